"""Masks as pictures with tables: numbers, overlaps, invalid input."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from infrablend.core.dataset import Category, ImageRecord, Instance
from infrablend.core.rle_masks import Mask
from infrablend.errors import DatasetError
from infrablend.formats.labels import masks
from tests.samples import SAMPLES, picture

BOX = np.array([10.0, 20.0, 18.0, 25.0])


def mask(x0: int, x1: int) -> Mask:
    pixels = np.zeros((48, 64), np.bool_)
    pixels[20:25, x0:x1] = True
    return Mask.from_array(pixels)


def test_numbers_say_which_object_and_the_later_one_wins(tmp_path: Path) -> None:
    objects = (Instance("a", BOX, mask=mask(10, 18)), Instance("b", BOX), Instance("b", BOX, mask=mask(15, 22)))
    image = ImageRecord("x", picture(tmp_path / "x.jpg", 1), "val", (64, 48), objects)
    written = masks.write(tmp_path / "out", [image], [Category(3, "a"), Category(4, "b")])
    assert written.losses == {"mask_absent": 1, "mask_overlap_px": 15}
    with Image.open(tmp_path / "out/masks/val/x.png") as png:
        assert png.mode.startswith("I;16")
        numbers = np.array(png)
    assert {n: int((numbers == n).sum()) for n in (1, 2, 3)} == {1: 25, 2: 0, 3: 35}
    table = json.loads((tmp_path / "out/masks/val/x.json").read_text())
    assert [(o["id"], o["category"], o["category_id"], o["area_px"], o["has_mask"]) for o in table["objects"]] == [
        (1, "a", 3, 25, True), (2, "b", 4, 0, False), (3, "b", 4, 35, True),
    ]  # fmt: skip
    (again,) = masks.read(tmp_path / "out").images
    assert [i.mask is not None and i.mask.area_px for i in again.instances] == [25, False, 35]


def test_more_objects_than_a_byte_holds(tmp_path: Path) -> None:
    objects = []
    for n in range(300):
        pixels = np.zeros((48, 64), np.bool_)
        pixels[n // 60, n % 60] = True
        box = np.array([n % 60, n // 60, n % 60 + 1, n // 60 + 1], np.float64)
        objects.append(Instance("a", box, mask=Mask.from_array(pixels)))
    image = ImageRecord("x", picture(tmp_path / "x.jpg", 1), "val", (64, 48), tuple(objects))
    assert masks.write(tmp_path / "out", [image], [Category(0, "a")]).losses == {}
    (again,) = masks.read(tmp_path / "out").images
    assert [i.mask for i in again.instances] == [i.mask for i in objects]


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return SAMPLES["masks"](tmp_path / "data")


def edit(path: Path, **changes: object) -> None:
    table = json.loads(path.read_text())
    table.update(changes)
    path.write_text(json.dumps(table))


def edit_object(path: Path, number: int, **changes: object) -> None:
    table = json.loads(path.read_text())
    table["objects"][number].update(changes)
    path.write_text(json.dumps(table))


TABLE = "masks/train/0_60_30_0_00001.json"


@pytest.mark.parametrize(
    ("damage", "code", "objects"),
    [
        (lambda d: edit_object(d / TABLE, 0, id=2), "annotation-malformed", 2),
        (lambda d: edit_object(d / TABLE, 0, box_xyxy=[1, 2, 3]), "annotation-malformed", 2),
        (lambda d: edit_object(d / TABLE, 0, box_xyxy=[5, 5, 2, 9]), "box-empty", 2),
        (lambda d: edit_object(d / TABLE, 0, category="lorry"), "category-unknown", 2),
        (lambda d: edit_object(d / TABLE, 0, category=["Car"]), "category-unknown", 2),
        (lambda d: edit(d / TABLE, file_name="../x.jpg"), "name-climbs", None),
        (lambda d: edit(d / TABLE, file_name="none.jpg"), "image-missing", None),
        (lambda d: edit(d / TABLE, width=0), "annotation-layout", None),
        (lambda d: edit(d / TABLE, objects={}), "annotation-layout", None),
        (lambda d: (d / TABLE).write_text("{"), "annotation-not-json", None),
        (lambda d: (d / TABLE).with_suffix(".png").unlink(), "image-missing", 3),
        (lambda d: picture((d / TABLE).with_suffix(".png"), 1, (64, 40)), "image-size", 3),
    ],
)
def test_damage_is_named_and_the_rest_is_read(data: Path, damage, code: str, objects: int | None) -> None:
    damage(data)
    found = masks.read(data)
    errors = [p for p in found.problems if p.severity == "error"]
    assert [p.code for p in errors] == [code]
    assert errors[0].where.startswith("masks/train/0_60_30_0_00001.")
    read = {i.name: len(i.instances) for i in found.images}
    assert len(read) == (3 if objects is None else 4)
    assert read.get("0_60_30_0_00001.jpg") == objects


def test_values_without_an_object_are_reported(data: Path) -> None:
    table = json.loads((data / TABLE).read_text())
    table["objects"] = table["objects"][:2]
    (data / TABLE).write_text(json.dumps(table))
    assert [(p.code, p.severity) for p in masks.read(data).problems] == [("mask-unknown", "warning")]


def test_a_list_of_categories_is_needed(data: Path) -> None:
    (data / "categories.json").write_text('{"categories": [{"id": 1}, {"id": 1, "name": "a"}]}')
    with pytest.raises(DatasetError, match="category 0"):
        masks.read(data)


def test_a_mask_of_another_size_is_refused(tmp_path: Path) -> None:
    instance = Instance("a", BOX, mask=Mask.from_array(np.ones((4, 4), np.bool_)))
    image = ImageRecord("x", picture(tmp_path / "x.jpg", 1), "val", (64, 48), (instance,))
    with pytest.raises(ValueError, match="mask of"):
        masks.write(tmp_path / "out", [image], [Category(0, "a")])
