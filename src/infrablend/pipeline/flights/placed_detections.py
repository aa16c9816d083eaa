"""Places detections on the ground, from the poses of their pictures, and writes maps of them.

A detection's place is that of the middle of its box; the flatter the camera looks, the further down in the box, where a
thing that stands touches the ground. Its ellipse holds the true place with `PROBABILITY`, and follows from the standard
errors of the pose.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import ImageRecord
from infrablend.core.ground_position import (
    LEAST_DEPRESSION_DEG,
    PROBABILITY,
    Ellipse,
    LocalFrame,
    Pose,
    ellipse,
    footprint,
    ground_of_pixels,
    ground_pixel_m,
    position_covariance,
)
from infrablend.core.mesh import FloatArray
from infrablend.detection.detections import Detections, Predictions
from infrablend.errors import DatasetError, Problem
from infrablend.formats.maps.map_files import MapFeature, write_geojson, write_gpx, write_kml
from infrablend.pipeline.flights.aligned_poses import align_poses
from infrablend.pipeline.flights.flight_poses import FlightPoses, find_poses
from infrablend.pipeline.flights.place_settings import PlaceSettings
from infrablend.pipeline.flights.terrain import Terrain, on_terrain
from infrablend.report.flight_map import draw_flight

DETECTIONS_MAP = "detections.geojson"
FOOTPRINTS_MAP = "footprints.geojson"
_BLUE = "#0072b2"


@dataclass(frozen=True)
class PlacedDetection:
    """A detection on the ground.

    Attributes:
        picture: `<split>/<name>` of its picture.
        number: Its number among the detections of the picture, from 0.
        category: Its class.
        score: Its score.
        latitude_deg: Latitude of the place.
        longitude_deg: Longitude of the place.
        ellipse: Ellipse that holds the true place with `PROBABILITY`.
        size_m: Longer side of its box, at its distance.
        ground_pixel_m: Metres across the line of sight in a pixel.
    """

    picture: str
    number: int
    category: str
    score: float
    latitude_deg: float
    longitude_deg: float
    ellipse: Ellipse
    size_m: float
    ground_pixel_m: float

    def table_cells(self) -> list[str]:
        """Return latitude, longitude, and semi-axes and bearing of the ellipse, as text."""
        e = self.ellipse
        place = f"{self.latitude_deg:.7f}", f"{self.longitude_deg:.7f}"
        return [*place, f"{e.major_m:.2f}", f"{e.minor_m:.2f}", f"{e.azimuth_deg:.1f}"]


@dataclass(frozen=True, eq=False)
class FlightPlaces:
    """Where things are on a flight.

    Attributes:
        poses: Poses of its pictures.
        placed: Detections that have a place.
        problems: Warnings about pictures and detections without one, and about what is taken for granted.
        joining: Poses by which pictures are compared with each other, see `aligned_poses`.
        joined: The detections that have a place, by these.
    """

    poses: FlightPoses
    placed: Sequence[PlacedDetection]
    problems: Sequence[Problem]
    joining: FlightPoses
    joined: Sequence[PlacedDetection]

    def stated_errors(self) -> list[tuple[str, float, str, int]]:
        """Return the standard errors that ellipses follow from: name, value, source and number of pictures."""
        found = ((name, e.value, e.source) for p in self.poses.known.values() for name, e in p.errors.items())
        return [(*key, n) for key, n in sorted(Counter(found).items())]

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {
            "pictures": len(self.poses.known),
            "detections": len(self.placed),
            "lacking": dict(self.poses.lacking),
            "errors": [
                {"name": name, "value": value, "source": source, "pictures": n}
                for name, value, source, n in self.stated_errors()
            ],
        }


def place_flight(
    where: str, images: Sequence[ImageRecord], predictions: Predictions, settings: PlaceSettings
) -> FlightPlaces:
    """Return where the detections of a flight are.

    Args:
        where: Name of the data, for problems.
        images: The pictures.
        predictions: The detections.
        settings: How to place them.

    Raises:
        MissingDependencyError: A height model is given, and rasterio is not installed.
    """
    shown = {key for key, found in predictions.images.items() if len(found)}
    aligned = align_poses(where, images, find_poses(images, settings.errors), shown)
    poses = aligned.poses
    problems = list(aligned.problems)
    terrain = None
    if settings.terrain is not None and poses.known:
        try:
            poses, terrain = on_terrain(Path(settings.terrain), images, poses, settings.take_off)
        except DatasetError as error:
            # What was found stays, but has no places: those on level ground were not asked for.
            poses = FlightPoses({}, {}, {})
            problems += error.problems
        if settings.take_off is None:
            found = "the place of take-off is not known, and is taken to be that of each flight's first picture"
            problems.append(Problem(where, "take-off", found, "", "give --take-off LAT,LON", "warning"))
    placed, nowhere = place_detections(predictions, poses, terrain)
    for lacking, keys in itertools.groupby(
        sorted(poses.lacking, key=lambda k: (poses.lacking[k], k)), poses.lacking.get
    ):
        names = list(keys)
        found = f"{len(names)} of {len(images)} pictures are not on the map, such as {names[0]}; they lack: {lacking}"
        todo = "give what is missing as columns of metadata.csv"
        problems.append(Problem(where, "no-pose", found, "position, height, angles and lens of each", todo, "warning"))
    if nowhere:
        found = f"no place for {nowhere} of {nowhere + len(placed)} detections in pictures on the map"
        expected = f"ground {LEAST_DEPRESSION_DEG:g} degrees or more below the horizon, and in the height model"
        problems.append(Problem(where, "no-place", found, expected, severity="warning"))
    joining = replace(aligned.own, known={k: aligned.own.known[k] for k in poses.known}, frames=poses.frames)
    joined, _ = place_detections(predictions, joining, terrain)
    return FlightPlaces(poses, placed, problems, joining, joined)


def place_detections(
    predictions: Predictions, poses: FlightPoses, terrain: Terrain | None = None
) -> tuple[list[PlacedDetection], int]:
    """Return the detections on the ground, by picture and number, and how many of pictures with a pose have no place.

    Those are nearer to the horizon than `core.ground_position.LEAST_DEPRESSION_DEG`, or leave the height model.
    """
    placed: list[PlacedDetection] = []
    tried = 0
    for key, found in sorted(predictions.images.items()):
        pose = poses.known.get(key)
        if pose is None or not len(found):
            continue
        tried += len(found)
        frame = poses.frames[key]
        xy = ground_contact(found.boxes_xyxy, pose)
        every = np.arange(len(found))
        if terrain is None:
            placed += _placed(key, found, predictions.classes, pose, frame, xy, every)
            continue
        for k in every:
            over = replace(pose, height_m=terrain.height_m(key, pose, frame, xy[k]))
            placed += _placed(key, found, predictions.classes, over, frame, xy, every[k : k + 1])
    return placed, tried - len(placed)


def _placed(
    key: str,
    found: Detections,
    classes: Sequence[str],
    pose: Pose,
    frame: LocalFrame,
    xy: FloatArray,
    which: NDArray[np.int_],
) -> Iterator[PlacedDetection]:
    """Yield those of some detections of a picture whose pixels `xy` meet the ground below the camera's height."""
    en = ground_of_pixels(pose, frame, xy[which])
    covariances = position_covariance(pose, frame, xy[which])
    pixel_m = ground_pixel_m(pose, xy[which])
    for k, place, covariance, pixel in zip(which.tolist(), en, covariances, pixel_m.tolist(), strict=True):
        if np.isnan(place).any():
            continue
        latitude, longitude = frame.to_degrees(*place).tolist()
        left, top, right, bottom = found.boxes_xyxy[k]
        yield PlacedDetection(
            picture=key,
            number=k,
            category=classes[int(found.classes[k])],
            score=float(found.scores[k]),
            latitude_deg=latitude,
            longitude_deg=longitude,
            ellipse=ellipse(covariance),
            size_m=float(max(right - left, bottom - top)) * pixel,
            ground_pixel_m=pixel,
        )


