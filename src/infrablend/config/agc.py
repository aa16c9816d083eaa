"""Automatic gain control (AGC): how 16-bit pictures become the 8-bit pictures that people and trainers look at."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Discriminator, TypeAdapter, ValidationError, model_validator
from pydantic import Field as _Field

from infrablend.core.strict_model import Strict
from infrablend.core.yaml_text import read_yaml


class LinearAgc(Strict):
    """A line between two percentiles of each picture."""

    mode: Literal["linear"]
    """`linear`: a line between two percentiles of each picture."""
    low_percentile: float = _Field(0.5, ge=0, lt=100)
    """Percentile of the counts that becomes black."""
    high_percentile: float = _Field(99.5, gt=0, le=100)
    """Percentile of the counts that becomes white."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.low_percentile >= self.high_percentile:
            raise ValueError(
                f"low_percentile below high_percentile; found {self.low_percentile:g} and {self.high_percentile:g}"
            )
        return self


class PlateauAgc(Strict):
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


class FixedAgc(Strict):
    """A line between two temperatures, the same for all pictures. Needs a temperature scale."""

    mode: Literal["fixed"]
    """`fixed`: a line between two temperatures, the same for all pictures."""
    low_c: float = _Field(ge=-200, le=2000)
    """Temperature that becomes black, degrees Celsius."""
    high_c: float = _Field(ge=-200, le=2000)
    """Temperature that becomes white, degrees Celsius."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.low_c >= self.high_c:
            raise ValueError(f"low_c below high_c; found {self.low_c:g} and {self.high_c:g}")
        return self


def _mode_alone(data: Any) -> Any:
    """Return the mapping that a mode alone stands for."""
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


def agc_from_json(data: Mapping[str, Any]) -> Agc:
    """Return the AGC that `model_dump` gave.

    Raises:
        ValidationError: The values are no AGC.
    """
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


def describe_agc(agc: Agc) -> str:
    """Return an AGC in words."""
    if isinstance(agc, LinearAgc):
        return f"linear from the {agc.low_percentile:g} to the {agc.high_percentile:g} % quantile of each picture"
    if isinstance(agc, FixedAgc):
        return f"linear from {agc.low_c:g} to {agc.high_c:g} °C in all pictures"
    return (
        f"plateau equalisation of each picture (plateau {agc.plateau_percent:g} %, {agc.linear_percent:g} % linear, "
        f"{agc.outlier_percent:g} % outliers, at most {agc.max_gain:g} levels per count)"
    )
