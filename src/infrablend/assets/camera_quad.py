"""Camera quadrotor model: body and arms moulded in one piece, a landing gear of two bows, a camera between them.

The body is an implicit surface (`assets.implicit`), so that the arms grow out of it; few distinct ones exist, which are
cached. All lengths are for a motor-to-motor diagonal of 1 and are scaled at the end. +X is the heading, +Y points left,
+Z up. Proportions follow the camera drones with fixed arms that were sold before folding ones, diagonals 0.25 to 0.6 m;
they are still flown, and appear in most public data sets of drones. Temperatures: docs/explanation/models.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from infrablend.assets import shapes
from infrablend.assets.drone import PARTS as DRONE_PARTS
from infrablend.assets.implicit import Body, concatenate, ellipsoid, surface, tube
from infrablend.assets.model import Params, PartRange
from infrablend.assets.params import Choice, Dials, Number
from infrablend.assets.rotors import PROPELLERS, Pieces, Propeller, Rotors, multirotor
from infrablend.assets.shapes import Solid
from infrablend.core.mesh import FloatArray

_UNUSED = ("esc", "frame", "arm")
PARTS: Mapping[str, PartRange] = {name: role for name, role in DRONE_PARTS.items() if name not in _UNUSED}
DIALS = Dials(
    "camera-quad",
    {
        "size_m": Number((0.25, 0.60), (0.05, 2.0), log=True),
        "form": Choice(("round", "slim", "flat"), (0.5, 0.3, 0.2)),
        "legs": Choice(("bows", "stubs", "raised"), (0.65, 0.2, 0.15), "raised ones are at the sides in flight"),
        "camera": Choice((True, False), (0.8, 0.2)),
        "blades": Choice((2, 3), (0.9, 0.1)),
        "propellers": Choice(PROPELLERS, (1.0, 0.0), "spinning ones are translucent discs that labels ignore"),
        "body_height": Number((0.85, 1.2), (0.7, 1.4)),
        "motor_radius": Number((0.85, 1.2), (0.7, 1.4)),
        "propeller_radius": Number((0.82, 0.97), (0.5, 0.98)),
        "propeller_angle_deg": Number((0.0, 360.0), (-3600.0, 3600.0)),
        "leg_height": Number((0.85, 1.2), (0.6, 1.4)),
        "gimbal_pitch_deg": Number((-10.0, 60.0), (-30.0, 90.0)),
        "lean_deg": Number((0.0, 18.0), (-45.0, 45.0)),
    },
)

# Form -> half length, half width and half height of the body; half width and half height of an arm at the body and at
# the motor.
_FORMS: Mapping[str, tuple[tuple[float, float, float], tuple[float, float], tuple[float, float]]] = {
    "round": ((0.235, 0.205, 0.088), (0.085, 0.052), (0.042, 0.030)),
    "slim": ((0.255, 0.150, 0.080), (0.060, 0.042), (0.034, 0.026)),
    "flat": ((0.225, 0.225, 0.060), (0.095, 0.036), (0.050, 0.026)),
}
_CELL = 0.020
_ARM_Z = 0.012
_WARM = 0.84  # share of an arm from which the motor heats it


def _motors_xy() -> FloatArray:
    turn = np.radians([45.0, 135.0, 225.0, 315.0])
    return np.asarray(0.5 * np.stack([np.cos(turn), np.sin(turn)], axis=1))


def _rotors(p: Params) -> Rotors:
    propeller = Propeller(
        math.sqrt(0.125) * float(p["propeller_radius"]), p["blades"], 1.0, p["propellers"] == "spinning"
    )
    r = 0.040 * float(p["motor_radius"])
    start = float(p["propeller_angle_deg"])
    seat = _ARM_Z + 0.8 * _FORMS[p["form"]][2][1] * float(p["body_height"])
    return Rotors(_motors_xy(), seat, r, 0.75 * r, propeller, tuple(start + 137.5 * k for k in range(4)))


def build_pieces(p: Params) -> Pieces:
    """Return the closed solids of one level aircraft, for a diagonal of 1."""
    out = Pieces()
    height = float(p["body_height"])
    for part, solid in _skin(p["form"]).items():
        out.add(part, Solid(solid.vertices * (1.0, 1.0, height), solid.triangles))
    _add_fittings(out, p, height)
    _add_legs(out, p, height)
    if p["camera"]:
        _add_camera(out, p, height)
    _rotors(p).add_to(out)
    return out


@lru_cache(maxsize=8)
def _skin(form: str) -> dict[str, Solid]:
    """Return body and inner arms as one skin, and the warm ends of the arms."""
    (length, width, height), inner, outer = _FORMS[form]
    arms = []
    ends = []
    for x, y in _motors_xy().tolist():
        root = np.array([0.45 * x, 0.45 * y, 0.0])
        tip = np.array([x, y, _ARM_Z])
        side = (-y, x, 0.0)
        t = np.array([0.0, 0.35, _WARM])
        path = root + t[:, None] * (tip - root)
        wide, tall = (np.interp(t, [0.0, 1.0], (inner[k], outer[k])) for k in (0, 1))
        arms.append(tube("shell", path, wide, tall, side=side, blend=0.09, caps=(0.05, 0.03)))
        end = np.stack([root + (_WARM - 0.06) * (tip - root), tip])
        ends.append(shapes.sweep(end, 0.98 * outer[0], 0.98 * outer[1], n=20, exponent=2.4, round_ends=True))
    hull = ellipsoid("shell", (0.0, 0.0, 0.0), (length, width, height))
    deck = ellipsoid("shell", (-0.03, 0.0, 0.25 * height), (0.8 * length, 0.75 * width, 0.9 * height), blend=0.05)
    vertices, triangles = surface(Body((hull, deck, *arms)), _CELL)
    return {"shell": Solid(vertices, triangles), "motor_mount": Solid(*concatenate(ends))}


def _add_fittings(out: Pieces, p: Params, height: float) -> None:
    """Add the battery in the tail, air outlets, and the satellite receiver under its cover."""
    (length, width, tall), _, _ = _FORMS[p["form"]]
    tall *= height
    pack = shapes.box((0.9 * length, 0.85 * width, 0.9 * tall), 0.15 * tall, corner=0.25 * width, steps=3)
    out.add("battery", pack, at=(-0.62 * length, 0.0, 0.22 * tall))
    for k in (-1, 1):
        slat = shapes.box((0.10, 0.018, 0.018), 0.004)
        out.add("vent", slat, at=(-0.1 * length, 0.9 * k * width, -0.40 * tall), smooth=False)
    out.add("vent", shapes.cylinder(0.30 * width, -1.02 * tall, -0.8 * tall, 20, 0.004), at=(-0.25 * length, 0.0, 0.0))
    eye = shapes.placed(shapes.cylinder(0.016, -0.04, 0.012, 14, 0.003), shapes.turn_y(math.pi / 2))
    out.add_both_sides("lens", shapes.moved(eye, (0.93 * length, 0.22 * width, 0.05 * tall)))
    cap = shapes.ellipsoid((0.20 * length, 0.32 * width, 0.28 * tall), 18, 10)
    out.add("antenna", cap, at=(0.30 * length, 0.0, 0.95 * tall))


def _add_legs(out: Pieces, p: Params, height: float) -> None:
    (length, width, tall), _, _ = _FORMS[p["form"]]
    ground = -height * tall - 0.19 * float(p["leg_height"])
    if p["legs"] == "stubs":
        for x, y in _motors_xy().tolist():
            high = (0.97 * x, 0.97 * y, 0.0)
            low = (1.02 * x, 1.02 * y, 0.5 * ground)
            out.add("leg", shapes.capsule(high, low, 0.022, 0.014, n=12))
        return
    raised = p["legs"] == "raised"
    foot = np.array([0.0, width + 0.16, 0.02]) if raised else np.array([0.0, 1.05 * width + 0.03, ground])
    hip = np.array([0.0, 0.62 * width, -0.55 * height * tall])
    reach = 0.62 * length
    across = (1.0, 0.0, 0.0)
    knee = 0.5 * (hip + foot) + np.array([0.0, 0.015, 0.0])
    for x in (0.75 * reach, -0.75 * reach):
        strut = np.stack([hip, knee, foot]) + np.outer([0.55 * x, 0.9 * x, x], across)
        out.add_both_sides("leg", shapes.sweep(strut, (0.020, 0.015, 0.013), n=12, up=across, round_ends=True))
    rail = foot + np.array([(-reach, 0.0, 0.0), (reach, 0.0, 0.0)])
    out.add_both_sides("leg", shapes.sweep(rail, 0.013, n=12, round_ends=True))


def _add_camera(out: Pieces, p: Params, height: float) -> None:
    """Add a gimbal below the nose: plate, yaw arm, camera with its lens."""
    (length, _, tall), _, _ = _FORMS[p["form"]]
    s = 0.045
    at = np.array([0.45 * length, 0.0, -height * tall - 0.062])
    roof = float(-height * tall * 0.85 - at[2])
    out.add(
        "gimbal", shapes.box((1.9 * s, 1.9 * s, 0.35 * s), 0.08 * s), at=(float(at[0] - 0.5 * s), 0.0, -height * tall)
    )
    out.add("gimbal", shapes.cylinder(0.45 * s, 0.9 * s, roof, 14), at=(float(at[0] - 0.9 * s), 0.0, float(at[2])))
    path = np.array([(-0.9, 0, 0.95), (-1.35, 0, 0.6), (-1.3, 0, 0.0), (-0.7, 0, 0.0)]) * s + at
    out.add("gimbal", shapes.sweep(path, 0.26 * s, 0.24 * s, n=10, up=(0.0, 1.0, 0.0), round_ends=True))
    down = shapes.turn_y(math.radians(float(p["gimbal_pitch_deg"])))
    out.add("camera", shapes.placed(shapes.box((1.6 * s, 1.5 * s, 1.5 * s), 0.3 * s, steps=2), down, at))
    forward = down @ shapes.turn_y(math.pi / 2)
    out.add("camera", shapes.placed(shapes.cylinder(0.6 * s, 0.6 * s, 1.3 * s, 18, 0.06 * s), forward, at))
    out.add("lens", shapes.placed(shapes.cylinder(0.48 * s, 1.2 * s, 1.36 * s, 16, 0.03 * s), forward, at))


MODEL = multirotor(
    "camera-quad",
    "A quadrotor moulded in one piece, with fixed arms, landing bows and a camera.",
    PARTS,
    DIALS,
    _rotors,
    build_pieces,
)
