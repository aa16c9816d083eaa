"""The shape of `realism.json`; docs/how_to/measure_realism.md explains the figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, NotRequired, TypedDict

from infrablend.annotation.measured_looseness import BoxFigures, FiguresAgainst
from infrablend.compositing.object_contrast import SlopeFigures

Medians = Mapping[str, float | None]
"""Median of each feature and measure of some objects; None without any."""
Interval = Sequence[float]
"""The two ends of a 95 % interval."""
Side = Literal["real", "inserted"]
Quantity = Literal["signed", "change", "ground_level", "ground_clutter"]
ScoreName = Literal["auc_boosting", "floor_logistic", "floor_boosting", "hard_paste_logistic", "chain_off_logistic"]


class Validity(TypedDict):
    """Whether a class's figures are valid, and the reasons if they are not."""

    valid: bool
    invalid_because: Sequence[str]


class FloorScores(TypedDict):
    """AUCs of untouched objects against the real control; None with too few pairs."""

    floor_n: int
    floor_logistic: float | None
    floor_boosting: float | None
    floor_ci: Interval | None
    floor_boosting_ci: NotRequired[Interval | None]


class StepScores(TypedDict):
    """AUCs of real objects against inserted ones that are measured without a step of the sensor chain."""

    n: int
    auc_logistic: float | None
    auc_boosting: float | None
    ci: Interval | None
    medians: Medians


class BoxMeasures(TypedDict):
    """Contrasts and levels of objects of all sizes; contrasts are quantiles at 5, 25, 50, 75 and 95 %."""

    p95_minus_ring: Sequence[float] | None
    centre_minus_ring: Sequence[float] | None
    share_pixels_above_245: float | None
    level_histogram: Sequence[int]
    flaws: Mapping[str, int]


class SeparatingFeature(TypedDict):
    """How well a feature alone separates the populations, its quartiles, and its weight in the classifier."""

    feature: str
    auc: float
    inserted_is: str
    real: Sequence[float]
    inserted: Sequence[float]
    weight: float


class CropScores(TypedDict, total=False):
    """AUCs of the small network on crops, or why there are none."""

    skipped: str
    auc: float
    ci: Interval | None
    floor: float
    floor_ci: Interval | None


class FeatureDistance(TypedDict, total=False):
    """Mean and standard deviation of the MMD of inserted from real crops, and of two halves of the real ones."""

    skipped: str
    inserted: Sequence[float]
    real_halves: Sequence[float]


class ContrastCheck(TypedDict):
    """Whether inserted objects are within a limit set by real ones; None with too few objects."""

    real: float
    inserted: float
    found: float | None
    ci: NotRequired[Interval]
    limit: float | Sequence[float]
    holds: bool | None


class ContrastFigures(TypedDict):
    """Quantiles of the contrast of some objects, and slopes of their levels over the ground's."""

    n: int
    images: int
    signed: Mapping[str, float]
    change: Mapping[str, float]
    high_minus_ring: Mapping[str, float]
    low_minus_ring: Mapping[str, float]
    ground_level: Mapping[str, float]
    ground_clutter: Mapping[str, float]
    scr: Mapping[str, float]
    slope: Mapping[str, SlopeFigures | None]


class TimeContrast(TypedDict):
    """The contrast of both populations at a time of day."""

    real: ContrastFigures
    inserted: ContrastFigures
    checks: Mapping[str, ContrastCheck]
    run: NotRequired[ComparedRun]


class ClassFacts(FloorScores):
    """The comparison of a class; what is not required follows from all classes together."""

    n: int
    n_real: int
    n_inserted: int
    auc_logistic: float | None
    auc_boosting: float | None
    auc_boosting_ci: Interval | None
    ci: Interval | None
    hard_paste_n: int
    hard_paste_logistic: float | None
    hard_paste_boosting: float | None
    hard_paste_ci: Interval | None
    hard_paste_boosting_ci: Interval | None
    chain_off_logistic: NotRequired[float | None]
    chain_off_boosting: NotRequired[float | None]
    medians: Mapping[str, Medians]
    all_sizes: Mapping[str, BoxMeasures]
    size_by_altitude: Mapping[str, Mapping[str, float | None]]
    separating_features: Sequence[SeparatingFeature]
    cnn: CropScores
    mmd_dct: FeatureDistance
    kid: FeatureDistance
    valid: NotRequired[bool]
    invalid_because: NotRequired[Sequence[str]]
    contrast: NotRequired[Mapping[str, TimeContrast]]
    contrast_as_written: NotRequired[Mapping[str, TimeContrast]]
    box_looseness: NotRequired[Mapping[str, BoxFigures | FiguresAgainst | None]]
    left_out: NotRequired[Mapping[str, Mapping[str, int]]]


class ComparedRun(TypedDict):
    """The run that was compared, and the splits of both sides."""

    seed: int
    recipe: str
    frames: int
    backgrounds: str
    splits: Sequence[str]
    real: str
    real_splits: Sequence[str]


class RealismRecord(TypedDict):
    """Content of `realism.json`."""

    version: int
    time_of_day: str
    most_pairs: int
    run: ComparedRun
    unreadable: Sequence[str]
    person_floor: FloorScores
    classes: Mapping[str, ClassFacts]
    ablation: Mapping[str, Mapping[str, StepScores]]
    car_to_person_contrast: NotRequired[Mapping[str, float | None]]


class TimedFacts(ClassFacts):
    """The figures of one class at one time of day, and the run that they are of."""

    run: ComparedRun


class CollectedClass(ClassFacts):
    """The figures of one class from several comparisons: those of the first time of day, and of each."""

    time_of_day: str
    by_time: Mapping[str, TimedFacts]
