"""Labels of other tools, after public bug reports: read rightly, or named with the next step by every command.

docs/how_to/check_a_dataset.md lists the kinds with their sources. Then all of them are damaged, with further inputs of
other tools where real data are, and the samples of the newest readers.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from tests.command_line import run
from tests.samples import SAMPLES, picture

from infrablend import api
from infrablend.formats.annotation_files import MAX_TEXT_BYTES, WHOLE_JSON

BOX = {"top": 6, "left": 4, "width": 10, "height": 12}
CATEGORIES = [{"id": 1, "name": "deer"}]


def put(root: Path, *pictures: str, **files: object) -> Path:
    """Write pictures, and files by their names; what is no text becomes JSON."""
    for k, name in enumerate(pictures):
        picture(root / name, k)
    for name, content in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(content, bytes):
            path.write_bytes(content)
        else:
            path.write_text(content if isinstance(content, str) else json.dumps(content))
    return root


def coco(ids: Any = 1, category: Any = 1, **fields: object) -> dict[str, object]:
    label = {"id": 1, "image_id": ids, "category_id": category, "bbox": [4, 6, 10, 12], **fields}
    images = [{"id": ids, "file_name": "f1.jpg", "width": 64, "height": 48}]
    return {"images": images, "annotations": [label], "categories": [{"id": category, "name": "deer"}]}


def voc(name: str, more: str) -> str:
    size, box = "<width>64</width><height>48</height>", "<xmin>24</xmin><ymin>20</ymin><xmax>44</xmax><ymax>30</ymax>"
    return (
        f"<annotation><filename>{name}</filename><size>{size}</size><object><name>deer</name><bndbox>{box}</bndbox>"
        f"{more}</object></annotation>"
    )


# -- kinds that are named -----------------------------------------------------------------------------------------


def open_images(root: Path) -> Path:
    """Pictures are named without their suffix: github.com/openimages/dataset/issues/80."""
    head = "ImageID,Source,LabelName,Confidence,XMin,XMax,YMin,YMax,IsOccluded\n"
    text = head + 9 * "f1,xclick,/m/01g317,1,0.1,0.3,0.2,0.4,0\n"
    return put(root, "train/f1.jpg", "train/f2.jpg", **{"train-annotations-bbox.csv": text})


def supervisely(root: Path) -> Path:
    """The name of the file, `f1.jpg.json`, says of which picture it is: github.com/voxel51/fiftyone/issues/4443."""
    points = {"exterior": [[4, 6], [14, 18]], "interior": []}
    objects = [{"classTitle": "deer", "geometryType": "rectangle", "points": points}]
    label = {"description": "", "size": {"height": 48, "width": 64}, "objects": objects}
    return put(root, "ds0/img/f1.jpg", **{"ds0/ann/f1.jpg.json": label, "meta.json": {"classes": [{"title": "deer"}]}})


def labelbox(root: Path) -> Path:
    """A line of JSON per picture: github.com/ultralytics/ultralytics/pull/22786."""
    labels = [{"annotations": {"objects": [{"name": "deer", "bounding_box": BOX}]}}]
    row = {"data_row": {"external_id": "f1.jpg"}, "projects": {"p": {"labels": labels}}}
    return put(root, "f1.jpg", **{"export.ndjson": json.dumps(row) + "\n"})


def ground_truth(root: Path) -> Path:
    """A manifest of AWS: docs.aws.amazon.com/rekognition/latest/customlabels-dg, cd-manifest-files-object-detection."""
    row = {"source-ref": "s3://bucket/f1.jpg", "boxes": {"annotations": [{"class_id": 0, **BOX}]}}
    return put(root, "f1.jpg", **{"output.manifest": json.dumps(row) + "\n"})


def uavdt(root: Path) -> Path:
    """A table of ground truth per sequence: github.com/VITA-Group/UAV-NDFT/issues/4."""
    return put(root, "UAV-benchmark-M/M0101/img000001.jpg", **{"GT/M0101_gt_whole.txt": "1,9,5,6,12,8,1,3,1\n"})


def uav123(root: Path) -> Path:
    """Four numbers per frame: github.com/visionml/pytracking/issues/119."""
    return put(root, "data_seq/UAV123/bike1/000001.jpg", **{"anno/UAV123/bike1.txt": 9 * "5,6,12,8\n"})


def upload_prefix(root: Path) -> Path:
    """Label Studio puts eight digits before the names: github.com/HumanSignal/label-studio/issues/5438."""
    label = [{"x": 1, "y": 2, "width": 3, "height": 4, "rectanglelabels": ["deer"]}]
    rows = [{"image": "/data/upload/1/ab12cd34-my f1.jpg", "id": 1, "label": label}]
    return put(root, "images/my f1.jpg", **{"project-1-min.json": rows})


def wider(root: Path) -> Path:
    """A name, a number, and lines of boxes: github.com/akofman/wider-face-pascal-voc-annotations/pull/2."""
    text = 9 * "0--Parade/f1.jpg\n1\n4 6 10 12 0 0 0 0 0 0\n"
    return put(root, "images/0--Parade/f1.jpg", **{"wider_train_bbx.txt": text})


def tf_record(root: Path) -> Path:
    """A part of TensorFlow's records: github.com/zzh8829/yolov3-tf2/issues/401."""
    record = (
        2
        * b"\x91\1\0\0\0\0\0\0abcd\n\x8e\3\n \n\x0eimage/filename\x12\x0e\n\x0c\n\x0af1.jpg\n\x1eimage/object/bbox/xmin"
    )
    return put(root, "f1.jpg", **{"train.record-00000-of-00010": record})


