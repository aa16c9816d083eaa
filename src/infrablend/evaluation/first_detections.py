"""The labelled objects found among the detections with the highest scores, one by one: for tests with few objects."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.evaluation.figures import Case
from infrablend.evaluation.overlap import overlaps


def list_found(case: Case, first: int, iou: float) -> dict[str, Any]:
    """Return which objects are among the detections with the highest scores of all images together.

    In the order of their scores, detections take the object of their class with the largest overlap that no earlier one
    has taken. Detections in regions to ignore do not count, and neither do those of other classes.

    Args:
        case: Labels and detections.
        first: Number of detections that count.
        iou: Least overlap, as intersection over union.

    Returns:
        Plain JSON: `first`, `iou`, `detections` (number that counted, at most `first`), `found`, and `objects` with
        `image`, `class`, `box` (xyxy, px) and `rank` (from 1), `score` and `iou` of the detection, None if missed.
    """
    candidates: list[tuple[float, int, int]] = []
    overlap: list[NDArray[np.float64]] = []
    for k, truth in enumerate(case.labels):
        detected = case.compared.get(truth.key)
        if detected is None or not len(detected):
            overlap.append(np.zeros((0, len(truth.boxes_xyxy))))
            continue
        shared = overlaps(detected, truth, case.task)
        regions = truth.regions_of(case.class_of[detected.classes])
        ignored = ((shared >= iou) & regions).any(axis=1) & ~(shared[:, ~truth.ignore] >= iou).any(axis=1)
        overlap.append(shared)
        candidates += [
            (-float(detected.scores[d]), k, d)
            for d in range(len(detected))
            if case.class_of[detected.classes[d]] >= 0 and not ignored[d]
        ]
    candidates.sort()
    hits: dict[tuple[int, int], dict[str, Any]] = {}
    for rank, (minus_score, k, d) in enumerate(candidates[:first], 1):
        truth = case.labels[k]
        free = (truth.classes == case.class_of[case.found[truth.key].classes[d]]) & ~truth.ignore
        free[[g for of, g in hits if of == k]] = False
        shared = np.where(free, overlap[k][d], 0.0)
        if shared.size and shared.max() >= iou:
            best = int(shared.argmax())
            hits[k, best] = {"rank": rank, "score": -minus_score, "iou": round(float(shared[best]), 3)}
    missed = {"rank": None, "score": None, "iou": None}
    objects = [
        {
            "image": truth.key,
            "class": case.classes[truth.classes[g]],
            "box": np.round(truth.boxes_xyxy[g], 1).tolist(),
            **hits.get((k, g), missed),
        }
        for k, truth in enumerate(case.labels)
        for g in range(len(truth.boxes_xyxy))
        if not truth.ignore[g]
    ]
    counted = min(first, len(candidates))
    return {"first": first, "iou": iou, "detections": counted, "found": len(hits), "objects": objects}
