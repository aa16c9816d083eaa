"""People and two-wheelers, parked or ridden: their sizes, poses, temperatures and bodies."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from infrablend.assets import shapes
from infrablend.assets.shapes import Solid
from infrablend.lab.world.setting import Draws, Weather
from infrablend.lab.world.thermal_surfaces import CLOTH, GLASS, METAL, PAINT, RUBBER, SKIN, Surface, SurfaceBuilder

Pose = Literal["stand", "walk", "run", "reach", "ride"]
# All entries equally likely: repeated entries are more common.
EVERYDAY_POSES: tuple[Pose, ...] = ("stand", "stand", "walk", "walk", "walk", "run")
GAME_POSES: tuple[Pose, ...] = ("stand", "run", "run", "reach", "walk")


@dataclass(frozen=True)
class Person:
    """A person; `stride` in [-1, 1] is the phase of the step, `spread` how far the arms are raised."""

    x_m: float
    y_m: float
    heading_rad: float
    height_m: float
    girth: float
    pose: Pose
    stride: float
    spread: float
    skin_k: float
    hair_k: float
    top_k: float
    legs_k: float
    solar_k: float

    category = "Person"


def draw_person(draws: Draws, weather: Weather, x: float, y: float, heading: float, pose: Pose) -> Person:
    """Draw the size, stride and temperatures of a person in a given pose."""
    u, a = draws.uniform, weather.air_k
    skin = a + min(306.0 - a, 30.0) * u(0.75, 0.95)
    if weather.night:
        top = a + u(8.5, 16)
        legs = a + u(8, 15)
        hair = a + u(8, 14)
        solar = 0.0
    else:
        # Dark cloth in the sun glows, light cloth does not; top and trousers differ.
        top = a + u(7, 17)
        legs = a + u(5, 15)
        hair = a + u(8, 13)
        solar = weather.solar * u(5, 20)
    return Person(
        x_m=x, y_m=y, heading_rad=heading, height_m=u(1.56, 1.84), girth=u(1.05, 1.4), pose=pose,
        stride=u(-1, 1), spread=u(0.05, 0.35) if pose != "reach" else u(0.6, 1.0),
        skin_k=skin, hair_k=hair, top_k=top, legs_k=legs, solar_k=solar,
    )  # fmt: skip


def _arm(
    q: Person, side: int, swing: float, fwd: float, chest: float
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return elbow and hand, in heights: arms swing against the legs; `spread` lifts them, "reach" above the head."""
    if q.pose == "reach":
        elbow = (fwd + 0.12, (0.26 + 0.1 * q.spread) * side, chest + 0.28 * (q.spread - 0.5))
        return elbow, (elbow[0] + 0.12, elbow[1], elbow[2] + 0.26 * q.spread)
    if q.pose == "ride":
        return (fwd + 0.2, 0.27 * side, chest - 0.22), (fwd + 0.42, 0.27 * side, chest - 0.3)
    b = -0.8 * swing * side
    out = math.sin(q.spread)
    elbow = (
        fwd + 0.28 * math.sin(b),
        (0.235 * q.girth + 0.26 * out) * side,
        chest - 0.28 * math.cos(b) * (1 - 0.4 * out),
    )
    bend = 1.1 if q.pose == "run" else 0.25
    hand = (elbow[0] + 0.25 * math.sin(b + bend), elbow[1] + 0.03 * side, elbow[2] - 0.25 * math.cos(b + bend))
    return elbow, hand


def person(q: Person, seat_m: float | None = None) -> Surface:
    """Return a clothed person with bare head and hands; `seat_m` is the height of the saddle of a rider."""
    p = SurfaceBuilder()
    h, g = q.height_m / 1.72, q.girth
    swing = {"stand": 0.1, "walk": 0.42, "run": 0.68, "reach": 0.2, "ride": 0.0}[q.pose] * q.stride
    lean = {"stand": 0.0, "walk": 0.05, "run": 0.2, "reach": 0.05, "ride": 0.16}[q.pose]
    hip = 0.93 if seat_m is None else seat_m / h + 0.08
    chest = hip + 0.47
    fwd = lean * 0.47

    def at(x: float, y: float, z: float) -> tuple[float, float, float]:
        return (x * h, y * h, z * h)

    jacket = 0.165 * g
    arm = 0.062 * g
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
        p.bar(at(0, 0.095 * side, hip), at(*knee), (0.085 * g * h, 0.062 * h), q.legs_k, CLOTH, q.solar_k, 0.4)
        p.bar(at(*knee), at(*foot), (0.06 * h, 0.048 * h), q.legs_k - 0.6, CLOTH, q.solar_k, 0.4)
        p.bar(
            at(foot[0] - 0.05, foot[1], 0.045 if seat_m is None else foot[2]),
            at(foot[0] + 0.15, foot[1], 0.04 if seat_m is None else foot[2]),
            0.05 * h,
            q.legs_k - 3.5,
            CLOTH,
            q.solar_k,
        )
        shoulder = (fwd, 0.215 * g * side, chest)
        elbow, hand = _arm(q, side, swing, fwd, chest)
        p.bar(at(*shoulder), at(*elbow), (arm * h, 0.052 * g * h), q.top_k - 0.8, CLOTH, q.solar_k, 0.4)
        p.bar(at(*elbow), at(*hand), (0.05 * g * h, 0.04 * h), q.top_k - 1.0, CLOTH, q.solar_k, 0.4)
        p.add(shapes.moved(shapes.ellipsoid((0.052 * h, 0.045 * h, 0.052 * h), 6, 4), at(*hand)), q.skin_k - 1.5, SKIN)
    head = at(fwd * 1.15 + 0.02, 0, chest + 0.235)
    p.bar(at(fwd, 0, chest + 0.04), head, 0.058 * h, q.skin_k, SKIN)
    p.add(shapes.moved(shapes.ellipsoid((0.1 * h, 0.082 * h, 0.122 * h), 8, 6), head), q.skin_k, SKIN)
    hair = shapes.ellipsoid((0.1 * h, 0.09 * h, 0.105 * h), 8, 6)
    p.add(shapes.moved(hair, (head[0] - 0.025 * h, 0, head[2] + 0.035 * h)), q.hair_k, CLOTH, q.solar_k)
    return p.surface()


