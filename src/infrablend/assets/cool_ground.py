"""Ground that a standing object keeps the sun off: a translucent sheet around it that takes light from the background.

Paving that loses the sun's rays q, W m^-2, and gives off h per kelvin cools by q / h (1 - exp(x²) erfc(x)) within a
time t, with x = h sqrt(t) / e (half-space of thermal effusivity e; Carslaw and Jaeger). With h = 22 W m^-2 K^-1 and
asphalt's e = 1,500 J m^-2 K^-1 s^-1/2, a quarter of what four hours cool is reached within 3 minutes, half within 16,
and three quarters within an hour. Meanwhile the sun moves on, and only ground close to the object is in the shade all
the time: the sheet is the mean of the shadows of four moments, and soft by construction. Conduction carries the edge
sideways, by sqrt(a t) = 0.1 m in four hours with a = 7e-7 m²/s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infrablend.assets.ground_sheet import hull_of, reach_of
from infrablend.assets.model import PartRange, Range, warm_ground_role
from infrablend.assets.shapes import ring_strips
from infrablend.core.mesh import FloatArray, IntArray

SHADE_RINGS: Mapping[str, float] = {
    "shade_edge": 0.03, "shade_far": 0.25, "shade_mid": 0.5, "shade_near": 0.75, "ground_shadow": 0.95,
}  # fmt: skip
"""Share of the cooling in each ring of the sheet, from outside to inside."""
# Middles of the quarters of the cooling: the moments since which a point has been in the shade, hours.
_AGES_H = (0.01, 0.12, 0.52, 1.94)
# Turn of the sun at 25 to 45 degrees in middle latitudes, clockwise seen from above north of the tropics.
_TURN_RAD_H = math.radians(18.0)
# Distances from a straight edge at which conduction leaves these quarters, metres: 2 sqrt(a t) erfc^-1.
_CONDUCTED_M = (0.16, 0.05, -0.05, -0.16)
_EDGE_M = 0.15
_CORNERS = 32
_EVERY = 4  # of the vertices, which lie close together, decide on the outline
_HIDDEN = 0.8  # the sheet begins well under the object


def shade_roles(delta_t_k: Range, opacity: float = 1.0) -> dict[str, PartRange]:
    """Return the thermal roles of the sheet: what the ground loses in the middle of the shade, kelvin, below 0."""
    what = "ground in the object's shade (half-space)"
    return {part: warm_ground_role("asphalt", delta_t_k, what, opacity * share) for part, share in SHADE_RINGS.items()}


def shade_sheet(vertices: FloatArray, shift_xy: ArrayLike) -> tuple[FloatArray, IntArray, NDArray[np.intp]]:
    """Return vertices (V, 3), metres, and triangles (T, 3) of the sheet, and the number in `SHADE_RINGS` of each.

    Args:
        vertices: (N, 3) of the object around its origin, on the ground.
        shift_xy: Shift of the shadow now per metre of height; earlier ones were further counter-clockwise.
    """
    vertices = vertices[::_EVERY]
    around = np.linspace(0.0, 2 * np.pi, _CORNERS, endpoint=False)
    shift = complex(*np.asarray(shift_xy, np.float64))
    earlier = [shift * np.exp(1j * _TURN_RAD_H * age_h) for age_h in _AGES_H]
    radius = np.stack(
        [_radius(vertices[:, :2] + vertices[:, 2:] * (s.real, s.imag), vertices, around) for s in earlier]
    )
    radius = -np.sort(-radius, axis=0) + np.array(_CONDUCTED_M)[:, None]
    inner = _HIDDEN * np.minimum(_radius(vertices[:, :2], vertices, around), radius[-1])
    loops = np.concatenate([radius[:1] + _EDGE_M, radius, inner[None]])[::-1]
    flat = loops.ravel()[:, None] * np.tile(np.stack([np.cos(around), np.sin(around)], axis=1), (len(loops), 1))
    triangles = ring_strips(_CORNERS, len(loops)).astype(np.int32)
    number = np.repeat(np.arange(len(SHADE_RINGS))[::-1], 2 * _CORNERS)
    return np.concatenate([flat, np.full((len(flat), 1), 0.005)], axis=1), triangles, number


def _radius(points: FloatArray, vertices: FloatArray, around: FloatArray) -> FloatArray:
    """Return how far the hull of points and of the object from above reaches in each direction from the origin."""
    return reach_of(hull_of(np.concatenate([points, vertices[:, :2]])), np.zeros(2), around)
