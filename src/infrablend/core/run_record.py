"""The record of a run, as `run.json` and the ledger have it: docs/reference/run_folder.md describes each field."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypedDict


class DataFacts(TypedDict):
    """The backgrounds of a run: their folder or address, its format, and what its reader noted."""

    root: str
    format: str
    backgrounds: int
    notes: Mapping[str, object]


class CategoryFacts(TypedDict):
    """A class of a run's labels; `new` where the recipe adds it."""

    id: int
    name: str
    new: bool
    ignore: bool


class DrawStatistics(TypedDict, total=False):
    """How the scenes of a run were drawn; empty where none had objects.

    `distance_m` has the spread at the `first_draw` and of the scenes that were `kept`; the other spreads are of these.
    """

    scenes: int
    wanted: int
    attempts_total: int
    attempts_max: int
    rejected: Mapping[str, int]
    absent: Mapping[str, int]
    distance_m: Mapping[str, Mapping[str, float]]
    pitch_deg: Mapping[str, float]
    size_px: Mapping[str, float]
    too_small_px: float


class RunTiming(TypedDict, total=False):
    """Times of the last call, which differ between equal runs."""

    seconds: float
    frames_seconds: float
    labels_seconds: float
    resumed_frames: int
    worker_seconds: Mapping[str, float]
    peak_worker_rss_mb: float


class RunRecord(TypedDict, total=False):
    """The record of a run; the fields from `counts` on are there once its frames are made."""

    infrablend: str
    recipe: Mapping[str, Any]
    formats: Sequence[str]
    seed: int
    run: str
    key: Mapping[str, object]
    data: DataFacts
    request: Mapping[str, Any]
    shard: str
    boxes: str
    categories: Sequence[CategoryFacts]
    frames: int
    machine: Mapping[str, Any]
    packages: Mapping[str, str]
    levels: Sequence[float]
    command: Mapping[str, object]
    counts: Mapping[str, Any]
    draws: DrawStatistics
    removed: Sequence[Mapping[str, object]]
    losses: Mapping[str, int]
    problems: Sequence[Mapping[str, Any]]
    timing: RunTiming
