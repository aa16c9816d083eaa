"""Converts the camera angles of drones and datasets to ours: degrees below the horizon, 90 straight down.

This is the only place that knows other conventions; readers of pictures, logs and datasets call it.
"""

from __future__ import annotations

STRAIGHT_DOWN_DEG = 90.0

# Gimbals overshoot their stop: DJI reports up to -90.9 for a camera that looks straight down.
_OVERSHOOT_DEG = 2.0


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


def _without_overshoot(pitch_deg: float) -> float:
    return STRAIGHT_DOWN_DEG if STRAIGHT_DOWN_DEG < pitch_deg <= STRAIGHT_DOWN_DEG + _OVERSHOOT_DEG else pitch_deg
