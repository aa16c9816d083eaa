"""Reads recipes: a shipped name or a YAML file, with single fields set by the caller or the command line."""

from __future__ import annotations

import copy
import functools
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from infrablend.config.camera_models import LENS, prefer_stated_optics, with_optics
from infrablend.config.modes import (
    drop_fields_of_other_modes,
    explain_unknown,
    kept_camera_warnings,
    modes_of,
    recipe_class,
    stated_camera_fields,
    wrong_modes,
)
from infrablend.config.recipe import Recipe
from infrablend.config.sensor_profile import PROFILE_SUFFIXES, read_profile
from infrablend.core.file_names import real_path
from infrablend.core.files import RECIPES, ShippedFiles
from infrablend.core.validation_messages import did_you_mean, read_model
from infrablend.core.yaml_text import read_yaml
from infrablend.errors import Problem, RecipeError

log = logging.getLogger(__name__)

Settings = Sequence[str] | Mapping[str, Any]

_YAML = (".yaml", ".yml")


def list_recipes() -> list[str]:
    """Return the names of the shipped recipes, sorted."""
    return RECIPES.names


def recipe_text(name: str) -> str:
    """Return the YAML text of a shipped recipe; a `RecipeError` if none has that name."""
    return _shipped_text(RECIPES, name)


def _shipped_text(shipped: ShippedFiles, name: str) -> str:
    names = shipped.names
    noun = shipped.noun
    if name not in names:
        raise RecipeError(
            f"{noun} {name!r}: neither a shipped {noun} nor a YAML file that exists; shipped are {', '.join(names)}. "
            f"{did_you_mean(name, names) or 'Give one of these names or the path of a .yaml file.'}"
        )
    return shipped.text(name)


def read_text(shipped: ShippedFiles, named: str | Path) -> tuple[str, Path | None]:
    """Return the text of a shipped file, or of a YAML file with the folder that it is in.

    A path is anything with a suffix or a folder in it. A `RecipeError` if there is no such name or file.
    """
    path = Path(named)
    if path.suffix.lower() not in _YAML and path.parent == Path():
        return _shipped_text(shipped, str(named)), None
    try:
        return path.read_text("utf-8"), real_path(path).parent
    except (OSError, ValueError) as error:  # ValueError: not UTF-8, or a path with a NUL in it
        raise RecipeError(
            f"{shipped.noun} {path}: cannot be read ({error}); expected a YAML text file. "
            f"Shipped {shipped.noun}s are {', '.join(shipped.names)}."
        ) from error


