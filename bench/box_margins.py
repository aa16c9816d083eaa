"""Compare two models of how much larger drawn boxes are than what is seen: a factor, or a margin in pixels.

    .venv/bin/python bench/box_margins.py DATA [--split train]

Prints, per class, width and height: the median factor from the visible extent of an object to its box and the median
margin of both sides together, each with the standard deviation of the logarithm of what it leaves unexplained. The
smaller one is the better model. The visible extent is the outline that `infrablend realism` measures.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np

from infrablend import api
from infrablend.core.boxes import boxes_mask
from infrablend.formats.images import load_background
from infrablend.realism.features import Outline, outline

_LEAST_OBJECTS = 30


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--split", default="train")
    args = parser.parse_args()
    found: dict[str, list[list[float]]] = defaultdict(list)
    for image in api.read_dataset(args.data).images:
        if image.split != args.split or not image.instances:
            continue
        picture = load_background(image.path).pixels.astype(np.float32)
        free = ~boxes_mask((i.box_xyxy for i in image.instances), picture.shape)
        for label in image.instances:
            seen = outline(picture, label.box_xyxy, free)
            if isinstance(seen, Outline):
                rows, columns = np.nonzero(seen.silhouette)
                drawn = label.box_xyxy[2:] - label.box_xyxy[:2]
                found[label.category].append([*drawn, np.ptp(columns) + 1, np.ptp(rows) + 1])
    print("class, side, objects".ljust(34) + "factor, spread     margin px, spread")
    for category, values in sorted(found.items()):
        table = np.array(values, np.float64)
        if len(table) < _LEAST_OBJECTS:
            continue
        for k, side in enumerate(("width", "height")):
            drawn, extent = table[:, k], table[:, k + 2]
            factor, margin = np.median(drawn / extent), np.median(drawn - extent)
            spreads = (np.log(drawn / (factor * extent)).std(), np.log(drawn / np.maximum(extent + margin, 1)).std())
            title = f"{category}, {side}, {len(table)}"
            print(f"{title:34}{factor:6.2f} {spreads[0]:7.2f} {margin:12.1f} {spreads[1]:7.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
