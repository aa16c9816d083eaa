"""Comparison of one class: how well, how reliably and by which features inserted objects differ from real ones.

Objects are compared in pairs of similar size, so that size cannot separate the two populations. The distance of two
sets of crops is the squared maximum mean discrepancy (MMD) with the kernel of KID.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.rng import stream
from infrablend.lab.realism.classify import FOLDS, Score, auc, group_numbers, score, weights
from infrablend.lab.realism.features import FEATURES, MEASURES, Measured
from infrablend.lab.realism.nets import inception_features, missing, no_inception, score_crops

LEAST_PAIRS = 500
HARD_AT_LEAST = 0.99
FLOOR_RANGE = (0.70, 0.80)

Pairs = Sequence[tuple[Measured, Measured]]
# Crops of a subset of the MMD, subsets, and side of the block of lowest frequencies.
SUBSET = 100
SUBSETS = 100
_SIDE = 8
# Largest difference in size of a pair.
CALIPER_OCTAVES = 0.25


@dataclass(frozen=True, eq=False)
class ClassComparison:
    """The comparison of one class.

    Attributes:
        category: The class.
        facts: Plain JSON values, documented in docs/how_to/measure_realism.md.
        ablation: Scores per step of the sensor chain; empty if there is none.
        pairs: (real, inserted) pairs, as scored.
        logistic: Score of the logistic classifier on these pairs; None if they are too few for folds.
    """

    category: str
    facts: dict[str, Any]
    ablation: dict[str, Any]
    pairs: Pairs
    logistic: Score | None


def compare_class(
    category: str,
    real: Sequence[Measured],
    inserted: Sequence[Measured],
    pairs: Pairs,
    redone: Mapping[str, Sequence[Measured]],
) -> ClassComparison:
    """Compare the objects of one class.

    `redone` are objects measured again, by population: `floor` and `hard_paste` (with the keys of the pairs' real
    objects), steps of the sensor chain (with the keys of the inserted ones).
    """
    reals = [r for r, _ in pairs]
    inserts = [i for _, i in pairs]
    floor = redone.get("floor", ())
    hard = redone.get("hard_paste", ())
    logistic, boosting = _both_scores(pairs)
    partner = {i.key: r for r, i in pairs}
    steps: dict[str, Any] = {}
    for step in (s for s in redone if s not in ("floor", "hard_paste")):
        usable = _with_partners(redone[step], partner)
        scores = _scores("auc", *_both_scores(usable))
        steps[step] = {
            "n": len(usable),
            "auc_logistic": scores["auc_logistic"],
            "auc_boosting": scores["auc_boosting"],
            "ci": scores["auc_ci"],
            "medians": _medians([m for _, m in usable]),
        }
    off = {
        f"chain_off_{kind}": steps["chain_off"][f"auc_{kind}"]
        for kind in ("logistic", "boosting")
        if "chain_off" in steps
    }
    facts = {
        "n": len(pairs),
        "n_real": len(real),
        "n_inserted": len(inserted),
        **_scores("auc", logistic, boosting),
        "ci": _interval(logistic),
        **compare_control("floor", reals, floor),
        **compare_control("hard_paste", reals, hard),
        **off,
        "medians": {
            "real": _medians(reals),
            "inserted": _medians(inserts),
            "floor": _medians([m for m in floor if not m.flaw]),
            "hard_paste": _medians([m for m in hard if not m.flaw]),
        },
        "all_sizes": {"real": _box_measures(real), "inserted": _box_measures(inserted)},
        "size_by_altitude": _sizes(real, inserted),
        "separating_features": [] if logistic is None else _separating_features(reals, inserts),
        "cnn": _cnn(pairs, floor),
        "mmd_dct": _distances(reals, inserts),
        "kid": _kid(reals, inserts),
    }
    del facts["auc_ci"]
    return ClassComparison(category, facts, steps, pairs, logistic)


def compare_control(name: str, real: Sequence[Measured], made: Sequence[Measured]) -> dict[str, Any]:
    """Return the AUCs of untouched objects against a control made of them."""
    usable = _with_partners(made, {m.key: m for m in real})
    return {f"{name}_n": len(usable), **_scores(name, *_both_scores(usable))}


def _with_partners(made: Sequence[Measured], partner: Mapping[str, Measured]) -> Pairs:
    """Return pairs of the objects without a flaw and those that they were made of, by key."""
    return [(partner[m.key], m) for m in made if not m.flaw and m.key in partner]


def validity(facts: Mapping[str, Any], person_floor: float | None) -> dict[str, Any]:
    """Return whether a class's figures are valid, and the reasons if they are not."""
    why = []
    if facts["n"] < LEAST_PAIRS:
        why.append(f"{facts['n']} pairs of real and inserted objects; at least {LEAST_PAIRS} are needed")
    hard = facts["hard_paste_logistic"]
    if hard is None or hard < HARD_AT_LEAST:
        why.append(f"the AUC of hard pastes against real objects is {_show(hard)}; at least {HARD_AT_LEAST} is needed")
    low, high = FLOOR_RANGE
    if person_floor is None or not low <= person_floor <= high:
        why.append(f"the AUC of people's real control is {_show(person_floor)}; expected {low:.2f} to {high:.2f}")
    return {"valid": not why, "invalid_because": why}


