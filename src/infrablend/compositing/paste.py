"""Cuts real objects out of their pictures and pastes them over other backgrounds.

What is pasted is the difference between the object and the level around it: on a new background it has the contrast
that it has in its own picture. Nothing is scaled, turned or blurred, so it keeps its size, sharpness and grain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.mapping import GreyImage
from infrablend.core.boxes import pixel_box
from infrablend.core.outline import ring_levels
from infrablend.core.quantiles import quantile

# Pixels around the box in which the matte fades to nothing.
FEATHER_PX = 2
# Width of the ring that gives the level around the box, as in `contrast`.
_MIN_RING_PX = 4
# The matte rises from 0 to 1 between these differences, in deviations of the ring's noise, which is at least a level.
_FROM_NOISE = 2.0
_TO_NOISE = 5.0
_LEAST_NOISE = 1.0
_SMOOTH_PX = 0.8
# Quantile that counts as an object's largest difference.
_LARGEST = 0.9
# Pixels joined to the brightest or darkest one by at least this much matte belong to the object.
_JOINED = 0.1


@dataclass(frozen=True, eq=False)
class CutOut:
    """A real object without its background.

    Attributes:
        difference: (h, w) levels of the object minus the level around it, times the matte.
        cover: (h, w) share of the background that the object hides, in [0, 1]: its difference over its largest one.
        box_xyxy: (4,) annotated box in the cut-out, pixels.
    """

    difference: NDArray[np.float32]
    cover: NDArray[np.float32]
    box_xyxy: NDArray[np.float64]

    @property
    def size_wh(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return int(self.cover.shape[1]), int(self.cover.shape[0])


def cut_out(
    picture: GreyImage, box_xyxy: NDArray[np.float64], others: Sequence[NDArray[np.float64]] = ()
) -> CutOut | None:
    """Cut the object in a box out of a picture.

    The matte is 1 where the picture differs from the ring around the box by much more than the ring's noise, 0 where it
    does not, and fades within `FEATHER_PX` around the box. Only the part that holds together with the largest
    difference is kept. Other objects' boxes are left out of the ring.

    Returns:
        The object; None if it is cut by the frame, if too few pixels around it are free, or if it does not stand out.
    """
    height, width = picture.shape
    left, top, right, bottom = pixel_box(box_xyxy, picture.shape)
    x0, y0, x1, y1 = left - FEATHER_PX, top - FEATHER_PX, right + FEATHER_PX, bottom + FEATHER_PX
    around = ring_levels(picture, box_xyxy, others, _MIN_RING_PX)
    if left >= right or top >= bottom or min(x0, y0) < 0 or x1 > width or y1 > height or around is None:
        return None
    level = float(np.median(around))
    noise = max(1.4826 * float(np.median(np.abs(around - level))), _LEAST_NOISE)
    difference = np.asarray(picture[y0:y1, x0:x1], np.float32) - np.float32(level)
    above = np.abs(cv2.GaussianBlur(difference, (0, 0), _SMOOTH_PX)) / np.float32(noise)
    rise = np.clip((above - _FROM_NOISE) / (_TO_NOISE - _FROM_NOISE), 0, 1)
    alpha = (rise * rise * (3 - 2 * rise)).astype(np.float32)
    # Between a bright and a dark part of an object the difference passes through zero.
    alpha = cv2.morphologyEx(alpha, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    inside = np.zeros(alpha.shape, np.bool_)
    inside[FEATHER_PX:-FEATHER_PX, FEATHER_PX:-FEATHER_PX] = True
    alpha *= _feather(alpha.shape)
    parts = cv2.connectedComponents((alpha > _JOINED).astype(np.uint8), connectivity=8)[1]
    strongest = parts.ravel()[int(np.argmax(np.where(inside, above * alpha, 0)))]
    if strongest == 0:
        return None
    own = cv2.dilate((parts == strongest).astype(np.uint8), np.ones((3, 3), np.uint8)).astype(np.bool_)
    alpha[~own] = 0
    difference *= alpha
    cover = np.minimum(np.abs(difference) / np.float32(quantile(np.abs(difference[alpha > _JOINED]), _LARGEST)), 1)
    return CutOut(
        difference, np.asarray(cover, np.float32), np.asarray(box_xyxy - np.array([x0, y0, x0, y0]), np.float64)
    )


def fits(cut: CutOut, offset_xy: tuple[int, int], size_wh: tuple[int, int]) -> bool:
    """Return whether a cut-out at an offset is wholly inside a picture."""
    (x, y), (w, h) = offset_xy, cut.size_wh
    return x >= 0 and y >= 0 and x + w <= size_wh[0] and y + h <= size_wh[1]


def placed_box(cut: CutOut, offset_xy: tuple[int, int]) -> NDArray[np.float64]:
    """Return the (4,) box of a cut-out at an offset, pixels of the picture."""
    x, y = offset_xy
    return np.asarray(cut.box_xyxy + np.array([x, y, x, y], np.float64))


def offset_at(cut: CutOut, centre_xy: tuple[float, float]) -> tuple[int, int]:
    """Return the offset at which the box of a cut-out has its centre nearest to a point."""
    x0, y0, x1, y1 = cut.box_xyxy
    return round(centre_xy[0] - (x0 + x1) / 2), round(centre_xy[1] - (y0 + y1) / 2)


def paste(
    background: GreyImage, cut: CutOut, offset_xy: tuple[int, int], others: Sequence[NDArray[np.float64]] = ()
) -> GreyImage:
    """Return a picture with a cut-out over it.

    Its difference is added to the level around its new place where it hides the background, and to the background
    elsewhere. The offset is that of the upper left corner, see `fits`; other objects' boxes are left out of the ring.
    """
    (x, y), (w, h) = offset_xy, cut.size_wh
    part = (slice(y, y + h), slice(x, x + w))
    around = ring_levels(background, placed_box(cut, offset_xy), others, _MIN_RING_PX)
    below = np.asarray(background[part], np.float32)
    level = np.float32(np.median(below if around is None else around))
    mixed = below + cut.cover * (level - below) + cut.difference
    pasted = background.copy()
    limit = np.iinfo(background.dtype).max
    pasted[part] = np.clip(np.rint(mixed), 0, limit).astype(background.dtype)
    return pasted


def _feather(shape_hw: tuple[int, ...]) -> NDArray[np.float32]:
    """Return (h, w) weights: 1 in the box, falling linearly to the edge around it."""
    rows, columns = (np.arange(n, dtype=np.float32) for n in shape_hw[:2])
    edge = [np.minimum(n + 1, n[::-1] + 1) / (FEATHER_PX + 1) for n in (rows, columns)]
    return np.asarray(np.minimum(1, np.minimum.outer(edge[0], edge[1])), np.float32)
