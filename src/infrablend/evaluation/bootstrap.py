"""How sure the figures are: the images (or whole sequences) drawn again and again, with replacement."""

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
    """(draws, i) how often each image is drawn; as many groups are drawn as there are, all images of one together."""
    names, number = np.unique(np.array(groups, dtype=np.str_), return_inverse=True)
    rng = stream(seed, "bootstrap", draws, len(names))
    drawn = rng.integers(0, len(names), (draws, len(names)))
    counts = np.zeros((draws, len(names)), np.int32)
    np.add.at(counts, (np.arange(draws)[:, None], drawn), 1)
    return np.asarray(counts[:, number], np.int32)


def drawn_figures(all_matches: Sequence[ClassMatches], weights: NDArray[Any]) -> FloatArray:
    """(b, 1 + classes, 2) mAP50 and mAP50-95 for each weighting of the images: the mean of the classes, then each.

    The mean is over the classes that the images have objects of. NaN where a class has none, and so the mean of a
    weighting that lacks one of those: the mean of other classes would be another figure.
    """
    figures = np.full((len(weights), 1 + len(all_matches), len(MEASURES)), np.nan)
    for k, matches in enumerate(all_matches, 1):
        ap = average_precisions(matches, weights)
        figures[:, k, 0], figures[:, k, 1] = ap[:, 0], ap.mean(axis=1)
    there = [k for k, matches in enumerate(all_matches, 1) if matches.objects[0].any()]
    if there:
        figures[:, 0] = figures[:, there].mean(axis=1)
    return figures


def several_groups(images: NDArray[np.bool_], groups: Sequence[str]) -> bool:
    """Whether the images chosen by (i,) are of two groups at least: drawing from one gives the same again and again."""
    return len({groups[k] for k in np.flatnonzero(images)}) > 1


def interval(values: FloatArray) -> list[float] | None:
    """Return the middle 95 % of drawn values, NaN left out; None if there are none."""
    known = values[~np.isnan(values)]
    if not len(known):
        return None
    low, high = np.quantile(known, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return [float(low), float(high)]


def _mean_of(detectors: Sequence[Sequence[ClassMatches]], weights: NDArray[Any], seed: int, side: str) -> FloatArray:
    """(b, 1 + classes, 2) the mean of detectors trained alike but for the seed, for each weighting of the images.

    Of several, as many are drawn with replacement each time. The mean of k so drawn scatters by a factor of
    sqrt((k - 1) / k) too little; what they differ by is made larger by that.
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
    """Ours minus theirs by class (and `all`), with the interval over the same draws of the same images.

    Args:
        ours: The matches of a detector by class; of several, trained alike but for the seed, the mean is taken and
            they are drawn, too, so that the interval holds what another seed would change.
        theirs: Likewise.
        classes: Their names.
        weights: (draws, i) how often each image is drawn.
        groups: (i,) of each image, that the draws were made of.
        seed: For drawing detectors.

    Returns:
        By class and measure `ours`, `theirs`, `difference`, `ci` (None if all objects are of one group), and
        `same_sign`: the share of the draws in which the difference has the sign of the undrawn one; None without `ci`,
        and if there is no difference, as zero has no sign.
    """
    once = np.ones((1, weights.shape[1]), np.int32)
    first, second = (np.mean([drawn_figures(m, once)[0] for m in side], axis=0) for side in (ours, theirs))
    drawn = _mean_of(ours, weights, seed, "ours") - _mean_of(theirs, weights, seed, "theirs")
    held = [m.objects[0] > 0 for m in ours[0]]
    result: dict[str, dict[str, Any]] = {}
    for k, name in enumerate(("all", *classes)):
        result[name] = {}
        several = several_groups(held[k - 1] if k else np.any(held, axis=0), groups)
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
