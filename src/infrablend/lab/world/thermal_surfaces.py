"""Thermal surfaces: triangles with a temperature and a reflectance each, from which all bodies are built.

The builders (`vehicle`, `person`, `cycle`, `tree_prototype`, `building`, `furniture`) are pure functions: each turns an
entry of the plan into a `Surface` in the object's own frame (origin on the ground, +X its heading). Detail is modelled
where it shows at a few pixels per metre: glass against paint, bonnet, wheels; head and hands against clothes; gaps in a
crown.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infrablend.assets import shapes
from infrablend.assets.shapes import Solid
from infrablend.core.mesh import FloatArray, IntArray

# Share of the sky's radiance that a surface mirrors at normal incidence: 1 - emissivity in 8-14 um.
PAINT = 0.07
GLASS = 0.13
RUBBER = 0.06
CLOTH = 0.03
SKIN = 0.02
WALL = 0.06
ROOF = 0.08
LEAF = 0.02
METAL = 0.10


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles with the thermal values that the shader reads from each.

    Attributes:
        vertices_m: (V, 3) float64.
        triangles: (T, 3) int32.
        kelvin: (T,) float32 temperature.
        mirror: (T,) float32 reflectance at normal incidence.
        solar_k: (T,) float32 heating by sun at normal incidence.
        grain_k: (T,) float32 amplitude of the fine pattern.
    """

    vertices_m: FloatArray
    triangles: IntArray
    kelvin: NDArray[np.float32]
    mirror: NDArray[np.float32]
    solar_k: NDArray[np.float32]
    grain_k: NDArray[np.float32]


@dataclass
class SurfaceBuilder:
    """Collector of solids for one surface."""

    vertices: list[FloatArray] = field(default_factory=list)
    triangles: list[IntArray] = field(default_factory=list)
    values: list[NDArray[np.float32]] = field(default_factory=list)
    count: int = 0

    def add(
        self, solid: Solid, kelvin: ArrayLike, mirror: ArrayLike, solar_k: ArrayLike = 0.0, grain_k: ArrayLike = 0.2
    ) -> None:
        """Add a solid; values are as in `Surface`, either one number for the solid or one per triangle."""
        n = len(solid.triangles)
        self.vertices.append(solid.vertices)
        self.triangles.append(solid.triangles + np.int32(self.count))
        self.values.append(
            np.stack(
                [np.broadcast_to(np.asarray(v, np.float32), (n,)) for v in (kelvin, mirror, solar_k, grain_k)], axis=1
            )
        )
        self.count += len(solid.vertices)

    def box(
        self, size_m: ArrayLike, bevel_m: float, at_m: ArrayLike, kelvin: float, mirror: float, solar_k: float = 0.0,
        grain_k: float = 0.2, corner: float | None = None,
    ) -> None:  # fmt: skip
        """Add a bevelled box with its middle at a point, see `shapes.box`."""
        self.add(shapes.moved(shapes.box(size_m, bevel_m, corner=corner), at_m), kelvin, mirror, solar_k, grain_k)

    def bar(
        self, a_m: ArrayLike, b_m: ArrayLike, radii_m: float | tuple[float, float], kelvin: float, mirror: float,
        solar_k: float = 0.0, grain_k: float = 0.2, n: int = 6,
    ) -> None:  # fmt: skip
        """Add a round bar between two points, of one radius or with one for each end, see `shapes.capsule`."""
        radius_a, radius_b = radii_m if isinstance(radii_m, tuple) else (radii_m, radii_m)
        self.add(shapes.capsule(a_m, b_m, radius_a, radius_b, n), kelvin, mirror, solar_k, grain_k)

    def surface(self) -> Surface:
        """Return everything added so far as one surface."""
        v = np.concatenate(self.values)
        return Surface(
            np.concatenate(self.vertices),
            np.concatenate(self.triangles).astype(np.int32),
            *(np.ascontiguousarray(v[:, k]) for k in range(4)),
        )


def quad(a: ArrayLike, b: ArrayLike, c: ArrayLike, d: ArrayLike) -> Solid:
    """Return a four-sided face."""
    return Solid(np.array([a, b, c, d], np.float64), np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def triangle_centres(solid: Solid) -> FloatArray:
    """Return the (T, 3) centres of a solid's triangles."""
    return np.asarray(solid.vertices[solid.triangles].mean(axis=1))


def placed(s: Surface, x_m: float, y_m: float, heading_rad: float) -> FloatArray:
    """Return the (V, 3) vertices of a surface, turned and moved to its place."""
    return np.asarray(s.vertices_m @ shapes.turn_z(heading_rad).T + (x_m, y_m, 0.0))
