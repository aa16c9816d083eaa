"""The pipeline with the flat renderer, on a small dataset in HIT-UAV's layout."""

import dataclasses
import itertools
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.config.loading import load_recipe
from infrablend.core.dataset import SEEN_BOX, SEEN_OBB
from infrablend.core.frame_row import FrameRow
from infrablend.core.run_record import DrawStatistics
from infrablend.core.scene import Sun, View, Weather
from infrablend.core.tasks import Progress
from infrablend.core.workspace import partial_of
from infrablend.errors import DatasetError, Interrupted, MissingDependencyError, OutputError, Problem, RecipeError
from infrablend.pipeline.plans.planning import make_plan
from infrablend.report.run_warnings import absent_warnings, few_inserted, limit_warnings
from tests.run_files import edit_ledger, hashes, records

NAMES = ["0_60_50_0_00001", "1_80_90_0_00002", "1_100_30_0_00003", "0_130_70_0_00004"]
SPLIT = {"train": NAMES[:2], "val": NAMES[2:3], "test": NAMES[3:]}


@pytest.fixture
def dataset(tmp_path) -> Path:
    """normal_json with four pictures, five labels, one DontCare."""
    root = tmp_path / "data" / "normal_json"
    rng, number = np.random.default_rng(7), itertools.count()
    names_of_classes = ["Person", "Car", "Bicycle", "OtherVehicle", "DontCare"]
    categories = [{"id": i, "name": n, "supercategory": n} for i, n in enumerate(names_of_classes)]
    (root / "annotations").mkdir(parents=True)
    for split, names in SPLIT.items():
        (root / split).mkdir()
        images, labels = [], []
        for k, name in enumerate(names):
            grey = np.clip(rng.normal(126, 30, (512, 640)), 16, 235).astype(np.uint8)
            Image.fromarray(grey).save(root / split / f"{name}.jpg", quality=95)
            facts = {"height": 512, "width": 640, "date_captured": "20210116"}
            images.append({"filename": f"{name}.jpg", "id": k, **facts})
            for category, x, y in ((0, 40, 50), (4, 300, 300)):
                outline = [[x, y, x + 10, y, x + 10, y + 12, x, y + 12]]
                shape = {"segmentation": outline, "area": 120, "bbox": [x, y, 10, 12]}
                labels.append({"id": next(number), "image_id": k, "category_id": category, **shape})
        top = {"info": {}, "licenses": [], "images": images, "annotation": labels, "categories": categories}
        (root / "annotations" / f"{split}.json").write_text(json.dumps(top))
    return root.parent


def generate(data, out, **kwargs):
    options = {"execution": api.Execution(renderer="flat", in_process=True), "settings": ["output.image=png"]}
    return api.generate("hit-uav-drone", data, out, **{**options, **kwargs})


def coco_of(run: Path, split: str = "train") -> dict:
    return json.loads((run / "coco" / f"{split}.json").read_text())


def test_run_end_to_end(dataset, tmp_path):
    seen: list[Progress] = []
    report = generate(dataset, tmp_path / "run", on_progress=seen.append)
    assert report.ok
    assert (report.counts["frames"], report.counts["labels_inserted"]) == (8, {"drone": 8})
    assert [p.done for p in seen] == list(range(1, 9))
    run = tmp_path / "run"
    for split, names in SPLIT.items():
        for name in names:
            for k in range(2):
                stem = f"{name}_c{k}"
                assert (run / "images" / split / f"{stem}.png").is_file()
                label = run / "yolo" / "labels" / split / f"{stem}.txt"
                classes = [line.split()[0] for line in label.read_text().splitlines()]
                assert classes == ["0", "4"]  # Person, drone; DontCare is left out
                image = run / "yolo" / "images" / split / f"{stem}.png"
                assert image.samefile(run / "images" / split / f"{stem}.png")
    coco = coco_of(run)
    assert [c["id"] for c in coco["categories"]] == [0, 1, 2, 3, 4, 5]
    assert sum(a["category_id"] == 5 for a in coco["annotations"]) == 4
    assert all(a["iscrowd"] == 1 for a in coco["annotations"] if a["category_id"] == 4)
    native = api.read_dataset(run / "native")
    assert len(native.images) == 8
    assert {c.name: c.id for c in native.categories}["drone"] == 5
    assert {i.capture.pitch_deg for i in native.images} == {50, 90, 30, 70}


def test_labels_describe_the_pixels(dataset, tmp_path):
    """Every changed pixel is within reach of an object; every mask pixel that must change has changed."""
    generate(dataset, tmp_path / "run", settings={"output.image": "png", "overlay.softness_px": 0.0})
    changed_in_masks = 0
    for record in records(tmp_path / "run"):
        before = np.array(Image.open(dataset / "normal_json" / record.background["path"].partition("/")[2]))
        after = np.array(Image.open(tmp_path / "run" / "images" / record.image))
        changed = before != after
        (instance,) = record.inserted
        x0, y0, x1, y1 = instance.box_xyxy
        rows, columns = np.nonzero(changed)
        assert columns.min() >= np.floor(x0)
        assert rows.min() >= np.floor(y0)
        assert columns.max() < np.ceil(x1)
        assert rows.max() < np.ceil(y1)
        mask = instance.mask.to_array()
        rows, columns = np.nonzero(mask)
        assert columns.min() + 1 >= x0
        assert columns.max() <= x1
        changed_in_masks += (changed & mask).sum() / mask.sum()
    assert changed_in_masks / 8 > 0.9


def test_same_seed_gives_same_bytes_and_another_seed_others(dataset, tmp_path):
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        generate(dataset, tmp_path / name, seed=seed)
    a, b, c = (hashes(tmp_path / n) for n in "abc")
    assert a == b
    images = [k for k in a if k.startswith("images/") and k.endswith(".png")]
    assert len(images) == 8
    assert all(a[k] != c[k] for k in images)


