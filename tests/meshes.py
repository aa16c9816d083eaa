"""Mesh measures shared by tests."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from infrablend.core.mesh import FloatArray, IntArray, Mesh


def signed_volume(vertices: FloatArray, triangles: IntArray) -> float:
    """Return the enclosed volume; negative if the triangles run clockwise seen from outside."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def areas(mesh: Mesh) -> FloatArray:
    """Return the (T,) areas of a mesh's triangles, m²."""
    a, b, c = (mesh.vertices_m[mesh.triangles[:, i]] for i in range(3))
    found: FloatArray = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return found


def vertices_of(mesh: Mesh, *parts: str) -> FloatArray:
    """Return the (V, 3) vertices of some parts of a mesh."""
    wanted = [i for i, name in enumerate(mesh.part_names) if name in parts]
    return mesh.vertices_m[np.unique(mesh.triangles[np.isin(mesh.part_of_triangle, wanted)])]


def digest(mesh: Mesh) -> tuple[bytes, ...]:
    """Return all bytes of a mesh: equal for equal meshes."""
    return (
        mesh.vertices_m.tobytes(),
        mesh.triangles.tobytes(),
        mesh.part_of_triangle.tobytes(),
        mesh.smooth.tobytes(),
        repr(mesh.part_names).encode(),
    )


def check_surface(mesh: Mesh, triangles: IntArray | None = None) -> None:
    """Check that a mesh, or some of its triangles, consists of closed solids that each face outward."""
    triangles = mesh.triangles if triangles is None else triangles
    # Vertices are doubled at sharp edges: closed by position.
    _, same = np.unique(mesh.vertices_m + 0.0, axis=0, return_inverse=True)
    welded = same.reshape(-1)[triangles].astype(np.int64)
    a, b = welded.ravel(), np.roll(welded, -1, axis=1).ravel()
    edge, size = a != b, int(welded.max()) + 1
    assert np.array_equal(np.sort((a * size + b)[edge]), np.sort((b * size + a)[edge]))
    count, solid = connected_components(coo_matrix((np.ones(len(a)), (a, b)), shape=(size, size)), directed=False)
    p, of_triangle = mesh.vertices_m[triangles], solid[welded[:, 0]]
    volume = np.bincount(of_triangle, np.einsum("ij,ij->i", p[:, 0], np.cross(p[:, 1], p[:, 2])), count)
    assert (volume[np.unique(of_triangle)] > 0).all()


def check_pieces(pieces: Sequence[tuple[Any, Any, Any, Any]]) -> None:
    """Check that every piece is a closed surface that faces outward."""
    for part, vertices, triangles, _ in pieces:
        # Vertices are doubled at sharp edges: a piece is closed by position.
        _, index = np.unique(vertices, axis=0, return_inverse=True)
        t = index.reshape(-1)[triangles]
        edges = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
        key, back = edges[:, 0] * 10**6 + edges[:, 1], edges[:, 1] * 10**6 + edges[:, 0]
        assert (edges[:, 0] != edges[:, 1]).all(), part
        assert len(np.unique(key)) == len(key), part
        assert np.array_equal(np.sort(key), np.sort(back)), part
        assert signed_volume(vertices, triangles) > 0, part


def share_inside(mesh: Mesh, part: str, others: Sequence[str]) -> float:
    """Return the share of a part's vertices inside other parts, which together are closed: by their winding number."""
    points = vertices_of(mesh, part)[::5]
    wanted = [i for i, name in enumerate(mesh.part_names) if name in others]
    t = mesh.triangles[np.isin(mesh.part_of_triangle, wanted)]
    count = 0
    for chunk in np.array_split(points, len(points) // 64 + 1):
        a, b, c = (mesh.vertices_m[t[:, k]][None] - chunk[:, None] for k in range(3))
        la, lb, lc = (np.linalg.norm(x, axis=2) for x in (a, b, c))
        ab, bc, ca = ((p * q).sum(axis=2) for p, q in ((a, b), (b, c), (c, a)))
        angle = 2.0 * np.arctan2((a * np.cross(b, c)).sum(axis=2), la * lb * lc + ab * lc + bc * la + ca * lb)
        count += int((angle.sum(axis=1) > 2 * np.pi).sum())
    return count / len(points)
