"""Person model, grown from a skeleton: an adult or child in light to thick clothes, in many poses (`person_poses`).

All lengths are in units of the body height (about 1.75 m), +X forward, +Y left, +Z up; `build` scales them to metres at
the end. The body consists of closed pieces that overlap where clothes do: jacket with its sleeves, trousers or bare
legs, the skirt of a coat, shoes and head are implicit surfaces (`assets.implicit`); hands, cap visor, backpack and seat
are lofts. Each piece depends on few parameters (the jacket on cut, arms and build, but not on the pose), so pieces are
cached and shared between persons; the lean of the trunk, the nod and turn of the head, width, mirroring and height are
applied to the vertices afterwards.

Measured on one core: 0.1-0.3 s of CPU time for a person without cached pieces, 1 ms with all pieces cached; 13,000 to
20,000 triangles.

Proportions: segment lengths divided by height after Drillis and Contini (hip 0.530, knee 0.285, shoulder 0.818, chin
0.870, upper arm 0.186, forearm 0.146, foot 0.152), with joints moved in slightly; clothes add 1-2.5 % of the height all
around.

Temperatures: see `PARTS`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np

from infrablend.assets import warm_ground
from infrablend.assets.anatomy import Piece, above_water, finished, joined, mirrored, smoothstep, unit
from infrablend.assets.implicit import Body, Primitive, concatenate, ellipsoid, surface, tube
from infrablend.assets.model import (
    LOW_SUN,
    TIMES,
    ObjectModel,
    Params,
    PartRange,
    SunResponse,
    at_low_sun,
    moment,
    part_role,
    sun_response,
    warmed_by_sun,
)
from infrablend.assets.params import Checks, pick
from infrablend.assets.person_poses import (
    ARM_PAIRS,
    ARMS,
    DRAWN_POSES,
    FOREARM,
    HIP_Z,
    NECK,
    POSES,
    SHOULDER,
    STRIDES,
    UPPER_ARM,
    VARIANTS,
    WADING,
    WAVES_HZ,
    Arm,
    Arms,
    Pose,
    child_factors,
    leg_lines,
    limb_joint,
    moves,
    skeleton,
)
from infrablend.assets.shapes import Solid, box, circle, loft, moved, sweep, turn_x, turn_y, turn_z
from infrablend.assets.shapes import ellipsoid as ellipsoid_solid
from infrablend.core.mesh import FloatArray, Mesh
from infrablend.core.surface_kinds import Affinity

ALL_ARMS = ARMS["standing"]
AGES = ("adult", "child")
TOPS = ("jacket", "puffer", "coat")
BOTTOMS = ("trousers", "skirt")
HEADWEAR = ("none", "beanie", "cap", "hood", "helmet")
HAIR = ("short", "long")
LENGTHS = ("long", "short")  # of sleeves and trousers: short ones leave forearms and lower legs bare
BUILDS = ("slim", "average", "heavy")
HEIGHTS_M: Mapping[str, tuple[float, float]] = {"adult": (1.4, 2.1), "child": (0.8, 1.5)}
DRAWN_HEIGHT_M = (1.5, 1.95)

# Surface minus air in cool weather of about -5..+12 C. Skin of 24-34 C is +14..+29 K at 5-10 C; nose and ears cool
# first. Winter clothing is +2..+8 K, neck and collar gap are hot, hat and hood are cooler. Cloth, hair and skin are
# rough or matt at this scale: no Fresnel rim, ior 1.
PARTS: Mapping[str, PartRange] = {
    "face": part_role("skin", (14.0, 24.0), "bare skin, 24-34 C"),
    "nose": part_role("skin", (10.0, 20.0), "nose: cools first in cold air"),
    "ear": part_role("skin", (9.0, 20.0), "ears: cool like the nose"),
    "neck": part_role("skin", (15.0, 25.0), "neck and collar gap: hot"),
    "hand": part_role("skin", (10.0, 22.0), "bare skin, 24-34 C"),
    "forearm": part_role("skin", (10.0, 20.0), "bare skin below a short sleeve: cooler than the face"),
    "shin": part_role("skin", (8.0, 18.0), "bare skin below short trousers: cooler than the forearm"),
    "leg": part_role("cloth", (6.0, 14.0), "thin stocking over skin, between skin and clothing"),
    "hair": part_role("hair", (5.0, 11.0), "between skin and air"),
    "hat": part_role("cloth", (3.0, 7.0), "hat: cooler than hair"),
    "hood": part_role("cloth", (2.0, 6.0), "hood: cooler than hair"),
    "collar": part_role("cloth", (4.0, 9.0), "collar: warm air escapes here"),
    "jacket": part_role("cloth", (2.0, 7.0), "winter clothing +2..+8 K"),
    "sleeve": part_role("cloth", (2.5, 7.5), "winter clothing +2..+8 K"),
    "coat_skirt": part_role(
        "cloth", (1.8, 6.0), "skirt or lower half of a coat, free of the body: low end of winter clothing"
    ),
    "trousers": part_role("cloth", (3.0, 8.0), "trousers: one layer, close to the leg"),
    "shoe": part_role("leather", (1.5, 5.0), "shoes: thick, in contact with the ground; low end of winter clothing"),
    "backpack": part_role("cloth", (0.0, 2.5), "backpack: away from the body, near air temperature"),
    "strap": part_role("cloth", (1.5, 5.0), "straps on the jacket"),
    "seat": part_role(
        "wood", (-1.0, 1.0), "seat: wood or stone at air temperature; not part of the person", label=False
    ),
    "helmet": part_role("plastic", (0.5, 4.0), "matt shell away from the head, near air temperature", ior=1.0),
    "laid_backpack": part_role("cloth", (-1.0, 1.5), "backpack on the ground; not part of the person", label=False),
}
# One or two thin layers in mild weather: the upper end of the +3..+10 K of summer clothing. Skin of 24-34 C is not
# chilled, and warms hair and collar.
_LIGHT: Mapping[str, tuple[float, float]] = {
    "face": (16.0, 26.0), "nose": (12.0, 22.0), "ear": (12.0, 22.0), "neck": (16.0, 26.0), "hand": (14.0, 24.0),
    "forearm": (12.0, 22.0), "shin": (10.0, 20.0),
    "leg": (10.0, 18.0), "hair": (10.0, 16.0), "hat": (7.0, 10.0), "hood": (7.0, 10.0), "collar": (10.0, 16.0),
    "jacket": (8.0, 10.0), "sleeve": (8.0, 10.0), "coat_skirt": (6.0, 10.0), "trousers": (8.0, 10.0),
    "shoe": (4.0, 9.0),
}  # fmt: skip
# Several thick layers, a scarf and gloves: little heat comes out.
_BUNDLED: Mapping[str, tuple[float, float]] = {
    "face": (12.0, 22.0), "neck": (5.0, 12.0), "hand": (3.0, 7.0), "hat": (2.0, 5.0), "hood": (1.0, 4.0),
    "collar": (2.5, 6.0), "jacket": (0.8, 3.5), "sleeve": (1.0, 4.0), "coat_skirt": (0.6, 3.0), "trousers": (1.5, 5.0),
    "shoe": (0.8, 3.0), "strap": (0.5, 3.0),
}  # fmt: skip
_WORN: Mapping[str, Mapping[str, tuple[float, float]]] = {"light": _LIGHT, "bundled": _BUNDLED}
# Wet cloth and skin just above the water: they evaporate, and hold water near the air's temperature (est.). Where the
# water reaches the waist, waves and hands have wetted the top, too.
_WET_LEGS: Mapping[str, tuple[float, float]] = {
    "trousers": (-2.0, 3.0), "leg": (0.0, 6.0), "shin": (3.0, 12.0), "coat_skirt": (-2.0, 2.0), "shoe": (-2.0, 2.0),
}  # fmt: skip
_WET_TOP: Mapping[str, tuple[float, float]] = {
    "jacket": (-1.0, 4.0), "sleeve": (-1.0, 4.0), "hand": (4.0, 14.0), "forearm": (4.0, 14.0), "backpack": (-2.0, 1.0),
}  # fmt: skip
_WET: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "knees": _WET_LEGS, "waist": {**_WET_LEGS, **_WET_TOP}, "chest": {**_WET_LEGS, **_WET_TOP},
}  # fmt: skip
# Height of the surface of the water on someone who stands.
_DEEP = {"knees": 0.285, "waist": 0.600, "chest": 0.720}
WATERS = ("none", *_DEEP)
PART_NAMES = tuple(PARTS)
CLOTHING = ("winter", "light", "bundled")
# Additional rise of clothes and hair in the sun (est.), for scenes without a sun of their own; the low end applies
# under clouds, too.
SUN_K = (3.0, 12.0)
_SUNLIT = frozenset(n for n, role in PARTS.items() if role.kind in ("cloth", "hair", "leather", "plastic"))
# By day the air is nearer to the skin's temperature, and moves more, and cloth in the shade cools towards the sky:
# clothes keep this share of their excess (est., so that people have the dark parts of those in HIT-UAV's train split).
SHADE_SHARE = (-0.1, 0.5)
# Parts of one garment absorb the same share of sunlight. Thin stockings count as skin.
_GARMENTS: Mapping[str, tuple[str, ...]] = {
    "top": ("jacket", "sleeve", "coat_skirt", "collar", "hood"),
    "bottom": ("trousers", "leg"),
    "skin": ("face", "nose", "ear", "neck", "hand", "forearm", "shin"),
    "backpack": ("backpack", "strap", "laid_backpack"),
}
_SURFACE = {part: garment for garment, parts in _GARMENTS.items() for part in parts}


def parts_for(params: Params) -> Mapping[str, PartRange]:
    """Return the thermal role of every part: light clothes are warmer outside, and by day the sun adds to that.

    In scenes with a sun, each garment has its own absorptivity, and is warmed where the sun's rays hit it.
    """
    # A part that someone does not have would change what is drawn for the others.
    rare = {"helmet": params.get("headwear") == "helmet", "laid_backpack": _lays_backpack(params)}
    parts = {n: role for n, role in PARTS.items() if rare.get(n, True)}
    own = {**_WORN.get(params.get("clothing", "winter"), {}), **_WET.get(params.get("water", "none"), {})}
    parts |= {n: replace(parts[n], delta_t_k=delta) for n, delta in own.items()}
    bed = warm_ground.roles(params)
    time = params.get("time_of_day", "night")
    if time == "night":
        return {**parts, **bed}
    by_day = warmed_by_sun(parts, SUN_K, {n: 1.0 for n in parts if n in _SUNLIT})
    by_day = {n: replace(role, sun=_in_the_sun(n, role.kind, parts[n].delta_t_k)) for n, role in by_day.items()}
    return {**(at_low_sun(parts, by_day, time) if time in LOW_SUN else by_day), **bed}


def _lays_backpack(params: Params) -> bool:
    """Return whether someone has put a backpack on the ground to lie on the back."""
    if params.get("pose") != "lying" or not params.get("backpack"):
        return False
    return skeleton("lying", params.get("variant", VARIANTS["lying"][0])).rests_on == "back"


def _in_the_sun(part: str, kind: str, night_k: tuple[float, float]) -> SunResponse:
    low, high = night_k if kind == "skin" else (SHADE_SHARE[0] * night_k[0], SHADE_SHARE[1] * night_k[1])
    return replace(sun_response(kind, (low, high), _SURFACE.get(part, part)), overcast_k=night_k)


_NUMBER = {name: i for i, name in enumerate(PART_NAMES)}

CLOTH_CELL = 0.0155
SKIRT_CELL = 0.021
HEAD_CELL = 0.0092
SHOE_CELL = 0.0105
# Where an arm almost touches the trunk, some grids give a handle thinner than a cell; these other cells are tried then.
_CELL_SHARES = (1.0, 0.95, 1.04, 0.9, 0.86)

# Sections of the trunk of a standing person: z, middle x, half width, half depth.
_TRUNK = np.array(
    [
        [0.462, 0.002, 0.099, 0.071],
        [0.530, -0.002, 0.098, 0.069],
        [0.610, 0.004, 0.087, 0.060],
        [0.680, 0.005, 0.090, 0.062],
        [0.745, 0.000, 0.097, 0.066],
        [0.790, -0.006, 0.092, 0.057],
        [0.830, -0.012, 0.050, 0.042],
    ]
)
_PADDING = {"jacket": 0.011, "puffer": 0.024, "coat": 0.013}
_LAYERS = 0.012  # further padding of the bundled up
_GIRTH = {"slim": 0.92, "average": 1.0, "heavy": 1.16}


def _skin(body: Body, cell: float) -> Piece:
    for share in _CELL_SHARES:
        try:
            v, t = surface(body, share * cell)
        except ValueError:
            if share == _CELL_SHARES[-1]:
                raise
        else:
            return v, t, body.parts(v[t].mean(axis=1), PART_NAMES)
    raise AssertionError


def _one_part(part: str, *solids: Solid) -> Piece:
    v, t = concatenate(solids)
    return v, t, np.full(len(t), _NUMBER[part], np.int32)


def _trunk_rows(top: str, pad: float, build_name: str, seated: bool) -> FloatArray:
    """Return the sections of the clothed trunk: z, middle x, half width, half depth."""
    rows = _TRUNK.copy()
    girth = _GIRTH[build_name]
    rows[:, 2:] *= girth
    if build_name == "heavy":
        belly = np.exp(-(((rows[:, 0] - 0.60) / 0.07) ** 2))
        rows[:, 1] += 0.020 * belly
        rows[:, 2] += 0.012 * belly
        rows[:, 3] += 0.024 * belly
    # Cloth hangs from the chest over the waist and is thinner on the shoulders.
    rows[1:4, 2] = np.maximum(rows[1:4, 2], 0.97 * rows[:, 2].max())
    rows[:, 2:] += pad * np.array([1.0, 1.0, 1.0, 1.0, 0.9, 0.7, 0.4])[:, None]
    if seated:
        rows[0, 0] = 0.500
    elif top == "puffer":
        rows[0, 0] = 0.485
        rows[0, 2:] -= 0.010
    return rows


def _shoulder(build_name: str) -> FloatArray:
    return np.array([SHOULDER[0], SHOULDER[1] * (0.5 + 0.5 * _GIRTH[build_name]), SHOULDER[2]])


def _arm_line(arm: Arm, sign: int, pad: float, build_name: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return shoulder, elbow and wrist of an arm in the frame of the trunk; thick clothes push the arms out."""
    flip = np.array([1.0, float(sign), 1.0])
    shoulder = _shoulder(build_name)
    wrist = np.array(arm.wrist)
    off = 0.0 if arm.planted else 0.6 * (pad - 0.011) + 0.16 * (_GIRTH[build_name] - 1.0)
    if wrist[1] > 0.1:
        wrist[1] += off
    if wrist[0] > 0.1:
        wrist[0] += off
    elbow = limb_joint(shoulder, wrist, UPPER_ARM, FOREARM, arm.elbow)
    return shoulder * flip, elbow * flip, wrist * flip


