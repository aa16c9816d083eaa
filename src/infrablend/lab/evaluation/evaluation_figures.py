"""The figures of an evaluation: tables by class, strata, intervals, confusion, curves, and found objects one by one."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypedDict, get_args

import numpy as np
from numpy.typing import NDArray

from infrablend.core.capture import TimeOfDay
from infrablend.core.dataset import ImageRecord
from infrablend.detection.detections import FloatArray
from infrablend.detection.matching import (
    SIZE_BINS,
    ClassMatches,
    draw_images,
    has_several_groups,
    interval,
    match_all,
    overlaps,
)
from infrablend.detection.truth import Case
from infrablend.lab.evaluation.evaluation_record import (
    ClassRow,
    ClassRows,
    Confusion,
    Curves,
    FalseAlarms,
    FirstDetections,
    ListedObject,
    Strata,
    Stratum,
    Targets,
)
from infrablend.lab.evaluation.precision import (
    MEASURES,
    RECALLS,
    drawn_figures,
    operating_point,
    precision_by_recall,
)
from infrablend.lab.evaluation.small_targets import (
    BODY_BINS,
    FOUND_IOU,
    add_target_shares,
    as_one_class,
    false_alarms,
    found_and_named,
    found_by_kind,
    median_sizes,
    sizes_by_body,
)

# Least overlap of a match in the confusion matrix.
CONFUSION_IOU = 0.5
PITCH_EDGES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0)
ALTITUDE_EDGES_M = (0.0, 20.0, 40.0, 60.0, 80.0, 100.0, 120.0, 150.0)
AS_ONE = ("as_one50", "as_one50_95")
"""Measures of all classes taken as one, in the order of `MEASURES`."""
# At most this many different values get a bin each.
_SINGLE_VALUES = 10


class Figures(TypedDict):
    """The fields of an `EvaluationRecord` that follow from labels and detections alone."""

    classes: ClassRows
    confidence: float
    strata: Strata
    targets: Targets
    false_alarms: FalseAlarms
    confusion: Confusion
    curves: Curves


class Hit(TypedDict):
    """The fields of a `ListedObject` on the detection that found it; None if it was missed."""

    rank: int | None
    score: float | None
    iou: float | None


def figures(
    case: Case, groups: Sequence[str], draws: int, seed: int, bodies_px: Sequence[FloatArray] | None = None
) -> tuple[Figures, tuple[ClassMatches, ...]]:
    """Return the figures of an evaluation as in `evaluation.json`, and the matches of each class at all sizes.

    Args:
        case: Labels and detections.
        groups: Group of each image; those of one group are drawn together.
        draws: Number of bootstrap draws; 0 for no intervals.
        seed: Seed of the draws.
        bodies_px: Sizes of the bodies of the labels on each image, if they are measured.
    """
    names = case.classes
    matches = match_all(case)
    once = np.ones((1, len(case.images)), np.int32)
    whole = drawn_figures(matches, once)[0]
    weights = draw_images(groups, draws, seed)
    confidence, points = operating_point(matches)
    matrix = confusion_matrix(case, confidence)
    rows = _rows(names, len(case.images), matches, whole, drawn_figures(matches, weights), groups)
    known = [p for p in points if p is not None]
    means = (float(np.mean([p for p, _ in known])), float(np.mean([r for _, r in known]))) if known else None
    one = match_all(as_one_class(case), {"all": SIZE_BINS["all"]})
    _add_as_one(rows["all"], one, weights)
    targets = found_and_named(case, confidence)
    alarms = false_alarms(case, {"all": one[0], **dict(zip(names, matches, strict=True))}, confidence)
    overlapping = match_all(case, {"all": SIZE_BINS["all"]}, ious=np.array([FOUND_IOU]))
    at_overlap = drawn_figures(overlapping, once)[0, :, 0]
    sizes = median_sizes(case)
    for (name, row), point, ap, size in zip(rows.items(), [means, *points], at_overlap, sizes, strict=True):
        row["p"] = None if point is None else point[0]
        row["r"] = None if point is None else point[1]
        row["map10"] = None if np.isnan(ap) else float(ap)
        row["median_px"] = size
        add_target_shares(row, targets[name], alarms["classes"].get(name))
    strata: dict[str, Mapping[str, Stratum]] = {"size": _by_size(case, matches, SIZE_BINS, weights, groups)}
    if bodies_px is not None:
        of_bodies = match_all(case, {"all": SIZE_BINS["all"], **BODY_BINS}, sizes_by_body(case, bodies_px))
        strata["body"] = _by_size(case, of_bodies, BODY_BINS, weights, groups)
    for kind, parts in image_strata(case.images).items():
        strata[kind] = {name: _stratum(matches, names, which, weights, groups) for name, which in parts.items()}
    metrics: Figures = {
        "classes": rows,
        "confidence": confidence,
        "strata": strata,
        "targets": {
            "iou": FOUND_IOU,
            "confidence": confidence,
            "classes": targets,
            "by": found_by_kind(case, confidence),
        },
        "false_alarms": alarms,
        "confusion": {
            "classes": [*names, "background"],
            "found_by_labelled": matrix.tolist(),
            "confidence": confidence,
            "iou": CONFUSION_IOU,
        },
        "curves": {
            "recall": RECALLS.tolist(),
            "precision": {
                n: [round(float(v), 6) for v in precision_by_recall(m)]
                for n, m in zip(names, matches, strict=True)
                if m.objects[0].sum()
            },
        },
    }
    return metrics, tuple(_at_size(m, 0) for m in matches)


def _add_as_one(row: ClassRow, one: Sequence[ClassMatches], weights: NDArray[Any]) -> None:
    """Add the AP of all classes as one to the row `all`, and its intervals if the row has any."""
    once = np.ones((1, weights.shape[1]), np.int32)
    values = drawn_figures(one, once)[0, 0]
    row["as_one50"] = float(values[0])
    row["as_one50_95"] = float(values[1])
    if row["ci"] is not None:
        drawn = drawn_figures(one, weights)[:, 0]
        row["ci"] = {**row["ci"], **{m: interval(drawn[:, n]) for n, m in enumerate(AS_ONE)}}


def _by_size(
    case: Case,
    matches: Sequence[ClassMatches],
    bins: Iterable[str],
    weights: NDArray[Any],
    groups: Sequence[str],
) -> dict[str, Stratum]:
    """Return the strata of the size ranges of some matches: the first holds all sizes, the others are the bins."""
    strata: dict[str, Stratum] = {}
    for a, name in enumerate([b for b in bins if b != "all"], 1):
        at_size = [_at_size(m, a) for m in matches]
        stratum = _stratum(at_size, case.classes, np.ones(len(case.images), np.bool_), weights, groups)
        # All images are evaluated for each size; the count covers those with an object of this size.
        stratum["classes"]["all"]["images"] = int(np.any([m.objects[a] > 0 for m in matches], axis=0).sum())
        strata[name] = stratum
    return strata


def _at_size(m: ClassMatches, size: int) -> ClassMatches:
    part = slice(size, size + 1)
    return ClassMatches(m.scores, m.images, m.right[part], m.neutral[part], m.objects[part])


def _of_images(m: ClassMatches, which: NDArray[np.bool_]) -> ClassMatches:
    """Return the matches in some images only, so that draws need not count the others zero times."""
    keep = which[m.images]
    return ClassMatches(m.scores[keep], m.images[keep], m.right[..., keep], m.neutral[..., keep], m.objects * which)


def _stratum(
    matches: Sequence[ClassMatches],
    names: Sequence[str],
    which: NDArray[np.bool_],
    weights: NDArray[Any],
    groups: Sequence[str],
) -> Stratum:
    matches = [_of_images(m, which) for m in matches]
    figures = drawn_figures(matches, which[None].astype(np.int32))[0]
    drawn = drawn_figures(matches, weights * which[None].astype(np.int32))
    images = int(which.sum())
    return {"images": images, "classes": _rows(names, images, matches, figures, drawn, groups)}


def _rows(
    names: Sequence[str],
    images: int,
    matches: Sequence[ClassMatches],
    figures: NDArray[np.float64],
    drawn: NDArray[np.float64],
    groups: Sequence[str],
) -> dict[str, ClassRow]:
    """Return the rows of `all` and of each class, with no interval without draws or if one group has all objects.

    Args:
        names: Names of the classes.
        images: Number of images for the row `all`.
        matches: Matches of each class.
        figures: (1 + classes, 2) mAP50 and mAP50-95.
        drawn: (draws, 1 + classes, 2) figures of each draw.
        groups: Group of each image.
    """
    objects = [m.objects[0] for m in matches]
    rows: dict[str, ClassRow] = {}
    for k, (name, of) in enumerate(zip(("all", *names), [np.sum(objects, axis=0), *objects], strict=True)):
        several = len(drawn) and has_several_groups(of > 0, groups)
        rows[name] = {
            "images": int((of > 0).sum()) if k else images,
            "instances": int(of.sum()),
            "map50": None if np.isnan(figures[k, 0]) else float(figures[k, 0]),
            "map50_95": None if np.isnan(figures[k, 1]) else float(figures[k, 1]),
            "ci": {m: interval(drawn[:, k, n]) for n, m in enumerate(MEASURES)} if several else None,
        }
    return rows


def confusion_matrix(case: Case, confidence: float) -> NDArray[np.int64]:
    """Return (classes + 1, classes + 1) counts by detected class (row) and labelled class (column); last is background.

    Detections with at least the given confidence are matched in the order of their score, each to the unmatched label
    with the largest IoU of at least 0.5. Unmatched detections in regions to ignore are left out, in crowds those of the
    crowd's class.
    """
    background = len(case.classes)
    matrix = np.zeros((background + 1, background + 1), np.int64)
    for truth, found in zip(case.labels, case.found, strict=True):
        free = ~truth.ignore
        sure = found.take(np.flatnonzero(found.scores >= confidence))
        overlap = overlaps(sure, truth, case.task)
        regions = truth.regions_of(sure.classes)
        for d, c in enumerate(sure.classes):
            value = np.where(free, overlap[d], 0.0)
            if value.max(initial=0.0) >= CONFUSION_IOU:
                label = int(value.argmax())
                matrix[c, truth.classes[label]] += 1
                free[label] = False
            elif not (overlap[d, regions[d]] >= CONFUSION_IOU).any():
                matrix[c, background] += 1
        for c in truth.classes[free]:
            matrix[background, c] += 1
    return matrix


def image_strata(images: Sequence[ImageRecord]) -> dict[str, dict[str, NDArray[np.bool_]]]:
    """Return (i,) masks of the images in each bin of pitch, altitude and time; `unknown` has those without a value."""
    return {
        "pitch": _binned([i.capture.pitch_deg for i in images], PITCH_EDGES_DEG),
        "altitude": _binned([i.capture.altitude_m for i in images], ALTITUDE_EDGES_M),
        "time": _bins([i.capture.time_of_day for i in images], get_args(TimeOfDay)),
    }


def _binned(values: Sequence[float | None], edges: Sequence[float]) -> dict[str, NDArray[np.bool_]]:
    """Bin by value if there are few different values (HIT-UAV has steps of 10), else by ranges."""
    known = sorted({v for v in values if v is not None})
    if len(known) <= _SINGLE_VALUES:
        names: Mapping[float, str] = {v: f"{v:g}" for v in known}
        ordered = [f"{v:g}" for v in known]
    else:
        place = np.searchsorted(np.array(edges), np.array(known), side="right")
        labels = [f"<{edges[0]:g}", *(f"{a:g}-{b:g}" for a, b in itertools.pairwise(edges))]
        labels.append(f">={edges[-1]:g}")
        names = {v: labels[int(k)] for v, k in zip(known, place, strict=True)}
        ordered = labels
    return _bins([None if v is None else names[v] for v in values], ordered)


def _bins(values: Sequence[str | None], ordered: Sequence[str]) -> dict[str, NDArray[np.bool_]]:
    bins = ["unknown" if v is None else v for v in values]
    return {name: np.array([v == name for v in bins], np.bool_) for name in (*ordered, "unknown") if name in set(bins)}


def list_found(case: Case, first: int, iou: float) -> FirstDetections:
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
    for k, (truth, found) in enumerate(zip(case.labels, case.found, strict=True)):
        shared = overlaps(found, truth, case.task)
        regions = truth.regions_of(found.classes)
        ignored = ((shared >= iou) & regions).any(axis=1) & ~(shared[:, ~truth.ignore] >= iou).any(axis=1)
        overlap.append(shared)
        candidates += [(-float(found.scores[d]), k, int(d)) for d in np.flatnonzero(~ignored)]
    candidates.sort()
    hits: dict[tuple[int, int], Hit] = {}
    for rank, (minus_score, k, d) in enumerate(candidates[:first], 1):
        truth = case.labels[k]
        free = (truth.classes == case.found[k].classes[d]) & ~truth.ignore
        free[[g for of, g in hits if of == k]] = False
        shared = np.where(free, overlap[k][d], 0.0)
        if shared.size and shared.max() >= iou:
            best = int(shared.argmax())
            hits[k, best] = {"rank": rank, "score": -minus_score, "iou": round(float(shared[best]), 3)}
    missed: Hit = {"rank": None, "score": None, "iou": None}
    objects: list[ListedObject] = [
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
