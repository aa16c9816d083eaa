"""MOTChallenge: counted from 1, classes and their names, ids that change, sequences that have to be made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder, writing
from infrablend.formats.labels import mot
from infrablend.formats.losses import Written
from infrablend.formats.read_write import Reading
from tests.samples import SIZE_WH, codes, picture

CATEGORIES = (Category(0, "drone"), Category(4, "bird"), Category(7, "DontCare", "", True))


def sequence(
    root: Path, rows: str | None, *, name: str = "a", count: int = 3, info: str | None = None, first: int = 1
) -> Path:
    for n in range(count):
        picture(root / name / "img1" / f"{first + n:06d}.png", n)
    (root / name / "gt").mkdir()
    if rows is not None:
        (root / name / "gt" / "gt.txt").write_text(rows)
    if info is not None:
        (root / name / "seqinfo.ini").write_text(info)
    return root


def image(
    folder: Path,
    name: str,
    *objects: Instance,
    size: tuple[int, int] = SIZE_WH,
    **facts: object,
) -> ImageRecord:
    path = picture(folder / name, sum(map(ord, name)), size)
    capture = Capture(**facts)  # type: ignore[arg-type]
    return ImageRecord(path.stem, path, "train", size, objects, capture, file_name=name)


def drone(track: int | str | None, x: float = 0.0, category: str = "drone") -> Instance:
    return Instance(category, np.array([x, 0.0, x + 9.5, 7.25]), visibility=0.5, track_id=track)


def converted(images: list[ImageRecord], out: Path) -> tuple[Written, Dataset]:
    written = writing.write("mot", out, images, CATEGORIES)
    assert set(written.files) == {p for p in out.rglob("*") if p.is_file()}
    again = dataset_folder.read(out)
    assert again.format == "mot" and codes(again) == []
    return written, again


def test_the_top_left_pixel_is_one_one(tmp_path: Path) -> None:
    d = dataset_folder.read(sequence(tmp_path, "1,1,1,1,10,8,1,1,1\n3,1,55,41,10,8,1,1,0.25\n"))
    assert codes(d) == codes(d, "warning") == []
    first, second, third = d.images
    assert first.instances[0].box_xyxy.tolist() == [0, 0, 10, 8]
    assert third.instances[0].box_xyxy.tolist() == [54, 40, 64, 48] and third.instances[0].visibility == 0.25
    assert [(i.capture.sequence, i.capture.frame) for i in d.images] == [("a", 0), ("a", 1), ("a", 2)]
    assert second.instances == () and second.extra == {}  # a text lists all objects of its frames
    assert [c.name for c in d.categories] == ["class_1"] and d.notes["rows"]["without_seqinfo"] == 1
    zero = dataset_folder.read(tmp_path, Reading(options={"origin": "0"}))
    assert zero.images[0].instances[0].box_xyxy.tolist() == [1, 1, 11, 9] and codes(zero, "warning") == ["box-clipped"]


def test_a_round_trip_keeps_ids_frames_and_boxes(tmp_path: Path) -> None:
    images = [
        image(tmp_path, f"{n}.png", drone(7, n), drone(9, 20.0 + n, "bird"), sequence="clip", frame=n) for n in range(3)
    ]
    written, again = converted(images, tmp_path / "out")
    folder = tmp_path / "out" / "train" / "clip"
    lines = (folder / "gt" / "gt.txt").read_text().splitlines()
    assert lines[:3] == ["1,7,1,1,9.5,7.25,1,1,0.5", "1,9,21,1,9.5,7.25,1,2,0.5", "2,7,2,1,9.5,7.25,1,1,0.5"]
    assert (folder / "gt" / "labels.txt").read_text() == "drone\nbird\nDontCare\n"
    assert (folder / "seqinfo.ini").read_text() == (
        "[Sequence]\nname=clip\nimDir=img1\nframeRate=30\nseqLength=3\nimWidth=64\nimHeight=48\nimExt=.png\n"
        "assumedFrameRate=30\n"
    )
    assert {i.capture.time_s for i in again.images} == {None}  # nobody knows it
    assert written.losses == {"name_changed": 3} and [p.code for p in written.problems] == ["frame-rate"]
    assert not (tmp_path / "out" / "tracks.csv").exists()
    for before, after in zip(images, again.images, strict=True):
        assert (after.capture.sequence, after.capture.frame) == ("clip", before.capture.frame)
        assert all(a.equals(b) for a, b in zip(before.instances, after.instances, strict=True))
    # What was read is written again with the same bytes, and the frame rate that somebody corrected.
    (folder / "seqinfo.ini").write_text((folder / "seqinfo.ini").read_text().replace("eRate=30\ns", "eRate=12.5\ns"))
    source = dataset_folder.read(tmp_path / "out")
    assert [i.capture.time_s for i in source.images] == [0, 0.08, 0.16]
    written = writing.write("native", tmp_path / "again", source.images, source.categories, source=source)
    assert written.losses == {} and written.problems == ()
    (folder / "seqinfo.ini").write_text((folder / "seqinfo.ini").read_text().removesuffix("assumedFrameRate=30\n"))
    for path in (p for p in folder.rglob("*") if p.is_file()):
        assert (tmp_path / "again" / path.relative_to(tmp_path / "out")).read_bytes() == path.read_bytes()


def timed(folder: Path, times: Mapping[int, float | None]) -> list[ImageRecord]:
    return [image(folder, f"{n}.png", drone(1), sequence="s", frame=n, time_s=t) for n, t in times.items()]


@pytest.mark.parametrize(
    ("times", "rate", "problems", "listed"),
    [
        ({n: round(n / 25, 6) for n in range(4)}, "25", [], False),
        ({n: round(n * 1.001 / 30, 6) for n in range(0, 90, 30)}, "29.97003", ["frames-missing"], False),
        ({n: round(n / 30, 3) for n in range(31)}, "30", [], True),  # as Matroska has them
        ({0: 0.0, 1: 40.0, 2: 80.0}, "0.025", [], False),
        ({0: 5.0, 1: 5.1, 2: 5.2}, "10", [], True),  # the clip began before the first number
        ({0: 0.0, 1: 0.04, 2: 7.0, 3: 7.04}, "25", ["frame-rate"], True),
        ({0: 0.0, 1: 0.5, 2: 0.75, 3: 1.0}, "4", ["frame-rate"], True),
        ({0: 0.0, 1: 0.0}, "30", ["frame-rate"], True),
        ({3: 0.12}, "30", ["frames-missing", "frame-rate"], True),
    ],
)
def test_time_stamps_give_the_rate_and_come_back(
    times: dict[int, float | None], rate: str, problems: list[str], listed: bool, tmp_path: Path
) -> None:
    """Of varying steps the median counts, with a warning; `names.csv` has each time that does not follow from it."""
    written, again = converted(timed(tmp_path, times), tmp_path / "out")
    assert f"frameRate={rate}\n" in (tmp_path / "out/train/s/seqinfo.ini").read_text()
    assert sorted(p.code for p in written.problems) == sorted(problems)
    assert {i.capture.frame: i.capture.time_s for i in again.images} == times
    moved = tmp_path / "out" / "names.csv"
    assert moved.read_text().startswith("file,name,sequence,frame,captured,time_s\n")
    source = replace(again, images=tuple(replace(i, file_name=i.name) for i in again.images))
    writing.write("mot", tmp_path / "again", source.images, source.categories)
    assert (tmp_path / "again" / "names.csv").exists() == listed
    assert (tmp_path / "again/train/s/seqinfo.ini").read_bytes() == (tmp_path / "out/train/s/seqinfo.ini").read_bytes()


def test_an_unknown_time_follows_from_the_rate_that_others_state(tmp_path: Path) -> None:
    _, again = converted(timed(tmp_path, {0: 0.0, 1: None, 2: 0.5}), tmp_path / "out")
    assert [i.capture.time_s for i in again.images] == [0, 0.25, 0.5]


def test_names_of_an_earlier_version_leave_the_times(tmp_path: Path) -> None:
    root = sequence(tmp_path, "1,1,1,1,10,8,1,1,1\n", info="[Sequence]\nframeRate=25\n")
    (root / "names.csv").write_text("file,name,sequence,frame,captured\na/img1/000003.png,x.png,b,7,2024-05-01\n")
    assert [i.capture for i in dataset_folder.read(root).images] == [
        Capture(sequence="a", frame=0, time_s=0.0),
        Capture(sequence="a", frame=1, time_s=0.04),
        Capture(sequence="b", frame=7, captured="2024-05-01", time_s=0.08),
    ]


def test_ids_that_do_not_fit_are_renumbered_and_recorded(tmp_path: Path) -> None:
    """Text, zero, and a number of two classes get the next free ones; objects without a track one each."""
    objects = (drone("left", 0), drone(3, 10), drone(3, 20, "bird"), drone(0, 30), drone(5, 40), drone(None, 50))
    images = [image(tmp_path, f"{n}.png", *objects, sequence="clip", frame=n) for n in range(2)]
    written, again = converted(images, tmp_path / "out")
    assert written.losses == {"name_changed": 2, "track_made": 2, "track_renumbered": 8}
    assert (tmp_path / "out" / "tracks.csv").read_text() == (
        "sequence,id,category,track_id\n"
        "train/clip,6,drone,left\ntrain/clip,7,drone,3\ntrain/clip,8,bird,3\ntrain/clip,9,drone,0\n"
    )
    rows = [line.split(",")[:2] for line in (tmp_path / "out/train/clip/gt/gt.txt").read_text().splitlines()]
    assert rows[:6] == [["1", i] for i in ("6", "7", "8", "9", "5", "10")] and rows[11] == ["2", "11"]
    for after in again.images:
        assert [o.track_id for o in after.instances[:5]] == ["left", 3, 3, 0, 5]
        assert [o.category for o in after.instances] == ["drone", "drone", "bird", "drone", "drone", "drone"]


def test_the_second_object_of_a_track_in_a_picture_gets_another(tmp_path: Path) -> None:
    written, again = converted([image(tmp_path, "a.png", drone(1), drone(1, 9), sequence="s", frame=0)], tmp_path / "o")
    assert written.losses["track_made"] == 1 and [o.track_id for o in again.images[0].instances] == [1, 2]


def test_pictures_without_sequence_or_number_form_one_and_are_counted(tmp_path: Path) -> None:
    images = [
        image(tmp_path, "b.png", drone(1)),
        image(tmp_path, "a.png", drone(2)),
        image(tmp_path, "c.png", drone(1), sequence="no/where", frame=4),
        image(tmp_path, "d.png", drone(1), sequence="no/where", frame=4),
        image(tmp_path, "e.png", drone(1), sequence="pictures", frame=4, captured="2024-05-01", pitch_deg=30.0),
    ]
    written, again = converted(images, tmp_path / "out")
    # The number 4 twice, so both are numbered by their names.
    assert written.losses["sequence_made"] == 4
    assert [p.code for p in written.problems if p.code == "frames-missing"] == ["frames-missing"]
    known = {i.path.read_bytes(): i for i in again.images}
    for before in images:
        assert known[before.path.read_bytes()].capture == before.capture
    assert sorted(p.name for p in (tmp_path / "out" / "train").iterdir()) == ["no_where", "pictures", "pictures-2"]


def test_what_does_not_count_has_conf_zero(tmp_path: Path) -> None:
    crowd = replace(drone(2, 20), extra={"iscrowd": 1})
    region = replace(drone(3, 40), category="DontCare")
    written, again = converted(
        [image(tmp_path, "a.png", drone(1), crowd, region, sequence="s", frame=0)], tmp_path / "o"
    )
    lines = (tmp_path / "o/train/s/gt/gt.txt").read_text().splitlines()
    assert [line.split(",")[6] for line in lines] == ["1", "0", "0"]
    assert [o.is_crowd for o in again.images[0].instances] == [False, True, False]
    assert again.category("DontCare").ignore and again.notes["rows"]["ignored"] == 2
    assert not {"ignore_dropped", "ignore_as_class"} & set(written.losses)


def test_sequences_without_labels_have_no_text_and_single_pictures_are_counted(tmp_path: Path) -> None:
    bare = [replace(image(tmp_path, f"{n}.png", sequence="s", frame=n), extra={"labelled": False}) for n in range(2)]
    _, again = converted(bare, tmp_path / "bare")
    assert [i.extra["labelled"] for i in again.images] == [False, False] and codes(again, "warning") == [
        "label-missing"
    ]
    with pytest.raises(DatasetError, match="no picture to read"):
        dataset_folder.read(tmp_path / "bare", Reading(options={"unlabelled": "drop"}))
    mixed = [bare[0], replace(bare[1], instances=(drone(1),), extra={})]
    written, again = converted(mixed, tmp_path / "mixed")
    assert written.losses["unlabelled_unsaid"] == 1 and [len(i.instances) for i in again.images] == [0, 1]


def test_two_sizes_and_types_in_a_sequence_are_kept_and_named(tmp_path: Path) -> None:
    images = [
        image(tmp_path, "a.png", drone(1), sequence="s", frame=0),
        image(tmp_path, "b.jpg", drone(1), sequence="s", frame=1, size=(32, 24)),
        image(tmp_path, "c.png", drone(1), sequence="s", frame=2),
    ]
    written, again = converted(images, tmp_path / "out")
    assert [p.code for p in written.problems] == ["frame-rate", "image-size"]
    assert ".jpg, .png, 32x24 px, 64x48 px" in written.problems[1].found
    assert [i.size_wh for i in again.images] == [(64, 48), (32, 24), (64, 48)]
    assert codes(again, "warning") == ["image-size"]


def test_unknown_visibility_becomes_one_and_is_counted(tmp_path: Path) -> None:
    unknown = replace(drone(1), visibility=None)
    written, again = converted([image(tmp_path, "a.png", unknown, sequence="s", frame=0)], tmp_path / "out")
    assert written.losses["visibility_made"] == 1 and again.images[0].instances[0].visibility == 1


@pytest.mark.parametrize(
    ("row", "code"),
    [
        ("1,1,1,1,10", "row-malformed"),
        ("1,1,1,1,x,8,1,1,1", "row-malformed"),
        ("0,1,1,1,10,8,1,1,1", "row-malformed"),  # frames count from 1
        ("1.5,1,1,1,10,8,1,1,1", "row-malformed"),
        ("1,1,1,1,10,8,1,0,1", "category-unknown"),
        ("1,1,1,1,10,8,1,1.5,1", "category-unknown"),
        ("1,1,100,1,10,8,1,1,1", "box-outside"),
        ("1,1,1,1,0,8,1,1,1", "box-empty"),
        ("1,1,nan,1,10,8,1,1,1", "box-not-finite"),
    ],
)
def test_a_broken_line_is_named_and_the_others_are_read(tmp_path: Path, row: str, code: str) -> None:
    d = dataset_folder.read(sequence(tmp_path, f"2,1,1,1,10,8,1,1,1\n\n{row}\n"))
    assert codes(d) == [code] and [len(i.instances) for i in d.images] == [0, 1, 0]
    assert d.problems[0].where == "a/gt/gt.txt: line 3"


def test_an_object_twice_in_a_frame_is_kept_with_a_warning(tmp_path: Path) -> None:
    d = dataset_folder.read(sequence(tmp_path, "1,4,1,1,10,8,1,1,1\n1,4,20,1,10,8,1,2,1\n"))
    assert codes(d, "warning") == ["track-twice"] and [o.track_id for o in d.images[0].instances] == [4, 4]
    assert [(c.id, c.name) for c in d.categories] == [(1, "class_1"), (2, "class_2")]


def test_objects_that_no_tracker_has_assigned_have_no_track(tmp_path: Path) -> None:
    """-1 is no object that jumps through the sequence: github.com/nwojke/deep_sort/issues/236."""
    rows = "1,-1,1,1,10,8,1,1,1\n1,-1.0,20,1,10,8,1,1,1\n2,-1,1,1,10,8,1,1,1\n2,3,20,1,10,8,1,1,1\n"
    d = dataset_folder.read(sequence(tmp_path / "in", rows))
    assert [o.track_id for i in d.images for o in i.instances] == [None, None, None, 3]
    assert codes(d, "warning") == ["track-missing"] and "3 row(s)" in d.problems[0].found
    assert d.notes["rows"]["untracked"] == 3
    written = writing.write("mot", tmp_path / "out", d.images, d.categories)
    assert written.losses["track_made"] == 3
    again = dataset_folder.read(tmp_path / "out")
    tracks = [o.track_id for i in again.images for o in i.instances]
    assert len(set(tracks)) == 4 and 3 in tracks


@pytest.mark.parametrize("track, ok", [("9007199254740993", True), ("9007199254740993.0", False), ("9e15", True)])
def test_an_id_that_has_lost_digits_is_an_error(tmp_path: Path, track: str, ok: bool) -> None:
    d = dataset_folder.read(sequence(tmp_path, f"2,{track},1,1,10,8,1,1,1\n"))
    assert codes(d) == ["row-malformed"] * (not ok)
    assert [o.track_id for o in d.images[1].instances] == [int(float(track)) + (track[-1] == "3")] * ok


def test_an_empty_text_and_rows_without_a_picture_are_warnings(tmp_path: Path) -> None:
    sequence(tmp_path, "", name="a")
    sequence(tmp_path, "4,1,1,1,10,8,1,1,1\n", name="b")
    d = dataset_folder.read(tmp_path)
    assert codes(d) == [] and codes(d, "warning") == ["label-empty", "row-without-picture"]
    assert d.notes["rows"]["without_picture"] == 1 and "frames=order" in d.problems[1].todo


def test_frames_by_order_and_pictures_counted_from_zero(tmp_path: Path) -> None:
    sequence(tmp_path, "1,1,1,1,10,8,1,1,1\n3,1,1,1,10,8,1,1,1\n", first=11)
    d = dataset_folder.read(tmp_path, Reading(options={"frames": "order"}))
    assert [(i.capture.frame, len(i.instances)) for i in d.images] == [(10, 1), (11, 0), (12, 1)] and d.problems == ()
    sequence(tmp_path / "zero", "1,1,1,1,10,8,1,1,1\n", first=0)
    d = dataset_folder.read(tmp_path / "zero")
    assert codes(d, "warning") == ["name-grammar"]
    assert [(i.path.stem, i.capture.frame, len(i.instances)) for i in d.images] == [
        ("000000", 0, 1), ("000001", 1, 0), ("000002", 2, 0),
    ]  # fmt: skip


def test_seqinfo_is_compared_with_the_pictures(tmp_path: Path) -> None:
    info = "[Sequence]\nname=a\nimDir=img1\nframeRate=25\nseqLength=9\nimWidth=99\nimHeight=48\nimExt=.png\n"
    d = dataset_folder.read(sequence(tmp_path, "1,1,1,1,10,8,1,1,1\n", info=info))
    assert codes(d) == [] and codes(d, "warning") == ["sequence-length", "image-size"]
    assert {i.extra["frame_rate"] for i in d.images} == {25} and d.images[0].size_wh == (64, 48)
    (tmp_path / "a" / "seqinfo.ini").write_text("imDir=img1\n")
    assert codes(dataset_folder.read(tmp_path), "warning") == ["annotation-layout"]
    (tmp_path / "a" / "seqinfo.ini").write_text("[Sequence]\nimDir=../..\n")
    with pytest.raises(DatasetError) as caught:
        dataset_folder.read(tmp_path)
    assert caught.value.problems[0].code == "name-climbs"


def test_names_of_classes_come_from_labels_or_from_the_challenge(tmp_path: Path) -> None:
    rows = "1,1,1,1,10,8,1,2,1\n"
    sequence(tmp_path / "own", rows)
    (tmp_path / "own" / "labels.txt").write_text("deer\nboar\n")
    own = dataset_folder.read(tmp_path / "own")
    assert [(c.id, c.name) for c in own.categories] == [(1, "deer"), (2, "boar")]
    assert own.images[0].instances[0].category == "boar" and own.problems == ()
    (tmp_path / "own" / "labels.txt").write_text("deer\n")
    with_fault = dataset_folder.read(tmp_path / "own")
    assert codes(with_fault) == ["category-unknown"]
    sequence(tmp_path / "MOT17" / "train", rows + "1,2,1,1,9,9,1,-1,-1,-1\n", name="MOT17-02-DPM")
    challenge = dataset_folder.read(tmp_path / "MOT17")
    assert [c.name for c in challenge.categories] == list(mot.CLASSES)
    assert [o.category for o in challenge.images[0].instances] == ["person on vehicle", "pedestrian"]
    sequence(tmp_path / "mine", "1,2,1,1,9,9,1,-1,-1,-1\n")
    assert dataset_folder.read(tmp_path / "mine").images[0].instances[0].category == "object"


def test_splits_come_from_folders_and_equal_names_of_sequences_stay_apart(tmp_path: Path) -> None:
    for k, split in enumerate(("train", "val", "test")):
        sequence(tmp_path / split, f"1,{k + 1},1,1,10,8,1,1,1\n", count=1)
    d = dataset_folder.read(tmp_path)
    assert [(i.split, i.instances[0].track_id) for i in d.images] == [("train", 1), ("val", 2), ("test", 3)]
    assert [i.split for i in dataset_folder.read(tmp_path, Reading(splits=["val"])).images] == ["val"]


words = st.sampled_from(["0", "1", "-1", "2", "9", "10.5", "1e308", "nan", "inf", "", "x", "\x00", "\n", '"', "٣"])


@given(st.lists(words, max_size=24).map(",".join) | st.binary(max_size=80).map(lambda b: b.decode("latin-1")))
def test_any_text_gives_boxes_inside_the_frame(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    root = sequence(tmp_path_factory.mktemp("m"), text, count=1, info="[Sequence]\n" + text)
    for name in ("names.csv", "tracks.csv", "a/labels.txt"):
        (root / name).write_text(text)
    for o in mot.read(root).images[0].instances:
        x0, y0, x1, y1 = o.box_xyxy
        assert 0 <= x0 < x1 <= 64 and 0 <= y0 < y1 <= 48
