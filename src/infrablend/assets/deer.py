"""Deer model, grown from a skeleton: six poses, with and without antlers, fawns, sizes from roe to red deer.

The body is an implicit surface (`assets.implicit`): trunk, neck, head and upper legs form one skin; the slender
lower legs are on a finer grid; ears and antlers are lofts. All lengths are in units of the height at the withers (the
shoulder height), +X towards the nose, +Y left, +Z up; `build` scales them to metres at the end.

The implicit surface depends only on pose, pose variant and body build, so there are few distinct ones (9 pose variants
x 2 builds), which are cached; size, proportions, the turn of neck and head, and mirroring are applied to the vertices
afterwards. Measured on one core: 0.15-0.20 s of CPU time for a new shape, 3-4 ms for a cached one; 23,000 to 26,000
triangles.

Proportions follow photographs of roe, red and white-tailed deer: the chest is deeper than half the legs' length, the
belly tucked up towards the flank, the hocks behind the buttocks, the head a third of the trunk, the ears half a head.

Temperatures: see `PARTS`. Ranges of neighbouring parts overlap, so a body drawn with the same quantile for all parts
is smooth.
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
from infrablend.assets.implicit import Body, Primitive, Tube, concatenate, ellipsoid, tube
from infrablend.assets.model import MOMENTS, TIMES, ObjectModel, Params, PartRange, moment, part_role
from infrablend.assets.params import Checks, pick
from infrablend.assets.shapes import loft, sweep
from infrablend.core.mesh import FloatArray, IntArray, Mesh

_CHECKS = Checks("deer")

POSES = ("standing", "walking", "grazing", "lying", "running", "sleeping")
AGES = ("adult", "young")
DRAWN_POSES = POSES[:4]
BUILDS = ("slender", "sturdy")
ANTLERS = ("none", "hard", "velvet")
ANTLER_FORMS = ("spike", "roe", "white-tailed", "red")
# Pose -> its variants; each pair is one shape of the body.
VARIANTS: Mapping[str, tuple[str, ...]] = {
    "standing": ("alert", "relaxed", "shifted"),
    "walking": ("left-fore", "right-hind"),
    "grazing": ("ground", "browse"),
    "lying": ("alert", "resting"),
    "running": ("left-trot", "right-trot"),
    "sleeping": ("curled", "flank"),
}
SHOULDER_HEIGHT_M: Mapping[str, tuple[float, float]] = {"adult": (0.4, 1.6), "young": (0.25, 0.9)}
TURN_RAD = {"standing": 0.7, "walking": 0.4, "grazing": 0.5, "lying": 0.6, "running": 0.2, "sleeping": 0.1}
HEAD_TURN_RAD = 0.35
BEND_DEG = (0.0, 70.0)

# Surface minus air. The level is that of trunks measured in winter, +6..+8 K. A deer should be a nearly uniform warm
# body with cooler legs, ears and antlers: legs and ears are therefore colder than the trunk here, although published
# skin temperatures of lower legs and inner ears are higher, and the trunk varies by 1-2 K only.
# Fur is rough: no Fresnel rim, ior 1.
PARTS: Mapping[str, PartRange] = {
    "back": part_role("fur", (5.0, 8.0), "top of the trunk, thickest coat"),
    "upper_flank": part_role("fur", (5.5, 8.5), "between back and flank"),
    "flank": part_role("fur", (6.0, 9.0), "sides of the trunk; +6..+8 K measured"),
    "belly": part_role("fur", (6.5, 10.0), "underside and groin, thin coat"),
    "neck_base": part_role("fur", (5.6, 8.8), "between trunk and neck"),
    "neck": part_role("fur", (6.0, 9.5), "trunk to head"),
    "head": part_role("fur", (7.0, 11.0), "head, reduced towards a uniform body"),
    "muzzle": part_role("fur", (8.0, 12.5), "bare muzzle, reduced towards a uniform body"),
    "nose": part_role("skin", (9.0, 14.5), "bare skin", emissivity=(0.97, 0.98)),
    "eye": part_role("eye", (11.0, 18.0), "hottest spot"),
    "ear": part_role("fur", (2.5, 5.5), "cooler than the body"),
    "haunch": part_role("fur", (5.6, 8.6), "thigh, between flank and leg"),
    "shoulder": part_role("fur", (5.6, 8.6), "shoulder to elbow, between flank and leg"),
    "upper_leg": part_role("fur", (5.0, 8.0), "forearm and gaskin, cooler than the trunk"),
    "mid_leg": part_role("fur", (3.8, 6.5), "above knee and hock, between its neighbours"),
    "lower_leg": part_role("fur", (2.5, 5.0), "below knee and hock, cooler than the trunk"),
    "hoof": part_role("antler", (0.5, 2.5), "horn, touches the ground"),
    "tail": part_role("fur", (4.0, 7.0), "thin, mostly fur"),
    "antler": part_role("antler", (0.0, 0.5), "bone at air temperature"),
    "antler_velvet": part_role("fur", (6.0, 10.0), "growing antler with blood supply"),
}
PART_NAMES = tuple(PARTS)
# Dark fur in direct sun is 15..25 K warmer than air and loses 18 K within two minutes of shade. Rise of the back (lower
# values for weak sun), and the share of it that parts reach that face less of the sky (est.).
SUN_K = (5.0, 20.0)
_SUN_SHARE: Mapping[str, float] = {
    "back": 1.0, "upper_flank": 0.9, "flank": 0.7, "belly": 0.1, "neck_base": 0.9, "neck": 0.8, "head": 0.7,
    "muzzle": 0.5, "ear": 0.7, "haunch": 0.7, "shoulder": 0.7, "upper_leg": 0.5, "mid_leg": 0.4, "lower_leg": 0.3,
    "hoof": 0.1, "tail": 0.7, "antler": 0.3, "antler_velvet": 0.5,
}  # fmt: skip


def parts_for(params: Params) -> Mapping[str, PartRange]:
    """Return the thermal role of every part; by day the sun warms the coat."""
    return {**roles_of_coat(params, PARTS, SUN_K, _SUN_SHARE), **warm_ground.roles(params)}


BODY_CELL = 0.019
HEAD_CELL = 0.0105
LEG_CELL = 0.0115

# Sections of the trunk of a standing deer: x, top, bottom, half width.
_TRUNK = np.array(
    [
        [-0.535, 0.880, 0.740, 0.055],
        [-0.48, 0.945, 0.680, 0.098],
        [-0.38, 0.985, 0.640, 0.125],
        [-0.26, 0.990, 0.620, 0.132],
        [-0.12, 0.970, 0.598, 0.134],
        [0.02, 0.958, 0.568, 0.136],
        [0.15, 0.972, 0.545, 0.128],
        [0.27, 1.000, 0.545, 0.108],
        [0.37, 0.970, 0.575, 0.096],
        [0.445, 0.900, 0.650, 0.075],
    ]
)
_WITHERS_X = 0.27
_SPINE_X = (-0.42, 0.34)
# Smaller bends do not show.
_STRAIGHT_RAD = 1e-3
# Trunks of the young are short for their legs.
_YOUNG_LENGTH = 0.88

Point = tuple[float, float, float]


@dataclass(frozen=True)
class _Pose:
    """Free parameters of the skeleton in one pose.

    Attributes:
        legs: Left fore, right fore, left hind and right hind leg.
        neck: Control points of the neck, from inside the chest to the poll.
        head: Direction of the head from poll to nose.
        drop: Distance by which the trunk is lowered.
        tilt: Further distance by which the withers are lowered.
        lying: Whether the trunk is on the ground, with the legs folded.
        middle_x: x of the model's origin; None for the middle between the feet.
        bend_rad: Bend of the spine to the left.
        asleep: Whether the head lies on the ground, with the neck bent to the side.
    """

    legs: tuple[Leg, Leg, Leg, Leg]
    neck: tuple[Point, ...]
    head: Point
    drop: float = 0.0
    tilt: float = 0.0
    lying: bool = False
    middle_x: float | None = None
    bend_rad: float = 0.0
    asleep: bool = False


_STILL = Leg()
_UPRIGHT: tuple[Point, ...] = ((0.32, 0, 0.82), (0.46, 0, 0.95), (0.575, 0, 1.12), (0.645, 0, 1.275))
_FORWARD: tuple[Point, ...] = ((0.32, 0, 0.82), (0.48, 0, 0.91), (0.63, 0, 1.03), (0.745, 0, 1.15))
_POSES: Mapping[tuple[str, str], _Pose] = {
    ("standing", "alert"): _Pose((_STILL, Leg(-0.01), Leg(0.015), Leg(-0.02)), _UPRIGHT, (0.90, 0, -0.44)),
    ("standing", "relaxed"): _Pose((Leg(0.02), Leg(-0.02), Leg(-0.04), Leg(0.03)), _FORWARD, (0.87, 0, -0.50)),
    ("standing", "shifted"): _Pose(
        (Leg(-0.045), Leg(0.035), Leg(-0.09), Leg(0.06)),
        ((0.32, 0, 0.82), (0.47, 0, 0.93), (0.61, 0, 1.07), (0.71, 0, 1.21)),
        (0.93, 0, -0.37),
        0.004,
    ),
    ("walking", "left-fore"): _Pose(
        (Leg(0.15, 0.0), Leg(-0.12, 0.0), Leg(-0.15, 0.0), Leg(0.02, 0.075, 0.8)), _FORWARD, (0.88, 0, -0.47), 0.012
    ),
    ("walking", "right-hind"): _Pose(
        (Leg(-0.10), Leg(0.05, 0.10, 1.0), Leg(0.11), Leg(-0.17)),
        ((0.32, 0, 0.82), (0.48, 0, 0.90), (0.64, 0, 1.00), (0.765, 0, 1.105)),
        (0.90, 0, -0.43),
        0.012,
    ),
    ("grazing", "ground"): _Pose(
        (Leg(0.13), Leg(-0.09), Leg(-0.03), Leg(0.04)),
        ((0.33, 0, 0.82), (0.48, 0, 0.77), (0.605, 0, 0.61), (0.70, 0, 0.405)),
        (0.30, 0, -0.954),
        0.01,
        0.02,
    ),
    ("grazing", "browse"): _Pose(
        (Leg(0.05), Leg(-0.05), Leg(0.04), Leg(-0.05)),
        ((0.33, 0, 0.82), (0.49, 0, 0.82), (0.64, 0, 0.75), (0.77, 0, 0.66)),
        (0.72, 0, -0.69),
        0.004,
        0.01,
    ),
    ("lying", "alert"): _Pose((_STILL,) * 4, _UPRIGHT, (0.90, 0, -0.44), 0.53, lying=True),
    ("lying", "resting"): _Pose(
        (_STILL,) * 4,
        ((0.32, 0, 0.80), (0.46, 0.03, 0.84), (0.59, 0.10, 0.86), (0.68, 0.20, 0.83)),
        (0.62, 0.66, -0.42),
        0.53,
        lying=True,
    ),
    ("sleeping", "curled"): _Pose(
        (_STILL,) * 4,
        ((0.32, 0, 0.79), (0.47, 0.10, 0.76), (0.44, 0.26, 0.69), (0.27, 0.315, 0.63)),
        (-0.99, 0.03, -0.05),
        0.53,
        lying=True,
        bend_rad=0.95,
        asleep=True,
    ),
    ("sleeping", "flank"): _Pose(
        (_STILL,) * 4,
        ((0.32, 0, 0.79), (0.47, 0.04, 0.76), (0.57, 0.15, 0.69), (0.57, 0.27, 0.635)),
        (-0.25, 0.95, -0.12),
        0.53,
        lying=True,
        bend_rad=0.35,
        asleep=True,
    ),
}
_GAITS: Mapping[str, Gait] = {
    "walking": Gait(0.80, 0.64, (0.25, 0.75, 0.0, 0.5), 0.10),
    "running": Gait(1.50, 0.40, (0.0, 0.5, 0.5, 0.0), 0.16),  # a trot: diagonal legs together
}
# Neck, head and lowered trunk of an animal in motion.
_MOVING: Mapping[str, _Pose] = {
    "walking": _Pose((_STILL,) * 4, _FORWARD, (0.88, 0, -0.47), 0.014, middle_x=-0.045),
    "running": _Pose((_STILL,) * 4, _UPRIGHT, (0.90, 0, -0.44), 0.026, middle_x=-0.045),
}


def _skeleton(pose: str, variant: str, phase: float | None) -> _Pose:
    """Return the skeleton of a variant, or that of a moving deer at a phase."""
    if pose == "running" and phase is None:
        phase = 0.5 * VARIANTS["running"].index(variant)
    if phase is None:
        return _POSES[pose, variant]
    return replace(_MOVING[pose], legs=_GAITS[pose].legs(phase))


@dataclass(frozen=True, eq=False)
class _Shape:
    """Undeformed deer of withers height 1, with the weights that deformation needs.

    Attributes:
        vertices: (V, 3) positions.
        triangles: (T, 3) indices of vertices.
        parts: (T,) indices into `PART_NAMES`.
        neck_weight: (V,) share of the neck's turn that applies to each vertex.
        head_weight: (V,) share of the head's turn that applies to each vertex.
        neck_pivot: (3,) pivot of the neck.
        poll: (3,) pivot of the head.
        forward: (3,) direction from poll to nose.
        side: (3,) direction to the left of the head.
        size: Factor that brings the withers to height 1.
    """

    vertices: FloatArray
    triangles: IntArray
    parts: IntArray
    neck_weight: FloatArray
    head_weight: FloatArray
    neck_pivot: FloatArray
    poll: FloatArray
    forward: FloatArray
    side: FloatArray
    size: float


def _foot(fetlock: FloatArray, hang: float, lying: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return coronet, heel and toe of a foot; the pastern points forward on the ground and folds back in the air."""
    angle = np.deg2rad(-62.0 - 75.0 * hang) if not lying else np.deg2rad(-150.0)
    direction = np.array([np.cos(angle), 0.0, np.sin(angle)])
    coronet = fetlock + 0.068 * direction
    sole = np.deg2rad(-35.0 - 75.0 * hang) if not lying else np.deg2rad(-170.0)
    toe = coronet + 0.052 * np.array([np.cos(sole), 0.0, np.sin(sole)])
    return coronet, coronet + 0.2 * (toe - coronet), toe


