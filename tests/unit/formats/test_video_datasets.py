"""Datasets of drones as published: Anti-UAV300, 410 and 600 and Halmstad, with frames out of videos."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from infrablend.cli.app import build_app
from infrablend.core.dataset import Dataset
from infrablend.errors import DatasetError
from infrablend.formats import dataset_folder
from infrablend.formats.labels import coco
from infrablend.formats.read_write import Reading
from tests.samples import SAMPLES, picture, with_facts
from tests.videos import level, write_ground_truth, write_video


def codes(dataset: Dataset) -> list[str]:
    return sorted(p.code for p in dataset.problems)


def anti_uav_video(root: Path, frames: int = 60, **label: Any) -> Path:
    """Write a sequence of Anti-UAV300, with its twin in visible light."""
    folder = root / "train" / "20190925_101846_1_1"
    folder.mkdir(parents=True)
    top = {"exist": [1] * frames, "gt_rect": [[k % 30, 5, 10, 8] for k in range(frames)]} | label
    for name, colour in (("infrared", 0), ("visible", 30)):
        write_video(folder / f"{name}.mp4", frames=frames, colour=colour)
        (folder / f"{name}.json").write_text(json.dumps(top))
    return root


def test_frames_of_thermal_videos_are_read(tmp_path: Path) -> None:
    d = dataset_folder.read(anti_uav_video(tmp_path))
    assert d.format == "anti-uav" and d.problems == ()
    assert [(i.capture.frame, i.capture.time_s) for i in d.images] == [(0, 0), (25, 2.5), (50, 5)]
    assert {(i.capture.sequence, i.capture.captured, i.split, i.size_wh) for i in d.images} == {
        ("20190925_101846_1_1", "2019-09-25", "train", (64, 48))
    }
    assert [i.instances[0].box_xyxy.tolist() for i in d.images] == [[0, 5, 10, 13], [25, 5, 35, 13], [20, 5, 30, 13]]
    for image in d.images:
        with Image.open(image.path) as frame:
            assert frame.getextrema() == (level(image.capture.frame),) * 2
    again = dataset_folder.read(tmp_path)
    assert [i.path for i in again.images] == [i.path for i in d.images]
    assert not (tmp_path / "train" / "20190925_101846_1_1" / "frames").exists()


def test_coco_has_fields_of_videos_if_pictures_are_numbered(tmp_path: Path) -> None:
    d = dataset_folder.read(anti_uav_video(tmp_path / "in"))
    tracked = [replace(i, instances=(replace(i.instances[0], track_id=4),)) for i in d.images]
    coco.write(tmp_path / "out", tracked, d.categories, pictures=True)
    path = tmp_path / "out" / "annotations" / "instances_train.json"
    top = json.loads(path.read_text())
    assert top["videos"] == [{"id": 1, "name": "20190925_101846_1_1"}]
    assert [(i["video_id"], i["frame_id"]) for i in top["images"]] == [(1, 0), (1, 25), (1, 50)]
    assert {a["track_id"] for a in top["annotations"]} == {4}
    # Other programs name the video of a picture by its number alone.
    for image in top["images"]:
        del image["sequence"]
    path.write_text(json.dumps(top))
    again = dataset_folder.read(tmp_path / "out").images
    assert [(i.capture.sequence, i.capture.frame, i.instances[0].track_id) for i in again] == [
        ("20190925_101846_1_1", k, 4) for k in (0, 25, 50)
    ]
    coco.write(tmp_path / "still", [with_facts(i, frame=None) for i in tracked], d.categories)
    assert not {"videos", "video_id", "frame_id"} & set((tmp_path / "still" / "train.json").read_text().split('"'))


def test_visible_videos_are_marked(tmp_path: Path) -> None:
    d = dataset_folder.read(anti_uav_video(tmp_path), Reading(options={"modality": "both", "every": "30"}))
    assert [(i.capture.frame, i.extra.get("modality")) for i in d.images] == [
        (0, None), (30, None), (0, "visible"), (30, "visible"),
    ]  # fmt: skip


def test_one_video_alone_is_read_with_its_labels(tmp_path: Path) -> None:
    folder = anti_uav_video(tmp_path / "a") / "train" / "20190925_101846_1_1"
    thermal, visible = (dataset_folder.read(folder / f"{name}.mp4") for name in ("infrared", "visible"))
    assert thermal.format == visible.format == "anti-uav" and thermal.problems == ()
    assert [i.extra.get("modality") for i in (thermal.images[0], visible.images[0])] == [None, "visible"]
    assert all(len(i.instances) == 1 for i in (*thermal.images, *visible.images))
    for clip in ("IR_DRONE_001", "IR_BIRD_002"):
        halmstad(tmp_path / "h", clip)
    d = dataset_folder.read(tmp_path / "h" / "Data" / "Video_IR" / "IR_BIRD_002.mp4")
    assert (d.format, {i.capture.sequence for i in d.images}) == ("halmstad", {"IR_BIRD_002"})
    assert any(i.instances for i in d.images) and d.problems == ()


def test_absent_drones_and_bad_labels_are_counted(tmp_path: Path) -> None:
    label = {
        "exist": [1, 0, 0, 1, 1, 2, 1],
        "gt_rect": [[1, 2, 3, 4], [], [5, 5, 5, 5], [0, 0, 0, 0], [60, 40, 9, 9], [1, 1, 2, 2], "x", [1, 1, 1, 1]],
    }
    d = dataset_folder.read(anti_uav_video(tmp_path, **label), Reading(options={"every": "1"}))
    assert [len(i.instances) for i in d.images] == [1, 0, 0, 0, 1, 0, 0]
    assert codes(d) == ["annotation-layout"] * 3 + ["annotation-length"] + ["box-clipped"]
    rows = d.notes["rows"]
    assert (rows["objects"], rows["read"], rows["absent"], rows["hidden_boxes"]) == (5, 2, 2, 1)


def test_pictures_and_labels_of_other_lengths(tmp_path: Path) -> None:
    root = SAMPLES["anti-uav"](tmp_path)
    picture(root / "train" / "20190920_111757_1_0" / "000003.jpg", 9)
    d = dataset_folder.read(root)
    assert len(d.images) == 4 and codes(d) == ["annotation-length", "image-unlisted"]
    assert d.notes["rows"]["unlabelled"] == 1
    assert [i.split for i in d.images] == ["train", "train", "test", "test"]


@pytest.mark.parametrize("every", ["0", "-1", "x", "1.5"])
def test_a_step_is_a_number_of_frames(tmp_path: Path, every: str) -> None:
    with pytest.raises(DatasetError, match="not allowed"):
        dataset_folder.read(SAMPLES["anti-uav"](tmp_path), Reading(options={"every": every}))


def test_a_damaged_sequence_costs_only_itself(tmp_path: Path) -> None:
    root = anti_uav_video(SAMPLES["anti-uav"](tmp_path))
    (root / "train" / "20190925_101846_1_1" / "infrared.mp4").write_bytes(b"no video")
    d = dataset_folder.read(root)
    assert {i.capture.sequence for i in d.images} == {"20190920_111757_1_0", "20190921_111757_1_1"}
    assert "video-unreadable" in codes(d)


def halmstad(root: Path, clip: str = "IR_DRONE_001", frames: int = 61, boxes: list[Any] | None = None) -> Path:
    (root / "Data" / "Video_IR").mkdir(parents=True, exist_ok=True)
    write_video(root / "Data" / "Video_IR" / f"{clip}.mp4", frames=frames)
    boxes = [(11.0, 21.0, 9.0, 8.0)] * 31 + [None] * (frames - 31) if boxes is None else boxes
    write_ground_truth(root / "Data" / "Video_IR" / f"{clip}_LABELS.mat", boxes)
    return root


def test_halmstad_boxes_count_from_one(tmp_path: Path) -> None:
    d = dataset_folder.read(halmstad(halmstad(tmp_path), "IR_HELICOPTER_010"))
    assert d.format == "halmstad" and d.problems == ()
    assert [i.capture.time_s for i in d.images] == [k / 10 for i in d.images if (k := i.capture.frame) is not None]
    assert [(i.capture.sequence, i.capture.frame, len(i.instances)) for i in d.images] == [
        (clip, frame, count)
        for clip in ("IR_DRONE_001", "IR_HELICOPTER_010")
        for frame, count in ((0, 1), (30, 1), (60, 0))
    ]  # fmt: skip
    assert d.images[0].instances[0].box_xyxy.tolist() == [10, 20, 19, 28]
    assert [c.name for c in d.categories] == ["airplane", "bird", "drone", "helicopter"]
    assert d.images[3].instances[0].category == "helicopter"


def test_halmstad_clips_that_do_not_decode_are_left_out(tmp_path: Path) -> None:
    root = halmstad(halmstad(tmp_path), "IR_DRONE_143", 3, [None] * 3)
    halmstad(root, "IR_BIRD_027", 40, [(5.0, 5.0, 4.0, 4.0)] * 9)
    (halmstad(root, "IR_BIRD_028", 3) / "Data" / "Video_IR" / "IR_BIRD_028_LABELS.mat").write_bytes(b"MATLAB")
    d = dataset_folder.read(root)
    assert sorted({i.capture.sequence or "" for i in d.images}) == ["IR_BIRD_027", "IR_DRONE_001"]
    assert codes(d) == ["annotation-length", "annotation-undecoded", "annotation-unreadable"]
    assert (d.notes["rows"]["clips"], d.notes["rows"]["undecoded"]) == (4, 2)


def test_one_command_checks_and_one_converts(tmp_path: Path) -> None:
    root, app = halmstad(tmp_path / "data"), build_app()
    result = CliRunner().invoke(app, ["check", str(root), "--format", "halmstad", "--read", "every=20"])
    assert result.exit_code == 0, result.output
    result = CliRunner().invoke(app, ["convert", str(root), str(tmp_path / "out"), "--to", "coco"])
    assert result.exit_code == 0, result.output
    again = dataset_folder.read(tmp_path / "out")
    assert [(i.capture.sequence, len(i.instances)) for i in again.images] == [("IR_DRONE_001", n) for n in (1, 1, 0)]
    with Image.open(again.images[0].path) as picture_read:
        assert np.array(picture_read).max() == level(0)


def test_halmstad_without_clips_names_where_they_are_expected(tmp_path: Path) -> None:
    (tmp_path / "Video_IR").mkdir()
    with pytest.raises(DatasetError, match="no clips") as error:
        dataset_folder.read(tmp_path, Reading(format="halmstad"))
    assert "Video_IR/IR_<CLASS>_NNN.mp4" in error.value.problems[0].expected
    assert "Video_IR/IR_<CLASS>_NNN.mp4" in dataset_folder.detect(tmp_path).reasons["halmstad"]
