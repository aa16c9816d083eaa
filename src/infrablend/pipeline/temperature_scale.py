"""Hands the temperature scale of a recipe to the reader of the backgrounds."""

from __future__ import annotations

from dataclasses import replace

from infrablend.config.recipe import Recipe
from infrablend.formats.reading import Reading
from infrablend.formats.temperatures import OPTIONS


def with_scale(reading: Reading, recipe: Recipe) -> Reading:
    """Return the reading with the recipe's temperature scale, unless its options state one."""
    stated = {k: str(v) for k, v in recipe.data.model_dump().items() if v is not None}
    if not stated or any(name in reading.options for name in OPTIONS):
        return reading
    return replace(reading, options={**reading.options, **stated})
