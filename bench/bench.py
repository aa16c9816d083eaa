"""`make bench`: measure speed, error, boxes and memory on frames of the shipped recipe, against the project's limits.

Writes build/bench/bench.json and bench.png; the exit code is 1 if a limit is missed. On two cores it takes about half
an hour, most of it for frames made the paper's way. The methods are described in docs/explanation/performance.md
(time, memory) and docs/explanation/quality.md (error, boxes).
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from boxes import BoxFit, measure_boxes
from children import Child, in_parallel, own_cores, start
from interleaved import sources_of
from memory import Memory, measure_memory
from quality import LEAST_SPAN_GREY, REFERENCE_SAMPLES, joined, measure_errors, summary
from scenes import PHYSICAL_RECIPE, RECIPE, SEED, Work, distribution, part_of_plan, plan_of, quantiles, spread
from variants import DEFAULT_THRESHOLD, PAPER_SAMPLES, split_program, time_full_frames, time_label_files, time_program

from infrablend.pipeline.plans.plan import RunPlan
from infrablend.rendering.engine.renderer import MATCHED
from infrablend.rendering.lattice import FRAGMENTS, SUPERSAMPLE
from recipes import FIRST_FRAME_RECIPE, FIRST_FRAME_S, LIMITS_CPU_S, PLAN_FACTOR, SIZES, Side, compare_recipe

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "build" / "bench"
HISTORY = ROOT / "bench" / "history.jsonl"
DATA_VARIABLE = "INFRABLEND_REAL_DATA"
MODELS = ("drone", "deer")
SIZES_PX = (20, 10)


@dataclass(frozen=True)
class Amount:
    """Amounts to measure."""

    frames: int = 44
    repeats: int = 3
    poses: int = 200
    memory_frames: int = 500
    world_images: int = 24
    recipe_images: tuple[int, int] = SIZES


QUICK = Amount(frames=2, repeats=1, poses=10, memory_frames=60, world_images=2, recipe_images=(1, 2))
# The naive way of many objects: the shape of each over the whole frame, as of this commit.
NAIVE_COMMIT, NAIVE_RECIPE = "66cd77d", "hit-uav-cars"


@dataclass(frozen=True)
class Bar:
    """Limit on a measured figure."""

    key: str
    text: str
    limit: float
    at_least: bool = False

    def met(self, value: float) -> bool:
        """Return True if the value meets the limit; NaN does not."""
        return value >= self.limit if self.at_least else value <= self.limit


BARS = (
    Bar("speedup", "CPU-s per frame, times better than the paper's way", 100.0, at_least=True),
    Bar("cpu_s_per_frame", "CPU-s per frame", 0.085),
    Bar("mean_error_grey", "mean error, grey levels", 0.5),
    Bar("p99_error_grey", "99th percentile of the error, grey levels", 4.0),
    Bar("box_iou_20px", "mean IoU of boxes at 20 px, worse model", 0.98, at_least=True),
    Bar("box_iou_10px", "mean IoU of boxes at 10 px, worse model", 0.90, at_least=True),
    Bar("peak_worker_rss_mb", "peak memory of a worker, MiB", 1024.0),
    Bar("rss_slope_mb_per_100_frames", "growth of a worker's memory, MiB per 100 frames", 2.0),
    *(
        Bar(f"{recipe}_cpu_s_per_frame", f"CPU-s per frame of {recipe}", limit)
        for recipe, limit in LIMITS_CPU_S.items()
    ),
    Bar("plan_factor", "predicted time of a run, times off, worst recipe", PLAN_FACTOR),
    Bar("first_frame_s", "seconds to the first frame of the physical look", FIRST_FRAME_S),
)


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print and write the results; return 0 if every limit is met, else 1."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--data", type=Path, help=f"HIT-UAV; default ${DATA_VARIABLE}, else a virtual world is made")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="a few frames, to check that the benchmark works; the figures are not valid",
    )
    parser.add_argument("--record", action="store_true", help="append the result to bench/history.jsonl")
    parser.add_argument(
        "--naive", default=NAIVE_COMMIT, help="commit to measure many objects the naive way; '' for none"
    )
    parser.add_argument("--naive-python", default=sys.executable, help="Python with the packages that it needs")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args(argv)
    amount = QUICK if options.quick else Amount()
    begun, measured = time.monotonic(), commit()
    options.out.mkdir(parents=True, exist_ok=True)

    data, name = backgrounds(options.data, options.out, amount)
    say(f"backgrounds: {name}")
    plan = plan_of(data)
    if len(plan.frames) < amount.frames:
        say(f"{data}: gives {len(plan.frames)} frames, the bars ask for {amount.frames}; give more backgrounds")
        return 2
    work = spread(plan, amount.frames, options.out)
    found = measure(plan, work, amount, options.out)
    found |= measure_physical(
        spread(plan_of(data, PHYSICAL_RECIPE), amount.frames, options.out / "physical"), options.out
    )
    with tempfile.TemporaryDirectory(prefix="recipes-") as folder:
        naive = options.naive and Side(sources_of(options.naive, Path(folder) / "naive"), options.naive_python)
        found |= measure_recipes(data, Path(folder), naive or None, amount)
    report = {
        **found,
        "backgrounds": name,
        "commit": measured,
        "machine": machine(),
        "settings": settings(amount, options.quick),
        "seconds": round(time.monotonic() - begun, 1),
    }
    missed = [bar for bar in BARS if not bar.met(report[bar.key])]
    report["bars"] = {bar.key: {"limit": bar.limit, "met": bar not in missed} for bar in BARS}
    memory = report.pop("_rss_mb")
    errors = report.pop("_errors")
    (options.out / "bench.json").write_text(json.dumps(report, indent=2, sort_keys=True) + "\n")
    draw(report, errors, memory, options.out / "bench.png")
    if options.record:
        with HISTORY.open("a") as history:
            history.write(json.dumps(kept(report), sort_keys=True) + "\n")
    show(report)
    if options.quick:
        say("the figures of a quick run are not valid: too few frames, and memory has not settled")
    say(f"written: {relative(options.out / 'bench.json')}, {relative(options.out / 'bench.png')}")
    return 1 if missed and not options.quick else 0


def backgrounds(given: Path | None, out: Path, amount: Amount) -> tuple[Path, str]:
    """Return the dataset to measure on, and its name in the report."""
    real = given or (Path(os.environ[DATA_VARIABLE]) if os.environ.get(DATA_VARIABLE) else None)
    if real is not None:
        below = real / "hit-uav"
        return (below if below.is_dir() else real), "HIT-UAV"
    from infrablend import api

    folder = out / f"world_{amount.world_images}"
    if not folder.is_dir():
        say(f"no {DATA_VARIABLE}: rendering a virtual thermal world of {amount.world_images} images")
        unfinished = folder.with_name(folder.name + "_unfinished")
        shutil.rmtree(unfinished, ignore_errors=True)
        api.make_world(unfinished, amount.world_images, SEED, workers=2)
        unfinished.rename(folder)
    return folder, "virtual thermal world"


def measure(plan: RunPlan, work: Work, amount: Amount, out: Path) -> dict[str, Any]:
    """Run all measurements, in an order that keeps both cores equally busy."""
    cores = own_cores()
    logs = out / "log"
    spread_of = distribution(work, plan)
    say(f"{len(work.frames)} frames of {RECIPE}, seed {SEED}:")
    for key, row in spread_of.items():
        say(f"  {key:12} " + "  ".join(f"{k} {v:g}" for k, v in row.items()))
    for folder in ("naive", "defaults", "program", "memory"):
        shutil.rmtree(out / folder, ignore_errors=True)

    def halves(of: Work) -> list[Work]:
        return [of.part(n, len(cores)) for n in range(len(cores))]

    say(f"the paper's way: whole frame, {PAPER_SAMPLES} samples (takes most of the time)")
    naive = rows(
        in_parallel(time_full_frames, [(w, False) for w in halves(work.into(out / "naive"))], cores, logs / "naive.log")
    )
    say_cpu(naive)
    say(f"Blender's defaults: adaptive {DEFAULT_THRESHOLD:g}, denoiser")
    defaults = rows(
        in_parallel(
            time_full_frames, [(w, True) for w in halves(work.into(out / "defaults"))], cores, logs / "defaults.log"
        )
    )
    say_cpu(defaults)

    say("this program")
    repeats = []
    for n in range(amount.repeats):
        done = rows(
            in_parallel(
                time_program, [(w,) for w in halves(work.into(out / "program"))], cores, logs / f"program_{n}.log"
            )
        )
        label_s: float = start(
            time_label_files, part_of_plan(plan, work.frames), out / "program", core=cores[0], log=logs / "labels.log"
        ).result()
        repeats.append((done, label_s / len(work.frames)))
        say_cpu(done, label_s / len(work.frames))
    totals = [mean_cpu(done) + label_s for done, label_s in repeats]
    wall = [statistics.fmean(r["wall_s"] for r in done) + label_s for done, label_s in repeats]
    shares = in_parallel(split_program, [(w,) for w in halves(work.into(out / "program"))], cores, logs / "split.log")
    parts = {name: statistics.fmean(share[name] for share in shares) for name in shares[0]}
    parts["label files"] = statistics.fmean(label_s for _, label_s in repeats)
    for name, seconds in sorted(parts.items(), key=lambda item: -item[1]):
        say(f"  {1000 * seconds:7.1f} ms  {name}")

    say(f"error against {REFERENCE_SAMPLES:,} samples")
    whole = {"naive": out / "naive", "defaults": out / "defaults"}
    errors = joined(in_parallel(measure_errors, [(w, whole) for w in halves(work)], cores, logs / "errors.log"))
    errors_of = {name: summary(values) for name, values in errors.by_way.items()}
    for name, row in errors_of.items():
        say(
            f"  {name:9} mean {row['mean']:.3f}  p99 {row['p99']:.2f}  max {row['max']:.1f}  ({row['pixels']:,} pixels)"
        )

    say("memory and boxes")
    long = spread(plan, amount.memory_frames, out / "memory")
    keeping = start(measure_memory, long, amount.memory_frames, core=cores[0], log=logs / "memory.log")
    fits = measure_all_boxes(amount, cores[-1], logs)
    memory: Memory = keeping.result()
    boxes = {
        f"{model}_{size}px": {
            "mean": statistics.fmean(f.iou for f in fit),
            "p5": quantiles([f.iou for f in fit])["p5"],
            "poses": len(fit),
            "size_px": quantiles([f.size_px for f in fit]),
        }
        for (model, size), fit in fits.items()
    }
    naive_s, own_s = mean_cpu(naive), statistics.median(totals)
    return {
        "frames": len(work.frames),
        "naive_cpu_s_per_frame": naive_s,
        "defaults_cpu_s_per_frame": mean_cpu(defaults),
        "cpu_s_per_frame": own_s,
        "cpu_s_per_frame_of_repeats": totals,
        "speedup": naive_s / own_s,
        # On this machine, one worker per core.
        "frames_per_s": len(cores) / statistics.median(wall),
        "label_files_cpu_s_per_frame": parts["label files"],
        "parts_cpu_s_per_frame": parts,
        "mean_error_grey": errors_of["program"]["mean"],
        "p99_error_grey": errors_of["program"]["p99"],
        "errors_grey": errors_of,
        "object_span_grey": quantiles(errors.span_grey),
        "box_iou_20px": min(v["mean"] for k, v in boxes.items() if k.endswith("_20px")),
        "box_iou_10px": min(v["mean"] for k, v in boxes.items() if k.endswith("_10px")),
        "boxes": boxes,
        "peak_worker_rss_mb": memory.peak_mb,
        "rss_slope_mb_per_100_frames": memory.slope_mb_per_100_frames,
        "memory_frames": len(memory.rss_mb),
        "distribution": spread_of,
        "_errors": errors.by_way,
        "_rss_mb": memory.rss_mb,
    }


def measure_physical(work: Work, out: Path) -> dict[str, Any]:
    """Measure frames of the physical look with the whole chain: placement, matching, light, sensor."""
    cores, logs = own_cores(), out / "log"
    shutil.rmtree(work.settings.out or out / "physical", ignore_errors=True)
    say(f"{len(work.frames)} frames of {PHYSICAL_RECIPE}")
    halves = [(work.part(n, len(cores)),) for n in range(len(cores))]
    done = rows(in_parallel(time_program, halves, cores, logs / "physical.log"))
    say_cpu(done)
    shares = in_parallel(split_program, halves, cores, logs / "physical_split.log")
    parts = {name: statistics.fmean(share[name] for share in shares) for name in shares[0]}
    for name, seconds in sorted(parts.items(), key=lambda item: -item[1]):
        say(f"  {1000 * seconds:7.1f} ms  {name}")
    return {"physical_cpu_s_per_frame": mean_cpu(done), "physical_parts_cpu_s_per_frame": parts}


def measure_recipes(data: Path, folder: Path, naive: Side | None, amount: Amount) -> dict[str, Any]:
    """Measure runs of recipes with one worker, one of them also the naive way; see `recipes`."""
    say("runs of recipes with one worker")
    found: dict[str, Any] = {"recipes": {}}
    for recipe in LIMITS_CPU_S:
        old = naive if recipe == NAIVE_RECIPE else None
        costs = compare_recipe(recipe, data, folder, old, sizes=amount.recipe_images)
        found["recipes"][recipe] = {"naive" if side == "old" else "program": cost for side, cost in costs.items()}
        found[f"{recipe}_cpu_s_per_frame"] = costs["new"]["cpu_s_per_frame"]
        for way, cost in found["recipes"][recipe].items():
            say(f"  {recipe} ({way}): " + "  ".join(f"{key} {value:g}" for key, value in cost.items()))
    ratios = [row["program"]["plan_over_wall"] for row in found["recipes"].values()]
    found["plan_factor"] = max(max(r, 1 / r) for r in ratios)
    found["first_frame_s"] = found["recipes"][FIRST_FRAME_RECIPE]["program"]["first_frame_s"]
    return found


def measure_all_boxes(amount: Amount, core: int, logs: Path) -> dict[tuple[str, int], list[BoxFit]]:
    """Measure the box fit of every model at every size, one after the other on one core."""
    found = {}
    for model in MODELS:
        for size in SIZES_PX:
            child: Child = start(
                measure_boxes, model, float(size), amount.poses, core=core, log=logs / f"boxes_{model}_{size}.log"
            )
            found[model, size] = child.result()
    return found


def rows(shares: Sequence[list[dict[str, Any]]]) -> list[dict[str, Any]]:
    """Return the rows of all shares, sorted by frame."""
    return sorted((row for share in shares for row in share), key=lambda row: row["frame"])


def mean_cpu(done: Sequence[dict[str, Any]]) -> float:
    """Return the CPU seconds per frame."""
    return statistics.fmean(row["cpu_s"] for row in done)


def commit() -> str:
    """Return the commit that is measured, with a mark if files differ from it."""
    git: Callable[..., str] = lambda *a: subprocess.run(  # noqa: E731
        ["git", "-C", str(ROOT), *a], capture_output=True, text=True, check=False
    ).stdout.strip()
    head = git("rev-parse", "HEAD") or "unknown"
    return head + ("-modified" if git("status", "--porcelain", "--untracked-files=no", "src") else "")


def machine() -> dict[str, Any]:
    """Return the machine's facts."""
    names = [
        line.partition(":")[2].strip()
        for line in Path("/proc/cpuinfo").read_text().splitlines()
        if line.startswith("model name")
    ]
    return {
        "processor": names[0] if names else platform.processor(),
        "cores": os.cpu_count(),
        "cores_used": len(own_cores()),
        "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        "system": platform.platform(),
        "load_at_end": round(os.getloadavg()[1], 1),
    }


