"""Closed triangle solids in pure numpy: lofts, boxes, plates, lathes, sweeps and propeller blades.

The triangles of every solid are counter-clockwise seen from outside. At edges that should look sharp on a smoothly
shaded solid, each vertex exists twice (same position, different index). A solid is therefore closed only if vertices at
the same position count as one.
Lengths are in the unit of the caller, angles in radians.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infrablend.core.mesh import FloatArray, IntArray


class Solid(NamedTuple):
    """A closed surface: `vertices` (V, 3) float64 and `triangles` (T, 3) int32, counter-clockwise from outside."""

    vertices: FloatArray
    triangles: IntArray


def loft(
    rings: FloatArray,
    *,
    sharp: Sequence[bool] | None = None,
    start: ArrayLike | None = None,
    end: ArrayLike | None = None,
    wrap: bool = False,
) -> Solid:
    """Return the solid whose surface connects consecutive rings of points.

    Args:
        rings: (R, N, 3) rings of N points, counter-clockwise seen from beyond the last ring, looking back at the first.
        sharp: (R,) whether a ring is a sharp edge.
        start: (3,) pole that closes the first ring smoothly; by default a flat cap closes it.
        end: (3,) pole that closes the last ring smoothly; by default a flat cap closes it.
        wrap: Join the last ring to the first instead of closing both, for a solid with a hole.
    """
    count, n = rings.shape[:2]
    marks = (False,) * count if sharp is None else tuple(bool(s) for s in sharp)
    take, triangles = _loft_topology(count, n, marks, start is not None, end is not None, wrap)
    flat = rings.reshape(-1, 3)[take]
    if wrap:
        return Solid(flat, triangles)
    first = rings[0].sum(axis=0) / n if start is None else np.asarray(start, np.float64)
    last = rings[-1].sum(axis=0) / n if end is None else np.asarray(end, np.float64)
    return Solid(np.concatenate([flat, first[None], last[None]]), triangles)


@lru_cache(maxsize=512)
def _loft_topology(
    count: int, n: int, sharp: tuple[bool, ...], start_pole: bool, end_pole: bool, wrap: bool
) -> tuple[NDArray[np.intp], IntArray]:
    """Return the ring points that become vertices, and the triangles over them (poles are the last two vertices)."""
    rows: list[int] = []
    enter = []
    leave = []
    for r in range(count):
        enter.append(len(rows))
        rows.append(r)
        if sharp[r]:
            rows.append(r)
        leave.append(len(rows) - 1)
    cap_rows = []
    if not wrap:
        for r, pole in ((0, start_pole), (count - 1, end_pole)):
            if pole:
                cap_rows.append(enter[r] if r == 0 else leave[r])
            else:
                cap_rows.append(len(rows))
                rows.append(r)
    j = np.arange(n)
    k = (j + 1) % n
    parts = []
    for r in range(count if wrap else count - 1):
        a, b = leave[r] * n, enter[(r + 1) % count] * n
        parts.append(np.stack([a + j, a + k, b + k], axis=1))
        parts.append(np.stack([a + j, b + k, b + j], axis=1))
    if not wrap:
        first, last = len(rows) * n, len(rows) * n + 1
        parts.append(np.stack([np.full(n, first), cap_rows[0] * n + k, cap_rows[0] * n + j], axis=1))
        parts.append(np.stack([np.full(n, last), cap_rows[1] * n + j, cap_rows[1] * n + k], axis=1))
    take = (np.array(rows)[:, None] * n + j).reshape(-1)
    triangles = np.concatenate(parts).astype(np.int32)
    take.setflags(write=False)
    triangles.setflags(write=False)
    return take, triangles


@lru_cache(maxsize=64)
def circle(n: int, exponent: float = 2.0) -> FloatArray:
    """Return (n, 2) read-only points of the superellipse |x|^e + |y|^e = 1, counter-clockwise from +x."""
    a = 2 * np.pi * np.arange(n) / n
    xy = np.stack([np.cos(a), np.sin(a)], axis=1)
    # cos and sin give 1e-17 instead of 0; for a large exponent, the power below would turn that into a visible offset.
    xy[np.abs(xy) < 1e-12] = 0.0
    out = np.asarray(np.sign(xy) * np.abs(xy) ** (2.0 / exponent))
    out.setflags(write=False)
    return out


def rounded_rectangle(half_x: float, half_y: float, radius: float, steps: int = 3) -> FloatArray:
    """Return a (4 * (steps + 1), 2) outline, counter-clockwise; `steps` 1 gives plain chamfers."""
    x, y = radius * _quarter(steps)
    outline = np.empty((4, steps + 1, 2))
    outline[0, :, 0], outline[0, :, 1] = x, y
    outline[1, :, 0], outline[1, :, 1] = -y, x
    outline[2, :, 0], outline[2, :, 1] = -x, -y
    outline[3, :, 0], outline[3, :, 1] = y, -x
    outline += np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])[:, None] * (half_x - radius, half_y - radius)
    return outline.reshape(-1, 2)


@lru_cache(maxsize=64)
def _quarter(steps: int) -> FloatArray:
    """Return cosines and sines (2, steps + 1) of the angles from 0 to 90 degrees."""
    a = np.linspace(0.0, np.pi / 2, steps + 1)
    return np.stack([np.cos(a), np.sin(a)])


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the vector products (..., 3); `np.cross` takes several times longer for few vectors."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    product[..., 0] = ay * bz - az * by
    product[..., 1] = az * bx - ax * bz
    product[..., 2] = ax * by - ay * bx
    return product


def ring_strips(corners: int, loops: int) -> IntArray:
    """Return the triangles of flat rings between loops of vertices, counter-clockwise seen from above.

    Neighbouring rings share their vertices, so that what differs between them blends without steps.

    Args:
        corners: Vertices of each loop, counter-clockwise.
        loops: Number of loops, whose vertices follow each other from the innermost to the outermost.
    """
    i = np.arange(corners)
    j = (i + 1) % corners
    ring = np.concatenate([np.stack([i, i + corners, j], 1), np.stack([j, i + corners, j + corners], 1)])
    return np.concatenate([ring + k * corners for k in range(loops - 1)]).astype(np.int32)


def box(size: ArrayLike, bevel: float, *, corner: float | None = None, steps: int = 1) -> Solid:
    """Return a box around the origin with bevelled edges.

    Args:
        size: (3,) full extents.
        bevel: Bevel of the edges around top and bottom.
        corner: Radius of the four vertical edges; by default the bevel.
        steps: Facets of a vertical edge.
    """
    hx, hy, hz = (float(s) / 2 for s in np.asarray(size, np.float64))
    bevel = min(bevel, 0.49 * min(hx, hy, hz))
    radius = min(max(bevel if corner is None else corner, bevel), 0.98 * min(hx, hy))
    outer = rounded_rectangle(hx, hy, radius, steps)
    inner = rounded_rectangle(hx - bevel, hy - bevel, max(radius - bevel, 0.35 * bevel), steps)
    return stack([(-hz, inner), (-hz + bevel, outer), (hz - bevel, outer), (hz, inner)])


def stack(levels: Sequence[tuple[float, FloatArray]], *, sharp: bool = True) -> Solid:
    """Return a solid over outlines (z, (N, 2) counter-clockwise) in rising order, closed by flat caps.

    The first and last outline must be star-shaped about their mean.
    """
    n = len(levels[0][1])
    rings = np.empty((len(levels), n, 3))
    for ring, (z, outline) in zip(rings, levels, strict=True):
        ring[:, :2] = outline
        ring[:, 2] = z
    return loft(rings, sharp=[sharp] * len(levels))


def plate(outline: FloatArray, low: float, high: float, hole: FloatArray | None = None) -> Solid:
    """Return a flat plate from z `low` to `high` with a counter-clockwise outline (N, 2) and maybe a hole (N, 2)."""
    if hole is None:
        return stack([(low, outline), (high, outline)])
    rings = np.empty((4, len(outline), 3))
    rings[0, :, :2] = rings[1, :, :2] = outline
    rings[2, :, :2] = rings[3, :, :2] = hole
    rings[[0, 3], :, 2], rings[[1, 2], :, 2] = low, high
    return loft(rings, sharp=[True] * 4, wrap=True)


def lathe(profile: ArrayLike, n: int = 20, *, wrap: bool = False, sharp_deg: float = 35.0) -> Solid:
    """Return a solid of revolution about Z.

    Args:
        profile: (P, 2) points (radius, z) with the outside on the right: upwards along the outer wall. A first or
            last radius of 0 is a smooth pole; otherwise a flat cap closes the end.
        n: Segments of the circumference.
        wrap: Whether the profile is a closed loop away from the axis, for a ring.
        sharp_deg: Angle above which a bend of the profile is a sharp edge.
    """
    p = np.asarray(profile, np.float64)
    step = (np.roll(p, -1, axis=0) if wrap else p[1:]) - (p if wrap else p[:-1])
    step = step / np.linalg.norm(step, axis=1, keepdims=True)
    before = np.roll(step, 1, axis=0) if wrap else np.concatenate([step[:1], step])
    after = step if wrap else np.concatenate([step, step[-1:]])
    bend = (before * after).sum(axis=1) < np.cos(np.radians(sharp_deg))
    start = end = None
    if not wrap and p[0, 0] == 0:
        start = (0.0, 0.0, p[0, 1])
        p = p[1:]
        bend = bend[1:]
    if not wrap and p[-1, 0] == 0:
        end = (0.0, 0.0, p[-1, 1])
        p = p[:-1]
        bend = bend[:-1]
    unit = circle(n)
    rings = np.empty((len(p), n, 3))
    rings[:, :, :2] = p[:, :1, None] * unit
    rings[:, :, 2] = p[:, 1:]
    return loft(rings, sharp=bend.tolist(), start=start, end=end, wrap=wrap)


def cylinder(radius: float, low: float, high: float, n: int = 16, bevel: float = 0.0) -> Solid:
    """Return a vertical cylinder about Z with bevelled rims."""
    if bevel <= 0:
        return lathe([(radius, low), (radius, high)], n)
    bevel = min(bevel, 0.45 * (high - low), 0.5 * radius)
    return lathe([(radius - bevel, low), (radius, low + bevel), (radius, high - bevel), (radius - bevel, high)], n)


def ellipsoid(half: ArrayLike, n: int = 16, rows: int = 8) -> Solid:
    """Return an ellipsoid around the origin with half axes (3,)."""
    a = np.linspace(-np.pi / 2, np.pi / 2, rows + 1)
    profile = np.stack([np.cos(a), np.sin(a)], axis=1)
    profile[0, 0] = profile[-1, 0] = 0.0
    solid = lathe(profile, n, sharp_deg=80.0)
    return Solid(solid.vertices * np.asarray(half, np.float64), solid.triangles)


def sweep(
    path: ArrayLike,
    half_width: ArrayLike,
    half_height: ArrayLike | None = None,
    *,
    n: int = 12,
    exponent: float = 2.0,
    up: ArrayLike = (0.0, 0.0, 1.0),
    round_ends: bool = False,
) -> Solid:
    """Return a bar along a path.

    Args:
        path: (P, 3) points; neighbours must differ.
        half_width: Half extent of the sections perpendicular to `up`, one value or (P,).
        half_height: Half extent of the sections along `up`; by default the half width.
        n: Points per section; a multiple of 4 keeps the section symmetric.
        exponent: 2 gives an ellipse, larger values a rounded rectangle.
        up: Direction of the height of the sections; must not be parallel to the path.
        round_ends: Close the ends with domes instead of flat caps.
    """
    p = np.asarray(path, np.float64)
    step = np.diff(p, axis=0)
    step /= np.linalg.norm(step, axis=1, keepdims=True)
    tangent = np.concatenate([step[:1], step[:-1] + step[1:], step[-1:]])
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = _cross(np.asarray(up, np.float64), tangent)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    rise = _cross(tangent, side)
    w = np.broadcast_to(np.asarray(half_width, np.float64), len(p))
    h = w if half_height is None else np.broadcast_to(np.asarray(half_height, np.float64), len(p))
    start = end = None
    if round_ends:
        dome = np.array([0.4, 0.8])
        grow = np.sqrt(1 - dome**2)
        reach0, reach1 = min(w[0], h[0]), min(w[-1], h[-1])
        start, end = p[0] - reach0 * tangent[0], p[-1] + reach1 * tangent[-1]
        before = p[0] - reach0 * dome[::-1, None] * tangent[0]
        after = p[-1] + reach1 * dome[:, None] * tangent[-1]
        p = np.concatenate([before, p, after])
        w = np.concatenate([w[0] * grow[::-1], w, w[-1] * grow])
        h = np.concatenate([h[0] * grow[::-1], h, h[-1] * grow])
        pick = np.array([0, 0, *range(len(tangent)), -1, -1])
        side = side[pick]
        rise = rise[pick]
    unit = circle(n, exponent)
    rings = (
        p[:, None]
        + (w[:, None] * unit[:, 0])[:, :, None] * side[:, None]
        + (h[:, None] * unit[:, 1])[:, :, None] * rise[:, None]
    )
    return loft(rings, start=start, end=end)


def capsule(a: ArrayLike, b: ArrayLike, radius_a: float, radius_b: float | None = None, n: int = 12) -> Solid:
    """Return a round bar with domed ends between two points, tapering from `radius_a` to `radius_b`."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    along = np.abs(b - a)
    up = np.zeros(3)
    up[int(np.argmin(along))] = 1.0
    radii = (radius_a, radius_a if radius_b is None else radius_b)
    return sweep(np.stack([a, b]), radii, n=n, up=up, round_ends=True)


