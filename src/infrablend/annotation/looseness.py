"""Draws the boxes of inserted objects as people would: around what is visible, with a margin.

`annotation.measured_looseness` measures how large the margin of a dataset's boxes is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np

from infrablend.core.boxes import clip_boxes
from infrablend.core.dataset import SEEN_BOX, SEEN_OBB, TIGHT_BOX, TIGHT_OBB, ImageRecord, Instance
from infrablend.core.mesh import FloatArray
from infrablend.core.strict_model import Strict

PerClass = float | Mapping[str, float]
"""One value for all classes, or one per class; classes that are not listed keep their boxes."""

BySize = Literal["by_size"]
BY_SIZE: BySize = "by_size"
"""In place of a distance: the one that `margin_by_size` gives."""

Fit = Literal["shape", "visible"]

LOOSENED = "boxes_loosened"
"""Name of the count of changed boxes in records."""

COUNTS = (LOOSENED, "boxes_fit", "loosened_by", "loosened_by_px")
"""Names of all counts in records that tell of changed boxes."""

TYPICAL_MARGINS = ((8.0, 2.0), (11.0, 3.0), (37.5, 3.0), (1000.0, 80.0))
"""Longer side of an object and the margin that people leave on each of its sides, px, with straight lines between.

Measured: 3 px in clips of Anti-UAV at 11 to 22 px, 4.3 px in Halmstad's backgrounds at 8 to 60 px, and in HIT-UAV a
factor of 1.2 around people and of 1.16 around what is visible of cars, which is 0.08 to 0.1 of a side.
"""
TYPICAL_TEXT = "2 px on each side up to a size of 8 px, 3 px from 11 to 37 px, and 0.08 of the longer side beyond"

_LEAST_PX = 1e-9  # shorter movements are rounding errors


@dataclass(frozen=True)
class Looseness:
    """How boxes are to be drawn.

    Attributes:
        loosen: Factor of at least 1 on width and height.
        loosen_px: Distance, px, by which each side moves outwards after that; or `by_size`, see `margin_by_size`.
        loosen_obb: Whether this changes oriented boxes, too; None counts as yes.
        fit: What they are drawn around before that: the object's `shape`, or what is `visible` of it.
    """

    loosen: PerClass = 1.0
    loosen_px: PerClass | BySize | Mapping[str, float | BySize] = 0.0
    loosen_obb: bool | None = None
    fit: Fit = "shape"

    @classmethod
    def of_labels(cls, section: Strict) -> Looseness:
        """Return what the labels of a recipe ask for, or a part of an experiment: its fields have the same names."""
        return cls(**section.model_dump(include={f.name for f in fields(cls)}))

    def __bool__(self) -> bool:
        """Return whether boxes of some class change."""
        return bool(self.to_counts())

    def to_counts(self) -> dict[str, object]:
        """Return `boxes_fit`, `loosened_by` and `loosened_by_px`, each where it changes boxes, as plain JSON values."""
        counts: dict[str, object] = {} if self.fit == "shape" else {"boxes_fit": self.fit}
        if any(v > 1 for v in _values(self.loosen)):
            counts["loosened_by"] = self.loosen
        if any(v != 0 for v in _values(self.loosen_px)):
            counts["loosened_by_px"] = self.loosen_px
        return counts

    def counted(self, changed: int) -> dict[str, object]:
        """Return `boxes_loosened`, the number of changed boxes, and `to_counts`; nothing without a looseness."""
        return {LOOSENED: changed, **self.to_counts()} if self else {}

    def of(self, category: str) -> tuple[float, float | BySize]:
        """Return the factor and the distance, px, or `by_size`, of a class."""
        factor = self.loosen.get(category, 1.0) if isinstance(self.loosen, Mapping) else self.loosen
        px = self.loosen_px.get(category, 0.0) if isinstance(self.loosen_px, Mapping) else self.loosen_px
        return factor, px


EXACT = Looseness()
"""Boxes as they are."""


def loosen_inserted(images: Sequence[ImageRecord], by: Looseness) -> tuple[list[ImageRecord], int]:
    """Draw the boxes of inserted objects within the frame as `by` says, and return how many were changed.

    Masks, original labels and images of unknown size stay unchanged. The exact boxes are kept in `Instance.extra`, see
    `TIGHT_BOX`.
    """
    loose = [loosen_image(image, by) for image in images]
    return [image for image, _ in loose], sum(count for _, count in loose)


def loosen_image(image: ImageRecord, by: Looseness) -> tuple[ImageRecord, int]:
    """Draw the boxes of the inserted objects of one image, see `loosen_inserted`."""
    instances = []
    count = 0
    for one in image.instances:
        fitted = by.fit == "visible" and SEEN_BOX in one.extra
        if one.inserted and (by.of(one.category) != (1, 0) or fitted) and image.size_wh is not None:
            one = _loosened(one, by, image.size_wh, fitted)
            count += 1
        instances.append(one)
    return replace(image, instances=tuple(instances)), count


def loosened_counts(counts: Mapping[str, object]) -> dict[str, object]:
    """Return those of a step's counts that say how many boxes were changed, and how; see `Looseness.counted`."""
    return {k: counts[k] for k in COUNTS if k in counts}


