"""Whether a training may start, and be resumed."""

import contextlib
import dataclasses
import io
import pickle
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from infrablend import api
from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.detection import ultralytics_environment
from infrablend.errors import DatasetError, ModelError, OtherSettingsError, OutputError
from infrablend.lab.training import start_weights
from infrablend.lab.training.presets import PRESETS
from infrablend.lab.training.train import require_same
from infrablend.lab.training.train_request import TrainRequest, choose_preset
from infrablend.lab.training.training_data import select_training_data
from infrablend.lab.training.ultralytics_backend import UltralyticsBackend
from tests.samples import SAMPLES
from tests.weights_files import write_weights


def test_resuming_compares_settings_but_not_their_summary(tmp_path):
    settings = dataclasses.asdict(TrainRequest(preset="smoke").chosen_preset())
    asked = {"preset": "smoke", "settings": settings, "data": str(tmp_path), "content": "0"}
    # As recorded by an earlier version.
    summary = "a few steps, to see that everything runs"
    require_same(tmp_path, {**asked, "settings": {**settings, "summary": summary}}, asked)
    with pytest.raises(OtherSettingsError, match=r"settings\.passes"):
        require_same(tmp_path, {**asked, "settings": {**settings, "passes": 3}}, asked)


def test_resuming_compares_start_weights_by_name_and_content(tmp_path):
    one, other = (write_weights(tmp_path / f / "w.pt", network=n) for f, n in (("a", "yolov5n"), ("b", "yolov8n")))
    copy = tmp_path / "c" / "w.pt"
    copy.parent.mkdir()
    copy.write_bytes(one.read_bytes())

    def asked(wanted):
        name, digest = start_weights.identify(str(wanted))
        return {"data": "", "content": "0", "start_asked": name, "weights_sha256": digest}

    require_same(tmp_path, asked(one), asked(copy))
    for was, now in ((one, other), (one, "w.pt"), ("w.pt", one)):
        with pytest.raises(OtherSettingsError, match="weights_sha256"):
            require_same(tmp_path, asked(was), asked(now))
    # As recorded by an earlier version.
    require_same(tmp_path, {"content": "0", "start_asked": "some/w.pt"}, asked(one))
    with pytest.raises(OtherSettingsError, match="start_asked"):
        require_same(tmp_path, {"content": "0", "start_asked": "some/v.pt"}, asked(one))


def test_arguments_that_the_trainer_sets_itself_are_refused(monkeypatch):
    monkeypatch.setattr(ultralytics_environment, "missing_packages", lambda: ["ultralytics"])
    own = ("imgsz", "data", "device", "seed", "task", "mode", "project", "name", "save_dir", "exist_ok", "resume",
           "single_cls", "val", "pretrained")  # fmt: skip
    with pytest.raises(OutputError) as caught:
        settings = dict.fromkeys(own, 1) | {"workers": 4, "model": "yolov8x"}
        UltralyticsBackend().require_settings(choose_preset("smoke", settings), "detect")
    assert {p.where for p in caught.value.problems} == {f"--set {k}" for k in own}
    assert next(p.expected for p in caught.value.problems if p.where == "--set imgsz") == "--set image_size"


def test_weights_for_another_task_and_truncated_ones_are_refused_before_data_are_made(tmp_path):
    for task, head in (("detect", "Detect"), ("obb", "OBB26"), ("segment", "Segment")):
        path = write_weights(tmp_path / f"{task}.pt", head)
        assert start_weights.find_start(str(path), PRESETS["small"], task).network == "yolov5n"
        other = "obb" if task == "detect" else "detect"
        with pytest.raises(ModelError, match=f"weights for {task}; expected {other}"):
            start_weights.find_start(str(path), PRESETS["small"], other)
    path.write_bytes(path.read_bytes()[:-30])
    data = SAMPLES["coco"](tmp_path / "data")
    with pytest.raises(ModelError, match="damaged"):
        api.plan_train(data, TrainRequest(preset="smoke", device="cpu", weights=str(path)))
    plan = api.plan_train(
        data, TrainRequest(preset="smoke", device="cpu", weights=str(write_weights(tmp_path / "new.pt")))
    )
    assert (plan.weights, plan.network) == ("new.pt", "yolov5n")


