"""The interface of renderers: from a placed scene to radiance, alpha and coverage per object.

A placed scene has everything that a renderer needs, with no random choice left.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import box_of_points
from infrablend.core.camera import CameraSpec, object_to_world
from infrablend.core.mesh import FloatArray, Mesh
from infrablend.core.raster import NEAR_M, BoolArray, ProjectedTriangles, project_triangles
from infrablend.core.scene import ObjectSpec, SceneSpec, Sun

# Share of the sunlight that the ground reflects: 0.1 (asphalt) to 0.25 (dry grass).
GROUND_ALBEDO = 0.2
# Cells of the depth map along the object's diagonal. A cell of a person is 3 cm wide, of a car 8 cm.
_CELLS = 64
# A point is in the shadow of surfaces that are this many cells nearer to the sun than itself, looked up this many cells
# outside its own surface, which would else shade itself where the rays graze it.
_BIAS_CELLS = 1.5
_OUTWARD_CELLS = 1.5


@dataclass(frozen=True, eq=False)
class PlacedObject:
    """One object at its place, as its frame's camera sees it. Geometry is computed on first use and then kept.

    Attributes:
        spec: The object's place, size and part states.
        mesh: Geometry in object coordinates, unscaled.
        camera: The frame's camera.
        sun: The frame's sun; None without one.
    """

    spec: ObjectSpec
    mesh: Mesh
    camera: CameraSpec
    sun: Sun | None = None

    @cached_property
    def world_m(self) -> FloatArray:
        """(V, 3) vertices in the world, metres."""
        o = self.spec
        return object_to_world(self.mesh.vertices_m, o.position_m, o.yaw_rad, o.scale)

    @cached_property
    def _projected(self) -> tuple[FloatArray, FloatArray]:
        return self.camera.project(self.world_m)

    @property
    def xy(self) -> FloatArray:
        """(V, 2) vertices in the image, pixels; NaN behind the camera."""
        return self._projected[0]

    @property
    def depth_m(self) -> FloatArray:
        """(V,) depth of the vertices; negative behind the camera."""
        return self._projected[1]

    @cached_property
    def box_xyxy(self) -> FloatArray:
        """(4,) box around all vertices in front of the camera; may reach outside the frame."""
        return np.concatenate([np.nanmin(self.xy, axis=0), np.nanmax(self.xy, axis=0)])

    @property
    def range_m(self) -> float:
        """Distance from the camera to the object's origin."""
        return float(np.linalg.norm(np.asarray(self.spec.position_m) - self.camera.position_m))

    @cached_property
    def triangles(self) -> ProjectedTriangles:
        """All triangles in the image, cut at the near plane; `source` indexes `mesh.triangles`."""
        return project_triangles(self.camera, self.world_m, self.mesh.triangles)

    def triangles_of(self, chosen: BoolArray) -> ProjectedTriangles:
        """Return the projected triangles among those with `chosen` (T,) True.

        `cut` of the result is True if a chosen triangle crosses the near plane; the others do not matter.
        """
        pieces = self.triangles
        keep = chosen[pieces.source]
        near = pieces.cut and bool((self.depth_m[self.mesh.triangles[chosen]] < NEAR_M).any())
        return ProjectedTriangles(pieces.xy[keep], pieces.inverse_depth[keep], pieces.source[keep], near)

    @cached_property
    def sun_rise_k(self) -> FloatArray:
        """(3T,) rise of the temperature at the face corners by the sun, kelvin; 0 without a sun."""
        states = [self.spec.parts[name] for name in self.mesh.part_names]
        gain = np.array([s.sun_k for s in states])[self.mesh.part_of_triangle]
        if self.sun is None or not gain.any():
            return np.zeros(3 * len(gain))
        opaque = np.array([s.opacity == 1 for s in states])[self.mesh.part_of_triangle]
        sun = replace(self.sun, direct_w_m2=0.0) if self.spec.shaded else self.sun
        return np.repeat(gain, 3) * surface_irradiance(self.mesh, self.world_m, sun, opaque) / 1000

    @cached_property
    def part_sun_rise_k(self) -> Mapping[str, float]:
        """Mean rise of each part by the sun, kelvin, over its area that faces the camera."""
        number = self.mesh.part_of_triangle
        area = self._facing_px2
        rise = self.sun_rise_k.reshape(-1, 3).mean(axis=1)
        count = len(self.mesh.part_names)
        mean = np.bincount(number, area * rise, count) / np.maximum(np.bincount(number, area, count), 1e-12)
        return dict(zip(self.mesh.part_names, mean.tolist(), strict=True))

    @cached_property
    def part_sun_range_k(self) -> Mapping[str, tuple[float, float]]:
        """Smallest and largest rise of each part by the sun, kelvin, over its faces towards the camera."""
        facing = self._facing_px2 > 0
        rise = self.sun_rise_k.reshape(-1, 3).mean(axis=1)[facing]
        number = self.mesh.part_of_triangle[facing]
        found = {}
        for k, name in enumerate(self.mesh.part_names):
            own = rise[number == k]
            found[name] = (float(own.min()), float(own.max())) if own.size else (0.0, 0.0)
        return found

    @cached_property
    def part_areas_px(self) -> Mapping[str, float]:
        """Area of each part that faces the camera, px²; parts hidden behind others count in full."""
        mesh = self.mesh
        areas = np.bincount(mesh.part_of_triangle, self._facing_px2, len(mesh.part_names))
        return dict(zip(mesh.part_names, areas.tolist(), strict=True))

    @cached_property
    def _facing_px2(self) -> FloatArray:
        """(T,) area of the triangles that face the camera, px²; 0 for the others."""
        triangles = self.mesh.triangles
        corners = self.xy[triangles]
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        # Faces are counter-clockwise from outside; with y down they become clockwise, so their area is negative.
        ahead = (self.depth_m[triangles] > 0).all(axis=1)
        return np.where(ahead, np.maximum(b[:, 0] * a[:, 1] - a[:, 0] * b[:, 1], 0), 0) / 2


