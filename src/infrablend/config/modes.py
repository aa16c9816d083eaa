"""The modes of a recipe: which fields each mode has, and the handling of fields of other modes.

`placement.mode`, `appearance.mode`, whether `matching.mode` is `radiometric` and whether `sensor.profile` is `off`
decide the classes of a recipe's sections.
A field of another mode's class is an error where its author wrote it. Only a setting that changes a mode
(`--set placement.mode=paper`) drops the fields that the recipe had for the old one. The camera's lens and roll have a
meaning in both placement modes, but seldom the same value: if they are kept, a warning lists them.
"""

from __future__ import annotations

import functools
import itertools
import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from pydantic import BaseModel

from infrablend.config.camera_models import LENS
from infrablend.config.recipe import (
    Camera,
    MetricArtisticRecipe,
    MetricPhysicalRecipe,
    NoSensor,
    PaperArtisticRecipe,
    PaperPhysicalRecipe,
    RadiometricRecipe,
    Recipe,
)
from infrablend.core.validation_messages import models_in, shorten
from infrablend.errors import Problem

# Fields of older recipes, by `section.field`: what became of them. A dotted name is the field's new place.
_MIN_CONTRAST = "the contrast is now measured in the finished picture; set placement.min_contrast"
REMOVED: Mapping[str, str] = {
    "placement.min_contrast_grey": _MIN_CONTRAST,
    "matching.min_contrast_grey": _MIN_CONTRAST,
    "environment.wind_m_s": "it never had an effect; remove it",
}

_GREY_MODE = "It follows from appearance.mode (physical is local, artistic is percentile); remove it"

DROPPED = "recipe-dropped"
"""Code of the warnings about fields that a change of mode dropped."""

KEPT = "recipe-kept"
"""Code of the warnings about fields that a change of mode kept although their value belongs to the old mode."""

Field = tuple[str, str]  # section and field; the section of an object's field is `objects`


class Modes(NamedTuple):
    """The modes of a recipe.

    Attributes:
        placement: `placement.mode`.
        look: `appearance.mode`.
        sensor: Whether `sensor.profile` names a camera: `on` or `off`.
        matching: `radiometric`, or `grey` for matching that follows from the look.
    """

    placement: str = "paper"
    look: str = "artistic"
    sensor: str = "off"
    matching: str = "grey"


CHOICES: Mapping[str, tuple[str, ...]] = {
    "placement.mode": ("paper", "metric"),
    "appearance.mode": ("artistic", "physical"),
}
RADIOMETRIC = "radiometric"
RADIOMETRIC_NEEDS = ("metric", "physical")
_CAMERAS = {"paper": "the recipe's virtual camera", "metric": "the real camera"}
_RECIPES: Mapping[tuple[str, str], type[Recipe]] = {
    ("paper", "artistic"): PaperArtisticRecipe,
    ("paper", "physical"): PaperPhysicalRecipe,
    ("metric", "artistic"): MetricArtisticRecipe,
    ("metric", "physical"): MetricPhysicalRecipe,
}


def modes_of(data: Mapping[str, object]) -> Modes:
    """Return the modes of a recipe's plain data; an unknown mode counts as the default one."""
    words = []
    for key, choices in CHOICES.items():
        section, field = key.split(".")
        word = _section(data, section).get(field)
        words.append(word if word in choices else choices[0])
    off = _section(data, "sensor").get("profile", "off") == "off"
    radiometric = _section(data, "matching").get("mode") == RADIOMETRIC
    fits = (words[0], words[1]) == RADIOMETRIC_NEEDS
    return Modes(words[0], words[1], "off" if off else "on", RADIOMETRIC if radiometric and fits else "grey")


def wrong_modes(data: Mapping[str, object]) -> list[Problem]:
    """Return one problem per mode that is none of the choices."""
    found = []
    for key, choices in CHOICES.items():
        section, field = key.split(".")
        word = _section(data, section).get(field, choices[0])
        if word not in choices:
            expected = " or ".join(f"'{c}'" for c in choices)
            found.append(Problem(key, "recipe-value", f"found {shorten(word)}", expected))
    modes = modes_of(data)
    matching = _section(data, "matching")
    if "mode" in matching and modes.matching != RADIOMETRIC:
        if matching["mode"] == RADIOMETRIC:
            has = f"found radiometric with placement.mode {modes.placement} and appearance.mode {modes.look}"
            found.append(
                Problem("matching.mode", "recipe-value", has, "placement.mode metric and appearance.mode physical")
            )
        else:
            expected = "radiometric, for 16-bit pictures with temperatures, or no such field"
            found.append(
                Problem("matching.mode", "recipe-value", f"found {shorten(matching['mode'])}", expected, _GREY_MODE)
            )
    return found


def recipe_class(modes: Modes) -> type[Recipe]:
    """Return the class of a recipe in these modes."""
    return RadiometricRecipe if modes.matching == RADIOMETRIC else _RECIPES[modes.placement, modes.look]


def recipe_from_json(text: str) -> Recipe:
    """Return the recipe that `model_dump_json` wrote; a `ValidationError` for another text."""
    return recipe_class(modes_of(json.loads(text))).model_validate_json(text)


@functools.cache
def sections_of(modes: Modes) -> Mapping[str, type[BaseModel]]:
    """Return the class of each section of a recipe in these modes; that of `objects` is the class of its items."""
    found = {}
    for section, info in recipe_class(modes).model_fields.items():
        classes = list(models_in(info.annotation))
        if section == "sensor":
            classes = [c for c in classes if (c is NoSensor) == (modes.sensor == "off")]
        if classes:
            (found[section],) = classes
    return found