def loosened_text(count: int, by: Looseness) -> str:
    """Return a sentence for a dataset's card on how many boxes were changed, and how."""
    counts = by.to_counts()
    border = ", up to the border of the picture" if len(counts) > ("boxes_fit" in counts) else ""
    return f"The boxes of {count} inserted objects were {looseness_text(counts)}{border}, to match hand-drawn boxes."


def looseness_text(counts: Mapping[str, Any]) -> str:
    """Return how boxes were changed, from the counts of a run or a conversion, see `Looseness.to_counts`."""
    parts = []
    fit = "drawn around what is visible" if counts.get("boxes_fit") == "visible" else ""
    if (factors := counts.get("loosened_by")) is not None:
        by_class = isinstance(factors, Mapping)
        parts.append(f"the factors {_listed(factors, 1)}" if by_class else f"the factor {factors:g}")
    if (px := counts.get("loosened_by_px")) is not None:
        parts += _distances(px)
    enlarged = f"enlarged by {' and '.join(parts)}" if parts else ""
    return " and ".join(p for p in (fit, enlarged) if p)


def is_loosened(instance: Instance) -> bool:
    """Return whether the box of the object is no longer the exact one."""
    return TIGHT_BOX in instance.extra


def tighten_image(image: ImageRecord, *, fitted: bool = False) -> ImageRecord:
    """Return an image with the exact boxes of its inserted objects, where they were changed and are recorded.

    With `fitted`, boxes that were drawn around what is visible are around that, without a margin.
    """
    return replace(image, instances=tuple(_tightened(i, fitted) if is_loosened(i) else i for i in image.instances))


def _tightened(one: Instance, fitted: bool) -> Instance:
    box, obb = (SEEN_BOX, SEEN_OBB) if fitted and SEEN_BOX in one.extra else (TIGHT_BOX, TIGHT_OBB)
    x, y, w, h = (float(v) for v in one.extra[box])
    corners = one.corners_xy
    if obb in one.extra:
        corners = np.reshape(np.asarray(one.extra[obb], np.float64), (4, 2))
    extra = {k: v for k, v in one.extra.items() if k not in (TIGHT_BOX, TIGHT_OBB)}
    return replace(one, box_xyxy=np.array([x, y, x + w, y + h]), corners_xy=corners, extra=extra)


def margin_by_size(longer_px: float) -> float:
    """Return the margin, px, that people leave on each side of an object, by its longer side."""
    sizes, margins = np.array(TYPICAL_MARGINS).T
    return float(np.interp(longer_px, sizes, margins))


def _values(of: Any) -> list[Any]:
    return list(of.values()) if isinstance(of, Mapping) else [of]


def _distances(px: float | BySize | Mapping[str, float | BySize]) -> list[str]:
    if not isinstance(px, Mapping):
        return ["a margin by size" if px == BY_SIZE else f"{px:g} px on each side"]
    stated = _listed({k: v for k, v in px.items() if v != BY_SIZE}, 0)
    sized = ", ".join(sorted(k for k, v in px.items() if v == BY_SIZE))
    texts = (f"{stated} px on each side" if stated else "", f"a margin by size ({sized})" if sized else "")
    return [text for text in texts if text]


