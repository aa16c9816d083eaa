"""Supervision and Datumaro load our output with every image and every object; DOTA is checked by its grammar."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from infrablend import api
from infrablend.core.boxes import box_of_points, polygon_area
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.format_table import NATIVE, find_writer, written_names
from infrablend.pipeline.plans.run_request import RunRequest

ROOT = Path(__file__).resolve().parents[2]
# What a library keeps of a coordinate: Datumaro two decimals, Supervision 32 bits.
ATOL_PX = {"supervision": 1e-3, "datumaro": 0.006, "datasets": 1e-6}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, write_tiny_hit_uav) -> Path:
    """A run on the made-up dataset with the software renderer, in every format there is."""
    root = tmp_path_factory.mktemp("run")
    data = write_tiny_hit_uav(root / "data")
    settings = {"labels.remove_covered": 1.0, "output.formats": [*written_names(), NATIVE]}
    report = api.generate(
        "hit-uav-drone",
        data,
        root / "out",
        execution=api.Execution(renderer="flat", in_process=True),
        settings=settings,
    )
    assert report.ok, report.problems
    return report.out


@pytest.fixture(scope="module")
def load(tools_python: Path):
    """Load a folder with another library: (tool, format, folder) -> its images by (split, stem)."""

    def loaded(tool: str, format_: str, folder: Path) -> dict[tuple[str, str], dict[str, Any]]:
        command = [tools_python, "-W", "ignore", ROOT / "scripts" / "load_with_tools.py", tool, format_, folder]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 0, done.stderr
        # Datumaro takes VOC's list trainval for a split of its own.
        return {(i["split"], i["stem"]): i for i in json.loads(done.stdout) if i["split"] != "trainval"}

    return loaded


def converted(run: Path, out: Path, to: str, **choice: Any) -> tuple[list[ImageRecord], Path]:
    """Convert the run to a format; return the run's images and the output folder."""
    report = api.convert(run, out, to, **{"reading": api.Reading(format="coco"), **choice})
    assert report.ok
    return list(api.read_dataset(run, api.Reading(format="coco")).images), out


def expected_objects(image: ImageRecord, ignored: bool) -> list[Instance]:
    return [i for i in image.instances if ignored or i.category != "DontCare"]


def compare(images: list[ImageRecord], loaded: dict, tool: str, *, ignored: bool, shift: float = 0.0) -> None:
    """Check that every image was loaded with its size and exactly its boxes and classes, in any order."""
    assert len(loaded) == len(images)
    for image in images:
        stem = Path(image.name).stem
        found = loaded.get((image.split, stem)) or loaded["", stem]
        assert tuple(found["size_wh"]) == image.size_wh
        boxes = [o for o in found["objects"] if tool != "datumaro" or o[6] is None]
        wanted = expected_objects(image, ignored)
        assert len(boxes) == len(wanted)
        for instance in wanted:
            target = instance.box_xyxy - np.array([shift, shift, 0, 0])
            near = [o for o in boxes if o[0] == instance.category and np.abs(o[1:5] - target).max() <= ATOL_PX[tool]]
            assert len(near) == 1, (image.id, instance, boxes)


@pytest.mark.parametrize("tool", ["supervision", "datumaro"])
def test_every_yolo_label_is_accepted(load, run: Path, tool: str) -> None:
    images = list(api.read_dataset(run, api.Reading(format="coco")).images)
    compare(images, load(tool, "yolo", run / "yolo"), tool, ignored=False)


def test_every_yolo_oriented_box_and_polygon_is_accepted(load, run: Path) -> None:
    images = list(api.read_dataset(run, api.Reading(format="coco")).images)
    oriented, masks = (
        load("supervision", "yolo-obb", run / "yolo-obb"),
        load("supervision", "yolo-seg", run / "yolo-seg"),
    )
    for image in images:
        key = image.split, Path(image.name).stem
        corners = [np.array(o[5]) for o in oriented[key]["objects"]]
        wanted = [i.corners_xy for i in expected_objects(image, False)]
        assert len(corners) == len(wanted)
        for w in wanted:
            assert w is not None
            assert min(min(np.abs(np.roll(c, k, axis=0) - w).max() for k in range(4)) for c in corners) < 1e-3
        with_mask = [i for i in image.instances if i.mask is not None]
        assert len(masks[key]["objects"]) == len(with_mask)


