"""Drone model, a quadrotor: hot motors and batteries, warm electronics and shell, cold carbon, propellers and legs.

`sample_params` draws what varies between quadrotors, `build_drone` builds the mesh of one. All lengths are for a
motor-to-motor diagonal of 1 and are scaled at the end. +X is the heading, +Y points left, +Z up.

Temperatures are surface minus air in steady flight; each part's `what` describes their basis, and
docs/explanation/models.md lists the sources. They range from a light hover to heavy load; the ranges here cover a
hovering or cruising aircraft.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from infrablend.assets import shapes
from infrablend.assets.model import ObjectModel, Params, PartRange, part_role
from infrablend.assets.params import Checks, Range
from infrablend.assets.rotors import DISC_PARTS, PROPELLERS, Pieces, Propeller, Rotors, Vector, assembled
from infrablend.assets.shapes import Solid
from infrablend.core.mesh import FloatArray, Mesh

_CHECKS = Checks("drone")

PARTS: Mapping[str, PartRange] = {
    "battery": part_role(
        "plastic", (8.0, 20.0), "battery pack: +8..+20 K, rising with flight time", emissivity=(0.92, 0.95)
    ),
    "motor": part_role(
        "black_anodised", (10.0, 40.0), "motor bell: +10..+25 K in hover, more under load", emissivity=(0.92, 0.96)
    ),
    "winding": part_role("circuit_board", (18.0, 55.0), "stator, visible between bell and base: hotter than the bell"),
    "motor_mount": part_role(
        "cfrp", (5.0, 10.0), "last 2-4 cm of the arm, heated by the motor: +5..+10 K", emissivity=(0.84, 0.94)
    ),
    "esc": part_role("circuit_board", (15.0, 40.0), "uncovered speed controllers and power boards: +15..+40 K"),
    "vent": part_role(
        "plastic", (8.0, 25.0), "air outlets over the electronics; cavities: high emissivity", emissivity=(0.92, 0.96)
    ),
    "shell": part_role("plastic", (2.0, 8.0), "plastic body over electronics: +2..+8 K", emissivity=(0.93, 0.95)),
    "camera": part_role(
        "plastic", (10.0, 25.0), "camera, video transmitter, on-board computer: +10..+25 K", emissivity=(0.92, 0.95)
    ),
    "lens": part_role("lens", (4.0, 12.0), "glass of cameras and sensors"),
    "gimbal": part_role("plastic", (2.0, 10.0), "gimbal arms and their small motors", emissivity=(0.90, 0.95)),
    "frame": part_role("cfrp", (0.0, 3.0), "carbon plates, spacers, clamps: 0..+3 K"),
    "arm": part_role("cfrp", (0.0, 3.0), "arms, carbon tube or plate, or moulded: 0..+3 K", emissivity=(0.80, 0.94)),
    "propeller": part_role(
        "plastic", (0.0, 4.0), "blades at rest: 0..+4 K of recovery heating", emissivity=(0.85, 0.94)
    ),
    "leg": part_role("plastic", (0.0, 0.8), "landing gear, at air temperature", emissivity=(0.85, 0.94)),
    "antenna": part_role("plastic", (0.0, 3.0), "antennas, satellite receiver and mast", emissivity=(0.90, 0.95)),
    **DISC_PARTS,
}

CHOICES: Mapping[str, tuple[Any, ...]] = {
    "layout": ("x", "h", "plus", "deadcat"),
    "body": ("shell", "plate", "industrial"),
    "arm": ("moulded", "tube", "bar"),
    "legs": ("feet", "skids", "curved"),
    "blades": (2, 3),
    "batteries": (1, 2),
    "antennas": (0, 1, 2),
    "camera": (False, True),
    "mast": (False, True),
}
_STATES: Mapping[str, tuple[Any, ...]] = {**CHOICES, "propellers": PROPELLERS}
"""Parameters with a fixed set of values. `propellers` is not drawn: still unless a recipe sets it."""
DRAWN: Mapping[str, tuple[float, float]] = {
    "size_m": (0.3, 0.9),
    "propeller_angle_deg": (0.0, 360.0),
    "body_length": (0.85, 1.15),
    "body_width": (0.85, 1.15),
    "body_height": (0.85, 1.15),
    "arm_thickness": (0.8, 1.25),
    "arm_rise": (-0.6, 1.0),
    "arm_spread": (0.0, 1.0),
    "motor_radius": (0.85, 1.2),
    "propeller_radius": (0.8, 0.97),
    "leg_height": (0.85, 1.3),
    "gimbal_pitch_deg": (-10.0, 60.0),
}
ALLOWED: Mapping[str, tuple[float, float]] = {
    **DRAWN,
    "size_m": (0.05, 5.0),
    "propeller_angle_deg": (-3600.0, 3600.0),
    "gimbal_pitch_deg": (-30.0, 90.0),
}
"""Ranges that `build_drone` accepts, in part wider than the ranges that are drawn."""

NOMINAL: Params = {
    "size_m": 0.38,
    "layout": "x",
    "body": "shell",
    "arm": "moulded",
    "legs": "feet",
    "blades": 2,
    "batteries": 1,
    "antennas": 0,
    "camera": True,
    "mast": False,
    "propeller_angle_deg": [20.0, 80.0, 145.0, 250.0],
    "body_length": 1.0,
    "body_width": 1.0,
    "body_height": 1.0,
    "arm_thickness": 1.0,
    "arm_rise": 0.3,
    "arm_spread": 0.5,
    "motor_radius": 1.0,
    "propeller_radius": 0.92,
    "leg_height": 1.0,
    "gimbal_pitch_deg": 15.0,
    "propellers": "still",
}
"""Parameters of a consumer camera drone; `{**NOMINAL, ...}` is handy for tests and pictures."""

# Odds of each choice, by body; small aircraft are more often shells, large ones industrial.
_ODDS: Mapping[str, dict[str, tuple[float, ...]]] = {
    "shell": {
        "layout": (0.55, 0.2, 0.05, 0.2), "arm": (0.85, 0.15, 0.0), "legs": (0.6, 0.15, 0.25), "blades": (0.85, 0.15),
        "batteries": (0.85, 0.15), "antennas": (0.9, 0.05, 0.05), "camera": (0.05, 0.95), "mast": (0.97, 0.03),
    },
    "plate": {
        "layout": (0.45, 0.2, 0.1, 0.25), "arm": (0.0, 0.3, 0.7), "legs": (0.45, 0.45, 0.1), "blades": (0.6, 0.4),
        "batteries": (0.75, 0.25), "antennas": (0.3, 0.4, 0.3), "camera": (0.35, 0.65), "mast": (0.5, 0.5),
    },
    "industrial": {
        "layout": (0.6, 0.1, 0.1, 0.2), "arm": (0.3, 0.7, 0.0), "legs": (0.1, 0.75, 0.15), "blades": (0.9, 0.1),
        "batteries": (0.2, 0.8), "antennas": (0.3, 0.3, 0.4), "camera": (0.1, 0.9), "mast": (0.35, 0.65),
    },
}  # fmt: skip
_BODY_ODDS_SMALL = (0.55, 0.35, 0.10)
_BODY_ODDS_LARGE = (0.15, 0.35, 0.50)


# --- drawing -------------------------------------------------------------------------------------------------


def sample_params(rng: np.random.Generator, options: Params) -> Params:
    """Draw the parameters of one drone, JSON values only.

    Every call takes the same number of values from `rng` in the same order, so fixing one option leaves the
    others as they would have been (except `body` and what depends on it, because its odds depend on the size). A list
    of `propellers` takes one more, at the end.

    Args:
        rng: Random stream to draw from.
        options: Any parameter by name: a value; for numbers also [low, high] to draw from; for choices also a
            list to choose from with equal odds. `propeller_angle_deg` also accepts four angles.
    """
    _CHECKS.known("option", options, tuple(NOMINAL))
    dice = {name: float(rng.random()) for name in CHOICES}
    dials = {name: float(rng.random()) for name in DRAWN if name != "propeller_angle_deg"}
    angles = rng.random(4)

    params: dict[str, object] = {}
    low, high = _number_range("size_m", options)
    size = low * (high / low) ** dials["size_m"]
    params["size_m"] = float(min(max(size, low), high))
    big = float(np.clip(math.log(size / 0.3) / math.log(3.0), 0.0, 1.0))
    body_odds = tuple((1 - big) * s + big * b for s, b in zip(_BODY_ODDS_SMALL, _BODY_ODDS_LARGE, strict=True))
    body = _CHECKS.choose("body", options, CHOICES["body"], body_odds, dice["body"])
    params["body"] = body
    odds = _ODDS[body]
    for name in CHOICES:
        if name != "body":
            params[name] = _CHECKS.choose(name, options, CHOICES[name], odds[name], dice[name])
    for name in DRAWN:
        if name not in ("size_m", "propeller_angle_deg"):
            low, high = _number_range(name, options)
            params[name] = low + (high - low) * dials[name]
    params["propeller_angle_deg"] = _angles(angles, options)
    several = isinstance(options.get("propellers"), list | tuple)
    share = float(rng.random()) if several else 0.0
    params["propellers"] = _CHECKS.choose("propellers", options, PROPELLERS, (1.0, 0.0), share)
    return params


def _number_range(name: str, options: Params) -> Range:
    """Return the range to draw a number from: that of the option, else the model's own."""
    if name not in options:
        return DRAWN[name]
    return _CHECKS.number_range(f"option {name}", options[name], *ALLOWED[name])


