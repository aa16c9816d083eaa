"""Parameters and options of a model: checks with errors that name the model and the option, and draws.

`Dials` holds the parameters of a model as a table: which numbers and choices it has, and how they are drawn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from infrablend.assets.model import Params
from infrablend.errors import ModelError

T = TypeVar("T")
Range = tuple[float, float]


@dataclass(frozen=True)
class Checks:
    """Checks whose errors name one model.

    Attributes:
        model: Name of the model.
    """

    model: str

    def bad(
        self, where: str, found: object, expected: str, todo: str = "Correct the value or leave it out."
    ) -> ModelError:
        """Return the error for an invalid value; `where` is, for example, `option pose`."""
        return ModelError(f"{self.model} model, {where}: found {found!r}; expected {expected}. {todo}")

    def known(self, kind: str, given: Params, allowed: Sequence[str]) -> None:
        """Raise ModelError if a given name is not among the allowed ones; `kind` is `option` or `parameter`."""
        unknown = sorted(set(given) - set(allowed))
        if unknown:
            raise self.bad(f"{kind} {unknown[0]}", given[unknown[0]], f"{kind}s " + ", ".join(allowed), "Remove it.")

    def complete(self, params: Params, needed: Sequence[str]) -> None:
        """Raise ModelError if a needed parameter is missing."""
        for name in needed:
            if name not in params:
                raise ModelError(
                    f"{self.model} model, parameter {name}: is missing; expected all of {', '.join(needed)}. Add it."
                )

    def one_of(self, where: str, value: object, allowed: Sequence[T]) -> T:
        """Return the value if it is one of the allowed ones."""
        # `True == 1` in Python: compare types too.
        found = [a for a in allowed if type(a) is type(value) and a == value]
        if not found:
            raise self.bad(where, value, "one of " + ", ".join(map(str, allowed)))
        return found[0]

    def some_of(self, where: str, value: object, allowed: Sequence[T]) -> tuple[T, ...]:
        """Return the allowed values that an option names: one value, or a list of some."""
        if isinstance(value, list | tuple) and value:
            return tuple(self.one_of(where, v, allowed) for v in value)
        return (self.one_of(where, value, allowed),)

    def weighted(
        self, where: str, value: object, allowed: Sequence[T], odds: Mapping[T, float]
    ) -> tuple[tuple[T, ...], tuple[float, ...]]:
        """Return the allowed values that an option names, as in `some_of`, with their odds.

        A mapping of values to weights gives other odds.
        """
        if not isinstance(value, Mapping):
            names = self.some_of(where, value, allowed)
            return names, tuple(odds[n] for n in names)
        names = tuple(self.one_of(where, v, allowed) for v in value)
        weights = tuple(self.number(f"{where}.{n}", weight, 0.0, 1e6) for n, weight in value.items())
        if not any(weights):
            raise self.bad(where, value, "a weight above 0")
        return names, weights

    def number(self, where: str, value: object, low: float, high: float) -> float:
        """Return the value if it is a number in [low, high]."""
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise self.bad(where, value, f"a number from {low:g} to {high:g}")
        return float(value)

    def number_range(self, where: str, value: object, low: float, high: float) -> Range:
        """Return an option's value as a range, from a number or [low, high] within the limits."""
        if not isinstance(value, list | tuple):
            single = self.number(where, value, low, high)
            return single, single
        if len(value) != 2:
            raise self.bad(where, value, f"a number from {low:g} to {high:g}, or [low, high]")
        first, last = (self.number(where, v, low, high) for v in value)
        if first > last:
            raise self.bad(where, value, "[low, high] with low not above high")
        return first, last

    def range_of_kind(
        self, name: str, options: Params, kind: str, kinds: Sequence[str], limits: Mapping[str, Range], drawn: Range
    ) -> Range:
        """Return the range to draw a number from whose limits depend on the kind of the individual, such as its age.

        Of an option's range for all kinds that may be drawn, each takes the numbers that it can have.
        """
        lowest, highest = min(limits[k][0] for k in kinds), max(limits[k][1] for k in kinds)
        low, high = self.number_range(f"option {name}", options.get(name, drawn), lowest, highest)
        least, most = limits[kind]
        return min(max(low, least), most), min(max(high, least), most)

    def flag(self, where: str, value: object) -> bool:
        """Return the value if it is true or false."""
        if not isinstance(value, bool):
            raise self.bad(where, value, "true or false")
        return value

    def choose(self, name: str, options: Params, allowed: Sequence[T], odds: Sequence[float], share: float) -> T:
        """Return one of the allowed values, or of those that the option lists.

        Values that an option lists have equal odds unless it gives weights; `share` in [0, 1) selects the value.
        """
        if name not in options:
            return pick(allowed, odds, share)
        if isinstance(options[name], Mapping):
            return pick(*self.weighted(f"option {name}", options[name], allowed, {}), share)
        found = self.some_of(f"option {name}", options[name], allowed)
        return found[min(int(share * len(found)), len(found) - 1)]