@lru_cache(maxsize=256)
def _upper(top: str, pad: float, arms: Arms, build_name: str, seated: bool, hood_down: bool, sleeves: str) -> Piece:
    """Return the jacket with sleeves, collar and any lowered hood, in the frame of the upright trunk."""
    rows = _trunk_rows(top, pad, build_name, seated)
    girth = _GIRTH[build_name]
    trunk = tube(
        "jacket",
        np.column_stack([rows[:, 1], np.zeros(len(rows)), rows[:, 0]]),
        rows[:, 2],
        rows[:, 3],
        caps=(0.016, 0.02),
        steps=3,
    )
    shoulder = _shoulder(build_name)
    y, z = shoulder[1], shoulder[2]
    primitives: list[Primitive] = [trunk]
    for sign in (1, -1):
        # Slope from the neck to the shoulder.
        primitives.append(
            tube(
                "jacket",
                [(-0.014, 0.030 * sign, 0.822), (-0.010, 0.085 * sign, z + 0.016), (-0.006, y * sign, z)],
                np.array([0.030, 0.034, 0.036]) * girth + 0.6 * pad,
                side=(1.0, 0.0, 0.0),
                blend=0.035,
            )
        )
    for sign, arm in zip((1, -1), arms, strict=True):
        a, b, c = _arm_line(arm, sign, pad, build_name)
        bare = sleeves == "short"
        padding = pad * np.array([0.8, 0.9, 0.8, *((0.0, 0.0) if bare else (0.8, 0.45))])
        width = np.array([0.0385, 0.0365, 0.0335, 0.0315, 0.0275]) * girth + padding
        path = [a, 0.5 * (a + b), b, 0.45 * b + 0.55 * c, c]
        side = (1.0, 0.0, 0.0) if abs(unit(c - a)[0]) < 0.8 else (0.0, 0.0, 1.0)
        beyond = ((2, "forearm"),) if bare else ()
        primitives.append(
            tube("sleeve", path, width, side=side, blend=0.020, caps=(0.04, 0.008), steps=2, beyond=beyond)
        )
    primitives.append(
        tube(
            "collar",
            [(-0.016, 0, 0.815), (-0.010, 0, 0.845), (-0.004, 0, 0.872)],
            np.array([0.048, 0.043, 0.041]) + 0.4 * pad,
            np.array([0.050, 0.046, 0.044]) + 0.4 * pad,
            blend=0.015,
            caps=(0.02, 0.006),
        )
    )
    if hood_down:
        primitives.append(
            tube(
                "hood",
                [
                    (0.030, 0.046, 0.842),
                    (-0.020, 0.060, 0.852),
                    (-0.068, 0.034, 0.842),
                    (-0.082, 0.0, 0.830),
                    (-0.068, -0.034, 0.842),
                    (-0.020, -0.060, 0.852),
                    (0.030, -0.046, 0.842),
                ],
                np.array([0.013, 0.019, 0.025, 0.029, 0.025, 0.019, 0.013]) + 0.25 * pad,
                side=(0.0, 0.0, 1.0),
                blend=0.012,
                steps=2,
            )
        )
    return _skin(Body(tuple(primitives)), CLOTH_CELL)


