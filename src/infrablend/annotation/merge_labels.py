"""Merging of the original labels of an image with those of the inserted objects."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import box_of_points, inside_convex, polygon_area
from infrablend.core.dataset import Instance
from infrablend.core.rle_masks import Mask

LabelChoice = Literal["merged", "new", "original"]
RemovalReason = Literal["covered", "category", "labels"]


@dataclass(frozen=True)
class MergeSettings:
    """Rules for the labels of an output image.

    Attributes:
        labels: Original and new labels, or only one of the two.
        keep_categories: Original categories that stay, None for all. New labels always stay.
        cover_share: Covered share in (0, 1] (see `covered_share`) at which the label of an original object is removed.
    """

    labels: LabelChoice = "merged"
    keep_categories: tuple[str, ...] | None = None
    cover_share: float = 0.99


@dataclass(frozen=True, eq=False)
class Removal:
    """A label that was left out of the output.

    Attributes:
        reason: `covered` by new objects, `category` not among those to keep, or left out by the choice of `labels`.
        category: Class of the object.
        source_id: Id of the annotation in its source.
        box_xyxy: Box of the object.
        covered_share: Share of the object's pixels under the new masks, in [0, 1].
        inserted: True for a new object (only `labels: original` leaves one out).
        corners_xy: (4, 2) corners of the oriented box, None if unknown.
        mask: Mask of the object, None if unknown.
    """

    reason: RemovalReason
    category: str
    source_id: int | str | None
    box_xyxy: tuple[float, float, float, float]
    covered_share: float
    inserted: bool = False
    corners_xy: NDArray[np.float64] | None = None
    mask: Mask | None = None

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values, with `corners_xy` and `mask` where they are known."""
        corners = {} if self.corners_xy is None else {"corners_xy": self.corners_xy.tolist()}
        mask = {} if self.mask is None else {"mask": self.mask.to_coco()}
        return {
            "reason": self.reason,
            "category": self.category,
            "source_id": self.source_id,
            "box_xyxy": list(self.box_xyxy),
            "covered_share": self.covered_share,
            "inserted": self.inserted,
            **corners,
            **mask,
        }


@dataclass(frozen=True, eq=False)
class MergedLabels:
    """The labels of an output image.

    Attributes:
        kept: Indices of the original labels that stay.
        inserted: New labels that the image carries.
        removed: Every label that was left out, with the reason.
        partly_covered: Original objects partly hidden by new ones, reduced to their visible parts, by index; see the
            function `partly_covered`.
    """

    kept: tuple[int, ...]
    inserted: tuple[Instance, ...]
    removed: tuple[Removal, ...]
    partly_covered: dict[int, Instance]


def merge(original: Sequence[Instance], new: Sequence[Instance], settings: MergeSettings) -> MergedLabels:
    """Merge the labels of a background with those of the objects inserted into it.

    Every given label is either carried by the output or listed in `removed`.

    Args:
        original: Labels of the background.
        new: Labels of the inserted objects; each has a mask.
        settings: Rules for the labels that stay.

    Raises:
        ValueError: A new instance has no mask.
    """
    cover = covered_pixels(new)
    kept: list[int] = []
    removed: list[Removal] = []
    for n, instance in enumerate(original):
        share = 0.0 if cover is None else covered_share(instance, cover)
        reason: RemovalReason | None = None
        if settings.labels == "new":
            reason = "labels"
        elif settings.keep_categories is not None and instance.category not in settings.keep_categories:
            reason = "category"
        elif share > 0 and share >= settings.cover_share:
            reason = "covered"
        if reason is None:
            kept.append(n)
        else:
            removed.append(_removal(instance, reason, share))
    if settings.labels == "original":
        removed += [_removal(i, "labels", 0.0) for i in new]
        new = ()
    seen = partly_covered(original, cover)
    return MergedLabels(tuple(kept), tuple(new), tuple(removed), {n: i for n, i in seen.items() if n in set(kept)})


def covered_pixels(new: Sequence[Instance]) -> NDArray[np.bool_] | None:
    """Mark the (h, w) pixels that the new objects hide; None without any new object."""
    cover: NDArray[np.bool_] | None = None
    for i in new:
        if i.mask is None:
            raise ValueError(f"a new object needs a mask; {i.category!r} at {i.box_xyxy.tolist()} has none")
        cover = i.mask.to_array() if cover is None else cover | i.mask.to_array()
    return cover


