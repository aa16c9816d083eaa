"""Skeleton of the person model: joints of each pose, and of each moment of a step.

Lengths are in units of the body height, +X forward, +Y left, +Z up. Poses are tables of a few joints each; a gait is a
function of its phase. Both stay within human limits: knees and elbows only bend one way, hips flex up to 125 degrees,
necks tilt up to 45.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from infrablend.assets.anatomy import Gait, joint, smoothstep, spline, unit
from infrablend.assets.shapes import turn_y
from infrablend.core.mesh import FloatArray

# Pose -> its variants. Those of `DRAWN` are drawn where no option names a pose.
VARIANTS: Mapping[str, tuple[str, ...]] = {
    "standing": ("upright", "relaxed", "apart"),
    "walking": ("contact", "passing", "swing", "push-off"),
    "sitting": ("seat", "cross-legged", "knees-up"),
    "lying": ("back", "back-knee-up", "back-spread", "side", "side-curled", "front", "front-arm-up"),
    "crouching": ("squat", "kneel", "heels"),
    "crawling": ("hands-and-knees", "creep"),
    "waving": ("one-arm", "both-arms"),
    "running": ("landing", "support", "take-off", "recovery"),
}
POSES = tuple(VARIANTS)
DRAWN_POSES = ("standing", "walking", "sitting")
WADING = ("standing", "walking", "waving")  # poses in which people are in water
# Pose -> what the arms may do there; "natural" hangs, swings or rests with the pose.
ARMS: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(POSES, ("natural",)),
    "standing": ("natural", "phone", "call", "bent", "pockets"),
    "walking": ("natural", "phone", "call", "bent", "pockets"),
    "sitting": ("natural", "phone", "call"),
}

THIGH = 0.245
SHANK = 0.246
UPPER_ARM = 0.178
FOREARM = 0.150
HIP_Y, HIP_Z = 0.052, 0.528
SHOULDER = (-0.006, 0.112, 0.792)
NECK = np.array([-0.012, 0.0, 0.838])

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Foot:
    """Position of the ankle, how far the toes point up and outward, and the direction of the knee."""

    ankle: Point
    toe_up_rad: float = 0.0
    toe_out_rad: float = 0.12
    knee: Point = (1.0, 0.0, 0.0)


@dataclass(frozen=True)
class Arm:
    """Position of a left arm when standing; for a right arm, y is negated.

    Attributes:
        wrist: Position in the frame of the trunk.
        elbow: Direction in which the elbow points.
        palm: Direction that the palm faces.
        hand: Direction of the fingers; by default that of the forearm.
        hidden: Whether the hand is in a pocket.
        planted: Whether the hand rests on the ground, so that thick clothes do not push it out.
    """

    wrist: Point
    elbow: Point = (-1.0, 0.45, 0.0)
    palm: Point = (0.0, -1.0, 0.0)
    hand: Point | None = None
    hidden: bool = False
    planted: bool = False


Arms = tuple[Arm, Arm]
"""Left and right arm."""


@dataclass(frozen=True)
class Pose:
    """Free parameters of the skeleton in one pose.

    Attributes:
        hip: x and z of the midpoint of the hip joints.
        feet: Left and right foot.
        arms: What "natural" stands for in this pose.
        lean_rad: Forward lean of the trunk.
        nod_rad: Forward nod of the head.
        folded: Whether the hips are bent so far that clothes lie along the thighs.
        middle_x: x of the model's origin; None for the middle between the feet.
        rests_on: Side of the body that lies on the ground: back, right side or front. Everything is then in the frame
            of a standing body, which has no ground.
        tilt_rad: Tilt of trunk and head to the left.
        neck_rad: Forward bend of the neck in addition to that of the head.
        turn_rad: Turn of the head to the left.
        loose: Share of an individual's own lean, nod and turn that the pose leaves.
    """

    hip: tuple[float, float]
    feet: tuple[Foot, Foot]
    arms: Arms
    lean_rad: float = 0.0
    nod_rad: float = 0.05
    folded: bool = False
    middle_x: float | None = None
    rests_on: str = ""
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    neck_rad: float = 0.0
    turn_rad: float = 0.0
    loose: float = 1.0


def _swing(x: float, z: float) -> Arm:
    return Arm((x, 0.146, z), (-1.0, 0.35, -0.2))


def _raised(wave: float) -> Arm:
    """Return an arm above the head; `wave` from -1 (inward) to 1 (outward)."""
    angle = 0.36 + 0.34 * wave
    shoulder_x, shoulder_y, shoulder_z = SHOULDER
    reach = 0.31
    wrist = (shoulder_x + 0.03, shoulder_y + reach * math.sin(angle), shoulder_z + reach * math.cos(angle))
    return Arm(wrist, (-0.2, 1.0, -0.2), (1.0, 0.0, 0.0))


_HANGING = Arm((0.028, 0.150, 0.475))
_PHONE = Arm((0.150, 0.042, 0.668), (-0.6, 0.7, -1.0), (-0.5, -0.3, 0.8), (0.75, -0.35, 0.5))
_CALL = Arm((0.040, 0.078, 0.845), (0.35, 0.8, -1.0), (-0.2, -1.0, 0.0), (-0.1, -0.05, 1.0))
_LAP = Arm((0.165, 0.080, 0.590), (-0.7, 0.8, -0.4), (0.0, 0.0, -1.0), (1.0, -0.15, -0.05))
_ON_BACK = Arm((-0.038, 0.235, 0.512), (-0.5, 1.0, 0.0), (0.6, -1.0, 0.0))
_ON_FRONT = Arm((0.040, 0.220, 0.505), (0.3, 1.0, 0.0), (-0.6, -1.0, 0.0))
_ON_HANDS = Arm((0.310, 0.115, 0.7315), (-0.248, 0.4, -0.969), (0.969, 0.0, -0.248), (0.248, 0.0, 0.969), planted=True)
ARM_PAIRS: Mapping[str, Arms] = {
    "hanging": (_HANGING, Arm((0.040, 0.148, 0.477))),
    "contact": (_swing(-0.130, 0.510), _swing(0.165, 0.545)),
    "passing": (_swing(0.035, 0.482), _swing(0.015, 0.478)),
    "swing": (_swing(0.095, 0.505), _swing(-0.055, 0.482)),
    "push-off": (_swing(0.150, 0.535), _swing(-0.115, 0.503)),
    "lap": (_LAP, _LAP),
    "knees": (
        Arm((0.215, 0.055, 0.665), (-0.2, 1.0, -0.5), (-1.0, 0.0, -0.2), (0.3, -1.0, -0.2)),
        Arm((0.225, 0.050, 0.690), (-0.2, 1.0, -0.5), (-1.0, 0.0, -0.2), (0.3, -1.0, -0.2)),
    ),
    "phone": (_PHONE, _PHONE),
    "call": (_HANGING, _CALL),
    "bent": (_HANGING, Arm((0.135, 0.070, 0.640), (-0.7, 0.7, -0.6), (-0.6, -0.2, -0.5), (0.5, -1.0, 0.15))),
    "pockets": (Arm((0.062, 0.112, 0.548), (-1.0, 0.8, 0.0), hidden=True),) * 2,
    "one-arm": (_raised(0.0), _HANGING),
    "both-arms": (_raised(-0.3), _raised(-0.3)),
}
_DOWN_RAD = -math.pi / 2  # toes straight down, and the sole backward: flat on the ground for someone lying on the back
_POSES: Mapping[tuple[str, str], Pose] = {
    ("standing", "upright"): Pose(
        (0, 0.528), (Foot((0, 0.058, 0.045)), Foot((0, -0.058, 0.045))), ARM_PAIRS["hanging"]
    ),
    ("standing", "relaxed"): Pose(
        (0, 0.526), (Foot((-0.02, 0.05, 0.045)), Foot((0.075, -0.085, 0.045), 0.0, 0.5)), ARM_PAIRS["hanging"]
    ),
    ("standing", "apart"): Pose(
        (0, 0.522), (Foot((0.01, 0.105, 0.045), 0.0, 0.3), Foot((-0.01, -0.105, 0.045), 0.0, 0.3)), ARM_PAIRS["hanging"]
    ),
    ("walking", "contact"): Pose(
        (0, 0.510), (Foot((0.165, 0.045, 0.058), 0.35), Foot((-0.185, -0.045, 0.105), -0.61)), ARM_PAIRS["contact"],
        0.06,
    ),
    ("walking", "passing"): Pose(
        (0, 0.525), (Foot((0.0, 0.040, 0.045)), Foot((-0.105, -0.045, 0.150), -0.85)), ARM_PAIRS["passing"], 0.07
    ),
    ("walking", "swing"): Pose(
        (0, 0.523), (Foot((-0.070, 0.042, 0.045)), Foot((0.085, -0.045, 0.075), -0.05)), ARM_PAIRS["swing"], 0.07
    ),
    ("walking", "push-off"): Pose(
        (0, 0.512), (Foot((-0.140, 0.042, 0.075), -0.30), Foot((0.155, -0.045, 0.078), 0.25)), ARM_PAIRS["push-off"],
        0.06,
    ),
    ("sitting", "seat"): Pose(
        (0, 0.285),
        (
            Foot((0.250, 0.075, 0.045), 0.0, 0.2, (1.0, 0.0, 1.0)),
            Foot((0.275, -0.070, 0.045), 0.0, 0.1, (1.0, 0.0, 1.0)),
        ),
        ARM_PAIRS["lap"], 0.06, 0.15, folded=True, middle_x=0.0,
    ),
    ("sitting", "cross-legged"): Pose(
        (0, 0.072),
        (
            Foot((0.150, -0.040, 0.042), -0.1, -1.35, (0.45, 1.0, 0.25)),
            Foot((0.205, 0.050, 0.042), -0.1, -1.35, (0.55, -1.0, 0.25)),
        ),
        ARM_PAIRS["lap"], 0.20, 0.15, folded=True, middle_x=0.0,
    ),
    ("sitting", "knees-up"): Pose(
        (0, 0.072),
        (
            Foot((0.260, 0.060, 0.045), 0.0, 0.1, (0.0, 0.15, 1.0)),
            Foot((0.240, -0.060, 0.045), 0.0, 0.1, (0.0, -0.15, 1.0)),
        ),
        ARM_PAIRS["knees"], 0.22, 0.10, folded=True, middle_x=0.0,
    ),
    ("lying", "back"): Pose(
        (0, 0.528),
        (
            Foot((-0.018, 0.085, 0.048), -0.5, 0.55, (1, 0.3, 0)),
            Foot((-0.018, -0.070, 0.046), -0.45, 0.45, (1, -0.3, 0)),
        ),
        (_ON_BACK, Arm((-0.035, 0.190, 0.490), (-0.5, 1.0, 0.0), (0.4, -1.0, 0.0))),
        0.0, -0.02, middle_x=0.0, rests_on="back", loose=0.3,
    ),
    ("lying", "back-knee-up"): Pose(
        (0, 0.528),
        (
            Foot((-0.030, 0.075, 0.230), _DOWN_RAD, 0.1, (1, 0.25, 0)),
            Foot((-0.018, -0.090, 0.046), -0.45, 0.6, (1, -0.3, 0)),
        ),
        (Arm((0.085, 0.020, 0.660), (-0.6, 1.0, -0.3), (-1.0, 0.0, 0.0)), _ON_BACK),
        0.0, -0.02, middle_x=0.0, rests_on="back", loose=0.3,
    ),
    ("lying", "back-spread"): Pose(
        (0, 0.528),
        (
            Foot((-0.018, 0.170, 0.060), -0.5, 0.7, (1, 0.3, 0)),
            Foot((-0.018, -0.150, 0.058), -0.45, 0.6, (1, -0.3, 0)),
        ),
        (
            Arm((-0.032, 0.395, 0.700), (-0.5, 0.0, -1.0), (1.0, 0.0, 0.0)),
            Arm((-0.022, 0.260, 0.960), (-0.3, 1.0, 0.0), (1.0, 0.0, 0.0)),
        ),
        0.0, -0.02, middle_x=0.0, rests_on="back", loose=0.3,
    ),
    ("lying", "side"): Pose(
        (0, 0.528),
        (Foot((0.110, -0.060, 0.190), -0.4, 0.0, (1, 0, 0.3)), Foot((-0.060, -0.072, 0.050), -0.5, 0.0)),
        (
            Arm((0.185, -0.045, 0.700), (0.2, 0.9, -0.8), (-0.3, -1.0, 0.0), (0.8, -0.2, 0.5)),
            Arm((0.130, 0.085, 0.930), (1.0, -0.1, -0.3), (0.0, -1.0, 0.0)),
        ),
        0.05, 0.12, middle_x=0.0, rests_on="right side", tilt_rad=(0.15, -0.30), loose=0.3,
    ),
    ("lying", "side-curled"): Pose(
        (0, 0.528),
        (
            Foot((0.055, -0.010, 0.270), -0.5, 0.0, (1, 0, 0.6)),
            Foot((0.020, -0.075, 0.245), -0.5, 0.0, (1, 0, 0.6)),
        ),
        (
            Arm((0.200, -0.015, 0.760), (0.2, 1.0, -0.6), (0.0, -1.0, 0.0), (0.3, -0.2, 1.0)),
            Arm((0.130, 0.080, 0.900), (1.0, -0.15, -0.6), (0.0, -1.0, 0.0)),
        ),
        0.30, 0.35, folded=True, middle_x=0.0, rests_on="right side", tilt_rad=(0.15, -0.30), neck_rad=0.2, loose=0.3,
    ),
    ("lying", "front"): Pose(
        (0, 0.528),
        (Foot((0.042, 0.075, 0.041), -1.25, 0.0, (1, 0.2, 0)), Foot((0.042, -0.085, 0.042), -1.3, 0.0, (1, -0.2, 0))),
        (_ON_FRONT, _ON_FRONT),
        0.0, 0.0, middle_x=0.0, rests_on="front", neck_rad=0.15, turn_rad=1.15, loose=0.1,
    ),
    ("lying", "front-arm-up"): Pose(
        (0, 0.528),
        (
            Foot((0.042, 0.150, 0.230), -1.2, 0.2, (0.1, 1, 0.1)),
            Foot((0.042, -0.085, 0.042), -1.3, 0.0, (1, -0.2, 0)),
        ),
        (Arm((0.025, 0.215, 0.985), (0.1, 1.0, -0.2), (1.0, 0.0, 0.0)), _ON_FRONT),
        0.0, 0.0, middle_x=0.0, rests_on="front", neck_rad=0.15, turn_rad=1.15, loose=0.1,
    ),
    ("crouching", "squat"): Pose(
        (-0.125, 0.190),
        (
            Foot((0.0, 0.085, 0.045), 0.0, 0.35, (1, 0.35, 0.4)),
            Foot((0.015, -0.085, 0.045), 0.0, 0.35, (1, -0.35, 0.4)),
        ),
        (Arm((0.215, 0.078, 0.715), (-0.2, 1.0, -0.6), (-0.3, -1.0, -0.2)),) * 2,
        0.50, 0.15, folded=True, middle_x=-0.04,
    ),
    ("crouching", "kneel"): Pose(
        (-0.060, 0.288),
        (
            Foot((0.140, 0.070, 0.045), 0.0, 0.1, (1, 0.15, 0.6)),
            Foot((-0.290, -0.060, 0.100), -1.2, 0.0, (0.6, 0, -1)),
        ),
        (
            Arm((0.135, 0.085, 0.650), (-0.7, 0.8, -0.4), (0.0, 0.0, -1.0), (1.0, -0.1, -0.2)),
            Arm((0.080, 0.150, 0.500)),
        ),
        0.22, 0.20, folded=True, middle_x=-0.04,
    ),
    ("crouching", "heels"): Pose(
        (-0.170, 0.165),
        (
            Foot((-0.200, 0.055, 0.038), -2.75, 0.0, (1, 0.2, -0.3)),
            Foot((-0.200, -0.055, 0.038), -2.75, 0.0, (1, -0.2, -0.3)),
        ),
        ARM_PAIRS["lap"], 0.15, 0.15, folded=True, middle_x=-0.10,
    ),
    ("crawling", "hands-and-knees"): Pose(
        (-0.170, 0.284),
        (
            Foot((-0.410, 0.075, 0.036), -2.75, 0.0, (0.5, 0, -1)),
            Foot((-0.410, -0.075, 0.036), -2.75, 0.0, (0.5, 0, -1)),
        ),
        (_ON_HANDS, _ON_HANDS),
        1.335, 0.20, folded=True, middle_x=-0.10, neck_rad=0.75, loose=0.0,
    ),
    ("crawling", "creep"): Pose(
        (-0.170, 0.280),
        (
            Foot((-0.350, 0.075, 0.036), -2.75, 0.0, (0.6, 0, -1)),
            Foot((-0.460, -0.075, 0.040), -2.75, 0.0, (0.4, 0, -1)),
        ),
        (
            replace(_ON_HANDS, wrist=(0.317, 0.115, 0.7605)),
            replace(_ON_HANDS, wrist=(0.295, 0.115, 0.6735)),
        ),
        1.32, 0.20, folded=True, middle_x=-0.10, neck_rad=0.75, loose=0.0,
    ),
    ("waving", "one-arm"): Pose(
        (0, 0.526), (Foot((-0.02, 0.07, 0.045)), Foot((0.03, -0.075, 0.045), 0.0, 0.3)), ARM_PAIRS["one-arm"], 0.0, -0.1
    ),
    ("waving", "both-arms"): Pose(
        (0, 0.522), (Foot((0.01, 0.105, 0.045), 0.0, 0.3), Foot((-0.01, -0.105, 0.045), 0.0, 0.3)),
        ARM_PAIRS["both-arms"], 0.0, -0.1,
    ),
}  # fmt: skip


@dataclass(frozen=True)
class _Gait:
    """One way to move on two legs; shares are of the cycle, which has one step of each foot.

    Attributes:
        stride: Distance that the body moves in one cycle.
        stance: Share of the cycle in which a foot is on the ground.
        ahead: Distance by which the middle of the stance lies in front of the hips.
        toe_up_rad: Pitch of the foot when it lands and when it leaves the ground.
        flat: Shares of the stance from which and until which the whole sole is on the ground.
        swing: Ankle (x, z) and pitch of a foot in the air, at equal times between leaving and landing.
        hip: Mean height of the hips, and how far they rise above it in the middle of a stance.
        lean_rad: Forward lean of the trunk.
        arms: Wrist (x, y, z) at the back, in the middle and in front.
    """

    stride: float
    stance: float
    ahead: float
    toe_up_rad: tuple[float, float]
    flat: tuple[float, float]
    swing: tuple[Point, ...]
    hip: tuple[float, float]
    lean_rad: float
    arms: tuple[Point, Point, Point]


GAITS: Mapping[str, _Gait] = {
    "walking": _Gait(
        0.72, 0.61, -0.005, (0.33, -0.72), (0.14, 0.55),
        ((-0.105, 0.135, -0.75), (0.035, 0.090, -0.20), (0.165, 0.075, 0.22)),
        (0.5105, 0.0095), 0.06,
        ((-0.130, 0.146, 0.510), (0.018, 0.146, 0.477), (0.165, 0.146, 0.545)),
    ),
    "running": _Gait(
        1.10, 0.42, -0.025, (0.12, -0.85), (0.10, 0.40),
        ((-0.270, 0.230, -1.35), (-0.150, 0.290, -1.20), (0.050, 0.215, -0.45), (0.190, 0.130, 0.05)),
        (0.486, -0.012), 0.14,
        ((-0.090, 0.165, 0.610), (0.090, 0.150, 0.600), (0.185, 0.085, 0.700)),
    ),
}  # fmt: skip
_CRAWL = Gait(0.28, 0.62, (0.0, 0.5, 0.5, 0.0), 0.05)  # hands as fore legs: each moves with the knee of the other side
# Pose -> distance that one cycle takes a person, in units of the height.
STRIDES: Mapping[str, float] = {**{pose: gait.stride for pose, gait in GAITS.items()}, "crawling": _CRAWL.stride}
# Round places of a sole that touch the ground as the foot rolls: x and z from the ankle, radius.
_HEEL = (-0.030, -0.022, 0.026)
_BALL = (0.090, -0.029, 0.020)
_SOLE_Z = 0.045
# Moments of a running step that are poses of their own.
_RUNNING = {"landing": 0.0, "support": 0.18, "take-off": 0.40, "recovery": 0.62}
WAVES_HZ = 1.1  # how often waving arms swing from side to side and back


def moves(pose: str) -> bool:
    """Return whether people in a pose have a phase."""
    return pose in STRIDES or pose == "waving"


def skeleton(pose: str, variant: str, phase: float | None = None) -> Pose:
    """Return the skeleton of a variant, or that of a moving person at a phase in [0, 1).

    Phase 0 of a gait is where the left foot lands.
    """
    if pose == "running" and phase is None:
        phase = _RUNNING[variant]
    if phase is None:
        return _POSES[pose, variant]
    if pose == "waving":
        arm = _raised(-0.3 + 0.7 * math.sin(2 * math.pi * phase))
        still = _POSES[pose, variant]
        return replace(still, arms=(arm, still.arms[1] if variant == "one-arm" else arm))
    return _crawling(phase) if pose == "crawling" else _stepping(GAITS[pose], phase)


def _stepping(gait: _Gait, phase: float) -> Pose:
    feet = []
    for sign, own in ((1, phase % 1.0), (-1, (phase + 0.5) % 1.0)):
        x, z, toe_up = _step(gait, own)
        feet.append(Foot((float(x), 0.043 * sign, float(z)), float(toe_up)))
    mean, rise = gait.hip
    hip = mean + rise * math.cos(4 * math.pi * (phase - 0.5 * gait.stance))
    back, middle, front = (np.array(p) for p in gait.arms)
    arms = []
    for forward in (-math.cos(2 * math.pi * phase), math.cos(2 * math.pi * phase)):
        wrist = middle + 0.5 * forward * (front - back) + forward**2 * (0.5 * (front + back) - middle)
        arms.append(Arm((float(wrist[0]), float(wrist[1]), float(wrist[2])), (-1.0, 0.35, -0.2)))
    return Pose((0.0, hip), (feet[0], feet[1]), (arms[0], arms[1]), gait.lean_rad, middle_x=0.0)


def _crawling(phase: float) -> Pose:
    still = _POSES["crawling", "hands-and-knees"]
    hip_x, hip_z = still.hip[0], 0.275
    left, right, *knees = _CRAWL.legs(phase)
    arms = []
    for hand in (left, right):
        # The hips are lower than on all fours at rest, and hands reach as far back as forward.
        x, y, z = _ON_HANDS.wrist + turn_y(-still.lean_rad) @ [hand.dx - 0.02, 0.0, hand.dz + still.hip[1] - hip_z]
        arms.append(replace(_ON_HANDS, wrist=(float(x), float(y), float(z))))
    feet = [
        replace(foot, ankle=(hip_x + knee.dx - 0.243, foot.ankle[1], 0.036 + 0.6 * knee.dz))
        for foot, knee in zip(still.feet, knees, strict=True)
    ]
    return replace(still, hip=(hip_x, hip_z), arms=(arms[0], arms[1]), feet=(feet[0], feet[1]))


def _step(gait: _Gait, phase: float) -> FloatArray:
    """Return x and z of the ankle and the pitch of the foot at a phase of its own, which begins where it lands."""
    if phase <= gait.stance:
        return _on_ground(gait, phase)
    count = len(gait.swing) + 1
    pace = (1.0 - gait.stance) / count
    # One point before and one after the swing are on the ground, so the foot does not jerk where it leaves or lands.
    keys = [_on_ground(gait, t) for t in (gait.stance - pace, gait.stance)]
    keys += [np.array(key) for key in gait.swing]
    keys += [_on_ground(gait, t) for t in (0.0, pace)]
    return spline(np.array(keys), 1.0 + (phase - gait.stance) / pace)


def _on_ground(gait: _Gait, phase: float) -> FloatArray:
    """Return x and z of the ankle and the pitch of a foot that rolls over the ground without sliding."""
    share = phase / gait.stance
    first, last = gait.flat
    ramp = smoothstep(np.array([1.0 - share / first, (share - last) / (1.0 - last)]))
    toe_up = float(gait.toe_up_rad[0] * ramp[0] + gait.toe_up_rad[1] * ramp[1])
    x, z, radius = _HEEL if toe_up > 0 else _BALL
    turned = turn_y(-toe_up) @ np.array([x, 0.0, z])
    ground = _SOLE_Z + z - radius  # where a flat sole has this place, it is cut off
    middle = gait.stride * (0.5 * gait.stance - phase) + gait.ahead
    return np.array([middle + x - radius * toe_up - turned[0], radius + ground - turned[2], toe_up])


def limb_joint(a: FloatArray, b: FloatArray, upper: float, lower: float, toward: Point) -> FloatArray:
    """Return the joint between two bones, on the side that `toward` points to."""
    direction = unit(b - a)
    side = np.asarray(toward, np.float64)
    return joint(a, b, (upper, lower), unit(side - (side @ direction) * direction))


def leg_lines(pose: Pose) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Return hip, knee and ankle of the left and the right leg."""
    lines = []
    for sign, foot in zip((1, -1), pose.feet, strict=True):
        hip = np.array([pose.hip[0], HIP_Y * sign, pose.hip[1]])
        ankle = np.array(foot.ankle)
        lines.append((hip, limb_joint(hip, ankle, THIGH, SHANK, foot.knee), ankle))
    return lines


# Of children: height, and the shares of it from the ground to the hips and from the base of the neck to the crown.
_GROWTH = np.array(
    [
        [0.80, 0.420, 0.264],
        [0.95, 0.458, 0.234],
        [1.15, 0.490, 0.204],
        [1.40, 0.518, 0.179],
        [1.50, 0.525, 0.170],
    ]
)


def child_factors(height_m: float) -> tuple[float, float]:
    """Return the factors of a child's legs and head beside the trunk, compared with an adult's.

    Shares follow growth charts: sitting height is 61 % of the height at 0.8 m and 52 % at 1.5 m, the head is a fifth of
    the height at 0.8 m and an eighth at 1.5 m.
    """
    legs, head = (float(np.interp(height_m, _GROWTH[:, 0], _GROWTH[:, k])) for k in (1, 2))
    trunk = 1.0 - legs - head
    own = 1.0 - _GROWTH[-1, 1] - _GROWTH[-1, 2]
    return float(legs / trunk * own / _GROWTH[-1, 1]), float(head / trunk * own / _GROWTH[-1, 2])
