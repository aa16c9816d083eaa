"""A tiny valid dataset of every readable format; the fuzz suite damages them, other tests read them.

To add a format (or a further layout of one), write a function that fills an empty folder and returns it:

    @sample("monet")                        # the format's name, or `name:variant`
    def _monet(folder: Path) -> Path:
        ...
        return folder

in the alphabetical place of its name. Rules: three or four pictures of 64 x 48 px (`picture`), at least one with two
objects, one without any, at least two splits if the format has splits; no more than some thirty files; the same bytes
every time; read by `detection.read` without an error. Nothing else is to be done: `test_readers_fuzz.py` and the
tests of `check` take what is in `SAMPLES`.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from infrablend.core.boxes import corners_of_cxcywha
from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance
from infrablend.core.files import sha256_of
from infrablend.core.rle_masks import Mask
from infrablend.core.run_folder import ShardFiles
from infrablend.formats.labels import coco, dota, masks, voc, yolo
from infrablend.formats.labels.shard_tar import TarWriter, label_text
from infrablend.formats.published import anti_uav, hit_uav

Build = Callable[[Path], Path]
SAMPLES: dict[str, Build] = {}
SIZE_WH = (64, 48)


def codes(dataset: Dataset, severity: str = "error") -> list[str]:
    """The codes of the problems of one severity, in order."""
    return [p.code for p in dataset.problems if p.severity == severity]


def with_facts(item: Any, **facts: object) -> Any:
    """An `ImageRecord` or `FrameKey` of whose picture other facts are known."""
    return replace(item, capture=replace(item.capture, **facts))


def sample(name: str) -> Callable[[Build], Build]:
    """Enter a builder into `SAMPLES`."""

    def enter(build: Build) -> Build:
        assert name not in SAMPLES, name
        SAMPLES[name] = build
        return build

    return enter


def picture(path: Path, number: int, size_wh: tuple[int, int] = SIZE_WH) -> Path:
    """Write a small grey picture, another one for every number; the suffix tells the type."""
    x, y = np.meshgrid(np.arange(size_wh[0]), np.arange(size_wh[1]))
    grey = (40 + x + y // 2 + 7 * number + 25 * ((x // 8 + y // 8 + number) % 2)).astype(np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(grey).save(path)
    return path


def records(folder: Path) -> tuple[tuple[ImageRecord, ...], tuple[Category, ...]]:
    """Four records for a writer, pictures in `folder`: several objects, none, one with a mask, one."""
    obb = (20.5, 18.25, 12.0, 6.0, 0.4)
    corners = corners_of_cxcywha(np.array([obb]))[0]
    mask = np.zeros((48, 64), np.bool_)
    mask[5:12, 40:50] = True
    labels: tuple[tuple[str, str, tuple[Instance, ...]], ...] = (
        (
            "train",
            "0_60_30_0_00001.jpg",
            (
                Instance("Car", np.concatenate([corners.min(axis=0), corners.max(axis=0)]), corners),
                Instance("DontCare", np.array([1.0, 2.0, 9.0, 30.0])),
                Instance("Person", np.array([40.0, 5.0, 50.0, 12.0]), mask=Mask.from_array(mask)),
            ),
        ),
        ("train", "1_90_60_0_00012.jpg", ()),
        (
            "val",
            "1_90_60_0_00023.jpg",
            (Instance("Person", np.array([40.0, 5.0, 50.0, 12.0]), mask=Mask.from_array(mask)),),
        ),
        ("test", "1_90_90_0_00034.jpg", (Instance("Bicycle", np.array([10.0, 20.0, 18.0, 25.0])),)),
    )
    images = []
    for k, (split, name, instances) in enumerate(labels):
        path = picture(folder / name, k)
        time, altitude, pitch, *_ = name.split("_")
        of_day = "night" if time == "1" else "day"
        images.append(
            ImageRecord(
                path.stem,
                path,
                split,
                SIZE_WH,
                instances,
                capture=Capture(pitch_deg=float(pitch), altitude_m=float(altitude), time_of_day=of_day),
                source_id=k,
                extra={"date": f"2021010{k + 1}"},
                file_name=name,
            )
        )
    return tuple(images), hit_uav.CATEGORIES


def _written(folder: Path, write: Callable[[tuple[ImageRecord, ...], tuple[Category, ...]], object]) -> Path:
    """A sample made by the format's own writer; the pictures it was made from are removed."""
    source = folder.with_name(folder.name + "-source")
    images, categories = records(source)
    write(images, categories)
    for path in source.iterdir():
        path.unlink()
    source.rmdir()
    return folder


