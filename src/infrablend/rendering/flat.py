"""A renderer without Blender, on the software rasteriser: for tests, and for trying out a recipe quickly.

Flat shading: each part has one radiance, from its mean temperature and its emissivity. There is no Fresnel effect and
no texture, and every surface mirrors the ground.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from infrablend.core.raster import visible
from infrablend.core.render import PlacedObject, PlacedScene, RenderResult, empty_result
from infrablend.core.scene import PartState, SceneSpec
from infrablend.rendering.surface_values import ground_radiance
from infrablend.thermal.radiometry import band_radiance

SUPERSAMPLE = 4


class FlatRenderer:
    """Implements `core.render.Renderer`."""

    def __init__(self, device: str = "cpu", blender: str | None = None) -> None:
        """Ignore device and Blender: everything runs here, on the CPU."""

    def start(self) -> None:
        """Do nothing; see `core.render.Renderer`."""

    def render(self, scene: PlacedScene) -> RenderResult:
        """Render a scene; see `core.render.Renderer`."""
        w, h = scene.spec.camera.size_wh
        parts = _parts(scene)
        if not len(parts.xy):
            return empty_result((w, h), len(scene.objects))
        low, high = parts.xy.min(axis=(0, 1)), parts.xy.max(axis=(0, 1))
        x0, y0 = (max(0, math.floor(v)) for v in low)
        x1, y1 = min(w, math.ceil(high[0])), min(h, math.ceil(high[1]))
        if x0 >= x1 or y0 >= y1:
            return empty_result((w, h), len(scene.objects))
        translucent = parts.opacity < 1
        opaque_triangle = ~translucent[parts.owner]

        def shares(kept: NDArray[np.bool_], owner: NDArray[np.intp], count: int) -> NDArray[np.float32]:
            """(count, h, w) share of each pixel in which each owner among the kept triangles is nearest."""
            crop = (x0, y0), (x1 - x0, y1 - y0)
            return visible(parts.xy[kept], parts.inverse_depth[kept], owner[kept], count, *crop, SUPERSAMPLE)

        layers = shares(opaque_triangle, parts.owner, len(parts.radiance))
        radiance = np.tensordot(np.array(parts.radiance, np.float32), layers, axes=1).astype(np.float32)
        alpha = layers.sum(axis=0, dtype=np.float32)
        coverage = np.zeros((len(scene.objects), *alpha.shape), np.float32)
        for layer, label, number in zip(layers, parts.label, parts.object_number, strict=True):
            if label:
                coverage[number] += layer
        # Translucent parts: each is laid over what is opaque; their order among themselves hardly matters.
        for k in np.flatnonzero(translucent).tolist():
            own = parts.owner == k
            share = np.float32(parts.opacity[k]) * shares(opaque_triangle | own, np.where(own, 0, 1), 1)[0]
            radiance += share * (np.float32(parts.radiance[k]) - radiance)
            alpha += share * (1 - alpha)
        of_ground = ground_radiance(scene)
        return RenderResult((x0, y0), (w, h), radiance, np.minimum(alpha, 1), np.minimum(coverage, 1), of_ground)

    def close(self) -> None:
        """Do nothing: there is nothing to release."""


@dataclass(frozen=True, eq=False)
class _Parts:
    """The parts of all objects, numbered through, and their triangles in the image.

    Attributes:
        xy: (T, 3, 2) corners, pixels.
        inverse_depth: (T, 3) 1 / depth of the corners.
        owner: (T,) number of the part.
        radiance: Radiance of each part.
        opacity: (P,) opacity of each part.
        label: Whether labels count the part.
        object_number: Object that the part belongs to.
    """

    xy: NDArray[np.float64]
    inverse_depth: NDArray[np.float64]
    owner: NDArray[np.intp]
    radiance: Sequence[float]
    opacity: NDArray[np.float64]
    label: Sequence[bool]
    object_number: Sequence[int]


def _parts(scene: PlacedScene) -> _Parts:
    objects: Sequence[PlacedObject] = scene.objects
    counts = np.array([len(o.mesh.part_names) for o in objects], np.intp)
    first = np.cumsum(counts) - counts
    pieces = [o.triangles for o in objects]
    states = [o.spec.parts[name] for o in objects for name in o.mesh.part_names]
    rises = [o.part_sun_rise_k[name] for o in objects for name in o.mesh.part_names]
    warmed = [replace(s, temperature_k=s.temperature_k + k) for s, k in zip(states, rises, strict=True)]
    owners = [f + o.mesh.part_of_triangle[p.source] for f, o, p in zip(first, objects, pieces, strict=True)]
    return _Parts(
        np.concatenate([np.zeros((0, 3, 2)), *(p.xy for p in pieces)]),
        np.concatenate([np.zeros((0, 3)), *(p.inverse_depth for p in pieces)]),
        np.concatenate([np.zeros(0, np.intp), *owners]),
        [_radiance(state, scene.spec) for state in warmed],
        np.array([state.opacity for state in states]),
        [state.label for state in states],
        np.repeat(np.arange(len(objects)), counts).tolist(),
    )


def _radiance(state: PartState, scene: SceneSpec) -> float:
    """Return the light from a surface: 0 to 1 in the artistic look, W m^-2 sr^-1 in the physical one."""
    look = scene.appearance
    e = state.emissivity
    if scene.weather is not None:
        return e * float(band_radiance(state.temperature_k)) + (1 - e) * float(band_radiance(scene.weather.ground_k))
    own, mirrored = (
        min(max((k - look.cold_k) / (look.hot_k - look.cold_k), 0.0), 1.0)
        for k in (state.temperature_k, look.surroundings_k)
    )
    return e * own + (1 - e) * mirrored
