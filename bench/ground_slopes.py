"""Measure how far around them real objects follow the ground, within images: the neighbourhood of the local share.

`bench/ground_slopes.py DATA [--split train]` regresses the level of the middle of annotated objects on the median level
of rings of several widths (in lengths of the box's longer side, at least 12 px), by class and time of day. Deviations
from each image's own mean are used, of images with at least three unclipped objects. For each width it prints the slope
of this ring alone, and the slopes of the narrowest and of this ring together.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.gain import Backdrop, ring_level
from infrablend.compositing.object_contrast import MIN_COMPARED, MIN_IN_IMAGE, UNCLIPPED, object_contrast
from infrablend.core.dataset import ImageRecord
from infrablend.formats.detection import read

REACHES = (0.5, 1.0, 1.5, 3.0)


def main() -> None:
    """Print a line per class and time of day."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--split", default="train")
    options = parser.parse_args()
    found: dict[tuple[str, str], list[NDArray[np.float64]]] = {}
    for image in read(options.data).images:
        if image.split == options.split:
            for category, rows in measure(image):
                key = category, image.capture.time_of_day or "unknown"
                found.setdefault(key, []).append(rows - rows.mean(axis=0))
    for (category, time_of_day), parts in sorted(found.items()):
        rows = np.concatenate(parts)
        if len(rows) >= MIN_COMPARED:
            print(f"{category}, {time_of_day}: {len(rows)} objects of {len(parts)} images; {slopes(rows)}")


def measure(image: ImageRecord) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Yield each class that has enough objects, with an (n, 1 + widths) array: level of the object, of its rings."""
    pixels = cv2.imread(str(image.path), cv2.IMREAD_GRAYSCALE)
    picture = pixels.astype(np.float32)
    free = Backdrop(pixels, image.instances, image.capture.time_of_day, (0, 255)).free()
    for category in sorted({i.category for i in image.instances}):
        rows = []
        for instance in image.instances:
            if instance.category == category and (c := object_contrast(pixels, instance, image.instances)) is not None:
                rings = [ring_level(picture, instance.box_xyxy, free, reach) for reach in REACHES]
                if UNCLIPPED[0] < c.middle < UNCLIPPED[1]:
                    rows.append([c.middle, *rings])
        if len(rows) >= MIN_IN_IMAGE:
            yield category, np.array(rows, np.float64)


def slopes(rows: NDArray[np.float64]) -> str:
    """Return the slopes in words."""
    level, texts = rows[:, 0], []
    for n, reach in enumerate(REACHES, start=1):
        alone = _fit(rows[:, [n]], level)
        text = f"ring {reach:g}: {alone[0]:.2f}"
        if n > 1:
            narrow, wide = _fit(rows[:, [1, n]], level)
            text += f" (together {narrow:.2f} and {wide:.2f})"
        texts.append(text)
    return "; ".join(texts)


def _fit(rings: NDArray[np.float64], level: NDArray[np.float64]) -> Sequence[float]:
    return [float(v) for v in np.linalg.lstsq(rings, level, rcond=None)[0]]


if __name__ == "__main__":
    main()
