"""Rings around boxes: the surroundings that an object's levels are compared with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import boxes_mask, pixel_box

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