def _angles(shares: FloatArray, options: Params) -> list[float]:
    name = "propeller_angle_deg"
    value = options.get(name, list(DRAWN[name]))
    if isinstance(value, list | tuple) and len(value) == 4:
        return [_CHECKS.number(f"option {name}", v, *ALLOWED[name]) for v in value]
    if not isinstance(value, int | float | list | tuple) or (isinstance(value, list | tuple) and len(value) != 2):
        expected = "an angle in degrees, [low, high] in degrees, or four angles"
        raise _CHECKS.bad(f"option {name}", value, expected)
    low, high = _CHECKS.number_range(f"option {name}", value, *ALLOWED[name])
    return [float(low + (high - low) * u) for u in shares]


def _require_params(params: Params) -> None:
    _CHECKS.known("parameter", params, tuple(NOMINAL))
    _CHECKS.complete(params, tuple(NOMINAL))
    for name in NOMINAL:
        where = f"parameter {name}"
        value = params[name]
        if name in _STATES:
            _CHECKS.one_of(where, value, _STATES[name])
        elif name == "propeller_angle_deg":
            if not (isinstance(value, list | tuple) and len(value) == 4):
                raise _CHECKS.bad(where, value, "four angles in degrees")
            for angle in value:
                _CHECKS.number(where, angle, *ALLOWED[name])
        else:
            _CHECKS.number(where, value, *ALLOWED[name])


# --- plan: positions and sizes for a diagonal of 1 --------------------------------------------------------------


@dataclass(frozen=True)
class _Plan:
    """Dimensions that the pieces share, for a motor diagonal of 1; z = 0 is the middle of the body."""

    p: Params
    motors_xy: FloatArray  # (4, 2) counter-clockwise from the front left (plus: from the front)
    roots_xy: FloatArray  # (4, 2) where the arms leave the body
    half_length: float
    half_width: float
    half_height: float
    root_z: float
    tip_z: float
    arm_half_width: float
    arm_half_height: float
    motor_radius: float
    propeller_radius: float
    ground_z: float


