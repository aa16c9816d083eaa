"""Airplane model: light aircraft with a propeller, business jet, or airliner with two engines under a low wing.

All lengths are for a wingspan of 1 and are scaled at the end. +X is the heading, +Y points left, +Z up. Proportions
follow Cessna 172 and Piper PA-28, Cessna Citation and Learjet, Airbus A320 and Boeing 737. The skin stays near the
temperature of the air that flows over it; engines and what lies behind them are hot. Temperatures:
docs/explanation/models.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from infrablend.assets import shapes
from infrablend.assets.model import Params, PartRange, part_role
from infrablend.assets.params import Choice, Dials, Number
from infrablend.assets.rotors import DISC_PARTS, Pieces, Propeller, Rotors, aircraft, assembled
from infrablend.assets.shapes import Solid
from infrablend.core.mesh import FloatArray, Mesh

PARTS: Mapping[str, PartRange] = {
    "fuselage": part_role("painted", (-1.0, 5.0), "skin over a heated cabin; recovery heating less radiation"),
    "window": part_role("glass", (-1.0, 4.0), "windscreen of the cockpit"),
    "wing": part_role("painted", (-2.0, 4.0), "skin over fuel; recovery heating of 1 to 4 K, clear sky above"),
    "tail": part_role("painted", (-2.0, 4.0), "fin and tail plane"),
    "strut": part_role("painted", (-1.0, 2.0), "struts of the wing and fixed landing gear"),
    "nacelle": part_role("painted", (5.0, 20.0), "cowling around an engine (estimate)"),
    "intake": part_role("cavity", (2.0, 12.0), "fan seen through the intake (estimate)"),
    "exhaust": part_role("oxidised_steel", (60.0, 250.0), "nozzle of a jet or exhaust pipe (estimate)"),
    "propeller": part_role("painted", (0.0, 6.0), "spinner"),
    **DISC_PARTS,
}
_SPANS = {"propeller": (8.0, 12.5), "business-jet": (12.0, 22.0), "airliner": (26.0, 60.0)}
DIALS = Dials(
    "airplane",
    {
        "kind": Choice(tuple(_SPANS), (0.35, 0.2, 0.45)),
        "size_m": Number((8.0, 60.0), (5.0, 80.0), log=True, by="kind", ranges=_SPANS),
        "wing": Choice(("high", "low"), (0.6, 0.4), "of light aircraft; jets have low wings"),
        "length": Number((0.9, 1.15), (0.7, 1.4)),
        "girth": Number((0.9, 1.12), (0.7, 1.4)),
        "chord": Number((0.9, 1.1), (0.7, 1.3)),
        "sweep": Number((0.85, 1.15), (0.0, 1.5)),
        "dihedral_deg": Number((2.0, 6.0), (-5.0, 12.0)),
        "climb_deg": Number((-4.0, 12.0), (-45.0, 45.0)),
        "bank_deg": Number((-20.0, 20.0), (-80.0, 80.0)),
    },
)
_UP = (0.0, 0.0, 1.0)
_RIGHT = (0.0, -1.0, 0.0)
_FORWARD = shapes.turn_y(math.pi / 2)


def parts_for(params: Params) -> dict[str, PartRange]:
    """Return the thermal role of every part; only light aircraft have the disc of a propeller."""
    return _propeller(params).propeller.roles_among(PARTS)


def build_airplane(params: Params) -> Mesh:
    """Build the mesh of one airplane: origin at the centre of its bounding box without the propeller."""
    DIALS.require(params)
    attitude = shapes.attitude(float(params["climb_deg"]), float(params["bank_deg"]))
    nose = 0.30 * float(params["length"])
    discs = [d @ _FORWARD.T + (nose, 0.0, 0.0) for d in _propeller(params).discs()]
    return assembled(build_pieces(params), discs, attitude=attitude, size=float(params["size_m"]))


def build_pieces(p: Params) -> Pieces:
    """Return the closed solids of one airplane in level flight, for a wingspan of 1."""
    # Wings and tails are shaded flat: renderers differ in smooth normals at their thin trailing edges.
    out = Pieces()
    {"propeller": _add_light, "business-jet": _add_business_jet, "airliner": _add_airliner}[p["kind"]](out, p)
    return out


def _propeller(p: Params) -> Rotors:
    spinning = p["kind"] == "propeller"
    return Rotors(np.zeros((1, 2)), 0.0, 0.02, 0.02, Propeller(0.085, 2, 0.7, spinning), (0.0,))


def _add_light(out: Pieces, p: Params) -> None:
    """Add a light aircraft: cabin, engine in the nose, high wing on struts or low wing, fixed landing gear."""
    length = float(p["length"])
    girth = 0.052 * float(p["girth"])
    high = p["wing"] == "high"
    x = np.array([-0.45, -0.25, -0.08, 0.02, 0.12, 0.19]) * length
    wide = girth * np.array([0.2, 0.55, 1.0, 1.05, 1.0, 0.9])
    tall = girth * np.array([0.35, 0.65, 1.2, 1.35, 1.1, 0.9])
    z = girth * np.array([0.5, 0.3, 0.15, 0.2, 0.0, -0.1])
    out.add("fuselage", _body(x, z, wide, tall))
    cowl = girth * np.array([0.92, 0.88, 0.6])
    out.add("nacelle", _body(np.array([0.18, 0.25, 0.295]) * length, girth * np.full(3, -0.1), cowl, cowl))
    out.add("propeller", shapes.ellipsoid((0.025, 0.018, 0.018), 12, 6), at=(0.3 * length, 0.0, -0.1 * girth))
    pane = shapes.box((0.07, 1.75 * girth, 0.8 * girth), 0.2 * girth, corner=0.4 * girth, steps=2)
    out.add("window", pane, at=(0.085 * length, 0.0, 0.95 * girth))
    pipe = (0.19 * length, 0.4 * girth, -1.0 * girth)
    out.add("exhaust", shapes.capsule(pipe, (0.16 * length, 0.4 * girth, -1.25 * girth), 0.006, n=8))
    chord = 0.145 * float(p["chord"])
    lead = 0.10 * length
    z_wing = 1.4 * girth if high else -0.75 * girth
    dihedral = math.radians(float(p["dihedral_deg"]) * (0.4 if high else 1.2))
    out.add_both_sides(
        "wing", _half(0.5, lead, z_wing, (chord, 0.95 * chord, 0.7 * chord), 0.02, dihedral, 0.13), smooth=False
    )
    gear_z = -2.3 * girth
    if high:
        foot = (0.05 * length, 0.8 * girth, -0.8 * girth)
        out.add_both_sides("strut", shapes.capsule(foot, (0.04 * length, 0.24, z_wing + 0.003), 0.006, n=8))
    for start, wheel in (((0.0, 0.7 * girth), (-0.01, 0.105)), ((0.2 * length, 0.0), (0.21 * length, 0.0))):
        leg = shapes.capsule((*start, -0.7 * girth), (*wheel, gear_z), 0.007, n=8)
        tyre = shapes.ellipsoid((0.022, 0.01, 0.02), 12, 6)
        for solid in (leg, shapes.moved(tyre, (*wheel, gear_z))):
            if wheel[1]:
                out.add_both_sides("strut", solid)
            else:
                out.add("strut", solid)
    _add_tail(out, -0.36 * length, 0.5 * girth, half=0.155, chord=0.085, sweep=0.02, fin=0.13, t=False)


def _add_business_jet(out: Pieces, p: Params) -> None:
    """Add a business jet: engines beside the rear of the fuselage, tail plane on top of the fin."""
    length = float(p["length"])
    girth = 0.054 * float(p["girth"])
    _add_tube(out, girth, np.array([-0.52, -0.47, -0.32, -0.15, 0.26, 0.38, 0.44, 0.47]) * length)
    chord = 0.165 * float(p["chord"])
    dihedral = math.radians(float(p["dihedral_deg"]))
    sweep = 0.13 * float(p["sweep"])
    chords = (1.15 * chord, 0.75 * chord, 0.38 * chord)
    out.add_both_sides("wing", _half(0.5, 0.07 * length, -0.8 * girth, chords, sweep, dihedral, 0.12), smooth=False)
    _add_engine(out, (-0.27 * length, 1.62 * girth, 0.5 * girth), 0.033, 0.17)
    pylon = [((-0.21 * length, y, 0.5 * girth), 0.10, 0.10) for y in (0.5 * girth, 1.3 * girth)]
    out.add_both_sides("tail", shapes.aerofoil(pylon, _UP), smooth=False)
    _add_tail(out, -0.38 * length, 0.7 * girth, half=0.17, chord=0.11, sweep=0.07, fin=0.17, t=True)


def _add_airliner(out: Pieces, p: Params) -> None:
    """Add an airliner: low swept wing with winglets, an engine under each half of it."""
    length = 1.08 * float(p["length"])
    girth = 0.057 * float(p["girth"])
    _add_tube(out, girth, np.array([-0.5, -0.46, -0.3, -0.16, 0.38, 0.44, 0.475, 0.49]) * length)
    chord = 0.135 * float(p["chord"])
    dihedral = math.radians(float(p["dihedral_deg"]))
    sweep = 0.25 * float(p["sweep"])
    chords = (1.5 * chord, 0.85 * chord, 0.33 * chord)
    out.add_both_sides("wing", _half(0.5, 0.14 * length, -0.65 * girth, chords, sweep, dihedral, 0.12), smooth=False)
    belly = shapes.ellipsoid((0.16, 0.85 * girth, 0.4 * girth), 16, 8)
    out.add("wing", belly, at=(0.14 * length - 0.1, 0.0, -0.8 * girth))
    y = 0.165
    x, z = 0.14 * length - 2 * y * sweep + 0.02, -0.65 * girth + y * math.tan(dihedral) - 0.045
    _add_engine(out, (x, y, z), 0.033, 0.13)
    out.add_both_sides(
        "wing",
        shapes.aerofoil([((x + 0.03, y, z + 0.02), 0.11, 0.1), ((x - 0.02, y, z + 0.055), 0.1, 0.1)], _RIGHT),
        smooth=False,
    )
    lead = 0.14 * length - sweep - 0.005
    top = 0.5 * math.tan(dihedral) - 0.65 * girth
    winglet = [((lead, 0.498, top), 0.3 * chord, 0.08), ((lead - 0.045, 0.507, top + 0.06), 0.13 * chord, 0.08)]
    out.add_both_sides("wing", shapes.aerofoil(winglet, _RIGHT), smooth=False)
    _add_tail(out, -0.34 * length, 0.8 * girth, half=0.185, chord=0.115, sweep=0.09, fin=0.175, t=False)


def _body(x: FloatArray, z: FloatArray, wide: FloatArray, tall: FloatArray) -> Solid:
    spine = np.column_stack([x, np.zeros_like(x), z])
    return shapes.sweep(spine, wide, tall, n=20, exponent=2.4, round_ends=True)


def _add_tube(out: Pieces, girth: float, x: FloatArray) -> None:
    """Add the fuselage of a jet along eight places from tail to nose, with its windscreen."""
    wide = girth * np.array([0.18, 0.3, 0.72, 1.0, 1.0, 0.82, 0.5, 0.25])
    z = girth * np.array([0.6, 0.55, 0.25, 0.0, 0.0, -0.05, -0.2, -0.3])
    spine = np.column_stack([x, np.zeros_like(x), z])
    out.add("fuselage", shapes.sweep(spine, wide, n=24, round_ends=True))
    pane = shapes.box((0.5 * girth, 1.1 * girth, 0.35 * girth), 0.1 * girth, corner=0.2 * girth, steps=2)
    out.add("window", shapes.placed(pane, shapes.turn_y(0.5), (float(x[5] + 0.2 * girth), 0.0, 0.6 * girth)))


def _half(
    reach: float,
    lead: float,
    z: float,
    chords: tuple[float, float, float],
    sweep: float,
    dihedral: float,
    thick: float,
) -> Solid:
    """Return the left half of a wing: chords in the middle, at two fifths and at the tip, which is rounded."""
    stations = []
    for share in (0.0, 0.1, 0.4, 0.7, 0.9, 0.97, 1.0):
        chord = float(np.interp(share, [0.0, 0.4, 1.0], chords))
        end = {0.97: 0.9, 1.0: 0.6}.get(share, 1.0)
        x = lead - sweep * share - 0.3 * chord * (1 - end)
        stations.append(((x, reach * share, z + reach * share * math.tan(dihedral)), chord * end, thick))
    return shapes.aerofoil(stations, _UP)


def _add_tail(out: Pieces, x: float, z: float, *, half: float, chord: float, sweep: float, fin: float, t: bool) -> None:
    """Add a fin whose root begins at x, z and a tail plane, on top of the fin if `t`."""
    ends = [((x + 0.03, 0.0, z - 0.01), 1.35 * chord, 0.09), ((x - 1.1 * sweep, 0.0, z + fin), 0.75 * chord, 0.09)]
    out.add("tail", shapes.aerofoil(ends, _RIGHT), smooth=False)
    x_plane, z_plane = (x - sweep - 0.005, z + fin) if t else (x - 0.02, z)
    out.add_both_sides(
        "tail", _half(half, x_plane, z_plane, (chord, 0.8 * chord, 0.5 * chord), sweep, 0.05, 0.09), smooth=False
    )


def _add_engine(out: Pieces, at: tuple[float, float, float], radius: float, length: float) -> None:
    """Add a jet engine to either side: nacelle with the middle of its length at a place, intake and nozzle."""
    r = radius
    shell = shapes.lathe(
        [
            (0.62 * r, -0.5 * length),
            (0.85 * r, -0.2 * length),
            (r, 0.15 * length),
            (0.98 * r, 0.42 * length),
            (0.85 * r, 0.5 * length),
        ],
        20,
    )
    nozzle = shapes.lathe([(0.3 * r, -0.68 * length), (0.55 * r, -0.58 * length), (0.58 * r, -0.45 * length)], 16)
    fan = shapes.cylinder(0.78 * r, 0.45 * length, 0.505 * length, 16)
    for part, solid in (("nacelle", shell), ("exhaust", nozzle), ("intake", fan)):
        out.add_both_sides(part, shapes.placed(solid, _FORWARD, at))


MODEL = aircraft(
    "airplane",
    "An airplane in flight: light aircraft with a propeller, business jet, or airliner with two engines.",
    PARTS,
    DIALS,
    build_airplane,
    parts_for,
    "airplane",
)