def pick(values: Sequence[T], odds: Sequence[float], share: float) -> T:
    """Return one of the values by their odds; the random number `share` in [0, 1) selects it."""
    edges = np.cumsum(odds) / float(np.sum(odds))
    return values[min(int(np.searchsorted(edges, share, side="right")), len(values) - 1)]


@dataclass(frozen=True)
class Number:
    """A number that each individual draws evenly from a range.

    Attributes:
        drawn: Range to draw from unless an option sets another.
        allowed: Range that options and parameters may use.
        log: Whether the logarithm is drawn evenly instead of the number; used for sizes.
        by: Name of a choice that is drawn before and sets the range; empty for none.
        ranges: Range to draw from for each value of this choice; `drawn` then covers them all.
    """

    drawn: Range
    allowed: Range
    log: bool = False
    by: str = ""
    ranges: Mapping[str, Range] = field(default_factory=dict)


@dataclass(frozen=True)
class Choice:
    """One of several values, drawn by their odds.

    Attributes:
        values: All values.
        odds: Odds of each value, same order.
        note: Remark for the list of options.
    """

    values: tuple[Any, ...]
    odds: tuple[float, ...]
    note: str = ""


@dataclass(frozen=True)
class Dials:
    """The parameters of a model.

    Attributes:
        model: Name of the model, for error messages.
        table: Name -> number or choice, in the order in which they are drawn.
    """

    model: str
    table: Mapping[str, Number | Choice]

    def sample(self, rng: np.random.Generator, options: Params) -> dict[str, Any]:
        """Draw one individual, JSON values only.

        Every call takes the same number of values from `rng`, so setting one option does not change the values of the
        others.

        Raises:
            ModelError: An option is unknown or its value is invalid.
        """
        checks = Checks(self.model)
        checks.known("option", options, tuple(self.table))
        params: dict[str, Any] = {}
        for name, dial in self.table.items():
            share = float(rng.random())
            if isinstance(dial, Choice):
                params[name] = checks.choose(name, options, dial.values, dial.odds, share)
                continue
            low, high = dial.ranges[params[dial.by]] if dial.by else dial.drawn
            if name in options:
                low, high = checks.number_range(f"option {name}", options[name], *dial.allowed)
            value = low * (high / low) ** share if dial.log else low + (high - low) * share
            params[name] = float(min(max(value, low), high))
        return params

    def require(self, params: Params) -> None:
        """Check the parameters of an individual.

        Raises:
            ModelError: A parameter is missing, unknown or out of range.
        """
        checks = Checks(self.model)
        checks.known("parameter", params, tuple(self.table))
        checks.complete(params, tuple(self.table))
        for name, dial in self.table.items():
            if isinstance(dial, Choice):
                checks.one_of(f"parameter {name}", params[name], dial.values)
            else:
                checks.number(f"parameter {name}", params[name], *dial.allowed)

    @property
    def options(self) -> dict[str, str]:
        """Options that a recipe may set, each with its values in words."""
        text = {}
        for name, dial in self.table.items():
            if isinstance(dial, Choice):
                values = ", ".join(str(v).lower() if isinstance(v, bool) else str(v) for v in dial.values)
                text[name] = f"one of {values}, a list of several, or each with its weight"
                text[name] += f"; {dial.note}" if dial.note else ""
            else:
                low, high = dial.drawn
                text[name] = f"a number or [low, high]; by default [{low:g}, {high:g}]"
                text[name] += f", by {dial.by}" if dial.by else ""
        return text
