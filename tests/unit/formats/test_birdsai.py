"""BIRDSAI: tracks, species, flags, frame numbers, odd folders; written back as it was, or with new numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from infrablend.core.dataset import Category, Instance
from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder
from infrablend.formats.published import birdsai
from infrablend.formats.read_write import Reading
from infrablend.formats.records import unlabelled_problems
from tests.samples import codes, picture

SEQ = "0000000067_0000000025"


def frames(root: Path, numbers: list[int], table: str | None, split: str = "TrainReal", sequence: str = SEQ) -> Path:
    for n in numbers:
        picture(root / split / "images" / sequence / f"{sequence}_{n:010d}.jpg", n)
    if table is not None:
        path = root / split / "annotations" / f"{sequence}.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(table)
    return root


ROWS = (
    "0,7,10,12,20,8,0,1,0,0\n"
    "0,-3,40,12,6,14,1,0,1,0\n"
    "2,7,11,12,20,8,0,1,0,1\n"
    "2,8,1,2,3.5,4,0,-1,0,0\n"
    "2,9,30,2,3,4,1,-1,0,0\n"
)


def test_tracks_species_and_flags(tmp_path: Path) -> None:
    d = dataset_folder.read(frames(tmp_path, [0, 1, 2], ROWS))
    assert d.format == "birdsai" and codes(d) == [] and codes(d, "warning") == ["label-missing"]
    first, second, third = d.images
    assert [(o.category, o.track_id, o.extra["occlusion"], o.extra["noise"]) for o in first.instances] == [
        ("elephant", 7, 0, 0), ("human", -3, 1, 0),
    ]  # fmt: skip
    assert [(o.category, o.track_id, o.extra["noise"]) for o in third.instances] == [
        ("elephant", 7, 1), ("unknown", 8, 0), ("human", 9, 0),
    ]  # fmt: skip
    assert first.instances[0].box_xyxy.tolist() == [10, 12, 30, 20]
    assert (second.instances, second.capture.frame, second.extra) == ((), 1, {"labelled": False})
    assert {i.capture.sequence for i in d.images} == {SEQ} and d.images[0].size_wh == (64, 48)
    assert (d.category("human").id, d.category("elephant").id, d.category("unknown").id) == (0, 1, 9)
    rows = d.notes["rows"]
    assert (rows["rows"], rows["read"], rows["noisy"], rows["unlabelled"], rows["without_picture"]) == (5, 5, 1, 1, 0)


def test_classes_instead_of_species_and_noise_dropped(tmp_path: Path) -> None:
    frames(tmp_path, [0, 1, 2], ROWS)
    d = dataset_folder.read(tmp_path, Reading(options={"category": "class", "noise": "drop", "unlabelled": "drop"}))
    assert [(c.id, c.name) for c in d.categories] == [(0, "animal"), (1, "human")]
    assert [[o.category for o in i.instances] for i in d.images] == [["animal", "human"], ["animal", "human"]]
    assert codes(d, "warning") == ["label-missing", "noise-dropped"] and d.notes["rows"]["noise_dropped"] == 1


@pytest.mark.parametrize("options", [{"category": "kind"}, {"noise": "1"}, {"frames": "x"}, {"frame_offset": "1.5"}])
def test_unknown_values_of_options_are_refused(tmp_path: Path, options: dict[str, str]) -> None:
    with pytest.raises(DatasetError) as caught:
        dataset_folder.read(frames(tmp_path, [0], ROWS), Reading(options=options))
    assert caught.value.problems[0].code == "option-value" and next(iter(options)) in caught.value.problems[0].where


def test_rows_and_frames_that_do_not_match_are_counted_and_an_offset_is_offered(tmp_path: Path) -> None:
    table = "".join(f"{n},1,10,12,20,8,0,1,0,0\n" for n in range(5))
    frames(tmp_path, [1, 2, 3, 4, 5], table)
    d = dataset_folder.read(tmp_path)
    assert codes(d, "warning") == ["row-without-picture", "label-missing", "frame-offset"]
    assert "frame_offset=1" in next(p.todo for p in d.problems if p.code == "frame-offset")
    assert d.notes["rows"]["without_picture"] == 1
    d = dataset_folder.read(tmp_path, Reading(options={"frame_offset": "1"}))
    assert d.problems == () and [len(i.instances) for i in d.images] == [1] * 5 and d.notes["frames"] == "number+1"
    ordered = dataset_folder.read(tmp_path, Reading(options={"frames": "order"}))
    assert ordered.problems == () and ordered.images[0].instances[0].extra["species"] == 1


LINES = (
    ("0,1,10,12,20,8,0,1,0", "row-incomplete", "error"),
    ("0,1,10,12,,8,0,1,0,0", "row-incomplete", "error"),
    ("0,1,10,12,NaN,8,0,1,0,0", "row-incomplete", "error"),
    ("0,1,10,12,inf,8,0,1,0,0", "row-malformed", "error"),
    ("0,1,10,12,2x,8,0,1,0,0", "row-malformed", "error"),
    ("0,1,10,12,20,8,0,1,0,0,0", "row-malformed", "error"),
    ("0.5,1,10,12,20,8,0,1,0,0", "row-malformed", "error"),
    ("0,1,10,12,20,8,2,1,0,0", "category-unknown", "error"),
    ("0,1,10,12,20,8,0,9,0,0", "category-unknown", "error"),
    ("0,1,10,12,0,8,0,1,0,0", "box-empty", "error"),
    ("0,1,70,12,5,8,0,1,0,0", "box-outside", "error"),
    ("0,1,60,12,20,8,0,1,0,0", "box-clipped", "warning"),
    ("0,1,10,12,20,8,1,1,0,0", "species-class", "warning"),
    ("0,1,10,12,20,8,0,1,2,0", "flag-value", "warning"),
    ("0,7,10,12,20,8,0,1,0,0", "track-twice", "warning"),
)


@pytest.mark.parametrize(("line", "code", "severity"), LINES)
def test_every_line_is_read_or_reported(tmp_path: Path, line: str, code: str, severity: Any) -> None:
    d = birdsai.read(frames(tmp_path, [0], f"0,7,10,12,20,8,0,1,0,0\r\n\r\n{line}\r\n"))
    assert [(p.code, p.severity) for p in d.problems] == [(code, severity)]
    assert len(d.images[0].instances) == (1 if severity == "error" else 2)
    if code != "species-class":
        assert d.problems[0].where == f"TrainReal/annotations/{SEQ}.csv: line 3"


def test_various_folder_layouts(tmp_path: Path) -> None:
    frames(tmp_path / "a" / "TrainReal", [0], ROWS, "TrainReal")  # doubled
    frames(tmp_path / "a", [0], ROWS, "TestReal")
    (tmp_path / "a" / "TrainSimulation").mkdir()
    d = dataset_folder.read(tmp_path / "a")
    assert [i.split for i in d.images] == ["train", "test"] and "simulation-excluded" in codes(d, "warning")
    assert len({i.id for i in d.images}) == 2
    assert [i.split for i in dataset_folder.read(tmp_path / "a" / "TestReal").images] == ["test"]
    assert [i.split for i in dataset_folder.read(tmp_path / "a", Reading(splits=["test"])).images] == ["test"]
    frames(tmp_path / "b", [0], ROWS, "Real")
    assert dataset_folder.read(tmp_path / "b").format == "birdsai"


def test_frames_in_another_format_are_not_claimed(tmp_path: Path) -> None:
    picture(tmp_path / "bare" / f"{SEQ}_0000000001.jpg", 1)
    assert dataset_folder.detect(tmp_path / "bare").format == "birdsai"
    (tmp_path / "bare" / f"{SEQ}_0000000001.txt").write_text("0 0.5 0.5 0.1 0.1\n")
    assert dataset_folder.detect(tmp_path / "bare").format == "folder"
    for n in range(2):
        picture(tmp_path / "mixed" / f"holiday{n}.jpg", n)
    picture(tmp_path / "mixed" / f"{SEQ}_0000000001.jpg", 1)
    assert dataset_folder.detect(tmp_path / "mixed").format == "folder"
    assert "2 of 3 pictures" in birdsai.detect(tmp_path / "mixed").reason


def test_unchanged_dataset_is_written_back_byte_for_byte(tmp_path: Path) -> None:
    d = birdsai.read(frames(tmp_path / "in", [0, 1, 2], ROWS))
    written = birdsai.write(tmp_path / "out", d.images, d.categories)
    assert written.losses == {}
    names = {p.relative_to(tmp_path / "out").as_posix() for p in written.files}
    assert names == {p.relative_to(tmp_path / "in").as_posix() for p in (tmp_path / "in").rglob("*") if p.is_file()}
    table = f"TrainReal/annotations/{SEQ}.csv"
    assert (tmp_path / "out" / table).read_text() == (tmp_path / "in" / table).read_text()
    by_class = birdsai.read(tmp_path / "in", category="class")
    birdsai.write(tmp_path / "class", by_class.images, by_class.categories)
    assert (tmp_path / "class" / table).read_text() == (tmp_path / "in" / table).read_text()


def test_new_classes_new_tracks_and_changed_names_come_back(tmp_path: Path) -> None:
    d = birdsai.read(frames(tmp_path / "in", [0], "0,7,10,12,20,8,0,1,0,0\n"))
    (image,) = d.images
    box = np.array([1.0, 2.0, 30.25, 40.5])
    new = (Instance("deer", box, inserted=True, visibility=0.5), Instance("Person", box, track_id="ann"))
    both = [
        replace(
            image,
            id=f"{image.id}_c{k}",
            file_name=f"{SEQ}/{SEQ}_0000000000_c{k}.jpg",
            split=split,
            capture=replace(image.capture, pitch_deg=40.5),
            instances=(*image.instances, *new),
        )
        for k, split in enumerate(("train", "train", "val"))
    ]
    categories = (*d.categories, Category(10, "deer"), Category(4, "Person"))
    written = birdsai.write(tmp_path / "out", both, categories)
    assert written.losses == {
        "class_unfit": 3, "name_changed": 3, "track_made": 3, "track_renumbered": 3, "visibility_dropped": 3,
    }  # fmt: skip
    table = (tmp_path / "out" / "TrainReal" / "annotations" / f"{SEQ}.csv").read_text().splitlines()
    assert table[:2] == ["0,7,10,12,20,8,0,1,0,0", "0,8,1,2,29.25,38.5,0,10,1,0"]
    assert (tmp_path / "out" / "species.csv").read_text() == "species,name,ignore\n10,deer,0\n11,Person,0\n"
    again = dataset_folder.read(tmp_path / "out")
    assert codes(again) == [] and [i.split for i in again.images] == ["train", "train", "val"]
    assert [[o.category for o in i.instances] for i in again.images] == [["elephant", "deer", "Person"]] * 3
    assert {i.capture.pitch_deg for i in again.images} == {40.5} and {i.capture.sequence for i in again.images} == {SEQ}
    people = [o.track_id for i in again.images for o in i.instances if o.category == "Person"]
    deer = [o.track_id for i in again.images for o in i.instances if o.category == "deer"]
    assert len(set(people)) == 1 and len(set(deer)) == 3 and not {7, *deer} & set(people)
    assert np.allclose(again.images[0].instances[1].box_xyxy, box, rtol=0, atol=1e-6)


def test_broken_tables_of_ours_are_named(tmp_path: Path) -> None:
    frames(tmp_path, [0], ROWS)
    (tmp_path / "species.csv").write_text("species,name,ignore\n3,fox,0\n10,elephant,0\n10,deer,1\n10,fox,0\nx\n")
    (tmp_path / "names.csv").write_text("file,name\n")
    d = birdsai.read(tmp_path)
    assert codes(d) == ["species-malformed"] * 4 and d.category("deer") == Category(10, "deer", ignore=True)


words = st.sampled_from(["0", "1", "-1", "2", "9", "10.5", "1e308", "nan", "inf", "", "x", "\x00", "\n", '"', "٣"])


@given(st.lists(words, max_size=24).map(",".join) | st.binary(max_size=80).map(lambda b: b.decode("latin-1")))
def test_any_text_gives_boxes_inside_the_frame(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    root = frames(tmp_path_factory.mktemp("b"), [0], text)
    for name in ("species.csv", "names.csv"):
        (root / name).write_text(text)
    d = birdsai.read(root)
    for o in d.images[0].instances:
        x0, y0, x1, y1 = o.box_xyxy
        assert 0 <= x0 < x1 <= 64 and 0 <= y0 < y1 <= 48


def test_the_shared_frames_are_pictures_without_labels(real_data: Path) -> None:
    d = dataset_folder.read(real_data / "birdsai")
    assert d.format == "birdsai" and len(d.images) == 7 and len({i.capture.sequence for i in d.images}) == 7
    assert codes(d) == [] and codes(d, "warning") == ["label-missing"] and "7 picture(s)" in d.problems[0].found
    assert d.problems[0].todo == "add their labels, or leave them out with --read unlabelled=drop"
    assert all(i.extra["labelled"] is False and i.instances == () for i in d.images)
    assert {i.size_wh for i in d.images} == {
        (635, 329), (697, 517), (582, 378), (637, 418), (698, 333), (701, 471), (640, 512),
    }  # fmt: skip


def test_the_warning_about_frames_without_rows_offers_two_remedies() -> None:
    (kept,) = unlabelled_problems("a", 7, "keep", "no row in the annotation table")
    assert str(kept) == (
        "a: 7 picture(s) with no row in the annotation table: kept, marked as not labelled; expected labels for each "
        "picture. Add their labels, or leave them out with --read unlabelled=drop"
    )
    (left_out,) = unlabelled_problems("a", 7, "drop", "no row in the annotation table")
    assert left_out.found.endswith("left out") and not left_out.todo
