"""Bootstrap intervals: images, or whole sequences, drawn repeatedly with replacement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.rng import stream
from infrablend.evaluation.detections import FloatArray
from infrablend.evaluation.matching import ClassMatches
from infrablend.evaluation.precision import average_precisions

LEVEL = 0.95
MEASURES = ("map50", "map50_95")


def draw_images(groups: Sequence[str], draws: int, seed: int) -> NDArray[np.int32]:
    """Return the (draws, i) number of times each image is drawn.

    Each draw takes as many groups as there are, with all their images.
    """
    names, number = np.unique(np.array(groups, dtype=np.str_), return_inverse=True)
    rng = stream(seed, "bootstrap", draws, len(names))
    drawn = rng.integers(0, len(names), (draws, len(names)))
    counts = np.zeros((draws, len(names)), np.int32)
    np.add.at(counts, (np.arange(draws)[:, None], drawn), 1)
    return np.asarray(counts[:, number], np.int32)


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


def has_several_groups(images: NDArray[np.bool_], groups: Sequence[str]) -> bool:
    """Whether the images chosen by (i,) are of two groups at least: drawing from one gives the same again and again."""
    return len({groups[k] for k in np.flatnonzero(images)}) > 1


def interval(values: FloatArray) -> list[float] | None:
    """Return the ends of the middle 95 % of drawn values without NaN; None if no value is left."""
    known = values[~np.isnan(values)]
    if not len(known):
        return None
    low, high = np.quantile(known, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return [float(low), float(high)]


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
) -> dict[str, dict[str, Any]]:
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
    result: dict[str, dict[str, Any]] = {}
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