def ground_contact(boxes_xyxy: FloatArray, pose: Pose) -> FloatArray:
    """Return the (n, 2) pixels at which things in (n, 4) boxes are taken to touch the ground.

    Seen from above it is the middle of the box, seen level the middle of its lower edge.
    """
    middle = (boxes_xyxy[:, :2] + boxes_xyxy[:, 2:]) / 2
    half = (boxes_xyxy[:, 3] - boxes_xyxy[:, 1]) / 2
    middle[:, 1] += half * abs(math.cos(math.radians(pose.pitch_deg)))
    return np.asarray(middle)


def write_maps(folder: Path, poses: FlightPoses, placed: Sequence[PlacedDetection]) -> list[Path]:
    """Write detections as GeoJSON, KML and GPX, and footprints as GeoJSON.

    Raises:
        OutputError: A file cannot be written.
    """
    features = [_feature(p) for p in placed]
    return [
        write_geojson(folder / DETECTIONS_MAP, features),
        write_geojson(folder / FOOTPRINTS_MAP, _footprints(poses)),
        write_kml(folder / "detections.kml", "detections", features),
        write_gpx(folder / "detections.gpx", features),
    ]


def draw_maps(poses: FlightPoses, placed: Sequence[PlacedDetection]) -> list[bytes]:
    """Return a map of each place that was flown over, as SVG files."""
    maps = []
    for frame in dict.fromkeys(poses.frames.values()):
        keys = sorted(k for k, f in poses.frames.items() if f == frame)
        footprints = [shape for k in keys if len(shape := footprint(poses.known[k], frame))]
        found: dict[str, list[tuple[FloatArray, Ellipse]]] = defaultdict(list)
        for p in placed:
            if poses.frames[p.picture] == frame:
                found[p.category].append((frame.to_metres(p.latitude_deg, p.longitude_deg), p.ellipse))
        at = f"{frame.latitude_deg:.5f}, {frame.longitude_deg:.5f}"
        if footprints:
            maps.append(draw_flight(footprints, found, f"{len(keys)} pictures; origin at {at}"))
    return maps