# -- in alphabetical order -------------------------------------------------------------------------------------


@sample("anti-uav")
def _anti_uav(folder: Path) -> Path:
    """Pictures of two sequences in two splits; the second frame of the first shows no drone."""
    for k, split in enumerate(("train", "test")):
        sequence = folder / split / f"2019092{k}_111757_1_{k}"
        for n in range(2):
            picture(sequence / f"{n + 1:06d}.jpg", 3 * k + n)
        top = {"exist": [1, k], "gt_rect": [[5, 6, 12, 8], [30, 20, 9, 7] if k else []]}
        (sequence / "IR_label.json").write_text(json.dumps(top))
    return folder


@sample("anti-uav:targets")
def _anti_uav_targets(folder: Path) -> Path:
    """As our writer does it: a folder for each object, and tables that put them together."""
    return _written(folder, lambda images, names: anti_uav.write(folder, images, names))


@sample("bambi")
def _bambi(folder: Path) -> Path:
    """Two flights in two splits, their pictures in one folder, with a twin in visible light."""
    species = ("Rotwild", "Schwarzwild")
    for k, (flight, split) in enumerate((("7", "train"), ("7", "train"), ("12", "test"))):
        name = f"{flight}_{100 + k}.jpg"
        picture(folder / "thermal" / name, k)
        picture(folder / "rgb" / name, k + 7)
        file = folder / f"{flight}_metadata.json"
        link = {"sharepoint_link": "https://x/2024_03_22_Place/F_M3TE"}
        empty = {"flight_key": flight, "split": split, "flight_info": link, "frames": {}}
        top = json.loads(file.read_text()) if file.is_file() else empty
        boxes = [
            {"species": s, "gender": 0, "age": 2, "visibility": n, "label_id": 10 * k + n,
             "bbox": {"x_min": 5 + 20 * n, "y_min": 6, "x_max": 17 + 20 * n, "y_max": 14}}
            for n, s in enumerate(species if k != 1 else ())
        ]  # fmt: skip
        top["frames"][str(100 + k)] = {"frame_idx": 100 + k, "thermal_image": name, "annotations": boxes}
        file.write_text(json.dumps(top))
    return folder


@sample("bambi:tracks")
def _bambi_tracks(folder: Path) -> Path:
    """Two published flights with pictures instead of videos; the second picture shows no animal, only a rock."""
    for flight, split in (("7", "train"), ("12", "test")):
        rows = [
            "3,1,5,6,12,8,1.0,6,1.0,Cervus elaphus (Red deer),0,2,0",
            "3,2,30,20,9,7,1.0,60,0.0,Sus scrofa (Wild boar),0,0,1",
            "4,3,5,6,12,8,1.0,0,1.0,No-animal,0,0,0",
        ]
        (folder / flight).mkdir(parents=True)
        (folder / flight / f"{flight}_gt.txt").write_text("\n".join(rows) + "\n")
        poses = [{"timestamp": f"2024-03-22T10:47:0{k}", "pitch": 360.0 - k, "alt": 900.0} for k in range(5)]
        (folder / flight / f"{flight}_matched_poses.json").write_text(json.dumps({"images": poses}))
        top = {"flight_key": flight, "split": split, "flight_info": {"start_time": "2024-03-22T10:47:00"}}
        (folder / flight / f"{flight}_metadata.json").write_text(json.dumps(top))
        for k in (3, 4):
            picture(folder / flight / "thermal" / f"{flight}_matched_processed_{k:08d}.png", k + int(flight))
    return folder