def detections(root: Path) -> Path:
    """Results of a detector know pictures by their stems: github.com/ultralytics/ultralytics/issues/21557."""
    return put(root, "f1.jpg", **{"predictions.json": [{"image_id": "f1", "category_id": 1, "bbox": [4, 6, 10, 12]}]})


def fiftyone_detections(root: Path) -> Path:
    """Stems as keys: docs.voxel51.com/user_guide/export_datasets.html, FiftyOneImageDetectionDataset."""
    labels = {"f1": [{"label": 0, "bounding_box": [0.1, 0.1, 0.2, 0.2]}]}
    return put(root, "data/f1.jpg", **{"labels.json": {"classes": ["deer"], "labels": labels}})


def vedai(root: Path) -> Path:
    """A table for all pictures, keyed by their stems without `_ir`: github.com/AlexeyAB/darknet/issues/1089."""
    rows = "".join(f"0000000{k} 40.0 40.0 0.1 20 60 60 20 30 30 50 50 1 1 0\n" for k in range(2))
    pictures = [f"Vehicules512/0000000{k}_{form}.jpg" for k in range(2) for form in ("co", "ir")]
    return put(root, *pictures, **{"Annotations512/annotation512.txt": rows})


def nps_drones(root: Path) -> Path:
    """A text of tuples per clip: github.com/mwaseema/Drone-Detection/issues/2."""
    rows = "".join(f"time_layer: {k} detections: (30, 2{k}, 50, 6{k})\n" for k in range(9))
    return put(root, "Videos/Clip_1/0000.jpg", "Videos/Clip_1/0001.jpg", **{"annotations/Clip_1_gt.txt": rows})


def results_of_coco(root: Path) -> Path:
    """Boxes by the numbers of pictures in another file: cocodataset.org/#format-results."""
    rows = [{"image_id": 480000 + k, "category_id": 1, "bbox": [4, 6, 10, 12], "score": 0.5} for k in range(2)]
    return put(root, "images/f1.jpg", **{"results.json": rows})


NAMED: dict[Callable[[Path], Path], str] = {
    open_images: "train-annotations-bbox.csv",
    supervisely: "ds0/ann/f1.jpg.json",
    labelbox: "export.ndjson",
    ground_truth: "output.manifest",
    uavdt: "GT/M0101_gt_whole.txt",
    uav123: "anno/UAV123/bike1.txt",
    upload_prefix: "project-1-min.json",
    wider: "wider_train_bbx.txt",
    tf_record: "train.record-00000-of-00010",
    detections: "predictions.json",
    fiftyone_detections: "labels.json",
    vedai: "Annotations512/annotation512.txt",
    nps_drones: "annotations/Clip_1_gt.txt",
    results_of_coco: "results.json",
}


