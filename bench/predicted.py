"""Detections of one class in the predictions of `infrablend evaluate`, for the measurements that read them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from infrablend.evaluation.detections import Detections, read_predictions


def predicted(evaluation: Path, category: str) -> dict[str, Detections]:
    """Return the detections of a class, the surest first, by `<split>/<name>` of the picture."""
    predictions = read_predictions(evaluation / "predictions.json")
    number = predictions.classes.index(category)
    return {key: of.take(np.flatnonzero(of.classes == number)) for key, of in predictions.images.items()}
