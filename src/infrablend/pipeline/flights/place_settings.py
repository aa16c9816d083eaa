"""How detections are placed on the ground."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from infrablend.core.ground_position import PoseErrors
from infrablend.errors import ArgumentError
from infrablend.formats.values import is_place
from infrablend.pipeline.flights.same_object import WALK_M_S


@dataclass(frozen=True)
class PlaceSettings:
    """How detections are placed on the ground.

    Attributes:
        errors: Standard errors instead of the defaults, such as position=3,yaw=1: position and height in m; yaw, pitch
            and roll in degrees; hfov as a share of it; pixel in px.
        terrain: GeoTIFF of the height of the ground, in metres; without it, ground is taken as level.
        take_off: Latitude and longitude where the aircraft took off, for terrain [default: those of a flight's first
            picture].
        speed: How fast things move at most, m/s, for counting what several pictures show once; 0 if none move.

    Raises:
        ArgumentError: `take_off` is no place, or `speed` is negative.
    """

    errors: PoseErrors = field(default_factory=PoseErrors)
    terrain: str | Path | None = None
    take_off: tuple[float, float] | None = None
    speed: float = WALK_M_S

    def __post_init__(self) -> None:
        if self.take_off is not None and not (len(self.take_off) == 2 and is_place(*self.take_off)):
            raise ArgumentError(f"take_off: found {self.take_off!r}, expected latitude and longitude in degrees")
        if not 0 <= self.speed < math.inf:
            raise ArgumentError(f"speed: found {self.speed:g}, expected a number from 0 m/s up")


DEFAULT_PLACES: PlaceSettings = PlaceSettings()
