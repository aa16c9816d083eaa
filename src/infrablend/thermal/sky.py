"""The sky's radiance by zenith angle, the transmittance of the air between object and camera, and the sun.

Irradiance of a clear sky after Haurwitz (1945), which needs the sun's elevation only; clouds after Kasten and Czeplak
(1980); rays after Meinel and Meinel (1976). Position of the sun after the low-precision formulas of the
Astronomical Almanac (0.01 degrees from 1950 to 2050).
"""

from __future__ import annotations

import math
from datetime import UTC, datetime

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infrablend.thermal.radiometry import STEFAN_BOLTZMANN_W_M2_K4, ZERO_C_K, band_radiance, radiance_at

Array = NDArray[np.float64]

# The zenith never lets more through than this: its emissivity is at least 0.12.
_CLEAREST = 0.88
# Mean slant of the sky's radiation, as a multiple of the vertical path.
_DIFFUSIVITY = 1.66
# The empirical form of the air's transmittance falls too fast in warm, humid air: at 40 degrees Celsius and 1000 m even
# below zero. Contrasts are divided by the transmittance, so the floor keeps their gain at 5 or less. Up to 30 degrees
# and 1000 m the form stays above 0.36.
_LEAST_TRANSMITTANCE = 0.2
# Share of a clear sky's irradiance that is scattered, in a high sun and dry air (est.; 0.3 in Hamburg by Kasten and
# Czeplak, down to 0.1 in deserts).
CLEAR_DIFFUSE_SHARE = 0.15


def clear_sky_emissivity(dew_point_k: float) -> float:
    """Return e0 in [0, 1], the broadband emissivity of a clear sky at this dew point, K (Berdahl and Martin's form)."""
    t = (dew_point_k - ZERO_C_K) / 100
    return float(np.clip(0.711 + 0.56 * t + 0.73 * t**2, 0, 1))


def window_transmittance(air_k: float, dew_point_k: float) -> float:
    """Return the share in (0, 0.88] of the 8-14 um radiation that a clear sky lets through straight up.

    It follows from the broadband emissivity e0. Nearly everything that a clear sky lacks of a blackbody it lacks in
    this window, so at the mean slant t53 = (1 - e0) / f with f = pi L(Ta) / (sigma Ta^4); at the zenith t53^(1/1.66).

    Raises:
        ValueError: The dew point is above the air temperature.
    """
    if dew_point_k > air_k:
        raise ValueError(f"dew_point_k {dew_point_k:g} is above air_k {air_k:g}")
    window = np.pi * radiance_at(air_k) / (STEFAN_BOLTZMANN_W_M2_K4 * air_k**4)
    slant = max((1 - clear_sky_emissivity(dew_point_k)) / window, 1e-3)
    return float(min(slant ** (1 / _DIFFUSIVITY), _CLEAREST))


def sky_radiance(
    air_k: float, dew_point_k: float, zenith_rad: ArrayLike, cloud: float = 0.0, cloud_base_k: float | None = None
) -> Array:
    """Return the 8-14 um radiance of the sky, W m^-2 sr^-1, at angles from the zenith.

    A clear sky at angle z has (1 - t^(1 / cos z)) L(Ta) with t = `window_transmittance`; this never exceeds L(Ta), the
    radiance of the horizon. At the zenith it is uncertain by about 15 K of apparent temperature, which is 1 K on a roof
    of emissivity 0.95. The horizon is at pi/2. Clouds are by default 7 K colder than the air.

    Raises:
        ValueError: The dew point is above the air temperature, or the cover outside [0, 1].
    """
    if not 0 <= cloud <= 1:
        raise ValueError(f"cloud {cloud:g} must lie in [0, 1]")
    of_air = radiance_at(air_k)
    zenith = window_transmittance(air_k, dew_point_k)
    cos = np.maximum(np.cos(np.asarray(zenith_rad, np.float64)), np.cos(np.radians(89.0)))
    clear = (1 - zenith ** (1 / cos)) * of_air
    of_cloud = float(band_radiance(cloud_base_k if cloud_base_k is not None else air_k - 7.0))
    return np.asarray((1 - cloud) * clear + cloud * of_cloud)


def transmittance(distance_m: ArrayLike, air_k: float, humidity: float) -> Array:
    """Return tau in [0.2, 1], the long-wave transmittance of the air along a path; FLIR's empirical form.

    Valid for 0 to about 1000 m, -20 to 40 degrees Celsius. tau(0) = 1; it falls with distance, humidity and warmth,
    down to a floor of 0.2 that only air above 33 degrees reaches.
    """
    if not 0 <= humidity <= 1:
        raise ValueError(f"humidity {humidity:g} must lie in [0, 1] (it is not a percentage)")
    t = air_k - ZERO_C_K
    water = humidity * np.exp(1.5587 + 0.06939 * t - 0.00027816 * t**2 + 6.8455e-7 * t**3)
    s = np.sqrt(np.asarray(distance_m, np.float64))
    q = np.sqrt(water)
    tau = 1.9 * np.exp(-s * (0.006569 - 0.002276 * q)) - 0.9 * np.exp(-s * (0.01262 - 0.00667 * q))
    return np.asarray(np.maximum(tau, _LEAST_TRANSMITTANCE))


