"""Plain folders, YOLO and COCO as input: layouts, tables of pitch and altitude, bad labels."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image

from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, ImageRecord, Instance
from infrablend.core.rle_masks import Mask
from infrablend.core.yaml_text import read_yaml
from infrablend.errors import DatasetError, Problem, UnknownFormatError
from infrablend.formats import dataset_folder, writing
from infrablend.formats.labels import coco, folder, yolo
from infrablend.formats.picture_facts import Captures, read_table
from infrablend.formats.published.hit_uav import CATEGORIES
from infrablend.formats.read_write import Reading
from tests.samples import SAMPLES, codes

FLIGHT = Capture(sequence="flight")


def picture(path: Path, size_wh: tuple[int, int] = (100, 80)) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.full(size_wh[::-1], 90, np.uint8)).save(path)
    return path


def yolo_dataset(root: Path, more: str, *lines: str, train: str = "images") -> Path:
    """Write a dataset of one picture of 100 x 80 px with these lines, and keys of data.yaml beside the usual ones."""
    picture(root / "images" / "a.png")
    (root / "labels").mkdir()
    (root / "labels" / "a.txt").write_text("\n".join(lines))
    (root / "data.yaml").write_text(f"train: {train}\nval: {train}\nnames: [deer]\n{more}\n")
    return root


@pytest.mark.parametrize("train", ["images", "elsewhere"])
@pytest.mark.parametrize("shape", [(2, 3), (2, 2), (17, 3), (1, 3)])
def test_of_yolo_pose_the_box_is_read_and_the_keypoints_counted(
    tmp_path: Path, shape: tuple[int, int], train: str
) -> None:
    """Lines of nine numbers are no oriented boxes, those of other lengths no polygons; also in a plain folder."""
    points = " 0.45" * (shape[0] * shape[1])
    lines = (f"0 0.5 0.5 0.2 0.2{points}", "0 0.2 0.2 0.1 0.1", f"0 0.5 0.5 0.1 0.1{points} 0.5 0.5")
    root = yolo_dataset(tmp_path, f"kpt_shape: [{shape[0]}, {shape[1]}]", *lines, train=train)
    (root / "labels" / "lost.txt").write_text(lines[0])
    d = dataset_folder.read(root)
    assert d.format == ("yolo" if train == "images" else "folder")
    deer, other = d.images[0].instances
    np.testing.assert_allclose(deer.box_xyxy, [40, 32, 60, 48])
    assert [(i.corners_xy, i.mask) for i in (deer, other)] == [(None, None)] * 2
    assert codes(d) == ["label-malformed"]
    (left_out,) = (p for p in d.problems if p.code == "kind-unread")
    assert left_out.where == "labels/a.txt: line 1" and left_out.found.endswith(": 1 objects' keypoints")
    assert "label-without-picture" in codes(d, "warning")


@pytest.mark.parametrize("said", ["kpt_shape: 17", "kpt_shape: [17, x]", "kpt_shape: [0, 3]", "task: pose"])
def test_yolo_pose_without_a_number_of_keypoints_is_refused(tmp_path: Path, said: str) -> None:
    with pytest.raises(DatasetError) as caught:
        dataset_folder.read(yolo_dataset(tmp_path, said, "0 0.5 0.5 0.2 0.2 0.4 0.4 2 0.5 0.5 2"))
    assert "kpt_shape" in caught.value.problems[0].found


@pytest.mark.parametrize(
    "said, oriented",
    [("", True), ("task: obb", True), ("task: segment", False), ("task: detect", False), ("task: [x]", True)],
)
def test_the_stated_task_tells_polygons_of_four_corners_from_oriented_boxes(
    tmp_path: Path, said: str, oriented: bool
) -> None:
    (deer,) = dataset_folder.read(yolo_dataset(tmp_path, said, "0 0.2 0.2 0.4 0.2 0.4 0.4 0.2 0.4")).images[0].instances
    assert (deer.corners_xy is not None, deer.mask is not None) == (oriented, not oriented)


BOX = "0 0.5 0.5 0.25 0.25"
TURNED = "0 0.5 0.4 0.6 0.5 0.5 0.6 0.4 0.5"
TRIANGLE = "0 0.2 0.2 0.4 0.2 0.3 0.4"


@pytest.mark.parametrize("place, corners", [(BOX, False), (TURNED, True)])
@pytest.mark.parametrize(
    "added, tracks, confidences",
    [
        (("0.9 7", "0.8 1", "0.7"), [7, 1, None], 3),
        (("0.9 0", "1 1"), [0, 1], 2),
        (("7 0.9", "123456789 0.9"), [7, 123456789], 2),
        (("0.9 -1", "0.8 2"), [None, 2], 2),
        (("0", "1", "2"), [0, 1, 2], 0),
        (("0.9", "1"), [None, None], 2),
        (("0.9", ""), [None, None], 1),
    ],
)
def test_predictions_are_boxes_with_tracks_and_their_confidences_are_counted(
    tmp_path: Path, place: str, corners: bool, added: Sequence[str], tracks: list[int | None], confidences: int
) -> None:
    """As Ultralytics' trackers write them; a box and two numbers is no triangle: ultralytics 1170 and 22256."""
    d = dataset_folder.read(yolo_dataset(tmp_path, "task: detect" * (not corners), *(f"{place} {a}" for a in added)))
    found = d.images[0].instances
    assert [i.track_id for i in found] == tracks and codes(d) == []
    assert all(i.mask is None and (i.corners_xy is not None) == corners for i in found)
    np.testing.assert_allclose(
        [i.box_xyxy for i in found], [[40, 32, 60, 48] if corners else [37.5, 30, 62.5, 50]] * len(found)
    )
    said = [p.found.rpartition(": ")[2] for p in d.problems if p.code == "kind-unread"]
    assert said == ([f"{confidences} confidences of predicted objects"] if confidences else [])


