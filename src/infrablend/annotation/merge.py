"""Labels that were in the image before, together with the new ones."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import box_of_points, inside_convex, polygon_area
from infrablend.core.dataset import Instance
from infrablend.core.masks import Mask

LabelChoice = Literal["merged", "new", "original"]
RemovalReason = Literal["covered", "category", "dont_care", "labels"]


@dataclass(frozen=True)
class MergeSettings:
    """Which labels an output image carries.

    Attributes:
        labels: Original and new ones, or one of the two.
        keep_categories: Names of the original categories that stay, None for all. New labels always stay.
        cover_share: An original object loses its label when at least this share of its pixels (see
            `covered_share`) lies under the new masks, in (0, 1]; None never removes one.
        dont_care: Whether regions of a category that is to be ignored stay.
    """

    labels: LabelChoice = "merged"
    keep_categories: tuple[str, ...] | None = None
    cover_share: float | None = 0.99
    dont_care: Literal["drop", "keep"] = "keep"


@dataclass(frozen=True, eq=False)
class Removal:
    """A label that the output does not carry.

    Attributes:
        reason: `covered` by new objects, `category` not among those to keep, `dont_care` region, or left out
        by
            the choice of `labels`.
        category: Of the object.
        source_id: Of the annotation in its source.
        box_xyxy: Of the object.
        covered_share: Share of its pixels under the new masks, in [0, 1].
        inserted: True for a new object (only `labels: original` leaves one out).
        corners_xy: (4, 2) of its oriented box, None if unknown.
        mask: Its own, None if unknown.
    """

    reason: RemovalReason
    category: str
    source_id: int | str | None
    box_xyxy: tuple[float, float, float, float]
    covered_share: float
    inserted: bool = False
    corners_xy: NDArray[np.float64] | None = None
    mask: Mask | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values; `corners_xy` and `mask` where they are known."""
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


def merge(
    original: Sequence[Instance],
    new: Sequence[Instance],
    settings: MergeSettings | None = None,
    *,
    ignored: Collection[str] = (),
    unlabelled_masks: Sequence[Mask] = (),
) -> tuple[tuple[Instance, ...], tuple[Removal, ...]]:
    """The labels of an output image, originals first, and every label that was left out.

    Args:
        original: Labels of the background.
        new: Labels of the inserted objects; each has a mask.
        settings: Which labels stay.
        ignored: Names of the original categories that are to be ignored (`Category.ignore`).
        unlabelled_masks: Pixels of inserted objects without a label (`Drop.mask`), which hide things as well.

    Returns:
        The instances that stay, unchanged and in order, and a record of each that does not. Every given
        instance is in exactly one of the two.

    Raises:
        ValueError: If a new instance has no mask.
    """
    settings = settings if settings is not None else MergeSettings()
    cover = cover_of(new, unlabelled_masks)
    kept: list[Instance] = []
    removed: list[Removal] = []
    for instance in original:
        share = 0.0 if cover is None else covered_share(instance, cover)
        reason: RemovalReason | None = None
        if settings.labels == "new":
            reason = "labels"
        elif instance.category in ignored and settings.dont_care == "drop":
            reason = "dont_care"
        elif settings.keep_categories is not None and instance.category not in settings.keep_categories:
            reason = "category"
        elif settings.cover_share is not None and share > 0 and share >= settings.cover_share:
            reason = "covered"
        if reason is None:
            kept.append(instance)
        else:
            removed.append(_removal(instance, reason, share))
    if settings.labels == "original":
        removed += [_removal(i, "labels", 0.0) for i in new]
    else:
        kept += new
    return tuple(kept), tuple(removed)


def cover_of(new: Sequence[Instance], unlabelled_masks: Sequence[Mask] = ()) -> NDArray[np.bool_] | None:
    """(h, w) which pixels the new objects hide; None without any.

    Raises:
        ValueError: If a new instance has no mask.
    """
    cover: NDArray[np.bool_] | None = None
    for mask in [*(_require_mask(i) for i in new), *unlabelled_masks]:
        cover = mask.to_array() if cover is None else cover | mask.to_array()
    return cover


def partly_covered(original: Sequence[Instance], cover: NDArray[np.bool_] | None) -> dict[int, Instance]:
    """The originals of which new objects hide a part, by index, with what can still be seen of them.

    `visibility` is multiplied by the share that is not covered (unknown counts as 1 before); a mask, which means
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
    """Share in [0, 1] of an object's pixels that `cover` (h, w) holds.

    Its pixels are its mask, else those of its box, the oriented one where it is known. A pixel belongs to a box if its
    centre lies inside; a box so small that it holds no centre has the pixel that its own centre lies in. Only pixels
    of the frame count; a box without any, outside the frame, has share 0.
    """
    mask = instance.mask
    if mask is not None and mask.size_hw == cover.shape and mask.area_px:
        return float((mask.to_array() & cover).sum() / mask.area_px)
    pixels = box_pixels(instance, (cover.shape[0], cover.shape[1]))
    if pixels is None:
        return 0.0
    (top, left), inside = pixels
    under = cover[top : top + inside.shape[0], left : left + inside.shape[1]]
    return float((under & inside).sum() / inside.sum())


def box_pixels(instance: Instance, size_hw: tuple[int, int]) -> tuple[tuple[int, int], NDArray[np.bool_]] | None:
    """Row and column of a window, and (h, w) which of its pixels lie in an object's box; None if outside."""
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


def _require_mask(instance: Instance) -> Mask:
    if instance.mask is None:
        where = instance.box_xyxy.tolist()
        raise ValueError(f"a new object needs a mask, {instance.category!r} at {where} has none")
    return instance.mask


def _removal(instance: Instance, reason: RemovalReason, share: float) -> Removal:
    x0, y0, x1, y1 = (float(v) for v in instance.box_xyxy)
    box = (x0, y0, x1, y1)
    i = instance
    return Removal(reason, i.category, i.source_id, box, share, i.inserted, i.corners_xy, i.mask)
