"""`evaluate` on saved detections, which needs neither torch nor Ultralytics."""

from __future__ import annotations

import json
import shutil
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from infrablend import api
from infrablend.cli.app import build_app
from infrablend.core.capture import Capture
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance
from infrablend.core.rle_masks import Mask
from infrablend.core.rng import stream
from infrablend.core.workspace import workspace
from infrablend.detection.detections import Predictions, detections, write_predictions
from infrablend.errors import DatasetError, MissingDependencyError, ModelError, OutputError, Problem
from infrablend.lab.evaluation import evaluate as pipeline
from infrablend.lab.evaluation.evaluate import evaluate_detector, image_groups, rejected_in
from infrablend.lab.evaluation.evaluation_settings import EvaluationSettings
from infrablend.lab.lab_commands import _evaluation
from tests.samples import with_facts

CLASSES = ("Person", "Car", "OtherVehicle")
CATEGORIES = (*(Category(k, n) for k, n in enumerate(CLASSES)), Category(9, "DontCare", ignore=True))


@pytest.fixture(autouse=True)
def _without_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    """As without the extra installed; tests/contract compares with Ultralytics."""
    monkeypatch.setattr(pipeline, "missing_packages", lambda: ["ultralytics", "torch"])


@pytest.fixture(autouse=True)
def _no_charts(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if "charts" not in request.fixturenames:
        monkeypatch.setattr(pipeline, "draw_plots", lambda facts: {"pr.png": b"", "confusion.png": b""})


def made_up_dataset(number: int = 40, split: str = "test") -> Dataset:
    """Images that exist as records alone, with sizes."""
    rng = stream(0, "dataset")
    images = []
    for k in range(number):
        n = int(rng.integers(1, 5))
        low = rng.uniform(0, [600, 480], (n, 2))
        boxes = np.concatenate([low, low + rng.uniform(8, 30, (n, 2))], axis=1)
        names = ["Person" if v < 0.6 else "Car" if v < 0.97 else "DontCare" for v in rng.random(n)]
        name = f"{k % 2}_{60 + 10 * (k % 8)}_{30 + 10 * (k % 7)}_0_{k // 2:05}_c{k % 2}.png"
        images.append(
            ImageRecord(
                Path(name).stem,
                Path(name),
                split,
                (640, 512),
                tuple(Instance(c, b) for c, b in zip(names, boxes, strict=True)),
                capture=Capture(
                    pitch_deg=30.0 + 10 * (k % 7),
                    altitude_m=60.0 + 10 * (k % 8),
                    time_of_day="night" if k % 2 else "day",
                ),
            )
        )
    return Dataset(Path("made-up"), "coco", CATEGORIES, tuple(images))


def found_on(
    dataset: Dataset, *, classes: tuple[str, ...] = CLASSES, noise_px: float = 1.5, seed: int = 0
) -> Predictions:
    """Detections near the labels, and some false ones."""
    rng = stream(seed, "found")
    found = {}
    for image in dataset.images:
        objects = [i for i in image.instances if i.category in classes and rng.random() < 0.9]
        boxes = [i.box_xyxy + rng.normal(0, noise_px, 4) for i in objects]
        numbers = [classes.index(i.category) for i in objects]
        scores = list(rng.uniform(0.3, 1, len(objects)))
        if rng.random() < 0.5:
            boxes, numbers, scores = [*boxes, np.array([5.0, 5, 20, 20])], [*numbers, 0], [*scores, rng.random()]
        found[f"{image.split}/{image.name}"] = detections(boxes, scores, numbers)
    return Predictions("detect", classes, found, dict.fromkeys(found, (640, 512)), {"weights": "made.pt"})


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    return write_predictions(tmp_path / "found.json", found_on(made_up_dataset()))


def run(saved: Path, out: Path, dataset: Dataset | None = None, **settings: Any):
    of_settings = {f.name for f in fields(EvaluationSettings)}
    chosen = EvaluationSettings(**{"bootstrap": 50, **{k: v for k, v in settings.items() if k in of_settings}})
    more = {k: v for k, v in settings.items() if k not in of_settings}
    return evaluate_detector(saved, dataset or made_up_dataset(), out, chosen, **more)


def test_written_files(charts: None, saved: Path, tmp_path: Path) -> None:
    report = run(saved, tmp_path / "out")
    files = sorted(p.name for p in (tmp_path / "out").iterdir())
    assert files == ["evaluation.html", "evaluation.json", "matches.npz", "plots", "predictions.json"]
    written = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert written == json.loads(json.dumps(report.to_json())) | {"contents": written["contents"]}
    dataset = made_up_dataset()
    objects = [i.category for image in dataset.images for i in image.instances]
    table = report.metrics["classes"]
    assert list(table) == ["all", *CLASSES]
    assert table["Person"]["instances"] == objects.count("Person")
    assert table["all"]["instances"] == objects.count("Person") + objects.count("Car")
    assert table["all"]["images"] == 40
    assert table["Car"]["images"] == sum(any(i.category == "Car" for i in image.instances) for image in dataset.images)
    assert table["all"]["map50"] == pytest.approx((table["Person"]["map50"] + table["Car"]["map50"]) / 2)
    assert 0.3 < table["all"]["map50_95"] < 0.6 < table["all"]["map50"] < 1
    low, high = table["Person"]["ci"]["map50"]
    assert low < table["Person"]["map50"] < high
    assert table["OtherVehicle"] == {
        "images": 0, "instances": 0, "p": None, "r": None, "map10": None, "map50": None, "map50_95": None,
        "ci": None, "median_px": None, "found": None, "named": None, "false_alarms": None,
    }  # fmt: skip
    assert report.metrics["ultralytics"] is None
    codes = {p.code for p in report.problems}
    assert {"class-empty", "ignore-regions"} <= codes
    strata = report.metrics["strata"]
    assert list(strata["time"]) == ["day", "night"]
    assert list(strata["pitch"]) == ["30", "40", "50", "60", "70", "80", "90"]
    assert len(strata["altitude"]) == 8
    for kind in ("time", "pitch", "altitude"):
        assert sum(s["classes"]["all"]["instances"] for s in strata[kind].values()) == table["all"]["instances"]
    assert sum(s["classes"]["all"]["instances"] for s in strata["size"].values()) == table["all"]["instances"]
    page = (tmp_path / "out" / "evaluation.html").read_text()
    assert f"{table['Person']['map50']:.3f}" in page
    assert "<script" not in page


def test_objects_found_and_missed_are_listed_on_request(saved: Path, tmp_path: Path) -> None:
    plain = run(saved, tmp_path / "plain")
    assert "first_detections" not in plain.metrics
    report = run(saved, tmp_path / "out", list_first=12, list_iou=0.4)
    listed = report.metrics["first_detections"]
    assert (listed["first"], listed["iou"], listed["detections"]) == (12, 0.4, 12)
    objects = listed["objects"]
    assert len(objects) == report.metrics["classes"]["all"]["instances"]
    ranks = sorted(o["rank"] for o in objects if o["rank"])
    assert 6 < len(ranks) == listed["found"] <= 12 and set(ranks) <= set(range(1, 13))
    page = (tmp_path / "out" / "evaluation.html").read_text()
    assert "Objects found and missed" in page and page.count("<td>missed</td>") == len(objects) - len(ranks)
    assert "Objects found and missed" not in (tmp_path / "plain" / "evaluation.html").read_text()
    with pytest.raises(DatasetError, match="list_iou"):
        EvaluationSettings(list_iou=0)


def test_bodies_are_measured_in_the_pictures_on_request(charts: None, tmp_path: Path) -> None:
    """A cold object of 3 px, a warm one of 6 px and none in a 16-bit picture; the third picture is lost."""
    images = []
    for k, box in enumerate(([15.0, 15, 30, 30], [55.0, 55, 70, 70], [15.0, 15, 30, 30])):
        path = tmp_path / f"{k}.png"
        pixels = np.full((512, 640), 100, np.uint8) if k == 0 else np.full((512, 640), 30000, np.uint16)
        pixels[20:23, 20:22] -= 60
        pixels[60:64, 60:66] += 90
        Image.fromarray(pixels).save(path)
        objects = (Instance("Person", np.array(box)), Instance("Car", np.array([80.0, 10, 90, 20])))
        images.append(ImageRecord(str(k), path, "test", (640, 512), objects[: 2 if k else 1]))
    (tmp_path / "2.png").unlink()
    dataset = Dataset(tmp_path, "coco", CATEGORIES, tuple(images))
    found = write_predictions(tmp_path / "found.json", found_on(dataset))
    report = run(found, tmp_path / "out", dataset, by_body=True, bootstrap=0)
    bins = {n: of["classes"]["Person"]["instances"] for n, of in report.metrics["strata"]["body"].items()}
    assert bins == {"2-4": 1, "4-8": 1, "8-14": 0, "14-30": 0, ">=30": 0}
    assert report.metrics["counts"]["bodies_not_measured"] == 3
    assert report.metrics["counts"]["bodies_below_2_px"] == 0
    said = [p.found for p in report.problems]
    assert "0 objects with a body below 2 px and 3 without a measurable one are in no bin of the body" in said
    assert "pictures that cannot be read, so that the bodies in them are not measured: 1; 2.png: no such file" in said
    page = (tmp_path / "out" / "evaluation.html").read_text()
    assert "By longer side of the body, px" in page
    assert "All classes as one: AP50" in page
    assert "body" not in run(found, tmp_path / "again", dataset, bootstrap=0).metrics["strata"]


def test_small_objects_have_map10_in_the_terminal_and_on_the_page(saved: Path, tmp_path: Path) -> None:
    """Objects are 8 to 30 px large; ten times as large, they need no such column."""
    small = run(saved, tmp_path / "small")
    why = "Boxes of small objects are inexact (median longer side: Person"
    page = (tmp_path / "small" / "evaluation.html").read_text()
    assert why in page and page.index("<th>mAP10</th>") < page.index("<th>mAP50</th>")
    table, said, *_ = _evaluation(small)
    assert " mAP10 " in table and said.startswith(why)
    assert "map10" in small.to_json()["classes"]["Person"] and "map10" in small.to_json()["classes"]["all"]
    dataset = made_up_dataset(4)
    images = [replace(i, size_wh=(6400, 5120), instances=tuple(replace(o, box_xyxy=10 * o.box_xyxy)
              for o in i.instances)) for i in dataset.images]  # fmt: skip
    large = replace(dataset, images=tuple(images))
    found = write_predictions(tmp_path / "large.json", replace(found_on(large), sizes_wh={
        f"{i.split}/{i.name}": (6400, 5120) for i in images}))  # fmt: skip
    report = run(found, tmp_path / "large", large)
    assert "mAP10" not in (tmp_path / "large" / "evaluation.html").read_text()
    assert "mAP10" not in "".join(_evaluation(report))


def test_repeated_evaluations_and_saved_detections_give_the_same_bytes(
    charts: None, saved: Path, tmp_path: Path
) -> None:
    run(saved, tmp_path / "a")
    run(tmp_path / "a" / "predictions.json", tmp_path / "b")
    run(tmp_path / "a", tmp_path / "b", overwrite=True)  # the folder means its predictions
    run(tmp_path / "b" / "predictions.json", tmp_path / "b", overwrite=True)  # itself
    for path in sorted((tmp_path / "a").rglob("*")):
        if path.is_file():
            assert path.read_bytes() == (tmp_path / "b" / path.relative_to(tmp_path / "a")).read_bytes(), path.name
    run(saved, tmp_path / "c", seed=1)
    assert (tmp_path / "a" / "evaluation.json").read_bytes() != (tmp_path / "c" / "evaluation.json").read_bytes()


def test_configurations_of_one_background_are_drawn_together(saved: Path, tmp_path: Path) -> None:
    assert run(saved, tmp_path / "a").metrics["settings"]["groups"] == 20
    by_gap = run(saved, tmp_path / "b", group="gap")
    assert by_gap.metrics["settings"]["groups"] == 1
    assert all(row["ci"] is None for row in by_gap.metrics["classes"].values())  # drawn from one, it is always the same
    with pytest.raises(DatasetError, match="--group image, gap or date"):
        run(saved, tmp_path / "c", group="sequence")
    assert not (tmp_path / "c").exists()


def test_strata_of_one_image_have_no_interval_and_say_the_images_that_hold_a_class(tmp_path: Path) -> None:
    whole = made_up_dataset()
    images = tuple(with_facts(i, time_of_day=None) if k == 0 else i for k, i in enumerate(whole.images))
    dataset = replace(whole, images=images)
    saved = write_predictions(tmp_path / "p.json", found_on(dataset))
    strata = run(saved, tmp_path / "out", dataset).metrics["strata"]
    lone, day = (strata["time"][n]["classes"] for n in ("unknown", "day"))
    assert lone["all"]["instances"] > 0
    assert lone["all"]["map50"] is not None
    assert all(row["ci"] is None for row in lone.values())
    low, high = day["all"]["ci"]["map50"]
    assert low < high

    def holding(wanted: str, low: float, high: float, images: Any = images) -> int:
        boxes = [[o.box_xyxy for o in i.instances if wanted in ("all", o.category)] for i in images]
        return sum(any(low <= max(b[2:] - b[:2]) < high for b in of) for of in boxes)

    by_size = strata["size"]
    for name, edges in (("8-16", (8, 16)), ("16-32", (16, 32))):
        rows = by_size[name]["classes"]
        for c in ("Person", "Car"):
            assert 0 < rows[c]["images"] == holding(c, *edges) < 40
        assert max(rows[c]["images"] for c in ("Person", "Car")) <= rows["all"]["images"] <= holding("all", *edges)
    at_day = [i for i in images if i.capture.time_of_day == "day"]
    assert day["Car"]["images"] == holding("Car", 0, 999, at_day) < day["all"]["images"] == len(at_day) == 19
    page = (tmp_path / "out" / "evaluation.html").read_text()
    car = by_size["16-32"]["classes"]["Car"]
    assert f"<td>16-32</td><td>Car</td><td>{car['images']}</td><td>{car['instances']}</td>" in page


def test_originals_and_other_names_are_drawn_with_their_configurations() -> None:
    def groups(*names: str) -> list[int]:
        record = made_up_dataset(1).images[0]
        images = [replace(record, id=Path(n).stem, path=Path(n), file_name=n) for n in names]
        found = image_groups(images, "image", [])
        return [found.index(g) for g in found]

    hit = "0_60_30_0_00001"
    assert groups(f"{hit}.jpg", f"{hit}_c0.png", f"{hit}_c1.png", "0_60_30_0_00002.jpg") == [0, 0, 0, 3]
    assert groups("a.png", "a_c0.png", "b_c0.png", "b_c12.png", "c.png", "_c0.png") == [0, 0, 2, 2, 4, 5]
    assert groups("x/a_c0.png", "y/a_c0.png", "a_c1_c0.png", "a_c0_c0.png", "a.jpg") == [0, 1, 2, 2, 2]
    assert groups("a.jpg", "a.png", "a_cat.png", "a_c.png") == [0, 1, 2, 3]


def test_one_configuration_each_keeps_the_names_that_draws_are_sorted_by() -> None:
    record = made_up_dataset(1).images[0]
    for names, expected in (
        (["a_c0.png", "b_c0.png"], ("test/a_c0.png", "test/b_c0.png")),
        (["0_60_30_0_00007_c0.png", "0_60_30_0_00008.png"], ("frame 7", "test/0_60_30_0_00008.png")),
    ):
        images = [replace(record, id=Path(n).stem, path=Path(n), file_name=n) for n in names]
        assert image_groups(images, "image", []) == expected


def test_labels_that_the_reader_rejected_are_reported(saved: Path, tmp_path: Path) -> None:
    whole = made_up_dataset()
    stem = Path(whole.images[0].name).stem
    ours = [
        Problem("coco/test.json: annotation 5", "box-empty", "bbox [1, 1, 0, 0]"),
        Problem("labels/test/x.txt: line 3", "label-malformed", "'0 a b'"),
        Problem(f"Annotations/{stem}.xml: object 2", "box-outside", "box 900 900 910 910"),
        Problem("Annotations/unknown.xml", "image-missing", "no picture"),
        Problem("Annotations/train_1.xml", "image-missing", "no picture"),
    ]
    others = [
        Problem("annotations/instances_val2017.json: annotation 5", "box-empty", "bbox [1, 1, 0, 0]"),
        Problem("labels/train/x.txt: line 3", "label-malformed", "'0 a b'"),
        Problem("test.json: annotation 9", "box-clipped", "box", severity="warning"),
    ]
    assert "rejected" not in run(saved, tmp_path / "a").metrics["counts"]
    report = run(saved, tmp_path / "b", replace(whole, problems=(*others, *ours)))
    assert report.metrics["counts"]["rejected"] == 5
    assert [p for p in report.problems if p.severity == "error"] == ours
    written = json.loads((tmp_path / "b" / "evaluation.json").read_text())["problems"]
    assert [p["where"] for p in written if p["severity"] == "error"] == [p.where for p in ours]
    (warning,) = [p for p in report.problems if p.code == "labels-rejected"]
    assert warning.severity == "warning"
    assert "5 labels or images" in warning.found
    assert "coco/test.json: annotation 5: bbox [1, 1, 0, 0]" in warning.found
    assert (tmp_path / "b" / "evaluation.html").read_text().count("bbox [1, 1, 0, 0]") == 1
    with pytest.raises(DatasetError, match="annotation 5"):
        run(saved, tmp_path / "c", replace(whole, images=(), problems=tuple(ours)))


def evaluation_command(data: Path, tmp_path: Path, draws: int) -> list[str]:
    """Return the command that evaluates a detection of the only label of the split test."""
    (image,) = api.read_dataset(data, api.Reading(splits=["test"])).images
    key, boxes = f"test/{image.name}", [i.box_xyxy for i in image.instances]
    found = Predictions("detect", ("other vehicle",), {key: detections(boxes, [0.9], [0])}, {key: (640, 512)})
    saved = str(write_predictions(tmp_path / "p.json", found))
    return ["-q", "evaluate", saved, str(data), "--out", str(tmp_path / "out"), "--bootstrap", str(draws)]


def test_the_command_reports_rejected_labels(tmp_path: Path, write_tiny_hit_uav) -> None:
    data = write_tiny_hit_uav(tmp_path / "data", ("normal_json",))
    file = data / "normal_json" / "annotations" / "test.json"
    content = json.loads(file.read_text())
    content["annotation"].append({**content["annotation"][0], "id": 77, "bbox": [5, 5, 0, 0]})
    file.write_text(json.dumps(content))
    done = CliRunner().invoke(build_app(), evaluation_command(data, tmp_path, 0))
    assert done.exit_code == 0, done.output
    assert "1 problem(s):" in done.stderr
    assert "annotation 77" in done.stderr
    assert "1 labels or images could not be read and are excluded" in done.stderr


def test_hit_uav_has_nothing_that_is_rejected(real_data: Path) -> None:
    dataset = api.read_dataset(real_data / "hit-uav")
    assert [rejected_in(dataset, split) for split in SPLITS] == [[], [], []]


def test_two_labelled_classes_that_match_one_class_of_the_detector(tmp_path: Path) -> None:
    base = made_up_dataset()
    called = {"Person": "pedestrian", "Car": "people"}

    def renamed(there: set[str]) -> Dataset:
        images = []
        for image in base.images:
            named = [replace(i, category=called.get(i.category, i.category)) for i in image.instances]
            images.append(replace(image, instances=tuple(i for i in named if i.category in there)))
        categories = tuple(replace(c, name=called.get(c.name, c.name)) for c in base.categories)
        return replace(base, images=tuple(images), categories=categories)

    saved = write_predictions(tmp_path / "p.json", found_on(base, classes=("Person",)))
    both = renamed({"pedestrian", "people"})
    for classes in (None, ["pedestrian", "people"], ["person"]):
        with pytest.raises(DatasetError, match=r"pedestrian and people .* --rename people=pedestrian.* --classes"):
            run(saved, tmp_path / "out", both, classes=classes)
    assert not (tmp_path / "out").exists()
    one = run(saved, tmp_path / "out", both, classes=["pedestrian"]).metrics["classes"]["pedestrian"]
    assert one["map50"] > 0.5
    # Without people in the images nothing is taken from pedestrians.
    report = run(saved, tmp_path / "out", renamed({"pedestrian"}), overwrite=True)
    assert report.metrics["classes"]["pedestrian"] == one
    assert "people" not in report.metrics["classes"]
    assert any("people: has no objects" in p.found for p in report.problems)


def test_detections_in_crowds_are_not_counted(tmp_path: Path) -> None:
    dataset = made_up_dataset(4)
    # The most confident detection is false; then a crowd is added around it, which makes it ignored.
    first = replace(dataset.images[0], instances=(Instance("Person", np.array([100.0, 100, 120, 140])),))
    dataset = replace(dataset, images=(first, *dataset.images[1:]))
    found = found_on(dataset)
    key = f"test/{first.name}"
    here = detections([[300, 300, 310, 320], [100, 100, 120, 140]], [0.99, 0.98], [0, 0])
    saved = write_predictions(tmp_path / "p.json", replace(found, images={**found.images, key: here}))
    before = run(saved, tmp_path / "a", dataset)
    region = Instance("Person", np.array([290.0, 290, 400, 400]), extra={"iscrowd": 1})
    crowded = replace(dataset, images=(replace(first, instances=(*first.instances, region)), *dataset.images[1:]))
    after = run(saved, tmp_path / "b", crowded)
    was, now = (r.metrics["classes"]["Person"] for r in (before, after))
    assert now["instances"] == was["instances"]
    assert now["map50"] > was["map50"]
    assert after.metrics["counts"]["crowds"] == 1
    assert any("1 crowds" in p.found for p in after.problems)
    without = run(saved, tmp_path / "c", crowded, ignore_regions=False)
    assert without.metrics["classes"]["Person"]["map50"] == was["map50"]
    assert without.metrics["counts"]["crowds_left_out"] == 1
    assert "crowds" not in before.metrics["counts"]
    assert before.metrics["dataset"]["labels_sha256"] != after.metrics["dataset"]["labels_sha256"]


def test_two_detectors_on_the_same_images(saved: Path, tmp_path: Path) -> None:
    worse = write_predictions(tmp_path / "worse.json", found_on(made_up_dataset(), noise_px=4, seed=1))
    run(worse, tmp_path / "worse")
    report = run(saved, tmp_path / "better", against=tmp_path / "worse")
    pair = report.metrics["paired"]
    assert pair["against"]["name"] == "worse"
    gain = pair["classes"]["Person"]["map50_95"]
    assert gain["difference"] == pytest.approx(gain["ours"] - gain["theirs"])
    assert gain["ci"][0] > 0
    assert gain["same_sign"] == 1
    assert pair["classes"]["OtherVehicle"]["map50"] is None
    compared = api.compare_evaluations(tmp_path / "better", tmp_path / "worse", bootstrap=50)
    assert compared.to_json() == pair
    only = api.compare_evaluations(tmp_path / "worse", tmp_path / "better", classes=["car"], bootstrap=50)
    assert set(only.classes) == {"all", "Car"}
    assert only.classes["Car"]["map50"]["difference"] == -pair["classes"]["Car"]["map50"]["difference"]
    assert "Against worse" in (tmp_path / "better" / "evaluation.html").read_text()
    run(saved, tmp_path / "itself", against=tmp_path / "better")
    page = (tmp_path / "itself" / "evaluation.html").read_text()
    assert "<td>+0.000</td><td>+0.000 to +0.000</td><td>-</td>" in page  # no difference has no sign


def test_other_images_or_labels_are_not_compared(saved: Path, tmp_path: Path) -> None:
    run(saved, tmp_path / "a")
    dataset = made_up_dataset()
    first = dataset.images[0]
    moved = replace(
        first, instances=(replace(first.instances[0], box_xyxy=first.instances[0].box_xyxy + 1), *first.instances[1:])
    )
    for name, other, settings in (
        ("labels", replace(dataset, images=(moved, *dataset.images[1:])), {}),
        ("images", replace(dataset, images=dataset.images[1:]), {}),
        ("ignored regions", dataset, {"ignore_regions": False}),
        ("group: image; expected gap", dataset, {"group": "gap"}),
    ):
        with pytest.raises(DatasetError, match=name):
            run(saved, tmp_path / "b", other, against=tmp_path / "a", **settings)
        assert not (tmp_path / "b").exists()
    with pytest.raises(DatasetError, match="not a finished evaluation"):
        run(saved, tmp_path / "b", against=tmp_path)
    for name, settings in (("group", {"group": "gap"}), ("ignored regions", {"ignore_regions": False})):
        run(saved, tmp_path / name, **settings)
        with pytest.raises(DatasetError, match=f"{name}: "):
            api.compare_evaluations(tmp_path / "a", tmp_path / name)
    val = replace(dataset, images=tuple(replace(i, split="val") for i in dataset.images))
    run(write_predictions(tmp_path / "val.json", found_on(val)), tmp_path / "val", val, split="val")
    with pytest.raises(DatasetError, match=r"split: val; expected test\. Give both the same --split"):
        api.compare_evaluations(tmp_path / "a", tmp_path / "val")
    (tmp_path / "a" / "matches.npz").write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(DatasetError, match="cannot be read"):
        run(saved, tmp_path / "b", against=tmp_path / "a")


def test_a_folder_can_be_given_instead_of_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Path] = []

    def load(path: Path, device: str) -> Any:
        asked.append(path)
        raise ModelError("asked", [Problem(str(path), "weights", "asked for")])

    from infrablend.detection import predict

    monkeypatch.setattr(predict, "load_detector", load)
    training = tmp_path / "training"
    training.mkdir()
    with pytest.raises(
        ModelError, match=r"with neither predictions\.json nor weights\.pt.*of a finished `infrablend train`"
    ):
        run(training, tmp_path / "out")
    with pytest.raises(RuntimeError), workspace(tmp_path / "later", "training", "train.json", keep=True) as space:
        (space.folder / "checkpoint.pt").touch()
        raise RuntimeError
    with pytest.raises(ModelError, match=r"an unfinished training is in .*\.later\.partial"):
        run(tmp_path / "later", tmp_path / "out")
    assert not asked
    (training / "weights.pt").write_bytes(b"")
    with pytest.raises(ModelError, match="asked for"):
        run(training, tmp_path / "out")
    assert asked == [training / "weights.pt"]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("name", "says"), [("README.md", "a .md file"), ("weights", "a file without .pt")])
