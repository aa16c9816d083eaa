"""Anti-UAV's JSON as written: a folder per target, frames without gaps, and what tables give back."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from infrablend import api
from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.formats import dataset_folder, writing
from infrablend.formats.losses import Written
from infrablend.formats.read_write import Reading
from tests.samples import SAMPLES, SIZE_WH, codes, picture

CATEGORIES = (Category(0, "drone"), Category(1, "bird"))


def image(folder: Path, frame: int | None, *objects: Instance, sequence: str | None = "clip") -> ImageRecord:
    name = f"{sequence}_{frame}_{len(objects)}.png"
    path = picture(folder / name, 10 * len(sequence or "") + (frame or 0))
    return ImageRecord(path.stem, path, "train", SIZE_WH, objects, Capture(sequence=sequence, frame=frame))


def drone(
    track: int | str | None, x: float = 0.0, category: str = "drone", visibility: float | None = None
) -> Instance:
    return Instance(category, np.array([x, 2.0, x + 9.5, 7.25]), visibility=visibility, track_id=track)


def converted(images: list[ImageRecord], out: Path) -> tuple[Written, Dataset]:
    written = writing.write("anti-uav", out, images, CATEGORIES)
    assert set(written.files) == {p for p in out.rglob("*") if p.is_file()}
    again = dataset_folder.read(out)
    assert again.format == "anti-uav" and codes(again) == codes(again, "warning") == []
    return written, replace(again, images=tuple(sorted(again.images, key=place)))


def place(image: ImageRecord) -> tuple[str | None, int | None]:
    return image.capture.sequence, image.capture.frame


def label(folder: Path) -> dict[str, Any]:
    top: dict[str, Any] = json.loads((folder / "IR_label.json").read_text())
    return top


def tracks(dataset: Dataset) -> list[list[tuple[str, int | str | None, float]]]:
    return [[(o.category, o.track_id, float(o.box_xyxy[0])) for o in i.instances] for i in dataset.images]


def test_one_drone_is_written_as_published_and_back_with_the_same_bytes(tmp_path: Path) -> None:
    images = [image(tmp_path, 0, drone(0, 1)), image(tmp_path, 1), image(tmp_path, 2, drone(0, 2.5))]
    written, again = converted(images, tmp_path / "out")
    folder = tmp_path / "out" / "train" / "clip"
    assert (folder / "IR_label.json").read_text() == (
        '{"exist": [1, 0, 1], "gt_rect": [[1, 2, 9.5, 5.25], [], [2.5, 2, 9.5, 5.25]]}\n'
    )
    assert written.losses == {"name_changed": 3} and written.problems == ()
    assert sorted(p.name for p in folder.iterdir()) == ["000001.png", "000002.png", "000003.png", "IR_label.json"]
    assert not (tmp_path / "out" / "targets.csv").exists()
    assert tracks(again) == [[("drone", 0, 1)], [], [("drone", 0, 2.5)]]
    assert [i.capture for i in again.images] == [i.capture for i in images]
    source = dataset_folder.read(SAMPLES["anti-uav"](tmp_path / "published"))
    for source_of, root in ((again, tmp_path / "out"), (source, tmp_path / "published")):
        out = tmp_path / f"{root.name}-again"
        assert writing.write("anti-uav", out, source_of.images, source_of.categories).losses == {}
        same = {p.relative_to(root): p.read_bytes() for p in root.rglob("*") if p.suffix not in ("", ".json")}
        same.pop(Path("names.csv"), None)  # the names of the pictures before
        assert {p.relative_to(out): p.read_bytes() for p in out.rglob("*") if p.suffix not in ("", ".json")} == same
    assert label(tmp_path / "out-again" / "train" / "clip") == label(folder)


def test_further_tracks_have_folders_from_their_first_to_their_last_box(tmp_path: Path) -> None:
    """Names of folders stay apart from those of sequences; classes and ids come back."""
    shown = (
        (drone(7, 1),), (drone(7, 2), drone("b/c", 30, "bird")), (), (drone(9, 40),), (drone("b/c", 33, "bird"),), (),
    )  # fmt: skip
    images = [image(tmp_path, n, *objects) for n, objects in enumerate(shown)]
    images.append(image(tmp_path, 0, sequence="clip_9"))
    written, again = converted(images, tmp_path / "out")
    assert (tmp_path / "out" / "targets.csv").read_text() == (
        "folder,of,first,category,track_id,ignore\n"
        "train/clip,train/clip,0,drone,7,0\n"
        "train/clip_b_c,train/clip,1,bird,b/c,0\n"
        "train/clip_9-2,train/clip,3,drone,9,0\n"
    )
    folders = tmp_path / "out" / "train"
    assert sorted(p.name for p in folders.iterdir()) == ["clip", "clip_9", "clip_9-2", "clip_b_c"]
    assert label(folders / "clip")["exist"] == [1, 1, 0, 0, 0, 0] and label(folders / "clip_9")["exist"] == [0]
    assert label(folders / "clip_b_c")["exist"] == [1, 0, 0, 1]
    assert (folders / "clip_b_c" / "000002.png").read_bytes() == images[2].path.read_bytes()
    assert written.losses == {"class_unfit": 2, "name_changed": 7}
    assert tracks(again) == [[(o.category, o.track_id, o.box_xyxy[0]) for o in i.instances] for i in images]
    assert [i.capture for i in again.images] == [i.capture for i in images]
    assert [c.name for c in again.categories] == ["drone", "bird"]
    assert again.notes["rows"]["frames"] == 7
    assert api.check(tmp_path / "out").problems == ()
    every = dataset_folder.read(tmp_path / "out", Reading(options={"every": "2"}))
    assert [(i.capture.frame, [o.track_id for o in i.instances]) for i in sorted(every.images, key=place)] == [
        (0, [7]), (2, []), (4, ["b/c"]), (0, []),
    ]  # fmt: skip
    # Without the table each folder is a sequence of its own, as other programs see it.
    (tmp_path / "out" / "targets.csv").unlink()
    assert len(dataset_folder.read(tmp_path / "out").images) == 7 + 4 + 1


def test_objects_without_a_track_are_one_target_if_no_picture_shows_two(tmp_path: Path) -> None:
    images = [
        image(tmp_path, 0, drone(4)),
        *(image(tmp_path, n, drone(None, n), drone(None, 9, "bird")) for n in (1, 2)),
    ]
    written, again = converted(images, tmp_path / "out")
    assert written.losses["track_made"] == 4
    assert [[o.track_id for o in i.instances] for i in again.images] == [[4], [5, 6], [5, 6]]


@pytest.mark.parametrize("frames", [(0, 1), (None, None)])
def test_others_without_a_track_are_a_target_each(frames: tuple[int | None, ...], tmp_path: Path) -> None:
    """Where two are in a picture, or the pictures are not known to follow each other."""
    second = (drone(None, 9),) if frames[1] else ()
    images = [image(tmp_path, frames[0], drone(None, 1)), image(tmp_path, frames[1], drone(None, 2), *second)]
    if not second:
        images[1] = replace(images[1], id="z", path=picture(tmp_path / "z.png", 9), file_name="z.png")
    written, again = converted(images, tmp_path / "out")
    count = 2 + len(second)
    assert written.losses["track_made"] == count
    assert sorted(o.track_id for i in again.images for o in i.instances) == list(range(count))  # type: ignore[type-var]
    assert [len(i.instances) for i in again.images] == [1, count - 1]


def test_the_second_object_of_a_track_in_a_picture_is_another_target(tmp_path: Path) -> None:
    written, again = converted(
        [image(tmp_path, 0, drone(3, 1), drone(3, 20)), image(tmp_path, 1, drone(3, 2))], tmp_path / "o"
    )
    assert written.losses["track_made"] == 1
    assert tracks(again) == [[("drone", 3, 1), ("drone", 4, 20)], [("drone", 3, 2)]]


def test_gaps_between_frames_are_closed_and_the_numbers_come_back(tmp_path: Path) -> None:
    written, again = converted([image(tmp_path, n, drone(0, n)) for n in (0, 3, 5)], tmp_path / "out")
    assert [p.name for p in sorted((tmp_path / "out" / "train" / "clip").glob("*.png"))] == [
        "000001.png", "000002.png", "000003.png",
    ]  # fmt: skip
    assert written.losses == {"frame_renumbered": 2, "name_changed": 3}
    (problem,) = written.problems
    assert problem.code == "frames-missing" and "3 picture(s), without 3 of the numbers" in problem.found
    assert [i.capture.frame for i in again.images] == [0, 3, 5]


def test_visible_shares_are_kept_and_hidden_objects_are_absent(tmp_path: Path) -> None:
    images = [image(tmp_path, n, drone(0, n, visibility=v)) for n, v in enumerate((0.25, None, 0.0))]
    written, again = converted(images, tmp_path / "out")
    assert label(tmp_path / "out" / "train" / "clip") == {
        "exist": [1, 1, 0], "gt_rect": [[0, 2, 9.5, 5.25], [1, 2, 9.5, 5.25], []], "visibility": [0.25, None, None],
    }  # fmt: skip
    assert written.losses["hidden_absent"] == 1 and written.left_out == {("train", "drone"): 1}
    assert "visibility_dropped" not in written.losses
    assert [[o.visibility for o in i.instances] for i in again.images] == [[0.25], [None], []]


def test_times_and_dates_come_back(tmp_path: Path) -> None:
    """A date in a sequence's name needs no row."""
    dated = image(tmp_path, 0, drone(0), sequence="20190925_1")
    dated = replace(dated, capture=replace(dated.capture, captured="2019-09-25"))
    timed = image(tmp_path, 0, drone(0), sequence="a")
    timed = replace(timed, capture=replace(timed.capture, captured="2020-01-01T10:00", time_s=0.5, hfov_deg=1.2))
    _, again = converted([dated, timed], tmp_path / "out")
    assert {i.capture for i in again.images} == {dated.capture, timed.capture}
    source = dataset_folder.read(tmp_path / "out")
    writing.write("anti-uav", tmp_path / "again", source.images, CATEGORIES)
    assert (tmp_path / "again" / "names.csv").read_text().splitlines() == [
        "file,name,sequence,frame,captured,time_s",
        "train/a/000001.png,a/ir/000001.png,a,0,2020-01-01T10:00,0.5",
    ]


@pytest.mark.parametrize("row", ["train/clip_9,train/clip,x,drone,9,0", "train/clip_9,train/clip,1,,9,0", "a,b"])
def test_bad_rows_of_targets_are_said(row: str, tmp_path: Path) -> None:
    writing.write("anti-uav", tmp_path / "out", [image(tmp_path, 0, drone(0))], CATEGORIES)
    (tmp_path / "out" / "targets.csv").write_text(f"folder,of,first,category,track_id,ignore\n{row}\n")
    d = dataset_folder.read(tmp_path / "out")
    assert codes(d) == ["row-malformed"] and d.problems[0].where == "targets.csv: line 2"


def test_a_run_on_it_still_writes_coco_as_native(tmp_path: Path) -> None:
    source = dataset_folder.read(SAMPLES["anti-uav"](tmp_path / "data"))
    writer = writing.native_writer(source)
    assert writer is not None and writer.name == "coco"
