"""Bicycles and scooters, parked or ridden: their temperatures and bodies."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from infrablend.assets import shapes
from infrablend.assets.shapes import Solid
from infrablend.world.draws import Draws
from infrablend.world.people import Person, draw_person, person
from infrablend.world.surfaces import CLOTH, GLASS, METAL, PAINT, RUBBER, Surface, SurfaceBuilder
from infrablend.world.weather import Weather


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

    @property
    def category(self) -> str:
        """Class of the label."""
        return "Bicycle"


def draw_cycle(draws: Draws, weather: Weather, x: float, y: float, heading: float, ridden: bool) -> Cycle:
    """Draw a two-wheeler, ridden or parked: its kind, temperatures and rider."""
    u, a = draws.uniform, weather.air_k
    scooter = draws.chance(0.8)
    if weather.night:
        body, seat, solar = a - 0.6 - 3.6 * weather.clear_sky + u(-0.8, 0.8), a - 1 - 2.5 * weather.clear_sky, 0.0
    else:
        body, seat, solar = a + u(0, 4), a + u(2, 8), weather.solar * u(6, 22)
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