def test_reading_weights_runs_no_code_of_the_file(tmp_path):
    class Attack:
        def __reduce__(self):
            return print, ("run",)

    with zipfile.ZipFile(tmp_path / "bad.pt", "w") as file:
        file.writestr("bad/data.pkl", pickle.dumps({"model": Attack()}))
    with contextlib.redirect_stdout(io.StringIO()) as said:
        assert start_weights.network_of(str(tmp_path / "bad.pt"), PRESETS["small"], "detect") == ""
    assert not said.getvalue()


@pytest.mark.parametrize("preset", ["smoke", "small"])
def test_data_without_any_object_are_refused_by_every_preset(preset, tmp_path):
    dataset = api.read_dataset(SAMPLES["coco"](tmp_path / "data"))
    bare = dataclasses.replace(dataset, images=tuple(dataclasses.replace(i, instances=()) for i in dataset.images))
    with pytest.raises(DatasetError) as caught:
        select_training_data(bare, TrainRequest(preset=preset))
    assert "class-empty" in {p.code for p in caught.value.problems if p.severity == "error"}


@pytest.mark.parametrize(
    ("sizes", "settings", "side"),
    [
        ([(320, 256)] * 3, {}, 256),
        ([(256, 330)] * 3, {}, 256),
        ([(640, 512)] * 3, {}, 320),
        ([(640, 512)] * 2 + [(320, 250)], {}, 320),
        ([(640, 512)] + [(320, 250)] * 2, {}, 224),  # half of them or more: what most have
        ([(64, 48)] * 3, {}, 320),
        ([None] * 3, {}, 320),
        ([(320, 256)] * 3, {"tile": 320}, 320),
        ([(320, 256)] * 3, {"image_size": 640}, 320),
        ([(320, 256)] * 3, {"mosaic": 0}, 256),
    ],
)
def test_tiles_are_no_larger_than_most_pictures_unless_a_size_is_stated(sizes, settings, side):
    images = [ImageRecord(str(n), Path(f"{n}.png"), "train", size, ()) for n, size in enumerate(sizes)]
    dataset = Dataset(Path(), "coco", (Category(1, "drone"),), tuple(images))
    preset = TrainRequest(settings=settings).fitted_to(dataset).chosen_preset()
    assert (preset.tile, preset.image_size) == (side, settings.get("image_size", side))
    assert preset.arguments["mosaic"] == settings.get("mosaic", 0.5)


@pytest.mark.parametrize(
    ("pitches", "settings", "scale"),
    [
        ([90.0, 45.0, 10.0], {}, 0.5),
        ([90.0, None, 0.0], {}, 0.2),
        ([-5.0, 0.0, None], {}, 0.2),
        ([None] * 3, {}, 0.2),
        ([90.0] * 3, {"scale": 0.3}, 0.3),
        ([90.0] * 3, {"tile": 0}, 0.2),  # whole pictures keep the preset's
    ],
)
def test_tiles_from_above_are_scaled_more_unless_a_scale_is_stated(pitches, settings, scale):
    images = [ImageRecord(str(n), Path(f"{n}.png"), "train", (640, 512), (), capture=Capture(pitch_deg=pitch))
              for n, pitch in enumerate(pitches)]  # fmt: skip
    dataset = Dataset(Path(), "coco", (Category(1, "Car"),), tuple(images))
    fitted = TrainRequest(settings=settings).fitted_to(dataset)
    assert fitted.chosen_preset().arguments["scale"] == scale
    assert fitted.fitted_to(dataset) == fitted


@pytest.mark.parametrize(("empty", "warned"), [(10, False), (12, True), (0, False)])
def test_many_pictures_without_an_object_are_named(empty, warned, tmp_path, caplog):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((512, 640), np.uint8))
    car = Instance("Car", np.array([1.0, 1.0, 9.0, 9.0]))
    images = [ImageRecord(str(n), tmp_path / "a.png", "train", (640, 512), () if n < empty else (car,))
              for n in range(100)]  # fmt: skip
    dataset = Dataset(Path(), "coco", (Category(1, "Car"),), tuple(images))
    select_training_data(dataset, TrainRequest())
    assert ("12 of 100 pictures without an object" in caplog.text) == warned
    assert ("convert --with-class Car" in caplog.text) == warned
