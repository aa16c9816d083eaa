"""Checks and draws of a model's parameters and options, with errors that name model, option and what was expected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from infrablend.errors import ModelError


@dataclass(frozen=True)
class Checks:
    """Checks in the name of one model."""

    model: str

    def bad(
        self, where: str, found: object, expected: str, todo: str = "Correct the value or leave it out."
    ) -> ModelError:
        """The error for a value that is not what it may be; `where` is such as `option pose`."""
        return ModelError(f"{self.model} model, {where}: found {found!r}; expected {expected}. {todo}")

    def known(self, kind: str, given: Sequence[str], allowed: Sequence[str]) -> None:
        """Raise ModelError if a name is not among the allowed ones; `kind` is `option` or `parameter`."""
        unknown = sorted(set(given) - set(allowed))
        if unknown:
            raise self.bad(f"{kind} {unknown[0]}", unknown[0], f"{kind}s " + ", ".join(allowed), "Remove it.")

    def one_of(self, where: str, value: object, allowed: Sequence[str]) -> str:
        """The value, if it is one of the allowed strings."""
        if not isinstance(value, str) or value not in allowed:
            raise self.bad(where, value, "one of " + ", ".join(allowed))
        return value

    def some_of(self, where: str, value: object, allowed: Sequence[str]) -> tuple[str, ...]:
        """The allowed strings that a value names: one, or a list of some."""
        if isinstance(value, list | tuple) and value:
            return tuple(self.one_of(where, v, allowed) for v in value)
        return (self.one_of(where, value, allowed),)

    def number(self, where: str, value: object, low: float, high: float) -> float:
        """The value, if it is a number in [low, high]."""
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise self.bad(where, value, f"a number from {low:g} to {high:g}")
        return float(value)

    def number_range(self, where: str, value: object, low: float, high: float) -> tuple[float, float]:
        """The range that a number or [low, high] stands for, within the limits."""
        if not isinstance(value, list | tuple):
            single = self.number(where, value, low, high)
            return single, single
        if len(value) != 2:
            raise self.bad(where, value, f"a number from {low:g} to {high:g}, or [low, high]")
        first, last = (self.number(where, v, low, high) for v in value)
        if first > last:
            raise self.bad(where, value, "low not above high")
        return first, last

    def flag(self, where: str, value: object) -> bool:
        """The value, if it is true or false."""
        if not isinstance(value, bool):
            raise self.bad(where, value, "true or false")
        return value


def pick(names: Sequence[str], odds: Sequence[float], share: float) -> str:
    """The name at `share` in [0, 1) of the odds laid end to end."""
    edges = np.cumsum(odds) / float(np.sum(odds))
    return names[min(int(np.searchsorted(edges, share, side="right")), len(names) - 1)]
