"""Average precision by pycocotools, for the tables and to check our own matching."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from infrablend.evaluation.detections import Detections, FloatArray, Task
from infrablend.evaluation.matching import overlaps
from infrablend.evaluation.truth import Truth, long_sides

MAX_DETECTIONS = 300


def coco_precisions(
    truths: Sequence[Truth],
    found: Mapping[str, Detections],
    class_of: NDArray[np.int64],
    classes: int,
    task: Task,
    ranges: Sequence[tuple[float, float]] = ((0.0, float("inf")),),
) -> FloatArray:
    """Return the (a, classes, 10) average precision at IoU 0.5 to 0.95 with at most 300 detections per image.

    Classes without objects are NaN. pycocotools compares boxes and masks; oriented boxes, which it does not support,
    are compared by `overlaps`.

    Args:
        truths: Labels by image.
        found: Detections by image.
        class_of: Index of the evaluated class for each of the detector's classes; -1 for none.
        classes: Number of evaluated classes.
        task: What is compared.
        ranges: Half-open ranges of the longer side, px, which replace COCO's areas.
    """
    with contextlib.redirect_stdout(io.StringIO()):
        evaluation = _Eval(
            _labels(truths, classes, task), _results(truths, found, class_of, classes, task), truths, found, class_of,
            task,
        )  # fmt: skip
        params = evaluation.params
        params.maxDets = [MAX_DETECTIONS]
        params.areaRng = [[low, np.nextafter(high, low) if np.isfinite(high) else 1e9] for low, high in ranges]
        params.areaRngLbl = [str(k) for k in range(len(ranges))]
        params.catIds = list(range(1, classes + 1))
        params.imgIds = list(range(1, len(truths) + 1))
        evaluation.evaluate()
        evaluation.accumulate()
    precision = evaluation.eval["precision"][..., 0]  # (t, recalls, classes, a)
    ap = precision.mean(axis=1).transpose(2, 1, 0)
    return np.asarray(np.where((precision == -1).all(axis=1).transpose(2, 1, 0), np.nan, ap))


class _Eval(COCOeval):  # type: ignore[misc]
    """pycocotools' evaluation, with oriented boxes."""

    def __init__(
        self,
        labels: COCO,
        results: COCO,
        truths: Sequence[Truth],
        found: Mapping[str, Detections],
        class_of: NDArray[np.int64],
        task: Task,
    ) -> None:
        super().__init__(labels, results, "segm" if task == "segment" else "bbox")
        self._quads = (truths, found, class_of) if task == "obb" else None

    def computeIoU(self, imgId: int, catId: int) -> Any:  # noqa: N802 - pycocotools' name
        if self._quads is None:
            return super().computeIoU(imgId, catId)
        labels, results = self._gts[imgId, catId], self._dts[imgId, catId]
        if not labels and not results:
            return []
        truths, found, class_of = self._quads
        truth = truths[imgId - 1]
        ours = found.get(truth.key)
        if ours is None or not results:
            return []
        its = np.flatnonzero(class_of[ours.classes] == catId - 1)[:MAX_DETECTIONS]
        whole = overlaps(ours.take(its), truth, "obb")
        return whole[:, (truth.classes == catId - 1) | (truth.classes == -1)]


def _labels(truths: Sequence[Truth], classes: int, task: Task) -> COCO:
    rows: list[dict[str, Any]] = []
    for number, truth in enumerate(truths, 1):
        sizes = truth.long_sides_px
        for k in range(len(truth.classes)):
            own = int(truth.classes[k])
            for c in range(classes) if own < 0 else (own,):
                rows.append(
                    _row(len(rows) + 1, number, c, truth.boxes_xyxy[k], float(sizes[k]))
                    | {"iscrowd": int(truth.ignore[k])}
                )
                if task == "segment" and truth.masks is not None:
                    rows[-1]["segmentation"] = truth.masks[k].to_coco()
    return _index(rows, truths, classes)


def _results(
    truths: Sequence[Truth], found: Mapping[str, Detections], class_of: NDArray[np.int64], classes: int, task: Task
) -> COCO:
    rows: list[dict[str, Any]] = []
    for number, truth in enumerate(truths, 1):
        ours = found.get(truth.key)
        if ours is None:
            continue
        sizes, its = long_sides(ours.boxes_xyxy, ours.corners_xy), class_of[ours.classes]
        for k in np.flatnonzero(its >= 0):
            rows.append(
                _row(len(rows) + 1, number, int(its[k]), ours.boxes_xyxy[k], float(sizes[k]))
                | {"score": float(ours.scores[k])}
            )
            if task == "segment" and ours.masks is not None:
                rows[-1]["segmentation"] = ours.masks[int(k)].to_coco()
    return _index(rows, truths, classes)


def _row(number: int, image: int, c: int, box_xyxy: FloatArray, size_px: float) -> dict[str, Any]:
    x0, y0, x1, y1 = box_xyxy.tolist()
    # pycocotools compares its ranges with the field `area`; our ranges are of the longer side.
    return {"id": number, "image_id": image, "category_id": c + 1, "bbox": [x0, y0, x1 - x0, y1 - y0], "area": size_px}


def _index(rows: list[dict[str, Any]], truths: Sequence[Truth], classes: int) -> COCO:
    coco = COCO()
    coco.dataset = {
        "images": [
            {"id": k, "width": truth.size_wh[0], "height": truth.size_wh[1]} for k, truth in enumerate(truths, 1)
        ],
        "categories": [{"id": c + 1, "name": str(c)} for c in range(classes)],
        "annotations": rows,
    }
    coco.createIndex()
    return coco
