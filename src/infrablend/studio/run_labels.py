"""Labels of a run's frames, from the tables that the run wrote, and where a detector disagrees with them.

An evaluation keeps its detections; they are matched here with the labels of the run by class, at its confidence and an
overlap of one half, so that objects that it missed and false detections can be listed. Its figures are not computed
again.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import box_iou
from infrablend.core.dataset import SPLITS, finite, known_class
from infrablend.core.files import read_regular
from infrablend.core.run_folder import PICTURE_TABLES, RunFolder
from infrablend.detection.detections import PREDICTIONS, RECORD, read_predictions
from infrablend.errors import DatasetError

Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class RunLabel:
    """A label of a frame; its box is in pixels, and `ignore` marks a region to ignore.

    `track` is the id of its track; empty without one.
    """

    category: str
    box_xyxy: Box
    inserted: bool = False
    ignore: bool = False
    track: str = ""


@dataclass(frozen=True)
class Place:
    """Where a frame is in its sequence, `<split>/<name>`: its number there, and its time."""

    sequence: str
    frame: int
    time_s: float | None


_Found = tuple[tuple[RunLabel, ...], Place | None]


class RunLabels:
    """The labels of all frames of a run, read when they are first asked for."""

    def __init__(self, layout: RunFolder) -> None:
        self._layout = layout
        self._lock = threading.Lock()
        self._found: dict[str, _Found] | None = None

    def of(self, image: str) -> tuple[RunLabel, ...]:
        """Return the labels of an image, a path below `images/`."""
        return self._get(image)[0]

    def place(self, image: str) -> Place | None:
        """Return where an image is in its sequence; None if it is in none."""
        return self._get(image)[1]

    def _get(self, image: str) -> _Found:
        with self._lock:
            if self._found is None:
                self._found = dict(_from_tables(self._layout))
        return self._found.get(image, ((), None))


def _from_tables(layout: RunFolder) -> Iterator[tuple[str, _Found]]:
    for split, name in zip(SPLITS, PICTURE_TABLES, strict=True):
        try:
            lines = read_regular(layout.root / name, layout.root).splitlines()
        except (OSError, ValueError):
            continue
        for line in lines:
            try:
                row = json.loads(line)
                objects = row["objects"]
                inserted = objects["inserted"]
                ignore = objects.get("ignore", [False] * len(inserted))
                tracks = objects.get("track_id", [""] * len(inserted))
                columns = zip(objects["bbox"], objects["category"], inserted, ignore, tracks, strict=True)
                labels = tuple(_label(*values) for values in columns)
                yield f"{split}/{row['file_name']}", (labels, _place(split, row))
            except (ValueError, LookupError, TypeError):
                continue


def _place(split: str, row: Mapping[str, Any]) -> Place | None:
    if not row.get("sequence"):
        return None
    time_s = row.get("time_s")
    return Place(f"{split}/{row['sequence']}", int(row.get("frame") or 0), None if time_s is None else float(time_s))


def _label(bbox: Any, category: Any, inserted: Any, ignore: Any, track: Any = "") -> RunLabel:
    x, y, w, h = (float(v) for v in finite(bbox))
    return RunLabel(str(category), (x, y, x + w, y + h), bool(inserted), bool(ignore), str(track))


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
