"""Pictures cut into tiles for a network of fixed size, and the boxes of tiles joined without doubles at their seams.

Each tile keeps the boxes whose centre is in its own part of the picture, which ends in the middle of the overlap with
the next tile. An object up to half as large as the overlap is whole in the tile that its centre belongs to, so pieces
cut by an edge are never kept. Near a seam two tiles may both keep an object; then the higher score stays.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import box_iou
from infrablend.detection.detections import FloatArray
from infrablend.detection.predict import fitted_size
from infrablend.detection.tiles import PAD_GREY

# Two tiles place the same object some pixels apart: without a part that both keep, both might take it for the other's.
_SHARED = 1 / 8  # of the overlap, on each side of its middle
# Boxes of two tiles that overlap more are the same object; people who stand side by side overlap less.
_SAME_IOU = 0.5
_STRIDE = 32


@dataclass(frozen=True)
class Window:
    """A tile of a picture.

    Attributes:
        origin_xy: Upper left corner in the picture, px; negative where the picture is smaller than the tile.
        core: Left, top, right and bottom of the part whose objects the tile keeps, px of the picture.
    """

    origin_xy: tuple[int, int]
    core: tuple[float, float, float, float]

    def crop(self, pixels: NDArray[np.uint8], side_wh: tuple[int, int]) -> NDArray[np.uint8]:
        """Return the (h, w) pixels of the tile, grey beyond the picture."""
        width, height = side_wh
        x, y = self.origin_xy
        part = pixels[max(y, 0) : y + height, max(x, 0) : x + width]
        tile = np.full((height, width), PAD_GREY, np.uint8)
        tile[max(-y, 0) : max(-y, 0) + part.shape[0], max(-x, 0) : max(-x, 0) + part.shape[1]] = part
        return tile

    def owns(self, boxes_xyxy: FloatArray) -> NDArray[np.bool_]:
        """Mark the (n,) boxes, in px of the picture, whose centres the tile keeps."""
        centres = (boxes_xyxy[:, :2] + boxes_xyxy[:, 2:]) / 2
        low, high = np.array(self.core[:2]), np.array(self.core[2:])
        return np.asarray(((centres >= low) & (centres < high)).all(axis=1))


def windows(size_wh: tuple[int, int], side_wh: tuple[int, int], overlap_px: int) -> list[Window]:
    """Return even tiles that cover a picture, row by row, with at least this overlap."""
    columns, rows = (_along(size, side, overlap_px) for size, side in zip(size_wh, side_wh, strict=True))
    return [Window((x, y), (x0, y0, x1, y1)) for y, y0, y1 in rows for x, x0, x1 in columns]


def _along(size: int, side: int, overlap: int) -> list[tuple[int, float, float]]:
    """Return origin, begin and end of the own part of each tile along one axis; the outer parts have no end."""
    padded, _ = fitted_size((size, size), _STRIDE)
    border = (padded - size) // 2
    if size <= side:
        return [(-min(border, (side - size) // 2), -math.inf, math.inf)]
    # Whole strides apart, and with the border that whole pictures have: a network then sees the same in each tile.
    steps = math.ceil((padded - side) / _STRIDE)
    tiles = math.ceil((padded - side) / (side - min(overlap + _STRIDE, side // 2))) + 1
    origins = (_STRIDE * np.linspace(0, steps, tiles).round().astype(int) - border).tolist()
    seams = [((a + side + b) / 2, _SHARED * (a + side - b)) for a, b in pairwise(origins)]
    begins = [-math.inf, *(middle - shared for middle, shared in seams)]
    ends = [*(middle + shared for middle, shared in seams), math.inf]
    return list(zip(origins, begins, ends, strict=True))


def joined(
    boxes_xyxy: FloatArray,
    scores: FloatArray,
    classes: NDArray[np.int64],
    owner: NDArray[np.int64],
    tiles: list[Window],
) -> NDArray[np.int64]:
    """Return the indices of the boxes of all tiles without doubles, highest score first.

    Args:
        boxes_xyxy: (n, 4) boxes, px of the picture.
        scores: (n,) scores.
        classes: (n,) classes.
        owner: (n,) number of the tile that each box is from.
        tiles: The tiles.
    """
    order = np.argsort(-scores, kind="stable")
    there = np.ones(len(scores), np.bool_)
    several = np.sum([tile.owns(boxes_xyxy) for tile in tiles], axis=0) > 1
    left, right = boxes_xyxy[:, 0], boxes_xyxy[:, 2]
    for k in order[several[order]]:
        if there[k]:
            beside = (left < right[k]) & (right > left[k])  # of the many, few; their overlap is worth computing
            others = np.flatnonzero(there & beside & (classes == classes[k]) & (owner != owner[k]))
            same = others[box_iou(boxes_xyxy[others], boxes_xyxy[k][None])[:, 0] > _SAME_IOU]
            there[same[scores[same] <= scores[k]]] = False
            there[k] = not there[same].any()
    return np.asarray(order[there[order]])