@dataclass(frozen=True)
class _Build:
    """Factors on the width of trunk, neck, throat and head."""

    trunk: float = 1.0
    neck: float = 1.0
    throat: float = 1.0
    head: float = 1.0


_BUILDS: Mapping[str, _Build] = {
    "slender": _Build(),
    "sturdy": _Build(1.08, 1.16, 1.12, 1.06),
    "fawn": _Build(0.92, 0.86, 0.98, 1.25),  # long legs, a thin neck and a round head
}


def _trunk(pose: _Pose, lying: bool, width: float) -> Tube:
    x, top, bottom, half = _TRUNK.T.copy()
    half = half * width
    if lying:
        top = top - pose.drop
        # The belly is compressed by the ground and bulges sideways.
        bottom = np.maximum(bottom - pose.drop - 0.05, -0.02)
        half = half * 1.04
    else:
        fall = pose.drop + pose.tilt * smoothstep((x + 0.5) / 0.8)
        top, bottom = top - fall, bottom - fall
    path = np.column_stack([x, np.zeros_like(x), 0.5 * (top + bottom)])
    return tube("flank", path, half, 0.5 * (top - bottom), caps=(0.035, 0.05), steps=2)


def _head_frame(pose: _Pose) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the directions forward, left and up of the head."""
    forward = unit(pose.head)
    side = unit(np.cross([0.0, 0.0, 1.0], forward))
    return forward, side, np.cross(forward, side)


def _head(poll: FloatArray, neck_end: FloatArray, frame: tuple[FloatArray, ...], build: _Build) -> list[Primitive]:
    """Return head and upper end of the neck, on the finer grid; `neck_end` is the direction of the neck there."""
    f, s, u = frame
    thick = build.throat

    def at(forward: float, up: float, left: float = 0.0) -> FloatArray:
        return np.asarray(poll + forward * f + up * u + left * s)

    big = build.head
    # The upper end starts inside the neck of the body, so that both skins meet without a crease.
    throat = tube(
        "neck",
        [poll - 0.13 * neck_end, poll - 0.05 * neck_end, poll],
        np.array([0.036, 0.046, 0.046]) * thick,
        np.array([0.056, 0.065, 0.058]) * (0.5 + 0.5 * thick),
        side=s,
        caps=(0.02, 0.04),
    )
    skull = tube(
        "head",
        [at(-0.005, -0.005), at(0.07, 0.0), at(0.135, -0.010)],
        np.array([0.050, 0.058, 0.048]) * big,
        np.array([0.056, 0.066, 0.060]) * big,
        side=s,
        blend=0.05,
        steps=3,
    )
    muzzle = tube(
        "head",
        [at(0.13, -0.010), at(0.19, -0.018), at(0.245, -0.025), at(0.285, -0.030)],
        np.array([0.046, 0.037, 0.031, 0.029]) * big,
        np.array([0.055, 0.047, 0.040, 0.035]) * big,
        side=s,
        blend=0.02,
        caps=(0.02, 0.022),
        steps=2,
        beyond=[(0.9, "muzzle")],
    )
    jaw = tube(
        "head", [at(0.045, -0.045), at(0.13, -0.052), at(0.18, -0.052)], [0.030, 0.026, 0.018], side=s, blend=0.03
    )
    nose = ellipsoid("nose", at(0.296, -0.019), (0.017, 0.024, 0.020), axes=[f, s, u], blend=0.014)
    brows = [
        ellipsoid("head", at(0.100, 0.026, 0.038 * e), (0.034, 0.016, 0.018), axes=[f, s, u], blend=0.02)
        for e in (1, -1)
    ]
    eyes = [
        ellipsoid("eye", at(0.112, 0.014, 0.0485 * e), (0.017, 0.013, 0.014), axes=[f, s, u], blend=0.004)
        for e in (1, -1)
    ]
    return [throat, skull, muzzle, jaw, nose, *brows, *eyes]


def _fore_leg(pose: _Pose, leg: Leg, sign: int, lying: bool) -> tuple[list[Primitive], list[Primitive]]:
    """Return the upper part (in the skin of the body) and the lower part (on the finer grid) of a foreleg."""
    y = 0.092 * sign
    fall = pose.drop + pose.tilt
    elbow = np.array([0.265 + 0.4 * leg.dx, 0.098 * sign, 0.615 - fall])
    if lying:
        elbow = np.array([0.25, 0.125 * sign, 0.10])
        knee = np.array([0.475, 0.12 * sign, 0.068])
        fetlock = np.array([0.275, 0.150 * sign, 0.030])
    else:
        fetlock = np.array([0.292 + leg.dx, y, 0.104 + leg.dz])
        if leg.hang:
            fetlock[0] -= 0.06 * leg.hang
        knee = leg_joint(elbow, fetlock, (0.272, 0.242), 1.0)
        knee[1] = y + 0.004 * sign
    shoulder = np.array([0.385 + 0.15 * leg.dx, 0.080 * sign, 0.70 - fall])
    blade = np.array([0.265, 0.062 * sign, 0.90 - fall])
    if lying:
        shoulder[2] = 0.19
    upper: list[Primitive] = [
        tube("flank", [blade, shoulder], [0.040, 0.045], [0.075, 0.075], blend=0.06),
        tube("shoulder", [shoulder, elbow + np.array([0.01, 0, 0.02])], [0.045, 0.040], [0.062, 0.060], blend=0.06),
        tube(
            "upper_leg",
            [elbow, elbow + 0.35 * (knee - elbow), knee],
            [0.041, 0.033, 0.0200],
            [0.060, 0.043, 0.0225],
            blend=0.045,
            beyond=[(0.6, "mid_leg")],
        ),
    ]
    cannon = fetlock - knee
    lower: list[Primitive] = [
        tube(
            "mid_leg",
            [knee - 0.35 * (knee - elbow), knee, knee + 0.2 * cannon, knee + 0.6 * cannon, fetlock],
            [0.0180, 0.0235, 0.0165, 0.0145, 0.0185],
            [0.0200, 0.0275, 0.0200, 0.0175, 0.0220],
            beyond=[(1.3, "lower_leg")],
        )
    ]
    return upper, lower + _hoof(fetlock, leg.hang, lying, 1.0)


def _hind_leg(pose: _Pose, leg: Leg, sign: int, lying: bool) -> tuple[list[Primitive], list[Primitive]]:
    """Return the upper part (in the skin of the body) and the lower part (on the finer grid) of a hind leg."""
    y = 0.092 * sign
    hip = np.array([-0.385, 0.078 * sign, 0.835 - pose.drop])
    stifle = np.array([-0.285 + 0.45 * leg.dx, 0.112 * sign, 0.615 - 0.9 * pose.drop + 0.3 * leg.dz])
    if lying:
        hip[2] = 0.29
        stifle = np.array([-0.14, 0.150 * sign, 0.165])
        hock = np.array([-0.44, 0.165 * sign, 0.055])
        fetlock = np.array([-0.19, 0.195 * sign, 0.030])
    else:
        fetlock = np.array([-0.452 + leg.dx, y, 0.104 + leg.dz])
        hock = leg_joint(stifle, fetlock, (0.325, 0.268), -1.0)
        hock[1] = y
    blend = 0.12 if lying else 0.07
    # When folded, the thigh is buried in the coat of the flank.
    low_thigh = [] if lying else [(0.75, "upper_leg")]
    low_ham = [] if lying else [(0.55, "upper_leg")]
    ham = np.array([-0.468, 0.072 * sign, 0.79 - pose.drop])
    ham_low = 0.55 * stifle + 0.45 * hock
    if lying:
        ham = np.array([-0.45, 0.10 * sign, 0.22])
    upper: list[Primitive] = [
        tube("haunch", [hip, stifle], [0.066, 0.050], [0.120, 0.085], blend=blend, beyond=low_thigh),
        tube("haunch", [ham, ham_low], [0.055, 0.030], [0.070, 0.045], blend=0.06, beyond=low_ham),
        tube(
            "upper_leg",
            [stifle - [0.01, 0, 0], stifle + 0.5 * (hock - stifle), hock],
            [0.042, 0.030, 0.0180],
            [0.066, 0.044, 0.0255],
            blend=0.05,
            beyond=[(0.7, "mid_leg")],
        ),
    ]
    cannon = fetlock - hock
    heel = unit(hock - stifle)
    lower: list[Primitive] = [
        tube(
            "mid_leg",
            [hock - 0.30 * (hock - stifle), hock, hock + 0.22 * cannon, hock + 0.65 * cannon, fetlock],
            [0.0165, 0.0225, 0.0180, 0.0155, 0.0190],
            [0.0230, 0.0310, 0.0225, 0.0185, 0.0225],
            beyond=[(1.3, "lower_leg")],
        ),
        tube("mid_leg", [hock, hock + 0.018 * heel + [-0.006, 0, 0.004]], [0.016, 0.013], [0.018, 0.015], blend=0.015),
    ]
    return upper, lower + _hoof(fetlock, leg.hang, lying, 1.04)


def _hoof(fetlock: FloatArray, hang: float, lying: bool, size: float) -> list[Primitive]:
    coronet, heel, toe = _foot(fetlock, hang, lying)
    toes: list[Primitive] = [
        tube(
            "hoof",
            [heel + np.array([0, 0.009 * e, 0]), toe + np.array([0, 0.012 * e, 0])],
            np.array([0.0155, 0.0095]) * size,
            np.array([0.0250, 0.0120]) * size,
            blend=0.006 if e < 0 else 0.010,
        )
        for e in (1, -1)
    ]
    return [
        tube(
            "lower_leg",
            [fetlock, coronet],
            np.array([0.0175, 0.0190]) * size,
            np.array([0.0195, 0.0210]) * size,
            blend=0.01,
        ),
        *toes,
    ]


def _ear(poll: FloatArray, frame: tuple[FloatArray, ...], sign: int) -> tuple[FloatArray, IntArray]:
    """Return a leaf-shaped ear at the side of the skull, its hollow side forward and outward."""
    f, s, u = frame
    root = poll + 0.012 * f + 0.030 * sign * s + 0.030 * u
    axis = unit(-0.30 * f + 0.78 * sign * s + 0.56 * u)
    opening = 0.80 * f + 0.45 * sign * s
    opening = unit(opening - (opening @ axis) * axis)
    width = np.cross(opening, axis)
    share = np.array([0.0, 0.12, 0.28, 0.45, 0.62, 0.78, 0.9, 0.98])
    half = np.array([0.016, 0.022, 0.036, 0.044, 0.041, 0.030, 0.017, 0.006])
    thick = np.array([0.014, 0.014, 0.011, 0.009, 0.008, 0.007, 0.006, 0.004])
    theta = np.arange(14) * (2 * np.pi / 14)
    c, n = np.cos(theta), np.sin(theta)
    cup = (0.75 * half)[:, None] * c**2 * smoothstep(share / 0.3)[:, None]
    centre = root + (0.185 * share)[:, None] * axis - (0.02 * np.sin(np.pi * share))[:, None] * opening
    rings = centre[:, None] + (half[:, None] * c)[..., None] * width + (thick[:, None] * n + cup)[..., None] * opening
    solid = loft(rings, start=root - 0.01 * axis, end=root + 0.188 * axis)
    return solid.vertices, solid.triangles


# Beam of one antler in the frame of the head (forward, left, up), then its tines: (share of the beam, relative tip).
_ANTLER_SHAPES: Mapping[str, tuple[list[Point], list[tuple[float, Point]]]] = {
    "spike": ([(0, 0, 0), (-0.01, 0.025, 0.07), (-0.01, 0.045, 0.15)], [(0.45, (0.055, 0.005, 0.035))]),
    "roe": (
        [(0, 0, 0), (-0.012, 0.022, 0.09), (-0.015, 0.034, 0.17), (-0.005, 0.05, 0.27)],
        [(0.55, (0.075, 0.005, 0.055)), (0.76, (-0.065, 0.012, 0.050))],
    ),
    "white-tailed": (
        [
            (0, 0, 0),
            (-0.06, 0.06, 0.07),
            (-0.11, 0.14, 0.16),
            (-0.07, 0.21, 0.26),
            (0.04, 0.215, 0.33),
            (0.13, 0.17, 0.36),
        ],
        [
            (0.13, (0.03, -0.015, 0.09)),
            (0.42, (-0.02, -0.01, 0.19)),
            (0.62, (-0.01, -0.02, 0.17)),
            (0.80, (0.0, -0.02, 0.11)),
        ],
    ),
    "red": (
        [
            (0, 0, 0),
            (-0.06, 0.07, 0.06),
            (-0.14, 0.18, 0.16),
            (-0.18, 0.26, 0.30),
            (-0.13, 0.29, 0.43),
            (-0.08, 0.26, 0.53),
        ],
        [
            (0.05, (0.15, 0.025, 0.06)),
            (0.20, (0.14, 0.035, 0.08)),
            (0.50, (0.13, 0.045, 0.08)),
            (0.80, (0.03, 0.09, 0.13)),
            (0.82, (-0.09, 0.01, 0.13)),
        ],
    ),
}


def _antler(
    poll: FloatArray, frame: tuple[FloatArray, ...], sign: int, form: str, velvet: bool
) -> tuple[FloatArray, IntArray]:
    f, s, u = frame
    # Antlers lean back from the line of the face.
    lean = np.deg2rad(28.0)
    up = np.cos(lean) * u - np.sin(lean) * f
    front = np.cos(lean) * f + np.sin(lean) * u
    axes = np.stack([front, sign * s, up])
    root = poll + 0.045 * f + 0.030 * sign * s + 0.040 * u
    beam, tines = _ANTLER_SHAPES[form]
    stretch, thick = (0.82, 1.5) if velvet else (1.0, 1.0)
    path = root + stretch * np.array(beam) @ axes
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    base = (0.012 + 0.009 * min(length / 0.6, 1.0)) * thick
    line = tube("antler", path, np.linspace(base, 0.0075 * thick, len(path)), steps=3)
    hold = axes[0] + 0.35 * axes[1]
    pieces = [sweep(line.path, line.half_width, n=8, up=hold, round_ends=True)]
    for share, tip in tines:
        at = share * (len(line.path) - 1)
        start = np.array([np.interp(at, np.arange(len(line.path)), line.path[:, i]) for i in range(3)])
        reach = stretch * np.array(tip) @ axes
        # A tine leaves the beam sideways and bends upward.
        bow = start + 0.5 * reach - 0.10 * float(np.linalg.norm(reach)) * axes[2]
        radius = float(np.interp(at, np.arange(len(line.path)), line.half_width))
        curve = tube("antler", [start, bow, start + reach], [0.8 * radius, 0.7 * radius, 0.005 * thick], steps=3)
        pieces.append(sweep(curve.path, curve.half_width, n=8, up=axes[1], round_ends=True))
    return concatenate(pieces)


@lru_cache(maxsize=3 * MOMENTS)
def _body(pose: _Pose, build_name: str) -> _Shape:
    """Return body and legs: everything that is part of the implicit surface."""
    lying = pose.lying
    build = _BUILDS[build_name]
    lift = np.array([0.0, 0.0, -pose.drop if lying else -pose.drop - pose.tilt])
    neck_path = np.array(pose.neck)
    if lying:
        neck_path = neck_path + lift
    neck = _neck(neck_path, build.neck, pose.asleep)
    trunk = _trunk(pose, lying, build.trunk)
    poll = neck_path[-1]
    frame = _head_frame(pose)
    tail_path = np.array([[-0.515, 0, 0.895], [-0.573, 0, 0.85], [-0.58, 0, 0.765]]) - [0.0, 0.0, pose.drop]
    tail = tube(
        "tail",
        tail_path,
        [0.028, 0.034, 0.020],
        [0.024, 0.024, 0.014],
        blend=0.02,
        steps=3,
    )
    uppers: list[Primitive] = []
    lowers: list[list[Primitive]] = []
    for i, leg in enumerate(pose.legs):
        grow = _fore_leg if i < 2 else _hind_leg
        upper, lower = grow(pose, leg, 1 if i % 2 == 0 else -1, lying)
        uppers += upper
        lowers.append(lower)
    head = _head(poll, unit(neck.path[-1] - neck.path[-3]), frame, build)
    body = Body((trunk, *uppers, neck, tail), floor=lying)

    pieces = [skin(body, BODY_CELL, PART_NAMES, _BANDS)]
    for fine, cell in [(head, HEAD_CELL), *((lower, LEG_CELL) for lower in lowers)]:
        pieces.append(skin(Body(tuple(fine), floor=True), cell, PART_NAMES))
    vertices, triangles, label = joined(pieces)
    if lying:
        origin = np.array([0.5 * (_TRUNK[0, 0] + _TRUNK[-1, 0]), 0.0, 0.0])
    elif pose.middle_x is not None:
        origin = np.array([pose.middle_x, 0.0, 0.0])
    else:
        soles = vertices[np.unique(triangles[label == PART_NAMES.index("hoof")])]
        origin = np.array([feet_centre(soles), 0.0, 0.0])
    # Scale the withers back to height 1: blending, the lowered trunk and the build change it.
    size = 1.0 if lying else 1.0 / withers_height(vertices, triangles[np.isin(label, _BACK)], _WITHERS_X)
    first_head = len(pieces[0][0])
    first_leg = len(pieces[0][0]) + len(pieces[1][0])
    along = neck.coordinates(vertices)[0] / (len(neck.path) - 1)
    neck_weight = smoothstep((along - 0.25) / 0.65)
    neck_weight[:first_head] *= 1.0 - smoothstep(neck.distance(vertices[:first_head]) / 0.05)
    neck_weight[first_leg:] = 0.0
    head_weight = smoothstep(((vertices - poll) @ frame[0] + 0.05) / 0.12)
    head_weight[:first_head] = 0.0
    head_weight[first_leg:] = 0.0
    return _Shape(
        (vertices - origin) * size,
        triangles,
        label,
        neck_weight,
        head_weight,
        (neck.path[3] - origin) * size,
        (poll - origin) * size,
        frame[0],
        frame[1],
        size,
    )


def _neck(path: FloatArray, thick: float, asleep: bool) -> Tube:
    wide = np.array([0.080, 0.064, 0.052, 0.036]) * thick
    high = np.array([0.150, 0.110, 0.078, 0.048]) * (1 + 0.7 * (thick - 1))
    if asleep:
        # Bent to the side, a neck is measured across the vertical; on the ground it is lower, too.
        wide, high = 0.85 * high, 1.1 * wide
    side = (0.0, 0.0, 1.0) if asleep else (0.0, 1.0, 0.0)
    return tube("neck_base", path, wide, high, side=side, blend=0.07, steps=4, beyond=[(1.25, "neck")])


# Parts of the trunk, by height.
_BANDS = ((0.35, "upper_flank"), (0.75, "back"), (-0.80, "belly"))
_BACK = tuple(PART_NAMES.index(n) for n in ("back", "upper_flank", "flank"))


def _with_crown(shape: _Shape, antlers: str, form: str) -> _Shape:
    """Add the ears and any antlers, which turn with the head."""
    frame = (shape.forward, shape.side, np.cross(shape.forward, shape.side))
    pieces = [(shape.vertices, shape.triangles)]
    parts = [shape.parts]
    for sign in (1, -1):
        pieces.append(_ear(shape.poll, frame, sign))
        parts.append(np.full(len(pieces[-1][1]), PART_NAMES.index("ear"), np.int32))
    if antlers != "none":
        name = "antler_velvet" if antlers == "velvet" else "antler"
        for sign in (1, -1):
            pieces.append(_antler(shape.poll, frame, sign, form, antlers == "velvet"))
            parts.append(np.full(len(pieces[-1][1]), PART_NAMES.index(name), np.int32))
    vertices, triangles = concatenate(pieces)
    extra = np.ones(len(vertices) - len(shape.vertices))
    return replace(
        shape,
        vertices=vertices,
        triangles=triangles,
        parts=np.concatenate(parts),
        neck_weight=np.concatenate([shape.neck_weight, extra]),
        head_weight=np.concatenate([shape.head_weight, extra]),
    )


def _rotated_about_vertical(points: FloatArray, pivot: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """Turn each of (N, 3) points about the vertical through `pivot` by its own angle (N,)."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, y = points[:, 0] - pivot[0], points[:, 1] - pivot[1]
    return np.column_stack([pivot[0] + c * x - s * y, pivot[1] + s * x + c * y, points[:, 2]])


