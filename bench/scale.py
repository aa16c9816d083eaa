"""Measure a run of many small frames without rendering: plan, shards, merge and check, each in processes of its own.

`bench/scale.py [--frames N,...] [--shard-frames M] [--jobs J] [--packed] [--json FILE [--plot PNG]]` makes backgrounds
of 64 x 64 px, plans N frames of them, makes packed shards of M frames with the flat renderer and a model of twelve
faces, joins them to one packed shard and checks it. Without `--packed` it also merges them into files, resumes that
finished run and checks it. Shards are removed once they have been merged. For each step it prints the CPU milliseconds
per frame and the largest memory of any process.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

CONFIGURATIONS = 100
SETTINGS = (
    f"configurations={CONFIGURATIONS}", "output.layout=shards", "output.formats=[coco,yolo]",
    "camera.pitch={fixed_deg: 60}", "camera.size_px=[64, 64]",
)  # fmt: skip
_MODEL = """name: block
category: block
file: block.obj
origin: centre
heading: +X
length_m: 0.5
parts:
  body: {match: ["*"], delta_t_k: [4, 10], kind: fur}
"""
_START = """
import sys
from pathlib import Path
from infrablend import api
data, out, merged, number, size, *settings = sys.argv[1:]
flat = api.Execution(renderer="flat", in_process=True)
"""
_REQUEST = """
request = api.RunRequest("hit-uav-drone", Path(data), Path(out), settings=settings, execution=flat, existing="resume",
                         shard=api.ShardRequest(int(number), size=int(size)))
"""
_RESUME = """
settings = [s for s in settings if not s.startswith("output.layout=")]
report = api.generate("hit-uav-drone", data, merged, settings=settings, execution=flat, existing="resume")
assert report.ok
"""
STEPS = {
    "plan": _START + 'api.plan("hit-uav-drone", data, out, settings=settings, execution=flat)',
    "shard": _START + _REQUEST + "api.generate_shard(request)",
    "status": _START + "print(len(api.status(out)))",
    "join": _START + 'api.merge([out], merged, layout="shards")',
    "check joined": _START + "assert api.check(merged).ok",
    "merge": _START + "api.merge([out], merged)",
    "resume": _START + _RESUME,
    "check merged": _START + "assert api.check(merged).ok",
}


@dataclass
class Used:
    """What the processes of a step used.

    Attributes:
        cpu_s: CPU seconds, together.
        peak_mb: Largest resident memory of one process, MiB.
    """

    cpu_s: float = 0.0
    peak_mb: float = 0.0


def main() -> None:
    """Print a JSON object per number of frames."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", default="2000,8000,32000")
    parser.add_argument("--shard-frames", type=int, default=1000)
    parser.add_argument("--jobs", type=int, default=1, help="shards made at a time")
    parser.add_argument("--packed", action="store_true", help="do not merge into files")
    parser.add_argument("--folder", type=Path, help="where to work; default: the temporary folder")
    parser.add_argument("--json", type=Path, help="file to add the results to")
    parser.add_argument(
        "--plot", type=Path, help="picture to draw of all results in --json; with --frames '' of them alone"
    )
    options = parser.parse_args()
    for frames in (int(n) for n in options.frames.split(",") if n):
        with tempfile.TemporaryDirectory(prefix="scale-", dir=options.folder) as folder:
            result = measure(Path(folder), frames, options.shard_frames, options.jobs, options.packed)
        print(json.dumps(result), flush=True)
        if options.json is not None:
            with options.json.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(result) + "\n")
    if options.plot is not None:
        from plot import draw_scale

        draw_scale([json.loads(line) for line in options.json.read_text("utf-8").splitlines()], options.plot)


def measure(folder: Path, frames: int, shard_frames: int, jobs: int, packed: bool) -> dict[str, Any]:
    """Return what each step used for this number of frames."""
    data, out, merged, joined = (folder / n for n in ("data", "out", "merged", "joined"))
    write_backgrounds(data, -(-frames // CONFIGURATIONS))
    write_model(folder)
    model = f"{{model: {folder / 'block.yaml'}, count: 1, x_m: [-3, 3], y_m: [-3, 3], yaw_deg: [0, 360]}}"
    shards = -(-frames // shard_frames)
    used = {name: Used() for name in STEPS}

    def step(name: str, target: Path = merged, number: int = 1) -> None:
        words = [str(w) for w in (data, out, target, number, shard_frames)]
        settings = (*SETTINGS, f"objects=[{model}]") if name in ("plan", "shard", "resume") else ()
        run(STEPS[name], [*words, *settings], used[name])

    step("plan")
    with ThreadPoolExecutor(jobs) as pool:
        list(pool.map(lambda number: step("shard", merged, number), range(1, shards + 1)))
    entries = len(list(out.iterdir())) - 1  # without the shared plan
    size = sum(p.stat().st_size for p in out.iterdir())
    step("status")
    step("join", joined)
    if not packed:
        step("merge")
    shutil.rmtree(out)
    step("check joined", joined)
    shutil.rmtree(joined)
    if not packed:
        step("resume")
        step("check merged")
        found = sum(1 for _ in (merged / "images").rglob("*.png"))
        assert found == frames, f"{found} pictures; expected {frames}"
    return {
        "frames": frames,
        "shards": shards,
        "entries_per_shard": entries / shards,
        "bytes_per_frame": round(size / frames),
        **{
            name: {"cpu_ms_per_frame": round(1000 * u.cpu_s / frames, 3), "peak_mb": round(u.peak_mb, 1)}
            for name, u in used.items()
            if u.peak_mb
        },
    }


def write_model(folder: Path) -> None:
    """Write a block of twelve faces, which is cheap to build."""
    ends = (-0.5, 0.5)
    corners = [f"v {x} {y} {z}" for x in ends for y in ends for z in ends]
    faces = ["f 1 2 4 3", "f 5 7 8 6", "f 1 5 6 2", "f 3 4 8 7", "f 1 3 7 5", "f 2 6 8 4"]
    (folder / "block.obj").write_text("\n".join([*corners, *faces]) + "\n")
    (folder / "block.yaml").write_text(_MODEL)


def write_backgrounds(folder: Path, count: int) -> None:
    """Write pictures of 64 x 64 px with smooth noise."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    for number in range(count):
        grain = cv2.resize(rng.normal(110, 25, (8, 8)), (64, 64), interpolation=cv2.INTER_CUBIC)
        cv2.imwrite(str(folder / f"{number:06}.png"), np.clip(grain, 16, 235).astype(np.uint8))


def run(program: str, words: Sequence[str], used: Used) -> None:
    """Run a Python program to its end, and add what it used."""
    process = subprocess.Popen([sys.executable, "-c", program, *words], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"a step ended with {process.returncode}")
    used.cpu_s += usage.ru_utime + usage.ru_stime
    used.peak_mb = max(used.peak_mb, usage.ru_maxrss / 1024)


if __name__ == "__main__":
    main()
