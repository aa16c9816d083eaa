"""Answers about a flight: what a detector finds in its pictures."""

from __future__ import annotations

from pathlib import Path

from infrablend.api.datasets import read_dataset
from infrablend.core.tasks import OnProgress
from infrablend.formats.read_write import READ_ALL, Reading
from infrablend.pipeline.flights.detect import DetectReport, detect_objects
from infrablend.pipeline.flights.detect_request import DEFAULT_DETECT, DetectRequest


def detect(
    detector: str | Path,
    data: str | Path,
    out: str | Path,
    request: DetectRequest = DEFAULT_DETECT,
    *,
    reading: Reading = READ_ALL,
    overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> DetectReport:
    """Find objects in the pictures of a dataset, a folder off the card or a video; write detections and a table.

    `detector` is an ONNX file, which needs `infrablend[onnx]`; weights of Ultralytics (.pt) or the folder of `train`,
    which need `infrablend[train]`; or detections in COCO, such as the predictions.json of an earlier call.
    """
    dataset = read_dataset(data, reading)
    return detect_objects(Path(detector), dataset, Path(out), request, overwrite=overwrite, on_progress=on_progress)
