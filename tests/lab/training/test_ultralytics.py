"""Ultralytics' own dataset check, in a separate process, accepts our output and drops nothing."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend.formats.labels import yolo

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="session")
def ultralytics_check(ultralytics: None):
    """Call Ultralytics' check: (data.yaml, task) -> (exit code, its JSON answer)."""

    def check(data_yaml: Path, task: str) -> tuple[int, dict]:
        command = [sys.executable, ROOT / "scripts" / "ultralytics_check.py", data_yaml, task]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
        assert done.stdout, done.stderr
        return done.returncode, json.loads(done.stdout)

    return check


def write_dataset(root: Path, labels: dict[str, str], names: tuple[str, ...] = ("car", "drone")) -> Path:
    """A tiny YOLO dataset: split/stem -> text of the label file."""
    for key, text in labels.items():
        split, stem = key.split("/")
        for kind in ("images", "labels"):
            (root / kind / split).mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.full((40, 50), 90, np.uint8)).save(root / "images" / split / f"{stem}.png")
        (root / "labels" / split / f"{stem}.txt").write_text(text)
    splits = sorted({key.split("/")[0] for key in labels})
    lines = [f"{split}: images/{split}" for split in splits]
    if "val" not in splits:
        lines.append(f"val: images/{splits[0]}")
    lines += ["names:", *(f"  {i}: {name}" for i, name in enumerate(names))]
    (root / "data.yaml").write_text("\n".join(lines) + "\n")
    return root / "data.yaml"


GOOD_ROWS = {
    "detect": "0 0.5 0.5 0.2 0.2\n1 0.25 0.25 0.1 0.1\n",
    "obb": "0 0.4 0.4 0.6 0.4 0.6 0.6 0.4 0.6\n1 0.1 0.1 0.3 0.2 0.2 0.4 0.05 0.3\n",
    "segment": "0 0.4 0.4 0.6 0.4 0.6 0.6 0.5 0.7 0.4 0.6\n1 0.1 0.1 0.3 0.2 0.2 0.4\n",
}


def test_a_split_that_stands_in_is_accepted(ultralytics_check, tmp_path: Path) -> None:
    """Ultralytics ignores the key `stand_ins`; the check counts each folder once."""
    data_yaml = write_dataset(tmp_path, {"train/x": GOOD_ROWS["detect"], "train/y": ""})
    text, _ = yolo.data_yaml({"car": 0, "drone": 1}, ["train"])
    assert "stand_ins: [val]" in text
    data_yaml.write_text(text)
    code, answer = ultralytics_check(data_yaml, "detect")
    assert code == 0, answer
    assert (answer["images"], answer["rows"], answer["dropped"], list(answer["splits"])) == (2, 2, 0, ["train"])


@pytest.mark.parametrize("task", sorted(GOOD_ROWS))
def test_the_check_counts_what_is_there_and_leaves_the_folder_alone(
    ultralytics_check, tmp_path: Path, task: str
) -> None:
    data_yaml = write_dataset(tmp_path / "a b", {"train/x": GOOD_ROWS[task], "test/y": "", "train/z": ""})
    before = sorted(tmp_path.rglob("*"))
    code, answer = ultralytics_check(data_yaml, task)
    assert code == 0, answer
    assert (answer["images"], answer["labels"], answer["rows"], answer["backgrounds"]) == (3, 2, 2, 2)
    assert answer["dropped"] == answer["corrupt"] == 0
    assert answer["per_class"] == {"car": 1, "drone": 1}
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize(
    ("task", "rows", "dropped"),
    [
        # One bad row costs the whole image: it and its two rows are gone.
        ("obb", GOOD_ROWS["obb"].replace("0.05 0.3", "-2.0 0.3"), 3),
        ("detect", GOOD_ROWS["detect"].replace("1 0.25", "1 1.25"), 3),
        ("detect", GOOD_ROWS["detect"].replace("1 0.25", "7 0.25"), 3),
        ("detect", GOOD_ROWS["detect"] + "0 0.5 0.5 0.2 0.2\n", 1),
    ],
)
def test_the_check_fails_when_something_is_dropped(
    ultralytics_check, tmp_path: Path, task: str, rows: str, dropped: int
) -> None:
    code, answer = ultralytics_check(write_dataset(tmp_path, {"train/good": GOOD_ROWS[task], "train/bad": rows}), task)
    assert code == 1
    assert answer["dropped"] == dropped
    assert "bad.png" in answer["messages"][0]


def test_the_check_fails_when_nothing_loads(ultralytics_check, tmp_path: Path) -> None:
    (tmp_path / "data.yaml").write_text("train: images/train\nval: images/train\nnames: [a]\n")
    code, answer = ultralytics_check(tmp_path / "data.yaml", "detect")
    assert code == 1
    assert "error" in answer


EXPECTED_CLASSES = {"Person": 2, "Car": 2, "Bicycle": 2, "OtherVehicle": 2, "drone": 8}


@pytest.mark.parametrize("folder", ["yolo", "yolo-obb", "yolo-seg"])
def test_ultralytics_accepts_every_label_of_a_run(ultralytics_check, finished_run: Path, folder: str) -> None:
    task = {"yolo": "detect", "yolo-obb": "obb", "yolo-seg": "segment"}[folder]
    code, answer = ultralytics_check(finished_run / folder / "data.yaml", task)
    assert code == 0, answer
    assert answer["images"] == 8
    assert answer["dropped"] == answer["corrupt"] == 0
    assert answer["per_class"]["drone"] == 8
    if folder != "yolo-seg":
        assert answer["per_class"] == EXPECTED_CLASSES


@pytest.fixture(scope="module")
def finished_run(tmp_path_factory: pytest.TempPathFactory, write_tiny_hit_uav) -> Path:
    """A run on the made-up dataset with the software renderer: two configurations of four images."""
    from infrablend import api

    root = tmp_path_factory.mktemp("run")
    data = write_tiny_hit_uav(root / "data")
    settings, flat = {"labels.remove_covered": 1.0}, api.Execution(renderer="flat", in_process=True)
    report = api.generate("hit-uav-drone", data, root / "out", execution=flat, settings=settings)
    assert report.ok, report.problems
    return report.out


@pytest.mark.slow
def test_the_command_yolo_trains_and_validates(ultralytics_check, finished_run: Path, tmp_path: Path) -> None:
    """The how-tos recommend it; it needs a torchvision that imports, which `make train` sees to."""
    environment = {**os.environ, "YOLO_CONFIG_DIR": str(tmp_path / "settings"), "YOLO_OFFLINE": "1"}
    common = [f"data={finished_run / 'yolo' / 'data.yaml'}", "imgsz=64", "batch=4", "workers=0", "plots=False",
              "device=cpu", f"project={tmp_path}", "exist_ok=True"]  # fmt: skip

    def yolo(*arguments: str) -> None:
        command = [str(Path(sys.executable).with_name("yolo")), "detect", *arguments, *common]
        done = subprocess.run(command, capture_output=True, text=True, timeout=500, check=False, env=environment)
        assert done.returncode == 0, done.stderr[-2000:]
        assert "torchvision::nms" not in done.stdout + done.stderr

    yolo("train", "model=yolov8n.yaml", "epochs=1", "name=trained")
    weights = tmp_path / "trained" / "weights" / "last.pt"
    assert weights.is_file()
    yolo("val", f"model={weights}", "name=validated")
