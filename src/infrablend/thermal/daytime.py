"""Day, dusk, night and dawn by the sun, and what stays of the day's heat.

The sun is low from the end of civil twilight, -6 degrees, to 8 degrees, around which passive surfaces swap places in
the morning (thermal crossover). The shares below follow from an energy balance (bench/daytime.py at
commit 7a8fc2b5).
"""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta, timezone

from infrablend.core.capture import TimeOfDay
from infrablend.thermal.sky import sun_position, time_of

Range = tuple[float, float]

LOW_SUN_DEG: Range = (-6.0, 8.0)
"""Elevations of the sun at dusk and dawn, degrees."""
STORED_SHARE = {"night": 0.0, "dusk": 0.3, "dawn": -0.15, "day": 1.0}
"""Temperature of what stores heat (ground, tyres), between that by night (0) and by day (1)."""
OVERCAST_SHARE = 0.3
"""Excess of the ground over the air under a closed cloud cover, as a share of that under other skies."""
SKY_COOLING_SHARE = 0.15
"""The same for what surfaces lose to the sky: 0.6 K of a roof's 4 to 8.5 K."""

# A local clock is within this of the sun's time: time zones and daylight saving.
_CLOCK_OFF_H = (-2, -1, 0, 1, 2)
# By a clock of an unknown zone, it is day or night where the sun is beyond these at all times that it may mean.
_DAY_ABOVE_DEG = 3.0
_NIGHT_BELOW_DEG = -3.0


def time_of_sun(when: datetime, latitude_deg: float, longitude_deg: float) -> TimeOfDay:
    """Return the time of day by the sun's elevation: low before its highest point at dawn, after it at dusk.

    Where the sun gets no higher than `LOW_SUN_DEG` all day, as in polar winters, low sun counts as dawn: nothing was
    warmed that could be warm at dusk.

    Raises:
        ValueError: The time has no time zone.
    """
    azimuth, elevation = sun_position(when, latitude_deg, longitude_deg)
    low, high = (math.radians(v) for v in LOW_SUN_DEG)
    if elevation > high:
        return "day"
    if elevation < low:
        return "night"
    if math.sin(azimuth) >= 0:  # east of the meridian
        return "dawn"
    latitude = math.radians(latitude_deg)
    north = math.sin(elevation) * math.sin(latitude) + math.cos(elevation) * math.cos(latitude) * math.cos(azimuth)
    declination = math.asin(max(-1.0, min(1.0, north)))
    return "dusk" if math.pi / 2 - abs(latitude - declination) > high else "dawn"


def local_moment(captured: str | None, longitude_deg: float) -> datetime | None:
    """Return the time in an ISO 8601 text without a zone, in that of the longitude; None without a time.

    Legal time is at most an hour from it nearly everywhere, mostly ahead; more in the west of Spain or China.
    """
    if captured is None or len(captured) <= 10:
        return None
    try:
        local = datetime.fromisoformat(captured).replace(tzinfo=timezone(timedelta(hours=round(longitude_deg / 15))))
        return local if local.astimezone(UTC) else None
    except (ValueError, OverflowError):  # no time, or the first or last hours that dates can express
        return None


def time_by_sun(captured: str | None, latitude_deg: float, longitude_deg: float) -> tuple[TimeOfDay, str] | None:
    """Return the time of day by the sun at a place, with what it rests on; None without a time.

    Where a clock of an unknown zone leaves several open, its zone is taken to be that of the longitude.

    Args:
        captured: Time, ISO 8601; without a zone it is local time.
        latitude_deg: North is positive.
        longitude_deg: East is positive.
    """
    if (exact := time_of(captured)) is not None:
        return time_of_sun(exact, latitude_deg, longitude_deg), "sun at time and place"
    moment = local_moment(captured, longitude_deg)
    if moment is None:
        return None
    try:
        times = [moment.replace(tzinfo=UTC) - timedelta(hours=longitude_deg / 15 + off) for off in _CLOCK_OFF_H]
        found = {time_of_sun(t, latitude_deg, longitude_deg) for t in times}
        up = [math.degrees(sun_position(t, latitude_deg, longitude_deg)[1]) for t in times]
    except OverflowError:
        return None
    source = "sun at place and local clock"
    if len(found) == 1:
        return found.pop(), source
    if min(up) > _DAY_ABOVE_DEG or max(up) < _NIGHT_BELOW_DEG:
        return ("day" if min(up) > _DAY_ABOVE_DEG else "night"), source
    zone = f"{moment:%z}"[:3]
    by_zone = time_of_sun(moment, latitude_deg, longitude_deg)
    return by_zone, f"{source}, taken as UTC{zone} by the longitude (+-1 h)"


def between(night: Range, day: Range, share: float) -> Range:
    """Return the range at a share of the way from that by night to that by day."""
    low, high = ((1 - share) * a + share * b for a, b in zip(night, day, strict=True))
    return min(low, high), max(low, high)