@pytest.mark.parametrize("kind", NAMED, ids=lambda kind: kind.__name__)
def test_every_command_names_the_file_and_the_next_step(tmp_path: Path, kind: Callable[[Path], Path]) -> None:
    root = kind(tmp_path / "data")
    commands = {"check": ("--no-decode",), "inspect": (), "convert": (tmp_path / "out", "--to", "coco")}
    for command, more in commands.items():
        done = run(command, root, *more)
        output = " ".join(done.output.split())
        assert NAMED[kind] in output and "CVAT or Datumaro" in output, (command, output)
        assert (done.exit_code == 0) == (command == "inspect")  # inspect gives no verdict


@pytest.mark.parametrize("kind", NAMED, ids=lambda kind: kind.__name__)
def test_such_a_file_is_named_beside_labels_that_are_read(tmp_path: Path, kind: Callable[[Path], Path]) -> None:
    root = kind(tmp_path / "data")
    (root / "classes.txt").write_text("deer\n")
    for path in sorted(root.rglob("*.jpg"))[:1]:
        path.with_suffix(".txt").write_text("0 0.5 0.5 0.2 0.2\n")
    report = api.check(root, decode=False)
    assert report.objects == 1
    assert [p.where for p in report.errors if p.code == "label-unread"] == [NAMED[kind]]


# -- kinds that are read ------------------------------------------------------------------------------------------


def ids_of_text(root: Path) -> Path:
    """Ids are text: github.com/open-mmlab/mmdetection/pull/89."""
    return put(root, "images/f1.jpg", **{"annotations.json": coco("a1b2", "deer")})


def keypoints(root: Path) -> Path:
    """Only the box of a pose can be read: github.com/ultralytics/JSON2YOLO/issues/34."""
    return put(root, "images/f1.jpg", **{"annotations/person_keypoints_train.json": coco(keypoints=[5, 7, 2])})


def turned_voc(root: Path) -> Path:
    """CVAT's VOC holds the angle as an attribute: github.com/cvat-ai/cvat/issues/5881."""
    angle = "<attributes><attribute><name>rotation</name><value>90.0</value></attribute></attributes>"
    return put(root, "JPEGImages/f1.jpg", **{"Annotations/f1.xml": voc("f1.jpg", angle)})


def valid_obb(root: Path) -> Path:
    """DOTA's lines in Roboflow's folders, `valid` for val: github.com/hukaixuan19970627/yolov5_obb/issues/518."""
    text = "4 6 14 6 14 18 4 18 deer 0\n"
    labels = {f"{split}/labelTxt/f{split}.txt": text for split in ("train", "valid")}
    return put(root, "train/images/ftrain.jpg", "valid/images/fvalid.jpg", **labels)


def yolo_pixels(root: Path) -> Path:
    """Corners in pixels instead of shares: github.com/ultralytics/yolov5/issues/443."""
    labels = {"labels/f1.txt": "0 0 0 14 0 14 18 0 18\n", "labels/f2.txt": "0 0.5 0.5 0.2 0.2\n"}
    return put(root, "images/f1.jpg", "images/f2.jpg", **labels, **{"data.yaml": "train: images\nnames: [deer]\n"})


def tracks_of_visdrone(root: Path) -> Path:
    """A table named like the folder of its frames, with tracks: github.com/VisDrone/VisDrone-Dataset/issues/22."""
    frames = [f"sequences/uav0000013_00000_v/000000{k}.jpg" for k in (1, 2)]
    text = "".join(f"1,{k},5,6,12,8,1,4,0,0\n" for k in range(9))
    return put(root, *frames, **{"annotations/uav0000013_00000_v.txt": text})


READ = (ids_of_text, keypoints, turned_voc, valid_obb, yolo_pixels, tracks_of_visdrone)


def objects(root: Path) -> list[tuple[str, list[float]]]:
    dataset = api.read_dataset(root)
    assert [p for p in dataset.problems if p.severity == "error"] == []
    return [(i.split, o.box_xyxy.tolist()) for i in dataset.images for o in i.instances]