@sample("bambi:yolo")
def _bambi_yolo(folder: Path) -> Path:
    """YOLO labels of published class numbers, and the poses of the flight."""
    for k, (split, text) in enumerate(
        (("train", "6 0.5 0.5 0.2 0.2\n62 0.2 0.25 0.1 0.125\n"), ("train", ""), ("val", "0 0.5 0.5 0.2 0.2\n"))
    ):
        picture(folder / "images" / split / f"163_{k}.png", k)
        label = folder / "labels" / split / f"163_{k}.txt"
        label.parent.mkdir(parents=True, exist_ok=True)
        label.write_text(text)
    poses = [{"timestamp": "2024-03-22T10:47:08", "rotation": [5.0 * k, 0, 90]} for k in range(3)]
    (folder / "correction_data").mkdir()
    (folder / "correction_data" / "163_matched_poses.json").write_text(json.dumps({"images": poses}))
    return folder


@sample("birdsai")
def _birdsai(folder: Path) -> Path:
    """Two sequences of different sizes in train, one in test, and files beside the tables that are not tables."""
    rows = "0,1,3,4,17,13,0,1,0,0\n0,2,30,8,11,12,1,0,1,0\n"
    for k, (split, sequence, frame, text) in enumerate(
        (
            ("Train", 67, 0, rows),
            ("Train", 67, 1, None),
            ("Train", 68, 0, "0,1,5,6,20,9,0,-1,0,1\n"),
            ("Test", 70, 5, ""),
        )
    ):
        name = f"{sequence:010d}_0000000025"
        size = (58, 37) if sequence == 68 else SIZE_WH
        picture(folder / f"{split}Real" / "images" / name / f"{name}_{frame:010d}.jpg", k, size)
        table = folder / f"{split}Real" / "annotations" / f"{name}.csv"
        table.parent.mkdir(parents=True, exist_ok=True)
        if text is not None:
            table.write_text(text)
    beside = folder / "TrainReal" / "annotations"
    (beside / "water_metadata_train.txt").write_text("no table")
    (beside / "tracking").mkdir()
    (beside / "._0000000067_0000000025.csv").write_text("no table")
    return folder


@sample("birdsai:frames")
def _birdsai_frames(folder: Path) -> Path:
    """Frames alone, of several sizes."""
    for k, (sequence, size) in enumerate(((11, (63, 32)), (55, SIZE_WH), (55, SIZE_WH))):
        picture(folder / f"{sequence:010d}_0000000000_{100 + k:010d}.jpg", k, size)
    return folder


@sample("coco")
def _coco(folder: Path) -> Path:
    return _written(folder, lambda images, names: coco.write(folder, images, names, pictures=True))


@sample("coco:plain")
def _coco_plain(folder: Path) -> Path:
    """Pictures, one COCO file beside them under a name of its own, and a table as JSON."""
    for k in range(3):
        picture(folder / f"a{k}.png", k)
    annotations = [
        {
            "id": k,
            "image_id": 0,
            "category_id": 1,
            "bbox": [5 + 20 * k, 6, 9, 8],
            "segmentation": [[5, 6, 14, 6, 9, 14]],
        }
        for k in range(2)
    ]
    images = [{"id": k, "file_name": f"a{k}.png", "width": 64, "height": 48} for k in range(3)]
    top = {"images": images, "annotations": annotations, "categories": [{"id": 1, "name": "fox"}]}
    (folder / "labels.json").write_text(json.dumps(top))
    (folder / "metadata.json").write_text(json.dumps({"a0.png": {"pitch_deg": 45, "time_of_day": "night"}}))
    return folder


