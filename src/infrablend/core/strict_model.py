"""Strict pydantic base class for schemas of users' YAML, and the types and checks of ranges of numbers."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator


class Strict(BaseModel):
    """A model that converts nothing silently, cannot be changed, and refuses unknown keys and infinite numbers."""

    model_config = ConfigDict(
        strict=True,
        frozen=True,
        extra="forbid",
        validate_default=True,
        use_attribute_docstrings=True,
        allow_inf_nan=False,
    )


def range_of(low: float, high: float) -> Any:
    """Return the type of a range `[lo, hi]` with both ends in [low, high]; a single number `n` means `[n, n]`."""
    end = Annotated[float, Field(ge=low, le=high, allow_inf_nan=False)]
    return Annotated[tuple[end, end], BeforeValidator(_pair), AfterValidator(_ordered)]


def in_order(low: str, high: str) -> Any:
    """Return a validator of a model, which refuses a field `low` that is not below the field `high`."""

    def check(model: BaseModel) -> BaseModel:
        a, b = (getattr(model, name) for name in (low, high))
        if a >= b:
            raise ValueError(f"{low} below {high}; found {a:g} and {b:g}")
        return model

    return model_validator(mode="after")(check)


def _pair(value: Any) -> Any:
    """Return a single number as a range, and a list from JSON as the tuple that strict mode requires."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return (value, value)
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ValueError("a range [lo, hi] or a number")
    return tuple(value)


def _ordered(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] > value[1]:
        raise ValueError("a range [lo, hi] whose low end is not above its high end")
    return value