def _bent(points: FloatArray, angle_rad: float) -> FloatArray:
    """Bend (N, 3) points along a horizontal arc from hips to withers, towards the left; neck and head follow."""
    hips, withers = _SPINE_X
    along = np.clip(points[:, 0], hips, withers)
    share = (along - hips) / (withers - hips) - 0.5
    turn = angle_rad * share
    # The spine keeps its length; its middle stays where it is.
    radius = (withers - hips) / angle_rad
    x, y = radius * np.sin(turn), radius * (1.0 - np.cos(turn))
    beyond = points[:, 0] - along
    aside = points[:, 1]
    c, s = np.cos(turn), np.sin(turn)
    middle = 0.5 * (hips + withers)
    return np.column_stack([middle + x + beyond * c - aside * s, y + beyond * s + aside * c, points[:, 2]])


DEFAULTS: Params = {
    "pose": "standing",
    "variant": "alert",
    "build": "slender",
    "antlers": "none",
    "antler_form": "roe",
    "age": "adult",
    "shoulder_height_m": 0.9,
    "length_factor": 1.0,
    "width_factor": 1.0,
    "neck_turn_rad": 0.0,
    "head_turn_rad": 0.0,
    "spine_bend_rad": 0.0,
    "mirror": False,
    "time_of_day": "night",
    "phase": None,
    warm_ground.PARAM: None,
}


