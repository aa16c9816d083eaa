"""HIT-UAV: a worked example, merged forms, and every kind of bad input."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from infrablend.core.boxes import corners_of_cxcywha
from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, ImageRecord, Instance, Split
from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder
from infrablend.formats.picture_facts import facts_from_name
from infrablend.formats.published import hit_uav
from tests.samples import codes


@pytest.fixture
def tiny(tmp_path: Path, write_tiny_hit_uav: Any) -> Path:
    """Four pictures in normal_json and rotate_json."""
    return Path(write_tiny_hit_uav(tmp_path / "tiny"))


def change(root: Path, form: str, split: str, edit: Any) -> None:
    """Edit the JSON of one split."""
    path = root / form / "annotations" / f"{split}.json"
    top = json.loads(path.read_text())
    edit(top)
    path.write_text(json.dumps(top))


def test_worked_example_of_the_paper_data() -> None:
    corners = corners_of_cxcywha(np.array([[167.1001, 193.5457, 54.3441, 115.954, 0.771333]]))[0]
    box = np.trunc([*corners.min(axis=0), *corners.max(axis=0)])
    assert [box[0], box[1], box[2] - box[0], box[3] - box[1]] == [107, 133, 119, 121]


def test_forms_are_merged(tiny: Path) -> None:
    d = hit_uav.read(tiny)
    assert d.problems == ()
    assert [i.id for i in d.images] == [
        "0_60_30_0_00001", "1_90_60_0_00002", "1_100_50_0_00003", "0_130_90_0_00004",
    ]  # fmt: skip
    first = d.images[0]
    assert (first.capture.pitch_deg, first.capture.altitude_m, first.capture.time_of_day, first.size_wh) == (
        30,
        60,
        "day",
        (640, 512),
    )
    car, person = first.instances
    assert car.box_xyxy.tolist() == [int(v) for v in car.box_xyxy]
    assert car.corners_xy is not None and car.difficult is False and car.truncated is None
    assert person.box_xyxy.tolist() == [394, 290, 406, 310]
    assert d.images[1].instances == ()
    assert d.category("DontCare").ignore
    assert d.notes["disagreements"] == dict.fromkeys(
        ("boxes", "oriented", "categories", "flags", "objects", "metadata"), 0
    )
    assert d.notes["boxes_checked"] == 5


def test_one_form_alone_and_by_name(tiny: Path) -> None:
    alone = hit_uav.read(tiny / "rotate_json")
    named = hit_uav.read(tiny, form="rotate_json")
    assert [i.instances[0].box_xyxy.tolist() for i in alone.images if i.instances] == [
        i.instances[0].box_xyxy.tolist() for i in named.images if i.instances
    ]
    assert hit_uav.read(tiny, form="normal_json").images[0].instances[0].corners_xy is None
    with pytest.raises(DatasetError, match="form normal_xml"):
        hit_uav.read(tiny, form="normal_xml")


def test_a_renamed_form_folder_is_known_by_its_content(tiny: Path, tmp_path: Path) -> None:
    (tiny / "rotate_json").rename(tmp_path / "mine")
    assert list(hit_uav.find_forms(tmp_path / "mine")) == ["rotate_json"]


def test_splits_are_filtered(tiny: Path) -> None:
    assert {i.split for i in hit_uav.read(tiny, splits=["val", "test"]).images} == {"val", "test"}
    with pytest.raises(DatasetError, match="splits"):
        hit_uav.read(tiny, splits=["dev"])


def test_picture_folders_may_be_links_and_rubbish_is_passed_over(tiny: Path, tmp_path: Path) -> None:
    shutil.move(tiny / "normal_json" / "train", tmp_path / "elsewhere")
    (tiny / "normal_json" / "train").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere" / ".DS_Store").write_bytes(b"x")
    (tmp_path / "elsewhere" / "._0_60_30_0_00001.jpg").write_bytes(b"x")
    (tiny / "normal_json" / ".DS_Store").write_bytes(b"x")
    assert hit_uav.read(tiny).problems == ()


def test_form_without_pictures_uses_those_of_another_form(tiny: Path) -> None:
    shutil.rmtree(tiny / "rotate_json" / "train")
    d = hit_uav.read(tiny / "rotate_json")
    assert len(d.images) == 4
    assert d.notes["pictures_borrowed"] == {"normal_json/train": 2}


def test_angles_a_hair_above_pi_are_kept(tiny: Path, tmp_path: Path) -> None:
    change(tiny, "rotate_json", "test", lambda t: t["annotations"][0]["bbox"].__setitem__(4, 3.141593))
    d = hit_uav.read(tiny, form="rotate_json")
    hit_uav.write(tmp_path / "out", d.images, d.categories, forms=["rotate_json"], ids="source", pictures=False)
    again = json.loads((tmp_path / "out" / "rotate_json" / "annotations" / "test.json").read_text())
    assert again["annotations"][0]["bbox"] == [320.0, 256.0, 70.0, 30.0, 3.141593]


@pytest.mark.parametrize(
    ("bbox", "code", "severity"),
    [
        ([float("nan"), 1, 2, 3], "box-not-finite", "error"),
        ([10, 10, float("inf"), 3], "box-not-finite", "error"),
        ([10, 10, 0, 3], "box-empty", "error"),
        ([10, 10, 5, -3], "box-empty", "error"),
        ([700, 10, 5, 3], "box-outside", "error"),
        ([-20, 10, 20, 3], "box-outside", "error"),
        ([1, 2, 3], "box-malformed", "error"),
        ("1 2 3 4", "box-malformed", "error"),
        ([1, 2, "x", 4], "box-malformed", "error"),
        (None, "box-malformed", "error"),
        ([-5, 10, 20, 3], "box-clipped", "warning"),
        ([630, 500, 20, 30], "box-clipped", "warning"),
    ],
)
def test_bad_boxes(tiny: Path, bbox: Any, code: str, severity: str) -> None:
    change(tiny, "normal_json", "train", lambda t: t["annotation"][1].__setitem__("bbox", bbox))
    d = hit_uav.read(tiny, form="normal_json")
    assert codes(d, severity) == [code]
    (problem,) = [p for p in d.problems if p.code == code]
    assert problem.where == "normal_json/annotations/train.json: annotation 1"
    assert problem.found and problem.expected
    kept = d.images[0].instances
    assert len(d.images) == 4 and len(kept) == (2 if severity == "warning" else 1)
    if severity == "warning":
        x0, y0, x1, y1 = kept[1].box_xyxy
        assert x0 >= 0 and y0 >= 0 and x1 <= 640 and y1 <= 512


def test_numbers_as_text_are_numbers(tiny: Path) -> None:
    change(tiny, "normal_json", "train", lambda t: t["annotation"][1].__setitem__("bbox", ["1", "2", "3", "4"]))
    assert hit_uav.read(tiny, form="normal_json").images[0].instances[1].box_xyxy.tolist() == [1, 2, 4, 6]


@pytest.mark.parametrize(
    ("bbox", "code", "severity"),
    [
        ([10, 10, 5, 5, float("nan")], "box-not-finite", "error"),
        ([10, 10, 0, 5, 0.1], "box-empty", "error"),
        ([900, 10, 5, 5, 0.1], "box-outside", "error"),
        ([10, 10, 40, 5, 0.1], "box-overhang", "warning"),
        ([10, 10, 5, 5], "box-malformed", "error"),
    ],
)
def test_bad_oriented_boxes(tiny: Path, bbox: Any, code: str, severity: str) -> None:
    change(tiny, "rotate_json", "train", lambda t: t["annotations"][1].__setitem__("bbox", bbox))
    d = hit_uav.read(tiny, form="rotate_json")
    assert codes(d, severity) == [code]
    assert len(d.images[0].instances) == (2 if severity == "warning" else 1)


def test_invalid_box_is_taken_from_the_other_form(tiny: Path) -> None:
    change(tiny, "normal_json", "train", lambda t: t["annotation"][1].__setitem__("bbox", [1, 2, 0, 0]))
    d = hit_uav.read(tiny)
    assert codes(d) == ["box-empty"]
    assert codes(d, "warning") == ["forms-disagree-objects"]
    assert d.images[0].instances[1].box_xyxy.tolist() == [394, 290, 406, 310]


@pytest.mark.parametrize(
    "name", ["../secret.jpg", "/etc/x.jpg", "a/../../x.jpg", "..\\x.jpg", "C:\\x.jpg", "\\\\host\\x.jpg", "", 7, None]
)
def test_names_that_lead_out_are_refused(tiny: Path, name: Any) -> None:
    (tiny / "normal_json" / "secret.jpg").write_bytes((tiny / "normal_json/train/0_60_30_0_00001.jpg").read_bytes())
    change(tiny, "normal_json", "train", lambda t: t["images"][0].__setitem__("filename", name))
    d = hit_uav.read(tiny, form="normal_json")
    assert [i.id for i in d.images if i.split == "train"] == ["1_90_60_0_00002"]
    assert codes(d)[0] in ("name-climbs", "name-missing")
    assert codes(d)[1:] == ["image-unknown", "image-unknown"]  # its annotations are named, too


def test_a_picture_that_is_a_link_out_is_refused(tiny: Path, tmp_path: Path) -> None:
    path = tiny / "normal_json" / "train" / "0_60_30_0_00001.jpg"
    shutil.move(path, tmp_path / "out.jpg")
    path.symlink_to(tmp_path / "out.jpg")
    d = hit_uav.read(tiny, form="normal_json")
    assert codes(d)[0] == "name-climbs" and len(d.images) == 3
    path.unlink()
    path.symlink_to("1_90_60_0_00002.jpg")  # a link that stays inside is a file like any other
    assert codes(hit_uav.read(tiny, form="normal_json")) == []


def test_missing_pictures_are_named(tiny: Path) -> None:
    for form in ("normal_json", "rotate_json"):
        (tiny / form / "train" / "0_60_30_0_00001.jpg").unlink()
    d = hit_uav.read(tiny)
    assert codes(d) == ["image-missing"] and len(d.images) == 3


def test_pictures_no_record_names_are_counted(tiny: Path) -> None:
    folder = tiny / "normal_json" / "train"
    shutil.copy(folder / "0_60_30_0_00001.jpg", folder / "0_60_30_0_09999.jpg")
    d = dataset_folder.read(tiny)
    assert codes(d, "warning") == ["image-unlisted"] and len(d.images) == 4


def test_duplicates_and_unknown_ids(tiny: Path) -> None:
    def edit(top: dict[str, Any]) -> None:
        top["images"].append(dict(top["images"][0]))
        top["annotation"].append(dict(top["annotation"][0]))
        top["annotation"].append(dict(top["annotation"][0], id=77, category_id=9))
        top["annotation"].append(dict(top["annotation"][0], id=78, image_id=999))
        top["annotation"].append("no record")

    change(tiny, "normal_json", "train", edit)
    d = hit_uav.read(tiny, form="normal_json")
    assert codes(d) == ["image-duplicate", "category-unknown", "image-unknown", "annotation-malformed"]
    assert codes(d, "warning") == ["annotation-duplicate"]
    assert len(d.images[0].instances) == 3


def test_broken_annotation_file_affects_only_its_split(tiny: Path) -> None:
    (tiny / "normal_json" / "annotations" / "train.json").write_text('{"images": [')
    d = hit_uav.read(tiny, form="normal_json")
    assert codes(d) == ["annotation-not-json"] and len(d.images) == 2
    for split in ("val", "test"):
        (tiny / "normal_json" / "annotations" / f"{split}.json").write_text("[]")
    with pytest.raises(DatasetError) as caught:
        hit_uav.read(tiny, form="normal_json")
    assert [p.code for p in caught.value.problems] == ["annotation-not-json", "annotation-layout", "annotation-layout"]


def test_forms_that_disagree_are_reported_and_the_first_counts(tiny: Path) -> None:
    def edit(top: dict[str, Any]) -> None:
        top["annotation"][0]["bbox"][0] += 3
        top["annotation"][1]["category_id"] = 1

    change(tiny, "normal_json", "train", edit)
    change(tiny, "rotate_json", "train", lambda t: t["images"][0].__setitem__("perspective", "40"))
    d = hit_uav.read(tiny)
    assert codes(d) == []
    assert sorted(codes(d, "warning")) == [
        "forms-disagree-boxes",
        "forms-disagree-categories",
        "forms-disagree-metadata",
    ]
    counts = d.notes["disagreements"]
    assert (counts["boxes"], counts["categories"], counts["metadata"]) == (1, 1, 1)
    assert d.images[0].capture.pitch_deg == 30
    assert d.images[0].instances[1].category == "Car"


def test_names_without_grammar_take_pitch_from_the_record(tiny: Path) -> None:
    for form in ("normal_json", "rotate_json"):
        folder = tiny / form / "train"
        (folder / "0_60_30_0_00001.jpg").rename(folder / "free.jpg")
        change(tiny, form, "train", lambda t: t["images"][0].__setitem__("filename", "free.jpg"))
    d = hit_uav.read(tiny)
    (free,) = [i for i in d.images if i.id == "free"]
    assert (free.capture.pitch_deg, free.capture.altitude_m, free.capture.time_of_day) == (30, 60, "day")
    assert codes(d, "warning") == ["name-grammar"]


XML = """<annotation><filename>{name}</filename><size><width>640</width><height>512</height><depth>1</depth></size>
{objects}</annotation>"""
OBJECT = (
    "<object><name>{name}</name><pose>30</pose><truncated>1</truncated><difficult>0</difficult>"
    "<bndbox><xmin>{x0}</xmin><ymin>290</ymin><xmax>406</xmax><ymax>310</ymax></bndbox></object>"
)


@pytest.fixture
def with_xml(tiny: Path) -> Path:
    """The tiny set with a normal_xml form of its first picture."""
    form = tiny / "normal_xml"
    (form / "Annotations").mkdir(parents=True)
    (form / "ImageSets" / "Main").mkdir(parents=True)
    (form / "ImageSets" / "Main" / "train.txt").write_text("0_60_30_0_00001\n")
    shutil.copytree(tiny / "normal_json" / "train", form / "JPEGImages")
    objects = OBJECT.format(name="Person", x0=394)
    text = XML.format(name="0_60_30_0_00001", objects=objects)
    (form / "Annotations" / "0_60_30_0_00001.xml").write_text(text)
    return tiny


def test_truncated_comes_from_the_xml_by_geometry(with_xml: Path) -> None:
    d = hit_uav.read(with_xml)
    car, person = d.images[0].instances
    assert (car.truncated, person.truncated, person.extra["pose"]) == (None, True, "30")
    assert sorted(codes(d, "warning")) == ["form-partial", "forms-disagree-objects"]  # the car is not in the XML


def test_entity_bombs_are_refused(with_xml: Path) -> None:
    bomb = '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "ha"><!ENTITY c "&b;&b;&b;">]><annotation>&c;</annotation>'
    (with_xml / "normal_xml" / "Annotations" / "0_60_30_0_00001.xml").write_text(bomb)
    (with_xml / "normal_xml" / "Annotations" / "0_60_30_0_00002.xml").write_text("<annotation><filename>")
    with pytest.raises(DatasetError) as caught:
        hit_uav.read(with_xml, form="normal_xml")
    assert [p.code for p in caught.value.problems if p.severity == "error"] == ["annotation-not-xml"] * 2
    assert "document type or entities" in caught.value.problems[0].found
    assert len(hit_uav.read(with_xml).images) == 4  # the other forms still contain everything


def test_xml_with_an_unknown_category_and_a_nan(with_xml: Path) -> None:
    objects = OBJECT.format(name="Tractor", x0=394) + OBJECT.format(name="Car", x0="nan")
    text = XML.format(name="0_60_30_0_00001", objects=objects)
    (with_xml / "normal_xml" / "Annotations" / "0_60_30_0_00001.xml").write_text(text)
    d = hit_uav.read(with_xml, form="normal_xml")
    assert codes(d) == ["box-not-finite"] and codes(d, "warning") == ["category-unknown"]
    assert d.category("Tractor").id == 5
    assert len(d.images[0].instances) == 1


@pytest.mark.parametrize(
    ("name", "facts"),
    [
        ("0_60_30_0_00001.jpg", (30.0, 60.0, "day", 1, None)),
        ("1_130_90_0_04077_c3.png", (90.0, 130.0, "night", 4077, 3)),
        ("60/day/0_60_00_0_00001", (0.0, 60.0, "day", 1, None)),
        ("0_60_95_0_00001.jpg", None),
        ("2_60_30_0_00001.jpg", None),
        ("0_60_30_0_00001_x.jpg", None),
        ("0_60_30_0_\u0661.jpg", None),
    ],
)
def test_file_name_grammar(name: str, facts: tuple[Any, ...] | None) -> None:
    found = facts_from_name(name)
    if facts is None:
        assert found is None
    else:
        assert found is not None
        c = found.capture
        assert (c.pitch_deg, c.altitude_m, c.time_of_day, found.frame, found.configuration) == facts


def made(folder: Path, names: list[tuple[str, Split]], instances: tuple[Instance, ...]) -> list[ImageRecord]:
    images = []
    for name, split in names:
        path = folder / split / name
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("L", (64, 48), 90).save(path)
        images.append(ImageRecord(path.stem, path, split, (64, 48), instances))
    return images


def test_xml_splits_hold_for_names_with_blanks(tmp_path: Path) -> None:
    images = made(tmp_path / "in", [("a b.png", "val"), ("c.png", "test")], ())
    hit_uav.write(tmp_path / "out", images, [Category(0, "Person")], forms=("normal_xml", "rotate_xml"))
    again = hit_uav.read(tmp_path / "out")
    assert {i.path.name: i.split for i in again.images} == {"a b.png": "val", "c.png": "test"}
    assert "split-unknown" not in codes(again, "warning")


def test_object_with_barely_overlapping_boxes_stays_one_object(tmp_path: Path) -> None:
    # A thin pole across its upright box, inserted by us; and a box thinner than a pixel, widened by the format.
    turned = corners_of_cxcywha(np.array([30.3, 20.7, 40.0, 2.0, 0.7]))
    low, high = turned.min(axis=0) + [6.0, 5.0], turned.max(axis=0) - [6.0, 5.0]
    pole = Instance("Person", np.concatenate([low, high]), turned, inserted=True)
    thin = Instance("Person", np.array([0.25, 0.125, 0.5, 48.0]))
    images = made(tmp_path / "in", [("a.png", "train")], (pole, thin))
    hit_uav.write(tmp_path / "out", images, [Category(0, "Person")], forms=("normal_xml", "rotate_xml"))
    again = hit_uav.read(tmp_path / "out")
    assert len(again.images[0].instances) == 2
    assert np.allclose(again.images[0].instances[0].corners_xy, turned, rtol=0, atol=1e-6)


def test_a_pose_with_markup_is_written_as_text(tmp_path: Path) -> None:
    picture = tmp_path / "0_60_30_0_00001.png"
    Image.new("L", (64, 48), 90).save(picture)
    car = Instance("Car", np.array([10.0, 20.0, 18.0, 25.0]), extra={"pose": "<b> & 45"})
    image = ImageRecord(
        picture.stem,
        picture,
        "train",
        (64, 48),
        (car,),
        capture=Capture(pitch_deg=30.0, altitude_m=60.0, time_of_day="day"),
        file_name=picture.name,
    )
    hit_uav.write(tmp_path / "out", [image], hit_uav.CATEGORIES, forms=("normal_xml",))
    d = hit_uav.read(tmp_path / "out")
    assert d.images[0].instances[0].extra["pose"] == "<b> & 45" and codes(d) == []
