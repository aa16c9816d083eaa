"""Converts the camera angles of drones and datasets to ours: pitch below the horizon (90 straight down), and roll.

This is the only place that knows other conventions; readers of pictures, logs and datasets call it.
"""

from __future__ import annotations

STRAIGHT_DOWN_DEG = 90.0

# Gimbals overshoot their stop: DJI reports up to -90.9 for a camera that looks straight down.
_OVERSHOOT_DEG = 2.0
# Gimbals roll by at most about this angle; a larger one is a turned mount, or the other way to write a pitch past 90.
_MOST_ROLL_DEG = 45.0
# From this pitch on, turning the camera about its axis only turns the ground in the picture.
_FROM_ABOVE_DEG = 80.0


def pitch_of_gimbal(gimbal_deg: float) -> float:
    """Return the angle below the horizon for a gimbal's pitch, which is negative below the horizon (DJI, AirData).

    An overshoot of at most 2 degrees counts as straight down. Larger angles are returned as they are, above 90: the
    camera looks back under the aircraft, which callers refuse.

    >>> pitch_of_gimbal(-90.0), pitch_of_gimbal(-30.5), pitch_of_gimbal(12.0)
    (90.0, 30.5, -12.0)
    """
    return _without_overshoot(0.0 - gimbal_deg)


def pitch_of_tilt(tilt_deg: float) -> float:
    """Return the angle below the horizon for a tilt away from straight down, in any number of turns (BAMBI).

    >>> pitch_of_tilt(0.0), pitch_of_tilt(25.0), pitch_of_tilt(359.0)
    (90.0, 65.0, 89.0)
    """
    return STRAIGHT_DOWN_DEG - abs((tilt_deg + 180.0) % 360.0 - 180.0)


def roll_of_gimbal(gimbal_deg: float) -> float:
    """Return the roll of the camera, in (-180, 180], for a gimbal's roll in any number of turns (DJI, AirData).

    Both are positive clockwise as seen from behind the camera: the right edge of the picture points further down, so
    the horizon in the picture is turned counter-clockwise.

    >>> roll_of_gimbal(10.0), roll_of_gimbal(-180.0), roll_of_gimbal(350.0)
    (10.0, 180.0, -10.0)
    """
    return 180.0 - (180.0 - gimbal_deg) % 360.0 if not -180.0 < gimbal_deg <= 180.0 else gimbal_deg


def is_plausible_roll(roll_deg: float, pitch_deg: float | None) -> bool:
    """Return whether a camera can have a gimbal's roll, or is seen so far from above that any roll is only a heading.

    A larger roll at a flatter pitch leaves open whether the picture is upside down: some cameras turn it upright.
    """
    return abs(roll_deg) <= _MOST_ROLL_DEG or (pitch_deg is not None and pitch_deg >= _FROM_ABOVE_DEG)


def _without_overshoot(pitch_deg: float) -> float:
    return STRAIGHT_DOWN_DEG if STRAIGHT_DOWN_DEG < pitch_deg <= STRAIGHT_DOWN_DEG + _OVERSHOOT_DEG else pitch_deg
