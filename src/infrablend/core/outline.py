"""What a picture shows around a box and of its object: levels of the ring, and pixels beyond half of the contrast."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import boxes_mask, pixel_box
from infrablend.core.rle_masks import row_corners

# Width of the ring: half the box's longest side, at least this, px.
MIN_RING_PX = 3
# Rings with fewer free pixels are not measured.
MIN_RING_PIXELS = 12

Levels = NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32]


def ring_window(
    box_xyxy: NDArray[np.float64], shape_hw: tuple[int, ...], min_ring_px: int = MIN_RING_PX
) -> tuple[int, int, int, int]:
    """Return left, top, right and bottom edge of a box and its ring, within the frame."""
    height, width = shape_hw
    left, top, right, bottom = pixel_box(box_xyxy, shape_hw)
    reach = max(min_ring_px, max(right - left, bottom - top) // 2)
    return max(left - reach, 0), max(top - reach, 0), min(right + reach, width), min(bottom + reach, height)


def ring_levels(
    picture: Levels,
    box_xyxy: NDArray[np.float64],
    others: Sequence[NDArray[np.float64]] | NDArray[np.float64] = (),
    min_ring_px: int = MIN_RING_PX,
) -> Levels | None:
    """Return the levels of the free pixels around a box, as in the picture; None for an empty box or too few of them.

    Args:
        picture: (h, w) levels.
        box_xyxy: (4,) box, pixels; taken as its integer hull.
        others: Boxes of other objects, which are left out.
        min_ring_px: Least width of the ring.
    """
    left, top, right, bottom = pixel_box(box_xyxy, picture.shape)
    if left >= right or top >= bottom:
        return None
    window = ring_window(box_xyxy, picture.shape, min_ring_px)
    x0, y0, x1, y1 = window
    ring = ~boxes_mask((box_xyxy, *others), picture.shape, window)
    if np.count_nonzero(ring) < MIN_RING_PIXELS:
        return None
    found: Levels = picture[y0:y1, x0:x1][ring]
    return found


# Least contrast of the peak, in standard deviations of the ring, as estimated by its middle half.
_LEAST_PEAK = 4.0
_STANDARD_PER_QUARTILES = 0.7413


def region_beyond_half(
    picture: Levels,
    box_xyxy: NDArray[np.float64],
    boxes: Iterable[NDArray[np.float64]],
    level: float,
    contrast: float,
) -> NDArray[np.bool_] | None:
    """Return the (h, w) mask, just as large as itself, of an object's pixels beyond half of its contrast.

    Of the connected regions, it is the one that covers most of the box; it may leave the box.

    Args:
        picture: (h, w) levels.
        box_xyxy: (4,) box of the object, pixels.
        boxes: Boxes of all objects; what is in another box but not in this one does not belong to the object.
        level: Level of the surroundings.
        contrast: Level of the object less that of the surroundings.

    Returns:
        The mask; None without any region, or if it runs on into the surroundings.
    """
    left, top, right, bottom = pixel_box(box_xyxy, picture.shape)
    window = ring_window(box_xyxy, picture.shape)
    x0, y0, x1, y1 = window
    beyond = ((picture[y0:y1, x0:x1] - level) / contrast > 0.5).astype(np.uint8)
    foreign = boxes_mask(boxes, picture.shape, window)
    own = (slice(top - y0, bottom - y0), slice(left - x0, right - x0))
    foreign[own] = False
    beyond[foreign] = 0
    _, regions, facts, _ = cv2.connectedComponentsWithStats(beyond, connectivity=8)
    inside = np.bincount(regions[own].ravel(), minlength=len(facts))
    inside[0] = 0
    if not inside.any():
        return None
    number = int(np.argmax(inside))
    x, y, w, h = (int(v) for v in facts[number, :4])
    if x == 0 or y == 0 or x + w == beyond.shape[1] or y + h == beyond.shape[0]:
        return None
    return np.asarray(regions[y : y + h, x : x + w] == number)


@dataclass(frozen=True)
class Body:
    """An object's area above half of its peak.

    Attributes:
        size_px: Longer side of the smallest rectangle, turned, around it; 1 for a single pixel.
        width_px: Shorter side.
        fill: Share of the rectangle that it covers.
        peak: The level in the object's box that differs most from the surroundings, less theirs.
    """

    size_px: float
    width_px: float
    fill: float
    peak: float


def find_body(picture: Levels, box_xyxy: NDArray[np.float64], boxes: Sequence[NDArray[np.float64]]) -> Body | None:
    """Return the body of an object, warmer or colder than the ring around its box.

    Args:
        picture: (h, w) levels of any unit.
        box_xyxy: (4,) box, however loose, pixels.
        boxes: Boxes of all objects.

    Returns:
        The body; None if the peak does not stand out from the ring, if the area runs on into the surroundings or the
        frame's edge, and for boxes outside the picture or without a ring.
    """
    ring = ring_levels(picture, box_xyxy, boxes)
    if ring is None:
        return None
    low, level, high = np.percentile(ring, [25, 50, 75])
    left, top, right, bottom = pixel_box(box_xyxy, picture.shape)
    change = picture[top:bottom, left:right].astype(np.float64) - level
    peak = float(change.flat[np.abs(change).argmax()])
    rounding = 0.0 if picture.dtype.kind == "f" else 12**-0.5
    if peak == 0 or abs(peak) < _LEAST_PEAK * np.hypot(_STANDARD_PER_QUARTILES * (high - low), rounding):
        return None
    region = region_beyond_half(picture, box_xyxy, boxes, float(level), peak)
    if region is None:
        return None
    sides = sorted(cv2.minAreaRect(row_corners(region).astype(np.float32))[1])
    return Body(sides[1], sides[0], float(np.count_nonzero(region)) / (sides[0] * sides[1]), peak)