@lru_cache(maxsize=256)
def _hands(pad: float, arms: Arms, build_name: str) -> Piece | None:
    """Return the hands that are not in pockets, in the frame of the trunk: palm, four fingers and thumb each."""
    solids: list[Solid] = []
    for sign, arm in zip((1, -1), arms, strict=True):
        if arm.hidden:
            continue
        _, elbow, wrist = _arm_line(arm, sign, pad, build_name)
        flip = np.array([1.0, float(sign), 1.0])
        d = unit(wrist - elbow) if arm.hand is None else unit(np.array(arm.hand) * flip)
        palm = np.array(arm.palm) * flip
        palm = unit(palm - (palm @ d) * d)
        thumb = sign * np.cross(palm, d)
        start = wrist + 0.004 * unit(wrist - elbow)
        solids.append(
            sweep(
                [start - 0.006 * d, start + 0.018 * d, start + 0.052 * d],
                [0.016, 0.021, 0.023],
                [0.013, 0.012, 0.009],
                n=12,
                up=palm,
                round_ends=True,
            )
        )
        for i, length in enumerate((0.040, 0.045, 0.041, 0.032)):
            root = start + 0.050 * d + (0.0165 - 0.011 * i) * thumb
            bend = 0.45 * d + 0.22 * palm
            tip = root + length * (0.92 * d + 0.40 * palm)
            solids.append(sweep([root, root + length * bend, tip], [0.0058, 0.0054, 0.0044], n=8, up=thumb))
        root = start + 0.010 * d + 0.014 * thumb
        knuckle = root + 0.022 * d + 0.016 * thumb + 0.006 * palm
        solids.append(
            sweep(
                [root, knuckle, knuckle + 0.022 * d + 0.002 * thumb + 0.006 * palm],
                [0.0085, 0.0066, 0.0050],
                n=8,
                up=palm,
                round_ends=True,
            )
        )
    return _one_part("hand", *solids) if solids else None


