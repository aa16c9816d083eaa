"""Figures for small targets: classes taken as one, what found objects are called, false alarms, size of the body."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from infrablend.core.outline import Levels, find_body
from infrablend.detection.detections import Detections, FloatArray, Task
from infrablend.detection.matching import SIZE_BINS, ClassMatches, overlaps
from infrablend.detection.truth import Case, Truth, long_sides
from infrablend.lab.evaluation.evaluation_record import (
    AlarmsAtRecall,
    ClassAlarms,
    ClassRow,
    FalseAlarms,
    FoundCounts,
    NamedCounts,
)

# Least overlap of a detection with an object that counts as found: small boxes that are a pixel off share little.
FOUND_IOU = 0.1
SMALL_PX = 32.0
"""Median longer side below which tables of AP50 show AP10, too."""
# Detections of different classes that share more are one detection; detectors suppress those of one class alike.
SAME_IOU = 0.7
RECALL_LEVELS = (0.5, 0.8, 0.9)
BODY_BINS = {
    "2-4": (2.0, 4.0), "4-8": (4.0, 8.0), "8-14": (8.0, 14.0), "14-30": (14.0, 30.0), ">=30": (30.0, float("inf")),
}  # fmt: skip
"""Half-open ranges of the size of the body, px."""
VISIBLE_BINS = {"<0.5": (0.0, 0.5), "0.5-0.8": (0.5, 0.8), ">=0.8": (0.8, float("inf"))}
"""Half-open ranges of the visible share."""
NO_BODY_PX = -1.0
"""Size of an object without a measurable body, which is in no range."""


def median_sizes(case: Case) -> list[float | None]:
    """Return the median longer side of all objects and of those of each class, px; None without objects."""
    of = np.concatenate([t.classes[~t.ignore] for t in case.labels])
    sizes = np.concatenate([long_sides(t)[~t.ignore] for t in case.labels])
    parts = [sizes, *(sizes[of == k] for k in range(len(case.classes)))]
    return [float(np.median(part)) if len(part) else None for part in parts]


def as_one_class(case: Case) -> Case:
    """Return the labels and detections with all classes taken as one.

    Of detections of different classes that are nearly the same, only the one with the highest score is kept.
    """
    labels = [replace(t, classes=np.minimum(t.classes, 0)) for t in case.labels]
    found = []
    for truth, of in zip(case.labels, case.found, strict=True):
        kept = _without_repeats(of, truth, case.task)
        found.append(replace(kept, classes=np.zeros_like(kept.classes)))
    return replace(case, labels=labels, found=found, classes=("all",))


def _without_repeats(found: Detections, truth: Truth, task: Task) -> Detections:
    if (found.classes == found.classes[:1]).all():
        return found
    themselves = replace(
        truth,
        boxes_xyxy=found.boxes_xyxy,
        classes=found.classes,
        ignore=np.zeros(len(found), np.bool_),
        corners_xy=found.corners_xy,
        masks=found.masks,
    )
    same = overlaps(found, themselves, task) > SAME_IOU
    same &= np.triu(found.classes != found.classes[:, None], 1)
    keep = np.ones(len(found), np.bool_)
    for d in np.flatnonzero(same.any(axis=1)):
        if keep[d]:
            keep &= ~same[d]
    return found.take(np.flatnonzero(keep))


def name_objects(case: Case, confidence: float) -> NDArray[np.int64]:
    """Return (classes, classes + 1) counts of objects by labelled class (row) and name; the last column is not found.

    A detection of any class with at least the given confidence belongs to the object that it overlaps most, by at least
    `FOUND_IOU`. An object has the name of its detection with the highest score.
    """
    nobody = len(case.classes)
    counts = np.zeros((nobody, nobody + 1), np.int64)
    for truth, names in zip(case.labels, _names(case, confidence), strict=True):
        np.add.at(counts, (truth.classes[~truth.ignore], names), 1)
    return counts


def _names(case: Case, confidence: float) -> Iterator[NDArray[np.int64]]:
    """Yield the names of the objects of each image as in `name_objects`, without regions; the last is not found."""
    nobody = len(case.classes)
    for truth, found in zip(case.labels, case.found, strict=True):
        objects = np.flatnonzero(~truth.ignore)
        names = np.full(len(objects), nobody)
        sure = found.take(np.flatnonzero(found.scores >= confidence))
        for overlap, name in reversed([*zip(overlaps(sure, truth, case.task)[:, objects], sure.classes, strict=True)]):
            if overlap.max(initial=0.0) >= FOUND_IOU:
                names[overlap.argmax()] = name  # the best comes last
        yield names


def found_by_kind(case: Case, confidence: float) -> dict[str, dict[str, FoundCounts]]:
    """Return numbers of `objects`, and of those `found` by a detection of any class, by size and by visible share.

    Sizes are the longer sides of boxes, px. Objects whose visible share is unknown are in no range of it, and a range
    without objects is left out.
    """
    sizes = [np.zeros(0)]
    shares = [np.zeros(0)]
    found = [np.zeros(0, np.bool_)]
    for truth, names in zip(case.labels, _names(case, confidence), strict=True):
        objects = ~truth.ignore
        sizes.append(long_sides(truth)[objects])
        unknown = np.full(len(objects), np.nan)
        shares.append((unknown if truth.visibility is None else truth.visibility)[objects])
        found.append(names < len(case.classes))
    hit = np.concatenate(found)
    rows: dict[str, dict[str, FoundCounts]] = {}
    bins = {k: v for k, v in SIZE_BINS.items() if k != "all"}
    for kind, values, ranges in (("size", sizes, bins), ("visibility", shares, VISIBLE_BINS)):
        of = np.concatenate(values)
        within = {name: (of >= low) & (of < high) for name, (low, high) in ranges.items()}
        rows[kind] = {
            name: {"objects": int(its.sum()), "found": int(hit[its].sum())} for name, its in within.items() if its.any()
        }
    return rows


def found_and_named(case: Case, confidence: float) -> dict[str, NamedCounts]:
    """Return numbers of `objects`, of those `found` and of those `named` rightly, per class and for `all`.

    `called` has the number of found objects by the name of their detection, see `name_objects`.
    """
    counts = name_objects(case, confidence)
    rows: dict[str, NamedCounts] = {}
    for k, name in enumerate(("all", *case.classes), -1):
        of = counts.sum(axis=0) if k < 0 else counts[k]
        rows[name] = {
            "objects": int(of.sum()),
            "found": int(of[:-1].sum()),
            "named": int(np.trace(counts) if k < 0 else counts[k, k]),
            "called": {n: int(v) for n, v in zip(case.classes, of, strict=False) if v},
        }
    return rows


def false_alarms(case: Case, matches: Mapping[str, ClassMatches], confidence: float) -> FalseAlarms:
    """Return the false alarms a picture on the pictures without objects of the evaluated classes.

    Args:
        case: Labels and detections.
        matches: Matches of each class, and of all classes as one, at all sizes.
        confidence: Least score of the detections in `per_picture`.

    Returns:
        `pictures`, and by class `per_picture` and, for each recall at IoU 0.5, the `confidence` that reaches it and
        `per_picture` there; None where it is not reached. Without such pictures there are no classes.
    """
    empty = np.array([not (t.classes >= 0).any() for t in case.labels], np.bool_)
    pictures = int(empty.sum())
    classes: dict[str, ClassAlarms] = {}
    for name, m in matches.items() if pictures else ():
        scores = m.scores[empty[m.images] & ~m.neutral[0, 0]]
        hits = np.cumsum(m.right[0, 0])
        objects = int(m.objects[0].sum())
        at_recall: dict[str, AlarmsAtRecall | None] = {}
        for level in RECALL_LEVELS:
            needed = math.ceil(level * objects - 1e-9)
            at_recall[f"{level:g}"] = None
            if objects and len(hits) and hits[-1] >= needed:
                least = float(m.scores[np.searchsorted(hits, needed)])
                at_recall[f"{level:g}"] = {
                    "confidence": least,
                    "per_picture": float((scores >= least).sum() / pictures),
                }
        classes[name] = {"per_picture": float((scores >= confidence).sum() / pictures), "at_recall": at_recall}
    return {"pictures": pictures, "classes": classes}


def add_target_shares(row: ClassRow, target: NamedCounts, alarms: ClassAlarms | None) -> None:
    """Add a class's share of objects found, of these the share named, and false alarms a picture at recall 0.8."""
    objects = target["objects"]
    found = target["found"]
    at_recall = alarms["at_recall"]["0.8"] if alarms else None
    row["found"] = found / objects if objects else None
    row["named"] = target["named"] / found if found else None
    row["false_alarms"] = at_recall["per_picture"] if at_recall else None