@pytest.mark.parametrize("tool", ["supervision", "datumaro"])
def test_every_coco_label_is_accepted_with_its_mask(load, run: Path, tmp_path: Path, tool: str) -> None:
    images, out = converted(run, tmp_path / "out", "coco", writing=api.WriteSettings(category_ids="from_one"))
    loaded = load(tool, "coco", out)
    compare(images, loaded, tool, ignored=True)
    for image in images:
        areas = sorted(o[6] for o in loaded[image.split, Path(image.name).stem]["objects"] if o[6] is not None)
        ours = [i.mask.area_px for i in image.instances if i.mask is not None]
        assert set(ours) <= set(areas)


def test_datumaro_takes_a_coco_category_0_for_background(load, run: Path, tmp_path: Path) -> None:
    """Why `category_ids: from_one` exists, and a warning where it is not chosen."""
    report = api.convert(run, tmp_path / "out", "coco", reading=api.Reading(format="coco"))
    assert [p.code for p in report.problems] == ["category-zero"]
    loaded = load("datumaro", "coco", tmp_path / "out")
    names = {o[0] for i in loaded.values() for o in i["objects"]}
    assert "Person" not in names and None in names


@pytest.mark.parametrize("tool", ["supervision", "datumaro"])
def test_every_voc_label_is_accepted(load, run: Path, tmp_path: Path, tool: str) -> None:
    images, out = converted(run, tmp_path / "out", "voc")
    # Supervision takes VOC's corners for one-based and moves the upper left one; ours are absolute edges.
    compare(images, load(tool, "voc", out), tool, ignored=True, shift=1.0 if tool == "supervision" else 0.0)


@pytest.mark.parametrize("folder", ["images", "huggingface"])
def test_hugging_face_loads_every_label_of_a_run_and_of_its_folder(load, run: Path, folder: str) -> None:
    """The pictures of a run load from where they are, with boxes, oriented boxes and masks."""
    images = list(api.read_dataset(run, api.Reading(format="coco")).images)
    loaded = load("datasets", "huggingface", run / folder)
    compare(images, loaded, "datasets", ignored=True)
    for image in images:
        objects = loaded[image.split, Path(image.name).stem]["objects"]
        for given, found in zip(image.instances, objects, strict=True):
            assert found[6] == (None if given.mask is None else given.mask.area_px)
            assert (found[5] is None) == (given.corners_xy is None)
            if given.corners_xy is not None:
                np.testing.assert_allclose(found[5], given.corners_xy, rtol=0, atol=1e-6)


def test_hugging_face_loads_every_label_of_packed_shards(load, run: Path, tmp_path: Path) -> None:
    """The builders for WebDataset and Parquet, and the labels of the run with a file per frame."""
    pytest.importorskip("pyarrow")
    request = RunRequest(
        "hit-uav-drone",
        run.parent / "data",
        tmp_path,
        settings={"labels.remove_covered": 1.0, "output.layout": "shards"},
        execution=api.Execution(renderer="flat", in_process=True),
        shard=api.ShardRequest(size=3),
    )
    assert api.generate_shard(request).ok
    images = list(api.read_dataset(run, api.Reading(format="coco")).images)
    loaded = load("datasets", "shards", tmp_path)
    compare(images, loaded, "datasets", ignored=True)
    for image in images:
        for given, found in zip(image.instances, loaded[image.split, Path(image.name).stem]["objects"], strict=True):
            assert found[6] == (None if given.mask is None else given.mask.area_px)


def test_datumaro_loads_every_rotated_box_and_mask_of_cvats_xml(load, run: Path) -> None:
    images = list(api.read_dataset(run, api.Reading(format="coco")).images)
    loaded = load("datumaro", "cvat", run / "cvat")
    assert len(loaded) == len(images)
    for image in images:
        objects = loaded[image.split, Path(image.name).stem]["objects"]
        masks = sorted(o[6] for o in objects if o[6] is not None)
        assert masks == sorted(i.mask.area_px for i in image.instances if i.mask is not None)
        boxes = [o for o in objects if o[6] is None]
        for given, found in zip(image.instances, boxes, strict=True):
            assert found[0] == given.category and (found[5] is None) == (given.corners_xy is None)
            if given.corners_xy is None:
                np.testing.assert_allclose(found[1:5], given.box_xyxy, rtol=0, atol=0.006)
            else:
                turns = [np.roll(given.corners_xy, k, axis=0) - np.array(found[5]) for k in range(4)]
                assert min(np.abs(t).max() for t in turns) < 0.02