@lru_cache(maxsize=256)
def _legs(pose: Pose, bottom: str, build_name: str, length: str, thick: float) -> Piece:
    """Return trousers with the hips, or stockinged legs under a skirt; short trousers end at the knee."""
    girth = _GIRTH[build_name]
    bare = bottom == "skirt"
    part = "leg" if bare else "trousers"
    x, z = pose.hip
    flat = 0.9 if pose.folded else 1.0
    primitives: list[Primitive] = [
        ellipsoid(
            "trousers",
            (x - 0.006, 0.0, z + 0.012),
            np.array([0.066, 0.092, 0.072 * flat]) * girth,
        )
    ]
    for line in leg_lines(pose):
        hip, knee, ankle = line
        if bare:
            width = np.array([0.042, 0.046, 0.033, 0.034, 0.022, 0.021]) * (0.5 + 0.5 * girth)
        else:
            width = np.array([0.050, 0.053, 0.044, 0.043, 0.039, 0.037]) * (0.4 + 0.6 * girth) + thick
            if length == "short":
                width[3:] = np.array([0.034, 0.023, 0.021]) * (0.5 + 0.5 * girth)
        end = ankle + (0.020 if not bare else 0.0) * unit(knee - ankle)
        shank = end - knee
        bent = unit(knee - hip) @ unit(knee - ankle) > -0.5
        calf = knee + 0.3 * shank
        if not bent:
            # The calf bulges backward.
            calf = calf - np.array([0.008, 0.0, 0.0])
        path = [hip, 0.5 * (hip + knee), knee, calf, knee + 0.75 * shank, end]
        beyond = ((2, "shin"),) if length == "short" and not bare else ()
        primitives.append(
            tube(part, path, width, side=(0.0, 1.0, 0.0), blend=0.022, caps=(0.05, 0.008), steps=2, beyond=beyond)
        )
    return _skin(Body(tuple(primitives), floor=not pose.rests_on), CLOTH_CELL)


@lru_cache(maxsize=256)
def _skirt(pose: Pose, kind: str, build_name: str) -> Piece:
    """Return the lower half of a coat, or a skirt: both hang from the hips around both thighs."""
    (hip, knee, _), (hip2, knee2, _) = leg_lines(pose)
    girth = _GIRTH[build_name]
    coat = kind == "coat"
    middle_hip = 0.5 * (hip + hip2)
    middle_knee = 0.5 * (knee + knee2)
    reach = middle_knee - middle_hip
    down = 0.93 if coat else 0.80
    end = middle_hip + down * reach
    spread = np.abs(knee - knee2) * down
    waist = np.array([middle_hip[0] + 0.002, 0.0, middle_hip[2] + (0.06 if coat else 0.03)])
    wide = 0.100 * girth + 0.012
    deep = 0.072 * girth + 0.012
    extra = 0.012 if coat else 0.004
    if pose.folded:
        # Along the thighs, which are close together or apart.
        half = [wide, wide + 0.004, max(0.5 * spread[1] + 0.056, 0.9 * wide)]
        thick = [deep, 0.068 * girth + extra, 0.056 * girth + extra]
    else:
        half = [wide, wide + extra, max(0.5 * spread[1] + 0.060 * girth + extra, wide)]
        thick = [deep, 0.5 * spread[0] * 0.5 + deep + 0.5 * extra, 0.5 * spread[0] + 0.055 * girth + extra]
    part = "coat_skirt" if coat else "trousers"
    bar = tube(part, [waist, middle_hip + 0.35 * reach, end], half, thick, caps=(0.02, 0.014), steps=3)
    return _skin(Body((bar,), floor=not pose.rests_on), SKIRT_CELL)


@lru_cache(maxsize=128)
def _shoes(pose: Pose) -> Piece:
    pieces = []
    for sign, foot in zip((1, -1), pose.feet, strict=True):
        turn = turn_z(sign * foot.toe_out_rad) @ turn_y(-foot.toe_up_rad)
        ankle = np.array(foot.ankle)
        sole = [ankle + turn @ np.array(p) for p in ((-0.030, 0, -0.022), (0.025, 0, -0.023), (0.083, 0, -0.030))]
        shaft = [ankle + turn @ np.array([-0.010, 0, -0.010]), ankle + turn @ np.array([-0.006, 0, 0.020])]
        body = Body(
            (
                tube(
                    "shoe",
                    sole,
                    [0.026, 0.030, 0.028],
                    [0.027, 0.027, 0.019],
                    side=turn[:, 1],
                    caps=(0.026, 0.028),
                    steps=3,
                ),
                tube("shoe", shaft, [0.028, 0.028], side=turn[:, 1], blend=0.03, caps=(0.02, 0.01)),
            ),
            floor=not pose.rests_on,
        )
        pieces.append(_skin(body, SHOE_CELL))
    return joined(pieces)


