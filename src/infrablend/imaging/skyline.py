"""Finds the sky in a thermal picture: which pixels show it, and the row of the horizon.

Sky is the smooth area that reaches the picture's upper edge. Trees, roofs and masts end it with a steep edge towards
warmer levels; clouds change gently. Only the picture is used, so the result can replace an unknown camera pitch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

# Blur before slopes are measured, px, and steepest slope within the sky, 8-bit levels per pixel.
_SMOOTH_PX = 1.2
_STEEPEST = 5.0
# A slope counts as an edge only if it exceeds the noise by this factor.
_OVER_NOISE = 6.0
# The sky ends where the levels rise by at least this much to what is below it, 8-bit levels.
_LEAST_STEP = 12.0
# Columns whose sky ends inside the picture, as a share of all, for a horizon to be found.
_LEAST_COLUMNS = 0.5
# Share of the columns whose sky ends above the horizon: trees, roofs and masts.
_ABOVE_HORIZON = 0.9
_MARGIN_PX = 4


@dataclass(frozen=True, eq=False)
class Skyline:
    """The sky of a picture.

    Attributes:
        sky: (h, w) pixels that show the sky.
        land: (h, w) pixels of the ground and of everything that stands on it: in each column, all below its upper end.
        horizon_px: Row at or below which the ground begins, pixels from the upper edge; None if the sky ends nowhere
            in the picture, or there is no sky.
        step_grey: Median rise of the level from the sky just above the skyline to the land just below it; 0 without a
            horizon. Cameras that enhance local contrast keep it where they lose the contrast of large areas.
    """

    sky: NDArray[np.bool_]
    land: NDArray[np.bool_]
    horizon_px: float | None
    step_grey: float = 0.0


def find_skyline(picture: NDArray[np.float32], scale: float = 1.0) -> Skyline:
    """Find the sky of a picture (h, w) in which hot is bright, with `scale` levels per 8-bit level."""
    height, width = picture.shape
    grey = np.asarray(picture, np.float32) / np.float32(scale)
    soft = cv2.GaussianBlur(grey, (0, 0), _SMOOTH_PX)
    across, down = (cv2.Sobel(soft, cv2.CV_32F, *d, scale=1 / 8) for d in ((1, 0), (0, 1)))
    steep = np.hypot(across, down)
    calm = steep < max(_STEEPEST, _OVER_NOISE * float(np.median(steep[: max(height // 4, 1)])))
    # Seen through branches the sky is in pieces; a small opening keeps them from joining it to the ground.
    calm = cv2.erode(calm.astype(np.uint8), np.ones((3, 3), np.uint8))
    count, parts = cv2.connectedComponents(calm, connectivity=4)
    touching = np.bincount(parts[0], minlength=count)
    touching[0] = 0
    if touching.sum() < 0.3 * width:
        return Skyline(np.zeros(picture.shape, np.bool_), np.ones(picture.shape, np.bool_), None)
    seeds = np.flatnonzero(touching >= 0.05 * width)
    sky = cv2.dilate(np.isin(parts, seeds).astype(np.uint8), np.ones((3, 3), np.uint8)).astype(np.bool_)
    # Ground is what is not sky and reaches the lower edge; clouds, aircraft and text are islands in the sky.
    rest = cv2.connectedComponents((~sky).astype(np.uint8), connectivity=8)[1]
    at_bottom = np.unique(rest[-1])
    ground = np.isin(rest, at_bottom[at_bottom > 0])
    ends = np.where(ground.any(axis=0), np.argmax(ground, axis=0), height)
    inside = ends < height - _MARGIN_PX
    below_end = np.arange(height)[:, None] >= ends[None, :]
    if inside.mean() < _LEAST_COLUMNS:
        # Ground too low in the picture to be measured, or none.
        return Skyline(sky & ~below_end, below_end, None)
    row = float(np.quantile(ends[inside], _ABOVE_HORIZON))
    columns = np.flatnonzero(inside)
    steps = []
    for c in columns[:: max(1, len(columns) // 100)]:
        above = grey[max(ends[c] - 12, 0) : max(ends[c] - 3, 1), c]
        below = grey[ends[c] + 1 : ends[c] + 10, c]
        steps.append(float(np.median(below) - np.median(above)))
    step = float(np.median(steps))
    if step < _LEAST_STEP:
        return Skyline(sky & ~below_end, below_end, None)
    return Skyline(sky & ~below_end, below_end, row, step * scale)


def noise_of(picture: NDArray[np.uint8] | NDArray[np.uint16], scale: float = 1.0) -> float:
    """Return the noise of a picture, 8-bit levels: the robust deviation of neighbouring pixels from each other."""
    steps = np.concatenate(
        [cv2.absdiff(picture[1:], picture[:-1]).ravel(), cv2.absdiff(picture[:, 1:], picture[:, :-1]).ravel()]
    )
    return float(1.4826 * np.median(steps) / scale / math.sqrt(2))