@sample("coco:flir")
def _coco_flir(folder: Path) -> Path:
    """FLIR's ADAS dataset v2: a folder per split and camera, with another file of labels beside COCO's."""
    for k, name in enumerate(("images_thermal_train", "images_thermal_val", "images_rgb_train", "video_thermal_test")):
        file = f"data/video-a{k}-frame-000000-xT7.jpg"
        picture(folder / name / file, k)
        images = [{"id": 0, "file_name": file, "width": 64, "height": 48, "extra_info": {"hours": "night"}}]
        boxes = [
            {"id": n, "image_id": 0, "category_id": 1 + 2 * n, "bbox": [5 + 20 * n, 6, 9, 8], "iscrowd": False}
            for n in range(2 if k != 1 else 0)
        ]
        classes = [{"id": n, "name": c} for n, c in enumerate(("person", "bike", "car", "sheep"), 1)]
        top = {"images": images, "annotations": boxes, "categories": classes}
        (folder / name / "coco.json").write_text(json.dumps(top))
        frames = {"datasetName": name, "frames": [{"file": file, "annotations": [{"labels": ["face"]}]}]}
        (folder / name / "index.json").write_text(json.dumps(frames))
        (folder / name / "coco_annotation_counts.txt").write_text("| person | 1 |\n")
    pairs = {"video-a2-frame-000000-xT7.jpg": "video-a0-frame-000000-xT7.jpg"}
    (folder / "rgb_to_thermal_vid_map.json").write_text(json.dumps(pairs))
    return folder


@sample("cvat")
def _cvat(folder: Path) -> Path:
    from infrablend.formats.labels import cvat  # which sources of earlier versions do not have

    return _written(folder, lambda images, categories: cvat.write(folder, images, categories))


@sample("cvat:video")
def _cvat_video(folder: Path) -> Path:
    """Two sequences; in the first, one object is gone in the second frame, the other in the third."""
    box = '<box frame="{}" keyframe="1" outside="{}" occluded="0" xtl="{}" ytl="4" xbr="20" ybr="17.5"></box>'
    first = "".join(box.format(n, int(n == 2), 3 + n) for n in range(3))
    second = box.format(0, 0, 9) + box.format(1, 1, 9)
    tracks = f'<track id="0" label="Person">{first}</track><track id="1" label="Car">{second}</track>'
    for k, (name, text, count) in enumerate((("train/north", tracks, 3), ("val/south", "", 1))):
        for n in range(count):
            picture(folder / name / "images" / f"frame_{n:06d}.png", 3 * k + n)
        head = "<version>1.1</version><meta><task><mode>interpolation</mode></task></meta>"
        (folder / name / "annotations.xml").write_text(f"<annotations>{head}{text}</annotations>")
    return folder


@sample("dota")
def _dota(folder: Path) -> Path:
    return _written(folder, lambda images, names: dota.write(folder, images, names))


@sample("dota:annfiles")
def _dota_annfiles(folder: Path) -> Path:
    """MMRotate's layout: no header, no flag on one line, integers, a test split without labels."""
    lines = ("2 3 12 3 12 9 2 9 ship 0\n20 20 30.5 22 30 26.5 19 25 plane 1\n", "", "5 5 9 5 9 9 5 9 ship\n")
    for k, text in enumerate(lines):
        base = folder / ("train", "train", "val")[k]
        picture(base / "images" / f"P{k:04}.png", k)
        (base / "annfiles").mkdir(exist_ok=True)
        (base / "annfiles" / f"P{k:04}.txt").write_text(text)
    picture(folder / "test/images/P0009.png", 9)
    return folder