def body_sizes(picture: Levels, truth: Truth) -> FloatArray:
    """Return the (g,) size of the body of each label in a picture, px; `NO_BODY_PX` without one, and for regions."""
    boxes = truth.boxes_xyxy[~truth.ignore]
    found = np.full(len(truth.ignore), NO_BODY_PX)
    for k in np.flatnonzero(~truth.ignore):
        body = find_body(picture, truth.boxes_xyxy[k], list(boxes))
        found[k] = NO_BODY_PX if body is None else body.size_px
    return found


def sizes_by_body(case: Case, bodies_px: Sequence[FloatArray]) -> list[tuple[FloatArray, FloatArray]]:
    """Return the sizes of the labels and of the detections on each image, for `match_all`.

    The body of a detection is unknown; its size is the longer side of its box less the median margin of the labels of
    its class, from body to box.
    """
    body = np.concatenate(bodies_px)
    of = np.concatenate([t.classes for t in case.labels])
    margin = np.concatenate([long_sides(t) for t in case.labels]) - body
    known = [(body != NO_BODY_PX) & (of == c) for c in range(len(case.classes))]
    margins = np.array([np.median(margin[its]) if its.any() else 0.0 for its in known])
    return [
        (b, np.maximum(long_sides(f) - margins[f.classes], 0.0)) for b, f in zip(bodies_px, case.found, strict=True)
    ]
