"""The record of a finished frame, as JSON in the ledger of its run, and the small row that is shown and counted of it.

A record (`FrameRecord`) has scene, labels and decisions about labels. The pages of the studio, the report of a run, its
counts and warnings, and the tables of packed shards read frames as rows (`FrameRow`). A row has plain numbers and texts
only, no masks and no parts of objects.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from infrablend.core.camera import CameraSpec
from infrablend.core.dataset import Instance
from infrablend.core.rle_masks import Mask
from infrablend.core.scene import SceneSpec, Weather, weather_from_json
from infrablend.errors import Problem


@dataclass(frozen=True)
class Remains:
    """What is still visible of a label of the background that inserted objects cover in part.

    Attributes:
        visibility: Visible share.
        mask: Visible pixels; None if unknown.
    """

    visibility: float | None
    mask: Mask | None = None

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {"visibility": self.visibility, **({} if self.mask is None else {"mask": self.mask.to_coco()})}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Remains:
        """Return what `to_json` wrote."""
        mask = data.get("mask")
        return cls(data["visibility"], None if mask is None else Mask.from_coco(mask, tuple(mask["size"])))


@dataclass(frozen=True, eq=False)
class FrameRecord:
    """Everything that is known of a finished frame but its pixels.

    Attributes:
        frame_id: Id of the frame, `<split>/<name>`.
        image: Path of the image below `images/`.
        image_sha256: SHA-256 of the image file.
        background: Facts about the background: id, path relative to the data folder, SHA-256, size, pitch, altitude,
            time of day.
        scene: Description of the scene; None for an unchanged original.
        mapping: Grey-level mapping (`dark`, `bright`, optionally `limits`); None for an unchanged original.
        kept: Indices of the background's labels that were kept, in order.
        inserted: Labels of the inserted objects.
        removed: Labels that were removed, each with the reason.
        facts: Special cases of labelling (see `annotation.labels.LabelReport`), and values estimated from the
            background: `matching`, and `sensor` and `camera`, which were applied to the picture.
        warnings: Problems that did not stop the frame.
        covered: Visible remains of kept labels that inserted objects partly cover, by index.
        run: Identity of the run, see `RunPlan.run`.
    """

    frame_id: str
    image: str
    image_sha256: str
    background: Mapping[str, Any]
    scene: SceneSpec | None
    mapping: Mapping[str, object] | None
    kept: tuple[int, ...]
    inserted: tuple[Instance, ...]
    removed: tuple[Mapping[str, object], ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[Problem, ...] = ()
    covered: Mapping[int, Remains] = field(default_factory=dict)
    run: str = ""

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {
            "run": self.run,
            "frame_id": self.frame_id,
            "image": self.image,
            "image_sha256": self.image_sha256,
            "background": dict(self.background),
            "scene": None if self.scene is None else self.scene.to_json(),
            "mapping": None if self.mapping is None else dict(self.mapping),
            "kept": list(self.kept),
            **({"covered": {str(n): c.to_json() for n, c in self.covered.items()}} if self.covered else {}),
            "inserted": [i.to_json() for i in self.inserted],
            "removed": [dict(r) for r in self.removed],
            "facts": dict(self.facts),
            "warnings": [w.to_json() for w in self.warnings],
        }

    def to_text(self) -> str:
        """Return the record as JSON; equal records give equal texts."""
        return json.dumps(self.to_json(), sort_keys=True, separators=(",", ":"), allow_nan=False)

    def originals(self, background: Sequence[Instance]) -> tuple[Instance, ...]:
        """Return the kept labels of the background, restricted to their visible parts."""
        found = []
        for n in self.kept:
            seen = self.covered.get(n)
            if seen is None:
                found.append(background[n])
                continue
            mask = background[n].mask if seen.mask is None else seen.mask
            found.append(replace(background[n], visibility=seen.visibility, mask=mask))
        return tuple(found)

    @classmethod
    def from_text(cls, text: str | bytes) -> FrameRecord:
        """Return the record that `to_text` returned.

        Raises:
            LookupError, TypeError, ValueError, AttributeError: The text is damaged.
        """
        return cls.from_json(json.loads(text))

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> FrameRecord:
        """Return the record from JSON values written by `to_json`; the errors are those of `from_text`."""
        return cls(
            frame_id=data["frame_id"],
            image=data["image"],
            image_sha256=data["image_sha256"],
            background=data["background"],
            scene=None if data["scene"] is None else SceneSpec.from_json(data["scene"]),
            mapping=data["mapping"],
            kept=tuple(data["kept"]),
            inserted=tuple(Instance.from_json(i) for i in data["inserted"]),
            removed=tuple(data["removed"]),
            facts=data["facts"],
            warnings=tuple(Problem(**w) for w in data["warnings"]),
            covered={int(n): Remains.from_json(c) for n, c in data.get("covered", {}).items()},
            run=data["run"],
        )


Box = tuple[float, float, float, float]
"""Left, top, right and bottom of an axis-aligned box, pixels."""


@dataclass(frozen=True, slots=True)
class InsertRow:
    """An inserted object that has a label.

    Attributes:
        category: Class of the label.
        box_xyxy: Its box.
        range_m: Distance from the camera to the object; None if it is not recorded.
        change_grey: Smaller of the change of its pixels and the change of its box against the ring, 8-bit levels; None
            if it is not recorded.
        signed_grey: Contrast against the ring, 8-bit levels, negative for a darker object; None if not measured.
        visibility: Visible share; None if unknown.
        track: Name of its track in the run; empty in single pictures.
        kind: Number of the recipe's entry of `objects`, from 0; None if it is not recorded.
    """

    category: str
    box_xyxy: Box
    range_m: float | None = None
    change_grey: float | None = None
    signed_grey: float | None = None
    visibility: float | None = None
    track: str = ""
    kind: int | None = None

    @property
    def size_px(self) -> float:
        """Longer side of the box."""
        x0, y0, x1, y1 = self.box_xyxy
        return max(x1 - x0, y1 - y0)


@dataclass(frozen=True, slots=True)
class RemovedLabel:
    """A label that was left out of a frame.

    Attributes:
        category: Class of the object.
        reason: `covered`, `category` or `labels`, see `annotation.merge_labels.Removal`.
        covered_share: Share of the object under inserted objects.
        inserted: Whether it is of an inserted object.
        box_xyxy: Its box; None if it is not recorded.
    """

    category: str
    reason: str
    covered_share: float
    inserted: bool = False
    box_xyxy: Box | None = None


@dataclass(frozen=True, slots=True)
class DrawRow:
    """How the objects of a scene were drawn; see `SceneSpec.draws`, from which all fields but the last are.

    Attributes:
        wanted: Objects that the recipe asked for; None if that is not recorded.
        wanted_by_kind: The same by number of the recipe's entry.
        attempts: Places that were tried; None if that is not recorded.
        absent: Objects without a place by reason.
        rejected: Places refused by reason.
        first_distance_m: Camera's distance as it was drawn first; None if it is not recorded.
        too_small_px: Size of the largest object that was too small; None without one.
        pitch_from: What the pitch was taken from, if the recipe looks for the horizon.
        out_of_view: Tracks that are out of view.
        empty_by_recipe: Whether the recipe left the frame empty.
    """

    wanted: int | None = None
    wanted_by_kind: Mapping[int, int] = field(default_factory=dict)
    attempts: int | None = None
    absent: Mapping[str, int] = field(default_factory=dict)
    rejected: Mapping[str, int] = field(default_factory=dict)
    first_distance_m: float | None = None
    too_small_px: float | None = None
    pitch_from: str | None = None
    out_of_view: int = 0
    empty_by_recipe: bool = False

    @classmethod
    def from_json(cls, draws: Mapping[str, Any]) -> DrawRow:
        """Return the row of a scene's `draws`."""
        return cls(
            wanted=draws.get("wanted"),
            wanted_by_kind={int(kind): n for kind, n in draws.get("wanted_by_kind", {}).items()},
            attempts=draws.get("attempts"),
            absent=draws.get("absent", {}),
            rejected=draws.get("rejected", {}),
            first_distance_m=draws.get("first_distance_m"),
            too_small_px=draws.get("too_small_px"),
            pitch_from=draws.get("pitch_from"),
            out_of_view=draws.get("out_of_view", 0),
            empty_by_recipe=bool(draws.get("empty_by_recipe")),
        )


