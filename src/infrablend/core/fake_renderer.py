"""A renderer without Blender: the same port on the software rasteriser. For tests, and for trying a recipe out fast.

Flat shading: every part has one grey level from its temperature; no Fresnel, no texture, metals mirror the ground.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from infrablend.core.camera import object_to_world
from infrablend.core.mesh import Mesh
from infrablend.core.raster import project_triangles, visible
from infrablend.core.render import RenderResult
from infrablend.core.scene import PartState, SceneSpec

SUPERSAMPLE = 4


class FakeRenderer:
    """Implements `core.render.Renderer`."""

    device = "fake"

    def render(self, scene: SceneSpec, meshes: Sequence[Mesh]) -> RenderResult:
        """See `core.render.Renderer`."""
        w, h = scene.camera.size_wh
        xy, inverse_depth, owner, level, labelled, part_owner, opacity = [], [], [], [], [], [], []
        count = 0
        for number, (spec, mesh) in enumerate(zip(scene.objects, meshes, strict=True)):
            world = object_to_world(mesh.vertices_m, spec.position_m, spec.yaw_rad, spec.scale)
            projected = project_triangles(scene.camera, world, mesh.triangles)
            xy.append(projected.xy)
            inverse_depth.append(projected.inverse_depth)
            owner.append(count + mesh.part_of_triangle[projected.source])
            for name in mesh.part_names:
                state = spec.parts[name]
                level.append(_level(state, scene))
                labelled.append(state.label)
                part_owner.append(number)
                opacity.append(state.opacity)
            count += len(mesh.part_names)
        corners = np.concatenate(xy) if xy else np.zeros((0, 3, 2))
        nothing = np.zeros((0, 0), np.float32)
        empty = RenderResult((0, 0), (w, h), nothing, nothing.copy(), np.zeros((len(meshes), 0, 0), np.float32))
        if not len(corners):
            return empty
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        x0, y0 = (max(0, math.floor(v)) for v in low)
        x1, y1 = min(w, math.ceil(high[0])), min(h, math.ceil(high[1]))
        if x0 >= x1 or y0 >= y1:
            return empty
        depth, parts = np.concatenate(inverse_depth), np.concatenate(owner)
        thin = np.array(opacity) < 1
        hides = ~thin[parts]

        def shares(kept: NDArray[np.bool_], n: int, whose: NDArray[np.intp]) -> NDArray[np.float32]:
            return visible(corners[kept], depth[kept], whose[kept], n, (x0, y0), (x1 - x0, y1 - y0), SUPERSAMPLE)

        layers = shares(hides, count, parts)
        radiance = np.tensordot(np.array(level, np.float32), layers, axes=1).astype(np.float32)
        alpha = layers.sum(axis=0, dtype=np.float32)
        coverage = np.zeros((len(meshes), *alpha.shape), np.float32)
        for layer, label, number in zip(layers, labelled, part_owner, strict=True):
            if label:
                coverage[number] += layer
        # Translucent parts: each lies over what is opaque; their own order changes next to nothing.
        for k in np.flatnonzero(thin):
            share = opacity[k] * shares(hides | (parts == k), 1, np.where(parts == k, 0, 1))[0]
            radiance += share * (level[k] - radiance)
            alpha += share * (1 - alpha)
        return RenderResult((x0, y0), (w, h), radiance, np.minimum(alpha, 1), np.minimum(coverage, 1))

    def close(self) -> None:
        """Nothing to release."""


def _level(state: PartState, scene: SceneSpec) -> float:
    """What a surface shows: 0 to 1 in the artistic look; W m^-2 sr^-1 in the physical one, mirroring the ground."""
    look, e = scene.appearance, state.emissivity
    if look.mode == "physical":
        if scene.weather is None:
            raise ValueError(f"{scene.frame_id}: the physical look needs the weather")
        # A blackbody's radiance, to 1 %: this module stands below the physics.
        return e * _radiance(state.temperature_k) + (1 - e) * _radiance(scene.weather.ground_k)
    warm, mirrored = (
        min(max((k - look.cold_k) / (look.hot_k - look.cold_k), 0.0), 1.0)
        for k in (state.temperature_k, look.surroundings_k)
    )
    return e * warm + (1 - e) * mirrored


def _radiance(kelvin: float) -> float:
    return float(54.93 * (kelvin / 300) ** 4.6)
