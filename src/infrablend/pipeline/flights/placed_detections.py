"""Places detections on the ground, from the poses of their pictures, and writes maps of them.

A detection's place is that of the middle of its box; the flatter the camera looks, the further down in the box, where a
thing that stands touches the ground. Its ellipse holds the true place with `PROBABILITY`, and follows from the standard
errors of the pose.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from infrablend.core.dataset import ImageRecord
from infrablend.core.ground_position import (
    PROBABILITY,
    Ellipse,
    LocalFrame,
    Pose,
    PoseErrors,
    ellipse,
    footprint,
    ground_of_pixels,
    ground_pixel_m,
    pose_of,
    position_covariance,
)
from infrablend.core.mesh import FloatArray
from infrablend.detection.detections import Predictions
from infrablend.formats.maps.map_files import MapFeature, write_geojson, write_gpx, write_kml
from infrablend.report.flight_map import draw_flight

DETECTIONS_MAP = "detections.geojson"
FOOTPRINTS_MAP = "footprints.geojson"
_BLUE = "#0072b2"
# Pictures farther apart than this are on maps of their own: there, a plane is no longer the earth.
_SAME_MAP_M = 20_000.0


@dataclass(frozen=True, eq=False)
class FlightPoses:
    """Poses of the pictures of a flight, by `<split>/<name>`.

    Attributes:
        known: Pose of each picture.
        frames: Frame in which its metres are.
        lacking: What the other pictures lack for one.
    """

    known: Mapping[str, Pose]
    frames: Mapping[str, LocalFrame]
    lacking: Mapping[str, str]


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


def find_poses(images: Sequence[ImageRecord], errors: PoseErrors | None = None) -> FlightPoses:
    """Return the poses of pictures that state all that is needed, with standard errors replaced where given."""
    known: dict[str, Pose] = {}
    frames: dict[str, LocalFrame] = {}
    lacking: dict[str, str] = {}
    origins: list[LocalFrame] = []
    for image in images:
        key = f"{image.split}/{image.name}"
        pose = pose_of(image, errors)
        if isinstance(pose, str):
            lacking[key] = pose
            continue
        place = pose.latitude_deg, pose.longitude_deg
        near = [o for o in origins if np.linalg.norm(o.to_metres(*place)) <= _SAME_MAP_M]
        if not near:
            origins += (near := [LocalFrame(*place)])
        known[key], frames[key] = pose, near[0]
    return FlightPoses(known, frames, lacking)


def place_detections(predictions: Predictions, poses: FlightPoses) -> tuple[list[PlacedDetection], int]:
    """Return the detections on the ground, by picture and number, and how many of pictures with a pose have no place.

    Those are nearer to the horizon than `core.ground_position.LEAST_DEPRESSION_DEG`, or above it.
    """
    placed = []
    nowhere = 0
    for key, found in sorted(predictions.images.items()):
        if (pose := poses.known.get(key)) is None or not len(found):
            continue
        frame = poses.frames[key]
        xy = ground_contact(found.boxes_xyxy, pose)
        en = ground_of_pixels(pose, frame, xy)
        covariances = position_covariance(pose, frame, xy)
        pixel_m = ground_pixel_m(pose, xy)
        sides = (found.boxes_xyxy[:, 2:] - found.boxes_xyxy[:, :2]).max(axis=1)
        for k in range(len(found)):
            if np.isnan(en[k, 0]):
                nowhere += 1
                continue
            latitude, longitude = frame.to_degrees(*en[k]).tolist()
            category = predictions.classes[int(found.classes[k])]
            size_m = float(sides[k] * pixel_m[k])
            placed.append(
                PlacedDetection(
                    key, k, category, float(found.scores[k]), latitude, longitude, ellipse(covariances[k]), size_m,
                    float(pixel_m[k]),
                )
            )  # fmt: skip
    return placed, nowhere


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
        write_geojson(folder / FOOTPRINTS_MAP, [_footprint(key, poses) for key in sorted(poses.known)]),
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


def _footprint(key: str, poses: FlightPoses) -> MapFeature:
    pose, frame = poses.known[key], poses.frames[key]
    facts = {
        "picture": key,
        "height_m": pose.height_m,
        "yaw_deg": pose.yaw_deg,
        "pitch_deg": pose.pitch_deg,
        "roll_deg": pose.roll_deg,
        "hfov_deg": pose.hfov_deg,
    }
    text = ", ".join(f"{name} {value}" for name, value in list(facts.items())[1:])
    return MapFeature(key, key, text, frame.to_degrees(*footprint(pose, frame).T), _BLUE, facts)
