"""Objects in pictures, inserted or real, and how surely a detector sees each of them.

A sighting holds the score of the detection of its object, so that it is found at every confidence up to that score.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import box_areas, box_iou, shared_areas
from infrablend.detection.detections import Detections, FloatArray
from infrablend.detection.recall import Share, weighted_share

NEAR_PX = 8.0
"""Least reach of an object, px: a detection whose middle is that near shows a searcher the place."""


@dataclass(frozen=True)
class Sighting:
    """An object in one picture.

    Attributes:
        picture: `<split>/<name>` of the picture.
        cluster: Group of pictures whose results depend on each other: the picture itself, its clip or its day.
        size_px: Longer side of its box.
        score: Score of the detection that overlaps it; 0 without one.
        score_near: Score of a detection whose middle is within its longer side, at least `NEAR_PX`; 0 without one.
        conditions: What is known of it: time of day, target, contrast ..., by name.
        track: Name of the object throughout its sequence; empty in single pictures.
    """

    picture: str
    cluster: str
    size_px: float
    score: float
    score_near: float
    conditions: dict[str, str]
    track: str = ""


def match_scores(
    boxes_xyxy: FloatArray, regions_xyxy: FloatArray, found: Detections, least_overlap: float
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return how surely objects of one class are seen, and which detections are of none.

    Detections choose in the order of their scores, each the free object with the largest overlap, so that what is found
    at a confidence does not depend on detections below it.

    Args:
        boxes_xyxy: (g, 4) boxes of the objects, px.
        regions_xyxy: (r, 4) regions to ignore, px: a detection with half of its area in one is no alarm.
        found: Detections of the class, in descending order of their scores.
        least_overlap: Least intersection over union of a detection with its object.

    Returns:
        (g,) scores by overlap, (g,) scores by place (see `Sighting.score_near`), and (n,) whether a detection is an
        alarm, which neither sees an object nor lies in a region.
    """
    overlap = box_iou(found.boxes_xyxy, boxes_xyxy)
    near = _nearness(found.boxes_xyxy, boxes_xyxy)
    by_overlap, of_object = _choose(np.where(overlap >= least_overlap, overlap, 0.0), found.scores)
    by_place, at_object = _choose(near, found.scores)
    in_region = shared_areas(found.boxes_xyxy, regions_xyxy).max(axis=1, initial=0.0)
    area = box_areas(found.boxes_xyxy)
    inside = (area > 0) & (in_region >= 0.5 * area)
    return by_overlap, by_place, ~(of_object | at_object | inside)


def _nearness(found_xyxy: FloatArray, boxes_xyxy: FloatArray) -> FloatArray:
    """Return (n, g) numbers above 0, the larger the nearer, where the middle of a detection is within an object."""
    middle = (found_xyxy[:, None, :2] + found_xyxy[:, None, 2:] - boxes_xyxy[:, :2] - boxes_xyxy[:, 2:]) / 2
    reach = np.maximum((boxes_xyxy[:, 2:] - boxes_xyxy[:, :2]).max(axis=1, initial=0.0), NEAR_PX)
    return np.asarray(np.maximum(1.0 - np.linalg.norm(middle, axis=2) / reach, 0.0))


def _choose(value: FloatArray, scores: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the score of each object's detection, and whether a detection has an object; (n, g) values above 0 fit."""
    of_object = np.zeros(value.shape[1])
    chosen = np.zeros(value.shape[0], np.bool_)
    for d in np.flatnonzero(value.max(axis=1, initial=0.0) > 0):
        free = np.where(of_object > 0, 0.0, value[d])
        best = int(free.argmax())
        if free[best] > 0:
            of_object[best] = scores[d]
            chosen[d] = True
    return of_object, chosen


def share_found(sightings: Sequence[Sighting], found: NDArray[np.bool_], weights: FloatArray | None = None) -> Share:
    """Return the share of sightings that are found; those of a cluster, and those of a track, depend on each other."""
    tracks = [s.track or f"{k}" for k, s in enumerate(sightings)] if any(s.track for s in sightings) else None
    return weighted_share(found, [s.cluster for s in sightings], weights, tracks)
