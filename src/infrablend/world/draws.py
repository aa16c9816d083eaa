"""Random draws from one generator, in plain Python numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

T = TypeVar("T")


class Draws:
    """Draws from a random generator; the order of the calls fixes the scene."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Draw from `rng`, usually the frame's own stream."""
        self._rng = rng

    def uniform(self, low: float, high: float) -> float:
        """Return a number from [low, high)."""
        return float(self._rng.uniform(low, high))

    def normal(self, mean: float, deviation: float) -> float:
        """Return a normally distributed number."""
        return float(self._rng.normal(mean, deviation))

    def share(self) -> float:
        """Return a number from [0, 1)."""
        return float(self._rng.random())

    def chance(self, probability: float) -> bool:
        """Return True with a given probability."""
        return bool(self._rng.random() < probability)

    def integer(self, low: int, high: int | None = None) -> int:
        """Return a whole number from [low, high), or from [0, low) if `high` is None."""
        return int(self._rng.integers(low, high))

    def one_of(self, options: Sequence[T]) -> T:
        """Return one of the options, all equally likely."""
        return options[int(self._rng.integers(len(options)))]