def _checked(params: Params) -> Params:
    """Return all parameters, checked, with defaults for missing ones."""
    _CHECKS.known("parameter", params, tuple(DEFAULTS))
    p = {**DEFAULTS, **params}
    pose = _CHECKS.one_of("parameter pose", p["pose"], POSES)
    if "variant" not in params:
        p["variant"] = VARIANTS[pose][0]
    _CHECKS.one_of("parameter variant", p["variant"], VARIANTS[pose])
    _CHECKS.one_of("parameter build", p["build"], BUILDS)
    _CHECKS.one_of("parameter time_of_day", p["time_of_day"], TIMES)
    _CHECKS.one_of("parameter antlers", p["antlers"], ANTLERS)
    _CHECKS.one_of("parameter antler_form", p["antler_form"], ANTLER_FORMS)
    age = _CHECKS.one_of("parameter age", p["age"], AGES)
    _CHECKS.number("parameter shoulder_height_m", p["shoulder_height_m"], *SHOULDER_HEIGHT_M[age])
    for name in ("length_factor", "width_factor"):
        _CHECKS.number(f"parameter {name}", p[name], 0.8, 1.25)
    for name in ("neck_turn_rad", "head_turn_rad", "spine_bend_rad"):
        _CHECKS.number(f"parameter {name}", p[name], -1.2, 1.2)
    _CHECKS.flag("parameter mirror", p["mirror"])
    warm_ground.check(p, _CHECKS)
    if p["phase"] is not None:
        p["phase"] = _CHECKS.number("parameter phase", p["phase"], 0.0, 1.0)
        if pose not in _GAITS:
            raise _CHECKS.bad("parameter phase", p["phase"], f"none for a {pose} deer", "Leave it out.")
    return p