@dataclass(frozen=True, slots=True)
class SceneRow:
    """The scene of a frame.

    Attributes:
        configuration: Number of the configuration.
        pitch_deg: Pitch of the camera that the objects were rendered with.
        size_wh: Size of its pictures.
        distance_m: Its distance from the objects, with the paper's placement.
        draws: How the objects were drawn.
        stated_height_m: Height that the picture was made with, if its camera is the real one.
        at_limit: Whether the correction of that height reached a limit; None if it was not corrected.
        motion_px: Length of the motion tail.
        weather: Air, sky and sun; None in a look without them.
    """

    configuration: int
    pitch_deg: float
    size_wh: tuple[int, int]
    distance_m: float
    draws: DrawRow
    stated_height_m: float | None = None
    at_limit: bool | None = None
    motion_px: float = 0.0
    weather: Weather | None = None

    @classmethod
    def from_json(cls, scene: Mapping[str, Any]) -> SceneRow:
        """Return the row of a scene's JSON values, see `SceneSpec.to_json`."""
        camera = scene["camera"]
        view = scene.get("view")
        width, height = camera["size_wh"]
        return cls(
            configuration=scene["configuration"],
            pitch_deg=math.degrees(camera["pitch_rad"]),
            size_wh=(width, height),
            distance_m=camera["distance_m"],
            draws=DrawRow.from_json(scene["draws"]),
            stated_height_m=None if view is None else view["stated_height_m"],
            at_limit=view.get("at_limit", False) if view is not None and view["anchors"] else None,
            motion_px=math.hypot(*scene.get("motion_px", (0.0,))),
            weather=weather_from_json(scene.get("weather")),
        )