def relative_humidity(air_k: float, dew_point_k: float) -> float:
    """Return the relative humidity in [0, 1] from air temperature and dew point (at most the former), kelvin.

    Magnus' formula with a = 17.625, b = 243.04 C, good to 0.4 % from -40 to 50 C (Alduchov and Eskridge 1996).
    """
    air_c = air_k - ZERO_C_K
    dew_c = min(dew_point_k, air_k) - ZERO_C_K
    return math.exp(17.625 * dew_c / (243.04 + dew_c) - 17.625 * air_c / (243.04 + air_c))


def dew_point(air_k: float, humidity: float) -> float:
    """Return the dew point, kelvin, of air at this relative humidity: the inverse of `relative_humidity`.

    Raises:
        ValueError: The humidity is not above 0 and up to 1.
    """
    if not 0 < humidity <= 1:
        raise ValueError(f"humidity {humidity:g} must be above 0 and up to 1 (it is not a percentage)")
    air_c = air_k - ZERO_C_K
    level = math.log(humidity) + 17.625 * air_c / (243.04 + air_c)
    return min(243.04 * level / (17.625 - level) + ZERO_C_K, air_k)


def irradiance(elevation_rad: float, cloud: float = 0.0) -> tuple[float, float]:
    """Return direct irradiance at right angles to the rays, and diffuse irradiance of level ground, W m^-2.

    Rays are at most 1353 * 0.7^(AM^0.678) W m^-2 (Meinel and Meinel 1976) at an air mass after Kasten and Young (1989),
    less what clouds keep back. Below about 45 degrees that is less than a fixed share of Haurwitz' irradiance; the rest
    of it is diffuse.
    """
    up = math.sin(elevation_rad)
    if up <= 0:
        return 0.0, 0.0
    direct, diffuse = _divided(up, cloud)
    if direct <= 0:
        return direct, diffuse
    clear, _ = _divided(up, 0.0)
    mass = 1 / (up + 0.50572 * (6.07995 + math.degrees(elevation_rad)) ** -1.6364)
    rays = min(1353 * 0.7 ** (mass**0.678) * direct / clear, direct)
    return rays, diffuse + (direct - rays) * up


def _divided(up: float, cloud: float) -> tuple[float, float]:
    """Return what `irradiance` does, with a share of direct light that only clouds change; `up` is the sine."""
    level = 1098 * up * math.exp(-0.059 / up) * (1 - 0.75 * cloud**3.4)
    diffuse = level * (CLEAR_DIFFUSE_SHARE + (1 - CLEAR_DIFFUSE_SHARE) * cloud**2)
    return (level - diffuse) / up, diffuse


def sun_position(when: datetime, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    """Return azimuth (clockwise from north) and elevation of the sun, radians; refraction is left out.

    North and east are positive.

    Raises:
        ValueError: The time has no time zone.
    """
    if when.tzinfo is None:
        raise ValueError(f"{when.isoformat()} has no time zone; expected one, e.g. {when.isoformat()}+08:00")
    days = (when.astimezone(UTC) - datetime(2000, 1, 1, 12, tzinfo=UTC)).total_seconds() / 86_400
    anomaly = math.radians(357.528 + 0.9856003 * days)
    longitude = math.radians(280.460 + 0.9856474 * days + 1.915 * math.sin(anomaly) + 0.020 * math.sin(2 * anomaly))
    tilt = math.radians(23.439 - 4e-7 * days)
    ascension = math.atan2(math.cos(tilt) * math.sin(longitude), math.cos(longitude))
    declination = math.asin(math.sin(tilt) * math.sin(longitude))
    sidereal = math.radians(280.46062 + 360.98564737 * days + longitude_deg)
    hour = sidereal - ascension
    latitude = math.radians(latitude_deg)
    up = math.sin(latitude) * math.sin(declination) + math.cos(latitude) * math.cos(declination) * math.cos(hour)
    east = -math.cos(declination) * math.sin(hour)
    north = math.cos(latitude) * math.sin(declination) - math.sin(latitude) * math.cos(declination) * math.cos(hour)
    return math.atan2(east, north) % (2 * math.pi), math.asin(max(-1.0, min(1.0, up)))


def time_of(captured: str | None) -> datetime | None:
    """Return the time in an ISO 8601 text that has both a time and a time zone; else None."""
    if captured is None or len(captured) <= 10:
        return None
    try:
        when = datetime.fromisoformat(captured)
    except ValueError:
        return None
    try:
        return when if when.tzinfo is not None and when.astimezone(UTC) else None
    except OverflowError:  # the first or last hours that dates can express
        return None
