"""The part of a recipe that decides the frames and labels of a run, for stage keys and for adopting runs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from infrablend import __version__
from infrablend.assets.user_model import description_digest, is_description
from infrablend.config.experiment import Generate
from infrablend.config.loading import read_recipe
from infrablend.config.recipe import NOT_IN_KEY, Recipe


def recipe_inputs(spec: Generate) -> dict[str, Any]:
    """Return the contribution of a run's recipe to the stage's key; the user's own models count by their content."""
    recipe = read_recipe(spec.recipe, spec.settings).recipe
    own = {o.model: description_digest(Path(o.model)) for o in recipe.objects if is_description(o.model)}
    return {
        "recipe": deciding_fields(recipe),
        "models": sorted(own.values()),
        "splits": list(spec.splits),
        "version": __version__,
    }


def deciding_fields(recipe: Recipe) -> dict[str, Any]:
    """Return the fields that decide frames and labels, defaults left out.

    Because defaults are left out, a field that a later version adds does not invalidate finished stages.
    """
    left_out: Any = {"description": True, "name": True, "output": NOT_IN_KEY}
    found: dict[str, Any] = json.loads(recipe.model_dump_json(exclude=left_out, exclude_defaults=True))
    return {k: v for k, v in found.items() if v != {}}