def test_coco_with_ids_of_text(tmp_path: Path) -> None:
    root = ids_of_text(tmp_path / "data")
    assert objects(root) == [("train", [4, 6, 14, 18])]
    assert run("convert", root, tmp_path / "out", "--to", "coco").exit_code == 0
    assert objects(tmp_path / "out") == objects(root)
    (root / "annotations.json").write_text(json.dumps(coco("a1b2", "deer") | {"categories": CATEGORIES}))
    (problem,) = api.check(root, decode=False).errors
    assert problem.code == "category-unknown" and "'deer'" in problem.found


def test_keypoints_of_coco_are_counted(tmp_path: Path) -> None:
    root = keypoints(tmp_path / "data")
    assert objects(root) == [("train", [4, 6, 14, 18])]
    (problem,) = [p for p in api.check(root, decode=False).warnings if p.code == "kind-unread"]
    assert "1 keypoints" in problem.found
    assert "1 keypoints" in run("convert", root, tmp_path / "out", "--to", "yolo").output


def test_turned_boxes_of_cvats_voc(tmp_path: Path) -> None:
    root = turned_voc(tmp_path / "data")
    ((_, box),) = objects(root)
    assert box == pytest.approx([29, 15, 39, 35])
    (image,) = api.read_dataset(root).images
    assert image.instances[0].corners_xy is not None


def test_oriented_boxes_in_a_folder_called_valid(tmp_path: Path) -> None:
    assert objects(valid_obb(tmp_path / "data")) == [("train", [4, 6, 14, 18]), ("val", [4, 6, 14, 18])]


def test_yolo_labels_in_pixels_are_no_boxes_of_the_whole_picture(tmp_path: Path) -> None:
    root = yolo_pixels(tmp_path / "data")
    report = api.check(root, decode=False)
    assert report.objects == 1 and [p.where for p in report.errors] == ["labels/f1.txt: line 1"]
    for command, more in (("check", ()), ("convert", (tmp_path / "out", "--to", "coco"))):
        done = run(command, root, *more)
        assert done.exit_code == 1 and "Divide pixels by its width and height" in " ".join(done.output.split())


def test_videos_of_visdrone(tmp_path: Path) -> None:
    dataset = api.read_dataset(tracks_of_visdrone(tmp_path / "data"))
    first, second = dataset.images
    assert [o.track_id for o in first.instances] == list(range(9)) and second.instances == ()
    assert dataset.problems == () and first.extra == {"modality": "visible"}


LONG = 2**60 + 1


@pytest.mark.parametrize("one, other", [(LONG, LONG + 1), ("1e5", "100000"), ("007", "7"), (str(LONG), LONG + 1)])
def test_ids_of_coco_are_exact(tmp_path: Path, one: Any, other: Any) -> None:
    """Whole numbers of any size or texts: github.com/cocodataset/cocoapi/pull/595."""
    both = [coco(one, id=one), coco(other, id=other, bbox=[20, 6, 10, 12])]
    both[1]["images"][0]["file_name"] = "f2.jpg"
    top = {k: [*both[0][k], *both[1][k]] for k in ("images", "annotations")} | {"categories": CATEGORIES}
    root = put(tmp_path / "data", "images/f1.jpg", "images/f2.jpg", **{"annotations.json": top})
    boxes = [("train", [4, 6, 14, 18]), ("train", [20, 6, 30, 18])]
    assert objects(root) == boxes
    for to, options in (("coco", {}), ("hit-uav", {}), ("monet", {"empty": "keep"})):
        assert run("convert", root, tmp_path / to, "--to", to, "--ids", "source").exit_code == 0
        images = api.read_dataset(tmp_path / to, api.Reading(options=options)).images
        assert [str(i.source_id) for i in images] == [str(one), str(other)]
        assert [o.box_xyxy.tolist() for i in images for o in i.instances] == [box for _, box in boxes]


