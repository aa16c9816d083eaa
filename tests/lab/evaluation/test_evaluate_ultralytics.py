"""Our figures agree with pycocotools, and our detections with those of Ultralytics' own validation.

Whatever imports torch runs in a process of its own: its warnings and settings are not ours.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.core.boxes import corners_of_cxcywha
from infrablend.core.rng import stream
from infrablend.detection.detections import Predictions, detections, write_predictions

ROOT = Path(__file__).resolve().parents[3]
CLASSES = ("person", "car", "lorry")


pytestmark = pytest.mark.usefixtures("ultralytics")


def python(*arguments: object) -> subprocess.CompletedProcess[str]:
    given = {"PYTHONPATH": str(ROOT / "src"), "PYTHONWARNINGS": "ignore"}
    environment = {"OMP_NUM_THREADS": "1", **os.environ, **given}
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=500, check=False, env=environment)


def evaluate(weights: Path, data: Path, out: Path, *more: str) -> dict:
    done = python("-m", "infrablend", "-q", "evaluate", weights, data, "--out", out, "--bootstrap", "100", *more)
    assert done.returncode == 0, done.stderr
    return json.loads((out / "evaluation.json").read_text())


def write_yolo(root: Path, number: int, size_wh: tuple[int, int], task: str, objects: int) -> Path:
    """Pictures of noise with made-up labels."""
    rng = stream(0, "yolo", task)
    for name in ("images", "labels"):
        (root / name / "test").mkdir(parents=True)
    for k in range(number):
        rows = []
        for _ in range(int(rng.integers(0, objects + 1))):
            w, h = rng.uniform(0.03, 0.15, 2)
            cx, cy = rng.uniform(0.2, 0.8, 2)
            label = int(rng.choice(3, p=[0.6, 0.3, 0.1]))
            corners = corners_of_cxcywha(np.array([cx * size_wh[0], cy * size_wh[1], w * size_wh[0], h * size_wh[1],
                                                   rng.uniform(0, 3)]))  # fmt: skip
            points = (corners / size_wh).reshape(-1)
            numbers = (cx, cy, w, h) if task == "detect" else points if task == "obb" else (*points, *points[:2])
            rows.append(" ".join([str(label), *(f"{v:.6f}" for v in numbers)]))
        (root / "labels" / "test" / f"{k:04}.txt").write_text("\n".join(dict.fromkeys(rows)))
        pixels = rng.integers(60, 200, (size_wh[1] // 8, size_wh[0] // 8)).astype(np.uint8)
        Image.fromarray(pixels).resize(size_wh).save(root / "images" / "test" / f"{k:04}.png")
    names = "".join(f"  {k}: {name}\n" for k, name in enumerate(CLASSES))
    (root / "data.yaml").write_text(
        f"path: {root}\ntrain: images/test\nval: images/test\ntest: images/test\nnames:\n{names}"
    )
    return root


def jittered(data: Path, path: Path, classes: tuple[str, ...]) -> Path:
    """Detections of a mediocre detector: near the labels, some missed, some duplicated, some false."""
    rng, found, sizes = stream(0, "jitter"), {}, {}
    for image in api.read_dataset(data, api.Reading(splits=["test"])).images:
        objects = [i for i in image.instances if i.category in classes and rng.random() < 0.85]
        objects += [i for i in objects if rng.random() < 0.1]
        boxes = [i.box_xyxy + rng.normal(0, 0.07, 4) * np.tile(i.box_xyxy[2:] - i.box_xyxy[:2], 2) for i in objects]
        numbers, scores = [classes.index(i.category) for i in objects], list(rng.beta(4, 2, len(objects)))
        size = image.size_wh or (320, 256)
        for _ in range(int(rng.integers(0, 12))):
            x, y, w, h = rng.uniform(0, 0.8 * size[0]), rng.uniform(0, 0.8 * size[1]), *rng.uniform(6, 40, 2)
            boxes.append(np.array([x, y, x + w, y + h]))
            numbers.append(int(rng.integers(0, len(classes))))
            scores.append(rng.beta(1.2, 4))
        key = f"{image.split}/{image.name}"
        found[key], sizes[key] = detections(boxes, scores, numbers), size
    return write_predictions(path, Predictions("detect", classes, found, sizes))


def assert_alike(record: dict, images: int) -> None:
    ours, theirs = record["classes"], record["ultralytics"]
    assert ours["all"]["images"] == images >= 200
    assert 0.3 < ours["all"]["map50"] < 0.98
    for name in theirs:
        assert ours[name]["images"] == theirs[name]["images"]
        assert ours[name]["instances"] == theirs[name]["instances"]
        for measure in ("map50", "map50_95", "p", "r"):
            assert ours[name][measure] == pytest.approx(theirs[name][measure], abs=0.01), (name, measure)
    assert set(theirs) == {name for name, row in ours.items() if row["instances"]}


def test_both_evaluate_synthetic_detections_alike(tmp_path: Path) -> None:
    data = write_yolo(tmp_path / "data", 220, (320, 256), "detect", 8)
    record = evaluate(jittered(data, tmp_path / "p.json", CLASSES), data, tmp_path / "out")
    assert_alike(record, 220)


@pytest.mark.parametrize("regions", ["--ignore-regions", "--no-ignore-regions"])
def test_both_evaluate_detections_on_hit_uav_alike(real_data: Path, tmp_path: Path, regions: str) -> None:
    data = real_data / "hit-uav"
    saved = jittered(data, tmp_path / "p.json", ("Person", "Car", "Bicycle", "OtherVehicle"))
    record = evaluate(saved, data, tmp_path / "out", regions)
    assert_alike(record, 579)
    table = record["classes"]
    # As the paper prints them.
    assert {n: (r["images"], r["instances"]) for n, r in table.items()} == {
        "all": (579, 4780), "Person": (355, 2611), "Car": (267, 1339), "Bicycle": (86, 796), "OtherVehicle": (21, 34),
    }  # fmt: skip
    assert record["counts"].get("ignore_regions", 0) == (31 if regions == "--ignore-regions" else 0)


MAKE_WEIGHTS = """
import sys, torch
from pathlib import Path
from infrablend.detection.ultralytics_environment import quiet_ultralytics
with quiet_ultralytics():
    from ultralytics.nn import tasks
    kind, path = sys.argv[1:]
    names = {"detect": ("DetectionModel", ""), "obb": ("OBBModel", "-obb"), "segment": ("SegmentationModel", "-seg")}
    name, suffix = names[kind]
    torch.manual_seed(0)
    net = getattr(tasks, name)(f"yolov8n{suffix}.yaml", nc=3, verbose=False)
    net.names = {0: "person", 1: "car", 2: "lorry"}
    net.args, net.task = {}, kind
    # Untrained. Without statistics for its normalisation such a network gives every place nearly the same score, and
    # the last bit of a convolution decides which of a hundred equal detections stay. So the statistics come from noise.
    for layer in net.modules():
        if isinstance(layer, torch.nn.BatchNorm2d):
            layer.momentum = None
    with torch.no_grad():
        net.train()(torch.nn.functional.interpolate(torch.rand(8, 3, 24, 24), scale_factor=8))
    net.eval()
    # Sharpened, so that scores spread from sure to unsure.
    for branch in net.model[-1].cv3:
        branch[-1].bias.data += 4
        branch[-1].weight.data *= 3
    torch.save({"model": net, "train_args": {"task": kind, "imgsz": 160}, "epoch": -1}, path)
