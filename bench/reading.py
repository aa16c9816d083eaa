"""Measure the CPU seconds of reading and checking HIT-UAV's labels, and of building a model's mesh.

    INFRABLEND_REAL_DATA=... .venv/bin/python bench/reading.py

Each figure is the best of five, so that other loads on the machine count little. The exit code is 1 if one is above its
limit. The tests count opened files and calls instead, which no load changes.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

from infrablend import api
from infrablend.assets import car
from infrablend.formats import dataset_folder

REPEATS = 5


def cpu_seconds(work: Callable[[], object]) -> float:
    """Return the CPU seconds of the fastest repeat."""
    spent = []
    for _ in range(REPEATS):
        begun = time.process_time()
        work()
        spent.append(time.process_time() - begun)
    return min(spent)


def main() -> int:
    """Print each figure with its limit; return 1 if a limit is missed, 2 without the data."""
    named = os.environ.get("INFRABLEND_REAL_DATA")
    if not named:
        print("set INFRABLEND_REAL_DATA to the folder that contains hit-uav")
        return 2
    root = Path(named) / "hit-uav"
    measured: list[tuple[str, float, Callable[[], object]]] = [
        ("read all four forms of HIT-UAV", 3.0, lambda: dataset_folder.read(root)),
        ("check HIT-UAV without decoding", 5.0, lambda: api.check(root, decode=False)),
        ("build a car", 0.1, lambda: car.MODEL.build(car.NOMINAL)),
    ]
    missed = 0
    for name, limit_s, work in measured:
        seconds = cpu_seconds(work)
        missed += seconds > limit_s
        print(f"{'FAIL' if seconds > limit_s else 'PASS'}  {name}: {seconds:.3f} CPU-s (<= {limit_s:g})", flush=True)
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
