"""Roll and pitch of a camera from upright lines: edges of buildings, poles and door frames.

In the middle of a picture upright lines lean by the camera's roll. Those beside it converge: they lean by the tangent
of the pitch over the focal length for each pixel to the side.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

_SMOOTH_PX = 1.0
_LEAST_PX = 12.0
_MOST_LEAN = np.radians(15.0)
# Fewer lines tell nothing.
_LEAST_LINES = 20
_LEAST_SCATTER = np.radians(0.5)
_ROUNDS = 20


@dataclass(frozen=True)
class UprightLines:
    """How upright lines lean.

    Attributes:
        roll_rad: Roll of the camera.
        pitch_per_px: Tangent of its pitch, over the focal length in pixels.
        count: Number of lines.
    """

    roll_rad: float
    pitch_per_px: float
    count: int


def find_upright_lines(picture: NDArray[np.uint8]) -> UprightLines | None:
    """Return how the upright lines of a picture (h, w) lean; None if there are few."""
    found = cv2.createLineSegmentDetector().detect(cv2.GaussianBlur(picture, (0, 0), _SMOOTH_PX))[0]
    if found is None:
        return None
    ends = np.asarray(found, np.float64).reshape(-1, 2, 2)
    along = ends[:, 1] - ends[:, 0]
    lean = np.arctan2(along[:, 0], along[:, 1])
    lean = (lean + np.pi / 2) % np.pi - np.pi / 2
    length = np.hypot(along[:, 0], along[:, 1])
    kept = (np.abs(lean) < _MOST_LEAN) & (length >= _LEAST_PX)
    if kept.sum() < _LEAST_LINES:
        return None
    lean = lean[kept]
    terms = np.column_stack([np.ones(len(lean)), ends[kept, :, 0].mean(axis=1) - picture.shape[1] / 2])
    solved = np.array([np.median(lean), 0.0])
    for _ in range(_ROUNDS):
        away = lean - terms @ solved
        scatter = max(float(np.median(np.abs(away))), _LEAST_SCATTER)
        weight = length[kept] / (1 + (away / scatter) ** 2)
        solved = np.linalg.solve((terms.T * weight) @ terms, (terms.T * weight) @ lean)
    return UprightLines(float(solved[0]), float(-solved[1]), len(lean))
