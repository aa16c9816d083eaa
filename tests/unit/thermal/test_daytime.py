"""Day, dusk, night and dawn by the sun, and the light of a low sun."""

import itertools
import math
from datetime import UTC, datetime, timedelta

import pytest

from infrablend.thermal.daytime import STORED_SHARE, between, time_of_sun
from infrablend.thermal.sky import irradiance, sun_position


@pytest.mark.parametrize(
    ("when", "azimuth_deg", "zenith_deg"),
    [
        ("1910-03-15T00:30:00Z", 0.188643, 34.269919),
        ("1910-03-15T03:30:00Z", 298.894756, 53.637925),
        ("1910-03-15T06:30:00Z", 268.082350, 88.143823),
        ("1910-03-15T09:30:00Z", 237.156205, 122.642657),
        ("1910-03-15T12:30:00Z", 180.112832, 140.797480),
    ],
)
def test_positions_of_the_reference_implementation(when: str, azimuth_deg: float, zenith_deg: float) -> None:
    """NREL's Solar Position Algorithm (NREL/TP-560-34302) for Auckland, in the tests of docs.rs/solar-positioning.

    Its zenith has refraction, 0.31 degrees with the sun at 1.9.
    """
    azimuth, elevation = sun_position(datetime.fromisoformat(when), -36.840556, 174.74)
    refraction = 0.31 if 85 < zenith_deg < 90 else 0.0
    assert math.degrees(azimuth) == pytest.approx(azimuth_deg, abs=0.1)
    assert 90 - math.degrees(elevation) - refraction == pytest.approx(zenith_deg, abs=0.1)


def times(day: str, latitude_deg: float) -> list[str]:
    """Return the times of a day on the prime meridian, every ten minutes, each run of equal ones once."""
    start = datetime.fromisoformat(day).replace(tzinfo=UTC)
    found = [time_of_sun(start + timedelta(minutes=10 * k), latitude_deg, 0.0) for k in range(144)]
    return [time for time, _ in itertools.groupby(found)]


@pytest.mark.parametrize(
    ("day", "latitude_deg", "expected"),
    [
        ("2024-03-20", 45, "night dawn day dusk night"),
        ("2024-03-20", 0, "night dawn day dusk night"),
        ("2024-09-22", -45, "night dawn day dusk night"),
        ("2024-06-21", 66, "dusk dawn day dusk"),  # low at midnight, which is at 0:02 here
        ("2024-12-21", -80, "day"),  # polar day
        ("2024-06-21", -80, "night"),  # polar night
        ("2024-12-21", 70, "night dawn night"),  # twilight at noon: nothing was warmed
        ("2024-12-21", 60, "night dawn night"),  # 6.6 degrees at noon
        ("2024-12-21", 55, "night dawn day dusk night"),  # 11.6 degrees at noon
    ],
)
def test_the_course_of_a_day(day: str, latitude_deg: float, expected: str) -> None:
    assert times(day, latitude_deg) == expected.split()


def test_a_low_sun_is_weak_and_half_of_its_light_is_diffuse() -> None:
    for degrees in (1, 2, 5, 8):
        e = math.radians(degrees)
        rays, diffuse = irradiance(e)
        assert rays < 400
        total = rays * math.sin(e) + diffuse
        assert total == pytest.approx(1098 * math.sin(e) * math.exp(-0.059 / math.sin(e)))  # Haurwitz
        assert 0.3 < diffuse / total < 0.95 or degrees == 1
        assert irradiance(e, 1.0)[0] == 0
    assert irradiance(math.radians(-3)) == (0, 0) and irradiance(1e-5)[0] == 0


def test_rays_grow_with_the_height_of_the_sun_by_one_formula() -> None:
    rays = [irradiance(math.radians(degrees))[0] for degrees in range(1, 91)]
    assert rays == sorted(rays)
    assert irradiance(math.radians(12.7))[0] == pytest.approx(506, abs=1)
    for degrees in (7.99, 8.01):  # where day begins
        assert irradiance(math.radians(degrees))[0] == pytest.approx(irradiance(math.radians(8))[0], rel=0.01)


def test_what_stores_heat_is_warmest_by_day_and_coldest_at_dawn() -> None:
    ground = {time: between((-1, 4), (2, 15), share) for time, share in STORED_SHARE.items()}
    assert ground["night"] == (-1, 4) and ground["day"] == (2, 15)
    for end in (0, 1):
        assert ground["day"][end] > ground["dusk"][end] > ground["night"][end] > ground["dawn"][end]
    assert between((-1, 0), (0, 60), STORED_SHARE["dawn"]) == pytest.approx((-9, -1.15))
