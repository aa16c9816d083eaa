"""The camera's local share: how far its grey levels follow the neighbourhood instead of the scene's temperature.

An object's level follows its ring by the camera's local share, plus what object and ground have in common: sunlit
places have sunlit people. The second part is not negative, so each class's slope within images is an upper bound on the
share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeGuard

from infrablend.realism.contrasts import LEVELS, MIN_COMPARED, ObjectContrast, Slope, slope_within_images


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
