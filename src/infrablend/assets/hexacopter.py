"""Hexacopter model: six carbon arms around a round hub, batteries on top, a camera and tall legs below.

All lengths are for a motor-to-motor diagonal of 1 and are scaled at the end. +X is the heading, +Y points left, +Z up.
Proportions follow camera and survey hexacopters with diagonals from 0.55 m to 1.15 m. Temperatures are surface minus
air in steady flight, with the sources of the quadrotor (docs/explanation/models.md).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from infrablend.assets import shapes
from infrablend.assets.drone import PARTS as DRONE_PARTS
from infrablend.assets.model import Params, PartRange
from infrablend.assets.params import Choice, Dials, Number
from infrablend.assets.rotors import PROPELLERS, Pieces, Propeller, Rotors, multirotor
from infrablend.core.mesh import FloatArray

PARTS: Mapping[str, PartRange] = DRONE_PARTS
DIALS = Dials(
    "hexacopter",
    {
        "size_m": Number((0.55, 1.15), (0.1, 3.0), log=True),
        "layout": Choice(("x", "plus"), (0.7, 0.3), "x has two arms in front, plus has one"),
        "hub": Choice(("dome", "plates"), (0.55, 0.45)),
        "legs": Choice(("down", "raised", "none"), (0.55, 0.35, 0.1)),
        "batteries": Choice((1, 2, 6), (0.35, 0.35, 0.3)),
        "camera": Choice((True, False), (0.8, 0.2)),
        "masts": Choice((0, 1, 3), (0.3, 0.4, 0.3), "satellite receivers"),
        "blades": Choice((2, 3), (0.92, 0.08)),
        "propellers": Choice(PROPELLERS, (1.0, 0.0), "spinning ones are translucent discs that labels ignore"),
        "hub_radius": Number((0.88, 1.15), (0.8, 1.2)),
        "arm_thickness": Number((0.85, 1.2), (0.7, 1.4)),
        "arm_rise_deg": Number((0.0, 7.0), (-5.0, 12.0)),
        "motor_radius": Number((0.85, 1.2), (0.7, 1.4)),
        "propeller_radius": Number((0.84, 0.96), (0.5, 0.98)),
        "propeller_angle_deg": Number((0.0, 360.0), (-3600.0, 3600.0)),
        "leg_height": Number((0.85, 1.2), (0.7, 1.4)),
        "gimbal_pitch_deg": Number((-10.0, 60.0), (-30.0, 90.0)),
        "lean_deg": Number((0.0, 14.0), (-45.0, 45.0)),
    },
)

_HUB = (0.155, 0.045)  # radius and half height
_ARM = 0.0125


def _motors_xy(p: Params) -> FloatArray:
    turn = np.radians((30.0 if p["layout"] == "x" else 0.0) + 60.0 * np.arange(6))
    return np.asarray(0.5 * np.stack([np.cos(turn), np.sin(turn)], axis=1))


def _rotors(p: Params) -> Rotors:
    r = 0.027 * float(p["motor_radius"])
    # Neighbouring shafts are half a diagonal apart.
    propeller = Propeller(0.25 * float(p["propeller_radius"]), p["blades"], 0.85, p["propellers"] == "spinning")
    start = float(p["propeller_angle_deg"])
    seat = _tip_z(p) + _ARM * float(p["arm_thickness"])
    # Golden angle: six propellers without a common direction.
    return Rotors(_motors_xy(p), seat, r, 0.85 * r, propeller, tuple(start + 137.5 * k for k in range(6)))


def _tip_z(p: Params) -> float:
    return 0.5 * math.tan(math.radians(float(p["arm_rise_deg"])))


def build_pieces(p: Params) -> Pieces:
    """Return the closed solids of one level hexacopter, for a diagonal of 1."""
    out = Pieces()
    radius = _HUB[0] * float(p["hub_radius"])
    top = _add_hub(out, p, radius)
    _add_batteries(out, p, radius, top)
    _add_arms(out, p, radius)
    _rotors(p).add_to(out)
    _add_legs(out, p, radius)
    if p["camera"]:
        _add_camera(out, float(p["gimbal_pitch_deg"]))
    _add_masts(out, p, radius, top)
    return out


def _add_hub(out: Pieces, p: Params, radius: float) -> float:
    """Add the hub and return the height of its top."""
    high = _HUB[1]
    if p["hub"] == "dome":
        bowl = [(0.0, -high), (0.72 * radius, -0.92 * high), (0.98 * radius, -0.35 * high), (radius, 0.2 * high)]
        dome = [(0.86 * radius, 0.8 * high), (0.5 * radius, 1.15 * high), (0.0, 1.25 * high)]
        out.add("shell", shapes.lathe([*bowl, *dome], 30, sharp_deg=60.0))
        for k in range(6):
            # Air outlets between the arms.
            turn = shapes.turn_z(math.radians(_between_deg(p) + 60.0 * k))
            slat = shapes.moved(shapes.box((0.02, 0.055, 0.022), 0.004), (0.985 * radius, 0.0, -0.1 * high))
            out.add("vent", shapes.placed(slat, turn), smooth=False)
        out.add("vent", shapes.cylinder(0.45 * radius, -1.06 * high, -0.9 * high, 18, 0.004))
        return 1.18 * high
    turn = shapes.turn_z(math.radians(_between_deg(p)))[:2, :2]
    outline = radius * 1.08 * shapes.circle(6) @ turn.T
    # Two hexagonal plates with posts, power boards between them and a cover over the avionics.
    for low in (-0.6 * high, 0.45 * high):
        out.add("frame", shapes.plate(outline, low, low + 0.008), smooth=False)
    for x, y in (0.85 * outline).tolist():
        out.add("frame", shapes.cylinder(0.008, -0.6 * high, 0.5 * high, 10), at=(x, y, 0.0))
    out.add("esc", shapes.cylinder(0.62 * radius, -0.35 * high, -0.1 * high, 20, 0.003))
    out.add(
        "shell",
        shapes.box((1.1 * radius, 0.8 * radius, 0.5 * high), 0.15 * high, corner=0.3 * radius, steps=3),
        at=(0.1 * radius, 0.0, 0.72 * high),
    )
    return 0.97 * high


def _between_deg(p: Params) -> float:
    """Return the direction of the middle between the first two arms."""
    return 60.0 if p["layout"] == "x" else 30.0


def _add_batteries(out: Pieces, p: Params, radius: float, top: float) -> None:
    if p["batteries"] == 6:
        # A ring of packs between the arms.
        for k in range(6):
            turn = shapes.turn_z(math.radians(_between_deg(p) + 60.0 * k))
            one = shapes.box((0.11, 0.062, 0.055), 0.008, corner=0.012, steps=2)
            out.add("battery", shapes.placed(shapes.moved(one, (radius, 0.0, 0.035)), turn))
        return
    pack = (1.25 * radius, 0.62 * radius, 0.06)
    z = top + 0.45 * pack[2]
    one = shapes.box(pack, 0.010, corner=0.014, steps=3)
    if p["batteries"] == 1:
        out.add("battery", one, at=(-0.1 * radius, 0.0, z))
    else:
        out.add_both_sides("battery", shapes.moved(one, (-0.1 * radius, 0.34 * radius, z)))
    wide = pack[1] * (1.0 if p["batteries"] == 1 else 2.1)
    for x in (-0.42, 0.2):
        strap = shapes.box((0.022, wide + 0.008, pack[2] + 0.008), 0.004)
        out.add("frame", strap, at=(x * radius, 0.0, z), smooth=False)


def _add_arms(out: Pieces, p: Params, radius: float) -> None:
    thick = _ARM * float(p["arm_thickness"])
    tip_z = _tip_z(p)
    r = _rotors(p).motor_radius
    for x, y in _motors_xy(p).tolist():
        root = np.array([0.8 * radius * 2 * x, 0.8 * radius * 2 * y, 0.8 * radius * tip_z * 2])
        tip = np.array([x, y, tip_z])
        warm = 1 - max(0.06, 2.0 * r) / float(np.linalg.norm(tip - root))
        out.add("arm", shapes.sweep([root, root + warm * (tip - root)], thick, n=16))
        out.add("motor_mount", shapes.sweep([root + (warm - 0.002) * (tip - root), tip], thick, n=16))
        for where in (0.1, 0.27):
            # Clamps of the folding arms.
            a, b = root + (where - 0.035) * (tip - root), root + (where + 0.035) * (tip - root)
            out.add("frame", shapes.sweep([a, b], 1.5 * thick, n=12, exponent=3.0))
        cup = [(0.0, -1.5 * thick), (0.6 * r, -1.4 * thick), (1.05 * r, -0.8 * thick), (1.1 * r, thick)]
        out.add("motor_mount", shapes.lathe(cup, 18, sharp_deg=50.0), at=(x, y, tip_z))


def _add_legs(out: Pieces, p: Params, radius: float) -> None:
    if p["legs"] == "none":
        for x, y in _motors_xy(p).tolist():
            stub = shapes.capsule((x, y, _tip_z(p) - 0.015), (x, y, _tip_z(p) - 0.07), 0.008, 0.006, n=8)
            out.add("leg", stub)
        return
    drop = 0.24 * float(p["leg_height"])
    if p["legs"] == "down":
        hip = np.array([0.0, 0.62 * radius, -0.03])
        foot = np.array([0.0, 0.23, -0.04 - drop])
    else:
        # Swung up to the sides in flight.
        hip = np.array([0.0, 0.62 * radius, -0.03])
        foot = np.array([0.0, 0.62 * radius + 0.95 * drop, 0.02])
    across = (1.0, 0.0, 0.0)
    out.add_both_sides("leg", shapes.sweep([hip, foot], 0.0095, n=12, up=across))
    out.add_both_sides("frame", shapes.sweep([hip, hip + 0.2 * (foot - hip)], 0.016, n=12, up=across))
    rail = foot + np.array([(-0.17, 0.0, 0.0), (0.17, 0.0, 0.0)])
    out.add_both_sides("leg", shapes.sweep(rail, 0.0095, n=12, round_ends=True))
    for x in (-0.13, 0.13):
        sleeve = foot + np.array([(x - 0.03, 0.0, 0.0), (x + 0.03, 0.0, 0.0)])
        out.add_both_sides("leg", shapes.sweep(sleeve, 0.014, n=12))


def _add_camera(out: Pieces, pitch_deg: float) -> None:
    """Add a payload in a yoke below the hub: yaw motor, two arms, camera with its lens."""
    s = 0.042
    z = -0.15
    out.add("gimbal", shapes.cylinder(0.9 * s, -0.075, -0.035, 16, 0.004))
    bridge = [(0.0, -1.35 * s, z + 1.2 * s), (0.0, 1.35 * s, z + 1.2 * s)]
    out.add("gimbal", shapes.sweep(bridge, 0.35 * s, 0.25 * s, n=10, round_ends=True))
    post = shapes.cylinder(0.3 * s, z + 1.1 * s, -0.05, 12)
    out.add("gimbal", post)
    side = shapes.sweep(
        [(0.0, 1.35 * s, z + 1.2 * s), (0.0, 1.35 * s, z - 0.2 * s)], 0.2 * s, 0.35 * s, n=10, up=(1, 0, 0)
    )
    out.add_both_sides("gimbal", side)
    down = shapes.turn_y(math.radians(pitch_deg))
    out.add("camera", shapes.placed(shapes.box((1.9 * s, 1.9 * s, 1.6 * s), 0.25 * s, steps=2), down, (0.0, 0.0, z)))
    forward = shapes.turn_y(math.pi / 2)
    barrel = shapes.placed(shapes.cylinder(0.55 * s, 0.8 * s, 1.9 * s, 18, 0.06 * s), down @ forward, (0.0, 0.0, z))
    out.add("camera", barrel)
    glass = shapes.cylinder(0.45 * s, 1.8 * s, 1.95 * s, 16, 0.03 * s)
    out.add("lens", shapes.placed(glass, down @ forward, (0.0, 0.0, z)))


def _add_masts(out: Pieces, p: Params, radius: float, top: float) -> None:
    places: list[tuple[float, float]] = {0: [], 1: [(-0.75, 0.0)], 3: [(-0.8, 0.0), (-0.35, 0.75), (-0.35, -0.75)]}[
        p["masts"]
    ]
    for x, y in places:
        at = (x * radius, y * radius, 0.0)
        height = top + 0.13
        out.add("antenna", shapes.cylinder(0.006, top - 0.04, height, 10), at=at)
        puck = [(0.012, height - 0.006), (0.034, height), (0.036, height + 0.009), (0.0, height + 0.02)]
        out.add("antenna", shapes.lathe(puck, 20), at=at)


MODEL = multirotor(
    "hexacopter",
    "A hexacopter: six arms around a round hub, propellers still or spinning, legs down or raised.",
    PARTS,
    DIALS,
    _rotors,
    build_pieces,
)