def test_ids_that_are_rounded_are_refused(tmp_path: Path) -> None:
    root = put(tmp_path / "data", "images/f1.jpg", "images/f2.jpg", **{"annotations.json": coco(2.0**60)})
    assert {"image-malformed", "annotation-malformed"} <= set(api.check(root, decode=False).by_code())
    (root / "annotations.json").write_text(json.dumps(coco(1.0)))
    assert objects(root) == [("train", [4, 6, 14, 18])]


def test_a_sequence_may_be_a_number(tmp_path: Path) -> None:
    top = coco()
    top["images"][0] |= {"sequence": 12}
    (image,) = api.read_dataset(put(tmp_path, "images/f1.jpg", **{"annotations.json": top})).images
    assert image.capture.sequence == "12"


@pytest.mark.parametrize("encoding", ["GB2312", "gbk", "GB18030", "Big5", "Shift_JIS", "euc-kr"])
def test_voc_in_an_encoding_of_several_bytes(tmp_path: Path, encoding: str) -> None:
    name = {"Big5": "鹿", "Shift_JIS": "シカ", "euc-kr": "사슴"}.get(encoding, "鹿")
    text = f'<?xml version="1.0" encoding="{encoding}"?>' + voc("f1.jpg", "").replace("deer", name)
    root = put(tmp_path, "JPEGImages/f1.jpg", **{"Annotations/f1.xml": text.encode(encoding)})
    assert objects(root) == [("train", [24, 20, 44, 30])]
    assert [c.name for c in api.read_dataset(root).categories] == [name]
    picture(root / "JPEGImages" / "f2.jpg", 2)
    (root / "Annotations" / "f2.xml").write_bytes(text.encode(encoding).replace(name.encode(encoding), b"\x81"))
    done = run("check", root, "--no-decode")
    assert done.exit_code == 1 and "iconv" in done.output


@pytest.mark.parametrize(
    ("declared", "name", "start"),
    [
        ("GB2312", "人员", b""),
        ("Shift_JIS", "車両", b""),
        ("ISO-8859-1", "vélo", b""),
        ("GB2312", "人", b"\xef\xbb\xbf"),
    ],
)
def test_voc_in_utf8_that_declares_something_else(tmp_path: Path, declared: str, name: str, start: bytes) -> None:
    text = f'<?xml version="1.0" encoding="{declared}"?>' + voc("f1.jpg", "").replace("deer", name)
    root = put(tmp_path, "JPEGImages/f1.jpg", **{"Annotations/f1.xml": start + text.encode()})
    assert [c.name for c in api.read_dataset(root).categories] == [name]


def labelme(size_wh: tuple[int, int], points: list[list[float]]) -> dict[str, object]:
    shape = {"label": "deer", "shape_type": "rectangle", "points": points}
    return {"imagePath": "f1.jpg", "imageWidth": size_wh[0], "imageHeight": size_wh[1], "shapes": [shape]}


def of_size(kind: str, root: Path, size_wh: tuple[int, int], box: list[float]) -> Path:
    """Write labels of a box, as x, y, width and height, which say that a picture of 64 x 48 px has some size."""
    w, h = size_wh
    x, y, bw, bh = box
    edges = dict(zip(("xmin", "ymin", "xmax", "ymax"), (x, y, x + bw, y + bh), strict=True))
    if kind == "coco":
        top = coco(bbox=box)
        top["images"][0] |= {"width": w, "height": h}
        return put(root, "images/f1.jpg", **{"annotations.json": top})
    if kind == "labelme":
        points = [[edges["xmin"], edges["ymin"]], [edges["xmax"], edges["ymax"]]]
        return put(root, "f1.jpg", **{"f1.json": labelme(size_wh, points)})
    if kind == "dota":
        x0, y0, x1, y1 = edges.values()
        return put(root, "images/f1.jpg", **{"labelTxt/f1.txt": f"{x0} {y0} {x1} {y0} {x1} {y1} {x0} {y1} deer 0\n"})
    size = f"<size><width>{w}</width><height>{h}</height></size>"
    box_ = "".join(f"<{k}>{v}</{k}>" for k, v in edges.items())
    text = f"<annotation>{size}<object><name>deer</name><bndbox>{box_}</bndbox></object></annotation>"
    return put(root, "JPEGImages/f1.jpg", **{"Annotations/f1.xml": text})


