"""Calibration of the camera's height: from the nominal height of the metadata and annotated objects of known size.

A picture's scale depends only on focal length over height. Heights in file names are relative to the take-off point,
and HIT-UAV's are wrong by up to a half, so the camera's height is corrected until the annotated people, cars and
two-wheelers of the same image have their real size.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from infrablend.config.recipe import StatedHeights, of_flight
from infrablend.core.camera import CameraSpec
from infrablend.core.capture import Capture
from infrablend.core.dataset import Instance, KnownClass, known_class
from infrablend.core.ground_plane import ground_point, ground_z_m
from infrablend.core.mesh import FloatArray
from infrablend.core.reference_sizes import REFERENCES, Reference, alike_headings, expected_sides

NOMINAL_FACTOR = 1.15
# Limits of the correction, as true over stated height: 1/1.1 to 1/0.65.
FACTOR_BOUNDS = (1 / 1.1, 1 / 0.65)
_MIN_SIDE_PX = 6.0


@dataclass(frozen=True)
class HeightPrior:
    """What is known about a stated height before any object of known size is looked at.

    Attributes:
        factor: True over stated height.
        sd: Standard deviation of the factor's logarithm.
        bounds: Limits of the corrected factor.
        references: Classes whose annotated boxes show the height.
        box_looseness: How much wider and higher annotated boxes are than the objects in them.
    """

    factor: float
    sd: float
    bounds: tuple[float, float] = FACTOR_BOUNDS
    references: tuple[KnownClass, ...] = ("person", "car", "bicycle")
    box_looseness: float = 1.0


# Heights in file names and tables, as in HIT-UAV: 1.15 times too low, with the spread between its groups.
FROM_TABLE = HeightPrior(NOMINAL_FACTOR, 0.16)
PRIORS: Mapping[str, HeightPrior] = {
    "take-off": HeightPrior(1.0, 0.16),
    "laser": HeightPrior(1.0, 0.03),
    "labels": HeightPrior(1.0, 0.03),
}
"""Heights that are no nominal ones, by their origin (`Capture.altitude_from`): above take-off, where only the relief
between there and here is unknown; from the laser range finder; or from the labels of a whole sequence."""


def prior_of(heights: StatedHeights, picture: Capture) -> HeightPrior:
    """Return the prior of a picture's height from a table, as the recipe states it for its dataset."""
    factor = heights.factor
    spread = heights.spread
    if (flight := of_flight(heights.by_flight, picture)) is not None:
        factor = flight.factor
        spread = flight.spread or spread
    low, high = (bound * (factor / NOMINAL_FACTOR) for bound in FACTOR_BOUNDS)
    return HeightPrior(factor, spread, (low, high), heights.references, heights.box_looseness)


@dataclass(frozen=True)
class Calibration:
    """The calibrated height of the camera.

    Attributes:
        height_m: Corrected height above the ground.
        factor: Corrected over stated height.
        sd: Standard deviation of the factor's logarithm.
        anchors: Number of annotated objects used, by class.
        at_limit: Whether the factor is at a limit of the correction.
    """

    height_m: float
    factor: float
    sd: float
    anchors: Mapping[str, int]
    at_limit: bool = False


def calibrate(
    camera: CameraSpec, stated_m: float, labels: Sequence[Instance], prior: HeightPrior = FROM_TABLE
) -> Calibration:
    """Calibrate the camera's height with the annotated boxes of one image.

    The median size ratio of each class (sitting people and half-hidden cars are outliers) is weighted against the
    nominal correction by the spread of its readings. `camera` is at the stated height (see `at_height`). Labels cut by
    the frame's edge and crowds are left out.
    """
    ratios: dict[KnownClass, list[float]] = {}
    for kind, _, ratio in log_ratios(camera, stated_m, labels, prior):
        ratios.setdefault(kind, []).append(ratio)
    # A box larger than predicted means that the camera is closer than stated.
    weight = 1 / prior.sd**2
    total = math.log(prior.factor) / prior.sd**2
    for name, found in sorted(ratios.items()):
        # Objects of one image share their errors (pose, annotator), so more than a few add little.
        precision = min(len(found), 6) / REFERENCES[name].sd ** 2
        weight += precision
        total -= precision * float(np.median(found))
    low, high = prior.bounds
    factor = min(max(math.exp(total / weight), low), high)
    anchors: dict[str, int] = {k: len(v) for k, v in sorted(ratios.items())}
    return Calibration(stated_m * factor, factor, weight**-0.5, anchors, factor in (low, high))


def log_ratios(
    camera: CameraSpec, height_m: float, labels: Sequence[Instance], prior: HeightPrior
) -> Iterator[tuple[KnownClass, Instance, float]]:
    """Yield the labels of known size of one image with their classes, and the logarithm of `size_ratio`."""
    for label in labels:
        kind = known_class(label.category)
        if kind is None or kind not in prior.references or label.truncated or label.is_crowd:
            continue
        ratio = size_ratio(camera, ground_z_m(camera, height_m), label.box_xyxy, REFERENCES[kind])
        if ratio is not None:
            yield kind, label, math.log(ratio / prior.box_looseness)


def size_ratio(camera: CameraSpec, ground_m: float, box_xyxy: FloatArray, reference: Reference) -> float | None:
    """Return the ratio of a box's size to that of a reference object at its place; None where it gives no reading.

    The reference is a cuboid on the ground plane, centred on the box, with the heading whose box has the most similar
    proportions. `ground_m` is the ground plane's height in the world.
    """
    x0, y0, x1, y1 = (float(v) for v in box_xyxy)
    w, h = camera.size_wh
    width, height = x1 - x0, y1 - y0
    if min(width, height) < _MIN_SIDE_PX or x0 <= 1 or y0 <= 1 or x1 >= w - 1 or y1 >= h - 1:
        return None
    place = ground_point(camera, (x0 + x1) / 2, (y0 + y1) / 2, ground_m + reference.size_m[2] / 2)
    if place is None:
        return None
    middle = camera.to_camera(place[None])
    sides = expected_sides(middle, camera.world_to_camera, camera.focal_px, reference.corners(shaped=False))
    if np.isnan(sides).any():
        return None
    chosen = sides[0]
    if reference.turns:
        chosen = chosen[alike_headings(sides, np.array([width]), np.array([height]))]
    seen = np.sqrt(chosen[:, 0] * chosen[:, 1]).mean()
    return float(math.sqrt(width * height) / seen)
