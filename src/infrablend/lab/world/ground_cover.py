"""What lies on the ground: materials, patches, and roads with coordinates along and across them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.core.mesh import FloatArray
from infrablend.core.surface_kinds import SurfaceKind
from infrablend.lab.world.setting import Draws, Weather


@dataclass(frozen=True)
class GroundMaterial:
    """A kind of ground: temperature, and the pattern on it (amplitude in kelvin, size of its grain in metres)."""

    name: str
    kelvin: float
    stain_k: float
    grain_k: float
    grain_m: float


# Half width of the narrowest road for cars.
_ROAD_M = 2.4

GROUND_KINDS: dict[str, SurfaceKind] = {
    "asphalt": "road",
    "concrete": "path",
    "paving": "path",
    "court": "path",
    "grass": "grass",
    "soil": "soil",
    "bed": "soil",
    "water": "water",
}
"""Kind of surface of each material; a road's carriageway is a `road`, and a `track` if it is of soil."""


@dataclass(frozen=True)
class Patch:
    """Flat patch on the ground.

    Attributes:
        shape: `rect` and `ellipse` fill length x width; `ring` is a circle line of diameter `length_m`.
        material: Material of the patch; None adds `amount_k` to the temperature of the ground below.
        amount_k: Temperature to add, also to that of the material.
        soft_m: Width of the soft edge.
        line_m: Line width of a ring.
    """

    shape: Literal["rect", "ellipse", "ring"]
    x_m: float
    y_m: float
    heading_rad: float
    length_m: float
    width_m: float
    material: str | None = None
    amount_k: float = 0.0
    soft_m: float = 0.05
    line_m: float = 0.0


def draw_materials(draws: Draws, weather: Weather) -> tuple[GroundMaterial, ...]:
    """Draw the temperature of every ground material of a scene."""
    if weather.night:
        c = weather.clear_sky
        table = {
            "asphalt": (3.6, 0.55, 0.28, 0.5),
            "concrete": (4.4, 0.5, 0.25, 0.4),
            "paving": (3.4, 0.5, 0.35, 0.35),
            "court": (1.6, 0.4, 0.22, 0.5),
            "grass": (-1.6 - 3.2 * c, 0.75, 0.4, 0.5),
            "soil": (-0.4, 0.7, 0.6, 0.7),
            "bed": (-3.2 - 2.5 * c, 0.6, 0.8, 0.4),
        }
    else:
        s = weather.solar
        table = {
            "asphalt": (10.0 * s, 1.1, 0.5, 0.6),
            "concrete": (8.5 * s, 1.0, 0.5, 0.5),
            "paving": (8.0 * s, 1.1, 0.7, 0.4),
            "court": (10.0 * s, 1.1, 0.4, 0.6),
            "grass": (3.5 * s, 1.3, 0.9, 0.4),
            "soil": (8.0 * s, 1.5, 1.0, 0.6),
            "bed": (2.5 * s, 1.2, 1.2, 0.4),
        }
    # Hard grounds differ more from place to place than grass does.
    spread = {"paving": 1.5, "concrete": 1.2, "court": 1.5} if weather.night else {"paving": 3.5, "court": 2.5}
    rest = 0.5 if weather.night else 1.5
    return tuple(
        GroundMaterial(n, weather.air_k + dt + draws.uniform(-1, 1) * spread.get(n, rest), stain, grain, size)
        for n, (dt, stain, grain, size) in table.items()
    )


def draw_water(draws: Draws, weather: Weather) -> GroundMaterial:
    """Draw the temperature of water: slow to cool by night and to warm by day, and even."""
    kelvin = weather.air_k + (draws.uniform(-2, 7) if weather.night else draws.uniform(-6, 3))
    return GroundMaterial("water", kelvin, 0.2, 0.06, 1.5)


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

    @property
    def kind(self) -> SurfaceKind:
        """Kind of surface of its carriageway."""
        if self.surface == "soil":
            return "track"
        return "road" if self.half_width_m >= _ROAD_M else "path"

    def along(self, x_m: NDArray[np.floating[Any]], y_m: NDArray[np.floating[Any]]) -> tuple[FloatArray, FloatArray]:
        """Return the arc length of ground points and their offset to the left of the centre line, in metres."""
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        dx, dy = x_m - self.x_m, y_m - self.y_m
        forward = dx * c + dy * s
        left = dy * c - dx * s
        k = self.curvature_per_m
        if abs(k) < 1e-6:
            return np.asarray(forward), np.asarray(left)
        radius = 1 / abs(k)
        sign = math.copysign(1.0, k)
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
            forward = along_m
            left = left_m
            turn = 0.0
        else:
            turn = k * along_m
            forward = math.sin(turn) * (1 / k - left_m)
            left = 1 / k - math.cos(turn) * (1 / k - left_m)
        c, s = math.cos(h), math.sin(h)
        return self.x_m + forward * c - left * s, self.y_m + forward * s + left * c, h + turn
