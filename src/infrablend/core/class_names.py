"""Compares class names, and maps those of datasets to classes of known size and warmth: person, car, bicycle."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal

KnownClass = Literal["person", "car", "bicycle"]

NAMES: Mapping[KnownClass, frozenset[str]] = {
    "person": frozenset({"person", "people", "human", "pedestrian"}),
    "car": frozenset({"car", "vehicle"}),
    "bicycle": frozenset({"bicycle", "bike", "two-wheeler"}),
}


def known_class(category: str) -> KnownClass | None:
    """Return the known class that a category's name stands for, whatever its case, or None."""
    name = category.casefold()
    return next((known for known, names in NAMES.items() if name in names), None)


def differ_in_form(one: str, other: str) -> bool:
    """Return whether two names are different, but the same word in another case, or its singular and plural."""
    if one == other:
        return False
    a, b = one.casefold(), other.casefold()
    return a == b or b in _plurals(a) or a in _plurals(b)


def _plurals(word: str) -> set[str]:
    irregular = {"person": "people", "man": "men", "woman": "women"}
    found = {f"{word}s", f"{word}es", irregular.get(word, "")}
    return found | {f"{word[:-1]}ies"} if word.endswith("y") else found


def named_as(known: KnownClass, categories: Iterable[str]) -> str | None:
    """Return the first of the names that stands for a known class, or None."""
    return next((name for name in categories if known_class(name) == known), None)
