"""Measure what the frames of shipped recipes cost on real backgrounds: this working tree and another commit, in turns.

    python bench/recipes.py [OLD] --data HIT-UAV [--recipe hit-uav-cars ...] [--old-python PYTHON] [--repeat 1]

OLD is a commit such as 66cd77d; without one, only the working tree is measured. Both make the same frames, with one
worker, by `infrablend generate` in a process of its own. The cost of a frame is the slope between runs of 6 and of 24
backgrounds, which contain the 6: user and system seconds of all processes, so without their start. `plan_over_wall` is
the time that `generate --plan` predicts for the run of 24, over the time that it took by the clock; `start_s` what
remains of that time without the frames; `first_frame_s` the time from the command to the first picture on disk, with
warm caches. These need an idle machine. The constants in `pipeline.runs.forecast` are from here. Exits with 1 if a
limit is missed.
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
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from interleaved import sources_of

from infrablend.core.run_folder import RunFolder
from infrablend.formats import dataset_folder
from infrablend.formats.read_write import Reading

SIZES = (6, 24)
# Limits of CPU seconds per frame.
LIMITS_CPU_S = {
    "hit-uav-people": 0.35,
    "hit-uav-cars": 0.5,
    "deer-above": 0.4,
    "hit-uav-drone-physical": 0.15,
    "hit-uav-drone": 0.05,
}
PLAN_FACTOR, FIRST_FRAME_S = 1.5, 4.0
FIRST_FRAME_RECIPE = "hit-uav-drone-physical"
_POLL_S = 0.02


@dataclass(frozen=True)
class Side:
    """A version of the program: the folder of its package, and the Python that runs it."""

    sources: Path
    python: str = sys.executable

    def command(self, folder: Path, *options: str | Path) -> tuple[list[str], dict[str, str]]:
        """Return a command line of this version and its environment; the cache is inside `folder`."""
        environment = {**os.environ, "PYTHONPATH": str(self.sources), "XDG_CACHE_HOME": str(folder / "cache")}
        return [self.python, "-m", "infrablend", *map(str, options)], environment


@dataclass(frozen=True)
class Run:
    """Cost of a run: CPU and wall-clock seconds, the time of its first picture, its frames and inserted objects."""

    cpu_s: float
    wall_s: float
    first_s: float
    frames: int
    objects: int


@dataclass(frozen=True)
class Cost:
    """Runs of a recipe with few and with many backgrounds, in pairs, and the predicted seconds of the latter."""

    pairs: list[tuple[Run, Run]] = field(default_factory=list)
    predicted_s: float = float("nan")

    def to_json(self) -> dict[str, float]:
        """Return the medians over the pairs."""
        few, many = self.pairs[0]
        middle = statistics.median
        return {
            "cpu_s_per_frame": middle((m.cpu_s - f.cpu_s) / (m.frames - f.frames) for f, m in self.pairs),
            "objects_per_frame": (many.objects - few.objects) / (many.frames - few.frames),
            "plan_over_wall": self.predicted_s / middle(m.wall_s for _, m in self.pairs),
            "start_s": middle(
                f.wall_s - (m.wall_s - f.wall_s) / (m.frames - f.frames) * f.frames for f, m in self.pairs
            ),
            "first_frame_s": middle(run.first_s for pair in self.pairs for run in pair),
        }


def main() -> int:
    """Measure, and print a line per recipe and version; return 1 if a limit is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", nargs="?", help="commit to compare with")
    parser.add_argument("--data", type=Path, required=True, help="HIT-UAV; its val split is read")
    parser.add_argument("--recipe", action="append", help="only this recipe; repeatable")
    parser.add_argument("--old-python", default=sys.executable, help="Python with the packages that OLD needs")
    parser.add_argument("--repeat", type=int, default=1)
    given = parser.parse_args()
    missed = 0
    with tempfile.TemporaryDirectory(prefix="recipes-") as name:
        old = Side(sources_of(given.old, Path(name) / "old"), given.old_python) if given.old else None
        for recipe in given.recipe or LIMITS_CPU_S:
            for side, found in compare_recipe(recipe, given.data, Path(name), old, given.repeat).items():
                failures = missed_limits(recipe, found) if side == "new" else []
                missed += len(failures)
                print(json.dumps({"recipe": recipe, "side": side, **found, "missed": failures}), flush=True)
    return 1 if missed else 0


