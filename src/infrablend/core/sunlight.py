"""Sunlight on a mesh: irradiance of its surface by orientation, with the shadows that the mesh casts on itself.

Shadows come from a depth map along the sun's rays: points spread over all triangles, on a grid at right angles to the
rays. It needs no ray tracer, and gives the same figures with every renderer.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from infrablend.core.mesh import FloatArray, Mesh
from infrablend.core.scene import Sun

# Share of the sunlight that the ground reflects: 0.1 (asphalt) to 0.25 (dry grass).
GROUND_ALBEDO = 0.2
# Cells of the depth map along the object's diagonal. A cell of a person is 3 cm wide, of a car 8 cm.
_CELLS = 64
# A point is in the shadow of surfaces that are this many cells nearer to the sun than itself, looked up this many cells
# outside its own surface, which would else shade itself where the rays graze it.
_BIAS_CELLS = 1.5
_OUTWARD_CELLS = 1.5


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
    at, weight = triangles.ravel(), np.repeat(faces, 3, axis=0)
    return _unit(np.stack([np.bincount(at, weight[:, k], count) for k in range(3)], axis=1))


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12))


def _sunlit(world_m: FloatArray, normals: FloatArray, triangles: NDArray[np.int32], toward: FloatArray) -> FloatArray:
    """Return the (V,) share of the sun's rays that reach each vertex past the triangles."""
    side = np.cross(toward, (0.0, 0.0, 1.0) if abs(toward[2]) < 0.99 else (1.0, 0.0, 0.0))
    side /= np.linalg.norm(side)
    axes = np.stack([side, np.cross(toward, side), toward], axis=1)
    local = world_m @ axes
    low, extent = local.min(axis=0)[:2], np.ptp(local[:, :2], axis=0)
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
    edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
    steps = np.minimum(np.ceil(edges / spacing), 64).astype(np.intp)
    found = [corners.mean(axis=1)]
    for n in np.unique(steps[steps > 1]):
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        inside = i + j <= n
        a, b = i[inside] / n, j[inside] / n
        weight = np.stack([1 - a - b, a, b], axis=1)
        found.append(np.einsum("pk,tkc->tpc", weight, corners[steps == n]).reshape(-1, 3))
    return np.concatenate(found)
