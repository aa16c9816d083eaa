"""The sun: its position in the sky, and the irradiance of surfaces.

Irradiance of a clear sky after Haurwitz (1945), which needs the sun's elevation only; clouds after Kasten and Czeplak
(1980). Position after the low-precision formulas of the Astronomical Almanac (0.01 degrees from 1950 to 2050).
"""

from __future__ import annotations

import math
from datetime import UTC, datetime

# Share of a clear sky's irradiance that is scattered, in a high sun and dry air (est.; 0.3 in Hamburg by Kasten and
# Czeplak, down to 0.1 in deserts).
CLEAR_DIFFUSE_SHARE = 0.15


def irradiance(elevation_rad: float, cloud: float = 0.0) -> tuple[float, float]:
    """Return direct irradiance at right angles to the rays, and diffuse irradiance of level ground, W m^-2.

    Args:
        elevation_rad: Elevation of the sun above the horizon.
        cloud: Share of the sky that clouds cover, 0 to 1.
    """
    up = math.sin(elevation_rad)
    if up <= 0:
        return 0.0, 0.0
    level = 1098 * up * math.exp(-0.059 / up) * (1 - 0.75 * cloud**3.4)
    diffuse = level * (CLEAR_DIFFUSE_SHARE + (1 - CLEAR_DIFFUSE_SHARE) * cloud**2)
    return (level - diffuse) / up, diffuse


def sun_position(when: datetime, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    """Return azimuth (clockwise from north) and elevation of the sun, radians; refraction is left out.

    Args:
        when: Time with its time zone.
        latitude_deg: Latitude, north positive.
        longitude_deg: Longitude, east positive.

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
    hour, latitude = sidereal - ascension, math.radians(latitude_deg)
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
