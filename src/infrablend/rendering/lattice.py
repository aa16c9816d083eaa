"""Draws scenes by sampling surfaces on a regular lattice, without tracing light.

A surface emits, and mirrors its surroundings, but not other surfaces. A pixel is then the mean over its samples of what
is nearest there. The lattice leaves no noise, so it needs fewer samples than Cycles, and no scene has to be handed to
Blender. Values are interpolated in perspective; `rendering.shading` has the formulas. Tests and `make bench` compare
the pictures with Cycles, and docs/explanation/quality.md says what the missing light changes.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import reach_of_triangles
from infrablend.core.camera import CameraSpec
from infrablend.core.mesh import FloatArray
from infrablend.core.raster import Fragments, SampleGrid, fragments_of, nearest_fragments
from infrablend.core.render import Image32, PlacedObject, PlacedScene, RenderResult, empty_result
from infrablend.core.scene import SceneSpec
from infrablend.rendering.shading import ArtisticLook, PhysicalLook, Points
from infrablend.rendering.surface_values import corner_normals, ground_radiance, is_two_sided, surface_values

# Samples along a pixel's side. Large objects have a smaller share of outlines, so they need fewer.
SUPERSAMPLE = (5, 8)
# Fragments per frame for which small objects get more samples than the least.
FRAGMENTS = 100_000
# Fragments at a time: arrays that stay in the processor's cache take half the time. It does not change the picture.
BAND_FRAGMENTS = 50_000
# Share of a fragment that an empty sample costs.
_EMPTY = 0.1
# As in the material: parts above are opaque.
_OPAQUE = 0.9999
# One pixel more than the projected outline, so that rounding loses nothing.
CROP_MARGIN_PX = 1
# Empty pixels that cost Cycles as much as one more rectangle of the same scene.
CROP_COST_PX = 5_000

Crop = tuple[int, int, int, int]


def needs_no_tracing(scene: PlacedScene) -> bool:
    """Return True if `render_on_lattice` can draw it: nothing mirrors other surfaces or reaches behind the camera."""
    return not mirrors_surfaces(scene) and not any(o.triangles.cut for o in scene.objects)


def mirrors_surfaces(scene: PlacedScene) -> bool:
    """Return whether something mirrors so well that it shows other surfaces; in the artistic look nothing does."""
    states = [placed.spec.parts[name] for placed in scene.objects for name in placed.mesh.part_names]
    return scene.spec.weather is not None and any(s.mirrors for s in states)


def render_on_lattice(scene: PlacedScene) -> RenderResult:
    """Draw a scene, cropped to what its objects cover; see `core.render.Renderer`."""
    started = time.perf_counter()
    camera = scene.spec.camera
    crop = crop_of(scene)
    if crop is None:
        return empty_result(camera.size_wh, len(scene.objects))
    x0, y0, x1, y1 = crop
    surfaces = _surfaces(scene).inside(crop)
    built = time.perf_counter()
    supersample = int(np.clip(math.sqrt(FRAGMENTS / max(surfaces.area_px(crop), 1.0)), *SUPERSAMPLE))
    weather = scene.spec.weather
    look = ArtisticLook(scene.spec.appearance) if weather is None else PhysicalLook(weather)
    radiance, alpha = np.zeros((2, y1 - y0, x1 - x0), np.float32)
    coverage = np.zeros((len(scene.objects), *alpha.shape), np.float32)
    for part, _ in crops_of(scene):
        of_part = surfaces.inside(part)
        left, top, right, bottom = part
        samples = max(of_part.area_px(part), _EMPTY * (right - left) * (bottom - top)) * supersample**2
        bands = min(bottom - top, math.ceil(samples / BAND_FRAGMENTS))
        edges = np.linspace(top, bottom, bands + 1).astype(int).tolist()
        for low, high in itertools.pairwise(edges):
            band = (left, low, right, high)
            at = np.s_[..., low - y0 : high - y0, left - x0 : right - x0]
            radiance[at], alpha[at], coverage[at] = _draw(scene, look, of_part.inside(band), band, supersample)
    seconds = {"build": built - started, "render": time.perf_counter() - built}
    return RenderResult((x0, y0), camera.size_wh, radiance, alpha, coverage, ground_radiance(scene), seconds)


@dataclass(frozen=True, eq=False)
class _Surfaces:
    """Triangles of all objects in the image, with values at their corners.

    Attributes:
        xy: (T, 3, 2) corners, pixels.
        inverse_depth: (T, 3) 1 / depth of the corners.
        low: (T, 2) smallest of the corners, pixels.
        high: (T, 2) largest of the corners.
        object_number: (T,) object that the triangle belongs to.
        label: (T,) whether labels count it.
        ior: (T,) refractive index, from the side that the camera sees.
        values: (T, 3, 6) at the corners: temperature in degrees Celsius, emissivity, normal in camera axes, opacity.
    """

    xy: FloatArray
    inverse_depth: FloatArray
    low: FloatArray
    high: FloatArray
    object_number: NDArray[np.intp]
    label: NDArray[np.bool_]
    ior: FloatArray
    values: FloatArray

    def take(self, keep: NDArray[np.bool_]) -> _Surfaces:
        """Return the triangles with `keep` (T,) True."""
        return self if keep.all() else _Surfaces(*(getattr(self, f.name)[keep] for f in fields(self)))

    def inside(self, crop: Crop) -> _Surfaces:
        """Return the triangles that reach into a crop."""
        x0, y0, x1, y1 = crop
        left, top = self.low.T
        right, bottom = self.high.T
        return self.take((left < x1) & (top < y1) & (right > x0) & (bottom > y0))

    def area_px(self, crop: Crop) -> float:
        """Return about how many pixels all triangles cover in a crop."""
        a, b = self.xy[:, 1] - self.xy[:, 0], self.xy[:, 2] - self.xy[:, 0]
        area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
        width, height = (np.minimum(self.high, crop[2:]) - np.maximum(self.low, crop[:2])).T
        return float(np.minimum(area, width * height).sum())


def _surfaces(scene: PlacedScene) -> _Surfaces:
    found = [
        replace(of, object_number=np.full(len(of.xy), number))
        for number, of in enumerate(_surfaces_of(placed, scene.spec) for placed in scene.objects)
    ]
    if len(found) == 1:
        return found[0]
    return _Surfaces(*(np.concatenate([getattr(s, f.name) for s in found]) for f in fields(_Surfaces)))


# A frame is drawn again after faint objects have been moved; the surfaces of the others stay as they are.
_kept: WeakKeyDictionary[PlacedObject, tuple[tuple[float, int], _Surfaces]] = WeakKeyDictionary()


def _surfaces_of(placed: PlacedObject, spec: SceneSpec) -> _Surfaces:
    """Return the surfaces of one object, as number 0."""
    pattern = (spec.appearance.texture_k, spec.render_seed)
    known = _kept.get(placed)
    if known is None or known[0] != pattern:
        known = _kept[placed] = (pattern, _compute_surfaces(placed, spec))
    return known[1]


def _compute_surfaces(placed: PlacedObject, spec: SceneSpec) -> _Surfaces:
    mesh = placed.mesh
    camera = placed.camera
    given = {name: values.reshape(-1, 3) for name, values in surface_values(placed, spec).items()}
    vertices = camera.to_camera(placed.world_m)
    face, normals = corner_normals(vertices, mesh.triangles, mesh.smooth)
    behind = np.einsum("ij,ij->i", face, vertices[mesh.triangles[:, 0]]) > 0
    # The front of an opaque solid hides its back.
    states = [placed.spec.parts[name] for name in mesh.part_names]
    hidden = [n in mesh.closed_parts and s.opacity == 1 for n, s in zip(mesh.part_names, states, strict=True)]
    shown = np.flatnonzero(~(behind & np.array(hidden)[mesh.part_of_triangle]))
    values = np.ones((len(shown), 3, 6))
    for k, name in ((0, "temperature_c"), (1, "emissivity"), (5, "opacity")):
        if name in given:
            values[:, :, k] = given[name][shown]
    values[:, :, 2:5] = normals[shown]
    xy = placed.triangles.xy[shown]
    ior = np.maximum(given["ior"][shown, 0].astype(np.float64), 1e-5)
    if not is_two_sided(mesh):  # seen from behind, light enters from the denser side
        ior = np.where(behind[shown], 1 / ior, ior)
    return _Surfaces(
        xy,
        placed.triangles.inverse_depth[shown],
        *reach_of_triangles(xy),
        np.zeros(len(shown), np.intp),
        given["label"][shown, 0] > 0.5,
        ior,
        values,
    )


def _draw(
    scene: PlacedScene, look: ArtisticLook | PhysicalLook, surfaces: _Surfaces, crop: Crop, supersample: int
) -> tuple[Image32, Image32, Image32]:
    """Return radiance (h, w), alpha (h, w) and coverage (n, h, w) of a crop."""
    x0, y0, x1, y1 = crop
    w, h = x1 - x0, y1 - y0
    grid = SampleGrid.over_pixels((x0, y0), (w, h), supersample)
    opaque = (surfaces.values[:, :, 5] > _OPAQUE).all(axis=1)
    solid = fragments_of(surfaces.xy, surfaces.inverse_depth, grid, np.flatnonzero(opaque))
    solid, nearest = nearest_fragments(solid, grid)
    weight = np.ones(len(solid.index))
    if not opaque.all():
        thin = fragments_of(surfaces.xy, surfaces.inverse_depth, grid, np.flatnonzero(~opaque))
        thin = thin.take(np.flatnonzero(thin.inverse_depth > nearest[thin.index]))
        thin, of_thin, through = _veil(surfaces, thin, grid)
        weight = through[solid.index]
    runs = _runs(solid, weight, grid, supersample)
    pixels = w * h
    per_pixel = 1 / supersample**2

    def layer(at: NDArray[np.intp], values: FloatArray | None = None) -> FloatArray:
        """Return the mean over the samples of each pixel, (h, w)."""
        return np.asarray((np.bincount(at, values, pixels) * per_pixel).reshape(h, w), np.float64)

    def light(of: _Runs) -> FloatArray:
        """Return the light of runs, weighted."""
        return of.weight * look.light(_points(surfaces, of.middle, grid, scene.spec.camera))

    labelled = surfaces.label[runs.middle.triangle]
    number = surfaces.object_number[runs.middle.triangle]
    chosen = [labelled & (number == k) for k in range(len(scene.objects))]
    coverage = np.stack([layer(runs.pixel[c], runs.count[c]) for c in chosen])
    radiance = layer(runs.pixel, light(runs))
    alpha = layer(runs.pixel, runs.weight)
    if not opaque.all():
        runs = _runs(thin, of_thin, grid, supersample)
        radiance += layer(runs.pixel, light(runs))
        alpha += layer(runs.pixel, runs.weight)
    return radiance.astype(np.float32), np.minimum(alpha, 1).astype(np.float32), coverage.astype(np.float32)


def _veil(surfaces: _Surfaces, thin: Fragments, grid: SampleGrid) -> tuple[Fragments, FloatArray, FloatArray]:
    """Return translucent fragments, the share of light that each adds, and (rows * columns,) the share behind all."""
    thin = thin.take(np.lexsort((thin.triangle, -thin.inverse_depth, thin.index)))
    rows, columns = grid.shape_hw
    through = np.ones(rows * columns)
    share = np.zeros(len(thin.index))
    row, column = np.divmod(thin.index, columns)
    where = _Places(thin.triangle, column + 0.5, row + 0.5, thin.inverse_depth)
    opacity = np.clip(_values_at(surfaces, where, grid, slice(5, 6))[:, 0], 0, 1)
    # Number of each fragment within its sample, from the front.
    begin = np.flatnonzero(np.diff(thin.index, prepend=-1))
    depth = np.arange(len(thin.index)) - np.repeat(begin, np.diff(begin, append=len(thin.index)))
    for k in range(int(depth.max(initial=-1)) + 1):
        now = depth == k
        at = thin.index[now]
        share[now] = opacity[now] * through[at]
        through[at] *= 1 - opacity[now]
    return thin, share, through


@dataclass(frozen=True, eq=False)
class _Places:
    """Points on triangles, in the image.

    Attributes:
        triangle: The triangle.
        x: Position, in samples.
        y: The same.
        inverse_depth: 1 / depth there.
    """

    triangle: NDArray[np.intp]
    x: FloatArray
    y: FloatArray
    inverse_depth: FloatArray


@dataclass(frozen=True, eq=False)
class _Runs:
    """Samples of one triangle on one row of samples in one pixel; they are shaded together.

    Attributes:
        middle: Their mean.
        pixel: Flat index of the pixel.
        count: Number of samples.
        weight: Sum of the samples' shares of the light.
    """

    middle: _Places
    pixel: NDArray[np.intp]
    count: FloatArray
    weight: FloatArray


def _runs(fragments: Fragments, weight: FloatArray, grid: SampleGrid, supersample: int) -> _Runs:
    """Join fragments that are neighbours in order, on the same row, and in the same pixel."""
    columns = grid.shape_hw[1]
    # Numbers the pixel's width of samples on each row: a row has a whole number of them.
    block = fragments.index // supersample
    begin = np.flatnonzero((np.diff(block, prepend=-1) != 0) | (np.diff(fragments.triangle, prepend=-1) != 0))
    count = np.diff(begin, append=len(block)).astype(np.float64)

    def total(values: NDArray[Any]) -> FloatArray:
        return np.add.reduceat(values, begin) if len(begin) else np.zeros(0)

    row, across = np.divmod(block[begin], columns // supersample)
    x = total(fragments.index) / count - row * columns + 0.5
    middle = _Places(fragments.triangle[begin], x, row + 0.5, total(fragments.inverse_depth) / count)
    pixel = row // supersample * (columns // supersample) + across
    return _Runs(middle, pixel, count, total(weight))


def _points(surfaces: _Surfaces, at: _Places, grid: SampleGrid, camera: CameraSpec) -> Points:
    """Return what shading needs to know of points."""
    celsius, emissivity, *normal = _values_at(surfaces, at, grid, slice(0, 5)).T
    # From the camera to the surface, in its axes; the third component is 1.
    x0, y0 = grid.origin_xy
    pitch = grid.pitch_px
    x = (x0 + at.x * pitch - camera.size_wh[0] / 2) / camera.focal_px
    y = (y0 + at.y * pitch - camera.size_wh[1] / 2) / camera.focal_px
    distance = np.sqrt(x * x + y * y + 1)
    length = np.maximum(np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2), 1e-30)
    along = (normal[0] * x + normal[1] * y + normal[2]) / (length * distance)
    up = camera.world_to_camera[:, 2]
    normal_up = (normal[0] * up[0] + normal[1] * up[1] + normal[2] * up[2]) / length
    mirrored_up = (x * up[0] + y * up[1] + up[2]) / distance - 2 * along * normal_up
    ior = surfaces.ior[at.triangle]
    return Points(celsius, emissivity, ior, np.abs(along), np.where(along > 0, -normal_up, normal_up), mirrored_up)


def _values_at(surfaces: _Surfaces, at: _Places, grid: SampleGrid, channels: slice) -> FloatArray:
    """Return values (N, C) at points, interpolated between the corners in perspective."""
    seen = np.zeros(len(surfaces.xy), np.bool_)
    seen[at.triangle] = True
    number = (np.cumsum(seen) - 1)[at.triangle]
    # A value divided by depth is linear in the image.
    value = surfaces.values[seen, :, channels] * surfaces.inverse_depth[seen, :, None]
    a, b, c = np.moveaxis(grid.to_samples(surfaces.xy[seen])[:, :, :, None], 1, 0)
    ab = b - a
    ac = c - a
    value_ab = value[:, 1] - value[:, 0]
    value_ac = value[:, 2] - value[:, 0]
    twice_area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    scale = np.where(twice_area == 0, 0.0, 1 / np.where(twice_area == 0, 1.0, twice_area))
    slope_x = (value_ab * ac[:, 1] - value_ac * ab[:, 1]) * scale
    slope_y = (value_ac * ab[:, 0] - value_ab * ac[:, 0]) * scale
    base = value[:, 0] - slope_x * a[:, 0] - slope_y * a[:, 1]
    x = at.x[:, None]
    y = at.y[:, None]
    inverse_depth = at.inverse_depth[:, None]
    return np.asarray((base[number] + slope_x[number] * x + slope_y[number] * y) / inverse_depth)


def crop_of(scene: PlacedScene) -> Crop | None:
    """Return the smallest pixel rectangle x0, y0, x1, y1 that contains all objects in the frame; None if none is."""
    return _crop_around(scene.objects, scene.spec.camera.size_wh)


def crops_of(scene: PlacedScene) -> list[tuple[Crop, list[int]]]:
    """Return pixel rectangles that contain the objects in the frame, each with the numbers of its objects.

    They share no pixel. Rectangles are joined where empty pixels between them cost less than one rectangle more.
    """
    found: list[tuple[Crop, list[int]]] = []
    for k, placed in enumerate(scene.objects):
        crop = _crop_around([placed], scene.spec.camera.size_wh)
        group = [k]
        if crop is None:
            continue
        while near := next((f for f in found if _belong_together(f[0], crop)), None):
            found.remove(near)
            crop = _joined(near[0], crop)
            group = sorted([*near[1], *group])
        found.append((crop, group))
    return found


def _crop_around(objects: Sequence[PlacedObject], size_wh: tuple[int, int]) -> Crop | None:
    w, h = size_wh
    lows = []
    highs = []
    for placed in objects:
        xy = placed.xy
        depth = placed.depth_m
        if (depth <= 0.01).any():
            if (depth <= 0.01).all():
                continue
            return (0, 0, w, h)  # reaches behind the camera, so its outline is unbounded
        lows.append(xy.min(axis=0))
        highs.append(xy.max(axis=0))
    if not lows:
        return None
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    x0, y0 = (max(0, math.floor(v) - CROP_MARGIN_PX) for v in low)
    x1, y1 = min(w, math.ceil(high[0]) + CROP_MARGIN_PX), min(h, math.ceil(high[1]) + CROP_MARGIN_PX)
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None


def _joined(a: Crop, b: Crop) -> Crop:
    return min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])


def _belong_together(a: Crop, b: Crop) -> bool:
    overlap = a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
    both, one, other = ((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in (_joined(a, b), a, b))
    return overlap or both - one - other < CROP_COST_PX
