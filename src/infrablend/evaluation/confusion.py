"""Confusion matrix: detections and labels matched regardless of class."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from infrablend.evaluation.detections import Detections, Task
from infrablend.evaluation.overlap import overlaps
from infrablend.evaluation.truth import Truth

IOU = 0.5


def confusion_matrix(
    truths: Sequence[Truth],
    found: Mapping[str, Detections],
    class_of: NDArray[np.int64],
    classes: int,
    task: Task,
    confidence: float,
) -> NDArray[np.int64]:
    """Return (classes + 1, classes + 1) counts by detected class (row) and labelled class (column); last is background.

    Detections with at least the given confidence are matched in the order of their score, each to the unmatched label
    with the largest IoU of at least 0.5. Unmatched detections in regions to ignore are left out, in crowds those of the
    crowd's class.
    """
    matrix = np.zeros((classes + 1, classes + 1), np.int64)
    for truth in truths:
        ours = found.get(truth.key)
        free = ~truth.ignore
        if ours is not None:
            ours = ours.take(np.flatnonzero((ours.scores >= confidence) & (class_of[ours.classes] >= 0)))
            overlap, regions = overlaps(ours, truth, task), truth.regions_of(class_of[ours.classes])
            for d, c in enumerate(class_of[ours.classes]):
                value = np.where(free, overlap[d], 0.0)
                if value.max(initial=0.0) >= IOU:
                    label = int(value.argmax())
                    matrix[c, truth.classes[label]] += 1
                    free[label] = False
                elif not (overlap[d, regions[d]] >= IOU).any():
                    matrix[c, classes] += 1
        for c in truth.classes[free]:
            matrix[classes, c] += 1
    return matrix