"""

PREDICT = """
import sys
from pathlib import Path
from infrablend import api
from infrablend.detection.detections import write_predictions
from infrablend.formats.read_write import Reading
from infrablend.detection.predict import load_detector, predict
weights, data, out = map(Path, sys.argv[1:])
images = api.read_dataset(data, Reading(["test"])).images
# One by one, like the validation below: convolutions of several pictures at once round otherwise.
write_predictions(out, predict(load_detector(weights, "cpu", "float32"), images, image_size=160, batch=1))
"""

# Ultralytics' own validation, run on single pictures; its detections are recorded before they are scored.
VALIDATE = """
import json, sys
from infrablend.detection.ultralytics_environment import quiet_ultralytics
with quiet_ultralytics():
    import ultralytics
    from ultralytics.models import yolo
    from ultralytics.utils import ops
    weights, data, out, kind = sys.argv[1:]
    validators = {
        "detect": yolo.detect.DetectionValidator,
        "obb": yolo.obb.OBBValidator,
        "segment": yolo.segment.SegmentationValidator,
    }
    found = {}
    class Keeping(validators[kind]):
        def update_metrics(self, preds, batch):
            for k, p in enumerate(preds):
                b = self._prepare_batch(k, batch)
                sizes = b["imgsz"], p["bboxes"].clone(), b["ori_shape"]
                boxes = ops.scale_boxes(*sizes, ratio_pad=b["ratio_pad"], xywh=kind == "obb")
                name = batch["im_file"][k].rsplit("/")[-1]
                found[name] = [boxes.tolist(), p["conf"].tolist(), p["cls"].tolist()]
            super().update_metrics(preds, batch)
    ultralytics.YOLO(weights).val(
        validator=Keeping, data=data, split="test", imgsz=160, batch=1, plots=False, device="cpu", conf=0.001, iou=0.7,
        project=out, workers=0,
    )
