"""Draws plans of the virtual world without Blender: the nearest surface at each sample of a regular lattice.

Surfaces emit and mirror by the formulas of `blender.world`, once per triangle instead of once per ray. The fine pattern
on them is another one, of the same strength and size.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infrablend.core.mesh import FloatArray
from infrablend.core.raster import SampleGrid, fragments_of, nearest_fragments, project_triangles
from infrablend.lab.world.ground import Field, Noise
from infrablend.lab.world.scene_plan import WorldPlan
from infrablend.lab.world.thermal_surfaces import Surface

# Size of the fine pattern, m, and its deviation as a share of `Surface.grain_k`: those of Blender's noise texture.
_PATTERN_M = 0.33
_PATTERN = 0.45


@dataclass(frozen=True, eq=False)
class Body:
    """A surface at its place.

    Attributes:
        surface: The surface.
        vertices_m: (V, 3) its vertices in the world.
        index: Number of the body in the picture of numbers; 0 is the ground's.
        kelvin: Added to the temperatures of the surface.
        sun: Share of the sun that reaches it.
    """

    surface: Surface
    vertices_m: FloatArray
    index: int
    kelvin: float = 0.0
    sun: float = 1.0


def draw_bodies(
    plan: WorldPlan, ground: Field, bodies: Iterable[Body], oversample: int
) -> tuple[Field, NDArray[np.int32]]:
    """Return the temperature in kelvin, and the number of the body, at each sample, (h, w) times `oversample`.

    Args:
        plan: The scene, with its camera, air, sky and sun.
        ground: Temperature of the ground at each sample; bodies stand on it and hide it.
        bodies: What stands on the ground; of several at the same depth the last one shows.
        oversample: Samples along a pixel's side.
    """
    grid = SampleGrid.over_pixels((0, 0), plan.camera.size_wh, oversample)
    depth = np.zeros(ground.size)  # as 1 / depth of the nearest body, 1/m
    ids = np.zeros(ground.size, np.int32)
    shown = ground.ravel().astype(np.float32)
    grain = np.zeros(ground.size, np.float32)
    for body in bodies:
        projected = project_triangles(plan.camera, body.vertices_m, body.surface.triangles)
        all_of_it = np.arange(len(projected.xy))
        found, _ = nearest_fragments(fragments_of(projected.xy, projected.inverse_depth, grid, all_of_it), grid)
        found = found.take(np.flatnonzero(found.inverse_depth >= depth[found.index]))
        of_triangle, grain_of_triangle = _light(plan, body)
        triangle = projected.source[found.triangle]
        depth[found.index] = found.inverse_depth
        ids[found.index] = body.index
        shown[found.index] = of_triangle[triangle]
        grain[found.index] = grain_of_triangle[triangle]
    covered = np.flatnonzero(ids)
    shown[covered] += grain[covered] * _pattern(plan, grid, covered, 1 / depth[covered])
    return shown.reshape(ground.shape), ids.reshape(ground.shape)


def _light(plan: WorldPlan, body: Body) -> tuple[Field, Field]:
    """Return the apparent temperature (T,) of a body's triangles, and the amplitude (T,) of the pattern on them."""
    of = body.surface
    a, b, c = np.moveaxis(body.vertices_m[of.triangles], 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    to_camera = plan.camera.position_m - (a + b + c) / 3
    to_camera /= np.linalg.norm(to_camera, axis=1, keepdims=True)
    cosine = np.einsum("ij,ij->i", normal, to_camera)
    normal *= np.where(cosine < 0, -1.0, 1.0)[:, None]  # on the camera's side
    cosine = np.abs(cosine)
    facing_sun = 0.0 if plan.sun is None else np.maximum(normal @ np.array(plan.sun), 0)
    own = of.kelvin + body.kelvin + facing_sun * body.sun * of.solar_k
    mirror = np.clip(of.mirror * (1 + 6 * (1 - cosine) ** 4), 0, 1)
    mirrored_up = np.maximum(2 * cosine * normal[:, 2] - to_camera[:, 2], 0)
    around = plan.air_k - plan.sky_drop_k * mirrored_up**0.6
    return (own + mirror * (around - own)).astype(np.float32), (of.grain_k * (1 - mirror)).astype(np.float32)


def _pattern(plan: WorldPlan, grid: SampleGrid, samples: NDArray[np.intp], depth_m: FloatArray) -> Field:
    """Return the (N,) fine pattern at what samples show, in parts of `Surface.grain_k`."""
    row, column = np.divmod(samples, grid.shape_hw[1])
    camera = plan.camera
    w, h = camera.size_wh
    x, y = grid.columns_x()[column] - w / 2, grid.rows_y()[row] - h / 2
    rays = np.stack([x, y, np.full(len(samples), camera.focal_px)], axis=1) / camera.focal_px
    at = camera.position_m + (rays * depth_m[:, None]) @ camera.world_to_camera
    # Heights shift the pattern, so that it is not smeared down a wall.
    plane = np.zeros((2, *grid.shape_hw), np.float32)
    plane.reshape(2, -1)[:, samples] = (at[:, :2] + at[:, 2:]).T
    return np.asarray(_PATTERN * Noise(plan.seed)(plane[0], plane[1], _PATTERN_M).ravel()[samples], np.float32)
