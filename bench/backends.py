"""Compare the back ends of `infrablend train`: AP50 of one class after trainings from scratch, and their CPU seconds.

`bench/backends.py DATA --class NAME [--split test] [--seeds 0,1,2] [--passes 2000] [--share 1.0] [--work DIR]`
trains YOLOv8n with Ultralytics and then YOLOX with `--backend yolox` for each seed and evaluates both on the split.
YOLOX is shown `share` times as many images. Prints a JSON object a line, and ends with 1 if the mean AP50 of YOLOX is
below 0.85 of YOLOv8n's, or if YOLOX took more CPU seconds. Trainings that DIR already holds are used, not repeated.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from infrablend import api

LEAST = 0.85


def main() -> int:
    """Measure all seeds; return 1 if the limit is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--class", dest="name", required=True)
    parser.add_argument("--split", default="test")
    parser.add_argument("--seeds", default="0,1,2")
    parser.add_argument("--passes", type=int, default=2000)
    parser.add_argument("--share", type=float, default=1.0)
    parser.add_argument("--work", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        work = options.work or Path(temporary)
        work.mkdir(parents=True, exist_ok=True)
        rows = []
        for seed in options.seeds.split(","):
            for backend, passes in (("ultralytics", options.passes), ("yolox", round(options.passes * options.share))):
                out = work / f"{backend}-{passes}-{seed}"
                cpu_s = trained(options.data, out, options.name, backend, seed, passes)
                row = {"backend": backend, "seed": int(seed), "cpu_s": cpu_s}
                rows.append(row | measured(options.data, out, options.name, options.split, backend))
                print(json.dumps(rows[-1]), flush=True)
    ours, theirs = ([r for r in rows if r["backend"] == b] for b in ("yolox", "ultralytics"))
    ratios = {k: statistics.mean(r[k] for r in ours) / statistics.mean(r[k] for r in theirs) for k in ("ap50", "cpu_s")}
    print(json.dumps({k: round(v, 3) for k, v in ratios.items()}))
    return int(ratios["ap50"] < LEAST or ratios["cpu_s"] > 1)


def trained(data: Path, out: Path, name: str, backend: str, seed: str, passes: int) -> float:
    """Return the CPU seconds of a training by the command, start and export included."""
    stored = out.with_suffix(".json")
    if not stored.is_file():
        words = ["train", data, "--out", out, "--backend", backend, "--classes", name, "--seed", seed]
        words += ["--set", f"passes={passes}", "--weights", "scratch", "--device", "cpu", "--overwrite"]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, "-W", "ignore", "-m", "infrablend", "-q", *map(str, words)], check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        stored.write_text(str(round(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, 1)))
    return float(stored.read_text())


def measured(data: Path, out: Path, name: str, split: str, backend: str) -> Mapping[str, float]:
    """Return AP50 and mAP50-95 on the split, and the number of images shown."""
    settings = api.EvaluationSettings(split=split, classes=[name], bootstrap=0)
    found = api.evaluate(out, data, out.with_name(f"{out.name}-evaluation"), settings, device="cpu", overwrite=True)
    row = found.metrics["classes"][name]
    shown = json.loads((out / "train.json").read_text())["passes"]
    return {"images": shown, "ap50": round(row["map50"] or 0, 4), "map50_95": round(row["map50_95"] or 0, 4)}


if __name__ == "__main__":
    sys.exit(main())