def test_a_triangle_is_a_polygon_in_a_dataset_of_polygons(tmp_path: Path) -> None:
    """A corner at the edge is as a confidence and a track; a track beyond 1 is none, and a box needs no number more."""
    lines = (TRIANGLE, "0 0.5 0.5 0.3 0.3 0.4 1", f"{TRIANGLE} 0.1 0.3 0.2 1", f"{BOX} 0.9 3", f"{BOX} 0.9")
    d = dataset_folder.read(yolo_dataset(tmp_path, "", *lines))
    assert [(i.mask is not None, i.track_id) for i in d.images[0].instances] == [(True, None)] * 3 + [(False, 3)]
    assert codes(d) == ["label-malformed"]


QUAD = f"{TRIANGLE} 0.1 0.3"
PENTAGON = f"{QUAD} 0.1 0.25"


@pytest.mark.parametrize(
    "said, added, tracks, errors",
    [
        ("", ("0.9 4", "1 1", "0.8 123"), [4, 1, 123], 0),
        ("task: segment", ("0.9 4", "0.8 1"), [4, 1], 0),
        ("", ("0.9 1", "0.8 1"), [], 2),  # corners at the lower edge, or a confidence and the first track
        ("task: segment", ("0.9 1", "0.8 1"), [None, None], 0),
        ("", ("0.9 1", "0.8 0.3"), [None, None], 0),
        ("", ("0.9 1", "0.8 4", ""), [None], 2),
        ("", ("0.9 1.5",), [None], 0),
    ],
)
@pytest.mark.parametrize("place", [QUAD, PENTAGON])
def test_no_number_of_a_track_becomes_a_corner_of_a_polygon(
    tmp_path: Path, said: str, added: Sequence[str], tracks: list[int | None], errors: int, place: str
) -> None:
    """As Ultralytics' trackers write masks; what may be either is an error that says how to decide."""
    d = dataset_folder.read(yolo_dataset(tmp_path, said, *(f"{place} {a}" for a in added)))
    found = d.images[0].instances
    assert codes(d) == ["label-malformed"] * errors and [i.track_id for i in found] == tracks
    for i in found:
        assert i.mask is not None or place == QUAD
        if i.track_id is not None:
            np.testing.assert_allclose(i.box_xyxy, [10, 16, 40, 32])


@pytest.mark.parametrize("said, tracks", [("", [1, 2, 1]), ("task: segment", [None, None])])
def test_lines_of_one_length_are_boxes_with_tracks_or_polygons(
    tmp_path: Path, said: str, tracks: list[int | None]
) -> None:
    lines = (f"{BOX} 0.87 1", "0 0.3 0.3 0.1 0.1 0.9 2", f"{BOX} 0.8 1", f"{QUAD} 0.2 0.2")
    found = dataset_folder.read(yolo_dataset(tmp_path, said, *lines)).images[0].instances
    assert [(i.track_id, i.mask is not None) for i in found] == [*((t, t is None) for t in tracks), (None, True)]


@pytest.mark.parametrize("box", ["0.5 0.5 1.0000001 0.25", "-0.0001 0.5 0.2 0.25", "0.99 0.5 0.1 1.02"])
@pytest.mark.parametrize("added", [" 0.9", " 0.9 4"])
def test_predicted_boxes_are_clipped_as_others(tmp_path: Path, box: str, added: str) -> None:
    boxes = [
        dataset_folder.read(yolo_dataset(tmp_path / name, "", f"0 {box}{further}")).images[0].instances[0].box_xyxy
        for name, further in (("plain", ""), ("predicted", added))
    ]
    np.testing.assert_array_equal(*boxes)


def test_keypoints_may_have_a_confidence_and_a_track_behind_them(tmp_path: Path) -> None:
    lines = (f"{BOX} 0.4 0.4 0.6 0.6 0.9 12", BOX)
    d = dataset_folder.read(yolo_dataset(tmp_path, "kpt_shape: [2, 2]", *lines))
    assert [i.track_id for i in d.images[0].instances] == [12, None] and codes(d) == []


def test_written_polygons_of_four_corners_are_read_as_polygons(tmp_path: Path) -> None:
    mask = np.zeros((80, 100), np.bool_)
    mask[10:20, 30:50] = True
    deer = Instance("deer", np.array([30.0, 10.0, 50.0, 20.0]), mask=Mask.from_array(mask))
    image = ImageRecord("a", picture(tmp_path / "a.png"), "train", (100, 80), (deer,))
    writing.write("yolo-seg", tmp_path / "out", [image], [Category(0, "deer")])
    ((found,),) = (i.instances for i in dataset_folder.read(tmp_path / "out").images)
    assert found.corners_xy is None and found.mask is not None and (found.mask.to_array() == mask).all()


def test_a_bare_folder_is_train(tmp_path: Path) -> None:
    for name in ("b.png", "sub/a.jpg", ".hidden.png", "sub/.x/c.png", "notes.txt"):
        picture(tmp_path / name) if name.endswith(("png", "jpg")) else (tmp_path / name).write_text("1 2 3")
    d = dataset_folder.read(tmp_path)
    assert (d.format, [i.id for i in d.images], {i.split for i in d.images}) == ("folder", ["a", "b"], {"train"})
    assert [i.size_wh for i in d.images] == [None, None] and d.problems == () and d.categories == ()


@pytest.mark.parametrize("inside", ["", "images/"])
def test_split_folders_are_splits(tmp_path: Path, inside: str) -> None:
    for name in ("train/a.png", "valid/a.png", "test/0_60_30_0_00001.png"):
        picture(tmp_path / (inside + name))
    picture(tmp_path / "stray.png")
    d = folder.read(tmp_path)
    where = inside.replace("/", "__")
    expected = [(f"{where}train__a", "train"), (f"{where}valid__a", "val"), ("0_60_30_0_00001", "test")]
    assert [(i.id, i.split) for i in d.images] == expected
    assert (d.images[2].capture.pitch_deg, d.images[2].capture.altitude_m, d.images[2].capture.time_of_day) == (
        30,
        60,
        "day",
    )
    assert codes(dataset_folder.read(tmp_path), "warning") == ["image-unlisted"]
    assert [i.split for i in folder.read(tmp_path, splits=["test"]).images] == ["test"]