def settings(amount: Amount, quick: bool) -> dict[str, Any]:
    """Return the settings of the measurement."""
    return {
        "recipe": RECIPE,
        "seed": SEED,
        "quick": quick,
        "amount": asdict(amount),
        "paper_samples": PAPER_SAMPLES,
        "defaults": {"adaptive_threshold": DEFAULT_THRESHOLD, "samples": PAPER_SAMPLES, "denoiser": True},
        "matched": asdict(MATCHED),
        "lattice": {"samples_along_pixel": SUPERSAMPLE, "fragments": FRAGMENTS},
        "reference_samples": REFERENCE_SAMPLES,
        "least_object_span_grey": LEAST_SPAN_GREY,
        "python": platform.python_version(),
        "packages": {p: metadata.version(p) for p in ("bpy", "numpy", "opencv-python-headless", "Pillow")},
    }


def kept(report: dict[str, Any]) -> dict[str, Any]:
    """Return the line for the history file."""
    names = [
        "frames", "naive_cpu_s_per_frame", "defaults_cpu_s_per_frame", "cpu_s_per_frame", "speedup", "frames_per_s",
        "physical_cpu_s_per_frame", "mean_error_grey", "p99_error_grey", "box_iou_20px", "box_iou_10px",
        "peak_worker_rss_mb", "rss_slope_mb_per_100_frames", "recipes", "backgrounds", "commit", "settings",
    ]  # fmt: skip
    day = datetime.datetime.now(datetime.UTC).date().isoformat()
    line = {n: round(report[n], 4) if isinstance(report[n], float) else report[n] for n in names}
    return {**line, "date": day, "machine": {k: report["machine"][k] for k in ("processor", "cores")}}


