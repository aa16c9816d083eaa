"""BAMBI: flights, species, straight-down views; bad frames and boxes are left out one by one."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from infrablend.core.dataset import Dataset
from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder
from infrablend.formats.published import bambi, bambi_tracks
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
    d = dataset_folder.read(data)
    assert d.format == "bambi" and d.problems == ()
    assert [(i.split, i.id, i.capture.sequence, len(i.instances)) for i in d.images] == [
        ("train", "7_100", "7", 2), ("train", "7_101", "7", 0), ("test", "12_102", "12", 2),
    ]  # fmt: skip
    assert {(i.capture.pitch_deg, i.capture.altitude_m, i.capture.captured) for i in d.images} == {
        (90.0, None, "2024-03-22")
    }
    assert [c.name for c in d.categories] == ["red deer", "wild boar"] and d.notes["pitch"] == "annotation"
    boar = d.images[0].instances[1]
    assert (boar.category, boar.source_id, boar.extra) == ("wild boar", 1, {"gender": 0, "age": 2, "visibility": 1})
    assert boar.box_xyxy.tolist() == [25, 6, 37, 14]
    assert d.notes["rows"] == {"flights": 2, "frames": 3, "objects": 4, "read": 4, "no_animal": 0, "unlabelled": 0}
    only = dataset_folder.read(data, dataset_folder.Reading(splits=["test"]))
    assert [i.id for i in only.images] == ["12_102"] and only.categories == d.categories


def test_species_in_other_languages_have_the_names_of_the_published_tracks(data: Path) -> None:
    box = {"x_min": 1, "y_min": 2, "x_max": 9, "y_max": 9}
    numbers = {"Steinwild": "Q168327", "Wildschwein": "Q58697", "Stein": "Q10738", "Marder": "Q0"}
    given = [{"species": name, "wikidata_id": number, "bbox": box} for name, number in numbers.items()]
    top = change(data, "7")
    top["frames"]["100"]["annotations"] = given
    change(data, "7", frames=top["frames"])
    d = dataset_folder.read(data)
    assert [o.category for o in d.images[0].instances] == ["alpine ibex", "wild boar", "Marder"]
    assert d.notes["rows"]["no_animal"] == 1


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
    d = dataset_folder.read(data)
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
    d = dataset_folder.read(data)
    assert codes(d) == ["annotation-layout", "annotation-not-json", "label-missing"]
    change(data, "12", split="all")
    with pytest.raises(DatasetError, match="no picture to read"):
        bambi.read(data)


def test_pictures_that_no_file_lists(data: Path) -> None:
    picture(data / "thermal" / "99_1.jpg", 5)
    dropped, kept = dataset_folder.read(data), bambi.read(data, unlabelled="keep")
    assert len(dropped.images) == 3 and codes(dropped) == codes(kept) == ["label-missing"]
    (new,) = [i for i in kept.images if i.id == "99_1"]
    assert (new.split, new.extra) == ("train", {"labelled": False})


def test_a_table_replaces_the_straight_down_view(data: Path) -> None:
    (data / "metadata.csv").write_text("sequence,altitude_m,time_of_day\n7,60,day\n")
    (data / "other.csv").write_text("file,pitch_deg\n12_102,80\n")
    first = dataset_folder.read(data).images[0]
    assert (first.capture.pitch_deg, first.capture.altitude_m, first.capture.time_of_day) == (90.0, 60.0, "day")
    again = bambi.read(data, metadata=data / "other.csv")
    assert [i.capture.pitch_deg for i in again.images if i.id == "12_102"] == [80.0]


def test_published_tracks_give_species_poses_and_times(tmp_path: Path) -> None:
    d = dataset_folder.read(SAMPLES["bambi:tracks"](tmp_path))
    assert d.format == "bambi" and d.problems == ()
    assert [(i.split, i.capture.sequence, i.file_name, i.capture.pitch_deg) for i in d.images] == [
        ("train", "7", "7_3.png", 87.0), ("train", "7", "7_4.png", 86.0),
        ("test", "12", "12_3.png", 87.0), ("test", "12", "12_4.png", 86.0),
    ]  # fmt: skip
    deer, boar = d.images[0].instances
    assert (deer.category, deer.track_id, deer.extra["age"], deer.extra["interpolated"]) == ("red deer", 1, 2.0, False)
    assert boar.box_xyxy.tolist() == [30, 20, 39, 27] and boar.extra["interpolated"] is True
    assert [(i.capture.captured, i.capture.time_s) for i in d.images[:2]] == [
        ("2024-03-22T10:47:03", 3.0), ("2024-03-22T10:47:04", 4.0),
    ]  # fmt: skip
    assert d.notes["rows"] == {
        "flights": 2, "frames": 4, "objects": 6, "read": 4, "no_animal": 2, "interpolated_frames": 0, "without_pose": 0,
    }  # fmt: skip


@pytest.mark.parametrize("first", ["2024-03-22T10:47:00+01:00", "2024-03-22T10:47:08", None])
def test_times_without_a_usable_first_one_give_no_seconds(first: str | None, tmp_path: Path) -> None:
    root = SAMPLES["bambi:tracks"](tmp_path)
    path = root / "7" / "7_matched_poses.json"
    top = json.loads(path.read_text())
    top["images"][0]["timestamp"] = first
    path.write_text(json.dumps(top))
    assert [(i.capture.captured, i.capture.time_s) for i in dataset_folder.read(root).images[:2]] == [
        ("2024-03-22T10:47:03", None), ("2024-03-22T10:47:04", None),
    ]  # fmt: skip


def test_frames_with_interpolated_boxes_alone_are_read_on_request(tmp_path: Path) -> None:
    root = SAMPLES["bambi:tracks"](tmp_path)
    table = root / "7" / "7_gt.txt"
    table.write_text(table.read_text().replace("(Red deer),0,2,0", "(Red deer),0,2,1") + "x,y\n4,1,2,3,4,5,1,99,1\n")
    d = dataset_folder.read(root)
    assert [i.file_name for i in d.images if i.split == "train"] == ["7_4.png"]
    assert d.notes["rows"]["interpolated_frames"] == 1
    assert codes(d) == ["category-unknown", "row-malformed"]
    everything = dataset_folder.read(root, dataset_folder.Reading(options={"frames": "all"}))
    assert [i.file_name for i in everything.images if i.split == "train"] == ["7_3.png", "7_4.png"]


def test_frames_come_from_the_left_half_of_the_video(tmp_path: Path) -> None:
    videos = pytest.importorskip("tests.videos")
    root = SAMPLES["bambi:tracks"](tmp_path)
    shutil.rmtree(root / "7" / "thermal")
    twin = np.full((48, 96), 200, np.uint8)
    pictures = [twin.copy() for _ in range(5)]
    for k, wide in enumerate(pictures):
        wide[:, :48] = 16 + k
    videos.write_video(root / "7" / "7_matched_processed.mp4", pictures)
    d = dataset_folder.read(root)
    first = d.images[0]
    assert first.size_wh == (48, 48) and first.capture.frame == 3 and d.problems == ()
    with Image.open(first.path) as frame:
        assert frame.getextrema() == (videos.level(3),) * 2


def test_annotations_without_a_video_are_reported(tmp_path: Path) -> None:
    root = SAMPLES["bambi:tracks"](tmp_path)
    shutil.rmtree(root / "7" / "thermal")
    d = dataset_folder.read(root)
    assert {i.capture.sequence for i in d.images} == {"12"} and codes(d) == ["image-missing"]


def test_yolo_labels_have_the_published_classes(tmp_path: Path) -> None:
    d = dataset_folder.read(SAMPLES["bambi:yolo"](tmp_path))
    assert d.format == "bambi" and d.problems == ()
    assert [(i.id, i.capture.pitch_deg, [o.category for o in i.instances]) for i in d.images] == [
        ("163_0", 90.0, ["red deer", "wild boar"]), ("163_1", 85.0, []), ("163_2", 80.0, []),
    ]  # fmt: skip
    assert [bambi_tracks.species_of(k) for k in (0, 2, 16, 17, 48, 49, 69, 74, 75, -1)] == [
        "no animal", "red deer", "red deer", "roe deer", "fallow deer", "unknown", "wild boar", "hybrid pig", None,
        None,
    ]  # fmt: skip


def test_corrected_boxes_take_the_pose_of_their_frame(data: Path) -> None:
    poses = [{"pitch": 0.0}] * 100 + [{"pitch": 12.5, "timestamp": "2024-03-22T11:00:00"}]
    (data / "7_matched_poses.json").write_text(json.dumps({"images": poses}))
    first, second = dataset_folder.read(data).images[:2]
    assert (first.capture.pitch_deg, first.capture.captured) == (77.5, "2024-03-22T11:00:00")
    assert (second.capture.pitch_deg, second.capture.captured) == (90.0, "2024-03-22")


def test_real_frames(real_data: Path) -> None:
    d = dataset_folder.read(real_data / "bambi")
    assert d.format == "bambi" and d.problems == ()
    counts = {i.id: [o.category for o in i.instances] for i in d.images}
    assert counts == {"163_6395": ["red deer"] * 10, "277_6760": ["wild boar"] * 6}
    assert [i.capture.captured for i in d.images] == ["2024-03-22", "2024-08-22"]