def test_tables_give_pitch_and_altitude(tmp_path: Path) -> None:
    for name in ("a.png", "b.png", "c.png", "0_60_30_0_00001.png"):
        picture(tmp_path / name)
    rows = ["file,pitch_deg,altitude_m,time_of_day", "a.png,35.5,80,night", "0_60_30_0_00001.png,40,,", "z.png,1,1,"]
    rows += ["b.png,nan,3,", "a.png,1,1,day", "c.png,-12,,noon"]
    (tmp_path / "metadata.csv").write_text("\n".join(rows))
    d = dataset_folder.read(tmp_path)
    by_id = {i.id: i for i in d.images}
    assert (by_id["a"].capture.pitch_deg, by_id["a"].capture.altitude_m, by_id["a"].capture.time_of_day) == (
        35.5,
        80,
        "night",
    )
    assert (by_id["0_60_30_0_00001"].capture.pitch_deg, by_id["0_60_30_0_00001"].capture.altitude_m) == (40, 60)
    assert by_id["b"].capture.pitch_deg is None
    assert codes(d) == ["table-value", "table-duplicate", "table-value"]
    assert codes(d, "warning") == ["metadata-disagrees", "table-unused"]
    assert "line 5" in next(p.where for p in d.problems if p.code == "table-value")


@pytest.mark.parametrize(
    "content", [[{"stem": "a", "pitch_deg": 45}], {"a": {"pitch_deg": "45"}}, {"a.png": {"pitch_deg": 45.0}}]
)
def test_tables_may_be_json(tmp_path: Path, content: Any) -> None:
    picture(tmp_path / "in" / "a.png")
    (tmp_path / "t.json").write_text(json.dumps(content))
    assert folder.read(tmp_path / "in", metadata=tmp_path / "t.json").images[0].capture.pitch_deg == 45


def test_table_row_may_name_a_sequence(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(
        "sequence,file,pitch_deg,altitude_m\nflight,,30,80\n,flight/b.png,,70\nother,,1,1\n"
    )
    problems: list[Problem] = []
    captures = Captures(read_table(tmp_path / "t.csv"), problems)
    assert captures.of("flight/a.png", "a", FLIGHT) == Capture(30, 80, sequence="flight")
    assert captures.of("flight/b.png", "b", FLIGHT) == Capture(30, 70, sequence="flight")
    assert captures.of("flight/c.png", "c", Capture(45, sequence="flight")) == Capture(
        45, 80, sequence="flight"
    )  # the annotation takes precedence
    assert captures.of("0_60_90_0_00001.png", "d", FLIGHT) == Capture(90, 60, "day", sequence="flight")
    assert captures.of("e.png", "e") == Capture()
    assert (
        captures.note() == "annotation (1 of 5), file names (1 of 5), none (1 of 5), table t.csv per sequence (2 of 5)"
    )
    assert captures.table is not None and captures.table.unused(["flight/b.png"], ["flight"]) == ["other"]
    assert problems == []


@pytest.mark.parametrize("text", ["", "name,pitch\na,1\n", "file,size\na,1\n", "\xff"])
def test_invalid_tables_are_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "t.csv").write_bytes(text.encode("latin-1"))
    with pytest.raises(DatasetError):
        read_table(tmp_path / "t.csv")


def test_sidecar_labels(tmp_path: Path) -> None:
    picture(tmp_path / "clip" / "a b.png")
    picture(tmp_path / "clip" / "c.png")
    (tmp_path / "clip" / "a b.txt").write_text("1 0.5 0.5 0.2 0.25\n")
    d = folder.read(tmp_path)
    assert d.categories == (Category(1, "class_1"),)
    assert d.images[0].instances[0].box_xyxy.tolist() == pytest.approx([40, 30, 60, 50])
    assert codes(d, "warning") == ["names-missing", "label-missing"]
    (tmp_path / "classes.txt").write_text("cow\nhorse\n")
    assert folder.read(tmp_path).images[0].instances[0].category == "horse"
    assert folder.read(tmp_path, labels="none").images[0].instances == ()


BAD_LINES = (
    ("0 0.5 0.5 0.2", "label-malformed"),
    ("0 0.5 0.5 0.2 x", "label-malformed"),
    ("-1 0.5 0.5 0.2 0.2", "label-malformed"),
    ("0.5 0.5 0.5 0.2 0.2", "label-malformed"),
    ("0 0.5 0.5 0.2 0.2 1.9", "label-malformed"),
    ("0 0.5 0.5 0.2 0.2 0.9 98.5", "label-malformed"),
    ("0 nan 0.5 0.2 0.2", "box-not-finite"),
    ("0 0.5 0.5 0 0.2", "box-empty"),
    ("0 1.5 0.5 0.2 0.2", "box-outside"),
    ("7 0.5 0.5 0.2 0.2", "category-unknown"),
)


@pytest.mark.parametrize(("line", "code"), BAD_LINES)
def test_bad_label_lines_are_named_and_left_out(tmp_path: Path, line: str, code: str) -> None:
    picture(tmp_path / "images" / "train" / "a.png")
    label = tmp_path / "labels" / "train" / "a.txt"
    label.parent.mkdir(parents=True)
    label.write_text(f"0 0.25 0.25 0.1 0.1\n{line}\n")
    (tmp_path / "data.yaml").write_text("train: images/train\nval: images/train\nnames: [cow]\n")
    d = dataset_folder.read(tmp_path)
    assert d.format == "yolo" and codes(d) == [code] and len(d.images[0].instances) == 1
    assert next(p.where for p in d.problems if p.code == code) == "labels/train/a.txt: line 2"