def parse_mapping(text: str, what: str, docs: str) -> dict[str, object]:
    """Return the fields in the YAML text of a file; `docs` is the page that explains them.

    Raises:
        RecipeError: The text is not YAML, or no mapping.
    """
    try:
        data = copy.deepcopy(_read_yaml(text))
    except ValueError as error:
        raise RecipeError(f"{what}: {error}. Correct the file; {docs} explains the fields.") from error
    if not isinstance(data, dict):
        raise RecipeError(f"{what}: found {type(data).__name__}, expected a mapping of fields")
    return data


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
    kept from the other placement mode gives a warning too. `read_recipe` has the same arguments and errors, and returns
    these warnings.
    """
    loaded = read_recipe(recipe, settings)
    for problem in loaded.warnings:
        log.warning("%s", problem)
    return loaded.recipe


def read_recipe(recipe: str | Path, settings: Settings = ()) -> LoadedRecipe:
    """Return the recipe of that name or file, with `settings` applied, and the fields that these dropped.

    Args:
        recipe: A shipped name, or a path (anything with a suffix or a folder in it).
        settings: `key=value` texts (dotted keys, YAML values), or a mapping of dotted keys to values. Paths in them are
            relative to the working directory.

    Raises:
        RecipeError: With every unknown key and bad value at once.
    """
    _require_settings(settings)
    text, folder = read_text(RECIPES, recipe)
    return parse_recipe(text, str(recipe), settings, folder)


def parse_recipe(text: str, where: str, settings: Settings = (), folder: Path | None = None) -> LoadedRecipe:
    """Return the recipe in a YAML text.

    Args:
        text: The YAML text.
        where: Name of the recipe in errors.
        settings: As of `read_recipe`.
        folder: Folder that paths in the text are relative to; the working directory by default.

    Raises:
        RecipeError: With every unknown key and bad value at once.
    """
    data = parse_mapping(text, f"recipe {where}", "docs/reference/recipe.md")
    problems: list[Problem] = []
    pairs = _pairs(settings, problems)
    _make_paths_whole(data, folder or Path())  # those of the settings are relative to the working directory
    dropped, kept = _change_modes(data, pairs)
    for key, value in pairs:
        _set(data, key, value, problems)
    _complete_lens(data, pairs, problems)
    _make_paths_whole(data, Path())
    _read_profile(data)
    problems += wrong_modes(data)
    modes = modes_of(data)
    see = "see docs/reference/recipe.md for all fields"
    found = read_model(recipe_class(modes), data, where, "recipe", see, lambda path: explain_unknown(path, modes))
    if isinstance(found, list):
        known = {p.where for p in problems}
        problems += [p for p in found if p.where not in known]
    if problems or isinstance(found, list):
        raise RecipeError(f"recipe {where}: {len(set(problems))} field(s) are wrong", sorted(set(problems)))
    return LoadedRecipe(found, tuple(dropped), tuple(kept))


def _complete_lens(data: dict[str, object], pairs: Sequence[tuple[str, Any]], problems: list[Problem]) -> None:
    """Fill in the lens that a camera's model or pixel pitch means; one that settings state replaces that of the file.

    It also counts more than the field of view of the pictures' own files. A `field_of_view` of the recipe's file does
    not prevent that, for recipes that the studio writes state every field; one among the settings does.
    """
    camera = data.get("camera")
    stated = stated_camera_fields(pairs)
    if not isinstance(camera, dict):
        return
    if (missing := prefer_stated_optics(camera, stated)) is not None:
        found = "stated alone, beside a focal length for another sensor"
        problems.append(Problem("camera.pixel_pitch_um", "recipe-value", found, missing))
    if stated & LENS and "field_of_view" not in stated and modes_of(data).placement == "metric":
        camera["field_of_view"] = "recipe"
    try:
        data["camera"] = with_optics(camera)
    except ValueError as error:
        problems.append(Problem("camera", "recipe-value", str(error), "one statement of the lens"))


def _change_modes(data: dict[str, object], pairs: Sequence[tuple[str, Any]]) -> tuple[list[Problem], list[Problem]]:
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


def _make_paths_whole(data: Mapping[str, object], folder: Path) -> None:
    """Replace paths of models, of a sensor profile and of masks, which are relative to a folder, by whole paths.

    The record of a run has the whole path, so that the run can be used from any folder.
    """
    objects = data.get("objects")
    sensor = data.get("sensor")
    places = [(item, "model", _YAML) for item in (objects if isinstance(objects, list) else ())]
    for item, field, suffixes in [*places, (sensor, "profile", PROFILE_SUFFIXES)]:
        named = item.get(field) if isinstance(item, dict) else None
        if isinstance(named, str) and named.lower().endswith(tuple(suffixes)):
            item[field] = whole_path(folder, named)
    placement = data.get("placement")
    where = placement.get("where") if isinstance(placement, dict) else None
    if isinstance(where, dict) and isinstance(where.get("masks"), str):
        where["masks"] = whole_path(folder, where["masks"])


def whole_path(folder: Path, named: str) -> str:
    """Return the whole path of a file; a link is kept, as its reader refuses a description that leaves its folder."""
    path = folder / named
    return str(real_path(path.parent) / path.name)


def _read_profile(data: dict[str, object]) -> None:
    """Replace the path of a sensor profile by the profile's fields, so that a run depends on no further file."""
    sensor = data.get("sensor")
    if not isinstance(sensor, dict):
        return
    named = sensor.get("profile")
    if isinstance(named, str) and named.lower().endswith(PROFILE_SUFFIXES):
        data["sensor"] = {**sensor, "profile": read_profile(Path(named)).model_dump(mode="json")}


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


def _set(data: dict[str, object], key: str, value: Any, problems: list[Problem]) -> None:
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
