"""One rule for every format: a file that tells of a dataset's pictures and was not read is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.command_line import run
from tests.samples import SAMPLES, picture

from infrablend import api
from infrablend.errors import DatasetError, UnknownFormatError

pytestmark = pytest.mark.thinned


def via(name: str) -> str:
    box = {"shape_attributes": {"name": "rect", "x": 1, "y": 2, "width": 4, "height": 3}}
    return json.dumps({f"{name}123": {"filename": name, "size": 123, "regions": [box]}}, indent=1)


def label_studio_min(name: str) -> str:
    return json.dumps([{"image": f"/data/upload/1/{name}", "label": [{"x": 1, "rectanglelabels": ["car"]}]}], indent=1)


UNKNOWN: dict[str, Callable[[str], str]] = {
    "via_region_data.json": via,
    "export.json": label_studio_min,
    "_annotations.csv": lambda name: f"filename,class,xmin,ymin,xmax,ymax\n{name},car,1,2,5,5\n",
    "labels.tsv": lambda name: f"images\\\\{name}\tcar\t1\t2\t5\t5\n",
    "boxes.xml": lambda name: f"<dataset><image file='{name}'><box top='1' left='2'/></image></dataset>",
    "retinanet.txt": lambda name: f"/mnt/data/{name},1,2,5,5,car\n",
    "train.yaml": lambda name: f"- boxes:\n  - {{label: Green, x_max: 5, x_min: 1}}\n  path: ./rgb/{name}\n",
    "gt/gt.txt": lambda name: "1,1,794.27,247.59,71.245,174.88,-1,-1,-1,-1\n",
}
HARMLESS: dict[str, Callable[[str], str]] = {
    "README.txt": lambda name: f"Pictures such as {name}, 640 px wide.\n",
    "LICENSE-notes.txt": lambda name: f"{name}: CC BY 4.0\n",
    "all.txt": lambda name: f"./images/train/{name}\n",
    "names_of_classes.txt": lambda name: "car\nperson\n",
    "settings.json": lambda name: '{"threshold": 0.5}',
    "hyp.yaml": lambda name: "lr0: 0.01\nbox: 7.5\nclasses: [1]\n",
    "recipe.yaml": lambda name: f"objects:\n- model: deer\ncamera: {{}}\nframes: {{{name}: [{{at: 1}}]}}\n",
}
# Packed shards are read in parts; nothing else lies in their folder.
FORMATS = sorted(name for name in SAMPLES if name != "shards")


def put(root: Path, files: dict[str, str]) -> Path:
    """Write text files and, for empty texts of picture names, pictures."""
    for k, (name, text) in enumerate(files.items()):
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if text or path.suffix != ".jpg":
            path.write_text(text)
        else:
            picture(path, k)
    return root


def unread(root: Path) -> list[str]:
    return [p.where for p in api.check(root, decode=False).errors if p.code == "label-unread"]


def is_named(root: Path, file: str) -> bool:
    """Return whether a problem names a file; some readers themselves say that a file of their suffix is not theirs."""
    return any(file in p.where for p in api.read_dataset(root).problems)


@pytest.mark.parametrize("sample", FORMATS)
def test_unknown_label_files_are_named_in_every_format(tmp_path: Path, sample: str) -> None:
    root = SAMPLES[sample](tmp_path / "data")
    assert unread(root) == []
    dataset = api.read_dataset(root)
    name = dataset.images[0].path.name
    here = root if name in {p.name for p in root.rglob("*")} else None
    for file, text in HARMLESS.items():
        (root / file).write_text(text(name))
    assert unread(root) == []
    for file, text in UNKNOWN.items():
        (root / file).parent.mkdir(exist_ok=True)
        (root / file).write_text(text(name))
    wanted = UNKNOWN if here is not None else {"gt/gt.txt"}  # frames of videos are pictures of the cache
    assert [file for file in wanted if not is_named(root, file)] == []


@pytest.mark.parametrize("sample", FORMATS)
@pytest.mark.parametrize("split", ["train", "val", "test"])
def test_labels_of_other_splits_are_not_unread(tmp_path: Path, sample: str, split: str) -> None:
    root = SAMPLES[sample](tmp_path / "data")
    try:
        dataset = api.read_dataset(root, reading=api.Reading(splits=[split]))
    except DatasetError:
        return  # no picture in it
    assert [p.where for p in dataset.problems if p.code == "label-unread"] == []


@pytest.mark.parametrize("file", UNKNOWN)
def test_a_central_file_beside_pictures_is_no_clean_dataset(tmp_path: Path, file: str) -> None:
    root = SAMPLES["folder"](tmp_path / "data") if "folder" in SAMPLES else SAMPLES["yolo:detect"](tmp_path / "data")
    (root / file).parent.mkdir(exist_ok=True)
    (root / file).write_text(UNKNOWN[file](api.read_dataset(root).images[0].path.name))
    done = run("check", root, "--no-decode")
    assert done.exit_code == 1 and file in done.output and "label-unread" in done.output


@pytest.mark.parametrize("sample", ["folder:yolo", "yolo:detect"])
def test_a_list_among_the_labels_of_yolo_is_named(tmp_path: Path, sample: str) -> None:
    """Its reader looks at each text file there, for labels without a picture."""
    root = SAMPLES[sample](tmp_path / "data")
    label = next(p for p in root.rglob("*.txt") if p.name != "classes.txt" and p.read_text())
    (label.parent / "boxes.txt").write_text(f"{api.read_dataset(root).images[0].path.name} 1,2,5,5,0\n")
    (name,) = unread(root)
    assert name.endswith("/boxes.txt")


def test_many_files_of_one_kind_are_one_problem(tmp_path: Path) -> None:
    root = SAMPLES["coco"](tmp_path / "data")
    name = api.read_dataset(root).images[0].path.name
    (root / "more").mkdir()
    for k in range(20):
        (root / "more" / f"{k:02}.csv").write_text(UNKNOWN["_annotations.csv"](name))
    (problem,) = [p for p in api.check(root, decode=False).errors if p.code == "label-unread"]
    assert problem.where == "more/00.csv" and problem.found.startswith("20 files")


@pytest.mark.parametrize("sample", [s for s in FORMATS if s.partition(":")[0] != "folder"])
def test_a_folder_of_two_datasets_is_said_to_be_one_or_read_as_a_whole(tmp_path: Path, sample: str) -> None:
    (tmp_path / "all").mkdir()
    parts = [SAMPLES[sample](tmp_path / "all" / name) for name in ("first", "second")]
    objects = sum(api.check(p, decode=False).objects for p in parts)
    try:
        report = api.check(tmp_path / "all", decode=False)
    except UnknownFormatError:
        return
    inside = [p for p in report.errors if p.code == "dataset-inside"]
    if inside:
        assert "first" in inside[0].found and "second" in inside[0].found
    else:
        assert report.objects >= objects or report.errors


def test_a_long_line_is_searched_in_time_in_proportion_to_its_length(tmp_path: Path) -> None:
    """Searched from each of its characters, this line would take an hour."""
    root = SAMPLES["coco"](tmp_path / "data")
    name = api.read_dataset(root).images[0].path.name
    (root / "notes.txt").write_text("a" * 900_000)
    assert unread(root) == []
    (root / "notes.txt").write_text("a" * 900_000 + f" {name} 1 2 5 5 car")
    assert unread(root) == ["notes.txt"]
    (root / "notes.txt").write_text("a .jpg " * 140_000)
    assert unread(root) == []
    (root / "notes.txt").write_text("a_" * 450_000 + '"' + 450_000 * "1")
    assert unread(root) == []


@pytest.mark.parametrize("sample", FORMATS)
@pytest.mark.parametrize("name", ["labels.zip", "more/annotations.tar.gz", "a.mat", "data/train.parquet", "table.xlsx"])
def test_files_that_are_no_text_are_named_by_their_suffix(tmp_path: Path, sample: str, name: str) -> None:
    root = put(SAMPLES[sample](tmp_path / "data"), {name: "PK"})
    dataset = api.read_dataset(root)
    (problem,) = [p for p in dataset.problems if p.where == name]
    lost = ("label" in name or "annot" in name) and not any(i.instances for i in dataset.images)
    assert (problem.code, problem.severity) == ("label-unread", "error" if lost else "warning")
    assert ("unpack it" in problem.todo) == name.endswith(("zip", "gz"))


@pytest.mark.parametrize("name", ["a,b.jpg", "k=1;v:2.jpg", "x | y.jpg", "a, b c=d.jpg"])
@pytest.mark.parametrize(
    "text",
    ["{} 1,2,5,5,0", "data/{},1,2,5,5,deer", '"{}",deer,1,2,5,5', "1 2 5 5 deer {}", '[{{"f": "{}", "label": 1}}]'],
)
def test_names_may_contain_what_separates_cells(tmp_path: Path, name: str, text: str) -> None:
    file = "t.json" if text.startswith("[") else "t.txt"
    root = put(tmp_path / "data", {name: "", "z.jpg": "", file: text.format(name) + "\n"})
    assert unread(root) == [file]


@pytest.mark.parametrize("size", [999_990, 1_000_000, 3_500_000])
@pytest.mark.parametrize(("file", "line"), [("t.csv", "{},1,2,5,5,deer"), ("t.json", '{{"f": "{}", "label": 1}}')])
def test_a_name_after_the_first_megabyte_is_found(tmp_path: Path, size: int, file: str, line: str) -> None:
    row = '{"f": "other.jpg"},' if file == "t.json" else "other.jpg,1,2,5,5,deer"
    rows = "\n".join([row] * (size // (len(row) + 1)))
    text = f"{rows}\n{line.format('f1.jpg')}\n"
    root = put(tmp_path / "data", {"f1.jpg": "", file: f"[{text}]" if file == "t.json" else text})
    assert unread(root) == [file]


IR = [f"ir/{k:06}_ir.jpg" for k in range(4)]
CLIP = [f"Clip_1/images/{k:04}.jpg" for k in range(4)]
FRAMES = [f"f/frame_{k:05}.jpg" for k in range(4)]
# A file, its text, and whether it is an error, a warning, or harmless.
KEYED: dict[str, tuple[list[str], str, str, str | None]] = {
    "stem without form": (IR, "a.txt", "".join(f"{k:06} 40 40 0.1 20\n" for k in range(4)), "error"),
    "number without zeros": (IR, "labels.txt", "".join(f"{k} 40 40 0.1 20\n" for k in range(4)), "error"),
    "numbers that may be others": (IR, "a.txt", "".join(f"{k} 40 40 0.1 20\n" for k in range(4)), "warning"),
    "number under a title": (IR, "a.csv", "id,x1,y1,x2,y2,class\n1,1,2,3,4,car\n", "error"),
    "number after a word": (FRAMES, "a.json", '{"2": [[1, 2, 3, 4]]}', "error"),
    "number of a frame": (FRAMES, "a.json", '[{"frame": 2, "bbox": [1, 2, 3, 4]}]', "error"),
    "results without numbers of pictures": (FRAMES, "a.jsonl", '{"image_id": 77, "bbox": [1, 2, 3, 4]}\n', "error"),
    "tuple of a clip": (CLIP, "Clip_1_gt.txt", "time_layer: 0 detections: (30, 20, 50, 60)\n", "error"),
    "numbers of a clip": (CLIP, "a/Clip_1-boxes.txt", "frame 0: 30 20 50 60\n", "error"),
    "lists of a clip": (CLIP, "a/Clip_1.txt", "0 : [30.5, 20, 50, 60]\n", "error"),
    "records of a clip": (CLIP, "a/Clip_1.json", '{"frames": [{"id": 0, "boxes": []}]}', "error"),
    "any numbers of a clip": (CLIP, "Clip_1_b.txt", "0.1 0.2 0.3 0.4\n", "warning"),
    "pairs of a clip": (CLIP, "a/Clip_1.txt", "t: 0 ((30, 20), (50, 60))\n", "error"),
    "no object in the first frame of a clip": (CLIP, "a/Clip_1.txt", "NaN,NaN,NaN,NaN\n1,2,3,4\n", "error"),
    "values of a clip": (CLIP, "a/Clip_1.txt", "frame=0 x=1 y=2 w=3 h=4\n", "warning"),
    "tuple of a clip with a word": (CLIP, "Clip_1_a.txt", "0 boxes [30 20 50 60]\n", "error"),
    "tuple of a clip without a word": (CLIP, "Clip_1_extent.txt", "bounds (47.1, 9.1, 47.2, 9.2)\n", "warning"),
    "tuple without a picture": (FRAMES, "boxes.txt", "frame 2: [1, 2, 3, 4]\n", "warning"),
    "numbers with points": (IR, "labels.txt", "".join(f"{k}.0 40 40 0.1 20\n" for k in range(4)), "error"),
    "motion of a clip": (CLIP, "Clip_1_imu.txt", "0.1 0.2 0.3 0.4\n", None),
    "places of a clip": (CLIP, "Clip_1_gps.txt", "(47.1, 9.1, 80, 0)\n", None),
    "notes on boxes": (CLIP, "Clip_1_boxcount.txt", "boxes per frame: 1 2 3 4 5\n", None),
    "log of labels": (CLIP, "Clip_1_labelling_log.txt", "10:00:00 annotator 1 saved 12 34 56 78\n", None),
    "training": (FRAMES, "train_log.txt", "1 0.5 0.4 0.3 0.2\n2 0.5 0.4 0.3 0.2\n", None),
    "losses of boxes": (FRAMES, "metrics.csv", "epoch,boxes,box_loss,lr,mAP\n1,33,0.5,0.4,0.3\n", None),
    "classes": (FRAMES, "stats.csv", "class_id,images,instances,P,R,mAP50\n1,3,3,0.9,0.8,0.7\n", None),
    "times of frames": (FRAMES, "timestamps.csv", "frame,ns,x,y,z,width\n1,12345,1,2,3,4\n", None),
    "sizes on the ground": (FRAMES, "gsd.csv", "image,gsd_x,gsd_y,w,h\n1,0.05,0.05,640,512\n", None),
    "sides under titles": (FRAMES, "a.csv", "class,frame,xtl,ytl,xbr,ybr\n7,1,1,2,3,4\n", "error"),
    "corners under titles": (
        FRAMES,
        "a.csv",
        "id,top_left_x,top_left_y,bottom_right_x,bottom_right_y,class\n1,1,2,3,4,car\n",
        "error",
    ),
    "box under one title": (FRAMES, "a.csv", 'image_id,bbox\n1,"[1, 2, 3, 4]"\n', "error"),
    "form of a picture": (["f1_ir.jpg"], "f1.txt", "0 0.5 0.5 0.2 0.2\n", "error"),
    "word after a picture": (["f1.jpg"], "f1_anno.txt", "1,2,3,4\n", "error"),
    "word before a picture": (["f1.jpg"], "res_f1.txt", "1,2,3,4\n", "error"),
    "results in a record": (FRAMES, "a.json", '{"dets": [{"m": {}, "image_id": 77, "bbox": [1, 2, 3, 4]}]}', "error"),
    "results of joints": (FRAMES, "a.json", '[{"image_id": 77, "category_id": 1, "keypoints": [1, 2, 2]}]', "error"),
    "boxes of other pictures": (FRAMES, "a.json", '{"images": [], "boxes": [{"image_id": 9, "bbox": []}]}', None),
    **{
        f"suffix {suffix!r}": (["f1.jpg"], f"boxes{suffix}", '"f1.jpg": (1, 2, 3, 4);\n', "error")
        for suffix in ("", ".lst", ".dat", ".ann", ".gt", ".idl", ".lbl", ".bbox")
    },
    "log of boxes": (["f1.jpg"], "boxes.log", "f1.jpg 1 2 3 4\n", "warning"),
    "log of pictures": (["f1.jpg"], "predict.log", "image 1/1 f1.jpg: 512x640 3 persons, 10.2ms\n", None),
    "list of pictures": (["f1.jpg"], "train.lst", "images/f1.jpg\n", None),
    "licence": (["f1.jpg"], "LICENSE", "f1.jpg 1 2 3 4\n", None),
    "rules": (["f1.jpg"], "Makefile", "all: f1.jpg\n", None),
    "no text": (["f1.jpg"], "flight.dat", "\0f1.jpg 1 2 3 4\n", None),
    "label of one picture": (["f1.jpg"], "labels/f1", "0 0.5 0.5 0.2 0.2\n", "error"),
    "points of one picture": (["f1.jpg"], "f1.pts", "version: 1\n{\n10 20\n}\n", "warning"),
    "viper": (CLIP, "a/Clip_1.xgtf", "<viper><object name='P'/></viper>", "error"),
    "array of one picture": (["f1.jpg"], "f1.npy", "\x93", "warning"),
    "array of labels": (["f1.jpg"], "labels.npz", "PK", "error"),
    "array": (["f1.jpg"], "mean.npy", "\x93", None),
    "log": (CLIP, "Clip_1_log.txt", "2023-01-01 10:00:00.123 start 1 2 3 4\n", None),
    "telemetry": (IR, "telemetry.csv", "frame,lat,lon,alt,yaw\n0,59.1,12.2,100,5\n1,59.1,12.2,100,5\n", None),
    "epochs": (IR, "results.csv", "epoch,loss,a,b,c\n1,0.5,0.4,0.3,0.2\n2,0.5,0.4,0.3,0.2\n", None),
    "matrix": (IR, "calib.txt", "1 0 0 0\n0 1 0 0\n0 0 1 0\n", None),
    "camera": (IR, "camera.json", '{"intrinsics": [500, 500, 320, 256]}', None),
}


@pytest.mark.parametrize("kind", KEYED)
def test_a_file_is_one_of_labels_if_its_keys_are_those_of_pictures(tmp_path: Path, kind: str) -> None:
    pictures, file, text, severity = KEYED[kind]
    root = put(tmp_path / "data", {**dict.fromkeys(pictures, ""), file: text})
    found = [(p.where, p.severity) for p in api.read_dataset(root).problems if p.code == "label-unread"]
    assert found == ([(file, severity)] if severity else [])


# -- pictures ------------------------------------------------------------------------------------------------------


def unlisted(root: Path, **reading: Any) -> list[str]:
    problems = api.read_dataset(root, reading=api.Reading(**reading)).problems
    found = [p for p in problems if p.code == "image-unlisted"]
    assert {p.severity for p in found} <= {"warning"} and all(p.todo and p.expected for p in found)
    return [p.where for p in found]


def test_samples_have_no_unread_pictures(tmp_path: Path) -> None:
    for sample in FORMATS:
        root = SAMPLES[sample](tmp_path / sample.replace(":", "-"))
        assert (sample, unlisted(root)) == (sample, [])


@pytest.mark.parametrize("sample", [s for s in FORMATS if s.partition(":")[0] != "folder"])
def test_pictures_of_a_part_that_is_not_read_are_named_in_every_format(tmp_path: Path, sample: str) -> None:
    root = SAMPLES[sample](tmp_path / "data")
    before = len(api.read_dataset(root).images)
    for k in range(12):
        picture(root / "more" / "images" / f"x{k}.jpg", 30 + k)
    now = api.read_dataset(root)
    if any(p.code == "video-not-pictures" for p in now.problems):  # videos beside pictures: those are read, these named
        return
    taken = len(now.images) - before
    assert taken == 12 or unlisted(root) == ["more/images"], taken


@pytest.mark.parametrize("sample", [s for s in FORMATS if s.partition(":")[0] != "folder"])
@pytest.mark.parametrize(
    "place", ["rgb/{}", "visible/{}", "masks/{}", "depth/{}", "all/{}", "docs/x{}", "previews/x{}"]
)
def test_other_forms_of_the_same_pictures_and_pictures_for_people_are_not_named(
    tmp_path: Path, sample: str, place: str
) -> None:
    root = SAMPLES[sample](tmp_path / "data")
    images = api.read_dataset(root).images
    for k, image in enumerate(images):
        picture(root / place.format(image.path.name), 30 + k)
    picture(root / "readme.png", 50)
    try:
        assert unlisted(root) == []
    except DatasetError:
        assert sample.startswith(("masks", "wisard"))


def coco_of(*names: str) -> str:
    images = [{"id": k, "file_name": name, "width": 64, "height": 48} for k, name in enumerate(names)]
    box = {"id": 1, "image_id": 0, "category_id": 1, "bbox": [8, 6, 16, 12]}
    return json.dumps({"images": images, "annotations": [box], "categories": [{"id": 1, "name": "deer"}]})


ROW, YAML = "0 0.5 0.5 0.2 0.2\n", "train: images/train\nval: images/val\nnames: [deer]\n"
YOLO = {"data.yaml": YAML, "labels/train/1.txt": ROW, "images/train/1.jpg": "", "images/val/1.jpg": ""}
CVAT = (
    "<annotations><version>1.1</version><image id='0' name='a.jpg' width='64' height='48'>"
    "<box label='deer' xtl='8' ytl='6' xbr='24' ybr='18'/></image></annotations>"
)
NESTED = {f"second/{name}": text for name, text in YOLO.items() if name != "images/val/1.jpg"} | {
    "second/images/train/7.jpg": ""
}
PARTS: dict[str, tuple[dict[str, str], list[str]]] = {
    "coco": ({"images/a.jpg": "", "images/b.jpg": "", "images/c.jpg": "", "coco.json": coco_of("a.jpg")}, ["images"]),
    "coco-second-file": (
        {"train.json": coco_of("a.jpg"), "images/a.jpg": "", "b/c/d/e/val.json": coco_of("x.jpg"), "b/c/x.jpg": ""},
        ["b/c"],
    ),
    "yolo-test": ({**YOLO, "images/test/1.jpg": "", "labels/test/1.txt": ROW}, ["images/test"]),
    "same-names": (
        {**YOLO, **{f"second/{n}": t for n, t in YOLO.items()}, **{f"rgb/{n}": t for n, t in YOLO.items()}},
        ["second/images/train", "second/images/val"],
    ),
    "yolo-nested": (YOLO | NESTED, ["second/images/train"]),
    "cvat-nested": ({"annotations.xml": CVAT, "images/a.jpg": "", **NESTED}, ["second/images/train"]),
    "cvat": ({"annotations.xml": CVAT, "images/a.jpg": "", "images/b.jpg": ""}, ["images"]),
    "twins": (
        {
            "coco.json": coco_of("ir/DJI_1_T.jpg"),
            "ir/DJI_1_T.jpg": "",
            "zoom/DJI_1_Z.jpg": "",
            "ir/1.jpg": "",
            "ir/DJI_20260101120001_2_W.jpg": "",
        },
        ["ir"],
    ),
    "many": (YOLO | {f"part{k}/x{k}.jpg": "" for k in range(9)}, ["data"]),
}


def test_pictures_of_other_kinds_are_read_or_named(tmp_path: Path) -> None:
    files = {
        f"images/train/{n}": "" for n in ("a.jpg", "b.webp", "c.jfif", "d.jpe", "e.jp2", "f.heic", "g.PGM", "a.dng")
    }
    labels = {f"labels/train/{stem}.txt": ROW for stem in "abcde"}
    root = put(tmp_path / "data", {"data.yaml": "train: images/train\nnames: [deer]\n", **labels})
    for k, name in enumerate(files):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        picture(root / "x.jpg", k).rename(root / name) if name[-3:] != "ebp" else picture(root / name, k)
    done = run("check", root)
    assert "4 images (1 .jfif, 1 .jpe, 1 .jpg, 1 .webp), 4 objects" in done.output
    (problem,) = [p for p in api.read_dataset(root).problems if p.code == "image-kind"]
    assert "3 picture(s) of kinds that are not read (1 .heic, 1 .jp2, 1 .pgm)" in problem.found


@pytest.mark.parametrize("kind", PARTS)
def test_pictures_without_a_record_are_one_warning_per_folder(tmp_path: Path, kind: str) -> None:
    files, places = PARTS[kind]
    root = put(tmp_path / "data", files)
    assert unlisted(root) == places
    for words in (["check", root], ["inspect", root], ["convert", root, tmp_path / "out", "--to", "coco"]):
        assert "in no record of the dataset" in run(*words).output, words
    assert set(unlisted(root, splits=["val"] if "yolo" in kind else ["train"])) <= set(places)


def test_generate_names_pictures_without_a_record(tmp_path: Path) -> None:
    root = put(tmp_path / "data", PARTS["coco"][0])
    pitch = ("--set", "camera.pitch={fixed_deg: 60}")
    done = run("generate", "hit-uav-drone", "--data", root, "--out", tmp_path / "run", *pitch)
    assert "2 picture(s) in no record of the dataset" in done.output


@pytest.mark.parametrize(
    ("sample", "options"),
    [
        ("voc", {"unlabelled": "drop"}),
        *(("drone-vehicle", {"modality": m}) for m in ("ir", "rgb", "both")),
        ("wit-uas", {"camera": "flir"}),
        ("wisard", {"modality": "all"}),
        ("anti-uav", {"every": "2"}),
        ("bambi:tracks", {"frames": "all"}),
        ("hit-uav:json", {"form": "normal_json"}),
        ("hit-uav:xml", {"form": "rotate_xml"}),
    ],
)
def test_pictures_that_options_leave_out_are_not_named(tmp_path: Path, sample: str, options: dict[str, str]) -> None:
    root = SAMPLES[sample](tmp_path / "data")
    if "unlabelled" in options:
        picture(next(root.rglob("*.jpg")).with_name("x.jpg"), 9)
    assert unlisted(root, options=options) == unlisted(root) == []


# -- videos and classes --------------------------------------------------------------------------------------------


def test_a_video_beside_pictures_is_named_with_the_command_that_reads_it(tmp_path: Path) -> None:
    root = put(tmp_path / "data", YOLO | {"clip.mp4": "no video"})
    (problem,) = [p for p in api.read_dataset(root).problems if p.code == "video-not-pictures"]
    assert problem.severity == "warning"
    assert f"infrablend frames {root / 'clip.mp4'} --out data_frames" in problem.todo
    put(root, {"clip_000001.jpg": "", "images/train/clip_000001.jpg": ""})  # its frames are there
    assert "video-not-pictures" not in [p.code for p in api.read_dataset(root).problems]


@pytest.mark.parametrize(
    ("names", "named"),
    [
        (["train/deer/a.jpg", "train/boar/b.jpg", "val/deer/c.jpg"], True),
        (["images/train/deer/a.jpg", "images/train/boar/b.jpg"], True),
        (["train/flight1/a.jpg", "train/flight2/b.jpg"], False),
        (["train/images/a.jpg", "val/images/b.jpg"], False),
        (["train/day/a.jpg", "train/night/b.jpg"], False),
        (["train/rgb/a.jpg", "train/thermal/b.jpg"], False),
        (["deer/a.jpg", "boar/b.jpg"], False),
        (["train/a.jpg", "train/deer/a.jpg", "train/boar/b.jpg"], False),
    ],
)
def test_folders_of_classes_are_no_labels(tmp_path: Path, names: list[str], named: bool) -> None:
    problems = api.read_dataset(put(tmp_path / "data", dict.fromkeys(names, ""))).problems
    assert [p.severity for p in problems if "boar, deer" in p.found] == ["warning"] * named
    assert len(problems) == named
