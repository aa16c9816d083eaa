"""Kinds of movement of inserted objects through a sequence, and how fast they are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

MotionKind = Literal["still", "walk", "graze", "run", "drive", "hover", "fly", "flock", "followed"]
ON_GROUND: tuple[MotionKind, ...] = ("still", "walk", "graze", "run", "drive")
IN_AIR: tuple[MotionKind, ...] = ("still", "hover", "fly", "flock", "followed")
SPEED_M_S: Mapping[MotionKind, tuple[float, float]] = {
    "still": (0.0, 0.0),
    "walk": (0.8, 1.6),
    "graze": (0.1, 0.3),
    "run": (2.0, 4.5),
    "drive": (3.0, 12.0),
    "hover": (0.1, 0.5),
    "fly": (3.0, 12.0),
    "flock": (6.0, 12.0),
    "followed": (0.0, 0.0),
}
"""Default range of the speed, m/s: people's gaits, cars in towns, drones in wind and in cruise, birds. A followed drone
is as fast as the camera turns."""
