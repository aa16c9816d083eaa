"""Comparison of one class: how well, how reliably and by which features inserted objects differ from real ones.

Objects are compared in pairs of similar size, so that size cannot separate the two populations. The distance of two
sets of crops is the squared maximum mean discrepancy (MMD) with the kernel of KID.

Contrasts of annotated and of inserted objects are compared by quantiles, and by how far levels follow the surroundings.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.object_contrast import (
    LEVELS,
    MIN_COMPARED,
    TIMES,
    ObjectContrast,
    Slopes,
    is_enough,
    slope_within_images,
)
from infrablend.core.rng import stream
from infrablend.lab.realism.classify import FOLDS, Kind, Score, auc, group_numbers, score, weights
from infrablend.lab.realism.features import FEATURES, MEASURES, Measured
from infrablend.lab.realism.nets import inception_features, missing, no_inception, score_crops
from infrablend.lab.realism.realism_record import (
    BoxMeasures,
    ClassFacts,
    ContrastCheck,
    ContrastFigures,
    CropScores,
    FeatureDistance,
    FloorScores,
    SeparatingFeature,
    StepScores,
    TimeContrast,
    Validity,
)

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
        facts: Its entry in `realism.json`.
        ablation: Scores per step of the sensor chain; empty if there is none.
        pairs: (real, inserted) pairs, as scored.
        logistic: Score of the logistic classifier on these pairs; None if they are too few for folds.
    """

    category: str
    facts: ClassFacts
    ablation: Mapping[str, StepScores]
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
    logistic = _score(pairs, "logistic")
    boosting = _score(pairs, "boosting")
    partner = {i.key: r for r, i in pairs}
    steps = {
        name: _step_scores(_with_partners(made, partner))
        for name, made in redone.items()
        if name not in ("floor", "hard_paste")
    }
    hard_pairs = _with_partners(hard, {r.key: r for r in reals})
    hard_logistic = _score(hard_pairs, "logistic")
    hard_boosting = _score(hard_pairs, "boosting")
    control = compare_floor(reals, floor)
    facts: ClassFacts = {
        "floor_n": control["floor_n"],
        "floor_logistic": control["floor_logistic"],
        "floor_boosting": control["floor_boosting"],
        "floor_ci": control["floor_ci"],
        "floor_boosting_ci": control["floor_boosting_ci"],
        "n": len(pairs),
        "n_real": len(real),
        "n_inserted": len(inserted),
        "auc_logistic": _auc(logistic),
        "auc_boosting": _auc(boosting),
        "auc_boosting_ci": _interval(boosting),
        "ci": _interval(logistic),
        "hard_paste_n": len(hard_pairs),
        "hard_paste_logistic": _auc(hard_logistic),
        "hard_paste_boosting": _auc(hard_boosting),
        "hard_paste_ci": _interval(hard_logistic),
        "hard_paste_boosting_ci": _interval(hard_boosting),
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
    if "chain_off" in steps:
        facts["chain_off_logistic"] = steps["chain_off"]["auc_logistic"]
        facts["chain_off_boosting"] = steps["chain_off"]["auc_boosting"]
    return ClassComparison(category, facts, steps, pairs, logistic)


def _step_scores(pairs: Pairs) -> StepScores:
    logistic = _score(pairs, "logistic")
    return {
        "n": len(pairs),
        "auc_logistic": _auc(logistic),
        "auc_boosting": _auc(_score(pairs, "boosting")),
        "ci": _interval(logistic),
        "medians": _medians([m for _, m in pairs]),
    }


def compare_floor(real: Sequence[Measured], made: Sequence[Measured]) -> FloorScores:
    """Return the AUCs of untouched objects against the control made of them."""
    pairs = _with_partners(made, {m.key: m for m in real})
    logistic = _score(pairs, "logistic")
    boosting = _score(pairs, "boosting")
    return {
        "floor_n": len(pairs),
        "floor_logistic": _auc(logistic),
        "floor_boosting": _auc(boosting),
        "floor_ci": _interval(logistic),
        "floor_boosting_ci": _interval(boosting),
    }


def _with_partners(made: Sequence[Measured], partner: Mapping[str, Measured]) -> Pairs:
    """Return pairs of the objects without a flaw and those that they were made of, by key."""
    return [(partner[m.key], m) for m in made if not m.flaw and m.key in partner]


def validity(pairs: int, hard_paste: float | None, person_floor: float | None) -> Validity:
    """Return whether a class's figures are valid, and the reasons if they are not.

    Args:
        pairs: Number of pairs of real and inserted objects.
        hard_paste: AUC of the logistic classifier on hard pastes.
        person_floor: AUC of the logistic classifier on people's real control.
    """
    why = []
    if pairs < LEAST_PAIRS:
        why.append(f"{pairs} pairs of real and inserted objects; at least {LEAST_PAIRS} are needed")
    if hard_paste is None or hard_paste < HARD_AT_LEAST:
        found = _show(hard_paste)
        why.append(f"the AUC of hard pastes against real objects is {found}; at least {HARD_AT_LEAST} is needed")
    low, high = FLOOR_RANGE
    if person_floor is None or not low <= person_floor <= high:
        why.append(f"the AUC of people's real control is {_show(person_floor)}; expected {low:.2f} to {high:.2f}")
    return {"valid": not why, "invalid_because": why}


def contrast_ratio(cars: ClassFacts, people: ClassFacts) -> dict[str, float | None]:
    """Return the ratio of cars' to people's median contrast, by population; it does not depend on the gain."""
    found = {}
    for population in ("real", "inserted"):
        car = cars["all_sizes"][population]["centre_minus_ring"]
        person = people["all_sizes"][population]["p95_minus_ring"]
        found[population] = None if car is None or person is None else round(car[2] / person[2], 4)
    return found


def _show(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.3f}"


def _score(pairs: Pairs, kind: Kind) -> Score | None:
    """Return the score of a classifier; None with too few pairs or backgrounds for the folds."""
    return None if _too_few(pairs) else score([r for r, _ in pairs], [o for _, o in pairs], kind)


def _too_few(pairs: Pairs) -> str | None:
    if len(pairs) < 2 * FOLDS or min(len({m.group for m in side}) for side in zip(*pairs, strict=True)) < FOLDS:
        return f"{len(pairs)} pairs on too few backgrounds for {FOLDS} folds"
    return None


def _interval(s: Score | None) -> list[float] | None:
    return None if s is None else [round(v, 4) for v in s.interval]


def _auc(s: Score | None) -> float | None:
    return None if s is None else round(s.auc, 4)


def _medians(objects: Sequence[Measured]) -> dict[str, float | None]:
    found: dict[str, float | None] = {}
    for names, rows in ((FEATURES, [m.features for m in objects]), (MEASURES, [m.measures for m in objects])):
        for k, name in enumerate(names):
            values = [float(r[k]) for r in rows if not math.isnan(r[k])]
            found[name] = round(float(np.median(values)), 4) if values else None
    return found


def _box_measures(objects: Sequence[Measured]) -> BoxMeasures:
    """Return contrasts and levels of objects of all sizes; these need no outline."""
    histogram = np.sum([m.histogram for m in objects], axis=0) if objects else np.zeros(64, np.int64)
    pixels = [m.histogram.sum() for m in objects]
    above = sum(float(m.measures[MEASURES.index("share_above_245")]) * n for m, n in zip(objects, pixels, strict=True))
    return {
        "p95_minus_ring": _quantiles(objects, "p95_minus_ring"),
        "centre_minus_ring": _quantiles(objects, "centre_minus_ring"),
        "share_pixels_above_245": round(above / sum(pixels), 7) if objects else None,
        "level_histogram": [int(n) for n in histogram],
        "flaws": {f: sum(m.flaw == f for m in objects) for f in sorted({m.flaw for m in objects} - {""})},
    }


def _quantiles(objects: Sequence[Measured], measure: str) -> list[float] | None:
    of = [float(m.measures[MEASURES.index(measure)]) for m in objects]
    known = [v for v in of if not math.isnan(v)]
    return [round(float(q), 2) for q in np.percentile(known, [5, 25, 50, 75, 95])] if known else None


def _sizes(real: Sequence[Measured], inserted: Sequence[Measured]) -> dict[str, dict[str, float | None]]:
    """Return numbers of objects and medians of their longer sides by altitude."""
    found: dict[str, dict[str, float | None]] = {}
    for altitude_m in sorted({m.altitude_m for m in (*real, *inserted) if m.altitude_m is not None}):
        of_real = _long_sides_px(real, altitude_m)
        of_inserted = _long_sides_px(inserted, altitude_m)
        found[f"{altitude_m:g}"] = {
            "real_n": len(of_real),
            "real_long_side_px": round(float(np.median(of_real)), 2) if of_real else None,
            "inserted_n": len(of_inserted),
            "inserted_long_side_px": round(float(np.median(of_inserted)), 2) if of_inserted else None,
        }
    return found


def _long_sides_px(objects: Sequence[Measured], altitude_m: float) -> list[float]:
    return [float((m.box_xyxy[2:] - m.box_xyxy[:2]).max()) for m in objects if m.altitude_m == altitude_m]


def _separating_features(real: Sequence[Measured], other: Sequence[Measured]) -> list[SeparatingFeature]:
    a, b = (np.array([m.features for m in objects], np.float64) for objects in (real, other))
    y = np.repeat([0, 1], [len(a), len(b)])
    by_weight = weights(real, other)
    found: list[SeparatingFeature] = []
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


def _cnn(pairs: Pairs, floor: Sequence[Measured]) -> CropScores:
    if reason := missing("torch") or _too_few(pairs):
        return {"skipped": reason}
    s = score_crops([r for r, _ in pairs], [i for _, i in pairs])
    facts: CropScores = {"auc": round(s.auc, 4), "ci": _interval(s)}
    usable = _with_partners(floor, {r.key: r for r, _ in pairs})
    if not _too_few(usable):
        s = score_crops([r for r, _ in usable], [m for _, m in usable])
        facts["floor"] = round(s.auc, 4)
        facts["floor_ci"] = _interval(s)
    return facts


def _kid(real: Sequence[Measured], inserted: Sequence[Measured]) -> FeatureDistance:
    if reason := no_inception(min(len(real), len(inserted))):
        return {"skipped": reason}
    return _feature_distance(real, inception_features(real), inception_features(inserted))


def _distances(real: Sequence[Measured], inserted: Sequence[Measured]) -> FeatureDistance:
    """Return the MMD on cosine coefficients of the crops."""
    if min(len(real) // 2, len(inserted)) < SUBSET:
        return {"skipped": f"{len(real)} pairs; {2 * SUBSET} are needed"}
    a, b = dct_features(real), dct_features(inserted)
    return _feature_distance(real, standardised(a, a), standardised(b, a))


def _feature_distance(real: Sequence[Measured], a: NDArray[np.float64], b: NDArray[np.float64]) -> FeatureDistance:
    """Return the distance of the inserted features `b` from the real `a`, and that of two halves of the real ones."""
    facts: FeatureDistance = {"inserted": [round(v, 6) for v in mmd(a, b)]}
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


QUANTILES = (1, 5, 25, 50, 75, 95)
MAX_SLOPE_DIFFERENCE = 0.15
MIN_LEAST_RATIO = 0.8
MAX_QUARTILE_DIFFERENCE = 0.25


def compare_contrasts(real: Sequence[ObjectContrast], inserted: Sequence[ObjectContrast]) -> dict[str, TimeContrast]:
    """Return the contrast of real and inserted objects of one class by time of day, and the verdicts on them.

    Returns:
        Time of day to `real` and `inserted` (quantiles of contrast and of signal to clutter, and both slopes) and
        `checks`: whether inserted objects are within the limits set by real ones. `slope_high` and `slope_middle` are
        within 0.15 of the real slope. `change_p1` and `change_p5`, the quantiles of the largest change, are at least
        0.8 of the real ones. Objects that are alone in their images have no slope: their quartiles of contrast,
        `signed_p25` to `signed_p75`, are within 25 % of the real ones instead. Each check has `real`, `inserted`,
        `found` (the difference or the ratio), its `ci` if known, `limit` and `holds`, which is None with fewer than 30
        objects on either side. As plain JSON values; times without inserted objects are left out.
    """
    found: dict[str, TimeContrast] = {}
    for time in TIMES:
        sides = [[o for o in side if o.time_of_day == time] for side in (real, inserted)]
        if sides[1]:
            slopes = [{level: slope_within_images(side, level) for level in LEVELS} for side in sides]
            real_figures, inserted_figures = (_figures(*of_side) for of_side in zip(sides, slopes, strict=True))
            checks = _checks(sides[0], sides[1], slopes[0], slopes[1])
            found[time] = {"real": real_figures, "inserted": inserted_figures, "checks": checks}
    return found


def _figures(objects: Sequence[ObjectContrast], slopes: Slopes) -> ContrastFigures:
    return {
        "n": len(objects),
        "images": len({o.image for o in objects}),
        "signed": _contrast_quantiles([o.contrast.signed for o in objects]),
        "change": _contrast_quantiles([o.contrast.change for o in objects]),
        "high_minus_ring": _contrast_quantiles([o.contrast.high - o.contrast.ring for o in objects]),
        "low_minus_ring": _contrast_quantiles([o.contrast.low - o.contrast.ring for o in objects]),
        "ground_level": _contrast_quantiles([o.contrast.ring - o.picture_level for o in objects]),
        "ground_clutter": _contrast_quantiles([o.contrast.clutter for o in objects]),
        "scr": _contrast_quantiles([o.contrast.scr for o in objects], (1, 5, 50), 2),
        "slope": {level: None if slope is None else slope.to_json() for level, slope in slopes.items()},
    }


def _checks(
    real: Sequence[ObjectContrast], inserted: Sequence[ObjectContrast], real_slopes: Slopes, inserted_slopes: Slopes
) -> dict[str, ContrastCheck]:
    checks: dict[str, ContrastCheck] = {}
    enough = min(len(real), len(inserted)) >= MIN_COMPARED
    for level in LEVELS:
        a, b = real_slopes[level], inserted_slopes[level]
        if a is not None and b is not None:
            n = min(len(a.draws), len(b.draws))
            spread = np.percentile(b.draws[:n] - a.draws[:n], [2.5, 97.5])
            difference = b.value - a.value
            checks[f"slope_{level}"] = {
                "real": round(a.value, 3),
                "inserted": round(b.value, 3),
                "found": round(difference, 3),
                "ci": [round(float(v), 3) for v in spread],
                "limit": MAX_SLOPE_DIFFERENCE,
                "holds": abs(difference) <= MAX_SLOPE_DIFFERENCE if is_enough(a) and is_enough(b) else None,
            }
    if not real or not inserted:
        return checks
    for percent in (1, 5):
        checks[f"change_p{percent}"] = _ratio_check(
            [float(np.percentile([o.contrast.change for o in side], percent)) for side in (real, inserted)],
            (MIN_LEAST_RATIO, None),
            enough,
        )
    if not any(name.startswith("slope") for name in checks):
        for percent in (25, 50, 75):
            checks[f"signed_p{percent}"] = _ratio_check(
                [float(np.percentile([o.contrast.signed for o in side], percent)) for side in (real, inserted)],
                (1 - MAX_QUARTILE_DIFFERENCE, 1 + MAX_QUARTILE_DIFFERENCE),
                enough,
            )
    return checks


def _ratio_check(values: Sequence[float], limits: tuple[float, float | None], enough: bool) -> ContrastCheck:
    real, inserted = values
    ratio = inserted / real if real else None
    low, high = limits
    within = ratio is not None and ratio >= low and (high is None or ratio <= high)
    return {
        "real": round(real, 2),
        "inserted": round(inserted, 2),
        "found": None if ratio is None else round(ratio, 3),
        "limit": low if high is None else [low, high],
        "holds": within if enough and ratio is not None else None,
    }


def _contrast_quantiles(
    values: Sequence[float], percents: Sequence[int] = QUANTILES, digits: int = 1
) -> dict[str, float]:
    if not values:
        return {}
    found = np.percentile(values, percents)
    return {f"p{percent}": round(float(v), digits) for percent, v in zip(percents, found, strict=True)}