def _motor_plan(p: Params) -> FloatArray:
    spread = float(p["arm_spread"])
    layout = p["layout"]
    if layout == "plus":
        front = rear = None
        xy = np.array([[0.5, 0.0], [0.0, 0.5], [-0.5, 0.0], [0.0, -0.5]])
    elif layout == "deadcat":
        # Wide, swept front arms and a narrower tail: keeps propellers out of the camera's view.
        front = math.radians(56 + 9 * spread)
        rear = math.radians(44 - 6 * spread)
        reach = 1.1
        xy = np.array([[math.cos(front), math.sin(front)], [-reach * math.cos(rear), reach * math.sin(rear)]])
    else:
        front = math.radians(41 + 9 * spread if layout == "x" else 52 + 7 * spread)
        xy = np.array([[math.cos(front), math.sin(front)], [-math.cos(front), math.sin(front)]])
    if layout != "plus":
        xy = np.concatenate([xy, (xy * (1, -1))[::-1]])
    return np.asarray(xy / np.linalg.norm(xy[0] - xy[2]))


_BODY_SIZE = {  # half length, half width, half height
    "shell": (0.275, 0.108, 0.064),
    "plate": (0.245, 0.080, 0.048),
    "industrial": (0.235, 0.125, 0.072),
}
_ARM_SECTION = {"moulded": (0.0200, 0.0160), "tube": (0.0125, 0.0125), "bar": (0.0200, 0.0065)}
_MOTOR_RADIUS = {"shell": 0.040, "plate": 0.046, "industrial": 0.037}


def _plan(p: Params) -> _Plan:
    motors = _motor_plan(p)
    length, width, height = _BODY_SIZE[p["body"]]
    length *= p["body_length"]
    width *= p["body_width"]
    height *= p["body_height"]
    if p["layout"] == "h":
        # The arms leave the body at right angles, so it must reach them.
        length = max(length, 1.12 * abs(float(motors[0, 0])))
        width *= 0.88
    elif p["layout"] == "plus":
        length *= 0.78
    half_w, half_h = (float(p["arm_thickness"]) * s for s in _ARM_SECTION[p["arm"]])

    if p["layout"] == "h":
        roots = np.stack([motors[:, 0], 0.35 * width * np.sign(motors[:, 1])], axis=1)
    elif p["layout"] == "plus":
        roots = np.stack([0.55 * length * np.sign(motors[:, 0]), 0.35 * width * np.sign(motors[:, 1])], axis=1)
        roots[np.abs(motors) < 1e-9] = 0.0
    else:
        roots = np.sign(motors) * (0.62 * length, 0.55 * width)

    # Propellers must clear one another and the body.
    gaps = np.linalg.norm(motors - np.roll(motors, -1, axis=0), axis=1)
    outside = np.maximum(np.abs(motors) - (length, width), 0.0)
    clear = float(np.linalg.norm(outside, axis=1).min()) - 0.012
    propeller = min(float(p["propeller_radius"]) * float(gaps.min()) / 2, clear)

    rise = float(p["arm_rise"])
    root_z = {"shell": 0.008, "plate": -height + half_h + 0.004, "industrial": 0.015}[p["body"]]
    tip_z = root_z + rise * {"moulded": 0.03, "tube": 0.02, "bar": 0.0}[p["arm"]]
    below = {"shell": 0.105, "plate": 0.10, "industrial": 0.27}[p["body"]]
    if p["legs"] != "feet":
        below = max(below, 0.17)
    if p["camera"] and p["body"] != "shell":
        below = max(below, 0.175)
    return _Plan(
        p,
        motors,
        roots,
        length,
        width,
        height,
        root_z,
        tip_z,
        half_w,
        half_h,
        _MOTOR_RADIUS[p["body"]] * float(p["motor_radius"]),
        propeller,
        -height - below * float(p["leg_height"]) + 0.04,
    )


# --- motors and propellers -----------------------------------------------------------------------------------


def _rotors(plan: _Plan) -> Rotors:
    r = plan.motor_radius
    industrial = plan.p["body"] == "industrial"
    return Rotors(
        plan.motors_xy,
        plan.tip_z + plan.arm_half_height,
        r,
        r * (0.62 if industrial else 0.8) + 0.10 * r,
        _propeller(plan.p, plan.propeller_radius),
        tuple(plan.p["propeller_angle_deg"]),
    )


def _propeller(params: Params, radius: float = 1.0) -> Propeller:
    chord = 0.85 if params["body"] == "industrial" else 1.0
    return Propeller(radius, params["blades"], chord, params.get("propellers") == "spinning")


def parts_for(params: Params) -> dict[str, PartRange]:
    """Return the thermal role of every part of this drone, without discs if its propellers are still."""
    return _propeller(params).roles_among(PARTS)


# --- arms ----------------------------------------------------------------------------------------------------