@sample("drone-vehicle")
def _drone_vehicle(folder: Path) -> Path:
    """Pairs of two splits without a white border; the second of train shows no vehicle."""
    points = ("x1", "y1", "x2", "y2", "x3", "y3", "x4", "y4")
    for k, (split, stem) in enumerate((("train", "00001"), ("train", "00002"), ("val", "00001"))):
        for n, (pictures, labels) in enumerate((("imgr", "labelr"), ("img", "label"))):
            picture(folder / split / f"{split}{pictures}" / f"{stem}.jpg", 2 * k + n)
            objects = "".join(
                f"<object><name>{name}</name><truncated>0</truncated><polygon>"
                + "".join(
                    f"<{p}>{v}</{p}>" for p, v in zip(points, (x, 10, x + 12, 13, x + 10, 21, x - 2, 18), strict=True)
                )
                + "</polygon></object>"
                for name, x in (("car", 8), ("feright car", 35))
            )
            size = "<size><width>64</width><height>48</height><depth>3</depth></size>"
            text = f"<annotation><filename>{stem}.jpg</filename>{size}{objects if k != 1 else ''}</annotation>"
            (folder / split / f"{split}{labels}").mkdir(exist_ok=True)
            (folder / split / f"{split}{labels}" / f"{stem}.xml").write_text(text)
    return folder


