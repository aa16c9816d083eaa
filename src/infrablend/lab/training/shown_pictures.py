"""Pictures that a training of our own shows: as mosaics, moved, scaled, mirrored, with other gains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import box_areas, clip_boxes
from infrablend.core.files import read_regular
from infrablend.detection.tiles import MIN_SHARE, PAD_GREY
from infrablend.formats.pictures.images import load_background

_KEPT_BYTES = 256 * 1024**2  # of pictures kept in memory after their first use, each at most as large as the input
_LEAST_SIDE_PX = 2.0  # of a box that still shows an object, as in Ultralytics


@dataclass(frozen=True)
class Changes:
    """How pictures change at random; Ultralytics has arguments of the same names and meaning.

    Attributes:
        mosaic: Share of mosaics of four pictures.
        scale: Sizes are multiplied by 1 - scale to 1 + scale.
        translate: Pictures move by up to this share of their side.
        fliplr: Share of mirrored pictures.
        hsv_v: Grey levels are multiplied by 1 - hsv_v to 1 + hsv_v.
    """

    mosaic: float
    scale: float
    translate: float
    fliplr: float
    hsv_v: float


@dataclass(frozen=True, eq=False)
class ShownPicture:
    """Picture as the network sees it: (side, side) grey levels, (n, 4) boxes x0 y0 x1 y1 in px, and (n,) classes."""

    levels: NDArray[np.uint8]
    boxes_xyxy: NDArray[np.float64]
    classes: NDArray[np.int64]


class ShownPictures:
    """Pictures of a split in a folder that the writer of YOLO has written.

    Attributes:
        paths: Files of the pictures.
        labels: Number of labels of all of them.
    """

    def __init__(self, data: Path, split: str, side_px: int) -> None:
        """Read the labels.

        Args:
            data: Folder with `images` and `labels`.
            split: Name of the split.
            side_px: Side of the square input of the network, px.
        """
        folder = data / "images" / split
        self.paths = sorted(p for p in folder.rglob("*") if p.is_file())
        self._rows = [_read_rows(data / "labels" / split / p.relative_to(folder)) for p in self.paths]
        self.labels = sum(len(rows) for rows in self._rows)
        self._side = side_px
        self._read = lru_cache(maxsize=_KEPT_BYTES // side_px**2)(self._read_levels)

    def show(self, index: int, changes: Changes, rng: np.random.Generator) -> ShownPicture:
        """Return a picture, or a mosaic of it and three others, after random changes."""
        side = self._side
        if rng.random() >= changes.mosaic:
            levels, boxes, classes = self._fitted(index)
            height, width = levels.shape
            canvas = np.full((side, side), PAD_GREY, np.uint8)
            x, y = (side - width) // 2, (side - height) // 2
            canvas[y : y + height, x : x + width] = levels
            boxes = boxes + np.tile([x, y], 2)
        else:
            others = rng.integers(0, len(self.paths), 3).tolist()
            canvas, boxes, classes = self._mosaic([index, *others], rng.uniform(0.5 * side, 1.5 * side, 2))
        scale = rng.uniform(1 - changes.scale, 1 + changes.scale)
        centre = side * rng.uniform(0.5 - changes.translate, 0.5 + changes.translate, 2)
        mirror = -1.0 if rng.random() < changes.fliplr else 1.0
        scales = np.array([mirror * scale, scale])
        shift = centre - scales * canvas.shape[0] / 2
        # OpenCV counts from the middle of the first pixel, boxes from its edge.
        of_middles = shift + (scales - 1) / 2
        affine = np.array([[scales[0], 0, of_middles[0]], [0, scales[1], of_middles[1]]])
        levels = cv2.warpAffine(canvas, affine, (side, side), borderValue=PAD_GREY)
        gain = rng.uniform(1 - changes.hsv_v, 1 + changes.hsv_v)
        levels = cv2.LUT(levels, np.rint(np.arange(256) * gain).clip(0, 255).astype(np.uint8))
        moved = np.sort(boxes.reshape(-1, 2, 2) * scales + shift, axis=1).reshape(-1, 4)
        seen = clip_boxes(moved, (side, side))
        is_seen = ((seen[:, 2:] - seen[:, :2]) >= _LEAST_SIDE_PX).all(axis=1)
        is_seen &= box_areas(seen) >= MIN_SHARE * box_areas(moved)
        return ShownPicture(np.asarray(levels, np.uint8), seen[is_seen], classes[is_seen])

    def _fitted(self, index: int) -> tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.int64]]:
        """Return a picture whose longer side is that of the input, its boxes in px, and their classes."""
        levels = self._read(index)
        rows = self._rows[index]
        size = np.tile(np.array(levels.shape[::-1], np.float64), 2)
        half = rows[:, 3:] / 2
        boxes = np.concatenate([rows[:, 1:3] - half, rows[:, 1:3] + half], axis=1) * size
        return levels, boxes, rows[:, 0].astype(np.int64)

    def _read_levels(self, index: int) -> NDArray[np.uint8]:
        levels = np.asarray(load_background(self.paths[index]).pixels, np.uint8)
        scale = self._side / max(levels.shape)
        if scale == 1:
            return levels
        height, width = (max(round(edge * scale), 1) for edge in levels.shape)
        return np.asarray(cv2.resize(levels, (width, height), interpolation=cv2.INTER_LINEAR), np.uint8)

    def _mosaic(
        self, indices: Sequence[int], centre_xy: NDArray[np.float64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.int64]]:
        """Return four pictures around a point of a canvas of twice the side, their boxes in it, and their classes."""
        side = 2 * self._side
        canvas = np.full((side, side), PAD_GREY, np.uint8)
        boxes = []
        classes = []
        for n, index in enumerate(indices):
            levels, its, numbers = self._fitted(index)
            height, width = levels.shape
            x = int(centre_xy[0]) - (width if n % 2 == 0 else 0)
            y = int(centre_xy[1]) - (height if n < 2 else 0)
            left, top = max(x, 0), max(y, 0)
            part = levels[top - y : side - y, left - x : side - x]
            canvas[top : top + part.shape[0], left : left + part.shape[1]] = part
            boxes.append(its + np.tile([x, y], 2))
            classes.append(numbers)
        return canvas, np.concatenate(boxes), np.concatenate(classes)


def _read_rows(picture: Path) -> NDArray[np.float64]:
    """Return the (n, 5) rows of the label file of a picture: class, and centre and size as shares of the picture."""
    lines = read_regular(picture.with_suffix(".txt")).decode().splitlines()
    return np.array([line.split() for line in lines], np.float64).reshape(-1, 5)