@dataclass(frozen=True, slots=True)
class FrameRow:
    """A finished frame; until its record is read, only the id is known.

    Attributes:
        id: Id of the frame, `<split>/<name>`.
        image: Path of its picture below `images/`.
        digest: SHA-256 of the picture.
        size_wh: Size of the picture.
        background: Id of its background.
        background_path: Path of its background below the data folder.
        background_digest: SHA-256 of the background.
        pitch_deg: Pitch of the background; None if unknown.
        altitude_m: Height of the background's camera; None if unknown.
        time_of_day: Time of day; None if unknown.
        time_from: What that was taken from: `recipe`, `sun` at the time of capture, or None for the dataset.
        scene: Its scene; None for an unchanged original.
        inserts: Labelled inserted objects.
        removed: Labels that were left out.
        covered: Number of labels that inserted objects cover in part.
        drops: Reason of each inserted object without a label.
        warnings: Problems that did not stop the frame.
        changes_grey: `InsertRow.change_grey` of all objects that were measured.
        first_changes_grey: The same before any object was moved for being too faint.
        hidden: For each object that was to be partly hidden, whether it is.
        behind: What is behind the objects, with the physical look: `ground`, `sky`, ...
        estimates_gain: Whether the gain was estimated.
        doubts: Doubts about it, see `compositing.gain.Doubt`.
        air_drawn: Whether the temperature of the air was drawn where it decides levels.
        faint: Number of labels of tracks of objects that nobody can see here.
        mask_fallbacks: Number of masks that became one pixel.
    """

    id: str
    image: str = ""
    digest: str = ""
    size_wh: tuple[int, int] = (0, 0)
    background: str = ""
    background_path: str = ""
    background_digest: str | None = None
    pitch_deg: float | None = None
    altitude_m: float | None = None
    time_of_day: str | None = None
    time_from: str | None = None
    scene: SceneRow | None = None
    inserts: tuple[InsertRow, ...] = ()
    removed: tuple[RemovedLabel, ...] = ()
    covered: int = 0
    drops: tuple[str, ...] = ()
    warnings: tuple[Problem, ...] = ()
    changes_grey: tuple[float, ...] = ()
    first_changes_grey: tuple[float, ...] = ()
    hidden: tuple[bool, ...] = ()
    behind: tuple[str, ...] = ()
    estimates_gain: bool = False
    doubts: frozenset[str] = frozenset()
    air_drawn: bool = False
    faint: int = 0
    mask_fallbacks: int = 0

    @classmethod
    def of(cls, record: FrameRecord) -> FrameRow:
        """Return the row of a frame's record."""
        return cls.from_json(record.to_json())

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> FrameRow:
        """Return the row of a record's JSON values.

        Raises:
            LookupError, TypeError, ValueError, AttributeError: The record is damaged.
        """
        background = record["background"]
        facts = record["facts"]
        scene = record["scene"]
        matching = facts.get("matching", {})
        gains = matching.get("gain", {}).values()
        contrasts = facts.get("contrast", ())
        width, height = background["size_wh"]
        return cls(
            id=str(record["frame_id"]),
            image=str(record["image"]),
            digest=str(record["image_sha256"]),
            size_wh=(int(width), int(height)),
            background=str(background["id"]),
            background_path=str(background["path"]),
            background_digest=background.get("sha256"),
            pitch_deg=background.get("pitch_deg"),
            altitude_m=background.get("altitude_m"),
            time_of_day=background.get("time_of_day"),
            time_from=background.get("time_from"),
            scene=None if scene is None else SceneRow.from_json(scene),
            inserts=_inserts(record),
            removed=tuple(_removed(r) for r in record["removed"]),
            covered=len(record.get("covered", ())),
            drops=tuple(str(d["reason"]) for d in facts.get("drops", ())),
            warnings=tuple(Problem(**w) for w in record["warnings"]),
            changes_grey=tuple(_change(c) for c in contrasts),
            first_changes_grey=tuple(_change(c) for c in facts.get("contrast_first", contrasts)),
            hidden=tuple("window" in o for o in facts.get("occlusion", ())),
            behind=tuple(matching.get("behind", ())),
            estimates_gain=bool(gains),
            doubts=frozenset(kind for gain in gains for kind in gain["doubts"]),
            air_drawn=matching.get("air") == "drawn",
            faint=len(facts.get("faint", ())),
            mask_fallbacks=len(facts.get("mask_fallbacks", ())),
        )

    # -- of the frame ------------------------------------------------------------------------------------------------

    @property
    def absent(self) -> Mapping[str, int]:
        """Number of wanted objects without a place, by reason."""
        return {} if self.scene is None else self.scene.draws.absent

    @property
    def missing(self) -> list[str]:
        """Reasons why wanted objects are absent or have no label, one per object, sorted."""
        return sorted([*self.drops, *(reason for reason, n in self.absent.items() for _ in range(int(n)))])

    @property
    def camera_pitch_deg(self) -> float | None:
        """Pitch of the camera that the objects were rendered with, else of the background."""
        return self.pitch_deg if self.scene is None else round(self.scene.pitch_deg, 6)

    @property
    def camera_height_m(self) -> float | None:
        """Height that the picture was made with, if its camera is the real one, else of the background."""
        if self.scene is None or self.scene.stated_height_m is None:
            return self.altitude_m
        return round(self.scene.stated_height_m, 1)

    @property
    def time_text(self) -> str | None:
        """Time of day, and what it was taken from where that is not the dataset: `dusk (recipe)`."""
        return self.time_of_day if self.time_from is None else f"{self.time_of_day} ({self.time_from})"

    @property
    def background_names(self) -> frozenset[str]:
        """Names that problems use for its background: id, path, file name."""
        name = PurePosixPath(self.background_path).name
        split = self.id.partition("/")[0]
        return frozenset({self.background, self.background_path, name, f"{split}/{name}"} - {""})

    @property
    def remarks(self) -> list[str]:
        """Warnings in words, and how many objects have no place."""
        texts = [w.found or w.code or "warning" for w in self.warnings]
        unplaced = sum(self.absent.values())
        return [*texts, f"{unplaced} object(s) not inserted"] if unplaced else texts

    # -- of its inserts ----------------------------------------------------------------------------------------------

    @property
    def classes(self) -> list[str]:
        """Classes of its inserts, each once, sorted."""
        return sorted({i.category for i in self.inserts})

    @property
    def boxes(self) -> tuple[Box, ...]:
        """Boxes of its inserts."""
        return tuple(i.box_xyxy for i in self.inserts)

    @property
    def size_px(self) -> float | None:
        """Longest side of the smallest insert's box; None without inserts."""
        return min((i.size_px for i in self.inserts), default=None)

    @property
    def visibility(self) -> float | None:
        """Least visible share of an insert; None if none is known."""
        return min((i.visibility for i in self.inserts if i.visibility is not None), default=None)

    @property
    def contrast(self) -> float | None:
        """Least contrast of an insert, 8-bit grey levels; None if none was measured."""
        return min((abs(i.signed_grey) for i in self.inserts if i.signed_grey is not None), default=None)


