"""Counts the objects of a flight: detections on the ground, each thing once however many pictures show it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypedDict

import numpy as np

from infrablend.core.boxes import polygon_area
from infrablend.core.dataset import ImageRecord
from infrablend.core.ground_position import LocalFrame, footprint
from infrablend.detection.detections import Predictions
from infrablend.detection.truth import image_key
from infrablend.formats.values import to_time
from infrablend.pipeline.flights.flight_poses import FlightPoses
from infrablend.pipeline.flights.placed_detections import PlacedDetection
from infrablend.pipeline.flights.same_object import FlightObject, PlacedSighting, count_objects

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


def count_flight(
    placed: Sequence[PlacedDetection],
    predictions: Predictions,
    images: Sequence[ImageRecord],
    own: FlightPoses,
    speed_m_s: float,
) -> FlightObjectFacts:
    """Return the objects behind the detections of a flight.

    Args:
        placed: The detections on the ground, by `own`.
        predictions: The same in the pictures.
        images: The pictures.
        own: Poses for joining, as `aligned_poses` has them.
        speed_m_s: How fast things move at most; 0 if none do.
    """
    times = _times(images)
    objects: list[ObjectFacts] = []
    counts = []
    for frame in dict.fromkeys(own.frames.values()):
        keys = [k for k, f in own.frames.items() if f == frame]
        area = sum(abs(polygon_area(footprint(own.known[k], frame))) for k in keys)
        here = [p for p in placed if own.frames[p.picture] == frame]
        count = count_objects([_sighting(p, predictions, frame, times) for p in here], max(area, 1.0), speed_m_s)
        counts.append(count)
        objects += [_facts(len(objects) + n, one, here, frame) for n, one in enumerate(count.objects)]
    return {
        "per_picture": round(len(placed) / max(len(own.known), 1), 3),
        "expected": round(sum(c.expected for c in counts), 1),
        "fewest": sum(c.fewest for c in counts),
        "most": sum(c.most for c in counts),
        "objects": objects,
    }


def _sighting(
    p: PlacedDetection, predictions: Predictions, frame: LocalFrame, times: Mapping[str, float]
) -> PlacedSighting:
    """Return a detection with the errors of its pose and its box."""
    box = predictions.images[p.picture].boxes_xyxy[p.number]
    cut = bool((box[:2] < 1).any() or (box[2:] > np.array(predictions.sizes_wh[p.picture]) - 1).any())
    of_box = (p.size_m * (_CUT if cut else _BOX)) ** 2 * np.eye(2)
    place = frame.to_metres(p.latitude_deg, p.longitude_deg)
    return PlacedSighting(p.picture, times.get(p.picture), place, p.ellipse.covariance() + of_box, p.size_m, p.category)


def _facts(number: int, one: FlightObject, placed: Sequence[PlacedDetection], frame: LocalFrame) -> ObjectFacts:
    latitude, longitude = frame.to_degrees(*one.place_m).tolist()
    return {
        "number": number,
        "category": one.category,
        "latitude": round(latitude, 7),
        "longitude": round(longitude, 7),
        "sightings": [f"{placed[k].picture} {placed[k].number}" for k in one.sightings],
        "moves": one.moves,
        "speed_m_s": round(one.speed_m_s, 2),
        "ambiguous": one.ambiguous,
    }


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