def _body_of(p: Params) -> str:
    return "fawn" if p["age"] == "young" else str(p["build"])


def build(params: Params) -> Mesh:
    """Build the mesh of a deer in metres.

    Args:
        params: Parameters as `sample` draws them; missing ones take their value from `DEFAULTS`.

            pose, variant: See `VARIANTS`.
            phase: Place in [0, 1] in the cycle of a walking or running deer, instead of the variant.
            build: `slender` or `sturdy` (wider trunk, thicker neck); ignored for the young.
            age: `adult`, or `young` for a fawn or calf with its proportions, which has no antlers.
            antlers, antler_form: See `ANTLERS` and `ANTLER_FORMS`; the form is ignored without antlers.
            shoulder_height_m: Height of the withers when standing; a lying deer of that size is lower.
            length_factor, width_factor: Extra factors along x and y.
            neck_turn_rad, head_turn_rad: Turn about the vertical, positive to the deer's left, before mirroring.
            spine_bend_rad: Angle between hips and shoulders about the vertical, positive to the deer's left, before
                mirroring.
            mirror: Exchange left and right.
            time_of_day: `night`, `day`, `dusk` or `dawn`; for the temperatures.
            warm_ground: Shift [x, y] of the ground that a lying deer has warmed, metres; None for none.

    Raises:
        ModelError: A parameter is unknown or outside its range.
    """
    p = _checked(params)
    skeleton = _skeleton(p["pose"], p["variant"], p["phase"])
    young = p["age"] == "young"
    shape = _with_crown(_body(skeleton, _body_of(p)), "none" if young else p["antlers"], p["antler_form"])
    v = shape.vertices
    v = _rotated_about_vertical(v, shape.poll, float(p["head_turn_rad"]) * shape.head_weight)
    v = _rotated_about_vertical(v, shape.neck_pivot, float(p["neck_turn_rad"]) * shape.neck_weight)
    bend = skeleton.bend_rad + (0.3 if skeleton.asleep else 1.0) * float(p["spine_bend_rad"])
    if abs(bend) > _STRAIGHT_RAD:
        v = _bent(v, bend)
    triangles = shape.triangles.copy()
    if p["mirror"]:
        v, triangles = mirrored(v, triangles)
    height = float(p["shoulder_height_m"])
    length = float(p["length_factor"]) * (_YOUNG_LENGTH if young else 1.0)
    scale = np.array([length, float(p["width_factor"]), 1.0]) * height
    return warm_ground.with_warm_ground(finished((v * scale, triangles, shape.parts), PART_NAMES), p)