def test_box_over_the_edge_is_clipped_and_reported(tmp_path: Path) -> None:
    picture(tmp_path / "a.png")
    (tmp_path / "a.txt").write_text("0 0 0.5 0.2 0.25\n0 0 0.5 0.2 0.25\n")
    d = folder.read(tmp_path)
    assert [o.box_xyxy.tolist() for o in d.images[0].instances] == [[0, 30, 10, 50]] * 2
    assert sorted(codes(d, "warning")) == ["box-clipped", "box-clipped", "names-missing", "object-duplicate"]


def ultralytics_label(path: Path) -> Path:
    """Return the label file that Ultralytics looks for: `labels` in place of the last `images` of the path."""
    before, after = str(path).rsplit("/images/", 1)
    return Path(f"{before}/labels/{after}").with_suffix(".txt")


@pytest.mark.parametrize("task", yolo.TASKS)
def test_folders_in_names_do_not_hide_labels_of_yolo(tmp_path: Path, task: str) -> None:
    """`images/` and `labels/` are usual in plain folders and in the names of pictures in COCO files."""
    names = ("images/1.png", "flight/images/a/2.png", "labels/3.png", "1.png", "plain/images.png", "Images/4.png")
    for k, name in enumerate(names):
        picture(tmp_path / "in" / name, (100 + k, 80))
    rows = [{"id": k, "file_name": name, "width": 100 + k, "height": 80} for k, name in enumerate(names)]
    objects = [{"id": k, "image_id": k, "category_id": 1, "bbox": [k, 20, 30, 40]} for k in range(len(names))]
    top = {"images": rows, "annotations": objects, "categories": [{"id": 1, "name": "cow"}]}
    (tmp_path / "in" / "train.json").write_text(json.dumps(top))
    source = coco.read(tmp_path / "in")
    writer = {"detect": "yolo", "obb": "yolo-obb", "seg": "yolo-seg"}[task]
    settings = writing.WriteSettings(without_mask="obb")
    written = writing.write(writer, tmp_path / "out", source.images, source.categories, settings=settings)
    assert written.losses["name_changed"] == 3
    pictures = [p for p in written.files if p.suffix == ".png"]
    assert {p.relative_to(tmp_path / "out/images/train").as_posix() for p in pictures} == {
        "images__1.png", "2.png", "3.png", "1.png", "plain/images.png", "Images/4.png",
    }  # fmt: skip
    assert len(pictures) == 6 and all(ultralytics_label(p).read_text().startswith("0 ") for p in pictures)
    again = yolo.read(tmp_path / "out")
    assert [len(i.instances) for i in again.images] == [1] * 6 and again.problems == ()
    sizes = {i.size_wh: i.path.name for i in again.images}
    assert sizes[100, 80] == "images__1.png" and sizes[103, 80] == "1.png"
    # Formats that find labels otherwise keep such names.
    assert "name_changed" not in writing.write("coco", tmp_path / "coco", source.images, source.categories).losses


def test_a_plain_folder_of_images_and_labels_becomes_yolo_with_its_labels(tmp_path: Path) -> None:
    picture(tmp_path / "in" / "images" / "0001.jpg")
    (tmp_path / "in" / "labels").mkdir()
    (tmp_path / "in" / "labels" / "0001.txt").write_text("0 0.5 0.5 0.2 0.25\n")
    (tmp_path / "in" / "classes.txt").write_text("cow\n")
    source = dataset_folder.read(tmp_path / "in")
    images = [replace(i, size_wh=(100, 80)) for i in source.images]
    assert writing.write("yolo", tmp_path / "out", images, source.categories).losses == {"name_changed": 1}
    (image,) = dataset_folder.read(tmp_path / "out").images
    assert image.name == "0001.jpg" and len(image.instances) == 1


@pytest.mark.parametrize("with_yaml", [False, True])
def test_labels_that_belong_to_no_picture_are_a_warning(tmp_path: Path, with_yaml: bool) -> None:
    picture(tmp_path / "images" / "train" / "images" / "a.png")
    if with_yaml:
        (tmp_path / "data.yaml").write_text("train: images/train\nval: images/val\nnames: [cow]\n")
        picture(tmp_path / "images" / "val" / "b.png")
    label = tmp_path / "labels" / "train" / "images" / "a.txt"
    label.parent.mkdir(parents=True)
    label.write_text("a note\n")
    assert "label-missing" not in codes(dataset_folder.read(tmp_path), "warning")
    label.write_text("0 0.5 0.5 0.5 0.5\n")
    d = dataset_folder.read(tmp_path)
    assert d.format == ("yolo" if with_yaml else "folder")
    (problem,) = [p for p in d.problems if p.code == "label-missing"]
    assert problem.severity == "warning" and "labels/train/images/a.txt" in problem.found
    if with_yaml:  # pictures of val may be without labels
        assert "label-missing" not in codes(yolo.read(tmp_path, splits=["val"]), "warning")
    else:
        assert "label-missing" not in codes(folder.read(tmp_path, labels="none"), "warning")


def test_data_yaml_stays_inside_the_folder(tmp_path: Path) -> None:
    picture(tmp_path / "outside" / "a.png")
    root = tmp_path / "data"
    picture(root / "train" / "images" / "b.png")
    (root / "train" / "labels").mkdir()
    (root / "train" / "labels" / "b.txt").write_text("0 0.5 0.5 0.5 0.5\n")
    (root / "data.yaml").write_text("train: ../train/images\nval: ../../outside\ntest: /etc\nnames: {0: cow}\n")
    d = yolo.read(root)
    assert [i.id for i in d.images] == ["b"] and len(d.images[0].instances) == 1
    assert codes(d) == ["name-climbs", "name-climbs"]


@pytest.mark.parametrize("text", ["- a", "train: [", "names: 3\ntrain: t", "train: t", "names: [a, a]\ntrain: t"])
def test_no_data_yaml_of_yolo(tmp_path: Path, text: str) -> None:
    picture(tmp_path / "t" / "b.png")
    (tmp_path / "data.yaml").write_text(text)
    assert not yolo.detect(tmp_path).ok
    with pytest.raises(DatasetError):
        yolo.read(tmp_path)


