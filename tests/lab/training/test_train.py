"""Training end to end with Ultralytics: every label is used, training resumes, and bad input is refused."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from dataclasses import asdict, replace
from importlib import metadata
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from PIL import Image

from infrablend import api
from infrablend.core.files import write_bytes, write_json
from infrablend.core.workspace import partial_of
from infrablend.detection import ultralytics_environment
from infrablend.detection.scale import DAMAGED, WEIGHTS
from infrablend.detection.ultralytics_environment import quiet_ultralytics, require_ultralytics
from infrablend.errors import DatasetError, FetchError, Interrupted, MissingDependencyError, OutputError, RenderError
from infrablend.lab.realism import nets
from infrablend.lab.training import start_weights, training_job, ultralytics_backend
from infrablend.lab.training import train as pipeline_train
from infrablend.lab.training import training_process as process
from infrablend.lab.training.presets import PRESETS
from infrablend.lab.training.train import choose_device
from infrablend.lab.training.train_request import choose_preset
from infrablend.lab.training.trainer import trainer_with_passes
from infrablend.lab.training.training_job import ShuffledPasses
from infrablend.lab.training.ultralytics_backend import UltralyticsBackend


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


def zipped() -> bytes:
    """What begins and ends as a file of weights does."""
    held = BytesIO()
    with zipfile.ZipFile(held, "w") as file:
        file.writestr("data.pkl", b"x" * 50)
    return held.getvalue()


def train(data: Path, out: Path, *, existing="refuse", on_progress=None, **request):
    return api.train(data, out, api.TrainRequest(**request), existing=existing, on_progress=on_progress)


def plan_train(data: Path, *, out: Path | None = None, existing="refuse", **request):
    return api.plan_train(data, api.TrainRequest(**request), out=out, existing=existing)


SMOKE = {"preset": "smoke", "weights": "scratch", "device": "cpu"}


def without_end(record: dict[str, Any]) -> dict[str, Any]:
    """The record as it was when the trainer was started."""
    ends = {"epochs_done", "passes", "seconds", "losses", "gate", "precision", "threads", "versions", "batch", "note"}
    return {k: v for k, v in record.items() if k not in (*ends, "contents")} | {"sessions": []}


def without_times(record: dict[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in record.items() if k not in ("seconds", "sessions")}


def test_an_evaluation_leaves_the_threads_of_later_trainings_alone(ultralytics):
    code = (
        "import os; from infrablend.detection.ultralytics_environment import quiet_ultralytics\n"
        "with quiet_ultralytics():\n    print(os.environ.get('OMP_NUM_THREADS'))\n"
    )
    for asked in ({}, {"OMP_NUM_THREADS": "3"}):
        around = {k: v for k, v in os.environ.items() if k != "OMP_NUM_THREADS"} | asked
        done = subprocess.run([sys.executable, "-c", code], env=around, capture_output=True, text=True, check=True)
        assert done.stdout.split() == [asked.get("OMP_NUM_THREADS", "None")]


def test_training_uses_every_tile_and_records_its_scale(ultralytics, tmp_path, monkeypatch):
    data = yolo(tmp_path / "data", {"train": 6, "val": 2, "test": 2})
    seen = []
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    with monkeypatch.context() as patch:
        patch.setattr(pipeline_train, "WORKING_FILES", ())
        report = train(data, tmp_path / "out", settings={"tiles": 0}, on_progress=seen.append, **SMOKE)
    record = json.loads((tmp_path / "out" / "train.json").read_text())
    assert record["losses"]
    # Killed after the last epoch, before the record was finished: the checkpoint has all that the record needs.
    (tmp_path / "out").rename(partial_of(tmp_path / "out"))
    write_json(partial_of(tmp_path / "out") / "train.json", without_end(record))
    write_json(partial_of(tmp_path / "out") / ".workspace.json", {"noun": "training"})
    train(data, tmp_path / "out", settings={"tiles": 0}, existing="resume", **SMOKE)
    resumed = json.loads((tmp_path / "out" / "train.json").read_text())
    assert without_times(resumed) == without_times(record) | {"contents": resumed["contents"]}
    record = resumed
    assert report.weights.stat().st_size > 1_000_000
    assert record["threads"] == 2
    assert record["start"]["kind"] == "scratch"
    assert record["gate"]["images"] == record["prepared"]["images"] == record["prepared"]["tiles"]["tiles"]
    assert record["gate"]["labels"] == record["prepared"]["labels"] >= 12
    assert record["passes"] == record["prepared"]["images"]
    assert record["classes"] == ["car", "drone"]
    assert seen
    assert seen[-1].total == record["prepared"]["images"]
    # No copy of the data stays behind, and nothing outside the folder was written.
    left = ["job.json", "train.json", "train.log", "weights.pt"]
    assert sorted(p.name for p in report.out.iterdir()) == left
    # The weights alone, away from train.json, still carry the scale of the training: tiles at native resolution.
    moved = shutil.copy(report.weights, tmp_path / "detector.pt")
    import ultralytics as of_others

    # Other programs show pictures at that scale, too: 320 is the longer side of the pictures, 160 that of the tiles.
    assert of_others.YOLO(str(moved)).overrides["imgsz"] == 320
    detector = api.evaluate(moved, data, tmp_path / "test", device="cpu").metrics["detector"]
    assert detector["image_size"] == 0
    assert detector["image_size_from"] == "trained on tiles of 160 px at native resolution"
    again = train(data, tmp_path / "out", settings={"tiles": 0}, existing="resume", **SMOKE)
    assert again.record == record
    with pytest.raises(OutputError, match="not empty"):
        train(data, tmp_path / "out", **SMOKE)
    with pytest.raises(OutputError, match="started with other settings"):
        train(data, tmp_path / "out", existing="resume", **{**SMOKE, "seed": 4})
    with pytest.raises(OutputError, match="started with other settings") as caught:
        train(data, tmp_path / "out", settings={"batch": 2, "hsv_v": 0.1}, existing="resume", **SMOKE)
    assert {p.where: (p.found, p.expected) for p in caught.value.problems} == {
        "settings.batch": ("2", "4, as at the start"),
        "settings.tiles": ("8", "0, as at the start"),
        "settings.arguments.hsv_v": ("0.1", "None, as at the start"),
    }


@pytest.mark.slow
@pytest.mark.parametrize("task", ["obb", "segment"])
def test_other_tasks_train_too(ultralytics, tmp_path, write_tiny_hit_uav, task):
    data = write_tiny_hit_uav(tmp_path / "data")
    run = api.generate(
        "hit-uav-drone", data, tmp_path / "run", execution=api.Execution(renderer="flat", in_process=True)
    ).out
    report = train(run, tmp_path / "out", task=task, classes=["drone"], **SMOKE)
    assert report.record["gate"]["labels"] == report.record["prepared"]["labels"] >= 2


@pytest.mark.slow
def test_stopped_training_resumes_from_its_last_epoch(ultralytics, tmp_path):
    data = yolo(tmp_path / "data", {"train": 12})
    command = [sys.executable, "-m", "infrablend", "train", str(data), "--preset", "smoke", "--weights", "scratch",
               "--device", "cpu", "--set", "epochs=3", "--set", "tiles=0", "--out", str(tmp_path / "out")]  # fmt: skip
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    end = time.monotonic() + 300
    while time.monotonic() < end and not (partial_of(tmp_path / "out") / "checkpoint.pt").exists():
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=120)
    if process.returncode != 130:  # it was faster than the signal: nothing to go on with
        assert (tmp_path / "out" / "train.json").is_file()
        return
    assert "--resume continues" in said
    assert not (tmp_path / "out").exists()
    done = subprocess.run([*command, "--resume"], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    record = json.loads((tmp_path / "out" / "train.json").read_text())
    assert record["epochs_done"] == 3
    assert [s["end"] for s in record["sessions"]] == ["stopped", "end"]


def test_a_trainer_without_its_parent_ends_before_it_writes(tmp_path):
    command = [sys.executable, "-m", "infrablend.lab.training.trainer", "1", str(tmp_path / "job.json")]
    assert subprocess.run(command, timeout=60, check=False).returncode == 1
    assert not list(tmp_path.iterdir())


def test_the_gate_stops_where_ultralytics_would_drop_a_label(ultralytics, tmp_path):
    # The same row twice: Ultralytics takes it once.
    data = yolo(tmp_path / "data", {"train": 4}, rows="0 0.5 0.5 0.1 0.1\n0 0.5 0.5 0.1 0.1\n1 0.2 0.2 0.1 0.1\n")
    with pytest.raises(DatasetError, match="drop labels"):
        train(data, tmp_path / "out", settings={"tile": 0}, **SMOKE)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_gate_checks_val_if_training_depends_on_it(ultralytics, tmp_path):
    data = yolo(tmp_path / "data", {"train": 4, "val": 2})
    doubled = data / "labels" / "val" / "0.txt"
    doubled.write_text(doubled.read_text() * 2)
    with pytest.raises(DatasetError, match="2 images and 6 labels of split val"):
        train(data, tmp_path / "out", settings={"tile": 0, "patience": 3}, **SMOKE)


def test_all_dataset_problems_are_reported_before_any_work(tmp_path, monkeypatch):
    monkeypatch.setattr(ultralytics_backend, "require_ultralytics", lambda: None)
    data = yolo(tmp_path / "data", {"val": 2, "test": 1}, names=("car", "drone", "deer"))
    with pytest.raises(DatasetError) as caught:
        train(data, tmp_path / "out", device="cpu", classes=["car", "boat"])
    assert {p.code for p in caught.value.problems} == {"category-unknown", "split-empty"}
    assert "add --classes car" in [p.todo for p in caught.value.problems]
    data = yolo(tmp_path / "more", {"train": 2}, names=("car", "drone", "deer"))
    with pytest.raises(DatasetError) as caught:
        train(data, tmp_path / "out", device="cpu")
    assert [(p.where, p.code) for p in caught.value.problems] == [("class deer", "class-empty")]
    assert "add --classes car,drone" in [p.todo for p in caught.value.problems]
    with pytest.raises(DatasetError, match="stops when val"):
        train(data, tmp_path / "out", preset="paper", device="cpu", classes=["car"])
    with pytest.raises(DatasetError, match="without oriented box"):
        train(data, tmp_path / "out", task="obb", device="cpu", classes=["car"])
    with pytest.raises(DatasetError, match="without mask"):
        train(data, tmp_path / "out", task="segment", device="cpu", classes=["car"])
    Image.fromarray(np.zeros((240, 320), np.uint16)).save(data / "images" / "train" / "1.png")
    with pytest.raises(DatasetError, match="8-bit"):
        train(data, tmp_path / "out", device="cpu", classes=["car"])
    assert not (tmp_path / "out").exists()


def test_warnings_that_do_not_stop_a_training_are_reported(tmp_path, caplog):
    data = yolo(tmp_path / "data", {"train": 2}, names=("car", "drone", "deer"))
    plan_train(data, preset="smoke", device="cpu")
    assert "class deer: no object in split train" in caplog.text
    assert "split val: no pictures" in caplog.text


def test_a_plan_refuses_what_the_training_would(ultralytics, tmp_path):
    data = yolo(tmp_path / "data", {"train": 2, "val": 1})
    with pytest.raises(OutputError, match="pases"):
        plan_train(data, device="cpu", settings={"pases": 320})
    with pytest.raises(FetchError, match="no such file"):
        plan_train(data, device="cpu", weights="no/where.onnx")
    out = tmp_path / "out"
    assert plan_train(data, device="cpu", out=out, weights="yolov8n.pt").images
    out.mkdir()
    (out / "weights.pt").write_text("whole")
    contents = {"names": ["train.json", "weights.pt"], "files": 2}
    (out / "train.json").write_text(json.dumps({"infrablend": "1", "contents": contents}))
    with pytest.raises(OutputError, match="not empty"):
        plan_train(data, device="cpu", out=out)
    assert plan_train(data, device="cpu", out=out, existing="overwrite").images
    assert (out / "weights.pt").read_text() == "whole"  # a plan replaces nothing
    (out / "train.json").unlink()
    with pytest.raises(OutputError, match="not a training"):
        plan_train(data, device="cpu", out=out, existing="overwrite")


def test_impossible_settings():
    with pytest.raises(OutputError, match="no such preset"):
        choose_preset("big", {})
    with pytest.raises(OutputError) as caught:
        choose_preset("small", {"passes": "many", "batch": -1, "lr0": 0.1})
    assert [p.where for p in caught.value.problems] == ["--set passes", "--set batch"]
    assert choose_preset("small", {"lr0": 0.1}).arguments["lr0"] == 0.1
    chosen = choose_preset("small", {"epochs": 3})
    assert chosen.epochs_for(1000) == (3, 1000)
    # Any number of images: the same epochs with the same number shown, and every image at least once.
    assert PRESETS["small"].epochs_for(700) == PRESETS["small"].epochs_for(15_000) == (20, 800)
    assert PRESETS["small"].epochs_for(100_000) == (20, 5008)
    for name, settings, where in (
        ("small", {"batch": 0, "image_size": 0, "tile": 0, "model": ""},
         ["--set batch", "--set image_size", "--set model"]),
        ("small", {"passes": 0}, ["--set passes"]),
        ("smoke", {"epochs": 0, "passes": 0}, ["--set epochs --set passes"]),
        ("smoke", {"epochs": True}, ["--set epochs"]),
    ):  # fmt: skip
        with pytest.raises(OutputError) as caught:
            choose_preset(name, settings)
        assert [p.where for p in caught.value.problems] == where


def test_arguments_that_ultralytics_would_refuse_are_refused_before_anything_is_made(ultralytics, tmp_path):
    data = yolo(tmp_path / "data", {"train": 1})
    before = dict(os.environ)
    for settings, said in (({"lr": 0.1}, "not a valid YOLO argument"), ({"lr0": "much"}, "invalid type str")):
        with pytest.raises(OutputError, match=said):
            train(data, tmp_path / "out", settings=settings, **SMOKE)
    UltralyticsBackend().require_settings(choose_preset("smoke", {"lr0": 0.1, "mosaic": 1}), "detect")
    assert dict(os.environ) == before
    assert not (tmp_path / "out").exists()


def test_numbers_on_the_command_line_are_numbers():
    from infrablend.cli.options import yaml_values

    given = ["a=1e-3", "b=2", "c=yolov8s", "d=true"]
    assert yaml_values(given, "--set") == {"a": 0.001, "b": 2, "c": "yolov8s", "d": True}
    with pytest.raises(typer.BadParameter, match="lr0"):
        yaml_values(["lr0=[1"], "--set")


def test_unreadable_labels_are_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(ultralytics_backend, "require_ultralytics", lambda: None)
    bad = "0 0.5 0.5 0.1 0.1\n1 0.5 0.5 0.1 0.2\n0 nan 0.5 0.1 0.1\n"
    data = yolo(tmp_path / "data", {"train": 25}, rows=bad)
    for call in (lambda: train(data, tmp_path / "out", device="cpu"), lambda: plan_train(data, device="cpu")):
        with pytest.raises(DatasetError, match="25 labels or pictures could not be read") as caught:
            call()
        assert "infrablend convert" in caught.value.message
        assert "first 20" in caught.value.message
        assert len(caught.value.problems) == 20
        assert all("labels/train" in p.where and p.found and p.expected for p in caught.value.problems)
    api.convert(data, tmp_path / "clean", to="coco")
    plan = plan_train(tmp_path / "clean", device="cpu")
    assert (plan.images, plan.labels) == (25, 50)


def test_plan_lists_shown_images_and_output(ultralytics, tmp_path, monkeypatch):
    import torch

    data = yolo(tmp_path / "data", {"train": 4})
    plan = plan_train(data, device="cpu")
    assert (plan.images, plan.shown, plan.epochs, plan.device) == (6, 800, 20, "cpu")
    assert (plan.tiled, plan.tile_px) == (True, 224)  # pictures are 240 px high
    assert plan.disk_bytes > 4 * 3.2e6 * 6
    assert plan_train(data, device="cpu", settings={"model": "yolov8x"}).disk_bytes > 1.6e9
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    fast = plan_train(data)
    assert fast.device == "0"
    assert fast.seconds < plan.seconds
    with pytest.raises(OutputError, match="finds 2 GPUs"):
        plan_train(data, device="cuda:2")


def test_devices(ultralytics, tmp_path, monkeypatch):
    import torch

    for wrong, said in (("foo", "no such device"), ("cuda:", "no such"), ("0,1", "several GPUs"),
                        ("cuda:0,1", "such as 0"), ("-1", "no such device"), ("", "no such device")):  # fmt: skip
        with pytest.raises(OutputError, match=said):
            choose_device(wrong)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    names = ("auto", "cpu", "cuda", "cuda:0", "cuda:1", "1")
    assert [choose_device(n) for n in names] == ["0", "cpu", "0", "0", "1", "1"]
    with pytest.raises(OutputError, match="finds 2 GPUs, numbered from 0"):
        train(yolo(tmp_path / "d", {"train": 1}), tmp_path / "out", device="7")
    assert not (tmp_path / "out").exists()
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert choose_device("auto") == "cpu"
    with pytest.raises(OutputError, match="finds no GPU"):
        choose_device("cuda")
    monkeypatch.setattr(torch.backends.mps, "is_available", lambda: False)
    with pytest.raises(OutputError, match="not available"):
        choose_device("mps")


def events(monkeypatch, *said, code=0, stopped=False, weights_there=True):
    """Replace the trainer's process by its events."""

    def watch(command, log, take):
        for event in said:
            take(event)
        job = json.loads(Path(command[-1]).read_text())
        out = Path(job["out"])
        (out / "checkpoint.new").write_bytes(b"x")
        if weights_there:
            write_bytes(out / WEIGHTS, b"x")
        return code, stopped

    monkeypatch.setattr(ultralytics_backend, "require_ultralytics", lambda: None)
    monkeypatch.setattr(process, "watch", watch)


