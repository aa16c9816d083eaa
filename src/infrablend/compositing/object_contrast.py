"""Contrast of annotated objects against the ground around them, and how far their levels follow it.

The slope within images shows whether an object's level moves with the ground that it stands on: 1 if it does, 0 if
objects look the same everywhere in a picture.

An object's level follows its ring by the camera's local share, plus what object and ground have in common: sunlit
places have sunlit people. The second part is not negative, so each class's slope within images is an upper bound on the
share.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypedDict, TypeGuard, get_args

import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.contrast import Contrast, measure_contrast, near_edge
from infrablend.core.dataset import Instance
from infrablend.core.rng import stream

Level = Literal["high", "middle"]
LEVELS: tuple[Level, ...] = get_args(Level)
TIMES = ("night", "day", "dusk", "dawn", "unknown")
Picture = NDArray[np.float32]

LEAST_PX = 8
"""Smallest longer side of an object, px."""
UNCLIPPED = (22.0, 225.0)
"""Levels at or beyond these count as clipped and have no slope."""
MIN_IN_IMAGE = 3
"""Fewest unclipped objects of an image that the slope is read from."""
MIN_COMPARED = 30
"""Fewest objects for a verdict."""
_BOOTSTRAPS = 1000


def eight_bit(pixels: NDArray[np.uint8] | NDArray[np.uint16], levels: tuple[float, float]) -> Picture:
    """Return the picture in 8-bit levels; for 16 bit, the dataset's `levels` become 16 and 235."""
    if pixels.dtype == np.uint8:
        return pixels.astype(np.float32)
    low, high = levels
    return ((pixels.astype(np.float32) - np.float32(low)) * np.float32(219.0 / (high - low)) + 16).astype(np.float32)


def from_eight_bit(
    picture: Picture, dtype: np.dtype[Any], levels: tuple[float, float]
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Return a picture in 8-bit levels as pixels of a file's own type and levels; the inverse of `eight_bit`."""
    if dtype == np.uint8:
        return np.asarray(np.clip(np.rint(picture), 0, 255).astype(np.uint8))
    low, high = levels
    own = (picture.astype(np.float64) - 16) * (high - low) / 219 + low
    return np.asarray(np.clip(np.rint(own), 0, 65535).astype(np.uint16))


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


class SlopeFigures(TypedDict):
    """The figures of a slope with its 95 % interval, rounded."""

    slope: float
    ci: list[float]
    objects: int
    images: int


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

    def to_json(self) -> SlopeFigures:
        """Return plain JSON values."""
        low, high = self.interval
        return {
            "slope": round(self.value, 3),
            "ci": [round(low, 3), round(high, 3)],
            "objects": self.objects,
            "images": self.images,
        }


class LocalShareBound(TypedDict):
    """What annotated objects say of the local share, as plain JSON values; see `bound_local_share`."""

    classes: dict[str, dict[str, object]]
    upper_bound: float
    ci: list[float]
    recommended: float
    recommended_ci: list[float]


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
    sums = []
    count = 0
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


def bound_local_share(objects: Sequence[ObjectContrast]) -> LocalShareBound | None:
    """Return the upper bound that annotated objects of one time of day set on the camera's local share.

    Returns:
        `classes` (class to `high` and `middle`: slope, interval, objects, images); `upper_bound`, the smallest slope of
        a class, with its `ci`; and `recommended` for recipes with its `recommended_ci`, the common slope of the middles
        of all classes within 0 to 1. The latter includes what object and ground have in common, which inserted objects
        lack. As plain JSON values; None if no class has 30 unclipped objects.
    """
    classes: dict[str, dict[str, object]] = {}
    found: list[Slope] = []
    for category in sorted({o.category for o in objects}):
        of_class = [o for o in objects if o.category == category]
        slopes = {level: slope_within_images(of_class, level) for level in LEVELS}
        enough = {str(level): s for level, s in slopes.items() if is_enough(s)}
        if enough:
            classes[category] = {level: s.to_json() for level, s in enough.items()}
            found += enough.values()
    # Deviations from the means of each class in each image, so that differences between classes do not count.
    common = slope_within_images([replace(o, image=f"{o.category} {o.image}") for o in objects], "middle")
    if not classes or not is_enough(common):
        return None
    least = min(found, key=lambda s: round(s.value, 3))
    return {
        "classes": classes,
        "upper_bound": round(least.value, 3),
        "ci": [round(v, 3) for v in least.interval],
        "recommended": round(min(max(common.value, 0.0), 1.0), 2),
        "recommended_ci": [round(v, 3) for v in common.interval],
    }


def is_enough(slope: Slope | None) -> TypeGuard[Slope]:
    """Return whether a slope is read from enough objects for a verdict."""
    return slope is not None and slope.objects >= MIN_COMPARED
