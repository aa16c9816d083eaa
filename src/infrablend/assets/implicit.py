"""Implicit surfaces: organic bodies from signed distances of tubes and ellipsoids, smoothly joined and triangulated.

A body consists of primitives whose approximate signed distances are joined by a smooth minimum. Surface nets extract
its surface: one vertex per sheet in each crossed cell and one quad per crossed grid edge (after Gibson, "Constrained
elastic surface nets", 1998). Distances are evaluated on a coarse grid first and refined only in blocks that the surface
may cross, and within a block only for the primitives that reach it. All lengths share one unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infrablend.core.mesh import FloatArray, IntArray

BLOCK = 4  # grid nodes per side of a block of the coarse grid
FAR = 1e3
AT_ONCE = 2048  # points whose arrays stay in the processor's cache
_ATTEMPTS = 8  # positions of the grid that are tried


@dataclass(frozen=True, eq=False)
class Tube:
    """A bar along a path with elliptic sections and domed ends.

    Attributes:
        part: Name of the part.
        path: (P, 3) points.
        half_width: (P,) half extent of the sections along `side`.
        half_height: (P,) half extent perpendicular to `side`.
        side: (3,) direction of the width; only its component perpendicular to the path counts.
        blend: Width of the smooth joint.
        caps: Lengths of the domes at the start and at the end.
        beyond: (position, part) pairs in rising order: from this position along the path, in [0, P - 1], the surface
            belongs to another part.
    """

    part: str
    path: FloatArray
    half_width: FloatArray
    half_height: FloatArray
    side: FloatArray
    blend: float
    caps: tuple[float, float]
    beyond: tuple[tuple[float, str], ...] = ()

    def coordinates(self, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return the position of (N, 3) points relative to the tube, and their distance, each (N,).

        Returns:
            `along` in [0, P - 1] (index on the path), `across` along the side and `above` along (direction of the
            path) x side, both -1 and 1 on the surface, and the signed distance.
        """
        (start, step, sides, heights), (length2, of_start, of_step, of_sides, of_heights) = self._segments
        count = len(step)
        xyz = points.T
        # |point|^2 is left out of the squared distances, as it is equal for all segments; the rest is products.
        run = step @ xyz - of_step
        t = np.clip(run / length2, 0.0, 1.0)
        d2 = t * (t * length2 - 2.0 * run) - 2.0 * (start @ xyz) + of_start
        # Outside a kink two segments are equally near: the first counts, whatever the rounding.
        index = (d2 + 1e-12 * np.arange(count)[:, None]).argmin(axis=0)
        nearest = index * len(points) + np.arange(len(points))
        share = t.ravel()[nearest]
        along = index + share
        w, h = (of[index] + share * (of[1:] - of[:-1])[index] for of in (self.half_width, self.half_height))
        # Sides and heights are at right angles to the segment, so the foot of the point may be replaced by its start.
        v = (sides @ xyz - of_sides).ravel()[nearest]
        u = (heights @ xyz - of_heights).ravel()[nearest]
        a = ((run - t * length2) / np.sqrt(length2)).ravel()[nearest]
        # `a` is not zero beyond the ends, where it is divided by the length of the dome, and at kinks of the path.
        cap = np.where(along < 1e-9, self.caps[0], np.where(along > count - 1e-9, self.caps[1], np.minimum(w, h)))
        across = v / w
        above = u / h
        over = a / cap
        k0 = np.sqrt(across**2 + above**2 + over**2)
        k1 = np.sqrt((across / w) ** 2 + (above / h) ** 2 + (over / cap) ** 2)
        thin = np.minimum(np.minimum(w, h), cap)
        distance = np.where(k1 > 1e-6, k0 * (k0 - 1.0) / np.maximum(k1, 1e-6), -thin)
        return along, across, above, distance

    def distance(self, points: FloatArray) -> FloatArray:
        """Return the (N,) signed distances of (N, 3) points."""
        parts = np.array_split(points, len(points) // AT_ONCE + 1)
        return np.concatenate([self.coordinates(part)[3] for part in parts])

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and highest corner (3,) of a box around the solid."""
        reach = np.maximum(self.half_width, self.half_height)
        reach[0], reach[-1] = max(reach[0], self.caps[0]), max(reach[-1], self.caps[1])
        return (self.path - reach[:, None]).min(axis=0), (self.path + reach[:, None]).max(axis=0)

    @cached_property
    def _segments(self) -> tuple[tuple[FloatArray, ...], tuple[FloatArray, ...]]:
        """Return start, step, side and height of the segments, (P - 1, 3) each, and products of them, (P - 1, 1) each.

        The products are those of the step with itself, and of the start with itself, the step, the side and the height.
        """
        start = self.path[:-1]
        step = np.diff(self.path, axis=0)
        tangents = step / np.linalg.norm(step, axis=1, keepdims=True)
        sides = self.side - (tangents @ self.side)[:, None] * tangents
        sides /= np.linalg.norm(sides, axis=1, keepdims=True)
        heights = np.cross(tangents, sides)
        pairs = ((step, step), (start, start), (start, step), (start, sides), (start, heights))
        return (start, step, sides, heights), tuple((a * b).sum(axis=1, keepdims=True) for a, b in pairs)


def tube(
    part: str,
    path: ArrayLike,
    half_width: ArrayLike,
    half_height: ArrayLike | None = None,
    *,
    side: ArrayLike = (0.0, 1.0, 0.0),
    blend: float = 0.0,
    caps: tuple[float, float] | None = None,
    steps: int = 1,
    beyond: Sequence[tuple[float, str]] = (),
) -> Tube:
    """Return a tube through control points.

    Args:
        part: Name of the part.
        path: (P, 3) points on the axis of the tube.
        half_width: Half extent of the sections along `side`, one value or (P,).
        half_height: Half extent perpendicular to `side`; by default the half width.
        side: Direction of the width.
        blend: Width of the smooth joint.
        caps: Lengths of the domes at the ends; by default the smaller half extent there.
        steps: Segments between two control points; more than 1 gives a Catmull-Rom curve.
        beyond: (index of a control point, part) pairs: see `Tube`.
    """
    points = np.asarray(path, np.float64)
    w = np.broadcast_to(np.asarray(half_width, np.float64), len(points))
    h = w if half_height is None else np.broadcast_to(np.asarray(half_height, np.float64), len(points))
    if caps is None:
        caps = (float(min(w[0], h[0])), float(min(w[-1], h[-1])))
    table = np.column_stack([points, w, h])
    if steps > 1:
        table = catmull_rom(table, steps)
    return Tube(
        part,
        np.ascontiguousarray(table[:, :3]),
        table[:, 3].copy(),
        table[:, 4].copy(),
        np.asarray(side, np.float64),
        blend,
        caps,
        tuple((at * steps, name) for at, name in beyond),
    )


def catmull_rom(rows: FloatArray, steps: int) -> FloatArray:
    """Return ((P - 1) * steps + 1, C) rows on the uniform Catmull-Rom curve through (P, C) rows."""
    ahead = 2 * rows[-1] - rows[-2]
    behind = 2 * rows[0] - rows[1]
    p = np.concatenate([behind[None], rows, ahead[None]])
    p0, p1, p2, p3 = p[:-3, None], p[1:-2, None], p[2:-1, None], p[3:, None]
    t = (np.arange(steps) / steps)[None, :, None]
    curve = 0.5 * (2 * p1 + (p2 - p0) * t + (2 * p0 - 5 * p1 + 4 * p2 - p3) * t**2 + (3 * p1 - p0 - 3 * p2 + p3) * t**3)
    return np.concatenate([curve.reshape(-1, rows.shape[1]), rows[-1:]])


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """An ellipsoid with a centre (3,), half axes (3,) and axes that are the rows of a rotation (3, 3)."""

    part: str
    centre: FloatArray
    half: FloatArray
    axes: FloatArray
    blend: float

    def distance(self, points: FloatArray) -> FloatArray:
        """Return the (N,) signed distances of (N, 3) points."""
        q = ((points - self.centre) @ self.axes.T) / self.half
        k0 = np.sqrt(np.einsum("ij,ij->i", q, q))
        q /= self.half
        k1 = np.sqrt(np.einsum("ij,ij->i", q, q))
        return np.asarray(np.where(k1 > 1e-6, k0 * (k0 - 1.0) / np.maximum(k1, 1e-6), -self.half.min()))

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and highest corner (3,) of a box around the solid."""
        reach = np.sqrt(((self.axes * self.half[:, None]) ** 2).sum(axis=0))
        return self.centre - reach, self.centre + reach


# A solid given by its signed distance: negative inside, close to the true one near the surface.
Primitive = Tube | Ellipsoid


def ellipsoid(
    part: str, centre: ArrayLike, half: ArrayLike, *, axes: ArrayLike | None = None, blend: float = 0.0
) -> Ellipsoid:
    """Return an ellipsoid; `axes` (3, 3) contains its axes as rows, by default the coordinate axes."""
    return Ellipsoid(
        part,
        np.asarray(centre, np.float64),
        np.asarray(half, np.float64),
        np.eye(3) if axes is None else np.asarray(axes, np.float64),
        blend,
    )


def smooth_minimum(a: FloatArray, b: FloatArray, width: float) -> FloatArray:
    """Return min(a, b), rounded by a parabola where the two differ by less than `width`."""
    low = np.asarray(np.minimum(a, b), np.float64)
    if width <= 0:
        return low
    gap = np.maximum(width - np.abs(a - b), 0.0)
    return np.asarray(low - gap * gap * (0.25 / width))


@dataclass(frozen=True, eq=False)
class Body:
    """Primitives joined in order, each with its own blend; `floor` cuts the body off at z = 0."""

    primitives: tuple[Primitive, ...]
    floor: bool = False

    def parts(self, points: FloatArray, names: Sequence[str]) -> IntArray:
        """Return the (N,) part of each point near the surface, that of its nearest primitive, as index into `names`."""
        nearest = self.nearest(points)
        part = np.array([names.index(p.part) for p in self.primitives], np.int32)[nearest]
        for i, p in enumerate(self.primitives):
            if isinstance(p, Tube) and p.beyond:
                own = np.flatnonzero(nearest == i)
                along = p.coordinates(points[own])[0]
                for at, name in p.beyond:
                    part[own[along >= at]] = names.index(name)
        return part

    def nearest(self, points: FloatArray) -> NDArray[np.intp]:
        """Return the (N,) indices of the primitives with the lowest signed distance at each point."""
        best = np.full(len(points), np.inf)
        index = np.zeros(len(points), np.intp)
        for i, p in enumerate(self.primitives):
            low, high = p.bounds()
            reach = 2.0 * p.blend + 0.25 * float(np.max(high - low))
            close = np.flatnonzero(np.all((points > low - reach) & (points < high + reach), axis=1))
            d = p.distance(points[close])
            win = d < best[close]
            best[close[win]] = d[win]
            index[close[win]] = i
        return index

    def sample_grid(self, cell: float, shift: float) -> tuple[FloatArray, FloatArray]:
        """Return signed distances (X, Y, Z) on a grid around the body, and its first node (3,).

        Blocks that the surface may cross are halved until every node has its own value. All nodes of any other block
        have the value of its middle, which has the right sign.
        """
        corners = [p.bounds() for p in self.primitives]
        widest = max(p.blend for p in self.primitives)
        low = np.min([c[0] for c in corners], axis=0) - widest - 2 * cell
        high = np.max([c[1] for c in corners], axis=0) + widest + 2 * cell
        if self.floor:
            low[2] = max(low[2], -2 * cell)
        low = (np.floor(low / cell) + shift) * cell
        blocks = np.maximum(np.ceil((high - low) / (BLOCK * cell)).astype(int) + 1, 1)
        grid = np.empty(blocks * BLOCK)
        index = np.stack(np.meshgrid(*(np.arange(n) for n in blocks), indexing="ij"), axis=-1).reshape(-1, 3)
        reached = [np.arange(len(index))] * len(self.primitives)
        size = BLOCK
        while True:
            centres = low + (index * size + 0.5 * (size - 1)) * cell
            value = np.full(len(index), FAR)
            own = []
            for p, near in zip(self.primitives, reached, strict=True):
                own.append(p.distance(centres[near]))
                value[near] = smooth_minimum(value[near], own[-1], p.blend)
            if self.floor:
                value = np.maximum(value, -centres[:, 2])
            of_blocks = grid.reshape([n for axis in grid.shape for n in (axis // size, size)]).transpose(
                0, 2, 4, 1, 3, 5
            )
            of_blocks[tuple(index.T)] = value[:, None, None, None]
            if size == 1:
                return grid, low
            # The slack allows for approximate distances, which are off by up to the aspect ratio of the sections.
            slack = (1.6 * 0.5 * np.sqrt(3.0) * (size - 1) + 2.0) * cell
            active = np.abs(value) < slack
            number = np.cumsum(active) - 1
            for k, (p, near, d) in enumerate(zip(self.primitives, reached, own, strict=True)):
                kept = near[active[near] & (d < slack + widest + p.blend)]
                reached[k] = (8 * number[kept][:, None] + np.arange(8)).ravel()
            index = (2 * index[active][:, None] + _CORNERS).reshape(-1, 3)
            size //= 2


def surface(body: Body, cell: float) -> tuple[FloatArray, IntArray]:
    """Return the closed surface of a body: (V, 3) vertices and (T, 3) triangles, counter-clockwise seen from outside.

    Where a cell contains a thin handle or gap, an edge can get four triangles; the grid is then shifted by a fraction
    of a cell and the surface extracted again.

    Raises:
        ValueError: No grid position gives a closed surface: `cell` is too coarse for the body.
    """
    for attempt in range(_ATTEMPTS):
        grid, low = body.sample_grid(cell, 0.381966 * attempt % 1.0)
        vertices, triangles = surface_nets(grid, cell, low)
        if is_closed(triangles):
            return vertices, triangles
    raise ValueError(f"no closed surface with cells of {cell:g}: the body has thinner details")


# Corners of a cell in the order of their bits, and its twelve edges as pairs of corners, by (axis, lower corner).
_CORNERS = np.array([[i & 1, (i >> 1) & 1, (i >> 2) & 1] for i in range(8)])
_EDGES = [(a, a | 1 << b) for b in range(3) for a in range(8) if not a & 1 << b]
_EDGE_NUMBER = {pair: i for i, pair in enumerate(_EDGES)}


def _sheets_table() -> tuple[NDArray[np.int8], NDArray[np.int8]]:
    """Return, for all 256 patterns of inside corners of a cell, the sheet of each edge and the number of sheets.

    A sheet is a connected piece of the surface in a cell. If two edges of a face are crossed, both belong to the same
    sheet. If all four are crossed, the two edges at an inside corner do. Both cells of a face follow this rule, so two
    sheets in a cell get separate vertices.

    Returns:
        (256, 12) index of the sheet that crosses the edge, or -1, and (256,) number of sheets.
    """
    sheet = np.full((256, 12), -1, np.int8)
    sheets = np.zeros(256, np.int8)
    for pattern in range(256):
        group = {e: e for e, (a, b) in enumerate(_EDGES) if (pattern >> a ^ pattern >> b) & 1}
        for axis in range(3):
            b, c = 1 << (axis + 1) % 3, 1 << (axis + 2) % 3
            for base in (0, 1 << axis):
                face = [base, base | b, base | b | c, base | c]
                rim = [_EDGE_NUMBER[min(p, q), max(p, q)] for p, q in zip(face, face[1:] + face[:1], strict=True)]
                crossed = [e for e in rim if e in group]
                links = [tuple(crossed)] if len(crossed) == 2 else []
                if len(crossed) == 4:
                    links = [(rim[i - 1], rim[i]) for i in range(4) if pattern >> face[i] & 1]
                for p, q in links:
                    old, new = group[p], group[q]
                    group = {e: new if g == old else g for e, g in group.items()}
        names = sorted(set(group.values()))
        sheets[pattern] = len(names)
        for e, g in group.items():
            sheet[pattern, e] = names.index(g)
    return sheet, sheets


_SHEET, _SHEETS = _sheets_table()


def surface_nets(grid: FloatArray, cell: float, low: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the surface of (X, Y, Z) signed distances: (V, 3) vertices and (T, 3) triangles, facing outwards.

    Distances are positive on all outer faces; `low` is the position of node (0, 0, 0).
    """
    inside = grid < 0
    nx, ny, nz = grid.shape
    pattern_grid = np.zeros((nx - 1, ny - 1, nz - 1), np.uint8)
    for bit, (i, j, k) in enumerate(_CORNERS):
        pattern_grid |= inside[i : nx - 1 + i, j : ny - 1 + j, k : nz - 1 + k] * np.uint8(1 << bit)
    cells = np.argwhere((pattern_grid > 0) & (pattern_grid < 255))
    pattern = pattern_grid[tuple(cells.T)]
    first = np.concatenate([[0], np.cumsum(_SHEETS[pattern], dtype=np.int64)])
    at = cells[:, None] + _CORNERS
    corner = grid[at[..., 0], at[..., 1], at[..., 2]]
    total = np.zeros((first[-1], 3))
    crossings = np.zeros(first[-1])
    for e, (a, b) in enumerate(_EDGES):
        which = np.flatnonzero(_SHEET[pattern, e] >= 0)
        vertex = first[which] + _SHEET[pattern[which], e]
        da, db = corner[which, a], corner[which, b]
        # Stay away from the nodes, where vertices of neighbouring cells would coincide.
        t = np.clip(da / (da - db), 0.02, 0.98)
        total[vertex] += cells[which] + _CORNERS[a] + t[:, None] * (_CORNERS[b] - _CORNERS[a])
        crossings[vertex] += 1
    vertices = low + (total / crossings[:, None]) * cell
    number = np.full(pattern_grid.shape, -1, np.int64)
    number[tuple(cells.T)] = np.arange(len(cells))
    q = np.concatenate([_quads(axis, inside, pattern, first, number) for axis in range(3)])
    v = vertices[q]
    short = np.linalg.norm(v[:, 0] - v[:, 2], axis=1) <= np.linalg.norm(v[:, 1] - v[:, 3], axis=1)
    split = np.where(short[:, None], q[:, [0, 1, 2, 0, 2, 3]], q[:, [1, 2, 3, 1, 3, 0]])
    return vertices, np.ascontiguousarray(split.reshape(-1, 3), np.int32)


def _quads(
    axis: int,
    inside: NDArray[np.bool_],
    pattern: NDArray[np.uint8],
    first: NDArray[np.int64],
    number: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Return the (Q, 4) vertices around the edges of the grid along an axis that the surface crosses.

    Args:
        axis: Axis of the edges.
        inside: Whether each node of the grid is inside.
        pattern: (C,) nodes of each cell on the surface that are inside, as bits.
        first: (C + 1,) first vertex of each cell.
        number: (X - 1, Y - 1, Z - 1) number of each cell, -1 for one that the surface does not cross.
    """
    b, c = (axis + 1) % 3, (axis + 2) % 3
    here: list[slice] = [slice(1, -1)] * 3
    there: list[slice] = [slice(1, -1)] * 3
    here[axis], there[axis] = slice(None, -1), slice(1, None)
    edge = np.argwhere(inside[tuple(here)] != inside[tuple(there)])
    leaves = inside[tuple(here)][tuple(edge.T)]
    edge[:, b] += 1
    edge[:, c] += 1
    ring = []
    for db, dc in ((-1, -1), (0, -1), (0, 0), (-1, 0)):
        spot = edge.copy()
        spot[:, b] += db
        spot[:, c] += dc
        at_cell = number[tuple(spot.T)]
        lower = -db << b | -dc << c
        ring.append(first[at_cell] + _SHEET[pattern[at_cell], _EDGE_NUMBER[lower, lower | 1 << axis]])
    quad = np.stack(ring, axis=1)
    return np.asarray(np.where(leaves[:, None], quad, quad[:, ::-1]))


def is_closed(triangles: IntArray) -> bool:
    """Return whether every edge belongs to exactly two triangles, which use it in opposite directions."""
    size = int(triangles.max(initial=0)) + 1
    a = triangles.ravel().astype(np.int64)
    b = np.roll(triangles, -1, axis=1).ravel().astype(np.int64)
    forward = a * size + b
    backward = b * size + a
    forward.sort()
    backward.sort()
    return bool(np.array_equal(forward, backward) and np.all(forward[1:] != forward[:-1]))


def concatenate(
    pieces: Sequence[tuple[FloatArray, IntArray]],
) -> tuple[FloatArray, IntArray]:
    """Join several surfaces into one list of vertices and one of triangles."""
    offsets = np.cumsum([0, *(len(v) for v, _ in pieces)])
    return (
        np.concatenate([v for v, _ in pieces]),
        np.concatenate([t + np.int32(o) for (_, t), o in zip(pieces, offsets, strict=False)]).astype(np.int32),
    )
