"""The bodies of the virtual world: vehicles, people, two-wheelers, trees, buildings, street furniture.

Every builder is pure: a plan's entry in, a `Surface` out, in the object's own frame (origin on the ground, +X its
heading) for what moves, already placed for what is part of the place. Detail goes where it shows at 10-50 cm per
few pixels: glass against paint, bonnet, wheels; head and hands against clothes; gaps in a crown.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infrablend.assets import shapes
from infrablend.assets.shapes import Solid
from infrablend.blender.world.layout import Building, Cycle, Person, Post, Tree, Vehicle
from infrablend.core.mesh import FloatArray, IntArray

# Share of the sky's radiance a surface mirrors at normal incidence: 1 - emissivity in 8-14 um.
PAINT, GLASS, RUBBER, CLOTH, SKIN, WALL, ROOF, LEAF, METAL = 0.07, 0.13, 0.06, 0.03, 0.02, 0.06, 0.08, 0.02, 0.10
TREE_KINDS = {"crown": 6, "bare": 4, "shrub": 3}


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles with what the shader needs to know of each.

    Attributes:
        vertices_m: (V, 3) float64.
        triangles: (T, 3) int32.
        kelvin: (T,) float32 temperature.
        mirror: (T,) float32 reflectance at normal incidence.
        solar_k: (T,) float32 heating by sun at normal incidence.
        grain_k: (T,) float32 amplitude of the fine pattern.
    """

    vertices_m: FloatArray
    triangles: IntArray
    kelvin: NDArray[np.float32]
    mirror: NDArray[np.float32]
    solar_k: NDArray[np.float32]
    grain_k: NDArray[np.float32]


@dataclass
class _Pieces:
    """Collects solids into one surface."""

    vertices: list[FloatArray] = field(default_factory=list)
    triangles: list[IntArray] = field(default_factory=list)
    values: list[NDArray[np.float32]] = field(default_factory=list)
    count: int = 0

    def add(
        self, solid: Solid, kelvin: ArrayLike, mirror: ArrayLike, solar_k: ArrayLike = 0.0, grain_k: ArrayLike = 0.2
    ) -> None:
        n = len(solid.triangles)
        self.vertices.append(solid.vertices)
        self.triangles.append(solid.triangles + np.int32(self.count))
        self.values.append(
            np.stack(
                [np.broadcast_to(np.asarray(v, np.float32), (n,)) for v in (kelvin, mirror, solar_k, grain_k)], axis=1
            )
        )
        self.count += len(solid.vertices)

    def surface(self) -> Surface:
        v = np.concatenate(self.values)
        return Surface(
            np.concatenate(self.vertices),
            np.concatenate(self.triangles).astype(np.int32),
            *(np.ascontiguousarray(v[:, k]) for k in range(4)),
        )


