"""Rotors that the drone models share: outrunner motors, still blades, translucent discs for spinning ones.

The caller chooses the unit of length; the drone models use their motor-to-motor diagonal or their wingspan.

A spinning propeller makes 0.5 to 1.5 turns within the time constant of the detector (10 ms), so it appears as a
translucent disc, which is modelled in rings. The opacity of a ring is the share of its circle that the blades cover:
blades * chord / (2 pi r).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from infrablend.assets import shapes
from infrablend.assets.model import ObjectModel, Params, PartRange, Range, part_role
from infrablend.assets.params import Dials
from infrablend.assets.shapes import Solid
from infrablend.core.mesh import FloatArray, IntArray, Mesh, make_mesh

Vector = tuple[float, float, float]
Piece = tuple[str, FloatArray, IntArray, bool]

PROPELLERS = ("still", "spinning")
# Thin parts that stick out, and propellers, whose extent changes with their angle.
OUTSIDE_ORIGIN_BOX = frozenset({"antenna", "propeller"})


def _disc_role(delta_t_k: Range, why: str = "spinning blades") -> PartRange:
    return part_role("plastic", delta_t_k, why, emissivity=(0.85, 0.94), label=False, opacity=0.1)


DISC_PARTS: Mapping[str, PartRange] = {
    "prop_disc_root": _disc_role((0.0, 1.0)),
    "prop_disc_inner": _disc_role((0.0, 2.0)),
    "prop_disc_outer": _disc_role((0.5, 3.0)),
    "prop_disc_tip": _disc_role((1.0, 5.0), "spinning blades: recovery heating at 100 m/s is +4..+5 K"),
}
# Ring -> inner and outer radius as fractions of the propeller's radius.
DISC_RINGS: Mapping[str, tuple[float, float]] = {
    "prop_disc_root": (0.14, 0.3),
    "prop_disc_inner": (0.3, 0.5),
    "prop_disc_outer": (0.5, 0.75),
    "prop_disc_tip": (0.75, 1.0),
}


class Pieces:
    """Collects the pieces of an object in the order they are added."""

    def __init__(self) -> None:
        self.items: list[Piece] = []

    def add(self, part: str, solid: Solid, *, at: Vector | None = None, smooth: bool = True) -> None:
        """Add a solid, shifted by `at`."""
        if at is not None:
            solid = shapes.moved(solid, at)
        self.items.append((part, solid.vertices, solid.triangles, smooth))

    def add_all(self, other: Pieces, rotation: FloatArray, offset: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Add the pieces of another collection, turned by a (3, 3) rotation and then shifted."""
        moved = np.asarray(offset, np.float64)
        self.items += [(part, v @ rotation.T + moved, t, smooth) for part, v, t, smooth in other.items]

    def add_both_sides(self, part: str, solid: Solid, *, smooth: bool = True) -> None:
        """Add a solid and its mirror image across the plane y = 0."""
        self.add(part, solid, smooth=smooth)
        self.add(part, shapes.mirrored(solid, 1), smooth=smooth)


@dataclass(frozen=True)
class Propeller:
    """Shape of a propeller.

    Attributes:
        radius: Radius of the tips.
        blades: Number of blades.
        chord: Factor on the width of the blades.
        spinning: Whether it is drawn as a disc; labels ignore the disc.
    """

    radius: float
    blades: int
    chord: float = 1.0
    spinning: bool = False

    def chord_at(self, t: FloatArray) -> FloatArray:
        """Return the widths of a blade, in radii, at fractions `t` of its radius."""
        wide = np.interp(t, [0.0, 0.12, 0.3, 0.45, 0.8, 1.0], [0.08, 0.11, 0.185, 0.18, 0.125, 0.09])
        wide *= np.sqrt(np.clip(1 - ((t - 0.85) / 0.155).clip(0) ** 2, 0.05, 1))
        wide *= (1.0 if self.blades == 2 else 0.92) * self.chord
        return np.asarray(wide)

    def blade(self, clockwise: bool) -> Solid:
        """Return one blade: narrow at the hub, tapering to a rounded tip, with pitch that falls outwards."""
        R = self.radius
        t = np.array([0.05, 0.12, 0.2, 0.3, 0.45, 0.65, 0.82, 0.92, 0.97, 1.0])
        wide = self.chord_at(t)
        lead = 0.5 * wide + 0.012 - 0.03 * t**2
        pitch = np.arctan2(0.22, 2.4 * np.maximum(t, 0.16)) + np.radians(1.5)
        thick = np.interp(t, [0.0, 0.2, 1.0], [0.035, 0.022, 0.006])
        # Blades bend up slightly under load.
        solid = shapes.blade(R * t, R * wide, R * lead, pitch, R * thick, camber=0.06, clockwise=clockwise)
        solid.vertices[:, 2] += 0.03 * solid.vertices[:, 0] ** 2 / R
        return solid

    def roles_among(self, parts: Mapping[str, PartRange]) -> dict[str, PartRange]:
        """Return an aircraft's roles with those of this propeller's discs, or without discs if it is still."""
        roles = {name: role for name, role in parts.items() if name not in DISC_RINGS}
        if self.spinning:
            for name, (inner, outer) in DISC_RINGS.items():
                t = np.linspace(inner, outer, 21)
                covered = float((self.blades * self.chord_at(t)).sum() / (2 * math.pi * t).sum())
                roles[name] = replace(DISC_PARTS[name], opacity=round(covered, 4))
        return roles


