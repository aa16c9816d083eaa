"""How detections are placed on the ground."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from infrablend.core.ground_position import PoseErrors
from infrablend.errors import ArgumentError
from infrablend.formats.values import is_place


@dataclass(frozen=True)
class PlaceSettings:
    """How detections are placed on the ground.

    Attributes:
        errors: Standard errors instead of the defaults, such as position=3,yaw=1: position and height in m; yaw, pitch
            and roll in degrees; hfov as a share of it; pixel in px.
        terrain: GeoTIFF of the height of the ground, in metres; without it, ground is taken as level.
        take_off: Latitude and longitude where the aircraft took off, for terrain [default: those of a flight's first
            picture].

    Raises:
        ArgumentError: `take_off` is no place.
    """

    errors: PoseErrors = field(default_factory=PoseErrors)
    terrain: str | Path | None = None
    take_off: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.take_off is not None and not (len(self.take_off) == 2 and is_place(*self.take_off)):
            raise ArgumentError(f"take_off: found {self.take_off!r}, expected latitude and longitude in degrees")


DEFAULT_PLACES: PlaceSettings = PlaceSettings()
