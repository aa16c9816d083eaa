"""Parameters of a model as a table: which numbers and choices it has, how they are drawn, and their checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from infrablend.assets.model import Params
from infrablend.assets.params import Checks, Range


@dataclass(frozen=True)
class Number:
    """A number that each individual draws evenly from a range.

    Attributes:
        drawn: Range to draw from unless an option sets another.
        allowed: Range that options and parameters may use.
        log: Whether the logarithm is drawn evenly instead of the number; used for sizes.
    """

    drawn: Range
    allowed: Range
    log: bool = False


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
            low, high = dial.drawn
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
                text[name] = f"one of {values}, or a list of several" + (f"; {dial.note}" if dial.note else "")
            else:
                low, high = dial.drawn
                text[name] = f"a number or [low, high]; by default [{low:g}, {high:g}]"
        return text