def contrast_ratio(cars: Mapping[str, Any], people: Mapping[str, Any]) -> dict[str, float | None]:
    """Return the ratio of cars' to people's median contrast, by population; it does not depend on the gain."""
    found = {}
    for population in ("real", "inserted"):
        car = cars["all_sizes"][population]["centre_minus_ring"]
        person = people["all_sizes"][population]["p95_minus_ring"]
        found[population] = None if car is None or person is None else round(car[2] / person[2], 4)
    return found


def _show(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.3f}"


def _both_scores(pairs: Pairs) -> tuple[Score | None, Score | None]:
    """Return the scores of both classifiers; None where there are too few pairs or backgrounds for the folds."""
    if _too_few(pairs):
        return None, None
    real = [r for r, _ in pairs]
    other = [o for _, o in pairs]
    return score(real, other, "logistic"), score(real, other, "boosting")


def _too_few(pairs: Pairs) -> str | None:
    if len(pairs) < 2 * FOLDS or min(len({m.group for m in side}) for side in zip(*pairs, strict=True)) < FOLDS:
        return f"{len(pairs)} pairs on too few backgrounds for {FOLDS} folds"
    return None


def _interval(s: Score | None) -> list[float] | None:
    return None if s is None else [round(v, 4) for v in s.interval]


def _scores(name: str, logistic: Score | None, boosting: Score | None) -> dict[str, Any]:
    return {
        f"{name}_logistic": None if logistic is None else round(logistic.auc, 4),
        f"{name}_boosting": None if boosting is None else round(boosting.auc, 4),
        f"{name}_ci": _interval(logistic),
        f"{name}_boosting_ci": _interval(boosting),
    }


def _medians(objects: Sequence[Measured]) -> dict[str, float | None]:
    found: dict[str, float | None] = {}
    for names, rows in ((FEATURES, [m.features for m in objects]), (MEASURES, [m.measures for m in objects])):
        for k, name in enumerate(names):
            values = [float(r[k]) for r in rows if not math.isnan(r[k])]
            found[name] = round(float(np.median(values)), 4) if values else None
    return found


def _box_measures(objects: Sequence[Measured]) -> dict[str, Any]:
    """Return contrasts and levels of objects of all sizes; these need no outline."""
    contrast = {
        name: [float(m.measures[k]) for m in objects if not math.isnan(m.measures[k])]
        for k, name in enumerate(MEASURES[:2])
    }
    histogram = np.sum([m.histogram for m in objects], axis=0) if objects else np.zeros(64, np.int64)
    pixels = [m.histogram.sum() for m in objects]
    above = sum(float(m.measures[MEASURES.index("share_above_245")]) * n for m, n in zip(objects, pixels, strict=True))
    return {
        **{
            name: None if not v else [round(float(q), 2) for q in np.percentile(v, [5, 25, 50, 75, 95])]
            for name, v in contrast.items()
        },
        "share_pixels_above_245": round(above / sum(pixels), 7) if objects else None,
        "level_histogram": [int(n) for n in histogram],
        "flaws": {f: sum(m.flaw == f for m in objects) for f in sorted({m.flaw for m in objects} - {""})},
    }


