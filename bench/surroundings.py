"""Measure what the inserted objects of a run change outside their boxes, and compare it with real objects.

    .venv/bin/python bench/surroundings.py RUN [DATA] [--pictures N]

DATA is the folder of the backgrounds if it has moved. Prints the largest change per frame by distance from the boxes,
and the level around real and inserted objects against the ground further away, by class and time of day. The exit code
is 1 if more than a tenth of the frames change by `LIMIT_GREY` levels or more beyond 8 px.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend import api
from infrablend.compositing.object_contrast import Picture
from infrablend.core.boxes import boxes_mask, pixel_box
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.mesh import FloatArray
from infrablend.core.run_folder import RunFolder
from infrablend.formats.pictures.images import load_background

BANDS_PX = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 24)
"""Outer distance of each band around a box; the first begins at the box."""
_FAR_PX = (14, 22)  # ground to compare with
_GAP_PX = 6  # around other boxes
_MOST_CLUTTER = 8.0
_LEAST_CONTRAST = 30.0
_LEAST_SIDE_PX = 8
_LEAST_PIXELS = 9
LIMIT_GREY = 6.0
_LEAST_OBJECTS = 5

Levels = dict[tuple[str, str, str, str], list[NDArray[np.float64]]]


def main() -> int:
    """Print both tables; return 1 if too many frames change too much."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("--pictures", type=int, default=300, help="Real pictures to measure.")
    args = parser.parse_args()
    folder = RunFolder(args.run)
    data = args.data or Path(folder.read_run()["data"]["root"])
    images = {i.path.name: i for i in api.read_dataset(data).images}
    changes: dict[str, list[NDArray[np.float64]]] = defaultdict(list)
    levels: Levels = defaultdict(list)
    for record in folder.records():
        if not record.inserted:
            continue
        source = images[Path(record.background["path"]).name]
        before, after = (_picture(p) for p in (data / record.background["path"], folder.image(record.image)))
        boxes = [i.box_xyxy for i in record.inserted]
        changes[source.capture.time_of_day or "unknown"].append(largest_changes(before, after, boxes))
        labels = (*record.originals(source.instances), *record.inserted)
        _collect(levels, "inserted", source, after, labels)
    for k in np.random.default_rng(0).permutation(len(images))[: args.pictures]:
        source = list(images.values())[k]
        _collect(levels, "real", source, _picture(source.path), source.instances)
    return _print(changes, levels)


def _picture(path: Path) -> NDArray[np.float32]:
    return load_background(path).pixels.astype(np.float32)


def _collect(
    levels: Levels, kind: str, source: ImageRecord, picture: NDArray[np.float32], labels: Sequence[Instance]
) -> None:
    for n, label in enumerate(labels):
        if label.inserted is not (kind == "inserted"):
            continue
        found = levels_around(picture, label.box_xyxy, [o.box_xyxy for k, o in enumerate(labels) if k != n])
        if found is not None:
            side = "bright" if found[0] > 0 else "dark"
            time_of_day = source.capture.time_of_day or "unknown"
            levels[label.category, time_of_day, side, kind].append(np.array([found[0], *found[1]]))


def _print(changes: dict[str, list[NDArray[np.float64]]], levels: Levels) -> int:
    print("largest change of a frame outside the boxes, by distance, px".ljust(64), _row([*BANDS_PX, np.inf]))
    bad = frames = 0
    for time, rows in sorted(changes.items()):
        found = np.array(rows)
        beyond = (found[:, BANDS_PX.index(8) + 1 :].max(axis=1) >= LIMIT_GREY).sum()
        bad, frames = bad + int(beyond), frames + len(found)
        for name, q in (("median", 50), ("90 % quantile", 90), ("largest", 100)):
            print(f"  {time}, {len(found)} frames, {name}".ljust(64), _row(np.percentile(found, q, axis=0)))
        print(f"  {time}: {beyond} frames change by {LIMIT_GREY:g} levels or more beyond 8 px")
    print("level around objects minus that of the ground, median, px".ljust(64), _row(BANDS_PX))
    for key, rows in sorted(levels.items()):
        if len(rows) >= _LEAST_OBJECTS:
            found = np.array(rows)
            name = f"  {' '.join(key)}, {len(found)}, contrast {np.median(found[:, 0]):.0f}"
            print(name.ljust(64), _row(np.nanmedian(found[:, 1:], axis=0)))
    return int(10 * bad > frames)