def compare_recipe(
    recipe: str, data: Path, folder: Path, old: Side | None = None, repeat: int = 1, sizes: tuple[int, int] = SIZES
) -> dict[str, dict[str, float]]:
    """Return what frames of a recipe cost in the working tree (`new`) and in another version, measured in turns."""
    new = Side(Path(__file__).resolve().parent.parent / "src")
    sides = {"new": new} if old is None else {"old": old, "new": new}
    names = spread_names(data, *sizes)
    costs = {}
    for side, version in sides.items():
        generate(version, recipe, data, folder / side, names[:1])  # fills the caches
        costs[side] = Cost(predicted_s=predict(version, recipe, data, folder / side, names))
    for _ in range(repeat):
        for side, version in sides.items():
            few, many = (generate(version, recipe, data, folder / side, names[:n]) for n in sizes)
            costs[side].pairs.append((few, many))
    return {side: {k: round(v, 4) for k, v in cost.to_json().items()} for side, cost in costs.items()}


def missed_limits(recipe: str, found: dict[str, float]) -> list[str]:
    """Return the names of the figures that miss their limit."""
    met = {
        "cpu_s_per_frame": found["cpu_s_per_frame"] <= LIMITS_CPU_S.get(recipe, float("inf")),
        "plan_over_wall": 1 / PLAN_FACTOR <= found["plan_over_wall"] <= PLAN_FACTOR,
        "first_frame_s": recipe != FIRST_FRAME_RECIPE or found["first_frame_s"] <= FIRST_FRAME_S,
    }
    return [name for name, good in met.items() if not good]


def spread_names(data: Path, few: int, many: int) -> list[str]:
    """Return the names of `many` backgrounds spread over the val split; the first `few` are spread over it, too."""
    images = dataset_folder.read(data, Reading(splits=("val",))).images or dataset_folder.read(data).images
    chosen = [f"{i.split}/{i.id}" for i in (images[n * len(images) // many] for n in range(many))]
    step = many // few
    return [name for start in range(step) for name in chosen[start::step]]


def predict(version: Side, recipe: str, data: Path, folder: Path, names: list[str]) -> float:
    """Return the seconds that `generate --plan` predicts for a run."""
    command, environment = version.command(folder, *_options(recipe, data, folder / "run", names), "--plan", "--json")
    found: dict[str, Any] = json.loads(_checked(subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )))  # fmt: skip
    return float(found["about_s"])


def generate(version: Side, recipe: str, data: Path, folder: Path, names: list[str]) -> Run:
    """Make the frames of these backgrounds with one worker, and measure it."""
    out = folder / "run"
    shutil.rmtree(out, ignore_errors=True)
    command, environment = version.command(folder, *_options(recipe, data, out, names))
    before, begun, first_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic(), float("nan")
    running = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while running.poll() is None:
        if first_s != first_s and any(folder.rglob("images/*/[!.]*.*")):
            first_s = time.monotonic() - begun
        time.sleep(_POLL_S)
    wall_s = time.monotonic() - begun
    _checked(running)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    counts = json.loads(RunFolder(out).run_file.read_text())["counts"]
    return Run(cpu_s, wall_s, first_s, counts["frames"], counts["objects_inserted"])


def _options(recipe: str, data: Path, out: Path, names: list[str]) -> list[str | Path]:
    options = ["generate", recipe, "--data", data, "--out", out, "--frames", ",".join(names), "--workers", "1"]
    return [*options, "--split", names[0].partition("/")[0], "--device", "cpu"]


def _checked(process: subprocess.Popen[str]) -> str:
    """Return what a process has written, or exit with its error."""
    output, errors = process.communicate()
    if process.returncode:
        raise SystemExit(f"{' '.join(map(str, process.args))}: exit code {process.returncode}\n{errors[-2000:]}")  # type: ignore[arg-type]
    return output


if __name__ == "__main__":
    sys.exit(main())
