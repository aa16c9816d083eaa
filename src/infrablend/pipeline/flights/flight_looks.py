"""The pictures of a flight as looks at the same ground: which follow each other, and how the camera moves by its poses.

With that, an inserted object stays at its place through all pictures that show it. Pictures of a flight are seconds and
metres apart, too far for the background to tell the movement; errors of positions shift an object from picture to
picture, but hardly change how well it can be seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.ground_position import (
    LocalFrame,
    Pose,
    ground_of_pixels,
    ground_to_pixels,
    pixels_of_ground,
)
from infrablend.imaging.camera_path import Moment
from infrablend.pipeline.flights.flight_poses import find_poses
from infrablend.pipeline.plans.sequence_motion import SequenceMotion
from infrablend.pipeline.studies.flight_overlap import flight_order

LONGEST = 60
"""Most pictures that are populated together: an object beyond them is another one."""
# Points along each side of a picture, and the share of them that the next picture shows where they overlap.
_POINTS = 5
_OVERLAP = 0.2


def as_flights(dataset: Dataset) -> Dataset | None:
    """Return the dataset with its pictures numbered in flights by their capture; None if it is no flight.

    It is one if every picture has a pose and none a sequence of its own, and most pictures overlap the next one.
    """
    images = sorted(dataset.images, key=lambda i: (i.split, *flight_order(i)))
    known = [*find_poses(images).known.values()]
    if len(known) < len(images) or len(images) < 2 or any(i.capture.frame is not None for i in images):
        return None
    overlapping = sum(_overlap(a, b) for a, b in pairwise(known))
    if 2 * overlapping < len(images) - 1:
        return None
    numbered = [
        replace(image, capture=replace(image.capture, sequence=f"flight part {k // LONGEST + 1}", frame=k % LONGEST))
        for k, image in enumerate(images)
    ]
    return replace(dataset, images=tuple(numbered))


def _overlap(one: Pose, other: Pose) -> bool:
    """Return whether a picture shows a part of the ground of another one."""
    frame = LocalFrame(one.latitude_deg, one.longitude_deg)
    x, y = np.meshgrid(*(np.linspace(0.05, 0.95, _POINTS) * side for side in one.size_wh))
    ground = ground_of_pixels(one, frame, np.stack([x.ravel(), y.ravel()], axis=1))
    seen = pixels_of_ground(other, frame, ground[np.isfinite(ground).all(axis=1)])
    return float(((seen >= 0) & (seen < other.size_wh)).all(axis=1).sum()) >= _OVERLAP * x.size


def motion_by_pose(name: str, images: Sequence[ImageRecord]) -> SequenceMotion:
    """Return how the camera moves through pictures that all have a pose, as it is over level ground."""
    poses = [*find_poses(images).known.values()]
    frame = LocalFrame(poses[0].latitude_deg, poses[0].longitude_deg)
    first = ground_to_pixels(poses[0], frame)
    moments = []
    for k, pose in enumerate(poses):
        matrix = first @ np.linalg.inv(ground_to_pixels(pose, frame))
        moments.append(Moment(0, "followed" if k else "first", matrix / matrix[2, 2]))
    numbers = tuple(image.capture.frame or 0 for image in images)
    return SequenceMotion(name, numbers, tuple(moments), poses[0].size_wh)
