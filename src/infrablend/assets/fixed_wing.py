"""Fixed-wing drone model: a foam aircraft with a tail, or a flying wing, with one electric motor.

All lengths are for a wingspan of 1 and are scaled at the end. +X is the heading, +Y points left, +Z up. Proportions
follow survey and hobby aircraft of 0.9 m to 2.2 m. Foam is thin, insulating and swept by the airflow, so it stays near
the temperature of the air; only what is above motor, controller and battery shows. Temperatures:
docs/explanation/models.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from infrablend.assets import shapes
from infrablend.assets.model import Params, PartRange, part_role
from infrablend.assets.params import Choice, Dials, Number
from infrablend.assets.rotors import DISC_PARTS, PROPELLERS, Pieces, Propeller, Rotors, aircraft, assembled
from infrablend.assets.shapes import Solid
from infrablend.core.mesh import FloatArray, Mesh

_FOAM = (0.90, 0.95)
PARTS: Mapping[str, PartRange] = {
    "wing": part_role(
        "plastic", (-1.5, 2.0), "foam skin in 10 to 20 m/s of air: clear night to weak sun", emissivity=_FOAM
    ),
    "tail": part_role("plastic", (-1.5, 2.0), "foam or carbon tail surfaces and winglets", emissivity=_FOAM),
    "shell": part_role("plastic", (0.0, 4.0), "fuselage, foam over warm electronics", emissivity=_FOAM),
    "boom": part_role("cfrp", (-0.5, 1.5), "carbon tube that carries the tail"),
    "battery": part_role("plastic", (3.0, 12.0), "hatch and belly above and below the pack", emissivity=(0.92, 0.95)),
    "motor": part_role("black_anodised", (8.0, 35.0), "motor bell in cruise, cooled by the propeller's air"),
    "winding": part_role("circuit_board", (12.0, 45.0), "stator, visible between bell and base"),
    "motor_mount": part_role("plastic", (4.0, 14.0), "firewall around the motor", emissivity=(0.90, 0.95)),
    "vent": part_role("cavity", (5.0, 18.0), "air outlet of the speed controller"),
    "camera": part_role("plastic", (5.0, 18.0), "camera, video transmitter", emissivity=(0.92, 0.95)),
    "lens": part_role("lens", (3.0, 10.0), "glass of the camera"),
    "propeller": part_role(
        "plastic", (0.0, 4.0), "blades at rest: 0..+4 K of recovery heating", emissivity=(0.85, 0.94)
    ),
    "antenna": part_role("plastic", (-0.5, 2.0), "antenna, air-speed probe", emissivity=(0.90, 0.95)),
    **DISC_PARTS,
}
DIALS = Dials(
    "fixed-wing",
    {
        "size_m": Number((0.9, 2.2), (0.2, 6.0), log=True),
        "layout": Choice(("tail", "boom", "flying-wing"), (0.4, 0.25, 0.35), "boom has a pod with a pusher behind it"),
        "tail": Choice(("conventional", "t", "v"), (0.5, 0.2, 0.3), "ignored by flying wings"),
        "camera": Choice((True, False), (0.6, 0.4)),
        "blades": Choice((2, 3), (0.95, 0.05)),
        "propellers": Choice(PROPELLERS, (1.0, 0.0), "spinning ones are translucent discs that labels ignore"),
        "chord": Number((0.85, 1.2), (0.7, 1.4)),
        "taper": Number((0.55, 0.95), (0.3, 1.0)),
        "sweep": Number((0.85, 1.15), (0.7, 1.3)),
        "dihedral_deg": Number((0.0, 6.0), (-5.0, 12.0)),
        "body_length": Number((0.9, 1.12), (0.8, 1.25)),
        "body_width": Number((0.85, 1.2), (0.7, 1.4)),
        "propeller_radius": Number((0.85, 1.1), (0.5, 1.2)),
        "propeller_angle_deg": Number((0.0, 360.0), (-3600.0, 3600.0)),
        "climb_deg": Number((-6.0, 10.0), (-60.0, 60.0)),
        "bank_deg": Number((-30.0, 30.0), (-80.0, 80.0)),
    },
)


@dataclass(frozen=True)
class _Thrust:
    """Place of the motor: `x`, `z` of its seat; it faces forward, or backward as a pusher."""

    x: float
    z: float
    pusher: bool

    @property
    def turn(self) -> FloatArray:
        """(3, 3) rotation of the vertical shaft into the direction of flight."""
        return shapes.turn_y(-math.pi / 2 if self.pusher else math.pi / 2)

    @property
    def at(self) -> tuple[float, float, float]:
        """Seat of the motor."""
        return self.x, 0.0, self.z


def _thrust(p: Params) -> _Thrust:
    length = float(p["body_length"])
    if p["layout"] == "tail":
        return _Thrust(0.285 * length, 0.0, False)
    if p["layout"] == "boom":
        return _Thrust(-0.185 * length, 0.035, True)
    return _Thrust(-0.175 * length, 0.012, True)


def _rotor(p: Params) -> Rotors:
    radius = {"tail": 0.115, "boom": 0.100, "flying-wing": 0.095}[p["layout"]] * float(p["propeller_radius"])
    propeller = Propeller(radius, p["blades"], 1.0, p["propellers"] == "spinning")
    return Rotors(np.zeros((1, 2)), 0.0, 0.019, 0.03, propeller, (float(p["propeller_angle_deg"]),))


def parts_for(params: Params) -> dict[str, PartRange]:
    """Return the thermal role of every part, without discs if the propeller is still."""
    return _rotor(params).propeller.roles_among(PARTS)


def build_fixed_wing(params: Params) -> Mesh:
    """Build the mesh of one aircraft: origin at the centre of its bounding box without propeller and antennas."""
    DIALS.require(params)
    attitude = shapes.attitude(float(params["climb_deg"]), float(params["bank_deg"]))
    thrust = _thrust(params)
    discs = [d @ thrust.turn.T + thrust.at for d in _rotor(params).discs()]
    size = float(params["size_m"])
    return assembled(build_pieces(params), discs, attitude=attitude, size=size)


def build_pieces(p: Params) -> Pieces:
    """Return the closed solids of one aircraft in level flight, for a wingspan of 1."""
    out = Pieces()
    if p["layout"] == "flying-wing":
        _add_flying_wing(out, p)
    else:
        _add_airframe(out, p)
    thrust = _thrust(p)
    motor = Pieces()
    _rotor(p).add_to(motor)
    out.add_all(motor, thrust.turn, thrust.at)
    return out


# --- surfaces ---------------------------------------------------------------------------------------------------

_UP = np.array([0.0, 0.0, 1.0])
_LEFT = np.array([0.0, 1.0, 0.0])


def _wing(lead_x: float, z: float, chords: tuple[float, float], sweep: float, dihedral_rad: float) -> Solid:
    """Return a wing of span 1 with root and tip `chords`; the tips' leading edges are `sweep` behind the root's."""
    stations = []
    for y in (-0.5, -0.485, -0.44, -0.25, 0.0, 0.25, 0.44, 0.485, 0.5):
        share = 2 * abs(y)
        chord = chords[0] + (chords[1] - chords[0]) * share
        # Rounded tips.
        round_off = {0.5: 0.55, 0.485: 0.85}.get(abs(y), 1.0)
        lead = lead_x - sweep * share - 0.25 * chord * (1 - round_off)
        stations.append(((lead, y, z + abs(y) * math.tan(dihedral_rad)), chord * round_off, 0.11))
    return shapes.aerofoil(stations, _UP)


def _add_airframe(out: Pieces, p: Params) -> None:
    """Add fuselage, high wing and tail."""
    length = float(p["body_length"])
    width = 0.040 * float(p["body_width"])
    dihedral = math.radians(float(p["dihedral_deg"]))
    chord = 0.175 * float(p["chord"])
    wing_z = 0.048
    lead_x = 0.11
    out.add("wing", _wing(lead_x, wing_z, (chord, chord * float(p["taper"])), 0.02 * float(p["sweep"]), dihedral))
    tail_x, tail_z = -0.46 * length, 0.03
    if p["layout"] == "tail":
        x = np.array([0.285, 0.27, 0.20, 0.08, -0.08, -0.25, -0.44, -0.47]) * length
        wide = width * np.array([0.55, 0.72, 0.95, 1.0, 0.95, 0.62, 0.30, 0.22])
        tall = width * np.array([0.55, 0.75, 1.0, 1.15, 1.10, 0.70, 0.36, 0.28])
        z = np.interp(x, [-0.47, -0.1, 0.3], [0.03, 0.004, 0.0])
        spine = np.column_stack([x, np.zeros_like(x), z])[::-1]
        out.add("shell", shapes.sweep(spine, wide[::-1], tall[::-1], n=20, exponent=2.6))
        out.add("motor_mount", shapes.sweep([(0.265 * length, 0, 0), (0.288 * length, 0, 0)], 0.78 * width, n=20))
        hatch_x = 0.17 * length
    else:
        x = np.array([0.26, 0.245, 0.19, 0.08, -0.06, -0.14, -0.165]) * length
        wide = width * np.array([0.25, 0.6, 0.98, 1.15, 1.05, 0.7, 0.4])
        out.add(
            "shell",
            shapes.sweep(
                np.column_stack([x, 0 * x, 0 * x])[::-1],
                wide[::-1],
                1.1 * wide[::-1],
                n=20,
                exponent=2.6,
                round_ends=True,
            ),
        )
        # Pylon of the pusher above the boom, which runs below the propeller.
        pylon = [(-0.06 * length, 0.0, 0.02), (-0.13 * length, 0.0, 0.032), (-0.188 * length, 0.0, 0.035)]
        out.add("motor_mount", shapes.sweep(pylon, 0.5 * width, 0.55 * width, n=14))
        y = 0.16
        for side in (y, -y):
            out.add("boom", shapes.sweep([(0.03, side, wing_z), (tail_x - 0.1, side, tail_z)], 0.0085, n=12))
        hatch_x = 0.15 * length
    hatch = shapes.box((0.13, 1.1 * width, 0.75 * width), 0.2 * width, corner=0.4 * width, steps=3)
    out.add("battery", hatch, at=(hatch_x, 0.0, 0.75 * width))
    out.add(
        "battery",
        shapes.box((0.11, 0.95 * width, 0.5 * width), 0.15 * width, corner=0.3 * width, steps=3),
        at=(hatch_x - 0.01, 0.0, -0.95 * width),
    )
    for k in (-1, 1):
        slat = shapes.box((0.035, 0.012, 0.014), 0.003)
        out.add("vent", slat, at=(0.03 * length, 0.98 * k * width, -0.3 * width), smooth=False)
    if p["camera"]:
        _add_camera(out, (0.03, 0.0, -1.25 * width))
    out.add("antenna", shapes.capsule((-0.12, 0.0, 0.03), (-0.14, 0.0, 0.14), 0.0035, n=8))
    out.add("antenna", shapes.capsule((0.09, 0.3, wing_z), (0.17, 0.3, wing_z), 0.003, n=8))
    _add_tail(out, p, tail_x, tail_z)


def _add_tail(out: Pieces, p: Params, x: float, z: float) -> None:
    chord = 0.105
    half = 0.175
    kind = "conventional" if p["layout"] == "boom" and p["tail"] == "t" else p["tail"]
    if kind == "v":
        lean = math.radians(38.0)
        for side in (1.0, -1.0):
            along = np.array([0.0, side * math.cos(lean), math.sin(lean)])
            up = np.array([0.0, -side * math.sin(lean), math.cos(lean)])
            foot = np.array([x + 0.06, side * (0.16 if p["layout"] == "boom" else 0.0), z])
            if p["layout"] == "boom":
                # Inverted: from the booms up to the middle.
                along = np.array([0.0, -side * math.cos(lean), math.sin(lean)])
                up = np.array([0.0, side * math.sin(lean), math.cos(lean)])
                reach = 0.16 / math.cos(lean)
            else:
                reach = 1.15 * half
            ends = [foot, foot + 0.9 * reach * along, foot + reach * along]
            stations = [
                ((float(e[0] - d), float(e[1]), float(e[2])), c, 0.09)
                for e, d, c in zip(ends, (0.0, 0.025, 0.035), (chord, 0.8 * chord, 0.6 * chord), strict=True)
            ]
            stations = stations if along[1] > 0 else stations[::-1]
            out.add("tail", shapes.aerofoil(stations, up))
        return
    plane_z = z + (0.135 if kind == "t" else 0.004)
    stations = []
    for y in (-1.0, -0.93, 0.0, 0.93, 1.0):
        c = chord * (1 - 0.25 * abs(y)) * (0.65 if abs(y) == 1 else 1.0)
        stations.append(((x + 0.06 - 0.02 * abs(y), y * half, plane_z), c, 0.08))
    out.add("tail", shapes.aerofoil(stations, _UP))
    for side in (0.16, -0.16) if p["layout"] == "boom" else (0.0,):
        fin = [
            ((x + 0.07, side, z - 0.004), 1.15 * chord, 0.08),
            ((x + 0.03, side, z + 0.12), 0.85 * chord, 0.08),
            ((x + 0.015, side, z + 0.14), 0.6 * chord, 0.08),
        ]
        out.add("tail", shapes.aerofoil(fin, -_LEFT))


def _add_flying_wing(out: Pieces, p: Params) -> None:
    """Add a swept wing with winglets and a blister in the middle."""
    length = float(p["body_length"])
    width = 0.062 * float(p["body_width"])
    root = 0.30 * float(p["chord"])
    tip = 0.30 * float(p["chord"]) * min(float(p["taper"]), 0.75)
    sweep = 0.23 * float(p["sweep"])
    rear = -0.165 * length
    lead_x = rear + root
    dihedral = math.radians(0.5 * float(p["dihedral_deg"]))
    out.add("wing", _wing(lead_x, 0.0, (root, tip), sweep, dihedral))
    for side in (0.5, -0.5):
        z = 0.5 * math.tan(dihedral)
        winglet = [
            ((lead_x - sweep - 0.01, side, z - 0.02), 0.85 * tip, 0.07),
            ((lead_x - sweep - 0.06, side, z + 0.085), 0.6 * tip, 0.07),
            ((lead_x - sweep - 0.075, side, z + 0.10), 0.4 * tip, 0.07),
        ]
        out.add("tail", shapes.aerofoil(winglet, -_LEFT))
    x = np.array([lead_x + 0.06, lead_x + 0.04, lead_x - 0.03, lead_x - 0.12, rear + 0.03, rear - 0.005])
    wide = width * np.array([0.25, 0.55, 0.95, 1.0, 0.75, 0.45])
    spine = np.column_stack([x, np.zeros_like(x), np.full_like(x, 0.010)])[::-1]
    out.add("shell", shapes.sweep(spine, wide[::-1], 0.68 * wide[::-1], n=20, exponent=2.5, round_ends=True))
    out.add("motor_mount", shapes.sweep([(rear + 0.02, 0, 0.012), (_thrust(p).x, 0, 0.012)], 0.024, n=16))
    hatch = shapes.box((0.12, 1.1 * width, 0.5 * width), 0.15 * width, corner=0.4 * width, steps=3)
    out.add("battery", hatch, at=(lead_x - 0.04, 0.0, 0.010 + 0.48 * width))
    belly = shapes.box((0.11, 1.0 * width, 0.4 * width), 0.12 * width, corner=0.3 * width, steps=3)
    out.add("battery", belly, at=(lead_x - 0.05, 0.0, 0.010 - 0.52 * width))
    for k in (-1, 1):
        slat = shapes.box((0.035, 0.014, 0.012), 0.003)
        out.add("vent", slat, at=(rear + 0.07, 0.5 * k * width, 0.010 + 0.5 * width), smooth=False)
    if p["camera"]:
        _add_camera(out, (rear + 0.10, 0.0, 0.005 - 0.68 * width))
    probe_x = lead_x - 0.5 * sweep + 0.05
    out.add("antenna", shapes.capsule((probe_x - 0.07, 0.25, 0.0), (probe_x, 0.25, 0.0), 0.003, n=8))


def _add_camera(out: Pieces, at: tuple[float, float, float]) -> None:
    """Add a camera that looks down through the belly."""
    x, y, z = at
    out.add("camera", shapes.cylinder(0.020, -0.004, 0.018, 16, 0.004), at=(x, y, z))
    out.add("lens", shapes.cylinder(0.012, -0.009, 0.0, 14, 0.002), at=(x, y, z))


MODEL = aircraft(
    "fixed-wing",
    "A fixed-wing drone of foam with a tail or twin booms, or a flying wing, and one electric motor.",
    PARTS,
    DIALS,
    build_fixed_wing,
    parts_for,
)
