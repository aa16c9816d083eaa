"""Contrast of annotated and of inserted objects side by side: quantiles, and how far levels follow the surroundings.

Quantiles show whether objects stand out as much as real ones; `compositing.object_contrast` explains the slopes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from infrablend.compositing.object_contrast import (
    LEVELS,
    MIN_COMPARED,
    TIMES,
    ObjectContrast,
    Slopes,
    is_enough,
    slope_within_images,
)
from infrablend.lab.realism.realism_record import ContrastCheck, ContrastFigures, TimeContrast

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
        "signed": _quantiles([o.contrast.signed for o in objects]),
        "change": _quantiles([o.contrast.change for o in objects]),
        "high_minus_ring": _quantiles([o.contrast.high - o.contrast.ring for o in objects]),
        "low_minus_ring": _quantiles([o.contrast.low - o.contrast.ring for o in objects]),
        "ground_level": _quantiles([o.contrast.ring - o.picture_level for o in objects]),
        "ground_clutter": _quantiles([o.contrast.clutter for o in objects]),
        "scr": _quantiles([o.contrast.scr for o in objects], (1, 5, 50), 2),
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


def _quantiles(values: Sequence[float], percents: Sequence[int] = QUANTILES, digits: int = 1) -> dict[str, float]:
    if not values:
        return {}
    found = np.percentile(values, percents)
    return {f"p{percent}": round(float(v), digits) for percent, v in zip(percents, found, strict=True)}