def blade(
    span: ArrayLike,
    chord: ArrayLike,
    lead: ArrayLike,
    pitch_rad: ArrayLike,
    thickness: ArrayLike,
    *,
    camber: float = 0.05,
    clockwise: bool = False,
) -> Solid:
    """Return a propeller blade along +X that turns counter-clockwise seen from above (leading edge towards +Y).

    Args:
        span: (S,) rising positions of the stations along X.
        chord: (S,) width at each station.
        lead: (S,) Y of the leading edge of the untwisted blade.
        pitch_rad: (S,) angle between chord and plane of rotation, positive with the leading edge up.
        thickness: (S,) largest thickness at each station.
        camber: Height of the mean line above the chord.
        clockwise: Mirror the blade for a propeller that turns clockwise.
    """
    x, c, y0, pitch, thick = (np.asarray(q, np.float64) for q in (span, chord, lead, pitch_rad, thickness))
    # A loop around the aerofoil: from the leading edge along the top to the trailing edge and back along the bottom.
    s = np.array([0.0, 0.12, 0.35, 0.65, 1.0])
    half = np.array([0.0, 0.38, 0.5, 0.34, 0.06])
    mean = 4 * camber * s * (1 - s)
    loop_s = np.concatenate([s, s[:0:-1]])
    loop_half = np.concatenate([half, -half[:0:-1]])
    loop_mean = np.concatenate([mean, mean[:0:-1]])
    along = -c[:, None] * loop_s
    height = c[:, None] * loop_mean + thick[:, None] * loop_half
    mid = 0.4 * c[:, None]
    cos, sin = np.cos(pitch)[:, None], np.sin(pitch)[:, None]
    rings = np.empty((len(x), len(loop_s), 3))
    rings[:, :, 0] = x[:, None]
    rings[:, :, 1] = y0[:, None] - mid + cos * (along + mid) - sin * height
    rings[:, :, 2] = sin * (along + mid) + cos * height
    # The loop runs from +Y to -Y along the top, so it is counter-clockwise seen from +X.
    solid = loft(rings)
    return mirrored(solid, 1) if clockwise else solid


