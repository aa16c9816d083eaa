"""Tracks of objects through formats that hold them: the same ids, frames and boxes; what is lost is counted."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.core.format_table import WRITERS, Writer
from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder, writing
from infrablend.formats.losses import Written
from infrablend.formats.read_write import Reading, WriteSettings
from tests.samples import SIZE_WH, codes, picture

CATEGORIES = (Category(0, "drone"), Category(1, "bird"))


def image(folder: Path, frame: int | None, *objects: Instance, sequence: str | None = "clip") -> ImageRecord:
    name = f"{sequence}_{frame}.png"
    path = picture(folder / name, sum(map(ord, name)))
    return ImageRecord(path.stem, path, "train", SIZE_WH, objects, Capture(sequence=sequence, frame=frame))


def drone(track: int | str | None, x: float = 0.0, category: str = "drone") -> Instance:
    return Instance(category, np.array([x, 2.0, x + 9.5, 7.25]), track_id=track)


def flight(folder: Path) -> list[ImageRecord]:
    """Two objects that come and go in frames 0, 1, 2 and 4."""
    shown = {0: (drone(7, 1),), 1: (drone(7, 2), drone(9, 30, "bird")), 2: (), 4: (drone(7, 4), drone(9, 33, "bird"))}
    return [image(folder, frame, *objects) for frame, objects in shown.items()]


def converted(name: str, images: list[ImageRecord], out: Path) -> tuple[Written, Dataset]:
    written = writing.write(name, out, images, CATEGORIES)
    assert set(written.files) == {p for p in out.rglob("*") if p.is_file()}
    again = dataset_folder.read(out)
    assert codes(again) == []
    return written, again


@pytest.mark.parametrize(
    "writer",
    [w for w in WRITERS if "tracks" not in w.lacks and w.name != "monet"],
    ids=lambda w: w.name,
)
def test_ids_frames_and_boxes_come_back(writer: Writer, tmp_path: Path) -> None:
    images = flight(tmp_path)
    written, again = converted(writer.name, images, tmp_path / "out")
    assert not {"tracks_dropped", "track_made", "track_renumbered", "sequence_dropped"} & set(written.losses)
    found = {i.path.read_bytes(): i for i in again.images}
    for before in images:
        after = found[before.path.read_bytes()]
        assert (after.capture.sequence, after.capture.frame) == ("clip", before.capture.frame)
        objects = {(str(o.track_id), o.category): o for o in after.instances}
        assert set(objects) == {(str(o.track_id), o.category) for o in before.instances}
        for o in before.instances:
            np.testing.assert_allclose(objects[str(o.track_id), o.category].box_xyxy, o.box_xyxy, rtol=0, atol=1e-6)


@pytest.mark.parametrize("writer", [w for w in WRITERS if "tracks" in w.lacks], ids=lambda w: w.name)
def test_a_format_without_tracks_counts_each(writer: Writer, tmp_path: Path) -> None:
    losses = writing.write(writer.name, tmp_path / "out", flight(tmp_path), CATEGORIES).losses
    assert losses["tracks_dropped"] == 5


# -- COCO ------------------------------------------------------------------------------------------------------


def coco_file(root: Path, records: list[dict[str, Any]], annotations: list[dict[str, Any]], **more: Any) -> Path:
    for k, record in enumerate(records):
        picture(root / "images" / record["file_name"], k)
    images = [{"id": k, "width": 64, "height": 48, **r} for k, r in enumerate(records, 1)]
    boxes = [{"id": k, "bbox": [1, 2, 3, 4], "category_id": 1, **a} for k, a in enumerate(annotations, 1)]
    top = {"images": images, "annotations": boxes, "categories": [{"id": 1, "name": "deer"}], **more}
    (root / "train.json").write_text(json.dumps(top))
    return root


def test_cocos_videos_count_frames_from_zero(tmp_path: Path) -> None:
    converted("coco", flight(tmp_path), tmp_path / "out")
    top = json.loads((tmp_path / "out" / "annotations" / "instances_train.json").read_text())
    assert top["videos"] == [{"id": 1, "name": "clip"}]
    assert sorted((i["video_id"], i["frame_id"]) for i in top["images"]) == [(1, 0), (1, 1), (1, 2), (1, 4)]


def test_tracks_by_the_names_of_other_tools(tmp_path: Path) -> None:
    """CocoVID's `instance_id`, TAO's `frame_index`, and the attribute that CVAT exports."""
    records = [{"file_name": "a.png", "video_id": 3, "frame_index": 5}, {"file_name": "b.png", "frame_id": 0}]
    annotations: list[dict[str, Any]] = [
        {"image_id": 1, "instance_id": 4},
        {"image_id": 1, "attributes": {"track_id": 8, "occluded": False}},
        {"image_id": 1, "track_id": 1, "instance_id": 2},
        {"image_id": 2, "attributes": {"occluded": True}},
    ]
    d = dataset_folder.read(coco_file(tmp_path, records, annotations, videos=[{"id": 3, "name": "north"}]))
    assert [(i.capture.sequence, i.capture.frame) for i in d.images] == [("north", 5), (None, 0)]
    assert [[o.track_id for o in i.instances] for i in d.images] == [[4, 8, 1], [None]]


@pytest.mark.parametrize(
    "said, track",
    [
        ({"track_id": -1}, None),
        ({"track_id": "-1"}, None),
        ({"track_id": -1.0}, None),
        ({"instance_id": -1}, None),
        ({"attributes": {"track_id": -1}}, None),
        ({"track_id": -1, "instance_id": 4}, 4),
        ({"track_id": -2}, -2),
    ],
)
def test_objects_that_no_tracker_has_assigned_are_no_track(
    tmp_path: Path, said: dict[str, Any], track: int | None
) -> None:
    """-1 is no object that jumps through the sequence."""
    annotations = [{"image_id": n, **said} for n in (1, 2)]
    d = dataset_folder.read(coco_file(tmp_path, [{"file_name": "a.png"}, {"file_name": "b.png"}], annotations))
    assert [o.track_id for i in d.images for o in i.instances] == [track] * 2
    missing = [p.found for p in d.problems if p.code == "track-missing"]
    assert missing == ["2 object(s) with track -1, read as objects without a track"] * (track is None)


def test_the_sources_ids_stay_texts(tmp_path: Path) -> None:
    records = [{"file_name": "a.png", "id": "1e5"}, {"file_name": "b.png", "id": "100000"}]
    annotations = [{"image_id": "1e5", "id": "07"}, {"image_id": 100000, "id": "7"}]
    d = dataset_folder.read(coco_file(tmp_path / "in", records, annotations))
    writing.write("coco", tmp_path / "out", d.images, d.categories, settings=WriteSettings(ids="source"))
    top = json.loads((tmp_path / "out/annotations/instances_train.json").read_text())
    assert [i["id"] for i in top["images"]] == ["1e5", "100000"]
    assert [(a["image_id"], a["id"]) for a in top["annotations"]] == [("1e5", "07"), ("100000", "7")]


# -- CVAT for video --------------------------------------------------------------------------------------------


def video_task(
    root: Path, tracks: str, numbers: range = range(3), *, meta: str = "", names: str = "frame_{:06d}.png"
) -> Path:
    for n in numbers:
        picture(root / "images" / names.format(n), n)
    head = f"<task><name>north</name><mode>interpolation</mode>{meta}</task>"
    text = f"<?xml version='1.0'?><annotations><version>1.1</version><meta>{head}</meta>{tracks}</annotations>"
    (root / "annotations.xml").write_text(text)
    return root


def shape(frame: int | str, x: float = 5, more: str = 'keyframe="1" outside="0" occluded="0"') -> str:
    return f'<box frame="{frame}" {more} xtl="{x}" ytl="2" xbr="{x + 9}" ybr="12.5"></box>'


def test_a_video_task_of_cvat_is_read(tmp_path: Path) -> None:
    gone, hidden = 'keyframe="1" outside="1" occluded="0"', 'keyframe="0" outside="0" occluded="1"'
    tracks = (
        f'<track id="0" label="deer">{shape(0)}{shape(1, 6, hidden)}{shape(2, 6, gone)}'
        f'</track><track id="1" label="boar">{shape(2, 30)}</track>'
    )
    d = dataset_folder.read(video_task(tmp_path, tracks))
    assert (d.format, d.problems) == ("cvat", ())
    assert [(i.capture.sequence, i.capture.frame) for i in d.images] == [("north", 0), ("north", 1), ("north", 2)]
    assert [[(o.category, o.track_id, o.box_xyxy[0]) for o in i.instances] for i in d.images] == [
        [("deer", 0, 5)], [("deer", 0, 6)], [("boar", 1, 30)],
    ]  # fmt: skip
    assert d.images[1].instances[0].extra == {"occluded": True}


def test_the_attribute_is_the_track_where_there_is_one(tmp_path: Path) -> None:
    named = shape(0).replace("></box>", '><attribute name="track_id">left</attribute></box>')
    empty = shape(0).replace("></box>", '><attribute name="track_id"></attribute></box>')
    tracks = f'<track id="4" label="deer">{named}</track><track id="5" label="deer">{empty}</track>'
    assert [o.track_id for o in dataset_folder.read(video_task(tmp_path, tracks)).images[0].instances] == ["left", 5]


def test_a_track_of_cvat_without_a_number_is_none(tmp_path: Path) -> None:
    d = dataset_folder.read(video_task(tmp_path, f'<track id="-1" label="deer">{shape(0)}{shape(1)}{shape(2)}</track>'))
    assert [o.track_id for i in d.images for o in i.instances] == [None] * 3
    assert codes(d, "warning") == ["track-missing"]


def test_frames_are_numbers_of_names_or_positions(tmp_path: Path) -> None:
    """A task made from every tenth frame of a video, and one made from pictures."""
    tracks = f'<track id="0" label="deer">{shape(10)}</track>'
    d = dataset_folder.read(video_task(tmp_path / "a", tracks, range(0, 30, 10), meta="<stop_frame>20</stop_frame>"))
    assert [(i.capture.frame, len(i.instances)) for i in d.images] == [(0, 0), (10, 1), (20, 0)]
    tracks = f'<track id="0" label="deer">{shape(1)}</track>'
    d = dataset_folder.read(video_task(tmp_path / "b", tracks, range(5, 8), names="north-{}.png"))
    assert [(i.capture.frame, len(i.instances)) for i in d.images] == [(0, 0), (1, 1), (2, 0)] and d.problems == ()


def test_objects_that_are_gone_are_outside(tmp_path: Path) -> None:
    """CVAT keeps an object until a shape is outside; frames are positions in the task."""
    written, _ = converted("cvat-video", flight(tmp_path), tmp_path / "out")
    text = (tmp_path / "out/train/clip/annotations.xml").read_text()
    assert "<start_frame>0</start_frame>\n      <stop_frame>3</stop_frame>" in text
    shapes = [line.split(' occluded="')[0].strip() for line in text.splitlines() if "<box" in line or "<track" in line]
    assert shapes == [
        '<track id="7" label="drone" source="manual">',
        '<box frame="0" keyframe="1" outside="0"', '<box frame="1" keyframe="1" outside="0"',
        '<box frame="2" keyframe="1" outside="1"', '<box frame="3" keyframe="1" outside="0"',
        '<track id="9" label="bird" source="manual">',
        '<box frame="1" keyframe="1" outside="0"', '<box frame="2" keyframe="1" outside="1"',
        '<box frame="3" keyframe="1" outside="0"',
    ]  # fmt: skip
    assert written.losses == {"name_changed": 4}
    assert sorted(p.name for p in (tmp_path / "out/train/clip/images").iterdir())[-1] == "frame_000004.png"


def test_ids_of_any_kind_come_back_from_cvats_attribute(tmp_path: Path) -> None:
    objects = (drone("left"), drone(3, 10), drone(3, 20, "bird"), drone(None, 30), drone(3, 40))
    written, again = converted("cvat-video", [image(tmp_path, 0, *objects)], tmp_path / "out")
    ids = {o.box_xyxy[0]: o.track_id for o in again.images[0].instances}
    assert {x: ids[x] for x in (0, 10, 20)} == {0: "left", 10: 3, 20: 3}
    assert len({ids[30], ids[40], 3, "left"}) == 4  # no track, and the second object of one in the picture
    assert written.losses["track_made"] == 2


@pytest.mark.parametrize(
    ("tracks", "errors", "warnings"),
    [
        (f'<track id="0" label="deer">{shape("x")}{shape(1)}</track>', ["row-malformed"], []),
        (f'<track id="0" label="deer">{shape(-1)}{shape(1)}</track>', ["row-malformed"], []),
        (f'<track id="0">{shape(0)}</track><track id="1" label="a">{shape(0)}</track>', ["category-unknown"], []),
        (f'<track id="0" label="deer">{shape(0, 90)}{shape(1)}</track>', ["box-outside"], []),
        (f'<track id="0" label="deer">{shape(1)}{shape(1, 8)}</track>', [], ["track-twice"]),
        (f'<track id="0" label="deer">{shape(2)}{shape(3)}</track>', [], ["row-without-picture"]),
        (f'<track id="0" label="deer">{shape(0)}{shape(2)}</track>', [], ["track-gaps"]),
        (f'<track id="0" label="deer">{shape(0)}<points frame="1" points="1,2"/></track>', [], ["kind-unread"]),
        (
            "".join(f'<track id="{k}" label="a" task_id="{k}">{shape(0)}</track>' for k in range(2)),
            ["annotation-layout", "image-missing"],
            [],
        ),
    ],
)
def test_faults_of_a_video_task_are_named(tmp_path: Path, tracks: str, errors: list[str], warnings: list[str]) -> None:
    try:
        problems = dataset_folder.read(video_task(tmp_path, tracks)).problems
    except DatasetError as error:
        problems = tuple(error.problems)
    assert [p.code for p in problems if p.severity == "error"] == errors
    assert [p.code for p in problems if p.severity == "warning"] == warnings


def test_a_video_task_without_pictures_and_one_without_tracks(tmp_path: Path) -> None:
    bare = video_task(tmp_path / "a", f'<track id="0" label="a">{shape(0)}</track>', range(1))
    (bare / "images" / "frame_000000.png").unlink()
    with pytest.raises(DatasetError) as caught:
        dataset_folder.read(bare, Reading(format="cvat"))
    assert caught.value.problems[0].code == "image-missing"
    d = dataset_folder.read(video_task(tmp_path / "b", ""))
    assert [i.instances for i in d.images] == [(), (), ()] and d.problems == ()


# -- BIRDSAI ---------------------------------------------------------------------------------------------------


def test_birdsai_counts_frames_from_zero_and_ids_that_are_text(tmp_path: Path) -> None:
    images = [image(tmp_path, frame, drone("left"), drone("4", 20), drone(0, 40)) for frame in (0, 1)]
    written, again = converted("birdsai", images, tmp_path / "out")
    (table,) = (tmp_path / "out" / "TrainReal" / "annotations").iterdir()
    assert [line.split(",")[:2] for line in table.read_text().splitlines()] == [
        ["0", "5"], ["0", "4"], ["0", "0"], ["1", "5"], ["1", "4"], ["1", "0"],
    ]  # fmt: skip
    assert written.losses["track_renumbered"] == 2 and "track_made" not in written.losses
    assert [i.capture.frame for i in again.images] == [0, 1]


# -- VisDrone's videos -----------------------------------------------------------------------------------------


def visdrone_video(root: Path, text: str | None, count: int = 3, first: int = 1) -> Path:
    for n in range(count):
        picture(root / "VisDrone2019-VID-val" / "sequences" / "uav1" / f"{first + n:07d}.jpg", n)
    (root / "VisDrone2019-VID-val" / "annotations").mkdir()
    if text is not None:
        (root / "VisDrone2019-VID-val" / "annotations" / "uav1.txt").write_text(text)
    return root


def test_videos_of_visdrone_count_frames_from_one_and_pixels_from_zero(tmp_path: Path) -> None:
    d = dataset_folder.read(
        visdrone_video(tmp_path, "1,0,0,0,10,8,1,4,0,0\n3,0,54,40,10,8,1,4,1,2\n3,5,1,1,9,9,0,11,0,0\n")
    )
    assert (d.format, d.problems) == ("visdrone", ())
    assert [(i.split, i.capture.sequence, i.capture.frame) for i in d.images] == [("val", "uav1", n) for n in range(3)]
    assert [[(o.category, o.track_id) for o in i.instances] for i in d.images] == [
        [("car", 0)], [], [("car", 0), ("others", 5)],
    ]  # fmt: skip
    assert d.images[0].instances[0].box_xyxy.tolist() == [0, 0, 10, 8]
    assert d.images[2].instances[0].box_xyxy.tolist() == [54, 40, 64, 48] and d.images[2].instances[0].truncated
    assert all(i.extra == {} for i in d.images)  # names of published videos say that they are in visible light


def test_faults_of_visdrones_videos_are_named(tmp_path: Path) -> None:
    good, row = "1,0,1,1,9,9,1,4,0,0\n", "1,4,0,0\n"
    text = f"{good}0,0,1,1,9,9,{row}1,0,1,1,{row}1,0,20,1,9,9,{row}2,0,90,1,9,9,{row}"
    text += f"2,1,1,1,9,9,1,12,0,0\n9,0,1,1,9,9,{row}"
    d = dataset_folder.read(visdrone_video(tmp_path / "a", text))
    assert codes(d) == ["label-malformed", "label-malformed", "box-outside", "category-unknown"]
    assert codes(d, "warning") == ["track-twice", "row-without-picture"]
    assert d.notes["rows"]["objects"] == 7 and d.notes["rows"]["read"] == 2
    bare = visdrone_video(tmp_path / "b", good, first=0)
    assert codes(dataset_folder.read(bare)) == ["name-grammar"]
    both = visdrone_video(tmp_path / "c", good)
    picture(both / "VisDrone2019-VID-val" / "sequences" / "uav2" / "0000001.jpg", 9)
    d = dataset_folder.read(both)
    assert codes(d, "warning") == ["label-missing"] and d.images[-1].extra["labelled"] is False