@lru_cache(maxsize=16)
def _head(headwear: str, hair: str) -> Piece:
    """Return head and neck with hair and headwear, relative to the base of the neck."""
    primitives: list[Primitive] = [
        tube("neck", [(-0.012, 0, 0.805), (-0.008, 0, 0.86), (0.0, 0, 0.905)], [0.034, 0.032, 0.033]),
        ellipsoid("face", (0.006, 0, 0.936), (0.056, 0.043, 0.056), blend=0.02),
        tube(
            "face",
            [(0.016, 0, 0.925), (0.032, 0, 0.895), (0.044, 0, 0.884)],
            [0.038, 0.031, 0.017],
            [0.040, 0.028, 0.015],
            blend=0.02,
            steps=2,
        ),
        ellipsoid("face", (0.050, 0, 0.939), (0.014, 0.032, 0.008), blend=0.012),
        tube("nose", [(0.061, 0, 0.928), (0.069, 0, 0.912)], [0.006, 0.0095], blend=0.006),
        ellipsoid("face", (0.055, 0, 0.896), (0.008, 0.016, 0.008), blend=0.008),
    ]
    if headwear != "hood":
        for sign in (1, -1):
            primitives.append(ellipsoid("ear", (0.0, 0.044 * sign, 0.920), (0.014, 0.0085, 0.019), blend=0.004))
    if hair == "long":
        primitives.append(
            tube(
                "hair",
                [(-0.026, 0, 0.945), (-0.036, 0, 0.905), (-0.042, 0, 0.868), (-0.040, 0, 0.835)],
                [0.050, 0.051, 0.047, 0.034],
                [0.034, 0.027, 0.024, 0.018],
                blend=0.015,
                steps=2,
            )
        )
    else:
        primitives.append(ellipsoid("hair", (-0.020, 0, 0.916), (0.036, 0.043, 0.036), blend=0.01))
    if headwear in ("none", "hood"):
        primitives.append(ellipsoid("hair", (-0.004, 0, 0.950), (0.060, 0.048, 0.050), blend=0.006))
    if headwear == "beanie":
        primitives.append(ellipsoid("hat", (-0.005, 0, 0.960), (0.063, 0.052, 0.052), blend=0.004))
        primitives.append(
            tube("hat", [(-0.006, 0, 0.946), (-0.003, 0, 0.962)], [0.053, 0.052], [0.066, 0.064], caps=(0.006, 0.006))
        )
    if headwear == "cap":
        primitives.append(ellipsoid("hat", (-0.004, 0, 0.957), (0.062, 0.050, 0.048), blend=0.004))
    if headwear == "hood":
        primitives.append(ellipsoid("hood", (-0.016, 0, 0.940), (0.066, 0.062, 0.076), blend=0.0))
        primitives.append(
            tube("hood", [(-0.030, 0, 0.92), (-0.030, 0, 0.84)], [0.058, 0.062], [0.055, 0.056], blend=0.03)
        )
        around = np.linspace(0.0, 2 * np.pi, 13)
        rim = np.column_stack([0.044 - 0.016 * np.sin(around), 0.050 * np.cos(around), 0.934 + 0.068 * np.sin(around)])
        primitives.append(tube("hood", rim, np.full(13, 0.0125), side=(1.0, 0.0, 0.0), blend=0.012))
    if headwear == "helmet":
        primitives.append(ellipsoid("helmet", (-0.008, 0, 0.958), (0.078, 0.064, 0.058), blend=0.002))
        primitives.append(
            tube("helmet", [(-0.010, 0, 0.938), (-0.008, 0, 0.956)], [0.063, 0.064], [0.076, 0.078], caps=(0.004, 0.01))
        )
    pieces = [_skin(Body(tuple(primitives)), HEAD_CELL)]
    if headwear == "cap":
        visor = ellipsoid_solid((0.052, 0.041, 0.0045), n=20, rows=6)
        tilt = Solid(visor.vertices @ turn_y(0.16).T, visor.triangles)
        pieces.append(_one_part("hat", moved(tilt, (0.056, 0.0, 0.952))))
    v, t, parts = joined(pieces)
    return v - NECK, t, parts


@lru_cache(maxsize=32)
def _backpack(top: str, pad: float, build_name: str, worn: bool) -> Piece:
    """Return a backpack with two shoulder straps, or one beyond the head of someone who lies on the back."""
    rows = _trunk_rows(top, pad, build_name, False)

    def at(z: float) -> tuple[float, float]:
        """Return middle x and half depth of the trunk at height z."""
        return float(np.interp(z, rows[:, 0], rows[:, 1])), float(np.interp(z, rows[:, 0], rows[:, 3]))

    levels = [(0.570, 0.062, 0.030), (0.582, 0.078, 0.042), (0.640, 0.084, 0.048), (0.740, 0.080, 0.043)]
    levels += [(0.790, 0.070, 0.034), (0.802, 0.052, 0.022)]
    middle, depth = at(0.68)
    back = middle - depth
    outline = circle(24, 3.2)
    rings = np.empty((len(levels), 24, 3))
    for ring, (z, wide, deep) in zip(rings, levels, strict=True):
        ring[:, 0] = back + 0.014 - 0.048 + deep * outline[:, 0]
        ring[:, 1] = wide * outline[:, 1]
        ring[:, 2] = z
    centre = rings[:, :, 0].mean(axis=1)
    pack = loft(rings, start=(centre[0], 0.0, 0.564), end=(centre[-1], 0.0, 0.806))
    if not worn:
        return _one_part("laid_backpack", moved(pack, (0.075, 0.05, 0.50)))
    straps = []
    lift = 0.034 * _GIRTH[build_name] + 0.6 * pad
    for sign in (1, -1):
        path = []
        for x_share, z, y in ((1.0, 0.655, 0.078), (1.0, 0.72, 0.066), (0.92, 0.775, 0.060)):
            m, d = at(z)
            # Sections of the trunk are ellipses, less deep away from the middle.
            w = float(np.interp(z, rows[:, 0], rows[:, 2]))
            path.append((m + x_share * d * math.sqrt(max(1 - (y / w) ** 2, 0.0)), y * sign, z))
        path += [(0.018, 0.062 * sign, 0.806 + lift * 0.86), (-0.028, 0.062 * sign, 0.804 + lift * 0.80)]
        path.append((back - 0.002, 0.055 * sign, 0.775))
        line = tube("strap", path, 0.014, steps=3).path
        straps.append(sweep(line, 0.006, 0.014, n=8, up=(0.0, 1.0, 0.0)))
    return joined([_one_part("backpack", pack), _one_part("strap", *straps)])


@lru_cache(maxsize=4)
def _seat(height: float) -> Piece:
    """Return a block to sit on with its top at `height`."""
    return _one_part("seat", moved(box((0.24, 0.34, height), 0.008), (0.02, 0.0, height / 2)))


DEFAULTS: Params = {
    "pose": "standing",
    "variant": "upright",
    "arms": "natural",
    "top": "jacket",
    "bottom": "trousers",
    "headwear": "none",
    "hair": "short",
    "backpack": False,
    "seat": True,
    "build": "average",
    "age": "adult",
    "height_m": 1.75,
    "width_factor": 1.0,
    "lean_rad": 0.0,
    "head_turn_rad": 0.0,
    "head_nod_rad": 0.0,
    "mirror": False,
    "time_of_day": "night",
    "clothing": "winter",
    "sleeves": "long",
    "legs": "long",
    "phase": None,
    "water": "none",
    warm_ground.PARAM: None,
}
_CHECKS = Checks("person")
_WORDS = {
    "top": TOPS,
    "bottom": BOTTOMS,
    "headwear": HEADWEAR,
    "hair": HAIR,
    "build": BUILDS,
    "sleeves": LENGTHS,
    "legs": LENGTHS,
}
_LIMITS: Mapping[str, tuple[float, float]] = {
    "width_factor": (0.85, 1.2),
    "lean_rad": (-0.2, 0.3),
    "head_turn_rad": (-1.2, 1.2),
    "head_nod_rad": (-0.3, 0.7),
}