END = {"event": "end", "epochs": 1, "precision": "float32", "batch": 3, "short_of_memory": False, "threads": 1,
       "versions": {}, "gate": {}, "losses": {}}  # fmt: skip


def test_interruption_after_the_last_task_has_no_effect(tmp_path, monkeypatch):
    data = yolo(tmp_path / "data", {"train": 2})
    events(monkeypatch, END, code=-15, stopped=True)
    report = train(data, tmp_path / "out", **SMOKE)
    assert report.record["sessions"][0]["end"] == "end"
    assert report.record["batch"] == 3
    assert "there are 3 images" in report.record["note"]
    assert sorted(p.name for p in report.out.iterdir()) == ["job.json", "train.json", "weights.pt"]


def test_interruption_reports_the_progress(tmp_path, monkeypatch):
    data = yolo(tmp_path / "data", {"train": 2})
    call = {"settings": {"epochs": 9}, **SMOKE}
    events(monkeypatch, code=-15, stopped=True, weights_there=False)
    with pytest.raises(Interrupted, match="before the end of the first of 9 epochs"):
        train(data, tmp_path / "out", **call)
    events(monkeypatch, {"event": "epoch", "epoch": 4}, code=-15, stopped=True, weights_there=False)
    with pytest.raises(Interrupted, match="after epoch 4 of 9"):
        train(data, tmp_path / "out", existing="resume", **call)
    events(monkeypatch, code=-15, stopped=True, weights_there=False)
    with pytest.raises(Interrupted, match="after epoch 4 of 9"):
        train(data, tmp_path / "out", existing="resume", **call)
    events(monkeypatch, {"event": "damaged", "message": "bad"}, code=-15, stopped=True, weights_there=False)
    with pytest.raises(Interrupted, match="before the end of the first"):
        train(data, tmp_path / "out", existing="resume", **call)
    record = json.loads((partial_of(tmp_path / "out") / "train.json").read_text())
    assert record["sessions"][-1]["restarted"] == "bad"


