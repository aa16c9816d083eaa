"""Reads recipes: a shipped name or a YAML file, with single fields set by the caller or the command line."""

from __future__ import annotations

import copy
import functools
import json
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from infrablend.config.modes import (
    drop_fields_of_other_modes,
    explain_unknown,
    kept_camera_warnings,
    modes_of,
    recipe_class,
    wrong_modes,
)
from infrablend.config.recipe import Recipe
from infrablend.config.sensor_profile import PROFILE_SUFFIXES, read_profile
from infrablend.core.file_names import real_path
from infrablend.core.shipped import shipped_names
from infrablend.core.validation_messages import did_you_mean, field_problems
from infrablend.core.yaml_text import read_yaml
from infrablend.errors import Problem, RecipeError

log = logging.getLogger(__name__)

Settings = Sequence[str] | Mapping[str, Any]


def list_recipes() -> list[str]:
    """Return the names of the shipped recipes, sorted."""
    return shipped_names("recipes")


def recipe_text(name: str) -> str:
    """Return the YAML text of a shipped recipe.

    Raises:
        RecipeError: If no shipped recipe has that name.
    """
    if name not in list_recipes():
        raise RecipeError(
            f"recipe {name!r}: neither a shipped recipe nor a YAML file that exists; "
            f"shipped are {', '.join(list_recipes())}. "
            f"{did_you_mean(name, list_recipes()) or 'Give one of these names or the path of a .yaml file.'}"
        )
    return (resources.files("infrablend.config") / "recipes" / f"{name}.yaml").read_text("utf-8")


@dataclass(frozen=True)
class LoadedRecipe:
    """A recipe and what reading it changed.

    Attributes:
        recipe: The recipe.
        dropped: One warning per field that was dropped because a setting changed the mode.
        kept: One warning per field that was kept although its value belongs to the old mode.
    """

    recipe: Recipe
    dropped: tuple[Problem, ...] = ()
    kept: tuple[Problem, ...] = ()

    @property
    def warnings(self) -> tuple[Problem, ...]:
        """All warnings."""
        return self.dropped + self.kept


def load_recipe(recipe: str | Path, settings: Settings = ()) -> Recipe:
    """Return the recipe of that name or file, with `settings` applied.

    Fields that a setting of a mode makes meaningless are dropped, each with a warning in the log; a lens or a roll
    kept from the other placement mode gives a warning too. `read_recipe` returns these warnings.

    Args:
        recipe: A shipped name, or a path (anything with a suffix or a folder in it).
        settings: `key=value` texts (dotted keys, YAML values), or a mapping of dotted keys to values.

    Raises:
        RecipeError: With every unknown key and bad value at once.
    """
    loaded = read_recipe(recipe, settings)
    for problem in loaded.warnings:
        log.warning("%s", problem)
    return loaded.recipe


def read_recipe(recipe: str | Path, settings: Settings = ()) -> LoadedRecipe:
    """Return the recipe of that name or file, with `settings` applied, and the fields that these dropped.

    Args:
        recipe: A shipped name, or a path (anything with a suffix or a folder in it).
        settings: `key=value` texts (dotted keys, YAML values), or a mapping of dotted keys to values.

    Raises:
        RecipeError: With every unknown key and bad value at once.
    """
    _require_settings(settings)
    path = Path(recipe)
    folder: Path | None = None
    if path.suffix.lower() in {".yaml", ".yml"} or path.parent != Path():
        folder = real_path(path).parent
        try:
            text = path.read_text("utf-8")
        except (OSError, ValueError) as error:  # ValueError: not UTF-8, or a path with a NUL in it
            raise RecipeError(
                f"recipe {path}: cannot be read ({error}); expected a YAML text file. "
                f"Shipped recipes are {', '.join(list_recipes())}."
            ) from error
    else:
        text = recipe_text(str(recipe))
    return parse_recipe(text, str(recipe), settings, folder)


def parse_recipe(text: str, where: str, settings: Settings = (), folder: Path | None = None) -> LoadedRecipe:
    """Return the recipe in a YAML text.

    Args:
        text: The YAML text.
        where: Name of the recipe in errors.
        settings: As of `load_recipe`.
        folder: Folder that paths in the recipe are relative to; the working directory by default.

    Raises:
        RecipeError: With every unknown key and bad value at once.
    """
    try:
        data = copy.deepcopy(_read_yaml(text))
    except ValueError as error:
        raise RecipeError(
            f"recipe {where}: {error}. Correct the file; docs/reference/recipe.md has all fields."
        ) from error
    if not isinstance(data, dict):
        raise RecipeError(f"recipe {where}: found {type(data).__name__}, expected a mapping of fields")
    problems: list[Problem] = []
    pairs = _pairs(settings, problems)
    dropped, kept = _change_modes(data, pairs)
    for key, value in pairs:
        _set(data, key, value, problems)
    _prefer_stated_lens(data, pairs)
    if isinstance(data.get("objects"), list):
        for item in data["objects"]:
            if isinstance(item, dict) and isinstance(item.get("model"), str) and _is_path(item["model"]):
                # The record of a run has the whole path, so that the run can be used from any folder.
                path = (folder or Path()) / item["model"]
                # A description that is a link out of its folder is refused by its reader.
                item["model"] = str(real_path(path.parent) / path.name)
    _read_profile(data, folder)
    problems += wrong_modes(data)
    modes = modes_of(data)
    model = recipe_class(modes)
    try:
        # Through JSON: strict mode then takes lists for tuples, and still refuses "640" or true for a number.
        recipe = model.model_validate_json(json.dumps(data))
    except ValidationError as error:
        see = "see docs/reference/recipe.md for all fields"
        known = {p.where for p in problems}
        found = field_problems(error, data, model, "recipe", see, lambda path: explain_unknown(path, modes))
        problems += [p for p in found if p.where not in known]
    except (TypeError, ValueError) as error:
        problems.append(Problem(where, "recipe-value", str(error), "plain numbers, texts, lists and mappings"))
    if problems:
        raise RecipeError(f"recipe {where}: {len(set(problems))} field(s) are wrong", sorted(set(problems)))
    return LoadedRecipe(recipe, tuple(dropped), tuple(kept))


