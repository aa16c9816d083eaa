"""Classes whose size and warmth are roughly known, by the names that datasets give them."""

from __future__ import annotations

from collections.abc import Mapping
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
