"""Figures of given detections as Ultralytics computes them, with its own overlap, matching and curves."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import cxcywha_of_corners
from infrablend.detection.detections import Detections, Task
from infrablend.detection.matching import IOUS, overlaps
from infrablend.detection.truth import Case, Truth
from infrablend.detection.ultralytics_environment import quiet_ultralytics
from infrablend.lab.evaluation.evaluation_record import ClassRow


def ultralytics_table(case: Case) -> dict[str, ClassRow]:
    """Return images, instances, P, R, mAP50 and mAP50-95 of `all` and of each class, by Ultralytics' code.

    Ultralytics has no regions to ignore. Detections that overlap such a region, but no object of their class, by half
    are therefore removed first. It compares oriented boxes by a probabilistic overlap instead of the exact one.
    """
    with quiet_ultralytics():
        import torch
        from ultralytics.engine.validator import BaseValidator
        from ultralytics.utils.metrics import ap_per_class

        matcher = SimpleNamespace(iouv=torch.linspace(0.5, 0.95, len(IOUS)))
        right = []
        scores = []
        predicted = []
        labels = []
        images = []
        for truth, found in zip(case.labels, case.found, strict=True):
            real = np.flatnonzero(~truth.ignore)
            labels.append(truth.classes[real])
            images.append(np.unique(truth.classes[real]))
            ours = _outside_regions(found, truth, case.task)
            hit = np.zeros((len(ours), len(IOUS)), np.bool_)
            if len(ours) and len(real):
                iou = _overlap(ours, truth, real, case.task)
                hit = BaseValidator.match_predictions(
                    matcher, torch.from_numpy(ours.classes), torch.from_numpy(truth.classes[real]), iou
                ).numpy()
            right.append(hit)
            scores.append(ours.scores)
            predicted.append(ours.classes)
        target = np.concatenate([np.zeros(0, np.int64), *labels])
        if not len(target):
            return {}
        _, _, p, r, _, ap, which, *_ = ap_per_class(
            np.concatenate([np.zeros((0, len(IOUS)), np.bool_), *right]),
            np.concatenate([np.zeros(0), *scores]),
            np.concatenate([np.zeros(0, np.int64), *predicted]),
            target,
        )
    with_class = np.concatenate(images)
    table = {"all": _row(len(case.labels), len(target), p.mean(), r.mean(), ap[:, 0].mean(), ap.mean())}
    for k, c in enumerate(which):
        counts = int((with_class == c).sum()), int((target == c).sum())
        table[case.classes[c]] = _row(*counts, p[k], r[k], ap[k, 0], ap[k].mean())
    return table


def _row(images: int, instances: int, p: float, r: float, map50: float, map50_95: float) -> ClassRow:
    return {
        "images": images,
        "instances": instances,
        "p": float(p),
        "r": float(r),
        "map50": float(map50),
        "map50_95": float(map50_95),
    }


def _outside_regions(ours: Detections, truth: Truth, task: Task) -> Detections:
    if not truth.ignore.any() or not len(ours):
        return ours
    overlap = overlaps(ours, truth, task)
    object_ = (overlap * ((ours.classes[:, None] == truth.classes) & ~truth.ignore)).max(axis=1) >= IOUS[0]
    region = (overlap * truth.regions_of(ours.classes)).max(axis=1) >= IOUS[0]
    return ours.take(np.flatnonzero(object_ | ~region))


def _overlap(ours: Detections, truth: Truth, real: NDArray[np.intp], task: Task) -> Any:
    """Return the (g, n) tensor of Ultralytics' overlaps; those of masks are the exact IoU of pixels, as in its code."""
    import torch
    from ultralytics.utils.metrics import batch_probiou, box_iou

    if task == "segment":
        return torch.from_numpy(overlaps(ours, truth, task)[:, real].T.copy())
    if task == "obb":
        assert ours.corners_xy is not None and truth.corners_xy is not None
        turned = [
            torch.from_numpy(cxcywha_of_corners(c).astype(np.float32))
            for c in (truth.corners_xy[real], ours.corners_xy)
        ]
        return batch_probiou(*turned)
    boxes = [torch.from_numpy(b.astype(np.float32)) for b in (truth.boxes_xyxy[real], ours.boxes_xyxy)]
    return box_iou(*boxes)
