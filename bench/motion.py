"""How well the movement of the camera is known: a still object against the background, and there and back.

    .venv/bin/python bench/motion.py DATA [--read every=1]

Corners other than those of the estimate are followed from one frame to the next, and over a second; the table has the
median and the 95th percentile of their distance from where the estimate puts them, px. `back` is how far a still object
is from where it was after 100 frames forwards and back. CPU is that of the estimate alone, ms a frame.
"""

from __future__ import annotations

import argparse
import time
from itertools import islice
from pathlib import Path

import numpy as np

from infrablend.formats import dataset_folder
from infrablend.formats.read_write import Reading
from infrablend.imaging.camera_path import follow_camera
from infrablend.imaging.camera_shift import find_corners, follow, moved
from infrablend.pipeline.plans.sequence_motion import sequence_views, sequences_of

FAR_PX = 4  # other corners are at least so far from those of the estimate
THERE = 100


def main() -> None:
    """Print a row per sequence."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--read", metavar="KEY=VALUE", action="append", default=[], help="option of the reader")
    options = parser.parse_args()
    dataset = dataset_folder.read(options.data, Reading(options=dict(o.split("=", 1) for o in options.read)))
    head = ("sequence", "frames", "known", "next, px", "a second, px", "back, px", "CPU, ms")
    print("{:16} {:>6} {:>6} {:>14} {:>14} {:>9} {:>8}".format(*head))
    for name, images in sequences_of(dataset).items():
        views = list(sequence_views(images))
        began = time.process_time()
        moments = follow_camera(views)
        cpu = (time.process_time() - began) / len(views) * 1e3
        cells = []
        for step in (1, 25):
            apart = [apart_px(views, moments, k - step, k) for k in range(25, len(views), 7)]
            every = np.concatenate([a for a in apart if a is not None] or [np.full(1, np.nan)])
            cells.append(f"{np.median(every):6.2f} {np.percentile(every, 95):7.2f}")
        there = list(islice(views, THERE + 1))
        last = follow_camera(there + there[-2::-1])[-1]
        width, height = views[0].size_wh
        points = np.array([(width / 2, height / 2), (0, 0), (width, height)])
        back = float(np.linalg.norm(moved(points, last.to_first) - points, axis=1).max()) if last.known else np.nan
        known = sum(m.known for m in moments)
        print(
            f"{name[:16]:16} {len(views):6} {known:6} {cells[0]:>14} {cells[1]:>14} {back:9.2f} {cpu:8.1f}", flush=True
        )


def apart_px(views, moments, a, b):
    """Return how far other corners of frame `a` are from where the estimate puts them in frame `b`; None if unknown."""
    if not (moments[a].known and moments[a].span == moments[b].span):
        return None
    first, second = views[a], views[b]
    corners = find_corners(first, 1500, 3.0)
    if len(first.corners) and len(corners):
        corners = corners[np.linalg.norm(corners[:, None] - first.corners[None], axis=2).min(axis=1) > FAR_PX]
    if len(corners) < 5:
        return None
    matrix = np.linalg.inv(moments[b].to_first) @ moments[a].to_first
    there, certain = follow(first, second, corners, matrix)
    return np.linalg.norm(moved(corners[certain], matrix) - there[certain], axis=1)


if __name__ == "__main__":
    main()
