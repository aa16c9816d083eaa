"""Compare sizes, shapes and levels of objects by time of day and pitch: real ones, or a run with `labels.mode: new`.

`bench/box_contents.py DATA... [--category Car] [--split train]` prints, per dataset, time of day and range of pitches,
the quartiles over all boxes off the border of: the longer side in pixels; the same times the stated height in metres;
width over height; and the 5 %, 50 % and 95 % quantiles of the levels in the middle 70 % of the box, minus the median
of a ring of a quarter of the box around it. Only the pixels of the picture and the boxes as written are read.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import ImageRecord
from infrablend.formats import detection

BELOW_DEG = (35.0, 45.0, 65.0, np.inf)
MIDDLE, RING = 0.7, 0.25
LEAST_PX = 20  # in the middle of the box
COLUMNS = ("longer side, px", "times height", "width/height", "5 %", "50 %", "95 %")


def main() -> None:
    """Print a line per dataset, time of day and range of pitches."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, nargs="+")
    parser.add_argument("--category", default="Car")
    parser.add_argument("--split", default="train")
    options = parser.parse_args()
    rows: dict[tuple[str, float, str], list[tuple[float, ...]]] = defaultdict(list)
    for data in options.data:
        for image in detection.read(data).images:
            if image.split == options.split:
                below = next(limit for limit in BELOW_DEG if (image.pitch_deg or 0) < limit)
                found = _rows(image, options.category)
                rows[image.time_of_day or "unknown", below, str(data)] += found
    for (when, below, name), found in sorted(rows.items()):
        if found:
            quartiles = np.percentile(np.array(found), (25, 50, 75), axis=0).T
            text = "; ".join(
                f"{c} {'/'.join(f'{v:.4g}' for v in np.round(q, 2))}" for c, q in zip(COLUMNS, quartiles, strict=True)
            )
            print(f"{when}, pitch below {below:g}, {name}: {len(found)} boxes; {text}")


def _rows(image: ImageRecord, category: str) -> list[tuple[float, ...]]:
    boxes = [i.box_xyxy for i in image.instances if i.category == category]
    if not boxes:
        return []
    pixels = np.asarray(cv2.imread(str(image.path), cv2.IMREAD_GRAYSCALE), np.float64)
    h, w = pixels.shape
    out = []
    for box in boxes:
        low, high = box[:2], box[2:]
        size = high - low
        if (low < 2).any() or (high > np.array([w - 2, h - 2])).any():
            continue
        inside = _cut(pixels, low + (1 - MIDDLE) / 2 * size, high - (1 - MIDDLE) / 2 * size)
        if inside.size < LEAST_PX:
            continue
        v, u = _cut(np.moveaxis(np.indices((h, w)), 0, -1), low - RING * size, high + RING * size).reshape(-1, 2).T
        ring = (u < low[0] - 1) | (u > high[0]) | (v < low[1] - 1) | (v > high[1])
        levels = np.percentile(inside, (5, 50, 95)) - np.median(pixels[v[ring], u[ring]])
        long = float(size.max())
        out.append((long, long * (image.altitude_m or np.nan), float(size[0] / size[1]), *map(float, levels)))
    return out


def _cut(array: NDArray[np.generic], low_xy: NDArray[np.float64], high_xy: NDArray[np.float64]) -> NDArray[np.generic]:
    (x0, y0), (x1, y1) = np.maximum(np.rint(low_xy), 0).astype(int), np.rint(high_xy).astype(int)
    return array[y0:y1, x0:x1]


if __name__ == "__main__":
    main()
