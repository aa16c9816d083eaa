"""Temperature of the ground as the camera sees it, one value per sample of the image.

The ground is flat, so its temperature is needed only where the ray of a pixel meets it. Computing it there, at the
resolution of the render, makes lane markings and soft marks equally sharp at 60 m and at 260 m.

By day, thermal shadows are ground that stayed cold because something kept the sun off it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.surface_kinds import SURFACES
from infrablend.lab.world.buildings import Building
from infrablend.lab.world.fixtures import Tree
from infrablend.lab.world.ground_cover import GROUND_KINDS, Patch, Road
from infrablend.lab.world.people import Person
from infrablend.lab.world.scene_plan import WorldPlan
from infrablend.lab.world.setting import ground_points
from infrablend.lab.world.vehicles import Vehicle

Field = NDArray[np.float32]
Lay = Callable[..., Field]
LATTICE = 256
# Rows of samples that are computed at once.
_ROWS = 1200

Fill = Callable[[NDArray[np.float64], float], None]


def ground_grid(plan: WorldPlan, oversample: int) -> tuple[Field, Field]:
    """Return world x and y, each (h * oversample, w * oversample) float32, of the ground at the sub-pixel centres."""
    w, h = plan.camera.size_wh
    columns, rows = (np.arange(n * oversample) + 0.5 for n in (w, h))
    # In parts, because intermediate results of the map of a flight take gigabytes.
    parts = np.split(rows, range(_ROWS, len(rows), _ROWS))
    xy = [_ground_part(plan, columns / oversample, part / oversample) for part in parts]
    return np.concatenate([x for x, _ in xy]), np.concatenate([y for _, y in xy])


def _ground_part(plan: WorldPlan, columns: NDArray[np.float64], rows: NDArray[np.float64]) -> tuple[Field, Field]:
    j, i = np.meshgrid(columns, rows)
    xy = ground_points(plan.camera, np.stack([j.ravel(), i.ravel()], axis=1))
    return (
        np.ascontiguousarray(xy[:, 0].reshape(j.shape), np.float32),
        np.ascontiguousarray(xy[:, 1].reshape(j.shape), np.float32),
    )


class Noise:
    """Source of smooth random fields over the ground plane."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.Generator(np.random.PCG64(seed))

    def __call__(self, x: Field, y: Field, size_m: float) -> Field:
        """Return a new field with zero mean, unit deviation and features of about `size_m`, at given points."""
        lattice = self._rng.standard_normal((LATTICE, LATTICE)).astype(np.float32)
        # Blurred on a torus, so that the field repeats without a seam.
        lattice = cv2.GaussianBlur(np.pad(lattice, 8, mode="wrap"), (0, 0), 1.1)[8:-8, 8:-8]
        lattice = np.ascontiguousarray(lattice / lattice.std())
        ox, oy = (float(v) for v in self._rng.uniform(0, LATTICE, 2))
        # Two lattice steps per feature; turning it keeps its axes off the world's.
        a = float(self._rng.uniform(0, math.pi))
        scale = 2.0 / size_m
        u = (x * math.cos(a) + y * math.sin(a)) * scale + ox
        v = (y * math.cos(a) - x * math.sin(a)) * scale + oy
        return np.asarray(
            cv2.remap(
                lattice,
                np.mod(u, LATTICE).astype(np.float32),
                np.mod(v, LATTICE).astype(np.float32),
                cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_WRAP,
            ),
            np.float32,
        )


def ground_kelvin(plan: WorldPlan, oversample: int = 2) -> Field:
    """Return the (h * oversample, w * oversample) float32 temperature of the ground without anything on it."""
    x, y = ground_grid(plan, oversample)
    noise = Noise(plan.seed)
    metre_per_sample = plan.camera.distance_m / plan.camera.focal_px / oversample
    # Patterns that all materials share, each with its own strength: slow ones of every size (the larger, the
    # stronger, as on real ground), and the material's grain.
    weather = np.zeros_like(x)
    for size_m, weight in ((26.0, 0.62), (12.0, 0.5), (5.5, 0.4), (2.5, 0.33), (1.2, 0.28)):
        if size_m > 3 * metre_per_sample:
            weather += np.float32(weight) * noise(x, y, size_m)
    grain_sizes = sorted({m.grain_m for m in plan.materials})
    fine = {g: noise(x, y, max(g, 3 * metre_per_sample)) for g in grain_sizes}

    def lay(name: str, rows: slice = slice(None), columns: slice = slice(None)) -> Field:
        m = plan.material(name)
        part = (rows, columns)
        out = m.stain_k * weather[part] + m.grain_k * fine[m.grain_m][part]
        return np.asarray(out + m.kelvin, np.float32)

    kelvin = lay(plan.base)
    for patch in plan.patches:
        if patch.material is not None:
            _draw(plan, kelvin, x, y, patch, oversample, lay)
    for road in reversed(plan.roads):
        _draw_road(plan, kelvin, x, y, road, noise, lay)
    for patch in plan.patches:
        if patch.material is None:
            _draw(plan, kelvin, x, y, patch, oversample, lay)
    if plan.sun is not None:
        kelvin -= plan.shade_k * shade(plan, oversample)
    return kelvin