def _prefer_stated_lens(data: dict[str, Any], pairs: Sequence[tuple[str, Any]]) -> None:
    """Let a lens that the settings state count more than the field of view of the pictures' own files.

    A `field_of_view` of the recipe's file does not prevent that, for recipes that the studio writes state every field;
    one among the settings does.
    """
    stated = {key for key, _ in pairs}
    stated |= {f"camera.{f}" for key, value in pairs if key == "camera" and isinstance(value, dict) for f in value}
    camera = data.get("camera")
    lens = stated & {"camera.focal_length_mm", "camera.sensor_width_mm"}
    chosen = "camera.field_of_view" in stated
    if lens and not chosen and isinstance(camera, dict) and modes_of(data).placement == "metric":
        camera["field_of_view"] = "recipe"


def _change_modes(data: dict[str, Any], pairs: Sequence[tuple[str, Any]]) -> tuple[list[Problem], list[Problem]]:
    """Drop the fields that have no meaning in the modes that the settings choose; the settings' own stay, as errors.

    Returns:
        Warnings about dropped fields, and about fields kept with a value of the old mode.
    """
    result = copy.deepcopy(data)
    for key, value in pairs:
        _set(result, key, value, [])
    old, new = modes_of(data), modes_of(result)
    if old == new:
        return [], []
    return drop_fields_of_other_modes(data, old, new), kept_camera_warnings(result, pairs, old, new)


def _read_profile(data: dict[str, Any], folder: Path | None) -> None:
    """Replace the path of a sensor profile by the profile's fields, so that a run depends on no further file."""
    sensor = data.get("sensor")
    if not isinstance(sensor, dict):
        return
    named = sensor.get("profile")
    if isinstance(named, str) and named.lower().endswith(PROFILE_SUFFIXES):
        data["sensor"] = {**sensor, "profile": read_profile((folder or Path()) / named).model_dump(mode="json")}


def _is_path(model: str) -> bool:
    return model.lower().endswith((".yaml", ".yml"))


def _require_settings(settings: Settings) -> None:
    several = isinstance(settings, Sequence | Mapping) and not isinstance(settings, str)
    if not several or not all(isinstance(key, str) for key in settings):  # a mapping yields its keys
        raise RecipeError(
            f"settings: found {settings!r}, expected a list of texts such as ['output.image=png'], or a mapping such "
            "as {'output.image': 'png'}"
        )


@functools.lru_cache(maxsize=8)
def _read_yaml(text: str) -> Any:
    """Return the shared value of a text: the studio reads the same recipe with other settings at each change."""
    return read_yaml(text)


def _pairs(settings: Settings, problems: list[Problem]) -> list[tuple[str, Any]]:
    if isinstance(settings, Mapping):
        return [(key, copy.deepcopy(value)) for key, value in settings.items()]
    pairs = []
    for text in settings:
        key, equals, value = text.partition("=")
        if not equals or not key.strip():
            problems.append(Problem(f"--set {text}", "set-syntax", "no key=value", "e.g. output.image=png"))
            continue
        try:
            pairs.append((key.strip(), read_yaml(value)))
        except ValueError as error:
            problems.append(Problem(f"--set {text}", "set-syntax", str(error), "a YAML value"))
    return pairs


def _set(data: dict[str, Any], key: str, value: Any, problems: list[Problem]) -> None:
    """Put `value` at a dotted key and add mappings on the way; `objects.0.model` leads to the first item of a list."""
    node: Any = data
    *above, last = key.split(".")
    for step in above:
        place = _place(node, step, key, problems)
        if place is None:
            return
        child = node.get(place) if isinstance(node, dict) else node[place]
        if not isinstance(child, dict | list):
            # No mapping yet, or a word that becomes one: camera.pitch is `metadata` and becomes {fixed_deg: 0}.
            child = node[place] = {}
        node = child
    place = _place(node, last, key, problems)
    if place is not None:
        node[place] = value


def _place(node: Any, step: str, key: str, problems: list[Problem]) -> Any:
    """Return the key or index that a step of a dotted key means; None, with a problem, for no item of a list."""
    if not isinstance(node, list):
        return step
    if step.isdecimal() and int(step) < len(node):
        return int(step)
    problems.append(Problem(f"--set {key}", "set-key", f"no item {step!r}", f"a number from 0 to {len(node) - 1}"))
    return None
