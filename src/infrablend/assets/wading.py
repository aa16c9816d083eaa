"""People in water: what is above its surface, which is the model's ground.

Water is opaque in the thermal band within a tenth of a millimetre, so that nothing below the surface is seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from infrablend.assets.anatomy import Piece
from infrablend.core.mesh import FloatArray, IntArray

_APART = 1e-6  # share of the piece's height: no vertex may be nearer to the surface


def above_water(piece: Piece, level: float) -> Piece:
    """Return what closed surfaces have above a height, closed there, with the height as the new zero.

    Raises:
        ValueError: Nothing of the piece is above the height.
    """
    vertices, triangles, parts = piece
    z = vertices[:, 2] - level
    nearest = _APART * float(np.ptp(z))
    z = np.where(np.abs(z) < nearest, nearest, z)
    v = np.column_stack([vertices[:, :2], z])
    above = z[triangles] > 0
    count = above.sum(axis=1)
    if not count.any():
        raise ValueError(f"all of the piece is below {level:g}; expected some above")
    crossings = _Crossings(v)
    rim: dict[int, tuple[int, int]] = {}  # start of an edge on the surface -> its end and part, as the caps run
    cut: list[tuple[int, int, int]] = []
    own: list[int] = []
    crossed = (count > 0) & (count < 3)
    for t, up, part in zip(triangles[crossed], above[crossed], parts[crossed], strict=True):
        lone = int(np.argmax(up if up.sum() == 1 else ~up))
        a, b, c = (int(t[(lone + k) % 3]) for k in range(3))
        ab, ca = crossings.between(a, b), crossings.between(c, a)
        if up.sum() == 1:
            cut.append((a, ab, ca))
            rim[ca] = (ab, int(part))
            own.append(int(part))
        else:
            cut += [(ab, b, c), (ab, c, ca)]
            rim[ab] = (ca, int(part))
            own += [int(part)] * 2
    caps, of_caps = _caps(rim, crossings)
    corners = np.concatenate([triangles[count == 3], np.array(cut + caps, np.int32).reshape(-1, 3)])
    numbers = np.concatenate([parts[count == 3], np.array(own + of_caps, np.int32)])
    everything = np.concatenate([v, np.array(crossings.new).reshape(-1, 3)])
    return _compact(everything, corners, numbers)


class _Crossings:
    """New vertices where edges cross the surface, at height 0. Their numbers follow those of the given vertices."""

    def __init__(self, vertices: FloatArray) -> None:
        self.new: list[FloatArray] = []
        self._vertices = vertices
        # Vertices are doubled at sharp edges: the same position is one corner of the rim.
        _, same = np.unique(vertices, axis=0, return_inverse=True)
        self._same = same.reshape(-1)
        self._of_edge: dict[tuple[int, int], int] = {}

    def between(self, a: int, b: int) -> int:
        """Return the vertex on the surface between two vertices, the same for both triangles of an edge."""
        upper, lower = (a, b) if self._vertices[a, 2] > 0 else (b, a)
        edge = int(self._same[upper]), int(self._same[lower])
        if edge not in self._of_edge:
            p, q = self._vertices[upper], self._vertices[lower]
            point = p + p[2] / (p[2] - q[2]) * (q - p)
            point[2] = 0.0
            self._of_edge[edge] = self._add(point)
        return self._of_edge[edge]

    def add_middle(self, loop: Sequence[int]) -> int:
        """Add the middle of new vertices, and return its number."""
        return self._add(np.mean([self.new[k - len(self._vertices)] for k in loop], axis=0))

    def _add(self, point: FloatArray) -> int:
        self.new.append(point)
        return len(self._vertices) + len(self.new) - 1


def _caps(rim: Mapping[int, tuple[int, int]], crossings: _Crossings) -> tuple[list[tuple[int, int, int]], list[int]]:
    """Return triangles that close each loop of the rim from below, and their parts; adds the middles of the loops."""
    caps: list[tuple[int, int, int]] = []
    parts: list[int] = []
    left = dict(rim)
    while left:
        start = next(iter(left))
        loop = []
        at = start
        while at in left:
            end, part = left.pop(at)
            loop.append((at, end, part))
            at = end
        middle = crossings.add_middle([a for a, _, _ in loop])
        caps += [(a, b, middle) for a, b, _ in loop]
        parts += [part for _, _, part in loop]
    return caps, parts


def _compact(vertices: FloatArray, triangles: IntArray, parts: NDArray[np.int32]) -> Piece:
    """Return a piece without the vertices that no triangle uses."""
    used, index = np.unique(triangles, return_inverse=True)
    return vertices[used], index.reshape(-1, 3).astype(np.int32), parts.astype(np.int32)