def _add_arms(out: Pieces, plan: _Plan) -> None:
    p = plan.p
    w, h = plan.arm_half_width, plan.arm_half_height
    r = plan.motor_radius
    for (mx, my), (rx, ry) in zip(plan.motors_xy.tolist(), plan.roots_xy.tolist(), strict=True):
        root = np.array([rx, ry, plan.root_z])
        tip = np.array([mx, my, plan.tip_z])
        # The end near the motor is warm and therefore a separate part.
        reach = float(np.linalg.norm(tip - root))
        t_warm = 1 - max(0.07, 1.6 * r) / reach
        if p["arm"] == "moulded":
            t = np.array([0.0, 0.12, 0.28, 0.5, 0.75, t_warm])
            swell = np.interp(t, [0.0, 0.25, 1.0], [1.55, 1.1, 0.85])
            bow = 0.006 * np.sin(np.pi * t)[:, None] * (0, 0, 1)
            out.add(
                "arm", shapes.sweep(root + t[:, None] * (tip - root) + bow, w * swell, h * swell, n=16, exponent=2.8)
            )
            warm_w = 0.88 * w
            warm_h = 0.88 * h
            exponent = 2.8
        elif p["arm"] == "tube":
            ends = np.stack([root, root + t_warm * (tip - root)])
            out.add("arm", shapes.sweep(ends, w, h, n=16))
            for where in (0.12, 0.3):
                # Clamps that hold the tube, the outer one hinged.
                a = root + (where - 0.03) * (tip - root)
                b = root + (where + 0.03) * (tip - root)
                out.add("frame", shapes.sweep(np.stack([a, b]), 1.45 * w, 1.45 * h, n=12, exponent=3.0))
            warm_w = w
            warm_h = h
            exponent = 2.0
        else:
            t = np.array([0.0, 0.2, 0.55, t_warm])
            wide = w * np.array([1.25, 1.0, 0.8, 0.9])
            out.add("arm", shapes.sweep(root + t[:, None] * (tip - root), wide, h, n=16, exponent=8.0), smooth=False)
            warm_w = 0.9 * w
            warm_h = h
            exponent = 8.0
        warm = np.stack([root + (t_warm - 0.002) * (tip - root), tip])
        out.add("motor_mount", shapes.sweep(warm, warm_w, warm_h, n=12, exponent=exponent), smooth=p["arm"] != "bar")
        z0, z1 = plan.tip_z - 1.1 * h, plan.tip_z + h
        if p["arm"] == "bar":
            out.add("motor_mount", shapes.cylinder(1.04 * r, plan.tip_z - h, z1, 24), at=(mx, my, 0.0))
        else:
            cup = [
                (0.0, z0 - 0.25 * r),
                (0.5 * r, z0 - 0.2 * r),
                (0.92 * r, z0 + 0.15 * r),
                (1.0 * r, plan.tip_z),
                (1.0 * r, z1),
            ]
            out.add("motor_mount", shapes.lathe(cup, 18, sharp_deg=50.0), at=(mx, my, 0.0))
        if p["body"] == "plate" and p["layout"] != "h":
            # An open frame has a speed controller on each arm.
            out.add("esc", _box_on_arm(root, tip, 0.52, (0.075, 1.5 * w, 0.011), h + 0.004), smooth=False)


def _box_on_arm(root: FloatArray, tip: FloatArray, t: float, size: Vector, lift: float) -> Solid:
    """Return a small box on top of an arm at fraction `t` of its length."""
    x, y, _ = (tip - root).tolist()
    at = root + t * (tip - root) + (0.0, 0.0, lift)
    return shapes.placed(shapes.box(size, 0.15 * min(size)), shapes.turn_z(math.atan2(y, x)), at)


# --- bodies --------------------------------------------------------------------------------------------------


def _add_shell_body(out: Pieces, plan: _Plan) -> None:
    """Add a smooth moulded body with its battery set into the back, sensors at the nose and outlets at the sides."""
    _add_shell_skin(out, plan)
    _add_shell_battery(out, plan)
    _add_shell_outlets(out, plan)
    _add_shell_sensors(out, plan)
    if plan.p["arm"] == "moulded":
        for x, y in plan.roots_xy.tolist():
            # Hinges of the folding arms.
            hinge = shapes.cylinder(
                1.5 * plan.arm_half_width, -1.5 * plan.arm_half_height, 1.6 * plan.arm_half_height, 18, 0.004
            )
            out.add("shell", hinge, at=(1.12 * x, 1.45 * y, plan.root_z))


def _shell_sections(plan: _Plan) -> tuple[FloatArray, FloatArray]:
    """Return where the cross sections of a moulded body are along it, from -1 to 1, and their half widths."""
    t = np.sin(np.linspace(-1, 1, 21) * math.pi / 2 * 0.955)
    closing = (1 - np.abs(t) ** 6) ** 0.4
    return t, plan.half_width * np.interp(t, [-1, -0.4, 0.25, 1], [0.80, 0.97, 1.0, 0.70]) * closing


def _add_shell_skin(out: Pieces, plan: _Plan) -> None:
    """Add the moulded body itself, and its canopy."""
    L, W, H = plan.half_length, plan.half_width, plan.half_height
    t, wide = _shell_sections(plan)
    closing = (1 - np.abs(t) ** 6) ** 0.4
    tall = H * np.interp(t, [-1, -0.5, 0.2, 1], [0.82, 1.0, 0.95, 0.62]) * closing
    middle = H * np.interp(t, [-1, -0.3, 0.4, 1], [0.10, 0.0, -0.02, -0.18])
    unit = shapes.circle(28, 2.9)
    rings = np.empty((len(t), 28, 3))
    rings[:, :, 0] = L * t[:, None]
    rings[:, :, 1] = wide[:, None] * unit[:, 0]
    rings[:, :, 2] = middle[:, None] + tall[:, None] * unit[:, 1]
    out.add("shell", shapes.loft(rings, start=(-L, 0, middle[0]), end=(L, 0, middle[-1])))

    # Canopy: a raised spine from the nose to the battery.
    s = np.sin(np.linspace(-1, 1, 11) * math.pi / 2 * 0.96)
    closing = (1 - np.abs(s) ** 4) ** 0.4
    unit = shapes.circle(20, 3.2)
    rings = np.empty((len(s), 20, 3))
    rings[:, :, 0] = L * (0.40 + 0.42 * s)[:, None]
    rings[:, :, 1] = (0.62 * W * closing * np.interp(s, [-1, 1], [1.0, 0.75]))[:, None] * unit[:, 0]
    rings[:, :, 2] = (0.55 * H * closing)[:, None] * unit[:, 1] + (H * np.interp(s, [-1, 0.2, 1], [0.66, 0.6, 0.2]))[
        :, None
    ]
    out.add("shell", shapes.loft(rings, start=(-0.02 * L, 0, 0.66 * H), end=(0.82 * L, 0, 0.2 * H)))