def ground_surfaces(plan: WorldPlan, oversample: int = 2) -> NDArray[np.uint8]:
    """Return the (h * oversample, w * oversample) kind of surface of the ground, a number in `SURFACES`."""
    x, y = ground_grid(plan, oversample)
    kinds = np.full(x.shape, SURFACES.index(GROUND_KINDS[plan.base]), np.float32)

    def lay(name: str, *part: slice) -> Field:
        return np.full_like(kinds[part], SURFACES.index(GROUND_KINDS[name]))

    for patch in plan.patches:
        if patch.material is not None:
            hard = replace(patch, soft_m=1e-3, amount_k=0.0)
            _draw(plan, kinds, x, y, hard, oversample, lay)
    for road in reversed(plan.roads):
        side = np.abs(np.asarray(road.along(x, y)[1], np.float32))
        if road.pavement_m > 0.1:
            kinds[side < road.half_width_m + road.pavement_m] = SURFACES.index("path")
        kinds[side < road.half_width_m] = SURFACES.index(road.kind)
    return np.asarray(np.rint(kinds), np.uint8)


def _blend(kelvin: Field, value: Field | float, mask: Field) -> None:
    kelvin += (value - kelvin) * mask


def _window(plan: WorldPlan, patch: Patch, oversample: int) -> tuple[slice, slice] | None:
    """Return the rows and columns that a patch can touch, or None if it is out of sight."""
    c, s = math.cos(patch.heading_rad), math.sin(patch.heading_rad)
    width = patch.length_m if patch.shape == "ring" else patch.width_m
    a, b = patch.length_m / 2 + patch.soft_m + patch.line_m, width / 2 + patch.soft_m + patch.line_m
    t = np.linspace(-1, 1, 9)
    edge = np.concatenate(
        [np.stack([t, np.full(9, k)], 1) for k in (-1, 1)] + [np.stack([np.full(9, k), t], 1) for k in (-1, 1)]
    ) * (a, b)
    points = np.zeros((len(edge), 3))
    points[:, 0] = patch.x_m + edge[:, 0] * c - edge[:, 1] * s
    points[:, 1] = patch.y_m + edge[:, 0] * s + edge[:, 1] * c
    xy, depth = plan.camera.project(points)
    w, h = plan.camera.size_wh
    if (depth <= 0.5).any():
        return slice(None), slice(None)
    low = np.floor(xy.min(axis=0) * oversample - 1).astype(int)
    high = np.ceil(xy.max(axis=0) * oversample + 1).astype(int)
    j0, j1 = max(low[0], 0), min(high[0], w * oversample)
    i0, i1 = max(low[1], 0), min(high[1], h * oversample)
    if j0 >= j1 or i0 >= i1:
        return None
    return slice(i0, i1), slice(j0, j1)


def _draw(plan: WorldPlan, kelvin: Field, x: Field, y: Field, patch: Patch, oversample: int, lay: Lay) -> None:
    part = _window(plan, patch, oversample)
    if part is None:
        return
    c, s = math.cos(patch.heading_rad), math.sin(patch.heading_rad)
    dx, dy = x[part] - np.float32(patch.x_m), y[part] - np.float32(patch.y_m)
    u, v = dx * np.float32(c) + dy * np.float32(s), dy * np.float32(c) - dx * np.float32(s)
    a, b = patch.length_m / 2, patch.width_m / 2
    if patch.shape == "rect":
        inside = np.minimum(a - np.abs(u), b - np.abs(v))
    elif patch.shape == "ellipse":
        inside = (1 - np.sqrt((u / a) ** 2 + (v / b) ** 2)) * min(a, b)
    else:
        inside = patch.line_m / 2 - np.abs(np.hypot(u, v) - a)
    mask = np.clip(inside / patch.soft_m + 0.5, 0, 1).astype(np.float32)
    mask *= mask * (3 - 2 * mask)
    if patch.material is None:
        kelvin[part] += mask * np.float32(patch.amount_k)
    else:
        _blend(kelvin[part], lay(patch.material, *part) + np.float32(patch.amount_k), mask)