def _inserts(record: Mapping[str, Any]) -> tuple[InsertRow, ...]:
    measured = {c.get("object"): _change(c) for c in record["facts"].get("contrast", ())}
    scene = record["scene"]
    objects: Sequence[Mapping[str, Any]] = () if scene is None else scene["objects"]
    camera = None if scene is None else CameraSpec(**scene["camera"]).position_m
    found = []
    sequence = record["background"].get("sequence")
    for label in record["inserted"]:
        extra = label.get("extra") or {}
        number = extra.get("object")
        range_m = None
        kind = None
        if isinstance(number, int) and number < len(objects):
            range_m = float(np.linalg.norm(np.asarray(objects[number]["position_m"]) - camera))
            kind = objects[number].get("kind", 0)
        track = label.get("track_id")
        signed = extra.get("contrast_grey")
        found.append(
            InsertRow(
                category=str(label["category"]),
                box_xyxy=_box(label["box_xyxy"]),
                range_m=range_m,
                change_grey=measured.get(number),
                signed_grey=None if signed is None else float(signed),
                visibility=label.get("visibility"),
                track="" if track is None else f"{sequence} c{scene['configuration']} {track}",
                kind=kind,
            )
        )
    return tuple(found)


def _removed(label: Mapping[str, Any]) -> RemovedLabel:
    box = label.get("box_xyxy")
    return RemovedLabel(
        category=str(label["category"]),
        reason=str(label["reason"]),
        covered_share=float(label["covered_share"]),
        inserted=bool(label.get("inserted")),
        box_xyxy=None if box is None else _box(box),
    )


def _change(contrast: Mapping[str, float]) -> float:
    """Return the smaller of the change of an object's pixels and that of its box against the ring, if it has one."""
    return float(min(contrast["changed"], contrast.get("change", contrast["changed"])))


def _box(values: Iterable[Any]) -> Box:
    x0, y0, x1, y1 = (float(v) for v in values)
    if not all(math.isfinite(v) for v in (x0, y0, x1, y1)):
        raise ValueError(f"box {(x0, y0, x1, y1)}, expected finite numbers")
    return x0, y0, x1, y1
