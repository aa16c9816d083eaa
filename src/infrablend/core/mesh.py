"""Triangle meshes with named parts, built by object models and drawn by every renderer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles in metres, Z up, in the object's own frame (its origin is the model's stated origin, +X its heading).

    Attributes:
        vertices_m: (V, 3) float64.
        triangles: (T, 3) int32 indices into `vertices_m`, counter-clockwise seen from outside.
        part_of_triangle: (T,) int32 indices into `part_names`.
        part_names: Names of the parts, each with a thermal role in the model's table.
        smooth: (T,) bool, True where shading interpolates normals.
        closed_parts: Parts that together are closed solids, where vertices at the same position count as one. Nobody
            sees their triangles from behind.
    """

    vertices_m: FloatArray
    triangles: IntArray
    part_of_triangle: IntArray
    part_names: tuple[str, ...]
    smooth: NDArray[np.bool_]
    closed_parts: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        v = self.vertices_m
        t = self.triangles
        if v.ndim != 2 or v.shape[1] != 3 or v.dtype != np.float64:
            raise ValueError(f"vertices_m must be (V, 3) float64, got {v.shape} {v.dtype}")
        if t.ndim != 2 or t.shape[1] != 3 or t.dtype != np.int32:
            raise ValueError(f"triangles must be (T, 3) int32, got {t.shape} {t.dtype}")
        if not len(t):
            raise ValueError("a mesh needs at least one triangle")
        if self.part_of_triangle.shape != (len(t),) or self.part_of_triangle.dtype != np.int32:
            raise ValueError(f"part_of_triangle must be ({len(t)},) int32, got {self.part_of_triangle.shape}")
        if self.smooth.shape != (len(t),) or self.smooth.dtype != np.bool_:
            raise ValueError(f"smooth must be ({len(t)},) bool, got {self.smooth.shape}")
        if t.min() < 0 or t.max() >= len(v):
            raise ValueError(f"triangle indices must lie in [0, {len(v)}), got [{t.min()}, {t.max()}]")
        if self.part_of_triangle.min() < 0 or self.part_of_triangle.max() >= len(self.part_names):
            raise ValueError("part_of_triangle points outside part_names")
        if not np.isfinite(v).all():
            raise ValueError("vertices_m holds NaN or infinity")
        for a in (v, t, self.part_of_triangle, self.smooth):
            a.setflags(write=False)

    @property
    def size_m(self) -> FloatArray:
        """Extent (3,) along x, y, z in metres."""
        return np.asarray(np.ptp(self.vertices_m, axis=0))


def make_mesh(pieces: Sequence[tuple[str, FloatArray, IntArray, bool]], *, closed: bool = False) -> Mesh:
    """Join pieces `(part name, vertices (v, 3), triangles (t, 3), smooth)` into one mesh; names may repeat.

    Vertices are not merged across pieces; `closed` says that the pieces are closed solids.
    """
    names = list(dict.fromkeys(p[0] for p in pieces))
    number = {name: n for n, name in enumerate(names)}
    corners = np.array([len(v) for _, v, _, _ in pieces])
    faces = [len(t) for _, _, t, _ in pieces]
    first = np.repeat(np.cumsum(corners) - corners, faces).astype(np.int32)
    return Mesh(
        np.concatenate([np.asarray(v, np.float64) for _, v, _, _ in pieces]),
        np.concatenate([np.asarray(t, np.int32) for _, _, t, _ in pieces]) + first[:, None],
        np.repeat(np.array([number[name] for name, _, _, _ in pieces], np.int32), faces),
        tuple(names),
        np.repeat(np.array([bool(is_smooth) for _, _, _, is_smooth in pieces]), faces),
        frozenset(names) if closed else frozenset(),
    )