# Loop around a profile from the leading edge along the top to the trailing edge and back below: share of the chord, and
# height over the chord in chords, for a thickness of 1.
_ALONG = np.array([0.0, 0.03, 0.10, 0.25, 0.45, 0.70, 1.0])
_HALF = np.array([0.0, 0.21, 0.37, 0.49, 0.46, 0.29, 0.02])
_CAMBER = 0.018


def aerofoil(stations: Sequence[tuple[tuple[float, float, float], float, float]], up: ArrayLike) -> Solid:
    """Return a wing, tail plane or fin whose chords lie along X.

    Args:
        stations: (leading edge, chord, thickness share) from the right or lower end to the left or upper one.
        up: (3,) unit vector across the surface, the direction of its upper side; or (S, 3), one for each station.
    """
    s = np.concatenate([_ALONG, _ALONG[-2:0:-1]])
    half = np.concatenate([_HALF, -_HALF[-2:0:-1]])
    rings = np.empty((len(stations), len(s), 3))
    ups = np.broadcast_to(np.asarray(up, np.float64), (len(stations), 3))
    for ring, (lead, chord, thick), rise in zip(rings, stations, ups, strict=True):
        height = chord * (thick * half + 4 * _CAMBER * s * (1 - s))
        ring[:] = np.asarray(lead) + np.outer(-chord * s, (1.0, 0.0, 0.0)) + np.outer(height, rise)
    # Counter-clockwise seen from the left: along the bottom first.
    return loft(np.ascontiguousarray(rings[:, ::-1]))