@dataclass(frozen=True, eq=False)
class PlacedScene:
    """A scene together with the geometry of its objects; `place` makes one.

    Attributes:
        spec: The scene.
        objects: One per object of the scene, in the same order.
    """

    spec: SceneSpec
    objects: tuple[PlacedObject, ...]

    def without(self, numbers: Collection[int], reason: str) -> PlacedScene:
        """Return the scene without some of its objects, counted in its draws as absent for `reason`."""
        keep = [k for k in range(len(self.objects)) if k not in set(numbers)]
        return PlacedScene(self.spec.without(numbers, reason), tuple(self.objects[k] for k in keep))


def place(spec: SceneSpec, meshes: Sequence[Mesh]) -> PlacedScene:
    """Place the meshes (object coordinates, unscaled) of a scene's objects; a `ValueError` if their numbers differ."""
    n = len(spec.objects)
    if len(meshes) != n:
        raise ValueError(f"{spec.frame_id}: {n} objects need {n} meshes, got {len(meshes)}")
    sun = None if spec.weather is None else spec.weather.sun
    pairs = zip(spec.objects, meshes, strict=True)
    return PlacedScene(spec, tuple(PlacedObject(o, m, spec.camera, sun) for o, m in pairs))


def sun_direction(sun: Sun) -> FloatArray:
    """Return the (3,) unit vector towards the sun in the world."""
    level = math.cos(sun.elevation_rad)
    return np.array([level * math.cos(sun.azimuth_rad), level * math.sin(sun.azimuth_rad), math.sin(sun.elevation_rad)])


def surface_irradiance(mesh: Mesh, world_m: FloatArray, sun: Sun, casts: NDArray[np.bool_]) -> FloatArray:
    """Return the (3T,) irradiance of the face corners, W m^-2: direct, scattered by the sky, reflected by the ground.

    Args:
        mesh: The mesh.
        world_m: (V, 3) its vertices in the world.
        sun: The sun.
        casts: (T,) triangles that cast shadows; translucent ones do not.
    """
    toward = sun_direction(sun)
    faces = _face_vectors(mesh, world_m)
    of_vertices = _vertex_normals(mesh.triangles, faces, len(world_m))
    smooth = np.repeat(mesh.smooth, 3)
    among_smooth = of_vertices
    if mesh.smooth.any() and not mesh.smooth.all():
        among_smooth = _vertex_normals(mesh.triangles[mesh.smooth], faces[mesh.smooth], len(world_m))
    normals = np.where(smooth[:, None], among_smooth[mesh.triangles.ravel()], np.repeat(_unit(faces), 3, axis=0))
    direct = sun.direct_w_m2 * np.maximum(normals @ toward, 0)
    if casts.any() and sun.direct_w_m2 > 0:
        lit = _sunlit(world_m, of_vertices, mesh.triangles[casts], toward)
        direct *= lit[mesh.triangles.ravel()]
    up = normals[:, 2]
    level = sun.direct_w_m2 * max(toward[2], 0.0) + sun.diffuse_w_m2
    return np.asarray(direct + sun.diffuse_w_m2 * (1 + up) / 2 + GROUND_ALBEDO * level * (1 - up) / 2)


def _face_vectors(mesh: Mesh, world_m: FloatArray) -> FloatArray:
    """Return the (T, 3) normals of the faces, as long as twice their area."""
    corners = world_m[mesh.triangles]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _vertex_normals(triangles: NDArray[np.int32], faces: FloatArray, count: int) -> FloatArray:
    """Return the (V, 3) unit normals of the vertices: the mean of their faces, weighted by area."""
    at = triangles.ravel()
    weight = np.repeat(faces, 3, axis=0)
    return _unit(np.stack([np.bincount(at, weight[:, k], count) for k in range(3)], axis=1))


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12))


