"""What users' YAML is checked against: strict, frozen, no unknown keys; ranges that a single number may stand for."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field


class Strict(BaseModel):
    """Base of all such models."""

    model_config = ConfigDict(
        strict=True,
        frozen=True,
        extra="forbid",
        validate_default=True,
        use_attribute_docstrings=True,
        allow_inf_nan=False,
    )


def range_of(low: float, high: float) -> Any:
    """Type of a range `[lo, hi]` whose ends lie in [low, high]; a number alone means `[n, n]`."""
    end = Annotated[float, Field(ge=low, le=high, allow_inf_nan=False)]
    return Annotated[tuple[end, end], BeforeValidator(_pair), AfterValidator(_ordered)]


def _pair(value: Any) -> Any:
    """A single number stands for the range that holds just it; JSON's lists become the tuples strict mode wants."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return (value, value)
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ValueError("a range [lo, hi] or a number")
    return tuple(value)


def _ordered(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] > value[1]:
        raise ValueError("a range [lo, hi] whose low end is not above its high end")
    return value
