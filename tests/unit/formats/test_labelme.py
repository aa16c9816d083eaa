"""labelme: kinds of shapes, groups, pictures by path and by name, and what is wrong with files."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from infrablend.core.dataset import Dataset, Instance
from infrablend.formats import dataset_folder
from tests.samples import codes, picture


def shape(kind: str | None, *points: list[float], label: Any = "deer", **fields: Any) -> dict[str, Any]:
    return {"label": label, "points": list(points), "group_id": None, "shape_type": kind, "flags": {}, **fields}


def write(path: Path, *shapes: Any, image: str = "f.png", **fields: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    top = {"version": "5.5.0", "flags": {}, "shapes": list(shapes), "imagePath": image, "imageData": None}
    path.write_text(json.dumps({**top, "imageHeight": 48, "imageWidth": 64, **fields}))


def read(folder: Path, *shapes: Any, **fields: Any) -> Dataset:
    picture(folder / "f.png", 0)
    write(folder / "f.json", *shapes, **fields)
    return dataset_folder.read(folder)


def objects(d: Dataset) -> tuple[Instance, ...]:
    assert d.format == "labelme" and not codes(d), d.problems
    return d.images[0].instances


def png(pixels: Any) -> str:
    stream = io.BytesIO()
    Image.fromarray(np.array(pixels, np.uint8)).save(stream, "PNG")
    return base64.b64encode(stream.getvalue()).decode()


def test_every_kind_of_shape(tmp_path: Path) -> None:
    turned = [[10, 20], [14, 24], [12, 26], [8, 22]]
    d = read(
        tmp_path,
        shape("rectangle", [14, 9.5], [4, 20]),
        shape("rectangle", [4, 9], [14, 9], [14, 20], [4, 20]),  # X-AnyLabeling
        shape(None, [30, 10], [50, 10], [50, 30]),
        shape("circle", [40, 24], [40, 28]),
        shape("mask", [60, 44], [63, 45], mask=png([[1, 0, 1, 1, 1], [0, 1, 0, 0, 0]])),
        shape("rotation", *turned, difficult=True),
        shape("oriented_rectangle", *turned[::-1], flags={"occluded": True}),
    )
    box, four, polygon, circle, mask, turned_box, other = objects(d)
    assert box.box_xyxy.tolist() == [4, 9.5, 14, 20] and box.mask is None and box.corners_xy is None
    assert four.box_xyxy.tolist() == [4, 9, 14, 20]
    assert polygon.box_xyxy.tolist() == [30, 10, 50, 30] and polygon.mask is not None
    assert polygon.mask.area_px == pytest.approx(200, abs=20)
    assert circle.box_xyxy.tolist() == pytest.approx([36, 20, 44, 28], abs=0.01) and circle.mask is not None
    assert mask.box_xyxy.tolist() == [60, 44, 64, 46] and mask.mask is not None and mask.mask.area_px == 4  # cut off
    assert turned_box.corners_xy is not None and turned_box.corners_xy.tolist() == turned and turned_box.difficult
    assert other.corners_xy is not None and other.extra == {"occluded": True}
    assert other.box_xyxy.tolist() == [8, 20, 14, 26]


def test_shapes_without_an_area_are_counted_by_kind(tmp_path: Path) -> None:
    kinds: tuple[Any, ...] = ("point", "line", "linestrip", "points", "cuboid", ["box"])
    d = read(tmp_path, *(shape(k, [1, 1]) for k in kinds), shape("line", [1, 1], [2, 2]))
    assert codes(d, "warning") == ["kind-unread"] and objects(d) == ()
    assert "1 ['box'], 1 cuboid, 2 line, 1 linestrip, 1 point, 1 points" in d.problems[0].found


def test_outlines_of_a_group_are_one_object(tmp_path: Path) -> None:
    parts = [shape("polygon", [x, 10], [x + 8, 10], [x + 8, 20], [x, 20], group_id=3) for x in (10, 30)]
    boxes = [shape("rectangle", [x, 30], [x + 4, 40], group_id=3) for x in (10, 30)]
    joined, *rest = objects(
        read(tmp_path, *parts, *boxes, shape("polygon", *parts[0]["points"], label="fox", group_id=3))
    )
    assert joined.box_xyxy.tolist() == [10, 10, 38, 20] and joined.mask is not None and joined.mask.area_px == 160
    assert [o.category for o in rest] == ["deer", "deer", "fox"]


def test_the_label_ignore_marks_regions(tmp_path: Path) -> None:
    d = read(tmp_path, shape("rectangle", [1, 1], [5, 5], label="__ignore__"), shape("rectangle", [9, 1], [15, 5]))
    assert [(c.name, c.ignore) for c in d.categories] == [("__ignore__", True), ("deer", False)]


@pytest.mark.parametrize("said", ["..\\images\\a.png", "/mnt/old/a.png", "C:\\old\\b.png", "a.png", "../../a.png"])
def test_the_picture_is_found_by_path_or_by_the_name_of_the_file(tmp_path: Path, said: str) -> None:
    picture(tmp_path / "images" / "a.png", 0)
    write(tmp_path / "annotations" / "a.json", shape("rectangle", [1, 1], [5, 5]), image=said)
    d = dataset_folder.read(tmp_path)
    assert len(objects(d)) == 1 and d.images[0].name == "a.png" and not d.problems


def test_splits_pictures_without_a_file_and_files_without_a_picture(tmp_path: Path) -> None:
    read(tmp_path / "train", shape("rectangle", [1, 1], [5, 5]))
    picture(tmp_path / "val" / "g.png", 1)
    write(tmp_path / "val" / "gone.json", image="gone.png", imageData="aGFsbG8=")
    write(tmp_path / "train" / "twice.json", shape("rectangle", [1, 1], [5, 5]))
    d = dataset_folder.read(tmp_path)
    assert [(i.split, i.name, i.extra) for i in d.images] == [
        ("train", "f.png", {}),
        ("val", "g.png", {"labelled": False}),
    ]
    assert sorted(codes(d)) == ["image-duplicate", "image-missing"] and codes(d, "warning") == ["label-missing"]
    assert any("inside this file" in p.found for p in d.problems)


def test_malformed_shapes_are_named_and_the_others_read(tmp_path: Path) -> None:
    d = read(
        tmp_path,
        shape("rectangle", [1, 1], [5, 5]),
        7,
        shape("rectangle", [1, 1], [5, 5], label=None),
        shape("rectangle", [1, 1]),
        shape("polygon", [1, 1], [2, float("nan")], [4, 4]),
        shape("polygon", [1, 1], [1e5, 1], [4, 4]),
        shape("circle", [1, 1], ["a", 2]),
        shape("mask", [1, 1], [2, 2], mask="no PNG"),
        shape("mask", [100, 100], [102, 102], mask=png([[1]])),
        shape("mask", [0, 0], [2, 2], mask=png(np.ones((200, 200)))),
        shape("rectangle", [1, 1], [1, 5]),
    )
    assert codes(d) == ["annotation-malformed"] * 9 + ["box-empty"]
    assert len(d.images[0].instances) == 1 and d.problems[0].where == "f.json: shape 1"


def test_a_damaged_file_leaves_out_its_picture(tmp_path: Path) -> None:
    read(tmp_path, shape("rectangle", [1, 1], [5, 5]))
    picture(tmp_path / "g.png", 1)
    (tmp_path / "g.json").write_text((tmp_path / "f.json").read_text()[:-9])
    d = dataset_folder.read(tmp_path)
    assert [i.name for i in d.images] == ["f.png"] and codes(d) == ["annotation-not-json"]
    assert d.problems[0].where == "g.json"
