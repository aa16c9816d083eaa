"""Measures the looseness of boxes: how much larger a box is than what can be seen of its object.

`annotation.looseness` draws boxes of inserted objects with a looseness that was found here.

The visible extent is where a picture differs from the surroundings by more than half of the object's contrast. Blur
and parts without contrast make it smaller or larger than the object itself. Inserted objects, whose boxes are exact,
show by how much; measured against those, the looseness of drawn boxes no longer depends on it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.contrast import Contrast
from infrablend.compositing.object_contrast import ObjectContrast, Picture
from infrablend.core.dataset import Instance
from infrablend.core.outline import region_beyond_half
from infrablend.core.rng import stream

MIN_BOXES = 30
"""Fewest boxes of a class for a figure."""
MIN_REFERENCE = 10
"""Fewest inserted objects of similar extent that a drawn box is compared with."""
MIN_CHANGE = 10.0
"""Objects with less contrast, 8-bit levels, have no extent."""
MAX_OTHER_END = 0.5
"""Objects whose other end is farther beyond the ring, as a share of the largest change, have no single outline."""
EXACT_FACTOR = 1.1
"""Factor from visible extent to exact box, where some parts have no contrast: 1.11 for inserted people, and 1.09 for
cars. A margin needs no such correction: for inserted drones, which have a glow, it is -0.1 px."""
MIN_GAIN = 0.04
"""How much less spread a margin has to leave than a factor: exact boxes of people give 0.01, as the extents of small
objects are inexact; drawn ones 0.02 or less (people, cars), or 0.06 or more (Anti-UAV, Halmstad)."""
_BOOTSTRAPS = 1000


@dataclass(frozen=True)
class BoxExtent:
    """The box and the visible extent of an object.

    Attributes:
        category: Class of the object.
        image: Key of the picture.
        time_of_day: `night`, `day`, `dusk`, `dawn` or `unknown`.
        box_wh: Width and height of the box, px.
        extent_wh: Width and height of what can be seen, px.
    """

    category: str
    image: str
    time_of_day: str
    box_wh: tuple[float, float]
    extent_wh: tuple[float, float]

    @property
    def log_factor(self) -> float:
        """Logarithm of the factor from extent to box, the same for width and height: their geometric mean."""
        w, h = self.box_wh
        a, b = self.extent_wh
        return 0.5 * math.log(w * h / (a * b))

    @property
    def margin_px(self) -> float:
        """Distance, px, from extent to box on each side, the mean of all sides."""
        return (sum(self.box_wh) - sum(self.extent_wh)) / 4

    @property
    def size_class(self) -> int:
        """Half octave of the longer side of the extent."""
        return math.floor(2 * math.log2(max(self.extent_wh)))


class FiguresAgainst(TypedDict):
    """How much larger drawn boxes are than exact ones, as plain JSON values; see `looseness_against`."""

    n: int
    factor: float
    ci: list[float]
    margin_px: float
    better: str


class BoxFigures(TypedDict):
    """How much larger boxes of one class are than the visible extent, as plain JSON values; see `looseness`.

    `against_rendered` compares them with exact boxes, and `by_time` has the figures by time of day.
    """

    n: int
    factor: float
    ci: list[float]
    width: float
    height: float
    margin_px: float
    spread: dict[str, float]
    against_rendered: NotRequired[FiguresAgainst | None]
    by_time: NotRequired[dict[str, BoxFigures]]


def visible_extent(
    picture: Picture, instance: Instance, labels: Sequence[Instance], contrast: Contrast
) -> tuple[float, float] | None:
    """Return the width and height, px, of what can be seen of an object.

    It is the connected region beyond half of the contrast that covers most of the box; it may leave the box.

    Args:
        picture: (h, w) in 8-bit levels.
        instance: Label of the object.
        labels: All labels of the picture; the boxes of the others do not belong to the object.
        contrast: Contrast of the object.

    Returns:
        The extent; None for objects of too little contrast, for those with both bright and dark parts, and for regions
        that run on into the surroundings.
    """
    other_end = min(contrast.high - contrast.ring, contrast.ring - contrast.low)  # below 0 if both are on one side
    if contrast.change < MIN_CHANGE or other_end > MAX_OTHER_END * contrast.change:
        return None
    boxes = [o.box_xyxy for o in labels]
    region = region_beyond_half(picture, instance.box_xyxy, boxes, contrast.ring, contrast.signed)
    return None if region is None else (float(region.shape[1]), float(region.shape[0]))


def box_extent(
    picture: Picture, instance: Instance, labels: Sequence[Instance], of: ObjectContrast
) -> BoxExtent | None:
    """Return the box and the visible extent of an object of known contrast; None as for `visible_extent`."""
    extent = visible_extent(picture, instance, labels, of.contrast)
    x0, y0, x1, y1 = (float(v) for v in instance.box_xyxy)
    return None if extent is None else BoxExtent(of.category, of.image, of.time_of_day, (x1 - x0, y1 - y0), extent)


def looseness(boxes: Sequence[BoxExtent]) -> BoxFigures | None:
    """Return how much larger boxes of one class are than the visible extent.

    Returns:
        `n`, the median `factor` from extent to box with its `ci` over resampled images, the medians of `width` and
        `height`, the median `margin_px` on each side, and `spread`: the standard deviation of the logarithm of widths
        and heights that `factor` and `margin` leave. Plain JSON values; None with fewer than 30 boxes.
    """
    if len(boxes) < MIN_BOXES:
        return None
    factor, ci = _median_factor([b.log_factor for b in boxes], [b.image for b in boxes])
    width, height = (np.median([b.box_wh[k] / b.extent_wh[k] for b in boxes]) for k in (0, 1))
    return {
        "n": len(boxes),
        "factor": factor,
        "ci": ci,
        "width": round(float(width), 3),
        "height": round(float(height), 3),
        "margin_px": round(float(np.median([b.margin_px for b in boxes])), 2),
        "spread": _spread(boxes),
    }


def looseness_against(drawn: Sequence[BoxExtent], exact: Sequence[BoxExtent]) -> FiguresAgainst | None:
    """Return how much larger drawn boxes are than exact ones around objects that look the same size.

    The factor of each drawn box is divided by the median factor of the exact boxes around objects of the same extent,
    to half an octave.

    Returns:
        `n`, `factor`, `ci` and `margin_px` as in `looseness`, the margin less that of the exact boxes; None with fewer
        than 30 drawn boxes that have their like. `better` is `margin` where it leaves less than the factor by more than
        it does for the exact boxes, whose small objects have inexact extents, too; else `factor`.
    """
    reference: dict[int, list[BoxExtent]] = {}
    for e in exact:
        reference.setdefault(e.size_class, []).append(e)
    alike = {size: of for size, of in reference.items() if len(of) >= MIN_REFERENCE}
    typical = {size: float(np.median([e.log_factor for e in of])) for size, of in alike.items()}
    margins = {size: float(np.median([e.margin_px for e in of])) for size, of in alike.items()}
    used = [d for d in drawn if d.size_class in typical]
    if len(used) < MIN_BOXES:
        return None
    factor, ci = _median_factor([d.log_factor - typical[d.size_class] for d in used], [d.image for d in used])
    margin = float(np.median([d.margin_px - margins[d.size_class] for d in used]))
    gains = [of["factor"] - of["margin"] for of in (_spread(used), _spread([e for v in alike.values() for e in v]))]
    better = "margin" if gains[0] > max(gains[1], 0.0) else "factor"
    return {"n": len(used), "factor": factor, "ci": ci, "margin_px": round(margin, 2), "better": better}


def typical_looseness(boxes: Sequence[BoxExtent]) -> tuple[float, float]:
    """Return a factor and a margin on each side, px, that describe drawn boxes; one of them is 1, or 0.

    Each is a median, and not below 1, or 0: tight boxes give exact ones. The margin is taken if it leaves less spread,
    without odd boxes. Constants stand for the exact boxes that `looseness_against` compares with.
    """
    logs = [b.log_factor for b in boxes]
    low, high = np.percentile(logs, [25, 75])
    reach = 1.5 * (high - low)
    spread = _spread([b for b in boxes if low - reach <= b.log_factor <= high + reach])
    if spread["factor"] - spread["margin"] > MIN_GAIN:
        return 1.0, max(round(float(np.median([b.margin_px for b in boxes])), 1), 0.0)
    return max(round(math.exp(float(np.median(logs))) / EXACT_FACTOR, 2), 1.0), 0.0


def _spread(boxes: Sequence[BoxExtent]) -> dict[str, float]:
    """Return what a factor and what a margin leave unexplained, each fitted to widths and heights by itself."""
    box = np.array([b.box_wh for b in boxes])
    extent = np.array([b.extent_wh for b in boxes])
    of_sides = np.array([side_spreads(box[:, k], extent[:, k]) for k in (0, 1)])
    factor, margin = np.sqrt(np.mean(of_sides**2, axis=0))
    return {"factor": round(float(factor), 3), "margin": round(float(margin), 3)}


def side_spreads(box: NDArray[np.float64], extent: NDArray[np.float64]) -> tuple[float, float]:
    """Return the standard deviations of the logarithm that a factor and a margin leave, for (n,) sides of boxes, px."""
    with_margin = np.maximum(extent + np.median(box - extent), 1)
    return float(np.log(box / extent).std()), float(np.log(box / with_margin).std())


def _median_factor(logs: Sequence[float], images: Sequence[str]) -> tuple[float, list[float]]:
    values = np.array(logs, np.float64)
    names, number = np.unique(list(images), return_inverse=True)
    order = np.argsort(values, kind="stable")
    times = stream(0, "looseness").multinomial(len(names), np.full(len(names), 1 / len(names)), _BOOTSTRAPS)
    draws: NDArray[np.float64] = np.array([_weighted_median(values[order], row[number[order]]) for row in times])
    low, high = np.exp(np.percentile(draws, [2.5, 97.5]))
    return round(float(np.exp(np.median(values))), 3), [round(float(low), 3), round(float(high), 3)]


def _weighted_median(ordered: NDArray[np.float64], weights: NDArray[np.int64]) -> float:
    total = np.cumsum(weights)
    return float(ordered[np.searchsorted(total, total[-1] / 2)])
