"""Regions to ignore and COCO's crowds in formats that cannot mark them: left out or written as objects, and counted."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, ImageRecord, Instance
from infrablend.core.format_table import WRITERS
from infrablend.formats import dataset_folder, writing
from infrablend.formats.read_write import Reading, WriteSettings
from tests.samples import picture

CATEGORIES = (Category(0, "Person"), Category(1, "Logo", ignore=True), Category(4, "DontCare", ignore=True))
BOX = np.array([10.0, 20.0, 18.0, 25.0])
PERSON = Instance("Person", BOX)
CROWD = Instance("Person", np.array([30.0, 20.0, 50.0, 40.0]), extra={"iscrowd": 1})
# COCO marks both alike, so its reader gives them both fields.
LOGO = Instance("Logo", np.array([0.0, 0.0, 8.0, 8.0]), extra={"iscrowd": 1})
DONT_CARE = Instance("DontCare", np.array([52.0, 0.0, 60.0, 8.0]), extra={"iscrowd": 1})

every_writer = pytest.mark.parametrize("name", [w.name for w in WRITERS])
DROP = ("anti-uav", "yolo", "yolo-obb", "yolo-seg", "birdsai")
HOLD = ("coco", "coco-tools", "rf-detr", "monet", "mot")


def write(name: str, folder: Path, *objects: Instance, keep: bool = False) -> tuple[Mapping[str, int], list[Instance]]:
    """Return the losses by kind, of HIT-UAV's forms the largest, and the objects read again."""
    path = picture(folder / "0_60_30_0_00001.png", 1)
    image = ImageRecord(
        path.stem,
        path,
        "train",
        (64, 48),
        objects,
        capture=Capture(pitch_deg=30.0, altitude_m=60.0, time_of_day="day"),
        file_name=path.name,
    )
    settings = WriteSettings(without_mask="obb", dont_care="keep" if keep else "drop")
    written = writing.write(name, folder / "out", [image], CATEGORIES, settings=settings)
    losses: dict[str, int] = {}
    for kind, n in written.losses.items():
        losses[kind.rpartition(".")[2]] = max(n, losses.get(kind.rpartition(".")[2], 0))
    options = {"pitch_sign": "-1"} if name == "monet" else {}
    again = dataset_folder.read(folder / "out", Reading(options=options))
    return losses, list(again.images[0].instances)


@every_writer
def test_a_crowd_is_held_or_left_out_or_counted_as_an_object(name: str, tmp_path: Path) -> None:
    losses, objects = write(name, tmp_path, PERSON, CROWD)
    if name in HOLD:
        assert [i.extra.get("iscrowd") for i in objects] == [None, 1]
        assert not {"ignore_dropped", "ignore_as_class"} & set(losses)
    elif name in DROP:
        assert len(objects) == 1 and losses["ignore_dropped"] == 1 and "ignore_as_class" not in losses
    else:
        assert len(objects) == 2 and losses["ignore_as_class"] == 1 and "ignore_dropped" not in losses


@pytest.mark.parametrize("name", DROP)
def test_a_crowd_that_is_kept_is_counted(name: str, tmp_path: Path) -> None:
    losses, objects = write(name, tmp_path, PERSON, CROWD, LOGO, DONT_CARE, keep=True)
    assert len(objects) == 4 and losses["ignore_as_class"] == 1 and "ignore_dropped" not in losses


@every_writer
def test_regions_of_a_category_are_counted_unless_the_format_tells_them(name: str, tmp_path: Path) -> None:
    """`DontCare` is one by its name in every format; `Logo` only where the format has a mark for categories."""
    losses, objects = write(name, tmp_path, PERSON, LOGO, DONT_CARE)
    if name in DROP:
        assert len(objects) == 1 and losses["ignore_dropped"] == 2
    else:
        marked = name in (*HOLD, "masks", "huggingface")
        assert len(objects) == 3 and losses.get("ignore_as_class", 0) == (0 if marked else 1)


@every_writer
def test_objects_are_not_counted(name: str, tmp_path: Path) -> None:
    losses, objects = write(name, tmp_path, PERSON, replace(PERSON, extra={"iscrowd": 0}, box_xyxy=BOX + 10))
    assert len(objects) == 2 and not {"ignore_dropped", "ignore_as_class"} & set(losses)


def test_crowds_of_a_coco_file_do_not_become_objects_of_yolo(tmp_path: Path) -> None:
    picture(tmp_path / "in" / "images" / "a.png", 1)
    top = {
        "images": [{"id": 1, "file_name": "a.png", "width": 64, "height": 48}],
        "annotations": [
            {"id": k, "image_id": 1, "category_id": 1, "bbox": [10 * k, 5, 8, 8], "iscrowd": int(k > 1)}
            for k in (1, 2, 3)
        ],
        "categories": [{"id": 1, "name": "Person"}],
    }
    (tmp_path / "in" / "train.json").write_text(json.dumps(top))
    source = dataset_folder.read(tmp_path / "in")
    written = writing.write("yolo", tmp_path / "out", source.images, source.categories)
    assert written.losses["ignore_dropped"] == 2
    assert len((tmp_path / "out" / "labels" / "train" / "a.txt").read_text().splitlines()) == 1
