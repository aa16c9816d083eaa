"""Measure how many objects have bright parts, and how bright: of a dataset, or of a run with `labels.mode: new`.

`bench/warm_parts.py DATA... [--split train] [--least-px 24]` prints, per dataset, class and time of day, the share of
objects whose brightest twentieth (the 95 % quantile of the box) is 40 to 120 levels above the median of the ring around
the box.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from infrablend.formats.detection import read
from infrablend.realism.contrasts import MIN_COMPARED, object_contrast

LEVELS = (40, 60, 80, 100, 120)


def main() -> None:
    """Print a line per dataset, class and time of day."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, nargs="+")
    parser.add_argument("--split", default="train")
    parser.add_argument("--least-px", type=float, default=24, help="longer side of the smallest box that counts")
    options = parser.parse_args()
    for data in options.data:
        for (category, time_of_day), rises in sorted(measure(data, options.split, options.least_px).items()):
            if len(rises) >= MIN_COMPARED:
                shares = ", ".join(f"{level}: {np.mean(np.array(rises) >= level):.3f}" for level in LEVELS)
                print(f"{data}, {category}, {time_of_day}: {len(rises)} objects; share above the ground by {shares}")


def measure(data: Path, split: str, least_px: float) -> dict[tuple[str, str], list[float]]:
    """Return the rise of the brightest part of each object, in 8-bit levels, by class and time of day."""
    found: dict[tuple[str, str], list[float]] = {}
    for image in read(data).images:
        if image.split != split:
            continue
        pixels = cv2.imread(str(image.path), cv2.IMREAD_GRAYSCALE)
        for instance in image.instances:
            x0, y0, x1, y1 = instance.box_xyxy
            contrast = object_contrast(pixels, instance, image.instances)
            if contrast is not None and max(x1 - x0, y1 - y0) >= least_px:
                key = instance.category, image.capture.time_of_day or "unknown"
                found.setdefault(key, []).append(contrast.high - contrast.ring)
    return found


if __name__ == "__main__":
    main()