@pytest.mark.slow
def test_worker_count_does_not_matter(dataset, tmp_path):
    generate(dataset, tmp_path / "a")
    for workers in (1, 2):
        out = tmp_path / f"w{workers}"
        generate(dataset, out, execution=api.Execution(workers, renderer="flat"))
        assert hashes(out) == hashes(tmp_path / "a")


def test_interrupted_and_resumed_gives_the_same_bytes(dataset, tmp_path, monkeypatch):
    generate(dataset, tmp_path / "whole")
    run = tmp_path / "part"

    def stop_after_three(progress: Progress) -> None:
        if progress.done == 3:
            raise Interrupted("stop")

    with pytest.raises(Interrupted, match="--resume"):
        generate(dataset, run, on_progress=stop_after_three)
    assert not run.exists()
    made = times(partial_of(run))
    assert 3 <= len(made) < 8
    report = generate(dataset, run, existing="resume")
    assert report.counts["frames"] == 8
    assert made.items() <= times(run).items()  # not made again
    assert hashes(run) == hashes(tmp_path / "whole")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["data", "part", "whole"]


def times(run: Path) -> dict[str, int]:
    """Return when each picture was made, by its name."""
    return {p.name: p.stat().st_mtime_ns for p in (run / "images").rglob("*.png")}


