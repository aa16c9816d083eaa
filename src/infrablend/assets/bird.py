"""Bird model in flight, from songbird to eagle: flapping or soaring, with wings that bend at the wrist.

All lengths are for stretched wings of span 1 and are scaled at the end. +X is the heading, +Y points left, +Z up.
Outlines follow silhouettes of starling, feral pigeon, carrion crow, herring gull, buzzard and greylag goose.
Plumage insulates, so a bird in flight is a few kelvin above the air. Temperatures: docs/explanation/models.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from infrablend.assets import shapes
from infrablend.assets.model import Params, PartRange, part_role
from infrablend.assets.params import Choice, Dials, Number
from infrablend.assets.rotors import Pieces, aircraft, assembled
from infrablend.assets.shapes import Solid
from infrablend.core.mesh import Mesh

PARTS: Mapping[str, PartRange] = {
    "body": part_role("fur", (2.5, 5.0), "thick plumage of breast, back and neck"),
    "head": part_role("fur", (4.5, 7.5), "thin plumage, eyes; +6.0 K measured on starlings in flight"),
    "bill": part_role("antler", (1.5, 6.0), "horn over blood vessels (estimate)"),
    "wing": part_role("fur", (1.5, 3.5), "flight feathers; +2.2 to +2.5 K measured"),
    "underwing": part_role("fur", (4.0, 6.5), "thin plumage below the wing beside the body; +5.3 K measured"),
    "tail": part_role("fur", (0.5, 2.5), "feathers alone, colder than the wings (estimate)"),
    "leg": part_role("skin", (4.0, 9.0), "bare legs, folded below the tail; +6.8 K measured"),
}


@dataclass(frozen=True)
class _Kind:
    """Outline of one kind of bird, for stretched wings of span 1.

    Attributes:
        span: (low, high) wingspan, metres.
        length: Length from the bill to the root of the tail.
        girth: Half width of the body.
        neck: Share of the length in front of the shoulders.
        chords: Chord at shoulder, wrist, middle of the hand, and near the tip.
        forward: Distance of the wrist's leading edge in front of the shoulder's.
        back: Distance of the tip's leading edge behind the wrist's.
        tail: Length and half width of the tail's end.
        soar_deg: Rise of arm and of hand while soaring.
    """

    span: tuple[float, float]
    length: float
    girth: float
    neck: float
    chords: tuple[float, float, float, float]
    forward: float
    back: float
    tail: tuple[float, float]
    soar_deg: tuple[float, float]


_KINDS: Mapping[str, _Kind] = {
    "songbird": _Kind((0.3, 0.42), 0.45, 0.075, 0.36, (0.23, 0.22, 0.17, 0.06), 0.03, 0.15, (0.17, 0.06), (2, -4)),
    "pigeon": _Kind((0.6, 0.72), 0.40, 0.072, 0.36, (0.21, 0.19, 0.15, 0.05), 0.05, 0.16, (0.17, 0.08), (8, 4)),
    "crow": _Kind((0.85, 1.05), 0.35, 0.058, 0.38, (0.20, 0.20, 0.18, 0.11), 0.03, 0.05, (0.19, 0.08), (6, 6)),
    "gull": _Kind((0.95, 1.5), 0.30, 0.044, 0.38, (0.135, 0.13, 0.095, 0.03), 0.06, 0.13, (0.10, 0.05), (12, -8)),
    "raptor": _Kind((1.0, 2.2), 0.27, 0.048, 0.30, (0.19, 0.205, 0.19, 0.14), 0.035, 0.03, (0.17, 0.10), (5, 8)),
    "goose": _Kind((1.2, 1.8), 0.44, 0.058, 0.52, (0.155, 0.145, 0.11, 0.04), 0.04, 0.09, (0.07, 0.045), (4, -2)),
}
DIALS = Dials(
    "bird",
    {
        "kind": Choice(tuple(_KINDS), (0.2, 0.2, 0.15, 0.2, 0.15, 0.1)),
        "size_m": Number((0.3, 2.2), (0.15, 3.5), log=True, by="kind", ranges={k: v.span for k, v in _KINDS.items()}),
        "flight": Choice(("flapping", "soaring"), (0.65, 0.35)),
        "phase_deg": Number((0.0, 360.0), (-3600.0, 3600.0)),
        "flap_deg": Number((20.0, 50.0), (0.0, 65.0)),
        "girth": Number((0.9, 1.15), (0.7, 1.4)),
        "chord": Number((0.9, 1.12), (0.7, 1.4)),
        "tail_spread": Number((0.6, 1.4), (0.3, 2.0)),
        "climb_deg": Number((-10.0, 15.0), (-60.0, 60.0)),
        "bank_deg": Number((-35.0, 35.0), (-80.0, 80.0)),
    },
)
# Parameter of an animated bird: the centre of its box would bob with the wings.
_IN_BODY = "origin_in_body"


def build_bird(params: Params) -> Mesh:
    """Build the mesh of one bird: origin at the centre of its bounding box, or of that of its body in an animation."""
    params = dict(params)
    flying = bool(params.pop(_IN_BODY, False))
    DIALS.require(params)
    attitude = shapes.attitude(float(params["climb_deg"]), float(params["bank_deg"]))
    mesh = assembled(build_pieces(params), (), attitude=attitude, size=float(params["size_m"]))
    if not flying:
        return mesh
    body = mesh.vertices_m[mesh.triangles[mesh.part_of_triangle == mesh.part_names.index("body")]]
    middle = 0.5 * (body.min(axis=(0, 1)) + body.max(axis=(0, 1)))
    return replace(mesh, vertices_m=mesh.vertices_m - middle)


def animate(params: Params, phase: float) -> Params:
    """Return the parameters of a bird at a phase of its beat: 0 is the top. Its body stays where it is."""
    beat = {"phase_deg": 360.0 * (phase % 1.0)} if params["flight"] == "flapping" else {}
    return {**params, **beat, _IN_BODY: True}


def cycle_hz(params: Params) -> float:
    """Return the wing beats per second: large birds are slower, geese fast for their size; 0 for soaring ones."""
    if params["flight"] == "soaring":
        return 0.0
    return (6.0 if params["kind"] == "goose" else 4.0) / float(params["size_m"])


def build_pieces(p: Params) -> Pieces:
    """Return the closed solids of one bird in level flight, for stretched wings of span 1."""
    kind = _KINDS[p["kind"]]
    out = Pieces()
    girth = kind.girth * float(p["girth"])
    front, rear = kind.neck * kind.length, (kind.neck - 1) * kind.length
    neck = max(front - 1.1 * girth, 0.0)  # from the shoulders to the head; short necks are hidden in the plumage
    slim = 0.62 if kind.neck < 0.5 else 0.4
    x = np.array([rear - 0.02, 0.8 * rear, 0.45 * rear, 0.05 * rear, 0.35 * neck, 0.8 * neck, neck + 0.3 * girth])
    z = girth * np.array([0.15, 0.05, -0.05, -0.1, 0.0, 0.15, 0.2])
    wide = girth * np.array([0.4, 0.68, 0.92, 1.0, 0.85, slim, slim])
    out.add("body", shapes.sweep(np.column_stack([x, 0 * x, z]), wide, n=20, round_ends=True))
    skull = shapes.ellipsoid((0.85 * girth, 0.58 * girth, 0.58 * girth), 16, 10)
    out.add("head", skull, at=(neck + 0.5 * girth, 0.0, 0.25 * girth))
    tip = (front + 0.45 * girth, 0.0, 0.1 * girth)
    out.add("bill", shapes.capsule((front, 0.0, 0.2 * girth), tip, 0.17 * girth, 0.06 * girth, n=10))
    _add_tail(out, kind, rear, float(p["tail_spread"]))
    for y in (-0.3 * girth, 0.3 * girth):
        foot = (rear - 0.25 * kind.tail[0], y, -0.25 * girth)
        out.add("leg", shapes.capsule((0.65 * rear, y, -0.6 * girth), foot, 0.12 * girth, 0.09 * girth, n=8))
    out.add_both_sides("wing", _wing(kind, p))
    out.add_both_sides("underwing", _wing(kind, p, lining=True))
    return out


def _add_tail(out: Pieces, kind: _Kind, rear: float, spread: float) -> None:
    """Add a fan of feathers."""
    length = kind.tail[0]
    half = kind.tail[1] * spread
    share = np.array([-1.0, -0.7, -0.35, 0.0, 0.35, 0.7, 1.0])
    end = rear - length * (1 - 0.12 * np.abs(share) ** 2)
    root = np.array([0.3 * half, 0.22 * kind.girth]).min()
    outline = np.concatenate([[(rear + 0.04, root), (rear + 0.04, -root)], np.column_stack([end, half * share])])
    # Counter-clockwise from the left side of the root.
    outline = np.concatenate([outline[:1], outline[:1:-1], outline[1:2]])
    out.add("tail", shapes.plate(outline, -0.003, 0.003), smooth=False)


# Stations of a wing from the shoulder: share of the half span. The arm ends and the hand begins at the wrist.
_ALONG = np.array([0.0, 0.12, 0.25, 0.36, 0.42, 0.48, 0.60, 0.72, 0.84, 0.93, 0.98, 1.0])
_WRIST = 0.42
# The thin plumage below the wing reaches that far.
_LINING = 5


def _wing(kind: _Kind, p: Params, *, lining: bool = False) -> Solid:
    """Return the left wing, bent by its flap, or the thin plumage of the arm's lower side."""
    s = _ALONG
    lead = np.interp(s, [0, 0.36, _WRIST, 0.6, 1], np.array([0, 0.9, 1, 0.95, 0]) * kind.forward)
    lead -= kind.back * np.clip((s - _WRIST) / (1 - _WRIST), 0, 1) ** 1.5
    chord = np.interp(s, [0, _WRIST, 0.72, 0.95], kind.chords) * float(p["chord"])
    chord *= np.interp(s, [0.93, 0.98, 1], [1, 0.8, 0.35])
    arm, hand, fold = _flap(kind, p)
    # In the upstroke the hand swings back around the wrist.
    out = np.clip(s - _WRIST, 0, None) / 2
    y, x = np.minimum(s, _WRIST) / 2 + out * math.cos(fold), lead - out * math.sin(fold)
    rise = np.interp(s, [0.36, 0.5], [arm, hand])
    step = np.diff(y, prepend=0.0)
    y, z = np.cumsum(step * np.cos(rise)), np.cumsum(step * np.sin(rise))
    up = np.stack([0 * rise, -np.sin(rise), np.cos(rise)], axis=1)
    root = 0.35 * chord[0]
    places = np.stack([x + root, y, z + 0.3 * kind.girth], axis=1)
    thick = np.interp(s, [0, _WRIST, 1], [0.10, 0.07, 0.045])
    if lining:
        places = places + np.stack([-0.12 * chord, 0 * y, 0 * y], axis=1) - 0.012 * up
        places = places[:_LINING]
        chord = 0.6 * chord[:_LINING]
        up = up[:_LINING]
    stations = [((a, b, c), float(d), float(t)) for (a, b, c), d, t in zip(places.tolist(), chord, thick, strict=False)]
    return shapes.aerofoil(stations, up)


def _flap(kind: _Kind, p: Params) -> tuple[float, float, float]:
    """Return the rise of the arm, that of the hand, which lags, and the angle by which the hand is swept back."""
    arm, hand = (math.radians(a) for a in kind.soar_deg)
    if p["flight"] == "soaring":
        return arm, hand, 0.0
    phase = math.radians(float(p["phase_deg"]))
    flap = math.radians(float(p["flap_deg"]))
    fold = 1.1 * flap * max(0.0, -math.sin(phase))
    return arm + flap * math.cos(phase), hand + 1.25 * flap * math.cos(phase - 0.7), fold


def parts_for(params: Params) -> Mapping[str, PartRange]:
    """Return the thermal role of every part."""
    return PARTS


MODEL = aircraft(
    "bird",
    "A bird in flight, flapping or soaring: songbird, pigeon, crow, gull, raptor or goose.",
    PARTS,
    DIALS,
    build_bird,
    parts_for,
    "bird",
)
MODEL = replace(MODEL, animate=animate, cycle_hz=cycle_hz, skin_limit_c=40.0)
