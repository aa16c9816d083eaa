"""Cars, vans, buses and trucks: their sizes and temperatures, and their bodies."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from infrablend.assets import shapes
from infrablend.assets.shapes import Solid
from infrablend.core.mesh import FloatArray
from infrablend.lab.world.setting import Draws, Weather
from infrablend.lab.world.thermal_surfaces import GLASS, PAINT, RUBBER, Surface, SurfaceBuilder, triangle_centres

Position = tuple[float, float, float]  # x, y, heading
VehicleKind = Literal["sedan", "suv", "van", "bus", "truck"]
# Everyday cars, all entries equally likely: repeated entries are more common.
CARS: tuple[VehicleKind, ...] = ("sedan", "sedan", "suv", "suv", "van")

# (x / length, half width factor, height of the deck over the road) from the rear bumper to the front.
_SEDAN = ((-0.5, 0.80, 0.60), (-0.485, 0.92, 0.86), (-0.40, 0.98, 0.98), (-0.2, 1.0, 0.98), (0.1, 1.0, 0.97),
          (0.22, 0.99, 0.95), (0.40, 0.96, 0.82), (0.475, 0.88, 0.70), (0.5, 0.72, 0.52))  # fmt: skip
_SUV = ((-0.5, 0.86, 0.65), (-0.485, 0.95, 1.0), (-0.40, 0.99, 1.05), (-0.2, 1.0, 1.05), (0.1, 1.0, 1.04),
        (0.24, 0.99, 1.03), (0.42, 0.96, 0.95), (0.485, 0.90, 0.80), (0.5, 0.78, 0.55))  # fmt: skip


@dataclass(frozen=True)
class Vehicle:
    """A car, van, bus or truck; temperatures before sun and sky reflection."""

    kind: VehicleKind
    x_m: float
    y_m: float
    heading_rad: float
    length_m: float
    width_m: float
    height_m: float
    paint_k: float
    glass_k: float
    bonnet_k: float
    wheel_k: float
    under_k: float
    solar_k: float

    @property
    def category(self) -> str:
        """Class of the label."""
        return "OtherVehicle" if self.kind in ("bus", "truck") else "Car"


def draw_vehicle(draws: Draws, weather: Weather, kind: VehicleKind, at: Position, driven: bool, warm: bool) -> Vehicle:
    """Draw the size and the temperatures of a vehicle: driven, parked a moment ago (`warm`) or parked for long."""
    u, a = draws.uniform, weather.air_k
    size = {
        "sedan": (4.35, 4.85, 1.74, 1.86, 1.42, 1.5),
        "suv": (4.1, 4.75, 1.78, 1.92, 1.58, 1.75),
        "van": (4.5, 5.3, 1.8, 2.0, 1.85, 2.2),
        "bus": (9.5, 12.0, 2.45, 2.55, 2.9, 3.2),
        "truck": (6.0, 8.5, 2.1, 2.45, 2.5, 3.3),
    }[kind]
    length = u(*size[:2])
    width = u(*size[2:4])
    height = u(*size[4:])
    if weather.night:
        paint = a - 0.6 - 4.2 * weather.clear_sky + u(-1.0, 1.0)
        glass = paint + u(-1.0, 3.2)
        bonnet = (
            a + (u(8, 22) if draws.chance(0.35) else u(-3, 6))
            if driven
            else a + u(3, 10)
            if warm
            else paint + u(-0.3, 2.0)
        )
        wheel = a + (u(5, 12) if driven else u(-1.5, 1.5))
        under = a + (u(4, 10) if driven else u(0.5, 3))
        solar = 0.0
    else:
        # Dark paint absorbs up to three times as much sunlight as white paint.
        solar = weather.solar * u(1, 26)
        paint = a + u(1, 5)
        glass = a + u(-2, 8)
        bonnet = paint + (u(6, 16) if driven else u(0, 3))
        wheel = a + u(5, 14)
        under = a + u(0, 6)
    return Vehicle(kind, *at, length, width, height, paint, glass, bonnet, wheel, under, solar)


def vehicle(v: Vehicle) -> Surface:
    """Return a vehicle standing on the ground, nose along +X."""
    p = SurfaceBuilder()
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


def _car(p: SurfaceBuilder, v: Vehicle) -> None:
    rise = v.height_m / (1.46 if v.kind == "sedan" else 1.66)
    _car_body(p, v, rise)
    _car_cabin(p, v, rise)


def _car_body(p: SurfaceBuilder, v: Vehicle, rise: float) -> None:
    half = v.width_m / 2
    length = v.length_m
    stations = _SEDAN if v.kind == "sedan" else _SUV
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
    centre = triangle_centres(body)
    bonnet_from = 0.22 * length
    kelvin = np.full(len(centre), v.paint_k)
    on_bonnet = (centre[:, 0] > bonnet_from) & (centre[:, 2] > 0.55)
    kelvin[on_bonnet] = v.bonnet_k
    # The grille and the wheel arches let warm air out.
    kelvin[(centre[:, 0] > 0.46 * length) & (centre[:, 2] < 0.6)] = 0.5 * (v.bonnet_k + v.paint_k)
    _warm_flanks(kelvin, body, v)
    kelvin[centre[:, 2] < 0.3] = v.under_k
    p.add(body, kelvin, PAINT, v.solar_k)


def _car_cabin(p: SurfaceBuilder, v: Vehicle, rise: float) -> None:
    """Add the cabin, glass between belt line and roof, and the mirrors."""
    half = v.width_m / 2
    length = v.length_m
    if v.kind == "sedan":
        base = (-0.36, 0.24)
        roof = (-0.22, 0.07)
        belt = 0.95 * rise
    elif v.kind == "suv":
        base = (-0.48, 0.26)
        roof = (-0.43, 0.10)
        belt = 1.02 * rise
    else:
        base = (-0.49, 0.36)
        roof = (-0.475, 0.22)
        belt = 1.02 * rise
    top = v.height_m
    lower = _cabin_outline(base, 0.93 * half, length)
    upper = _cabin_outline(roof, (0.74 if v.kind != "van" else 0.84) * half, length)
    inner = upper * (0.9, 0.86) + ((roof[0] + roof[1]) / 2 * length * 0.1, 0)
    cabin = shapes.stack([(belt - 0.04, lower), (top - 0.06, upper), (top, inner)], sharp=False)
    centre = triangle_centres(cabin)
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
        p.box((0.1, 0.16, 0.1), 0.02, (0.2 * length, side * (half + 0.02), belt + 0.02), v.paint_k, PAINT, v.solar_k)


def _warm_flanks(kelvin: FloatArray, solid: Solid, v: Vehicle) -> None:
    """Return the temperature of a side, which faces ground and sky alike and stays near the ground's."""
    a, b, c = (solid.vertices[solid.triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    upward = np.abs(normal[:, 2]) / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
    kelvin += 0.5 * np.clip(1 - 1.25 * upward, 0, 1) * (v.under_k - kelvin)


def _cabin_outline(ends: tuple[float, float], half: float, length: float) -> FloatArray:
    """Return the (8, 2) outline of the cabin with cut corners, counter-clockwise from the front right."""
    x0, x1 = ends[0] * length, ends[1] * length
    cut = 0.12
    return np.array(
        [
            (x1 - 1.6 * cut, -half), (x1, -half + 1.4 * cut), (x1, half - 1.4 * cut), (x1 - 1.6 * cut, half),
            (x0 + cut, half), (x0, half - cut), (x0, -half + cut), (x0 + cut, -half),
        ]
    )  # fmt: skip


def _large_vehicle(p: SurfaceBuilder, v: Vehicle) -> None:
    length = v.length_m
    width = v.width_m
    height = v.height_m
    if v.kind == "bus":
        p.box((length, width, 0.75), 0.06, (0, 0, 0.7), v.paint_k, PAINT, v.solar_k, corner=0.2)
        p.box(
            (length - 0.06, width - 0.06, height - 2.0),
            0.02,
            (0, 0, height / 2 + 0.1),
            v.glass_k,
            GLASS,
            0.2 * v.solar_k,
            corner=0.2,
        )
        p.box((length, width, 0.9), 0.12, (0, 0, height - 0.45), v.paint_k, PAINT, v.solar_k, corner=0.25)
        for fx, warm in ((0.22, 1.2), (-0.18, 0.4)):
            p.box((2.0, 1.5, 0.24), 0.05, (fx * length, 0, height + 0.1), v.paint_k + warm, PAINT, v.solar_k)
        # The engine sits at the rear.
        p.box((0.16, width - 0.4, 0.9), 0.03, (-length / 2 - 0.01, 0, 0.9), v.bonnet_k, PAINT)
        return
    cab = 2.0
    p.box((length, 0.9, 0.3), 0.03, (0, 0, 0.75), v.under_k, RUBBER)
    front = length / 2 - cab / 2
    p.box((cab, width - 0.1, 1.0), 0.08, (front, 0, 1.0), v.paint_k, PAINT, v.solar_k)
    p.box((cab - 0.25, width - 0.2, 0.65), 0.06, (front - 0.1, 0, 1.75), v.glass_k, GLASS)
    p.box((cab - 0.3, width - 0.25, 0.15), 0.05, (front - 0.12, 0, 2.12), v.paint_k, PAINT, v.solar_k)
    p.box((0.1, width - 0.6, 0.5), 0.03, (length / 2 + 0.01, 0, 0.85), v.bonnet_k, PAINT)
    p.box(
        (length - cab - 0.25, width, height - 0.95),
        0.04,
        (-(cab + 0.25) / 2, 0, (height + 0.95) / 2),
        v.paint_k + 0.4,
        PAINT,
        v.solar_k,
    )