@dataclass(frozen=True, eq=False)
class Rotors:
    """Motors of one aircraft with vertical shafts, each with a propeller.

    Attributes:
        xy: (N, 2) positions of the shafts.
        seat_z: Height of the surface that the motors stand on.
        motor_radius: Radius of a motor's bell.
        motor_height: Height from the seat to the top of the bell.
        propeller: Shape of the propellers; neighbours turn in opposite directions.
        angles_deg: Angle of each propeller, N values.
    """

    xy: FloatArray
    seat_z: float
    motor_radius: float
    motor_height: float
    propeller: Propeller
    angles_deg: tuple[float, ...]

    def add_to(self, out: Pieces) -> None:
        """Add motors, hubs and, unless they spin, blades."""
        r = self.motor_radius
        gap = 0.10 * r
        top = self.motor_height
        # Outrunner: a fixed base with the stator on it, and a bell that turns around the stator, with a spoked top.
        base = shapes.lathe([(0.55 * r, -0.03 * r), (0.98 * r, 0.0), (0.98 * r, 0.08 * r), (0.5 * r, 0.12 * r)], 16)
        stator = shapes.cylinder(0.78 * r, 0.05 * r, top - 0.22 * r, 12)
        wall = shapes.lathe(
            [
                (0.97 * r, 0.08 * r + gap),
                (1.0 * r, 0.12 * r + gap),
                (1.0 * r, top - 0.14 * r),
                (0.9 * r, top),
                (0.76 * r, top),
                (0.85 * r, top - 0.18 * r),
                (0.87 * r, 0.08 * r + gap),
            ],
            20,
            wrap=True,
        )
        spoke = shapes.sweep([(-0.31 * r, 0.0, 0.0), (0.31 * r, 0.0, 0.0)], 0.11 * r, 0.07 * r, n=4)
        cap = shapes.lathe([(0.32 * r, top - 0.16 * r), (0.34 * r, top - 0.02 * r), (0.28 * r, top + 0.03 * r)], 12)
        shaft = shapes.lathe(
            [(0.13 * r, top), (0.13 * r, top + 0.52 * r), (0.09 * r, top + 0.6 * r), (0.0, top + 0.62 * r)], 10
        )
        seat = self.seat_z
        blades = [self.propeller.blade(clockwise) for clockwise in (False, True)]
        hub = shapes.cylinder(0.36 * r, top + 0.02 * r, top + 0.34 * r, 12, 0.06 * r)
        for i, (x, y) in enumerate(self.xy.tolist()):
            at = (x, y, seat)
            out.add("motor", base, at=at)
            out.add("winding", stator, at=at)
            out.add("motor", wall, at=at)
            out.add("motor", cap, at=at)
            turn = float(np.radians(self.angles_deg[i]))
            for k in range(6):
                # The bell has the angle of the propeller: they are screwed together.
                a = turn + k * math.pi / 3
                offset = (x + 0.52 * r * math.cos(a), y + 0.52 * r * math.sin(a), seat + top - 0.08 * r)
                out.add("motor", shapes.placed(spoke, shapes.turn_z(a), offset), smooth=False)
            out.add("motor", shaft, at=at)
            out.add("propeller", hub, at=at)
            if self.propeller.spinning:
                continue
            for k in range(self.propeller.blades):
                a = turn + 2 * math.pi * k / self.propeller.blades
                at_hub = (x, y, seat + top + 0.18 * r)
                out.add("propeller", shapes.placed(blades[i % 2], shapes.turn_z(a), at_hub))

    def discs(self) -> list[FloatArray]:
        """Return the (V, 3) vertices of the disc over each motor for `with_discs`; none if the propellers are still."""
        if not self.propeller.spinning:
            return []
        flat, rise = _rings(self.propeller.radius)
        # The disc is above the hub, like the blades.
        z = self.seat_z + self.motor_height + 0.18 * self.motor_radius + rise
        height = np.broadcast_to(z[:, None, None], (*flat.shape[:2], 1))
        return [np.concatenate([flat + xy, height], axis=2).reshape(-1, 3) for xy in self.xy]


