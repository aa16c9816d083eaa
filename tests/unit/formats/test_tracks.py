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
from infrablend.formats import detection, writing
from infrablend.formats.losses import Written
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
    again = detection.read(out)
    assert codes(again) == []
    return written, again


@pytest.mark.parametrize(
    "writer",
    [w for w in WRITERS if "tracks" not in w.lacks and w.name not in ("monet", "anti-uav")],
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
    d = detection.read(coco_file(tmp_path, records, annotations, videos=[{"id": 3, "name": "north"}]))
    assert [(i.capture.sequence, i.capture.frame) for i in d.images] == [("north", 5), (None, 0)]
    assert [[o.track_id for o in i.instances] for i in d.images] == [[4, 8, 1], [None]]
