"""Flights: how likely a detector finds objects in the user's own pictures."""

from __future__ import annotations

from pathlib import Path

from infrablend.core.output_checks import require_apart
from infrablend.core.tasks import OnProgress
from infrablend.pipeline.flights.detectability import (
    DetectabilityPlan,
    DetectabilityReport,
    DetectabilityRequest,
    measure_detectability,
)
from infrablend.pipeline.flights.detectability import plan_detectability as plan_request


def detectability(
    request: DetectabilityRequest,
    out: str | Path,
    *,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> DetectabilityReport:
    """Insert a recipe's objects into pictures in memory, let a detector search them, and write how many it finds."""
    require_apart(request.data, Path(out))
    return measure_detectability(request, Path(out), overwrite=overwrite, on_progress=on_progress)


def plan_detectability(request: DetectabilityRequest) -> DetectabilityPlan:
    """Return how many frames and how much time `detectability` would take, from a few frames."""
    return plan_request(request)
