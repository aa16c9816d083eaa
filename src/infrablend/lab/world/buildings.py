"""Buildings: their roofs, windows and temperatures, and their bodies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from infrablend.assets.shapes import Solid
from infrablend.core.mesh import FloatArray
from infrablend.lab.world.setting import Draws, Weather
from infrablend.lab.world.thermal_surfaces import GLASS, PAINT, ROOF, WALL, Surface, SurfaceBuilder, quad

RoofKind = Literal["flat", "gable", "arrays"]
# All entries equally likely.
ROOFS: tuple[RoofKind, ...] = ("flat", "flat", "gable", "arrays")


@dataclass(frozen=True)
class Building:
    """A block with windows; `seed` fixes the pattern of its windows and what stands on the roof."""

    x_m: float
    y_m: float
    heading_rad: float
    length_m: float
    width_m: float
    height_m: float
    roof: RoofKind
    roof_k: float
    wall_k: float
    window_k: float
    lit_share: float
    solar_k: float
    seed: int


def draw_building(
    draws: Draws, weather: Weather, x: float, y: float, heading: float, size_m: tuple[float, float, float]
) -> Building:
    """Draw a building of a given (length, width, height): its roof, windows and temperatures."""
    u, a = draws.uniform, weather.air_k
    length, width, height = size_m
    if weather.night:
        roof = a - 1.5 - 4.0 * weather.clear_sky + u(-1, 1)
        wall = a + u(0.8, 3.2)
        window = a + u(-1.5, 3.0)
        solar = 0.0
    else:
        roof = a + u(2, 8)
        wall = a + u(2, 5)
        window = a + u(0, 4)
        solar = weather.solar * u(7, 18)
    kind = "gable" if height < 5 and draws.chance(0.5) else draws.one_of(ROOFS)
    lit_share = u(0.0, 0.35) if weather.night else 0.0
    return Building(
        x, y, heading, length, width, height, kind, roof, wall, window, lit_share, solar, draws.integer(2**31)
    )


def building(b: Building) -> Surface:
    """Return a building about its own centre, length along +X."""
    rng = np.random.Generator(np.random.PCG64(b.seed))
    p = SurfaceBuilder()
    hx, hy, z = b.length_m / 2, b.width_m / 2, b.height_m
    corners = [(-hx, -hy), (hx, -hy), (hx, hy), (-hx, hy)]
    for k in range(4):
        (ax, ay), (bx, by) = corners[k], corners[(k + 1) % 4]
        p.add(quad((ax, ay, 0), (bx, by, 0), (bx, by, z), (ax, ay, z)), b.wall_k, WALL, b.solar_k, 0.4)
        _windows(p, b, rng, np.array([ax, ay]), np.array([bx, by]))
    if b.roof == "gable":
        _gable(p, b)
        return p.surface()
    p.add(_level(-hx, hx, hy, z - 0.1), b.roof_k, ROOF, b.solar_k, 0.5)
    # Parapet: concrete that keeps warmer than the felt.
    for x, y, lx, ly in (
        (0, -hy, 2 * hx + 0.4, 0.35),
        (0, hy, 2 * hx + 0.4, 0.35),
        (-hx, 0, 0.35, 2 * hy),
        (hx, 0, 0.35, 2 * hy),
    ):
        p.box((lx, ly, 0.75), 0.02, (x, y, z + 0.2), 0.5 * (b.wall_k + b.roof_k), WALL, b.solar_k, 0.3)
    for x in np.arange(-hx + 1.2, hx - 0.5, float(rng.uniform(1.8, 3.2))):  # seams of the roofing felt
        p.add(_level(x, x + 0.09, hy, z - 0.08), b.roof_k + 0.9, ROOF, b.solar_k * 0.9)
    if b.roof == "arrays":  # rows of solar heaters: tilted glass, a warm tank on top
        for x in np.arange(-hx + 1.5, hx - 2.2, 2.6):
            for y in np.arange(-hy + 1.0, hy - 2.0, 2.2):
                if rng.random() < 0.85:
                    low = (x, y, z + 0.1), (x, y + 1.8, z + 0.1)
                    high = (x + 1.6, y + 1.8, z + 1.2), (x + 1.6, y, z + 1.2)
                    p.add(quad(*low, *high), b.roof_k - 0.5, GLASS, b.solar_k * 0.5)
                    p.bar((x + 1.7, y, z + 1.3), (x + 1.7, y + 1.8, z + 1.3), 0.24, b.wall_k + 4.0, PAINT)
    else:
        for _ in range(int(rng.integers(2, 7))):
            size = rng.uniform((0.8, 0.8, 0.6), (2.4, 1.8, 1.5))
            x, y = (float(v) for v in rng.uniform(-1, 1, 2) * np.maximum((hx - 2, hy - 2), 0))
            warm = float(rng.uniform(4, 14)) if rng.random() < 0.35 else float(rng.uniform(-0.5, 2))
            p.box(size, 0.05, (x, y, z + size[2] / 2), b.roof_k + warm, PAINT, b.solar_k, 0.3)
        if rng.random() < 0.6:  # the stairs' head
            x = float(rng.uniform(-0.6, 0.6)) * max(hx - 3, 0.0)
            p.box((3.4, 2.8, 2.5), 0.05, (x, hy * 0.3, z + 1.2), 0.6 * b.wall_k + 0.4 * b.roof_k, WALL, b.solar_k, 0.3)
    return p.surface()


def _level(x0: float, x1: float, hy: float, z: float) -> Solid:
    """Return a level face from x0 to x1, `hy` to either side."""
    return quad((x0, -hy, z), (x1, -hy, z), (x1, hy, z), (x0, hy, z))


def _windows(p: SurfaceBuilder, b: Building, rng: np.random.Generator, a: FloatArray, c: FloatArray) -> None:
    """Add windows and a band per storey, 3 cm in front of the wall from `a` to `c`."""
    span = float(np.linalg.norm(c - a))
    along = (c - a) / span
    out = np.array([along[1], -along[0]])
    columns = int(span / 3.0)
    storeys = max(int(b.height_m / 3.1), 1)

    def face(s0: float, s1: float, z0: float, z1: float, off: float) -> Solid:
        lo, hi = a + along * s0 + out * off, a + along * s1 + out * off
        return quad((*lo, z0), (*hi, z0), (*hi, z1), (*lo, z1))

    for f in range(storeys):
        z0 = 0.95 + 3.1 * f
        if z0 + 1.6 > b.height_m:
            break
        p.add(face(0.1, span - 0.1, z0 + 1.85, z0 + 2.05, 0.02), b.wall_k + 0.9, WALL, b.solar_k)
        for k in range(columns):
            s0 = (span - 3.0 * columns) / 2 + 3.0 * k + 0.65
            lit = rng.random() < b.lit_share
            p.add(face(s0 - 0.12, s0 + 1.82, z0 - 0.12, z0 + 1.62, 0.025), b.wall_k + 0.7, WALL, b.solar_k)
            glass_k = b.window_k + (3.5 if lit else float(rng.normal(0, 0.5)))
            p.add(face(s0, s0 + 1.7, z0, z0 + 1.5, 0.03), glass_k, GLASS, 0.2 * b.solar_k)


def _gable(p: SurfaceBuilder, b: Building) -> None:
    hx, hy, z = b.length_m / 2 + 0.5, b.width_m / 2 + 0.5, b.height_m
    rise = 0.42 * hy
    ridge0, ridge1 = (-hx, 0, z + rise), (hx, 0, z + rise)
    for side in (-1, 1):
        p.add(quad((-hx, side * hy, z - 0.1), (hx, side * hy, z - 0.1), ridge1, ridge0), b.roof_k, ROOF, b.solar_k, 0.6)
        for x in np.arange(-hx + 0.8, hx, 1.1):  # the sheets' ribs
            low, high = z - 0.06, z + rise + 0.04
            rib = quad((x, side * hy, low), (x + 0.08, side * hy, low), (x + 0.08, 0, high), (x, 0, high))
            p.add(rib, b.roof_k + 1.2, ROOF, b.solar_k)
    wx, wy = b.length_m / 2, b.width_m / 2
    for x in (-wx, wx):
        tri = Solid(
            np.array([(x, -wy, z - 0.1), (x, wy, z - 0.1), (x, 0.0, z + rise - 0.15)]), np.array([[0, 1, 2]], np.int32)
        )
        p.add(tri, b.wall_k, WALL, b.solar_k, 0.4)
    p.box((2 * hx, 0.35, 0.14), 0.03, (0, 0, z + rise + 0.03), b.roof_k + 1.5, WALL, b.solar_k)