def test_wrong_number_of_classes_is_reported(tmp_path: Path) -> None:
    picture(tmp_path / "images" / "train" / "a.png")
    for nc, found in (("2", ["names"]), ("1", []), ("many", ["names"])):
        (tmp_path / "data.yaml").write_text(f"train: images/train\nnc: {nc}\nnames: [Person]\n")
        assert [c for c in codes(dataset_folder.read(tmp_path), "warning") if c == "names"] == found


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("names: [car, drone]", ["car", "drone"]),
        ("names:\n- car\n- drone\n", ["car", "drone"]),
        ("names: {0: car, 1: drone,}", ["car", "drone"]),
        ("names:\n  1: drone  # second\n  0: car\n", ["car", "drone"]),
        ("names:\n  '0': car\n  '1': drone\n", ["car", "drone"]),
        ("nc: 2\nnames: ['car', \"drone\"]", ["car", "drone"]),
        ("names: [car, drone]\ndownload: |\n  import a\n  x = {'b': [1]}\n\n  a.get(x)\n", ["car", "drone"]),
        ("download: https://a.b/c.zip\nnames: [car, drone]", ["car", "drone"]),
        ("roboflow:\n  license: CC BY 4.0\n  version: 1\nnames: [car, drone]", ["car", "drone"]),
        ("# a comment\r\nnames: [car, drone]\r\n", ["car", "drone"]),
        ("path:\nnames: [car, drone]", ["car", "drone"]),
        ("path: ../datasets/other # elsewhere\nnames: [car, drone]", ["car", "drone"]),
        ("nc: 2", ["class_0", "class_1"]),
        ("names:\nnc: 2", ["class_0", "class_1"]),
        ("names: ['no', \"off\", 'yes']", ["no", "off", "yes"]),
        ("names: [été, 😀]", ["été", "😀"]),
        ("names: [1, 2.5]", ["1", "2.5"]),
    ],
)
def test_data_yaml_is_read_as_ultralytics_reads_it(tmp_path: Path, text: str, names: list[str]) -> None:
    """The files that Ultralytics, which reads YAML 1.1, accepts give the same class names here."""
    picture(tmp_path / "a" / "images" / "1.png")
    picture(tmp_path / "b" / "images" / "2.png")
    picture(tmp_path / "c" / "images" / "3.png")
    (tmp_path / "data.yaml").write_text(f"train: [a/images, b/images]\nvalidation: c/images\n{text}\n")
    d = dataset_folder.read(tmp_path)
    assert d.format == "yolo" and [(i.name, i.split) for i in d.images] == [
        ("1.png", "train"), ("2.png", "train"), ("3.png", "val"),
    ]  # fmt: skip
    assert [c.name for c in d.categories] == names and not d.problems
    theirs = yaml.safe_load((tmp_path / "data.yaml").read_text()).get("names")
    if theirs is not None:
        items = theirs.items() if isinstance(theirs, dict) else enumerate(theirs)
        assert [str(v) for _, v in sorted((int(k), v) for k, v in items)] == names


@pytest.mark.parametrize(
    ("text", "names", "unlike"),
    [
        (
            "{0: no}",
            ["no"],
            ["class 0: no without quotes is a truth value for some YAML readers. Write 'no' in quotes"],
        ),
        ("[off, On, Yes, y]", ["off", "On", "Yes", "y"], ["class 0: off", "class 1: On", "class 2: Yes"]),
        ("[true, car]", ["true", "car"], ["true without quotes is a truth value"]),
        (
            "[a, b, 1e3, 0o17]",
            ["a", "b", "1e3", "0o17"],
            ["class 2: 1e3 without quotes is a number for some YAML readers. Write '1e3' in quotes", "0o17"],
        ),
        ("[12:30, 2020-01-01]", ["12:30", "2020-01-01"], ["12:30 without quotes is a number", "a date"]),
        ("[null, ~]", ["null", "~"], ["null without quotes is empty", "~ without quotes is empty"]),
        ("[0x10, 010, 1_000, 1.50]", ["0x10", "010", "1_000", "1.50"], ["0x10", "010", "1_000", "1.50"]),
    ],
)
def test_class_names_that_ultralytics_reads_otherwise_are_a_warning(
    tmp_path: Path, text: str, names: list[str], unlike: list[str]
) -> None:
    """Unquoted, `no` is False in YAML 1.1 (Ultralytics) and the word in YAML 1.2 (here): weights would not match."""
    picture(tmp_path / "images" / "1.png")
    (tmp_path / "data.yaml").write_text(f"train: images\nnames: {text}\n")
    d = dataset_folder.read(tmp_path)
    assert [c.name for c in d.categories] == names
    found = [str(p) for p in d.problems if p.code == "name-unquoted"]
    assert len(found) == len(unlike) == len(d.problems) and all(u in f for u, f in zip(unlike, found, strict=True))
    # Written again, the names are in quotes, and every reader finds the same text.
    written = yolo.data_yaml({name: k for k, name in enumerate(names)}, ["train"])[0]
    assert list(yaml.safe_load(written)["names"].values()) == names == list(read_yaml(written)["names"].values())


@pytest.mark.parametrize(
    "text", ["names: [a]\nnames: [b]", "names:\n\t- a", "names:\n  0: a\n  0: b", "names: !!python/name:os.system [a]"]
)
def test_data_yaml_that_is_ambiguous_is_refused(tmp_path: Path, text: str) -> None:
    picture(tmp_path / "images" / "1.png")
    (tmp_path / "data.yaml").write_text(f"train: images\n{text}\n")
    with pytest.raises(DatasetError) as stop:
        yolo.read(tmp_path)
    assert [p.code for p in stop.value.problems] == ["annotation-not-yaml"]


