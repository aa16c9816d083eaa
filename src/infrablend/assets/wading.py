"""People in water: what is above its surface, which is the model's ground.

Water is opaque in the thermal band within a tenth of a millimetre, so that nothing below the surface is seen.
"""

from __future__ import annotations

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
    corners: list[IntArray] = [triangles[count == 3]]
    numbers: list[IntArray] = [parts[count == 3]]
    # Vertices are doubled at sharp edges: the same position is one corner of the rim.
    _, same = np.unique(v, axis=0, return_inverse=True)
    same = same.reshape(-1)
    edges: dict[tuple[int, int], int] = {}
    new: list[FloatArray] = []

    def crossing(a: int, b: int) -> int:
        """Return the vertex on the surface between two vertices, the same for both triangles of an edge."""
        upper, lower = (a, b) if z[a] > 0 else (b, a)
        key = int(same[upper]), int(same[lower])
        if key not in edges:
            p, q = v[upper], v[lower]
            edges[key] = len(v) + len(new)
            new.append(p + p[2] / (p[2] - q[2]) * (q - p))
            new[-1][2] = 0.0
        return edges[key]

    rim: dict[int, tuple[int, int]] = {}  # start of an edge on the surface -> its end and part, as the caps run
    cut: list[tuple[int, int, int]] = []
    own: list[int] = []
    crossed = (count > 0) & (count < 3)
    for t, up, part in zip(triangles[crossed], above[crossed], parts[crossed], strict=True):
        lone = int(np.argmax(up if up.sum() == 1 else ~up))
        a, b, c = (int(t[(lone + k) % 3]) for k in range(3))
        ab, ca = crossing(a, b), crossing(c, a)
        if up.sum() == 1:
            cut.append((a, ab, ca))
            rim[ca] = (ab, int(part))
            own.append(int(part))
        else:
            cut += [(ab, b, c), (ab, c, ca)]
            rim[ab] = (ca, int(part))
            own += [int(part)] * 2
    caps, of_caps = _caps(rim, v, new)
    corners.append(np.array(cut + caps, np.int32).reshape(-1, 3))
    numbers.append(np.array(own + of_caps, np.int32))
    everything = np.concatenate([v, np.array(new).reshape(-1, 3)])
    return _compact(everything, np.concatenate(corners), np.concatenate(numbers))


def _caps(
    rim: dict[int, tuple[int, int]], v: FloatArray, new: list[FloatArray]
) -> tuple[list[tuple[int, int, int]], list[int]]:
    """Return triangles that close each loop of the rim from below, and their parts; adds their middles to `new`."""
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
        middle = len(v) + len(new)
        new.append(np.mean([new[a - len(v)] for a, _, _ in loop], axis=0))
        caps += [(a, b, middle) for a, b, _ in loop]
        parts += [part for _, _, part in loop]
    return caps, parts


def _compact(vertices: FloatArray, triangles: IntArray, parts: NDArray[np.int32]) -> Piece:
    """Return a piece without the vertices that no triangle uses."""
    used, index = np.unique(triangles, return_inverse=True)
    return vertices[used], index.reshape(-1, 3).astype(np.int32), parts.astype(np.int32)
