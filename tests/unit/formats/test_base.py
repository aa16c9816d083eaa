"""What all formats share: splits stated by names, shortened lists of problems, corners in clockwise order."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from infrablend.core.boxes import corners_of_cxcywha, polygon_area
from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, ImageRecord, Instance
from infrablend.core.format_table import WRITERS
from infrablend.errors import Problem
from infrablend.formats import dataset_folder, writing
from infrablend.formats.base import shorten, split_of_stem
from infrablend.formats.box_checks import clockwise_corners
from infrablend.formats.read_write import Reading
from infrablend.formats.records import Findings
from tests.samples import picture


@pytest.mark.parametrize(
    ("split", "stems"),
    {
        "train": (
            "train", "instances_train", "instances_train2017", "train2017", "annotations", "training", "valley_train",
            "valley", "interval", "latest", "contest", "greatest_hits", "trainval", "labels", "runway_04", "préval",
            "project-1-at-2026-01-31-10-20-5ce7de5f", "train_val_split", "",
        ),
        "val": (
            "val", "VAL", "instances_val2017", "val2017", "valid", "Validation", "instances_minival2014", "eval",
            "monet_val", "instancesVal", "my-val.1",
        ),
        "test": ("test", "instances_test", "image_info_test-dev2017", "Test", "testing", "TestSet", "person_test2017"),
    }.items(),
)  # fmt: skip
def test_the_split_is_a_whole_word_of_the_name(split: str, stems: tuple[str, ...]) -> None:
    assert {s: split_of_stem(s) for s in stems} == dict.fromkeys(stems, split)


def test_shortened_warnings_are_no_error() -> None:
    warning = Problem("a", "box-clipped", "x", severity="warning")
    assert [p.severity for p in shorten([warning] * 7)] == ["warning"] * 6
    assert shorten([warning] * 7)[-1].found == "2 more box-clipped"
    error = Problem("a", "box-empty", "x")
    assert shorten([*[warning] * 7, *[error] * 6])[-1] == Problem(
        "elsewhere", "more", "2 more box-clipped, 1 more box-empty"
    )
    assert shorten([warning, error]) == [warning, error]


# Any rectangle, with its corners in either direction.
TURNED = corners_of_cxcywha(np.array([30.5, 22.25, 16.0, 6.0, 0.4]))
BACK = TURNED[[0, 3, 2, 1]]


def test_corners_that_run_the_other_way_are_reversed() -> None:
    assert polygon_area(BACK) < 0
    assert clockwise_corners(BACK).tolist() == TURNED.tolist() == clockwise_corners(TURNED).tolist()
    odd = np.array([[np.nan, 0], [1, 0], [1, 1], [0, 1]])
    assert clockwise_corners(odd) is odd


@pytest.mark.parametrize("name", ["yolo-obb", "dota", "coco", "monet", "huggingface", "masks"])
def test_corners_are_clockwise_whatever_a_file_says(name: str, tmp_path: Path) -> None:
    """Other tools write corners the other way round; evaluation would take such a box for one without area."""
    assert name in {w.name for w in WRITERS}
    box = np.array([*TURNED.min(axis=0), *TURNED.max(axis=0)])
    path = picture(tmp_path / "a.png", 1)
    image = ImageRecord(
        "a",
        path,
        "train",
        (64, 48),
        (Instance("Car", box, BACK),),
        capture=Capture(pitch_deg=60.0, altitude_m=50.0, time_of_day="day"),
        file_name="a.png",
    )
    writing.write(name, tmp_path / "out", [image], [Category(0, "Car")])
    options = {"pitch_sign": "-1"} if name == "monet" else {}
    (again,) = dataset_folder.read(tmp_path / "out", Reading(options=options)).images
    corners = again.instances[0].corners_xy
    assert corners is not None and polygon_area(corners) > 0
    np.testing.assert_allclose(corners, TURNED, atol=1e-6)


def test_rectangles_of_negative_width_are_clockwise(tmp_path: Path) -> None:
    """Tools that draw boxes may count from another corner than the upper left one."""
    picture(tmp_path / "cvat" / "images" / "a.png", 1)
    shape = '<box label="Car" xtl="40" ytl="10" xbr="20" ybr="20" rotation="30"/>'
    text = f'<annotations><image id="0" name="a.png" width="64" height="48">{shape}</image></annotations>'
    (tmp_path / "cvat" / "annotations.xml").write_text(text)
    picture(tmp_path / "ls" / "images" / "a.png", 1)
    value = {"x": 60, "y": 20, "width": -30, "height": 20, "rotation": 30, "rectanglelabels": ["Car"]}
    result = {"type": "rectanglelabels", "original_width": 64, "original_height": 48, "value": value}
    task = {"data": {"image": "images/a.png"}, "annotations": [{"result": [result]}]}
    (tmp_path / "ls" / "train.json").write_text(json.dumps([task]))
    for name in ("cvat", "ls"):
        (car,) = dataset_folder.read(tmp_path / name).images[0].instances
        assert car.corners_xy is not None and polygon_area(car.corners_xy) > 0


def test_of_two_pictures_of_one_name_the_second_is_counted_as_left_out(tmp_path: Path) -> None:
    """Such as crops of `a.jpg` and `a.png` in a cache, whose paths are outside the dataset."""
    o = Instance("deer", np.array([1.0, 2, 3, 4]))
    first, second = (
        ImageRecord("", Path(f"/cache/{n}.png"), "train", (9, 9), (o,) * n, file_name="a.png") for n in (1, 2)
    )
    found = Findings(tmp_path)
    (kept,) = found.dataset("coco", [first, second], [Category(0, "deer")], {}).images
    assert kept.path == first.path
    (problem,) = found.problems
    assert problem.code == "image-duplicate" and "2 object(s)" in problem.found
