"""The figures of an evaluation: tables by class, strata, intervals, confusion, curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import ImageRecord
from infrablend.evaluation.bootstrap import MEASURES, draw_images, drawn_figures, has_several_groups, interval
from infrablend.evaluation.coco import coco_precisions
from infrablend.evaluation.confusion import IOU as CONFUSION_IOU
from infrablend.evaluation.confusion import confusion_matrix
from infrablend.evaluation.detections import Detections, Task
from infrablend.evaluation.matching import ClassMatches, match_all, size_bins
from infrablend.evaluation.precision import RECALLS, average_precisions, operating_point, precision_by_recall
from infrablend.evaluation.strata import image_strata
from infrablend.evaluation.truth import Truth


@dataclass(frozen=True, eq=False)
class Case:
    """Detections and the labels to compare them with.

    Attributes:
        images: Images of the split.
        labels: Labels of each image.
        found: Detections by `<split>/<name>` of the image.
        class_of: Index of the evaluated class for each of the detector's classes; -1 for none.
        classes: Names of the evaluated classes.
        task: What is compared: boxes, oriented boxes or masks.
    """

    images: Sequence[ImageRecord]
    labels: Sequence[Truth]
    found: Mapping[str, Detections]
    class_of: NDArray[np.int64]
    classes: tuple[str, ...]
    task: Task

    @property
    def compared(self) -> Mapping[str, Detections]:
        """Detections as the task compares them: with corners for oriented boxes only."""
        if self.task == "obb":
            return self.found
        return {key: replace(found, corners_xy=None) for key, found in self.found.items()}


@dataclass(frozen=True)
class Draws:
    """Bootstrap draws of images.

    Attributes:
        number: Number of draws; 0 for no intervals.
        groups: Group of each image; those of one group are drawn together.
        seed: Seed of the draws.
    """

    number: int
    groups: tuple[str, ...]
    seed: int


def figures(case: Case, draws: Draws) -> tuple[dict[str, Any], tuple[ClassMatches, ...]]:
    """Return the figures of an evaluation as in `evaluation.json`, and the matches of each class at all sizes."""
    bins, found, names = size_bins(), case.compared, case.classes
    matches = match_all(case.labels, found, case.class_of, len(names), case.task, bins)
    coco = coco_precisions(case.labels, found, case.class_of, len(names), case.task)[0]
    ours = np.array([average_precisions(m)[0] for m in matches])
    if not np.allclose(coco, ours, rtol=0, atol=1e-6, equal_nan=True):
        raise AssertionError("pycocotools and our own matching disagree: a bug")
    weights = draw_images(draws.groups, draws.number, draws.seed)
    confidence, points = operating_point(matches)
    matrix = confusion_matrix(case.labels, found, case.class_of, len(names), case.task, confidence)
    metrics = {
        "classes": _table(case, matches, coco, points, drawn_figures(matches, weights), draws.groups),
        "confidence": confidence,
        "strata": _strata(case, matches, list(bins), weights, draws.groups),
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


def _table(
    case: Case,
    matches: Sequence[ClassMatches],
    coco: NDArray[np.float64],
    points: Sequence[tuple[float, float] | None],
    drawn: NDArray[np.float64],
    groups: Sequence[str],
) -> dict[str, Any]:
    """Return the rows of `all` and of each class."""
    known = [p for p in points if p is not None]
    everything = np.sum([m.objects[0] for m in matches], axis=0)
    table: dict[str, Any] = {
        "all": {
            "images": len(case.images),
            "instances": int(everything.sum()),
            "p": float(np.mean([p for p, _ in known])),
            "r": float(np.mean([r for _, r in known])),
            "map50": float(np.nanmean(coco[:, 0])),
            "map50_95": float(np.nanmean(coco)),
            "ci": _intervals(drawn[:, 0], everything > 0, groups),
        }
    }
    for k, name in enumerate(case.classes):
        point, m = points[k], matches[k]
        held = m.objects[0] > 0
        table[name] = {
            "images": int(held.sum()),
            "instances": int(m.objects[0].sum()),
            "p": None if point is None else point[0],
            "r": None if point is None else point[1],
            "map50": _number(coco[k, 0]),
            "map50_95": _number(coco[k].mean()),
            "ci": _intervals(drawn[:, k + 1], held, groups),
        }
    return table


def _strata(
    case: Case, matches: Sequence[ClassMatches], bins: Sequence[str], weights: NDArray[Any], groups: Sequence[str]
) -> dict[str, Any]:
    """Return the figures by size of objects, pitch, altitude and time of day."""
    names = case.classes
    strata: dict[str, Any] = {"size": {}}
    for a, name in enumerate(bins):
        if a:
            at_size = [_at_size(m, a) for m in matches]
            stratum = _stratum(at_size, names, np.ones(len(case.images), np.bool_), weights, groups)
            # All images are evaluated for each size; the count covers those with an object of this size.
            stratum["classes"]["all"]["images"] = int(np.any([m.objects[a] > 0 for m in matches], axis=0).sum())
            strata["size"][name] = stratum
    for kind, parts in image_strata(case.images).items():
        strata[kind] = {name: _stratum(matches, names, which, weights, groups) for name, which in parts.items()}
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
) -> dict[str, Any]:
    """Return the figures of some images, ignoring all others."""
    matches = [_of_images(m, which) for m in matches]
    figures = drawn_figures(matches, which[None].astype(np.int32))[0]
    drawn = drawn_figures(matches, weights * which[None].astype(np.int32))
    objects = [m.objects[0] for m in matches]
    objects = [np.sum(objects, axis=0), *objects]
    rows = {}
    for k, (name, of) in enumerate(zip(("all", *names), objects, strict=True)):
        rows[name] = {
            "images": int((of > 0).sum()) if k else int(which.sum()),
            "instances": int(of.sum()),
            "map50": _number(figures[k, 0]),
            "map50_95": _number(figures[k, 1]),
            "ci": _intervals(drawn[:, k], of > 0, groups),
        }
    return {"images": int(which.sum()), "classes": rows}


def _number(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def _intervals(
    drawn: NDArray[np.float64], held: NDArray[np.bool_], groups: Sequence[str]
) -> dict[str, list[float] | None] | None:
    """Return the intervals of (draws, 2) mAP50 and mAP50-95; None without draws or if one group has all objects."""
    if not len(drawn) or not has_several_groups(held, groups):
        return None
    return {name: interval(drawn[:, k]) for k, name in enumerate(MEASURES)}
