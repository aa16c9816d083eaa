"""Exchange with CVAT and Label Studio: numbers by hand, what they export, and masks packed as they do."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance
from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder, writing
from infrablend.formats.labels import coco, cvat, label_studio
from tests.samples import codes, picture, records


def blob() -> np.ndarray:
    pixels = np.zeros((48, 64), np.bool_)
    pixels[10:20, 30:41] = True
    pixels[12:14, 33] = False
    pixels[0, 0] = pixels[47, 63] = True
    return pixels


@pytest.mark.parametrize("pixels", [blob(), ~blob(), np.ones((48, 64), np.bool_), np.zeros((48, 64), np.bool_)])
def test_a_brush_comes_back(pixels: np.ndarray) -> None:
    code = label_studio.encode_brush(pixels)
    assert (label_studio.decode_brush(code, (64, 48)) == pixels).all()


def test_a_brush_has_the_bits_of_rle_pack() -> None:
    """One pixel of four channels: 32 bits of length, 5 of word size, 4 x 4 of run sizes, one run of four."""
    bits = f"{4:032b}{7:05b}{2:04b}{3:04b}{7:04b}{15:04b}" + "1" + "00" + f"{3:03b}" + f"{255:08b}"
    bits += "0" * (-len(bits) % 8)
    expected = [int(bits[k : k + 8], 2) for k in range(0, len(bits), 8)]
    assert label_studio.encode_brush(np.ones((1, 1), np.bool_)) == expected


@pytest.mark.parametrize("code", [None, [], [1, 2, 3], [0, 0, 48, 0, 255], ["a"], [300] * 10, [0] * 10**6])
def test_a_damaged_brush_is_refused(code: object) -> None:
    with pytest.raises(ValueError):
        label_studio.decode_brush(code, (64, 48))


def test_a_rectangle_of_label_studio_turns_about_its_first_corner(tmp_path: Path) -> None:
    """A box of 10 x 4 px with its first corner at (20, 10), turned by 90 degrees clockwise."""
    picture(tmp_path / "images" / "train" / "a.png", 1)
    value = {"x": 2000 / 64, "y": 1000 / 48, "width": 1000 / 64, "height": 400 / 48, "rotation": 90}
    result = {
        "id": "k3", "type": "rectanglelabels", "from_name": "boxes", "to_name": "image", "original_width": 64,
        "original_height": 48, "value": value | {"rectanglelabels": ["Car"]},
    }  # fmt: skip
    task = {"id": 1, "data": {"image": "http://host/data/local-files/?d=images/train/a.png"}}
    tasks = [task | {"annotations": [{"id": 7, "was_cancelled": False, "result": [result]}]}]
    (tmp_path / "export.json").write_text(json.dumps(tasks))
    dataset = dataset_folder.read(tmp_path)
    assert (dataset.format, dataset.images[0].split) == ("label-studio", "train")
    (car,) = dataset.images[0].instances
    np.testing.assert_allclose(car.box_xyxy, [16, 10, 20, 20], atol=1e-9)


def test_cvats_own_export_is_read(tmp_path: Path) -> None:
    """Box, turned box, mask and polygon; the subset names the split, and attributes of others are ignored."""
    picture(tmp_path / "images" / "a.png", 1)
    (tmp_path / "annotations.xml").write_text("""<?xml version="1.0" encoding="utf-8"?>
<annotations><version>1.1</version><meta><project><labels><label><name>Car</name></label></labels></project></meta>
<image id="0" name="a.png" subset="Validation" task_id="3" width="64" height="48">
  <box label="Car" source="manual" occluded="1" xtl="1.00" ytl="2.00" xbr="11.00" ybr="6.50" z_order="0"/>
  <box label="Car" source="manual" occluded="0" xtl="20.00" ytl="10.00" xbr="40.00" ybr="20.00" rotation="90.00"/>
  <mask label="Person" occluded="0" rle="1, 2, 3" left="50" top="30" width="3" height="2" z_order="0"/>
  <polygon label="Person" occluded="0" points="5.0,40.0;10.0,40.0;10.0,45.0;5.0,45.0"/>
  <points label="Person" points="1,1"/>