def show(report: dict[str, Any]) -> None:
    """Print the results beside the limits."""
    say("")
    say(f"the paper's way   {report['naive_cpu_s_per_frame']:8.3f} CPU-s per frame")
    say(f"Blender defaults  {report['defaults_cpu_s_per_frame']:8.3f}")
    rate = f"{report['frames_per_s']:.1f} frames/s on {report['machine']['cores_used']} cores"
    say(f"this program      {report['cpu_s_per_frame']:8.3f}   {rate}")
    say(f"physical look     {report['physical_cpu_s_per_frame']:8.3f}   with the whole chain")
    naive, own = (report["recipes"][NAIVE_RECIPE].get(way, {}).get("cpu_s_per_frame") for way in ("naive", "program"))
    say(
        f"{NAIVE_RECIPE}      {own:8.3f}   "
        + ("" if naive is None else f"{naive:.3f} the naive way: shapes over the whole frame")
    )
    for name, row in report["boxes"].items():
        say(f"boxes {name:11} mean IoU {row['mean']:.4f}  5th percentile {row['p5']:.4f}  ({row['poses']} poses)")
    for bar in BARS:
        sign = ">=" if bar.at_least else "<="
        verdict = "PASS" if report["bars"][bar.key]["met"] else "FAIL"
        say(f"{verdict}  {bar.text}: {report[bar.key]:.3f} ({sign} {bar.limit:g})")


def draw(report: dict[str, Any], errors: dict[str, Any], rss_mb: Sequence[float], path: Path) -> None:
    """Draw the plot: time, error, boxes, memory."""
    from plot import draw_bench

    draw_bench(report, errors, rss_mb, path)


def say_cpu(done: Sequence[dict[str, Any]], more_s: float = 0.0) -> None:
    """Print the time per frame."""
    wall = statistics.fmean(r["wall_s"] for r in done)
    say(f"  {mean_cpu(done) + more_s:.3f} CPU-s per frame, {wall:.3f} s by the clock")


def relative(path: Path) -> Path:
    """Return the path, relative to the current folder if it is inside."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def say(text: str) -> None:
    """Print a line without buffering."""
    print(text, flush=True)


if __name__ == "__main__":
    sys.exit(main())