def _sizes(real: Sequence[Measured], inserted: Sequence[Measured]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for a in sorted({m.altitude_m for m in (*real, *inserted) if m.altitude_m is not None}):
        at_height = found[f"{a:g}"] = {}
        for name, objects in (("real", real), ("inserted", inserted)):
            sides = [float((m.box_xyxy[2:] - m.box_xyxy[:2]).max()) for m in objects if m.altitude_m == a]
            at_height[f"{name}_n"] = len(sides)
            at_height[f"{name}_long_side_px"] = round(float(np.median(sides)), 2) if sides else None
    return found


def _separating_features(real: Sequence[Measured], other: Sequence[Measured]) -> list[dict[str, Any]]:
    a, b = (np.array([m.features for m in objects], np.float64) for objects in (real, other))
    y = np.repeat([0, 1], [len(a), len(b)])
    by_weight = weights(real, other)
    found = []
    for k, name in enumerate(FEATURES):
        alone = auc(y, np.concatenate([a[:, k], b[:, k]]))
        found.append(
            {
                "feature": name,
                "auc": round(max(alone, 1 - alone), 4),
                "inserted_is": "larger" if alone >= 0.5 else "smaller",
                "real": [round(float(v), 4) for v in np.percentile(a[:, k], [25, 50, 75])],
                "inserted": [round(float(v), 4) for v in np.percentile(b[:, k], [25, 50, 75])],
                "weight": round(by_weight[name], 3),
            }
        )
    return sorted(found, key=lambda f: (-f["auc"], f["feature"]))


def _cnn(pairs: Pairs, floor: Sequence[Measured]) -> dict[str, Any]:
    if reason := missing("torch") or _too_few(pairs):
        return {"skipped": reason}
    s = score_crops([r for r, _ in pairs], [i for _, i in pairs])
    facts: dict[str, Any] = {"auc": round(s.auc, 4), "ci": _interval(s)}
    usable = _with_partners(floor, {r.key: r for r, _ in pairs})
    if not _too_few(usable):
        s = score_crops([r for r, _ in usable], [m for _, m in usable])
        facts |= {"floor": round(s.auc, 4), "floor_ci": _interval(s)}
    return facts


def _kid(real: Sequence[Measured], inserted: Sequence[Measured]) -> dict[str, Any]:
    if reason := no_inception(min(len(real), len(inserted))):
        return {"skipped": reason}
    return _feature_distance(real, inception_features(real), inception_features(inserted))


def _distances(real: Sequence[Measured], inserted: Sequence[Measured]) -> dict[str, Any]:
    """Return the MMD on cosine coefficients of the crops."""
    if min(len(real) // 2, len(inserted)) < SUBSET:
        return {"skipped": f"{len(real)} pairs; {2 * SUBSET} are needed"}
    a, b = dct_features(real), dct_features(inserted)
    return _feature_distance(real, standardised(a, a), standardised(b, a))


def _feature_distance(real: Sequence[Measured], a: NDArray[np.float64], b: NDArray[np.float64]) -> dict[str, Any]:
    """Return the distance of the inserted features `b` from the real `a`, and that of two halves of the real ones."""
    facts = {"inserted": [round(v, 6) for v in mmd(a, b)]}
    half = group_numbers(real) % 2 == 0
    if min(half.sum(), (~half).sum()) >= SUBSET:
        facts["real_halves"] = [round(v, 6) for v in mmd(a[half], a[~half])]
    return facts


def dct_features(crops: Sequence[Measured]) -> NDArray[np.float64]:
    """Return the (n, 64) lowest frequencies of the cosine transform of each 48 px crop."""
    return np.array(
        [cv2.dct(m.patch.astype(np.float64) / 255.0)[:_SIDE, :_SIDE].ravel() for m in crops], np.float64
    ).reshape(len(crops), _SIDE * _SIDE)


def mmd(a: NDArray[np.float64], b: NDArray[np.float64]) -> tuple[float, float]:
    """Return mean and standard deviation of the unbiased MMD^2 over subsets of 100 crops, of which each side has more.

    The kernel is (x.y / d + 1)^3, and the features are used without scaling.
    """
    rng = stream(0, "mmd")
    found = []
    for _ in range(SUBSETS):
        x = a[rng.choice(len(a), SUBSET, replace=False)]
        y = b[rng.choice(len(b), SUBSET, replace=False)]
        xx, yy, xy = (_kernel(p, q) for p, q in ((x, x), (y, y), (x, y)))
        n = SUBSET
        within = (xx.sum() - np.trace(xx) + yy.sum() - np.trace(yy)) / (n * (n - 1))
        found.append(within - 2 * xy.mean())
    return float(np.mean(found)), float(np.std(found))


def standardised(features: NDArray[np.float64], like: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return features minus the mean of `like`, divided by its standard deviation."""
    deviation = like.std(axis=0)
    return np.asarray((features - like.mean(axis=0)) / np.where(deviation > 0, deviation, 1), np.float64)


def _kernel(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray((x @ y.T / x.shape[1] + 1) ** 3, np.float64)


def pair_by_size(real: Sequence[Measured], inserted: Sequence[Measured], most: int) -> list[tuple[Measured, Measured]]:
    """Return (real, inserted) pairs whose box heights differ by at most a quarter of an octave.

    In random order, each inserted object is paired with the unused real one nearest in height, so both sides have the
    same distribution of sizes. Each object is in one pair at most; those without a partner or with a flaw are left out.
    """
    rest = sorted((math.log2(m.height_px), m.key, m) for m in real if not m.flaw)
    usable = sorted((m for m in inserted if not m.flaw), key=lambda m: m.key)
    order = stream(0, "pairs").permutation(len(usable))
    pairs: list[tuple[Measured, Measured]] = []
    for k in order:
        if len(pairs) == most:
            break
        m = usable[int(k)]
        size = math.log2(m.height_px)
        at = bisect.bisect_left(rest, (size, ""))
        near = [i for i in (at - 1, at) if 0 <= i < len(rest)]
        if not near:
            break
        best = min(near, key=lambda i: abs(rest[i][0] - size))
        if abs(rest[best][0] - size) <= CALIPER_OCTAVES:
            pairs.append((rest.pop(best)[2], m))
    return pairs