_DISC_SIDES = 48


def _rings(radius: float) -> tuple[FloatArray, FloatArray]:
    """Return (R + 1, N, 2) points of the edges of a disc's rings and the (R + 1,) heights of the edges."""
    rings = list(DISC_RINGS)
    edges = np.array([DISC_RINGS[rings[0]][0], *(DISC_RINGS[name][1] for name in rings)])
    turn = np.arange(_DISC_SIDES) * (2 * math.pi / _DISC_SIDES)
    around = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    # The disc is bent up slightly, like the blades.
    return radius * edges[:, None, None] * around, 0.03 * radius * edges**2


def with_discs(mesh: Mesh, discs: Sequence[FloatArray]) -> Mesh:
    """Return the mesh with discs added; neighbouring rings share vertices, so that shading is continuous."""
    if not discs:
        return mesh
    rings = list(DISC_RINGS)
    n = _DISC_SIDES
    i, j = (g.ravel() for g in np.meshgrid(np.arange(len(rings)), np.arange(n), indexing="ij"))
    a, b = i * n + j, i * n + (j + 1) % n
    sheet = np.concatenate([np.stack([a, a + n, b], 1), np.stack([b, a + n, b + n], 1)])
    part = np.concatenate([i, i]) + len(mesh.part_names)
    vertices = [mesh.vertices_m]
    triangles = [mesh.triangles]
    for k, points in enumerate(discs):
        vertices.append(points)
        triangles.append(sheet + len(mesh.vertices_m) + k * (len(rings) + 1) * n)
    return Mesh(
        np.concatenate(vertices),
        np.concatenate(triangles).astype(np.int32),
        np.concatenate([mesh.part_of_triangle, np.tile(part, len(discs))]).astype(np.int32),
        (*mesh.part_names, *rings),
        np.concatenate([mesh.smooth, np.ones(len(discs) * len(sheet), np.bool_)]),
        mesh.closed_parts,
    )


def assembled(pieces: Pieces, discs: Sequence[FloatArray], *, attitude: FloatArray, size: float) -> Mesh:
    """Return the mesh of an aircraft; its origin is the centre of its bounding box, see `OUTSIDE_ORIGIN_BOX`.

    `discs` are the vertices of the discs of spinning propellers, level as the pieces; `attitude` turns both to that in
    flight.
    """
    turned = Pieces()
    turned.add_all(pieces, attitude)
    counted = np.concatenate([v for part, v, _, _ in turned.items if part not in OUTSIDE_ORIGIN_BOX])
    centre = (counted.min(axis=0) + counted.max(axis=0)) / 2
    mesh = make_mesh([(part, (v - centre) * size, t, smooth) for part, v, t, smooth in turned.items], closed=True)
    return with_discs(mesh, [(d @ attitude.T - centre) * size for d in discs])


def multirotor(
    name: str,
    description: str,
    parts: Mapping[str, PartRange],
    dials: Dials,
    rotors: Callable[[Params], Rotors],
    pieces: Callable[[Params], Pieces],
) -> ObjectModel:
    """Return the model of an aircraft that leans forward by `lean_deg`.

    Its dials have `size_m` and `lean_deg`; `pieces` returns the closed solids of the level aircraft, for a diagonal of
    1.
    """

    def roles(params: Params) -> dict[str, PartRange]:
        return rotors(params).propeller.roles_among(parts)

    def build(params: Params) -> Mesh:
        dials.require(params)
        lean = shapes.turn_y(math.radians(float(params["lean_deg"])))
        return assembled(pieces(params), rotors(params).discs(), attitude=lean, size=float(params["size_m"]))

    return aircraft(name, description, parts, dials, build, roles)


def aircraft(
    name: str,
    description: str,
    parts: Mapping[str, PartRange],
    dials: Dials,
    build: Callable[[Params], Mesh],
    roles: Callable[[Params], Mapping[str, PartRange]],
    category: str = "drone",
) -> ObjectModel:
    """Return the model of an aircraft."""
    return ObjectModel(
        name=name,
        category=category,
        description=description,
        origin="the centre of its bounding box without propellers and antennas",
        stands=False,
        parts=parts,
        sample=dials.sample,
        build=build,
        options=dials.options,
        parts_for=roles,
    )