def test_resume_mends_damaged_frames(dataset, tmp_path):
    run = tmp_path / "run"
    generate(dataset, run)
    whole = hashes(run)
    images = sorted((run / "images").rglob("*.png"))
    # Unlink first: the images are hard-linked into the formats' folders.
    data = images[0].read_bytes()
    images[0].unlink()
    images[0].write_bytes(data[: len(data) // 2])
    images[1].unlink()
    edit_ledger(run, "DELETE FROM frames WHERE frame_id = ?", f"val/{NAMES[2]}_c0")
    before = times(run)
    generate(dataset, run, existing="resume")
    assert hashes(run) == whole
    assert len(before.items() & times(run).items()) == 5  # the others were not made again


@pytest.mark.parametrize("name", ["coco/train.json", "yolo/data.yaml", "README.md", "report.html"])
def test_resume_writes_a_missing_file_again_and_makes_no_frame(dataset, tmp_path, name):
    run = tmp_path / "run"
    generate(dataset, run)
    whole, before = hashes(run), times(run)
    (run / name).unlink()
    generate(dataset, run, existing="resume")
    assert hashes(run) == whole
    assert times(run) == before
    stamp = (run / "run.json").stat().st_mtime_ns
    generate(dataset, run, existing="resume")
    assert (run / "run.json").stat().st_mtime_ns == stamp, "nothing was to do"


def test_resume_refuses_another_run_and_lists_differences(dataset, tmp_path):
    generate(dataset, tmp_path / "run")
    with pytest.raises(OutputError, match=r"recipe\.camera\.distance_m was \[1\.0, 10\.0\], is \[2\.0, 3\.0\]"):
        generate(
            dataset, tmp_path / "run", existing="resume", settings=["output.image=png", "camera.distance_m=[2, 3]"]
        )
    with pytest.raises(OutputError, match="seed was 0, is 5"):
        generate(dataset, tmp_path / "run", existing="resume", seed=5)


def test_resume_names_options_and_not_digests(dataset, tmp_path):
    from infrablend.pipeline.runs.begun_run import differences

    key = {"backgrounds": "01ab", "seed": 0, "frames": [f"test/{k}_c0" for k in range(6)]}
    asked = {"reading": {"splits": ("test",)}, "selection": {"limit": 6}}
    now = {"reading": {"splits": ("test",)}, "selection": {"limit": 5}}
    changed = {**key, "backgrounds": "02cd", "frames": key["frames"][:5]}
    shown = "(test/0_c0, test/1_c0, test/2_c0, ...)"
    assert differences(key, changed, asked, now) == ["limit was 6, is 5", f"frames was 6 {shown}, is 5 {shown}"]
    changed = {**key, "backgrounds": "02cd"}
    assert differences(key, changed, asked, asked) == ["the backgrounds, their labels or their metadata have changed"]
    assert differences(key, {**changed, "backgrounds": "01ab"}) == []


def test_output_folder_rules(dataset, tmp_path):
    out = tmp_path / "full"
    out.mkdir()
    (out / "precious.txt").write_text("mine")
    for options in ({}, {"existing": "overwrite"}, {"existing": "resume"}):
        with pytest.raises(OutputError):
            generate(dataset, out, **options)
    assert [p.name for p in out.iterdir()] == ["precious.txt"]
    generate(dataset, tmp_path / "run", limit=1)
    (tmp_path / "run" / "mine.txt").write_text("mine")
    with pytest.raises(OutputError, match="--resume"):
        generate(dataset, tmp_path / "run", limit=1)
    with pytest.raises(OutputError, match=r"not part of the run \(mine\.txt\); nothing was touched"):
        generate(dataset, tmp_path / "run", limit=2, existing="overwrite")
    (tmp_path / "run" / "mine.txt").unlink()
    generate(dataset, tmp_path / "run", limit=2, existing="overwrite")
    assert len(list((tmp_path / "run" / "images").rglob("*.png"))) == 4
    with pytest.raises(OutputError, match="refuse, resume or overwrite"):
        generate(dataset, tmp_path / "run", existing="both")
    with pytest.raises(OutputError, match="contains the data"):
        generate(dataset, dataset.parent)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_unwritable_output(dataset, tmp_path):
    (tmp_path / "locked").mkdir(mode=0o500)
    with pytest.raises(OutputError, match="cannot be written"):
        generate(dataset, tmp_path / "locked" / "run")


def test_unreadable_background_is_skipped_named_and_counted(dataset, tmp_path):
    path = dataset / "normal_json" / "train" / f"{NAMES[0]}.jpg"
    path.write_bytes(path.read_bytes()[:3000])
    report = generate(dataset, tmp_path / "run")
    assert not report.ok
    assert report.counts["skipped_backgrounds"] == 1
    assert report.counts["frames"] == 6
    assert any(NAMES[0] in str(p) for p in report.problems)
    labels = sorted(p.stem for p in (tmp_path / "run" / "yolo" / "labels").rglob("*.txt"))
    assert len(labels) == 6
    assert not any(n.startswith(NAMES[0]) for n in labels)
    # Once mended, resume makes what is missing.
    report = generate(dataset, tmp_path / "run", existing="resume")
    assert report.counts["frames"] == 6


def test_a_full_disk_stops_the_run_and_keeps_what_is_finished(dataset, tmp_path, monkeypatch):
    from infrablend.pipeline.compose import frame_worker

    real, calls = frame_worker.write_bytes, []

    def full_after_two(path, data):
        calls.append(path)
        if len(calls) > 2:
            raise OutputError(f"cannot write {path}: No space left on device")
        return real(path, data)

    monkeypatch.setattr(frame_worker, "write_bytes", full_after_two)
    with pytest.raises(OutputError, match="No space left"):
        generate(dataset, tmp_path / "run")
    assert len(list((partial_of(tmp_path / "run") / "images").rglob("*.png"))) == 2
    monkeypatch.undo()
    assert generate(dataset, tmp_path / "run", existing="resume").counts["frames"] == 8


def test_original_labels_are_kept_or_listed(dataset, tmp_path):
    """A drone that fills the frame covers every original object: each removal is listed, none is lost."""
    settings = {
        "output.image": "png",
        "configurations": 1,
        "objects.0.scale": 40,
        "objects.0.x_m": 0,
        "objects.0.y_m": 0,
        "camera.distance_m": 30,
        "placement.min_inside": 0.0,
        "objects.0.options.body": "shell",
    }
    report = generate(dataset, tmp_path / "run", settings=settings)
    run = json.loads((tmp_path / "run" / "run.json").read_text())
    before = sum(len(i.instances) for i in api.read_dataset(dataset).images)
    after = sum(n for c, n in report.counts["labels"].items() if c != "drone")
    assert after + len(run["removed"]) == before
    assert all(r["covered_share"] >= 0.99 for r in run["removed"])


def test_boxes_of_inserted_objects_are_written_as_loose_as_the_recipe_says(dataset, tmp_path):
    settings = {"output.image": "png", "output.formats": ["coco", "yolo", "native"]}
    tight = generate(dataset, tmp_path / "tight", settings=settings)
    loose = generate(dataset, tmp_path / "loose", settings={**settings, "labels.loosen": {"drone": 1.3}})
    assert "boxes_loosened" not in tight.counts
    assert (loose.counts["boxes_loosened"], loose.counts["loosened_by"]) == (8, {"drone": 1.3})
    assert (
        "boxes of 8 inserted objects were enlarged by the factors drone 1.3"
        in (tmp_path / "loose" / "README.md").read_text()
    )
    for before, after in zip(records(tmp_path / "tight"), records(tmp_path / "loose"), strict=True):
        assert before.image_sha256 == after.image_sha256
        np.testing.assert_array_equal(before.inserted[0].box_xyxy, after.inserted[0].box_xyxy)

    for a, b in zip(
        coco_of(tmp_path / "tight")["annotations"], coco_of(tmp_path / "loose")["annotations"], strict=True
    ):
        changes = {k: b[k] for k in b if a.get(k) != b[k]}
        assert not changes or b["inserted"]
        if b["inserted"]:
            assert set(changes) == {"bbox", "obb", "tight_bbox", "tight_obb"}
            assert (b["tight_bbox"], b["tight_obb"]) == (a["bbox"], a["obb"])
            (x, y, w, h), (lx, ly, lw, lh) = a["bbox"], b["bbox"]
            assert lw <= 1.3 * w + 1e-6 and lh <= 1.3 * h + 1e-6 and min(lx, ly) >= 0
            assert lx <= x and ly <= y and x + w <= lx + lw + 1e-6 and y + h <= ly + lh + 1e-6
    for run, by in (("tight", 1.0), ("loose", 1.3)):
        text = (tmp_path / run / "yolo" / "labels" / "train" / f"{SPLIT['train'][0]}_c0.txt").read_text()
        box = next(a for a in coco_of(tmp_path / run)["annotations"] if a["inserted"])
        assert f" {box['bbox'][2] / 640:.4f}"[:6] in text, by
    for labels in ("coco", "native", ""):
        with pytest.raises(DatasetError, match="8 boxes that are enlarged or fitted already"):
            api.convert(tmp_path / "loose" / labels, tmp_path / "twice", "coco", loosen=1.1)
    with pytest.raises(RecipeError, match="found Drone; expected classes of the inserted objects") as caught:
        wrong = {"labels.loosen": {"Drone": 1.3}, "labels.loosen_px": {"Drone": 2}}
        generate(dataset, tmp_path / "unknown", settings=wrong)
    assert [p.where for p in caught.value.problems] == ["labels.loosen", "labels.loosen_px"]


def test_boxes_of_inserted_objects_are_drawn_around_what_is_visible(dataset, tmp_path):
    settings = {"output.image": "png", "output.formats": ["coco", "yolo", "native"]}
    generate(dataset, tmp_path / "shape", settings=settings)
    fitted = generate(dataset, tmp_path / "visible", settings={**settings, "labels.fit": "visible"})
    assert fitted.counts["boxes_fit"] == "visible" and "loosened_by" not in fitted.counts
    assert 0 < fitted.counts["boxes_loosened"] <= 8
    card = (tmp_path / "visible" / "README.md").read_text()
    assert "inserted objects were drawn around what is visible, to match" in card
    smaller = 0
    for before, after in zip(records(tmp_path / "shape"), records(tmp_path / "visible"), strict=True):
        assert before.image_sha256 == after.image_sha256
        for shape, seen in zip(before.inserted, after.inserted, strict=True):
            np.testing.assert_array_equal(shape.box_xyxy, seen.box_xyxy)
            assert set(seen.extra) - set(shape.extra) <= {SEEN_BOX, SEEN_OBB}

    for a, b in zip(
        coco_of(tmp_path / "shape")["annotations"], coco_of(tmp_path / "visible")["annotations"], strict=True
    ):
        assert b.get("tight_bbox", b["bbox"]) == a["bbox"] and b.get("segmentation") == a.get("segmentation")
        (x, y, w, h), (sx, sy, sw, sh) = a["bbox"], b["bbox"]
        assert sx >= x - 1e-6 and sy >= y - 1e-6 and sx + sw <= x + w + 1e-6 and sy + sh <= y + h + 1e-6
        smaller += sw * sh < 0.999 * w * h
    assert smaller
    with pytest.raises(DatasetError, match="boxes that are enlarged or fitted already"):
        api.convert(tmp_path / "visible" / "coco", tmp_path / "twice", "coco", loosen=1.1)


def test_objects_of_an_earlier_run_keep_their_boxes(dataset, tmp_path):
    settings = {"output.image": "png", "output.formats": ["coco"], "labels.loosen": 1.2, "configurations": 1}
    generate(dataset, tmp_path / "first", settings=settings)
    again = generate(tmp_path / "first" / "coco", tmp_path / "again", settings=settings)

    def inserted(run):
        return [(a["bbox"], a["tight_bbox"]) for a in coco_of(tmp_path / run)["annotations"] if a["inserted"]]

    first, both = inserted("first"), inserted("again")
    assert 0 < again.counts["boxes_loosened"] == again.counts["objects_inserted"]
    assert all(box in both for box in first)


def test_fitted_boxes_are_the_same_in_all_formats_and_layouts(dataset, tmp_path):
    pytest.importorskip("pyarrow.parquet")
    settings = {"output.image": "png", "labels.fit": "visible", "labels.loosen": 1.2}
    files = generate(dataset, tmp_path / "files", settings={**settings, "output.formats": ["coco", "yolo", "yolo-obb"]})
    packed = generate(dataset, tmp_path / "packed", settings={**settings, "output.layout": "shards"})
    loosened = {k: v for k, v in files.counts.items() if k.startswith("boxes_") or k == "loosened_by"}
    assert loosened == {"boxes_loosened": 8, "boxes_fit": "visible", "loosened_by": 1.2}
    assert loosened.items() <= packed.counts.items()

    def inserted(folder):
        return {
            i.path.stem: next(o for o in i.instances if o.category == "drone")
            for i in api.read_dataset(folder).images
            if any(o.category == "drone" for o in i.instances)
        }

    coco = inserted(tmp_path / "files" / "coco")
    assert sum(SEEN_BOX in o.extra for o in coco.values()) > 0
    for folder in (tmp_path / "files" / "yolo", tmp_path / "files" / "yolo-obb", tmp_path / "packed"):
        found = inserted(folder)
        assert found.keys() == coco.keys()
        for name, one in found.items():
            if folder.name != "yolo-obb":  # whose boxes are around the oriented ones
                np.testing.assert_allclose(one.box_xyxy, coco[name].box_xyxy, atol=0.01)
            if folder.name != "yolo":
                np.testing.assert_allclose(one.corners_xy, coco[name].corners_xy, atol=0.01)


def test_boxes_of_inserted_objects_are_enlarged_by_pixels_in_all_formats(dataset, tmp_path):
    settings = {"output.image": "png", "output.formats": ["coco", "yolo", "yolo-obb"], "configurations": 1}
    generate(dataset, tmp_path / "tight", settings=settings)
    loose = generate(dataset, tmp_path / "loose", settings={**settings, "labels.loosen_px": 3.5})
    assert (loose.counts["boxes_loosened"], loose.counts["loosened_by_px"]) == (4, 3.5)
    assert "loosened_by" not in loose.counts
    assert "enlarged by 3.5 px on each side" in (tmp_path / "loose" / "README.md").read_text()
    for form in ("coco", "yolo", "yolo-obb"):
        exact, drawn = (
            {
                (i.path.name, k): o
                for i in api.read_dataset(tmp_path / run / form).images
                for k, o in enumerate(i.instances)
            }
            for run in ("tight", "loose")
        )
        changed = 0
        for key, a in exact.items():
            b = drawn[key]
            if a.category != "drone":
                np.testing.assert_allclose(a.box_xyxy, b.box_xyxy, atol=1e-3)
                continue
            if form == "yolo-obb":
                corners = [np.asarray(i.corners_xy) for i in (a, b)]
                sides = [np.hypot(*(np.roll(c, -1, axis=0) - c).T) for c in corners]
                assert (sides[1] <= sides[0] + 7 + 0.05).all() and (sides[1] >= sides[0] - 0.05).all()
            else:
                grown = np.abs(b.box_xyxy - a.box_xyxy)
                assert (grown <= 3.5 + 1e-2).all() and grown.max() >= 3.5 - 1e-2
            changed += 1
        assert changed == 4, form


def test_label_modes_and_categories(dataset, tmp_path):
    def labels(name, **settings):
        settings = {"output.image": "png", "configurations": 1, **settings}
        return generate(dataset, tmp_path / name, settings=settings).counts["labels"]

    assert labels("merged") == {"Person": 4, "DontCare": 4, "drone": 4}
    assert labels("new", **{"labels.mode": "new"}) == {"drone": 4}
    assert labels("original", **{"labels.mode": "original"}) == {"Person": 4, "DontCare": 4}
    assert labels("some", **{"labels.keep_categories": ["DontCare"]}) == {"DontCare": 4, "drone": 4}
    assert labels("existing", **{"objects.0.category": "Person"}) == {"Person": 8, "DontCare": 4}
    coco = coco_of(tmp_path / "existing")
    assert len(coco["categories"]) == 5
    assert sorted(a["inserted"] for a in coco["annotations"] if a["category_id"] == 0) == [False, False, True, True]


def test_a_single_object_that_is_barely_visible_is_not_inserted(dataset, tmp_path):
    """`on_miss: keep` draws objects anywhere; `min_visibility` applies nevertheless, even to a single object."""
    settings = {"output.image": "png", "placement.on_miss": "keep", "camera.distance_m": 3, "configurations": 5}
    free = generate(dataset, tmp_path / "free", settings=settings)
    held = generate(dataset, tmp_path / "held", settings={**settings, "placement.min_visibility": 0.6})

    def seen(name):
        found = records(tmp_path / name)
        return [i.visibility for r in found for i in r.inserted], [r.scene.draws["absent"] for r in found]

    assert min(seen("free")[0]) < 0.6 <= min(seen("held")[0])
    absent = sum(a.get("min_visibility", 0) for a in seen("held")[1])
    assert absent == 20 - held.counts["labels_inserted"]["drone"] > 0
    assert free.counts["labels_inserted"]["drone"] >= held.counts["labels_inserted"]["drone"]


def test_labels_left_out_of_originals_are_listed_too(dataset, tmp_path):
    settings = {"output.originals": True, "configurations": 1, "labels.keep_categories": ["Person"]}
    report = generate(dataset, tmp_path / "run", settings=settings)
    before = sum(len(i.instances) for i in api.read_dataset(dataset).images)
    kept = sum(n for c, n in report.counts["labels"].items() if c != "drone")
    assert kept + sum(report.counts["labels_removed"].values()) == 2 * before


@pytest.mark.parametrize(("line", "numbers"), [("0 0.5 0.5 0.1 0.1", 5), ("0 .4 .4 .6 .4 .6 .6 .4 .6", 9)])
def test_native_of_a_folder_with_yolo_labels_is_yolo(tmp_path, line, numbers):
    """In the folder's own task: boxes stay boxes, oriented boxes stay oriented."""
    for name in ("0_60_50_0_00001", "0_60_50_0_00002"):
        folder = tmp_path / "data"
        folder.mkdir(exist_ok=True)
        Image.fromarray(np.arange(64 * 80, dtype=np.uint32).reshape(64, 80).astype(np.uint8)).save(
            folder / f"{name}.png"
        )
        (folder / f"{name}.txt").write_text(line + "\n")
    (tmp_path / "data" / "classes.txt").write_text("Person\n")
    generate(tmp_path / "data", tmp_path / "run", settings={"configurations": 1})
    native = tmp_path / "run" / "native"
    lines = (native / "labels" / "train" / "0_60_50_0_00001_c0.txt").read_text().splitlines()
    assert [len(text.split()) for text in lines] == [numbers, numbers]
    again = api.read_dataset(native)
    assert [[i.category for i in image.instances] for image in again.images] == [["Person", "drone"]] * 2


def test_originals_groups_and_same_file_type(dataset, tmp_path):
    settings = {"output.originals": True, "output.group_by": ["pitch", "altitude", "day_night"]}
    report = generate(dataset, tmp_path / "run", settings=settings)
    assert report.counts["images"] == 12
    source = dataset / "normal_json" / "train" / f"{NAMES[0]}.jpg"
    copy = tmp_path / "run" / "images" / "train" / "pitch_50" / "altitude_60" / "day" / f"{NAMES[0]}.jpg"
    assert copy.read_bytes() == source.read_bytes()
    made = copy.with_name(f"{NAMES[0]}_c0.jpg")
    with Image.open(made) as a, Image.open(source) as b:
        assert a.quantization == b.quantization
        assert a.mode == "L"
    assert len(api.read_dataset(tmp_path / "run" / "native").images) == 12


def test_limit_splits_and_plan(dataset, tmp_path):
    facts = api.plan("hit-uav-drone", dataset, reading=api.Reading(splits=["val", "test"])).to_json()
    assert (facts["frames"], facts["new_categories"]) == (4, ["drone"])
    assert generate(dataset, tmp_path / "run", reading=api.Reading(splits=["val"])).counts["images_per_split"] == {
        "val": 2
    }
    yaml = (tmp_path / "run" / "yolo" / "data.yaml").read_text()
    assert "train: images/val" in yaml
    with pytest.raises(DatasetError):
        api.plan("hit-uav-drone", tmp_path / "nothing")


def test_a_plan_shows_what_would_happen_to_an_earlier_run(dataset, tmp_path):
    def outlook(existing="refuse"):
        before = hashes(tmp_path)
        found = api.plan("hit-uav-drone", dataset, tmp_path / "out", existing=existing).facts["out"]
        assert hashes(tmp_path) == before
        return found

    assert outlook() is None
    generate(dataset, tmp_path / "out", limit=1)
    assert "has a run: would be refused without --resume" in outlook()
    assert "would keep its finished frames" in outlook("resume")
    assert "would replace it once the new run is complete" in outlook("overwrite")
    (tmp_path / "out" / "run.sqlite").unlink()
    assert "something else than a run of InfraBlend: would be refused" in outlook("overwrite")
    shutil.rmtree(tmp_path / "out")
    with pytest.raises(Interrupted):
        generate(dataset, tmp_path / "out", on_progress=interrupt)
    assert "has an unfinished run" in outlook("resume")


def interrupt(_: Progress) -> None:
    raise Interrupted("stop")


def test_estimates_at_their_limits_are_a_warning(dataset, tmp_path):
    generate(dataset, tmp_path / "run", settings=[])
    record = next(r for r in records(tmp_path / "run") if r.scene is not None)

    assert record.scene is not None
    scene = record.scene

    def with_estimates(centre, *doubts, at_limit=False):
        view = View(115.0, 100.0, 0.0, {"car": 3}, 0.1, at_limit)
        gain = {"grey_per_k": 6.0, "posterior": [centre, 1.0], "bounds": [2.5, 12.0], "doubts": doubts}
        facts = {**record.facts, "matching": {"gain": {"warm": gain}}}
        return FrameRow.of(dataclasses.replace(record, scene=dataclasses.replace(scene, view=view), facts=facts))

    good, bad = with_estimates(6.0), with_estimates(14.0, "gain_at_bound", at_limit=True)
    assert limit_warnings([FrameRow.of(record)] * 3 + [good] * 5 + [bad]) == []
    found = limit_warnings([good] * 4 + [bad])
    assert [(p.where, p.code, p.severity) for p in found] == [
        ("camera", "height-at-limit", "warning"),
        ("matching", "gain-at-limit", "warning"),
    ]
    assert "in 1 of 5 frames" in str(found[0]) and "in 1 of 5 frames" in str(found[1])
    day = Weather(290.0, 284.0, 0.0, 283.0, 292.0, Sun(0.0, 0.5, 800.0, 100.0, "contradicted"))
    early = FrameRow.of(dataclasses.replace(record, scene=dataclasses.replace(scene, weather=day)))
    (sun,) = limit_warnings([good] * 9 + [early])
    assert sun.code == "sun-below-horizon" and "in 1 frames" in sun.found
    others = [with_estimates(-3.0, kind) for kind in ("gain_negative", "anchors_contradict", "no_anchor")]
    assert [p.code for p in limit_warnings(others)] == ["gain-negative", "anchors-contradict", "no-anchor"]
    assert all("in 1 of 3 frames" in str(p) and "Check " in str(p) for p in limit_warnings(others))


def test_images_without_pitch_are_left_out_and_counted(dataset, tmp_path):
    plain = tmp_path / "plain"
    plain.mkdir()
    for k, p in enumerate(sorted((dataset / "normal_json").rglob("*.jpg"))):
        shutil.copy(p, plain / f"picture {k}.jpg")
    with pytest.raises(DatasetError, match="unknown camera pitch; expected a pitch in") as caught:
        generate(plain, tmp_path / "a")
    assert len(caught.value.problems) == 4
    metric = {"placement.mode": "metric"}
    with pytest.raises(DatasetError, match="unknown camera pitch and unknown camera height"):
        generate(plain, tmp_path / "a", settings=metric)
    with pytest.raises(DatasetError, match=r"set camera.altitude to \{fixed_m"):
        generate(plain, tmp_path / "a", settings=metric | {"camera.pitch.fixed_deg": 45})
    report = generate(plain, tmp_path / "b", settings={"camera.pitch.fixed_deg": 45, "output.image": "png"})
    assert report.counts["labels"] == {"drone": 8}
    (plain / "metadata.csv").write_text("file,pitch_deg\npicture 0.jpg,30\npicture 2.jpg,-5\n")
    report = generate(plain, tmp_path / "c")
    assert report.counts["frames"] == 4
    assert report.counts["skipped_backgrounds"] == 2


def test_pictures_of_one_name_in_two_splits_count_twice(dataset, tmp_path):
    plain = tmp_path / "plain"
    names = ("train/0001.jpg", "val/0001.jpg", "train/0002.jpg", "val/0002.jpg")
    for picture, name in zip(sorted((dataset / "normal_json").rglob("*.jpg")), names, strict=True):
        (plain / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(picture, plain / name)
    rows = "".join(f"{s}/{k}.jpg,{p}\n" for s in ("train", "val") for k, p in (("0001", ""), ("0002", 30)))
    (plain / "metadata.csv").write_text("file,pitch_deg\n" + rows)
    for name in ("train/0002.jpg", "val/0002.jpg"):
        (plain / name).write_bytes((plain / name).read_bytes()[:3000])
    (plain / "val" / "0003.jpg").write_bytes((plain / "val" / "0001.jpg").read_bytes())
    with (plain / "metadata.csv").open("a") as stream:
        stream.write("val/0003.jpg,40\n")
    report = generate(plain, tmp_path / "run")
    assert report.counts["dataset_errors"] == {"no-pitch": 2}
    assert report.counts["skipped_backgrounds"] == 4 and report.counts["frames"] == 2


def test_pictures_that_a_selection_does_not_reach_are_not_skipped(dataset, tmp_path):
    (dataset / "normal_json" / "test" / f"{NAMES[3]}.jpg").unlink()
    report = generate(dataset, tmp_path / "some", limit=1)
    assert report.ok and report.counts["skipped_backgrounds"] == 0
    assert report.counts["dataset_errors"] == {"image-missing": 1}  # still listed
    assert generate(dataset, tmp_path / "all").counts["skipped_backgrounds"] == 1


def test_rerender_gives_the_same_bytes(dataset, tmp_path):
    generate(dataset, tmp_path / "run", limit=1)
    frame = f"train/{NAMES[0]}_c1"
    again = api.rerender(tmp_path / "run", frame, tmp_path / "again.png")
    assert again.read_bytes() == (tmp_path / "run" / "images" / f"{frame}.png").read_bytes()
    with pytest.raises(OutputError, match="no finished frame"):
        api.rerender(tmp_path / "run", "train/other")


def test_the_physical_look_records_weather_and_what_was_estimated(dataset, tmp_path):
    settings = {"appearance.mode": "physical", "output.image": "png", "placement.min_contrast": "off"}
    generate(dataset, tmp_path / "run", settings=settings)
    for record in records(tmp_path / "run"):
        weather = record.scene.weather
        assert weather.dew_point_k <= weather.air_k - 2
        assert 0 <= weather.cloud <= 1
        by_day = record.background["time_of_day"] == "day"
        assert (weather.ground_k - weather.air_k >= 2) if by_day else (-1 <= weather.ground_k - weather.air_k <= 4)
        facts = record.facts["matching"]
        assert 2.5 <= facts["gain"]["warm" if facts["warm"][0] else "cold"]["grey_per_k"] <= 12
        low, high = facts["levels"]
        assert 16 <= low < 40
        assert 210 < high <= 235
        assert record.mapping["limits"] == facts["levels"]
    frame = f"train/{NAMES[0]}_c0"
    again = api.rerender(tmp_path / "run", frame, tmp_path / "again.png")
    assert again.read_bytes() == (tmp_path / "run" / "images" / f"{frame}.png").read_bytes()


def test_the_physical_look_places_objects_as_the_artistic_one_does(dataset, tmp_path):
    """Looks differ in grey levels alone: boxes and masks are the same."""
    generate(dataset, tmp_path / "a")
    settings = {"appearance.mode": "physical", "output.image": "png", "placement.min_contrast": "off"}
    generate(dataset, tmp_path / "p", settings=settings)
    for a, p in zip(records(tmp_path / "a"), records(tmp_path / "p"), strict=True):
        assert all(x.equals(y) for x, y in zip(a.inserted, p.inserted, strict=True))
    with pytest.raises(RecipeError, match=r"matching\.mode: .* follows from appearance\.mode"):
        generate(dataset, tmp_path / "x", settings={**settings, "matching.mode": "percentile"})


def test_one_split_of_a_dataset_is_not_read_alone(dataset, tmp_path):
    with pytest.raises(DatasetError, match="lose every label"):
        generate(dataset / "normal_json" / "train", tmp_path / "run")


def test_a_folder_of_datasets_is_refused(dataset, tmp_path):
    shutil.copytree(dataset, tmp_path / "both" / "one")
    with pytest.raises(DatasetError, match=r"(?s)a folder of datasets, not of one dataset.*1 dataset\(s\) inside"):
        generate(tmp_path / "both", tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_frames_for_which_the_recipe_drew_no_object_are_empty_by_recipe(dataset, tmp_path):
    objects = [{"model": "drone", "count": {"values": [0]}}]
    report = generate(dataset, tmp_path / "run", settings={"output.image": "png", "objects": objects})
    assert report.counts["frames_without_object_because"] == {"recipe": report.counts["images"]}


def test_pictures_that_look_down_have_no_place_for_a_recipe_of_the_sky():
    draws: DrawStatistics = {"wanted": 8, "absent": {"no_place": 8}, "rejected": {"beyond_ground": 1200, "overlap": 3}}
    (found,) = absent_warnings(draws)
    assert "use a recipe for cameras that look down" in found.todo
    (other,) = absent_warnings({**draws, "rejected": {"overlap": 1200, "beyond_ground": 3}})
    assert "look down" not in other.todo


def test_a_kind_of_which_few_are_inserted_is_said_in_words():
    recipe = load_recipe("hit-uav-cars", {"objects": [{"model": "person"}, {"model": "car", "category": "Car"}]})
    by_kind = {"objects.0": {"asked": 30, "inserted": 26}, "objects.1": {"asked": 24, "inserted": 2}}
    draws: DrawStatistics = {"wanted": 54, "absent": {"no_place": 26}, "rejected": {"unfit_ground": 900, "overlap": 9}}
    counts = {"objects_by_kind": by_kind, "objects_left_out": {"no_place": 26}}
    (found,) = few_inserted(recipe, counts, draws)
    assert (found.where, found.code, found.severity) == ("objects.1", "objects-absent", "warning")
    assert found.found.startswith("22 of 24 Car were not inserted; ") and "a car needs a road" in found.found
    assert "no place was found where it fits" in found.found and "placement.where" in found.todo
    assert few_inserted(recipe, {"objects_by_kind": {"objects.1": by_kind["objects.1"]}}, draws) == []


def test_visible_pictures_without_pitch_are_called_so_first(tmp_path):
    """A pitch would not help: the pictures that are looked at are all in colour."""
    folder = tmp_path / "visible"
    folder.mkdir()
    rng = np.random.default_rng(0)
    for n in range(5):
        Image.fromarray(rng.integers(0, 255, (128, 160, 3), dtype=np.uint8)).save(folder / f"DJI_{n}_W.png")
    with pytest.raises(DatasetError, match="no usable background") as caught:
        generate(folder, tmp_path / "run")
    first, *others = caught.value.problems
    assert first.code == "image-colour" and "as train/DJI_0_W.png, train/DJI_1_W.png" in first.found
    assert first.expected == "thermal pictures in grey" and {p.code for p in others} == {"no-pitch"}
    Image.new("L", (160, 128), 90).save(folder / "DJI_0_W.png")
    with pytest.raises(DatasetError, match="no usable background") as caught:
        generate(folder, tmp_path / "run")
    assert {p.code for p in caught.value.problems} == {"no-pitch"}


def test_warnings_of_single_frames_reach_the_report(dataset, tmp_path):
    folder = tmp_path / "colour"
    folder.mkdir()
    rng = np.random.default_rng(0)
    for n in range(3):
        Image.fromarray(rng.integers(0, 255, (128, 160, 3), dtype=np.uint8)).save(folder / f"1_80_60_0_0000{n}.png")
    report = generate(folder, tmp_path / "run")
    (colour,) = [p for p in report.problems if p.code == "image-colour"]
    assert "and 2 more" in colour.where
    assert colour.found.startswith("in colour (visible light, or thermal with a palette); converted to grey")
    assert "leave visible pictures out" in colour.todo
    assert any(p.code == "no-labels" for p in report.problems)
    written = json.loads((tmp_path / "run" / "run.json").read_text())["problems"]
    assert {"image-colour", "no-labels"} <= {p["code"] for p in written}


def test_a_renderer_that_cannot_start_leaves_no_run_behind(dataset, tmp_path, monkeypatch):
    from infrablend.rendering import RENDERERS

    monkeypatch.setitem(RENDERERS, "flat", "infrablend.no_such_module:Renderer")
    with pytest.raises(MissingDependencyError):
        generate(dataset, tmp_path / "run")
    monkeypatch.undo()
    assert generate(dataset, tmp_path / "run", limit=1).ok


def test_classes_are_renamed_joined_and_shared_with_new_objects(dataset, tmp_path):
    objects = [{"model": m, "category": c} for m, c in (("drone", "thing"), ("deer", "deer"), ("person", "human"))]
    settings = {
        "labels.rename": {"Person": "thing", "Car": "vehicle", "OtherVehicle": "vehicle"}, "labels.keep_categories":
        ["thing"], "objects": objects, "output.formats": ["coco", "yolo"], "configurations": 1,
    }  # fmt: skip
    run = generate(dataset, tmp_path / "run", settings=settings).out
    top = coco_of(run)
    assert [(c["id"], c["name"]) for c in top["categories"]] == [
        (0, "thing"), (1, "vehicle"), (2, "Bicycle"), (4, "DontCare"), (5, "deer"), (6, "human"),
    ]  # fmt: skip
    of_name = {c["id"]: c["name"] for c in top["categories"]}
    kinds = {(of_name[a["category_id"]], a["inserted"]) for a in top["annotations"]}
    assert kinds >= {("thing", False), ("thing", True), ("deer", True), ("human", True)}
    record = json.loads((run / "run.json").read_text())
    assert [c["name"] for c in record["categories"] if c["new"]] == ["deer", "human"]
    assert record["recipe"]["labels"]["rename"]["Car"] == "vehicle"


def test_regions_to_ignore_that_a_recipe_turns_into_objects_are_a_warning(dataset, tmp_path):
    def warnings(rename: dict[str, str]) -> list[Problem]:
        recipe = load_recipe("hit-uav-drone", {"labels.rename": rename})
        found = make_plan(recipe, api.read_dataset(dataset), seed=0).problems
        return [p for p in found if p.code == "ignore-renamed"]

    (warning,) = warnings({"DontCare": "Car"})
    assert (warning.where, warning.severity) == ("Car", "warning") and "(DontCare)" in warning.found
    assert not warnings({"DontCare": "crowd", "Car": "vehicle"})


def test_renaming_an_unknown_class_is_refused(dataset, tmp_path):
    with pytest.raises(RecipeError, match=r"labels.rename: found car; expected categories .*Car"):
        generate(dataset, tmp_path / "run", settings={"labels.rename": {"car": "x"}})


def test_the_sources_ids_can_be_kept(dataset, tmp_path):
    settings = {"output.ids": "source", "configurations": 1, "output.formats": ["coco", "native"]}
    run = generate(dataset, tmp_path / "run", settings=settings).out
    source = json.loads((dataset / "normal_json/annotations/train.json").read_text())
    for top, key in ((coco_of(run), "file_name"), (json.loads((run / "native/normal_json/annotations/train.json")
                      .read_text()), "filename")):  # fmt: skip
        names = {i["id"]: i[key].rpartition("_c0")[0] for i in top["images"]}
        assert names == {i["id"]: i["filename"].removesuffix(".jpg") for i in source["images"]}
    objects = coco_of(run)["annotations"]
    old = {a["id"]: a["image_id"] for a in objects if not a["inserted"]}
    assert old == {a["id"]: a["image_id"] for a in source["annotation"]}
    new = [a["id"] for split in ("train", "val", "test") for a in coco_of(run, split)["annotations"] if a["inserted"]]
    assert new and min(new) > 7 and len(set(new)) == len(new)


def test_source_ids_that_would_repeat_are_refused_before_the_first_frame(dataset, tmp_path):
    with pytest.raises(RecipeError, match=r"source with 2 configuration\(s\)"):
        generate(dataset, tmp_path / "run", settings={"output.ids": "source"})
    assert not (tmp_path / "run").exists()


def test_partly_covered_originals_say_how_much_is_seen(dataset, tmp_path):
    file = dataset / "normal_json/annotations/train.json"
    top = json.loads(file.read_text())
    for a in top["annotation"]:
        if a["category_id"] == 0:
            a["bbox"], a["segmentation"] = [0, 0, 640, 512], [[0, 0, 640, 0, 640, 512, 0, 512]]
    file.write_text(json.dumps(top))
    report = generate(
        dataset, tmp_path / "run", reading=api.Reading(splits=["train"]), settings={"output.formats": ["coco", "yolo"]}
    )
    assert report.counts["labels_partly_covered"] >= 4
    by_image: dict[int, list[dict]] = {}
    for a in coco_of(report.out)["annotations"]:
        by_image.setdefault(a["image_id"], []).append(a)
    for found in by_image.values():
        person = next(a for a in found if a["category_id"] == 0)
        hidden = sum(a["area"] for a in found if a["inserted"])
        assert hidden > 0
        assert person["visibility"] == pytest.approx(1 - hidden / (640 * 512), abs=1e-6)
        assert person["bbox"] == [0, 0, 640, 512]
    again = generate(
        dataset,
        tmp_path / "run",
        reading=api.Reading(splits=["train"]),
        existing="resume",
        settings={"output.formats": ["coco"]},
    )
    assert again.counts["labels_partly_covered"] == report.counts["labels_partly_covered"]


def test_formats_that_warn_alike_warn_once(dataset, tmp_path):
    formats = "output.formats=[yolo, yolo-obb, yolo-seg]"
    settings = ["output.image=png", formats]
    report = generate(dataset, tmp_path / "run", settings=settings, reading=api.Reading(splits=("test",)))
    assert sorted(p.code for p in report.problems if p.code.endswith("-absent")) == ["train-absent", "val-absent"]