def sample(rng: np.random.Generator, options: Params) -> Params:
    """Draw the parameters of one deer, JSON values only.

    Every call takes the same numbers from `rng`, so fixing an option leaves the rest as it would have been drawn. The
    option `bend_deg` alone takes one more, after all others.
    """
    _CHECKS.known("option", options, tuple(OPTIONS))
    u = [float(x) for x in rng.random(12)]
    pose = pick(*_CHECKS.weighted("option pose", options.get("pose", DRAWN_POSES), POSES, _POSE_ODDS), u[0])
    antlers = _antler_option(options.get("antlers"), u[1])
    ages, age_odds = _CHECKS.weighted("option age", options.get("age", "adult"), AGES, _AGE_ODDS)
    age = pick(ages, age_odds, 1000.0 * u[2] % 1.0)
    drawn_m = DRAWN_HEIGHT_M if age == "adult" else YOUNG_HEIGHT_M
    low, high = _CHECKS.range_of_kind("shoulder_height_m", options, age, ages, SHOULDER_HEIGHT_M, drawn_m)
    height = low + (high - low) * u[2]
    builds = _CHECKS.some_of("option build", options.get("build", BUILDS), BUILDS)
    # Tall deer carry large antlers and a sturdy build more often.
    tall = min(max((height - 0.7) / 0.5, 0.0), 1.0)
    forms = _CHECKS.some_of("option antler_form", options.get("antler_form", ANTLER_FORMS), ANTLER_FORMS)
    odds = {"spike": 0.15, "roe": 0.05 + 0.6 * (1 - tall), "white-tailed": 0.35, "red": 0.05 + 0.6 * tall}
    turn = TURN_RAD[pose]
    neck_turn = turn * (u[8] + u[9] - 1.0)
    bend = {}
    if "bend_deg" in options:
        least, most = _CHECKS.number_range("option bend_deg", options["bend_deg"], *BEND_DEG)
        angle = np.deg2rad(least + (most - least) * float(rng.random()))
        # A deer that looks aside bends its whole body to that side.
        bend = {"spine_bend_rad": float(np.copysign(angle, neck_turn))}
    return {
        "pose": pose,
        "variant": pick(VARIANTS[pose], [1.0] * len(VARIANTS[pose]), u[3]),
        "build": pick(builds, [0.75 - 0.4 * tall if b == "slender" else 0.25 + 0.4 * tall for b in builds], u[4]),
        "antlers": antlers if age == "adult" else "none",
        "antler_form": pick(forms, [odds[f] for f in forms], u[5]),
        "shoulder_height_m": height,
        "length_factor": 0.94 + 0.12 * u[6],
        "width_factor": 0.93 + 0.16 * u[7],
        # The mean of two draws: usually straight ahead, seldom far to the side.
        "neck_turn_rad": neck_turn,
        "head_turn_rad": HEAD_TURN_RAD * (2.0 * u[10] - 1.0) * (0.3 if pose == "sleeping" else 1.0),
        "mirror": u[11] < 0.5,
        "time_of_day": _CHECKS.one_of("option time_of_day", options.get("time_of_day", "night"), TIMES),
        **({} if age == "adult" else {"age": age}),
        **bend,
        **warm_ground.drawn(rng, options, _CHECKS, pose in ("lying", "sleeping")),
    }


