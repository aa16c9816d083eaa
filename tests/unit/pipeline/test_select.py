"""Selecting a part of a dataset by class, number of pictures or objects, or flight conditions."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.core.rle_masks import Mask
from infrablend.core.temperature import Radiometry, TemperatureScale
from infrablend.errors import DatasetError
from infrablend.formats import writing
from infrablend.pipeline.datasets.content import content_digest
from infrablend.pipeline.datasets.origin import loosened_before
from infrablend.pipeline.datasets.requests import MOST_COPIES, ClassChanges, Selection, SplitRule
from infrablend.pipeline.datasets.select import Conditions, conditions, copies_to_match, draw_with_sum, select
from tests.command_line import done

CATEGORIES = (Category(0, "Person"), Category(1, "Car"), Category(2, "DontCare", ignore=True))


def image(number: int, objects: dict[str, int], altitude: float = 60.0, time="night", root=Path()) -> ImageRecord:
    boxes = tuple(Instance(name, np.array([4.0 * k, 4, 4 * k + 3, 9])) for name, n in objects.items() for k in range(n))
    path = root / f"{number:03d}.png"
    return ImageRecord(
        f"{number:03d}",
        path,
        "train",
        (64, 64),
        boxes,
        capture=Capture(pitch_deg=60.0, altitude_m=altitude, time_of_day=time),
    )


def dataset(counts, root=Path()) -> Dataset:
    return Dataset(root, "coco", CATEGORIES, tuple(image(k, c, root=root) for k, c in enumerate(counts)))


def people(count: int) -> dict[str, int]:
    return {"Person": count} if count else {"Car": 1}


def test_pictures_without_a_class_and_without_regions_to_ignore():
    data = dataset([{"Person": 2}, {"Car": 1}, {}, {"DontCare": 1}, {"Car": 1, "DontCare": 1}])
    part, facts = select(data, Selection(without=("Person", "DontCare")))
    assert [i.id for i in part.images] == ["001", "002"]
    assert facts["left_out"] == {"with DontCare": 2, "with Person": 1}
    assert part.images[0].instances is data.images[1].instances


@pytest.mark.parametrize("objects", [60, 77, 90, 111])
def test_requested_numbers_of_pictures_and_objects_are_met(objects):
    counts = np.random.default_rng(3).integers(0, 9, 60)
    data = dataset([people(int(c)) for c in counts])
    part, facts = select(data, Selection("Person", images=20, objects=objects, seed=5))
    assert len(part.images) == len({i.id for i in part.images}) == 20
    shown = [sum(o.category == "Person" for o in i.instances) for i in part.images]
    assert min(shown) > 0
    assert sum(shown) == facts["objects_taken"] == objects
    assert facts["left_out"] == {"not drawn": int((counts > 0).sum()) - 20, "without Person": int((counts == 0).sum())}
    same, _ = select(data, Selection("Person", images=20, objects=objects, seed=5))
    other, _ = select(data, Selection("Person", images=20, objects=objects, seed=6))
    assert [i.id for i in same.images] == [i.id for i in part.images] != [i.id for i in other.images]


def test_unreachable_targets_are_approximated_and_reported():
    data = dataset([people(c) for c in (1, 2, 3, 4)])
    for objects, found in ((100, 7), (1, 3)):
        part, facts = select(data, Selection("Person", images=2, objects=objects))
        assert len(part.images) == 2
        assert facts["objects_taken"] == found
        assert facts["objects"] == objects


def test_the_draw_is_changed_no_more_than_it_must():
    counts = np.array([5, 5, 5, 5, 5, 5, 2], np.int64)
    taken = draw_with_sum(counts, np.arange(7), 4, 17)
    assert set(taken.tolist()) - {0, 1, 2, 3} == {6}
    assert counts[taken].sum() == 17
    assert draw_with_sum(counts, np.arange(7), 4, 20).tolist() == [0, 1, 2, 3]


def test_heights_and_times_follow_the_images_with_the_class():
    like = [image(k, {"Person": 1}, 60.0 if k < 30 else 100.0) for k in range(40)]
    pool = [image(100 + k, {"Car": 1}, 60.0 if k < 10 else 100.0) for k in range(40)]
    data = Dataset(Path(), "coco", CATEGORIES, (*like, *pool))
    part, facts = select(data, Selection(without=("Person",), images=40, like="Person"))
    assert Counter(i.capture.altitude_m for i in part.images) == {60.0: 30, 100.0: 10}
    assert len({i.id for i in part.images}) == len({i.name for i in part.images}) == 40
    assert facts["drawn_again"] == 20
    assert facts["pictures"] == 20
    assert facts["left_out"] == {"not drawn": 20, "with Person": 40}
    again = [i for i in part.images if "_again" in i.id]
    assert {i.name for i in again} == {f"{i.id}.png" for i in again}
    assert {i.path for i in again} <= {i.path for i in pool}


def test_missing_heights_are_filled_from_the_nearest_of_the_same_time():
    pool = [
        Conditions("night", 60.0, 30),
        Conditions("night", 80.0, 30),
        Conditions("night", 120.0, 30),
        Conditions("night", 120.0, 30),
        Conditions("day", 60.0, 30),
    ]
    copies = copies_to_match(pool, [Conditions("night", 60.0, 30)] * 3 + [Conditions("day", 90.0, 30)], 12, 0)
    # Nine at night from 60 m, of which four are to be had; four from 80 m, one from 120 m. Three by day.
    assert copies[0] == copies[1] == MOST_COPIES
    assert copies[2] + copies[3] == 1
    assert copies[4] == 3
    assert sum(copies_to_match(pool, [Conditions("night", 60.0, 30)], MOST_COPIES * 5, 0)) == MOST_COPIES * 5


def test_pitches_are_shared_out_too():
    pool = [Conditions("night", 60.0, p) for p in (30, 40, 40, 60, 90, 90)]
    assert copies_to_match(pool, [Conditions("night", 60.0, 30)], 4, 0) == [4, 0, 0, 0, 0, 0]
    # 80 degrees are not there: 90 are nearer than 60.
    assert copies_to_match(pool, [Conditions("night", 60.0, 80)], 2, 0) == [0, 0, 0, 0, 1, 1]
    assert copies_to_match([*pool, Conditions("night", 70.0, 80)], [Conditions("night", 60.0, 80)], 3, 0)[-1] == 3


def test_grey_levels_are_shared_out_too() -> None:
    pool = [Conditions("day", 60.0, 30, level) for level in (75, 100, 150, 175)]
    assert copies_to_match(pool, [Conditions("day", 60.0, 30, 150)], 4, 0) == [0, 0, 4, 0]
    assert copies_to_match(pool, [Conditions("day", 60.0, 30, 125)] * 2, 8, 0) == [0, 4, 4, 0]


def test_levels_come_from_the_pixels_of_8_and_16_bits(tmp_path: Path) -> None:
    for name, pixels, level in (
        ("a.png", np.full((8, 8), 140, np.uint8), 150.0),
        ("b.png", np.full((8, 8), 140 * 257, np.uint16), 150.0),
        ("c.png", np.full((8, 8), 30, np.uint8), 25.0),
    ):
        Image.fromarray(pixels).save(tmp_path / name)
        assert conditions(replace(image(1, {}, 60.0), path=tmp_path / name)).level == level
    assert conditions(replace(image(1, {}, 60.0), path=tmp_path / "missing.png")).level == -1


@pytest.mark.parametrize(
    ("wanted", "match"),
    [
        (Selection("Dog", ("Cat",)), r"--with-class: Dog[\s\S]*--without: Cat"),
        (Selection("Car", ("Car",)), "--without: Car, also given as --with-class"),
        (Selection("Car", images=0), "--images: 0"),
        (Selection(objects=3), "Give --with-class"),
        (Selection(like="Car", objects=3), "--like-class"),
        (Selection(like="DontCare"), "no object of class DontCare"),
        (Selection("Car", images=3), r"2 matching picture\(s\) \(1 without Car\); expected 3"),
        (Selection(without=("Car", "Person")), r"0 matching picture\(s\)"),
    ],
)
def test_invalid_selections_are_refused(wanted, match):
    with pytest.raises(DatasetError, match=match):
        select(dataset([{"Car": 1}, {"Car": 2}, {"Person": 1}]), wanted)


def written(root: Path) -> Path:
    (root / "pictures").mkdir(parents=True)
    data = dataset([{"Person": k % 4, "Car": 1, "DontCare": int(k == 7)} for k in range(12)], root / "pictures")
    for i in data.images:
        Image.fromarray(np.full((64, 64), 90, np.uint8)).save(i.path)
    writing.write("coco", root / "data", data.images, CATEGORIES, source=data)
    return root / "data"


def test_convert_writes_a_selection_with_one_class_and_says_so(tmp_path):
    data, out = written(tmp_path), tmp_path / "out"
    words = ["convert", data, out, "--to", "coco", "--with-class", "Person", "--without", "DontCare"]
    words += ["--only-class", "Person", "--images", 4, "--objects", 9, "--seed", 1]
    done(*words)
    again = api.read_dataset(out)
    assert [c.name for c in again.categories] == ["Person"]
    assert len(again.images) == 4
    assert sum(len(i.instances) for i in again.images) == 9
    counts = json.loads((out / "convert.json").read_text())["counts"]
    assert counts["labels_dropped"] == {"Car": 4}
    assert counts["selection"]["left_out"] == {"not drawn": 4, "with DontCare": 1, "without Person": 3}
    assert "left out: 4 not drawn, 1 with DontCare, 3 without Person" in (out / "README.md").read_text()


def test_pictures_drawn_again_are_written_under_names_of_their_own(tmp_path):
    data = written(tmp_path)
    api.convert(
        data, tmp_path / "out", "coco", selection=api.Selection(without=("Person", "DontCare"), like="Person", images=8)
    )
    again = api.read_dataset(tmp_path / "out")
    assert len({i.path for i in again.images}) == 8
    assert len({i.path.stat().st_ino for i in again.images}) == 3


def test_boxes_of_inserted_objects_alone_are_loosened(tmp_path):
    first = replace(
        image(0, {"Person": 3}, root=tmp_path),
        instances=(
            Instance("Person", np.array([20.0, 20, 30, 40]), inserted=True),
            Instance("Person", np.array([0.0, 50, 10, 64]), inserted=True),
            Instance("Person", np.array([40.0, 20, 50, 40])),
        ),
    )
    Image.fromarray(np.full((64, 64), 90, np.uint8)).save(first.path)
    writing.write(
        "coco", tmp_path / "data", [first], CATEGORIES, source=Dataset(tmp_path, "coco", CATEGORIES, (first,))
    )
    words = ["convert", tmp_path / "data", tmp_path / "out", "--to", "coco", "--loosen-inserted", 1.2]
    done(*words)
    (again,) = api.read_dataset(tmp_path / "out").images
    boxes = sorted(i.box_xyxy.tolist() for i in again.instances)
    np.testing.assert_allclose(boxes, [[0, 48.6, 11, 64], [19, 18, 31, 42], [40, 20, 50, 40]])
    counts = json.loads((tmp_path / "out" / "convert.json").read_text())["counts"]
    assert (counts["boxes_loosened"], counts["loosened_by"]) == (2, 1.2)
    assert "boxes of 2 inserted objects were enlarged by the factor 1.2" in (tmp_path / "out" / "README.md").read_text()
    words = [*words[:2], tmp_path / "px", "--to", "coco", "--loosen-inserted-px", 2]
    done(*words)
    (again,) = api.read_dataset(tmp_path / "px").images
    boxes = sorted(i.box_xyxy.tolist() for i in again.instances)
    np.testing.assert_allclose(boxes, [[0, 48, 12, 64], [18, 18, 32, 42], [40, 20, 50, 40]])
    counts = json.loads((tmp_path / "px" / "convert.json").read_text())["counts"]
    assert (counts["boxes_loosened"], counts["loosened_by_px"]) == (2, 2) and "loosened_by" not in counts
    with pytest.raises(DatasetError, match="2 boxes that are enlarged or fitted already"):
        api.convert(tmp_path / "px", tmp_path / "twice", "coco", loosen_px=1)
    with pytest.raises(DatasetError, match="masks instead of boxes"):
        api.convert(tmp_path / "data", tmp_path / "yolo-seg", "yolo-seg", loosen_px=1)
    api.convert(tmp_path / "data", tmp_path / "masks", "masks", loosen_px=2)  # these have boxes beside the masks
    (with_masks,) = api.read_dataset(tmp_path / "masks").images
    np.testing.assert_allclose(sorted(i.box_xyxy.tolist() for i in with_masks.instances), boxes)
    # Neither a conversion without the option nor a new split hides that boxes are enlarged.
    api.convert(tmp_path / "px", tmp_path / "voc", "voc")
    api.split(tmp_path / "px", tmp_path / "split", SplitRule("gap"), to="voc")
    for made in ("voc", "split"):
        report = api.convert(tmp_path / made, tmp_path / f"{made}-yolo", "yolo")
        assert report.counts["boxes_loosened"] == 2
        assert (
            "\n* 2 boxes of inserted objects were enlarged or fitted before" in (report.out / "README.md").read_text()
        )
        with pytest.raises(DatasetError, match="2 boxes that are enlarged or fitted already"):
            api.convert(report.out, tmp_path / "thrice", "coco", loosen_px=1)
    # A part counts its own boxes, and one without enlarged boxes may be enlarged.
    part = api.convert(tmp_path / "px", tmp_path / "none", "coco", classes=ClassChanges(drop=["Person"]))
    assert "boxes_loosened" not in part.counts
    part = api.convert(tmp_path / "voc", tmp_path / "none-voc", "yolo", classes=ClassChanges(drop=["Person"]))
    assert "boxes_loosened" not in part.counts
    # Without marks, any box of a part may be enlarged.
    voc = api.read_dataset(tmp_path / "voc")
    one = replace(voc.images[0], instances=voc.images[0].instances[:1])
    assert loosened_before(voc, voc) == {"boxes_loosened": 2}
    assert loosened_before(voc, replace(voc, images=(one,))) == {"boxes_loosened_at_most": 1}
    two = replace(voc.images[0], instances=voc.images[0].instances[:2])
    thrice = replace(voc, images=(two, replace(two, id="again"), two))
    assert loosened_before(voc, thrice) == {"boxes_loosened_at_most": 6}
    half = api.convert(tmp_path / "voc", tmp_path / "train", "yolo", selection=api.Selection(images=1))
    assert half.counts["boxes_loosened"] == 2
    # Formats without boxes have none, and exact ones are read from their masks.
    masks = api.convert(tmp_path / "px", tmp_path / "polygons", "yolo-seg")
    assert not {"boxes_loosened", "boxes_loosened_at_most"} & masks.counts.keys()
    with pytest.raises(DatasetError, match=r"--rendered: 2 boxes that are enlarged"):
        api.profile(tmp_path / "data", tmp_path / "profile", rendered=tmp_path / "voc")
    with pytest.raises(DatasetError, match=r"--loosen-inserted-px: \{"):
        api.convert(tmp_path / "data", tmp_path / "tight", "coco", loosen_px={"Person": 1})
    with pytest.raises(DatasetError, match=r"--loosen-inserted-px: -1"):
        api.convert(tmp_path / "data", tmp_path / "tight", "coco", loosen_px=-1)
    with pytest.raises(DatasetError, match=r"--loosen-inserted: 0\.5"):
        api.convert(tmp_path / "data", tmp_path / "tight", "coco", loosen=0.5)


@pytest.mark.realdata
@pytest.mark.parametrize(("name", "pictures", "boxes"), [("Person", 417, 3095), ("Car", 450, 2400)])
def test_hit_uav_gives_as_many_real_boxes_as_asked_for(real_data, name, pictures, boxes):
    data = api.read_dataset(real_data / "hit-uav", api.Reading(splits=["train"]))
    free, facts = select(data, Selection(without=(name, "DontCare"), like=name))
    assert not any(o.category in (name, "DontCare") for i in free.images for o in i.instances)
    assert sum(n for n in facts["left_out"].values()) + facts["pictures"] == len(data.images)
    real, found = select(data, Selection(name, ("DontCare",), pictures, boxes))
    assert (len(real.images), found["objects_taken"]) == (pictures, boxes)
    assert min(sum(o.category == name for o in i.instances) for i in real.images) > 0


_VIEW = Capture(pitch_deg=60.0, altitude_m=80.0, time_of_day="night")


@pytest.mark.parametrize(
    "change",
    [
        {"capture": replace(_VIEW, sequence="flight 2")},
        {"capture": replace(_VIEW, captured="2024-05-01T12:00:00")},
        {"capture": replace(_VIEW, radiometry=Radiometry(TemperatureScale(0.04, 0.0, "counts"), "stated"))},
        {"capture": replace(_VIEW, altitude_from="laser")},
        {"instances": (Instance("Person", np.array([1.0, 2, 3, 4]), extra={"iscrowd": 1}),)},
        {"instances": (Instance("Person", np.array([1.0, 2, 3, 4]), mask=Mask.from_array(np.eye(8, dtype=bool))),)},
    ],
)
def test_everything_that_decides_a_result_changes_the_digest(change):
    """Stages were reused, and runs resumed, although sequence, time, scale, masks or crowds had changed."""
    one = ImageRecord(
        "a",
        Path("a.png"),
        "train",
        (8, 8),
        (Instance("Person", np.array([1.0, 2, 3, 4])),),
        capture=_VIEW,
    )
    categories = (Category(0, "Person"),)
    before, after = (Dataset(Path("x"), "coco", categories, (i,)) for i in (one, replace(one, **change)))
    assert content_digest(before) == content_digest(before)
    assert content_digest(before) != content_digest(after)
    ignoring = Dataset(Path("x"), "coco", (Category(0, "Person", ignore=True),), (one,))
    assert content_digest(before) != content_digest(ignoring)
