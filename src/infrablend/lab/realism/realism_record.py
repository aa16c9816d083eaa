"""The shape of `realism.json`: what a comparison writes of each class, and what its pages and the studio read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, NotRequired, TypedDict

Quantiles = Mapping[str, float]
"""`p1` to `p95` -> value; empty without objects."""
Side = Literal["real", "inserted"]
Level = Literal["high", "middle"]
Quantity = Literal["signed", "change", "ground_level", "ground_clutter"]
Score = Literal["auc_boosting", "floor_logistic", "floor_boosting", "hard_paste_logistic", "chain_off_logistic"]


class SlopeFigures(TypedDict):
    """Slope of the objects' level over that of their rings, within images."""

    slope: float
    ci: Sequence[float]
    objects: int
    images: int


class ContrastFigures(TypedDict):
    """Quantiles of the contrast of one population, 8-bit levels, and both slopes, None with too few objects."""

    n: int
    images: int
    signed: Quantiles
    change: Quantiles
    high_minus_ring: Quantiles
    low_minus_ring: Quantiles
    ground_level: Quantiles
    ground_clutter: Quantiles
    scr: Quantiles
    slope: Mapping[Level, SlopeFigures | None]


class ContrastCheck(TypedDict):
    """A limit on inserted objects: their difference from the real ones, or the ratio; no verdict with too few."""

    real: float
    inserted: float
    found: float | None
    ci: NotRequired[Sequence[float]]
    limit: float | Sequence[float]
    holds: bool | None


class ContrastSides(TypedDict):
    """The contrast of both populations at one time of day."""

    real: ContrastFigures
    inserted: ContrastFigures
    checks: Mapping[str, ContrastCheck]
    run: NotRequired[ComparedRun]


Contrasts = Mapping[str, ContrastSides]
"""Time of day -> contrast."""


class BoxFactor(TypedDict):
    """Factor from the visible extent of objects to their boxes, and the margin beyond it, px."""

    n: int
    factor: float
    ci: Sequence[float]
    margin_px: float


class ComparedRun(TypedDict):
    """What was compared."""

    recipe: str
    seed: int
    frames: int
    backgrounds: str
    splits: Sequence[str]
    real: str
    real_splits: Sequence[str]


class ClassScores(TypedDict):
    """The figures of the classifiers on one class; None where there are too few objects."""

    n: int
    auc_logistic: float | None
    ci: Sequence[float] | None
    auc_boosting: float | None
    floor_logistic: NotRequired[float | None]
    floor_boosting: NotRequired[float | None]
    hard_paste_logistic: NotRequired[float | None]
    chain_off_logistic: NotRequired[float | None]


class ComparedClass(ClassScores):
    """The figures of one class that pages show."""

    valid: bool
    invalid_because: Sequence[str]
    box_looseness: Mapping[str, BoxFactor | None]
    contrast: Contrasts
    contrast_as_written: NotRequired[Contrasts]


class TimedClass(ComparedClass):
    """The figures of one class at one time of day, and the run that they are of."""

    run: ComparedRun


class CollectedClass(ComparedClass):
    """The figures of one class from several comparisons: those of the first time of day, and of each."""

    time_of_day: str
    by_time: Mapping[str, TimedClass]