</image></annotations>""")
    dataset = dataset_folder.read(tmp_path)
    assert dataset.format == "cvat" and dataset.images[0].split == "val"
    plain, turned, mask, polygon = dataset.images[0].instances
    assert plain.box_xyxy.tolist() == [1, 2, 11, 6.5] and plain.corners_xy is None and plain.extra["occluded"] is True
    np.testing.assert_allclose(turned.box_xyxy, [25, 5, 35, 25], atol=1e-9)
    assert mask.mask is not None and np.argwhere(mask.mask.to_array()).tolist() == [[30, 51], [30, 52]]
    assert mask.box_xyxy.tolist() == [51, 30, 53, 31] and polygon.box_xyxy.tolist() == [5, 40, 10, 45]


@pytest.mark.parametrize(
    "subsets", [("Train", "Validation", "Test"), ("TRAINING", "Val", "testing"), ("north", "Valid", "Test")]
)
def test_cvats_folders_are_named_as_the_subsets_were(tmp_path: Path, subsets: tuple[str, str, str]) -> None:
    elements = ""
    for n, subset in enumerate(subsets):
        picture(tmp_path / "images" / subset / "flight" / "a.png", n)
        elements += f'<image id="{n}" name="flight/a.png" subset="{subset}" width="64" height="48">'
        elements += '<box label="Car" xtl="1" ytl="2" xbr="11" ybr="6"/></image>'
    (tmp_path / "annotations.xml").write_text(f"<annotations><version>1.1</version>{elements}</annotations>")
    dataset = dataset_folder.read(tmp_path)
    found = [(i.split, i.path.relative_to(tmp_path).parts[1], len(i.instances)) for i in dataset.images]
    assert found == [(s, subset, 1) for s, subset in zip(("train", "val", "test"), subsets, strict=True)]
    assert not dataset.problems


def test_a_subset_leads_nowhere_else(tmp_path: Path) -> None:
    picture(tmp_path / "outside" / "a.png", 1)
    (tmp_path / "data" / "images").mkdir(parents=True)
    element = '<image id="0" name="a.png" subset="../../outside" width="64" height="48"/>'
    (tmp_path / "data" / "annotations.xml").write_text(f"<annotations>{element}</annotations>")
    with pytest.raises(DatasetError):
        dataset_folder.read(tmp_path / "data")


@pytest.mark.parametrize(
    "shape, code",
    [
        ('<box label="Car" xtl="1" ytl="2" xbr="x" ybr="6"/>', "box-malformed"),
        ('<box label="Car" xtl="1" ytl="2" xbr="1e999" ybr="6" rotation="nan"/>', "box-not-finite"),
        ('<box xtl="1" ytl="2" xbr="5" ybr="6"/>', "category-unknown"),
        ('<mask label="Car" rle="1, 2" left="50" top="30" width="3" height="2"/>', "mask-malformed"),
        ('<mask label="Car" rle="0, 400000000" left="0" top="0" width="20000" height="20000"/>', "mask-malformed"),
        ('<polygon label="Car" points="5;6"/>', "mask-malformed"),
    ],
)
def test_a_malformed_shape_is_named_and_left_out(tmp_path: Path, shape: str, code: str) -> None:
    picture(tmp_path / "images" / "a.png", 1)
    text = f'<annotations><image id="0" name="a.png" width="64" height="48">{shape}</image></annotations>'
    (tmp_path / "annotations.xml").write_text(text)
    dataset = dataset_folder.read(tmp_path)
    assert [p.code for p in dataset.problems] == [code] and not dataset.images[0].instances


def test_cvats_other_shapes_are_read_or_counted_by_kind(tmp_path: Path) -> None:
    picture(tmp_path / "images" / "a.png", 1)
    (tmp_path / "annotations.xml").write_text("""<annotations><image id="0" name="a.png" width="64" height="48">
  <box label="car" xtl="1" ytl="2" xbr="9" ybr="6"/>
  <ellipse label="deer" cx="30" cy="20" rx="10" ry="5"/>
  <ellipse label="deer" cx="30" cy="20" rx="10" ry="5" rotation="90"/>
  <ellipse label="deer" cx="59" cy="30" rx="10" ry="5"/>
  <ellipse label="deer" cx="inf" cy="20" rx="10" ry="5"/>
  <ellipse label="deer" cx="1e5" cy="20" rx="10" ry="5"/>
  <polyline label="car" points="1,2;30,40"/><points label="deer" points="9,9"/><points label="deer" points="8,8"/>
  <cuboid label="car" xtl1="6" ytl1="6" xbr2="9" ybr2="8"/><tag label="day"/>
  <skeleton label="deer"><points label="nose" outside="0" points="5,5"/></skeleton>