@dataclass(frozen=True)
class Cycle:
    """A bicycle or scooter, perhaps with its rider, who belongs to its label as in HIT-UAV."""

    kind: Literal["bicycle", "scooter"]
    x_m: float
    y_m: float
    heading_rad: float
    body_k: float
    seat_k: float
    motor_k: float
    solar_k: float
    cover: bool
    rider: Person | None

    category = "Bicycle"


def draw_cycle(draws: Draws, weather: Weather, x: float, y: float, heading: float, ridden: bool) -> Cycle:
    """Draw a two-wheeler, ridden or parked: its kind, temperatures and rider."""
    u, a = draws.uniform, weather.air_k
    scooter = draws.chance(0.8)
    if weather.night:
        body = a - 0.6 - 3.6 * weather.clear_sky + u(-0.8, 0.8)
        seat = a - 1 - 2.5 * weather.clear_sky
        solar = 0.0
    else:
        body = a + u(0, 4)
        seat = a + u(2, 8)
        solar = weather.solar * u(6, 22)
    motor = a + (u(8, 20) if ridden else u(-1, 1))
    rider = replace(draw_person(draws, weather, x, y, heading, "ride"), stride=0.0) if ridden else None
    return Cycle(
        "scooter" if scooter else "bicycle", x, y, heading, body, seat, motor, solar,
        cover=scooter and draws.chance(0.5), rider=rider,
    )  # fmt: skip


def cycle(c: Cycle) -> Surface:
    """Return a bicycle or scooter standing upright, front along +X, with its rider if it has one."""
    p = SurfaceBuilder()
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
        p.box((0.72, 0.34, 0.12), 0.06, (-0.4, 0, 0.79), c.seat_k, CLOTH, c.solar_k)
        p.box((0.5, 0.32, 0.12), 0.03, (0.18, 0, 0.3), c.body_k, PAINT, c.solar_k)
        p.box((0.3, 0.16, 0.2), 0.03, (-0.45, 0, 0.36), c.motor_k, PAINT)
        shield = shapes.sweep(
            [(0.46, 0, 0.32), (0.42, 0, 0.7), (0.34, 0, 1.0)], [0.2, 0.25, 0.14], [0.06, 0.1, 0.12], n=8, up=(1, 0, 0)
        )
        p.add(shield, c.body_k, PAINT, c.solar_k)
        if c.cover:  # the padded wind guard that hangs before the rider's legs in winter
            p.box((0.16, 0.74, 0.6), 0.06, (0.3, 0, 0.78), c.body_k + 0.6, CLOTH, c.solar_k)
        elif c.rider is None:  # a box on the carrier
            p.box((0.3, 0.34, 0.28), 0.04, (-0.88, 0, 0.9), c.body_k - 0.2, PAINT, c.solar_k)
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
            p.bar(joints[a_], joints[b_], 0.025, c.body_k, METAL, c.solar_k, n=4)
        p.box((0.26, 0.16, 0.07), 0.02, (-0.26, 0, 0.92), c.seat_k, CLOTH, c.solar_k)
        p.box((0.3, 0.34, 0.24), 0.02, (0.6, 0, 0.9), c.body_k, METAL, c.solar_k)
        bar_z, bar_x = 1.0, 0.36
    p.bar((bar_x, -0.33, bar_z), (bar_x, 0.33, bar_z), 0.035, c.body_k, RUBBER, c.solar_k)
    for side in (-1, 1):
        if scooter:
            p.box((0.03, 0.13, 0.09), 0.01, (bar_x, 0.36 * side, bar_z + 0.2), c.body_k - 1, GLASS)
    if c.rider is not None:
        r = person(c.rider, seat_m=0.84 if scooter else 0.95)
        v = r.vertices_m - (0.3, 0.0, 0.0)
        p.add(Solid(v, r.triangles), r.kelvin, r.mirror, r.solar_k, r.grain_k)
    return p.surface()