def test_every_class_name_written_is_the_same_in_yaml_1_1_and_1_2() -> None:
    names = [
        "no",
        "off",
        "Yes",
        "true",
        "null",
        "~",
        "1e3",
        "0o17",
        "017",
        "1_000",
        "12:30",
        "2020-01-01",
        "=",
        "<<",
        "-",
    ]
    names += ["a: b", "# a", "@b", ".nan", "1e-3", "0x1F", "é", "😀", "a b", "person"]
    text, _ = yolo.data_yaml({name: n for n, name in enumerate(names)}, ["train", "val"])
    assert list(yaml.safe_load(text)["names"].values()) == names
    assert list(yolo.class_names(read_yaml(text)["names"], "data.yaml").values()) == names
    assert "  24: person\n" in text  # quotes only where they are needed


def test_splits_may_be_lists_of_pictures(tmp_path: Path) -> None:
    for n in range(4):
        picture(tmp_path / "images" / f"{n}.png")
        (tmp_path / "labels").mkdir(exist_ok=True)
        (tmp_path / "labels" / f"{n}.txt").write_text("0 0.5 0.5 0.1 0.1\n")
    (tmp_path / "data.yaml").write_text("train: train.txt\nval: val.txt\nnames: [Person]\n")
    (tmp_path / "train.txt").write_text("./images/0.png\nimages/1.png\n")
    (tmp_path / "val.txt").write_text("images/2.png\nimages/1.png\nimages/9.png\n../3.png\n")
    d = dataset_folder.read(tmp_path)
    assert (d.format, [(i.name, i.split) for i in d.images]) == (
        "yolo",
        [("0.png", "train"), ("1.png", "train"), ("2.png", "val")],
    )
    assert all(len(i.instances) == 1 for i in d.images)
    assert sorted(codes(d)) == ["image-missing", "name-climbs"]
    assert codes(d, "warning")[0] == "split-twice"
    (only,) = dataset_folder.read(tmp_path, Reading(splits=["val"])).images
    assert only.name == "2.png"
    # A folder beside a list: the list counts.
    (tmp_path / "data.yaml").write_text("train: images\nval: val.txt\nnames: [Person]\n")
    (tmp_path / "val.txt").write_text("images/2.png\n")
    d = dataset_folder.read(tmp_path)
    assert [i.split for i in d.images] == ["train", "train", "train", "val"]
    assert codes(d, "warning") == ["split-twice"]


def test_classes_of_hit_uav_with_a_drone() -> None:
    categories = (*CATEGORIES, Category(5, "drone"))
    dropped = {"Person": 0, "Car": 1, "Bicycle": 2, "OtherVehicle": 3, "drone": 4}
    assert yolo.yolo_classes(categories) == dropped
    kept = {"Person": 0, "Car": 1, "Bicycle": 2, "OtherVehicle": 3, "DontCare": 4, "drone": 5}
    assert yolo.yolo_classes(categories[::-1], "keep") == kept


def test_data_yaml_of_one_split_names_it_three_times() -> None:
    text, problems = yolo.data_yaml({"a": 0, "yes": 1}, ["test"])
    assert text.splitlines()[1:] == [
        "train: images/test", "val: images/test", "test: images/test", "stand_ins: [train, val]", "names:",
        "  0: a", "  1: 'yes'",
    ]  # fmt: skip
    assert [p.code for p in problems] == ["train-absent", "val-absent"]
    text, problems = yolo.data_yaml({"a": 0}, ["train"])
    assert "val: images/train" in text and "test" not in text and [p.code for p in problems] == ["val-absent"]


def write_json(path: Path, top: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(top))


def write_coco(root: Path, **changes: Any) -> Path:
    picture(root / "images" / "a.png")
    top: dict[str, Any] = {
        "images": [{"id": 1, "file_name": "a.png", "width": 100, "height": 80}],
        "annotations": [{"id": 1, "image_id": 1, "category_id": 3, "bbox": [10, 20, 30, 40]}],
        "categories": [{"id": 3, "name": "cow"}],
    }
    (root / "labels.json").write_text(json.dumps(top | changes))
    return root


def annotation(**changes: Any) -> list[dict[str, Any]]:
    good = {"id": 1, "image_id": 1, "category_id": 3, "bbox": [10, 20, 30, 40]}
    return [good, good | {"id": 2} | changes]


@pytest.mark.parametrize(
    ("changes", "code", "left"),
    [
        ({"bbox": [float("nan"), 1, 2, 3]}, "box-not-finite", 1),
        ({"bbox": [1, 1, -2, 3]}, "box-empty", 1),
        ({"bbox": [200, 1, 2, 3]}, "box-outside", 1),
        ({"bbox": None}, "box-malformed", 1),
        ({"category_id": 4}, "category-unknown", 1),
        ({"image_id": 9}, "image-unknown", 1),
        ({"image_id": "x"}, "image-unknown", 1),
        ({"image_id": []}, "annotation-malformed", 1),
        ({"bbox": [90, 1, 20, 3]}, "box-clipped", 2),
        ({"id": 1}, "annotation-duplicate", 2),
        ({"segmentation": {"size": [3, 3], "counts": "01"}}, "mask-malformed", 2),
        ({"segmentation": {"size": [80, 100], "counts": 7}}, "mask-malformed", 2),
    ],
)
def test_bad_coco_annotations(tmp_path: Path, changes: dict[str, Any], code: str, left: int) -> None:
    d = dataset_folder.read(write_coco(tmp_path, annotations=annotation(**changes)), Reading(format="coco"))
    assert [p.code for p in d.problems] == [code]
    assert (d.problems[0].severity == "error") == (left == 1)
    assert len(d.images[0].instances) == left


@pytest.mark.parametrize("name", ["../a.png", "/a.png", "x/../../a.png", "b.png", 300 * "b"])
def test_bad_coco_file_names(tmp_path: Path, name: str) -> None:
    images = [
        {"id": 1, "file_name": "a.png", "width": 100, "height": 80},
        {"id": 2, "file_name": name, "width": 100, "height": 80},
    ]
    d = coco.read(write_coco(tmp_path, images=images))
    assert codes(d) == ["image-missing" if name[0] == "b" else "name-climbs"] and len(d.images) == 1


