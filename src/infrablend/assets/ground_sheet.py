"""Outline of an object on the ground, around which sheets of warm or cool ground lie."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike

from infrablend.core.mesh import FloatArray


def hull_of(points_xy: ArrayLike) -> FloatArray:
    """Return the (k, 2) corners of the convex hull of (n, 2) points."""
    return np.asarray(cv2.convexHull(np.asarray(points_xy, np.float32))[:, 0], np.float64)


def reach_of(hull_xy: FloatArray, centre_xy: FloatArray, around_rad: FloatArray) -> FloatArray:
    """Return (n,) distances from a point inside a convex hull to its edge, in directions counter-clockwise from +X."""
    # Many points along each edge, whose distance from the centre is then known in every direction.
    t = np.linspace(0.0, 1.0, 16, endpoint=False)[None, :, None]
    edge = ((1 - t) * hull_xy[:, None] + t * np.roll(hull_xy, -1, axis=0)[:, None]).reshape(-1, 2) - centre_xy
    return np.asarray(np.interp(around_rad, np.arctan2(edge[:, 1], edge[:, 0]), np.hypot(*edge.T), period=2 * np.pi))
