"""Car model: cold roof and glass under a clear night sky, hot nose after a drive, paint heated by the sun.

`sample_params` draws what varies between cars, `build_car` builds the mesh of one, and `parts_for` returns its
temperatures, which depend on its state and colour. Lengths are in metres, +X points to the nose, +Y to the left and +Z
up; the origin is on the ground below the middle of the car.

Temperatures are surface minus air. Each part's `what` names its source: the emissivity tables of Ideal Industries
(HeatSeeker manual) and testo, body temperatures measured in summer sun (autotimesnews.com), tyres after a drive
(mistersustainable.blogspot.com), and the grey levels of cars in HIT-UAV by night and day. "Est." marks estimates.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infrablend.assets import shapes
from infrablend.assets.cool_ground import SHADE_RINGS, shade_roles, shade_sheet
from infrablend.assets.model import (
    LOW_SUN,
    SHADOW_PARAM,
    ObjectModel,
    Params,
    PartRange,
    at_low_sun,
    part_role,
    sun_response,
    warm_ground_role,
)
from infrablend.assets.params import Checks, Choice, Dials, Number, Range
from infrablend.assets.shapes import Solid
from infrablend.core.mesh import FloatArray, IntArray, Mesh
from infrablend.thermal.daytime import STORED_SHARE, between

_CHECKS = Checks("car")


# --- temperatures --------------------------------------------------------------------------------------------

# part -> (material, description and source).
_SURFACES: Mapping[str, tuple[str, str]] = {
    "roof": ("car_paint", "roof: faces the whole sky; HIT-UAV's night cars -46 DN against the ground, some -8 K"),
    "bonnet": ("car_paint", "bonnet: its lining keeps the middle colder than the rim; cools within 1-2 h"),
    "cowl": ("car_paint", "rear third of the bonnet, behind the engine; blends into the bonnet (est.)"),
    "wing": ("car_paint", "front wings and edge of the bonnet: the bright rim round the nose of HIT-UAV's warm cars"),
    "boot": ("car_paint", "boot lid of a saloon, horizontal like the roof"),
    "side": (
        "car_paint",
        "doors, rear wings: upright, so half of their view is ground (est. from the roof)",
    ),
    "pillar": ("car_paint", "window frames: lean inwards, between roof and doors; hardly visible in HIT-UAV (est.)"),
    "front": ("car_paint", "bumper, nose and front edge of the bonnet, ahead of the radiator (est.)"),
    "rear": ("car_paint", "bumper and tailgate (est.)"),
    "trim": ("plastic", "mirrors and rails"),
    "windscreen": ("glass", "windscreen: as cold as the roof by night; +5..+20 K when heated"),
    "rear_window": ("glass", "rear window, like the windscreen"),
    "window": ("glass", "side windows: steeper, so they face less of the sky (est.)"),
    "sunroof": ("glass", "glass in the roof, like the windscreen"),
    "tyre": ("rubber", "tyre: +8..+11 K after a drive of 14 miles"),
    "rim": ("lacquered_metal", "rim: lacquered alloy or steel"),
    "brake": ("oxidised_steel", "brake and hub behind the rim: hotter than the tyre after a drive (rotors +17 K)"),
    "underbody": ("painted", "floor and wheel wells: shielded from the sky (est.)"),
    "grille": ("cavity", "grille and intake: plastic over cavities"),
    "exhaust": ("oxidised_steel", "tail pipe: +50..+250 K with the engine running (est.)"),
    "headlamp": ("plastic", "covers of the front lamps, polycarbonate"),
    "tail_lamp": ("plastic", "covers of the rear lamps, like the front ones"),
}

# A parked car shields the ground from the cold sky, so a rim of ground around it is warmer. Rings of a translucent
# sheet: their outer distance in m, and opacity. HIT-UAV by night (train, 65 dark cars on even ground): the level beside
# the car exceeds that 2 to 3 m away by 5 levels at 0.3 m (90 % quantile 12), 4 at 0.5 m, 1 at 0.8 m, 0 from 1 m on, of
# which the camera's sharpening makes about 1. At 5.4 levels per kelvin the middle of the range below gives 3 and 2.
GROUND_RINGS: Mapping[str, tuple[float, float]] = {
    "ground_near": (0.15, 0.42), "ground_mid": (0.35, 0.28), "ground_far": (0.6, 0.12), "ground_edge": (0.85, 0.03),
}  # fmt: skip
_GROUND_K = (0.0, 4.0)
# By day it keeps the sun off the ground, for minutes or hours: rays of 300 to 640 W/m² on level ground, of which paving
# absorbs 0.65 to 0.85, take 2 to 10 K.
_SHADE_K = (-9.0, -2.0)
# A long shadow at dusk moves by its own width within the hour, and the low sun hardly warms what lies beside it. At
# dawn there is none: the ground has the temperature of the night inside and outside (est.).
_DUSK_SHADE_K = (-1.5, -0.3)

# Clear night, parked for hours: surfaces that face the sky are below air temperature, a roof by 8.5 K without wind and
# by 4 K at 3 m/s (energy balance). The middle of that range is drawn: the middle of HIT-UAV's median car is 46 +- 12
# levels darker than the ground, which is 7.7 K at 6 levels per kelvin, some 4 K of it from the reflected sky. Screens
# and window frames are as dark as the roof: HIT-UAV's cars are one dark shape from bonnet to boot. Upright parts see
# the ground and have nearly its level; stores of heat (tyres, floor, engine bay) are warmer than the air for hours,
# so that the edge below is some 14 levels brighter.
_PARKED_COLD: Mapping[str, Range] = {
    "roof": (-7.0, -4.5), "bonnet": (-7.0, -4.5), "boot": (-7.0, -4.5), "cowl": (-7.0, -4.5),
    "wing": (-4.0, -1.0), "side": (-1.5, 2.5), "pillar": (-7.0, -4.5), "front": (-1.5, 3.0),
    "rear": (-1.5, 3.0), "trim": (-5.0, -2.0), "windscreen": (-7.5, -5.0), "rear_window": (-7.5, -5.0),
    "window": (-4.0, -1.5), "sunroof": (-7.5, -5.0), "tyre": (0.5, 5.0), "rim": (-0.5, 3.0), "brake": (0.0, 4.0),
    "underbody": (1.5, 6.5), "grille": (0.0, 5.0), "exhaust": (-2.0, 0.0), "headlamp": (-3.5, -1.0),
    "tail_lamp": (-3.5, -1.0),
}  # fmt: skip
# The same night, within the hour after a drive. Most of HIT-UAV's warm cars show a bright rim around a bonnet that is
# near the level of the ground or half as bright.
_DRIVEN: Mapping[str, Range] = {
    "roof": (-5.5, -3.0), "bonnet": (-3.0, 18.0), "boot": (-5.5, -2.5), "cowl": (-4.0, 9.0),
    "wing": (5.0, 27.0), "side": (-2.0, 2.0), "pillar": (-5.5, -2.0), "front": (5.0, 27.0),
    "rear": (-1.5, 3.0), "trim": (-3.0, 0.0), "windscreen": (-2.0, 8.0), "rear_window": (-3.0, 5.0),
    "window": (-3.0, 3.0), "sunroof": (-4.0, 1.0), "tyre": (8.0, 11.0), "rim": (6.0, 16.0), "brake": (17.0, 60.0),
    "underbody": (5.0, 20.0), "grille": (10.0, 40.0), "exhaust": (50.0, 250.0), "headlamp": (10.0, 30.0),
    "tail_lamp": (-1.0, 6.0),
}  # fmt: skip
# Summer sun: 71-73 C black, 63 C grey, 54 C silver, 44-45 C white at some 32 C air; the low end is a weak sun.
_SUN_ON_PAINT: Mapping[str, Range] = {
    "black": (16.0, 41.0), "grey": (12.0, 31.0), "silver": (9.0, 22.0), "white": (5.0, 13.0),
}  # fmt: skip
# Share of the roof's rise that other painted parts reach, in a high and in a low sun (est.).
_SUN_SHARE: Mapping[str, Range] = {
    "roof": (1.0, 1.0), "bonnet": (1.0, 1.0), "boot": (1.0, 1.0), "cowl": (1.0, 1.0), "wing": (0.7, 1.0),
    "side": (0.5, 0.85), "pillar": (0.7, 0.9), "front": (0.5, 0.9), "rear": (0.5, 0.85),
}  # fmt: skip
_DAY_SUN: Mapping[str, Range] = {
    "trim": (10.0, 30.0), "windscreen": (5.0, 20.0), "rear_window": (5.0, 20.0), "window": (3.0, 14.0),
    "sunroof": (8.0, 25.0), "tyre": (6.0, 20.0), "rim": (3.0, 12.0), "brake": (2.0, 8.0), "underbody": (-1.0, 6.0),
    "grille": (5.0, 18.0), "exhaust": (2.0, 10.0), "headlamp": (4.0, 14.0),
    "tail_lamp": (4.0, 14.0),
}  # fmt: skip

# In scenes with a sun: share of sunlight that paint absorbs (1 minus the reflectance of car bodies: black 0.05, silver
# 0.57, white 0.6 and more), and surface minus air without sunlight. Panels and screens cool towards the sky.
_ABSORPTIVITY: Mapping[str, Range] = {
    "black": (0.90, 0.95), "grey": (0.65, 0.85), "silver": (0.40, 0.50), "white": (0.25, 0.40),
}  # fmt: skip
_DAY_SHADE_K: Range = (-2.0, 1.0)
_DAY_SHADE: Mapping[str, Range] = {
    # Level panels lose some 63 W/m² to a clear sky, 3 to 4 K, upright ones nothing: the correction of ASHRAE's sol-air
    # temperature. Frames, doors and bumpers get heat from inside and from sunlit ground (est.): the bright outline of
    # HIT-UAV's cars by day.
    **dict.fromkeys(("roof", "bonnet", "boot", "cowl"), (-4.5, -2.0)),
    **dict.fromkeys(("side", "front", "rear"), (0.5, 4.5)),
    **dict.fromkeys(("underbody", "tyre", "rim", "grille", "brake"), (-1.0, 2.0)),
    "pillar": (1.0, 5.0), "wing": (0.0, 4.0), "trim": (0.0, 3.0),
    **dict.fromkeys(("windscreen", "rear_window", "sunroof"), (-4.0, 1.0)),
    "window": (-2.0, 3.0),
    "exhaust": (0.0, 4.0),
}  # fmt: skip
# Wind of driving takes the sun's heat off: 6.47 v^0.78 and radiation, with v of 8 to 15 m/s.
_DRIVING_W_M2_K = 45.0
_IN_THE_WIND = ("car_paint", "glass", "plastic")


# What stores heat: at dusk warm from the day, at dawn nearly as cold as the air, unless the engine heats it (est.).
_STORES = ("tyre", "rim", "brake", "underbody", "grille")
_BY_NIGHT: Mapping[str, str] = {"day_sun": "parked_cold", "day_driven": "driven"}
_BY_DAY: Mapping[str, str] = {night: day for day, night in _BY_NIGHT.items()}
_AT_DAWN = 0.5


def parts_for(params: Params) -> dict[str, PartRange]:
    """Return the thermal role of every part of the car with these parameters: state, colour, a low sun and shadow."""
    time = params.get("time_of_day")
    state = params["state"]
    if time not in LOW_SUN:
        return _parts_for(params)
    # Between what it has by night and by day.
    night = _parts_for({**params, "state": _BY_NIGHT.get(state, state)})
    day = _parts_for({**params, "state": _BY_DAY.get(state, state)})
    roles = at_low_sun(night, day, time)
    for part in _STORES:
        at_night = night[part].delta_t_k
        role = roles[part]
        by_day = day[part].sun
        assert role.sun is not None and by_day is not None
        if time == "dusk":
            delta = between(at_night, day[part].delta_t_k, STORED_SHARE[time])
            overcast = between(at_night, by_day.shade_k, STORED_SHARE[time])
        else:
            parked = _BY_NIGHT.get(state, state) == "parked_cold"
            delta = overcast = between(at_night, (0.0, 0.0), _AT_DAWN if parked else 0.0)
        sun = replace(role.sun, shade_k=delta, overcast_k=overcast)
        roles[part] = replace(role, delta_t_k=delta, sun=sun)
    return {**roles, **shade_roles(_DUSK_SHADE_K)} if params.get(SHADOW_PARAM) else roles


def _parts_for(params: Params) -> dict[str, PartRange]:
    deltas = _deltas(params["state"], params["colour"])
    roles = {part: part_role(kind, deltas[part], what) for part, (kind, what) in _SURFACES.items()}
    what = "ground sheltered from the sky, measured on HIT-UAV's cars by night"
    for part, (_, opacity) in GROUND_RINGS.items():
        roles[part] = warm_ground_role("asphalt", _GROUND_K, what, opacity, sheltered=True)
    if params.get(SHADOW_PARAM):
        roles |= shade_roles(_SHADE_K)
    if params["state"] in ("day_sun", "day_driven"):
        driven = _DRIVEN if params["state"] == "day_driven" else {}
        for part, (kind, _) in _SURFACES.items():
            cold, warm = _DAY_SHADE.get(part, _DAY_SHADE_K)
            engine = driven.get(part, (cold, warm))
            shade = max(cold, engine[0]), max(warm, engine[1])
            paint = _ABSORPTIVITY[params["colour"]] if kind == "car_paint" else None
            exchange = _DRIVING_W_M2_K if driven and kind in _IN_THE_WIND else None
            roles[part] = replace(roles[part], sun=sun_response(kind, shade, kind, paint, exchange))
    return roles


def _deltas(state: str, colour: str) -> dict[str, Range]:
    if state == "day_sun":
        low, high = _SUN_ON_PAINT[colour]
        return {**_DAY_SUN, **{part: (a * low, b * high) for part, (a, b) in _SUN_SHARE.items()}}
    if state == "day_driven":
        # The sun and the engine, whichever heats a part more.
        sun = _deltas("day_sun", colour)
        return {part: (max(a, sun[part][0]), max(b, sun[part][1])) for part, (a, b) in _DRIVEN.items()}
    return dict(_DRIVEN if state == "driven" else _PARKED_COLD)


PARTS: Mapping[str, PartRange] = parts_for({"state": "parked_cold", "colour": "grey"})
_PART_NAMES = (*PARTS, *SHADE_RINGS)
_PANELS = [_PART_NAMES.index(part) for part in ("roof", "pillar", "side", "wing", "front", "rear")]
_LID = [_PART_NAMES.index(part) for part in ("bonnet", "cowl")]


# --- parameters ----------------------------------------------------------------------------------------------


class _Body(NamedTuple):
    """Dimensions of a body type; heights are fractions of `height_m`, `*_at` of the length, from the nose."""

    lengths_m: Range
    length_m: float
    width_m: float
    height_m: float
    wheelbase_m: float
    front_overhang_m: float
    wheel_radius_m: float
    clearance_m: float
    top: tuple[tuple[float, float], ...]  # (behind the nose, height) of bonnet, waist and boot along the middle
    screen_at: Range  # foot and head of the windscreen
    rear_at: Range  # head and foot of the rear screen
    roof_width: float  # at the rain channel, as a fraction of the body's width
    rear_drop_m: float
    quarter_window: bool
    rear_pillar_m: Range  # thickness at waist and roof


_BODIES: Mapping[str, _Body] = {
    "saloon": _Body(
        (4.2, 5.3), 4.75, 1.83, 1.46, 2.80, 0.90, 0.335, 0.17,
        ((0, 0.47), (0.012, 0.51), (0.05, 0.55), (0.18, 0.605), (0.29, 0.655), (0.40, 0.665), (0.80, 0.69),
         (0.87, 0.695), (0.965, 0.685), (0.99, 0.65), (1, 0.58)),
        (0.29, 0.435), (0.73, 0.88), 0.735, 0.045, False, (0.30, 0.20),
    ),
    "hatchback": _Body(
        (3.6, 4.4), 4.2, 1.78, 1.49, 2.60, 0.85, 0.325, 0.17,
        ((0, 0.47), (0.012, 0.51), (0.05, 0.555), (0.18, 0.62), (0.27, 0.655), (0.40, 0.665), (0.80, 0.685),
         (0.97, 0.68), (0.99, 0.655), (1, 0.60)),
        (0.27, 0.43), (0.885, 0.972), 0.75, 0.06, False, (0.34, 0.28),
    ),
    "suv": _Body(
        (4.2, 5.0), 4.6, 1.88, 1.69, 2.70, 0.90, 0.365, 0.23,
        ((0, 0.50), (0.012, 0.555), (0.05, 0.59), (0.18, 0.635), (0.28, 0.66), (0.40, 0.67), (0.80, 0.685),
         (0.97, 0.68), (0.99, 0.66), (1, 0.61)),
        (0.28, 0.41), (0.90, 0.972), 0.77, 0.05, True, (0.85, 0.72),
    ),
    "estate": _Body(
        (4.4, 5.1), 4.75, 1.83, 1.48, 2.80, 0.90, 0.335, 0.17,
        ((0, 0.47), (0.012, 0.51), (0.05, 0.55), (0.18, 0.605), (0.29, 0.655), (0.40, 0.665), (0.80, 0.68),
         (0.97, 0.68), (0.99, 0.655), (1, 0.60)),
        (0.29, 0.445), (0.90, 0.975), 0.745, 0.045, True, (0.85, 0.75),
    ),
    "van": _Body(
        (4.7, 5.4), 5.0, 1.95, 1.93, 3.05, 0.93, 0.34, 0.18,
        ((0, 0.41), (0.012, 0.45), (0.05, 0.50), (0.13, 0.565), (0.18, 0.59), (0.30, 0.60), (0.80, 0.60), (0.97, 0.60),
         (0.99, 0.58), (1, 0.54)),
        (0.165, 0.31), (0.955, 0.985), 0.86, 0.02, True, (1.25, 1.20),
    ),
}  # fmt: skip

# Shares of cars that are parked and that have been driven within the last hour: by night fitted to the share of cars
# with bright parts in HIT-UAV's train, by day estimated.
_STATE_ODDS: Mapping[str, tuple[float, ...]] = {
    "night": (0.8, 0.2, 0.0, 0.0),
    "day": (0.0, 0.0, 0.75, 0.25),
    "dusk": (0.75, 0.25, 0.0, 0.0),
    "dawn": (0.8, 0.2, 0.0, 0.0),
}
_STATE = Choice(("parked_cold", "driven", "day_sun", "day_driven"), (0.5, 0.25, 0.19, 0.06))
DIALS = Dials(
    "car",
    {
        "body": Choice(tuple(_BODIES), (0.36, 0.22, 0.24, 0.06, 0.12)),
        "state": _STATE,
        "colour": Choice(("black", "grey", "silver", "white"), (0.25, 0.17, 0.2, 0.38)),
        "sunroof": Choice((False, True), (0.7, 0.3)),
        "rails": Choice((False, True), (0.35, 0.65), "by default only on an suv or estate"),
        "panelled": Choice((False, True), (0.65, 0.35), "by default only a van"),
        "exhausts": Choice((0, 1, 2), (0.2, 0.55, 0.25)),
        "spokes": Choice((5, 7, 10), (0.5, 0.2, 0.3)),
        "length_m": Number(
            (3.6, 5.4), (3.0, 6.5), by="body", ranges={name: b.lengths_m for name, b in _BODIES.items()}
        ),
        "width": Number((0.97, 1.04), (0.97, 1.04)),
        "height": Number((0.96, 1.04), (0.96, 1.04)),
        "wheelbase": Number((0.98, 1.02), (0.98, 1.02)),
        "wheel_radius": Number((0.95, 1.06), (0.95, 1.06)),
        "screen_rake": Number((-0.02, 0.02), (-0.02, 0.02)),
        "nose_taper": Number((0.7, 1.2), (0.7, 1.2)),
        "tail_taper": Number((0.7, 1.2), (0.7, 1.2)),
    },
)

NOMINAL: Params = {
    "sheltered": False,
    "body": "saloon",
    "state": "parked_cold",
    "colour": "grey",
    "sunroof": False,
    "rails": False,
    "panelled": False,
    "exhausts": 1,
    "spokes": 5,
    "length_m": 4.75,
    "width": 1.0,
    "height": 1.0,
    "wheelbase": 1.0,
    "wheel_radius": 1.0,
    "screen_rake": 0.0,
    "nose_taper": 1.0,
    "tail_taper": 1.0,
}
"""Parameters of a saloon; `{**NOMINAL, ...}` is handy for tests and pictures."""


def sample_params(rng: np.random.Generator, options: Params) -> Params:
    """Draw the parameters of one car, JSON values only.

    Every call takes the same number of values from `rng` in the same order, so fixing one option leaves the others
    as they would have been (except `length_m`, whose range depends on the body).

    Args:
        rng: Random stream to draw from.
        options: Values of parameters, as `DIALS` draws them, `sheltered` and `time_of_day`.
    """
    _CHECKS.known("option", options, (*NOMINAL, "time_of_day"))
    given = {name: value for name, value in options.items() if name not in ("sheltered", "time_of_day")}
    when = options.get("time_of_day")
    dials = DIALS
    if when is not None:
        _CHECKS.one_of("option time_of_day", when, tuple(_STATE_ODDS))
        dials = replace(DIALS, table={**DIALS.table, "state": replace(_STATE, odds=_STATE_ODDS[when])})
    params = dials.sample(rng, given)
    # Set only for bodies that may have them, so that equal cars have equal parameters.
    if "rails" not in options:
        params["rails"] = params["rails"] and params["body"] in ("suv", "estate")
    if "panelled" not in options:
        params["panelled"] = params["panelled"] and params["body"] == "van"
    sheltered = options.get("sheltered", when in ("night", "dawn") and params["state"] == "parked_cold")
    params["sheltered"] = _CHECKS.flag("option sheltered", sheltered)
    if when in LOW_SUN:
        params["time_of_day"] = when
    return params


def _require_params(params: Params) -> None:
    DIALS.require({k: v for k, v in params.items() if k not in ("sheltered", "time_of_day", SHADOW_PARAM)})
    _CHECKS.complete(params, ("sheltered",))
    _CHECKS.flag("parameter sheltered", params["sheltered"])
    if "time_of_day" in params:
        _CHECKS.one_of("parameter time_of_day", params["time_of_day"], LOW_SUN)


# --- plan: the curves that pieces share -----------------------------------------------------------------------


def _curve(points: ArrayLike, x: ArrayLike) -> FloatArray:
    """Return the value at x of a smooth curve through (P, 2) points of rising abscissa, without overshoot."""
    p = np.asarray(points, np.float64)
    px, py = p[:, 0], p[:, 1]
    step = np.diff(px)
    slope = np.diff(py) / step
    m = np.concatenate([slope[:1], np.zeros(len(px) - 2), slope[-1:]])
    same = slope[:-1] * slope[1:] > 0
    m[1:-1][same] = 2 * slope[:-1][same] * slope[1:][same] / (slope[:-1] + slope[1:])[same]
    at = np.clip(np.asarray(x, np.float64), px[0], px[-1])
    k = np.clip(np.searchsorted(px, at, side="right") - 1, 0, len(step) - 1)
    t = (at - px[k]) / step[k]
    rest = 1 - t
    return np.asarray(
        py[k] * (1 + 2 * t) * rest**2
        + m[k] * step[k] * t * rest**2
        + py[k + 1] * t**2 * (3 - 2 * t)
        - m[k + 1] * step[k] * t**2 * rest
    )


# Half width against height from sill (0) to waist (1), as a fraction of the largest half width.
_FLANK = ((0.0, 0.945), (0.16, 0.975), (0.40, 1.0), (0.72, 0.985), (1.0, 0.945), (1.3, 0.90))
_NOSE_M = 0.55
_TAIL_M = 0.42
_CROWN_M = 0.065


@dataclass(frozen=True)
class _Plan:
    """Dimensions and curves of one car; x is measured from the middle of its length."""

    p: Params

    @cached_property
    def body(self) -> _Body:
        return _BODIES[self.p["body"]]

    @cached_property
    def grown(self) -> float:
        """Length divided by that of the nominal car of this body."""
        return float(self.p["length_m"]) / self.body.length_m

    @cached_property
    def length(self) -> float:
        return float(self.p["length_m"])

    @cached_property
    def half(self) -> float:
        """Half width, which grows less than the length."""
        return float(0.5 * self.body.width_m * self.p["width"] * self.grown**0.45)

    @cached_property
    def height(self) -> float:
        return float(self.body.height_m * self.p["height"] * self.grown**0.15)

    @cached_property
    def wheel_radius(self) -> float:
        return float(self.body.wheel_radius_m * self.p["wheel_radius"] * self.grown**0.3)

    @cached_property
    def arch_radius(self) -> float:
        return self.wheel_radius + 0.05

    @cached_property
    def axles_x(self) -> tuple[float, float]:
        """Return x of the front and of the rear axle."""
        front = self.length / 2 - self.body.front_overhang_m * self.grown
        return front, front - self.body.wheelbase_m * self.grown * float(self.p["wheelbase"])

    def at(self, share: ArrayLike) -> FloatArray:
        """Return x of a point at a share of the length behind the nose."""
        return np.asarray(self.length * (0.5 - np.asarray(share, np.float64)))

    def to_nose(self, x: ArrayLike) -> FloatArray:
        """Return 0 behind the curve of the nose, rising to 1 at its tip."""
        return np.asarray(np.clip((np.asarray(x) - self.length / 2) / _NOSE_M + 1, 0, 1))

    def to_tail(self, x: ArrayLike) -> FloatArray:
        """Return 0 ahead of the curve of the tail, rising to 1 at its end."""
        return np.asarray(np.clip((-np.asarray(x) - self.length / 2) / _TAIL_M + 1, 0, 1))

    def taper(self, x: ArrayLike) -> FloatArray:
        """Return the half width at x as a fraction of the largest, seen from above."""
        nose = 0.27 * float(self.p["nose_taper"]) * self.to_nose(x) ** 3
        tail = 0.20 * float(self.p["tail_taper"]) * self.to_tail(x) ** 3
        return np.asarray(1 - 0.03 * (2 * np.asarray(x) / self.length) ** 2 - nose - tail)

    def bow(self, x: ArrayLike) -> FloatArray:
        """Return how far a section at x bends back (forward at the tail) at full half width."""
        nose = 0.17 * float(self.p["nose_taper"]) * self.to_nose(x) ** 2
        return np.asarray(nose - 0.09 * float(self.p["tail_taper"]) * self.to_tail(x) ** 2)

    def top(self, x: ArrayLike) -> FloatArray:
        """Return the height of bonnet, waist and boot along the middle."""
        return self.height * _curve(self.body.top, 0.5 - np.asarray(x) / self.length)

    def sill(self, x: ArrayLike) -> FloatArray:
        return np.asarray(self.body.clearance_m + 0.05 * self.to_nose(x) ** 2 + 0.12 * self.to_tail(x) ** 2)

    def flank(self, x: ArrayLike, z: ArrayLike) -> FloatArray:
        """Return y of the side at x and height z."""
        waist = 0.66 * self.height
        v = (np.asarray(z) - self.body.clearance_m) / (waist - self.body.clearance_m)
        return np.asarray(self.half * self.taper(x) * _curve(_FLANK, v))

    def roof(self, x: ArrayLike) -> FloatArray:
        """Return the height of the edge of the roof."""
        behind = np.clip(self.at(0.45) - np.asarray(x), 0, None) / (0.45 * self.length)
        return np.asarray(self.height - _CROWN_M - self.body.rear_drop_m * behind**2)

    def end_x(self, y: ArrayLike, z: float, end: int) -> FloatArray:
        """Return x of the nose (`end` 1) or tail (-1) at y and z, assuming that the bumper reaches this height."""
        y = np.asarray(y, np.float64)
        x = end * np.linspace(self.length / 2 - 0.6, self.length / 2, 25)
        wide = self.flank(x, np.full_like(x, z))
        skin = x - self.bow(x) * (wide / self.half) ** 2
        face = x[-1] - self.bow(x[-1]) * (y / self.half) ** 2
        return np.asarray(np.where(np.abs(y) < wide[-1], face, np.interp(np.abs(y), wide[::-1], skin[::-1])))


# --- pieces --------------------------------------------------------------------------------------------------

Piece = tuple[IntArray, FloatArray, IntArray, bool]
"""Part of each triangle (index into the part names), vertices, triangles, whether shading is smooth."""


class _Pieces:
    def __init__(self) -> None:
        self.items: list[Piece] = []

    def add(self, part: str | NDArray[np.intp], solid: Solid, *, smooth: bool = True) -> None:
        index = _PART_NAMES.index(part) if isinstance(part, str) else part
        parts = np.broadcast_to(np.asarray(index, np.int32), len(solid.triangles))
        self.items.append((parts, solid.vertices, solid.triangles, smooth))

    def add_both_sides(self, part: str, solid: Solid, *, smooth: bool = True) -> None:
        self.add(part, solid, smooth=smooth)
        self.add(part, shapes.mirrored(solid, 1), smooth=smooth)


def _ring(half: FloatArray) -> FloatArray:
    """Complete (R, K, 3) half rings with y >= 0, which start and end in the middle plane, to (R, N, 3) rings."""
    other = half[:, -2:0:-1] * (1.0, -1.0, 1.0)
    return np.concatenate([half, other], axis=1)


def _skin(rings: FloatArray, parts: NDArray[np.intp], start: int, end: int) -> tuple[NDArray[np.intp], Solid]:
    """Loft rings into a creased skin with closed ends.

    Args:
        rings: Rings as `_ring` returns them.
        parts: (R - 1, K - 1) parts of the faces of one half.
        start: Part of the cap on the first ring.
        end: Part of the cap on the last ring.
    """
    n = rings.shape[1]
    whole = np.concatenate([parts, parts[:, ::-1]], axis=1)
    of_triangle = np.concatenate([np.concatenate([row, row]) for row in whole])
    of_triangle = np.concatenate([of_triangle, np.full(n, start), np.full(n, end)])
    # The poles are between the middle points of their rings, so that the caps continue the curve of the ends.
    first, last = ((ring[0] + ring[n // 2]) / 2 for ring in (rings[0], rings[-1]))
    # Shading runs on across painted panels; glass, lids and floor have creased edges.
    panels = np.where(np.isin(of_triangle, _PANELS), -1, of_triangle)
    panels[np.isin(panels, _LID)] = -2
    return of_triangle, shapes.creased(shapes.loft(rings, start=first, end=last), math.radians(38), panels)


def _section_positions(plan: _Plan) -> FloatArray:
    """Return rising x of the sections of the lower body, dense at the rounded ends and along the wheel arches."""
    front, rear = plan.axles_x
    turn = plan.arch_radius * np.cos(np.linspace(math.pi, 0, 15))
    arch = np.concatenate([[-plan.arch_radius - 0.012], turn, [plan.arch_radius + 0.012]])
    arches = np.concatenate([rear + arch, front + arch])
    u = np.array([1.0, 0.985, 0.955, 0.90, 0.82, 0.72, 0.58, 0.40, 0.20])
    tail = -plan.length / 2 + _TAIL_M * (1 - u)
    nose = plan.length / 2 - _NOSE_M * (1 - u)
    between = plan.at(np.array([0.24, plan.body.screen_at[0], 0.36, 0.46, 0.56, 0.66, plan.body.rear_at[1]]))
    other = np.concatenate([tail, nose, between])
    kept = arches.tolist()
    for x in other.tolist():
        # Sections at the very ends are closer together than this.
        if abs(x) > plan.length / 2 - 0.05 or min(abs(x - k) for k in kept) > 0.02:
            kept.append(x)
    return np.sort(np.array(kept))


def _add_lower_body(out: _Pieces, plan: _Plan) -> None:
    """Add floor, wheel wells, flanks, bonnet and boot as one skin along x."""
    x = _section_positions(plan)
    low = plan.sill(x)
    edge = low.copy()
    for axle in plan.axles_x:
        inside = np.clip(plan.arch_radius**2 - (x - axle) ** 2, 0, None)
        edge = np.where(np.abs(x - axle) < plan.arch_radius + 0.006, plan.wheel_radius + np.sqrt(inside), edge)
    top = plan.top(x)
    shoulder = np.maximum(top - 0.045 - 0.03 * plan.to_nose(x), edge + 0.05)
    top = np.maximum(top, shoulder + 0.03)
    well = 0.66 * plan.half * plan.taper(x)
    columns = [(0 * x, low + 0.02), (well, low + 0.02), (well + 0.006, edge)]
    for t in (0.0, 0.22, 0.48, 0.75, 1.0):
        z = edge + (shoulder - edge) * t
        columns.append((plan.flank(x, z), z))
    y = columns[-1][0]
    for inward, up in ((0.965, 0.5), (0.88, 0.74), (0.62, 0.90), (0.32, 0.98), (0.0, 1.0)):
        columns.append((inward * y, shoulder + (top - shoulder) * up))
    half = np.empty((len(x), len(columns), 3))
    for j, (yj, zj) in enumerate(columns):
        half[:, j, 0] = x - plan.bow(x) * (yj / plan.half) ** 2
        half[:, j, 1], half[:, j, 2] = yj, zj

    middle = (x[:-1] + x[1:]) / 2
    share = 0.5 - middle / plan.length
    at_nose, at_tail = plan.to_nose(middle) > 0.86, plan.to_tail(middle) > 0.86
    name = {n: _PART_NAMES.index(n) for n in _PART_NAMES}
    parts = np.full((len(middle), len(columns) - 1), name["side"], np.intp)
    foot = plan.body.screen_at[0] + 0.015
    parts[share < foot, 9:] = name["bonnet"]
    parts[(share < foot) & (share > 0.7 * foot), 9:] = name["cowl"]
    parts[share < foot, 5:9] = name["wing"]
    if plan.p["body"] == "saloon":
        parts[share > plan.body.rear_at[1] - 0.015, 7:] = name["boot"]
    parts[middle > plan.axles_x[0] + plan.arch_radius, 3:5] = name["front"]
    parts[middle < plan.axles_x[1] - plan.arch_radius, 3:5] = name["rear"]
    parts[at_nose, 3:7] = name["front"]
    parts[plan.to_nose(middle) > 0.6, 3:] = name["front"]
    parts[at_tail, 3:7] = name["rear"]
    if plan.p["body"] != "saloon":
        parts[at_tail, 7:] = name["rear"]
    parts[:, :3] = name["underbody"]
    out.add(*_skin(_ring(half), parts, name["rear"], name["front"]))


_LEVELS = (-0.10, 0.0, 0.05, 0.45, 0.85, 0.94, 1.0)
_ROOF_RINGS = (0.96, 0.88, 0.76, 0.60, 0.42, 0.22)


def _add_cabin(out: _Pieces, plan: _Plan) -> None:
    """Add windscreen, windows, pillars and roof as one skin from bottom to top."""
    levels = _cabin_levels(plan)
    edge = levels[-1]
    centre_x = (edge[0, 0] + edge[-1, 0]) / 2
    for s in _ROOF_RINGS:
        xs = centre_x + (edge[:, 0] - centre_x) * s
        levels.append(np.stack([xs, edge[:, 1] * s, plan.roof(xs) + _CROWN_M * (1 - s**2)], axis=1))
    half = np.stack(levels)

    name = {n: _PART_NAMES.index(n) for n in _PART_NAMES}
    parts = np.full((len(half) - 1, half.shape[1] - 1), name["pillar"], np.intp)
    parts[5:] = name["roof"]
    parts[:5, :2] = name["windscreen"]
    parts[1 if plan.p["body"] == "saloon" else 2 : 4, 11:13] = name["rear_window"]
    parts[2:4, 4] = name["window"]
    if not plan.p["panelled"]:
        parts[2:4, 6] = name["window"]
        if plan.body.quarter_window:
            parts[2:4, 8] = name["window"]
    else:
        parts[2:4, 6:9] = name["side"]
        parts[2:4, 11:13] = name["rear"]
    out.add(*_skin(_ring(half), parts, name["side"], name["roof"]))
    _add_on_roof(out, plan, edge)
    # Mirrors at the foot of the windscreen pillars.
    foot = half[2, 4]
    at = np.array([foot[0] - 0.06, plan.half + 0.03, foot[2] + 0.07])
    out.add_both_sides("trim", shapes.placed(shapes.ellipsoid((0.065, 0.09, 0.068), 14, 8), shapes.turn_z(0.15), at))
    out.add_both_sides("trim", shapes.capsule(at, (at[0], 0.88 * plan.half, at[2] - 0.06), 0.022, n=8))


def _cabin_levels(plan: _Plan) -> list[FloatArray]:
    """Return half an outline of the cabin at each level, (14, 3) from windscreen over the sides to the rear window."""
    body = plan.body
    rake = float(plan.p["screen_rake"])
    levels: list[FloatArray] = []
    # Start at the roof: its pillars fix the position of the middle one, which is upright.
    for t in (1.0, *_LEVELS):
        wide = plan.half * (0.905 + (body.roof_width - 0.905) * (max(t, 0.0) ** 1.15 if t > 0 else t))
        bulge = 0.10 * t * (1 - t)
        front = float(plan.at(body.screen_at[0] + (body.screen_at[1] + rake - body.screen_at[0]) * t)) + bulge
        rear = float(plan.at(body.rear_at[1] + (body.rear_at[0] - body.rear_at[1]) * t)) - bulge
        bow = 0.24 - 0.06 * t
        in_front = np.array([0.0, 0.5, 1 - 0.11 / wide, 1 - 0.025 / wide])
        behind = np.array([1 - 0.03 / wide, 1 - 0.13 / wide, 0.5, 0.0])
        x_front = front - bow * in_front**2.5
        x_behind = rear + 0.11 * behind**2.5
        first, last = front - bow - 0.07, rear + 0.11 + 0.09
        pillar = last + body.rear_pillar_m[0] + (body.rear_pillar_m[1] - body.rear_pillar_m[0]) * t
        if not levels:
            centre = 0.5 * (first + pillar)
        side = np.array([first, centre + 0.04, centre - 0.04, pillar, pillar - 0.10, last])
        xs = np.concatenate([x_front, side, x_behind])
        ys = wide * np.concatenate([in_front, np.ones(len(side)), behind]) * plan.taper(xs) ** 0.8
        foot = plan.top(xs) - 0.05
        levels.append(np.stack([xs, ys, foot + (plan.roof(xs) - foot) * t], axis=1))
    return levels[1:]


def _add_on_roof(out: _Pieces, plan: _Plan, edge: FloatArray) -> None:
    """Add sunroof and rails on a roof whose edge is half an outline of the cabin."""
    centre_x = (edge[0, 0] + edge[-1, 0]) / 2
    span = edge[0, 0] - edge[-1, 0]
    if plan.p["sunroof"]:
        x = np.linspace(edge[0, 0] - 0.18 - 0.34 * span, edge[0, 0] - 0.18, 6)
        reach = np.abs(x - centre_x) / (span / 2)
        path = np.stack([x, 0 * x, plan.roof(x) + _CROWN_M * (1 - reach**2) - 0.012], axis=1)
        out.add("sunroof", shapes.sweep(path, 0.55 * float(edge[5, 1]), 0.02, n=24, exponent=6.0))
    if plan.p["rails"]:
        x = np.linspace(edge[9, 0] + 0.12, edge[4, 0] - 0.10, 7)
        y = 0.93 * np.interp(x, edge[9:3:-1, 0], edge[9:3:-1, 1])
        z = plan.roof(x) + 0.055 - 0.05 * np.linspace(-1, 1, 7) ** 6
        out.add_both_sides("trim", shapes.sweep(np.stack([x, y, z], axis=1), 0.02, 0.018, n=8, round_ends=True))


def _bar(plan: _Plan, share: Range, z: float, half_height: ArrayLike, end: int) -> Solid:
    """Return a bar that follows nose or tail from one share of the half width to another."""
    y = plan.half * np.linspace(*share, 9)
    x = plan.end_x(y, z, end) - end * 0.018
    path = np.stack([x, y, np.full(9, z)], axis=1)
    return shapes.sweep(path, 0.03, half_height, n=16, exponent=5.0)


def _add_ends(out: _Pieces, plan: _Plan) -> None:
    """Add lamps, grille, intake and exhaust."""
    lead = float(plan.top(plan.length / 2))
    tall = plan.p["body"] in ("suv", "van")
    deep = np.linspace(0.035, 0.065, 9) * (1.2 if tall else 1.0)
    out.add_both_sides("headlamp", _bar(plan, (0.50, 0.88), lead - 0.09, deep, 1))
    out.add("grille", _bar(plan, (-0.42, 0.42), lead - 0.12, 0.075, 1))
    out.add("grille", _bar(plan, (-0.55, 0.55), float(plan.sill(plan.length / 2)) + 0.11, 0.055, 1))
    back = float(plan.top(-plan.length / 2))
    if tall or plan.p["body"] == "hatchback":
        out.add_both_sides("tail_lamp", _bar(plan, (0.72, 0.90), back - 0.14, 0.13, -1))
    else:
        out.add_both_sides("tail_lamp", _bar(plan, (0.48, 0.88), back - 0.09, deep, -1))
    pipe = shapes.placed(shapes.cylinder(0.035, 0.0, 0.30, 14, 0.006), shapes.turn_y(-math.pi / 2))
    for side in (1, -1)[: plan.p["exhausts"]]:
        y = 0.48 * plan.half * side
        x = float(plan.end_x(y, 0.35, -1)) + 0.285
        out.add("exhaust", shapes.moved(pipe, (x, y, float(plan.sill(-plan.length / 2)) - 0.005)))


def _add_wheels(out: _Pieces, plan: _Plan) -> None:
    r = plan.wheel_radius
    wide = 0.215
    rim = 0.66 * r
    tyre = shapes.lathe(
        [
            (rim, -0.42 * wide),
            (0.82 * r, -0.5 * wide),
            (0.95 * r, -0.45 * wide),
            (r, -0.34 * wide),
            (r, 0.34 * wide),
            (0.95 * r, 0.45 * wide),
            (0.82 * r, 0.5 * wide),
            (rim, 0.42 * wide),
        ],
        28,
        wrap=True,
    )
    lip = shapes.lathe(
        [(0.90 * rim, -0.3 * wide), (1.03 * rim, -0.3 * wide), (1.03 * rim, 0.40 * wide), (0.90 * rim, 0.36 * wide)],
        28,
        wrap=True,
    )
    pieces = [("tyre", tyre), ("rim", lip), ("brake", shapes.cylinder(0.96 * rim, -0.3 * wide, 0.0, 24))]
    pieces.append(("rim", shapes.lathe([(0.24 * rim, 0.0), (0.24 * rim, 0.30 * wide), (0.0, 0.34 * wide)], 16)))
    count = int(plan.p["spokes"])
    spoke = shapes.moved(
        shapes.box((0.80 * rim, 1.5 * rim / count, 0.10 * wide), 0.02 * wide), (0.55 * rim, 0, 0.27 * wide)
    )
    pieces += [("rim", shapes.placed(spoke, shapes.turn_z(2 * math.pi * k / count))) for k in range(count)]
    outward = shapes.turn_x(-math.pi / 2)
    for x in plan.axles_x:
        y = float(plan.flank(x, np.array(2 * r))) - 0.5 * wide - 0.012
        for part, solid in pieces:
            out.add_both_sides(
                part, shapes.placed(solid, outward, (x, y, r)), smooth=part != "rim" or solid is not spoke
            )


# --- the model -----------------------------------------------------------------------------------------------


def build_car(params: Params) -> Mesh:
    """Build the mesh of one car: origin on the ground below the middle of its length, +X its nose."""
    _require_params(params)
    pieces = _kept_pieces(tuple((name, params[name]) for name in NOMINAL))
    closed = np.unique(np.concatenate([p for p, _, _, _ in pieces]))
    vertices = np.concatenate([v for _, v, _, _ in pieces])
    vertices[:, 0] -= (vertices[:, 0].min() + vertices[:, 0].max()) / 2
    if params["sheltered"]:
        reach = vertices[:, :2].max(axis=0)
        rings = _ground_rings(float(reach[0]), 0.94 * float(reach[1]))
        pieces = [*pieces, rings]
        vertices = np.concatenate([vertices, rings[1]])
    if params.get(SHADOW_PARAM):
        pieces = [*pieces, _ground_shade(vertices, params[SHADOW_PARAM])]
        vertices = np.concatenate([vertices, pieces[-1][1]])
    first = np.cumsum([0, *(len(v) for _, v, _, _ in pieces[:-1])])
    parts = np.concatenate([p for p, _, _, _ in pieces])
    used, index = np.unique(parts, return_inverse=True)
    return Mesh(
        vertices,
        np.concatenate([t + f for (_, _, t, _), f in zip(pieces, first, strict=True)]).astype(np.int32),
        index.reshape(-1).astype(np.int32),
        tuple(_PART_NAMES[k] for k in used),
        np.concatenate([np.full(len(t), smooth) for _, _, t, smooth in pieces]),
        frozenset(_PART_NAMES[k] for k in closed),
    )


@lru_cache(maxsize=32)
def _kept_pieces(params: tuple[tuple[str, Any], ...]) -> list[Piece]:
    """Return `_build_pieces`; a car that has found its place is built again, with a shadow."""
    return _build_pieces(dict(params))


def _build_pieces(params: Params) -> list[Piece]:
    """Return the closed solids of one car."""
    plan = _Plan(params)
    out = _Pieces()
    _add_lower_body(out, plan)
    _add_cabin(out, plan)
    _add_ends(out, plan)
    _add_wheels(out, plan)
    return out.items


def _ground_rings(half_x_m: float, half_y_m: float) -> Piece:
    """Return flat rings around the car just above the ground; the innermost starts well under the car."""
    loops = [shapes.rounded_rectangle(half_x_m - 0.5, half_y_m - 0.3, 0.3, 5)]
    loops += [
        shapes.rounded_rectangle(half_x_m + out_m, half_y_m + out_m, 0.3 + out_m, 5)
        for out_m, _ in GROUND_RINGS.values()
    ]
    triangles = shapes.ring_strips(len(loops[0]), len(loops))
    of_ring = len(triangles) // len(GROUND_RINGS)
    parts = np.repeat([_PART_NAMES.index(part) for part in GROUND_RINGS], of_ring).astype(np.int32)
    flat = np.concatenate(loops)
    vertices = np.concatenate([flat, np.full((len(flat), 1), 0.005)], axis=1)
    return parts, vertices, triangles, True


def _casts_shadow(params: Params) -> bool:
    if params.get("time_of_day") is None:
        return bool(params["state"] == "day_sun")
    return params["time_of_day"] == "dusk" and params["state"] in ("day_sun", "parked_cold")


def _ground_shade(vertices: FloatArray, shift_xy: ArrayLike) -> Piece:
    """Return the sheet of ground that the car keeps the sun off."""
    sheet, triangles, ring = shade_sheet(vertices, shift_xy)
    parts = np.array([_PART_NAMES.index(part) for part in SHADE_RINGS], np.int32)[ring]
    return parts, sheet, triangles, True


MODEL = ObjectModel(
    name="car",
    category="car",
    description="A saloon, hatchback, SUV, estate or van: parked on a cold night, just driven, or in the sun.",
    origin="on the ground below the middle of the car; +X is its nose",
    stands=True,
    # Car parks are roads to the model of surfaces.
    surfaces={"road": 1.0, "track": 0.5},
    parts={**PARTS, **shade_roles(_SHADE_K)},
    sample=sample_params,
    build=build_car,
    options={
        **DIALS.options,
        "sheltered": (
            "true or false: warm rim of ground that the car shields from the sky; by default for cars parked at night"
        ),
        "time_of_day": "day, dusk, night or dawn: the states that can be drawn; by default as in the background",
    },
    parts_for=parts_for,
    casts_shadow=_casts_shadow,
)