</image></annotations>""")
    dataset = dataset_folder.read(tmp_path)
    _, deer, turned, cut = dataset.images[0].instances
    np.testing.assert_allclose(deer.box_xyxy, [20, 15, 40, 25], atol=1e-9)
    np.testing.assert_allclose(turned.box_xyxy, [25, 10, 35, 30], atol=1e-9)
    np.testing.assert_allclose(cut.box_xyxy, [49, 25, 64, 35], atol=1e-9)
    assert deer.mask is not None and abs(deer.mask.area_px - math.pi * 50) < 8
    assert codes(dataset) == ["box-malformed"] * 2
    (left_out,) = (p for p in dataset.problems if p.code == "kind-unread")
    assert left_out.found.endswith(": 1 cuboid, 2 points, 1 polyline, 1 skeleton, 1 tag")


def cvats_coco(root: Path, *annotations: dict[str, Any]) -> Path:
    """Write CVAT's export as COCO of a picture of 160 x 128 px with these annotations of cars."""
    picture(root / "images" / "default" / "a.png", 1, (160, 128))
    rows = [{"id": n, "image_id": 1, "category_id": 1, "iscrowd": 0} | a for n, a in enumerate(annotations, 1)]
    top = {
        "images": [{"id": 1, "width": 160, "height": 128, "file_name": "a.png"}],
        "annotations": rows,
        "categories": [{"id": 1, "name": "car", "supercategory": ""}, {"id": 2, "name": "deer", "supercategory": ""}],
    }
    (root / "annotations").mkdir()
    (root / "annotations" / "instances_default.json").write_text(json.dumps(top))
    return root


def test_a_box_that_cvat_turned_is_oriented_in_its_coco_export(tmp_path: Path) -> None:
    """60 x 20 px, turned about (80, 60). CVAT writes a rotation of 0 with each upright box."""

    def car(rotation: object, segmentation: object = ()) -> dict[str, Any]:
        attributes = {"occluded": False, "rotation": rotation}
        return {"bbox": [50.0, 50.0, 60.0, 20.0], "segmentation": segmentation, "attributes": attributes}

    outline = [[60, 55, 90, 55, 90, 65, 60, 65]]
    root = cvats_coco(tmp_path, car(90.0), car(30.0), car(0.0), car("x"), car(360), car(90.0, outline), car(math.nan))
    dataset = dataset_folder.read(root)
    quarter, twelfth, *upright = dataset.images[0].instances
    np.testing.assert_allclose(quarter.box_xyxy, [70, 30, 90, 90], atol=1e-9)
    assert quarter.corners_xy is not None and twelfth.corners_xy is not None
    np.testing.assert_allclose(quarter.corners_xy, [[90, 30], [90, 90], [70, 90], [70, 30]], atol=1e-9)
    c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
    np.testing.assert_allclose(twelfth.corners_xy[0], [80 - 30 * c + 10 * s, 60 - 30 * s - 10 * c])
    assert all(i.corners_xy is None and i.box_xyxy.tolist() == [50, 50, 110, 70] for i in upright)
    (left_out,) = dataset.problems
    assert left_out.code == "kind-unread" and left_out.found.endswith(": 1 rotation beside a segmentation")