def _listed(of: Mapping[str, float], nothing: float) -> str:
    return ", ".join(f"{k} {v:g}" for k, v in sorted(of.items()) if v != nothing)


def _loosened(one: Instance, by: Looseness, size_wh: tuple[int, int], fitted: bool) -> Instance:
    x0, y0, x1, y1 = one.box_xyxy.tolist()
    exact: dict[str, list[float]] = {TIGHT_BOX: [x0, y0, x1 - x0, y1 - y0]}
    corners = one.corners_xy
    if corners is not None:
        exact[TIGHT_OBB] = corners.reshape(-1).tolist()
    if fitted:
        x0, y0, w, h = one.extra[SEEN_BOX]
        x1, y1 = x0 + w, y0 + h
        if corners is not None and SEEN_OBB in one.extra:
            corners = np.reshape(np.asarray(one.extra[SEEN_OBB], np.float64), (4, 2))
    factor, distance = by.of(one.category)
    px = margin_by_size(max(x1 - x0, y1 - y0)) if distance == BY_SIZE else distance
    outwards = np.array([-1.0, -1, 1, 1])
    margin = outwards * (np.array([x1 - x0, y1 - y0, x1 - x0, y1 - y0]) * (factor - 1) / 2 + px)
    if corners is not None and by.loosen_obb is not False:
        corners = loosen_rectangle(corners, factor, size_wh, px)
    box = clip_boxes(np.array([x0, y0, x1, y1]) + margin, size_wh)
    return replace(one, box_xyxy=box, corners_xy=corners, extra={**one.extra, **exact})


def loosen_rectangle(corners_xy: FloatArray, factor: float, size_wh: tuple[int, int], px: float = 0.0) -> FloatArray:
    """Return a rectangle (4, 2) enlarged about its centre, with the same orientation.

    Each side moves outwards by its share of the factor and by `px`. All sides move together, and one that would leave
    the frame stops there, so that the result does not depend on which corner is the first.
    """
    corners = corners_xy.astype(np.float64)
    size = np.array(size_wh, np.float64)
    shifts = np.array([_shift_of_side(corners, k, factor, px) for k in range(4)])
    left = np.where(np.hypot(*shifts.T) > _LEAST_PX, 1.0, 0.0)  # part of its way that each side has still to go
    while (moving := left > 0).any():
        # Corner k belongs to the side that starts there and to the one that ends there.
        own = shifts * moving[:, None]
        way = own + np.roll(own, 1, axis=0)
        room = np.maximum(np.where(way > 0, size - corners, corners), 0.0)
        steps = np.divide(room, np.abs(way), out=np.full((4, 2), np.inf), where=np.abs(way) > _LEAST_PX)
        step = float(min(left[moving].min(), steps.min()))
        corners += step * way
        left[moving] = np.maximum(left[moving] - step, 0.0)
        for corner, axis in np.argwhere(steps <= step):
            for side in (corner, (corner - 1) % 4):
                if shifts[side, axis] * way[corner, axis] > 0:
                    left[side] = 0.0
    inside = bool(((corners_xy >= 0) & (corners_xy <= size)).all())
    # Rounding may leave a corner just outside.
    return np.clip(corners, 0.0, size) if inside else corners


def _shift_of_side(corners_xy: FloatArray, k: int, factor: float, px: float) -> FloatArray:
    """Return by how much (2,) the side from corner k to the next one moves away from the opposite side."""
    side = [k, (k + 1) % 4]
    opposite = [(k + 3) % 4, (k + 2) % 4]
    across: FloatArray = corners_xy[side].mean(axis=0) - corners_xy[opposite].mean(axis=0)
    return across * ((factor - 1) / 2) + px * _outwards(across, corners_xy[side[1]] - corners_xy[side[0]])


def _outwards(across: FloatArray, along: FloatArray) -> FloatArray:
    """Return the unit vector (2,) of `across`, from the opposite side of a clockwise rectangle to the side `along`."""
    # Without an extent across: at right angles to the side.
    outwards = across if np.hypot(*across) > _LEAST_PX else np.array([along[1], -along[0]])
    length = float(np.hypot(*outwards))
    return outwards / length if length > _LEAST_PX else np.zeros(2)
