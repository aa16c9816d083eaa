"""Finds black margins: regions at the edge where the camera saw nothing, as undistortion and rotation leave them.

A margin has exactly one level of nearly 0, runs along the picture's edge and ends sharply; only a narrow rim shows
traces of the codec. Cold skies, roads and dark corners that a camera shows as 0 have noise, or fade into their
surroundings.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import pixel_box
from infrablend.core.mesh import FloatArray

# Highest level of a margin, and of its rim, 8-bit levels; width of the rim and of the windows without texture, px.
_INSIDE = 2.0
_RIM = 8.0
_RIM_PX = 8
_WINDOW_PX = 5
# Of the pixels beyond the rim of a margin, at most this share is as dark as the rim, within this distance, px.
_MOST_DARK = 0.4
_BEYOND_PX = 8
# Least length along the picture's edge, as a share of the shorter side.
_LEAST_EDGE = 0.2
# Least share of the picture for one region to be a margin, and for further ones beside it. Smaller corners of real
# scenes are as even.
_LEAST = 0.01
_LEAST_FURTHER = 0.0005
# Objects keep this far away: interpolation and the codec mix both sides of the border, px.
_APART_PX = 4


def find_margin(picture: NDArray[np.uint8] | NDArray[np.uint16], scale: float = 1.0) -> NDArray[np.bool_] | None:
    """Return the (h, w) mask of a picture's margins and the pixels next to them; None if it has none.

    `scale` is the number of levels of the picture (h, w) per 8-bit level.
    """
    if _at_edge(picture).min() > _INSIDE * scale:
        return None
    window = np.ones((_WINDOW_PX, _WINDOW_PX), np.uint8)
    highest = cv2.dilate(picture, window)
    even = (highest <= _INSIDE * scale) & (highest == cv2.erode(picture, window))
    _, parts, found, _ = cv2.connectedComponentsWithStats(even.astype(np.uint8), connectivity=4)
    along = np.bincount(_at_edge(parts), minlength=len(found))
    along[0] = 0
    dark = picture <= _RIM * scale
    margin = np.zeros(picture.shape, np.bool_)
    largest = 0.0
    for k in np.flatnonzero(along >= _LEAST_EDGE * min(picture.shape)):
        share = found[k, cv2.CC_STAT_AREA] / picture.size
        if share < _LEAST_FURTHER:
            continue
        rim = _grown(parts == k, _RIM_PX)
        beyond = _grown(rim, _BEYOND_PX) & ~rim
        # A picture of nothing has nothing beyond that a margin could be told from.
        if beyond.any() and dark[beyond].mean() <= _MOST_DARK:
            margin |= rim & dark
            largest = max(largest, share)
    if largest < _LEAST:
        return None
    return _grown(margin | _thin_ends(margin, dark), _APART_PX)


def _thin_ends(margin: NDArray[np.bool_], dark: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the dark pixels that continue a margin along the picture's edge, where it is too thin for a window."""
    strip = np.ones(margin.shape, np.bool_)
    strip[_RIM_PX:-_RIM_PX, _RIM_PX:-_RIM_PX] = False
    _, parts = cv2.connectedComponents((strip & dark).astype(np.uint8), connectivity=4)
    return np.isin(parts, np.setdiff1d(parts[margin], 0))


def on_margin(margin: NDArray[np.bool_] | None, box_xyxy: FloatArray | None) -> bool:
    """Return whether a (4,) box covers any pixel of a margin, as `find_margin` returns it."""
    if margin is None or box_xyxy is None:
        return False
    left, top, right, bottom = pixel_box(box_xyxy, margin.shape)
    return bool(margin[top:bottom, left:right].any())


def _at_edge(values: NDArray[np.generic]) -> NDArray[np.generic]:
    return np.concatenate([values[0], values[-1], values[1:-1, 0], values[1:-1, -1]])


def _grown(mask: NDArray[np.bool_], by_px: int) -> NDArray[np.bool_]:
    size = 2 * by_px + 1
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((size, size), np.uint8)), np.bool_)
