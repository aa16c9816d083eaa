"""Turns pydantic's validation errors into messages for the author of a recipe or another YAML file."""

from __future__ import annotations

import json
import re
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from difflib import get_close_matches
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from infrablend.errors import Problem

Path = tuple[int | str, ...]
Model = TypeVar("Model", bound=BaseModel)

# Pydantic's own messages speak of JSON where the user wrote YAML.
_EXPECTED = {
    "model_type": "a mapping",
    "model_attributes_type": "a mapping",
    "dict_type": "a mapping",
    "tuple_type": "a list",
    "list_type": "a list",
    "missing": "a value",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "string_type": "text",
}
_QUOTE = "'"
_MAPPING_TYPES = ("model_type", "model_attributes_type", "dict_type")
_SPACE = "write a space after the colon: {key: value}"


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """Return `Did you mean X?` if one of the names is close, else an empty text."""
    close = get_close_matches(name, sorted(names), 1)
    return f"Did you mean {close[0]}?" if close else ""


def shorten(value: Any) -> str:
    """Return a value as JSON of at most 60 characters."""
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= 60 else text[:57] + "..."


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the model classes inside an annotation, in order."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in typing.get_args(annotation):
        yield from models_in(inner)


def read_model(
    model: type[Model],
    data: Any,
    where: str,
    code: str,
    see: str,
    explain: Callable[[Path], tuple[str, str] | None] = lambda path: None,
) -> Model | list[Problem]:
    """Return the model that plain values of a YAML file describe, or one problem per wrong field, sorted.

    Args:
        model: Class of the model.
        data: Plain values.
        where: Name of the file, for values that JSON cannot hold.
        code: Start of the problems' codes: `recipe` gives `recipe-value` and `recipe-unknown-key`.
        see: Remedy for an unknown key that resembles no known one.
        explain: Returns the cause and the remedy of an unknown key at a path, or None for the default message.
    """
    try:
        # Through JSON: strict mode then takes lists for tuples, and still refuses "640" or true for a number.
        return model.model_validate_json(json.dumps(data))
    except ValidationError as error:
        return _field_problems(error, data, model, code, see, explain)
    except (TypeError, ValueError) as error:
        return [Problem(where, f"{code}-value", str(error), "plain numbers, texts, lists and mappings")]


def _field_problems(
    error: ValidationError,
    data: Any,
    model: type[BaseModel],
    code: str,
    see: str,
    explain: Callable[[Path], tuple[str, str] | None],
) -> list[Problem]:
    alternatives: dict[Path, dict[str, list[tuple[Path, ErrorDetails]]]] = {}
    found: list[Problem] = []

    def add(path: Path, e: ErrorDetails) -> None:
        found.append(_unknown(path, e) if e["type"] == "extra_forbidden" else _problem(path, e, code))

    def _unknown(path: Path, e: ErrorDetails) -> Problem:
        where = _dotted(path)
        value = shorten(e["input"])
        if explained := explain(path):
            return Problem(where, f"{code}-unknown-key", explained[0], "", explained[1])
        todo = did_you_mean(str(path[-1]), _known_names(model, path)) or see
        todo = _SPACE if ":" in where and e["input"] is None else todo
        return Problem(where, f"{code}-unknown-key", f"unknown key (value {value})", "a known field", todo)

    for e in error.errors(include_url=False):
        path, at, member = _locate(e, data)
        if member is None:
            add(path, e)
        else:
            alternatives.setdefault(at, {}).setdefault(member, []).append((path, e))
    for at, members in alternatives.items():
        intended = _errors_of_intended_member(at, members, _value(data, at))
        if intended is not None:
            for path, e in intended:
                add(path, e)
        else:
            found.append(_union_problem(at, members, _value(data, at), code, see, _mapping_text(model, at)))
    # Other problems explain these better: a list "too short" because its items are wrong, and the missing key `share`
    # where `share:0.5` is an unknown one.
    wrong = {p.where for p in found}
    clearer = {f"{code}-length": (".", ":")}
    return sorted({p for p in found if not _explained(p.where, clearer.get(p.code, (":",)), wrong)})


def _explained(where: str, by: Iterable[str], wrong: Iterable[str]) -> bool:
    """Return whether the place of another problem is this one's, followed by one of the separators and more."""
    return any(w.startswith(tuple(where + separator for separator in by)) for w in wrong)


