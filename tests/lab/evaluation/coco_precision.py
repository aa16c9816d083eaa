"""Average precision by pycocotools: the oracle of our own matching and precision."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

from infrablend.detection.detections import MAX_DETECTIONS, Detections, FloatArray
from infrablend.detection.matching import overlaps
from infrablend.detection.truth import Case, Truth, long_sides


def coco_precisions(case: Case, ranges: Sequence[tuple[float, float]] = ((0.0, float("inf")),)) -> FloatArray:
    """Return the (a, classes, 10) average precision at IoU 0.5 to 0.95 with at most 300 detections per image.

    Classes without objects are NaN. pycocotools compares boxes and masks; oriented boxes, which it does not support,
    are compared by `overlaps`.

    Args:
        case: Labels and detections.
        ranges: Half-open ranges of the longer side, px, which replace COCO's areas.
    """
    with contextlib.redirect_stdout(io.StringIO()):
        evaluation = _Eval(case)
        params = evaluation.params
        params.maxDets = [MAX_DETECTIONS]
        params.areaRng = [[low, np.nextafter(high, low) if np.isfinite(high) else 1e9] for low, high in ranges]
        params.areaRngLbl = [str(k) for k in range(len(ranges))]
        params.catIds = list(range(1, len(case.classes) + 1))
        params.imgIds = list(range(1, len(case.labels) + 1))
        evaluation.evaluate()
        evaluation.accumulate()
    precision = evaluation.eval["precision"][..., 0]  # (t, recalls, classes, a)
    ap = precision.mean(axis=1).transpose(2, 1, 0)
    return np.asarray(np.where((precision == -1).all(axis=1).transpose(2, 1, 0), np.nan, ap))


class _Eval(COCOeval):  # type: ignore[misc]
    """pycocotools' evaluation, with oriented boxes."""

    def __init__(self, case: Case) -> None:
        geometry = "segm" if case.task == "segment" else "bbox"
        super().__init__(_dataset(case, _labels(case)), _dataset(case, _results(case)), geometry)
        self._case = case

    def computeIoU(self, imgId: int, catId: int) -> Any:  # noqa: N802 - pycocotools' name
        if self._case.task != "obb":
            return super().computeIoU(imgId, catId)
        if not self._dts[imgId, catId]:
            return []
        truth = self._case.labels[imgId - 1]
        found = self._case.found[imgId - 1]
        its = np.flatnonzero(found.classes == catId - 1)[:MAX_DETECTIONS]
        return overlaps(found.take(its), truth, "obb")[:, (truth.classes == catId - 1) | (truth.classes == -1)]


def _labels(case: Case) -> Iterator[dict[str, Any]]:
    for number, truth in enumerate(case.labels, 1):
        sizes = long_sides(truth)
        for k, own in enumerate(truth.classes.tolist()):
            for c in range(len(case.classes)) if own < 0 else (own,):
                yield _row(number, c, truth, k, sizes) | {"iscrowd": int(truth.ignore[k])}


def _results(case: Case) -> Iterator[dict[str, Any]]:
    for number, found in enumerate(case.found, 1):
        sizes = long_sides(found)
        for k, c in enumerate(found.classes.tolist()):
            yield _row(number, c, found, k, sizes) | {"score": float(found.scores[k])}


def _row(image: int, c: int, of: Truth | Detections, k: int, sizes_px: FloatArray) -> dict[str, Any]:
    x0, y0, x1, y1 = of.boxes_xyxy[k].tolist()
    # pycocotools compares its ranges with the field `area`; our ranges are of the longer side.
    row = {"image_id": image, "category_id": c + 1, "bbox": [x0, y0, x1 - x0, y1 - y0], "area": float(sizes_px[k])}
    return row if of.masks is None else row | {"segmentation": of.masks[k].to_coco()}


def _dataset(case: Case, rows: Iterable[dict[str, Any]]) -> COCO:
    coco = COCO()
    coco.dataset = {
        "images": [{"id": k, "width": t.size_wh[0], "height": t.size_wh[1]} for k, t in enumerate(case.labels, 1)],
        "categories": [{"id": c, "name": str(c)} for c in range(1, len(case.classes) + 1)],
        "annotations": [{"id": n, **row} for n, row in enumerate(rows, 1)],
    }
    coco.createIndex()
    return coco
