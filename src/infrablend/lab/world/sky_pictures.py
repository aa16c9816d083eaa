"""Makes thermal pictures of the sky with small objects: a stand-in for a ground camera's dataset, without rendering.

Each picture shows a cold, smooth sky with faint clouds above a warm tree line, and one small warm object. Airplanes,
birds, drones and helicopters differ in outline, so that there is something to learn; nothing is physical.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import SPLITS, Category, ImageRecord, Instance, Split
from infrablend.core.files import write_bytes
from infrablend.core.rng import stream
from infrablend.core.workspace import WORLD_FILE, workspace
from infrablend.formats.labels import coco
from infrablend.formats.pictures.images import png_bytes

SIZE_WH = (320, 256)
# Levels of sky and trees, and of objects above the sky; deviation of the noise.
_SKY = 70.0
_TREES = 150.0
_OBJECT = (60.0, 120.0)
_NOISE = 1.5
# Longest side of objects, px.
_SIZE_PX = (14.0, 26.0)
# Bars from the middle of an object, as (length, angle), by class; other classes look like drones.
_SHAPES: Mapping[str, tuple[tuple[float, float], ...]] = {
    "airplane": ((1.0, 0.0), (1.0, 3.14), (0.7, 1.57)),
    "bird": ((1.0, 0.5), (1.0, 2.6)),
    "drone": ((1.0, 0.4), (1.0, 2.7), (1.0, 3.6), (1.0, 5.8)),
    "helicopter": ((1.0, 0.0), (0.4, 3.14), (0.5, 4.71)),
}


def write_sky_pictures(out: Path, count: int, seed: int, classes: Sequence[str]) -> None:
    """Write a COCO dataset of pictures that show one object each, and `world.json`.

    Seven in ten pictures are train, one in ten val, the others test, but at least one of each; classes come in turn.

    Raises:
        OutputError: The folder is not empty or cannot be written.
    """
    with workspace(out, "virtual world", WORLD_FILE) as space:
        images = _write_pictures(space.folder, count, seed, classes)
        coco.write(space.folder, images, [Category(n, name) for n, name in enumerate(classes, 1)])
        space.finish({"seed": seed, "layout": "sky", "classes": list(classes), "frames": []})


def _write_pictures(folder: Path, count: int, seed: int, classes: Sequence[str]) -> list[ImageRecord]:
    images = []
    per_split: dict[Split, int] = {"val": max(1, count // 10), "test": max(1, count // 5)}
    per_split["train"] = max(1, count - sum(per_split.values()))
    for split in SPLITS:
        for number in range(per_split[split]):
            category = classes[number % len(classes)]
            rng = stream(seed, "sky", *classes, split, number)
            grey, box = _picture(rng, _SHAPES.get(category, _SHAPES["drone"]))
            path = folder / "images" / split / f"sky_{number:05d}.png"
            write_bytes(path, png_bytes(grey))
            label = Instance(category, box)
            images.append(ImageRecord(f"{split}/{number}", path, split, SIZE_WH, (label,)))
    return images


def _picture(
    rng: np.random.Generator, shape: Sequence[tuple[float, float]]
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return the (h, w) levels of a picture, and the (4,) box of its object."""
    width, height = SIZE_WH
    rows = np.arange(height, dtype=np.float32)[:, None]
    clouds = cv2.resize(rng.normal(0, 3, (5, 6)).astype(np.float32), SIZE_WH, interpolation=cv2.INTER_CUBIC)
    grey = _SKY + 0.05 * rows + clouds
    tops = cv2.GaussianBlur(rng.normal(0, 1, (1, width)).astype(np.float32), (0, 0), 4)[0]
    ends = rng.uniform(0.7, 0.85) * height + 25 * tops
    trees = _TREES + cv2.GaussianBlur(rng.normal(0, 40, (height, width)).astype(np.float32), (0, 0), 2)
    grey = np.where(rows < ends[None, :], grey, trees).astype(np.float32)
    half = float(rng.uniform(*_SIZE_PX)) / 2
    centre = np.array([rng.uniform(30, width - 30), rng.uniform(30, 0.5 * height)])
    mask = np.zeros((height * 4, width * 4), np.uint8)  # drawn larger, then averaged: smooth outlines
    middle = tuple(int(v) for v in np.rint(4 * centre))
    tips = [centre + half * length * np.array([np.cos(turn), np.sin(turn)]) for length, turn in shape]
    for tip in tips:
        cv2.line(mask, middle, tuple(int(v) for v in np.rint(4 * tip)), 255, max(2, int(half * 1.2)))
    cv2.circle(mask, middle, max(3, int(half * 1.6)), 255, -1)
    cover = cv2.resize(mask, SIZE_WH, interpolation=cv2.INTER_AREA).astype(np.float32) / 255
    grey = cv2.GaussianBlur(grey + cover * np.float32(rng.uniform(*_OBJECT)), (0, 0), 0.7)
    grey = grey + rng.normal(0, _NOISE, grey.shape)
    ys, xs = np.nonzero(cover > 0.3)
    box = np.array([xs.min() - 1, ys.min() - 1, xs.max() + 2, ys.max() + 2], np.float64)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8), box
