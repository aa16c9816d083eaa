"""Temperatures in 16-bit pictures: the scale from counts to kelvin, and what a file states about the air."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

Unit = Literal["centikelvin", "decikelvin", "counts"]
UNITS: tuple[Unit, ...] = get_args(Unit)
"""Names of the units that 16-bit pictures come in; `counts` has no scale of its own."""

Counts = NDArray[np.uint16]

_SLOPES_K: Mapping[str, float] = {"centikelvin": 0.01, "decikelvin": 0.1}
# A steeper scale would show a whole scene in a few levels: no radiometric picture has one.
_MOST_SLOPE_K = 10.0

# Pixels that the median of a picture is taken of.
_SAMPLE = 100_000

PLAUSIBLE_K = (173.15, 473.15)
"""Apparent temperatures, kelvin, between which the median of a picture lies, from a clear winter sky to a furnace."""

GROUND_K = (230.0, 340.0)
"""The same for pictures of the ground, from polar night to desert sand at noon."""


def implausible_median(kelvin: NDArray[Any], ground: bool) -> float | None:
    """Return the median of a picture's apparent temperatures, kelvin, if no camera sees such a scene; else None.

    A unit taken for another one moves it outside: 0.04 K per count instead of 0.01 makes 1,150 K of 288 K, and raw
    counts of DJI taken for 0.01 K make 170 to 200 K of ground.

    Args:
        kelvin: Apparent temperatures.
        ground: Whether the picture shows the ground, not the sky alone.
    """
    lowest, highest = GROUND_K if ground else PLAUSIBLE_K
    sample = kelvin.ravel()[:: max(1, kelvin.size // _SAMPLE)]
    finite = sample[np.isfinite(sample)]
    median = float(np.median(finite)) if finite.size else math.nan
    return None if lowest <= median <= highest else median


def implausible_counts(counts: NDArray[Any], scale: TemperatureScale, ground: bool) -> float | None:
    """Return the implausible median, kelvin, of a picture in counts; None if it is plausible."""
    return implausible_median(scale.kelvin(counts.ravel()[:: max(1, counts.size // _SAMPLE)]), ground)


def describe_plausible(ground: bool) -> str:
    """Return the range of plausible medians in words."""
    low, high = (k - 273.15 for k in (GROUND_K if ground else PLAUSIBLE_K))
    text = f"a median between {low:.0f} and {high:.0f} degrees Celsius"
    return f"{text} in pictures of the ground" if ground else text


@dataclass(frozen=True)
class TemperatureScale:
    """Linear scale of a 16-bit picture: `kelvin = slope_k * count + offset_k`.

    Counts without a known scale have no `TemperatureScale`: they are only counts.

    Attributes:
        slope_k: Kelvin per count; negative where warm is dark.
        offset_k: Temperature of count 0, kelvin.
        unit: Name of the unit: `centikelvin` (0.01 K per count, as TLinear in high resolution), `decikelvin`, or
            `counts` for any other slope and offset (TLinear in low resolution has 0.04 K per count).

    Raises:
        ValueError: The slope is 0, too steep or not finite, or the unit has another slope or offset.
    """

    slope_k: float
    offset_k: float = 0.0
    unit: Unit = "counts"

    def __post_init__(self) -> None:
        if not math.isfinite(self.slope_k) or not 0 < abs(self.slope_k) <= _MOST_SLOPE_K:
            raise ValueError(f"slope {self.slope_k:g} K per count; expected a number up to {_MOST_SLOPE_K:g}, not 0")
        if not math.isfinite(self.offset_k):
            raise ValueError(f"offset {self.offset_k:g} K; expected a finite number")
        if self.unit not in UNITS:
            raise ValueError(f"unit {self.unit!r}; expected one of {', '.join(UNITS)}")
        own = _SLOPES_K.get(self.unit)
        if own is not None and (self.slope_k != own or self.offset_k != 0):
            raise ValueError(
                f"{self.unit} with {self.slope_k:g} K per count and an offset of {self.offset_k:g} K; expected {own:g} "
                "and 0. Use the unit counts for other scales"
            )

    @property
    def black_hot(self) -> bool:
        """Whether warm is dark."""
        return self.slope_k < 0

    @classmethod
    def of_unit(cls, unit: str, slope_k: float | None = None, offset_k: float | None = None) -> TemperatureScale | None:
        """Return the scale of a unit, with what is stated about it; None for counts without a slope.

        Raises:
            ValueError: The values do not fit together; an offset without a slope says nothing.
        """
        if unit not in UNITS:
            raise ValueError(f"unit {unit!r}; expected one of {', '.join(UNITS)}")
        own = _SLOPES_K.get(unit)
        if own is None and slope_k is None:
            if offset_k is not None:
                raise ValueError(f"an offset of {offset_k:g} K without a slope; expected both, or neither")
            return None
        slope = slope_k if slope_k is not None else own
        assert slope is not None
        return cls(slope, offset_k or 0.0, unit)

    def kelvin(self, counts: NDArray[Any]) -> NDArray[np.float64]:
        """Return temperatures, kelvin, of an array of counts."""
        return np.asarray(np.asarray(counts, np.float64) * self.slope_k + self.offset_k)

    def counts(self, kelvin: NDArray[Any]) -> Counts:
        """Return the nearest 16-bit counts of temperatures in kelvin; values that do not fit become 0 or 65535."""
        exact = (np.asarray(kelvin, np.float64) - self.offset_k) / self.slope_k
        return np.asarray(np.clip(np.rint(exact), 0, 65_535), np.uint16)

    def describe(self) -> str:
        """Return the scale in words, such as `centikelvin` or `0.04 K per count, 0 = 273.15 K`."""
        if self.unit != "counts":
            return self.unit
        return f"{self.slope_k:g} K per count, 0 = {self.offset_k:g} K"

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values, from which `from_json` restores an equal scale."""
        return {"unit": self.unit, "slope_k": self.slope_k, "offset_k": self.offset_k}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> TemperatureScale:
        """Return the scale that `to_json` wrote.

        Raises:
            ValueError: The values are no scale.
        """
        slope = data.get("slope_k")
        offset = data.get("offset_k", 0.0)
        numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in (slope, offset))
        if not numbers:
            raise ValueError(f"slope_k {slope!r} and offset_k {offset!r}; expected numbers")
        return cls(float(slope), float(offset), data.get("unit", "counts"))  # type: ignore[arg-type]