def test_a_class_of_crowds_alone_as_cvat_exports_masks_is_a_warning(tmp_path: Path) -> None:
    """Categories 1 and 2 are cars and deer; a class with one object beside its crowds is as COCO means it."""
    box, counts = {"bbox": [10, 10, 40, 20]}, {"counts": [1290, 20, 108, 20, 19042], "size": [128, 160]}
    deer = box | {"category_id": 2, "iscrowd": 1, "segmentation": counts}
    dataset = dataset_folder.read(cvats_coco(tmp_path, box, box | {"iscrowd": 1}, deer, deer))
    (crowds,) = dataset.problems
    assert (crowds.code, crowds.severity) == ("crowds-only", "warning") and "all 2 label(s) of 'deer'" in crowds.found


def test_objects_in_unknown_fields_of_coco_are_counted(tmp_path: Path) -> None:
    box = {"bbox": [10, 10, 40, 20]}
    root = cvats_coco(
        tmp_path, box | {"parts": [box, box], "head": box, "tags": [{"name": "x"}], "segments_info": [box]}
    )
    file = root / "annotations" / "instances_default.json"
    top = json.loads(file.read_text())
    top["images"][0] |= {"annotations": {"7": box, "8": box}, "extra_info": {"sun": {"up": True}}}
    top |= {"tracks": [{"boxes": [[1, 2, 3, 4]]}] * 3, "scenes": [{"name": "night"}], "regions": []}
    file.write_text(json.dumps(top))
    dataset = dataset_folder.read(root)
    (problem,) = dataset.problems
    counted = "1 in annotations.head, 2 in annotations.parts, 2 in images.annotations, 3 in tracks"
    assert problem.code == "kind-unread" and problem.found.endswith(f": {counted}")
    assert len(dataset.images[0].instances) == 1


def label_studio_objects(root: Path, *results: dict[str, Any]) -> Dataset:
    """Read a task of a picture of 64 x 48 px with these results."""
    picture(root / "images" / "a.png", 1)
    size = {"original_width": 64, "original_height": 48}
    task = {"data": {"image": "/data/upload/1/a.png"}, "annotations": [{"result": [size | r for r in results]}]}
    (root / "export.json").write_text(json.dumps([task]))
    return dataset_folder.read(root)


@pytest.mark.parametrize(
    "address", ["images/Valid/a.png", "/data/local-files/?d=x%5Cimages%5Cvalid%5Ca.png", "/data/upload/1/a.png"]
)
def test_pictures_of_label_studio_lie_in_folders_of_splits_whatever_their_case(tmp_path: Path, address: str) -> None:
    picture(tmp_path / "images" / "Valid" / "a.png", 1)
    task = {"data": {"image": address}, "annotations": [{"result": []}]}
    (tmp_path / "val.json").write_text(json.dumps([task]))
    (image,) = dataset_folder.read(tmp_path).images
    assert (image.split, image.name) == ("val", "a.png")


@pytest.mark.parametrize(
    ("address", "file", "name"),
    [
        ("/data/local-files/?d=images/train/images/g_7.png", "train/images/g_7.png", "images/g_7.png"),
        ("/mnt/images/p/images/train/a.png", "train/a.png", "a.png"),
        ("../images/p/images/train/a.png", "train/a.png", "a.png"),
        ("images/../p/images/a.png", "a.png", "a.png"),
        ("s3://[bucket/images/a.png", "a.png", "a.png"),
        ("/data/upload/1/abcd1234-a.png", "a.png", "a.png"),
        ("/data/upload/1/abcd1234-a.png", "abcd1234-a.png", "abcd1234-a.png"),
    ],
)
def test_pictures_of_label_studio_are_found(tmp_path: Path, address: str, file: str, name: str) -> None:
    picture(tmp_path / "images" / file, 1)
    (tmp_path / "train.json").write_text(json.dumps([{"data": {"image": address}, "annotations": [{"result": []}]}]))
    d = dataset_folder.read(tmp_path)
    assert not d.problems and [i.name for i in d.images] == [name]


