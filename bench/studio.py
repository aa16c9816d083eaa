"""Measure how long the studio takes to redraw a frame after a setting changed: `bench/studio.py DATA [--repeats N]`."""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from infrablend.pipeline.trial import TrialRequest
from infrablend.studio.pictures import to_png
from infrablend.studio.tuning import Tuning


def main() -> None:
    """Print median and 95 % quantile of the seconds from a changed temperature to the encoded picture with boxes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--recipe", default="hit-uav-drone-physical")
    parser.add_argument("--size-px", type=float, default=60.0, help="size of the drone in the picture")
    parser.add_argument("--repeats", type=int, default=40)
    options = parser.parse_args()
    tuning = Tuning(TrialRequest(options.recipe, options.data))
    try:
        background = tuning.backgrounds[0]
        # A drone has this size at a distance of 10 to 20 m.
        size = {"placement.size_px": [options.size_px * 0.9, options.size_px * 1.1], "objects.0.range_m": [10, 20]}
        seconds = []
        for warmth in np.linspace(2.0, 20.0, options.repeats + 2):
            settings = {**size, "environment.air_temperature_c": [warmth, warmth]}
            start = time.perf_counter()
            tuned = tuning.compose(options.recipe, settings, background)
            to_png(tuned.picture(boxes=True))
            seconds.append(time.perf_counter() - start)
        drawn = [max(i.box_xyxy[2:] - i.box_xyxy[:2]) for i in tuned.trial.frame.inserted]
    finally:
        tuning.close()
    # The first two frames load the models and the background.
    median, slow = np.percentile(seconds[2:], [50, 95])
    result = {"frames": options.repeats, "inserts_px": [round(float(d)) for d in drawn]}
    print(json.dumps({**result, "median_s": round(float(median), 3), "p95_s": round(float(slow), 3)}))


if __name__ == "__main__":
    main()
