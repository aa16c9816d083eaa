"""VisDrone-DET: regions to ignore, boxes that do not count, flags, splits, and what is wrong with lines."""

from __future__ import annotations

from pathlib import Path

import pytest

from infrablend.core.dataset import Dataset
from infrablend.formats import dataset_folder
from infrablend.formats.read_write import Reading
from tests.command_line import run
from tests.samples import codes, picture

STEM = "0000137_02220_d_0000163"


def dataset(folder: Path, text: str, stem: str = STEM) -> Dataset:
    picture(folder / "images" / f"{stem}.jpg", 0)
    (folder / "annotations").mkdir(parents=True, exist_ok=True)
    (folder / "annotations" / f"{stem}.txt").write_text(text)
    return dataset_folder.read(folder)


def test_every_class_and_flag(tmp_path: Path) -> None:
    lines = "\n".join(f"{3 * k},4,9,8,{int(k not in (0, 11))},{k},{k % 2},{k % 3}" for k in range(12))
    d = dataset(tmp_path / "VisDrone2019-DET-test-dev", lines)
    assert d.format == "visdrone" and not d.problems
    (image,) = d.images
    assert image.split == "test" and image.capture.sequence == "0000137" and image.extra == {"modality": "visible"}
    assert [o.category for o in image.instances] == [c.name for c in d.categories]
    assert [c.name for c in d.categories if c.ignore] == ["ignored regions", "others"]
    car = image.instances[4]
    assert car.category == "car" and car.box_xyxy.tolist() == [12, 4, 21, 12]
    assert (car.truncated, car.extra) == (False, {"occluded": True, "occlusion": 1})
    assert image.instances[3].truncated is True and image.instances[3].extra["occluded"] is False


def test_a_box_that_does_not_count_is_a_region_to_ignore(tmp_path: Path) -> None:
    d = dataset(tmp_path, "3,4,9,8,0,4,0,0\n13,4,9,8,1,4,-1,-1\n")
    ignored, car = d.images[0].instances
    assert ignored.category == "ignored regions" and ignored.extra["category"] == "car"
    assert car.category == "car" and car.truncated is None and car.extra == {}
    assert d.notes["rows"]["ignored"] == 1


def test_lines_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    d = dataset(tmp_path, "3,4,9,8,1,4,0,0,\n3,4,9\n3,4,9,8,1,12,0,0\n3,4,9,0,1,4,0,0\n900,4,9,8,1,4,0,0\n")
    assert codes(d) == ["label-malformed", "category-unknown", "box-empty", "box-outside"]
    assert [p.where for p in d.problems] == [f"annotations/{STEM}.txt: line {n}" for n in (2, 3, 4, 5)]
    assert d.notes["rows"]["objects"] == 5 and d.notes["rows"]["read"] == 1


def test_folders_of_several_splits_and_pictures_without_labels(tmp_path: Path) -> None:
    dataset(tmp_path / "VisDrone2019-DET-train", "3,4,9,8,1,4,0,0\n")
    dataset(tmp_path / "raw" / "VisDrone2019-DET-val", "3,4,9,8,1,4,0,0\n", "own")
    picture(tmp_path / "VisDrone2019-DET-test-challenge" / "images" / "b.jpg", 1)
    (tmp_path / "VisDrone2019-DET-train" / "annotations" / "gone.txt").write_text("3,4,9,8,1,4,0,0\n")
    d = dataset_folder.read(tmp_path)
    assert [(i.split, i.name, len(i.instances)) for i in d.images] == [
        ("train", f"{STEM}.jpg", 1), ("val", "own.jpg", 1), ("test", "b.jpg", 0),
    ]  # fmt: skip
    assert "modality" not in d.images[1].extra  # someone's own pictures in this layout
    assert codes(d) == ["image-missing"] and codes(d, "warning") == ["label-missing"]
    assert len(dataset_folder.read(tmp_path, Reading(options={"unlabelled": "drop"})).images) == 2


@pytest.mark.parametrize("text", ["98,0,808,1,47,22,1,4,0,0\n", "0.5 0.5 0.1 0.1\n", ""])
def test_other_text_files_in_annotations_are_named(tmp_path: Path, text: str) -> None:
    d = dataset(tmp_path, text)
    assert d.format == "folder" and codes(d) == ["label-unread"]


def test_converted_to_coco_it_keeps_regions_to_ignore(tmp_path: Path) -> None:
    dataset(tmp_path / "data", "3,4,9,8,0,0,0,0\n13,4,9,8,1,4,0,0\n")
    assert run("convert", tmp_path / "data", tmp_path / "out", "--to", "coco").exit_code == 0
    again = dataset_folder.read(tmp_path / "out")
    assert [(o.category, again.category(o.category).ignore) for o in again.images[0].instances] == [
        ("ignored regions", True), ("car", False),
    ]  # fmt: skip


def test_empty_files_come_first_and_a_text_for_people_lies_beside_them(tmp_path: Path) -> None:
    for k in range(25):
        label = tmp_path / "annotations" / f"{k:02}.txt"
        label.parent.mkdir(exist_ok=True)
        label.write_text("\n" * (k % 2))
        picture(tmp_path / "images" / f"{k:02}.jpg", 0)
    (tmp_path / "annotations" / "README.txt").write_text("Boxes are left, top, width and height.\n")
    d = dataset(tmp_path, "3,4,9,8,1,4,0,0\n", "z")
    assert d.format == "visdrone" and not d.problems and len(d.images) == 26