def test_files_of_other_types_are_refused_as_weights(
    name: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from infrablend.detection import predict

    monkeypatch.setattr(predict, "require_ultralytics", lambda: None)
    monkeypatch.setattr(predict, "pick_device", lambda wanted: "cpu")
    (tmp_path / name).write_text("# Words")
    with pytest.raises(ModelError) as raised:
        run(tmp_path / name, tmp_path / "out")
    message = str(raised.value)
    assert f"{says}; expected a .pt file" in message
    assert "weights.pt of a finished `infrablend train`" in message
    assert "Error" not in message


def test_detections_without_any_match_give_a_warning(saved: Path, tmp_path: Path) -> None:
    dataset = made_up_dataset()
    nothing = {f"test/{i.name}": detections([[0, 0, 3, 3]], [0.5], [0]) for i in dataset.images}
    away = write_predictions(tmp_path / "away.json", replace(found_on(dataset), images=nothing))
    report = run(away, tmp_path / "a")
    (warning,) = [p for p in report.problems if p.code == "no-hits"]
    assert warning.severity == "warning"
    assert "40 detections, hardly any on an object: mAP50 is below 0.001 in every class" in warning.found
    assert warning.found in (tmp_path / "a" / "evaluation.html").read_text()
    assert "no-hits" not in {p.code for p in run(saved, tmp_path / "b").problems}


def coco_results(dataset: Dataset, saved: Path) -> tuple[Dataset, list[dict[str, Any]]]:
    """Return the dataset with ids of COCO, and saved detections as COCO's list of results."""
    top = json.loads(saved.read_text())
    number = {i["id"]: i["file_name"] for i in top["images"]}
    images = tuple(replace(i, source_id=2**60 + k) for k, i in enumerate(dataset.images))
    of_image = {f"{i.split}/{i.name}": i.source_id for i in images}
    of_class = {k: next(c.id for c in CATEGORIES if c.name == name) for k, name in enumerate(CLASSES, 1)}
    rows = [
        {**a, "image_id": of_image[number[a["image_id"]]], "category_id": of_class[a["category_id"]]}
        for a in top["annotations"]
    ]
    return replace(dataset, images=images), rows


def test_a_list_of_results_refers_to_the_ids_of_the_dataset(saved: Path, tmp_path: Path) -> None:
    """As pycocotools' `loadRes` takes it: github.com/cocodataset/cocoapi/blob/master/PythonAPI/pycocotools/coco.py."""
    dataset, rows = coco_results(made_up_dataset(), saved)
    path = tmp_path / "results.json"
    path.write_text(json.dumps(rows))
    expected = run(saved, tmp_path / "a").metrics
    metrics = run(path, tmp_path / "b", dataset).metrics
    assert metrics["classes"] == expected["classes"] and metrics["counts"]["detections"] == len(rows)
    run(tmp_path / "b", tmp_path / "c", dataset)  # what it wrote says all itself
    with pytest.raises(DatasetError, match="refers to ids that the dataset does not have"):
        run(path, tmp_path / "d")
    path.write_text(json.dumps([*rows, rows[0] | {"image_id": 2**60 + 99.0}]))
    with pytest.raises(DatasetError, match="which no image has"):
        run(path, tmp_path / "d", dataset)


def test_masks_of_a_list_of_results_need_no_box(tmp_path: Path) -> None:
    mask = np.zeros((512, 640), np.bool_)
    mask[10:30, 20:60] = True
    person = Instance("Person", np.array([20.0, 10, 60, 30]), mask=Mask.from_array(mask))
    image = ImageRecord("a", Path("a.png"), "test", (640, 512), (person,), source_id="a1b2")
    row = {"image_id": "a1b2", "category_id": 0, "segmentation": Mask.from_array(mask).to_coco(), "score": 0.9}
    (path := tmp_path / "results.json").write_text(json.dumps([row]))
    report = run(path, tmp_path / "out", Dataset(Path("made-up"), "coco", CATEGORIES, (image,)), classes=["Person"])
    assert report.metrics["task"] == "segment" and report.metrics["classes"]["Person"]["map50"] > 0.999


def test_a_dataset_without_labels_has_no_classes_to_name(saved: Path, tmp_path: Path) -> None:
    images = tuple(replace(i, instances=()) for i in made_up_dataset().images)
    with pytest.raises(DatasetError) as caught:
        run(saved, tmp_path / "out", Dataset(Path("bare"), "folder", (), images), classes=["Person"])
    said = next(str(p) for p in caught.value.problems if p.code == "class-unknown")
    assert "which have none" in said and "Give a dataset with labels" in said


def test_classes_that_the_detector_lacks(tmp_path: Path) -> None:
    dataset = made_up_dataset()
    saved = write_predictions(tmp_path / "p.json", found_on(dataset, classes=("person", "drone")))
    with pytest.raises(DatasetError, match=r"no class Car.*--classes Person"):
        run(saved, tmp_path / "out", dataset)
    with pytest.raises(DatasetError, match="'Lorry'"):
        run(saved, tmp_path / "out", dataset, classes=["Lorry", "Person"])
    report = run(saved, tmp_path / "out", dataset, classes=["Person"])
    assert list(report.metrics["classes"]) == ["all", "Person"]
    message = "\n".join(str(p) for p in report.problems)
    assert "drone: detections of this class are left out" in message
    assert "Car, OtherVehicle: not evaluated" in message


def test_all_problems_are_reported_at_once(tmp_path: Path) -> None:
    other = made_up_dataset(3, "train")
    saved = write_predictions(tmp_path / "p.json", found_on(other, classes=("Person",)))
    with pytest.raises(DatasetError) as caught:
        run(saved, tmp_path / "out", task="obb", group="date")
    assert {p.code for p in caught.value.problems} >= {"class-absent", "prediction-images", "task", "group-unknown"}
    assert "no entry for 40 of 40 images" in str(caught.value)


def test_splits_without_images_or_objects(saved: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"split val: no images \(test 40\)"):
        run(saved, tmp_path / "out", split="val")
    dataset = made_up_dataset()
    bare = replace(dataset, images=tuple(replace(i, instances=()) for i in dataset.images))
    with pytest.raises(DatasetError, match="no object of Person, Car, OtherVehicle"):
        run(saved, tmp_path / "out", bare)
    for wrong in ({"split": "all"}, {"group": "flight"}, {"bootstrap": -1}):
        with pytest.raises(DatasetError, match=next(iter(wrong))):
            run(saved, tmp_path / "out", **wrong)


def test_without_a_test_split_the_only_other_one_is_evaluated_and_named(tmp_path: Path) -> None:
    dataset = made_up_dataset(20, "val")
    saved = write_predictions(tmp_path / "p.json", found_on(dataset))
    report = run(saved, tmp_path / "out", dataset)
    assert report.metrics["dataset"]["split"] == "val"
    (warning,) = [p for p in report.problems if p.code == "split-only"]
    assert "no split test: evaluated on val, the only split" in str(warning) and warning.severity == "warning"
    assert "split-only" not in {p.code for p in run(saved, tmp_path / "named", dataset, split="val").problems}
    both = replace(dataset, images=(*dataset.images, replace(dataset.images[0], split="train")))
    (warning,) = [p for p in run(saved, tmp_path / "both", both).problems if p.code == "split-only"]
    assert "evaluated on val, the only other split" in str(warning)
    # Asked for, or lost to errors of the reader, it is missed.
    with pytest.raises(DatasetError, match=r"split test: no images \(val 20\)"):
        run(saved, tmp_path / "asked", dataset, split="test")
    broken = replace(dataset, problems=(Problem("test/a.txt", "label-line", "no number"),))
    with pytest.raises(DatasetError, match="split test: no images"):
        run(saved, tmp_path / "other", broken)


def test_other_sizes_and_too_many_detections(tmp_path: Path) -> None:
    dataset = made_up_dataset(2)
    found = found_on(dataset)
    key = next(iter(found.images))
    wrong = replace(found, sizes_wh={**found.sizes_wh, key: (320, 256)})
    with pytest.raises(DatasetError, match="320x256 px; expected 640x512 px"):
        run(write_predictions(tmp_path / "p.json", wrong), tmp_path / "out", dataset)
    boxes = np.tile([300.0, 300, 310, 310], (400, 1))
    many = replace(found, images={**found.images, key: detections(boxes, np.linspace(0, 1, 400), np.zeros(400))})
    report = run(write_predictions(tmp_path / "p.json", many), tmp_path / "out", dataset)
    assert "more than 300 detections in 1 images" in "\n".join(str(p) for p in report.problems)
    assert report.metrics["counts"]["detections"] == 300 + len(found.images[list(found.images)[1]])


def test_folders_with_foreign_content_are_left_alone(saved: Path, tmp_path: Path) -> None:
    run(saved, tmp_path / "out")
    with pytest.raises(OutputError, match="--overwrite"):
        run(saved, tmp_path / "out")
    (tmp_path / "out" / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"notes\.txt"):
        run(saved, tmp_path / "out", overwrite=True)
    assert (tmp_path / "out" / "evaluation.json").exists()
    with pytest.raises(OutputError, match="is a file"):
        run(saved, saved)


def test_weights_without_ultralytics(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    (tmp_path / "w.pt").write_bytes(b"")
    with pytest.raises(MissingDependencyError, match=r'pip install "infrablend\[train\]"'):
        run(tmp_path / "w.pt", tmp_path / "out")


def test_the_command(tmp_path: Path, write_tiny_hit_uav) -> None:
    data = write_tiny_hit_uav(tmp_path / "data")
    arguments = evaluation_command(data, tmp_path, 20)
    done = CliRunner().invoke(build_app(), arguments)
    assert done.exit_code == 0, done.output
    row = next(line.split() for line in done.stdout.splitlines() if line.startswith("OtherVehicle"))
    assert row[1:3] == ["1", "1"]
    assert row[5] == "1.000"
    assert "All classes as one: AP50 1.000" in done.stdout
    assert "Objects found by any class (IoU at least 0.1" in done.stdout
    again = CliRunner().invoke(build_app(), arguments)
    assert again.exit_code == 2
    assert "--overwrite" in again.stderr
    as_json = CliRunner().invoke(build_app(), [*arguments, "--overwrite", "--json"])
    assert json.loads(as_json.stdout)["classes"]["OtherVehicle"]["map50"] == pytest.approx(1)
    shutil.rmtree(tmp_path / "out")
    missing = CliRunner().invoke(
        build_app(), ["-q", "evaluate", str(tmp_path / "no.json"), str(data), "--out", str(tmp_path / "out")]
    )
    assert missing.exit_code == 2
    assert "cannot be read: No such file" in missing.stderr
    assert not (tmp_path / "out").exists()


def test_the_size_that_pictures_had_is_reported(tmp_path: Path) -> None:
    found = found_on(made_up_dataset())
    facts = {"weights": "w.pt", "image_size": 0, "image_size_from": "trained on tiles of 320 px at native resolution"}
    saved = write_predictions(tmp_path / "found.json", replace(found, facts=facts))
    report = run(saved, tmp_path / "out", image_size=640)
    assert report.metrics["detector"]["image_size"] == 0
    assert "--image-size 640 has no effect" in str([p for p in report.problems if p.code == "image-size-unused"])
    assert "trained on tiles of 320 px" in (tmp_path / "out" / "evaluation.html").read_text()
    assert "image-size-unused" not in {p.code for p in run(saved, tmp_path / "b", image_size=0).problems}
