"""What readers and writers of the formats give back, value by value; the input is unchanged."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from infrablend.core.boxes import corners_of_cxcywha
from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.core.format_table import FORMATS
from infrablend.core.rle_masks import Mask
from infrablend.formats import dataset_folder
from infrablend.formats.base import sort_images
from infrablend.formats.labels import coco, voc, yolo
from infrablend.formats.losses import Written
from infrablend.formats.published import hit_uav, monet

CATEGORIES = (*hit_uav.CATEGORIES, Category(5, "drone"))
SIZE_WH = (64, 48)


def blob() -> Mask:
    """Two parts and a hole, near the lower right corner of the frame."""
    canvas = np.zeros((48, 64), np.uint8)
    cv2.circle(canvas, (50, 40), 7, 1, -1)
    canvas[38:41, 49:52] = 0
    canvas[20:23, 50:54] = 1
    return Mask.from_array(canvas.astype(np.bool_))


def golden_images(folder: Path) -> tuple[ImageRecord, ...]:
    """Three pictures: labels of every kind, an empty one, one of another split."""
    folder.mkdir(parents=True, exist_ok=True)
    obb = (20.5, 18.25, 12.0, 6.0, 0.4)
    corners = corners_of_cxcywha(np.array([obb]))[0]
    box = np.concatenate([corners.min(axis=0), corners.max(axis=0)])
    drone = np.array([43.0, 20.0, 58.0, 48.0])
    drone_obb = np.array([[43.0, 20.0], [58.0, 20.0], [58.0, 48.0], [43.0, 48.0]])
    labels = (
        Instance("Car", box, corners, None, None, False, True, False, 7, {"obb": obb}),
        Instance("DontCare", np.array([1.0, 2.0, 9.0, 30.0]), None, None, None, None, None, False, 9),
        Instance("drone", drone, drone_obb, blob(), 0.75, True, None, True),
    )
    person = Instance("Person", np.array([0.25, 0.5, 3.75, 8.5]), source_id=11)
    images = []
    for name, split, instances, source_id in (
        ("0_60_30_0_00001_c0.png", "train", labels, 3),
        ("1_90_60_0_00002_c0.png", "train", (), 4),
        ("1_90_90_0_00003_c0.png", "test", (person,), 5),
    ):
        path = folder / name
        Image.fromarray(np.full((48, 64), 40 + source_id, np.uint8)).save(path)
        night = name.startswith("1")
        _, altitude, pitch, *_ = name.split("_")
        images.append(
            ImageRecord(
                name.removesuffix(".png"),
                path,
                split,
                SIZE_WH,
                tuple(instances),
                capture=Capture(
                    pitch_deg=float(pitch), altitude_m=float(altitude), time_of_day="night" if night else "day"
                ),
                source_id=source_id,
                extra={"date": "20210101", "weather": "0"},
                file_name=name,
            )
        )
    return sort_images(images)


@dataclass(frozen=True)
class Case:
    """A writer, its reader, and the fields of an instance that survive the round trip."""

    name: str
    write: Callable[[Path, tuple[ImageRecord, ...]], Written]
    read: Callable[[Path], Dataset]
    kept: Callable[[Instance], Instance | None]
    atol_px: float


def bare(instance: Instance, **changes: object) -> Instance:
    """The instance as formats give it back that know only category and geometry."""
    fields = {
        "mask": None, "visibility": None, "truncated": None, "difficult": None, "inserted": False, "source_id": None,
    }  # fmt: skip
    return replace(instance, **(fields | changes))


def yolo_kept(corners: bool) -> Callable[[Instance], Instance | None]:
    def keep(i: Instance) -> Instance | None:
        if i.category == "DontCare":
            return None
        if not corners:
            return bare(i, corners_xy=None)
        c = i.corners_xy
        if c is None:
            x0, y0, x1, y1 = i.box_xyxy
            c = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        return bare(i, corners_xy=c)

    return keep


def native_kept(form: str) -> Callable[[Instance], Instance]:
    def keep(i: Instance) -> Instance:
        flags: dict[str, object] = {"inserted": i.inserted}
        if form != "normal_json":
            flags["difficult"] = bool(i.difficult)
        if form.endswith("_xml"):
            flags["truncated"] = bool(i.truncated)
        if form.startswith("normal"):
            return bare(i, box_xyxy=np.trunc(i.box_xyxy), corners_xy=None, **flags)
        return bare(i, corners_xy=yolo_kept(True)(replace(i, category="Car")).corners_xy, **flags)

    return keep


def voc_kept(i: Instance) -> Instance:
    flags = {"truncated": bool(i.truncated), "difficult": bool(i.difficult), "inserted": i.inserted}
    return bare(i, corners_xy=None, **flags)


def without_ids(dataset: Dataset) -> Dataset:
    images = [replace(i, instances=tuple(replace(o, source_id=None) for o in i.instances)) for i in dataset.images]
    return replace(dataset, images=tuple(images))


def native(form: str) -> Case:
    return Case(
        form,
        lambda out, images: hit_uav.write(out, images, CATEGORIES, forms=(form,)),
        lambda out: without_ids(hit_uav.read(out, form=form)),
        native_kept(form),
        1e-6,
    )


CASES = (
    native("normal_json"),
    native("rotate_json"),
    native("normal_xml"),
    native("rotate_xml"),
    Case("yolo", lambda o, i: yolo.write(o, i, CATEGORIES), yolo.read, yolo_kept(False), 1e-6),
    Case("obb", lambda o, i: yolo.write(o, i, CATEGORIES, task="obb"), yolo.read, yolo_kept(True), 1e-6),
    Case(
        "seg",
        lambda o, i: yolo.write(o, i, CATEGORIES, task="seg"),
        lambda o: yolo.read(o, task="seg"),
        lambda i: None if i.mask is None else bare(i, corners_xy=None, mask=i.mask),
        0.03,
    ),
    Case("voc", lambda o, i: voc.write(o, i, CATEGORIES), voc.read, voc_kept, 1e-6),
    Case(
        "coco",
        lambda o, i: coco.write(o, i, CATEGORIES, pictures=True),
        lambda o: without_ids(coco.read(o)),
        lambda i: replace(i, source_id=None),
        1e-6,
    ),
    Case(
        "monet",
        lambda o, i: monet.write(o, i, CATEGORIES),
        lambda o: without_ids(monet.read(o)),
        lambda i: replace(i, source_id=None),
        1e-6,
    ),
)
all_cases = pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)


def tree(folder: Path) -> dict[str, str]:
    """SHA-256 of every file below a folder."""
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@all_cases
def test_written_dataset_reads_back_equal_and_the_input_is_left_as_it_was(case: Case, tmp_path: Path) -> None:
    images = golden_images(tmp_path / "in")
    given = tree(tmp_path / "in")
    boxes = [o.box_xyxy.copy() for i in images for o in i.instances]
    case.write(tmp_path / "out", images)
    again = case.read(tmp_path / "out")
    assert tree(tmp_path / "in") == given
    objects = (o for i in images for o in i.instances)
    assert all((a == o.box_xyxy).all() for a, o in zip(boxes, objects, strict=True))
    assert [p for p in again.problems if p.severity == "error"] == []
    assert [i.id for i in again.images] == [i.id for i in images]
    for before, after in zip(images, again.images, strict=True):
        assert (after.split, after.capture.pitch_deg, after.capture.altitude_m, after.capture.time_of_day) == (
            before.split, before.capture.pitch_deg, before.capture.altitude_m, before.capture.time_of_day,
        )  # fmt: skip
        assert after.size_wh == SIZE_WH
        assert after.path.read_bytes() == before.path.read_bytes()
        expected = [k for i in before.instances if (k := case.kept(i)) is not None]
        if case.name == "seg":  # the bridge between the two parts paints pixels: compare masks by overlap
            for e, o in zip(expected, after.instances, strict=True):
                assert e.category == o.category and e.mask is not None and o.mask is not None
                differ = int((e.mask.to_array() != o.mask.to_array()).sum())
                assert differ == 10  # rows 23 to 32 between the parts
                np.testing.assert_allclose(o.box_xyxy, e.box_xyxy, atol=case.atol_px)
            continue
        for e, o in zip(expected, after.instances, strict=True):
            assert o.equals(e, case.atol_px), (e, o)


def test_an_image_without_objects_has_an_empty_label_file(tmp_path: Path) -> None:
    for task in yolo.TASKS:
        yolo.write(tmp_path / task, golden_images(tmp_path / "in"), CATEGORIES, task=task)
        assert (tmp_path / task / "labels/train/1_90_60_0_00002_c0.txt").read_bytes() == b""


def test_losses_of_yolo_detect_are_counted_one_by_one(tmp_path: Path) -> None:
    written = yolo.write(tmp_path / "o", golden_images(tmp_path / "in"), CATEGORIES)
    assert written.losses == {
        "difficult_dropped": 1, "ignore_dropped": 1, "mask_dropped": 1, "obb_dropped": 2,
        "truncated_dropped": 1, "visibility_dropped": 1,
    }  # fmt: skip


def test_native_reads_both_forms_as_one(tmp_path: Path) -> None:
    images = golden_images(tmp_path / "in")
    hit_uav.write(tmp_path / "out", images, CATEGORIES)
    again = hit_uav.read(tmp_path / "out")
    assert again.problems == ()
    assert again.category("drone").id == 5 and again.category("DontCare").ignore
    car, dont_care, drone = again.images[0].instances
    assert car.box_xyxy.tolist() == np.trunc(images[0].instances[0].box_xyxy).tolist()
    assert (car.difficult, dont_care.category, drone.inserted) == (True, "DontCare", True)
    np.testing.assert_allclose(car.corners_xy, images[0].instances[0].corners_xy, atol=1e-9)
    assert (car.source_id, car.extra["source_id"]) == (0, 7)
    assert [i.extra["source_id"] for i in again.images] == [3, 4, 5]


# pycocotools' decoder does what numpy 2 deprecates.
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_coco_loads_in_pycocotools(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from pycocotools.coco import COCO

    coco.write(tmp_path, golden_images(tmp_path / "in"), CATEGORIES)
    data = COCO(str(tmp_path / "train.json"))
    assert sorted(data.getCatIds()) == [0, 1, 2, 3, 4, 5]
    annotations = data.loadAnns(data.getAnnIds())
    assert [a["iscrowd"] for a in annotations] == [0, 1, 0]
    assert (data.annToMask(annotations[2]).astype(bool) == blob().to_array()).all()
    assert annotations[2]["area"] == blob().area_px
    assert annotations[2]["visibility"] == 0.75 and annotations[2]["inserted"] is True
    assert [i["source_id"] for i in json.loads((tmp_path / "train.json").read_text())["images"]] == [3, 4]
    capsys.readouterr()


def test_a_folder_without_pictures_is_said_in_few_lines(tmp_path: Path) -> None:
    with pytest.raises(dataset_folder.UnknownFormatError, match=r"no picture .* and no other file"):
        dataset_folder.read(tmp_path)
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(dataset_folder.UnknownFormatError) as caught:
        dataset_folder.read(tmp_path)
    (problem,) = caught.value.problems
    assert "1 other file(s), such as notes.txt" in problem.found and "docs/formats" in problem.expected
    assert [*dataset_folder.detect(tmp_path).reasons] == [f.name for f in FORMATS]
    assert "no data.yaml" in dataset_folder.detect(tmp_path).reasons["yolo"]
