"""Day, dusk, night and dawn by the sun, and what stays of the day's heat.

The sun is low from the end of civil twilight, -6 degrees, to 8 degrees, around which passive surfaces swap places in
the morning (thermal crossover). The shares below follow from an energy balance (bench/daytime.py at
commit 7a8fc2b5).
"""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta, timezone

from infrablend.core.capture import TimeOfDay
from infrablend.thermal.sky import sun_position

Range = tuple[float, float]

LOW_SUN_DEG: Range = (-6.0, 8.0)
"""Elevations of the sun at dusk and dawn, degrees."""
STORED_SHARE = {"night": 0.0, "dusk": 0.3, "dawn": -0.15, "day": 1.0}
"""Temperature of what stores heat (ground, tyres), between that by night (0) and by day (1)."""
OVERCAST_SHARE = 0.3
"""Excess of the ground over the air under a closed cloud cover, as a share of that under other skies."""
SKY_COOLING_SHARE = 0.15
"""The same for what surfaces lose to the sky: 0.6 K of a roof's 4 to 8.5 K."""


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


def between(night: Range, day: Range, share: float) -> Range:
    """Return the range at a share of the way from that by night to that by day."""
    low, high = ((1 - share) * a + share * b for a, b in zip(night, day, strict=True))
    return min(low, high), max(low, high)