def _locate(e: ErrorDetails, data: Any) -> tuple[Path, Path, str | None]:
    """Return the field's path as the user wrote it, and for a union also its path and the member's name."""
    path: list[int | str] = []
    at: Path = ()
    member: str | None = None
    node = data
    for k, step in enumerate(e["loc"]):
        last = k == len(e["loc"]) - 1
        if isinstance(node, Mapping) and step in node:
            node = node[str(step)]
        elif isinstance(node, list) and isinstance(step, int) and step < len(node):
            node = node[step]
        elif last and e["type"] == "missing":
            pass
        else:
            # Not a field: the name of a union's member, or an end of the range that a single number stands for.
            if isinstance(step, str) and member is None:
                at = tuple(path)
                member = step
            continue
        path.append(step)
    return tuple(path), at, member


def _errors_of_intended_member(
    at: Path, members: Mapping[str, list[tuple[Path, ErrorDetails]]], value: Any
) -> list[tuple[Path, ErrorDetails]] | None:
    """Return the errors of the union member that the user intended; None if this is ambiguous."""
    if len(members) == 1:
        return next(iter(members.values()))
    if not isinstance(value, Mapping):
        return None
    fitting = []
    for errors in members.values():
        reaches_inside = any(len(path) > len(at) for path, _ in errors)
        has_other_fields = any(e["type"] in {"extra_forbidden", "missing"} for _, e in errors)
        if reaches_inside and not has_other_fields:
            fitting.append(errors)
    return fitting[0] if len(fitting) == 1 else None


def _union_problem(
    at: Path,
    members: Mapping[str, list[tuple[Path, ErrorDetails]]],
    value: Any,
    code: str,
    see: str,
    mapping: str,
) -> Problem:
    """Return the problem of a value that fits no member of a union; it lists the allowed values."""
    errors = [(path, e) for m in members.values() for path, e in m]
    if isinstance(value, Mapping):
        fields = sorted({str(p[-1]) for p, e in errors if e["type"] == "missing"})
        fields = fields or sorted({str(p[-1]) for p, e in errors if e["type"] == "extra_forbidden"})
        if fields:
            expected = "a mapping with " + " or ".join(fields) + (" alone" if len(fields) > 1 else "")
            todo = _SPACE if any(":" in k and v is None for k, v in value.items()) else see
            return Problem(_dotted(at), f"{code}-value", f"found {shorten(value)}", expected, todo)
    texts = dict.fromkeys(mapping if e["type"] in _MAPPING_TYPES else _expected(e) for path, e in errors if path == at)
    return Problem(_dotted(at), f"{code}-value", f"found {shorten(value)}", " or ".join(texts))


def _problem(path: Path, e: ErrorDetails, code: str) -> Problem:
    where = _dotted(path)
    if e["type"] == "value_error" and isinstance(e["input"], Mapping):  # fields that do not go together
        return Problem(where or code, f"{code}-value", _expected(e))
    found = "nothing" if e["type"] == "missing" else shorten(e["input"])
    kind = "length" if e["type"] in {"too_short", "too_long"} else "value"
    return Problem(where, f"{code}-{kind}", f"found {found}", _expected(e))


def _expected(e: ErrorDetails) -> str:
    if e["type"] in _EXPECTED:
        return _EXPECTED[e["type"]]
    if e["type"] == "union_tag_not_found":
        return f"a mapping with {e['ctx']['discriminator'].strip(_QUOTE)}"
    if e["type"] == "union_tag_invalid":
        return f"{e['ctx']['discriminator'].strip(_QUOTE)} as one of {e['ctx']['expected_tags'].replace(_QUOTE, '')}"
    text = re.sub(r"^(Value error, |Input should be |\w+ should have )|( after validation, not \d+)$", "", e["msg"])
    return re.sub(r"^String should match ", "a text of the ", text)


def _mapping_text(model: type[BaseModel], path: Path) -> str:
    """Return `a mapping with values` for a field that takes a mapping: with the keys that it must have."""
    parents = _parents(model, path)
    fields = [f for m in parents if (f := m.model_fields.get(str(path[-1]))) is not None] if path else []
    inner = dict.fromkeys(m for f in fields for m in models_in(f.annotation))
    keys = dict.fromkeys(
        " and ".join(needed) for m in inner if (needed := [n for n, f in m.model_fields.items() if f.is_required()])
    )
    return "a mapping" + (f" with {' or '.join(keys)}" if keys else "")


def _known_names(model: type[BaseModel], path: Path) -> set[str]:
    return {name for m in _parents(model, path) for name in m.model_fields}


def _parents(model: type[BaseModel], path: Path) -> list[type[BaseModel]]:
    """Return the models that can stand at the parent of `path`."""
    models = [model]
    for step in path[:-1]:
        inner = [m for o in models if step in o.model_fields for m in models_in(o.model_fields[str(step)].annotation)]
        models = inner or models  # an item of a list or a key of a mapping leads no deeper
    return models


def _value(data: Any, path: Path) -> Any:
    for step in path:
        data = data[step]
    return data


def _dotted(path: Path) -> str:
    return ".".join(str(p) for p in path)