@pytest.mark.parametrize("kind", ["coco", "voc", "labelme"])
@pytest.mark.parametrize("turned", [False, True])
def test_sizes_in_labels_are_compared_with_the_pictures(tmp_path: Path, kind: str, turned: bool) -> None:
    """Boxes would be divided by the wrong size: github.com/DLR-RM/BlenderProc/issues/93."""
    root = of_size(kind, tmp_path / "data", (48, 64), [4, 6, 10, 12])
    (path,) = root.rglob("f1.jpg")
    exif = Image.Exif()
    exif[0x0112] = 6 if turned else 1
    Image.open(path).save(path, exif=exif)
    calls: list[tuple[object, ...]] = [
        ("check", root, "--no-decode"), ("check", root), ("inspect", root),
        ("convert", root, tmp_path / "out", "--to", "yolo"),
        ("generate", "hit-uav-drone", "--data", root, "--out", tmp_path / "run", "--plan"),
    ]  # fmt: skip
    for command in calls:
        done = run(*command)
        said = " ".join(done.output.split())
        assert said.count("64x48 px") == 1 and "48x64 px as annotated" in said, (command, said)
        assert ("turned by its EXIF" in said) == turned and ("swapped" in said) == (not turned)
        assert (done.exit_code == 0) == (command[0] == "inspect")


@pytest.mark.parametrize("turn", [1, 3, 6])
def test_jpeg_turned_by_exif_is_said_once_without_a_size_in_the_labels(tmp_path: Path, turn: int) -> None:
    root = put(tmp_path, "images/f1.jpg", **{"labels/f1.txt": "0 0.5 0.5 0.2 0.2\n"})
    exif = Image.Exif()
    exif[0x0112] = turn
    Image.open(root / "images/f1.jpg").save(root / "images/f1.jpg", exif=exif)
    assert [p.code for p in api.read_dataset(root).problems].count("image-exif-turned") == (turn != 1)


SHARES = {"edges": [0.125, 0.25, 0.5, 0.125], "centre": [0.95, 0.9, 0.2, 0.3], "beyond": [0.9, 0.95, 0.15, 0.1]}


@pytest.mark.parametrize("kind", ["coco", "voc", "labelme", "dota"])
@pytest.mark.parametrize("order", SHARES)
def test_boxes_in_shares_are_not_taken_for_pixels(tmp_path: Path, kind: str, order: str) -> None:
    """As github.com/swatig007/automlForImages/pull/27 writes them; one box at the corner may be what it is."""
    root = of_size(kind, tmp_path / "data", (64, 48), SHARES[order])
    for command, more in (("check", ()), ("convert", (tmp_path / "out", "--to", "yolo"))):
        done = run(command, root, *more)
        assert done.exit_code in (1, 2) and "shares of the picture" in " ".join(done.output.split()), command


@pytest.mark.parametrize("box, share", [([0, 0, 0.75, 1], False), ([1, 1, 1, 1], False), ([0.2, 0, 0.5, 1], True)])
def test_one_box_among_others_that_is_a_share(tmp_path: Path, box: list[float], share: bool) -> None:
    corner = of_size("voc", tmp_path / "data", (64, 48), box)
    of_size("voc", tmp_path / "other", (64, 48), [4, 6, 10, 12])
    shutil.copy(tmp_path / "other/Annotations/f1.xml", corner / "Annotations/f2.xml")
    picture(corner / "JPEGImages/f2.jpg", 2)
    dataset = api.read_dataset(corner)
    assert ("box-shares" in [p.code for p in dataset.problems]) == share
    assert [len(i.instances) for i in dataset.images] == [1] * (2 - share)


# -- bad input ----------------------------------------------------------------------------------------------------