def moved(solid: Solid, offset: ArrayLike) -> Solid:
    """Return the solid shifted by (3,) `offset`."""
    return Solid(solid.vertices + np.asarray(offset, np.float64), solid.triangles)


def placed(solid: Solid, rotation: FloatArray, offset: ArrayLike = (0.0, 0.0, 0.0)) -> Solid:
    """Return the solid turned by a (3, 3) rotation, then shifted."""
    return Solid(solid.vertices @ rotation.T + np.asarray(offset, np.float64), solid.triangles)


def mirrored(solid: Solid, axis: int) -> Solid:
    """Return the solid mirrored along `axis` in a plane through the origin; its triangles still face outwards."""
    v = solid.vertices.copy()
    v[:, axis] *= -1.0
    return Solid(v, np.ascontiguousarray(solid.triangles[:, ::-1]))


def turn_z(angle_rad: float) -> FloatArray:
    """Return the (3, 3) rotation about +Z, counter-clockwise seen from above."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def turn_y(angle_rad: float) -> FloatArray:
    """Return the (3, 3) rotation about +Y: a positive angle turns +X down to -Z and +Z forward to +X."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def turn_x(angle_rad: float) -> FloatArray:
    """Return the (3, 3) rotation about +X: a positive angle turns +Y up to +Z and +Z to -Y."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def attitude(climb_deg: float, bank_deg: float) -> FloatArray:
    """Return the (3, 3) rotation of what flies level to its attitude: nose up, then right side down, in degrees."""
    return np.asarray(turn_y(-math.radians(climb_deg)) @ turn_x(math.radians(bank_deg)))


def creased(solid: Solid, angle_rad: float, area: ArrayLike | None = None) -> Solid:
    """Split the vertices along edges that bend by more than `angle_rad`; triangles keep their order.

    Shading then interpolates within smooth areas only. Edges are found by vertex index, so the solid must not
    have split vertices yet.

    Args:
        solid: Closed solid without degenerate triangles.
        angle_rad: Largest bend that stays smooth.
        area: (T,) number of the area of each triangle; edges between different areas are split as well.
    """
    t = solid.triangles
    corners = solid.vertices[t]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # Corner 3 * triangle + k belongs to vertex t[triangle, k]; each edge lies between corners k and k + 1.
    corner = np.arange(3 * len(t)).reshape(-1, 3)
    start, end = corner.reshape(-1), np.roll(corner, -1, axis=1).reshape(-1)
    a, b = t.reshape(-1)[start].astype(np.int64), t.reshape(-1)[end].astype(np.int64)
    order = np.argsort(np.minimum(a, b) * (len(solid.vertices) + 1) + np.maximum(a, b), kind="stable").reshape(-1, 2)
    one, other = order[:, 0], order[:, 1]
    soft = (normal[one // 3] * normal[other // 3]).sum(axis=1) >= np.cos(angle_rad)
    if area is not None:
        areas = np.asarray(area)
        soft &= areas[one // 3] == areas[other // 3]
    one, other = one[soft], other[soft]
    # The two triangles of an edge use it in opposite directions: the start for one is the end for the other.
    left = np.concatenate([start[one], end[one]])
    right = np.concatenate([end[other], start[other]])
    group = np.arange(3 * len(t))
    while True:
        least = np.minimum(group[left], group[right])
        after = group.copy()
        np.minimum.at(after, left, least)
        np.minimum.at(after, right, least)
        if np.array_equal(after, group):
            break
        group = after
    keep, index = np.unique(group, return_inverse=True)
    return Solid(solid.vertices[t.reshape(-1)[keep]], index.reshape(-1, 3).astype(np.int32))