def _add_shell_battery(out: Pieces, plan: _Plan) -> None:
    L, W, H = plan.half_length, plan.half_width, plan.half_height
    pack_l, pack_w, pack_h = 0.88 * L, 1.30 * W, 1.05 * H
    x, z = -0.50 * L, 0.68 * H
    if plan.p["batteries"] == 1:
        out.add("battery", shapes.box((pack_l, pack_w, pack_h), 0.18 * H, corner=0.3 * W, steps=4), at=(x, 0, z))
        out.add(
            "shell",
            shapes.box((0.10 * L, 0.5 * pack_w, 0.10 * H), 0.03 * H),
            at=(x - 0.3 * L, 0, z + 0.5 * pack_h),
            smooth=False,
        )
    else:
        one = shapes.box((pack_l, 0.47 * pack_w, pack_h), 0.16 * H, corner=0.2 * W, steps=3)
        out.add_both_sides("battery", shapes.moved(one, (x, 0.26 * pack_w, z)))


def _add_shell_outlets(out: Pieces, plan: _Plan) -> None:
    """Add slats along both sides and across the tail."""
    L, W, H = plan.half_length, plan.half_width, plan.half_height
    t, wide = _shell_sections(plan)
    for k in range(5):
        x = L * (-0.30 + 0.095 * k)
        flank = float(np.interp(x / L, t, wide))
        slat = shapes.box((0.035 * L, 0.05 * W, 0.55 * H), 0.01 * H)
        out.add_both_sides("vent", shapes.moved(slat, (x, flank, -0.10 * H)), smooth=False)
    for k in (-1, 0, 1):
        slat = shapes.box((0.05 * L, 0.9 * W, 0.09 * H), 0.02 * H)
        out.add("vent", slat, at=(-0.985 * L, 0, (0.1 + 0.22 * k) * H), smooth=False)


def _add_shell_sensors(out: Pieces, plan: _Plan) -> None:
    """Add obstacle sensors at the nose and the tail, facing along X, and a cooling plate below the belly."""
    L, W, H = plan.half_length, plan.half_width, plan.half_height
    eye = shapes.placed(shapes.cylinder(0.11 * W, -0.10 * L, 0.0, 14, 0.02 * W), shapes.turn_y(math.pi / 2))
    out.add_both_sides("lens", shapes.moved(eye, (0.945 * L, 0.40 * W, 0.05 * H)))
    out.add_both_sides("lens", shapes.moved(shapes.mirrored(eye, 0), (-0.93 * L, 0.55 * W, 0.28 * H)))
    out.add("vent", shapes.box((0.7 * L, 1.0 * W, 0.12 * H), 0.03 * H), at=(-0.2 * L, 0, -0.96 * H), smooth=False)


def _plate_outline(L: float, W: float, waist: float) -> FloatArray:
    """Return the outline of a long plate with a waist: 32 points, counter-clockwise."""
    unit = shapes.circle(32, 5.0)
    x, y = L * unit[:, 0], W * unit[:, 1]
    y = y * (1 - waist * np.exp(-((x / (0.38 * L)) ** 2)))
    return np.stack([x, y], axis=1)