def _checked(params: Params) -> Params:
    """Return all parameters, checked, with defaults for missing ones."""
    _CHECKS.known("parameter", params, tuple(DEFAULTS))
    p = {**DEFAULTS, **params}
    pose = _CHECKS.one_of("parameter pose", p["pose"], POSES)
    if "variant" not in params:
        p["variant"] = VARIANTS[pose][0]
    _CHECKS.one_of("parameter variant", p["variant"], VARIANTS[pose])
    _CHECKS.one_of("parameter arms", p["arms"], ARMS[pose])
    for name, allowed in _WORDS.items():
        _CHECKS.one_of(f"parameter {name}", p[name], allowed)
    _CHECKS.one_of("parameter time_of_day", p["time_of_day"], TIMES)
    _CHECKS.one_of("parameter clothing", p["clothing"], CLOTHING)
    age = _CHECKS.one_of("parameter age", p["age"], AGES)
    p["height_m"] = _CHECKS.number("parameter height_m", p["height_m"], *HEIGHTS_M[age])
    if p["phase"] is not None:
        p["phase"] = _CHECKS.number("parameter phase", p["phase"], 0.0, 1.0)
        if not moves(pose):
            raise _CHECKS.bad("parameter phase", p["phase"], f"none for a {pose} person", "Leave it out.")
    if _CHECKS.one_of("parameter water", p["water"], WATERS) != "none" and pose not in WADING:
        raise _CHECKS.bad("parameter water", p["water"], f"none for a {pose} person", "Leave it out.")
    warm_ground.check(p, _CHECKS)
    for name in ("backpack", "seat", "mirror"):
        _CHECKS.flag(f"parameter {name}", p[name])
    for name, (low, high) in _LIMITS.items():
        p[name] = _CHECKS.number(f"parameter {name}", p[name], low, high)
    return p


def build(params: Params) -> Mesh:
    """Build the mesh of a person in metres.

    Args:
        params: Parameters as `sample` draws them; missing ones take their value from `DEFAULTS`.

            pose, variant, arms: See `VARIANTS` and `ARMS`.
            phase: Place in [0, 1] in the cycle of someone who walks, runs, crawls or waves, instead of the variant.
            top, bottom, headwear, hair, build: See `TOPS`, `BOTTOMS`, `HEADWEAR`, `HAIR` and `BUILDS`; a hood that
                is not worn hangs on the back of jacket and puffer.
            backpack: Whether the person carries a backpack; who lies on the back has put it down.
            seat: Whether the model of someone sitting on a seat includes the seat, which is not labelled.
            age, height_m: Height when standing upright, with shoes and headwear; a child's proportions follow from it.
            width_factor: Extra factor for width and depth.
            lean_rad: Forward lean of the trunk in addition to that of the pose.
            head_turn_rad, head_nod_rad: Turn to the left before mirroring, and forward nod in addition to that of the
                pose.
            mirror: Exchange left and right.
            time_of_day: `night`, `day`, `dusk` or `dawn`; for the temperatures.
            clothing: See `CLOTHING`; for the temperatures, and the thickness of those of the bundled up.
            sleeves, legs: See `LENGTHS`; coats and puffers always have long sleeves.
            water: How deep someone who stands, walks or waves is in water; see `WATERS`. Only what is above it is
                built, and the surface of the water is the ground.
            warm_ground: Shift [x, y] of the ground that a lying person has warmed, metres; None for none.

    Raises:
        ModelError: A parameter is unknown or outside its range.
    """
    p = _checked(params)
    pose = skeleton(p["pose"], p["variant"], p["phase"])
    legs_factor, head_factor = _proportions(p)
    lean = turn_y(pose.lean_rad + pose.loose * p["lean_rad"])
    if pose.tilt_rad[0]:
        lean = turn_x(-pose.tilt_rad[0]) @ lean
    hip = np.array([pose.hip[0], 0.0, pose.hip[1]]) * legs_factor
    at_hip = np.array([0.0, 0.0, HIP_Z])
    pieces: list[Piece] = [((v - at_hip) @ lean.T + hip, t, parts) for v, t, parts in _trunk(p, pose)]

    v, t, parts = _head(p["headwear"], p["hair"])
    nod = pose.nod_rad + pose.loose * p["head_nod_rad"] + (0.30 if p["arms"] == "phone" else 0.0)
    v = head_factor * _head_turned(v, nod, pose.turn_rad + pose.loose * p["head_turn_rad"])
    if pose.neck_rad or pose.tilt_rad[1]:
        v = v @ (turn_x(-pose.tilt_rad[1]) @ turn_y(pose.neck_rad)).T
    neck = (NECK - at_hip) @ lean.T + hip
    pieces.append((v + neck, t, parts))

    pieces += [(legs_factor * v, t, parts) for v, t, parts in _below_hips(p, pose)]

    vertices, triangles, label = joined(pieces)
    middle = pose.middle_x
    if middle is None:
        middle = 0.5 * (pose.feet[0].ankle[0] + pose.feet[1].ankle[0]) + 0.028
    vertices = vertices - np.array([legs_factor * middle, 0.0, float(vertices[:, 2].min())])
    if p["mirror"]:
        vertices, triangles = mirrored(vertices, triangles)
    scale = _scale(p)
    across = scale * p["width_factor"]
    vertices = vertices * np.array([across, across, scale])
    if pose.rests_on:
        vertices = _lying(vertices, pose.rests_on, scale)
    if p["water"] != "none":
        deep = _DEEP[p["water"]]
        level = scale * (legs_factor * min(deep, HIP_Z) + max(deep - HIP_Z, 0.0))
        vertices, triangles, label = above_water((vertices, triangles, label), level)
    mesh = finished((vertices, triangles, label), PART_NAMES, smooth=np.asarray(label != _NUMBER["seat"]))
    return warm_ground.with_warm_ground(mesh, p)


def _trunk(p: Params, pose: Pose) -> list[Piece]:
    """Return trunk and arms, hands and backpack of an upright person."""
    girth = p["build"]
    top = p["top"]
    arms = pose.arms if p["arms"] == "natural" else ARM_PAIRS[p["arms"]]
    pad = _PADDING[top]
    if p["clothing"] == "bundled":
        pad += _LAYERS
    sleeves = p["sleeves"] if top == "jacket" else "long"
    # A hood under the back of someone who lies on it is flat.
    hood_down = p["headwear"] != "hood" and top != "coat" and sleeves == "long" and pose.rests_on != "back"
    trunk = [_upper(top, pad, arms, girth, pose.folded, hood_down, sleeves)]
    hands = _hands(pad, arms, girth)
    if hands is not None:
        trunk.append(hands)
    if p["backpack"]:
        trunk.append(_backpack(top, pad, girth, not _lays_backpack(p)))
    return trunk


def _below_hips(p: Params, pose: Pose) -> list[Piece]:
    """Return legs and shoes with what hangs over them, and the seat of someone sitting on one."""
    layers = 0.5 * _LAYERS if p["clothing"] == "bundled" else 0.0
    pieces = [_legs(pose, p["bottom"], p["build"], p["legs"], layers), _shoes(pose)]
    # A coat reaches lower than a skirt and hides it.
    hanging = "coat" if p["top"] == "coat" else p["bottom"]
    if hanging != "trousers":
        pieces.append(_skirt(pose, hanging, p["build"]))
    if (p["pose"], p["variant"]) == ("sitting", "seat") and p["seat"]:
        pieces.append(_seat(round(pose.hip[1] - 0.055, 4)))
    return pieces


