"""`evaluate --stress`: labels follow the pixels under every change, and a perfect detector stays perfect."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from infrablend import api
from infrablend.cli.app import build_app
from infrablend.core.boxes import corners_of_box
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.core.rle_masks import Mask
from infrablend.detection.detections import Predictions, detections, write_predictions
from infrablend.detection.predict import FittedPicture, _scaled, fit_picture
from infrablend.detection.truth import image_key, truths
from infrablend.errors import DatasetError
from infrablend.lab.evaluation import evaluate as pipeline
from infrablend.lab.evaluation.evaluate import evaluate_detector
from infrablend.lab.evaluation.evaluation_settings import EvaluationSettings
from infrablend.lab.evaluation.stress import Change, crop_labels, list_changes

CHANGES = {change.name: change for change in list_changes(0)}
CROPS = [name for name in CHANGES if "cropped" in name]
SIZE_WH = (323, 250)
CATEGORIES = (Category(1, "drone"), Category(2, "bird"))
# Of 323 x 250 px, the eighth cropped left and above ends at 40, 31; the one right and below begins at 283, 219.
OBJECTS = {
    "drone": ([100, 80, 124, 96], [200, 150, 220, 190], [30, 100, 60, 120]),  # the last one is cut on the left
    "bird": ([150, 40, 182, 52], [5, 5, 25, 20], [270, 200, 300, 230]),  # outside left and above; cut right and below
}
LEVELS = {"drone": 230, "bird": 190}


class Rows:
    """Stands for a tensor of Ultralytics' rows."""

    def __init__(self, values: Any) -> None:
        self.values = np.array(values, np.float64).reshape(-1, 6)

    def cpu(self) -> Rows:
        return self

    def numpy(self) -> Any:
        return self.values


