"""Paths of objects: they keep within the limits of what moves, and depend on nothing but their stream."""

import math

import numpy as np
import pytest

from infrablend.config.recipe import IN_AIR, ON_GROUND, SPEED_M_S
from infrablend.sampling.paths import STEP_S, find_path, sway

START = (3.0, -2.0, 1.0, 0.7)
KINDS = sorted({*ON_GROUND, *IN_AIR} - {"followed"})


def path(kind, span=(-20.0, 30.0), seed=0, speed=None, fits=lambda x, y: True):
    speed = SPEED_M_S[kind][1] if speed is None else speed
    return find_path(kind, START, speed, span, np.random.default_rng(seed), fits)


def speeds(found):
    return np.linalg.norm(np.diff(found.place_m, axis=0), axis=1) / STEP_S


@pytest.mark.parametrize("kind", KINDS)
def test_a_path_goes_through_its_start_and_has_the_speed_of_its_kind(kind):
    for seed in range(5):
        found = path(kind, seed=seed)
        now = found.at(np.array([0.0]))
        np.testing.assert_allclose(now.place_m[0], START[:3], atol=1e-9)
        if kind != "flock":
            assert math.remainder(now.yaw_rad[0] - START[3], 2 * math.pi) == pytest.approx(0, abs=1e-9)
        assert speeds(found).max() <= 1.4 * SPEED_M_S[kind][1] + 1e-9
        assert np.abs(np.diff(speeds(found))).max(initial=0) / STEP_S < 6  # m/s², of climbs and sways, too
        assert np.abs(np.diff(found.yaw_rad)).max() / STEP_S < 2


@pytest.mark.parametrize("kind", KINDS)
def test_a_longer_sequence_does_not_change_what_comes_before(kind):
    short, long = path(kind, (-5.0, 10.0)), path(kind, (-5.0, 40.0))
    times = np.linspace(-5, 10, 31)
    np.testing.assert_allclose(short.at(times).place_m, long.at(times).place_m, atol=1e-9)


def test_who_walks_goes_around_what_is_in_the_way_and_a_car_stops_before_it():
    def fits(x, y):
        return math.hypot(x - START[0], y - START[1]) < 6

    for seed in range(10):
        for kind in ("walk", "run", "graze"):
            away = np.linalg.norm(path(kind, (-60, 60), seed, fits=fits).place_m[:, :2] - START[:2], axis=1)
            assert away.max() < 9
        car = path("drive", (-60, 60), seed, speed=8.0, fits=fits)
        assert speeds(car)[[0, -1]].max() < 1e-9  # parked in the end, and in the beginning
        np.testing.assert_allclose(car.yaw_rad, START[3], atol=1e-9)


def test_a_grazing_deer_stands_most_of_the_time():
    moving = speeds(path("graze", (0, 300))) > 0.02
    assert 0.05 < moving.mean() < 0.6


@pytest.mark.parametrize("kind", ["walk", "graze", "run"])
def test_a_body_turns_smoothly_and_only_while_it_walks(kind):
    for seed in range(8):
        found = find_path(kind, (0, 0, 0, 0.4), 1.0, (0, 60), np.random.default_rng(seed))
        turns, gone = np.diff(found.yaw_rad) / STEP_S, np.diff(found.way_m)
        assert np.abs(turns[gone < 1e-3]).max(initial=0) < 0.01
        assert np.abs(np.diff(turns)).max() < 0.6  # no trembling, rad/s from one tenth of a second to the next
    ends = [find_path(kind, (0, 0, 0, 0.0), 1.0, (0, 60), np.random.default_rng(s)).yaw_rad[-1] for s in range(30)]
    assert 0.3 < np.std(ends) < 2  # and wanders all the same


def test_what_flies_banks_into_its_turns_and_leans_into_the_wind():
    found = path("fly", speed=8.0)
    turning = np.diff(found.yaw_rad)
    assert (np.sign(found.bank_rad[1:]) == -np.sign(turning)).all()  # a left turn has the right side up
    assert np.abs(found.bank_rad).max() < math.radians(25) and 0.1 < found.lean_rad[0] < 0.25
    heading = np.arctan2(np.diff(found.place_m[:, 1]), np.diff(found.place_m[:, 0]))
    np.testing.assert_allclose(np.cos(heading - found.yaw_rad[1:]), 1, atol=1e-6)


def test_a_flock_flies_together():
    birds = [find_path("flock", (x, 0, 5, x), 9.0, (-5, 5), np.random.default_rng(4)) for x in (0.0, 3.0)]
    apart = birds[1].place_m - birds[0].place_m
    np.testing.assert_allclose(apart - apart[0], 0, atol=1e-9)


def test_a_sway_stays_within_its_size_and_a_followed_drone_has_no_path():
    assert np.abs(sway(np.linspace(0, 500, 5000), 2.0, (3.0, 9.0), np.random.default_rng(1))).max() <= 2
    with pytest.raises(ValueError, match="followed"):
        path("followed")
