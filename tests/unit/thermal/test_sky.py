"""The sun's position and irradiance against published values."""

import math
from datetime import datetime

import pytest

from infrablend.thermal.sky import irradiance, sun_position, time_of


def test_position_of_the_published_example():
    """NREL's Solar Position Algorithm, example of its report: zenith 50.11 degrees, azimuth 194.34 degrees."""
    when = datetime.fromisoformat("2003-10-17T12:30:30-07:00")
    azimuth, elevation = sun_position(when, 39.742476, -105.1786)
    assert math.degrees(azimuth) == pytest.approx(194.34, abs=0.05)
    assert 90 - math.degrees(elevation) == pytest.approx(50.11, abs=0.05)


def test_a_time_needs_a_zone():
    assert time_of("2021-01-16") is None and time_of("2021-01-16T12:00:00") is None and time_of(None) is None
    assert time_of("2021-01-16T12:00:00+08:00") is not None and time_of("at noon on Saturday") is None
    with pytest.raises(ValueError, match="time zone"):
        sun_position(datetime(2021, 1, 16, 12), 25.0, 102.7)


def test_irradiance_of_clear_and_cloudy_skies():
    direct, diffuse = irradiance(math.radians(90))
    assert direct + diffuse == pytest.approx(1098 * math.exp(-0.059))  # Haurwitz, overhead
    assert 0.1 < diffuse / (direct + diffuse) < 0.3
    assert irradiance(-0.1) == (0.0, 0.0)
    overcast = irradiance(math.radians(40), 1.0)
    assert overcast[0] == pytest.approx(0) and 50 < overcast[1] < 200
    levels = [d * math.sin(0.7) + f for d, f in (irradiance(0.7, c) for c in (0, 0.3, 0.6, 1))]
    assert levels == sorted(levels, reverse=True)
