"""Compare the bodies of real and inserted small objects: fill, elongation and peak at equal size.

    .venv/bin/python bench/bodies.py DATA [DATA ...] --class drone [--split train]

The body is the area above half of the peak (`infrablend.core.outline`). Fill is its share of the smallest rectangle
around it, turned; elongation the ratio of that rectangle's sides; the peak is in grey levels over the surroundings.
Prints the quartiles of each dataset by the longer side of the rectangle, and the sizes of all. With the `coco` folder
of a run as second DATA, `ok` marks medians within the quartiles of the first DATA.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from pathlib import Path

import numpy as np

from infrablend import api
from infrablend.core.outline import Body, find_body
from infrablend.formats.pictures.images import load_background

_EDGES_PX = (2, 4, 8, 14, 30)
_LEAST_OBJECTS = 5
_COLUMNS = ("fill", "elongation", "peak")


def find_bodies(data: Path, category: str, split: str) -> tuple[list[Body], int]:
    """Return the bodies of a class that stand out, and the number of its objects."""
    found: list[Body] = []
    objects = 0
    for image in api.read_dataset(data).images:
        boxes = [i.box_xyxy for i in image.instances]
        own = [i.box_xyxy for i in image.instances if i.category == category and image.split == split]
        objects += len(own)
        if own:
            picture = load_background(image.path).pixels
            found += [body for box in own if (body := find_body(picture, box, boxes)) is not None]
    return found, objects


def quartiles(bodies: list[Body]) -> np.ndarray:
    """Return the (3, 3) quartiles of fill, elongation and peak, one column each."""
    table = [(b.fill, b.size_px / b.width_px, abs(b.peak)) for b in bodies]
    return np.percentile(table, [25, 50, 75], axis=0)


def main() -> int:
    """Print a table for each dataset."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("data", type=Path, nargs="+")
    parser.add_argument("--class", dest="category", required=True)
    parser.add_argument("--split", default="train")
    args = parser.parse_args()
    first: dict[int, np.ndarray] = {}
    for data in args.data:
        bodies, objects = find_bodies(data, args.category, args.split)
        if not bodies:
            print(f"{data}: no {args.category} in {args.split} that stands out")
            return 1
        sizes = np.percentile([b.size_px for b in bodies], [5, 25, 50, 75, 95])
        print(
            f"{data}: {len(bodies)} of {objects} objects; size, 5 25 50 75 95 %: {' '.join(f'{v:.1f}' for v in sizes)}"
        )
        for low, high in itertools.pairwise(_EDGES_PX):
            of_size = [b for b in bodies if low <= b.size_px < high]
            if len(of_size) < _LEAST_OBJECTS:
                continue
            table = quartiles(of_size)
            like = first.setdefault(low, table)
            cells = []
            for k, name in enumerate(_COLUMNS):
                inside = like[0, k] <= table[1, k] <= like[2, k]
                text = "/".join(f"{v:.{0 if name == 'peak' else 2}f}" for v in table[:, k])
                cells.append(f"{name} {text}{' ok' if inside and like is not table else ''}")
            print(f"  {low:2}-{high:<2} px {len(of_size):5}  " + "  ".join(cells))
    return 0


if __name__ == "__main__":
    sys.exit(main())
