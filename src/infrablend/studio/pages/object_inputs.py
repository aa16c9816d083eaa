"""Inputs for the model of an object, its options, the temperatures of its parts, and the number of objects."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from nicegui import ui

from infrablend.assets.catalogue import list_models
from infrablend.core.yaml_text import read_yaml
from infrablend.errors import ModelError
from infrablend.studio.object_form import (
    Count,
    OptionField,
    choice_of,
    chosen_of,
    count_of,
    fits_choice,
    options_of,
    parts_of,
    range_of_ends,
    weights_of,
    with_temperature,
    with_value,
)
from infrablend.studio.recipe_form import FormField

Change = Callable[[Any], None]


@dataclass
class Input:
    """A field of the form.

    Attributes:
        parts: Parts of the form that it is in.
        shown: Its inputs.
        marked: What is wrong, as it shows; empty for nothing.
    """

    parts: Sequence[Any]
    shown: Sequence[Any]
    marked: str = ""


Inputs = dict[str, Input]


def show_models(title: str, value: str, on_choice: Callable[[str], None]) -> list[Any]:
    """Show the list of the models with a picture of each; a model of the user's has none."""
    shipped = list_models()
    names = shipped if value in shipped else [value, *shipped]
    made = ui.select(names, value=value, label=title, on_change=lambda e: on_choice(e.value))
    made.props(f'dense outlined aria-label="{title}"').classes("w-full")
    made.add_slot(
        "option",
        '<q-item v-bind="props.itemProps"><q-item-section avatar>'
        '<img v-if="!/[./]/.test(props.opt.label)" :src="`/tune/model/${props.opt.label}.jpg`" alt="" loading="lazy" '
        'class="tune-model" /></q-item-section><q-item-section>{{ props.opt.label }}</q-item-section></q-item>',
    )
    with made.add_slot("prepend"):
        if value in shipped:
            ui.element("img").props(f'alt="" src="/tune/model/{value}.jpg"').classes("tune-model")
    return [made]


def show_counts(title: str, value: Count, on_change: Change) -> list[Any]:
    """Show the numbers of objects that are drawn for a frame, each with its weight."""
    weights: dict[int, float | None] = {**weights_of(value)}
    boxes = []

    def weigh(number: int, weight: float | None) -> None:
        weights[number] = weight
        on_change(count_of(weights))

    with ui.element("div").classes("studio-row"):
        for number, weight in weights.items():
            box = ui.number(f"{title} {number}, weight", value=weight, min=0).props("dense outlined debounce=300")
            box.classes("tune-end").on_value_change(lambda e, n=number: weigh(n, e.value))
            boxes.append(box)
    return boxes


def show_options(field: FormField, model: str, part: Any, unread: dict[str, str], on_change: Change) -> Inputs:
    """Show the options of a model, in a part of the form of its own; what is not stated is as the model draws it."""
    try:
        options = options_of(model)
    except ModelError:  # marked at the model
        return {}
    values = dict(field.value)
    found = Inputs()
    known = {o.name for o in options}
    options += [
        OptionField(name, "yaml", "not an option of this model; empty removes it")
        for name in values
        if name not in known
    ]

    def set_value(name: str, value: Any) -> None:
        values.update({name: value})
        on_change({k: v for k, v in values.items() if v is not None})

    with ui.expansion(f"options of {model}", value=bool(values)).props("dense").classes("w-full") as inner:
        for option in options:
            key = f"{field.key}.{option.name}"
            given = values.get(option.name)
            with ui.element("div").classes("tune-field"):
                change = _setter(option.name, set_value)
                if option.kind == "choice" and (given is None or fits_choice(option, given)):
                    shown = _show_choices(option, given, change)
                elif option.kind == "range" and (given is None or _is_range(given)):
                    shown = show_ends(option.name.replace("_", " "), given, change)
                else:
                    shown = _show_text(option.name.replace("_", " "), key, given, unread, change)
                ui.label(option.help).classes("faint tune-help")
            found[key] = Input((part, inner), shown)
    return found


