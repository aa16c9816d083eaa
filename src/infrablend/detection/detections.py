"""A detector's detections on the images of a split, and the file that holds them.

The file is COCO JSON with a `score` in every annotation, so that other tools can read it, and files of other tools can
be evaluated:

    {"task": "detect", "categories": [{"id", "name"}], "images": [{"id", "file_name", "width", "height"}],
     "annotations": [{"image_id", "category_id", "bbox": [x, y, w, h], "score", "corners"?, "segmentation"?}],
     "facts": {...}}

`file_name` is `<split>/<name>`; `corners` are the eight coordinates of an oriented box, clockwise; `segmentation` holds
run lengths. Numbers are rounded (1e-3 px, 1e-6 for scores) before anything is computed, so that evaluating the file
gives the figures of the original run. A list of annotations alone, COCO's file of results, refers to the dataset's ids.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import MANY_PX, are_shares, box_of_points, clockwise
from infrablend.core.dataset import Category, ImageRecord
from infrablend.core.files import finite, write_json
from infrablend.core.rle_masks import Mask
from infrablend.errors import DatasetError, Problem
from infrablend.formats.values import to_key

Task = Literal["detect", "obb", "segment"]
TASKS: tuple[Task, ...] = ("detect", "obb", "segment")

FloatArray = NDArray[np.float64]
_SHOWN = 20
_OTHER_INPUT = "give the predictions.json of an earlier evaluation, or weights.pt of a finished `infrablend train`"

RECORD = "evaluation.json"
MATCHES = "matches.npz"
PREDICTIONS = "predictions.json"
MAX_DETECTIONS = 300
"""Names of the files of a stored evaluation."""


@dataclass(frozen=True, eq=False)
class Detections:
    """Detections in one image, highest score first.

    Attributes:
        boxes_xyxy: (n, 4) boxes in px of the stored image; for oriented boxes, their bounding boxes.
        scores: (n,) scores in [0, 1], in descending order.
        classes: (n,) int64 indices into the detector's classes.
        corners_xy: (n, 4, 2) corners of oriented boxes, clockwise, or None.
        masks: n masks, or None.
    """

    boxes_xyxy: FloatArray
    scores: FloatArray
    classes: NDArray[np.int64]
    corners_xy: FloatArray | None = None
    masks: tuple[Mask, ...] | None = None

    def __len__(self) -> int:
        return len(self.scores)

    def take(self, which: NDArray[np.int64]) -> Detections:
        """Return the detections with the given indices, in that order."""
        return Detections(
            self.boxes_xyxy[which],
            self.scores[which],
            self.classes[which],
            None if self.corners_xy is None else self.corners_xy[which],
            None if self.masks is None else tuple(self.masks[int(k)] for k in which),
        )


def detections(
    boxes_xyxy: Any, scores: Any, classes: Any, corners_xy: Any = None, masks: Sequence[Mask] | None = None
) -> Detections:
    """Return `Detections` from array-likes in any order: rounded, by descending score, equal scores as given."""
    score = np.round(np.asarray(scores, np.float64).reshape(-1), 6)
    if corners_xy is not None:
        corners_xy = [clockwise(c) for c in np.asarray(corners_xy, np.float64).reshape(-1, 4, 2)]
    unsorted = Detections(
        np.round(np.asarray(boxes_xyxy, np.float64).reshape(-1, 4), 3),
        score,
        np.asarray(classes, np.int64).reshape(-1),
        None if corners_xy is None else np.round(np.asarray(corners_xy, np.float64).reshape(-1, 4, 2), 3),
        None if masks is None else tuple(masks),
    )
    return unsorted.take(np.argsort(-score, kind="stable"))


@dataclass(frozen=True, eq=False)
class Predictions:
    """Detections on a set of images.

    Attributes:
        task: Output of the detector: boxes, oriented boxes or masks.
        classes: Names of the detector's classes, in its order.
        images: Detections by `<split>/<name>` of the image.
        sizes_wh: Sizes of the images in px, by the same keys.
        facts: Weights, image size and thresholds of the run.
    """

    task: Task
    classes: tuple[str, ...]
    images: Mapping[str, Detections]
    sizes_wh: Mapping[str, tuple[int, int]]
    facts: Mapping[str, object] = field(default_factory=dict)


def write_predictions(path: Path, predictions: Predictions) -> Path:
    """Write detections as a file; the same detections give the same bytes.

    Raises:
        OutputError: The file cannot be written.
    """
    images = []
    found = []
    for number, (key, one) in enumerate(sorted(predictions.images.items()), 1):
        width, height = predictions.sizes_wh[key]
        images.append({"id": number, "file_name": key, "width": width, "height": height})
        boxes = np.round(np.concatenate([one.boxes_xyxy[:, :2], one.boxes_xyxy[:, 2:] - one.boxes_xyxy[:, :2]], 1), 3)
        for k in range(len(one)):
            row: dict[str, object] = {
                "image_id": number,
                "category_id": int(one.classes[k]) + 1,
                "bbox": boxes[k].tolist(),
                "score": float(one.scores[k]),
            }
            if one.corners_xy is not None:
                row["corners"] = one.corners_xy[k].reshape(-1).tolist()
            if one.masks is not None:
                row["segmentation"] = one.masks[k].to_coco()
            found.append(row)
    return write_json(
        path,
        {
            "task": predictions.task,
            "categories": [{"id": k, "name": name} for k, name in enumerate(predictions.classes, 1)],
            "images": images,
            "annotations": found,
            "facts": dict(predictions.facts),
        },
        indent=None,
    )


def read_predictions(
    path: Path, images: Sequence[ImageRecord] = (), categories: Sequence[Category] = ()
) -> Predictions:
    """Return the detections that a file holds.

    Args:
        path: The file.
        images: Images to whose ids in the source a list of results refers.
        categories: Categories to whose ids it refers.

    Raises:
        DatasetError: The file is not a predictions file; `problems` lists the malformed entries.
    """
    data = _content(path)
    if isinstance(data, list):
        if not images or any(image.source_id is None or image.size_wh is None for image in images):
            found = "a list of results, whose image_id refers to ids that the dataset does not have"
            raise _refused(path, found, "labels in COCO with these ids, or a file with images and categories")
        data = _of_results(data, images, categories)
    if not isinstance(data, dict) or data.get("task", "detect") not in TASKS:
        raise _refused(path, "no task detect, obb or segment", "COCO JSON whose annotations have scores")
    task: Task = data.get("task", "detect")
    names = _table(data.get("categories"), "name")
    files = _table(data.get("images"), "file_name")
    rows = data.get("annotations")
    if not names or not files or not isinstance(rows, list):
        raise _refused(path, "no categories, images or annotations", "COCO JSON whose annotations have scores")
    sizes = {}
    for image in data["images"]:
        size = image.get("width"), image.get("height")
        if not all(type(v) is int and 0 < v < 2**16 for v in size):
            raise _refused(path, f"image {image['file_name']!r} of size {size}", "width and height in px")
        sizes[str(image["file_name"])] = (int(size[0]), int(size[1]))
    number = {key: k for k, key in enumerate(names)}
    gathered: dict[str, list[tuple[Any, ...]]] = {name: [] for name in files.values()}
    problems: list[Problem] = []
    for k, row in enumerate(rows):
        wrong = _row_fault(row, task, names, files)
        if wrong is None:
            key = files[to_key(row["image_id"])]
            try:
                mask = Mask.from_coco(row["segmentation"], sizes[key][::-1]) if task == "segment" else None
            except ValueError as error:
                wrong = f"a mask with {error}"
            else:
                class_ = number[to_key(row["category_id"])]
                gathered[key].append((_edges(row, mask), row["score"], class_, row.get("corners"), mask))
        if wrong is not None:
            problems.append(Problem(f"{path.name}, annotation {k}", "prediction", wrong, _EXPECTED[task]))
    if problems:
        raise DatasetError(f"{path}: {len(problems)} of {len(rows)} detections cannot be read", problems[:_SHOWN])
    boxes = np.array([row[0] for of in gathered.values() for row in of])
    if len(boxes) and boxes[:, :2].any() and are_shares(boxes).all() and min(map(min, sizes.values())) >= MANY_PX:
        edges = ", ".join(f"{v:.3g}" for v in boxes[0])
        found = f"all boxes within 0 to 2 px, such as {edges} (edges): shares of the picture"
        raise _refused(path, found, "boxes in px", "multiply them by each picture's width and height")
    facts = data.get("facts")
    return Predictions(
        task,
        tuple(names.values()),
        {key: _collect_detections(of, task) for key, of in gathered.items()},
        sizes,
        finite(facts, Counter()) if isinstance(facts, dict) else {},
    )


def _content(path: Path) -> Any:
    try:
        return json.loads(path.read_bytes())
    except OSError as error:
        raise _refused(path, f"cannot be read: {error.strerror or error}", "a file") from error
    except (ValueError, RecursionError) as error:
        raise _refused(path, f"not JSON: {error}"[:160], "JSON") from error


def _refused(path: Path, found: str, expected: str, todo: str = _OTHER_INPUT) -> DatasetError:
    return DatasetError(f"{path}: not a predictions file", [Problem(path.name, "predictions", found, expected, todo)])


_EXPECTED: Mapping[Task, str] = {
    "detect": "image_id, category_id, bbox of four numbers, score in [0, 1]",
    "obb": "image_id, category_id, corners of eight numbers, score in [0, 1]",
    "segment": "image_id, category_id, bbox of four numbers, segmentation of run lengths, score in [0, 1]",
}


def _of_results(rows: list[Any], images: Sequence[ImageRecord], categories: Sequence[Category]) -> dict[str, object]:
    """Return a list of COCO's results as the content of a file, with the images and categories that it refers to."""
    sized = [(i, i.size_wh) for i in images if i.size_wh is not None]
    return {
        "task": "segment" if all(isinstance(r, dict) and "segmentation" in r for r in rows) and rows else "detect",
        "categories": [{"id": c.id, "name": c.name} for c in categories],
        "images": [
            {"id": i.source_id, "file_name": f"{i.split}/{i.name}", "width": w, "height": h} for i, (w, h) in sized
        ],
        "annotations": rows,
    }


