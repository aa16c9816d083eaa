"""What the grown models share: joints and legs of a skeleton, pieces of skin, cuts at water, meshes, coats in sun."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infrablend.assets.implicit import Body, Tube, concatenate, surface
from infrablend.assets.model import LOW_SUN, Params, PartRange, at_low_sun, warmed_by_sun
from infrablend.core.mesh import FloatArray, IntArray, Mesh

Piece = tuple[FloatArray, IntArray, IntArray]
"""Vertices (V, 3), triangles (T, 3), and the number of each triangle's part (T,)."""

# No vertex of a piece in water may be nearer to the surface, as a share of the piece's height.
_APART = 1e-6


@dataclass(frozen=True)
class Leg:
    """Position of a hoof relative to a standing animal's, and how far the foot hangs (0 on the ground, 1 swinging)."""

    dx: float = 0.0
    dz: float = 0.0
    hang: float = 0.0


@dataclass(frozen=True)
class Gait:
    """One way to move on four legs, in units of the shoulder height.

    Attributes:
        stride: Distance that the body moves in one cycle, which has one step of each leg.
        stance: Share of the cycle in which a hoof is on the ground.
        lands: Phases at which left fore, right fore, left hind and right hind hoof land.
        lift: Height to which hooves are lifted.
    """

    stride: float
    stance: float
    lands: tuple[float, float, float, float]
    lift: float

    def legs(self, phase: float) -> tuple[Leg, Leg, Leg, Leg]:
        """Return the legs at a phase in [0, 1)."""
        a, b, c, d = (self._leg((phase - landed) % 1.0) for landed in self.lands)
        return a, b, c, d

    def _leg(self, phase: float) -> Leg:
        reach = 0.5 * self.stride * self.stance
        if phase <= self.stance:
            return Leg(reach - self.stride * phase)
        u = (phase - self.stance) / (1.0 - self.stance)
        # From the back to the front, at both ends as fast as the ground: hooves leave it and land without a jerk.
        pace = self.stride * (1.0 - self.stance)
        dx = -reach + 2.0 * reach * u * u * (3.0 - 2.0 * u) - pace * u * (1.0 - u) * (1.0 - 2.0 * u)
        raised = math.sin(math.pi * u**0.8) ** 2
        return Leg(dx, self.lift * raised, raised)


def unit(v: ArrayLike) -> FloatArray:
    """Return a vector scaled to length 1."""
    a = np.asarray(v, np.float64)
    return a / float(np.linalg.norm(a))


def smoothstep(x: FloatArray) -> FloatArray:
    """Return a smooth ramp: 0 up to x = 0, 1 from x = 1 on."""
    t = np.clip(x, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def spline(rows: FloatArray, at: float) -> FloatArray:
    """Return the (C,) point at a position in [1, P - 2] on the Catmull-Rom curve through (P, C) rows, one per unit."""
    k = min(max(int(at), 1), len(rows) - 3)
    a, b, c, d = rows[k - 1 : k + 3]
    t = at - k
    return np.asarray(0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * (b - c) + d - a) * t**3))


def joint(a: FloatArray, b: FloatArray, bones: tuple[float, float], side: FloatArray) -> FloatArray:
    """Return the joint between two bones that connect two points.

    The bones stretch if the points are too far apart. `side` is the unit vector, at right angles to b - a, in whose
    direction the joint bends.
    """
    reach = b - a
    span = float(np.linalg.norm(reach))
    stretch = max(1.0, span / (0.999 * sum(bones)))
    upper, lower = (bone * stretch for bone in bones)
    along = (span**2 + upper**2 - lower**2) / (2 * span)
    direction = reach / span
    return np.asarray(a + along * direction + math.sqrt(max(upper**2 - along**2, 0.0)) * side)


def leg_joint(a: FloatArray, b: FloatArray, bones: tuple[float, float], bend: float) -> FloatArray:
    """Return the joint between two bones in a vertical plane; `bend` +1 points it forward, -1 backward."""
    normal = np.cross(unit(b - a), np.array([0.0, 1.0, 0.0]))
    normal *= bend / float(np.linalg.norm(normal)) * (1.0 if normal[0] >= 0 else -1.0)
    return joint(a, b, bones, normal)