@dataclass(frozen=True)
class Radiometry:
    """What is known about the temperatures of one picture.

    The pixels show apparent temperatures at the sensor: those of a blackbody that sends as much radiation into the
    camera as the scene does, air included.

    Attributes:
        scale: Scale of the picture's 16-bit pixels; None where they are only counts.
        source: Where the scale comes from, such as `stated` or the name of a header.
        air_k: Temperature of the air, kelvin; None if unknown.
        humidity: Relative humidity of the air, 0 to 1; None if unknown.
        reflected_k: Apparent temperature of the surroundings, kelvin; None if unknown.
        emissivity: Emissivity set in the camera; None if unknown.
        distance_m: Distance set in the camera, metres; None if unknown.
    """

    scale: TemperatureScale | None
    source: str = "stated"
    air_k: float | None = None
    humidity: float | None = None
    reflected_k: float | None = None
    emissivity: float | None = None
    distance_m: float | None = None

    @property
    def plausible_air_k(self) -> float | None:
        """Temperature of the air if it is one that people fly in; cameras report others where nobody set it."""
        return self.air_k if self.air_k is not None and 213 <= self.air_k <= 333 else None

    @property
    def plausible_humidity(self) -> float | None:
        """Relative humidity if it is one; None otherwise."""
        return self.humidity if self.humidity is not None and 0.01 <= self.humidity <= 1 else None
