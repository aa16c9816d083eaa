"""BAMBI: flights, species, straight-down views; bad frames and boxes are left out one by one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from infrablend.core.dataset import Dataset
from infrablend.errors import DatasetError
from infrablend.formats import bambi, detection
from tests.samples import SAMPLES, picture


def codes(dataset: Dataset) -> list[str]:
    return sorted(p.code for p in dataset.problems)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    return SAMPLES["bambi"](tmp_path / "data")


def change(root: Path, flight: str, **values: Any) -> dict[str, Any]:
    """Replace values of a flight's file, and return its content."""
    path = root / f"{flight}_metadata.json"
    top: dict[str, Any] = json.loads(path.read_text()) | values
    path.write_text(json.dumps(top))
    return top


def test_flights_are_read_with_species_and_a_straight_down_view(data: Path) -> None:
    d = detection.read(data)
    assert d.format == "bambi" and d.problems == ()
    assert [(i.split, i.id, i.sequence, len(i.instances)) for i in d.images] == [
        ("train", "7_100", "7", 2), ("train", "7_101", "7", 0), ("test", "12_102", "12", 2),
    ]  # fmt: skip
    assert {(i.pitch_deg, i.altitude_m, i.captured) for i in d.images} == {(90.0, None, "2024-03-22")}
    assert [c.name for c in d.categories] == ["red deer", "wild boar"] and d.notes["pitch"] == "annotation"
    boar = d.images[0].instances[1]
    assert (boar.category, boar.source_id, boar.extra) == ("wild boar", 1, {"gender": 0, "age": 2, "visibility": 1})
    assert boar.box_xyxy.tolist() == [25, 6, 37, 14]
    assert d.notes["rows"] == {"flights": 2, "frames": 3, "objects": 4, "read": 4, "unlabelled": 0}
    only = detection.read(data, detection.Reading(splits=["test"]))
    assert [i.id for i in only.images] == ["12_102"] and only.categories == d.categories


def test_bad_annotations_are_left_out(data: Path) -> None:
    good = {"species": "Gamswild", "bbox": {"x_min": 1, "y_min": 2, "x_max": 70, "y_max": 9}}
    bad = [
        {"species": "Rotwild", "bbox": {"x_min": 1, "y_min": 2, "x_max": 1, "y_max": 9}},
        {"species": "Rotwild", "bbox": {"x_min": 1, "y_min": 2, "x_max": 9}},
        {"bbox": good["bbox"]},
        "deer",
    ]
    frames: dict[str, Any] = {
        "1": {"thermal_image": "7_100.jpg", "annotations": [good, *bad]},
        "2": {"thermal_image": "7_100.jpg", "annotations": []},
        "3": {"thermal_image": "7_999.jpg", "annotations": []},
        "4": {"thermal_image": "../rgb/7_100.jpg", "annotations": []},
        "5": {"thermal_image": "7_101.jpg"},
        "6": None,
    }
    change(data, "7", frames=frames)
    d = detection.read(data)
    assert [(i.id, [o.category for o in i.instances]) for i in d.images if i.split == "train"] == [
        ("7_100", ["Gamswild"])
    ]
    assert codes(d) == sorted([
        "box-clipped", "box-empty", *["annotation-layout"] * 4, "image-duplicate", "image-missing", "label-missing",
        "name-climbs", "name-missing",
    ])  # fmt: skip
    assert [c.name for c in d.categories] == ["red deer", "wild boar", "Gamswild"]


def test_a_file_without_frames_or_split_is_left_out(data: Path) -> None:
    change(data, "7", frames=[])
    (data / "9_metadata.json").write_text('{"flight_key": "9", "frames": ')
    d = detection.read(data)
    assert codes(d) == ["annotation-layout", "annotation-not-json", "label-missing"]
    change(data, "12", split="all")
    with pytest.raises(DatasetError, match="no picture to read"):
        bambi.read(data)


def test_pictures_that_no_file_lists(data: Path) -> None:
    picture(data / "thermal" / "99_1.jpg", 5)
    dropped, kept = detection.read(data), bambi.read(data, unlabelled="keep")
    assert len(dropped.images) == 3 and codes(dropped) == codes(kept) == ["label-missing"]
    (new,) = [i for i in kept.images if i.id == "99_1"]
    assert (new.split, new.extra) == ("train", {"labelled": False})


def test_a_table_replaces_the_straight_down_view(data: Path) -> None:
    (data / "metadata.csv").write_text("sequence,altitude_m,time_of_day\n7,60,day\n")
    (data / "other.csv").write_text("file,pitch_deg\n12_102,80\n")
    first = detection.read(data).images[0]
    assert (first.pitch_deg, first.altitude_m, first.time_of_day) == (90.0, 60.0, "day")
    again = bambi.read(data, metadata=data / "other.csv")
    assert [i.pitch_deg for i in again.images if i.id == "12_102"] == [80.0]


def test_real_frames(real_data: Path) -> None:
    d = detection.read(real_data / "bambi")
    assert d.format == "bambi" and d.problems == ()
    counts = {i.id: [o.category for o in i.instances] for i in d.images}
    assert counts == {"163_6395": ["red deer"] * 10, "277_6760": ["wild boar"] * 6}
    assert [i.captured for i in d.images] == ["2024-03-22", "2024-08-22"]