# Shoulder height: roe deer 0.65-0.75 m, white-tailed 0.8-1.0 m, red deer 1.0-1.2 m.
DRAWN_HEIGHT_M = (0.7, 1.2)
YOUNG_HEIGHT_M = (0.35, 0.7)  # a roe fawn of some weeks to a red calf of some months
_POSE_ODDS = {"standing": 0.30, "walking": 0.25, "grazing": 0.30, "lying": 0.15, "running": 0.1, "sleeping": 0.1}
_AGE_ODDS = {"adult": 0.7, "young": 0.3}
_ANTLER_ODDS = {"none": 0.5, "hard": 0.38, "velvet": 0.12}
OPTIONS: Mapping[str, str] = {
    "pose": "one of "
    + ", ".join(POSES)
    + ", a list of several, or each with its weight; by default "
    + ", ".join(DRAWN_POSES),
    "antlers": "true, false, none, hard or velvet; by default half of the deer have antlers",
    "antler_form": "one of " + ", ".join(ANTLER_FORMS) + ", or a list of several",
    "build": "one of " + ", ".join(BUILDS) + ", or a list of several",
    "age": "adult or young, a list of both, or each with its weight; by default adult. The young have long legs, "
    "a short trunk, a round head and no antlers",
    "shoulder_height_m": "a number from 0.4 to 1.6, or [low, high]; by default [0.7, 1.2]. Young ones: 0.25 to 0.9, by "
    "default [0.35, 0.7]",
    "bend_deg": "angle between hips and shoulders seen from above, 0 to 70 degrees, or [low, high]; by default 0",
    "time_of_day": "day, dusk, night or dawn: by day the sun warms the coat; by default as in the background, or night",
    warm_ground.PARAM: warm_ground.OPTION,
}