def quad(a: ArrayLike, b: ArrayLike, c: ArrayLike, d: ArrayLike) -> Solid:
    """A four-sided face."""
    return Solid(np.array([a, b, c, d], np.float64), np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def _tri_centres(solid: Solid) -> FloatArray:
    return np.asarray(solid.vertices[solid.triangles].mean(axis=1))


# Vehicles -----------------------------------------------------------------------------------------------------

# (x / length, half width factor, height of the deck over the road) from the rear bumper to the front.
_SEDAN = ((-0.5, 0.80, 0.60), (-0.485, 0.92, 0.86), (-0.40, 0.98, 0.98), (-0.2, 1.0, 0.98), (0.1, 1.0, 0.97),
          (0.22, 0.99, 0.95), (0.40, 0.96, 0.82), (0.475, 0.88, 0.70), (0.5, 0.72, 0.52))  # fmt: skip
_SUV = ((-0.5, 0.86, 0.65), (-0.485, 0.95, 1.0), (-0.40, 0.99, 1.05), (-0.2, 1.0, 1.05), (0.1, 1.0, 1.04),
        (0.24, 0.99, 1.03), (0.42, 0.96, 0.95), (0.485, 0.90, 0.80), (0.5, 0.78, 0.55))  # fmt: skip


def vehicle(v: Vehicle) -> Surface:
    """A vehicle standing on the ground, nose along +X."""
    p = _Pieces()
    if v.kind in ("bus", "truck"):
        _large_vehicle(p, v)
    else:
        _car(p, v)
    radius = 0.33 if v.kind not in ("bus", "truck") else 0.48
    axles = (-0.3, 0.31) if v.kind not in ("bus", "truck") else (-0.27, 0.33)
    wheel = shapes.placed(shapes.cylinder(radius, -0.11, 0.11, 10), shapes.turn_x(math.pi / 2))
    for ax in axles:
        for side in (-1, 1):
            p.add(shapes.moved(wheel, (ax * v.length_m, side * (v.width_m / 2 - 0.115), radius)), v.wheel_k, RUBBER)
    return p.surface()


def _car(p: _Pieces, v: Vehicle) -> None:
    half, length = v.width_m / 2, v.length_m
    stations = _SEDAN if v.kind == "sedan" else _SUV
    rise = v.height_m / (1.46 if v.kind == "sedan" else 1.66)
    # Sections of the body from the rear: sill, flank, shoulder, deck; symmetric.
    section = np.array([(0.86, 0.0), (1.0, 0.22), (1.0, 0.62), (0.95, 0.90), (0.80, 1.0), (0.4, 1.03)], np.float64)
    rings = []
    for fx, fw, top in stations:
        y = section[:, 0] * half * fw
        z = 0.2 + section[:, 1] * (min(top * rise, 1.2) - 0.2)
        x = np.full(6, fx * length)
        right = np.stack([x, -y, z], axis=1)
        left = np.stack([x, y, z], axis=1)[::-1]
        rings.append(np.concatenate([right, left]))
    body = shapes.loft(np.array(rings), sharp=[False] * len(rings))
    centre = _tri_centres(body)
    bonnet_from = 0.22 * length
    kelvin = np.full(len(centre), v.paint_k)
    on_bonnet = (centre[:, 0] > bonnet_from) & (centre[:, 2] > 0.55)
    kelvin[on_bonnet] = v.bonnet_k
    # The grille and the wheel arches let warm air out.
    kelvin[(centre[:, 0] > 0.46 * length) & (centre[:, 2] < 0.6)] = 0.5 * (v.bonnet_k + v.paint_k)
    _warm_flanks(kelvin, body, v)
    kelvin[centre[:, 2] < 0.3] = v.under_k
    p.add(body, kelvin, PAINT, v.solar_k)
    # The cabin: glass between belt line and roof.
    if v.kind == "sedan":
        base, roof = (-0.36, 0.24), (-0.22, 0.07)
        belt = 0.95 * rise
    elif v.kind == "suv":
        base, roof = (-0.48, 0.26), (-0.43, 0.10)
        belt = 1.02 * rise
    else:
        base, roof = (-0.49, 0.36), (-0.475, 0.22)
        belt = 1.02 * rise
    top = v.height_m
    lower = _cabin_outline(base, 0.93 * half, length)
    upper = _cabin_outline(roof, (0.74 if v.kind != "van" else 0.84) * half, length)
    inner = upper * (0.9, 0.86) + ((roof[0] + roof[1]) / 2 * length * 0.1, 0)
    cabin = shapes.stack([(belt - 0.04, lower), (top - 0.06, upper), (top, inner)], sharp=False)
    centre = _tri_centres(cabin)
    glass = (centre[:, 2] < top - 0.1) & (centre[:, 2] > belt - 0.03)
    # Corner posts, and a blind rear flank on vans.
    n = 8
    side_of = np.arange(len(cabin.triangles)) % n
    post = np.isin(side_of, (1, 3, 5, 7))
    if v.kind == "van":
        post |= (centre[:, 0] < -0.05 * length) & (np.abs(centre[:, 1]) > 0.5 * half)
    glass &= ~post
    kelvin = np.where(glass, v.glass_k, v.paint_k)
    _warm_flanks(kelvin, cabin, v)
    p.add(cabin, kelvin, np.where(glass, GLASS, PAINT), np.where(glass, 0.25, 1.0) * v.solar_k)
    for side in (-1, 1):  # mirrors
        p.add(
            shapes.moved(shapes.box((0.1, 0.16, 0.1), 0.02), (0.2 * length, side * (half + 0.02), belt + 0.02)),
            v.paint_k, PAINT, v.solar_k,
        )  # fmt: skip


def _warm_flanks(kelvin: FloatArray, solid: Solid, v: Vehicle) -> None:
    """What faces sideways sees the ground as much as the sky, and stays nearer to the ground's temperature."""
    a, b, c = (solid.vertices[solid.triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    upward = np.abs(normal[:, 2]) / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
    kelvin += 0.5 * np.clip(1 - 1.25 * upward, 0, 1) * (v.under_k - kelvin)


def _cabin_outline(ends: tuple[float, float], half: float, length: float) -> FloatArray:
    """(8, 2) outline of the greenhouse, corners cut; starts at the front right, counter-clockwise from above."""
    x0, x1 = ends[0] * length, ends[1] * length
    cut = 0.12
    return np.array(
        [
            (x1 - 1.6 * cut, -half), (x1, -half + 1.4 * cut), (x1, half - 1.4 * cut), (x1 - 1.6 * cut, half),
            (x0 + cut, half), (x0, half - cut), (x0, -half + cut), (x0 + cut, -half),
        ]
    )  # fmt: skip


def _large_vehicle(p: _Pieces, v: Vehicle) -> None:
    length, width, height = v.length_m, v.width_m, v.height_m
    if v.kind == "bus":
        p.add(
            shapes.moved(shapes.box((length, width, 0.75), 0.06, corner=0.2), (0, 0, 0.7)), v.paint_k, PAINT, v.solar_k
        )
        p.add(
            shapes.moved(
                shapes.box((length - 0.06, width - 0.06, height - 2.0), 0.02, corner=0.2), (0, 0, height / 2 + 0.1)
            ),
            v.glass_k, GLASS, 0.2 * v.solar_k,
        )  # fmt: skip
        p.add(
            shapes.moved(shapes.box((length, width, 0.9), 0.12, corner=0.25), (0, 0, height - 0.45)),
            v.paint_k,
            PAINT,
            v.solar_k,
        )
        for fx, warm in ((0.22, 1.2), (-0.18, 0.4)):
            p.add(
                shapes.moved(shapes.box((2.0, 1.5, 0.24), 0.05), (fx * length, 0, height + 0.1)),
                v.paint_k + warm,
                PAINT,
                v.solar_k,
            )
        # The engine sits at the rear.
        p.add(shapes.moved(shapes.box((0.16, width - 0.4, 0.9), 0.03), (-length / 2 - 0.01, 0, 0.9)), v.bonnet_k, PAINT)
        return
    cab = 2.0
    p.add(shapes.moved(shapes.box((length, 0.9, 0.3), 0.03), (0, 0, 0.75)), v.under_k, RUBBER)
    front = length / 2 - cab / 2
    p.add(shapes.moved(shapes.box((cab, width - 0.1, 1.0), 0.08), (front, 0, 1.0)), v.paint_k, PAINT, v.solar_k)
    p.add(shapes.moved(shapes.box((cab - 0.25, width - 0.2, 0.65), 0.06), (front - 0.1, 0, 1.75)), v.glass_k, GLASS)
    p.add(
        shapes.moved(shapes.box((cab - 0.3, width - 0.25, 0.15), 0.05), (front - 0.12, 0, 2.12)),
        v.paint_k,
        PAINT,
        v.solar_k,
    )
    p.add(shapes.moved(shapes.box((0.1, width - 0.6, 0.5), 0.03), (length / 2 + 0.01, 0, 0.85)), v.bonnet_k, PAINT)
    p.add(
        shapes.moved(
            shapes.box((length - cab - 0.25, width, height - 0.95), 0.04), (-(cab + 0.25) / 2, 0, (height + 0.95) / 2)
        ),
        v.paint_k + 0.4, PAINT, v.solar_k,
    )  # fmt: skip


# People -------------------------------------------------------------------------------------------------------


def person(q: Person, seat_m: float | None = None) -> Surface:
    """A clothed person with bare head and hands; `seat_m` is the height of the saddle sat on."""
    p = _Pieces()
    h, g = q.height_m / 1.72, q.girth
    swing = {"stand": 0.1, "walk": 0.42, "run": 0.68, "reach": 0.2, "ride": 0.0}[q.pose] * q.stride
    lean = {"stand": 0.0, "walk": 0.05, "run": 0.2, "reach": 0.05, "ride": 0.16}[q.pose]
    hip = 0.93 if seat_m is None else seat_m / h + 0.08
    chest = hip + 0.47
    fwd = lean * 0.47

    def at(x: float, y: float, z: float) -> tuple[float, float, float]:
        return (x * h, y * h, z * h)

    jacket, arm = 0.165 * g, 0.062 * g
    torso = shapes.sweep(
        [at(0, 0, hip - 0.06), at(0.3 * fwd, 0, hip + 0.16), at(0.9 * fwd, 0, chest - 0.06), at(fwd, 0, chest + 0.05)],
        [0.155 * g * h, 0.16 * g * h, 0.205 * g * h, 0.12 * h],
        [0.115 * g * h, jacket * 0.75 * h, 0.125 * g * h, 0.07 * h],
        n=8, up=(1.0, 0.0, 0.0), round_ends=True,
    )  # fmt: skip
    p.add(torso, q.top_k, CLOTH, q.solar_k, 0.5)
    for side in (-1, 1):
        a = swing * side
        if seat_m is None:
            knee = (0.40 * math.sin(a) + 0.05 * abs(a), 0.10 * side, hip - 0.42 * math.cos(a))
            trail = 0.9 * min(a, 0.0)
            foot = (knee[0] + 0.40 * math.sin(a + trail), 0.10 * side, max(knee[2] - 0.42 * math.cos(a + trail), 0.07))
        else:
            knee = (0.38, 0.13 * side, hip - 0.05)
            foot = (0.36, 0.13 * side, hip - 0.45)
        p.add(
            shapes.capsule(at(0, 0.095 * side, hip), at(*knee), 0.085 * g * h, 0.062 * h, n=6),
            q.legs_k,
            CLOTH,
            q.solar_k,
            0.4,
        )
        p.add(shapes.capsule(at(*knee), at(*foot), 0.06 * h, 0.048 * h, n=6), q.legs_k - 0.6, CLOTH, q.solar_k, 0.4)
        p.add(
            shapes.capsule(at(foot[0] - 0.05, foot[1], 0.045 if seat_m is None else foot[2]),
                           at(foot[0] + 0.15, foot[1], 0.04 if seat_m is None else foot[2]), 0.05 * h, n=6),
            q.legs_k - 3.5, CLOTH, q.solar_k,
        )  # fmt: skip
        # Arms swing against the legs; `spread` lifts them sideways, "reach" above the head.
        shoulder = (fwd, 0.215 * g * side, chest)
        if q.pose == "reach":
            elbow = (fwd + 0.12, (0.26 + 0.1 * q.spread) * side, chest + 0.28 * (q.spread - 0.5))
            hand = (elbow[0] + 0.12, elbow[1], elbow[2] + 0.26 * q.spread)
        elif q.pose == "ride":
            elbow = (fwd + 0.2, 0.27 * side, chest - 0.22)
            hand = (fwd + 0.42, 0.27 * side, chest - 0.3)
        else:
            b = -0.8 * swing * side
            out = math.sin(q.spread)
            elbow = (
                fwd + 0.28 * math.sin(b),
                (0.235 * g + 0.26 * out) * side,
                chest - 0.28 * math.cos(b) * (1 - 0.4 * out),
            )
            bend = 1.1 if q.pose == "run" else 0.25
            hand = (elbow[0] + 0.25 * math.sin(b + bend), elbow[1] + 0.03 * side, elbow[2] - 0.25 * math.cos(b + bend))
        p.add(
            shapes.capsule(at(*shoulder), at(*elbow), arm * h, 0.052 * g * h, n=6), q.top_k - 0.8, CLOTH, q.solar_k, 0.4
        )
        p.add(shapes.capsule(at(*elbow), at(*hand), 0.05 * g * h, 0.04 * h, n=6), q.top_k - 1.0, CLOTH, q.solar_k, 0.4)
        p.add(shapes.moved(shapes.ellipsoid((0.052 * h, 0.045 * h, 0.052 * h), 6, 4), at(*hand)), q.skin_k - 1.5, SKIN)
    head = at(fwd * 1.15 + 0.02, 0, chest + 0.235)
    p.add(shapes.capsule(at(fwd, 0, chest + 0.04), head, 0.058 * h, n=6), q.skin_k, SKIN)
    p.add(shapes.moved(shapes.ellipsoid((0.1 * h, 0.082 * h, 0.122 * h), 8, 6), head), q.skin_k, SKIN)
    p.add(
        shapes.moved(
            shapes.ellipsoid((0.1 * h, 0.09 * h, 0.105 * h), 8, 6), (head[0] - 0.025 * h, 0, head[2] + 0.035 * h)
        ),
        q.hair_k, CLOTH, q.solar_k,
    )  # fmt: skip
    return p.surface()


# Two-wheelers -------------------------------------------------------------------------------------------------


def cycle(c: Cycle) -> Surface:
    """A bicycle or scooter standing upright, front along +X, with its rider if it has one."""
    p = _Pieces()
    scooter = c.kind == "scooter"
    radius, base = (0.24, 0.62) if scooter else (0.34, 0.53)
    for x in (-base, base):
        if scooter:
            tyre = shapes.cylinder(radius, -0.06, 0.06, 10)
        else:
            tyre = shapes.lathe([(0.31, -0.02), (0.355, -0.02), (0.355, 0.02), (0.31, 0.02)], 12, wrap=True)
        tyre = shapes.placed(tyre, shapes.turn_x(math.pi / 2))
        p.add(
            shapes.moved(tyre, (x, 0, radius)),
            c.body_k + (c.motor_k - c.body_k) * (0.6 if x < 0 else 0.1),
            RUBBER,
            c.solar_k,
        )
    if scooter:
        rear = shapes.sweep(
            [(-0.78, 0, 0.62), (-0.45, 0, 0.6), (-0.02, 0, 0.52)], [0.13, 0.2, 0.15], [0.1, 0.17, 0.15], n=8
        )
        p.add(rear, c.body_k, PAINT, c.solar_k)
        p.add(shapes.moved(shapes.box((0.72, 0.34, 0.12), 0.06), (-0.4, 0, 0.79)), c.seat_k, CLOTH, c.solar_k)
        p.add(shapes.moved(shapes.box((0.5, 0.32, 0.12), 0.03), (0.18, 0, 0.3)), c.body_k, PAINT, c.solar_k)
        p.add(shapes.moved(shapes.box((0.3, 0.16, 0.2), 0.03), (-0.45, 0, 0.36)), c.motor_k, PAINT)
        shield = shapes.sweep(
            [(0.46, 0, 0.32), (0.42, 0, 0.7), (0.34, 0, 1.0)], [0.2, 0.25, 0.14], [0.06, 0.1, 0.12], n=8, up=(1, 0, 0)
        )
        p.add(shield, c.body_k, PAINT, c.solar_k)
        if c.cover:  # the padded wind guard that hangs before the rider's legs in winter
            p.add(shapes.moved(shapes.box((0.16, 0.74, 0.6), 0.06), (0.3, 0, 0.78)), c.body_k + 0.6, CLOTH, c.solar_k)
        elif c.rider is None:  # a box on the carrier
            p.add(shapes.moved(shapes.box((0.3, 0.34, 0.28), 0.04), (-0.88, 0, 0.9)), c.body_k - 0.2, PAINT, c.solar_k)
        bar_z, bar_x = 1.04, 0.32
    else:
        joints = {
            "rear": (-base, 0, radius),
            "crank": (-0.1, 0, 0.3),
            "seat": (-0.22, 0, 0.82),
            "head": (0.38, 0, 0.85),
            "front": (base, 0, radius),
        }
        for a_, b_ in (
            ("rear", "crank"),
            ("rear", "seat"),
            ("crank", "seat"),
            ("crank", "head"),
            ("seat", "head"),
            ("head", "front"),
        ):
            p.add(shapes.capsule(joints[a_], joints[b_], 0.025, n=4), c.body_k, METAL, c.solar_k)
        p.add(shapes.moved(shapes.box((0.26, 0.16, 0.07), 0.02), (-0.26, 0, 0.92)), c.seat_k, CLOTH, c.solar_k)
        p.add(shapes.moved(shapes.box((0.3, 0.34, 0.24), 0.02), (0.6, 0, 0.9)), c.body_k, METAL, c.solar_k)
        bar_z, bar_x = 1.0, 0.36
    p.add(shapes.capsule((bar_x, -0.33, bar_z), (bar_x, 0.33, bar_z), 0.035, n=6), c.body_k, RUBBER, c.solar_k)
    for side in (-1, 1):
        if scooter:
            p.add(
                shapes.moved(shapes.box((0.03, 0.13, 0.09), 0.01), (bar_x, 0.36 * side, bar_z + 0.2)),
                c.body_k - 1,
                GLASS,
            )
    if c.rider is not None:
        r = person(c.rider, seat_m=0.84 if scooter else 0.95)
        v = r.vertices_m - (0.3, 0.0, 0.0)
        p.add(Solid(v, r.triangles), r.kelvin, r.mirror, r.solar_k, r.grain_k)
    return p.surface()


# Trees --------------------------------------------------------------------------------------------------------


def tree_prototype(kind: str, index: int) -> Surface:
    """Prototype `index` of a kind of tree, 1 m high and 1 m in radius; temperatures are relative to the tree's."""
    # Prototypes are part of the program, like a model file: the same in every world.
    rng = np.random.Generator(np.random.PCG64([7, sorted(TREE_KINDS).index(kind), index]))
    if kind == "crown":
        return _crown(rng, 560, 0.30, 0.72)
    if kind == "shrub":
        return _crown(rng, 170, 0.05, 0.5)
    return _bare(rng)


def tree_matrix(t: Tree) -> FloatArray:
    """(4, 4) placement of a prototype."""
    m = np.eye(4)
    m[:3, :3] = shapes.turn_z(t.heading_rad) @ np.diag([t.radius_m, t.radius_m, t.height_m])
    m[:3, 3] = (t.x_m, t.y_m, 0.0)
    return m


def _crown(rng: np.random.Generator, clumps: int, low: float, centre: float) -> Surface:
    p = _Pieces()
    ball = _icosahedron()
    flatten = (1 - low) / 2
    trunk = shapes.capsule((0, 0, 0), (0, 0, 0.6), 0.06, 0.04, n=6)
    p.add(Solid(trunk.vertices * (1, 1, 1), trunk.triangles), 1.6, LEAF, 0.3, 0.3)
    # Lobes make the outline uneven, clumps make the lobes.
    lobes = rng.normal(size=(7, 3))
    lobes /= np.linalg.norm(lobes, axis=1, keepdims=True)
    for _ in range(clumps):
        d = rng.normal(size=3)
        d /= np.linalg.norm(d)
        bulge = 0.72 + 0.28 * float(np.max(np.clip(lobes @ d, 0, 1)) ** 3)
        r = bulge * float(rng.uniform(0.35, 1.0) ** 0.45)
        c = np.array([d[0] * r, d[1] * r, centre - 0.02 + d[2] * r * flatten])
        size = float(rng.uniform(0.07, 0.17))
        jitter = 1 + 0.38 * rng.uniform(-1, 1, (len(ball.vertices), 1))
        v = ball.vertices * jitter * (size, size, size * 0.62) + c
        v[:, 2] = np.clip(v[:, 2], 0.02, 1.0)
        # What sees the sky is colder, the inside keeps the trunk's warmth.
        warm = 0.75 * (1 - r) - 0.4 * d[2] + float(rng.normal(0, 0.7))
        p.add(Solid(v, ball.triangles), warm, LEAF, 1.0, 1.1)
    return p.surface()


def _bare(rng: np.random.Generator) -> Surface:
    """A tree in winter: trunk and branches."""
    p = _Pieces()

    def grow(start: FloatArray, direction: FloatArray, length: float, radius: float, level: int) -> None:
        end = start + direction * length
        up = np.array([1.0, 0, 0]) if abs(direction[0]) < 0.9 else np.array([0, 1.0, 0])
        p.add(shapes.sweep([start, end], [radius, radius * 0.65], n=4, up=up), 0.5 * (4 - level) - 0.6, LEAF, 0.5, 0.4)
        if level == 4:
            return
        for _ in range(3 if level < 3 else 2):
            turn = direction + rng.normal(0, 0.62, 3) + (0, 0, 0.12)
            turn /= np.linalg.norm(turn)
            grow(
                start + direction * length * float(rng.uniform(0.55, 1.0)),
                turn,
                length * float(rng.uniform(0.6, 0.85)),
                radius * 0.6,
                level + 1,
            )

    # Built 1 unit high and about 0.35 wide, then stretched to radius 1.
    grow(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.34, 0.014, 0)
    s = p.surface()
    v = s.vertices_m.copy()
    v[:, :2] /= max(float(np.percentile(np.hypot(v[:, 0], v[:, 1]), 97)), 1e-6)
    v[:, 2] = np.maximum(v[:, 2], 0) / float(v[:, 2].max())
    return Surface(v, s.triangles, s.kelvin, s.mirror, s.solar_k, s.grain_k)


def _icosahedron() -> Solid:
    """A ball of 20 triangles, radius 1."""
    g = (1 + 5**0.5) / 2
    v = [
        (-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g),
        (0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1),
    ]  # fmt: skip
    f = [
        (0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6),
        (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10),
        (8, 6, 7), (9, 8, 1),
    ]  # fmt: skip
    return Solid(np.array(v, np.float64) / math.hypot(1, g), np.array(f, np.int32))


# Buildings and furniture --------------------------------------------------------------------------------------


def building(b: Building) -> Surface:
    """A building about its own centre, length along +X."""
    rng = np.random.Generator(np.random.PCG64(b.seed))
    p = _Pieces()
    hx, hy, z = b.length_m / 2, b.width_m / 2, b.height_m
    corners = [(-hx, -hy), (hx, -hy), (hx, hy), (-hx, hy)]
    for k in range(4):
        (ax, ay), (bx, by) = corners[k], corners[(k + 1) % 4]
        p.add(quad((ax, ay, 0), (bx, by, 0), (bx, by, z), (ax, ay, z)), b.wall_k, WALL, b.solar_k, 0.4)
        _windows(p, b, rng, np.array([ax, ay]), np.array([bx, by]))
    if b.roof == "gable":
        _gable(p, b)
        return p.surface()
    p.add(
        quad((-hx, -hy, z - 0.1), (hx, -hy, z - 0.1), (hx, hy, z - 0.1), (-hx, hy, z - 0.1)),
        b.roof_k,
        ROOF,
        b.solar_k,
        0.5,
    )
    # Parapet: concrete that keeps warmer than the felt.
    for x, y, lx, ly in (
        (0, -hy, 2 * hx + 0.4, 0.35),
        (0, hy, 2 * hx + 0.4, 0.35),
        (-hx, 0, 0.35, 2 * hy),
        (hx, 0, 0.35, 2 * hy),
    ):
        p.add(
            shapes.moved(shapes.box((lx, ly, 0.75), 0.02), (x, y, z + 0.2)),
            0.5 * (b.wall_k + b.roof_k),
            WALL,
            b.solar_k,
            0.3,
        )
    for x in np.arange(-hx + 1.2, hx - 0.5, float(rng.uniform(1.8, 3.2))):  # seams of the roofing felt
        p.add(
            quad((x, -hy, z - 0.08), (x + 0.09, -hy, z - 0.08), (x + 0.09, hy, z - 0.08), (x, hy, z - 0.08)),
            b.roof_k + 0.9,
            ROOF,
            b.solar_k * 0.9,
        )
    if b.roof == "arrays":  # rows of solar heaters: tilted glass, a warm tank on top
        for x in np.arange(-hx + 1.5, hx - 2.2, 2.6):
            for y in np.arange(-hy + 1.0, hy - 2.0, 2.2):
                if rng.random() < 0.85:
                    p.add(
                        quad(
                            (x, y, z + 0.1), (x, y + 1.8, z + 0.1), (x + 1.6, y + 1.8, z + 1.2), (x + 1.6, y, z + 1.2)
                        ),
                        b.roof_k - 0.5,
                        GLASS,
                        b.solar_k * 0.5,
                    )
                    p.add(
                        shapes.capsule((x + 1.7, y, z + 1.3), (x + 1.7, y + 1.8, z + 1.3), 0.24, n=6),
                        b.wall_k + 4.0,
                        PAINT,
                    )
    else:
        for _ in range(int(rng.integers(2, 7))):
            size = rng.uniform((0.8, 0.8, 0.6), (2.4, 1.8, 1.5))
            x, y = (float(v) for v in rng.uniform(-1, 1, 2) * np.maximum((hx - 2, hy - 2), 0))
            warm = float(rng.uniform(4, 14)) if rng.random() < 0.35 else float(rng.uniform(-0.5, 2))
            p.add(shapes.moved(shapes.box(size, 0.05), (x, y, z + size[2] / 2)), b.roof_k + warm, PAINT, b.solar_k, 0.3)
        if rng.random() < 0.6:  # the stairs' head
            x = float(rng.uniform(-0.6, 0.6)) * max(hx - 3, 0.0)
            p.add(
                shapes.moved(shapes.box((3.4, 2.8, 2.5), 0.05), (x, hy * 0.3, z + 1.2)),
                0.6 * b.wall_k + 0.4 * b.roof_k,
                WALL,
                b.solar_k,
                0.3,
            )
    return p.surface()


def _windows(p: _Pieces, b: Building, rng: np.random.Generator, a: FloatArray, c: FloatArray) -> None:
    """Windows and a band per storey on the wall from `a` to `c`, 3 cm before it."""
    span = float(np.linalg.norm(c - a))
    along = (c - a) / span
    out = np.array([along[1], -along[0]])
    columns, storeys = int(span / 3.0), max(int(b.height_m / 3.1), 1)

    def face(s0: float, s1: float, z0: float, z1: float, off: float) -> Solid:
        lo, hi = a + along * s0 + out * off, a + along * s1 + out * off
        return quad((*lo, z0), (*hi, z0), (*hi, z1), (*lo, z1))

    for f in range(storeys):
        z0 = 0.95 + 3.1 * f
        if z0 + 1.6 > b.height_m:
            break
        p.add(face(0.1, span - 0.1, z0 + 1.85, z0 + 2.05, 0.02), b.wall_k + 0.9, WALL, b.solar_k)
        for k in range(columns):
            s0 = (span - 3.0 * columns) / 2 + 3.0 * k + 0.65
            lit = rng.random() < b.lit_share
            p.add(face(s0 - 0.12, s0 + 1.82, z0 - 0.12, z0 + 1.62, 0.025), b.wall_k + 0.7, WALL, b.solar_k)
            p.add(
                face(s0, s0 + 1.7, z0, z0 + 1.5, 0.03),
                b.window_k + (3.5 if lit else float(rng.normal(0, 0.5))),
                GLASS,
                0.2 * b.solar_k,
            )


def _gable(p: _Pieces, b: Building) -> None:
    hx, hy, z = b.length_m / 2 + 0.5, b.width_m / 2 + 0.5, b.height_m
    rise = 0.42 * hy
    ridge0, ridge1 = (-hx, 0, z + rise), (hx, 0, z + rise)
    for side in (-1, 1):
        p.add(quad((-hx, side * hy, z - 0.1), (hx, side * hy, z - 0.1), ridge1, ridge0), b.roof_k, ROOF, b.solar_k, 0.6)
        for x in np.arange(-hx + 0.8, hx, 1.1):  # the sheets' ribs
            p.add(
                quad(
                    (x, side * hy, z - 0.06),
                    (x + 0.08, side * hy, z - 0.06),
                    (x + 0.08, 0, z + rise + 0.04),
                    (x, 0, z + rise + 0.04),
                ),
                b.roof_k + 1.2,
                ROOF,
                b.solar_k,
            )
    wx, wy = b.length_m / 2, b.width_m / 2
    for x in (-wx, wx):
        tri = Solid(
            np.array([(x, -wy, z - 0.1), (x, wy, z - 0.1), (x, 0.0, z + rise - 0.15)]), np.array([[0, 1, 2]], np.int32)
        )
        p.add(tri, b.wall_k, WALL, b.solar_k, 0.4)
    p.add(
        shapes.moved(shapes.box((2 * hx, 0.35, 0.14), 0.03), (0, 0, z + rise + 0.03)), b.roof_k + 1.5, WALL, b.solar_k
    )


def post(q: Post) -> Surface:
    """Street furniture about its foot, arm or length along +X."""
    p = _Pieces()
    h = q.height_m
    if q.kind == "lamp":
        p.add(shapes.capsule((0, 0, 0), (0, 0, h), 0.1, 0.06, n=6), q.pole_k, METAL)
        p.add(shapes.capsule((0, 0, h), (q.length_m, 0, h + 0.25), 0.05, n=4), q.pole_k, METAL)
        p.add(shapes.moved(shapes.box((0.75, 0.32, 0.14), 0.04), (q.length_m + 0.2, 0, h + 0.24)), q.head_k, METAL)
    elif q.kind == "hoop":
        p.add(shapes.moved(shapes.box((1.5, 0.9, 0.4), 0.05), (-0.4, 0, 0.2)), q.pole_k, PAINT)
        p.add(shapes.capsule((0, 0, 0.3), (0.5, 0, h - 0.3), 0.11, n=6), q.pole_k, METAL)
        p.add(shapes.capsule((0.5, 0, h - 0.35), (q.length_m, 0, h - 0.2), 0.07, n=6), q.pole_k, METAL)
        p.add(shapes.moved(shapes.box((0.06, 1.8, 1.05), 0.01), (q.length_m, 0, h)), q.head_k, GLASS)
        ring = shapes.lathe([(0.22, -0.02), (0.25, -0.02), (0.25, 0.02), (0.22, 0.02)], 12, wrap=True)
        p.add(shapes.moved(ring, (q.length_m + 0.35, 0, h - 0.4)), q.pole_k, METAL)
    elif q.kind == "fence":
        half = q.length_m / 2
        for x in np.arange(-half, half + 0.1, 3.0):
            p.add(shapes.capsule((x, 0, 0), (x, 0, h), 0.045, n=4), q.pole_k, METAL)
        for z in (0.15, h / 2, h):
            p.add(shapes.sweep([(-half, 0, z), (half, 0, z)], 0.03, n=4), q.pole_k, METAL)
    elif q.kind == "bin":
        p.add(shapes.cylinder(0.3, 0, h, 8), q.pole_k, PAINT)
    elif q.kind == "bollard":
        p.add(shapes.cylinder(0.1, 0, h, 6), q.pole_k, PAINT)
    else:
        p.add(shapes.moved(shapes.box((q.length_m, 0.5, 0.1), 0.02), (0, 0, h)), q.pole_k, CLOTH)
    return p.surface()


def placed(s: Surface, x_m: float, y_m: float, heading_rad: float) -> FloatArray:
    """(V, 3) vertices of a surface turned and moved to its place."""
    return np.asarray(s.vertices_m @ shapes.turn_z(heading_rad).T + (x_m, y_m, 0.0))


def tree_outline(t: Tree, points: Sequence[tuple[float, float, float]]) -> FloatArray:
    """(N, 3) points of a tree's unit frame in the world."""
    m = tree_matrix(t)
    return np.asarray(np.asarray(points, np.float64) @ m[:3, :3].T + m[:3, 3])