def _add_plate_body(out: Pieces, plan: _Plan) -> None:
    """Add two carbon plates on spacers with boards between them and the battery strapped on top."""
    L, W, H = plan.half_length, plan.half_width, plan.half_height
    thick = 0.009
    low, high = -H, H * 0.62
    out.add("frame", shapes.plate(_plate_outline(L, W, 0.12), low - thick, low), smooth=False)
    out.add(
        "frame",
        shapes.plate(_plate_outline(0.92 * L, 0.9 * W, 0.12), low + 0.02, low + 0.02 + 0.8 * thick),
        smooth=False,
    )
    # Top plate: a solid middle and an open frame at either end.
    middle = _plate_outline(0.46 * L, 0.74 * W, 0.0)
    out.add("frame", shapes.plate(middle, high, high + thick), smooth=False)
    ring = shapes.circle(24, 4.0)
    outer = ring * (0.33 * L, 0.66 * W)
    hole = ring * (0.22 * L, 0.40 * W)
    for side in (1, -1):
        shift = (side * 0.66 * L, 0.0)
        out.add("frame", shapes.plate(outer + shift, high, high + thick, hole + shift), smooth=False)
    post = shapes.cylinder(0.0085, low - 0.004, high + thick + 0.004, 10)
    for x in (-0.9, -0.45, 0.45, 0.9):
        out.add_both_sides("frame", shapes.moved(post, (x * L, 0.52 * W, 0.0)))

    # Boards: power stage with a row of hot chips below, flight controller above.
    board = (0.62 * L, 0.95 * W, 0.006)
    out.add("esc", shapes.box(board, 0.001), at=(0.02 * L, 0, low + 0.38 * (high - low)), smooth=False)
    chip = shapes.box((0.10 * L, 0.16 * W, 0.012), 0.002)
    for x in (-0.2, 0.02, 0.24):
        out.add_both_sides(
            "esc", shapes.moved(chip, (x * L, 0.26 * W, low + 0.38 * (high - low) + 0.008)), smooth=False
        )
    out.add(
        "esc", shapes.box((0.40 * L, 0.8 * W, 0.005), 0.001), at=(0.02 * L, 0, low + 0.68 * (high - low)), smooth=False
    )
    # Video transmitter and receiver at the tail, a warm block visible through the opening of the frame.
    out.add("camera", shapes.box((0.26 * L, 0.5 * W, 0.02), 0.003), at=(-0.66 * L, 0, low + 0.055), smooth=False)
    out.add("shell", shapes.box((0.18 * L, 0.4 * W, 0.016), 0.003), at=(0.66 * L, 0, low + 0.05), smooth=False)

    pack = (0.88 * L, 0.84 * W, 0.078)
    z = high + thick + pack[2] / 2
    if plan.p["batteries"] == 1:
        out.add("battery", shapes.box(pack, 0.010, corner=0.014, steps=3), at=(-0.06 * L, 0, z))
        wide = pack[1]
    else:
        one = shapes.box((pack[0], 0.78 * W, pack[2]), 0.010, corner=0.014, steps=3)
        out.add_both_sides("battery", shapes.moved(one, (-0.06 * L, 0.41 * W, z)))
        wide = 1.64 * W
    # Straps across the pack and the power lead from its end.
    for x in (-0.26, 0.14):
        strap = shapes.box((0.10 * L, wide + 0.006, pack[2] + 0.006), 0.004)
        out.add("frame", strap, at=(x * L, 0, z), smooth=False)
    lead = [
        (-0.48 * L, 0.0, z + 0.012),
        (-0.60 * L, 0.004, z + 0.016),
        (-0.70 * L, 0.012, z - 0.02),
        (-0.72 * L, 0.014, low + 0.05),
    ]
    out.add("battery", shapes.sweep(lead, 0.0075, n=8, up=(0.0, 1.0, 0.0), round_ends=True))
    # Side plates and the pilot's camera at the nose.
    cheek = shapes.box((0.16 * L, 0.006, 0.85 * (high - low)), 0.0015)
    out.add_both_sides("frame", shapes.moved(cheek, (0.96 * L, 0.36 * W, (low + high) / 2)), smooth=False)
    out.add("camera", shapes.box((0.045, 0.5 * W, 0.045), 0.006), at=(0.94 * L, 0, (low + high) / 2), smooth=False)
    barrel = shapes.placed(shapes.cylinder(0.016, 0.0, 0.028, 14, 0.002), shapes.turn_y(math.pi / 2 - 0.35))
    out.add("lens", barrel, at=(0.94 * L + 0.018, 0, (low + high) / 2))


def _add_industrial_body(out: Pieces, plan: _Plan) -> None:
    """Add a faceted hull with hot-swap batteries at the back, a sensor block in front and cooling slots."""
    L, W, H = plan.half_length, plan.half_width, plan.half_height
    x0 = 0.05 * L
    levels = []
    for z, sx, sy in ((-1.0, 0.78, 0.72), (-0.72, 0.92, 0.92), (0.1, 1.0, 1.0), (0.62, 0.95, 0.92), (1.0, 0.80, 0.70)):
        levels.append((z * H, shapes.rounded_rectangle(sx * 0.95 * L, sy * W, 0.36 * W, 4) + np.array([x0, 0.0])))
    out.add("shell", shapes.stack(levels))
    # Lid with a raised edge over the avionics.
    out.add(
        "shell",
        shapes.box((0.62 * L, 0.95 * W, 0.16 * H), 0.05 * H, corner=0.2 * W, steps=3),
        at=(0.48 * L, 0, 1.03 * H),
    )
    out.add(
        "shell",
        shapes.box((0.36 * L, 0.9 * W, 0.8 * H), 0.12 * H, corner=0.2 * W, steps=3),
        at=(0.92 * L, 0, -0.05 * H),
    )

    pack_l, pack_w, pack_h = 0.95 * L, 0.78 * W, 1.5 * H
    x, z = -0.52 * L, 0.62 * H
    if plan.p["batteries"] == 2:
        one = shapes.box((pack_l, pack_w, pack_h), 0.16 * H, corner=0.12 * W, steps=3)
        out.add_both_sides("battery", shapes.moved(one, (x, 0.43 * W, z)))
        handles = [0.43, -0.43]
    else:
        one = shapes.box((pack_l, 1.5 * pack_w, pack_h), 0.16 * H, corner=0.12 * W, steps=3)
        out.add("battery", one, at=(x, 0, z))
        handles = [0.0]
    for y in handles:
        # Handle at the rear end of the pack.
        grip = np.array([(-0.53, -0.22), (-0.60, -0.16), (-0.60, 0.16), (-0.53, 0.22)])
        grip = np.column_stack([x + grip[:, 0] * pack_l, (y + grip[:, 1]) * W, np.full(4, z + 0.1 * H)])
        out.add("shell", shapes.sweep(grip, 0.10 * H, 0.16 * H, n=8))
        ridge = shapes.box((0.7 * pack_l, 0.06 * W, 0.06 * H), 0.015 * H)
        out.add("battery", ridge, at=(x, y * W, z + pack_h / 2), smooth=False)

    for k in range(6):
        xk = L * (0.16 + 0.10 * k)
        slat = shapes.box((0.045 * L, 0.05 * W, 0.5 * H), 0.01 * H)
        out.add_both_sides("vent", shapes.moved(slat, (xk, 0.985 * W, 0.05 * H)), smooth=False)
    for k in range(4):
        slat = shapes.box((0.035 * L, 0.42 * W, 0.04 * H), 0.01 * H)
        out.add("vent", slat, at=((0.30 + 0.09 * k) * L, 0, 1.11 * H), smooth=False)
    eye = shapes.placed(shapes.cylinder(0.11 * W, 0.0, 0.05 * L, 14, 0.02 * W), shapes.turn_y(math.pi / 2))
    out.add_both_sides("lens", shapes.moved(eye, (1.07 * L, 0.28 * W, 0.08 * H)))
    dome = shapes.cylinder(0.12 * W, 0.0, 0.09 * H, 14, 0.03 * W)
    out.add_both_sides("lens", shapes.moved(dome, (0.80 * L, 0.30 * W, 1.08 * H)))
    # Shoulders: brackets from which the arms leave.
    for (rx, ry), (mx, my) in zip(plan.roots_xy.tolist(), plan.motors_xy.tolist(), strict=True):
        root = np.array([rx, ry, plan.root_z])
        tip = np.array([mx, my, plan.tip_z])
        t = np.array([0.0, 0.1, 0.2])[:, None]
        w = 1.9 * plan.arm_half_width
        out.add("shell", shapes.sweep(root + t * (tip - root), (1.3 * w, 1.1 * w, 0.85 * w), w, n=12, exponent=4.0))


