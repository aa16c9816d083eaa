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
from pathlib import Path

import numpy as np
from infrablend.pipeline.record import read_record
from numpy.typing import NDArray

from infrablend import api
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.run_folder import RunFolder
from infrablend.formats.images import load_background
from infrablend.realism.surroundings import BANDS_PX, largest_changes, levels_around

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
    for record in filter(None, map(read_record, folder.records())):
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


if __name__ == "__main__":
    sys.exit(main())