json.dump(found, open(out + "/found.json", "w"))
"""


@pytest.mark.slow
@pytest.mark.parametrize("task", ["detect", "obb", "segment"])
def test_weights_find_what_ultralytics_validation_finds(tmp_path: Path, task: str) -> None:
    data = write_yolo(tmp_path / "data", 5, (150, 110), task, 3)
    weights = tmp_path / "weights.pt"
    made = python("-c", MAKE_WEIGHTS, task, weights)
    assert made.returncode == 0, made.stderr
    done = python("-c", PREDICT, weights, data, tmp_path / "ours.json")
    assert done.returncode == 0, done.stderr
    checked = python("-c", VALIDATE, weights, data / "data.yaml", tmp_path, task)
    assert checked.returncode == 0, checked.stderr[-2000:]
    theirs = json.loads((tmp_path / "found.json").read_text())
    from infrablend.detection.detections import read_predictions

    ours = read_predictions(tmp_path / "ours.json").images
    assert sorted(ours) == [f"test/{name}" for name in sorted(theirs)]
    for name, (boxes, scores, classes) in theirs.items():
        mine = ours[f"test/{name}"]
        mine_at = mine.corners_xy.mean(axis=1) if task == "obb" else mine.boxes_xyxy
        their_at = corners_of_cxcywha(np.array(boxes)).mean(axis=1) if task == "obb" else np.array(boxes)
        same = mine.classes[:, None] == np.array(classes)[None]
        same &= np.isclose(mine.scores[:, None], np.array(scores)[None], rtol=0, atol=2e-5)
        same &= np.isclose(mine_at[:, None], their_at[None], rtol=0, atol=0.05).all(axis=2)
        # On one thread both compute the same bits. On several, sums are taken in another order, and a detection that is
        # within rounding of the overlap at which it is dropped, or of the 300th place, may be there or not.
        assert len(mine.scores) > 5
        assert same.any(axis=1).mean() >= 0.98
        if task != "segment":  # detections with an empty mask do not count
            assert same.any(axis=0).mean() >= 0.98
            assert abs(len(scores) - len(mine.scores)) <= 0.02 * len(scores)

    record = evaluate(weights, data, tmp_path / "out", "--image-size", "160")
    assert record["task"] == task
    assert record["detector"]["weights"] == "weights.pt"
    assert (record["detector"]["image_size"], record["detector"]["image_size_from"]) == (160, "requested")
    saved = evaluate(tmp_path / "out" / "predictions.json", data, tmp_path / "again")
    assert saved == record
    if task != "detect":
        boxes_only = evaluate(tmp_path / "out", data, tmp_path / "boxes", "--task", "detect")
        assert boxes_only["classes"]["all"]["map50"] is not None


@pytest.mark.slow
def test_unusable_weights(tmp_path: Path) -> None:
    data = write_yolo(tmp_path / "data", 2, (64, 64), "detect", 2)
    (tmp_path / "torn.pt").write_bytes(b"PK\x03\x04 no weights")
    command = ("-m", "infrablend", "-q", "evaluate", data, "--out", tmp_path / "out")
    for weights, device, code, says in (
        ("torn.pt", "auto", 2, "cannot be loaded"),
        ("yolov8n.pt", "auto", 2, "no such file"),
        ("torn.pt", "cuda:7", 3, "cuda:7"),
    ):
        done = python(*command[:4], tmp_path / weights, *command[4:], "--device", device)
        assert done.returncode == code, done.stderr
        assert says in done.stderr
        assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["data", "torn.pt"]


@pytest.mark.slow
def test_unreadable_pictures_are_reported_first_and_an_earlier_evaluation_is_kept(tmp_path: Path) -> None:
    data, out, weights = tmp_path / "data", tmp_path / "out", tmp_path / "weights.pt"
    (data / "images" / "test").mkdir(parents=True)
    rng = stream(0, "broken pictures")
    names = [f"{k}.{suffix}" for k, suffix in enumerate(["png", "png", "png", "png", "bmp", "png"])]
    for name in names:
        Image.fromarray(rng.integers(0, 256, (64, 96), np.uint8)).save(data / "images" / "test" / name)
    top = {
        "categories": [{"id": 1, "name": "person"}],
        "images": [{"id": k, "file_name": n, "width": 96, "height": 64} for k, n in enumerate(names)],
        "annotations": [{"id": k, "image_id": k, "category_id": 1, "bbox": [5, 5, 20, 40]} for k in range(len(names))],
    }
    (data / "annotations").mkdir()
    (data / "annotations" / "test.json").write_text(json.dumps(top))
    made = python("-c", MAKE_WEIGHTS, "detect", weights)
    assert made.returncode == 0, made.stderr
    evaluate(weights, data, out, "--image-size", "64")
    before = {p.name: p.read_bytes() for p in out.iterdir() if p.is_file()}

    def refused() -> str:
        done = python("-m", "infrablend", "-q", "evaluate", weights, data, "--out", out, "--overwrite",
                      "--bootstrap", "0", "--image-size", "64")  # fmt: skip
        assert done.returncode == 2, done.stderr
        assert {p.name: p.read_bytes() for p in out.iterdir() if p.is_file()} == before
        return done.stderr

    whole = {n: (data / "images" / "test" / n).read_bytes() for n in names}
    # The header is there, the pixels are not; nothing tells but decoding.
    (data / "images" / "test" / "4.bmp").write_bytes(whole["4.bmp"][:2000])
    assert "1 of 6 pictures cannot be used" in refused()
    (data / "images" / "test" / "1.png").write_bytes(b"no picture")
    (data / "images" / "test" / "3.png").write_bytes(whole["3.png"][:2000])
    Image.fromarray(np.zeros((32, 96), np.uint8)).save(data / "images" / "test" / "5.png")
    told = refused()
    assert "cannot be evaluated" in told  # before the first picture is detected on
    for name in ("test/1.png", "test/3.png", "test/5.png: 96x32 px"):
        assert name in told
    assert "test/0.png" not in told
