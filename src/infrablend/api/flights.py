"""Answers about a flight: what a detector finds in its pictures, and how likely it finds what is there."""

from __future__ import annotations

from pathlib import Path

from infrablend.api.datasets import read_dataset
from infrablend.core.output_checks import require_apart
from infrablend.core.tasks import OnProgress
from infrablend.formats.dataset_folder import with_every_frame
from infrablend.formats.read_write import READ_ALL, Reading
from infrablend.pipeline.flights.detect import DetectReport, detect_objects
from infrablend.pipeline.flights.detect_request import DEFAULT_DETECT, DetectRequest
from infrablend.pipeline.flights.detectability import (
    DetectabilityPlan,
    DetectabilityReport,
    measure_detectability,
)
from infrablend.pipeline.flights.detectability import plan_detectability as plan_request
from infrablend.pipeline.flights.detectability_request import DetectabilityRequest
from infrablend.pipeline.flights.place_settings import DEFAULT_PLACES, PlaceSettings


def detect(
    detector: str | Path,
    data: str | Path,
    out: str | Path,
    request: DetectRequest = DEFAULT_DETECT,
    places: PlaceSettings = DEFAULT_PLACES,
    *,
    reading: Reading = READ_ALL,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> DetectReport:
    """Find objects in the pictures of a dataset, a folder off the card or a video; write detections and a table.

    `detector` is an ONNX file, which needs `infrablend[onnx]`; weights of Ultralytics (.pt) or the folder of `train`,
    which need `infrablend[train]`; or detections in COCO, such as the predictions.json of an earlier call. Where
    pictures state their position, height, angles and lens, detections get a place each, and maps are written.
    """
    if request.tracks:
        reading = with_every_frame(reading, Path(data))
    dataset = read_dataset(data, reading)
    return detect_objects(
        Path(detector), dataset, Path(out), request, places,
        reading=reading, overwrite=overwrite, on_progress=on_progress,
    )  # fmt: skip


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