@sample("dut-anti-uav")
def _dut_anti_uav(folder: Path) -> Path:
    """Colour pictures with the same names in two splits; the second of train shows no drone."""
    boxes = "".join(
        f"<object><name>UAV</name><truncated>0</truncated><difficult>0</difficult><bndbox><xmin>{x}</xmin>"
        f"<ymin>4</ymin><xmax>{x + 9}</xmax><ymax>12</ymax></bndbox></object>"
        for x in (3, 40)
    )
    for k, (split, name) in enumerate((("train", "00001"), ("train", "00002"), ("test/test", "00001"))):
        path = picture(folder / split / "img" / f"{name}.jpg", k)
        grey = np.array(Image.open(path))
        Image.fromarray(np.stack([grey, grey // 2, 255 - grey], axis=-1)).save(path)
        size = "<size><width>64</width><height>48</height><depth>3</depth></size>"
        text = f"<annotation><filename>{name}.jpg</filename>{size}{boxes if k == 0 else ''}</annotation>"
        (folder / split / "xml").mkdir(exist_ok=True)
        (folder / split / "xml" / f"{name}.xml").write_text(text)
    return folder


@sample("folder:plain")
def _folder_plain(folder: Path) -> Path:
    """Pictures of several types, no labels, a table as JSON."""
    for k, name in enumerate(("a.jpg", "b.png", "c.bmp", "d.tif")):
        picture(folder / name, k)
    table = [{"file": "a.jpg", "pitch_deg": 45, "time_of_day": "night"}, {"stem": "b", "altitude_m": 60.5}]
    (folder / "metadata.json").write_text(json.dumps(table))
    return folder


@sample("folder:yolo")
def _folder_yolo(folder: Path) -> Path:
    """Text beside the pictures in folders of splits, class names in `classes.txt`, a table as CSV."""
    for k, (split, text) in enumerate(
        (("train", "0 0.5 0.5 0.2 0.2\n1 0.2 0.25 0.1 0.125\n"), ("train", ""), ("test", ""))
    ):
        path = picture(folder / split / f"b {k}.jpg", k)
        path.with_suffix(".txt").write_text(text)
    (folder / "classes.txt").write_text("fox\nhare\n")
    (folder / "metadata.csv").write_text("file,pitch_deg,altitude_m,time_of_day\ntrain/b 0.jpg,30,50,day\n")
    return folder


@sample("halmstad")
def _halmstad(folder: Path) -> Path:
    """Two clips of 31 frames; the drone is there in the first frame, not in the last."""
    from tests.videos import write_ground_truth, write_video

    (folder / "Video_IR").mkdir(parents=True)
    for k, clip in enumerate(("IR_DRONE_001", "IR_BIRD_002")):
        write_video(folder / "Video_IR" / f"{clip}.mp4", frames=31, codec="mpeg4")
        boxes = [(10.0 + k, 11.0, 12.0, 8.0), *[None] * 30]
        write_ground_truth(folder / "Video_IR" / f"{clip}_LABELS.mat", boxes)
    return folder


@sample("hit-uav:json")
def _hit_uav_json(folder: Path) -> Path:
    return _written(folder, lambda images, names: hit_uav.write(folder, images, names))


@sample("hit-uav:xml")
def _hit_uav_xml(folder: Path) -> Path:
    forms: tuple[hit_uav.Form, ...] = ("normal_xml", "rotate_xml")
    return _written(folder, lambda images, names: hit_uav.write(folder, images, names, forms=forms))


@sample("huggingface")
def _huggingface(folder: Path) -> Path:
    from infrablend.formats.labels import huggingface  # which sources of earlier versions do not have

    return _written(folder, lambda images, categories: huggingface.write(folder, images, categories))


@sample("label-studio")
def _label_studio(folder: Path) -> Path:
    from infrablend.formats.labels import label_studio  # which sources of earlier versions do not have

    return _written(folder, lambda images, categories: label_studio.write(folder, images, categories))


@sample("labelme")
def _labelme(folder: Path) -> Path:
    """JSON beside the pictures of two splits, one without shapes; a name as on Windows."""
    shapes = [
        {"label": "deer", "shape_type": "rectangle", "points": [[14, 9.5], [4, 20]]},
        {"label": "boar", "shape_type": "polygon", "points": [[30, 10], [50, 12], [40, 30]], "group_id": 1},
        {"label": "boar", "shape_type": "circle", "points": [[52, 38], [56, 38]], "flags": {"occluded": True}},
    ]
    for k, split in enumerate(("train", "train", "val")):
        path = picture(folder / split / f"f{k}.png", k)
        top: dict[str, Any] = {
            "version": "5.4.1",
            "flags": {},
            "shapes": shapes if k != 1 else [],
            "imagePath": f"..\\{split}\\f{k}.png",
        }
        top |= {"imageData": None, "imageHeight": 48, "imageWidth": 64}
        path.with_suffix(".json").write_text(json.dumps(top, indent=2))
    return folder


@sample("masks")
def _masks(folder: Path) -> Path:
    return _written(folder, lambda images, names: masks.write(folder, images, names))


@sample("monet")
def _monet(folder: Path) -> Path:
    """Two good sequences, one without telemetry, a file for each; pitch as MONET's gimbal gives it."""
    for n, (split, sequence, pitches) in enumerate(
        (("train", "runway_01", (None,)), ("train", "runway_04", (-35.5, -60.0)), ("test", "dirtroad_03", (-90.0, 4.5)))
    ):
        images, annotations = [], []
        for k, pitch in enumerate(pitches):
            path = picture(folder / split / sequence / "lwir" / f"image{k:05d}.png", 10 * n + k)
            telemetry = {"g_pitch": pitch, "alt": 51.5, "timestamp": f"2022-07-01T10:00:0{k}+02:00", "speed_x": 1.5}
            images.append(
                {"id": k + 1, "file_name": f"lwir/{path.name}", "width": 64, "height": 48,
                 "metadata": {} if pitch is None else telemetry}
            )  # fmt: skip
        for k in range(2):
            annotations.append(
                {"id": k + 1, "image_id": 1, "category_id": k + 1, "bbox": [5 + 20 * k, 6, 9, 8], "area": 72,
                 "iscrowd": 0}
            )  # fmt: skip
        categories = [{"id": 1, "name": "person"}, {"id": 2, "name": "vehicle"}]
        top = {"images": images, "annotations": annotations, "categories": categories}
        (folder / split / f"{sequence}.json").write_text(json.dumps(top))
    return folder


@sample("mot")
def _mot(folder: Path) -> Path:
    """A sequence in train with two objects and an empty frame, and one in test without labels."""
    rows = "1,1,4,5,17,13,1,1,0.5\n1,2,31,9,11,12,1,2,1\n3,1,5,5,17,13,0,1,1\n"
    info = "[Sequence]\nname={}\nimDir=img1\nframeRate=25\nseqLength={}\nimWidth=64\nimHeight=48\nimExt=.png\n"
    for k, (name, count) in enumerate((("train/north", 3), ("test/south", 1))):
        for n in range(count):
            picture(folder / name / "img1" / f"{n + 1:06d}.png", 3 * k + n)
        (folder / name / "seqinfo.ini").write_text(info.format(name[-5:], count))
    (folder / "train/north/gt").mkdir()
    (folder / "train/north/gt/gt.txt").write_text(rows)
    (folder / "train/north/gt/labels.txt").write_text("deer\nperson\n")
    return folder


@sample("mot:challenge")
def _mot_challenge(folder: Path) -> Path:
    """MOT16's names of classes, without seqinfo.ini; the second frame is empty."""
    for n in range(2):
        picture(folder / "MOT16-02" / "img1" / f"{n + 1:06d}.jpg", n)
    (folder / "MOT16-02" / "gt").mkdir()
    (folder / "MOT16-02" / "gt" / "gt.txt").write_text("1,1,4,5,17,13,1,1,1\n1,9,31,9,11,12,0,3,0.25\n")
    return folder


@sample("shards")
def _shards(folder: Path) -> Path:
    """Two packed shards; their tables are not read."""
    images, categories = records(folder / "from")
    ids = {c.name: c.id for c in categories}
    key = {"seed": 0}
    (folder / "shards.json").write_text(json.dumps({"shards": 2, "layout": "shards", "key": key}))
    for number in (1, 2):
        files = ShardFiles(folder, f"shard-{number:05d}-of-00002")
        with files.tar.open("wb") as stream, TarWriter(stream) as tar:
            for image in images[number - 1 :: 2]:
                frame = f"{image.split}/{Path(image.name).stem}"
                tar.add(frame, image.path.suffix[1:], image.path.read_bytes())
                tar.add(frame, "json", label_text(frame, image, ids))
                tar.add(frame, "scene.json", b"{}")
        files.table.write_bytes(b"PAR1")
        made = {"tar": files.tar, "table": files.table}
        archive = {k: {"bytes": p.stat().st_size, "sha256": sha256_of(p)} for k, p in made.items()}
        known = [asdict(c) for c in categories]
        record = {"infrablend": "0", "status": "complete", "key": key, "categories": known, "archive": archive}
        files.marker.write_text(json.dumps(record))
    shutil.rmtree(folder / "from")
    return folder


@sample("videos")
def _videos(folder: Path) -> Path:
    """Two clips of 31 frames in two splits, one with subtitles."""
    from tests.videos import bracketed, write_srt, write_video

    for k, split in enumerate(("train", "test")):
        (folder / split).mkdir(parents=True)
        frames = [np.full(SIZE_WH[::-1], 30 + 60 * k + n, np.uint8) for n in range(31)]
        write_video(folder / split / f"DJI_{k}.mp4", frames, codec="mpeg4")
    write_srt(folder / "train" / "DJI_0.SRT", bracketed, blocks=31)
    return folder


@sample("visdrone")
def _visdrone(folder: Path) -> Path:
    """Two splits; the second picture of train shows nothing, and a line ends with a comma."""
    lines = (
        "3,4,12,9,1,4,0,1\n30,8,11,12,1,1,1,0,\n50,30,10,9,0,0,0,0\n",
        "",
        "5,6,20,9,1,10,0,2\n40,6,9,9,0,11,0,0\n",
    )
    for k, text in enumerate(lines):
        base = folder / f"VisDrone2019-DET-{('train', 'train', 'val')[k]}"
        stem = f"000000{k}_02999_d_000000{k}"
        picture(base / "images" / f"{stem}.jpg", k)
        (base / "annotations").mkdir(exist_ok=True)
        (base / "annotations" / f"{stem}.txt").write_text(text)
    return folder


@sample("visdrone:video")
def _visdrone_video(folder: Path) -> Path:
    """A sequence each in train and val; frames count from 1, and the second frame of the first is empty."""
    rows = "1,0,3,4,17,13,1,4,0,0\n1,7,30,8,11,12,1,1,0,1\n3,0,5,4,17,13,0,4,0,2\n"
    for k, (split, name, text) in enumerate((("train", "uav0001_00000_v", rows), ("val", "uav0002_00000_v", ""))):
        base = folder / f"VisDrone2019-MOT-{split}"
        for n in range(3 - 2 * k):
            picture(base / "sequences" / name / f"{n + 1:07d}.jpg", 3 * k + n)
        (base / "annotations").mkdir()
        (base / "annotations" / f"{name}.txt").write_text(text)
    return folder


@sample("voc")
def _voc(folder: Path) -> Path:
    return _written(folder, lambda images, names: voc.write(folder, images, names))


@sample("voc:flat")
def _voc_flat(folder: Path) -> Path:
    """XML beside the pictures in folders of splits, in LabelImg's manner and roLabelImg's, one without objects."""
    turned = "<robndbox><cx>30</cx><cy>20</cy><w>12.5</w><h>6</h><angle>0.4</angle></robndbox>"
    upright = "<bndbox><xmin>1</xmin><ymin>2</ymin><xmax>64</xmax><ymax>30.5</ymax></bndbox>"
    objects = "".join(f"<object><name>fox</name><difficult>0</difficult>{box}</object>" for box in (turned, upright))
    size = "<size><width>64</width><height>48</height><depth>1</depth></size>"
    for k, split in enumerate(("train", "train", "valid")):
        path = picture(folder / split / f"c {k}.jpg", k)
        text = f"<annotation><filename>{path.name}</filename>{size}{objects if k == 0 else ''}</annotation>"
        path.with_suffix(".xml").write_text(text)
    return folder


@sample("wisard")
def _wisard(folder: Path) -> Path:
    """A clip with a blank in its names and a count, a FLIR clip with its logo, one of visible light."""
    clips = ("210417_MtErie_Enterprise_IR_0004", "200704_Baker_FLIR_IR_1", "210417_MtErie_Enterprise_VIS_0003")
    people = "0 0.5 0.5 0.2 0.25\n0 0.2 0.25 0.100000 0.125000\n"
    frames = (
        (0, "DJI_0053_00000715.jpg", people),
        (0, "DJI 0053_ 00000721.jpeg", ""),
        (1, "200704_baker__FLIR_1_ 0001.jpg", ""),
        (2, "DJI_0052_00000715.jpg", people),
    )
    for k, (clip, name, text) in enumerate(frames):
        path = picture(folder / clips[clip] / name, k)
        path.with_suffix(".txt").write_text(text)
    (folder / clips[0] / "count.txt").write_text("2\n1\n")
    return folder


@sample("wit-uas")
def _wit_uas(folder: Path) -> Path:
    """One run in two splits by two cameras: 8 and 16 bits, one and three channels."""
    run = "2021-11-08_FIRE-SGL-174-Rossiter_M100/2021-11-08-12-30-00"
    label = "3 4 20 17 h\n30.5 8 41 20 v\n\n50 8 60 20 c\n"
    for k, (split, sensor, time, text) in enumerate(
        (("train", "flir", "0001.00", label), ("train", "flir", "0002.00", ""), ("test", "seek", "0003.00", ""))
    ):
        path = picture(folder / split / f"{run}_{sensor}" / f"time_{time}.png", k)
        grey = np.array(Image.open(path))
        Image.fromarray(grey.astype(np.uint16) * 200 if k == 0 else np.stack([grey] * 3, axis=-1)).save(path)
        path.with_suffix(".label").write_text(text)
    return folder


@sample("yolo:detect")
def _yolo_detect(folder: Path) -> Path:
    return _written(folder, lambda images, names: yolo.write(folder, images, names))


@sample("yolo:obb")
def _yolo_obb(folder: Path) -> Path:
    return _written(folder, lambda images, names: yolo.write(folder, images, names, task="obb"))


@sample("yolo:seg")
def _yolo_seg(folder: Path) -> Path:
    return _written(folder, lambda images, names: yolo.write(folder, images, names, task="seg"))