def needs(params: Params) -> Affinity | None:
    """Return the ground that someone in water may stand on: water alone; None for others."""
    return None if params.get("water", "none") == "none" else {"water": 1.0}


def _proportions(p: Params) -> tuple[float, float]:
    """Return the factors of legs and head beside the trunk."""
    if p["age"] == "adult":
        return 1.0, 1.0
    legs, head = child_factors(p["height_m"])
    # Hands that stand on the ground need legs that fit the arms.
    return (1.0 if p["pose"] == "crawling" else legs), head


def _scale(p: Params) -> float:
    """Return the scale that gives the upright body its height, headwear included."""
    legs, head = (1.0, 1.0) if p["age"] == "adult" else child_factors(p["height_m"])
    top = float(_head(p["headwear"], p["hair"])[0][:, 2].max())
    return float(p["height_m"] / (float(NECK[2]) - (1.0 - legs) * HIP_Z + head * top))


def animate(params: Params, phase: float) -> Params:
    """Return the parameters of a walking, running, crawling or waving person at a phase; of others, as they are."""
    return {**params, "phase": moment(phase)} if moves(params["pose"]) else dict(params)


def stride_m(params: Params) -> float:
    """Return how far two steps take a person who walks, runs or crawls; 0 for others."""
    p = _checked(params)
    if p["pose"] not in STRIDES:
        return 0.0
    return float(STRIDES[p["pose"]] * _proportions(p)[0] * _scale(p) * p["width_factor"])


def cycle_hz(params: Params) -> float:
    """Return how often arms wave per second."""
    return WAVES_HZ if params["pose"] == "waving" else 0.0


# Side that lies on the ground -> rotation of a standing body that puts it there, with the head towards +X.
_RESTS = {
    "back": turn_z(math.pi) @ turn_y(-math.pi / 2),
    "front": turn_y(math.pi / 2),
    "right side": turn_z(math.pi / 2) @ turn_x(math.pi / 2),
}
# A body and the ground give way: the lowest layer of a lying one is this much thinner, both in units of its height.
_LAYER = 0.060
_SINKS = 0.024


def _lying(vertices: FloatArray, rests_on: str, scale: float) -> FloatArray:
    """Lay (V, 3) vertices of a standing body down, hips over the origin, and press them on the ground."""
    v = (vertices - [0.0, 0.0, scale * HIP_Z]) @ _RESTS[rests_on].T
    x, z = v[:, 0], v[:, 2]
    z -= z.min()
    # Thick clothes lift the trunk: the head hangs from the neck, and legs from the hips, until they touch the ground.
    if rests_on != "right side":  # where the head lies on the arm
        head = smoothstep((x / scale - 0.27) / 0.08)
        z -= z[head == 1.0].min() * head
        z -= z.min()
    feet = x < 0.8 * x.min()
    z -= z[feet].min() * np.clip(x / x[feet].mean(), 0.0, 1.0)
    z -= z.min()
    z -= scale * _SINKS * np.minimum(z / (scale * _LAYER), 1.0)
    return v


def _head_turned(vertices: FloatArray, nod_rad: float, turn_rad: float) -> FloatArray:
    """Nod and turn (V, 3) vertices relative to the base of the neck, more the higher they are."""
    share = smoothstep((vertices[:, 2] - 0.01) / 0.05)
    out = vertices.copy()
    c, s = np.cos(share * turn_rad), np.sin(share * turn_rad)
    out[:, 0], out[:, 1] = c * vertices[:, 0] - s * vertices[:, 1], s * vertices[:, 0] + c * vertices[:, 1]
    pivot = 0.035
    c, s = np.cos(share * nod_rad), np.sin(share * nod_rad)
    x, z = out[:, 0].copy(), out[:, 2] - pivot
    out[:, 0], out[:, 2] = c * x + s * z, pivot - s * x + c * z
    return out


def sample(rng: np.random.Generator, options: Params) -> Params:
    """Draw the parameters of one person, JSON values only.

    Every call takes the same numbers from `rng`, so fixing an option leaves the rest as it would have been drawn
    (as far as pose and clothes allow).
    """
    _CHECKS.known("option", options, tuple(OPTIONS))
    u = [float(x) for x in rng.random(18)]

    def drawn(name: str, allowed: tuple[str, ...], odds: Mapping[str, float], share: float) -> str:
        default = [n for n in allowed if n in _DRAWN.get(name, allowed)]
        return pick(*_CHECKS.weighted(f"option {name}", options.get(name, default), allowed, odds), share)

    def flag(name: str, likely: float, share: float) -> bool:
        return _CHECKS.flag(f"option {name}", options[name]) if name in options else share < likely

    of_variant = {v: p for p in POSES for v in VARIANTS[p]}
    variants, chances = _CHECKS.weighted(
        "option variant", options.get("variant", tuple(of_variant)), tuple(of_variant), _ODDS["variant"]
    )
    poses, odds = _CHECKS.weighted(
        "option pose", options.get("pose", POSES if "variant" in options else DRAWN_POSES), POSES, _ODDS["pose"]
    )
    suiting = [k for k, q in enumerate(poses) if q in {of_variant[v] for v in variants}]
    if not suiting:
        raise _CHECKS.bad(
            "option variant", options["variant"], f"variants of the pose, {options['pose']!r}: see `pose`"
        )
    pose = pick([poses[k] for k in suiting], [odds[k] for k in suiting], u[0])
    own = [k for k, v in enumerate(variants) if of_variant[v] == pose]
    variant = pick([variants[k] for k in own], [chances[k] for k in own], u[1])
    arms, chances = _CHECKS.weighted("option arms", options.get("arms", ALL_ARMS), ALL_ARMS, _ODDS["arms"])
    possible = [k for k, a in enumerate(arms) if a in ARMS[pose]]
    if not possible:
        raise _CHECKS.bad("option arms", options["arms"], f"for a {pose} person one of " + ", ".join(ARMS[pose]))
    woman = u[2] < 0.5
    ages, odds = _CHECKS.weighted("option age", options.get("age", "adult"), AGES, _ODDS["age"])
    age = pick(ages, odds, 1000.0 * u[3] % 1.0)
    drawn_m = DRAWN_HEIGHT_M if age == "adult" else HEIGHTS_M[age]
    low, high = _CHECKS.range_of_kind("height_m", options, age, ages, HEIGHTS_M, drawn_m)
    height = low + (high - low) * u[3]
    if "height_m" not in options and age == "adult":
        # Close to normal: the mean of three draws over +-3 standard deviations of adults with shoes.
        mean = 1.65 if woman else 1.78
        height = min(max(mean + 0.21 * (2.0 * (u[3] + u[4] + u[5]) / 3.0 - 1.0), low), high)
    hair = drawn("hair", HAIR, {"short": 0.25, "long": 0.75} if woman else {"short": 0.96, "long": 0.04}, u[6])
    bottom = drawn(
        "bottom", BOTTOMS, {"trousers": 0.85, "skirt": 0.15} if woman else {"trousers": 1.0, "skirt": 1e-6}, u[7]
    )
    waters, odds = _CHECKS.weighted("option water", options.get("water", "none"), WATERS, _ODDS["water"])
    if "none" not in waters and not set(poses) & set(WADING):
        raise _CHECKS.bad("option water", options["water"], "none for these poses; in water are " + ", ".join(WADING))
    water = pick(waters, odds, 1000.0 * u[12] % 1.0) if pose in WADING else "none"
    backpack = flag("backpack", 0.22, u[11])
    person = {
        "pose": pose,
        "variant": variant,
        "arms": pick([arms[k] for k in possible], [chances[k] for k in possible], u[8]),
        "top": drawn("top", TOPS, _ODDS["top"], u[9]),
        "bottom": bottom,
        "headwear": drawn("headwear", HEADWEAR, _ODDS["headwear"], u[10]),
        "hair": hair,
        "backpack": backpack,
        "seat": flag("seat", 1.0, 0.0),
        "build": drawn("build", BUILDS, _ODDS["build"], u[12]),
        "height_m": height,
        "width_factor": 0.95 + 0.10 * u[13],
        "lean_rad": -0.03 + 0.08 * u[14],
        # The mean of two draws: usually straight ahead, seldom far to the side.
        "head_turn_rad": 0.9 * (u[15] + u[16] - 1.0),
        "head_nod_rad": -0.10 + 0.35 * u[4],
        "mirror": u[17] < 0.5,
        "time_of_day": _CHECKS.one_of("option time_of_day", options.get("time_of_day", "night"), TIMES),
        # Later digits of draws that decide something else: more draws would change everybody.
        "clothing": drawn("clothing", CLOTHING, _ODDS["clothing"], 1000.0 * u[10] % 1.0),
        "sleeves": drawn("sleeves", LENGTHS, _ODDS["lengths"], 1000.0 * u[9] % 1.0),
        "legs": drawn("legs", LENGTHS, _ODDS["lengths"], 1000.0 * u[7] % 1.0),
        **({} if age == "adult" else {"age": age}),
        **({} if water == "none" else {"water": water}),
    }
    # Renderers do not tell warm ground from other parts without a label.
    lies = pose == "lying" and not _lays_backpack(person)
    return person | warm_ground.drawn(rng, options, _CHECKS, lies)


