"""Automatic gain control (AGC): how 16-bit pictures become the 8-bit pictures that people and trainers look at.

Each picture is mapped by itself, as a camera does, except with a fixed range of temperatures. Originals and pictures
with inserts are mapped alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Discriminator, TypeAdapter, ValidationError
from pydantic import Field as _Field

from infrablend.core.strict_model import Strict, in_order
from infrablend.core.temperature import TemperatureScale
from infrablend.core.yaml_text import read_yaml
from infrablend.thermal.radiometry import ZERO_C_K

# Bins of the histogram for plateau equalisation; a bin is at least one count wide.
_BINS = 2048
_TOP = 255.0

Counts = NDArray[np.uint16]
Levels = NDArray[np.uint8]


class _Agc(Strict):
    needs_scale: ClassVar[bool] = False
    """Whether pictures need a temperature scale."""

    def apply(self, counts: Counts, scale: TemperatureScale | None = None) -> Levels:
        """Return the (h, w) 8-bit picture of a (h, w) 16-bit one; warm is bright where a scale says what is warm.

        Args:
            counts: The picture.
            scale: Scale of the counts; needed by a fixed range. A negative slope is turned over.

        Raises:
            ValueError: A fixed range without a scale.
        """
        if scale is not None and scale.black_hot:
            counts = np.asarray(65_535 - counts, np.uint16)
        return self._map(counts)

    def _map(self, counts: Counts) -> Levels:
        raise NotImplementedError


class LinearAgc(_Agc):
    """A line between two percentiles of each picture."""

    mode: Literal["linear"]
    """`linear`: a line between two percentiles of each picture."""
    low_percentile: float = _Field(0.5, ge=0, lt=100)
    """Percentile of the counts that becomes black."""
    high_percentile: float = _Field(99.5, gt=0, le=100)
    """Percentile of the counts that becomes white."""

    _in_order = in_order("low_percentile", "high_percentile")

    def _map(self, counts: Counts) -> Levels:
        low, high = (float(v) for v in np.percentile(counts, [self.low_percentile, self.high_percentile]))
        return _rounded((counts.astype(np.float64) - low) / max(high - low, 1.0) * _TOP)

    def describe(self) -> str:
        """Return it in words."""
        return f"linear from the {self.low_percentile:g} to the {self.high_percentile:g} % quantile of each picture"


class PlateauAgc(_Agc):
    """Plateau equalisation with the parameters that FLIR publishes for its cameras.

    The histogram of the picture is cut off at the plateau, so that large even areas do not take all levels. Its sum,
    mixed with a straight line, is the map from counts to levels, as far as its slope stays below the largest gain.
    """

    mode: Literal["plateau"]
    """`plateau`: plateau equalisation of the histogram of each picture."""
    plateau_percent: float = _Field(0.07, gt=0, le=100)
    """Most pixels that count in a bin of the histogram, percent of the picture. Low values come close to a straight
    line, high ones to full equalisation."""
    linear_percent: float = _Field(20.0, ge=0, le=100)
    """Share of a straight line in the map, percent."""
    outlier_percent: float = _Field(0.1, ge=0, lt=50)
    """Pixels at each end of the histogram that are black or white, percent."""
    max_gain: float = _Field(8.0, gt=0, le=255)
    """Steepest part of the map, 8-bit levels per count; keeps the noise of even pictures low."""
    midpoint: float = _Field(127.0, ge=0, le=255)
    """Level of the median where `max_gain` leaves levels unused."""

    def _map(self, counts: Counts) -> Levels:
        outliers = [self.outlier_percent, 100 - self.outlier_percent]
        low, high = (float(v) for v in np.percentile(counts, outliers))
        width = max((high - low) / _BINS, 1.0)
        bins = max(int(np.ceil((high - low) / width)), 1)
        edges = low + width * np.arange(bins + 1)
        inner = counts[(counts >= low) & (counts <= high)]
        found, _ = np.histogram(inner, edges)
        kept = np.minimum(found, self.plateau_percent / 100 * counts.size)
        share = self.linear_percent / 100
        steps = (1 - share) * kept / max(float(kept.sum()), 1.0) + share / bins
        rise = np.minimum(_TOP * steps, self.max_gain * width)
        curve = np.concatenate([[0.0], np.cumsum(rise)])
        unused = _TOP - curve[-1]
        if unused > 0:
            # The largest gain does not fill the range: the median goes to the midpoint, as far as there is room.
            median = float(np.interp(float(np.median(counts)), edges, curve))
            curve = curve + float(np.clip(self.midpoint - median, 0.0, unused))
        return _rounded(np.interp(counts, edges, curve))

    def describe(self) -> str:
        """Return it in words."""
        return (
            f"plateau equalisation of each picture (plateau {self.plateau_percent:g} %, {self.linear_percent:g} % "
            f"linear, {self.outlier_percent:g} % outliers, at most {self.max_gain:g} levels per count)"
        )


class FixedAgc(_Agc):
    """A line between two temperatures, the same for all pictures. Needs a temperature scale."""

    needs_scale: ClassVar[bool] = True

    mode: Literal["fixed"]
    """`fixed`: a line between two temperatures, the same for all pictures."""
    low_c: float = _Field(ge=-200, le=2000)
    """Temperature that becomes black, degrees Celsius."""
    high_c: float = _Field(ge=-200, le=2000)
    """Temperature that becomes white, degrees Celsius."""

    _in_order = in_order("low_c", "high_c")

    def apply(self, counts: Counts, scale: TemperatureScale | None = None) -> Levels:
        """Return the (h, w) 8-bit picture of a (h, w) 16-bit one with a scale."""
        if scale is None:
            raise ValueError("a fixed range of temperatures needs a temperature scale")
        celsius = scale.kelvin(counts) - ZERO_C_K
        return _rounded((celsius - self.low_c) / (self.high_c - self.low_c) * _TOP)

    def describe(self) -> str:
        """Return it in words."""
        return f"linear from {self.low_c:g} to {self.high_c:g} °C in all pictures"


def _rounded(levels: NDArray[np.float64]) -> Levels:
    return np.asarray(np.clip(np.rint(levels), 0, _TOP), np.uint8)


def _mode_alone(data: Any) -> Any:
    return {"mode": data} if isinstance(data, str) else data


Agc = Annotated[
    Annotated[LinearAgc | PlateauAgc | FixedAgc, Discriminator("mode")],
    BeforeValidator(
        _mode_alone, json_schema_input_type=LinearAgc | PlateauAgc | FixedAgc | Literal["linear", "plateau"]
    ),
]
DEFAULT_AGC = LinearAgc(mode="linear")
MODES = ("linear", "plateau", "fixed")

_ADAPTER: TypeAdapter[Agc] = TypeAdapter(Agc)


def agc_from_json(data: Mapping[str, object]) -> Agc:
    """Return the AGC that `model_dump` gave; a `ValidationError` for values that are none."""
    return _ADAPTER.validate_python(dict(data))


def parse_agc(text: str) -> Agc:
    """Return the AGC in a text: `linear`, `plateau`, or a mapping such as `{mode: fixed, low_c: 0, high_c: 40}`.

    Raises:
        ValueError: The text is none of these; the message says what is wrong.
    """
    data = _mode_alone(read_yaml(text))
    if not isinstance(data, dict):
        raise ValueError(f"{text!r}: expected linear, plateau, or a mapping with mode, low_c and high_c")
    try:
        return agc_from_json({k: float(v) if type(v) is int else v for k, v in data.items()})
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "mode"
        raise ValueError(f"{text!r}: {where}: {first['msg']}; modes are {', '.join(MODES)}") from error