def test_the_last_annotation_of_label_studio_with_results_counts(tmp_path: Path) -> None:
    picture(tmp_path / "images" / "a.png", 1)

    def annotation(label: str, **fields: Any) -> dict[str, Any]:
        value = {"x": 10, "y": 20, "width": 30, "height": 20, "rectanglelabels": [label]}
        size = {"original_width": 64, "original_height": 48}
        return {"result": [{"type": "rectanglelabels", "value": value, **size}], **fields}

    given = [annotation("fox"), annotation("deer"), {"result": []}, annotation("cat", was_cancelled=True)]
    more = {"drafts": [annotation("boar")], "completions": [annotation("hare")] * 2}
    (tmp_path / "a.json").write_text(json.dumps([{"data": {"image": "a.png"}, "annotations": given, **more}]))
    d = dataset_folder.read(tmp_path)
    assert [o.category for o in d.images[0].instances] == ["deer"]
    (problem,) = d.problems
    counted = "1 in a cancelled annotation, 1 in an earlier annotation, 2 in completions, 1 in drafts"
    assert problem.code == "kind-unread" and problem.found.endswith(f": {counted}")


def test_ellipses_of_label_studio_are_read_and_other_results_counted_by_kind(tmp_path: Path) -> None:
    place = {"x": 50, "y": 50, "radiusX": 25, "radiusY": 12.5, "ellipselabels": ["deer"]}
    dataset = label_studio_objects(
        tmp_path,
        {"type": "ellipselabels", "value": place},
        {"type": "ellipselabels", "value": place | {"rotation": 90}},
        {"type": "ellipselabels", "value": place | {"radiusX": None}},
        {"type": "ellipselabels", "value": place | {"radiusX": math.inf}},
        {"type": "keypointlabels", "value": {"x": 1, "y": 1, "width": 1, "keypointlabels": ["nose"]}},
        {"type": "choices", "value": {"choices": ["night"]}},
        {"type": "choices", "value": {"choices": ["day"]}},
    )
    level, turned = dataset.images[0].instances
    np.testing.assert_allclose(level.box_xyxy, [16, 18, 48, 30], atol=1e-9)
    np.testing.assert_allclose(turned.box_xyxy, [26, 8, 38, 40], atol=1e-9)
    assert level.mask is not None and abs(level.mask.area_px - math.pi * 16 * 6) < 12
    assert codes(dataset) == ["annotation-malformed"] * 2
    (left_out,) = (p for p in dataset.problems if p.severity == "warning")
    assert left_out.code == "kind-unread" and left_out.found.endswith(": 2 choices, 1 keypointlabels")


def test_labels_beside_a_shape_of_label_studio_are_its_label(tmp_path: Path) -> None:
    """The controls `Rectangle` and `Labels`: two results with one id. Shapes without label are counted."""
    box = {"x": 25, "y": 25, "width": 12.5, "height": 25, "rotation": 0}
    corners = {"points": [[50, 50], [75, 50], [75, 75]]}
    dataset = label_studio_objects(
        tmp_path,
        {"id": "q", "type": "rectangle", "value": box},
        {"id": "q", "type": "labels", "value": box | {"labels": ["truck"]}},
        {"id": "p", "type": "labels", "value": corners | {"labels": ["deer"]}},
        {"id": "p", "type": "polygon", "value": corners},
        {"id": "r", "type": "rectangle", "value": box},
        {"id": "t", "type": "labels", "value": {"text": "word", "labels": ["name"]}},
        {"type": "labels"},
    )
    truck, deer = dataset.images[0].instances
    assert (truck.category, truck.box_xyxy.tolist()) == ("truck", [16, 12, 24, 24])
    assert deer.category == "deer" and deer.mask is not None
    (left_out,) = dataset.problems
    assert left_out.code == "kind-unread" and left_out.found.endswith(": 2 labels, 1 rectangle")