def see(fitted: FittedPicture):
    """Return what a perfect detector finds in what the network gets: everything that differs from the grey of 114."""
    seen = fitted.pixels[..., 0].astype(np.int64)
    left, top = fitted.pad_xy
    sky = int(seen[top, left + 100])
    away = np.abs(seen - sky)
    away[:top], away[:, :left] = 0, 0
    away[top + round(fitted.size_wh[1] * fitted.scale_xy[1]) :] = 0
    away[:, left + round(fitted.size_wh[0] * fitted.scale_xy[0]) :] = 0
    # The brightest object stands out by 116 levels, the other one by 76, whatever the gain.
    _, _, areas, _ = cv2.connectedComponentsWithStats((away > away.max() / 3).astype(np.uint8))
    rows = []
    for x, y, w, h, _ in areas[1:]:
        is_drone = away[y + h // 2, x + w // 2] > 0.82 * away.max()
        rows.append([x, y, x + w, y + h, 0.9, 0 if is_drone else 1])
    return _scaled(Rows(rows), fitted, "detect", None)


def drawn(folder: Path, number: int = 1) -> Dataset:
    pixels = np.full((SIZE_WH[1], SIZE_WH[0]), 114, np.uint8)
    instances = []
    for name, boxes in OBJECTS.items():
        for x0, y0, x1, y1 in boxes:
            pixels[y0:y1, x0:x1] = LEVELS[name]
            mask = np.zeros(pixels.shape, np.bool_)
            mask[y0:y1, x0:x1] = True
            box = np.array([x0, y0, x1, y1], np.float64)
            instances.append(Instance(name, box, corners_of_box(box), Mask.from_array(mask)))
    images = []
    for k in range(number):
        Image.fromarray(pixels).save(folder / f"{k}.png")
        images.append(ImageRecord(str(k), folder / f"{k}.png", "test", SIZE_WH, tuple(instances)))
    return Dataset(folder, "coco", CATEGORIES, tuple(images))


def read(path: Path) -> np.ndarray:
    return np.repeat(np.array(Image.open(path))[..., None], 3, axis=2)


class PerfectDetector:
    """Stands for `DetectionSource`; its network sees every object as it is."""

    name = "weights.pt"
    classes = ("drone", "bird")
    task = "detect"
    is_fixed = False

    def __init__(self, *_: Any) -> None:
        pass

    def check(self, images: Any, problems: Any) -> None:
        pass

    def on(self, images: Any, image_size: int | None, on_image: Any, problems: Any, fit: Any = fit_picture):
        found = {}
        sizes = {}
        for number, image in enumerate(images, 1):
            fitted = fit(read(image.path), image_size or 0, 32)
            found[image_key(image)] = see(fitted)
            sizes[image_key(image)] = fitted.size_wh
            if on_image is not None:
                on_image(number, len(images))
        return Predictions("detect", self.classes, found, sizes, {"weights": self.name})


@pytest.fixture
def perfect(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline, "DetectionSource", PerfectDetector)
    monkeypatch.setattr(pipeline, "missing_packages", lambda: ["ultralytics", "torch"])
    monkeypatch.setattr(pipeline, "draw_plots", lambda facts: {"pr.png": b"", "confusion.png": b""})


@pytest.mark.parametrize("image_size", [0, 640])
@pytest.mark.parametrize("name", CHANGES)
def test_labels_follow_the_pixels(name: str, image_size: int, tmp_path: Path) -> None:
    """What the network gets, mapped back, is where the labels of the changed picture are."""
    dataset = drawn(tmp_path)
    change = CHANGES[name]
    (truth,), _ = truths(dataset.images, CATEGORIES, ("drone", "bird"), "detect")
    labels = crop_labels(truth, change.window)
    fitted = change(read(dataset.images[0].path), image_size, 32)
    assert fitted.size_wh == labels.size_wh
    found = see(fitted)
    whole = labels.boxes_xyxy[~labels.ignore]
    near = 1.01 if image_size or "scale" in name else 0.0  # px; resampling blurs an edge
    for box, of in zip(whole, labels.classes[~labels.ignore], strict=True):
        same = found.boxes_xyxy[found.classes == of]
        assert np.abs(same - box).max(axis=1).min() <= near


@pytest.mark.parametrize("image_size", [None, 640])
def test_a_perfect_detector_stays_perfect(perfect: None, tmp_path: Path, image_size: int | None) -> None:
    seen = []
    dataset = drawn(tmp_path, 2)
    settings = EvaluationSettings(stress=True, bootstrap=0, image_size=image_size)
    report = evaluate_detector(
        Path("weights.pt"), dataset, tmp_path / "out", settings, on_image=lambda *n: seen.append(n)
    )
    stress = report.metrics["stress"]
    assert [of["change"] for of in stress["changes"]] == ["none", *CHANGES]
    counts = {of["change"]: (of["objects_cut"], of["objects_outside"]) for of in stress["changes"]}
    for of in stress["changes"]:
        for name, row in of["classes"].items():
            objects = 6 * 2 if name == "all" else 3 * 2
            if name == "all":
                objects -= sum(counts[of["change"]])
                assert row["objects"] == objects
            figures = {key: row[key] for key in ("map50", "map10", "found", "named", "false_alarms")}
            assert figures == {"map50": 1.0, "map10": 1.0, "found": 1.0, "named": 1.0, "false_alarms": 0.0}, of
    assert {name: of for name, of in counts.items() if of != (0, 0)} == {
        "an eighth cropped left and above": (2, 2),
        "an eighth cropped right and below": (2, 0),
        "an eighth cropped on all sides": (4, 2),
    }
    assert seen[-1] == (2 * len(CHANGES), 2 * len(CHANGES))
    out = tmp_path / "out"
    assert json.loads((out / "stress.json").read_text()) == json.loads((out / "evaluation.json").read_text())["stress"]
    page = (out / "stress.html").read_text()
    assert "<td>border 64 px</td><td>12</td><td>1.000</td>" in page
    assert "an eighth cropped on all sides: 4 objects are cut and ignored, 2 are outside." in page
    assert page.count("<table>") == 3  # all, drone, bird
    assert 'href="stress.html"' in (out / "evaluation.html").read_text()


def test_figures_tell_misses_wrong_names_and_false_alarms(
    perfect: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A detector that overlooks all drones in noise, calls them birds inverted, and fires at a border of 64 px."""
    plain = PerfectDetector.on

    def on(self: PerfectDetector, images: Any, image_size: Any, on_image: Any, problems: Any, fit: Any = fit_picture):
        predictions = plain(self, images, image_size, on_image, problems, fit)
        name = getattr(fit, "name", "")
        (key,) = predictions.images
        its = predictions.images[key]
        classes = its.classes
        boxes = its.boxes_xyxy
        scores = its.scores
        if name.startswith("noise"):
            boxes, scores, classes = boxes[classes == 1], scores[classes == 1], classes[classes == 1]
        elif name.startswith("inverted"):
            classes = np.ones_like(classes)
        elif name == "border 64 px":
            boxes = np.concatenate([boxes, [[290, 10, 310, 30]]])
            scores = np.append(scores, 0.95)
            classes = np.append(classes, 0)
        return Predictions("detect", self.classes, {key: detections(boxes, scores, classes)}, predictions.sizes_wh)

    monkeypatch.setattr(PerfectDetector, "on", on)
    settings = EvaluationSettings(stress=True, bootstrap=0)
    report = evaluate_detector(Path("weights.pt"), drawn(tmp_path), tmp_path / "out", settings)
    rows = {of["change"]: of["classes"] for of in report.metrics["stress"]["changes"]}
    noise = rows["noise of sigma 3"]
    assert (noise["all"]["map50"], noise["drone"]["map10"], noise["drone"]["found"]) == (0.5, 0.0, 0.0)
    assert (noise["all"]["found"], noise["all"]["named"], noise["drone"]["named"]) == (0.5, 1.0, None)
    inverted = rows["inverted grey (not trained for)"]
    assert (inverted["drone"]["map10"], inverted["drone"]["found"], inverted["drone"]["named"]) == (0.0, 1.0, 0.0)
    assert (inverted["all"]["named"], inverted["bird"]["false_alarms"], inverted["all"]["false_alarms"]) == (0.5, 3, 0)
    fired = rows["border 64 px"]
    assert (fired["all"]["false_alarms"], fired["drone"]["false_alarms"], fired["bird"]["false_alarms"]) == (1, 1, 0)
    assert fired["drone"]["map50"] < 1.0 == fired["bird"]["map50"]
    assert rows["border 32 px"] == rows["none"]


@pytest.mark.parametrize("name", CROPS)
def test_masks_corners_and_regions_follow_a_crop(name: str, tmp_path: Path) -> None:
    (image,) = drawn(tmp_path).images
    change = CHANGES[name]
    (boxes,), _ = truths([image], CATEGORIES, ("drone", "bird"), "detect")
    expected = crop_labels(boxes, change.window)
    for task in ("obb", "segment"):
        (truth,), _ = truths([image], CATEGORIES, ("drone", "bird"), task)
        cut = crop_labels(truth, change.window)
        assert (cut.ignore == expected.ignore).all() and (cut.classes == expected.classes).all()
        assert (np.diff(cut.ignore.astype(int)) >= 0).all()  # objects come first
        if cut.corners_xy is not None:
            bounds = np.concatenate([cut.corners_xy.min(axis=1), cut.corners_xy.max(axis=1)], axis=1)
            assert (bounds == expected.boxes_xyxy).all()
        for mask, box in zip(cut.masks or (), expected.boxes_xyxy, strict=cut.masks is not None):
            w, h = cut.size_wh
            assert mask.size_hw == (h, w)
            assert (mask.box_xyxy == np.clip(box, 0, [w, h, w, h])).all()


def test_objects_at_the_pictures_own_edge_are_not_cut_by_a_crop_there(tmp_path: Path) -> None:
    at_edge = Instance("drone", np.array([300.0, 240, 330, 255]))  # a box that its source did not clip
    empty = Instance("bird", np.array([50.0, 50, 50, 60]))
    image = ImageRecord("a", tmp_path / "a.png", "test", SIZE_WH, (at_edge, empty))
    (truth,), _ = truths([image], CATEGORIES, ("drone", "bird"), "detect")
    kept = crop_labels(truth, CHANGES["an eighth cropped left and above"].window)
    assert not kept.ignore.any() and kept.boxes_xyxy.tolist() == [[260, 209, 290, 224], [10, 19, 10, 29]]
    same = crop_labels(truth, Change("none").window)
    assert (same.boxes_xyxy == truth.boxes_xyxy).all() and (same.ignore == truth.ignore).all()


def test_borders_and_shifts_are_exact() -> None:
    pixels = np.random.default_rng(0).integers(0, 255, (256, 320, 3), np.uint8)
    assert CHANGES["border 0 px"](pixels, 0, 32).pixels.shape == pixels.shape
    assert (CHANGES["border 0 px"](pixels, 0, 32).pixels == pixels).all()
    for border in (0, 8, 16, 32, 64):
        fitted = CHANGES[f"border {border} px"](pixels, 0, 32)
        assert fitted.pad_xy == (border, border)
        inner = np.zeros(fitted.pixels.shape[:2], np.bool_)
        inner[border : border + 256, border : border + 320] = True
        assert (fitted.pixels[inner].reshape(pixels.shape) == pixels).all()
        assert (fitted.pixels[~inner] == 114).all()
        assert all(0 <= s - b - 2 * border < 32 and s % 32 == 0 for s, b in zip(inner.shape, (256, 320), strict=True))
    shifted = CHANGES["shift -7, -3 px"](pixels, 0, 32)
    assert shifted.pad_xy == (9, 13)
    assert (shifted.pixels[13 : 13 + 256, 9 : 9 + 320] == pixels).all()


@pytest.mark.parametrize("size_hw", [(256, 320), (255, 319), (250, 323), (17, 40), (512, 640), (271, 33)])
@pytest.mark.parametrize("image_size", [0, 320, 640])
def test_no_change_is_what_an_evaluation_does(size_hw: tuple[int, int], image_size: int) -> None:
    pixels = np.random.default_rng(0).integers(0, 255, (*size_hw, 1), np.uint8)
    ours = Change("none")(pixels, image_size, 32)
    plain = fit_picture(pixels, image_size, 32)
    assert (ours.pixels == plain.pixels).all()
    assert (ours.size_wh, ours.scale_xy, ours.pad_xy) == (plain.size_wh, plain.scale_xy, plain.pad_xy)


def test_levels_change_as_named() -> None:
    pixels = np.full((64, 64, 3), 120, np.uint8)
    pixels[10:14, 10:14], pixels[20:24, 20:24] = 250, 10

    def levels(name: str, of: np.ndarray = pixels) -> np.ndarray:
        fitted = CHANGES[name](of, 0, 32)
        x, y = fitted.pad_xy
        return fitted.pixels[y : y + 64, x : x + 64]

    def three(name: str) -> list[int]:
        return [int(levels(name)[at, at, 0]) for at in (0, 11, 21)]

    assert three("gain 0.7") == [120, 211, 43]
    assert three("gain 1.4") == [120, 255, 0]
    assert three("offset -20 levels") == [100, 230, 0]
    assert three("offset +20 levels") == [140, 255, 30]
    assert three("inverted grey (not trained for)") == [135, 5, 245]
    noisy = levels("noise of sigma 3").astype(int) - pixels
    assert 2.5 < noisy[30:].std() < 3.5
    assert (noisy == noisy[..., :1]).all()
    assert (levels("noise of sigma 3").astype(int) - pixels == noisy).all()
    other = pixels.copy()
    other[0, 0] = 121
    assert (levels("noise of sigma 3", other).astype(int) - other != noisy).mean() > 0.5
    again = next(c for c in list_changes(1) if c.name.startswith("noise"))(pixels, 0, 32).pixels
    assert (again != CHANGES["noise of sigma 3"](pixels, 0, 32).pixels).mean() > 0.3


def test_saved_detections_are_refused_and_the_screen_shows_a_table(
    perfect: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset = drawn(tmp_path)
    call = ["evaluate", "weights.pt", str(tmp_path), "--out", str(tmp_path / "out"), "--stress", "--bootstrap", "0"]
    monkeypatch.setattr(api, "read_dataset", lambda *_: dataset)
    monkeypatch.setattr("infrablend.lab.interface.read_dataset", lambda *_: dataset)
    monkeypatch.setattr("infrablend.lab.interface.require_apart", lambda *_: None)
    done = CliRunner().invoke(build_app(), call)
    assert done.exit_code == 0, done.output
    assert "border 64 px" in done.output and "false alarms a picture" in done.output
    done = CliRunner().invoke(build_app(), [*call, "--overwrite", "--json"])
    assert len(json.loads(done.stdout)["stress"]["changes"]) == 1 + len(CHANGES)
    monkeypatch.undo()
    saved = PerfectDetector().on(dataset.images, 0, None, [])
    file = write_predictions(tmp_path / "saved.json", saved)
    with pytest.raises(DatasetError, match="cannot be evaluated") as refused:
        evaluate_detector(file, dataset, tmp_path / "no", EvaluationSettings(stress=True))
    assert "stress-saved" in {p.code for p in refused.value.problems}
    assert not (tmp_path / "no").exists()
