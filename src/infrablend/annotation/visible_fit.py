"""Fits boxes to the visible part of an object: people draw boxes around what they see.

Part of an object may have the level of the ground, as the sides of cars by night. A drawn box leaves it out; the box of
a render includes it.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import box_of_points, corners_of_box
from infrablend.core.dataset import SEEN_BOX, SEEN_OBB, Instance
from infrablend.core.mesh import FloatArray
from infrablend.core.rle_masks import row_corners

# A pixel is visible if the insertion changed it, or if it differs from the surroundings, by this many 8-bit levels, or
# by this share of the object's contrast where that is less; after a blur that keeps grain out, px.
_LEAST_GREY = 15.0
_LEAST_SHARE = 0.3
_SMOOTHING_PX = 0.7
# Visible spots with a smaller share of the connected piece of the mask that they are in do not count.
_LEAST_SPOT = 0.1
# A side of the box moves only if the mask reaches it and at least this much of the object is invisible there, px: masks
# are of whole pixels.
_LEAST_PX = 1.0


def add_seen_box(
    label: Instance,
    after: NDArray[np.generic],
    before: NDArray[np.generic],
    change_grey: float,
    ring_grey: float | None = None,
    unit: float = 1.0,
) -> Instance:
    """Add the boxes around the visible part of an object to `extra`; `box_xyxy` and `corners_xy` stay exact.

    Args:
        label: Label with a mask.
        after: (h, w) finished picture.
        before: (h, w) background.
        change_grey: Contrast of the object, 8-bit levels.
        ring_grey: Level of the surroundings, 8-bit levels; None if it cannot be measured.
        unit: Levels of the pictures per 8-bit level.

    Returns:
        The label; unchanged if no side moves, or if no pixel of the mask is visible.
    """
    assert label.mask is not None
    mask = label.mask.to_array()
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    crop = (slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1))
    finished, ground = (_smooth(p[crop], unit) for p in (after, before))
    least = min(_LEAST_GREY, _LEAST_SHARE * change_grey)
    visible = np.abs(finished - ground) > least
    if ring_grey is not None:
        visible |= np.abs(finished - ring_grey) > least
    seen = _large_spots(mask[crop] & visible, mask[crop])
    if not seen.any():
        return label
    offset = np.array([columns[0], rows[0]], np.float64)
    seen_xy, mask_xy = (row_corners(m) + offset for m in (seen, mask[crop]))
    box = _cut(corners_of_box(label.box_xyxy), seen_xy, mask_xy)
    corners = None if label.corners_xy is None else _cut(label.corners_xy, seen_xy, mask_xy)
    if box is None and corners is None:
        return label
    x0, y0, x1, y1 = label.box_xyxy if box is None else box_of_points(box)
    extra = {**label.extra, SEEN_BOX: [float(v) for v in (x0, y0, x1 - x0, y1 - y0)]}
    if label.corners_xy is not None:
        extra[SEEN_OBB] = [float(v) for v in (label.corners_xy if corners is None else corners).ravel()]
    return replace(label, extra=extra)


def _smooth(picture: NDArray[np.generic], unit: float) -> NDArray[np.float32]:
    grey = picture.astype(np.float32) / np.float32(unit)
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), _SMOOTHING_PX), np.float32)


def _large_spots(seen: NDArray[np.bool_], mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the visible pixels without the connected spots that are small within their piece of the mask."""
    _, spots, facts, _ = cv2.connectedComponentsWithStats(seen.astype(np.uint8), connectivity=8)
    _, pieces, of_pieces, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    areas = facts[:, cv2.CC_STAT_AREA]
    piece = np.zeros(len(facts), np.intp)
    piece[spots[seen]] = pieces[seen]
    large = areas >= _LEAST_SPOT * of_pieces[piece, cv2.CC_STAT_AREA]
    if len(areas) > 1:
        large[1 + int(areas[1:].argmax())] = True
    large[0] = False
    return np.asarray(large[spots])


def _cut(corners_xy: FloatArray, seen_xy: FloatArray, mask_xy: FloatArray) -> FloatArray | None:
    """Return a rectangle (4, 2) with the sides moved to what is visible; None if no side moves.

    Args:
        corners_xy: (4, 2) exact rectangle.
        seen_xy: (n, 2) corners of the visible pixels.
        mask_xy: (m, 2) corners of the mask's pixels.
    """
    ends = []
    moved = False
    for k in (1, 3):
        along = corners_xy[k] - corners_xy[0]
        length = float(np.hypot(*along))
        if length <= 0:
            return None
        seen, whole = ((xy - corners_xy[0]) @ along / length for xy in (seen_xy, mask_xy))
        low, high = 0.0, length
        # A mask that ends far from the side is that of an object with something in front: its box stays whole there.
        if whole.min() <= _LEAST_PX <= seen.min() - whole.min():
            low = min(max(float(seen.min()), 0.0), length)
            moved = True
        if length - whole.max() <= _LEAST_PX <= whole.max() - seen.max():
            high = min(max(float(seen.max()), 0.0), length)
            moved = True
        ends.append((along / length * low, along / length * high))
    (low_u, high_u), (low_v, high_v) = ends
    if not moved:
        return None
    return np.asarray(corners_xy[0] + np.array([low_u + low_v, high_u + low_v, high_u + high_v, low_u + high_v]))
