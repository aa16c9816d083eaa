"""Measure frames per CPU second of `api.frames` against `generate`: `bench/in_memory.py DATA [--frames N]`."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

# Each way runs in a process of its own: CPU time counts with all of its workers.
_GENERATE = """
from infrablend import api
selection = api.FrameSelection(sample={backgrounds})
api.generate({recipe!r}, {data!r}, {out!r}, selection=selection, execution=api.Execution(workers=2))
"""
_IN_MEMORY = """
from infrablend import api
selection = api.FrameSelection(sample={backgrounds})
with api.frames({recipe!r}, {data!r}, selection=selection, execution=api.Execution(workers=2)) as frames:
    for frame in frames:
        assert frame.pixels.size
"""
_TIME = """
import resource
used = [resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
print(sum(u.ru_utime + u.ru_stime for u in used))
"""


def main() -> None:
    """Print the CPU seconds of both ways and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data")
    parser.add_argument("--recipe", default="hit-uav-drone")
    parser.add_argument("--backgrounds", type=int, default=30)
    parser.add_argument("--repeats", type=int, default=2)
    options = parser.parse_args()
    seconds: dict[str, list[float]] = {"generate": [], "frames": []}
    for repeat in range(options.repeats):
        for name, program in (("generate", _GENERATE), ("frames", _IN_MEMORY)):
            with tempfile.TemporaryDirectory() as folder:
                out = str(Path(folder) / f"run{repeat}")
                values = {"recipe": options.recipe, "data": options.data, "out": out}
                code = program.format(backgrounds=options.backgrounds, **values) + _TIME
                done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
            seconds[name].append(float(done.stdout.split()[-1]))
    best = {name: min(values) for name, values in seconds.items()}
    print(json.dumps({"cpu_seconds": seconds, "frames_per_cpu_second": round(best["generate"] / best["frames"], 3)}))


if __name__ == "__main__":
    main()