@pytest.mark.parametrize(
    ("file", "pictures", "name"),
    [
        ("annotations.json", "JPEGImages/a.png", r"JPEGImages\a.png"),
        ("annotations/train.json", "images/a.png", "../images/a.png"),
        ("annotations/train.json", "images/sub/a.png", r"..\images\sub\a.png"),
        ("labels.json", "data/a.png", "a.png"),
        ("train.json", r"images/a\b.png", r"a\b.png"),
    ],
)
def test_coco_paths_lead_from_the_annotation_file(tmp_path: Path, file: str, pictures: str, name: str) -> None:
    write_coco(tmp_path, images=[{"id": 1, "file_name": name, "width": 100, "height": 80}])
    (tmp_path / "images" / "a.png").unlink()
    path = picture(tmp_path / pictures)
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / "labels.json").rename(tmp_path / file)
    dataset = dataset_folder.read(tmp_path)
    assert [(i.path, len(i.instances)) for i in dataset.images] == [(path, 1)] and not dataset.problems


@pytest.mark.parametrize(
    "name",
    ["../../a.png", r"..\..\a.png", "../../data-2/a.png", "../x/../../a.png", "../images/l.png", "../images/a.png\0"],
)
def test_coco_paths_lead_nowhere_else(tmp_path: Path, name: str) -> None:
    root = tmp_path / "data"
    images = [{"id": n, "file_name": f, "width": 100, "height": 80} for n, f in enumerate(("../images/a.png", name), 1)]
    write_coco(root, images=images)
    (root / "annotations").mkdir()
    (root / "labels.json").rename(root / "annotations" / "train.json")
    outside = picture(tmp_path / "a.png")
    picture(tmp_path / "data-2" / "a.png")
    (root / "images" / "l.png").symlink_to(outside)
    d = coco.read(root)
    assert [i.name for i in d.images] == ["a.png"] and codes(d) == ["name-missing" if "\0" in name else "name-climbs"]


def test_coco_polygons_become_masks(tmp_path: Path) -> None:
    d = coco.read(write_coco(tmp_path, annotations=annotation(segmentation=[[10, 20, 40, 20, 40, 60, 10, 60]])))
    mask = d.images[0].instances[1].mask
    assert mask is not None and mask.area_px == 30 * 40


def test_a_picture_in_two_coco_files_is_read_once(tmp_path: Path) -> None:
    """COCO has a file of boxes and one of key points over the same pictures."""
    for name in ("train2017/1.png", "train2017/2.png", "val2017/1.png"):
        picture(tmp_path / name)
    rows = [{"id": k, "file_name": f"{k}.png", "width": 100, "height": 80} for k in (1, 2)]
    objects = [{"id": k, "image_id": k, "category_id": 1, "bbox": [10, 20, 30, 40]} for k in (1, 2)]
    top = {"images": rows, "annotations": objects, "categories": [{"id": 1, "name": "person"}]}
    write_json(tmp_path / "annotations" / "instances_train2017.json", top)
    more = top | {"annotations": [*objects, objects[0] | {"id": 3}]}
    write_json(tmp_path / "annotations" / "person_keypoints_train2017.json", more)
    write_json(tmp_path / "annotations" / "instances_val2017.json", top | {"images": rows[:1], "annotations": []})
    d = dataset_folder.read(tmp_path)
    assert [(i.id, i.split, len(i.instances)) for i in d.images] == [
        ("2", "train", 1), ("train__1", "train", 1), ("val__1", "val", 0),
    ]  # fmt: skip
    (problem,) = d.problems
    assert (problem.where, problem.code, problem.severity) == (
        "annotations/person_keypoints_train2017.json", "image-duplicate", "warning",
    )  # fmt: skip
    assert problem.found.startswith("2 picture(s)") and "3 annotation(s)" in problem.found


def test_pictures_of_one_name_in_the_folders_of_two_coco_files_are_both_read(tmp_path: Path) -> None:
    for k, name in enumerate(("a", "b")):
        picture(tmp_path / name / "1.png", (100 + k, 80))
        top = {"images": [{"id": 1, "file_name": "1.png"}], "annotations": [], "categories": [{"id": 1, "name": "x"}]}
        write_json(tmp_path / f"{name}.json", top)
    d = coco.read(tmp_path)
    assert sorted(i.size_wh or () for i in d.images) == [(100, 80), (101, 80)] and codes(d) == []


@pytest.mark.parametrize(
    "file, pictures", [("_annotations.coco.json", ""), ("labels.json", "data/"), ("annotations.json", "images/")]
)
def test_coco_with_a_file_in_the_folder_of_each_split(tmp_path: Path, file: str, pictures: str) -> None:
    """The layout of Roboflow, and of FiftyOne's exports side by side: all names are the same."""
    for n, split in enumerate(("train", "valid", "test")):
        picture(tmp_path / split / pictures / "a.png", (64 + n, 48))
        image = {"id": 0, "file_name": "a.png", "width": 64 + n, "height": 48}
        label = {"id": 0, "image_id": 0, "category_id": 1, "bbox": [10 + n, 10, 20, 9]}
        names = [{"id": i, "name": "drone"} for i in (0, 1)]  # Roboflow lists the project beside its class
        top = {"images": [image], "annotations": [label], "categories": names}
        (tmp_path / split / file).write_text(json.dumps(top))
    dataset = dataset_folder.read(tmp_path)
    found = [(i.split, i.path.relative_to(tmp_path).parts[0], i.instances[0].box_xyxy[0]) for i in dataset.images]
    assert found == [("train", "train", 10), ("val", "valid", 11), ("test", "test", 12)]
    assert not dataset.problems and dataset.format == "coco"
    if file.startswith("_"):  # one of them alone
        assert [i.split for i in dataset_folder.read(tmp_path / "valid").images] == ["val"]
        (tmp_path / "test" / file).write_text("{")
        assert codes(dataset_folder.read(tmp_path)) == ["annotation-not-json"]