# Files that only name classes, folders or all that annotators drew.
BESIDE = {"data.yaml", "meta.json", "index.json"}
# An empty text file of these says that its picture shows nothing, or nothing at all.
EMPTY_IS_NONE = (
    "valid_obb", "yolo_pixels", "visdrone", "02-roboflow-split-gap", "03-yolo-pose", "wider", "vedai",
    "04-central-label-files/data-27d-mot", "31-yolo-conf", "36-vedai-table", "37-nps-drones-text", "39-mot-id",
)  # fmt: skip
# Lines of seven numbers that are cut have six, and two tuples none; `check` reads no logs.
UNSEEN = {"truncated": ("31-yolo-conf-and-id", "37-nps-drones-text"), "ten times too large": ("40-litchi-log",)}
# Too large for memory or, of pictures, in pixels; JSON may have any size, but is read in other ways beyond this one.
TEN_TIMES = {".json": 2 * WHOLE_JSON, ".jpg": 0, ".tif": 0, ".tiff": 0, ".webp": 0}
BAD = {kind.__name__: kind for kind in (*NAMED, *READ)} | {n: SAMPLES[n] for n in ("visdrone", "labelme", "coco:flir")}
bad = pytest.mark.parametrize("how", ["truncated", "empty", "ten times too large"])


def file_to_damage(root: Path) -> Path:
    """Return a file with labels, else with a picture."""
    files = sorted(p for p in root.rglob("*") if p.is_file() and p.name not in BESIDE and p.suffix != ".names")
    return next((p for p in files if p.suffix.lower() not in (".jpg", ".png", ".tiff", ".ini")), files[0])


def damage(path: Path, how: str) -> None:
    if how == "truncated":
        data = path.read_bytes()
        cut = len(data) // 2
        cut -= 12 * data[:cut].endswith(b"\n")  # between two lines there is nothing to notice
        path.write_bytes(data[:cut])
    elif how == "empty":
        path.write_bytes(b"")
    elif size := TEN_TIMES.get(path.suffix.lower(), 10 * MAX_TEXT_BYTES):
        os.truncate(path, size)  # sparse: it costs no disk
    else:
        Image.new("1", (20_000, 10_000)).save(path, "PNG")


def check_damaged(root: Path, name: str, how: str) -> None:
    """Damage a file of a dataset, and assert that `check` names it and reads the others."""
    before = api.check(root, decode=False)
    damaged = file_to_damage(root)
    damage(damaged, how)
    done = run("check", root, *(() if damaged.suffix in (".jpg", ".tif", ".tiff", ".webp") else ("--no-decode",)))
    output = " ".join(done.output.split())
    assert done.exception is None or isinstance(done.exception, SystemExit), (name, output)
    if how == "empty" and name.startswith(EMPTY_IS_NONE):
        named = "label-empty" in output
        assert named or 0 < api.check(root, decode=False).objects <= before.objects or not before.objects
        return
    place = damaged.relative_to(root)
    assert done.exit_code and (place.name in output or f"{place.parts[0]} (" in output), (name, output)


@bad
@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_named_and_the_rest_is_read(tmp_path: Path, name: str, how: str) -> None:
    check_damaged(BAD[name](tmp_path / "data"), name, how)


@pytest.mark.realdata
def test_the_shared_kinds_are_as_their_scripts_expect(tmp_path: Path, real_data: Path) -> None:
    scripts = sorted((real_data / "foreign").glob("*/expect.sh"))
    if not scripts:
        pytest.skip("NEEDS REAL DATA: no folder foreign")
    environment = {**os.environ, "IB": f"{sys.executable} -m infrablend"}
    for script in scripts:
        folder = shutil.copytree(script.parent, tmp_path / script.parent.name)
        done = subprocess.run(["bash", "expect.sh"], cwd=folder, env=environment, capture_output=True, check=False)
        assert done.returncode == 0, (script.parent.name, done)


@bad
@pytest.mark.realdata
def test_bad_input_of_the_shared_kinds_is_named(tmp_path: Path, real_data: Path, how: str) -> None:
    folders = sorted((real_data / "foreign").glob("*/data*"))
    if not folders:
        pytest.skip("NEEDS REAL DATA: no folder foreign")
    for n, folder in enumerate(folders):
        name = f"{folder.parent.name}/{folder.name}"
        if not name.startswith(UNSEEN.get(how, ())):
            check_damaged(shutil.copytree(folder, tmp_path / str(n)), name, how)
