"""Detections that `detect` wrote, the verdicts on them, and the labelled dataset that accepted ones become."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.core.files import read_object
from infrablend.core.workspace import DETECT_FILE
from infrablend.detection.detections import PREDICTIONS, Predictions, read_predictions
from infrablend.detection.truth import image_key
from infrablend.errors import DatasetError, Problem
from infrablend.formats.dataset_folder import read
from infrablend.formats.read_write import Reading
from infrablend.pipeline.runs.review_file import REVIEW_FILE, Verdict, read_verdicts


@dataclass(frozen=True, eq=False)
class StoredDetection:
    """A detection to judge.

    Attributes:
        id: Id in the review: `<split>/<name>#<number>`.
        image: Its picture.
        number: Its number among the detections of its picture, from 0.
        category: Class that the detector gave it.
        score: Its score.
        box_xyxy: Left, top, right and bottom edge, px.
    """

    id: str
    image: ImageRecord
    number: int
    category: str
    score: float
    box_xyxy: tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class StoredDetections:
    """The folder of a finished `detect`.

    Attributes:
        folder: The folder.
        dataset: The pictures that were searched.
        predictions: All detections.
        objects: Those from the confidence of `detect` on, highest score first.
    """

    folder: Path
    dataset: Dataset
    predictions: Predictions
    objects: tuple[StoredDetection, ...]

    @property
    def review_file(self) -> Path:
        """Path of the verdicts."""
        return self.folder / REVIEW_FILE


def is_detections(folder: Path) -> bool:
    """Return whether a folder is one that `detect` wrote."""
    return (folder / DETECT_FILE).is_file() and (folder / PREDICTIONS).is_file()


def open_detections(folder: Path) -> StoredDetections:
    """Return what `detect` wrote, with its pictures, read again as they were for the search.

    Raises:
        DatasetError: The folder is none of `detect`, has nothing to judge, or its pictures are gone.
    """
    record: Mapping[str, Any] = read_object(folder / DETECT_FILE) or {}
    try:
        reading = Reading(**record["reading"])
        data, confidence = Path(record["data"]), float(record["confidence"])
    except (KeyError, TypeError, ValueError) as error:
        expected = "the folder that `infrablend detect` wrote"
        problem = Problem(str(folder), "detections", f"no {DETECT_FILE} that can be read", expected)
        raise DatasetError(f"{folder}: no detections", [problem]) from error
    if not data.exists():
        todo = f"search them where they are now: infrablend detect {folder} DATA --out DIR"
        problem = Problem(str(data), "data-missing", "the pictures are not there any more", "those searched", todo)
        raise DatasetError(f"{folder}: no pictures", [problem])
    dataset = read(data, reading)
    predictions = read_predictions(folder / PREDICTIONS)
    found = []
    for image in dataset.images:
        key = image_key(image)
        d = predictions.images.get(key)
        for k in range(0 if d is None else len(d)):
            assert d is not None
            x0, y0, x1, y1 = d.boxes_xyxy[k].tolist()
            name = predictions.classes[int(d.classes[k])]
            found.append(StoredDetection(f"{key}#{k}", image, k, name, float(d.scores[k]), (x0, y0, x1, y1)))
    objects = sorted((o for o in found if o.score >= confidence), key=lambda o: -o.score)
    if not objects:
        raise DatasetError(f"{folder}: no detection has a score of {confidence:g}; search with a lower --confidence")
    return StoredDetections(folder, dataset, predictions, tuple(objects))


def accepted_objects(folder: Path) -> Dataset:
    """Return the pictures of which all detections have a verdict, labelled with those that were accepted.

    Other pictures would teach a detector that objects which nobody has judged are background; they are counted.

    Raises:
        DatasetError: The folder is none of `detect`, or no picture is judged to the end.
        OutputError: The review cannot be read.
    """
    stored = open_detections(folder)
    verdicts = read_verdicts(stored.review_file) if stored.review_file.exists() else {}
    of: dict[str, list[tuple[StoredDetection, Verdict | None]]] = {}
    for o in stored.objects:
        of.setdefault(image_key(o.image), []).append((o, verdicts.get(o.id)))
    done = {key for key, judged in of.items() if all(verdict for _, verdict in judged)}
    images = []
    for image in stored.dataset.images:
        key = image_key(image)
        if key in done:
            accepted = [(o, v) for o, v in of[key] if v is not None and v.word == "accept"]
            instances = tuple(_instance(stored.predictions, o, v.category or o.category) for o, v in accepted)
            images.append(replace(image, instances=instances, source_id=None, extra={}))
    if not images:
        found = f"{sum(v is not None for judged in of.values() for _, v in judged)} of {len(stored.objects)} judged"
        todo = f"judge every detection of some pictures: infrablend studio --detections {folder}"
        problem = Problem(folder.name, "review-open", found, "a picture whose detections all are", todo)
        raise DatasetError(f"{folder}: no picture is judged to the end", [problem])
    used = Counter(i.category for image in images for i in image.instances)
    names = dict.fromkeys([*stored.predictions.classes, *sorted(used)])
    categories = tuple(Category(k, name) for k, name in enumerate(names, 1))
    open_ = len(of) - len(done)
    nothing = len(stored.dataset.images) - len(of)
    remarks = [
        Problem(folder.name, "review-left-out", f"{n} pictures {why}, left out", severity="warning")
        for n, why in ((open_, "with detections that nobody has judged"), (nothing, "without a detection to judge"))
        if n
    ]
    return Dataset(stored.dataset.root, "coco", categories, tuple(images), tuple(remarks))


def _instance(predictions: Predictions, found: StoredDetection, category: str) -> Instance:
    of = predictions.images[image_key(found.image)]
    return Instance(
        category,
        np.array(found.box_xyxy, np.float64),
        None if of.corners_xy is None else of.corners_xy[found.number],
        None if of.masks is None else of.masks[found.number],
    )
