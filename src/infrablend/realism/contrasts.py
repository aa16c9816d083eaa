"""Contrast of annotated and of inserted objects side by side: quantiles, and how far levels follow the surroundings.

The slope within images shows whether an object's level moves with the ground that it stands on: 1 if it does, 0 if
objects look the same everywhere in a picture. Quantiles show whether objects stand out as much as real ones.

An object's level follows its ring by the camera's local share, plus what object and ground have in common: sunlit
places have sunlit people. The second part is not negative, so each class's slope within images is an upper bound on the
share.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeGuard, get_args

import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.contrast import Contrast, measure_contrast, near_edge
from infrablend.core.dataset import Instance
from infrablend.core.rng import stream
from infrablend.realism.features import LEAST_PX, Picture

Level = Literal["high", "middle"]
LEVELS: tuple[Level, ...] = get_args(Level)
TIMES = ("night", "day", "dusk", "dawn", "unknown")

QUANTILES = (1, 5, 25, 50, 75, 95)
UNCLIPPED = (22.0, 225.0)
"""Levels at or beyond these count as clipped and have no slope."""
MIN_IN_IMAGE = 3
"""Fewest unclipped objects of an image that the slope is read from."""
MIN_COMPARED = 30
"""Fewest objects on either side for a verdict."""
MAX_SLOPE_DIFFERENCE = 0.15
MIN_LEAST_RATIO = 0.8
MAX_QUARTILE_DIFFERENCE = 0.25
_BOOTSTRAPS = 1000


@dataclass(frozen=True)
class ObjectContrast:
    """Contrast of one object.

    Attributes:
        category: Class of the object.
        image: Key of the picture.
        time_of_day: `night`, `day`, `dusk`, `dawn` or `unknown`.
        contrast: Its contrast against the ring around its box.
        picture_level: Median level of the picture, 8-bit levels.
    """

    category: str
    image: str
    time_of_day: str
    contrast: Contrast
    picture_level: float


def object_contrast(picture: Picture, instance: Instance, labels: Sequence[Instance]) -> Contrast | None:
    """Measure the contrast of an object, or return None for small objects and those near the frame's edge.

    Args:
        picture: (h, w) in 8-bit levels.
        instance: Label of the object.
        labels: All labels of the picture; their boxes are left out of the ring.
    """
    x0, y0, x1, y1 = instance.box_xyxy
    if max(x1 - x0, y1 - y0) < LEAST_PX or near_edge(instance.box_xyxy, picture.shape):
        return None
    return measure_contrast(picture, instance.box_xyxy, [i.box_xyxy for i in labels if i is not instance])


@dataclass(frozen=True, eq=False)
class Slope:
    """Slope of the objects' level over the level of their rings, within images.

    Attributes:
        value: The slope.
        draws: (k,) slopes of resampled images; without those where it is undefined.
        objects: Number of objects that it is read from.
        images: Number of images that these are in.
    """

    value: float
    draws: NDArray[np.float64]
    objects: int
    images: int

    @property
    def interval(self) -> tuple[float, float]:
        """2.5 and 97.5 % quantile over resampled images."""
        low, high = np.percentile(self.draws, [2.5, 97.5])
        return float(low), float(high)

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        low, high = self.interval
        return {
            "slope": round(self.value, 3),
            "ci": [round(low, 3), round(high, 3)],
            "objects": self.objects,
            "images": self.images,
        }


Slopes = Mapping[Level, Slope | None]


def slope_within_images(objects: Sequence[ObjectContrast], level: Level) -> Slope | None:
    """Return the slope of objects over their rings, or None if no image has enough unclipped objects.

    Deviations from each image's own means are summed over all images: (ring - mean)(level - mean) over
    (ring - mean) squared.

    Args:
        objects: Objects of one class and time of day.
        level: `high`, the 95 % quantile of the box, or `middle`, the median of its central half.
    """
    images: dict[str, list[tuple[float, float]]] = {}
    for o in objects:
        of_object = getattr(o.contrast, level)
        if UNCLIPPED[0] < of_object < UNCLIPPED[1]:
            images.setdefault(o.image, []).append((o.contrast.ring, of_object))
    sums, count = [], 0
    for _, pairs in sorted(images.items()):
        if len(pairs) >= MIN_IN_IMAGE:
            ring, of_object = (np.array(side) - np.mean(side) for side in zip(*sorted(pairs), strict=True))
            sums.append((ring @ of_object, ring @ ring))
            count += len(pairs)
    both, squared = np.array(sums, np.float64).reshape(-1, 2).T
    if not squared.sum() > 0:
        return None
    drawn = stream(0, "slope").integers(0, len(sums), (_BOOTSTRAPS, len(sums)))
    below = squared[drawn].sum(axis=1)
    draws = both[drawn].sum(axis=1)[below > 0] / below[below > 0]
    return Slope(float(both.sum() / squared.sum()), draws, count, len(sums))


def compare_contrasts(
    real: Sequence[ObjectContrast], inserted: Sequence[ObjectContrast]
) -> dict[str, dict[str, dict[str, Any]]]:
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
    found = {}
    for time in TIMES:
        sides = [[o for o in side if o.time_of_day == time] for side in (real, inserted)]
        if sides[1]:
            slopes = [{level: slope_within_images(side, level) for level in LEVELS} for side in sides]
            real_figures, inserted_figures = (_figures(*of_side) for of_side in zip(sides, slopes, strict=True))
            checks = _checks(sides[0], sides[1], slopes[0], slopes[1])
            found[time] = {"real": real_figures, "inserted": inserted_figures, "checks": checks}
    return found


def _figures(objects: Sequence[ObjectContrast], slopes: Slopes) -> dict[str, Any]:
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
) -> dict[str, dict[str, Any]]:
    checks: dict[str, dict[str, Any]] = {}
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
                "holds": abs(difference) <= MAX_SLOPE_DIFFERENCE if _is_enough(a) and _is_enough(b) else None,
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


def _ratio_check(values: Sequence[float], limits: tuple[float, float | None], enough: bool) -> dict[str, Any]:
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


def bound_local_share(objects: Sequence[ObjectContrast]) -> dict[str, Any] | None:
    """Return the upper bound that annotated objects of one time of day set on the camera's local share.

    Returns:
        `classes` (class to `high` and `middle`: slope, interval, objects, images); `upper_bound`, the smallest slope of
        a class, with its `ci`; and `recommended` for recipes with its `recommended_ci`, the common slope of the middles
        of all classes within 0 to 1. The latter includes what object and ground have in common, which inserted objects
        lack. As plain JSON values; None if no class has 30 unclipped objects.
    """
    classes: dict[str, dict[str, Any]] = {}
    for category in sorted({o.category for o in objects}):
        of_class = [o for o in objects if o.category == category]
        slopes = {level: slope_within_images(of_class, level) for level in LEVELS}
        enough = {str(level): s.to_json() for level, s in slopes.items() if _is_enough(s)}
        if enough:
            classes[category] = enough
    # Deviations from the means of each class in each image, so that differences between classes do not count.
    common = slope_within_images([replace(o, image=f"{o.category} {o.image}") for o in objects], "middle")
    if not classes or not _is_enough(common):
        return None
    least = min((s for of_class in classes.values() for s in of_class.values()), key=lambda s: s["slope"])
    return {
        "classes": classes,
        "upper_bound": least["slope"],
        "ci": least["ci"],
        "recommended": round(min(max(common.value, 0.0), 1.0), 2),
        "recommended_ci": [round(v, 3) for v in common.interval],
    }


def _is_enough(slope: Slope | None) -> TypeGuard[Slope]:
    return slope is not None and slope.objects >= MIN_COMPARED
