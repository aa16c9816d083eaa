"""Roads: circular arcs with coordinates along and across them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.mesh import FloatArray


@dataclass(frozen=True)
class Road:
    """Road along a circular arc through (x, y) with a given heading there; curvature 0 is a straight line."""

    x_m: float
    y_m: float
    heading_rad: float
    curvature_per_m: float
    half_width_m: float
    pavement_m: float
    lanes: int
    surface: str
    markings: bool

    def along(self, x_m: NDArray[np.floating[Any]], y_m: NDArray[np.floating[Any]]) -> tuple[FloatArray, FloatArray]:
        """Return the arc length of ground points and their offset to the left of the centre line, in metres."""
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        dx, dy = x_m - self.x_m, y_m - self.y_m
        forward, left = dx * c + dy * s, dy * c - dx * s
        k = self.curvature_per_m
        if abs(k) < 1e-6:
            return np.asarray(forward), np.asarray(left)
        radius, sign = 1 / abs(k), math.copysign(1.0, k)
        # Seen from the arc's centre, which lies at `sign * radius` to the left.
        inward = radius - sign * left
        return np.asarray(radius * np.arctan2(forward, inward)), np.asarray(sign * (radius - np.hypot(forward, inward)))

    def offset_m(self, x_m: float, y_m: float) -> float:
        """Return the distance of a point from the centre line."""
        return abs(float(self.along(np.asarray(x_m), np.asarray(y_m))[1]))

    def at(self, along_m: float, left_m: float) -> tuple[float, float, float]:
        """Return x, y and the heading of the road at an arc length and an offset to the left."""
        k, h = self.curvature_per_m, self.heading_rad
        if abs(k) < 1e-6:
            forward, left, turn = along_m, left_m, 0.0
        else:
            turn = k * along_m
            forward = math.sin(turn) * (1 / k - left_m)
            left = 1 / k - math.cos(turn) * (1 / k - left_m)
        c, s = math.cos(h), math.sin(h)
        return self.x_m + forward * c - left * s, self.y_m + forward * s + left * c, h + turn
