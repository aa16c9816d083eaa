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

# A pixel is visible if it differs from the ground by this many 8-bit levels, or by this share of the object's contrast
# where that is less; after a blur that keeps grain out, px.
_LEAST_GREY = 15.0
_LEAST_SHARE = 0.3
_SMOOTHING_PX = 0.7
# Spots with a smaller share of the visible pixels are not part of it.
_LEAST_SPOT = 0.1
# A side of the box moves only if at least this much of the object is invisible there, px: masks are of whole pixels.
_LEAST_PX = 1.0


def add_seen_box(
    label: Instance, picture: NDArray[np.generic], ring_grey: float, change_grey: float, unit: float = 1.0
) -> Instance:
    """Add the boxes around the visible part of an object to `extra`; `box_xyxy` and `corners_xy` stay exact.

    Args:
        label: Label with a mask.
        picture: (h, w) finished picture.
        ring_grey: Level of the surroundings, 8-bit levels.
        change_grey: Contrast of the object, 8-bit levels.
        unit: Levels of the picture per 8-bit level.

    Returns:
        The label; unchanged if no pixel of the mask is visible.
    """
    assert label.mask is not None
    mask = label.mask.to_array()
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    crop = (slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1))
    smooth = cv2.GaussianBlur(picture[crop].astype(np.float32) / np.float32(unit), (0, 0), _SMOOTHING_PX)
    seen = _large_spots(mask[crop] & (np.abs(smooth - ring_grey) > min(_LEAST_GREY, _LEAST_SHARE * change_grey)))
    if not seen.any():
        return label
    offset = np.array([columns[0], rows[0]], np.float64)
    seen_xy, mask_xy = (_pixel_corners(m) + offset for m in (seen, mask[crop]))
    x0, y0, x1, y1 = box_of_points(_cut(corners_of_box(label.box_xyxy), seen_xy, mask_xy))
    extra = {**label.extra, SEEN_BOX: [float(v) for v in (x0, y0, x1 - x0, y1 - y0)]}
    if label.corners_xy is not None:
        extra[SEEN_OBB] = [float(v) for v in _cut(label.corners_xy, seen_xy, mask_xy).ravel()]
    return replace(label, extra=extra)


def _large_spots(seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the mask without its small connected regions."""
    _, names, facts, _ = cv2.connectedComponentsWithStats(seen.astype(np.uint8), connectivity=8)
    large = facts[:, cv2.CC_STAT_AREA] >= _LEAST_SPOT * np.count_nonzero(seen)
    large[0] = False
    return np.asarray(large[names])


def _pixel_corners(mask: NDArray[np.bool_]) -> FloatArray:
    """Return (n, 2) corners of a mask's pixels: those at both ends of each row."""
    rows = np.flatnonzero(mask.any(axis=1))
    first, last = mask[rows].argmax(axis=1), mask.shape[1] - mask[rows, ::-1].argmax(axis=1)
    ends = [np.stack([x, y], axis=1) for x in (first, last) for y in (rows, rows + 1)]
    return np.asarray(np.concatenate(ends), np.float64)


def _cut(corners_xy: FloatArray, seen_xy: FloatArray, mask_xy: FloatArray) -> FloatArray:
    """Return a rectangle (4, 2) whose sides have moved to what is visible, where the object goes on beyond that.

    Args:
        corners_xy: (4, 2) exact rectangle.
        seen_xy: (n, 2) corners of the visible pixels.
        mask_xy: (m, 2) corners of the mask's pixels.
    """
    ends = []
    for k in (1, 3):
        along = corners_xy[k] - corners_xy[0]
        length = float(np.hypot(*along))
        if length <= 0:
            return corners_xy
        seen, whole = ((xy - corners_xy[0]) @ along / length for xy in (seen_xy, mask_xy))
        low = float(seen.min()) if seen.min() - whole.min() >= _LEAST_PX else 0.0
        high = float(seen.max()) if whole.max() - seen.max() >= _LEAST_PX else length
        low, high = min(max(low, 0.0), length), min(max(high, 0.0), length)
        ends.append((along / length * low, along / length * high))
    (low_u, high_u), (low_v, high_v) = ends
    return np.asarray(corners_xy[0] + np.array([low_u + low_v, high_u + low_v, high_u + high_v, low_u + high_v]))
