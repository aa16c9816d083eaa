"""Counts the objects of a flight: detections on the ground, each thing once however many pictures show it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypedDict

import numpy as np

from infrablend.core.boxes import polygon_area
from infrablend.core.dataset import ImageRecord
from infrablend.core.ground_position import LocalFrame, footprint, ground_of_pixels, ground_pixel_m, position_covariance
from infrablend.detection.detections import Predictions
from infrablend.detection.truth import image_key
from infrablend.formats.values import to_time
from infrablend.pipeline.flights.flight_poses import FlightPoses
from infrablend.pipeline.flights.placed_detections import ground_contact
from infrablend.pipeline.flights.same_object import Sighting, count_objects

# Errors of a box, as a share of its longer side: of its middle, and if the edge of the picture cuts it.
_BOX = 0.1
_CUT = 0.5


class ObjectFacts(TypedDict):
    """An object of a flight.

    Attributes:
        number: Its number, from 0.
        category: Its class.
        latitude: Its latitude; of one that moves, when it was seen last.
        longitude: Its longitude.
        sightings: `<picture> <number>` of its detections.
        moves: Whether it moves; None if that cannot be told.
        speed_m_s: Its speed.
        ambiguous: Whether one of these detections may as well be of another object.
    """

    number: int
    category: str
    latitude: float
    longitude: float
    sightings: list[str]
    moves: bool | None
    speed_m_s: float
    ambiguous: bool


class FlightObjectFacts(TypedDict):
    """The objects of a flight.

    Attributes:
        per_picture: Mean number of detections in a picture that is on the map.
        expected: Expected number of objects on the flight: what was lost from view and may have been seen again counts
            by the chance that it was not.
        fewest: Number of objects if all are one that may be.
        most: Number if none are one of which it is not certain.
        objects: The objects, with what was lost from view and seen again as two.
    """

    per_picture: float
    expected: float
    fewest: int
    most: int
    objects: list[ObjectFacts]


@dataclass(frozen=True, eq=False)
class _Seen:
    """Detections on one map.

    Attributes:
        names: `<picture> <number>` of each.
        sightings: Their places.
        area_m2: Ground that the pictures show.
    """

    names: list[str]
    sightings: list[Sighting]
    area_m2: float


def count_flight(
    predictions: Predictions, images: Sequence[ImageRecord], own: FlightPoses, speed_m_s: float
) -> FlightObjectFacts:
    """Return the objects behind the detections of a flight.

    Args:
        predictions: The detections to count.
        images: The pictures.
        own: Poses for joining, as `aligned_poses` has them.
        speed_m_s: How fast things move at most; 0 if none do.
    """
    times = _times(images)
    maps = [_seen(predictions, own, times, frame) for frame in dict.fromkeys(own.frames.values())]
    counts = [count_objects(m.sightings, m.area_m2, speed_m_s) for m in maps]
    objects: list[ObjectFacts] = []
    for frame, seen, count in zip(dict.fromkeys(own.frames.values()), maps, counts, strict=True):
        for one in count.objects:
            latitude, longitude = frame.to_degrees(*one.place_m).tolist()
            objects.append(
                {
                    "number": len(objects),
                    "category": one.category,
                    "latitude": round(latitude, 7),
                    "longitude": round(longitude, 7),
                    "sightings": [seen.names[k] for k in one.sightings],
                    "moves": one.moves,
                    "speed_m_s": round(one.speed_m_s, 2),
                    "ambiguous": one.ambiguous,
                }
            )
    pictures = sum(key in own.known for key in predictions.images)
    return {
        "per_picture": round(sum(len(m.sightings) for m in maps) / max(pictures, 1), 3),
        "expected": round(sum(c.expected for c in counts), 1),
        "fewest": sum(c.fewest for c in counts),
        "most": sum(c.most for c in counts),
        "objects": objects,
    }


def _seen(predictions: Predictions, own: FlightPoses, times: Mapping[str, float], frame: LocalFrame) -> _Seen:
    names: list[str] = []
    sightings: list[Sighting] = []
    area = 0.0
    for key, found in sorted(predictions.images.items()):
        pose = own.known.get(key)
        if pose is None or own.frames[key] != frame:
            continue
        area += abs(polygon_area(footprint(pose, frame)))
        xy = ground_contact(found.boxes_xyxy, pose)
        places = ground_of_pixels(pose, frame, xy)
        covariances = position_covariance(pose, frame, xy) if len(xy) else np.zeros((0, 2, 2))
        sides = (found.boxes_xyxy[:, 2:] - found.boxes_xyxy[:, :2]).max(axis=1, initial=0.0) * ground_pixel_m(pose, xy)
        inside = np.concatenate(
            [found.boxes_xyxy[:, :2] - 1, np.array(pose.size_wh) - 1 - found.boxes_xyxy[:, 2:]], axis=1
        )
        cut = inside.min(axis=1, initial=1.0) < 0
        for k in np.flatnonzero(np.isfinite(places).all(axis=1)).tolist():
            of_box = (float(sides[k]) * (_CUT if cut[k] else _BOX)) ** 2 * np.eye(2)
            category = predictions.classes[int(found.classes[k])]
            covariance = covariances[k] + of_box
            sightings.append(Sighting(key, times.get(key), places[k], covariance, float(sides[k]), category))
            names.append(f"{key} {k}")
    return _Seen(names, sightings, max(area, 1.0))


def _times(images: Sequence[ImageRecord]) -> dict[str, float]:
    """Return the second of each picture, within a single sequence or from dates; none unless all pictures have one."""
    seconds = [i.capture.time_s for i in images]
    if None in seconds or len({i.capture.sequence for i in images}) > 1:
        moments = [to_time(i.capture.captured) for i in images]
        known = [m for m in moments if m is not None]
        # A date alone is the same for all.
        if len(known) < len(images) or len({m.utcoffset() for m in known}) > 1 or len(set(known)) == 1:
            return {}
        seconds = [(m - known[0]).total_seconds() for m in known]
    return {image_key(i): s for i, s in zip(images, seconds, strict=True) if s is not None}
