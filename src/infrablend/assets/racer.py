"""FPV racer model: a small quadrotor on an open carbon frame, with large motors, three blades and the pack on top.

All lengths are for a motor-to-motor diagonal of 1 and are scaled at the end. +X is the heading, +Y points left, +Z up.
Proportions follow frames for 3-inch to 7-inch propellers (diagonals of 0.14 m to 0.33 m). Motors run hard and hot, the
frame conducts their heat, and the aircraft leans far forward in flight. Temperatures: docs/explanation/models.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from infrablend.assets import shapes
from infrablend.assets.model import Params, PartRange, part_role
from infrablend.assets.params import Choice, Dials, Number
from infrablend.assets.rotors import DISC_PARTS, PROPELLERS, Pieces, Propeller, Rotors, multirotor
from infrablend.core.mesh import FloatArray

PARTS: Mapping[str, PartRange] = {
    "battery": part_role("plastic", (10.0, 28.0), "pack under high current, in the open", emissivity=(0.92, 0.95)),
    "motor": part_role("black_anodised", (15.0, 45.0), "motor bell under load", emissivity=(0.92, 0.96)),
    "winding": part_role("circuit_board", (25.0, 65.0), "stator, visible between bell and base"),
    "motor_mount": part_role("cfrp", (6.0, 18.0), "end of the arm, screwed to the motor"),
    "esc": part_role("circuit_board", (18.0, 45.0), "speed controllers and flight controller, open to the sides"),
    "camera": part_role("plastic", (8.0, 22.0), "pilot's camera and action camera", emissivity=(0.92, 0.95)),
    "transmitter": part_role("circuit_board", (20.0, 45.0), "video transmitter at the tail"),
    "lens": part_role("lens", (4.0, 12.0), "glass of the cameras"),
    "frame": part_role("cfrp", (1.0, 6.0), "plates and spacers, warmed by the electronics"),
    "arm": part_role("cfrp", (1.0, 7.0), "carbon plate; conducts heat from motor and controller"),
    "propeller": part_role(
        "plastic", (0.0, 4.0), "blades at rest: 0..+4 K of recovery heating", emissivity=(0.85, 0.94)
    ),
    "antenna": part_role("plastic", (0.0, 4.0), "antennas and their tubes", emissivity=(0.90, 0.95)),
    **DISC_PARTS,
}
DIALS = Dials(
    "racer",
    {
        "size_m": Number((0.16, 0.32), (0.05, 1.0), log=True),
        "layout": Choice(("x", "stretched", "wide"), (0.55, 0.2, 0.25), "stretched is longer than wide"),
        "action_camera": Choice((False, True), (0.55, 0.45), "a second camera on top of the nose"),
        "pack": Choice(("top", "bottom"), (0.85, 0.15), "side on which the battery is strapped"),
        "antennas": Choice((1, 2), (0.6, 0.4)),
        "blades": Choice((2, 3), (0.25, 0.75)),
        "propellers": Choice(PROPELLERS, (1.0, 0.0), "spinning ones are translucent discs that labels ignore"),
        "body_length": Number((0.85, 1.2), (0.8, 1.3)),
        "arm_width": Number((0.85, 1.25), (0.7, 1.4)),
        "motor_radius": Number((0.9, 1.15), (0.8, 1.25)),
        "propeller_radius": Number((0.86, 0.97), (0.5, 0.98)),
        "propeller_angle_deg": Number((0.0, 360.0), (-3600.0, 3600.0)),
        "camera_tilt_deg": Number((10.0, 50.0), (-10.0, 70.0)),
        "lean_deg": Number((5.0, 45.0), (-80.0, 80.0)),
    },
)

# Half length and half width of the body.
_LENGTH = 0.215
_WIDTH = 0.068
# Heights of the lower and the upper plate, and their thickness.
_LOW = 0.016
_HIGH = 0.118
_PLATE = 0.010
# Half thickness of an arm.
_ARM_HALF = 0.012


def _motors_xy(p: Params) -> FloatArray:
    turn = math.radians({"x": 45.0, "stretched": 38.0, "wide": 53.0}[p["layout"]])
    x, y = 0.5 * math.cos(turn), 0.5 * math.sin(turn)
    return np.array([[x, y], [-x, y], [-x, -y], [x, -y]])


def _rotors(p: Params) -> Rotors:
    xy = _motors_xy(p)
    gap = float(np.linalg.norm(xy - np.roll(xy, -1, axis=0), axis=1).min())
    propeller = Propeller(gap / 2 * float(p["propeller_radius"]), p["blades"], 1.05, p["propellers"] == "spinning")
    r = 0.060 * float(p["motor_radius"])
    start = float(p["propeller_angle_deg"])
    return Rotors(xy, _ARM_HALF, r, 1.25 * r, propeller, tuple(start + 137.5 * k for k in range(4)))


def build_pieces(p: Params) -> Pieces:
    """Return the closed solids of one level racer, for a diagonal of 1."""
    out = Pieces()
    length = _LENGTH * float(p["body_length"])
    _add_arms(out, p)
    _add_body(out, length)
    _add_battery(out, p, length)
    _add_cameras(out, p, length)
    _add_antennas(out, p, length)
    _rotors(p).add_to(out)
    return out


def _add_arms(out: Pieces, p: Params) -> None:
    half = 0.030 * float(p["arm_width"])
    r = _rotors(p).motor_radius
    for x, y in _motors_xy(p).tolist():
        root = np.array([0.12 * x, 0.12 * y, 0.0])
        tip = np.array([x, y, 0.0])
        t = np.array([0.0, 0.3, 0.7, 0.84])
        wide = half * np.array([1.35, 1.05, 0.85, 0.9])
        out.add(
            "arm",
            shapes.sweep(root + t[:, None] * (tip - root), wide, _ARM_HALF, n=16, exponent=8.0),
            smooth=False,
        )
        warm = np.stack([root + 0.838 * (tip - root), tip])
        out.add("motor_mount", shapes.sweep(warm, 0.9 * half, _ARM_HALF, n=12, exponent=8.0), smooth=False)
        out.add("motor_mount", shapes.cylinder(0.98 * r, -_ARM_HALF, _ARM_HALF, 24), at=(x, y, 0.0))


def _add_body(out: Pieces, length: float) -> None:
    """Add the plates with posts between them, and the boards that the open sides show."""
    for low, part in ((-_ARM_HALF - _PLATE, 0.8), (_LOW - _PLATE, 0.8), (_HIGH, 1.0)):
        outline = shapes.rounded_rectangle(part * length, _WIDTH, 0.03, 2)
        out.add("frame", shapes.plate(outline, low, low + _PLATE), smooth=False)
    post = shapes.cylinder(0.013, _LOW - 0.003, _HIGH + 0.003, 10)
    for x in (-0.88, -0.35, 0.35, 0.88):
        out.add_both_sides("frame", shapes.moved(post, (x * length * (0.9 if abs(x) > 0.5 else 1), 0.8 * _WIDTH, 0.0)))
    for z, thick in ((0.034, 0.012), (0.062, 0.010), (0.086, 0.008)):
        out.add("esc", shapes.box((0.155, 0.118, thick), 0.002), at=(0.0, 0.0, z), smooth=False)
    out.add("transmitter", shapes.box((0.11, 0.09, 0.03), 0.004), at=(-0.66 * length, 0.0, 0.05), smooth=False)


def _add_battery(out: Pieces, p: Params, length: float) -> None:
    pack = (0.34, 0.155, 0.135)
    top = p["pack"] == "top"
    z = _HIGH + _PLATE + pack[2] / 2 if top else -_ARM_HALF - _PLATE - pack[2] / 2
    x = -0.08 * length
    out.add("battery", shapes.box(pack, 0.014, corner=0.02, steps=3), at=(x, 0.0, z))
    strap = shapes.box((0.06, pack[1] + 0.008, pack[2] + 0.008), 0.006)
    out.add("frame", strap, at=(x, 0.0, z), smooth=False)
    # Power lead from the pack to the boards.
    rear = x - pack[0] / 2
    plate = _HIGH if top else 0.0
    lead = [(rear + 0.01, 0.03, z), (rear - 0.05, 0.035, 0.5 * (z + plate)), (rear - 0.04, 0.03, 0.055)]
    out.add("battery", shapes.sweep(lead, 0.014, n=8, up=(0.0, 1.0, 0.0), round_ends=True))


def _add_cameras(out: Pieces, p: Params, length: float) -> None:
    up = shapes.turn_y(-math.radians(float(p["camera_tilt_deg"])))
    forward = up @ shapes.turn_y(math.pi / 2)
    at = (0.88 * length, 0.0, 0.5 * (_LOW + _HIGH))
    out.add("camera", shapes.placed(shapes.box((0.07, 0.085, 0.085), 0.01), up, at))
    out.add("lens", shapes.placed(shapes.cylinder(0.032, 0.03, 0.085, 14, 0.006), forward, at))
    cheek = shapes.box((0.14, 0.012, _HIGH - _LOW + 0.02), 0.003)
    out.add_both_sides("frame", shapes.moved(cheek, (0.86 * length, 0.85 * _WIDTH, 0.5 * (_LOW + _HIGH))), smooth=False)
    if p["action_camera"]:
        z = _HIGH + _PLATE + 0.10
        out.add("camera", shapes.placed(shapes.box((0.11, 0.19, 0.15), 0.02, steps=2), up, (0.95 * length, 0.0, z)))
        eye = shapes.moved(shapes.cylinder(0.04, 0.05, 0.075, 14, 0.006), (0.0, 0.045, 0.0))
        out.add("lens", shapes.placed(eye, forward, (0.95 * length, 0.0, z + 0.02)))
        out.add("frame", shapes.box((0.1, 0.1, 0.06), 0.01), at=(0.88 * length, 0.0, _HIGH + _PLATE + 0.02))


def _add_antennas(out: Pieces, p: Params, length: float) -> None:
    base = np.array([-0.95 * length, 0.0, _HIGH])
    for side in (0.0,) if p["antennas"] == 1 else (0.55, -0.55):
        lean = np.array([-0.55, side, 1.0])
        lean /= float(np.linalg.norm(lean))
        tip = base + 0.19 * lean
        out.add("antenna", shapes.capsule(base, tip, 0.008, n=8))
        out.add("antenna", shapes.capsule(tip - 0.01 * lean, tip + 0.035 * lean, 0.028, n=12))


MODEL = multirotor(
    "racer",
    "A small FPV quadrotor with an open carbon frame that leans forward; propellers still or spinning.",
    PARTS,
    DIALS,
    _rotors,
    build_pieces,
)