def _antler_option(value: object, share: float) -> str:
    if value is None:
        return pick(ANTLERS, [_ANTLER_ODDS[a] for a in ANTLERS], share)
    if isinstance(value, bool):
        return "hard" if value else "none"
    if not isinstance(value, str) or value not in ANTLERS:
        raise _CHECKS.bad("option antlers", value, OPTIONS["antlers"])
    return value


def animate(params: Params, phase: float) -> Params:
    """Return the parameters of a walking or running deer at a phase; of others, as they are."""
    return {**params, "phase": moment(phase)} if params["pose"] in _GAITS else dict(params)


def stride_m(params: Params) -> float:
    """Return how far a deer goes in a step of each leg, 0 for one that neither walks nor runs."""
    p = _checked(params)
    if p["pose"] not in _GAITS:
        return 0.0
    size = _body(_skeleton(p["pose"], p["variant"], 0.0), _body_of(p)).size
    length = p["length_factor"] * (_YOUNG_LENGTH if p["age"] == "young" else 1.0)
    return float(_GAITS[p["pose"]].stride * size * length * p["shoulder_height_m"])


MODEL = ObjectModel(
    name="deer",
    category="deer",
    description="A deer from roe to red deer in size, adult or young: standing, walking, grazing, lying, sleeping, ...",
    origin="on the ground between the feet; for a lying deer, below the middle of its trunk",
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