def partly_covered(original: Sequence[Instance], cover: NDArray[np.bool_] | None) -> dict[int, Instance]:
    """Return the originals that new objects hide in part, by index, with their visible parts.

    `visibility` is multiplied by the share that is not covered (an unknown one counts as 1). A mask, which means
    visible pixels, loses the covered ones. Boxes stay.
    """
    found: dict[int, Instance] = {}
    for n, instance in enumerate(original if cover is not None else ()):
        assert cover is not None
        share = covered_share(instance, cover)
        if share > 0:
            mask = instance.mask
            if mask is not None and mask.size_hw == cover.shape:
                mask = Mask.from_array(mask.to_array() & ~cover)
            before = 1.0 if instance.visibility is None else instance.visibility
            found[n] = replace(instance, mask=mask, visibility=round(before * (1 - share), 6))
    return found


def covered_share(instance: Instance, cover: NDArray[np.bool_]) -> float:
    """Return the share in [0, 1] of an object's pixels that `cover` (h, w) marks.

    The object's pixels are those of its mask; without a mask, those of its oriented box, or else of its box. A pixel
    belongs to a box if its centre is inside. If a box contains no pixel centre, the pixel under its centre counts. Only
    pixels of the frame count; a box outside the frame has share 0.
    """
    mask = instance.mask
    if mask is not None and mask.size_hw == cover.shape and mask.area_px:
        return float((mask.to_array() & cover).sum() / mask.area_px)
    if not _near(instance, cover):
        return 0.0
    pixels = box_pixels(instance, (cover.shape[0], cover.shape[1]))
    if pixels is None:
        return 0.0
    (top, left), inside = pixels
    under = cover[top : top + inside.shape[0], left : left + inside.shape[1]]
    return float((under & inside).sum() / inside.sum())


def _near(instance: Instance, cover: NDArray[np.bool_]) -> bool:
    """Return False if `cover` marks no pixel within one pixel of the object's box."""
    box = instance.box_xyxy if instance.corners_xy is None else box_of_points(instance.corners_xy)
    x0, y0, x1, y1 = (math.floor(v) for v in box)
    return bool(cover[max(y0 - 1, 0) : max(y1 + 2, 0), max(x0 - 1, 0) : max(x1 + 2, 0)].any())


def box_pixels(instance: Instance, size_hw: tuple[int, int]) -> tuple[tuple[int, int], NDArray[np.bool_]] | None:
    """Return row and column of a window, and its (h, w) pixels inside an object's box; None outside the frame."""
    height, width = size_hw
    polygon = instance.corners_xy
    if polygon is not None and polygon_area(polygon) < 0:
        polygon = polygon[::-1]  # some sources list corners counter-clockwise
    x0, y0, x1, y1 = instance.box_xyxy if polygon is None else box_of_points(polygon)
    # Pixel j has its centre in [x0, x1) if x0 <= j + 0.5 < x1.
    left, right = max(math.ceil(x0 - 0.5), 0), min(math.ceil(x1 - 0.5), width)
    top, bottom = max(math.ceil(y0 - 0.5), 0), min(math.ceil(y1 - 0.5), height)
    if right > left and bottom > top:
        inside = np.ones((bottom - top, right - left), np.bool_)
        if polygon is not None:
            columns, rows = np.meshgrid(np.arange(left, right) + 0.5, np.arange(top, bottom) + 0.5)
            centres = np.stack([columns.reshape(-1), rows.reshape(-1)], axis=1)
            inside = inside_convex(centres, polygon).reshape(inside.shape)
        if inside.any():
            return (top, left), inside
    if x1 < 0 or y1 < 0 or x0 > width or y0 > height:
        return None
    column = min(math.floor((max(x0, 0) + min(x1, width)) / 2), width - 1)
    row = min(math.floor((max(y0, 0) + min(y1, height)) / 2), height - 1)
    return (row, column), np.ones((1, 1), np.bool_)


def _removal(i: Instance, reason: RemovalReason, share: float) -> Removal:
    x0, y0, x1, y1 = (float(v) for v in i.box_xyxy)
    return Removal(reason, i.category, i.source_id, (x0, y0, x1, y1), share, i.inserted, i.corners_xy, i.mask)