def test_a_region_of_label_studio_has_its_first_label_and_others_are_counted(tmp_path: Path) -> None:
    value = {"x": 25, "y": 25, "width": 12.5, "height": 25, "rectanglelabels": ["deer", "male", "adult"]}
    dataset = label_studio_objects(tmp_path, {"id": "q", "type": "rectanglelabels", "value": value})
    assert [o.category for o in dataset.images[0].instances] == ["deer"]
    (left_out,) = dataset.problems
    assert left_out.code == "kind-unread" and left_out.found.endswith(": 2 further labels of a region")


@pytest.mark.parametrize(
    "more",
    [
        {"image_rotation": 90},
        {"image_rotation": "180"},
        {"image_rotation": "x"},
        {"original_width": 128, "original_height": 96},
        {"original_width": 48, "original_height": 64},
    ],
)
def test_a_result_of_label_studio_on_another_form_of_the_picture_is_an_error(
    tmp_path: Path, more: dict[str, Any]
) -> None:
    value = {"x": 25, "y": 25, "width": 12.5, "height": 25, "rectanglelabels": ["deer"]}
    result = {"type": "rectanglelabels", "value": value, "image_rotation": 0}
    d = label_studio_objects(tmp_path, {**result, "id": "q"}, {**result, "id": "r", **more})
    assert codes(d) == ["annotation-malformed"] and d.problems[0].where.endswith("result r")
    assert len(d.images[0].instances) == 1


def test_predictions_of_label_studio_are_counted_where_nobody_annotated(tmp_path: Path) -> None:
    picture(tmp_path / "images" / "a.png", 1)
    guess = {"result": [{"type": "rectanglelabels", "value": {}}, {"type": "rectanglelabels", "value": {}}]}
    tasks = [{"data": {"image": "a.png"}, "annotations": [], "predictions": [guess]}]
    text = json.dumps(tasks)
    (tmp_path / "export.json").write_text(text)
    (left_out,) = dataset_folder.read(tmp_path).problems
    assert left_out.code == "kind-unread" and left_out.found.endswith(": 2 predicted by a model")
    (tmp_path / "export.json").write_text(text.replace('"annotations": []', '"annotations": [{"result": []}]'))
    assert not dataset_folder.read(tmp_path).problems


def annotate(root: Path, file: str, count: int) -> None:
    """Write annotations of both tools with that many objects in the picture `images/train/a.png`."""
    box = '<box label="Car" xtl="1" ytl="2" xbr="9" ybr="6"/>'
    text = f'<annotations><image id="0" name="a.png" subset="train" width="64" height="48">{box * count}</image>'
    (root / "cvat" / f"{file}.xml").write_text(f"{text}</annotations>")
    value = {"x": 10, "y": 20, "width": 30, "height": 20, "rectanglelabels": ["Car"]}
    result = {"type": "rectanglelabels", "original_width": 64, "original_height": 48, "value": value}
    task = {"data": {"image": "images/train/a.png"}, "annotations": [{"result": [result] * count}]}
    (root / "label-studio" / f"{file}.json").write_text(json.dumps([task]))


@pytest.mark.parametrize("name", ["cvat", "label-studio"])
def test_a_second_annotation_of_a_picture_is_an_error(tmp_path: Path, name: str) -> None:
    """An export beside the files that were given to the tool: one of them is out of date."""
    for tool in ("cvat", "label-studio"):
        picture(tmp_path / tool / "images" / "train" / "a.png", 1)
    annotate(tmp_path, "annotations", 1)
    annotate(tmp_path, "train", 2)
    d = dataset_folder.read(tmp_path / name)
    assert [len(i.instances) for i in d.images] == [1]
    (problem,) = d.problems
    assert (problem.code, problem.severity) == ("image-duplicate", "error")
    assert problem.where in ("train.xml", "train.json")
    assert "1 picture(s)" in problem.found and "2 object(s)" in problem.found


