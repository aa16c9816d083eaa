"""Checks of values that callers of the Python interface pass, before anything is started or written.

Each raises an `ArgumentError` for another value.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from numbers import Integral
from typing import Any

from infrablend.errors import ArgumentError


def require_names(where: str, value: Sequence[str] | None) -> None:
    """Check that a value is a list of names, or None; a single text would be taken for a list of its letters."""
    if value is None:
        return
    if isinstance(value, str):
        raise ArgumentError(f"{where}: found the text {value!r}, expected a list of names. Write [{value!r}]")
    if not isinstance(value, Collection) or not all(isinstance(name, str) for name in value):
        raise ArgumentError(f"{where}: found {value!r}, expected a list of names")


def require_choice(where: str, value: object, choices: Collection[str]) -> None:
    """Check that a value is one of these names."""
    if not isinstance(value, str) or value not in choices:
        raise ArgumentError(f"{where}: found {value!r}, expected one of {', '.join(choices)}")


def require_choices(where: str, value: Sequence[str] | None, choices: Collection[str]) -> None:
    """Check that a value is a list of some of these names, or None."""
    require_names(where, value)
    for name in value or ():
        require_choice(where, name, choices)


def require_whole(where: str, value: Any, least: int | None = None) -> None:
    """Check that a value is a whole number, not below `least`."""
    if not isinstance(value, Integral) or isinstance(value, bool) or (least is not None and value < least):
        expected = "a whole number" if least is None else f"a whole number from {least} up"
        raise ArgumentError(f"{where}: found {value!r}, expected {expected}")
