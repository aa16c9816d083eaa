"""Training, end to end with Ultralytics: every label used, stopped and gone on with, and what is refused."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.errors import DatasetError, FetchError, MissingDependencyError, OutputError, RenderError
from infrablend.pipeline import train as pipeline
from infrablend.training import weights
from infrablend.training.presets import PRESETS
from infrablend.training.trainer import Turns


@pytest.fixture(scope="session")
def ultralytics() -> None:
    """Skips, loudly, where Ultralytics is not installed."""
    if find_spec("ultralytics") is None:
        message = "NEEDS Ultralytics: run `make train` (the download size is said first)"
        if os.environ.get("INFRABLEND_REQUIRE_TOOLS") == "1":
            pytest.fail(message)
        pytest.skip(message)


def yolo(
    root: Path, splits: dict[str, int], rows: str | None = None, names: tuple[str, ...] = ("car", "drone")
) -> Path:
    """A YOLO dataset of 320 x 240 pictures with two bright objects of the two classes each."""
    rng = np.random.default_rng(3)
    for split, count in splits.items():
        for kind in ("images", "labels"):
            (root / kind / split).mkdir(parents=True)
        for n in range(count):
            pixels = rng.integers(40, 90, (240, 320)).astype(np.uint8)
            text = []
            for k in range(2):
                x, y = int(rng.integers(10, 280)), int(rng.integers(10, 200))
                w, h = (20, 12) if k else (10, 24)
                pixels[y : y + h, x : x + w] = 220
                text.append(f"{k} {(x + w / 2) / 320} {(y + h / 2) / 240} {w / 320} {h / 240}")
            Image.fromarray(pixels).save(root / "images" / split / f"{n}.png")
            (root / "labels" / split / f"{n}.txt").write_text("\n".join(text) + "\n" if rows is None else rows)
    lines = [*(f"{s}: images/{s}" for s in splits), "names:", *(f"  {i}: {n}" for i, n in enumerate(names))]
    (root / "data.yaml").write_text("\n".join(lines) + "\n")
    return root


SMOKE = {"preset": "smoke", "weights": "scratch", "device": "cpu"}


def test_a_training_uses_every_tile_and_says_what_it_did(ultralytics, tmp_path):
    data = yolo(tmp_path / "data", {"train": 6, "val": 2, "test": 2})
    seen = []
    report = api.train(data, tmp_path / "out", settings={"tiles": 0}, on_progress=seen.append, **SMOKE)
    record = json.loads((tmp_path / "out" / "train.json").read_text())
    assert report.weights.stat().st_size > 1_000_000
    assert record["status"] == "complete"
    assert record["start"]["kind"] == "scratch"
    assert record["gate"]["images"] == record["prepared"]["images"] == record["prepared"]["tiles"]["tiles"]
    assert record["gate"]["labels"] == record["prepared"]["labels"] >= 12
    assert record["passes"] == record["prepared"]["images"]
    assert record["classes"] == ["car", "drone"]
    assert seen
    assert seen[-1].total == record["prepared"]["images"]
    # No copy of the data stays behind, and nothing outside the folder was written.
    assert sorted(p.name for p in report.out.iterdir()) == ["job.json", "train.json", "train.log", "weights.pt"]
    again = api.train(data, tmp_path / "out", settings={"tiles": 0}, resume=True, **SMOKE)
    assert again.record == record
    with pytest.raises(OutputError, match="holds a training"):
        api.train(data, tmp_path / "out", **SMOKE)
    with pytest.raises(OutputError, match="begun otherwise"):
        api.train(data, tmp_path / "out", resume=True, **{**SMOKE, "seed": 4})


@pytest.mark.slow
@pytest.mark.parametrize("task", ["obb", "segment"])
def test_other_tasks_train_too(ultralytics, tmp_path, write_tiny_hit_uav, task):
    data = write_tiny_hit_uav(tmp_path / "data")
    run = api.generate("hit-uav-drone", data, tmp_path / "run", renderer="fake", in_process=True).out
    report = api.train(run, tmp_path / "out", task=task, classes=["drone"], **SMOKE)
    assert report.record["status"] == "complete"
    assert report.record["gate"]["labels"] == report.record["prepared"]["labels"] >= 2


@pytest.mark.slow
def test_a_stopped_training_goes_on_from_its_last_epoch(ultralytics, tmp_path):
    data = yolo(tmp_path / "data", {"train": 12})
    command = [sys.executable, "-m", "infrablend", "train", str(data), "--preset", "smoke", "--weights", "scratch",
               "--device", "cpu", "--set", "epochs=3", "--set", "tiles=0", "--out", str(tmp_path / "out")]  # fmt: skip
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    end = time.monotonic() + 300
    while time.monotonic() < end and not (tmp_path / "out" / "checkpoint.pt").exists():
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=120)
    record = json.loads((tmp_path / "out" / "train.json").read_text())
    if process.returncode != 130:  # it was faster than the signal: nothing to go on with
        assert record["status"] == "complete"
        return
    assert "--resume goes on" in said
    assert record["status"] == "interrupted"
    done = subprocess.run([*command, "--resume"], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    record = json.loads((tmp_path / "out" / "train.json").read_text())
    assert record["status"] == "complete"
    assert record["epochs_done"] == 3
    assert [s["end"] for s in record["sessions"]] == ["stopped", "end"]


def test_the_gate_stops_where_ultralytics_would_drop_a_label(ultralytics, tmp_path):
    # The same row twice: Ultralytics takes it once.
    data = yolo(tmp_path / "data", {"train": 4}, rows="0 0.5 0.5 0.1 0.1\n0 0.5 0.5 0.1 0.1\n1 0.2 0.2 0.1 0.1\n")
    with pytest.raises(DatasetError, match="drop labels"):
        api.train(data, tmp_path / "out", settings={"tile": 0}, **SMOKE)
    assert json.loads((tmp_path / "out" / "train.json").read_text())["status"] == "failed"


def test_everything_wrong_with_a_dataset_is_said_at_once_before_anything_is_made(tmp_path, monkeypatch):
    monkeypatch.setattr(weights, "require_ultralytics", lambda: None)
    data = yolo(tmp_path / "data", {"val": 2, "test": 1}, names=("car", "drone", "deer"))
    with pytest.raises(DatasetError) as caught:
        api.train(data, tmp_path / "out", device="cpu", classes=["car", "boat"])
    assert {p.code for p in caught.value.problems} == {"category-unknown", "split-empty"}
    data = yolo(tmp_path / "more", {"train": 2}, names=("car", "drone", "deer"))
    with pytest.raises(DatasetError) as caught:
        api.train(data, tmp_path / "out", device="cpu")
    assert [(p.where, p.code) for p in caught.value.problems] == [("class deer", "class-empty")]
    with pytest.raises(DatasetError, match="stops when val"):
        api.train(data, tmp_path / "out", preset="paper", device="cpu", classes=["car"])
    with pytest.raises(DatasetError, match="without oriented box"):
        api.train(data, tmp_path / "out", task="obb", device="cpu", classes=["car"])
    with pytest.raises(DatasetError, match="without mask"):
        api.train(data, tmp_path / "out", task="segment", device="cpu", classes=["car"])
    Image.fromarray(np.zeros((240, 320), np.uint16)).save(data / "images" / "train" / "1.png")
    with pytest.raises(DatasetError, match="8-bit"):
        api.train(data, tmp_path / "out", device="cpu", classes=["car"])
    assert not (tmp_path / "out").exists()


def test_settings_that_cannot_be():
    with pytest.raises(OutputError, match="no such preset"):
        pipeline.choose_preset("big", {})
    with pytest.raises(OutputError) as caught:
        pipeline.choose_preset("small", {"passes": "many", "batch": -1, "lr0": 0.1})
    assert [p.where for p in caught.value.problems] == ["--set passes", "--set batch"]
    assert pipeline.choose_preset("small", {"lr0": 0.1}).arguments["lr0"] == 0.1
    chosen = pipeline.choose_preset("small", {"epochs": 3})
    assert chosen.epochs_for(1000) == (3, 1000)
    # However many images: as many epochs, as many shown in each, and all of them at least once.
    assert PRESETS["small"].epochs_for(700) == PRESETS["small"].epochs_for(15_000) == (20, 800)
    assert PRESETS["small"].epochs_for(100_000) == (20, 5008)


def test_turns_walk_through_all_images_again_and_again():
    shown = [list(Turns(7, 5, seed=3, epoch=e)) for e in range(7)]
    assert all(len(s) == 5 for s in shown)
    walks = [i for s in shown for i in s]
    assert all(sorted(walks[k : k + 7]) == list(range(7)) for k in range(0, 35, 7))
    assert walks[:7] != walks[7:14]
    one = Turns(7, 5, seed=3)
    assert [list(one) for _ in range(7)] == shown  # as the loader takes them, epoch after epoch
    assert list(Turns(7, 5, seed=4)) != shown[0]
    assert sorted(Turns(3, 9, seed=0)) == [0, 0, 0, 1, 1, 1, 2, 2, 2]


def test_no_gpu_when_one_was_asked_for(ultralytics, tmp_path):
    import torch

    if torch.cuda.is_available():
        pytest.skip("there is a GPU here")
    with pytest.raises(OutputError, match="finds no GPU"):
        api.train(yolo(tmp_path / "d", {"train": 1}), tmp_path / "out", device="cuda")


def test_without_ultralytics_it_is_said_what_to_install(tmp_path):
    code = (
        "import sys; sys.modules['ultralytics'] = None\n"
        "from infrablend.training.weights import require_ultralytics\n"
        "try: require_ultralytics()\n"
        "except ImportError as e: print(e)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 'pip install "infrablend[train]"' in done.stdout


def test_weights_from_where_there_are_some(tmp_path, monkeypatch):
    small = PRESETS["small"]
    assert weights.find_start("scratch", small, "obb").model == "yolov8n-obb.yaml"
    own = tmp_path / "mine.pt"
    own.write_bytes(b"x")
    assert weights.find_start(str(own), small, "detect").kind == "file"
    monkeypatch.setattr(weights, "_ADDRESS", "http://127.0.0.1:9/{name}")  # nobody listens there
    start = weights.find_start("auto", small, "detect", tmp_path / "cache")
    assert start.kind == "scratch"
    assert "could not be had" in start.why
    for name in ("yolov8s.pt", "no/such.pt", "nonsense"):
        with pytest.raises(FetchError):
            weights.find_start(name, small, "detect", tmp_path / "cache")
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache" / "yolov8n.pt").write_bytes(b"x")
    assert weights.find_start("auto", small, "detect", tmp_path / "cache").kind == "published"


def test_a_download_that_breaks_off_leaves_nothing_behind(tmp_path, monkeypatch):
    import http.server
    import threading

    class Broken(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Length", "1000")
            self.end_headers()
            self.wfile.write(b"half")

        def log_message(self, *args: object) -> None:
            pass

    server = http.server.HTTPServer(("127.0.0.1", 0), Broken)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        monkeypatch.setattr(weights, "_ADDRESS", f"http://127.0.0.1:{server.server_port}/{{name}}")
        with pytest.raises(FetchError, match="run the command again"):
            weights.find_start("yolov8n.pt", PRESETS["small"], "detect", tmp_path / "cache")
    finally:
        server.shutdown()
        server.server_close()
    assert not list((tmp_path / "cache").glob("*.pt*"))


def test_what_failed_is_told_with_the_log(tmp_path):
    error = pipeline._failure(tmp_path, -9, None, PRESETS["small"])
    assert isinstance(error, RenderError)
    assert "batch=8" in str(error)
    assert "train.log" in str(pipeline._failure(tmp_path, 1, {"code": "failed", "message": "x"}, PRESETS["small"]))
    assert issubclass(MissingDependencyError, ImportError)