def skin(body: Body, cell: float, names: Sequence[str], bands: Sequence[tuple[float, str]] = ()) -> Piece:
    """Return the surface of a body; whatever nearly touches the ground does touch it.

    Args:
        body: The body; with `bands`, its first primitive is the trunk.
        cell: Size of the grid's cells.
        names: Names of all parts.
        bands: Parts of the trunk by height: (height relative to the trunk's half height, part above it), or below it if
            the height is negative.
    """
    vertices, triangles = surface(body, cell)
    centres = vertices[triangles].mean(axis=1)
    parts = body.parts(centres, names)
    trunk = body.primitives[0]
    if bands and isinstance(trunk, Tube):
        own = np.flatnonzero(parts == names.index(trunk.part))
        above = trunk.coordinates(centres[own])[2]
        for height, name in bands:
            parts[own[above > height if height > 0 else above < height]] = names.index(name)
    return on_ground(vertices, cell), triangles, parts


def joined(pieces: Sequence[Piece]) -> Piece:
    """Return several pieces as one."""
    vertices, triangles = concatenate([(v, t) for v, t, _ in pieces])
    return vertices, triangles, np.concatenate([parts for _, _, parts in pieces])


def on_ground(vertices: FloatArray, cell: float) -> FloatArray:
    """Stretch the two lowest cells to the ground, so that whatever nearly touches it does touch it."""
    lowest = float(vertices[:, 2].min())
    top = 2.0 * cell
    if lowest > cell:
        return vertices
    v = vertices.copy()
    v[:, 2] = np.where(v[:, 2] < top, (v[:, 2] - lowest) * (top / (top - lowest)), v[:, 2])
    return v


def feet_centre(hooves: FloatArray) -> float:
    """Return the mean x of the middle of the fore hooves and the middle of the hind hooves."""
    fore = hooves[:, 0] > 0
    return float(0.5 * (hooves[fore, 0].mean() + hooves[~fore, 0].mean()))


def withers_height(vertices: FloatArray, triangles: IntArray, withers_x: float) -> float:
    """Return the shoulder height of a standing animal: the highest point of its trunk over the forelegs.

    Vertices are not yet moved along x; triangles are those of the trunk.
    """
    v = vertices[np.unique(triangles)]
    return float(v[np.abs(v[:, 0] - withers_x) < 0.03, 2].max())


def mirrored(vertices: FloatArray, triangles: IntArray) -> tuple[FloatArray, IntArray]:
    """Return a surface with left and right exchanged."""
    return vertices * np.array([1.0, -1.0, 1.0]), np.ascontiguousarray(triangles[:, ::-1])


def finished(piece: Piece, names: Sequence[str], *, smooth: NDArray[np.bool_] | None = None) -> Mesh:
    """Return a piece as a mesh of closed parts, with the parts that it has; faces are smooth unless `smooth` says."""
    vertices, triangles, parts = piece
    used = np.unique(parts)
    number = np.full(len(names), -1, np.int32)
    number[used] = np.arange(len(used), dtype=np.int32)
    own = tuple(names[i] for i in used)
    smooth = np.ones(len(triangles), np.bool_) if smooth is None else smooth
    return Mesh(vertices, triangles, number[parts], own, smooth, frozenset(own))


def roles_of_coat(
    params: Params, parts: Mapping[str, PartRange], sun_k: tuple[float, float], shares: Mapping[str, float]
) -> Mapping[str, PartRange]:
    """Return the thermal role of every part; by day the sun warms the coat as in `warmed_by_sun`."""
    time = params.get("time_of_day", "night")
    if time == "night":
        return parts
    by_day = warmed_by_sun(parts, sun_k, shares)
    return at_low_sun(parts, by_day, time) if time in LOW_SUN else by_day


def above_water(piece: Piece, level: float) -> Piece:
    """Return what closed surfaces have above a height, closed there, with the height as the new zero.

    Water is opaque in the thermal band within a tenth of a millimetre, so that nothing below its surface is seen.

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
