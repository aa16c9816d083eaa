"""What a browser changes of an object in a recipe: the options of its model, and the temperatures of its parts.

A model says in words what values its options take. Where these are a list of values or a range, the option has inputs
of its own; others are written as in YAML. The model itself checks what is given. The numbers of objects that are drawn
for frames have a weight each.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypedDict

from infrablend.assets.catalogue import load_model
from infrablend.config.recipe import ALL_PARTS, Recipe
from infrablend.core.rng import stream
from infrablend.core.yaml_text import read_yaml
from infrablend.errors import ModelError, Problem

_END = re.compile(r"[;:]|,? (?:a list|or a list|or each|or both)\b")
_VALUE = re.compile(r"[\w.-]+")
_GROUP = re.compile(r"[\w-]+: ")


class Count(TypedDict):
    """Numbers of objects that a recipe draws from, with their weights; None for equal ones."""

    values: list[int]
    weights: list[float] | None


@dataclass(frozen=True)
class OptionField:
    """An option of a model.

    Attributes:
        name: Name of the option.
        kind: Kind of input.
        help: What values it takes, in words.
        values: Values to choose from.
        several: Whether a recipe may give several values.
        weighted: Whether a recipe may give each of them a weight.
    """

    name: str
    kind: Literal["choice", "range", "yaml"]
    help: str
    values: tuple[Any, ...] = ()
    several: bool = False
    weighted: bool = False


def options_of(model: str) -> list[OptionField]:
    """Return the options of a model; a `ModelError` if there is no such model."""
    return [_option(name, words) for name, words in load_model(model).options.items()]


def _option(name: str, words: str) -> OptionField:
    if "[low, high]" in words:
        return OptionField(name, "range", words)
    groups = words.replace(" (default)", "").split("; ")
    if len(groups) > 1 and all(_GROUP.match(g) for g in groups):  # values by those of another option
        groups = [", ".join(_END.split(_GROUP.sub("", g, count=1))[0] for g in groups)]
    listed = _END.split(groups[0])[0].removeprefix("one of ")
    values = [v.strip() for v in re.split(r", | or ", listed) if v.strip()]
    if len(values) < 2 or not all(_VALUE.fullmatch(v) for v in values):
        return OptionField(name, "yaml", words)
    several = bool(re.search(r"\ba list of|\bor both\b", words))
    return OptionField(name, "choice", words, tuple(read_yaml(v) for v in values), several, "its weight" in words)


def chosen_of(given: Any) -> dict[Any, float | None]:
    """Return the values that a recipe gives to an option with their weights; None for no weight."""
    if isinstance(given, Mapping):
        return {value: float(weight) for value, weight in given.items()}
    return dict.fromkeys(given if isinstance(given, list) else [given])


def choice_of(chosen: Mapping[Any, float | None]) -> Any:
    """Return what a recipe gives to an option for some values with their weights, the inverse of `chosen_of`.

    None for no value. Values without a weight have weight 1 beside others with one.
    """
    if any(w is not None for w in chosen.values()):
        return {value: 1.0 if weight is None else weight for value, weight in chosen.items()}
    values = list(chosen)
    return values if len(values) > 1 else values[0] if values else None


def fits_choice(option: OptionField, given: Any) -> bool:
    """Return whether the inputs of an option can show what a recipe gives to it."""
    chosen = given if isinstance(given, Mapping | list) else [given]
    # Python takes 1 for True.
    known = {json.dumps(v) for v in option.values}
    return all(isinstance(v, str | int | float) and json.dumps(v) in known for v in chosen)


def weights_of(count: Count) -> dict[int, float]:
    """Return the numbers of objects that a recipe draws from with their weights, and two larger ones of weight 0."""
    weights = count["weights"] or [1.0] * len(count["values"])
    found = dict.fromkeys(range(max(count["values"]) + 3), 0.0)
    for value, weight in zip(count["values"], weights, strict=True):
        found[value] += weight
    return found


def count_of(weights: Mapping[int, float | None]) -> Count:
    """Return what a recipe gives to `count` for numbers of objects with their weights; None counts as 0."""
    given = {value: weight for value, weight in weights.items() if weight} or {0: 0.0}
    return {"values": list(given), "weights": list(given.values())}


def range_of_ends(low: float | None, high: float | None) -> Any:
    """Return a number or [low, high] from two ends, of which None is the other one; None for none."""
    ends = [v for v in (low, high) if v is not None]
    return None if not ends else ends if len(ends) == 2 and ends[0] != ends[1] else ends[0]


@dataclass(frozen=True)
class PartField:
    """A part of a model, with the temperatures above the air that it has by default, kelvin, and what it is."""

    name: str
    delta_t_k: tuple[float, float] | None
    help: str


def parts_of(model: str) -> list[PartField]:
    """Return the parts of a model, after that for all parts; a `ModelError` if there is no such model."""
    found = [PartField(ALL_PARTS, None, "all parts of the object that are not named")]
    return found + [PartField(n, r.delta_t_k, r.what) for n, r in sorted(load_model(model).parts.items())]


def with_value(values: Mapping[str, object], name: str, value: object) -> dict[str, object]:
    """Return a mapping with a value, or without it if the value is None."""
    return {**{k: v for k, v in values.items() if k != name}, **({} if value is None else {name: value})}


def with_temperature(parts: Mapping[str, Any], name: str, delta_t_k: Sequence[float] | None) -> dict[str, Any]:
    """Return the recipe's `parts` with the temperature of one, which keeps its emissivity; None for the model's own."""
    rest = {k: v for k, v in (parts.get(name) or {}).items() if k != "delta_t_k" and v is not None}
    made = rest if delta_t_k is None else {"delta_t_k": list(delta_t_k), **rest}
    return with_value(parts, name, made or None)


def model_problems(recipe: Recipe) -> list[Problem]:
    """Return what is wrong with the models of a recipe, their options and their parts, each in its own field."""
    return [p for k, kind in enumerate(recipe.objects) for p in _problems_of(f"objects.{k}", kind)]


def _problems_of(where: str, kind: Any) -> Iterator[Problem]:
    try:
        model = load_model(kind.model)
    except ModelError as error:
        yield Problem(f"{where}.model", "recipe-value", error.message)
        return
    for name, value in kind.options.items():
        try:
            model.sample(stream(0, "options"), {name: value})
        except ModelError as alone:
            try:  # some options depend on others
                model.sample(stream(0, "options"), kind.options)
            except ModelError:
                yield Problem(f"{where}.options.{name}", "recipe-value", alone.message)
    for name in kind.parts:
        if name not in {*model.parts, ALL_PARTS}:
            yield Problem(f"{where}.parts.{name}", "recipe-value", "no such part", ", ".join(sorted(model.parts)))
