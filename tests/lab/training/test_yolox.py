"""Training with YOLOX: what it is shown, that it resumes exactly, and that its ONNX file finds what it finds."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from infrablend import api
from infrablend.detection.finder import load_finder
from infrablend.errors import FetchError, MissingDependencyError, ModelError, OutputError
from infrablend.lab.training import start_weights, train, yolox_network
from infrablend.lab.training.shown_pictures import Changes, ShownPicture, ShownPictures
from infrablend.lab.training.train_request import TrainRequest, choose_preset
from infrablend.lab.training.training_job import IncompleteDataError, Job
from infrablend.lab.training.yolox_settings import ARGUMENTS, require_yolox_settings
from tests.lab.training.test_train import SMOKE, yolo

# Of the package, where it uses torch's former names.
pytestmark = pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::UserWarning")
STILL = Changes(mosaic=0, scale=0, translate=0, fliplr=0, hsv_v=0)
SMOKE_YOLOX: dict[str, Any] = {**SMOKE, "backend": "yolox"}


def job_of(data: Path, out: Path, **changes: Any) -> Job:
    """Six pictures with two objects each, two epochs."""
    out.mkdir(exist_ok=True)
    arguments = {**ARGUMENTS, "warmup_epochs": 1.0}
    return replace(
        Job(data=str(data / "data.yaml"), out=str(out), task="detect", model="yolox_n", network="yolox_n",
            device="cpu", epochs=2, batch=4, image_size=160, patience=0, seed=0, images=6, labels=12, shown=6,
            arguments=arguments, backend="yolox",
            classes=["car", "drone"]), **changes)  # fmt: skip


# -- what is shown ---------------------------------------------------------------------------------------------


def test_a_picture_without_changes_is_fitted_to_the_input(tmp_path: Path) -> None:
    shown = ShownPictures(yolo(tmp_path / "data", {"train": 3}), "train", 160)
    assert (len(shown.paths), shown.labels) == (3, 6)
    for n in range(3):
        picture = shown.show(n, STILL, np.random.default_rng(0))
        # 320x240 px become 160x120, with 20 rows of grey above and below.
        assert picture.levels.shape == (160, 160)
        assert (picture.levels[:20] == 114).all()
        assert (picture.levels[-20:] == 114).all()
        stated = np.loadtxt(tmp_path / "data" / "labels" / "train" / f"{n}.txt")
        assert picture.classes.tolist() == stated[:, 0].tolist()
        centres = (picture.boxes_xyxy[:, :2] + picture.boxes_xyxy[:, 2:]) / 2
        assert np.allclose(centres, stated[:, 1:3] * (160, 120) + (0, 20))


@pytest.mark.parametrize("changes", [replace(STILL, fliplr=1), replace(STILL, scale=0.4, translate=0.1),
                                     Changes(mosaic=1, scale=0.2, translate=0.1, fliplr=0.5, hsv_v=0)])  # fmt: skip
def test_boxes_follow_the_objects(tmp_path: Path, changes: Changes) -> None:
    shown = ShownPictures(yolo(tmp_path / "data", {"train": 4}), "train", 320)
    rng = np.random.default_rng(1)
    seen = 0
    for n in range(4):
        for _ in range(10):
            picture = shown.show(n, changes, rng)
            inside = np.zeros((320, 320), np.bool_)
            for x0, y0, x1, y1 in picture.boxes_xyxy:
                rows, columns = (slice(math.floor(a), math.ceil(b)) for a, b in ((y0, y1), (x0, x1)))
                inside[rows, columns] = True
                # Objects have 220; interpolation and a second object across the edge darken or hide some of them.
                middle = picture.levels[round((y0 + y1) / 2 - 0.5), round((x0 + x1) / 2 - 0.5)]
                assert middle > 150
                seen += 1
            # Bright pixels outside of all boxes are of pieces below a quarter of their object, or below 2 px.
            assert (picture.levels[~inside] > 200).sum() <= 0.25 * 240 * 8
    assert seen > 40


def test_a_picture_without_label_file_has_no_objects(tmp_path: Path) -> None:
    data = yolo(tmp_path / "data", {"train": 2})
    (data / "labels" / "train" / "1.txt").write_text("")
    picture = ShownPictures(data, "train", 160).show(1, STILL, np.random.default_rng(0))
    assert picture.boxes_xyxy.shape == (0, 4)


def test_targets_are_centres_and_sizes(yolox: None) -> None:
    from infrablend.lab.training.yolox_trainer import targets_of

    levels = np.zeros((32, 32), np.uint8)
    full = ShownPicture(levels, np.array([[2.0, 4, 8, 14], [0, 0, 3, 5]]), np.array([1, 0]))
    empty = ShownPicture(levels, np.zeros((0, 4)), np.zeros(0, np.int64))
    found = targets_of([full, empty])
    assert found.tolist() == [[[1, 5, 9, 6, 10], [0, 1.5, 2.5, 3, 5]], [[0] * 5, [0] * 5]]
    assert targets_of([empty]).shape == (1, 1, 5)


# -- settings --------------------------------------------------------------------------------------------------


def test_presets_are_those_of_ultralytics_with_the_network_of_their_size() -> None:
    small = choose_preset("small", {"lr0": 0.004, "passes": 320}, "yolox")
    assert (small.model, small.tile, small.passes, small.batch) == ("yolox_n", 320, 320, 16)
    assert (small.arguments["lr0"], small.arguments["mosaic"], small.arguments["scale"]) == (0.004, 0.5, 0.2)
    assert set(small.arguments) == set(ARGUMENTS)
    assert choose_preset("paper", {}, "yolox").model == "yolox_s"


def test_what_yolox_does_not_do_is_refused_at_once() -> None:
    settings = {"hsv_h": 0.1, "lr0": "fast", "image_size": 100, "model": "yolov8n"}
    with pytest.raises(OutputError) as caught:
        require_yolox_settings(choose_preset("paper", settings, "yolox"), "obb")
    assert [p.where for p in caught.value.problems] == [
        "--task", "--set model", "--set image_size", "--set patience", "--set lr0", "--set hsv_h",
    ]  # fmt: skip


def test_start_weights_are_files_or_none(tmp_path: Path) -> None:
    preset = choose_preset("small", {}, "yolox")
    assert start_weights.find_yolox_start("auto", preset).facts() == {
        "model": "yolox_n", "kind": "scratch", "why": "no weights of YOLOX are downloaded", "network": "yolox_n",
    }  # fmt: skip
    with pytest.raises(FetchError, match=r"expected a \.pth file of YOLOX"):
        start_weights.find_yolox_start("yolov8n.pt", preset)


def test_missing_packages_are_named_with_the_extra(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(yolox_network, "missing_packages", lambda: ["pixeltable-yolox"])
    request = TrainRequest(**SMOKE_YOLOX)
    with pytest.raises(MissingDependencyError, match=r"infrablend\[train-yolox\]"):
        api.train(yolo(tmp_path / "data", {"train": 2}), tmp_path / "out", request)
    assert train.plan_training(api.read_dataset(tmp_path / "data"), request).network == "yolox_n"


# -- training --------------------------------------------------------------------------------------------------


def test_the_loss_of_labels(yolox: None) -> None:
    """Without labels only the objectness counts, and in bfloat16 the loss is the same but for its roundings."""
    import torch

    torch.manual_seed(0)
    network = yolox_network.make_network("yolox_n", 2)
    x = torch.rand(2, 3, 64, 64) * 255

    def losses_of(box: list[float]) -> dict[str, float]:
        with torch.no_grad():
            return {k: float(v) for k, v in network(x, torch.tensor([[box]] * 2)).items()}

    none = losses_of([0.0] * 5)
    assert none["iou_loss"] == none["cls_loss"] == 0
    # An untrained network gives each of the 84 anchors of each picture a score near 0.01.
    assert none["conf_loss"] == pytest.approx(2 * 84 * -math.log(0.99), rel=0.5)
    # Five times one minus the square of an overlap.
    near = losses_of([0, 32, 32, 8, 8])
    assert 0 < near["iou_loss"] <= 5
    with torch.autocast("cpu", torch.bfloat16):
        narrow = losses_of([0, 32, 32, 8, 8])
    # Layers that are narrow change a loss in float32 by a few of their roundings, each of 2**-8.
    assert narrow["iou_loss"] == pytest.approx(near["iou_loss"], rel=0.05)


def test_steps_on_the_same_pictures_lower_the_losses(yolox: None, tmp_path: Path) -> None:
    from infrablend.lab.training.yolox_trainer import YoloxTraining

    data = yolo(tmp_path / "data", {"train": 4})
    training = YoloxTraining(job_of(data, tmp_path / "out"))
    shown = ShownPictures(data, "train", 160)
    pictures = [shown.show(n, STILL, np.random.default_rng(0)) for n in range(4)]
    losses = [training.step(pictures, 0.002) for _ in range(15)]
    assert set(losses[0]) == {"box_loss", "obj_loss", "cls_loss"}
    # The losses of classes and boxes are of other anchors in each step.
    assert losses[-1]["obj_loss"] < losses[0]["obj_loss"]
    assert sum(losses[-1].values()) < sum(losses[0].values())


def test_the_learning_rate_rises_and_falls(yolox: None, tmp_path: Path) -> None:
    from infrablend.lab.training.yolox_trainer import YoloxTraining

    training = YoloxTraining(job_of(tmp_path, tmp_path / "out", epochs=4))
    rates = [training.rate_at(step, 5) for step in range(20)]
    assert np.argmax(rates) == 4
    assert rates[0] == pytest.approx(0.002 / 5)
    assert rates[10] == pytest.approx(0.002 * (1 - 0.99 / 2))
    assert rates[19] > 0.002 * 0.01


def test_a_killed_training_ends_as_an_undisturbed_one(yolox: None, tmp_path: Path) -> None:
    import torch

    from infrablend.lab.training.yolox_trainer import train_yolox

    data = yolo(tmp_path / "data", {"train": 6})
    events: list[tuple[str, dict[str, Any]]] = []

    def say(event: str, **facts: Any) -> None:
        events.append((event, facts))

    def killed(event: str, **facts: Any) -> None:
        if event == "epoch":
            raise KeyboardInterrupt

    train_yolox(job_of(data, tmp_path / "whole"), say)
    ends = [facts for event, facts in events if event == "end"]
    with pytest.raises(KeyboardInterrupt):
        train_yolox(job_of(data, tmp_path / "parts"), killed)
    assert not (tmp_path / "parts" / "weights.pth").exists()
    train_yolox(job_of(data, tmp_path / "parts"), say)
    ends += [facts for event, facts in events[len(events) - 1 :] if event == "end"]
    assert ends[0] == ends[1]
    assert ends[0]["gate"] == {"images": 6, "labels": 12, "images_per_epoch": 6}
    whole, parts = (torch.load(tmp_path / n / "weights.pth", weights_only=True)["model"] for n in ("whole", "parts"))
    assert all(torch.equal(whole[k], parts[k]) for k in whole)


@pytest.mark.parametrize("change", [lambda d: (d / "labels" / "train" / "0.txt").write_text("0 0.5 0.5 0.1 0.1\n"),
                                    lambda d: (d / "images" / "train" / "0.png").unlink()])  # fmt: skip
def test_the_gate_stops_where_data_are_missing(yolox: None, tmp_path: Path, change: Callable[[Path], object]) -> None:
    from infrablend.lab.training.yolox_trainer import train_yolox

    data = yolo(tmp_path / "data", {"train": 6})
    change(data)
    with pytest.raises(IncompleteDataError, match="of 6 images and 12 labels the trainer would use"):
        train_yolox(job_of(data, tmp_path / "out"), lambda event, **facts: None)


def test_training_exports_what_the_network_finds(yolox: None, tmp_path: Path) -> None:
    import torch

    data = yolo(tmp_path / "data", {"train": 6, "val": 2, "test": 2})
    request = TrainRequest(settings={"tiles": 0}, **SMOKE_YOLOX)
    report = api.train(data, tmp_path / "out", request)
    left = ["job.json", "train.json", "train.log", "weights.onnx", "weights.pth"]
    assert sorted(p.name for p in report.out.iterdir()) == left
    assert report.weights.name == "weights.onnx"
    record = report.record
    assert (record["backend"], record["task"], record["start"]["kind"]) == ("yolox", "detect", "scratch")
    assert record["gate"]["labels"] == record["prepared"]["labels"] >= 12
    assert record["versions"]["pixeltable-yolox"]
    finder = load_finder(report.out)
    assert (finder.classes, finder.facts["network"]) == (("car", "drone"), "YOLOX")
    assert finder.facts["tile"] == [352, 352]
    # The decoded outputs of the ONNX file are those of torch, up to the order of sums in 32 bits.
    import onnxruntime

    stored = torch.load(report.out / "weights.pth", weights_only=True)
    network = yolox_network.make_network("yolox_n", 2)
    network.load_state_dict(stored["model"])
    x = torch.randint(0, 256, (1, 3, 352, 352), generator=torch.Generator().manual_seed(1)).float()
    with torch.no_grad():
        expected = network.eval()(x).numpy()
    session = onnxruntime.InferenceSession(str(report.weights), providers=["CPUExecutionProvider"])
    found = session.run(None, {"images": x.numpy()})[0]
    assert found.shape == expected.shape == (1, 44 * 44 + 22 * 22 + 11 * 11, 7)
    assert np.allclose(found, expected, rtol=1e-3, atol=1e-3)
    # The folder is evaluated without weights of Ultralytics, and a finished training resumes to itself.
    evaluated = api.evaluate(report.out, data, tmp_path / "test", device="cpu")
    assert evaluated.metrics["detector"]["network"] == "YOLOX"
    again = api.train(data, tmp_path / "out", request, existing="resume")
    assert again.record == json.loads((report.out / "train.json").read_text())
    assert again.weights == report.weights
    with pytest.raises(OutputError, match="started with other settings"):
        api.train(data, tmp_path / "out", replace(request, backend="ultralytics"), existing="resume")


def test_weights_of_a_training_start_another_with_other_classes(yolox: None, tmp_path: Path) -> None:
    import torch

    torch.manual_seed(0)
    states = yolox_network.make_network("yolox_n", 2).state_dict()
    torch.save({"model": states}, tmp_path / "two.pth")
    torch.manual_seed(1)
    network = yolox_network.make_network("yolox_n", 3)
    left = yolox_network.load_states(network, tmp_path / "two.pth")
    assert left == sorted(f"head.cls_preds.{n}.{of}" for n in range(3) for of in ("bias", "weight"))
    loaded = network.state_dict()
    assert all(torch.equal(loaded[k], states[k]) for k in states if k not in left)
    (tmp_path / "text.pth").write_text("no weights")
    with pytest.raises(ModelError, match="no weights of YOLOX"):
        yolox_network.load_states(network, tmp_path / "text.pth")
    torch.save({"model": {"layer": torch.zeros(1)}}, tmp_path / "other.pth")
    with pytest.raises(ModelError, match="of another network"):
        yolox_network.load_states(network, tmp_path / "other.pth")