def _table(rows: Any, field_name: str) -> dict[int | str | None, str]:
    """Return texts by id; empty if any row is malformed or repeated."""
    if not isinstance(rows, list):
        return {}
    found: dict[int | str | None, str] = {}
    for row in rows:
        number = to_key(row.get("id")) if isinstance(row, dict) else None
        if number is None or not isinstance(row.get(field_name), str):
            return {}
        found[number] = row[field_name]
    return found if len(found) == len(rows) == len(set(found.values())) else {}


def _row_fault(
    row: Any, task: Task, names: Mapping[int | str | None, str], files: Mapping[int | str | None, str]
) -> str | None:
    if not isinstance(row, dict):
        return "not a JSON object"
    if to_key(row.get("image_id")) not in files:
        return f"image_id {row.get('image_id')!r}, which no image has"
    if to_key(row.get("category_id")) not in names:
        return f"category_id {row.get('category_id')!r}, which no category has"
    score: Any = row.get("score")
    if not _is_number(score) or not 0 <= score <= 1:
        return f"score {score!r}"
    wanted = ("corners", 8) if task == "obb" else ("bbox", 4)
    if task == "obb" and "bbox" in row and not _numbers(row["bbox"], 4):
        return f"bbox {row['bbox']!r}"[:80]
    of_mask = task == "segment" and not row.get("bbox")
    if not of_mask and not _numbers(row.get(wanted[0]), wanted[1]):
        return f"{wanted[0]} {row.get(wanted[0])!r}"[:80]
    return "no segmentation" if task == "segment" and "segmentation" not in row else None


def _numbers(value: Any, count: int) -> bool:
    return isinstance(value, list) and len(value) == count and all(_is_number(v) and abs(v) < 1e6 for v in value)


def _is_number(value: Any) -> bool:
    # A whole number may be too large for a float.
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < sys.float_info.max


def _edges(row: Mapping[str, Any], mask: Mask | None) -> Sequence[float]:
    """Return the edges of a detection's box, else those of its corners or mask."""
    if row.get("bbox"):
        x, y, w, h = (float(v) for v in row["bbox"])
        return x, y, x + w, y + h
    found = box_of_points(np.array(row["corners"], np.float64).reshape(4, 2)) if mask is None else mask.box_xyxy
    return (0.0, 0.0, 0.0, 0.0) if found is None else tuple(found.tolist())


def _collect_detections(rows: Sequence[tuple[Any, ...]], task: Task) -> Detections:
    boxes, scores, classes, corners, masks = zip(*rows, strict=True) if rows else ((), (), (), (), ())
    return detections(boxes, scores, classes, corners if task == "obb" else None, masks if task == "segment" else None)