# --- gimbal, landing gear, antennas -------------------------------------------------------------------------


def _add_gimbal(out: Pieces, plan: _Plan) -> None:
    """Add a three-axis gimbal at the nose: yaw motor, arm, roll motor, arm, camera with its lens."""
    body = plan.p["body"]
    if body == "shell":
        s = 0.042
        at = np.array([0.90 * plan.half_length, 0.0, -1.05 * plan.half_height])
    elif body == "plate":
        s = 0.046
        at = np.array([0.62 * plan.half_length, 0.0, -plan.half_height - 0.085])
    else:
        s = 0.058
        at = np.array([0.80 * plan.half_length, 0.0, -plan.half_height - 0.095])
    roof = -plan.half_height - at[2]
    yaw = shapes.cylinder(0.52 * s, max(0.75 * s, 0.4 * roof), max(roof, 0.8 * s) + 0.4 * s, 14, 0.06 * s)
    out.add("gimbal", yaw, at=(float(at[0] - 0.9 * s), 0.0, float(at[2])))
    yaw_arm = np.array([(-0.9, 0, 0.95), (-1.35, 0, 0.85), (-1.6, 0, 0.45), (-1.6, 0, 0.0)]) * s + at
    out.add("gimbal", shapes.sweep(yaw_arm, 0.24 * s, 0.2 * s, n=10, up=(0.0, 1.0, 0.0), round_ends=True))
    roll = shapes.placed(shapes.cylinder(0.42 * s, -0.3 * s, 0.3 * s, 14, 0.05 * s), shapes.turn_y(math.pi / 2))
    out.add("gimbal", roll, at=(float(at[0] - 1.5 * s), 0.0, float(at[2])))
    roll_arm = np.array([(-1.35, 0, 0), (-1.3, 0.7, 0), (-1.05, 1.12, 0), (-0.5, 1.25, 0), (0.0, 1.25, 0)]) * s + at
    out.add("gimbal", shapes.sweep(roll_arm, 0.15 * s, 0.24 * s, n=10, round_ends=True))
    tilt = shapes.placed(shapes.cylinder(0.42 * s, 0.85 * s, 1.42 * s, 14, 0.05 * s), shapes.turn_x(-math.pi / 2))
    out.add("gimbal", tilt, at=tuple(at.tolist()))
    down = shapes.turn_y(math.radians(float(plan.p["gimbal_pitch_deg"])))
    if body == "industrial":
        # A payload with several lenses, one of them of a thermal camera.
        head = shapes.box((1.7 * s, 1.85 * s, 1.75 * s), 0.3 * s, corner=0.5 * s, steps=3)
        eyes = [(0.42, 0.34, 0.40), (-0.42, 0.34, 0.32), (-0.05, -0.45, 0.26)]
    else:
        head = shapes.ellipsoid((1.0 * s, 0.92 * s, 0.95 * s), 18, 10)
        eyes = [(0.0, 0.0, 0.56)]
    out.add("camera", shapes.placed(head, down, at))
    for y, z, radius in eyes:
        barrel = shapes.placed(shapes.cylinder(radius * s, 0.4 * s, 1.08 * s, 16, 0.05 * s), shapes.turn_y(math.pi / 2))
        out.add("camera", shapes.placed(shapes.moved(barrel, (0, y * s, z * s)), down, at))
        glass = shapes.lathe(
            [(0.8 * radius * s, 1.0 * s), (0.8 * radius * s, 1.09 * s), (0.4 * radius * s, 1.13 * s), (0.0, 1.14 * s)],
            16,
        )
        glass = shapes.moved(shapes.placed(glass, shapes.turn_y(math.pi / 2)), (0, y * s, z * s))
        out.add("lens", shapes.placed(glass, down, at))


