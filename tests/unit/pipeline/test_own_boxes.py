"""`labels.loosen: auto`: boxes of inserted objects as loose as those that people drew in the dataset."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.annotation.looseness import Looseness
from infrablend.annotation.measured_looseness import EXACT_FACTOR
from infrablend.config.loading import load_recipe
from infrablend.config.recipe import Labels, Recipe
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.formats.pictures.images import Background
from infrablend.pipeline.plans.own_boxes import MAX_BOXES, OwnBoxes, with_measured_boxes
from tests.run_files import hashes, records

SIZE_WH = 160, 120
FLAT = api.Execution(renderer="flat", in_process=True)


def drawn(
    count: int, category: str = "Car", factor: float = 1.0, margin_px: float = 0.0, first: int = 0
) -> tuple[ImageRecord, ...]:
    """Pictures with two objects of 8 to 36 px each, whose boxes are larger by a factor and a margin."""
    images = []
    for n in range(first, first + count):
        labels = []
        for x in (40, 120):
            size = np.array([8 + 4 * (n % 8), 8 + 2 * (n % 5)])
            half = size * factor / 2 + margin_px
            middle = np.array([x, 60.0])
            labels.append(Instance(category, np.concatenate([middle - half, middle + half]), extra={"wh": size}))
        images.append(ImageRecord(f"{n:03d}", Path(f"{n:03d}.png"), "train", SIZE_WH, tuple(labels)))
    return tuple(images)


def pixels_of(image: ImageRecord, depth: int = 8) -> np.ndarray:
    pixels = np.random.default_rng(int(image.id)).normal(100, 2, SIZE_WH[::-1])
    for label in image.instances:
        middle = (label.box_xyxy[:2] + label.box_xyxy[2:]) / 2
        (x0, y0), (x1, y1) = ((middle + s * label.extra["wh"] / 2).astype(int) for s in (-1, 1))
        pixels[y0:y1, x0:x1] = 200
    return pixels.astype(np.uint8) if depth == 8 else (pixels * 20 + 7000).astype(np.uint16)


def boxes_of(images: tuple[ImageRecord, ...], depth: int = 8) -> OwnBoxes:
    names = dict.fromkeys(label.category for image in images for label in image.instances)
    dataset = Dataset(
        Path("data"), "coco", tuple(Category(k, n, ignore=n == "DontCare") for k, n in enumerate(names)), images
    )
    mode = {8: "L", 16: "I;16"}[depth]
    return OwnBoxes(dataset, lambda image: Background(image.path, pixels_of(image, depth), mode, depth, "PNG"))


def recipe(**labels: object) -> Recipe:
    return load_recipe("hit-uav-cars", {"labels": {"loosen": "auto", **labels}})


def found(images: tuple[ImageRecord, ...], *classes: str, depth: int = 8, **labels: object) -> tuple[Labels, str]:
    resolved, text = with_measured_boxes(recipe(**labels), classes or ("Car",), boxes_of(images, depth))
    return resolved.labels, text


@pytest.mark.parametrize("depth", [8, 16])
@pytest.mark.parametrize("margin_px", [2, 5])
def test_a_margin_is_measured(margin_px, depth):
    labels, text = found(drawn(20, margin_px=margin_px), depth=depth)
    assert (labels.loosen, labels.loosen_px, labels.loosen_obb) == ({"Car": 1.0}, {"Car": margin_px}, False)
    assert text == (
        f"Boxes of inserted objects (Car) get {margin_px} px on each side, as measured on 40 boxes of Car in this "
        "dataset. Oriented boxes stay exact."
    )
    assert Looseness.of_labels(labels).to_counts() == {"loosened_by_px": {"Car": margin_px}}


def test_a_factor_is_measured_against_exact_boxes():
    labels, text = found(drawn(20, factor=1.5))
    assert labels.loosen == {"Car": pytest.approx(1.5 / EXACT_FACTOR, abs=0.006)} and labels.loosen_px == {"Car": 0}
    assert "are enlarged by the factor 1.36, as measured on 40 boxes of Car" in text


@pytest.mark.parametrize("drawn_boxes", [{}, {"factor": 1.08}, {"margin_px": -2}])
def test_tight_boxes_give_exact_ones(drawn_boxes):
    labels, text = found(drawn(20, **drawn_boxes))
    assert not Looseness.of_labels(labels)
    assert "(Car) stay exact, as measured on " in text


def test_some_odd_boxes_do_not_count():
    odd = drawn(3, margin_px=14, first=20)
    assert found((*drawn(20, margin_px=2), *odd))[0].loosen_px == {"Car": 2}


def test_classes_with_too_few_boxes_are_drawn_like_all_others_and_then_by_size():
    few, many = drawn(5, "Car", margin_px=3), drawn(20, "Bird", margin_px=4, first=5)
    labels, text = found((*few, *many), "Car", "Bird", "drone")
    assert labels.loosen_px == {"Car": 4, "Bird": 4, "drone": 4}
    assert "(Car, drone) get 4 px on each side, as measured on 50 boxes of Bird, Car in this dataset" in text
    assert "(Bird) get 4 px on each side, as measured on 40 boxes of Bird in this dataset" in text
    labels, text = found(few, "Car", "drone")
    assert labels.loosen_px == {"Car": "by_size", "drone": "by_size"}
    assert text.startswith(
        "Boxes of inserted objects (Car, drone) get 2 px on each side up to a size of 8 px, 3 px from"
    )
    assert "as 10 boxes of this dataset could be measured, and 30 are needed" in text


def test_labels_that_nobody_drew_around_objects_are_not_measured():
    images = drawn(40, margin_px=3)
    for fault in ({"inserted": True}, {"truncated": True}, {"extra": {"iscrowd": 1, "wh": np.array([8, 8])}}):
        changed = [replace(i, instances=tuple(replace(o, **fault) for o in i.instances)) for i in images]
        assert found(tuple(changed))[0].loosen_px == {"Car": "by_size"}
    regions = drawn(40, "DontCare", margin_px=3)
    assert found(regions, "Car")[0].loosen_px == {"Car": "by_size"}


def test_names_are_those_after_renaming():
    images = (*drawn(20, "Van", margin_px=2), *drawn(20, "Bird", margin_px=5, first=20))
    labels, text = found(images, "Car", rename={"Van": "Car"})
    assert labels.loosen_px == {"Car": 2} and "40 boxes of Van" in text


def test_stated_margins_stay():
    images = drawn(20, margin_px=3)
    assert found(images, loosen_px=4.75) == (recipe(loosen="exact", loosen_px=4.75).labels, "")
    labels, text = found(images, "Car", "drone", loosen_px={"drone": 2})
    assert labels.loosen_px == {"drone": 2, "Car": 3} and "drone" not in text
    assert found(images, loosen_obb=True)[0].loosen_obb is True
    plain = recipe(loosen=1.2)
    assert with_measured_boxes(plain, ["Car"], boxes_of(images)) == (plain, "")


def test_few_labels_are_read_whatever_their_order():
    images = drawn(300, margin_px=3)
    loaded: list[str] = []
    boxes = boxes_of(images)

    def load(image: ImageRecord) -> Background:
        loaded.append(image.id)
        return boxes.load(image)

    counting = OwnBoxes(boxes.dataset, load)
    first = counting.of(frozenset({"Car"}))
    assert len(first) == MAX_BOXES and len(set(loaded)) == len(loaded) == 300
    assert counting.of(frozenset({"Car"})) is first and len(loaded) == 300, "measured once"
    turned = tuple(replace(i, instances=i.instances[::-1]) for i in images[::-1])
    assert list(boxes_of(turned).of(frozenset({"Car"}))) == list(first)


@pytest.fixture
def folder(tmp_path) -> Path:
    """A YOLO folder of 20 pictures with 40 cars, whose boxes have a margin of 3 px."""
    root = tmp_path / "data"
    for kind in ("images", "labels"):
        (root / kind / "train").mkdir(parents=True)
    (root / "data.yaml").write_text("names: [Car]\ntrain: images/train\n")
    for image in drawn(20, margin_px=3):
        Image.fromarray(pixels_of(image)).save(root / "images/train" / image.path.name)
        lines = []
        for label in image.instances:
            x0, y0, x1, y1 = label.box_xyxy
            of_picture = [(x0 + x1) / 2 / 160, (y0 + y1) / 2 / 120, (x1 - x0) / 160, (y1 - y0) / 120]
            lines.append(" ".join(map(str, (0, *of_picture))))
        (root / "labels/train" / f"{image.id}.txt").write_text("\n".join(lines))
    return root


SETTINGS = {
    "labels.loosen": "auto", "output.image": "png", "output.formats": ["coco"], "camera.size_px": SIZE_WH,
    "camera.pitch": {"fixed_deg": 45},
}  # fmt: skip
SENTENCE = "Boxes of inserted objects (drone) get 3 px on each side, as measured on 40 boxes of Car in this dataset. "


def generate(data: Path, out: Path, **changes):
    options = {"settings": SETTINGS, "execution": FLAT, "limit": 3, **changes}
    return api.generate("hit-uav-drone", data, out, **options)


def labels_of(run: Path) -> list[dict]:
    return [a for a in json.loads((run / "coco/train.json").read_text())["annotations"] if a["inserted"]]


def test_a_run_states_what_was_measured_and_every_way_to_make_it_gives_the_same(folder, tmp_path):
    run = tmp_path / "run"
    generate(folder, run)
    record = json.loads((run / "run.json").read_text())
    assert record["boxes"].startswith(SENTENCE)
    stated = record["recipe"]["labels"]
    assert (stated["loosen"], stated["loosen_px"], stated["loosen_obb"]) == ({"drone": 1}, {"drone": 3}, False)
    assert SENTENCE in (run / "README.md").read_text() and SENTENCE in (run / "report.html").read_text()
    planned = api.plan("hit-uav-drone", folder, settings=SETTINGS, execution=FLAT, limit=3)
    assert planned.facts["boxes"] == record["boxes"]

    inserted = labels_of(run)
    assert inserted
    for a in inserted:
        (x, y, w, h), (tx, ty, tw, th) = a["bbox"], a["tight_bbox"]
        far = np.array([x + w - tx - tw, y + h - ty - th, tx - x, ty - y])
        at_edge = np.isclose([x + w, y + h, x, y], [*SIZE_WH, 0, 0])
        assert np.allclose(far[~at_edge], 3, atol=0.02) and (far <= 3.02).all()
        assert a["obb"] == a["tight_obb"]

    generate(folder, tmp_path / "two", execution=api.Execution(renderer="flat", workers=2))
    assert hashes(tmp_path / "two") == hashes(run)
    with api.frames(
        "hit-uav-drone", folder, settings=SETTINGS, selection=api.FrameSelection(limit=3), execution=FLAT
    ) as frames:
        in_memory = [o.box_xyxy for frame in frames for o in frame.inserted]
    written = [np.array(a["bbox"]) for a in inserted]
    np.testing.assert_allclose(in_memory, [[*b[:2], *(b[:2] + b[2:])] for b in written], atol=0.01)
    frame = records(run)[0]
    again = api.rerender(run, frame.frame_id, tmp_path / "again.png")
    assert again.read_bytes() == (run / "images" / frame.image).read_bytes()
    assert api.show(run, frame.frame_id)["inserted"]


def test_a_resumed_run_and_one_with_frames_left_out_keep_what_was_measured(folder, tmp_path):
    run = tmp_path / "run"
    generate(folder, run)
    before = hashes(run)
    next((run / "images").rglob("*.png")).unlink()
    shutil.rmtree(run / "coco")
    generate(folder, run, existing="resume")
    assert hashes(run) == before
    boxes = json.loads((run / "run.json").read_text())["boxes"]
    api.exclude(run, [records(run)[0].frame_id])
    assert json.loads((run / "run.json").read_text())["boxes"] == boxes
    assert boxes in (run / "README.md").read_text()


def test_a_merged_run_states_it_too(folder, tmp_path):
    generate(folder, tmp_path / "whole")
    for number in (1, 2):
        request = api.RunRequest(
            "hit-uav-drone", folder, tmp_path / "parts", settings=SETTINGS, execution=FLAT,
            selection=api.FrameSelection(limit=3), shard=api.ShardRequest(number, 2),
        )  # fmt: skip
        api.generate_shard(request)
    api.merge([tmp_path / "parts"], tmp_path / "merged")
    assert hashes(tmp_path / "merged") == hashes(tmp_path / "whole")


@pytest.mark.realdata
@pytest.mark.parametrize(("name", "data", "category", "least", "most"), [
    ("hit-uav-people", "hit-uav", "Person", 1.15, 1.25),
    ("hit-uav-cars", "hit-uav", "Car", 1.12, 1.22),
    ("drone-sky", "halmstad/backgrounds", "drone", 4.0, 4.6),
])  # fmt: skip
def test_real_boxes_are_as_loose_as_known(real_data, name, data, category, least, most):
    boxes = OwnBoxes(api.read_dataset(real_data / data))
    labels = with_measured_boxes(load_recipe(name), [category], boxes)[0].labels
    looseness = Looseness.of_labels(labels)
    factor, px = looseness.of(category)
    assert least <= (px if px else factor) <= most
