"""Where a detector disagrees with the labels of a run's frames: objects that it missed, and false detections.

An evaluation keeps its detections; they are matched here with the labels of the run by class, at its confidence and an
overlap of one half, so that single frames can be listed. Its figures are not computed again.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import box_iou
from infrablend.core.dataset import known_class
from infrablend.core.files import read_regular
from infrablend.detection.detections import PREDICTIONS, RECORD, read_predictions
from infrablend.errors import DatasetError
from infrablend.studio.run_labels import Box, RunLabel, RunLabels

MIN_OVERLAP = 0.5


@dataclass(frozen=True)
class Disagreement:
    """Number of labelled objects that a detector missed in a frame, and of its detections without an object."""

    missed: int
    false: int

    @property
    def total(self) -> int:
        """Both together."""
        return self.missed + self.false


def read_disagreement(folder: Path, labels: RunLabels, images: Iterable[str]) -> dict[str, Disagreement]:
    """Return the disagreement of an evaluation's detector by image, for the images that it was evaluated on.

    Args:
        folder: Folder of the evaluation.
        labels: Labels of the run.
        images: Paths of the run's images below `images/`.

    Raises:
        DatasetError: The folder is not that of an evaluation.
    """
    try:
        record = json.loads(read_regular(folder / RECORD, folder))
        confidence = float(record["confidence"])
        classes = {_class(str(name)) for name in record["classes"]}
        read_regular(folder / PREDICTIONS, folder)  # not through a link out of the folder
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise DatasetError(
            f"{folder}: not an evaluation ({error}); expected {RECORD} and {PREDICTIONS}, as `infrablend evaluate` "
            "writes them"
        ) from error
    predictions = read_predictions(folder / PREDICTIONS)
    names = [_class(name) for name in predictions.classes]
    found = {}
    for image in images:
        if (seen := predictions.images.get(image)) is not None:
            sure = [
                (names[int(k)], box.tolist())
                for k, box, score in zip(seen.classes, seen.boxes_xyxy, seen.scores, strict=True)
                if score >= confidence and names[int(k)] in classes
            ]
            known = [label for label in labels.of(image) if label.ignore or _class(label.category) in classes]
            found[image] = compare(sure, known)
    return found


def compare(detections: Sequence[tuple[str, Box]], labels: Sequence[RunLabel]) -> Disagreement:
    """Return what differs between detections, highest score first, and the labels of an image.

    A detection whose centre is in a region to ignore is not false.
    """
    objects = [label for label in labels if not label.ignore]
    free = set(range(len(objects)))
    false = 0
    shared = box_iou(_array([box for _, box in detections]), _array([o.box_xyxy for o in objects]))
    for (name, box), overlap in zip(detections, shared, strict=True):
        near = [n for n in free if _class(objects[n].category) == name]
        best = max(near, key=overlap.__getitem__, default=None)
        if best is not None and overlap[best] >= MIN_OVERLAP:
            free.discard(best)
        elif not any(label.ignore and _has_centre(label.box_xyxy, box) for label in labels):
            false += 1
    return Disagreement(len(free), false)


def _class(name: str) -> str:
    return known_class(name) or name.casefold()


def _array(boxes_xyxy: Sequence[Box]) -> NDArray[np.float64]:
    return np.array(boxes_xyxy, np.float64).reshape(-1, 4)


def _has_centre(region: Box, box: Box) -> bool:
    x, y = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
    return region[0] <= x <= region[2] and region[1] <= y <= region[3]