@functools.cache
def fields_of(modes: Modes) -> frozenset[Field]:
    """Return the fields of all sections of a recipe in these modes."""
    return frozenset((section, field) for section, c in sections_of(modes).items() for field in c.model_fields)


def drop_fields_of_other_modes(data: dict[str, object], old: Modes, new: Modes) -> list[Problem]:
    """Remove the fields of `data` that have a meaning in the modes `old` and none in `new`.

    Returns:
        One warning per field removed.
    """
    dropped = []
    for section, at, values in _sections(data):
        for field in [f for f in values if (section, f) in fields_of(old) - fields_of(new)]:
            value = values.pop(field)
            found = f"{shorten(value)} is not used: {_explain_field((section, field), new)[0]}"
            dropped.append(Problem(f"{at}.{field}", DROPPED, found, severity="warning"))
    return dropped


def stated_camera_fields(settings: Iterable[tuple[str, Any]]) -> set[str]:
    """Return the fields of the camera that settings state, one by one or as a mapping."""
    whole = (value for key, value in settings if key == "camera" and isinstance(value, Mapping))
    single = (key.removeprefix("camera.") for key, _ in settings if key.startswith("camera."))
    return {*single, *(str(field) for value in whole for field in value)}


def kept_camera_warnings(
    data: Mapping[str, object], settings: Iterable[tuple[str, Any]], old: Modes, new: Modes
) -> list[Problem]:
    """Return warnings about the lens and the roll of a camera that was chosen for the other placement mode.

    Args:
        data: Plain data of the recipe, with the settings applied.
        settings: Dotted key and value of each setting; what they set explicitly is not warned about.
        old: Modes of the recipe.
        new: Modes after the settings.
    """
    if old.placement == new.placement:
        return []
    given = stated_camera_fields(settings)
    camera = {name: info.default for name, info in Camera.model_fields.items()} | dict(_section(data, "camera"))
    has = _CAMERAS[old.placement]
    needs = _CAMERAS[new.placement]
    expected = f"that of {needs}, for placement.mode {new.placement}"
    found = []
    if not given & LENS:
        lens = f"{camera['focal_length_mm']} mm on {camera['sensor_width_mm']} mm is the lens of {has}"
        todo = "Set camera.focal_length_mm and camera.sensor_width_mm"
        found.append(Problem("camera.focal_length_mm", KEPT, lens, expected, todo, "warning"))
    # A camera held level is plausible in both modes.
    if "roll_deg" not in given and camera["roll_deg"] not in (0, [0, 0], (0, 0)):
        roll = f"{shorten(camera['roll_deg'])} is the roll of {has}"
        found.append(Problem("camera.roll_deg", KEPT, roll, expected, "Set camera.roll_deg", "warning"))
    return found


def explain_unknown(path: tuple[int | str, ...], modes: Modes) -> tuple[str, str] | None:
    """Return why a recipe in these modes has no field at `path`, and the remedy; None for a misspelt field.

    Args:
        path: Steps of the field's dotted name, such as `("objects", 0, "group")`.
        modes: Modes of the recipe.
    """
    steps = [s for s in path if isinstance(s, str)]
    if len(steps) != 2:
        return None
    field = (steps[0], steps[1])
    name = ".".join(steps)
    if name in REMOVED:
        return "this field was removed", REMOVED[name]
    if not any(field in fields_of(m) for m in all_modes()):
        return None
    return _explain_field(field, modes)


def _explain_field(field: Field, modes: Modes) -> tuple[str, str]:
    """Return the modes that a field needs and the recipe lacks, and the remedy."""
    meaningful = [m for m in all_modes() if field in fields_of(m)]
    nearest = min(meaningful, key=lambda m: sum(a != b for a, b in zip(m, modes, strict=True)))
    needed = [
        (key, wanted, given)
        for key, wanted, given in zip((*CHOICES, "sensor.profile", "matching.mode"), nearest, modes, strict=True)
        if wanted != given
    ]
    needs = " and ".join(
        "a camera in sensor.profile" if w == "on" else "another matching.mode" if w == "grey" else f"{k} {w}"
        for k, w, _ in needed
    )
    has = " and ".join("no matching.mode" if given == "grey" else given for _, _, given in needed)
    settings = " and ".join(
        "no matching.mode" if w == "grey" else f"{k} to {'a camera' if w == 'on' else w}" for k, w, _ in needed
    )
    return f"this field has a meaning only with {needs}; this recipe has {has}", f"remove it, or set {settings}"


def all_modes() -> Iterator[Modes]:
    """Yield every combination of modes."""
    for placement, look, sensor in itertools.product(*CHOICES.values(), ("off", "on")):
        yield Modes(placement, look, sensor)
    for sensor in ("off", "on"):
        yield Modes(*RADIOMETRIC_NEEDS, sensor, RADIOMETRIC)


def _section(data: Mapping[str, object], name: str) -> Mapping[str, object]:
    section = data.get(name)
    return section if isinstance(section, Mapping) else {}


def _sections(data: dict[str, object]) -> Iterator[tuple[str, str, dict[str, object]]]:
    """Yield each mapping of fields with its section and its dotted name; each item of `objects` is one."""
    for section, values in data.items():
        if isinstance(values, dict):
            yield section, section, values
        elif section == "objects" and isinstance(values, list):
            yield from ((section, f"objects.{k}", item) for k, item in enumerate(values) if isinstance(item, dict))
