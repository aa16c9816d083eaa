"""Compare two models of how much larger drawn boxes are than what is seen: a factor, or a margin in pixels.

    .venv/bin/python bench/box_margins.py DATA [--split train]

Prints, per class, width and height: the median factor from the visible extent of an object to its box and the median
margin of both sides together, each with the standard deviation of the logarithm of what it leaves unexplained. Extents
of small objects are inexact, which favours the margin: compare with the exact boxes of a run, as `infrablend profile
--rendered` does. The visible extent is that of `infrablend realism` and `infrablend profile`.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np

from infrablend import api
from infrablend.annotation.measured_looseness import side_spreads, visible_extent
from infrablend.compositing.object_contrast import object_contrast
from infrablend.formats.pictures.images import load_background

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
        for label in image.instances:
            contrast = object_contrast(picture, label, image.instances)
            extent = None if contrast is None else visible_extent(picture, label, image.instances, contrast)
            if extent is not None:
                found[label.category].append([*(label.box_xyxy[2:] - label.box_xyxy[:2]), *extent])
    print("class, side, objects".ljust(34) + "factor, spread     margin px, spread")
    for category, values in sorted(found.items()):
        table = np.array(values, np.float64)
        if len(table) < _LEAST_OBJECTS:
            continue
        for k, side in enumerate(("width", "height")):
            drawn, extent = table[:, k], table[:, k + 2]
            factor, margin = np.median(drawn / extent), np.median(drawn - extent)
            spreads = side_spreads(drawn, extent)
            title = f"{category}, {side}, {len(table)}"
            print(f"{title:34}{factor:6.2f} {spreads[0]:7.2f} {margin:12.1f} {spreads[1]:7.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
