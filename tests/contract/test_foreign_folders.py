"""What other tools leave in the folder of a dataset is read, known to be irrelevant, or named with the next step."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from tests.command_line import run
from tests.samples import picture

from infrablend import api
from infrablend.errors import DatasetError

pytestmark = pytest.mark.long

LFS = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a214614ab2935c943f9e0ff69d22eadbb8f32\nsize 12345\n"
VOC = (
    "<annotation><filename>{name}.jpg</filename><size><width>64</width><height>48</height></size><object>"
    "<name>{category}</name><bndbox><xmin>8</xmin><ymin>6</ymin><xmax>24</xmax><ymax>18</ymax></bndbox></object>"
    "</annotation>"
)
COCO: dict[str, Any] = {
    "images": [{"id": k, "file_name": f"f{k}.jpg", "width": 64, "height": 48} for k in (1, 2)],
    "annotations": [{"id": k, "image_id": k, "category_id": 1, "bbox": [8, 6, 16, 12]} for k in (1, 2)],
    "categories": [{"id": 1, "name": "deer"}],
}


def put(root: Path, files: dict[str, str]) -> Path:
    """Write text files and, for empty texts of picture names, pictures."""
    for k, (name, text) in enumerate(files.items()):
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if text or path.suffix not in (".jpg", ".png"):
            path.write_text(text)
        else:
            picture(path, k)
    return root


# -- Git LFS -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "files",
    [
        {"f1.jpg": LFS},
        {"images/f1.jpg": "", "labels/f1.txt": LFS, "images/f2.jpg": "", "labels/f2.txt": "0 0.5 0.5 0.1 0.1\n"},
        {"images/train/f1.jpg": "", "labels/train/f1.txt": "0 0.5 0.5 0.1 0.1\n", "data.yaml": LFS},
        {"f1.jpg": "", "annotations/instances_train.json": LFS},
        {"f1.jpg": "", "labels_my-project.json": LFS},
        {"f1.jpg": "", "f1.xml": LFS, "f2.jpg": "", "f2.xml": VOC.format(name="f2", category="deer")},
        {"f1.jpg": "", "metadata.csv": LFS},
        {"train/f1.jpg": "", "train/metadata.jsonl": LFS},
    ],
    ids=["picture", "yolo", "data.yaml", "coco", "unknown", "voc", "table", "jsonl"],
)
def test_a_pointer_of_git_lfs_is_named_with_the_command_that_fetches_the_file(
    tmp_path: Path, files: dict[str, str]
) -> None:
    done = run("check", put(tmp_path / "data", files))
    assert done.exit_code == 1
    (pointer,) = [name for name, text in files.items() if text == LFS]
    line = next(line for line in done.output.splitlines() if "LFS" in line)
    assert pointer in line and "a pointer of Git LFS" in line and "git lfs pull" in line


def test_a_picture_whose_yolo_labels_are_a_pointer_is_no_picture_without_objects(tmp_path: Path) -> None:
    files = {"f1.jpg": "", "f1.txt": LFS, "f2.jpg": "", "f2.txt": "0 0.5 0.5 0.1 0.1\n", "classes.txt": "deer\n"}
    assert [i.name for i in api.read_dataset(put(tmp_path / "data", files)).images] == ["f2.jpg"]


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".usda", ".blend"])
def test_a_pointer_of_git_lfs_in_place_of_a_model(tmp_path: Path, suffix: str) -> None:
    (tmp_path / f"deer{suffix}").write_text(LFS)
    done = run("models", "add", tmp_path / f"deer{suffix}", "--category", "deer", "--size-m", 1)
    assert done.exit_code == 2 and "a pointer of Git LFS" in done.output and "git lfs pull" in done.output


# -- masks as pictures ---------------------------------------------------------------------------------------------

VOC_FILES = {f"Annotations/f{k}.xml": VOC.format(name=f"f{k}", category="deer") for k in (1, 2)}
MASKS = {
    "voc": {"JPEGImages/f{}.jpg": "SegmentationClass/f{}.png"},
    "kaggle": {"images/f{}.jpg": "masks/f{}.png"},
    "kaggle-splits": {"train/images/f{}.jpg": "train/masks/f{}.png"},
    "mmsegmentation": {"img_dir/train/f{}.jpg": "ann_dir/train/f{}.png"},
    "mfnet": {"images/f{}.png": "labels/f{}.png"},
    "roboflow": {"train/f{}.jpg": "train/f{}_mask.png"},
}


@pytest.mark.parametrize("kind", MASKS)
def test_masks_beside_pictures_are_no_pictures_but_unread_labels(tmp_path: Path, kind: str) -> None:
    ((name, mask),) = MASKS[kind].items()
    put(tmp_path / "data", {form.format(k): "" for k in (1, 2) for form in (name, mask)})
    dataset = api.read_dataset(tmp_path / "data")
    assert [i.path.suffix for i in dataset.images] == [Path(name).suffix] * 2
    assert {i.path.stem for i in dataset.images} == {"f1", "f2"}
    said = run("check", tmp_path / "data", "--no-decode")
    assert said.exit_code == 1 and mask.format(1) in said.output and "masks of pictures" in said.output
    for words in (["convert", tmp_path / "data", tmp_path / "out", "--to", "yolo"], ["inspect", tmp_path / "data"]):
        assert "masks of pictures" in run(*words).output


def test_masks_of_pictures_with_other_labels_are_a_warning(tmp_path: Path) -> None:
    masks = {f"Segmentation{kind}/f{k}.png": "" for kind in ("Class", "Object") for k in (1, 2)}
    root = put(tmp_path / "data", {"JPEGImages/f1.jpg": "", "JPEGImages/f2.jpg": "", **VOC_FILES, **masks})
    report = api.check(root, decode=False)
    assert (report.images, report.objects, report.errors) == (2, 2, ())
    assert {p.where for p in api.read_dataset(root).problems} == masks.keys()


def test_a_folder_called_masks_may_hold_pictures(tmp_path: Path) -> None:
    put(tmp_path / "data", {"masks/f1.jpg": "", "people/f2.jpg": ""})
    assert [i.name for i in api.read_dataset(tmp_path / "data").images] == ["masks/f1.jpg", "people/f2.jpg"]


def coco_of(*names: str) -> str:
    images = [{"id": k, "file_name": name, "width": 64, "height": 48} for k, name in enumerate(names, 1)]
    return json.dumps(COCO | {"images": images})


NO_MASKS: dict[str, dict[str, str]] = {
    "coco": {"images/a.jpg": "", "images/a_mask.jpg": "", "coco.json": coco_of("a.jpg", "a_mask.jpg")},
    "coco-folders": {"labels/a.jpg": "", "raw/a.jpg": "", "coco.json": coco_of("labels/a.jpg", "raw/a.jpg")},
    "voc": {f"{name}{end}": VOC.format(name=name, category="deer") * (end == ".xml")
            for name in ("a", "a_mask") for end in (".jpg", ".xml")},
    "yolo": {f"{kind}/train/{name}": "0 0.5 0.5 0.1 0.1\n" * (kind == "labels") for kind, name in (
        ("images", "a.jpg"), ("images", "a-mask.jpg"), ("labels", "a.txt"), ("labels", "a-mask.txt"))}
    | {"data.yaml": "train: images/train\nnames: [deer]\n"},
    "yolo-list": {"images/a.jpg": "", "images/a_mask.jpg": "", "labels/a.txt": "0 0.5 0.5 0.1 0.1\n",
                  "train.txt": "images/a.jpg\nimages/a_mask.jpg\n", "data.yaml": "train: train.txt\nnames: [deer]\n"},
    "folder": {"a.jpg": "", "a.txt": "0 0.5 0.5 0.1 0.1\n", "a_mask.jpg": "", "a_mask.txt": "0 0.5 0.5 0.1 0.1\n"},
    "imagefolder": {"a.jpg": "", "a_mask.jpg": "", "metadata.jsonl": "".join(
        json.dumps({"file_name": f"{name}.jpg", "objects": {"bbox": [[8, 6, 16, 12]], "categories": ["deer"]}}) + "\n"
        for name in ("a", "a_mask"))},
}  # fmt: skip


@pytest.mark.parametrize("kind", NO_MASKS)
def test_a_picture_with_labels_or_in_a_list_is_no_mask(tmp_path: Path, kind: str) -> None:
    report = api.check(put(tmp_path / "data", NO_MASKS[kind]), decode=False)
    assert report.images == 2 and report.objects >= 1
    assert [p for p in (*report.errors, *report.warnings) if p.code in ("label-unread", "image-missing")] == []


# -- files that name pictures --------------------------------------------------------------------------------------

YOLO = {
    "images/train/DJI_1.jpg": "", "labels/train/DJI_1.txt": "0 0.5 0.5 0.1 0.1\n",
    "data.yaml": "train: images/train\nnames: [deer]\n",
}  # fmt: skip
WITHOUT_LABELS = {
    "geo.txt": "EPSG:4326\nDJI_1.jpg -91.99 46.8 198.6 10 -90 0\n",
    "gcp_list.txt": "+proj=utm +zone=10\n544256.7 5320919.9 5 3044 2622 DJI_1.jpg\n",
    "images.txt": "# Image list\n1 0.8 0.1 0.2 0.3 1.0 2.0 3.0 1 DJI_1.jpg\n1.0 2.0 -1 3.0 4.0 -1\n",
    "transforms.json": json.dumps(
        {"w": 64, "frames": [{"file": "a/DJI_1.jpg", "transform_matrix": [[1, 0, 0, 0]] * 4}]}
    ),
    "external_camera_parameters.txt": "imageName X Y Z Omega Phi Kappa\nDJI_1.jpg 1.0 2.0 3.0 4.0 5.0 6.0\n",
    "telemetry.csv": "frame,lat,lon,alt,yaw,pitch\nDJI_1,45.1,15.2,100,3,4\n",
    "exif.json": json.dumps([{"SourceFile": "DJI_1.jpg", "GPSAltitude": 1}]),
    "timestamps.txt": "DJI_1.jpg 1700000000.123\n",
    "md5sums.txt": "d41d8cd98f00b204e9800998ecf8427e  DJI_1.jpg\n",
    "splits.csv": "image,split\nDJI_1.jpg,train\n",
    "train.csv": "DJI_1.jpg\n",
    "train_list.txt": "images/train/DJI_1.jpg labels/train/DJI_1.txt\n",
    "manifest.jsonl": json.dumps({"name": "DJI_1", "width": 64, "height": 48}) + "\n",
    "notes.txt": "DJI_1.jpg is blurred\n",
    "00_README.txt": "See DJI_1.jpg for an example\n",
    "captions.json": json.dumps({"images": [{"file_name": "DJI_1.jpg"}], "annotations": [{"caption": "a deer"}]}),
}
WITH_LABELS = {
    "license_plates.csv": "f,x,y,w,h\nDJI_1.jpg,1,2,3,4\n",
    "boxes.csv": "file,x,y,width,height\nDJI_1,1,2,3,4\n",
    "classes.csv": "file,label\nDJI_1.jpg,deer\n",
    "yolov3.txt": "data/DJI_1.jpg 1,2,3,4,0 5,6,7,8,1\n",
    "last.txt": "1 2 3 4 deer DJI_1.jpg\n",
    "small.csv": "DJI_1,.5,.5,.1,.1\n",
    "keys.json": '{"DJI_1.jpg": [[1, 2, 3, 4]]}',
    "more/polygons.json": '[{"file": "DJI_\\u0031.jpg", "polygon": []}]',
}


@pytest.mark.parametrize("name", [*WITHOUT_LABELS, *WITH_LABELS])
def test_a_file_that_names_pictures_is_an_error_if_it_shows_labels(tmp_path: Path, name: str) -> None:
    root = put(tmp_path / "data", {**YOLO, name: (WITHOUT_LABELS | WITH_LABELS)[name]})
    (problem,) = [p for p in api.read_dataset(root).problems if p.code == "label-unread"]
    assert (problem.where, problem.severity) == (name, "error" if name in WITH_LABELS else "warning")
    if name in WITHOUT_LABELS:
        assert "names pictures, and is not read" in problem.found and "if it holds labels, convert it" in problem.todo
    assert run("check", root, "--no-decode").exit_code == (name in WITH_LABELS)


@pytest.mark.parametrize("table", ["image_id,class,x,y,w,h\n000001,deer,5,5,9,9\n", "frame,id,x,y,w,h\n1,7,5,5,9,9\n"])
def test_numbers_name_pictures_in_a_table_of_boxes(tmp_path: Path, table: str) -> None:
    root = put(
        tmp_path / "data", {"000001.jpg": "", "t.csv": table, "keys.json": '{"000001": [{"bbox": [1, 2, 3, 4]}]}'}
    )
    assert [p.where for p in api.check(root, decode=False).errors] == ["keys.json", "t.csv"]
    (root / "t.csv").write_text("epoch,time,box_loss,a,b\n1,5,5,9,9\n")
    assert [p.where for p in api.check(root, decode=False).errors] == ["keys.json"]


@pytest.mark.parametrize("folder", ["annotation_files/train", "labels_seg/train", "more"])
def test_a_file_of_a_picture_without_labels_is_named_wherever_it_is(tmp_path: Path, folder: str) -> None:
    files = {**YOLO, "images/train/DJI_2.jpg": "", f"{folder}/DJI_2.txt": "0 0.5 0.5 0.1 0.1\n"}
    assert [p.where for p in api.check(put(tmp_path / "d", files), decode=False).errors] == [f"{folder}/DJI_2.txt"]
    (tmp_path / "d" / folder / "DJI_2.txt").write_text("a note\n")
    assert api.check(tmp_path / "d", decode=False).errors == ()


def test_an_empty_table_beside_labels_is_a_warning(tmp_path: Path) -> None:
    (problem,) = api.read_dataset(put(tmp_path / "a", {**YOLO, "t.csv": ""})).problems
    assert (problem.where, problem.severity) == ("t.csv", "warning")
    (problem,) = api.read_dataset(put(tmp_path / "b", {"f.jpg": "", "t.csv": ""})).problems
    assert (problem.where, problem.severity) == ("t.csv", "error")


def test_companions_of_coco_are_no_error(tmp_path: Path) -> None:
    files = {
        f"annotations/{kind}_train2017.json": json.dumps(COCO) for kind in ("instances", "person_keypoints", "stuff")
    }
    root = put(tmp_path / "data", {"train2017/f1.jpg": "", "train2017/f2.jpg": "", **files})
    report = api.check(root, decode=False)
    assert (report.objects, report.errors) == (2, ()) and "image-duplicate" in {p.code for p in report.warnings}


def test_a_file_is_named_though_another_of_its_name_is(tmp_path: Path) -> None:
    missing = coco_of("f1.jpg", "gone.jpg")
    root = put(
        tmp_path / "data", {"f1.jpg": "", "train.json": missing, "via/train.json": '{"f1.jpg": {"regions": []}}'}
    )
    assert {p.where for p in api.check(root, decode=False).errors} >= {"via/train.json"}


# -- two kinds of labels -------------------------------------------------------------------------------------------


def test_yolo_labels_beside_coco_labels_are_named(tmp_path: Path) -> None:
    labels = {f"f{k}.txt": "0 0.5 0.5 0.1 0.1\n" for k in (1, 2)}
    root = put(tmp_path / "data", {"f1.jpg": "", "f2.jpg": "", **labels, "coco.json": json.dumps(COCO)})
    found = {p.where: p.severity for p in api.read_dataset(root).problems}
    assert found == {"f1.txt": "warning", "f2.txt": "warning"}
    put(root, {"f3.jpg": "", "f3.txt": "0 0.5 0.5 0.1 0.1\n"})  # a picture that COCO does not list
    dataset = api.read_dataset(root)
    assert len(dataset.images) == 2 and {p.where for p in dataset.problems} >= {"f1.txt", "f2.txt"}


# -- what was written ----------------------------------------------------------------------------------------------


def crowds_of_cvat(root: Path) -> Path:
    """Two deer as brush masks, which CVAT exports as crowds, and a car."""
    files = put(root, {"images/f1.jpg": "", "images/f2.jpg": ""})
    rows = [a | {"iscrowd": 1} for a in COCO["annotations"]] + [COCO["annotations"][0] | {"id": 3, "category_id": 2}]
    top = COCO | {"annotations": rows, "categories": [{"id": 1, "name": "deer"}, {"id": 2, "name": "car"}]}
    (files / "coco.json").write_text(json.dumps(top))
    return files


def test_convert_counts_the_labels_that_it_wrote(tmp_path: Path) -> None:
    data = crowds_of_cvat(tmp_path / "data")
    said = run("convert", data, tmp_path / "yolo", "--to", "yolo").output
    assert re.search(r"^labels +car 1, deer 0$", said, re.MULTILINE)
    assert re.search(r"^labels lost +deer 2$", said, re.MULTILINE) and "lost: ignore_dropped 2" in said
    assert "all 2 label(s) of 'deer' are crowds" in said and "--dont-care keep" in said
    said = run("convert", data, tmp_path / "kept", "--to", "yolo", "--dont-care", "keep").output
    assert re.search(r"^labels +car 1, deer 2$", said, re.MULTILINE) and "labels lost" not in said
    said = run("convert", data, tmp_path / "seg", "--to", "yolo-seg").output  # the car has no mask
    assert re.search(r"^labels +car 0, deer 0$", said, re.MULTILINE)


def test_split_counts_the_labels_that_it_wrote(tmp_path: Path) -> None:
    data = crowds_of_cvat(tmp_path / "data")
    rule = api.SplitRule(by="gap", gap=1, shares=(0.5, 0, 0.5))
    report = api.split(data, tmp_path / "split", rule, to="yolo")
    assert sum(report.objects["deer"].values()) == 0 and sum(report.objects["car"].values()) == 1
    assert sum(api.split(data, tmp_path / "same", rule).objects["deer"].values()) == 2


def test_generate_counts_the_labels_of_each_format(tmp_path: Path) -> None:
    words = ["--set", "camera.pitch={fixed_deg: 60}", "--set", "output.formats=[coco, yolo, dota]"]
    done = run("generate", "hit-uav-drone", "--data", crowds_of_cvat(tmp_path / "d"), "--out", tmp_path / "r", *words)
    assert re.search(r"^labels in coco, dota +car \d, deer [1-9]", done.output, re.MULTILINE)
    assert re.search(r"^labels in yolo +car \d, deer 0", done.output, re.MULTILINE)
    (lost,) = re.findall(r"^lost: .*", done.output, re.MULTILINE)
    assert re.search(r"in dota \(\d+\), images \(\d+\), yolo \(\d+\), in no other: .*`losses` in .*run.json", lost)
    assert json.loads((tmp_path / "r" / "run.json").read_text())["losses"]["yolo.ignore_dropped"]


# -- Darknet -------------------------------------------------------------------------------------------------------

ROW, NAMES, DATA = "1 0.5 0.5 0.1 0.1\n", "car\ndeer\n", "classes = 2\ntrain = data/train.txt\nnames = data/obj.names\n"
VALID = DATA + "valid = data/{}\nbackup = backup/\n"
DARKNET: dict[str, tuple[dict[str, str], list[str]]] = {
    "cvat": (
        {
            "obj_train_data/f1.jpg": "", "obj_train_data/f1.txt": ROW, "obj.names": NAMES, "obj.data": DATA,
            "train.txt": "data/obj_train_data/f1.jpg\n",
        },
        ["train"],
    ),
    "cvat-subsets": (
        {
            "obj_train_data/f1.jpg": "", "obj_train_data/f1.txt": ROW, "obj_valid_data/f2.jpg": "",
            "obj_valid_data/f2.txt": ROW, "obj.names": NAMES, "obj.data": VALID.format("valid.txt"),
            "train.txt": "data/obj_train_data/f1.jpg\n", "valid.txt": "data/obj_valid_data/f2.jpg\n",
        },
        ["train", "val"],
    ),
    "darknet": (
        {
            "data/obj/f1.jpg": "", "data/obj/f1.txt": ROW, "data/obj/f2.jpg": "", "data/obj/f2.txt": ROW,
            "data/obj.names": NAMES, "data/obj.data": VALID.format("test.txt"),
            "data/train.txt": "/darknet/data/obj/f1.jpg\n", "data/test.txt": "C:\\darknet\\data\\obj\\f2.jpg\n",
        },
        ["train", "val"],
    ),
    "roboflow": (
        {
            "train/f1.jpg": "", "train/f1.txt": ROW, "train/_darknet.labels": NAMES, "valid/f2.jpg": "",
            "valid/f2.txt": ROW, "valid/_darknet.labels": NAMES,
        },
        ["train", "val"],
    ),
    "names-alone": ({"f1.jpg": "", "f1.txt": ROW, "my.names": NAMES}, ["train"]),
}  # fmt: skip


@pytest.mark.parametrize("kind", DARKNET)
def test_darknets_lists_and_names_are_read(tmp_path: Path, kind: str) -> None:
    files, splits = DARKNET[kind]
    dataset = api.read_dataset(put(tmp_path / "data", files))
    assert [i.split for i in dataset.images] == splits and dataset.problems == ()
    assert [o.category for i in dataset.images for o in i.instances] == ["deer"] * len(splits)


def test_darknets_files_lead_nowhere_else(tmp_path: Path) -> None:
    files = DARKNET["cvat"][0]
    put(tmp_path, {"outside.names": "secret\nother\n", "secret.jpg": ""})
    stated = {"obj.data": DATA.replace("data/obj.names", "../outside.names")}
    with pytest.raises(DatasetError, match="names"):
        api.read_dataset(put(tmp_path / "names", files | stated))
    data = put(tmp_path / "pictures", files | {"train.txt": files["train.txt"] + "../secret.jpg\n"})
    assert [p.code for p in api.read_dataset(data).problems] == ["name-climbs"]
    long = "a" * 5000 + ".jpg\n" + "a/" * 100_000 + "b.jpg\n"
    dataset = api.read_dataset(put(tmp_path / "long", files | {"train.txt": files["train.txt"] + long}))
    assert len(dataset.images) == 1 and [p.code for p in dataset.problems] == ["image-missing"] * 2


# -- imagefolder ---------------------------------------------------------------------------------------------------

BOX = json.dumps({"bbox": [[8, 6, 16, 12]], "categories": ["deer"]})
CSV = 'file_name,objects\n%sf1.jpg,"' + BOX.replace('"', '""') + '"\n%sf2.jpg,\n'
LINE = f'{{"file_name": "val/f1.jpg", "objects": {BOX}}}\n'


@pytest.mark.parametrize(
    ("files", "split"),
    [
        ({"f1.jpg": "", "f2.jpg": "", "metadata.csv": CSV % ("", "")}, "train"),
        ({"test/f1.jpg": "", "test/f2.jpg": "", "test/metadata.csv": CSV % ("", "")}, "test"),
        ({"test/f1.jpg": "", "test/f2.jpg": "", "metadata.csv": CSV % ("test/", "test/")}, "test"),
        ({"val/f1.jpg": "", "metadata.jsonl": LINE}, "val"),
    ],
    ids=["csv", "csv-split", "csv-whole", "jsonl-whole"],
)
def test_objects_of_an_imagefolder_may_be_in_a_table_and_in_one_file(
    tmp_path: Path, files: dict[str, str], split: str
) -> None:
    dataset = api.read_dataset(put(tmp_path / "data", files))
    assert dataset.format == "huggingface" and dataset.problems == ()
    assert {i.split for i in dataset.images} == {split}
    (deer,) = (o for i in dataset.images for o in i.instances)
    assert deer.category == "deer" and deer.box_xyxy.tolist() == [8, 6, 24, 18]


def test_an_imagefolders_table_of_labels_is_named(tmp_path: Path) -> None:
    root = put(tmp_path / "data", {"f1.jpg": "", "metadata.csv": "file_name,label\nf1.jpg,deer\n"})
    (problem,) = api.read_dataset(root).problems
    assert (problem.where, problem.code, problem.severity) == ("metadata.csv", "label-unread", "error")
    table = "file_name,pitch_deg,label\nf1.jpg,45,deer\n"
    dataset = api.read_dataset(put(root, {"metadata.csv": table}))
    assert dataset.images[0].capture.pitch_deg == 45 and "unknown columns label" in dataset.problems[0].found


def test_unknown_columns_of_an_imagefolder_are_counted(tmp_path: Path) -> None:
    objects = {"bbox": [[8, 6, 16, 12]], "category": ["deer"], "depth": [2]}
    row = {"file_name": "f1.jpg", "label": 3, "text": "", "objects": objects}
    root = put(tmp_path / "data", {"train/f1.jpg": "", "train/metadata.jsonl": json.dumps(row)})
    (problem,) = api.read_dataset(root).problems
    assert problem.code == "kind-unread" and problem.found.endswith(": 1 column depth of objects, 1 column label")


# -- XML -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("encoding", "declared"),
    [("utf-16", "UTF-16"), ("utf-16", ""), ("latin-1", "ISO-8859-1"), ("cp1252", "windows-1252"), ("utf-8-sig", "")],
)
def test_xml_is_read_in_its_encoding(tmp_path: Path, encoding: str, declared: str) -> None:
    text = f"<?xml version='1.0' encoding='{declared}'?>" * bool(declared) + VOC.format(name="f1", category="Rehkühe")
    root = put(tmp_path / "data", {"f1.jpg": ""})
    (root / "f1.xml").write_bytes(text.encode(encoding))
    dataset = api.read_dataset(root)
    assert [o.category for o in dataset.images[0].instances] == ["Rehkühe"] and dataset.problems == ()


@pytest.mark.parametrize(("encoding", "declared"), [("latin-1", ""), ("gbk", "utf-8"), ("utf-8", "UTF-16")])
def test_xml_in_an_encoding_that_is_not_declared_or_not_known_is_named(
    tmp_path: Path, encoding: str, declared: str
) -> None:
    category = "车" if encoding == "gbk" else "Rehkühe"
    text = f"<?xml version='1.0' encoding='{declared}'?>" * bool(declared) + VOC.format(name="f1", category=category)
    root = put(tmp_path / "data", {"f1.jpg": ""})
    (root / "f1.xml").write_bytes(text.encode(encoding))
    (problem,) = api.read_dataset(root).problems
    assert (problem.where, problem.severity) == ("f1.xml", "error")


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le"])
def test_cvats_xml_in_another_encoding_is_read_or_named(tmp_path: Path, encoding: str) -> None:
    box = '<box label="deer" xtl="8" ytl="6" xbr="24" ybr="18"/>'
    image = f'<image id="0" name="f1.jpg" width="64" height="48">{box}</image>'
    text = f'<?xml version="1.0" encoding="UTF-16"?><annotations><version>1.1</version>{image}</annotations>'
    root = put(tmp_path / "data", {"images/f1.jpg": ""})
    (root / "annotations.xml").write_bytes(text.encode(encoding))
    dataset = api.read_dataset(root)
    assert any(i.instances for i in dataset.images) or [p.where for p in dataset.problems] == ["annotations.xml"]
