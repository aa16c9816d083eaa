"""Measure `infrablend try`: cold for the first, the tenth and the last frame, and in `--watch` after a change.

`bench/trial.py DATA [--recipe NAME] [--repeats N]` prints the median seconds by the clock and the CPU seconds of all
processes beside each other, with the load of the machine: on a busy machine only the CPU seconds say something.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil

from infrablend import api
from infrablend.config.loading import recipe_text

COMMAND = (sys.executable, "-m", "infrablend", "-q", "try")


def main() -> None:
    """Print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--recipe", default="hit-uav-drone")
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    names = [f"{i.split}/{i.id}" for i in api.read_dataset(options.data).images]
    frames = {"first": names[0], "tenth": names[min(9, len(names) - 1)], "last": names[-1]}
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        recipe = Path(folder) / "recipe.yaml"
        recipe.write_text(recipe_text(options.recipe))
        cold: dict[str, list[tuple[float, float]]] = {name: [] for name in frames}
        for _ in range(options.repeats + 1):
            for name, frame in frames.items():
                cold[name].append(cold_try(recipe, options.data, frame))
        watch = watched(recipe, options.data, frames["tenth"], 2 * options.repeats)
    result: dict[str, Any] = {name: _medians(times[1:]) for name, times in cold.items()}  # the first fills disk caches
    result["watch"] = _medians(watch)
    print(json.dumps({"pictures": len(names), **result, "load": [round(load, 1), round(os.getloadavg()[0], 1)]}))


def cold_try(recipe: Path, data: Path, frame: str) -> tuple[float, float]:
    """Return the seconds of a whole command by the clock, and the CPU seconds of its processes."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    out = recipe.with_name("try.png")
    subprocess.run([*COMMAND, recipe, "--data", data, "--frame", frame, "--out", out], check=True, capture_output=True)
    seconds, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return seconds, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def watched(recipe: Path, data: Path, frame: str, repeats: int) -> list[tuple[float, float]]:
    """Return the seconds from a saved recipe to the written picture, and the CPU seconds in between."""
    found = []
    words = [*COMMAND, recipe, "--data", data, "--frame", frame, "--out", recipe.with_name("watch.png"), "--watch"]
    text = recipe.read_text()
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            _await_picture(process)
            for number in range(repeats + 1):
                time.sleep(0.5)  # the command goes back to waiting
                before, start = _cpu_seconds(process.pid), time.perf_counter()
                recipe.write_text(f"{text}\n# {number}\n")
                _await_picture(process)
                found.append((time.perf_counter() - start, _cpu_seconds(process.pid) - before))
        finally:
            process.kill()
    return found[1:]


def _await_picture(process: subprocess.Popen[str]) -> None:
    assert process.stdout is not None
    while not process.stdout.readline().strip().endswith("watch.png"):
        if process.poll() is not None:
            raise RuntimeError("the watch has ended")


def _cpu_seconds(process: int) -> float:
    root = psutil.Process(process)
    times = [p.cpu_times() for p in (root, *root.children(recursive=True))]
    return sum(t.user + t.system for t in times)


def _medians(times: list[tuple[float, float]]) -> dict[str, float]:
    clock, cpu = zip(*times, strict=True)
    return {"clock_s": round(statistics.median(clock), 2), "cpu_s": round(statistics.median(cpu), 2)}


if __name__ == "__main__":
    main()
