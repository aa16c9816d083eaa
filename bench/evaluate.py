"""Compare the CPU time of `infrablend evaluate` with that of `yolo val` on the same weights and pictures.

    .venv/bin/python bench/evaluate.py [--pictures 585] [--threads 1]

Weights are those of an untrained YOLOv8n with the statistics of noise; pictures are noise of 320 x 256 px. Each command
runs in its own process, so that imports count as they do for users. The exit code is 1 if the ratio is above 1.5.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

MOST = 1.5
SIZE_WH = (320, 256)

WEIGHTS = """
import sys, torch
from infrablend.training.environment import quiet_ultralytics
with quiet_ultralytics():
    from ultralytics.nn import tasks
    torch.manual_seed(0)
    net = tasks.DetectionModel("yolov8n.yaml", nc=3, verbose=False)
    net.names, net.args, net.task = {0: "person", 1: "car", 2: "lorry"}, {}, "detect"
    for layer in net.modules():
        if isinstance(layer, torch.nn.BatchNorm2d):
            layer.momentum = None
    with torch.no_grad():
        net.train()(torch.nn.functional.interpolate(torch.rand(8, 3, 40, 40), scale_factor=8))
    torch.save({"model": net.eval(), "train_args": {"task": "detect", "imgsz": 320}, "epoch": -1}, sys.argv[1])
"""


def write_pictures(root: Path, number: int) -> Path:
    """Write a YOLO dataset of noise with made-up labels."""
    rng = np.random.default_rng(0)
    for name in ("images", "labels"):
        (root / name / "test").mkdir(parents=True)
    for k in range(number):
        noise = rng.integers(60, 200, (SIZE_WH[1] // 8, SIZE_WH[0] // 8)).astype(np.uint8)
        Image.fromarray(noise).resize(SIZE_WH).save(root / "images" / "test" / f"{k:04}.png")
        rows = []
        for _ in range(rng.integers(1, 6)):
            box = (*rng.uniform(0.2, 0.8, 2), *rng.uniform(0.03, 0.15, 2))
            rows.append(" ".join([str(rng.integers(3)), *(f"{v:.4f}" for v in box)]))
        (root / "labels" / "test" / f"{k:04}.txt").write_text("\n".join(rows))
    names = "".join(f"  {k}: {name}\n" for k, name in enumerate(("person", "car", "lorry")))
    splits = "".join(f"{split}: images/test\n" for split in ("train", "val", "test"))
    (root / "data.yaml").write_text(f"path: {root}\n{splits}names:\n{names}")
    return root


def cpu_seconds(command: list[str], environment: dict[str, str]) -> float:
    """Return user and system seconds of a command and its children."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, env=environment, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def main() -> int:
    """Measure both and print the ratio."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", type=int, default=585)
    parser.add_argument("--threads", type=int, default=1)
    given = parser.parse_args()
    bin_ = Path(sys.executable).parent
    with tempfile.TemporaryDirectory() as folder:
        root, weights = Path(folder), Path(folder) / "weights.pt"
        environment = os.environ | {
            "OMP_NUM_THREADS": str(given.threads), "YOLO_CONFIG_DIR": folder, "YOLO_OFFLINE": "1",
            "PYTHONWARNINGS": "ignore",
        }  # fmt: skip
        data = write_pictures(root / "data", given.pictures)
        subprocess.run([sys.executable, "-c", WEIGHTS, str(weights)], env=environment, check=True)
        theirs = [str(bin_ / "yolo"), "detect", "val", f"model={weights}", f"data={data / 'data.yaml'}", "split=test",
                  "imgsz=320", "device=cpu", "workers=0", "plots=False", f"project={root}"]  # fmt: skip
        ours = [sys.executable, "-m", "infrablend", "-q", "evaluate", str(weights), str(data), "--out",
                str(root / "out"), "--image-size", "320", "--device", "cpu"]  # fmt: skip
        seconds = {name: cpu_seconds(command, environment) for name, command in (("yolo", theirs), ("ours", ours))}
    ratio = seconds["ours"] / seconds["yolo"]
    print(f"{given.pictures} pictures: evaluate {seconds['ours']:.1f} CPU-s, yolo val {seconds['yolo']:.1f} CPU-s")
    print(f"ratio {ratio:.2f}, at most {MOST}")
    return int(ratio > MOST)


if __name__ == "__main__":
    sys.exit(main())
