"""Average precision, precision and recall at the best confidence, and their bootstrap intervals.

A bootstrap draws images, or whole sequences, repeatedly with replacement.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.rng import stream
from infrablend.detection.detections import FloatArray
from infrablend.detection.matching import ClassMatches, has_several_groups, interval
from infrablend.lab.evaluation.evaluation_record import Difference

RECALLS: FloatArray = np.linspace(0.0, 1.0, 101)
CONFIDENCES: FloatArray = np.linspace(0.0, 1.0, 1000)
_CELLS = 4_000_000  # most cells of a working array
MEASURES = ("map50", "map50_95")


def average_precisions(matches: ClassMatches, weights: NDArray[Any] | None = None, size: int = 0) -> FloatArray:
    """Return COCO's (b, t) average precision (101 recalls) of one class, for several weightings of the images at once.

    Args:
        matches: Matches of the class.
        weights: (b, i) number of times each image counts, whole numbers; once each by default. Counting an image twice
            equals having it twice, except for the order of detections with equal scores.
        size: Index of the size range.

    Returns:
        The average precision; NaN if a weighting has no object.
    """
    images = matches.objects.shape[1]
    counts = np.ones((1, images), np.int32) if weights is None else np.asarray(weights, np.int32)
    # Detections in images with weight 0, or neutral at every threshold, can be dropped.
    live = np.any(counts, axis=0)[matches.images] & ~matches.neutral[size].all(axis=0)
    right, neutral = (x[size][:, live] for x in (matches.right, matches.neutral))
    of_image = matches.images[live]
    # Precision matters only at hits; false positives at every threshold are counted between them.
    mixed = (right | neutral).any(axis=0)
    special = np.flatnonzero(mixed)
    before = np.cumsum(~mixed)[special]
    wrong_images = of_image[~mixed][: int(before[-1]) if len(before) else 0]
    right = right[:, special]
    neutral = neutral[:, special]
    of = of_image[special]
    thresholds = len(right)
    result = np.full((len(counts), thresholds), np.nan)
    step = max(1, _CELLS // max(len(wrong_images), len(special), 1))
    for start in range(0, len(counts), step):
        w = counts[start : start + step]
        total = (w * matches.objects[size]).sum(axis=1).astype(np.float64)
        some = total > 0
        passed = np.zeros((len(w), len(wrong_images) + 1), np.int32)
        np.cumsum(w[:, wrong_images], axis=1, out=passed[:, 1:])
        base = passed[:, before]
        own = w[:, of]
        for t in range(thresholds):
            ap = np.zeros(len(w))
            if right[t].any():
                hits = np.cumsum(own * right[t], axis=1, dtype=np.int32)
                misses = np.cumsum(own * ~(right[t] | neutral[t]), axis=1, dtype=np.int32) + base
                ap = _area(hits.astype(np.float64), misses.astype(np.float64), np.maximum(total, 1.0))
            result[start : start + step, t] = np.where(some, ap, np.nan)
    return result


def _area(hits: FloatArray, misses: FloatArray, total: FloatArray) -> FloatArray:
    """Return the (b,) mean of the interpolated precision at 101 recalls, from (b, s) cumulative counts."""
    precision = hits / (hits + misses + np.spacing(1.0))
    reached = np.maximum.accumulate(precision[:, ::-1], axis=1)[:, ::-1]
    recall = hits / total[:, None]
    result = np.zeros(len(hits))
    for row in range(len(hits)):
        at = np.searchsorted(recall[row], RECALLS, side="left")
        at = at[at < recall.shape[1]]
        result[row] = reached[row, at].sum() / len(RECALLS)
    return result


def precision_by_recall(matches: ClassMatches) -> FloatArray:
    """Return the (101,) interpolated precision at each recall at IoU 0.5; its mean is the average precision."""
    right = matches.right[0, 0]
    neutral = matches.neutral[0, 0]
    hits, misses = np.cumsum(right), np.cumsum(~right & ~neutral)
    total = int(matches.objects[0].sum())
    curve = np.zeros(len(RECALLS))
    if total and len(hits):
        reached = np.maximum.accumulate((hits / np.maximum(hits + misses, 1))[::-1])[::-1]
        at = np.searchsorted(hits / total, RECALLS, side="left")
        curve[at < len(hits)] = reached[at[at < len(hits)]]
    return curve


def operating_point(all_matches: Sequence[ClassMatches]) -> tuple[float, list[tuple[float, float] | None]]:
    """Return the confidence with the best smoothed mean F1 at IoU 0.5, with precision and recall there.

    Ultralytics chooses the precision and recall that it prints in the same way: one confidence for all classes, among
    1,000 in [0, 1].

    Returns:
        The confidence, and (precision, recall) per class; None for a class without objects.
    """
    curves = [confidence_curves(m) if m.objects[0].sum() else None for m in all_matches]
    known = [c for c in curves if c is not None]
    if not known:
        return 0.0, [None] * len(curves)
    f1 = np.mean([2 * p * r / np.maximum(p + r, 1e-16) for p, r in known], axis=0)
    # Scores below the width of smoothing leave their best at 0, where every detection counts.
    best = int(np.argmax(_smoothed(f1))) or int(np.argmax(f1))
    return float(CONFIDENCES[best]), [None if c is None else (float(c[0][best]), float(c[1][best])) for c in curves]


def confidence_curves(matches: ClassMatches) -> tuple[FloatArray, FloatArray]:
    """Return (1000,) precision and recall at IoU 0.5 of one class by confidence, linear between detections.

    Above the highest score precision is 1 and recall 0; without detections both are 0.
    """
    right = matches.right[0, 0]
    neutral = matches.neutral[0, 0]
    scores = matches.scores[~neutral]
    right = right[~neutral]
    if not len(scores):
        return np.zeros(len(CONFIDENCES)), np.zeros(len(CONFIDENCES))
    hits = np.cumsum(right)
    precision, recall = hits / np.arange(1, len(hits) + 1), hits / matches.objects[0].sum()
    return (
        np.interp(-CONFIDENCES, -scores, precision, left=1.0),
        np.interp(-CONFIDENCES, -scores, recall, left=0.0),
    )


def _smoothed(values: FloatArray) -> FloatArray:
    """Return the moving average over a tenth of the values, with the ends repeated."""
    half = len(values) // 20
    padded = np.pad(values, half, mode="edge")
    return np.asarray(np.convolve(padded, np.full(2 * half + 1, 1 / (2 * half + 1)), mode="valid"))


def drawn_figures(all_matches: Sequence[ClassMatches], weights: NDArray[Any]) -> FloatArray:
    """Return (b, 1 + classes, 2) mAP50 and mAP50-95 per weighting of the images: mean over classes, then each class.

    The mean covers the classes that have objects in the images. A class without objects in a weighting is NaN there,
    and so is the mean if it covers that class: the mean over fewer classes would be a different figure.
    """
    figures = np.full((len(weights), 1 + len(all_matches), len(MEASURES)), np.nan)
    for k, matches in enumerate(all_matches, 1):
        ap = average_precisions(matches, weights)
        figures[:, k, 0], figures[:, k, 1] = ap[:, 0], ap.mean(axis=1)
    there = [k for k, matches in enumerate(all_matches, 1) if matches.objects[0].any()]
    if there:
        figures[:, 0] = figures[:, there].mean(axis=1)
    return figures


def _mean_of(detectors: Sequence[Sequence[ClassMatches]], weights: NDArray[Any], seed: int, side: str) -> FloatArray:
    """Return the (b, 1 + classes, 2) mean of detectors that differ in their seed only, per weighting of the images.

    Each weighting also draws as many of the detectors as there are, with replacement. The mean of k detectors drawn so
    varies by a factor of sqrt((k - 1) / k) too little, so deviations from their mean are enlarged by its inverse.
    """
    each = np.stack([drawn_figures(matches, weights) for matches in detectors])
    k, draws = each.shape[:2]
    if k == 1:
        return np.asarray(each[0])
    mean = each.mean(axis=0)
    drawn = stream(seed, "bootstrap", "detectors", side, k, draws).integers(0, k, (draws, k))
    redrawn = each[drawn, np.arange(draws)[:, None]].mean(axis=1)
    return np.asarray(mean + (redrawn - mean) * np.sqrt(k / (k - 1)))


def paired(
    ours: Sequence[Sequence[ClassMatches]],
    theirs: Sequence[Sequence[ClassMatches]],
    classes: Sequence[str],
    weights: NDArray[Any],
    groups: Sequence[str],
    seed: int = 0,
) -> dict[str, dict[str, Difference | None]]:
    """Return ours minus theirs by class (and `all`), with the interval over the same draws of the same images.

    Args:
        ours: Matches of each detector by class. Several detectors must differ in their seed only; their mean is
            compared, and the draws include the detectors, so that the interval covers the effect of the seed.
        theirs: Matches of the detectors on the other side.
        classes: Names of the classes.
        weights: (draws, i) number of times each image is drawn.
        groups: (i,) group of each image, as used for `weights`.
        seed: Seed for drawing detectors.

    Returns:
        By class and measure `ours`, `theirs`, `difference`, `ci` (None if all objects are in one group), and
        `same_sign`: the share of draws whose difference has the sign of `difference`; None without `ci` or if the
        difference is 0.
    """
    once = np.ones((1, weights.shape[1]), np.int32)
    first, second = (np.mean([drawn_figures(m, once)[0] for m in side], axis=0) for side in (ours, theirs))
    drawn = _mean_of(ours, weights, seed, "ours") - _mean_of(theirs, weights, seed, "theirs")
    held = [m.objects[0] > 0 for m in ours[0]]
    result: dict[str, dict[str, Difference | None]] = {}
    for k, name in enumerate(("all", *classes)):
        result[name] = {}
        several = has_several_groups(held[k - 1] if k else np.any(held, axis=0), groups)
        for m, measure in enumerate(MEASURES):
            if np.isnan(first[k, m]) or np.isnan(second[k, m]):
                result[name][measure] = None
                continue
            difference = float(first[k, m] - second[k, m])
            values = drawn[:, k, m][~np.isnan(drawn[:, k, m])] if several else np.zeros(0)
            signed = len(values) > 0 and difference != 0
            result[name][measure] = {
                "ours": float(first[k, m]),
                "theirs": float(second[k, m]),
                "difference": difference,
                "ci": interval(values),
                "same_sign": float(np.mean(np.sign(values) == np.sign(difference))) if signed else None,
            }
    return result
