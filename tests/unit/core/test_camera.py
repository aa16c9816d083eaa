"""Angles of gimbals and datasets become degrees below the horizon."""

from __future__ import annotations

import math

import pytest

from infrablend.core.camera import pitch_of_gimbal, pitch_of_tilt


@pytest.mark.parametrize(
    ("gimbal", "pitch"),
    [(-90.0, 90.0), (-45.0, 45.0), (0.0, 0.0), (20.0, -20.0), (-90.9, 90.0), (-92.0, 90.0), (-120.0, 120.0)],
)
def test_a_gimbal_is_negative_below_the_horizon(gimbal: float, pitch: float) -> None:
    assert pitch_of_gimbal(gimbal) == pitch


def test_a_level_camera_has_no_negative_zero() -> None:
    assert math.copysign(1.0, pitch_of_gimbal(0.0)) == 1.0


@pytest.mark.parametrize(
    ("tilt", "pitch"),
    [(0.0, 90.0), (10.0, 80.0), (-10.0, 80.0), (90.0, 0.0), (360.5, 89.5), (359.5, 89.5), (180.0, -90.0)],
)
def test_a_tilt_counts_from_straight_down(tilt: float, pitch: float) -> None:
    assert pitch_of_tilt(tilt) == pitch
