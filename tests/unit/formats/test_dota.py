"""DOTA: reading, invalid input, writing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from infrablend.core.dataset import Category, ImageRecord, Instance
from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder
from infrablend.formats.labels import dota
from tests.samples import picture

GOOD = "2 3 12 3 12 9 2 9 ship 0\n"


def folder(root: Path, texts: dict[str, str]) -> Path:
    """A picture and a label file for every `split/stem`."""
    for k, (key, text) in enumerate(texts.items()):
        split, stem = key.split("/")
        picture(root / split / "images" / f"{stem}.png", k)
        (root / split / "labelTxt").mkdir(exist_ok=True)
        (root / split / "labelTxt" / f"{stem}.txt").write_text(text)
    return root


def codes(root: Path) -> list[tuple[str, str]]:
    return [(p.code, p.severity) for p in dota.read(root).problems]


def test_headers_flags_and_corners(tmp_path: Path) -> None:
    text = (
        "imagesource:GoogleEarth\ngsd:0.25\n"
        + GOOD
        + "20 20 30 20 30 26 20 26 small-vehicle 2\n40 5 50 5 50 9 40 9 ship\n"
    )
    (image,) = dota.read(folder(tmp_path, {"train/P1": text})).images
    assert image.extra == {"imagesource": "GoogleEarth", "gsd": "0.25"}
    assert [(i.category, i.difficult) for i in image.instances] == [
        ("ship", False),
        ("small-vehicle", True),
        ("ship", None),
    ]
    assert image.instances[0].box_xyxy.tolist() == [2, 3, 12, 9]
    assert image.instances[0].corners_xy is not None
    assert image.instances[0].corners_xy.tolist() == [[2, 3], [12, 3], [12, 9], [2, 9]]
    dota.write(tmp_path / "out", [image], (Category(0, "ship"), Category(1, "small-vehicle")))
    lines = (tmp_path / "out/train/labelTxt/P1.txt").read_text().splitlines()
    assert lines[:2] == ["imagesource:GoogleEarth", "gsd:0.25"]
    assert [line.split()[-1] for line in lines[2:]] == ["0", "2", "0"]


def test_counter_clockwise_corners_are_turned_round(tmp_path: Path) -> None:
    (image,) = dota.read(folder(tmp_path, {"train/P1": "2 3 2 9 12 9 12 3 ship 0\n"})).images
    assert image.instances[0].corners_xy is not None
    assert image.instances[0].corners_xy.tolist() == [[2, 3], [12, 3], [12, 9], [2, 9]]


@pytest.mark.parametrize(
    ("line", "code", "severity", "kept"),
    [
        ("1 2 3 4 ship 0", "label-malformed", "error", 0),
        ("2 3 12 3 12 9 2 9 my ship 0", "label-malformed", "error", 0),
        ("2 3 12 3 12 9 2 nine ship 0", "label-malformed", "error", 0),
        ("2 3 12 3 12 9 2 9 ship 7", "label-malformed", "error", 0),
        ("2 3 nan 3 12 9 2 9 ship 0", "box-not-finite", "error", 0),
        ("2 3 2 3 2 9 2 9 ship 0", "box-empty", "error", 0),
        ("99 3 110 3 110 9 99 9 ship 0", "box-outside", "error", 0),
        ("-3 3 12 3 12 9 -3 9 ship 0", "box-overhang", "warning", 1),
        ("-0.4 3 12 3 12 9 -0.4 9 ship 0", None, None, 1),
    ],
)
def test_every_invalid_line_is_reported(
    line: str, code: str | None, severity: str | None, kept: int, tmp_path: Path
) -> None:
    data = dota.read(folder(tmp_path, {"train/P1": f"gsd:null\n{line}\n{GOOD}"}))
    assert len(data.images[0].instances) == kept + 1
    assert [(p.code, p.severity) for p in data.problems] == ([] if code is None else [(code, severity)])
    assert all(p.where == "train/labelTxt/P1.txt: line 2" for p in data.problems)


def test_pictures_and_labels_that_lack_each_other(tmp_path: Path) -> None:
    root = folder(tmp_path, {"train/P1": GOOD, "train/P2": GOOD})
    (root / "train/images/P2.png").unlink()
    picture(root / "train/images/P3.png", 3)
    picture(root / "train/images/P1.jpg", 3)
    data = dota.read(root)
    assert {(p.code, p.severity) for p in data.problems} == {
        ("image-duplicate", "error"), ("image-missing", "error"), ("label-missing", "warning"),
    }  # fmt: skip
    assert [i.id for i in data.images] == ["P1", "P3"]


def test_repeated_line_is_kept_with_a_warning(tmp_path: Path) -> None:
    assert codes(folder(tmp_path, {"train/P1": GOOD + GOOD})) == [("object-duplicate", "warning")]


@pytest.mark.parametrize("layout", ["labelTxt-v1.5/labelTxt", "annfiles"])
def test_other_layouts(layout: str, tmp_path: Path) -> None:
    root = folder(tmp_path, {"train/P1": GOOD, "val/P2": ""})
    for split in ("train", "val"):
        (root / split / layout).parent.mkdir(exist_ok=True)
        (root / split / "labelTxt").rename(root / split / layout)
    assert [(i.split, len(i.instances)) for i in dataset_folder.read(root).images] == [("train", 1), ("val", 0)]


def test_splits_below_the_kinds_and_no_splits_at_all(tmp_path: Path) -> None:
    for base, split in ((tmp_path / "a", "/val"), (tmp_path / "b", "")):
        picture(base / f"images{split}/P1.png", 1)
        (base / f"labelTxt{split}").mkdir(parents=True)
        (base / f"labelTxt{split}/P1.txt").write_text(GOOD)
        (image,) = dataset_folder.read(base).images
        assert (image.split, len(image.instances)) == (split[1:] or "train", 1)


def test_no_label_folder_is_an_error(tmp_path: Path) -> None:
    picture(tmp_path / "train/images/a.png", 1)
    with pytest.raises(DatasetError, match="no labelTxt or annfiles"):
        dota.read(tmp_path)


def test_names_without_blanks_stay_apart() -> None:
    categories = [Category(0, "big car"), Category(1, "big-car"), Category(2, "big\tcar")]
    assert dota.dota_names(categories) == {"big car": "big-car-2", "big-car": "big-car", "big\tcar": "big-car-3"}


def test_numbers_are_short_and_exact(tmp_path: Path) -> None:
    corners = np.array([[-1e-12, 0.1 + 0.2], [12.0, 0.3], [12.0, 1 / 3], [0.0, 1 / 3]])
    instance = Instance("a", np.array([0.0, 0.3, 12.0, 1 / 3]), corners)
    image = ImageRecord("x", picture(tmp_path / "x.png", 1), "train", (64, 48), (instance,))
    dota.write(tmp_path / "out", [image], [Category(0, "a")])
    line = (tmp_path / "out/train/labelTxt/x.txt").read_text().splitlines()[2]
    assert line == "0.0 0.3 12.0 0.3 12.0 0.33333333 0.0 0.33333333 a 0"
