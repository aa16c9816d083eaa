"""Values of an object's surfaces at the corners of its faces; every renderer that interpolates them uses these.

Arrays have one value per face corner, (3T,), in the order of `mesh.triangles.ravel()`.

`ground_radiance` is the radiance of ground that objects warm, against which renderers measure its glow.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infrablend.core.mesh import FloatArray, IntArray, Mesh
from infrablend.core.render import PlacedObject, PlacedScene
from infrablend.core.scene import SceneSpec
from infrablend.thermal.radiometry import ZERO_C_K, band_radiance

_WAVES = np.array([[1.6, 0.7, 0.4], [-0.9, 1.7, 0.6], [0.5, -1.1, 2.0], [2.6, 1.9, -1.3]])


def is_two_sided(mesh: Mesh) -> bool:
    """Return whether the backs of faces look like their fronts: a mesh that is not known to consist of closed solids.

    A user's file may contain single sheets and faces that are wound the wrong way. The closed solids of shipped models
    hide their backs; only their translucent propeller discs show them, as the inside of a dense body.
    """
    return not mesh.closed_parts


def surface_values(placed: PlacedObject, scene: SceneSpec) -> dict[str, NDArray[np.float32]]:
    """Return `temperature_c`, `emissivity`, `ior` and `label` at the face corners of an object.

    In the physical look also `roughness` and `metal`; for objects with translucent parts also `opacity`.
    """
    spec = placed.spec
    mesh = placed.mesh
    states = [spec.parts[name] for name in mesh.part_names]
    temperature_c = np.array([s.temperature_k - ZERO_C_K for s in states])
    glow = np.repeat(np.array([s.glow for s in states])[mesh.part_of_triangle], 3)
    values = {
        "temperature_c": _corner_values(mesh, temperature_c, mesh.smooth)
        + np.where(glow, 0, _pattern(mesh, scene.appearance.texture_k, scene.render_seed)[mesh.triangles.ravel()])
        + placed.sun_rise_k.astype(np.float32),
        "emissivity": _corner_values(mesh, np.array([s.emissivity for s in states]), mesh.smooth),
        "ior": _corner_values(mesh, np.array([s.ior for s in states])),
        "label": _corner_values(mesh, np.array([float(s.label) for s in states])),
    }
    if scene.weather is not None:
        values["roughness"] = _corner_values(mesh, np.array([s.roughness for s in states]))
        values["metal"] = _corner_values(mesh, np.array([float(s.metal) for s in states]))
    opacity = np.array([s.opacity for s in states])
    if (opacity < 1).any():
        # Opacity is averaged among translucent parts only: labels count opaque parts in full.
        values["opacity"] = _corner_values(mesh, opacity, mesh.smooth & (opacity < 1)[mesh.part_of_triangle])
    return values


def corner_normals(
    vertices: FloatArray, triangles: IntArray, smooth: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the face normals (T, 3), and the normals at the face corners (T, 3, 3), that shading interpolates.

    As in Blender, the normal of a smooth corner is the mean of the smooth faces around its vertex, weighted by their
    angles there. Faces without area have a normal of zero.
    """
    near_zero = np.ascontiguousarray((vertices - vertices[0]).T, np.float32)
    corner = np.ascontiguousarray(triangles.T)
    # Edges from corner 0 to 1, 1 to 2, and 2 to 0: (3, T) for each axis.
    x, y, z = (np.stack((p[1] - p[0], p[2] - p[1], p[0] - p[2])) for p in (axis[corner] for axis in near_zero))
    face = _unit(np.stack((y[2] * z[0] - z[2] * y[0], z[2] * x[0] - x[2] * z[0], x[2] * y[0] - y[2] * x[0])))
    if not smooth.any():
        return face.T, np.repeat(face.T[:, None], 3, axis=1)
    edges = _unit(np.stack((x, y, z)))
    x, y, z = edges * np.roll(edges, 1, axis=1)
    angles = np.arccos(np.clip(-(x + y + z), -1, 1)) * smooth
    sums = [np.bincount(corner.ravel(), (axis * angles).ravel(), len(vertices)) for axis in face]
    of_vertices = _unit(np.stack(sums).astype(np.float32)).T
    return face.T, np.where(smooth[:, None, None], of_vertices[triangles], face.T[:, None])


def _unit(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return vectors (3, ...) of length 1; zeros stay zeros."""
    length = np.sqrt(vectors[0] * vectors[0] + vectors[1] * vectors[1] + vectors[2] * vectors[2])
    return np.asarray(vectors / np.maximum(length, np.float32(1e-30)))


def _corner_values(mesh: Mesh, of_part: FloatArray, blend: NDArray[np.bool_] | None = None) -> NDArray[np.float32]:
    """Return the (3T,) value per face corner, averaged over the triangles `blend` (T,) that share a vertex.

    Averaging blends neighbouring parts of one skin (flank, leg) into each other. Parts that are separate bodies share
    no vertices and stay sharp.
    """
    per_triangle = of_part[mesh.part_of_triangle]
    corners = np.repeat(per_triangle, 3)
    if blend is not None and blend.any():
        smooth = np.repeat(blend, 3)
        at = mesh.triangles.ravel()[smooth]
        size = len(mesh.vertices_m)
        total = np.bincount(at, corners[smooth], size)
        number = np.bincount(at, minlength=size)
        corners[smooth] = (total / np.maximum(number, 1))[at]
    return corners.astype(np.float32)


def _pattern(mesh: Mesh, amplitude_k: float, seed: int) -> NDArray[np.float32]:
    """Return a (V,) temperature pattern in [-amplitude, amplitude] that varies slowly over the body.

    No real surface has a uniform temperature. The pattern is a mean of plane waves of about half the body's length, in
    object coordinates, with phases from the scene's seed.
    """
    phase = np.random.Generator(np.random.PCG64(seed)).uniform(0, 2 * np.pi, len(_WAVES))
    extent = max(float(mesh.size_m.max()), 1e-9)
    waves = np.cos(mesh.vertices_m @ (_WAVES.T * (2 * np.pi / extent)) + phase)
    return np.asarray(amplitude_k * waves.mean(axis=1), np.float32)


def ground_radiance(scene: PlacedScene) -> float | None:
    """Return the radiance of ground at air temperature if all translucent parts of the scene are ground that glows.

    None if there is no such part, or if the scene has other parts without a label: a render does not separate them.
    """
    weather = scene.spec.weather
    unlabelled = [s for o in scene.objects for n in o.mesh.part_names if not (s := o.spec.parts[n]).label]
    separable = bool(unlabelled) and all(s.glow for s in unlabelled)
    if weather is None or not separable:
        return None
    return float(band_radiance(weather.air_k))
