"""Compare the CPU time of `generate` per frame between two commits, in turns: noise then hits both alike.

    python bench/interleaved.py OLD [NEW] [--renderer flat,blender] [--frames 40] [--pairs 5] [--recipe hit-uav-drone]
                                [--set KEY=VALUE ...] [--old-python PYTHON]

NEW is the working tree by default. Each run is a process of its own on one core; its user and system time, with that of
its children, is counted from its start to its end, so the frames bear the start of Python and Blender, too. Prints the
median of each side, and the median of the ratios of the pairs.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
SIZE_WH = (640, 512)
_RUN = """
import sys
from infrablend import api
recipe, data, out, renderer, *settings = sys.argv[1:]
settings = ["camera.pitch={fixed_deg: 60}", "output.formats=[coco, yolo, voc]", *settings]
flat = renderer == "flat"
if hasattr(api, "Execution"):
    execution = api.Execution(workers=1, renderer=renderer, in_process=flat)
    api.generate(recipe, data, out, settings=settings, execution=execution)
else:
    api.generate(recipe, data, out, settings=settings, workers=1, renderer=renderer, in_process=flat)
"""


def main() -> int:
    """Measure and print the comparison."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", help="commit")
    parser.add_argument("new", nargs="?", help="commit [default: the working tree]")
    parser.add_argument("--renderer", default="flat,blender")
    parser.add_argument("--recipe", default="hit-uav-drone")
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--old-python", default=sys.executable, help="Python with the packages that OLD needs")
    parser.add_argument("--set", action="append", default=[], help="setting of both sides; repeatable")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="interleaved-") as name:
        folder = Path(name)
        sources = {side: sources_of(commit, folder / side) for side, commit in (("old", given.old), ("new", given.new))}
        _write_pictures(folder / "data", given.frames)
        for renderer in given.renderer.split(","):
            seconds: dict[str, list[float]] = {"old": [], "new": []}
            for pair in range(given.pairs):
                for side in ("old", "new") if pair % 2 == 0 else ("new", "old"):
                    python = given.old_python if side == "old" else sys.executable
                    options = [given.recipe, folder / "data", folder / "out", renderer, *given.set]
                    used = _measure(python, sources[side], folder, options)
                    seconds[side].append(used / given.frames)
                    print(f"{renderer} {side}: {used:.2f} CPU s", file=sys.stderr, flush=True)
            ratios = [new / old for old, new in zip(seconds["old"], seconds["new"], strict=True)]
            facts = {
                "renderer": renderer,
                "recipe": given.recipe,
                "settings": given.set,
                "frames": given.frames,
                "pairs": given.pairs,
                "old_cpu_s_per_frame": round(statistics.median(seconds["old"]), 4),
                "new_cpu_s_per_frame": round(statistics.median(seconds["new"]), 4),
                "median_ratio": round(statistics.median(ratios), 4),
                "ratios": [round(r, 4) for r in ratios],
            }
            print(json.dumps(facts), flush=True)
    return 0


def sources_of(commit: str | None, folder: Path) -> Path:
    """Return the folder of the package at a commit, or that of the working tree."""
    if commit is None:
        return ROOT / "src"
    folder.mkdir()
    archive = subprocess.run(["git", "-C", ROOT, "archive", commit, "src"], stdout=subprocess.PIPE, check=True).stdout
    subprocess.run(["tar", "-x", "-C", folder], input=archive, check=True)
    return folder / "src"


def _write_pictures(folder: Path, count: int) -> None:
    """Write grey pictures with the texture of noise and slow gradients."""
    folder.mkdir()
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.linspace(0, 60, SIZE_WH[0]), np.linspace(0, 40, SIZE_WH[1]))
    for n in range(count):
        pixels = np.clip(70 + x + y + rng.normal(0, 6, x.shape), 0, 255).astype(np.uint8)
        Image.fromarray(pixels).save(folder / f"{n:04}.png")


def _measure(python: str, sources: Path, folder: Path, arguments: list[str | Path]) -> float:
    """Return the CPU seconds of one run and its children."""
    shutil.rmtree(folder / "out", ignore_errors=True)
    environment = {
        **os.environ, "PYTHONPATH": str(sources), "OMP_NUM_THREADS": "1", "XDG_CACHE_HOME": str(folder / "cache"),
    }  # fmt: skip
    core = sorted(os.sched_getaffinity(0))[0]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = ["taskset", "-c", str(core), python, "-c", _RUN, *arguments]
    ended = subprocess.run(command, env=environment, capture_output=True, check=False)
    if ended.returncode:
        raise SystemExit(f"{sources}: {ended.stderr.decode(errors='replace')[-2000:]}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    sys.exit(main())