_ODDS: Mapping[str, Mapping[str, float]] = {
    "pose": {
        "standing": 0.38,
        "walking": 0.54,
        "sitting": 0.08,
        "lying": 0.08,
        "crouching": 0.06,
        "crawling": 0.03,
        "waving": 0.04,
        "running": 0.06,
    },
    "variant": {v: 1.0 for p in POSES for v in VARIANTS[p]},
    "arms": {"natural": 0.56, "phone": 0.14, "call": 0.05, "bent": 0.09, "pockets": 0.16},
    "top": {"jacket": 0.50, "puffer": 0.30, "coat": 0.20},
    "headwear": {"none": 0.56, "beanie": 0.15, "cap": 0.12, "hood": 0.17, "helmet": 0.1},
    "build": {"slim": 0.35, "average": 0.47, "heavy": 0.18},
    "age": {"adult": 0.8, "child": 0.2},
    "clothing": {"winter": 1.0, "light": 1.0, "bundled": 1.0},
    "lengths": dict.fromkeys(LENGTHS, 1.0),
    "water": dict.fromkeys(WATERS, 1.0),
}
# What is drawn where no option says so; of other options, everything.
_DRAWN: Mapping[str, tuple[str, ...]] = {
    "headwear": HEADWEAR[:-1],
    "clothing": CLOTHING[:1],
    "sleeves": LENGTHS[:1],
    "legs": LENGTHS[:1],
}
_LIST = ", a list of several, or each with its weight"
OPTIONS: Mapping[str, str] = {
    "pose": "one of " + ", ".join(POSES) + _LIST + "; by default " + ", ".join(DRAWN_POSES),
    "variant": "; ".join(f"{p}: " + ", ".join(VARIANTS[p]) for p in POSES) + _LIST,
    "arms": "one of " + ", ".join(ALL_ARMS) + _LIST + "; sitting: " + ", ".join(ARMS["sitting"]) + "; standing and "
    "walking: all; in other poses natural",
    "top": "one of " + ", ".join(TOPS) + _LIST,
    "bottom": "one of " + ", ".join(BOTTOMS) + _LIST,
    "headwear": "one of " + ", ".join(HEADWEAR) + _LIST,
    "hair": "one of " + ", ".join(HAIR) + _LIST,
    "build": "one of " + ", ".join(BUILDS) + _LIST,
    "backpack": "true or false; by default about one person in five carries one",
    "seat": "true or false: whether a person on a seat comes with it; by default true",
    "age": "adult or child"
    + _LIST
    + "; by default adult. The smaller a child, the larger its head and the shorter its legs",
    "height_m": "a number or [low, high]: "
    + ", ".join(f"{low:g} to {high:g} ({age})" for age, (low, high) in HEIGHTS_M.items())
    + "; by default adults of both sexes, and children of all heights",
    "time_of_day": "day, dusk, night or dawn: by day the sun warms clothes; by default as in the background, or night",
    "clothing": f"one of {', '.join(CLOTHING)}{_LIST}; light clothes have a warmer outer surface, and many layers are "
    "thicker and colder outside; by default winter",
    "sleeves": "long or short, or both for one person in two: short ones leave the forearms bare; jackets only",
    "legs": "long or short, or both for one person in two: short trousers leave the lower legs bare",
    "water": "one of "
    + ", ".join(WATERS)
    + _LIST
    + "; by default none. How deep those who stand, walk or wave are in water. They are left out where the place map "
    "shows none",
    warm_ground.PARAM: warm_ground.OPTION,
}

MODEL = ObjectModel(
    name="person",
    category="person",
    description="An adult or child in light to thick clothes: standing, walking, sitting, lying, crawling, waving, ...",
    origin="on the ground between the feet; for a sitting or lying person, below the hips",
    stands=True,
    surfaces={"path": 1.0, "track": 1.0, "road": 0.25, "grass": 0.7, "soil": 0.7},
    parts={**PARTS, **warm_ground.PARTS},
    needs=needs,
    sample=sample,
    build=build,
    options=OPTIONS,
    parts_for=parts_for,
    animate=animate,
    stride_m=stride_m,
    cycle_hz=cycle_hz,
    skin_limit_c=36.0,
)
