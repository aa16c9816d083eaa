"""What objects do to the picture around them: levels and changes by distance from the box, real and inserted alike."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import boxes_mask, pixel_box
from infrablend.core.mesh import FloatArray
from infrablend.realism.features import Picture

BANDS_PX = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 24)
"""Outer distance of each band around a box; the first begins at the box."""
_FAR_PX = (14, 22)  # ground to compare with
_GAP_PX = 6  # around other boxes
_MOST_CLUTTER = 8.0
_LEAST_CONTRAST = 30.0
_LEAST_SIDE_PX = 8
_LEAST_PIXELS = 9


def distance_px(shape_hw: tuple[int, ...], boxes_xyxy: Sequence[FloatArray]) -> NDArray[np.float32]:
    """Return the (h, w) distance of each pixel from the nearest box: that of rows or columns, 0 inside."""
    outside = ~boxes_mask(boxes_xyxy, shape_hw)
    return np.asarray(cv2.distanceTransform(outside.astype(np.uint8), cv2.DIST_C, 3), np.float32)


def largest_changes(before: Picture, after: Picture, boxes_xyxy: Sequence[FloatArray]) -> FloatArray:
    """Return the largest absolute change in each of `BANDS_PX` around the boxes, and beyond the last one.

    Args:
        before: (h, w) background, 8-bit levels.
        after: (h, w) the same with inserted objects.
        boxes_xyxy: Exact boxes of the inserted objects, at least one.

    Returns:
        (12,) levels; 0 for a band outside the picture.
    """
    away, change = distance_px(before.shape, boxes_xyxy), np.abs(after - before)
    bands = pairwise([0, *BANDS_PX, np.inf])
    return np.array([float(change[(away > a) & (away <= b)].max(initial=0.0)) for a, b in bands])


def levels_around(
    picture: Picture, box_xyxy: FloatArray, others_xyxy: Sequence[FloatArray]
) -> tuple[float, FloatArray] | None:
    """Measure the level around an object against the ground further away.

    Distances count from the pixels of the box that differ from the ground by 30 % of the object's contrast, because
    hand-drawn boxes are loose.

    Args:
        picture: (h, w) 8-bit levels.
        box_xyxy: Box of the object.
        others_xyxy: Boxes of the other objects.

    Returns:
        Contrast of the object (5 or 95 % quantile of its box against the ground), and (11,) median level minus that of
        the ground in each of `BANDS_PX`, NaN where there is none. None if the object is small, faint, near the frame's
        edge or on uneven ground.
    """
    reach = _FAR_PX[1] + 1
    x0, y0, x1, y1 = pixel_box(box_xyxy, picture.shape)
    height, width = picture.shape
    if min(x0, y0) < reach or x1 > width - reach or y1 > height - reach or max(x1 - x0, y1 - y0) < _LEAST_SIDE_PX:
        return None
    part = (slice(y0 - reach, y1 + reach), slice(x0 - reach, x1 + reach))
    window, inside = picture[part], np.zeros(picture.shape, np.bool_)
    inside[y0:y1, x0:x1] = True
    inside = inside[part]
    free = distance_px(picture.shape, others_xyxy)[part] > _GAP_PX if others_xyxy else np.ones_like(inside)
    away = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, 5)
    ground = window[(away > _FAR_PX[0]) & (away <= _FAR_PX[1]) & free]
    if ground.size < 200 or ground.std() > _MOST_CLUTTER:
        return None
    level = float(np.median(ground))
    low, high = (float(v) - level for v in np.percentile(window[inside], [5, 95]))
    contrast = high if high >= -low else low
    if abs(contrast) < _LEAST_CONTRAST:
        return None
    seen = inside & (np.abs(window - level) > 0.3 * abs(contrast))
    away = cv2.distanceTransform((~seen).astype(np.uint8), cv2.DIST_L2, 5)
    found = []
    for a, b in pairwise([0, *BANDS_PX]):
        band = window[(away > a) & (away <= b) & free]
        found.append(float(np.median(band)) - level if band.size >= _LEAST_PIXELS else np.nan)
    return contrast, np.array(found)