def _sunlit(world_m: FloatArray, normals: FloatArray, triangles: NDArray[np.int32], toward: FloatArray) -> FloatArray:
    """Return the (V,) share of the sun's rays that reach each vertex past the triangles."""
    side = np.cross(toward, (0.0, 0.0, 1.0) if abs(toward[2]) < 0.99 else (1.0, 0.0, 0.0))
    side /= np.linalg.norm(side)
    axes = np.stack([side, np.cross(toward, side), toward], axis=1)
    local = world_m @ axes
    box = box_of_points(local)
    low = box[:2]
    extent = box[2:] - box[:2]
    cell = max(float(np.linalg.norm(extent)) / _CELLS, 1e-6)
    points = _spread(local[triangles], cell)
    # A margin of four cells around, for what is looked up beside the object.
    columns, rows = (int(v) + 9 for v in extent / cell)
    at = ((points[:, :2] - low) / cell).astype(np.intp) + 4
    nearest = np.full(columns * rows, -np.inf)
    np.maximum.at(nearest, at[:, 1] * columns + at[:, 0], points[:, 2])
    depth = nearest.reshape(rows, columns)
    outside = local + _OUTWARD_CELLS * cell * (normals @ axes)
    at = np.floor((outside[:, :2] - low) / cell).astype(np.intp) + 4
    share = np.zeros(len(local))
    # Nine cells around the point; their mean is a soft edge.
    for row in (-1, 0, 1):
        for column in (-1, 0, 1):
            share += depth[at[:, 1] + row, at[:, 0] + column] <= outside[:, 2] + _BIAS_CELLS * cell
    return np.asarray(share / 9)


def _spread(corners: FloatArray, spacing: float) -> FloatArray:
    """Return (N, 3) points spread over triangles (T, 3, 3), no farther apart than about `spacing`."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = (np.einsum("tc,tc->t", edge, edge) for edge in (a - b, b - c, c - a))
    longest = np.sqrt(np.maximum(np.maximum(ab, bc), ca))
    steps = np.minimum(np.ceil(longest / spacing), 64).astype(np.intp)
    found = [(a + b + c) / 3]
    for n in np.unique(steps[steps > 1]):
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        inside = i + j <= n
        of_b, of_c = i[inside] / n, j[inside] / n
        weight = np.stack([1 - of_b - of_c, of_b, of_c], axis=1)
        found.append((weight @ corners[steps == n].transpose(1, 0, 2).reshape(3, -1)).reshape(-1, 3))
    return np.concatenate(found)


Image32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class RenderResult:
    """A rendered scene, cropped to its objects. Linear, float32, with a box filter of one pixel.

    Attributes:
        offset_xy: Column and row of the crop's top left pixel in the frame.
        frame_wh: Size of the whole frame.
        radiance: (h, w) radiance premultiplied by alpha: `radiance + (1 - alpha) * background` is the picture.
        alpha: (h, w) share of the pixel covered by objects, in [0, 1].
        coverage: (n, h, w) share of the pixel in which labelled parts of object k are the nearest surface.
        ground_radiance: Radiance of ground at air temperature if the translucent parts are ground that objects warm
            (`PartState.glow`): what exceeds it is added to the background. None if translucent parts cover it.
        seconds: Time spent per step, for the run record; never part of any output that must repeat.
    """

    offset_xy: tuple[int, int]
    frame_wh: tuple[int, int]
    radiance: Image32
    alpha: Image32
    coverage: Image32
    ground_radiance: float | None = None
    seconds: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.radiance.shape != self.alpha.shape or self.radiance.ndim != 2:
            raise ValueError(f"radiance {self.radiance.shape} and alpha {self.alpha.shape} must be one (h, w)")
        if self.coverage.ndim != 3 or self.coverage.shape[1:] != self.alpha.shape:
            raise ValueError(f"coverage must be (n, {self.alpha.shape}), got {self.coverage.shape}")
        for a in (self.radiance, self.alpha, self.coverage):
            if a.dtype != np.float32:
                raise ValueError(f"render arrays must be float32, got {a.dtype}")
            a.setflags(write=False)


def empty_result(frame_wh: tuple[int, int], objects: int) -> RenderResult:
    """Return the result of a scene of which nothing is in the frame: a crop without pixels."""
    nothing = np.zeros((0, 0), np.float32)
    return RenderResult((0, 0), frame_wh, nothing, nothing.copy(), np.zeros((objects, 0, 0), np.float32))


class Renderer(Protocol):
    """A renderer of scenes. One per process; not thread-safe."""

    def start(self) -> None:
        """Start, without waiting for it, what scenes need that this process cannot draw alone.

        Raises:
            MissingDependencyError: It is not there.
        """
        ...

    def render(self, scene: PlacedScene) -> RenderResult:
        """Render a scene, cropped to what its objects cover.

        Raises:
            RenderError: The renderer fails.
            MissingDependencyError: The scene needs a program or device that is not there.
        """
        ...

    def close(self) -> None:
        """Release everything the renderer holds."""
        ...
