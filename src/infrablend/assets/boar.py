"""Wild boar model, grown from a skeleton: six poses, from piglets to tuskers, with a mane of bristles.

The body is an implicit surface (`assets.implicit`): trunk, mane, haunches and upper legs form one skin; head and lower
legs are on finer grids; ears and tusks are lofts. All lengths are in units of the height at the withers, +X towards the
snout, +Y left, +Z up; `build` scales them to metres at the end. Seen from above a boar is a wedge: broad and highest at
the shoulders, a head of a third of the body's length that tapers to the snout, and hardly a neck.

The implicit surface depends only on pose, pose variant and build, so there are few distinct ones, which are cached;
size, proportions, the bend of the spine and mirroring are applied to the vertices afterwards.

Proportions follow photographs of European wild boar (*Sus scrofa*): head and body 1.7 to 1.8 times the shoulder height,
legs less than half of it, the back falling towards the rump. Shoulder heights: piglets 0.2 to 0.42 m, yearlings 0.5 to
0.65 m, sows 0.65 to 0.8 m, tuskers up to 0.95 m.

Temperatures: docs/explanation/models.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from infrablend.assets import warm_ground
from infrablend.assets.anatomy import (
    Gait,
    Leg,
    Piece,
    feet_centre,
    finished,
    joined,
    leg_joint,
    mirrored,
    roles_of_coat,
    skin,
    smoothstep,
    unit,
    withers_height,
)
from infrablend.assets.implicit import Body, Primitive, Tube, ellipsoid, tube
from infrablend.assets.model import MOMENTS, TIMES, ObjectModel, Params, PartRange, moment, part_role
from infrablend.assets.params import Checks, Choice, Dials, Number
from infrablend.assets.shapes import loft, sweep
from infrablend.core.mesh import FloatArray, IntArray, Mesh

# Pose -> its variants; each pair is one shape of the body.
VARIANTS: Mapping[str, tuple[str, ...]] = {
    "standing": ("square", "alert"),
    "walking": ("left-fore", "right-fore"),
    "rooting": ("ground", "step"),
    "lying": ("resting",),
    "running": ("left-trot", "right-trot"),
    "sleeping": ("curled", "on-side"),
}
POSES = tuple(VARIANTS)
DRAWN_POSES = POSES[:4]
BUILDS = ("yearling", "sow", "tusker", "piglet")
DRAWN_BUILDS = BUILDS[:3]

# Surface minus air. The winter coat of a boar has long bristles over dense underfur, thickest along the spine; the
# underside, the inside of the legs and the face are thinly covered.
PARTS: Mapping[str, PartRange] = {
    "mane": part_role("fur", (2.5, 6.0), "bristles along the spine, coldest part of the coat"),
    "back": part_role("fur", (4.0, 7.5), "top of the trunk, thickest coat"),
    "flank": part_role("fur", (5.0, 9.0), "sides of the trunk"),
    "belly": part_role("fur", (7.0, 12.0), "underside and groin, thin coat"),
    "neck": part_role("fur", (5.0, 9.0), "trunk to head"),
    "shoulder": part_role("fur", (5.0, 9.0), "shoulder to elbow; tuskers carry a shield of thick skin"),
    "haunch": part_role("fur", (5.0, 9.0), "thigh, between flank and leg"),
    "head": part_role("fur", (6.5, 11.0), "cheeks and forehead"),
    "snout": part_role("fur", (8.0, 14.0), "thinly covered snout"),
    "nose": part_role("skin", (10.0, 18.0), "bare disc of the nose", emissivity=(0.97, 0.98)),
    "eye": part_role("eye", (12.0, 19.0), "hottest spot"),
    "ear": part_role("fur", (6.0, 12.0), "thin, well supplied with blood"),
    "upper_leg": part_role("fur", (5.0, 9.0), "forearm and gaskin"),
    "lower_leg": part_role("fur", (3.0, 7.0), "below knee and hock"),
    "hoof": part_role("antler", (0.5, 2.5), "horn, touches the ground"),
    "tail": part_role("fur", (3.0, 6.0), "thin, with a tuft"),
    "tusk": part_role("antler", (0.5, 3.0), "tooth in the open"),
}
PART_NAMES = tuple(PARTS)
# Rise of the back in the sun, and the share of it that parts reach that face less of the sky (est., as for the deer).
SUN_K = (5.0, 20.0)
_SUN_SHARE: Mapping[str, float] = {
    "mane": 1.0, "back": 1.0, "flank": 0.7, "belly": 0.1, "neck": 0.9, "shoulder": 0.7, "haunch": 0.7, "head": 0.8,
    "snout": 0.6, "ear": 0.7, "upper_leg": 0.4, "lower_leg": 0.3, "hoof": 0.1, "tail": 0.6, "tusk": 0.3,
}  # fmt: skip

# Shoulder heights that are drawn for each build.
HEIGHTS_M: Mapping[str, tuple[float, float]] = {
    "yearling": (0.50, 0.65),
    "sow": (0.62, 0.80),
    "tusker": (0.72, 0.95),
    "piglet": (0.20, 0.42),
}
_DRAWN_M = (0.5, 0.95)
DIALS = Dials(
    "boar",
    {
        "pose": Choice(POSES, (0.32, 0.30, 0.26, 0.12, 0.0, 0.0), "by default " + ", ".join(DRAWN_POSES)),
        "variant": Choice((1, 2), (0.5, 0.5), "variant of the pose"),
        "build": Choice(BUILDS, (0.35, 0.40, 0.25, 0.0), "by default " + ", ".join(DRAWN_BUILDS)),
        "shoulder_height_m": Number(_DRAWN_M, (0.2, 1.3)),
        "length_factor": Number((0.94, 1.06), (0.8, 1.25)),
        "width_factor": Number((0.93, 1.09), (0.8, 1.25)),
        "bend_rad": Number((-0.4, 0.4), (-0.8, 0.8)),
        "head_turn_rad": Number((-0.4, 0.4), (-0.8, 0.8)),
        "mirror": Choice((False, True), (0.5, 0.5)),
        "time_of_day": Choice(
            TIMES, (1.0, 0.0, 0.0, 0.0), "by day the sun warms the coat; by default that of the background"
        ),
    },
)
OPTIONS: Mapping[str, str] = DIALS.options | {
    "shoulder_height_m": "a number or [low, high]; by default "
    + ", ".join(f"[{low:g}, {high:g}] for a {build}" for build, (low, high) in HEIGHTS_M.items()),
    warm_ground.PARAM: warm_ground.OPTION,
}


def parts_for(params: Params) -> Mapping[str, PartRange]:
    """Return the thermal role of every part; by day the sun warms the coat."""
    return {**roles_of_coat(params, PARTS, SUN_K, _SUN_SHARE), **warm_ground.roles(params)}


BODY_CELL = 0.0235
HEAD_CELL = 0.0135
LEG_CELL = 0.0145

# Sections of the trunk of a standing boar: x, top, bottom, half width.
_TRUNK = np.array(
    [
        [-0.655, 0.785, 0.640, 0.045],
        [-0.600, 0.845, 0.550, 0.100],
        [-0.470, 0.895, 0.475, 0.142],
        [-0.290, 0.922, 0.440, 0.164],
        [-0.090, 0.940, 0.415, 0.180],
        [0.090, 0.965, 0.388, 0.194],
        [0.240, 0.985, 0.370, 0.200],
        [0.370, 0.970, 0.390, 0.186],
        [0.480, 0.930, 0.460, 0.158],
    ]
)
_WITHERS_X = 0.24
Point = tuple[float, float, float]


@dataclass(frozen=True)
class _Pose:
    """Free parameters of the skeleton in one pose.

    Attributes:
        legs: Left fore, right fore, left hind and right hind leg.
        poll: Top of the head, where the ears are, relative to the withers' height.
        head: Direction of the head from poll to snout.
        drop: Distance by which the trunk is lowered.
        tilt: Further distance by which the withers are lowered.
        lying: Whether the trunk is on the ground, with the legs folded.
        middle_x: x of the model's origin; None for the middle between the feet.
        bend_rad, head_turn_rad: Bend of the spine and turn of the head to the left.
        on_side: Whether it lies on its right side, with stretched legs.
    """

    legs: tuple[Leg, Leg, Leg, Leg]
    poll: Point
    head: Point
    drop: float = 0.0
    tilt: float = 0.0
    lying: bool = False
    middle_x: float | None = None
    bend_rad: float = 0.0
    head_turn_rad: float = 0.0
    on_side: bool = False

    @property
    def moves(self) -> bool:
        """Whether it is a moment of a gait, whose legs swing so far that only bones of fixed length look right."""
        return self.middle_x is not None


_STILL = Leg()
_POSES: Mapping[tuple[str, str], _Pose] = {
    ("standing", "square"): _Pose((_STILL, Leg(-0.02), Leg(0.02), Leg(-0.02)), (0.650, 0, 0.735), (0.87, 0, -0.49)),
    ("standing", "alert"): _Pose((Leg(0.02), Leg(-0.03), Leg(-0.05), Leg(0.02)), (0.655, 0, 0.800), (0.965, 0, -0.26)),
    ("walking", "left-fore"): _Pose(
        (Leg(0.14), Leg(-0.12), Leg(-0.14), Leg(0.07, 0.06, 0.8)), (0.655, 0, 0.690), (0.84, 0, -0.54), 0.012
    ),
    ("walking", "right-fore"): _Pose(
        (Leg(-0.13), Leg(0.06, 0.08, 1.0), Leg(0.10), Leg(-0.16)), (0.655, 0, 0.715), (0.87, 0, -0.49), 0.012
    ),
    ("rooting", "ground"): _Pose(
        (Leg(0.07), Leg(-0.07), Leg(0.02), Leg(-0.06)), (0.620, 0, 0.510), (0.70, 0, -0.714), 0.015, 0.045
    ),
    ("rooting", "step"): _Pose(
        (Leg(0.13), Leg(-0.11), Leg(-0.10), Leg(0.05)), (0.630, 0, 0.480), (0.80, 0, -0.600), 0.015, 0.060
    ),
    ("lying", "resting"): _Pose((_STILL,) * 4, (0.640, 0, 0.700), (0.92, 0, -0.39), 0.395, lying=True),
    ("sleeping", "curled"): _Pose(
        (_STILL,) * 4, (0.630, 0, 0.575), (0.995, 0, -0.10), 0.395, lying=True, bend_rad=1.05, head_turn_rad=0.70
    ),
    ("sleeping", "on-side"): _Pose(
        (Leg(0.08), Leg(0.02), Leg(-0.04), Leg(0.03)), (0.640, 0, 0.710), (0.94, 0, -0.34), on_side=True
    ),
}
_GAITS: Mapping[str, Gait] = {
    "walking": Gait(0.70, 0.64, (0.25, 0.75, 0.0, 0.5), 0.08),
    "running": Gait(1.25, 0.42, (0.0, 0.5, 0.5, 0.0), 0.12),  # a trot: diagonal legs together
}
# Head and lowered trunk of an animal in motion.
_MOVING: Mapping[str, _Pose] = {
    "walking": _Pose((_STILL,) * 4, (0.655, 0, 0.700), (0.86, 0, -0.51), 0.014, middle_x=-0.09),
    "running": _Pose((_STILL,) * 4, (0.660, 0, 0.770), (0.93, 0, -0.37), 0.022, middle_x=-0.09),
}


def _skeleton(params: Params) -> _Pose:
    """Return the skeleton of a variant, or that of a moving boar at its phase."""
    pose = params["pose"]
    phase = params.get("phase")
    variants = VARIANTS[params["pose"]]
    number = min(params["variant"], len(variants)) - 1
    if pose == "running" and phase is None:
        phase = 0.5 * number
    if phase is None:
        return _POSES[pose, variants[number]]
    return replace(_MOVING[pose], legs=_GAITS[pose].legs(phase))


def _trunk(pose: _Pose, lying: bool, girth: float) -> Tube:
    x, top, bottom, half = _TRUNK.T.copy()
    half = half * girth
    if lying:
        top = top - pose.drop
        bottom = np.maximum(bottom - pose.drop - 0.03, -0.02)
        half = half * 1.06
    else:
        fall = pose.drop + pose.tilt * smoothstep((x + 0.5) / 0.8)
        # A lean animal has less belly, not a lower back.
        top, bottom = top - fall, bottom - fall + (1 - girth) * 0.25 * (top - bottom)
    path = np.column_stack([x, np.zeros_like(x), 0.5 * (top + bottom)])
    return tube("flank", path, half, 0.5 * (top - bottom), caps=(0.03, 0.06), steps=2)


def _mane(trunk: Tube, neck: Tube, height: float) -> Tube:
    """Return the crest of bristles from the forehead along the neck and the spine to the loins."""
    x = np.linspace(-0.22, 0.38, 7)
    top = np.interp(x, trunk.path[:, 0], trunk.path[:, 2] + trunk.half_height)
    spine = np.column_stack([x, np.zeros_like(x), top - 0.012])
    behind_ears = neck.path[4:9:2] + np.column_stack(
        [0.25 * neck.half_height[4:9:2], np.zeros(3), 0.95 * neck.half_height[4:9:2]]
    )
    path = np.concatenate([spine, behind_ears])
    rise = height * np.array([0.2, 0.5, 0.8, 1.0, 1.0, 1.0, 1.0, 1.0, 0.9, 0.7])
    return tube("mane", path, 0.034, 0.022 + rise, blend=0.03, caps=(0.08, 0.05))


def _neck(poll: FloatArray, f: FloatArray, pose: _Pose, lying: bool, girth: float) -> Tube:
    fall = pose.drop if lying else pose.drop + pose.tilt
    start = np.array([0.30, 0.0, 0.715 - fall])
    middle = 0.5 * (start + poll) + [0.02, 0.0, 0.0]
    path = [start, middle, poll - 0.02 * f, poll + 0.08 * f]
    return tube(
        "neck", path, np.array([0.180, 0.162, 0.132, 0.108]) * girth, [0.250, 0.220, 0.165, 0.130], blend=0.09, steps=3
    )


def _head(poll: FloatArray, axes: tuple[FloatArray, ...], big: float, sturdy: float, long: float) -> list[Primitive]:
    f, s, u = axes

    def at(forward: float, up: float, left: float = 0.0) -> FloatArray:
        if forward > 0.16:
            forward -= (1.0 - long) * (forward - 0.16)
        return np.asarray(poll + big * (forward * f + up * u + left * s))

    skull = tube(
        "head",
        [at(-0.06, -0.02), at(0.06, -0.012), at(0.16, -0.022), at(0.25, -0.032)],
        np.array([0.112, 0.120, 0.100, 0.070]) * big * sturdy,
        np.array([0.145, 0.135, 0.108, 0.080]) * big,
        side=s,
        steps=2,
    )
    snout = tube(
        "snout",
        [at(0.22, -0.028), at(0.32, -0.040), at(0.42, -0.050), at(0.505, -0.058)],
        np.array([0.072, 0.056, 0.047, 0.048]) * big,
        np.array([0.085, 0.066, 0.052, 0.050]) * big,
        side=s,
        blend=0.03,
        caps=(0.03, 0.012),
        steps=2,
    )
    jaw = tube(
        "head",
        [at(0.06, -0.090), at(0.18, -0.098), at(0.36, -0.090)],
        np.array([0.075, 0.055, 0.03]) * big,
        side=s,
        blend=0.04,
    )
    cheeks = [
        ellipsoid("head", at(0.07, -0.060, 0.075 * e), np.array([0.08, 0.05, 0.075]) * big, axes=[f, s, u], blend=0.04)
        for e in (1, -1)
    ]
    disc = ellipsoid("nose", at(0.518, -0.058), np.array([0.014, 0.047, 0.050]) * big, axes=[f, s, u], blend=0.006)
    eyes = [
        ellipsoid(
            "eye",
            at(0.150, 0.040, 0.075 * sturdy * e),
            np.array([0.020, 0.014, 0.016]) * big,
            axes=[f, s, u],
            blend=0.004,
        )
        for e in (1, -1)
    ]
    return [skull, *cheeks, jaw, snout, disc, *eyes]


def _foot(fetlock: FloatArray, hang: float, lying: bool) -> list[Primitive]:
    angle = np.deg2rad(-150.0 if lying else -66.0 - 70.0 * hang)
    coronet = fetlock + 0.052 * np.array([np.cos(angle), 0.0, np.sin(angle)])
    sole = np.deg2rad(-170.0 if lying else -32.0 - 75.0 * hang)
    toe = coronet + 0.055 * np.array([np.cos(sole), 0.0, np.sin(sole)])
    heel = coronet + 0.2 * (toe - coronet)
    toes: list[Primitive] = [
        tube(
            "hoof",
            [heel + np.array([0, 0.012 * e, 0]), toe + np.array([0, 0.016 * e, 0])],
            [0.021, 0.013],
            [0.028, 0.014],
            blend=0.006 if e < 0 else 0.010,
        )
        for e in (1, -1)
    ]
    pastern = tube("lower_leg", [fetlock, coronet], [0.027, 0.028], [0.030, 0.030], blend=0.01)
    return [pastern, *toes]


def _fore_leg(pose: _Pose, leg: Leg, sign: int, lying: bool) -> tuple[list[Primitive], list[Primitive]]:
    """Return the upper part (in the skin of the body) and the lower part (on the finer grid) of a foreleg."""
    y = 0.118 * sign
    fall = pose.drop + pose.tilt
    blade = np.array([0.24, 0.110 * sign, 0.80 - fall])
    if lying:
        shoulder = np.array([0.34, 0.138 * sign, 0.23])
        elbow = np.array([0.24, 0.140 * sign, 0.11])
        knee = np.array([0.43, 0.140 * sign, 0.060])
        fetlock = np.array([0.26, 0.150 * sign, 0.038])
    else:
        shoulder = np.array([0.35 + 0.15 * leg.dx, 0.125 * sign, 0.62 - fall])
        elbow = np.array([0.235 + (0.6 if pose.moves else 0.35) * leg.dx, 0.140 * sign, 0.475 - fall])
        fetlock = np.array([0.262 + leg.dx - 0.05 * leg.hang, y, 0.092 + leg.dz])
        knee = 0.47 * elbow + 0.53 * fetlock + np.array([0.026 + 0.05 * leg.hang, 0.0, 0.012])
        if pose.moves:
            knee = leg_joint(elbow, fetlock, (0.195, 0.193), 1.0)
        knee[1] = y
    upper: list[Primitive] = [
        tube("shoulder", [blade, shoulder], [0.075, 0.070], [0.120, 0.110], blend=0.08),
        tube("shoulder", [shoulder, elbow], [0.065, 0.060], [0.095, 0.085], blend=0.07),
        tube(
            "upper_leg", [elbow, 0.5 * (elbow + knee), knee], [0.066, 0.054, 0.040], [0.086, 0.066, 0.046], blend=0.05
        ),
    ]
    cannon = fetlock - knee
    lower: list[Primitive] = [
        tube(
            "upper_leg",
            [knee - 0.3 * (knee - elbow), knee, knee + 0.5 * cannon, fetlock],
            [0.036, 0.039, 0.032, 0.033],
            [0.041, 0.046, 0.036, 0.037],
            beyond=[(1.2, "lower_leg")],
        )
    ]
    return upper, lower + _foot(fetlock, leg.hang, lying)


def _hind_leg(pose: _Pose, leg: Leg, sign: int, lying: bool) -> tuple[list[Primitive], list[Primitive]]:
    """Return the upper part (in the skin of the body) and the lower part (on the finer grid) of a hind leg."""
    y = 0.105 * sign
    if lying:
        hip = np.array([-0.44, 0.085 * sign, 0.29])
        stifle = np.array([-0.24, 0.145 * sign, 0.16])
        hock = np.array([-0.50, 0.160 * sign, 0.055])
        fetlock = np.array([-0.30, 0.175 * sign, 0.038])
    else:
        hip = np.array([-0.46, 0.085 * sign, 0.73 - pose.drop])
        stifle = np.array([-0.375 + 0.4 * leg.dx, 0.118 * sign, 0.505 - 0.9 * pose.drop + 0.3 * leg.dz])
        fetlock = np.array([-0.505 + leg.dx, y, 0.092 + leg.dz])
        hock = np.array([-0.560 + 0.85 * leg.dx - 0.03 * leg.hang, y, 0.270 + 0.9 * leg.dz])
        if pose.moves:
            hock = leg_joint(stifle, fetlock, (0.299, 0.186), -1.0)
            hock[1] = y
    blend = 0.12 if lying else 0.08
    upper: list[Primitive] = [
        tube("haunch", [hip, stifle], [0.080, 0.066], [0.155, 0.115], blend=blend),
        tube(
            "upper_leg",
            [stifle, 0.5 * (stifle + hock), hock],
            [0.064, 0.052, 0.036],
            [0.098, 0.070, 0.048],
            blend=0.06,
        ),
    ]
    cannon = fetlock - hock
    lower: list[Primitive] = [
        tube(
            "upper_leg",
            [hock - 0.3 * (hock - stifle), hock, hock + 0.4 * cannon, fetlock],
            [0.033, 0.037, 0.031, 0.033],
            [0.043, 0.052, 0.039, 0.037],
            beyond=[(1.2, "lower_leg")],
        )
    ]
    return upper, lower + _foot(fetlock, leg.hang, lying)


def _tail(drop: float) -> Tube:
    path = np.array([[-0.63, 0, 0.775], [-0.690, 0, 0.70], [-0.705, 0, 0.58], [-0.700, 0, 0.47]]) - [0.0, 0.0, drop]
    return tube("tail", path, [0.020, 0.017, 0.016, 0.022], blend=0.02, steps=2)


def _ear(poll: FloatArray, axes: tuple[FloatArray, ...], big: float, sign: int) -> tuple[FloatArray, IntArray]:
    """Return an upright, furry ear, its hollow side forward and outward."""
    f, s, u = axes
    root = poll + big * (0.005 * f + 0.068 * sign * s + 0.095 * u)
    axis = unit(-0.38 * f + 0.50 * sign * s + 0.80 * u)
    opening = 0.85 * f + 0.40 * sign * s
    opening = unit(opening - (opening @ axis) * axis)
    width = np.cross(opening, axis)
    share = np.array([0.0, 0.15, 0.35, 0.55, 0.75, 0.9, 0.98])
    half = big * np.array([0.036, 0.046, 0.050, 0.044, 0.030, 0.016, 0.006])
    thick = big * np.array([0.022, 0.020, 0.017, 0.014, 0.011, 0.008, 0.005])
    theta = np.arange(14) * (2 * np.pi / 14)
    c, n = np.cos(theta), np.sin(theta)
    cup = (0.6 * half)[:, None] * c**2 * smoothstep(share / 0.3)[:, None]
    centre = root + big * 0.165 * share[:, None] * axis
    rings = centre[:, None] + (half[:, None] * c)[..., None] * width + (thick[:, None] * n + cup)[..., None] * opening
    solid = loft(rings, start=root - 0.015 * axis, end=root + big * 0.168 * axis)
    return solid.vertices, solid.triangles


def _tusk(poll: FloatArray, axes: tuple[FloatArray, ...], big: float, sign: int) -> tuple[FloatArray, IntArray]:
    """Return a lower canine that curves up beside the snout."""
    f, s, u = axes
    points = [(0.33, 0.045, -0.085), (0.345, 0.066, -0.070), (0.34, 0.078, -0.035), (0.325, 0.076, -0.005)]
    path = np.array([poll + big * (a * f + b * sign * s + c * u) for a, b, c in points])
    solid = sweep(path, big * np.array([0.013, 0.012, 0.009, 0.003]), n=8, up=f, round_ends=True)
    return solid.vertices, solid.triangles


# Build -> girth, height of the mane, size of the head, breadth of the skull, length of the snout.
_BUILD = {
    "yearling": (0.88, 0.022, 1.03, 0.94, 1.0),
    "sow": (1.0, 0.038, 1.0, 1.0, 1.0),
    "tusker": (1.08, 0.060, 1.06, 1.10, 1.0),
    "piglet": (0.90, 0.006, 1.12, 1.06, 0.6),
}


@lru_cache(maxsize=3 * MOMENTS)
def _shape(pose: _Pose, build_name: str) -> tuple[Piece, float]:
    """Return the whole boar, withers at height 1, straight, and the factor that brings them there."""
    lying = pose.lying
    girth, crest, big, sturdy, long = _BUILD[build_name]
    poll = np.array(pose.poll) - [0.0, 0.0, pose.drop if lying else pose.drop + pose.tilt]
    f = unit(pose.head)
    s = np.array([0.0, 1.0, 0.0])
    axes = (f, s, np.cross(f, s))
    trunk = _trunk(pose, lying, girth)
    uppers: list[Primitive] = []
    lowers: list[list[Primitive]] = []
    for i, leg in enumerate(pose.legs):
        grow = _fore_leg if i < 2 else _hind_leg
        upper, lower = grow(pose, leg, 1 if i % 2 == 0 else -1, lying)
        uppers += upper
        lowers.append(lower)
    neck = _neck(poll, f, pose, lying, girth)
    body = Body((trunk, *uppers, neck, _mane(trunk, neck, crest), _tail(pose.drop)), lying)
    pieces = [skin(body, BODY_CELL, PART_NAMES, _BANDS)]
    for fine, cell in [(_head(poll, axes, big, sturdy, long), HEAD_CELL), *((lower, LEG_CELL) for lower in lowers)]:
        pieces.append(skin(Body(tuple(fine), floor=True), cell, PART_NAMES))
    extras = [(_ear(poll, axes, big, sign), "ear") for sign in (1, -1)]
    if build_name == "tusker":
        extras += [(_tusk(poll, axes, big, sign), "tusk") for sign in (1, -1)]
    pieces += [(v, t, np.full(len(t), PART_NAMES.index(name), np.int32)) for (v, t), name in extras]
    vertices, triangles, parts = joined(pieces)
    if pose.on_side:
        vertices = _tipped(vertices)
    if lying or pose.on_side:
        origin = np.array([0.5 * (_TRUNK[0, 0] + _TRUNK[-1, 0]), 0.0, 0.0])
        size = 1.0
    else:
        soles = vertices[np.unique(triangles[parts == PART_NAMES.index("hoof")])]
        origin = np.array([feet_centre(soles) if pose.middle_x is None else pose.middle_x, 0.0, 0.0])
        # Blending, the lowered trunk and the mane change the height of the withers.
        size = 1.0 / withers_height(vertices, triangles[np.isin(parts, _BACK)], _WITHERS_X)
    return ((vertices - origin) * size, triangles, parts), size


def _tipped(vertices: FloatArray) -> FloatArray:
    """Return the (V, 3) vertices of a standing boar on its right side, legs to the left, resting on the ground."""
    x, y, z = vertices.T
    # What is narrower than the trunk sinks to the ground: head, lower legs, and upper legs onto those.
    legs = smoothstep((0.46 - z) / 0.30) * (0.055 + 0.105 * smoothstep(y / 0.08))
    head = 0.075 * smoothstep((x - 0.45) / 0.30)
    lying = np.column_stack([x, 0.62 - z, y - np.maximum(legs, head)])
    lying[:, 2] -= lying[:, 2].min()
    # The belly gives way to the ground.
    lying[:, 2] -= 0.4 * np.minimum(lying[:, 2], 0.10)
    return lying


# Parts of the trunk, by height.
_BANDS = ((0.60, "back"), (-0.80, "belly"))
_BACK = tuple(PART_NAMES.index(n) for n in ("back", "flank", "mane"))


def _bent(vertices: FloatArray, bend_rad: float, head_rad: float) -> FloatArray:
    """Return the vertices with the spine bent to the left.

    `bend_rad` is the angle between the directions of rump and shoulders, `head_rad` a further turn of the neck.
    """
    s = np.linspace(-1.0, 1.6, 261)
    angle = bend_rad * np.clip(s / 1.1, -0.6, 0.6) + head_rad * smoothstep((s - 0.38) / 0.35)
    step = s[1] - s[0]
    x = np.concatenate([[0.0], np.cumsum(0.5 * step * (np.cos(angle[1:]) + np.cos(angle[:-1])))])
    y = np.concatenate([[0.0], np.cumsum(0.5 * step * (np.sin(angle[1:]) + np.sin(angle[:-1])))])
    x, y = x - np.interp(0.0, s, x), y - np.interp(0.0, s, y)
    at = vertices[:, 0]
    side = vertices[:, 1]
    turn = np.interp(at, s, angle)
    return np.column_stack(
        [
            np.interp(at, s, x) - side * np.sin(turn),
            np.interp(at, s, y) + side * np.cos(turn),
            vertices[:, 2],
        ]
    )


def sample(rng: np.random.Generator, options: Params) -> Params:
    """Draw the parameters of one boar, JSON values only.

    Every call takes the same numbers from `rng`, so fixing an option leaves the rest as it would have been drawn,
    except that the height depends on the build.
    """
    params = DIALS.sample(rng, {name: value for name, value in options.items() if name != warm_ground.PARAM})
    if "shoulder_height_m" not in options:
        share = (params["shoulder_height_m"] - _DRAWN_M[0]) / (_DRAWN_M[1] - _DRAWN_M[0])
        low, high = HEIGHTS_M[params["build"]]
        params["shoulder_height_m"] = low + (high - low) * share
    return params | warm_ground.drawn(rng, options, Checks("boar"), params["pose"] in ("lying", "sleeping"))


def _require(params: Params) -> None:
    """Check the parameters, of which only animated animals have a phase."""
    DIALS.require({name: value for name, value in params.items() if name not in ("phase", warm_ground.PARAM)})
    checks = Checks("boar")
    warm_ground.check(params, checks)
    if params.get("phase") is not None:
        checks.number("parameter phase", params["phase"], 0.0, 1.0)
        if params["pose"] not in _GAITS:
            raise checks.bad("parameter phase", params["phase"], f"none for a {params['pose']} boar", "Leave it out.")


def animate(params: Params, phase: float) -> Params:
    """Return the parameters of a walking or running boar at a phase; of others, as they are."""
    return {**params, "phase": moment(phase)} if params["pose"] in _GAITS else dict(params)


def stride_m(params: Params) -> float:
    """Return how far a boar goes in a step of each leg, 0 for one that neither walks nor runs."""
    _require(params)
    if params["pose"] not in _GAITS:
        return 0.0
    _, size = _shape(_skeleton({**params, "phase": 0.0}), params["build"])
    return float(_GAITS[params["pose"]].stride * size * params["length_factor"] * params["shoulder_height_m"])


def build(params: Params) -> Mesh:
    """Build the mesh of a boar in metres, from parameters as `sample` draws them or `animate` returns them."""
    _require(params)
    pose = _skeleton(params)
    (vertices, triangles, parts), _ = _shape(pose, params["build"])
    own = 0.3 if params["pose"] == "sleeping" else 1.0
    v = _bent(
        vertices,
        pose.bend_rad + own * float(params["bend_rad"]),
        pose.head_turn_rad + own * float(params["head_turn_rad"]),
    )
    triangles = triangles.copy()
    if params["mirror"]:
        v, triangles = mirrored(v, triangles)
    factors = np.array([float(params["length_factor"]), float(params["width_factor"]), 1.0])
    mesh = finished((v * factors * float(params["shoulder_height_m"]), triangles, parts), PART_NAMES)
    return warm_ground.with_warm_ground(mesh, params)


MODEL = ObjectModel(
    name="boar",
    category="boar",
    description="A wild boar, piglet to tusker: standing, walking, running, rooting, lying or sleeping.",
    origin="on the ground between the feet; for a lying boar, below the middle of its trunk",
    stands=True,
    surfaces={"grass": 1.0, "soil": 1.0, "track": 0.3},
    parts={**PARTS, **warm_ground.PARTS},
    sample=sample,
    build=build,
    options=OPTIONS,
    parts_for=parts_for,
    animate=animate,
    stride_m=stride_m,
    skin_limit_c=38.0,
)
