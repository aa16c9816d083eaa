"""Measure the thermal shadows beside the inserted objects of a run by day, and beside real ones.

    .venv/bin/python bench/shadows.py RUN [DATA] [--category Car] [--pictures N]

DATA is the folder of the backgrounds if it has moved. Prints quantiles of the darkest ground 4 to 20 px beside boxes,
in levels relative to the ground around, on even ground only: for inserted objects, for the same places without them,
and for real objects in N pictures by day of the split train.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from infrablend.pipeline.record import read_record
from numpy.typing import NDArray

from infrablend import api
from infrablend.core.boxes import boxes_mask
from infrablend.core.run_folder import RunFolder
from infrablend.formats.images import load_background

Picture = NDArray[np.float32]

# Band beside a box and the one beyond it, px; other boxes count with a margin of 6 px.
_NEAR_PX, _FAR_PX, _MARGIN_PX = (4, 20), (20, 34), 6
_LEAST_PX = 400
# Quantile of the near band, so that a few pixels decide nothing, and the least even ground: deviation of the far band.
_DARKEST, _MOST_UNEVEN = 4, 12.0
_QUANTILES = (5, 25, 50, 75)


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("--category", default="Car")
    parser.add_argument("--pictures", type=int, default=120, help="Real pictures to measure.")
    args = parser.parse_args()
    folder = RunFolder(args.run)
    data = args.data or Path(folder.read_run()["data"]["root"])
    images = {i.path.name: i for i in api.read_dataset(data).images}
    inserted: list[float] = []
    empty: list[float] = []
    for record in filter(None, map(read_record, folder.records())):
        source = images[Path(record.background["path"]).name]
        if source.capture.time_of_day != "day" or not record.inserted:
            continue
        before, after = (_picture(p) for p in (data / record.background["path"], folder.image(record.image)))
        boxes = [i.box_xyxy for i in (*record.originals(source.instances), *record.inserted)]
        for k in range(len(boxes) - len(record.inserted), len(boxes)):
            ground, shaded = darkest(before, boxes, k), darkest(after, boxes, k)
            if ground is not None and shaded is not None:
                empty.append(ground)
                inserted.append(shaded)
    real: list[float] = []
    by_day = [i for i in images.values() if i.capture.time_of_day == "day" and i.split == "train"]
    for k in np.random.default_rng(0).permutation(len(by_day))[: args.pictures]:
        source, pixels = by_day[k], _picture(by_day[k].path)
        boxes = [i.box_xyxy for i in source.instances]
        found = [darkest(pixels, boxes, n) for n, i in enumerate(source.instances) if i.category == args.category]
        real += [v for v in found if v is not None]
    for name, values in (("real", real), ("inserted", inserted), ("the same places before", empty)):
        levels = " / ".join(f"{v:.0f}" for v in np.percentile(values, _QUANTILES)) if values else "-"
        print(f"{name:24} {len(values):5}   {levels}")
    return 0


def darkest(picture: Picture, boxes: Sequence[NDArray[np.float64]], number: int) -> float | None:
    """Return the darkest ground beside a box, relative to the ground around; None if that is uneven or too small."""
    h, w = picture.shape
    away = cv2.distanceTransform((~boxes_mask([boxes[number]], (h, w))).astype(np.uint8), cv2.DIST_L2, 5)
    grow = np.array([-_MARGIN_PX, -_MARGIN_PX, _MARGIN_PX, _MARGIN_PX])
    free = ~boxes_mask((b + grow for k, b in enumerate(boxes) if k != number), (h, w))
    near, far = ((away > low) & (away <= high) & free for low, high in (_NEAR_PX, _FAR_PX))
    if min(near.sum(), far.sum()) < _LEAST_PX or picture[far].std() > _MOST_UNEVEN:
        return None
    return float(np.percentile(picture[near], _DARKEST) - np.median(picture[near | far]))


def _picture(path: Path) -> Picture:
    return np.asarray(cv2.medianBlur(load_background(path).pixels, 5), np.float32)


if __name__ == "__main__":
    sys.exit(main())
