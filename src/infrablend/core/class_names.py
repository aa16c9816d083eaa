"""Maps the class names of datasets to classes of roughly known size and warmth: person, car, bicycle."""

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


def named_as(known: KnownClass, categories: Iterable[str]) -> str | None:
    """Return the first of the names that stands for a known class, or None."""
    return next((name for name in categories if known_class(name) == known), None)