def test_a_killed_session_counts(tmp_path, monkeypatch):
    data, out = yolo(tmp_path / "data", {"train": 2}), tmp_path / "out"

    def killed(command, log, take):
        time.sleep(0.2)
        take({"event": "epoch", "epoch": 4})
        raise SystemExit

    events(monkeypatch)
    monkeypatch.setattr(process, "watch", killed)
    with pytest.raises(SystemExit):
        train(data, out, **SMOKE)
    events(monkeypatch, END)
    record = train(data, out, existing="resume", **SMOKE).record
    assert [(s["end"], s["epoch"]) for s in record["sessions"]] == [("killed", 4), ("end", 0)]
    assert (
        record["seconds"] == pytest.approx(sum(s["seconds"] for s in record["sessions"])) and record["seconds"] >= 0.2
    )


def test_a_record_that_cannot_be_read_starts_again_when_asked(tmp_path, monkeypatch, caplog):
    data, out = yolo(tmp_path / "data", {"train": 2}), tmp_path / "out"
    events(monkeypatch, code=-15, stopped=True, weights_there=False)
    with pytest.raises(Interrupted):
        train(data, out, **SMOKE)
    (partial_of(out) / "train.json").write_text("")
    (partial_of(out) / "checkpoint.pt").write_bytes(b"old")
    events(monkeypatch, END)
    with pytest.raises(OutputError, match="--resume"):
        train(data, out, **SMOKE)
    assert train(data, out, existing="resume", **SMOKE).record["epochs_done"] == 1
    assert "starts again" in caplog.text
    assert not (out / "checkpoint.pt").exists()


