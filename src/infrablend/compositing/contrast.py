"""Contrast of an object in a finished picture, measured alike for annotated and for inserted objects.

The level of an object is compared with that of a ring around its box. Levels are 8-bit levels: those of 16-bit pictures
are divided by their scale first.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.mapping import GreyImage
from infrablend.core.boxes import pixel_box
from infrablend.core.capture import TimeOfDay
from infrablend.core.dataset import known_class
from infrablend.core.outline import ring_levels
from infrablend.core.quantiles import percentile

# Boxes nearer to the frame's edge are not measured.
EDGE_PX = 3


@dataclass(frozen=True)
class Least:
    """Least contrast of an object that counts as seen.

    Attributes:
        change: Least change against the ring, 8-bit levels.
        scr: Least signal to clutter.
    """

    change: float
    scr: float

    def is_met(self, change: float, clutter: float) -> bool:
        """Return whether a change over a clutter, 8-bit levels, is enough."""
        return change >= self.change and change >= self.scr * (clutter + 1)


# What 99 of 100 annotated objects show, of cars by day 95: HIT-UAV's train split by class and time of day. For all
# other classes: what 99 of 100 drones in Halmstad's train clips show.
REAL_LEAST: Mapping[tuple[str, TimeOfDay], Least] = {
    ("person", "night"): Least(50, 1.9),
    ("person", "day"): Least(28, 1.6),
    ("car", "night"): Least(35, 1.4),
    ("car", "day"): Least(48, 1.5),
    ("bicycle", "night"): Least(43, 1.6),
    ("bicycle", "day"): Least(23, 1.2),
}
OTHER_LEAST = Least(17, 1.6)


def real_least(category: str, time_of_day: TimeOfDay | None) -> Least:
    """Return what 99 of 100 real objects of a class show; at dusk, dawn and an unknown time the lesser of both."""
    known = known_class(category)
    times: tuple[TimeOfDay, ...] = (time_of_day,) if time_of_day in ("night", "day") else ("night", "day")
    found = [REAL_LEAST[known, t] for t in times if known is not None and (known, t) in REAL_LEAST]
    return min(found, key=lambda least: least.change) if found else OTHER_LEAST


@dataclass(frozen=True)
class Contrast:
    """Contrast of the object in a box, 8-bit levels.

    Attributes:
        high: 95 % quantile of the box.
        low: 5 % quantile of the box.
        middle: Median of the box's central half in both directions.
        ring: Median of the ring around the box.
        clutter: Standard deviation of the ring.
    """

    high: float
    low: float
    middle: float
    ring: float
    clutter: float

    @property
    def change(self) -> float:
        """The larger of |high - ring| and |low - ring|."""
        return abs(self.signed)

    @property
    def signed(self) -> float:
        """High - ring or low - ring, whichever is larger in magnitude."""
        above, below = self.high - self.ring, self.low - self.ring
        return above if abs(above) >= abs(below) else below

    @property
    def scr(self) -> float:
        """Signal to clutter: `change` over clutter + 1."""
        return self.change / (self.clutter + 1)

    def to_json(self) -> dict[str, float]:
        """Return plain JSON values, rounded to a hundredth of a level."""
        plain: dict[str, float] = {k: round(v, 2) for k, v in asdict(self).items()}
        return {**plain, "change": round(self.change, 2), "scr": round(self.scr, 3)}


def measure_contrast(
    picture: GreyImage | NDArray[np.float32],
    box_xyxy: NDArray[np.float64],
    others: Sequence[NDArray[np.float64]] = (),
    scale: float = 1.0,
) -> Contrast | None:
    """Measure the contrast of the object in a box against the ring around it.

    The box is taken as its integer hull; those of other objects are left out of the ring. `scale` is the number of
    levels per 8-bit level.

    Returns:
        The contrast; None if the box is empty or too few pixels of the ring are free.
    """
    around = ring_levels(picture, box_xyxy, others)
    if around is None:
        return None
    ring = np.asarray(around, np.float64) / scale
    left, top, right, bottom = pixel_box(box_xyxy, picture.shape)
    inside = np.asarray(picture[top:bottom, left:right], np.float64) / scale
    h, w = inside.shape
    low, high = np.percentile(inside, [5, 95])
    return Contrast(
        high=float(high),
        low=float(low),
        middle=float(np.median(inside[h // 4 : h - h // 4, w // 4 : w - w // 4])),
        ring=float(np.median(ring)),
        clutter=float(ring.std()),
    )


def near_edge(box_xyxy: NDArray[np.float64], shape_hw: tuple[int, ...]) -> bool:
    """Return whether the integer hull of a box is nearer than `EDGE_PX` to the frame's edge."""
    h, w = shape_hw
    x0, y0, x1, y1 = box_xyxy
    return bool(
        math.floor(x0) < EDGE_PX
        or math.floor(y0) < EDGE_PX
        or math.ceil(x1) > w - EDGE_PX
        or math.ceil(y1) > h - EDGE_PX
    )


def visible_change(
    before: GreyImage, after: GreyImage, coverage: NDArray[np.float32], offset_xy: tuple[int, int], scale: float = 1.0
) -> float:
    """Return the change of an object's pixels by its insertion, 8-bit levels: the 90 % quantile within its mask.

    Means over 3 x 3 pixels are compared, because new grain changes every pixel even if nobody sees the object. Its mask
    is what `coverage`, a crop at `offset_xy`, has by at least a half, or the most covered pixel of a smaller object;
    `scale` is the number of levels per 8-bit level.
    """
    x, y = offset_xy
    h, w = coverage.shape
    inside = coverage >= min(0.5, float(coverage.max(initial=0.0)))
    inside &= coverage > 0
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if not rows.size:
        return 0.0
    # The object and the pixel around it that the mean takes in, within the crop.
    top, bottom = max(int(rows[0]) - 1, 0), min(int(rows[-1]) + 2, h)
    left, right = max(int(columns[0]) - 1, 0), min(int(columns[-1]) + 2, w)
    part = (slice(y + top, y + bottom), slice(x + left, x + right))
    change = cv2.blur(after[part].astype(np.float32) - before[part].astype(np.float32), (3, 3))
    return percentile(np.abs(change[inside[top:bottom, left:right]]), 90) / scale
