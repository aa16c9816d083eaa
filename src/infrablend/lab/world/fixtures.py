"""What stands on the ground: trees and shrubs from a few prototypes, and street furniture."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from infrablend.assets import shapes
from infrablend.assets.shapes import Solid
from infrablend.core.mesh import FloatArray
from infrablend.lab.world.setting import Draws, Weather
from infrablend.lab.world.thermal_surfaces import CLOTH, GLASS, LEAF, METAL, PAINT, Surface, SurfaceBuilder

TreeKind = Literal["bare", "crown", "shrub", "conifer"]
# Number of prototypes of each kind; a kind's place here is part of its prototypes' seeds.
TREE_KINDS = {"bare": 4, "crown": 6, "shrub": 3, "conifer": 5}


@dataclass(frozen=True)
class Tree:
    """A tree or shrub, one of a few prototypes placed, turned and scaled."""

    kind: TreeKind
    prototype: int
    x_m: float
    y_m: float
    heading_rad: float
    height_m: float
    radius_m: float
    kelvin: float
    solar_k: float


def draw_tree_size(draws: Draws, kind: TreeKind, scale: float) -> tuple[float, float]:
    """Return the height and the radius of a new tree in metres."""
    u = draws.uniform
    alike = "crown" if kind == "conifer" else kind
    height = {"crown": u(4.5, 8.5), "bare": u(5.0, 8.5), "shrub": u(0.9, 1.9)}[alike] * scale
    radius = height * {"crown": u(0.32, 0.46), "bare": u(0.3, 0.4), "shrub": u(0.5, 0.75)}[alike]
    return (1.3 * height, 0.6 * radius) if kind == "conifer" else (height, radius)


def draw_tree(draws: Draws, weather: Weather, kind: TreeKind, x: float, y: float, size_m: tuple[float, float]) -> Tree:
    """Draw a tree of a given (height, radius) at (x, y): its prototype, heading and temperatures."""
    u = draws.uniform
    clear = weather.clear_sky
    kelvin = weather.air_k + (-0.4 - 1.9 * clear + u(-0.5, 0.5) if weather.night else u(-2.0, 1.0))
    kelvin -= 1.2 * clear if kind == "shrub" and weather.night else 0
    prototype = draws.integer(64)
    heading = u(0, 2 * math.pi)
    kelvin += 1.6 if kind == "bare" and weather.night else 0
    return Tree(kind, prototype, x, y, heading, *size_m, kelvin, weather.solar * u(1, 3.5))


def tree_prototype(kind: str, index: int) -> Surface:
    """Return prototype `index` of a kind of tree, 1 m high, of radius 1 m; temperatures are relative to the tree's."""
    # Prototypes are part of the program, like a model file: the same in every world.
    rng = np.random.Generator(np.random.PCG64([7, list(TREE_KINDS).index(kind), index]))
    if kind == "crown":
        return _crown(rng, 560, 0.30, 0.72)
    if kind == "shrub":
        return _crown(rng, 170, 0.05, 0.5)
    if kind == "conifer":
        return _conifer(rng)
    return _bare(rng)


def tree_matrix(t: Tree) -> FloatArray:
    """Return the (4, 4) placement matrix of a prototype."""
    m = np.eye(4)
    m[:3, :3] = shapes.turn_z(t.heading_rad) @ np.diag([t.radius_m, t.radius_m, t.height_m])
    m[:3, 3] = (t.x_m, t.y_m, 0.0)
    return m


def _crown(rng: np.random.Generator, clumps: int, low: float, centre: float) -> Surface:
    p = SurfaceBuilder()
    ball = _icosahedron()
    flatten = (1 - low) / 2
    trunk = shapes.capsule((0, 0, 0), (0, 0, 0.6), 0.06, 0.04, n=6)
    p.add(Solid(trunk.vertices * (1, 1, 1), trunk.triangles), 1.6, LEAF, 0.3, 0.3)
    # The crown consists of lobes, for an uneven outline; each lobe consists of clumps.
    lobes = rng.normal(size=(7, 3))
    lobes /= np.linalg.norm(lobes, axis=1, keepdims=True)
    for _ in range(clumps):
        d = rng.normal(size=3)
        d /= np.linalg.norm(d)
        bulge = 0.72 + 0.28 * float(np.max(np.clip(lobes @ d, 0, 1)) ** 3)
        r = bulge * float(rng.uniform(0.35, 1.0) ** 0.45)
        c = np.array([d[0] * r, d[1] * r, centre - 0.02 + d[2] * r * flatten])
        size = float(rng.uniform(0.07, 0.17))
        jitter = 1 + 0.38 * rng.uniform(-1, 1, (len(ball.vertices), 1))
        v = ball.vertices * jitter * (size, size, size * 0.62) + c
        v[:, 2] = np.clip(v[:, 2], 0.02, 1.0)
        # Parts that face the sky are colder; the inside keeps the trunk's warmth.
        warm = 0.75 * (1 - r) - 0.4 * d[2] + float(rng.normal(0, 0.7))
        p.add(Solid(v, ball.triangles), warm, LEAF, 1.0, 1.1)
    return p.surface()