def _draw_road(plan: WorldPlan, kelvin: Field, x: Field, y: Field, road: Road, noise: Noise, lay: Lay) -> None:
    night = plan.sun is None
    s, t = (np.asarray(a, np.float32) for a in road.along(x, y))
    side = np.abs(t)
    half = road.half_width_m
    edge_m = 0.06

    def within(distance: Field | float, limit: float) -> Field:
        return np.clip((limit - distance) / edge_m + 0.5, 0, 1).astype(np.float32)

    if road.pavement_m > 0.1:
        _blend(kelvin, lay("paving"), within(side, half + road.pavement_m))
    surface = lay(road.surface)
    # Wheels polish two tracks per lane, and oil darkens the middle: streaks along the road, broken up slowly.
    lane = 2 * half / road.lanes
    streak = noise(s * np.float32(0.045), t, 0.9)
    tracks = np.cos(t * np.float32(2 * math.pi / (lane / 2)))
    surface += np.float32(0.35 if night else 0.9) * streak + np.float32(0.22 if night else -0.6) * tracks
    for k in range(3):  # construction joints and cracks across
        at = (k - 1) * 23.0 + float(plan.seed % 97) * 0.2
        wobble = noise(s * 0, t, 3.0) * np.float32(0.12)
        surface += np.float32(-0.8 if night else 1.5) * np.exp(-(((s - np.float32(at) - wobble) / 0.07) ** 2))
    # Towards the kerb the road is less worn and leaves gather.
    surface -= np.float32(0.5 if night else 1.2) * np.clip((side - half + 0.9) / 0.9, 0, 1)
    _blend(kelvin, surface, within(side, half))
    paint_k = np.float32(-0.9 if night else -3.0)
    if road.markings:
        line = np.zeros_like(kelvin)
        for k in range(1, road.lanes):
            at = -half + lane * k
            dash = within(np.abs(np.mod(s, 9.0) - 4.5), 2.0) if k != road.lanes // 2 or road.lanes == 2 else 1.0
            line += within(np.abs(t - np.float32(at)), 0.075) * dash
        for at in (-half + 0.35, half - 0.35):
            line += within(np.abs(t - np.float32(at)), 0.07)
        kelvin += paint_k * np.minimum(line, 1)
    kerb = within(np.abs(side - np.float32(half)), 0.11)
    kelvin += np.float32(1.6 if night else -1.5) * kerb


def shade(plan: WorldPlan, oversample: int) -> Field:
    """Return the share in [0, 1] of the sun's heat that shadows kept from the ground, float32.

    The shape is (h * `oversample`, w * `oversample`) for an image of (h, w). Moving cars and walking people leave no
    shadow, because asphalt needs minutes to cool.
    """
    assert plan.sun is not None
    w, h = plan.camera.size_wh
    mask = np.zeros((h * oversample, w * oversample), np.float32)
    sx, sy = -plan.sun[0] / plan.sun[2], -plan.sun[1] / plan.sun[2]

    def fill(points_xy: NDArray[np.float64], depth: float) -> None:
        world = np.concatenate([points_xy, np.zeros((len(points_xy), 1))], axis=1)
        xy, z = plan.camera.project(world)
        if (z <= 0.5).any():
            return
        hull = cv2.convexHull(np.round(xy * oversample * 16).astype(np.int32).reshape(-1, 1, 2))
        layer = mask if depth >= 1 else np.zeros_like(mask)
        cv2.fillConvexPoly(layer, hull, depth, lineType=cv2.LINE_AA, shift=4)
        if layer is not mask:
            np.maximum(mask, layer, out=mask)

    def box(b: Building | Vehicle | Person, length: float, width: float, height: float, depth: float) -> None:
        c, s = math.cos(b.heading_rad), math.sin(b.heading_rad)
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (length / 2, width / 2)
        base = np.stack(
            [b.x_m + corners[:, 0] * c - corners[:, 1] * s, b.y_m + corners[:, 0] * s + corners[:, 1] * c], 1
        )
        fill(np.concatenate([base, base + np.array([sx, sy]) * height]), depth)

    # Trees first, in several lobes, so that their outline is not a clean ellipse.
    t = 2 * np.pi * np.arange(12) / 12
    ring = np.stack([np.cos(t), np.sin(t)], 1)
    for tree in plan.trees:
        _tree_shadow(tree, ring, (sx, sy), fill)
    for b in plan.buildings:
        box(b, b.length_m, b.width_m, b.height_m, 1.0)
    for v in plan.vehicles:
        box(v, v.length_m * 0.96, v.width_m * 0.96, v.height_m * 0.85, 1.0)
    for q in plan.furniture:
        if q.kind in ("lamp", "hoop"):
            base = np.array([[q.x_m, q.y_m]])
            fill(np.concatenate([base - 0.06, base + 0.06, base + np.array([sx, sy]) * q.height_m]), 1.0)
    soft = max(0.25 * plan.camera.focal_px / plan.camera.distance_m * oversample, 0.8)
    return np.asarray(cv2.GaussianBlur(mask, (0, 0), soft), np.float32)


def _tree_shadow(tree: Tree, ring: NDArray[np.float64], slope: tuple[float, float], fill: Fill) -> None:
    base = np.array([tree.x_m, tree.y_m])
    s = np.array(slope)
    if tree.kind == "bare":
        fill(np.stack([base - 0.08, base + 0.08, base + s * tree.height_m]), 1.0)
        return
    fill(np.concatenate([base + 0.1 * ring, base + s * 0.6 * tree.height_m + 0.1 * ring]), 1.0)
    for k in range(7):
        a = 2.4 * k + tree.heading_rad
        r = 0.55 * tree.radius_m if k else 0.0
        centre = base + s * tree.height_m * (0.62 + 0.12 * math.sin(1.7 * a)) + r * np.array([math.cos(a), math.sin(a)])
        fill(centre + 0.5 * tree.radius_m * ring * (1 + 0.15 * np.sin(3 * np.arange(12) + a))[:, None], 1.0)