def test_the_folders_of_flir_adas_v2_are_one_dataset(tmp_path: Path) -> None:
    root = SAMPLES["coco:flir"](tmp_path / "FLIR_ADAS_v2")
    dataset = dataset_folder.read(root)
    assert not dataset.problems and [c.name for c in dataset.categories] == ["person", "bike", "car", "sheep"]
    assert [(i.capture.sequence, i.capture.frame) for i in dataset.images[:2]] == [("a0", 0), ("a2", 0)]
    found = [(i.split, i.extra.get("modality"), len(i.instances)) for i in dataset.images]
    assert found == [("train", None, 2), ("train", "visible", 2), ("val", None, 0), ("test", None, 2)]
    for name, split, kind in (("images_thermal_val", "val", None), ("images_rgb_train", "train", "visible")):
        (alone,) = dataset_folder.read(root / name).images
        assert (alone.split, alone.extra.get("modality")) == (split, kind)
    (root / "images_thermal_val" / "more.csv").write_text("data/video-a1-frame-000000-xT7.jpg,car,1,2,3,4\n")
    assert [p.where for p in dataset_folder.read(root).problems] == ["images_thermal_val/more.csv"]


def test_sizes_that_a_coco_file_lacks_come_from_the_pictures(tmp_path: Path) -> None:
    """Without them, masks would be left out and boxes not be clipped."""
    ring = [[10, 20, 40, 20, 40, 60, 10, 60]]
    images = [{"id": 1, "file_name": "a.png"}]
    d = coco.read(write_coco(tmp_path, images=images, annotations=annotation(segmentation=ring, bbox=[90, 20, 30, 40])))
    assert codes(d, "warning") == ["box-clipped", "image-size-unknown"] and codes(d) == []
    (image,) = d.images
    assert image.size_wh == (100, 80) and image.instances[1].mask is not None
    assert image.instances[1].box_xyxy.tolist() == [90, 20, 100, 60]
    (tmp_path / "images" / "a.png").write_bytes(b"no picture")
    assert codes(coco.read(tmp_path)) == ["image-unreadable"]


def test_measured_contrast_of_inserted_objects_is_kept(tmp_path: Path) -> None:
    measured = {"changed_grey": 12.5, "contrast_grey": -3.25, "scr": 1.5}
    source = coco.read(write_coco(tmp_path / "in", annotations=annotation(inserted=True, **measured)))
    assert source.images[0].instances[0].extra == {} and source.images[0].instances[1].extra == measured
    coco.write(tmp_path / "out", source.images, source.categories, pictures=True)
    top = json.loads((tmp_path / "out" / "annotations" / "instances_train.json").read_text())
    assert {k: top["annotations"][1][k] for k in measured} == measured
    damaged = {"changed_grey": "x", "contrast_grey": float("inf"), "scr": None}
    d = coco.read(write_coco(tmp_path / "in", annotations=annotation(**damaged)))
    assert d.images[0].instances[1].extra == {}


def test_broken_coco_files(tmp_path: Path) -> None:
    picture(tmp_path / "a.png")
    (tmp_path / "train.json").write_text("{")
    with pytest.raises(DatasetError) as caught:
        coco.read(tmp_path)
    assert [p.code for p in caught.value.problems] == ["annotation-not-json"]


def test_options_belong_to_their_formats(tmp_path: Path) -> None:
    picture(tmp_path / "a.png")
    with pytest.raises(DatasetError, match="folder has none"):
        dataset_folder.read(tmp_path, Reading(form="normal_json"))
    with pytest.raises(DatasetError, match="form"):
        dataset_folder.read(tmp_path, Reading(form="normal"))
    with pytest.raises(UnknownFormatError, match="expected one of hit-uav"):
        dataset_folder.read(tmp_path, Reading(format="no-such-format"))
    with pytest.raises(DatasetError, match=r"no such folder.*Check the path") as caught:
        dataset_folder.read(tmp_path / "absent")
    assert str(caught.value).count("absent") == 1
    with pytest.raises(DatasetError, match=r"no such folder.*Check the path"):  # as commands that need every frame do
        dataset_folder.read(tmp_path / "absent", dataset_folder.with_every_frame(Reading(), tmp_path / "absent"))


@pytest.mark.parametrize("count", [1, 3, 5])
def test_videos_beside_pictures_name_the_command_for_their_frames(tmp_path: Path, count: int) -> None:
    """The command works as it stands."""
    from tests.videos import write_video

    folder = tmp_path / "my flights"
    picture(folder / "a.png")
    for n in range(count):
        write_video(folder / f"DJI_{n}.MP4", frames=2)
    (problem,) = dataset_folder.read(folder).problems
    assert problem.code == "video-not-pictures"
    assert problem.found == f"{count} video(s) beside the pictures, not read"
    command, out = re.fullmatch(r"extract frames with (.*), then use (.*); or .*", problem.todo).groups()  # type: ignore[union-attr]
    program = f"{shlex.quote(sys.executable)} -m {command}"
    subprocess.run(["bash", "-c", program], cwd=tmp_path, check=True, capture_output=True)
    dataset = dataset_folder.read(tmp_path / shlex.split(out)[0])
    assert len({i.capture.sequence for i in dataset.images}) == count


def test_a_file_in_place_of_a_folder_is_called_a_file(tmp_path: Path) -> None:
    (tmp_path / "data.zip").write_bytes(b"PK")
    with pytest.raises(DatasetError, match=r"data\.zip: a file; expected the folder of a dataset.*unpack it"):
        dataset_folder.read(tmp_path / "data.zip")


def test_the_folder_of_two_datasets_names_them(tmp_path: Path) -> None:
    for name in ("one", "two"):
        SAMPLES["coco"](tmp_path / name)
    dataset = dataset_folder.read(tmp_path)
    (problem,) = [p for p in dataset.problems if p.severity == "error"]
    assert dataset.format == "folder" and problem.found.endswith("whose labels are not read: one (coco), two (coco)")
    assert problem.todo == f"give one of them, such as {tmp_path / 'one'}"
