"""Helicopter model: light with a piston engine, medium, or heavy on wheels, its rotors still or spinning.

All lengths are for a main rotor of diameter 1 and are scaled at the end. +X is the heading, +Y points left, +Z up; the
shaft of the main rotor is at x = 0. Proportions follow Robinson R44, Airbus H135 and H145, and Sikorsky UH-60.
Temperatures: docs/explanation/models.md.
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
from infrablend.core.mesh import FloatArray, Mesh

PARTS: Mapping[str, PartRange] = {
    "cabin": part_role("painted", (1.0, 7.0), "skin over a heated cabin and gearbox, weak sun"),
    "window": part_role("glass", (-1.0, 4.0), "windscreen and doors"),
    "boom": part_role("painted", (0.0, 5.0), "tail boom, partly in the exhaust"),
    "fin": part_role("painted", (-1.0, 3.0), "fin, tail plane, shroud of the tail rotor"),
    "gear": part_role("painted", (-1.0, 2.0), "skids or wheels"),
    "engine": part_role("painted", (8.0, 30.0), "cowling over engines and gearbox (estimate)"),
    "exhaust": part_role("oxidised_steel", (60.0, 250.0), "exhaust pipes (estimate)"),
    "hub": part_role("painted", (4.0, 20.0), "mast and hub above the gearbox (estimate)"),
    "propeller": part_role("painted", (0.0, 4.0), "blades: recovery heating of up to 15 K at the tips, mean over them"),
    **DISC_PARTS,
}


@dataclass(frozen=True)
class _Kind:
    """Proportions of one kind, for a main rotor of diameter 1.

    Attributes:
        diameter: (low, high) diameter of the main rotor, metres.
        cabin: Places of nose and rear end, half width, half height.
        boom: Radii of the tail boom at either end.
        hub: Height of the main rotor above the middle of the cabin.
        blades: Blades of the main rotor.
        engine: Length and half width of the cowling; its height is a third of the length.
    """

    diameter: tuple[float, float]
    cabin: tuple[float, float, float, float]
    boom: tuple[float, float]
    hub: float
    blades: int
    engine: tuple[float, float]


_KINDS: Mapping[str, _Kind] = {
    "light": _Kind((7.5, 10.5), (0.21, -0.15, 0.066, 0.085), (0.022, 0.012), 0.185, 2, (0.13, 0.045)),
    "medium": _Kind((10.2, 13.0), (0.27, -0.19, 0.085, 0.092), (0.042, 0.022), 0.17, 4, (0.24, 0.055)),
    "heavy": _Kind((13.5, 17.0), (0.33, -0.27, 0.072, 0.078), (0.045, 0.026), 0.145, 4, (0.26, 0.060)),
}
DIALS = Dials(
    "helicopter",
    {
        "kind": Choice(tuple(_KINDS), (0.35, 0.4, 0.25)),
        "size_m": Number(
            (7.5, 17.0), (4.0, 25.0), log=True, by="kind", ranges={k: v.diameter for k, v in _KINDS.items()}
        ),
        "tail": Choice(("rotor", "shrouded"), (0.75, 0.25)),
        "propellers": Choice(PROPELLERS, (0.5, 0.5), "spinning rotors are translucent discs that labels ignore"),
        "propeller_angle_deg": Number((0.0, 360.0), (-3600.0, 3600.0)),
        "length": Number((0.92, 1.08), (0.8, 1.2)),
        "girth": Number((0.9, 1.12), (0.7, 1.4)),
        "lean_deg": Number((-4.0, 12.0), (-45.0, 45.0)),
        "bank_deg": Number((-15.0, 15.0), (-60.0, 60.0)),
    },
)
_TAIL_X, _TAIL_Z = -0.57, 0.06
_RIGHT = (0.0, -1.0, 0.0)
_Rotor = tuple[Rotors, FloatArray, tuple[float, float, float]]


def parts_for(params: Params) -> dict[str, PartRange]:
    """Return the thermal role of every part, without discs if the rotors are still."""
    return _rotors(params)[0][0].propeller.roles_among(PARTS)


def build_helicopter(params: Params) -> Mesh:
    """Build the mesh of one helicopter: origin at the centre of its bounding box without rotors."""
    DIALS.require(params)
    attitude = shapes.attitude(-float(params["lean_deg"]), float(params["bank_deg"]))
    discs = [d @ turn.T + at for rotor, turn, at in _rotors(params) for d in rotor.discs()]
    return assembled(build_pieces(params), discs, attitude=attitude, size=float(params["size_m"]))


def _rotors(p: Params) -> list[_Rotor]:
    """Return each rotor with the rotation of its upright shaft and the place of its hub."""
    kind = _KINDS[p["kind"]]
    spinning = p["propellers"] == "spinning"
    angle = (float(p["propeller_angle_deg"]),)
    main = Rotors(np.zeros((1, 2)), 0.0, 0.0, 0.0, Propeller(0.5, kind.blades, 0.32, spinning), angle)
    found: list[_Rotor] = [(main, np.eye(3), (0.0, 0.0, kind.hub))]
    if p["tail"] == "rotor":
        blades = 2 if kind.blades == 2 else 4
        side = Rotors(np.zeros((1, 2)), 0.0, 0.0, 0.0, Propeller(0.085, blades, 0.6, spinning), angle)
        found.append((side, shapes.turn_x(-math.pi / 2), (_TAIL_X * float(p["length"]), 0.03, _TAIL_Z + 0.02)))
    return found


def build_pieces(p: Params) -> Pieces:
    """Return the closed solids of one level helicopter, for a main rotor of diameter 1."""
    kind = _KINDS[p["kind"]]
    out = Pieces()
    length = float(p["length"])
    girth = float(p["girth"])
    front, rear = kind.cabin[0] * length, kind.cabin[1] * length
    wide = kind.cabin[2] * girth
    tall = kind.cabin[3] * girth
    share = np.array([0.0, 0.12, 0.35, 0.6, 0.8, 0.93, 1.0])
    z = tall * np.array([0.45, 0.3, 0.05, 0.0, -0.1, -0.25, -0.35])
    spine = np.column_stack([rear + (front - rear) * share, 0 * share, z])
    half = np.array([0.4, 0.62, 0.95, 1.0, 0.9, 0.62, 0.35])
    height = np.array([0.4, 0.65, 0.95, 1.0, 0.85, 0.55, 0.3])
    out.add("cabin", shapes.sweep(spine, wide * half, tall * height, n=24, exponent=2.5, round_ends=True))
    pane = shapes.ellipsoid((0.3 * (front - rear), 0.9 * wide, 0.6 * tall), 20, 10)
    out.add("window", pane, at=(rear + 0.74 * (front - rear), 0.0, 0.22 * tall))
    tail_x = _TAIL_X * length
    boom = [(0.5 * rear, 0.0, 0.35 * tall), (rear, 0.0, 0.5 * tall), (tail_x, 0.0, _TAIL_Z)]
    radii = np.array([1.4 * kind.boom[0], kind.boom[0], kind.boom[1]])
    out.add("boom", shapes.sweep(boom, radii, n=16, round_ends=True))
    _add_engine(out, kind, tall)
    _add_fins(out, p, tail_x)
    _add_gear(out, p["kind"] == "heavy", (rear, front), wide, tall)
    mast = shapes.cylinder(0.012, 0.5 * tall, kind.hub + 0.012, 12)
    out.add("hub", mast)
    out.add("hub", shapes.cylinder(0.035, -0.008, 0.010, 16, 0.003), at=(0.0, 0.0, kind.hub))
    for rotor, turn, at in _rotors(p):
        if not rotor.propeller.spinning:
            blade = rotor.propeller.blade(False)
            for k in range(rotor.propeller.blades):
                angle = math.radians(rotor.angles_deg[0]) + 2 * math.pi * k / rotor.propeller.blades
                out.add("propeller", shapes.placed(blade, turn @ shapes.turn_z(angle), at))
    return out


def _add_engine(out: Pieces, kind: _Kind, tall: float) -> None:
    """Add the cowling behind the mast, with an exhaust pipe on either side."""
    length, wide = kind.engine
    top = 0.82 * tall
    x = np.array([-0.72, -0.5, 0.1, 0.36]) * length
    spine = np.column_stack([x, 0 * x, top + length * np.array([-0.06, -0.02, 0.0, -0.04])])
    scale = np.array([0.55, 0.9, 1.0, 0.5])
    out.add("engine", shapes.sweep(spine, wide * scale, 0.17 * length * scale, n=20, exponent=2.6, round_ends=True))
    pipe = [(-0.5 * length, 0.55 * wide, top + 0.05 * length), (-0.95 * length, 0.9 * wide, top + 0.08 * length)]
    out.add_both_sides("exhaust", shapes.sweep(pipe, 0.3 * wide, n=12))


def _add_fins(out: Pieces, p: Params, x: float) -> None:
    """Add fin and tail plane, and the shroud of a shrouded tail rotor."""
    low, high = (-0.05, 0.14) if p["kind"] != "heavy" else (-0.02, 0.17)
    fin = [
        ((x + 0.02, 0.0, _TAIL_Z + low), 0.05, 0.1),
        ((x + 0.05, 0.0, _TAIL_Z), 0.085, 0.1),
        ((x - 0.01, 0.0, _TAIL_Z + high), 0.055, 0.1),
    ]
    out.add("fin", shapes.aerofoil(fin, _RIGHT))
    plane = [((x + 0.12, y, _TAIL_Z), 0.045, 0.1) for y in (-0.12, 0.12)]
    out.add("fin", shapes.aerofoil(plane, (0.0, 0.0, 1.0)))
    if p["tail"] == "shrouded":
        ring = shapes.placed(shapes.cylinder(0.065, -0.016, 0.016, 20, 0.006), shapes.turn_x(-math.pi / 2))
        out.add("fin", ring, at=(x - 0.01, 0.0, _TAIL_Z))


def _add_gear(out: Pieces, wheels: bool, ends: tuple[float, float], wide: float, tall: float) -> None:
    """Add wheels or skids below a cabin with these ends."""
    rear, front = ends
    if wheels:
        tyre = shapes.placed(shapes.cylinder(0.022, -0.010, 0.010, 16, 0.004), shapes.turn_x(math.pi / 2))
        for x in (0.45 * front, 0.9 * rear):
            foot = (x, 1.15 * wide, -1.25 * tall)
            out.add_both_sides("gear", shapes.capsule((x, 0.7 * wide, -0.4 * tall), foot, 0.012, n=8))
            out.add_both_sides("gear", shapes.moved(tyre, foot))
        return
    y, z = 1.35 * wide, -1.75 * tall
    rail = [(1.0 * rear, y, z), (0.75 * front, y, z), (0.9 * front, y, z + 0.02)]
    out.add_both_sides("gear", shapes.sweep(rail, 0.0045, n=8, round_ends=True))
    for x in (0.45 * front, 0.55 * rear):
        out.add_both_sides("gear", shapes.capsule((x, 0.5 * wide, -0.6 * tall), (x, y, z), 0.0045, n=8))


MODEL = aircraft(
    "helicopter",
    "A helicopter in flight: light, medium or heavy, with main rotor, tail boom, tail rotor and hot exhausts.",
    PARTS,
    DIALS,
    build_helicopter,
    parts_for,
    "helicopter",
)