def _feature(p: PlacedDetection) -> MapFeature:
    shape = p.ellipse
    sure = (
        f"{PROBABILITY:.0%} within {shape.major_m:.1f} x {shape.minor_m:.1f} m, long axis {shape.azimuth_deg:.0f} deg"
    )
    return MapFeature(
        f"{p.picture} {p.number}",
        f"{p.category} {p.score:.2f}",
        f"{p.picture}, detection {p.number}; {sure}; {p.size_m:.1f} m long",
        np.array([[p.latitude_deg, p.longitude_deg]]),
        properties={
            "picture": p.picture,
            "number": p.number,
            "class": p.category,
            "score": p.score,
            "size_m": round(p.size_m, 2),
            "ground_pixel_m": round(p.ground_pixel_m, 4),
            "ellipse": {
                "probability": PROBABILITY,
                "major_m": round(shape.major_m, 2),
                "minor_m": round(shape.minor_m, 2),
                "azimuth_deg": round(shape.azimuth_deg, 1),
            },
        },
    )


def _footprints(poses: FlightPoses) -> Iterator[MapFeature]:
    """Yield the ground in each picture; nothing for one that shows none."""
    for key, pose in sorted(poses.known.items()):
        frame = poses.frames[key]
        facts = {
            "picture": key,
            "height_m": pose.height_m,
            "yaw_deg": pose.yaw_deg,
            "pitch_deg": pose.pitch_deg,
            "roll_deg": pose.roll_deg,
            "hfov_deg": pose.hfov_deg,
        }
        if len(corners := footprint(pose, frame)):
            yield MapFeature(key, key, f"{pose.height_m:.1f} m", frame.to_degrees(*corners.T), _BLUE, facts)