def _conifer(rng: np.random.Generator) -> Surface:
    """Return a spruce or a cypress: whorls of branches that hang, shorter towards the top."""
    p = SurfaceBuilder()
    p.add(shapes.capsule((0, 0, 0), (0, 0, 0.95), 0.05, 0.01, n=6), 1.2, LEAF, 0.3, 0.3)
    ball = _icosahedron()
    droop = float(rng.uniform(0.1, 0.45))
    low = float(rng.uniform(0.03, 0.15))
    for z in np.arange(low, 0.98, 0.045):
        reach = (1 - (z - low) / (1 - low)) ** float(rng.uniform(0.7, 1.0))
        for angle in rng.uniform(0, 2 * math.pi) + np.arange(0, 2 * math.pi, 0.5 + 0.4 * (1 - reach)):
            length = reach * float(rng.uniform(0.75, 1.0)) + 0.05
            thick = 0.14 * length + 0.02
            v = ball.vertices * (1 + 0.3 * rng.uniform(-1, 1, (len(ball.vertices), 1)))
            v = v * (length / 2, thick, 0.02 + 0.2 * thick) + (length / 2, 0, 0)
            v[:, 2] -= 0.25 * droop * v[:, 0]
            v = v @ shapes.turn_z(float(angle + rng.normal(0, 0.1))).T + (0, 0, z)
            v[:, 2] = np.clip(v[:, 2], 0.0, 1.0)
            p.add(Solid(v, ball.triangles), float(rng.normal(0, 0.5)) - 0.3, LEAF, 1.0, 0.9)
    return p.surface()


def _bare(rng: np.random.Generator) -> Surface:
    """Return a tree in winter: trunk and branches."""
    p = SurfaceBuilder()

    def grow(start: FloatArray, direction: FloatArray, length: float, radius: float, level: int) -> None:
        end = start + direction * length
        up = np.array([1.0, 0, 0]) if abs(direction[0]) < 0.9 else np.array([0, 1.0, 0])
        p.add(shapes.sweep([start, end], [radius, radius * 0.65], n=4, up=up), 0.5 * (4 - level) - 0.6, LEAF, 0.5, 0.4)
        if level == 4:
            return
        for _ in range(3 if level < 3 else 2):
            turn = direction + rng.normal(0, 0.62, 3) + (0, 0, 0.12)
            turn /= np.linalg.norm(turn)
            at = start + direction * length * float(rng.uniform(0.55, 1.0))
            grow(at, turn, length * float(rng.uniform(0.6, 0.85)), radius * 0.6, level + 1)

    # Built 1 unit high and about 0.35 wide, then stretched to radius 1.
    grow(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.34, 0.014, 0)
    s = p.surface()
    v = s.vertices_m.copy()
    v[:, :2] /= max(float(np.percentile(np.hypot(v[:, 0], v[:, 1]), 97)), 1e-6)
    v[:, 2] = np.maximum(v[:, 2], 0) / float(v[:, 2].max())
    return Surface(v, s.triangles, s.kelvin, s.mirror, s.solar_k, s.grain_k)


def _icosahedron() -> Solid:
    """Return a ball of 20 triangles, radius 1."""
    g = (1 + 5**0.5) / 2
    v = [
        (-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g),
        (0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1),
    ]  # fmt: skip
    f = [
        (0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6),
        (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10),
        (8, 6, 7), (9, 8, 1),
    ]  # fmt: skip
    return Solid(np.array(v, np.float64) / math.hypot(1, g), np.array(f, np.int32))


@dataclass(frozen=True)
class Furniture:
    """Street furniture: a lamp, a basketball hoop, a bin, a bollard or a bench."""

    kind: Literal["lamp", "hoop", "bin", "bollard", "bench", "fence"]
    x_m: float
    y_m: float
    heading_rad: float
    height_m: float
    length_m: float
    pole_k: float
    head_k: float


def furniture(q: Furniture) -> Surface:
    """Street furniture about its foot, arm or length along +X."""
    p = SurfaceBuilder()
    h = q.height_m
    if q.kind == "lamp":
        p.bar((0, 0, 0), (0, 0, h), (0.1, 0.06), q.pole_k, METAL)
        p.bar((0, 0, h), (q.length_m, 0, h + 0.25), 0.05, q.pole_k, METAL, n=4)
        p.box((0.75, 0.32, 0.14), 0.04, (q.length_m + 0.2, 0, h + 0.24), q.head_k, METAL)
    elif q.kind == "hoop":
        p.box((1.5, 0.9, 0.4), 0.05, (-0.4, 0, 0.2), q.pole_k, PAINT)
        p.bar((0, 0, 0.3), (0.5, 0, h - 0.3), 0.11, q.pole_k, METAL)
        p.bar((0.5, 0, h - 0.35), (q.length_m, 0, h - 0.2), 0.07, q.pole_k, METAL)
        p.box((0.06, 1.8, 1.05), 0.01, (q.length_m, 0, h), q.head_k, GLASS)
        ring = shapes.lathe([(0.22, -0.02), (0.25, -0.02), (0.25, 0.02), (0.22, 0.02)], 12, wrap=True)
        p.add(shapes.moved(ring, (q.length_m + 0.35, 0, h - 0.4)), q.pole_k, METAL)
    elif q.kind == "fence":
        half = q.length_m / 2
        for x in np.arange(-half, half + 0.1, 3.0):
            p.bar((x, 0, 0), (x, 0, h), 0.045, q.pole_k, METAL, n=4)
        for z in (0.15, h / 2, h):
            p.add(shapes.sweep([(-half, 0, z), (half, 0, z)], 0.03, n=4), q.pole_k, METAL)
    elif q.kind == "bin":
        p.add(shapes.cylinder(0.3, 0, h, 8), q.pole_k, PAINT)
    elif q.kind == "bollard":
        p.add(shapes.cylinder(0.1, 0, h, 6), q.pole_k, PAINT)
    else:
        p.box((q.length_m, 0.5, 0.1), 0.02, (0, 0, h), q.pole_k, CLOTH)
    return p.surface()
