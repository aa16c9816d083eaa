"""What pydantic found wrong with a text of ours, in words for the one who wrote it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from infrablend.errors import Problem

_EXPECTED = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing_size": "a smaller whole number",
    "float_type": "a number",
    "bool_type": "true or false",
    "string_type": "a text",
    "tuple_type": "a list",
    "list_type": "a list",
    "model_type": "a mapping",
    "model_attributes_type": "a mapping",
    "dict_type": "a mapping",
    "none_required": "null",
    "finite_number": "a finite number",
    "missing": "a value",
    "greater_than": "a number above {gt:g}",
    "greater_than_equal": "a number of at least {ge:g}",
    "less_than": "a number below {lt:g}",
    "less_than_equal": "a number of at most {le:g}",
    "string_too_short": "a text that is not empty",
    "string_pattern_mismatch": "a text that matches {pattern}",
    "literal_error": "{expected}",
}


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """`Did you mean X?` if one of the names is close, else nothing."""
    close = get_close_matches(name, sorted(names), 1)
    return f"Did you mean {close[0]}?" if close else ""


_SPACE = "write a space after the colon: {key: value}"


def field_problems(error: ValidationError, data: Any, code: str, see: str) -> list[Problem]:
    """One problem for each wrong field, sorted; `code` begins their codes, `see` says where fields are described.

    Args:
        error: What validation raised.
        data: What was validated, plain values.
        code: `recipe` gives `recipe-value` and `recipe-unknown-key`.
        see: What to do about an unknown key.
    """
    alternatives: dict[tuple[int | str, ...], dict[str, list[tuple[tuple[int | str, ...], ErrorDetails]]]] = {}
    single: list[tuple[tuple[int | str, ...], ErrorDetails]] = []
    for e in error.errors(include_url=False):
        path, at, member = _locate(e, data)
        if member is None:
            single.append((path, e))
        else:
            alternatives.setdefault(at, {}).setdefault(member, []).append((path, e))
    found = [_problem(path, e, code, see) for path, e in single]
    for at, members in alternatives.items():
        found += _of_alternatives(at, members, _value(data, at), code, see)
    # A list is "too short" only because its items are wrong: the items say it better.
    wrong = {p.where for p in found}
    return sorted(
        {
            p
            for p in found
            if not (p.code == f"{code}-length" and any(w != p.where and w.startswith(f"{p.where}.") for w in wrong))
        }
    )


def _locate(e: ErrorDetails, data: Any) -> tuple[tuple[int | str, ...], tuple[int | str, ...], str | None]:
    """The field's path as the user wrote it; and, of a field with alternatives, its path and the alternative."""
    path: list[int | str] = []
    at: tuple[int | str, ...] = ()
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
            # Not a field: pydantic's name for an alternative, or an end of the range that a number stands for.
            if isinstance(step, str) and member is None:
                at, member = tuple(path), step
            continue
        path.append(step)
    return tuple(path), at, member


def _of_alternatives(
    at: tuple[int | str, ...],
    members: Mapping[str, list[tuple[tuple[int | str, ...], ErrorDetails]]],
    value: Any,
    code: str,
    see: str,
) -> list[Problem]:
    """The problems of a field that may be one thing or another: of the one the user meant, else what it may be."""
    if isinstance(value, Mapping):
        meant = [
            m
            for m in members.values()
            if any(len(path) > len(at) for path, _ in m)
            and not any(e["type"] in {"extra_forbidden", "missing"} for _, e in m)
        ]
        if len(meant) == 1:
            return [_problem(path, e, code, see) for path, e in meant[0]]
        odd = {"extra_forbidden", "missing"}
        fields = sorted({str(p[-1]) for m in members.values() for p, e in m if e["type"] == "missing"})
        fields = fields or sorted({str(p[-1]) for m in members.values() for p, e in m if e["type"] in odd})
        if fields:
            expected = "a mapping with " + " or ".join(fields) + (" alone" if len(fields) > 1 else "")
            todo = _SPACE if any(":" in k and v is None for k, v in value.items()) else see
            return [Problem(_dotted(at), f"{code}-value", f"found {_short(value)}", expected, todo)]
    texts = []
    for m in members.values():
        texts += [_expected(e) for path, e in m if path == at]
    return [Problem(_dotted(at), f"{code}-value", f"found {_short(value)}", " or ".join(dict.fromkeys(texts)))]


def _problem(path: tuple[int | str, ...], e: ErrorDetails, code: str, see: str) -> Problem:
    where = _dotted(path)
    if e["type"] == "extra_forbidden":
        todo = _SPACE if ":" in where and e["input"] is None else see
        return Problem(where, f"{code}-unknown-key", f"unknown key (value {_short(e['input'])})", "a known field", todo)
    if e["type"] == "value_error" and isinstance(e["input"], Mapping):  # fields that do not go together
        return Problem(where or code, f"{code}-value", _expected(e))
    found = "nothing" if e["type"] == "missing" else _short(e["input"])
    kind = "length" if e["type"] in {"too_short", "too_long"} else "value"
    return Problem(where, f"{code}-{kind}", f"found {found}", _expected(e))


def _expected(e: ErrorDetails) -> str:
    kind, context = e["type"], e.get("ctx", {})
    if kind in {"too_short", "too_long"}:
        limit = context.get("min_length" if kind == "too_short" else "max_length")
        return f"a list of at {'least' if kind == 'too_short' else 'most'} {limit} item(s)"
    if kind in _EXPECTED:
        return _EXPECTED[kind].format(**context)
    return re.sub(r"^(Value error, |Input should be )", "", e["msg"])


def _value(data: Any, path: tuple[int | str, ...]) -> Any:
    for step in path:
        data = data[step]
    return data


def _dotted(path: tuple[int | str, ...]) -> str:
    return ".".join(str(p) for p in path)


def _short(value: Any) -> str:
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= 60 else text[:57] + "..."
