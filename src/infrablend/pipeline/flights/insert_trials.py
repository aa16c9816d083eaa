"""Trials of a detector: objects are inserted into pictures in memory, and the detector looks for them.

Each picture is also searched as it is. What the detector sees there may be real: an object that is inserted on it is no
trial, and what it reports there is no object of ours. Labelled objects of the class are trials of their own, with which
those of inserted objects can be compared.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import box_iou, clip_boxes
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.ground_position import ground_pixel_m, pose_of
from infrablend.core.rng import stream
from infrablend.core.scene import ObjectSpec
from infrablend.detection.detections import Detections, FloatArray
from infrablend.detection.finder import Finder
from infrablend.detection.sightings import Sighting, match_scores
from infrablend.detection.truth import image_key, match_classes
from infrablend.errors import DatasetError, Problem
from infrablend.formats.pictures.images import load_background
from infrablend.pipeline.compose.memory_frames import Frame, Frames
from infrablend.sampling.labelled_ground import kinds_around
from infrablend.thermal.radiometry import ZERO_C_K

# Half-open ranges of contrast, 8-bit levels, and of the visible share.
_CONTRAST_GREY = (0.0, 15.0, 30.0, 60.0, 120.0)
_VISIBLE = (0.0, 0.5, 0.8, 0.999)
GROUND_PIXEL_CM = (0.0, 2.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0)
"""Edges of the ranges of what a pixel covers of the ground, across the line of sight."""
_AIR_C = (-40.0, -10.0, 0.0, 10.0, 20.0, 30.0)
UNKNOWN_TIME = "unknown"
# A box that is nearer to the edge of its picture is cut by it: labels end a pixel or two before it.
_EDGE_PX = 2.0


@dataclass(frozen=True)
class TrialRules:
    """What counts in a trial.

    Attributes:
        category: Class of the inserted objects, and of the labels to compare them with.
        numbers: The detector's numbers of that class.
        least_overlap: Least overlap of a detection with its object.
        least_score: Least score of a detection that is looked at.
        clusters: Group of each picture by `<split>/<name>`; a picture without one is a group of its own.
        ignored: Classes of the labels that mark regions to ignore.
        stands: Whether the inserted objects stand on the ground, so that the surface around them counts.
    """

    category: str
    numbers: tuple[int, ...]
    least_overlap: float
    least_score: float
    clusters: Mapping[str, str]
    ignored: frozenset[str]
    stands: bool = False

    def is_class(self, name: str) -> bool:
        """Whether labels of a name are of the class: the same name, or another name of the same class."""
        return bool(match_classes([name], [self.category])[self.category])

    def of_class(self, found: Detections) -> Detections:
        """Return the detections of the class."""
        return found.take(np.flatnonzero(np.isin(found.classes, self.numbers)))


@dataclass
class SearchedPicture:
    """A picture as it is, searched.

    Attributes:
        image: Record of the picture.
        found: Detections of the class, in descending order of their scores.
        real: Labelled objects of the class.
        alarms: (n,) whether a detection sees no labelled object.
    """

    image: ImageRecord
    found: Detections
    real: list[Sighting]
    alarms: NDArray[np.bool_]


@dataclass
class Trials:
    """Trials of a detector on the frames of a recipe.

    Attributes:
        frames: Frames of the recipe.
        finder: The detector.
        rules: What counts.
        inserted: Inserted objects so far.
        searched: Pictures that were searched as they are, by `<split>/<name>`.
        counts: Numbers of inserted objects that are no trials, by reason.
        unread: Pictures that could not be read.
    """

    frames: Frames
    finder: Finder
    rules: TrialRules
    inserted: list[Sighting] = field(default_factory=list)
    searched: dict[str, SearchedPicture] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    unread: list[Problem] = field(default_factory=list)

    def images(self) -> list[ImageRecord]:
        """Return the pictures of the frames, each once."""
        return list({image_key(image): image for image in self.frames.backgrounds.values()}.values())

    def rounds(self, seed: int, most: int) -> Iterator[int]:
        """Try frame after frame in a drawn order, and yield the number of finished frames.

        Each round has other objects on the same backgrounds.

        Args:
            seed: Seed of the order and of the objects.
            most: Most rounds.
        """
        finished = 0
        for number in range(most):
            ids = np.array(self.frames.ids, object)
            stream(seed, "detectability", number).shuffle(ids)
            for frame in self.frames.iterate(ids.tolist(), seed + number):
                self.try_frame(frame, number)
                finished += 1
                yield finished

    def try_frame(self, frame: Frame, round_: int = 0) -> None:
        """Search a frame and the picture it was made of; objects of other rounds are other ones."""
        ours = [i for i in frame.inserted if self.rules.is_class(i.category)]
        self.counts["without_label"] += len(frame.record.facts.get("drops", ()))
        if frame.scene is not None:
            self.counts["without_place"] += sum(frame.scene.draws.get("absent", {}).values())
        before = self.search(self.frames.backgrounds[frame.id])
        if before is None or not ours:
            return
        others = [i for i in frame.labels if not i.inserted and self.rules.is_class(i.category)]
        found = self.rules.of_class(self.finder.find(frame.pixels, self.rules.least_score, before.image.capture.scale))
        boxes = _boxes([*ours, *others])
        scores, near, _ = match_scores(boxes, _boxes([]), found, self.rules.least_overlap)
        around = self._surfaces(frame.pixels, boxes)
        taken = box_iou(boxes, before.found.boxes_xyxy).max(axis=1, initial=0.0) >= self.rules.least_overlap
        for k, instance in enumerate(ours):
            if taken[k]:
                self.counts["on_a_detection"] += 1
                continue
            sighting = self._sighting(before.image, instance, scores[k], near[k], around[k], frame, round_)
            self.inserted.append(sighting)

    def search(self, image: ImageRecord) -> SearchedPicture | None:
        """Search a picture as it is, once; None if it cannot be read."""
        key = image_key(image)
        if key in self.searched:
            return self.searched[key]
        try:
            pixels = load_background(image.path, image.size_wh).pixels
        except DatasetError as error:
            self.unread += [p for p in error.problems if p not in self.unread]
            return None
        found = self.rules.of_class(self.finder.find(pixels, self.rules.least_score, image.capture.scale))
        ours = [i for i in image.instances if self.rules.is_class(i.category) and not i.is_crowd]
        regions = [i for i in image.instances if i.category in self.rules.ignored or (i.is_crowd and i not in ours)]
        scores, near, alarms = match_scores(_boxes(ours), _boxes(regions), found, self.rules.least_overlap)
        around = self._surfaces(pixels, _boxes(ours))
        real = [self._sighting(image, i, scores[k], near[k], around[k]) for k, i in enumerate(ours)]
        self.searched[key] = SearchedPicture(image, found, real, alarms)
        return self.searched[key]

    def real(self) -> list[Sighting]:
        """Return the labelled objects of the pictures that were searched."""
        return [sighting for picture in self.searched.values() for sighting in picture.real]

    def labelled_sizes(self) -> tuple[FloatArray, list[str]]:
        """Return the sizes of all labelled objects of the class, px, and their strata, see `stratum`."""
        pairs = [
            (_size_px(image, instance), stratum(image.capture.time_of_day or UNKNOWN_TIME, at_edge(image, instance)))
            for image in self.images()
            for instance in image.instances
            if self.rules.is_class(instance.category) and not instance.is_crowd
        ]
        return np.array([size for size, _ in pairs], np.float64), [name for _, name in pairs]

    def _surfaces(self, pixels: NDArray[np.uint8] | NDArray[np.uint16], boxes: FloatArray) -> Sequence[str | None]:
        """Return the surface around each of (n, 4) boxes of standing objects, found as for real ones; else None."""
        return kinds_around(pixels, boxes) if self.rules.stands and len(boxes) else [None] * len(boxes)

    def _sighting(
        self, image: ImageRecord, instance: Instance, score: float, near: float, surface: str | None,
        frame: Frame | None = None, round_: int = 0,
    ) -> Sighting:  # fmt: skip
        key = image_key(image)
        capture = image.capture
        middle = (instance.box_xyxy[:2] + instance.box_xyxy[2:]) / 2
        conditions = look_conditions(image, middle[None])[0] | {"edge": at_edge(image, instance)}
        if capture.pitch_deg is not None:
            conditions["pitch"] = f"{capture.pitch_deg:.0f} degrees"
        if surface is not None:
            conditions["surface"] = surface
        track = ""
        if frame is not None and frame.scene is not None:
            number = int(instance.extra["object"])
            spec = frame.scene.objects[number]
            conditions |= _described(spec)
            if frame.scene.weather is not None:
                conditions["air"] = in_range(frame.scene.weather.air_k - ZERO_C_K, _AIR_C, "degrees Celsius")
            if "contrast_grey" in instance.extra:
                conditions["contrast"] = in_range(float(instance.extra["contrast_grey"]), _CONTRAST_GREY, "levels")
            if instance.visibility is not None:
                conditions["visible"] = in_range(instance.visibility, _VISIBLE)
            behind = frame.record.facts.get("matching", {}).get("behind", ())
            if number < len(behind):
                conditions["behind"] = str(behind[number])
            track = "" if spec.track is None else f"{round_}/{capture.sequence}/{spec.track}"
        return Sighting(
            key,
            self.rules.clusters.get(key, key),
            _size_px(image, instance),
            float(score),
            float(near),
            conditions,
            track,
        )


def _described(spec: ObjectSpec) -> dict[str, str]:
    """Return what an inserted object is: its target, such as `lying` or `lying child`, and its clothing."""
    params = spec.params
    target = str(params.get("pose", params.get("variant", spec.model)))
    if params.get("age") == "child":
        target += " child"
    return {"target": target, **({"clothing": str(params["clothing"])} if "clothing" in params else {})}


def look_conditions(image: ImageRecord, xy: FloatArray) -> list[dict[str, str]]:
    """Return what is known of a look at each of (n, 2) places of a picture, px, whatever is there.

    The time of day, the height of the camera, and the ground that a pixel covers where the camera's pose is known.
    """
    of_all = {"time": image.capture.time_of_day or UNKNOWN_TIME}
    if image.capture.altitude_m is not None:
        of_all["height"] = f"{image.capture.altitude_m:.0f} m"
    pose = pose_of(image)
    if isinstance(pose, str):
        return [dict(of_all) for _ in xy]
    found = []
    for ground_m in ground_pixel_m(pose, xy):
        known = {"ground pixel": in_range(100 * ground_m, GROUND_PIXEL_CM, "cm")} if np.isfinite(ground_m) else {}
        found.append(of_all | known)
    return found


def at_edge(image: ImageRecord, instance: Instance) -> str:
    """Return `cut` for an object whose box reaches the picture's edge, else `whole`."""
    if image.size_wh is None:
        return "whole"
    inner = (instance.box_xyxy[:2] > _EDGE_PX).all() and (
        instance.box_xyxy[2:] < np.array(image.size_wh) - _EDGE_PX
    ).all()
    return "whole" if inner else "cut"


def stratum(time: str, edge: str) -> str:
    """Return the name of the objects that are compared with each other: those of a time of day, cut ones apart."""
    return f"{time}, {edge}"


def in_range(value: float, edges: Sequence[float], unit: str = "") -> str:
    """Return the name of the half-open range of a value: `30-60 levels`.

    >>> in_range(31.0, (0, 30, 60), "levels"), in_range(70.0, (0, 30, 60), "levels")
    ('30-60 levels', '>=60 levels')
    """
    k = max(0, int(np.searchsorted(edges, value, side="right")) - 1)
    name = f">={edges[k]:g}" if k == len(edges) - 1 else f"{edges[k]:g}-{edges[k + 1]:g}"
    return f"{name} {unit}".rstrip()


def _boxes(instances: Sequence[Instance]) -> FloatArray:
    return np.array([i.box_xyxy for i in instances], np.float64).reshape(-1, 4)


def _size_px(image: ImageRecord, instance: Instance) -> float:
    """Return the longer side of what the picture has of a box, px."""
    box = instance.box_xyxy if image.size_wh is None else clip_boxes(instance.box_xyxy[None], image.size_wh)[0]
    return float((box[2:] - box[:2]).max())
