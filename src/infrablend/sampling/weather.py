"""Air, sky, ground and sun of a frame."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from infrablend.config.recipe import Environment, SkyEnvironment
from infrablend.core.capture import Capture
from infrablend.core.rng import stream
from infrablend.core.scene import Sun, Weather
from infrablend.sampling.site import FrameKey
from infrablend.thermal.daytime import LOW_SUN_DEG, OVERCAST_SHARE, local_moment, time_by_sun, time_of_sun
from infrablend.thermal.radiometry import ZERO_C_K
from infrablend.thermal.sky import dew_point, irradiance, sun_position, time_of

# A range of the recipe up to which the air counts as known, kelvin.
_KNOWN_K = 5.0


def draw_air_k(frame: FrameKey, environment: Environment, rng: np.random.Generator) -> float:
    """Return the temperature of the air: a draw from the recipe's range, or that of the picture's file."""
    drawn = float(rng.uniform(*environment.air_temperature_c)) + ZERO_C_K
    if environment.air_of_picture and frame.capture.radiometry is not None:
        return frame.capture.radiometry.plausible_air_k or drawn
    return drawn


def air_source(frame: FrameKey, environment: Environment) -> Literal["metadata", "stated", "drawn"]:
    """Return where the temperature of the air comes from: the picture's file, the recipe, or a draw from its range."""
    if frame.capture.radiometry is not None and frame.capture.radiometry.plausible_air_k is not None:
        return "metadata"
    low, high = environment.air_temperature_c
    return "stated" if low == high else "drawn"


def knows_air(environment: Environment) -> bool:
    """Return whether bodies follow the air: it is known, from a narrow range, or levels are temperatures."""
    low, high = environment.air_temperature_c
    return environment.air_of_picture or high - low <= _KNOWN_K


def used_time(capture: Capture, environment: SkyEnvironment) -> Capture:
    """Return how a picture was taken with the time of day that counts, and what this is taken from.

    A stated time counts first, then that of the sun by time of capture and stated place, then the dataset's own, then
    that of the sun by the picture's own place. Where sun and dataset say day and night, something is wrong, and the
    dataset's own stays.
    """
    if environment.time_of_day is not None:
        return replace(capture, time_of_day=environment.time_of_day, time_from="recipe")
    stated = environment.place
    if stated is None:
        if capture.time_of_day is not None or capture.place is None:
            return capture
        by_sun = time_by_sun(capture.captured, *capture.place)
        return capture if by_sun is None else replace(capture, time_of_day=by_sun[0], time_from="sun")
    when = time_of(capture.captured)
    if when is None:
        return capture
    found = time_of_sun(when, stated.latitude_deg, stated.longitude_deg)
    if {found, capture.time_of_day} == {"day", "night"}:
        return capture
    return replace(capture, time_of_day=found, time_from="sun")


def draw_weather(frame: FrameKey, e: SkyEnvironment, air_k: float, seed: int) -> Weather:
    """Draw air, sky and ground of the frame, from a stream of its own.

    With radiometric matching, humidity is that of the picture's file if it states one, and the ground is that of the
    picture: it gets its temperature from there when the objects are in their places.
    """
    rng = stream(seed, frame.frame_id, "weather")
    below = float(rng.uniform(*e.dew_point_below_air_k))
    rng.random()  # of a quantity that was removed: the draws after it stay those of earlier versions
    clear, cover, base = (float(v) for v in rng.random(3))
    time = frame.capture.time_of_day
    above = e.ground_above_air_k(time)
    ground_above_k = 0.0 if above is None else float(rng.uniform(*above))
    humidity = None if frame.capture.radiometry is None else frame.capture.radiometry.plausible_humidity
    if e.air_of_picture and humidity is not None:
        below = air_k - dew_point(air_k, humidity)
    sun = None
    if time not in ("night", None):
        # The sun and the clouds are those of the whole sequence.
        together = stream(seed, "sun", frame.capture.sequence or frame.capture.captured or frame.frame_id)
        clear, cover, share, turn = (float(v) for v in together.random(4))
        sun = _sun(frame, e, share, turn, _cloud(e, clear, cover))
    cloud = _cloud(e, clear, cover)
    return Weather(
        air_k=air_k,
        dew_point_k=air_k - below,
        cloud=cloud,
        cloud_base_k=air_k - (5 + 5 * base),
        ground_k=air_k + (OVERCAST_SHARE * ground_above_k if cloud == 1 else ground_above_k),
        sun=sun,
    )


def _cloud(environment: SkyEnvironment, clear: float, cover: float) -> float:
    """Return the share of the sky that clouds cover; `clear` and `cover` are drawn numbers in [0, 1)."""
    if clear >= 1 - environment.overcast_share:
        return 1.0
    return 0.0 if clear < environment.clear_share else cover


def _sun(frame: FrameKey, environment: SkyEnvironment, share: float, turn: float, cloud: float) -> Sun:
    """Return the sun over a frame.

    Its azimuth is relative to the camera's heading, which few datasets state, and is always drawn. `share` and
    `turn` are drawn numbers in [0, 1) that set elevation and azimuth; `cloud` is the share that clouds cover.
    """
    is_low = frame.capture.time_of_day != "day"
    low, high = LOW_SUN_DEG if is_low else environment.sun_elevation_deg
    elevation = math.radians(low + (high - low) * share)
    source: Literal["computed", "drawn", "contradicted"] = "drawn"
    stated = environment.place
    place = frame.capture.place if stated is None else (stated.latitude_deg, stated.longitude_deg)
    when = exact = time_of(frame.capture.captured)
    if exact is None and stated is None and place is not None:
        when = local_moment(frame.capture.captured, place[1])
    if place is not None and when is not None:
        _, computed = sun_position(when, *place)
        if low <= math.degrees(computed) <= high if is_low else computed > 0:
            elevation = computed
            source = "computed"
        elif exact is not None and frame.capture.time_from != "recipe":
            source = "contradicted"
    direct, diffuse = irradiance(elevation, cloud)
    return Sun(2 * math.pi * turn, elevation, direct, diffuse, source)
