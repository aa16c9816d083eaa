"""Measure the levels across the edges of cold objects: dark inside, and how bright beside and below.

`bench/edge_profiles.py DATA... [--category Car] [--split train] [--time night]` prints, per dataset and side of the box
(up, down, across), the median level over the ground at 8 px inside to 12 px outside the box, in steps of 2 px. Only
objects of 20 to 70 px count whose middle is at least 20 levels darker than the ground at that side, and only sides
without another box within 16 px. The side below is the one that the camera looks at.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from data_options import data_parser
from numpy.typing import NDArray

from infrablend.core.dataset import ImageRecord
from infrablend.formats.detection import read

FROM_EDGE_PX = np.arange(-8, 13, 2)
GROUND_PX = np.arange(12, 16)
FREE_PX = 16
SIZE_PX = (20, 70)
LEAST_GREY = 20.0
# Direction of each side in the picture, and its name.
SIDES = ((0, -1, "up"), (0, 1, "down"), (-1, 0, "across"), (1, 0, "across"))


def main() -> None:
    """Print a line per dataset and side."""
    parser = data_parser(__doc__)
    parser.add_argument("--time", default="night", choices=("day", "night"))
    options = parser.parse_args()
    print(f"distance from the box's edge, px: {FROM_EDGE_PX.tolist()}")
    for data in options.data:
        found: dict[str, list[NDArray[np.float64]]] = defaultdict(list)
        for image in read(data).images:
            if image.split == options.split and image.capture.time_of_day == options.time:
                for side, levels in profiles(image, options.category):
                    found[side].append(levels)
        for side, rows in found.items():
            print(f"{data}, {side}, {len(rows)} sides: {np.median(rows, axis=0).round().astype(int).tolist()}")


def profiles(image: ImageRecord, category: str) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Yield each free side of a cold object, with the levels over the ground there."""
    picture = np.asarray(cv2.imread(str(image.path), cv2.IMREAD_GRAYSCALE), np.float32)
    boxes = np.array([i.box_xyxy for i in image.instances]).reshape(-1, 4)
    for number, instance in enumerate(image.instances):
        x0, y0, x1, y1 = instance.box_xyxy
        half = np.array([x1 - x0, y1 - y0]) / 2
        if instance.category != category or not SIZE_PX[0] <= 2 * half.max() <= SIZE_PX[1]:
            continue
        centre = np.array([x0 + x1, y0 + y1]) / 2
        others = np.delete(boxes, number, axis=0)
        middle = float(np.median(_levels(picture, centre + half * _GRID)))
        for dx, dy, side in SIDES:
            towards = np.array([dx, dy])
            edge = centre + half * towards
            if not _is_free(edge, half * (towards == 0), towards, others, picture.shape):
                continue
            # Over the middle two fifths of the side.
            along = np.linspace(-0.4, 0.4, 9)[:, None] * half * (towards == 0)
            levels = np.array(
                [_levels(picture, edge + along + d * towards).mean() for d in (*FROM_EDGE_PX, *GROUND_PX)]
            )
            ground = levels[len(FROM_EDGE_PX) :].mean()
            if middle <= ground - LEAST_GREY:
                yield side, levels[: len(FROM_EDGE_PX)] - ground


_GRID = np.stack(np.meshgrid(np.linspace(-0.3, 0.3, 5), np.linspace(-0.3, 0.3, 5)), axis=-1).reshape(-1, 2)


def _levels(picture: NDArray[np.float32], xy: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the levels at (n, 2) positions, interpolated."""
    x, y = (xy - 0.5).astype(np.float32).T
    return np.asarray(cv2.remap(picture, x[None], y[None], cv2.INTER_LINEAR)[0], np.float32)


def _is_free(
    edge: NDArray[np.float64],
    beside: NDArray[np.float64],
    towards: NDArray[np.int_],
    others: NDArray[np.float64],
    shape: Sequence[int],
) -> bool:
    """Return whether the strip beyond an edge is inside the picture and touches no other box."""
    ends = np.stack([edge - beside, edge + beside + FREE_PX * towards])
    (x0, y0), (x1, y1) = ends.min(axis=0), ends.max(axis=0)
    if x0 < 1 or y0 < 1 or x1 > shape[1] - 2 or y1 > shape[0] - 2:
        return False
    return not bool(((others[:, 0] < x1) & (others[:, 2] > x0) & (others[:, 1] < y1) & (others[:, 3] > y0)).any())


if __name__ == "__main__":
    main()