def _add_legs(out: Pieces, plan: _Plan) -> None:
    kind = plan.p["legs"]
    ground = plan.ground_z
    L, W, H = plan.half_length, plan.half_width, plan.half_height
    thin = 0.011 if plan.p["body"] == "industrial" else 0.0085
    if kind == "feet":
        for x, y in plan.motors_xy.tolist():
            k = 1 - 0.35 * plan.motor_radius / math.hypot(x, y)
            top = (k * x, k * y, plan.tip_z)
            foot = (1.01 * x, 1.01 * y, ground)
            up = (-y, x, 0.0)
            out.add("leg", shapes.sweep([top, foot], (0.019, 0.011), (0.011, 0.008), n=12, up=up, round_ends=True))
        return
    spread = max(1.35 * W, 0.15)
    reach = max(0.85 * L, 0.19)
    if kind == "skids":
        for x in (0.42 * reach, -0.42 * reach):
            high = np.array([x, 0.5 * W, -0.7 * H])
            low = np.array([1.15 * x, spread, ground])
            across = (1.0, 0.0, 0.0)
            out.add_both_sides("leg", shapes.sweep([high, low], (1.3 * thin, thin), n=12, up=across))
            out.add_both_sides("frame", shapes.sweep([high, high + 0.22 * (low - high)], 1.8 * thin, n=10, up=across))
            tee = low + np.array([(-0.03, 0.0, 0.0), (0.03, 0.0, 0.0)])
            out.add_both_sides("leg", shapes.sweep(tee, 1.5 * thin, n=10))
        tips = 0.012
        rail = [(-reach, spread, ground + tips), (-0.85 * reach, spread, ground)]
        rail += [(-x, y, z) for x, y, z in reversed(rail)]
        out.add_both_sides("leg", shapes.sweep(rail, thin, n=12, round_ends=True))
        for x in (0.72, -0.72):
            sleeve = [((x - 0.1) * reach, spread, ground), ((x + 0.1) * reach, spread, ground)]
            out.add_both_sides("leg", shapes.sweep(sleeve, 1.5 * thin, n=12))
        return
    # Curved: one bow per side, from the front down and outwards, along the ground and up again.
    hip = np.array([0.55 * reach, 0.0, -0.6 * H])
    half = np.concatenate([hip[None], _bow(0.75 * reach, ground, 0.07)])
    half[:, 1] = 0.6 * W + (spread - 0.6 * W) * np.clip((hip[2] - half[:, 2]) / (hip[2] - ground), 0, 1)
    path = np.concatenate([half, (half * (-1, 1, 1))[::-1]])
    out.add_both_sides("leg", shapes.sweep(path, 1.25 * thin, thin, n=12, up=(0.0, 1.0, 0.0)))


def _bow(x: float, ground: float, bend: float) -> FloatArray:
    """Return five points of a quarter bend from vertical at `x` to horizontal on the ground."""
    a = np.linspace(0, math.pi / 2, 5)
    return np.stack([x - bend + bend * np.cos(a), np.zeros(5), ground + bend - bend * np.sin(a)], axis=1)


def _add_antennas(out: Pieces, plan: _Plan) -> None:
    L, W, H = plan.half_length, plan.half_width, plan.half_height
    body = plan.p["body"]
    top = {"shell": 0.95 * H, "plate": 0.62 * H, "industrial": 0.9 * H}[body]
    if plan.p["mast"]:
        x = {"shell": 0.12, "plate": 0.94, "industrial": 0.12}[body] * L
        height = 0.30 if body == "industrial" else 0.22
        out.add("antenna", shapes.cylinder(0.0065, top - 0.02, height, 10), at=(x, 0.0, 0.0))
        puck = [
            (0.012, height - 0.006),
            (0.040, height),
            (0.042, height + 0.010),
            (0.036, height + 0.020),
            (0.0, height + 0.024),
        ]
        out.add("antenna", shapes.lathe(puck, 20), at=(x, 0.0, 0.0))
    sides = {0: (), 1: (0.0,), 2: (1.0, -1.0)}[plan.p["antennas"]]
    for side in sides:
        x, y = -0.93 * L, side * 0.6 * W
        base = (x, y, {"shell": 0.2, "plate": -0.2, "industrial": 0.0}[body] * H)
        lean = np.array([-0.35, 0.45 * side, 1.0])
        lean /= np.linalg.norm(lean)
        tip = np.array(base) + 0.17 * lean
        out.add("antenna", shapes.capsule(base, tip, 0.0045, n=8))
        out.add("antenna", shapes.capsule(np.array(base) + 0.10 * lean, tip, 0.0085, n=10))


# --- the model -----------------------------------------------------------------------------------------------


def build_drone(params: Params) -> Mesh:
    """Build the mesh of one drone: origin at the centre of its bounding box without propellers and antennas."""
    _require_params(params)
    discs = _rotors(_plan(params)).discs()
    return assembled(_build_pieces(params), discs, attitude=np.eye(3), size=float(params["size_m"]))


def _build_pieces(params: Params) -> Pieces:
    """Return the closed solids of one drone, for a diagonal of 1."""
    plan = _plan(params)
    out = Pieces()
    add_body = {"shell": _add_shell_body, "plate": _add_plate_body, "industrial": _add_industrial_body}
    add_body[params["body"]](out, plan)
    _add_arms(out, plan)
    _rotors(plan).add_to(out)
    _add_legs(out, plan)
    if params["camera"]:
        _add_gimbal(out, plan)
    _add_antennas(out, plan)
    return out


def _option_text(name: str) -> str:
    if name == "propellers":
        return "still (default), spinning, or a list of both; spinning ones are translucent discs that labels ignore"
    if name in CHOICES:
        return f"one of {', '.join(map(str, CHOICES[name]))}, or a list of several"
    low, high = DRAWN[name]
    text = f"a number or [low, high]; by default [{low:g}, {high:g}]"
    return text + ("; or four numbers" if name == "propeller_angle_deg" else "")


MODEL = ObjectModel(
    name="drone",
    category="drone",
    description="A quadrotor, propellers still or spinning: hot motors and batteries; cold carbon, blades and legs.",
    origin="the centre of its bounding box without propellers and antennas",
    stands=False,
    parts=PARTS,
    sample=sample_params,
    build=build_drone,
    options={name: _option_text(name) for name in NOMINAL},
    parts_for=parts_for,
)
