"""Recipes as YAML, with what was set in them and nothing else."""

from __future__ import annotations

import io

from ruamel.yaml import YAML

from infrablend.config.recipe import Recipe


def to_yaml(recipe: Recipe) -> str:
    """Return the YAML text of a recipe."""
    text = io.StringIO()
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = None
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    yaml.width = 120
    yaml.dump(recipe.model_dump(mode="json", exclude_unset=True), text)
    return text.getvalue()