def _row(values: Sequence[float] | NDArray[np.float64]) -> str:
    return " ".join(f"{v:6.1f}" for v in values)


def distance_px(shape_hw: tuple[int, ...], boxes_xyxy: Sequence[FloatArray]) -> NDArray[np.float32]:
    """Return the (h, w) distance of each pixel from the nearest box: that of rows or columns, 0 inside."""
    outside = ~boxes_mask(boxes_xyxy, shape_hw)
    return np.asarray(cv2.distanceTransform(outside.astype(np.uint8), cv2.DIST_C, 3), np.float32)


def largest_changes(before: Picture, after: Picture, boxes_xyxy: Sequence[FloatArray]) -> FloatArray:
    """Return the largest absolute change in each of `BANDS_PX` around the boxes, and beyond the last one.

    Args:
        before: (h, w) background, 8-bit levels.
        after: (h, w) the same with inserted objects.
        boxes_xyxy: Exact boxes of the inserted objects, at least one.

    Returns:
        (12,) levels; 0 for a band outside the picture.
    """
    away, change = distance_px(before.shape, boxes_xyxy), np.abs(after - before)
    bands = pairwise([0, *BANDS_PX, np.inf])
    return np.array([float(change[(away > a) & (away <= b)].max(initial=0.0)) for a, b in bands])


def levels_around(
    picture: Picture, box_xyxy: FloatArray, others_xyxy: Sequence[FloatArray]
) -> tuple[float, FloatArray] | None:
    """Measure the level around an object against the ground further away.

    Distances count from the pixels of the box that differ from the ground by 30 % of the object's contrast, because
    hand-drawn boxes are loose.

    Args:
        picture: (h, w) 8-bit levels.
        box_xyxy: Box of the object.
        others_xyxy: Boxes of the other objects.

    Returns:
        Contrast of the object (5 or 95 % quantile of its box against the ground), and (11,) median level minus that of
        the ground in each of `BANDS_PX`, NaN where there is none. None if the object is small, faint, near the frame's
        edge or on uneven ground.
    """
    reach = _FAR_PX[1] + 1
    x0, y0, x1, y1 = pixel_box(box_xyxy, picture.shape)
    height, width = picture.shape
    if min(x0, y0) < reach or x1 > width - reach or y1 > height - reach or max(x1 - x0, y1 - y0) < _LEAST_SIDE_PX:
        return None
    part = (slice(y0 - reach, y1 + reach), slice(x0 - reach, x1 + reach))
    window, inside = picture[part], np.zeros(picture.shape, np.bool_)
    inside[y0:y1, x0:x1] = True
    inside = inside[part]
    free = distance_px(picture.shape, others_xyxy)[part] > _GAP_PX if others_xyxy else np.ones_like(inside)
    away = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, 5)
    ground = window[(away > _FAR_PX[0]) & (away <= _FAR_PX[1]) & free]
    if ground.size < 200 or ground.std() > _MOST_CLUTTER:
        return None
    level = float(np.median(ground))
    low, high = (float(v) - level for v in np.percentile(window[inside], [5, 95]))
    contrast = high if high >= -low else low
    if abs(contrast) < _LEAST_CONTRAST:
        return None
    seen = inside & (np.abs(window - level) > 0.3 * abs(contrast))
    away = cv2.distanceTransform((~seen).astype(np.uint8), cv2.DIST_L2, 5)
    found = []
    for a, b in pairwise([0, *BANDS_PX]):
        band = window[(away > a) & (away <= b) & free]
        found.append(float(np.median(band)) - level if band.size >= _LEAST_PIXELS else np.nan)
    return contrast, np.array(found)


if __name__ == "__main__":
    sys.exit(main())