def test_overwriting_replaces_a_training_and_refuses_foreign_files(tmp_path, monkeypatch):
    data, out = yolo(tmp_path / "data", {"train": 2}), tmp_path / "out"
    events(monkeypatch, END)
    train(data, out, **SMOKE)
    (out / "note.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"note\.txt"):
        train(data, out, existing="overwrite", **SMOKE)
    (out / "note.txt").rename(tmp_path / "note.txt")
    train(data, out, existing="overwrite", **{**SMOKE, "seed": 4})
    assert json.loads((out / "train.json").read_text())["seed"] == 4
    (out / "weights.pt").unlink()
    with pytest.raises(OutputError, match=r"weights\.pt: is not there"):
        train(data, out, existing="resume", **{**SMOKE, "seed": 4})


def test_resuming_needs_the_same_data_but_not_the_same_path(tmp_path, monkeypatch):
    data = yolo(tmp_path / "data", {"train": 2, "test": 1})
    out = tmp_path / "out"
    events(monkeypatch, code=-15, stopped=True, weights_there=False)
    with pytest.raises(Interrupted):
        train(data, out, **SMOKE)
    data = data.rename(tmp_path / "moved")
    (data / "labels" / "test" / "0.txt").write_text("")  # not trained on
    with pytest.raises(Interrupted):
        train(data, out, existing="resume", **SMOKE)
    labels = data / "labels" / "train" / "0.txt"
    was = labels.read_text()
    labels.write_text(was.replace("1 0.", "0 0."))
    with pytest.raises(OutputError, match="other labels or pictures"):
        train(data, out, existing="resume", **SMOKE)
    labels.write_text(was)
    Image.fromarray(np.full((240, 320), 9, np.uint8)).save(data / "images" / "train" / "1.png")
    with pytest.raises(OutputError, match="other labels or pictures"):
        train(data, out, existing="resume", **SMOKE)


def test_a_checkpoint_contains_the_progress_and_is_moved_away_if_damaged(ultralytics, tmp_path):
    import torch

    said = []
    checkpoint = tmp_path / "checkpoint.pt"
    assert training_job.last_checkpoint(checkpoint, torch, None).epochs == 0
    reached = training_job.Reached(5, True, {"images": 8}, {"box_loss": 0.5}, 4)
    torch.save({"epoch": 4, training_job.REACHED: asdict(reached)}, checkpoint)
    assert training_job.last_checkpoint(checkpoint, torch, None) == reached
    whole = checkpoint.read_bytes()
    (tmp_path / "run").mkdir()
    for broken in (b"", whole[: len(whole) // 2], b"no checkpoint"):
        checkpoint.write_bytes(broken)
        assert (
            training_job.last_checkpoint(
                checkpoint, torch, lambda event, **facts: said.append((event, facts["message"]))
            )
            == training_job.Reached()
        )
        assert (tmp_path / DAMAGED).read_bytes() == broken
        assert not checkpoint.exists()
        assert said.pop()[0] == "damaged"
    assert not (tmp_path / "run").exists()  # nothing is left that cannot be resumed


@pytest.mark.parametrize("workers", [0, 2])
def test_turns_stay_with_their_epoch_when_the_loader_starts_again(ultralytics, tmp_path, workers):
    with quiet_ultralytics():
        from ultralytics.data.build import InfiniteDataLoader

    class Base:
        def get_dataloader(self, mode: str = "train") -> Any:
            return InfiniteDataLoader(
                dataset=range(7), batch_size=2, shuffle=True, num_workers=workers, collate_fn=list
            )

        def _close_dataloader_mosaic(self) -> None:
            pass

    job = training_job.Job("", str(tmp_path), "detect", "", "cpu", 4, 2, 32, 0, seed=3, images=7, labels=7, shown=6)
    t = trainer_with_passes(Base, job, 1)()
    loader = t.get_dataloader()
    shown = []
    for t.epoch in (1, 2, 3):
        if t.epoch == 2:  # as Ultralytics does inside the epoch
            t._close_dataloader_mosaic()
            loader.reset()
        shown.append([int(i) for batch in loader for i in batch])
    loader.close()
    assert shown == [list(ShuffledPasses(7, 6, seed=3, epoch=e)) for e in (1, 2, 3)]
    assert trainer_with_passes(Base, replace(job, shown=7), 0)().get_dataloader().sampler is not t.turns


def test_shuffled_passes_cover_all_images_repeatedly():
    shown = [list(ShuffledPasses(7, 5, seed=3, epoch=e)) for e in range(7)]
    assert all(len(s) == 5 for s in shown)
    walks = [i for s in shown for i in s]
    assert all(sorted(walks[k : k + 7]) == list(range(7)) for k in range(0, 35, 7))
    assert walks[:7] != walks[7:14]
    one = ShuffledPasses(7, 5, seed=3)
    assert [list(one) for _ in range(7)] == shown  # as the loader takes them, epoch after epoch
    assert list(ShuffledPasses(7, 5, seed=4)) != shown[0]
    assert sorted(ShuffledPasses(3, 9, seed=0)) == [0, 0, 0, 1, 1, 1, 2, 2, 2]


def test_outdated_ultralytics_is_reported(ultralytics, tmp_path, monkeypatch):
    data = yolo(tmp_path / "d", {"train": 1})
    for version in ("8.3.0", "8.4.189"):
        monkeypatch.setattr(metadata, "version", lambda name, v=version: v)
        with pytest.raises(MissingDependencyError, match=rf"{version} is installed; expected 8\.4\.190 or later"):
            train(data, tmp_path / "out", **SMOKE)
    assert not (tmp_path / "out").exists()
    for version in ("8.4.190", "8.10", "9.0.0rc1"):
        monkeypatch.setattr(metadata, "version", lambda name, v=version: v)
        require_ultralytics()


def test_weights_are_found_in_known_places(tmp_path, monkeypatch):
    small = PRESETS["small"]
    assert start_weights.find_start("scratch", small, "obb").model == "yolov8n-obb.yaml"
    own = tmp_path / "mine.pt"
    own.write_bytes(zipped())
    assert start_weights.find_start(str(own), small, "detect").kind == "file"
    monkeypatch.setattr(start_weights, "_ADDRESS", "http://127.0.0.1:9/{name}")  # nobody listens there
    start = start_weights.find_start("auto", small, "detect", tmp_path / "cache")
    assert start.kind == "scratch"
    assert "is not available" in start.why
    monkeypatch.chdir(tmp_path)
    for name, said in (
        ("yolov8s.pt", f"no file {tmp_path}/yolov8s.pt; "),
        ("no/such.pt", "no such"),
        ("nonsense", "no such"),
    ):
        with pytest.raises(FetchError, match=re.escape(said)):
            start_weights.find_start(name, small, "detect", tmp_path / "cache")
    (tmp_path / "cache").mkdir()
    cached = tmp_path / "cache" / "yolov8n.pt"
    for broken in (b"", b"<html>log in first</html>", zipped()[:60]):
        cached.write_bytes(broken)
        start = start_weights.find_start("auto", small, "detect", tmp_path / "cache")
        assert start.kind == "scratch"
        assert "not a complete file of weights and was deleted" in start.why
        assert not cached.exists()
    cached.write_bytes(zipped())
    assert start_weights.find_start("auto", small, "detect", tmp_path / "cache").kind == "published"
    # No request is made for what can be no name, and no file outside the cache is touched.
    other = tmp_path / "other.pt"
    other.write_bytes(b"of somebody else")
    for name in ("my best.pt", "x" * 300 + ".pt", "a\nb.pt", "é.pt", "..pt"):
        with pytest.raises(FetchError, match="no such file"):
            start_weights.find_start(name, small, "detect", tmp_path / "cache")
    start = start_weights.find_start("auto", replace(small, model="../other"), "detect", tmp_path / "cache")
    assert (start.kind, other.read_bytes()) == ("scratch", b"of somebody else")


@pytest.mark.parametrize(
    ("length", "body", "said"),
    [(1000, b"half", "run the command again"), (19, b"<html>hello</html>\n", "19 bytes that begin '<html>")],
)
def test_download_that_is_not_weights_leaves_nothing_behind(tmp_path, monkeypatch, length, body, said):
    import http.server
    import threading

    class Broken(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Length", str(length))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *args: object) -> None:
            pass

    server = http.server.HTTPServer(("127.0.0.1", 0), Broken)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        monkeypatch.setattr(start_weights, "_ADDRESS", f"http://127.0.0.1:{server.server_port}/{{name}}")
        with pytest.raises(FetchError, match=said):
            start_weights.find_start("yolov8n.pt", PRESETS["small"], "detect", tmp_path / "cache")
        assert said in start_weights.find_start("auto", PRESETS["small"], "detect", tmp_path / "cache").why
    finally:
        server.shutdown()
        server.server_close()
    assert not list((tmp_path / "cache").glob("*.pt*"))


def test_failures_name_the_log(tmp_path):
    error = process._failure(tmp_path, -9, None, PRESETS["small"])
    assert isinstance(error, RenderError)
    assert "batch=8" in str(error)
    assert "train.log" in str(process._failure(tmp_path, 1, {"code": "failed", "message": "x"}, PRESETS["small"]))
    assert issubclass(MissingDependencyError, ImportError)


def test_the_stand_in_for_torchvision_can_be_asked_for(ultralytics, monkeypatch):
    """Other packages also look for torchvision, and Python raises for a module without `__spec__`."""
    for name in [n for n in sys.modules if n.partition(".")[0] == "torchvision"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "torchvision", None)  # an import of it fails
    monkeypatch.setitem(sys.modules, "torchvision.ops", None)
    ultralytics_environment.replace_broken_torchvision()
    assert sys.modules["torchvision"].ops.nms
    assert nets.missing("torchvision") is None
    assert "cannot be imported" in nets.no_inception(1000)
