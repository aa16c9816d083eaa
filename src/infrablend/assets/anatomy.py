"""What the grown models share: joints and legs of a skeleton, pieces of skin, the finished mesh, coats in the sun."""

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
