"""Which file of a folder is the detector, or has its detections."""

from __future__ import annotations

from pathlib import Path

from infrablend.core.workspace import unfinished
from infrablend.detection.detections import PREDICTIONS
from infrablend.detection.scale import ONNX_WEIGHTS, WEIGHTS
from infrablend.errors import ModelError, Problem


def file_of(path: Path) -> Path:
    """Return the file to use from a folder: detections of an evaluation, or weights of a training.

    Raises:
        ModelError: The folder is neither, or its training is not finished.
    """
    if not path.is_dir() and (path.exists() or unfinished(path) is None):
        return path
    for file in (PREDICTIONS, WEIGHTS, ONNX_WEIGHTS):
        if (path / file).is_file():
            return path / file
    found = unfinished(path)
    todo = ""
    if found is None:
        found = f"a folder with neither {PREDICTIONS} nor {WEIGHTS}"
        todo = f"give {WEIGHTS} of a finished `infrablend train`, or {PREDICTIONS} of an earlier evaluation"
    problem = Problem(str(path), "weights", found, f"weights (.pt), or {PREDICTIONS}", todo)
    raise ModelError(f"{path}: nothing to evaluate", [problem])
