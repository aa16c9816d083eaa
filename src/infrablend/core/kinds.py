"""Kinds of objects whose size and warmth are roughly known, by the names that datasets give them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

Kind = Literal["person", "car", "bicycle"]

NAMES: Mapping[Kind, frozenset[str]] = {
    "person": frozenset({"person", "people", "human", "pedestrian"}),
    "car": frozenset({"car", "vehicle"}),
    "bicycle": frozenset({"bicycle", "bike", "two-wheeler"}),
}


def kind_of(category: str) -> Kind | None:
    """The kind that a category's name means, whatever its case, or None."""
    name = category.casefold()
    return next((kind for kind, names in NAMES.items() if name in names), None)
