"""Pascal VOC: layouts, origins, flags, bad boxes, written files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from infrablend.core.boxes import corners_of_box, corners_of_cxcywha
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.core.rle_masks import Mask
from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder
from infrablend.formats.labels import voc
from infrablend.formats.read_write import Reading
from tests.samples import codes

SIZE = "<size><width>100</width><height>80</height><depth>1</depth></size>"


def picture(path: Path, size_wh: tuple[int, int] = (100, 80)) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full(size_wh[::-1], 90, np.uint8)).save(path)
    return path


def box(x0: object, y0: object, x1: object, y1: object) -> str:
    return f"<bndbox><xmin>{x0}</xmin><ymin>{y0}</ymin><xmax>{x1}</xmax><ymax>{y1}</ymax></bndbox>"


def xml(path: Path, *objects: str, name: str = "", size: str = SIZE) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    inside = "".join(f"<object>{o}</object>" for o in objects)
    path.write_text(f"<annotation><filename>{name or path.stem + '.png'}</filename>{size}{inside}</annotation>")
    return path


def boxes(dataset: Dataset) -> dict[str, list[list[float]]]:
    return {i.id: [o.box_xyxy.tolist() for o in i.instances] for i in dataset.images}


LAYOUTS = {
    "own": ("Annotations/{}.xml", "JPEGImages/{}.png", ""),
    "devkit": ("VOCdevkit/VOC2012/Annotations/{}.xml", "VOCdevkit/VOC2012/JPEGImages/{}.png", "VOCdevkit/VOC2012/"),
    "flat": ("{}.xml", "{}.png", ""),
    "kinds": ("annotations/{}.xml", "images/{}.png", ""),
}


@pytest.mark.parametrize("layout", sorted(LAYOUTS))
def test_every_layout_is_found_and_read(tmp_path: Path, layout: str) -> None:
    annotation, image, base = LAYOUTS[layout]
    for name in ("a 1", "b", "c"):
        picture(tmp_path / image.format(name))
    xml(tmp_path / annotation.format("a 1"), f"<name>fox</name>{box(10, 20, 30, 40)}")
    xml(tmp_path / annotation.format("b"))
    lists = tmp_path / base / "ImageSets" / "Main"
    lists.mkdir(parents=True)
    (lists / "train.txt").write_text("a 1\n")
    (lists / "test.txt").write_text("b  -1\nc\n")
    d = dataset_folder.read(tmp_path)
    assert d.format == "voc" and codes(d) == [] and codes(d, "warning") == ["label-missing"]
    assert boxes(d) == {"a 1": [[10, 20, 30, 40]], "b": [], "c": []}
    assert {i.id: i.split for i in d.images} == {"a 1": "train", "b": "test", "c": "test"}
    assert [i.extra.get("labelled", True) for i in d.images] == [True, True, False]
    assert d.notes["rows"] == {"files": 2, "objects": 1, "read": 1, "parts": 0, "unlabelled": 1}
    assert [i.id for i in voc.read(tmp_path, unlabelled="drop").images] == ["a 1", "b"]
    assert [i.id for i in voc.read(tmp_path, splits=["train"]).images] == ["a 1"]


def test_folders_of_splits_may_hold_the_same_names(tmp_path: Path) -> None:
    for k, folder in enumerate(("train", "valid/valid", "test")):
        picture(tmp_path / folder / "img" / "1.png")
        xml(tmp_path / folder / "xml" / "1.xml", f"<name>fox</name>{box(k, 0, 10, 10)}")
    d = voc.read(tmp_path)
    assert [(i.split, i.file_name, i.instances[0].box_xyxy[0]) for i in d.images] == [
        ("train", "1.png", 0), ("val", "1.png", 1), ("test", "1.png", 2),
    ]  # fmt: skip
    assert len({i.id for i in d.images}) == 3 and codes(d) == []


def test_box_convention_is_an_option(tmp_path: Path) -> None:
    picture(tmp_path / "a.png")
    xml(tmp_path / "a.xml", f"<name>fox</name>{box(1, 1, 100, 80)}", f"<name>fox</name>{box(0, 5, 8, 9)}")
    assert boxes(voc.read(tmp_path))["a"] == [[1, 1, 100, 80], [0, 5, 8, 9]]
    d = dataset_folder.read(tmp_path, Reading(options={"origin": "1"}))
    assert boxes(d)["a"] == [[0, 0, 100, 80], [0, 4, 8, 9]]  # there is no pixel 0, so that one is clipped
    assert codes(d, "warning") == ["box-clipped"] and d.notes["origin"] == 1
    with pytest.raises(DatasetError) as caught:
        dataset_folder.read(tmp_path, Reading(options={"origin": "2", "unlabelled": "maybe"}))
    assert [p.where for p in caught.value.problems] == ["option origin", "option unlabelled"]


def test_flags_poses_and_oriented_boxes(tmp_path: Path) -> None:
    picture(tmp_path / "a.png")
    flags = "<truncated>1</truncated><difficult>0</difficult><occluded>1</occluded><pose>Left</pose>"
    turned = "<robndbox><cx>50</cx><cy>40</cy><w>20</w><h>10</h><angle>0.5</angle></robndbox>"
    xml(
        tmp_path / "a.xml",
        f"<name>fox</name>{flags}{box(1, 2, 3, 4)}",
        f"<name>hare</name><difficult>?</difficult>{turned}",
    )
    d = voc.read(tmp_path)
    fox, hare = d.images[0].instances
    assert (fox.truncated, fox.difficult, fox.extra) == (True, False, {"occluded": True, "pose": "Left"})
    assert (hare.truncated, hare.difficult) == (None, None) and codes(d, "warning") == ["flag-value"]
    assert hare.corners_xy is not None
    np.testing.assert_allclose(hare.corners_xy, corners_of_cxcywha(np.array([50, 40, 20, 10, 0.5])), atol=1e-12)
    assert d.categories == (Category(0, "fox"), Category(1, "hare"))


BAD_OBJECTS = (
    (box(1, 2, 3, 4), "category-unknown"),
    ("<name>fox</name>", "box-malformed"),
    ("<name>fox</name>" + box("x", 2, 3, 4), "box-malformed"),
    ("<name>fox</name>" + box("nan", 2, 3, 4), "box-not-finite"),
    ("<name>fox</name>" + box(10, 20, 10, 40), "box-empty"),
    ("<name>fox</name>" + box(30, 20, 10, 40), "box-empty"),
    ("<name>fox</name>" + box(120, 20, 130, 40), "box-outside"),
    ("<name>f</name><robndbox><cx>1</cx><cy>1</cy><w>0</w><h>2</h><angle>0</angle></robndbox>", "box-empty"),
    ("<name>f</name><robndbox><cx>inf</cx><cy>1</cy><w>1</w><h>2</h><angle>0</angle></robndbox>", "box-not-finite"),
)


@pytest.mark.parametrize(("text", "code"), BAD_OBJECTS)
def test_bad_objects_are_named_counted_and_left_out(tmp_path: Path, text: str, code: str) -> None:
    picture(tmp_path / "a.png")
    xml(tmp_path / "a.xml", "<name>fox</name>" + box(10, 20, 30, 40), text)
    d = voc.read(tmp_path)
    assert codes(d) == [code] and len(d.images[0].instances) == 1
    assert d.problems[0].where == "a.xml: object 1"
    assert (d.notes["rows"]["objects"], d.notes["rows"]["read"]) == (2, 1)


def test_files_that_cannot_be_used_are_all_named(tmp_path: Path) -> None:
    for name in ("a", "b", "c", "d"):
        picture(tmp_path / f"{name}.png")
    xml(tmp_path / "a.xml", "<name>fox</name>" + box(10, 20, 30, 40) + "<part/>", size="")
    (tmp_path / "b.xml").write_text("<annotation>")
    (tmp_path / "c.xml").write_text('<!DOCTYPE a [<!ENTITY x "y">]><annotation>&x;</annotation>')
    (tmp_path / "d.xml").write_text("<other/>")
    xml(tmp_path / "e.xml", name="../../../etc/passwd")
    xml(tmp_path / "f.xml", name="a.png")
    d = voc.read(tmp_path)
    assert [i.id for i in d.images] == ["a"]  # a picture with a broken file does not count as one without objects
    assert sorted(codes(d)) == [
        "annotation-layout", "annotation-not-xml", "annotation-not-xml", "image-duplicate", "image-missing",
    ]  # fmt: skip
    assert codes(d, "warning") == ["image-size-unknown", "part-unread"]
    assert d.images[0].size_wh == (100, 80)


def test_foreign_folders_are_left_alone(tmp_path: Path) -> None:
    picture(tmp_path / "a.png")
    match = voc.detect(tmp_path)
    assert (match.ok, match.reason) == (False, "no XML file in the folder or below it")
    (tmp_path / "a.png.aux.xml").write_text("<PAMDataset/>")
    match = voc.detect(tmp_path)
    assert not match.ok and "<PAMDataset>" in match.reason
    assert dataset_folder.detect(tmp_path).format == "folder"


def test_voc_with_annotations_is_not_detected_as_hit_uav(tmp_path: Path) -> None:
    for name in ("0_60_30_0_00001", "dog"):
        picture(tmp_path / name / "JPEGImages" / f"{name}.png")
        xml(tmp_path / name / "Annotations" / f"{name}.xml", "<name>fox</name>" + box(10, 20, 30, 40))
        assert dataset_folder.detect(tmp_path / name).format == "voc"
    assert voc.read(tmp_path / "0_60_30_0_00001").notes["pitch"] == "file names"


def test_losses_are_counted_and_names_must_fit(tmp_path: Path) -> None:
    frame = np.zeros((80, 100), np.bool_)
    frame[10:20, 10:30] = True
    b = np.array([10.0, 10.0, 30.0, 20.125])
    logo = Instance("Logo", np.array([0.0, 60.0, 20.0, 80.0]), track_id=3)
    full = Instance("fox & hound", b, corners_of_box(b), Mask.from_array(frame), 0.5, True, True, True)
    path = picture(tmp_path / "in" / "a.png")
    image = ImageRecord("a", path, "val", (100, 80), (full, logo))
    categories = (Category(3, "fox & hound"), Category(7, "Logo", ignore=True))
    written = voc.write(tmp_path / "out", [image], categories)
    assert written.losses == {"ignore_as_class": 1, "mask_dropped": 1, "obb_dropped": 1, "visibility_dropped": 1}
    text = (tmp_path / "out" / "Annotations" / "a.xml").read_text()
    assert "<xmin>10</xmin>" in text and "<ymax>20.125</ymax>" in text and "fox &amp; hound" in text
    d = dataset_folder.read(tmp_path / "out")
    assert [c.name for c in d.categories] == ["fox & hound", "Logo"]
    assert d.images[0].split == "val" and d.images[0].instances[0].inserted
    with pytest.raises(ValueError, match="does not fit"):
        voc.write(tmp_path / "x", [image, image], categories)
    with pytest.raises(ValueError, match="not in the list"):
        voc.write(tmp_path / "y", [image], categories[:1])


@given(st.text(max_size=200) | st.binary(max_size=200))
def test_any_bytes_are_read_or_reported(tmp_path_factory: pytest.TempPathFactory, content: str | bytes) -> None:
    root = tmp_path_factory.mktemp("voc")
    picture(root / "a.png")
    raw = content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content
    (root / "a.xml").write_bytes(raw)
    try:
        d = voc.read(root)
    except DatasetError as error:
        assert error.problems
    else:
        assert d.images


values = st.sampled_from(["0", "-1", "5", "99.5", "1e308", "-1e308", "nan", "inf", "", "x", "0x10", "1_000", "٣"])


@given(st.lists(values, min_size=5, max_size=5), st.sampled_from(["bndbox", "robndbox"]), st.sampled_from("01"))
def test_any_numbers_give_boxes_inside_the_frame(
    tmp_path_factory: pytest.TempPathFactory, numbers: list[str], tag: str, origin: str
) -> None:
    root = tmp_path_factory.mktemp("voc")
    picture(root / "a.png")
    keys = ("xmin", "ymin", "xmax", "ymax") if tag == "bndbox" else ("cx", "cy", "w", "h", "angle")
    inside = "".join(f"<{k}>{v}</{k}>" for k, v in zip(keys, numbers, strict=False))
    xml(root / "a.xml", f"<name>fox</name><{tag}>{inside}</{tag}>")
    d = voc.read(root, origin=origin)
    for o in d.images[0].instances:
        x0, y0, x1, y1 = o.box_xyxy
        assert 0 <= x0 < x1 <= 100 and 0 <= y0 < y1 <= 80
    assert len(d.images[0].instances) + len(codes(d)) == 1


ONE = f"<name>fox</name>{box(1, 2, 3, 4)}"


@pytest.mark.parametrize(
    "inside", [f'<object xmlns="http://x">{ONE}</object>', f"<objects><object>{ONE}</object></objects>"]
)
def test_objects_in_a_namespace_or_a_list_are_read(tmp_path: Path, inside: str) -> None:
    picture(tmp_path / "a.png")
    (tmp_path / "a.xml").write_text(f"<annotation>{SIZE}{inside}</annotation>")
    d = dataset_folder.read(tmp_path)
    assert d.format == "voc" and not d.problems and boxes(d) == {"a": [[1, 2, 3, 4]]}


@pytest.mark.parametrize(
    ("inside", "read", "kinds"),
    [
        (f"<Object>{ONE}</Object><Object><name>fox</name></Object>", 0, "2 <Object>"),
        (f"<item>{ONE}</item><items><item>{ONE}</item><item>{ONE}</item></items>", 0, "1 <item>, 2 <items>"),
        (f"<object>{ONE}{box(5, 5, 9, 9)}</object>", 1, "1 further bndbox of an object"),
        (f"<object>{ONE}<polygon><x1>1</x1><y1>2</y1></polygon></object>", 1, "1 polygon beside a box"),
    ],
)
def test_other_objects_are_counted_by_kind(tmp_path: Path, inside: str, read: int, kinds: str) -> None:
    picture(tmp_path / "a.png")
    (tmp_path / "a.xml").write_text(f"<annotation>{SIZE}<weather><name>fog</name></weather>{inside}</annotation>")
    d = dataset_folder.read(tmp_path)
    (problem,) = d.problems
    assert problem.code == "kind-unread" and problem.found.endswith(f": {kinds}")
    assert len(d.images[0].instances) == read
