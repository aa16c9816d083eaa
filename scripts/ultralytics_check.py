"""Ultralytics' own verdict on a dataset: `ultralytics_check.py DATA_YAML [detect|obb|segment]` (needs `make train`).

Writes one JSON object to standard output:

    images        image files found, all splits together
    labels        objects Ultralytics loaded
    rows          non-empty lines in the label files
    dropped       images it would leave out of training, plus label lines it removed
    corrupt       images it calls corrupt (part of `dropped`)
    backgrounds   images without objects
    per_class     class name -> objects loaded
    splits        the same per split
    messages      what Ultralytics said of single images, sorted

Exit code 0: nothing dropped; 1: something was, or the dataset does not load; 2: wrong use. Nothing is downloaded,
nothing is sent, and the dataset folder stays as it is (Ultralytics would write a label cache into it).
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections import Counter
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
TASKS = ("detect", "obb", "segment")

# Read on import by Ultralytics: settings folder inside build/, no network, no automatic installs, no reports.
os.environ.setdefault("YOLO_CONFIG_DIR", str(ROOT / "build" / "ultralytics"))
os.environ.update(YOLO_OFFLINE="1", YOLO_AUTOINSTALL="0", YOLO_VERBOSE="0")


def check(data_yaml: Path, task: str) -> dict[str, Any]:
    """Load every split with Ultralytics' dataset class and count what came through.

    Raises:
        Exception: Whatever Ultralytics raises when it refuses the dataset as a whole.
    """
    from ultralytics.data import dataset as loading
    from ultralytics.data import utils as checking

    scans: list[dict[str, Any]] = []

    def keep_scan(prefix: str, path: Path, scan: dict[str, Any], version: str) -> None:
        scan["version"] = version
        scans.append({"results": scan["results"], "messages": list(scan["msgs"])})

    # The font is for drawing, the cache for speed: neither belongs to the verdict, and one would go over the network.
    checking.check_font = lambda *_: None
    loading.load_dataset_cache_file = _no_cache
    loading.save_dataset_cache_file = keep_scan

    data = checking.check_det_dataset(str(data_yaml), autodownload=False)
    totals: Counter[str] = Counter()
    per_class: Counter[str] = Counter(dict.fromkeys(data["names"].values(), 0))
    splits: dict[str, dict[str, int]] = {}
    messages: list[str] = []
    seen: set[str] = set()
    for split in ("train", "val", "test"):
        folder = data.get(split)
        # A recipe without a val split points val to train: count those images once.
        if not folder or str(folder) in seen:
            continue
        seen.add(str(folder))
        loaded = loading.YOLODataset(img_path=folder, data=data, task=task, augment=False, cache=False)
        scan = scans.pop()
        _found, _missing, _empty, corrupt, images = scan["results"]
        rows = sum(_rows(Path(file)) for file in loaded.label_files)
        names = [data["names"][int(k)] for label in loaded.labels for k in label["cls"][:, 0]]
        counts = {
            "images": int(images),
            "labels": len(names),
            "rows": rows,
            "dropped": int(images) - len(loaded.labels) + rows - len(names),
            "corrupt": int(corrupt),
            "backgrounds": sum(not len(label["cls"]) for label in loaded.labels),
        }
        splits[split] = counts
        totals.update(counts)
        per_class.update(names)
        messages += scan["messages"]
    return {**totals, "per_class": dict(per_class), "splits": splits, "messages": sorted(messages)}


def _no_cache(path: Path) -> dict[str, Any]:
    raise FileNotFoundError(path)


def _rows(file: Path) -> int:
    """Non-empty lines of a label file; a missing one has none."""
    return sum(bool(line.strip()) for line in file.read_text("utf-8").splitlines()) if file.is_file() else 0


def main(arguments: list[str]) -> int:
    """Check, print, and say by the exit code whether anything was dropped."""
    if not 1 <= len(arguments) <= 2 or (len(arguments) == 2 and arguments[1] not in TASKS):
        print(f"use: ultralytics_check.py DATA_YAML [{'|'.join(TASKS)}]", file=sys.stderr)
        return 2
    data_yaml, task = Path(arguments[0]).resolve(), arguments[1] if len(arguments) == 2 else "detect"
    Path(os.environ["YOLO_CONFIG_DIR"]).mkdir(parents=True, exist_ok=True)
    try:
        # Ultralytics logs to standard output; that is for the result alone.
        with contextlib.redirect_stdout(sys.stderr):
            result = check(data_yaml, task)
    except Exception as error:
        result = {"dropped": -1, "error": f"{type(error).__name__}: {error}"}
    print(json.dumps(result, indent=1, sort_keys=True))
    return int(result["dropped"] != 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
