"""The scale of counts that have none of their own: stated, fitted to known temperatures, or from another program."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from infrablend.core.dataset import Dataset
from infrablend.core.temperature import TemperatureScale
from infrablend.errors import ArgumentError, Problem
from infrablend.formats.cameras.raw_temperatures import CONVERTED_UNITS, fit_scale, read_temperatures
from infrablend.thermal.radiometry import ZERO_C_K

_SPOT = re.compile(r"(.+):(\d+),(\d+)=([-+]?\d+(?:\.\d+)?)", re.ASCII)
# A square around a spot that spans more than this is not uniform: its median may be that of something else.
_SPOT_SPAN_K = 2.0
# Half the side of the square around a spot whose median count is taken, px.
_SPOT_REACH = 1
_MOST_SPOT_C = 3_000.0


@dataclass(frozen=True)
class Spot:
    """A temperature that the user knows at one place of a picture.

    Attributes:
        file: Name of the picture.
        xy: Column and row in the radiometric layer.
        celsius: Apparent temperature there.
    """

    file: str
    xy: tuple[int, int]
    celsius: float

    @classmethod
    def of_text(cls, text: str) -> Spot:
        """Return the spot in a text such as `DJI_0001_T.JPG:320,256=21.5`.

        Raises:
            ArgumentError: The text is no spot.
        """
        match = _SPOT.fullmatch(text.strip())
        if match is None:
            raise ArgumentError(f"spot {text!r}: expected FILE:X,Y=DEGREES, e.g. DJI_0001_T.JPG:320,256=21.5")
        if not -ZERO_C_K < float(match[4]) < _MOST_SPOT_C:
            raise ArgumentError(f"spot {text!r}: expected a temperature from {-ZERO_C_K:g} to {_MOST_SPOT_C:g}")
        return cls(match[1], (int(match[2]), int(match[3])), float(match[4]))


@dataclass(frozen=True)
class SpotCount:
    """A known temperature, and the counts in the square of 3 x 3 px around it.

    Attributes:
        spot: The known temperature.
        count: Median of the counts, which is used.
        lowest: Lowest count.
        highest: Highest count.
    """

    spot: Spot
    count: float
    lowest: int
    highest: int

    def describe(self) -> str:
        """Return the counts in words."""
        return f"count {self.count:g}, median of 3 x 3 px with {self.lowest} to {self.highest}"

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        counts = {k: getattr(self, k) for k in ("count", "lowest", "highest")}
        return {"file": self.spot.file, "xy": list(self.spot.xy), "celsius": self.spot.celsius, **counts}


@dataclass(frozen=True)
class CountScale:
    """Where the scale of counts comes from that have none of their own; at most one of the three.

    Attributes:
        slope_k: Kelvin per count, for DJI's counts: kelvin = slope * count + offset.
        offset_k: Kelvin of count 0, for DJI's counts; may be negative. Of degrees Celsius, add 273.15.
        spots: Known temperature, degrees Celsius, at column X and row Y of the radiometric layer; the median of the
            3 x 3 px around it is used. Give at least two.
        converted: TIFF files that another program converted, same names.
        unit: Unit of the converted files.

    Raises:
        ArgumentError: The values do not fit together.
    """

    slope_k: float | None = None
    offset_k: float | None = None
    spots: Sequence[Spot] = ()
    converted: Path | None = None
    unit: Literal["celsius", "kelvin", "decikelvin", "centikelvin"] | None = None

    def __post_init__(self) -> None:
        if (self.slope_k is None) != (self.offset_k is None):
            raise ArgumentError("--slope and --offset: found one of them, expected both, or neither")
        if self.slope_k is not None and self.slope_k < 0:
            raise ArgumentError(f"--slope {self.slope_k:g}: found a negative one; DJI's counts rise with temperature")
        if sum((self.slope_k is not None, bool(self.spots), self.converted is not None)) > 1:
            found = "--slope with --offset, --spot, --converted: found several, expected one source of the scale"
            raise ArgumentError(found)
        if (self.converted is None) != (self.unit is None):
            raise ArgumentError("--converted and --converted-unit: found one of them, expected both, or neither")
        if self.unit is not None and self.unit not in CONVERTED_UNITS:
            raise ArgumentError(f"--converted-unit {self.unit!r}: expected one of {', '.join(CONVERTED_UNITS)}")


NO_SCALE = CountScale()


def stated_scale(given: CountScale, spots: Sequence[SpotCount]) -> TemperatureScale | None:
    """Return the scale that is stated, or fitted to the spots; None if there is none.

    Raises:
        ArgumentError: The values give no scale.
    """
    try:
        if given.slope_k is not None:
            return TemperatureScale(given.slope_k, given.offset_k or 0.0)
        return fit_scale([(s.count, s.spot.celsius + ZERO_C_K) for s in spots]) if spots else None
    except ValueError as error:
        name = "--spot" if spots else "--slope and --offset"
        used = ", ".join(f"count {s.count:g} for {s.spot.celsius:g} degrees" for s in spots)
        raise ArgumentError(f"{name}: {error}" + (f"; found {used}" if used else "")) from error


def count_at(dataset: Dataset, spot: Spot) -> SpotCount:
    """Return the counts around a spot.

    Raises:
        ArgumentError: There is no such picture, or it is smaller.
        DatasetError: The picture has no radiometric layer.
    """
    found = [i for i in dataset.images if spot.file in (i.name, i.path.name)]
    if len(found) != 1:
        raise ArgumentError(f"--spot {spot.file}: found {len(found)} pictures of this name, expected one")
    counts = read_temperatures(found[0].path).counts
    x, y = spot.xy
    h, w = counts.shape
    if x >= w or y >= h:
        raise ArgumentError(f"--spot {spot.file}:{x},{y}: outside the radiometric layer of {w}x{h} px")
    near = counts[max(0, y - _SPOT_REACH) : y + _SPOT_REACH + 1, max(0, x - _SPOT_REACH) : x + _SPOT_REACH + 1]
    return SpotCount(spot, float(np.median(near)), int(near.min()), int(near.max()))


def spot_warnings(spots: Sequence[SpotCount], scale: TemperatureScale | None) -> list[Problem]:
    """Return a warning per known temperature whose surroundings are not uniform."""
    problems: list[Problem] = []
    if scale is None:
        return problems
    for s in spots:
        span_k = (s.highest - s.lowest) * scale.slope_k
        if span_k > _SPOT_SPAN_K:
            x, y = s.spot.xy
            found = f"{s.describe()}, {span_k:.1f} K apart"
            expected = f"a uniform surface, within {_SPOT_SPAN_K:g} K"
            todo = "give a spot inside a larger surface"
            problems.append(Problem(f"--spot {s.spot.file}:{x},{y}", "spot-uneven", found, expected, todo, "warning"))
    return problems