@pytest.mark.parametrize("name", ["cvat", "label-studio"])
def test_many_warnings_stay_warnings(tmp_path: Path, name: str) -> None:
    for tool in ("cvat", "label-studio"):
        picture(tmp_path / tool / "images" / "train" / "a.png", 1)
    box = '<box label="Car" xtl="60" ytl="2" xbr="70" ybr="6"/>'
    text = (
        f'<annotations><image id="0" name="a.png" subset="train" width="64" height="48">{box * 7}</image></annotations>'
    )
    (tmp_path / "cvat" / "train.xml").write_text(text)
    value = {"x": 90, "y": 20, "width": 30, "height": 20, "rectanglelabels": ["Car"]}
    result = {"type": "rectanglelabels", "original_width": 64, "original_height": 48, "value": value}
    task = {"data": {"image": "images/train/a.png"}, "annotations": [{"result": [result] * 7}]}
    (tmp_path / "label-studio" / "train.json").write_text(json.dumps([task]))
    d = dataset_folder.read(tmp_path / name)
    assert [(p.code, p.severity) for p in d.problems] == [("box-clipped", "warning")] * 7


def test_both_hold_a_turned_box_to_a_millionth_of_a_pixel(tmp_path: Path) -> None:
    angle, half = 0.7, np.array([[-9.0, -4.0], [9.0, -4.0], [9.0, 4.0], [-9.0, 4.0]])
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    corners = half @ turn + np.array([30.3, 22.2])
    box = np.concatenate([corners.min(axis=0), corners.max(axis=0)])
    path = picture(tmp_path / "a.png", 1)
    image = ImageRecord("a", path, "train", (64, 48), (Instance("Car", box, corners),))
    for name, module in (("cvat", cvat), ("label-studio", label_studio)):
        module.write(tmp_path / name, [image], [Category(0, "Car")])
        (found,) = dataset_folder.read(tmp_path / name).images[0].instances
        assert found.corners_xy is not None
        assert min(np.abs(np.roll(found.corners_xy, k, axis=0) - corners).max() for k in range(4)) < 1e-6


def test_coco_for_tools_counts_from_one_and_outlines_only_masks(tmp_path: Path) -> None:
    images, categories = records(tmp_path / "source")
    done = writing.write("coco-tools", tmp_path / "out", images, categories)
    assert not done.losses
    top = json.loads((tmp_path / "out" / "annotations" / "instances_train.json").read_text())
    assert [c["id"] for c in top["categories"]] == [1, 2, 3, 4, 5]
    assert [("segmentation" in a, a["category_id"]) for a in top["annotations"]] == [(False, 2), (False, 5), (True, 1)]
    assert coco.read(tmp_path / "out").images[0].instances[0].category == "Car"


def test_rf_detr_finds_a_file_beside_the_pictures_of_each_split(tmp_path: Path) -> None:
    images, categories = records(tmp_path / "source")
    images = [replace(image, split=split) for image, split in zip(images, SPLITS, strict=False)]
    done = writing.write("rf-detr", tmp_path / "out", images, categories)
    assert not done.losses
    for image in images:
        folder = tmp_path / "out" / {"train": "train", "val": "valid", "test": "test"}[image.split]
        top = json.loads((folder / "_annotations.coco.json").read_text())
        assert [folder / i["file_name"] for i in top["images"]] == [folder / image.name]
        assert (folder / image.name).read_bytes() == image.path.read_bytes()
    found = dataset_folder.read(tmp_path / "out")
    assert [(i.split, [o.category for o in i.instances]) for i in found.images] == [
        (i.split, [o.category for o in i.instances]) for i in images
    ]