def show_parts(field: FormField, model: str, part: Any, unread: dict[str, str], on_change: Change) -> Inputs:
    """Show the temperatures of the parts of a model, in a part of the form of its own."""
    try:
        parts = parts_of(model)
    except ModelError:
        return {}
    state = {"parts": dict(field.value)}
    found = Inputs()

    def set_part(name: str, value: Any) -> None:
        ends = None if value is None else value if isinstance(value, list) else [value, value]
        state["parts"] = with_temperature(state["parts"], name, ends)
        on_change(state["parts"])

    def set_rest(name: str, value: Any) -> None:
        state["parts"] = with_value(state["parts"], name, value)
        on_change(state["parts"])

    with ui.expansion(f"temperatures of {model}", value=bool(field.value)).props("dense").classes("w-full") as inner:
        ui.label("Surface minus air temperature. Empty: as the model has it.").classes("faint tune-help")
        for one in parts:
            given = (field.value.get(one.name) or {}).get("delta_t_k")
            with ui.element("div").classes("tune-field"):
                title = "all parts" if one.delta_t_k is None else one.name.replace("_", " ")
                shown = show_ends(f"{title}, K", given, _setter(one.name, set_part))
                own = "" if one.delta_t_k is None else f"By default {one.delta_t_k[0]:+g} to {one.delta_t_k[1]:+g} K. "
                ui.label(own + one.help).classes("faint tune-help")
            found[f"{field.key}.{one.name}"] = Input((part, inner), shown)
        for name, given in field.value.items():
            key = f"{field.key}.{name}"
            if key not in found:  # no part of this model; empty removes it
                found[key] = Input((part, inner), _show_text(name, key, given, unread, _setter(name, set_rest)))
    return found


def _setter(name: str, set_value: Callable[[str, Any], Any]) -> Change:
    return lambda value: set_value(name, value)


def _is_range(given: Any) -> bool:
    ends = given if isinstance(given, list) else [given]
    return len(ends) in (1, 2) and all(isinstance(v, int | float) and not isinstance(v, bool) for v in ends)


def _show_choices(option: OptionField, given: Any, on_change: Change) -> list[Any]:
    """Show a list of values; where the recipe may weigh them, with a weight for each chosen one."""
    title = option.name.replace("_", " ")
    names = {json.dumps(v): v if isinstance(v, str) else json.dumps(v) for v in option.values}
    chosen = {} if given is None else {json.dumps(v): w for v, w in chosen_of(given).items()}

    def tell() -> None:
        on_change(choice_of({json.loads(key): weight for key, weight in chosen.items()}))

    def choose(value: Any) -> None:
        kept = {v: chosen.get(v) for v in (value if isinstance(value, list) else [value] if value else [])}
        chosen.clear()
        chosen.update(kept)
        show_weights()
        tell()

    def weigh(name: str, weight: float | None) -> None:
        chosen[name] = weight
        tell()

    start: Any = list(chosen) if option.several else next(iter(chosen), None)
    made = ui.select(names, value=start, label=title, multiple=option.several, clearable=True)
    made.props(f'dense outlined aria-label="{title}"' + (" use-chips" if option.several else "")).classes("w-full")
    weights = ui.element("div").classes("studio-row")

    def show_weights() -> None:
        weights.clear()
        if option.weighted and len(chosen) > 1:
            with weights:
                for key, weight in chosen.items():
                    box = ui.number(f"weight of {names[key]}", value=weight, min=0).props("dense outlined debounce=300")
                    box.classes("tune-end").on_value_change(lambda e, k=key: weigh(k, e.value))

    show_weights()
    made.on_value_change(lambda e: choose(e.value))
    return [made]


def show_ends(
    title: str,
    given: Any,
    on_change: Change,
    low: float | None = None,
    high: float | None = None,
    joined: Callable[[Any, Any], Any] = range_of_ends,
) -> list[Any]:
    """Show two ends of a range, which may be from `low` to `high`; `joined` makes its value of them.

    As `range_of_ends` does, both empty stands for the model's own, and a range with one end is a number.
    """
    ends = [None, None] if given is None else list(given) if isinstance(given, list) else [given, given]
    boxes = []
    with ui.element("div").classes("studio-row"):
        for end, word in enumerate(("from", "to")):
            box = ui.number(f"{title}, {word}", value=ends[end], min=low, max=high)
            boxes.append(box.props("dense outlined debounce=150").classes("tune-end"))

            def change(value: float | None, end: int = end) -> None:
                ends[end] = value
                on_change(joined(*ends))

            box.on_value_change(lambda e, c=change: c(e.value))
    return boxes


def _show_text(title: str, key: str, given: Any, unread: dict[str, str], on_change: Change) -> list[Any]:
    """Show a value as in YAML; empty for none."""
    made = ui.input(title, value="" if given is None else json.dumps(given)).props("dense outlined debounce=500")

    def change(text: str) -> None:
        unread.pop(key, None)
        try:
            value = read_yaml(text) if text.strip() else None
        except ValueError as error:
            unread[key] = str(error)
            value = given
        on_change(value)

    made.classes("w-full").on_value_change(lambda e: change(e.value or ""))
    return [made]