def test_every_dota_label_is_accepted(load, run: Path, tmp_path: Path) -> None:
    # Datumaro wants the same classes in every split, which DOTA's files do not contain.
    images, out = converted(run, tmp_path / "out", "dota", reading=api.Reading(format="coco", splits=["train"]))
    loaded = load("datumaro", "dota", out)
    train = [i for i in images if i.split == "train"]
    assert len(loaded) == len(train) == 4
    for image in train:
        objects = loaded["train", Path(image.name).stem]["objects"]
        assert len(objects) == len(image.instances)
        for i in image.instances:
            assert i.corners_xy is not None
            box = box_of_points(i.corners_xy)
            assert any(o[0] == i.category and np.abs(o[1:5] - box).max() < 0.02 for o in objects), (i, objects)


NUMBER = r"-?\d+(?:\.\d+)?"
OBJECT = re.compile(rf"({NUMBER}(?: {NUMBER}){{7}}) (\S+) ([01])")


def strict_dota(text: str) -> tuple[dict[str, str], list[tuple[np.ndarray, str, int]]]:
    """A label file by the page of DOTA's authors and nothing else: two header lines, then an object in each line.

    Raises:
        ValueError: Anything else.
    """
    lines = text.split("\n")
    if lines.pop() != "":
        raise ValueError("the last line has no end")
    header = {}
    for key in ("imagesource", "gsd"):
        name, colon, value = lines.pop(0).partition(":")
        if (name, colon) != (key, ":") or not value:
            raise ValueError(f"no {key}")
        header[key] = value
    if header["gsd"] != "null":
        float(header["gsd"])
    objects = []
    for line in lines:
        found = OBJECT.fullmatch(line)
        if found is None:
            raise ValueError(f"no object: {line!r}")
        corners = np.array([float(v) for v in found[1].split(" ")]).reshape(4, 2)
        if polygon_area(corners) <= 0:
            raise ValueError(f"not clockwise: {line!r}")
        objects.append((corners, found[2], int(found[3])))
    return header, objects


def test_dota_text_follows_its_specification(run: Path, tmp_path: Path) -> None:
    images, out = converted(run, tmp_path / "out", "dota", classes=api.ClassChanges({"OtherVehicle": "other vehicle"}))
    assert len(list(out.rglob("*.txt"))) == len(images)
    for image in images:
        stem = Path(image.name).stem
        _, objects = strict_dota((out / image.split / "labelTxt" / f"{stem}.txt").read_text())
        assert (out / image.split / "images" / Path(image.name).name).is_file()
        for i, (corners, name, difficult) in zip(image.instances, objects, strict=True):
            assert i.corners_xy is not None
            np.testing.assert_allclose(corners, i.corners_xy, rtol=0, atol=1e-6)
            assert name == {"OtherVehicle": "other-vehicle"}.get(i.category, i.category)
            assert difficult == int(i.difficult is True)


@pytest.mark.parametrize("text", ["", "gsd:null\n", "imagesource:x\ngsd:null\n1 2 3 4 5 6 7 8 a b 0\n",
                                  "imagesource:x\ngsd:null\n0 0 0 9 9 9 9 0 a 0\n"])  # fmt: skip
def test_the_strict_parser_is_strict(text: str) -> None:
    with pytest.raises((ValueError, IndexError)):
        strict_dota(text)


def test_oriented_boxes_of_new_objects_stay_in_the_frame_in_every_format(run: Path) -> None:
    for name in (*written_names(), NATIVE):
        options = {"empty": "keep", "pitch_sign": "-1"} if name == "monet" else {}
        folder = run if name == "coco" else run / name
        again = api.read_dataset(
            folder, api.Reading(format="coco" if name == "coco" else "monet" if options else None, options=options)
        )
        new = [o for i in again.images for o in i.instances if o.category == "drone"]
        assert len(new) == 8, name
        cut = 0
        for o in new:
            corners = o.corners_xy
            if corners is None:
                continue
            cut += bool((o.box_xyxy[:2] <= 0).any() or (o.box_xyxy[2:] >= [640, 512]).any())
            assert (corners >= -1e-6).all() and (corners <= np.array([640, 512]) + 1e-6).all(), name
        holds = "obb" not in find_writer("hit-uav" if name == NATIVE else name).lacks
        assert cut > 0 or not holds, name
