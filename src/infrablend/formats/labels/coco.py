"""COCO JSON: one file per split; masks are run lengths, oriented boxes and camera facts are extra fields."""

from __future__ import annotations

import math
import pickle
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import corners_of_box, polygon_area
from infrablend.core.capture import Capture
from infrablend.core.dataset import (
    SEEN_BOX,
    SEEN_OBB,
    SPLITS,
    TIGHT_BOX,
    TIGHT_OBB,
    Category,
    Dataset,
    ImageRecord,
    Instance,
    Split,
)
from infrablend.core.file_names import real_path
from infrablend.core.files import link_or_copy, write_chunks
from infrablend.core.json_records import Streamed, is_list, json_chunks
from infrablend.core.rle_masks import Mask
from infrablend.core.temperature import Radiometry
from infrablend.errors import DatasetError, Problem, Severity
from infrablend.formats.annotation_files import leave_out, only_looked_at, read_json, too_long
from infrablend.formats.base import (
    Match,
    Numbered,
    category_ids,
    check_splits,
    in_order,
    is_ignored_name,
    number_ids,
    numbered_from_one,
    require_known,
    require_size,
    shorten,
    split_of_stem,
    stated_split,
)
from infrablend.formats.box_checks import clockwise_corners, edges_of_xywh, is_near, turned_box
from infrablend.formats.losses import Written, occlusion_fields
from infrablend.formats.picture_facts import Captures
from infrablend.formats.pictures.listing import PictureFolder
from infrablend.formats.pictures.temperature_scale import info_of_scale, scale_of_record
from infrablend.formats.records import Findings, table_of, with_ids
from infrablend.formats.values import (
    is_unassigned,
    known,
    read_occlusion,
    to_bool,
    to_floats,
    to_id,
    to_key,
    to_number,
    to_share,
    to_size,
)

NAME = "coco"

WithoutMask = Literal["polygon", "omit"]

_INFO: Mapping[str, object] = {"description": "written by InfraBlend"}
# Far finer than a pixel, but short: sums such as 0.1 + 0.2 would otherwise be written with 17 digits.
_DIGITS = 9
# Contrast of inserted objects in the finished picture, 8-bit levels; see `pipeline.compose.inserts`.
MEASURED = ("changed_grey", "contrast_grey", "scr")
_ROBOFLOW = "_annotations.coco.json"
# Folder of each split that RF-DETR and Roboflow read, with pictures and file.
_BESIDE = {"train": "train", "val": "valid", "test": "test"}
# FLIR's ADAS dataset v2: COCO's file, one with all that annotators drew, and which frames show the same.
_FLIR = "coco.json"
_UNFILTERED = "index.json"
_PAIRS = "rgb_to_thermal_vid_map.json"
_FLIR_NAME = re.compile(r"video-(\w+)-frame-(\d{1,9})-", re.ASCII)
_VISIBLE = re.compile(r"(?<![a-z])(rgb|visible)(?![a-z])", re.IGNORECASE)
# Scale of 16-bit pictures: in `info` if a file's pictures share it, else with each picture.
_SCALE = "temperature_scale"
# What the camera was told about the scene, beside the scale of a picture.
_SETTINGS = "camera_settings"
SETTINGS = ("air_k", "humidity", "reflected_k", "emissivity", "distance_m")
# Facts that COCO has fields of its own for.
_KEYS = {"captured": "date_captured", "frame": "frame_id"}
# Boxes of partly hidden objects, as x, y, width and height.
_OCCLUSION_BOXES = {"amodal_box": "bbox_amodal", "visible_box": "bbox_visible"}
# Exact and visible boxes of inserted objects, where others were written, with the number of their values.
_OTHER_BOXES = {TIGHT_BOX: 4, TIGHT_OBB: 8, SEEN_BOX: 4, SEEN_OBB: 8}
# Fields that are read, or hold no objects; where one of `_PLACES` is, there is an object.
_TOP = {"info", "licenses", "images", "annotations", "categories", "videos"}
_OF_IMAGE = {"id", "file_name", "width", "height", "license", "coco_url", "flickr_url", "date_captured", "video_id"}
_OF_ANNOTATION = {
    "id", "image_id", "category_id", "bbox", "area", "iscrowd", "segmentation", "segmentation_from", "segments_info",
    "keypoints", "num_keypoints", "attributes", "obb", "inserted", "visibility", "truncated", "difficult", "occluded",
    "track_id", "source_id", *MEASURED, *_OTHER_BOXES, *_OCCLUSION_BOXES.values(),
}  # fmt: skip
_PLACES = {"bbox", "bboxes", "box", "boxes", "obb", "points", "polygon", "polygons", "rle", "segmentation"}


# -- writing ---------------------------------------------------------------------------------------------------


def write(
    out: Path,
    images: Iterable[ImageRecord],
    categories: Sequence[Category],
    *,
    ids: Literal["source", "new"] = "new",
    without_mask: WithoutMask = "polygon",
    info: Mapping[str, object] | None = None,
    pictures: bool = False,
    from_one: bool = False,
    beside: bool = False,
) -> Written:
    """Write one file per split that has images, see `coco_chunks`; `from_one` numbers the categories from 1.

    With `pictures`, the files are `out/annotations/instances_<split>.json`, and the pictures are hard-linked (copied
    where that is impossible) to `out/images/<split>/`. Without, the files are `out/<split>.json`; readers then expect
    the pictures in `images/<split>/` in `out` or its parent folder. With `beside`, the files are
    `out/<train|valid|test>/_annotations.coco.json`, as RF-DETR and Roboflow read them, with the pictures in any case.

    Raises:
        OutputError: A file cannot be written.
        ValueError: A size, category or id is missing.
    """
    ordered = in_order(images)
    if from_one:
        categories = numbered_from_one(categories)
    losses: Counter[str] = Counter()
    texts = coco_chunks(ordered, categories, losses, ids=ids, without_mask=without_mask, info=info)
    if beside:
        files = [write_chunks(out / _BESIDE[Path(name).stem] / _ROBOFLOW, chunks) for name, chunks in texts.items()]
    else:
        prefix = "annotations/instances_" if pictures else ""
        files = [write_chunks(out / f"{prefix}{name}", chunks) for name, chunks in texts.items()]
    for image in ordered if pictures or beside else ():
        folder = _BESIDE[image.split] if beside else f"images/{image.split}"
        files.append(link_or_copy(image.path, out / folder / image.name))
    return Written.of(files, losses)


def coco_chunks(
    images: Iterable[ImageRecord],
    categories: Sequence[Category],
    losses: Counter[str],
    *,
    ids: Literal["source", "new"] = "new",
    without_mask: WithoutMask = "polygon",
    info: Mapping[str, object] | None = None,
) -> dict[str, Iterator[str]]:
    """Return the texts of the files `<split>.json` in pieces, by name; equal records give equal bytes.

    `file_name` is `ImageRecord.name`, relative to the split's picture folder. Pictures with a number in their sequence
    get COCO's fields of videos. Categories keep their ids. A category to ignore gets `"ignore": 1`, and its annotations
    get `"iscrowd": 1`.

    Args:
        images: Images with known `size_wh`.
        categories: Categories with the ids to write.
        losses: Counts what is lost while the pieces are composed.
        ids: `new` numbers images and annotations from 1 over all splits (0 means "no match" to pycocotools) and writes
            the source's ids as `source_id`; `source` keeps the source's ids.
        without_mask: `segmentation` of objects without a mask: `polygon` writes that of the oriented box, else of the
            box; `omit` leaves the field out. `segmentation_from` is `mask`, `obb` or `box`.
        info: The `info` object; dates in it would make the files differ between runs.
    """
    ordered = in_order(images)
    new = ids == "new"
    texts: dict[str, Iterator[str]] = {}
    for split, part in number_ids(ordered, ids, 1).by_split().items():
        common = info_of_scale(i for i, _, _ in part)
        videos = _videos(i for i, _, _ in part)
        top = {
            "info": {**(info or _INFO), **({} if common is None else {_SCALE: common})},
            "licenses": [],
            "images": Streamed(_file_record(i, n, new, common is not None, videos) for i, n, _ in part),
            "annotations": Streamed(annotation_records(part, categories, new, without_mask)),
            "categories": category_records(categories),
            **({"videos": [{"id": number, "name": name} for name, number in videos.items()]} if videos else {}),
        }
        texts[f"{split}.json"] = chain(json_chunks(top, losses), "\n")
    return texts


def _videos(images: Iterable[ImageRecord]) -> dict[str, int]:
    """Return the number of each sequence in a file; none if the pictures have no numbers in their sequences."""
    known = {(i.capture.sequence, i.capture.frame is not None) for i in images}
    if not any(numbered for _, numbered in known):
        return {}
    return {name: number for number, name in enumerate(sorted({n for n, _ in known if n is not None}), 1)}


def _file_record(
    image: ImageRecord, number: int | str, new: bool, one_scale: bool, videos: Mapping[str, int]
) -> dict[str, object]:
    """Return the record of a picture, with its temperature scale unless all pictures of the file share one."""
    record = _image_record(image, number, new)
    if (video := videos.get(image.capture.sequence or "")) is not None:
        record["video_id"] = video
    if not one_scale and image.capture.scale is not None:
        record[_SCALE] = image.capture.scale.to_json()
    return record | _camera_settings(image)


def _camera_settings(image: ImageRecord) -> dict[str, object]:
    given = image.capture.radiometry
    found = {} if given is None else known(**{k: getattr(given, k) for k in SETTINGS})
    return {_SETTINGS: found} if found else {}


def category_records(categories: Sequence[Category]) -> list[dict[str, object]]:
    """Return the list `categories` of a COCO file."""
    return [
        {"id": c.id, "name": c.name, "supercategory": c.supercategory or c.name} | ({"ignore": 1} if c.ignore else {})
        for c in categories
    ]


def source_id_field(item: ImageRecord | Instance, new: bool) -> dict[str, object]:
    """Return the field `source_id`: the source's id if `new` ids are written, else the field that was read, if any."""
    if new and item.source_id is not None:
        return {"source_id": item.source_id}
    return {"source_id": item.extra["source_id"]} if "source_id" in item.extra else {}


def _image_record(image: ImageRecord, number: int | str, new: bool) -> dict[str, object]:
    w, h = require_size(image)
    record = {"id": number, "file_name": image.name, "width": w, "height": h} | source_id_field(image, new)
    return record | fact_fields(image)


def fact_fields(image: ImageRecord) -> dict[str, object]:
    """Return the known facts about a picture by the names of COCO's fields."""
    return {_KEYS.get(name, name): value for name, value in image.capture.to_json().items()}


def _tidy(values: NDArray[np.float64]) -> list[float]:
    return [round(float(v), _DIGITS) for v in values.reshape(-1)]


def annotation_records(
    numbered: Numbered, categories: Sequence[Category], new: bool, without_mask: WithoutMask
) -> Iterator[dict[str, object]]:
    """Yield the annotations of numbered images; `source_id` as in `source_id_field`."""
    of_category = category_ids(categories)
    ignored = {c.name for c in categories if c.ignore}
    for image, image_id, numbers in numbered:
        require_known(image, of_category)
        for instance, number in zip(image.instances, numbers, strict=True):
            a = _annotation(instance, require_size(image), new, without_mask)
            a |= {"id": number, "image_id": image_id, "category_id": of_category[instance.category]}
            a["iscrowd"] = int(instance.is_crowd or instance.category in ignored)
            yield a


def _annotation(
    instance: Instance, size_wh: tuple[int, int], new: bool, without_mask: WithoutMask
) -> dict[str, object]:
    """Return an annotation without `id`, `image_id` and `category_id`."""
    x0, y0, x1, y1 = instance.box_xyxy
    a: dict[str, object] = {
        "bbox": _tidy(np.array([x0, y0, x1 - x0, y1 - y0])),
        "area": round(float((x1 - x0) * (y1 - y0)), _DIGITS),
        "inserted": instance.inserted,
        "iscrowd": int(instance.is_crowd),
    }
    corners = instance.corners_xy
    if corners is not None:
        a["obb"] = _tidy(corners)
    a |= known(visibility=instance.visibility, truncated=instance.truncated, difficult=instance.difficult)
    a |= known(track_id=instance.track_id)
    a |= {k: instance.extra[k] for k in MEASURED if k in instance.extra}
    a |= {k: _tidy(np.array(instance.extra[k])) for k in _OTHER_BOXES if k in instance.extra}
    a |= {"tight_box": True} if instance.extra.get("tight_box") else {}
    a |= _occlusion(instance)
    if instance.mask is not None:
        if instance.mask.size_hw != (size_wh[1], size_wh[0]):
            raise ValueError(f"mask of {instance.mask.size_hw} in a frame of {size_wh}")
        a |= {"segmentation": instance.mask.to_coco(), "segmentation_from": "mask", "area": instance.mask.area_px}
    elif without_mask == "polygon":
        outline = corners if corners is not None else corners_of_box(instance.box_xyxy)
        a |= {"segmentation": [_tidy(outline)], "segmentation_from": "box" if corners is None else "obb"}
        if corners is not None:
            a["area"] = round(abs(polygon_area(corners)), _DIGITS)
    return a | source_id_field(instance, new)


def _occlusion(instance: Instance) -> dict[str, object]:
    fields = occlusion_fields(instance)
    for key, name in _OCCLUSION_BOXES.items():
        if key in fields:
            del fields[key]
            left, top, right, bottom = instance.extra[key]
            fields[name] = _tidy(np.array([left, top, right - left, bottom - top]))
    return fields


def _read_occlusion(a: Mapping[str, object]) -> dict[str, object]:
    fields: dict[str, object] = {"occluded": a.get("occluded")}
    for key, name in _OCCLUSION_BOXES.items():
        if (box := to_floats(a.get(name), 4)) is not None:
            x, y, w, h = box
            fields[key] = [x, y, x + w, y + h]
    return read_occlusion(fields)


# -- finding ---------------------------------------------------------------------------------------------------


def is_coco(top: object) -> bool:
    """Return whether a JSON value is a COCO detection dataset (HIT-UAV's own JSON has other keys)."""
    if not isinstance(top, dict):
        return False
    lists = all(is_list(top.get(k)) for k in ("images", "annotations", "categories"))
    first = next(iter(top["images"]), None) if lists else None
    return lists and ("file_name" in first if isinstance(first, dict) else True)


def find_files(root: Path) -> dict[Path, Split]:
    """Return the COCO files in a folder, its subfolder `annotations` or `coco`, or folders that state a split.

    Else the file's name determines the split (`test.json`, `instances_val2017.json`); files with other names are train.
    """
    for folder in (root, root / "annotations", root / "coco"):
        if files := _files_in(folder):
            return {p: _split_of(p) for p in files}
    inside = sorted(d for d in root.iterdir() if d.is_dir()) if root.is_dir() else []
    return {p: split for d in inside if (split := stated_split(d.name)) for p in _files_in(d)}


def _files_in(folder: Path) -> list[Path]:
    found = sorted(p for p in folder.glob("*.json") if p.is_file() and not p.name.startswith("."))
    others = {"metadata.json", *([_UNFILTERED] if _is_flir(folder / _FLIR) else [])}
    return [p for p in found if p.name not in others and _looks_like_coco(p)]


def _is_flir(file: Path) -> bool:
    return file.name == _FLIR and file.is_file() and file.with_name(_UNFILTERED).is_file()


def _split_of(file: Path) -> Split:
    """Return the split that a file's name states, or that of its folder, where Roboflow and FLIR state it."""
    return split_of_stem(real_path(file.parent).name if file.name == _ROBOFLOW or _is_flir(file) else file.stem)


def _looks_like_coco(path: Path) -> bool:
    try:
        if is_coco(read_json(path)):
            return True
        only_looked_at(path)
        return False
    except DatasetError:
        # A broken file named after a split will be reported when it is read; any other is no annotation file.
        return path.stem in SPLITS or path.stem.startswith("instances_") or path.name == _ROBOFLOW


def detect(root: Path) -> Match:
    """Decide whether `root` contains COCO files."""
    files = find_files(root)
    if not files:
        reason = "no JSON with images, annotations and categories in the folder, annotations/, coco/ or train/"
        return Match(NAME, False, reason)
    return Match(NAME, True, f"COCO: {', '.join(p.relative_to(root).as_posix() for p in files)}")


def _some_names(images: Iterable[Any]) -> list[str]:
    return list(islice((str(i["file_name"]) for i in images if isinstance(i, dict) and "file_name" in i), 50))


def _picture_folder(root: Path, file: Path, split: Split, names: Sequence[str]) -> PictureFolder:
    stem = file.stem.removeprefix("instances_")
    bases = [root, file.parent, file.parent.parent] if file.parent != root else [root]
    if root.name == "coco":
        bases.append(root.parent)
    last = stem.rpartition("_")[2]  # of person_keypoints_train2017
    parts = (f"images/{split}", f"images/{stem}", split, stem, "images", ".", f"images/{last}", last, "data")
    return PictureFolder.with_most([base / part for base in bases for part in parts], names, file.parent)


# -- reading ---------------------------------------------------------------------------------------------------


def read(
    root: Path,
    *,
    splits: Iterable[str] | None = None,
    metadata: Path | None = None,
    file: Path | None = None,
) -> Dataset:
    """Read COCO files and find their pictures.

    Args:
        root: Folder that contains the JSON files, see `find_files`.
        splits: Splits to read; None reads all.
        metadata: Table of pitch and altitude; None uses `metadata.csv` or `.json` in the folder, if it exists.
        file: The only JSON file to read; None reads all that are found.

    Raises:
        DatasetError: There is no COCO file, or no picture can be read.
    """
    wanted = check_splits(splits)
    files = {file: _split_of(file)} if file is not None else find_files(root)
    if not files:
        problem = Problem(str(root), "annotation-missing", "no COCO file", "a JSON with images and annotations")
        raise DatasetError(f"{root}: no COCO dataset", [problem])
    table, named = table_of(root, metadata)
    found = Findings(root, list(table.problems) if table else [])
    captures = Captures(table, found.problems)
    categories: list[Category] = []
    taken: set[tuple[Split, Path]] = set()
    records: list[ImageRecord] = []
    for path, split in files.items():
        if split not in wanted:
            continue
        where = found.place(path) if path.is_relative_to(root) else path.name
        try:
            top = read_json(path)
        except DatasetError as error:
            found.add_all(error.problems, where)
            continue
        if not is_coco(top):
            found.add(where, "annotation-layout", "no COCO keys", "images, annotations, categories", "use COCO")
            continue
        if fault := too_long(where, "info", top.get("info")):
            found.problems.append(fault)
        folder = _picture_folder(root, path, split, _some_names(top["images"]))
        of_file = read_records(found, top, folder, split, where, categories, captures, taken)
        if _is_flir(path):
            leave_out([path.with_name(_UNFILTERED), root / _PAIRS])
            visible = _VISIBLE.search(real_path(path.parent).name) is not None
            of_file = [_of_flir(r, visible) for r in of_file]
        records += of_file
    if not records:
        raise DatasetError(f"{root}: no picture to read", shorten(found.problems))
    if table is not None:
        found.problems += table.remarks(root, [r.name for r in records], [r.capture.sequence for r in records])
    found.report_left_out()
    _report_crowds(found, records, categories)
    notes = {"labels": "coco", **named, "pitch": captures.note()}
    return Dataset(root, NAME, tuple(categories), with_ids(records), tuple(found.problems), notes)


def _of_flir(record: ImageRecord, visible: bool) -> ImageRecord:
    """Return a picture of FLIR's dataset with the sequence and the number that its name states, and its light."""
    named = _FLIR_NAME.search(record.name)
    capture = record.capture
    if named is not None:
        capture = replace(capture, sequence=named[1], frame=int(named[2]))
    return replace(record, capture=capture, extra={**record.extra, **({"modality": "visible"} if visible else {})})


def _report_crowds(found: Findings, records: Iterable[ImageRecord], categories: Iterable[Category]) -> None:
    """Warn of classes without a single object: CVAT and Datumaro mark every brush mask as a crowd."""
    counts = Counter((i.category, i.is_crowd) for r in records for i in r.instances)
    for name in (c.name for c in categories if not c.ignore):
        if (crowds := counts[name, True]) and not counts[name, False]:
            text = f"all {crowds} label(s) of {name!r} are crowds (iscrowd 1), which YOLO leaves out"
            todo = "if they are masks of single objects, as from CVAT, set iscrowd to 0, or keep crowds as objects: "
            todo += "labels.dont_care=keep in a recipe, --dont-care keep for convert"
            found.warn(found.root.name, "crowds-only", text, "iscrowd 0 for single objects", todo)


def read_records(
    found: Findings,
    top: Mapping[str, Any],
    folder: PictureFolder,
    split: Split,
    where: str,
    categories: list[Category],
    captures: Captures,
    taken: set[tuple[Split, Path]] | None = None,
) -> list[ImageRecord]:
    """Return the record, without an id, of every usable picture of one file.

    Args:
        found: Problems.
        top: A COCO object, see `is_coco`.
        folder: Folder of the pictures.
        split: Split of all pictures.
        where: Name of the file in problems.
        categories: Categories of earlier files; new ones are appended.
        captures: Source of pitch and altitude.
        taken: Pictures of earlier files, by split, which are left out; those of this file are added.
    """
    earlier = frozenset(taken or ())
    _leave_out_objects(found, top, _TOP, "", where)
    names = _category_names(found, top["categories"], where, categories)
    of_image = _by_image(found, top["annotations"], where)
    videos = _video_names(top.get("videos"))
    info = top.get("info")
    scale = info.get(_SCALE) if isinstance(info, dict) else None
    records: list[ImageRecord] = []
    seen_names: set[str] = set()
    seen_ids: set[int | str] = set()
    left_out: list[int] = []
    measured = 0
    for i, r in enumerate(top["images"]):
        here = f"{where}: image {r.get('id', i) if isinstance(r, dict) else i}"
        number = to_key(r.get("id")) if isinstance(r, dict) else None
        if number is None:
            found.add(here, "image-malformed", repr(r)[:80], "an image record with an id")
            continue
        _leave_out_objects(found, r, _OF_IMAGE, "images.", here)
        annotations = of_image.pop(number, [])
        name, file, fault = folder.find_named(r.get("file_name"), here, "a file in the picture folder")
        if fault is None and (name in seen_names or number in seen_ids):
            text = f"a second record with name {name!r} or id {number}"
            fault = Problem(here, "image-duplicate", text, "each picture once")
        if fault is not None or file is None:
            found.problems += [fault] if fault else []
            continue
        seen_names.add(name)
        seen_ids.add(number)
        if (split, file) in earlier:
            left_out.append(len(annotations))
            continue
        if taken is not None:
            taken.add((split, file))
        size_wh = to_size(r.get("width"), r.get("height"))
        if size_wh is None:
            size_wh = found.size(file, here)
            measured += size_wh is not None
        instances = _read_annotations(found, [pickle.loads(a) for a in annotations], names, size_wh, here)
        stated = replace(_stated_facts(r, videos), radiometry=_read_radiometry(found, r, scale, here))
        capture = captures.of(name, here, stated)
        extra = {"source_id": r["source_id"]} if "source_id" in r else {}
        records.append(ImageRecord("", file, split, size_wh, instances, capture, to_id(r.get("id")), extra, name))
    found.problems += _remarks(where, left_out, measured, of_image, _gravity_of_repeats(found.root / where))
    return records


def _gravity_of_repeats(file: Path) -> Severity:
    """Return how grave it is that pictures of a file were in an earlier one.

    COCO itself has the pictures of a split in several files, of which the one of the objects is read.
    """
    beside = file.with_name(f"instances_{file.stem.rpartition('_')[2]}.json")
    return "warning" if beside != file and beside.is_file() else "error"


def _leave_out_objects(found: Findings, record: Mapping[str, object], read: Set[str], prefix: str, where: str) -> None:
    """Count the objects in fields of a record that are not read; only the first item of a list is looked at."""
    for name in record.keys() - read:
        value = record[name]
        if isinstance(value, dict) and _PLACES.isdisjoint(value):  # by their ids, perhaps
            value = list(value.values())
        first = next(iter(value), None) if is_list(value) else value
        if isinstance(first, dict) and not _PLACES.isdisjoint(first):
            found.leave_out(f"in {prefix}{name}", where, len(value) if is_list(value) else 1)


def _category_names(
    found: Findings, rows: Iterable[Any], where: str, categories: list[Category]
) -> dict[int | str, str]:
    """Return the name of each category of a file by its id; new categories are appended to those of all files."""
    names: dict[int | str, str] = {}
    for i, c in enumerate(rows):
        number = to_key(c.get("id")) if isinstance(c, dict) else None
        if number is None or not isinstance(c.get("name"), str) or number in names:
            found.add(f"{where}: category {i}", "category-malformed", repr(c)[:80], "a new id and a name")
            continue
        names[number] = c["name"]
        if all(k.name != c["name"] for k in categories):
            taken = {k.id for k in categories}
            free = number if isinstance(number, int) and number not in taken else max(taken, default=-1) + 1
            ignore = is_ignored_name(c["name"]) or c.get("ignore") == 1
            categories.append(Category(free, c["name"], str(c.get("supercategory") or ""), ignore))
    return names


def _by_image(found: Findings, rows: Iterable[Any], where: str) -> dict[int | str, list[bytes]]:
    """Return the annotations by `image_id`, pickled: as bytes they take a fifth of the memory until they are needed."""
    of_image: dict[int | str, list[bytes]] = {}
    for i, a in enumerate(rows):
        number = to_key(a.get("image_id")) if isinstance(a, dict) else None
        if number is None:
            found.add(f"{where}: annotation {i}", "annotation-malformed", repr(a)[:80], "an annotation record")
            continue
        of_image.setdefault(number, []).append(pickle.dumps(a, pickle.HIGHEST_PROTOCOL))
    return of_image


def _video_names(rows: object) -> dict[int | str, str]:
    videos = (v for v in rows if isinstance(v, dict)) if is_list(rows) else ()
    numbered = ((to_key(v.get("id")), v.get("name")) for v in videos)
    return {number: name for number, name in numbered if number is not None and isinstance(name, str)}


def _stated_facts(r: Mapping[str, object], videos: Mapping[int | str, str]) -> Capture:
    """Return what the record of a picture states; values that cannot be are left out."""
    facts = {**r, **{fact: r.get(key) for fact, key in _KEYS.items()}}
    facts["frame"] = r.get("frame_index") if facts["frame"] is None else facts["frame"]  # TAO's name
    video = to_key(r.get("video_id"))
    if facts.get("sequence") in (None, "") and video is not None:
        facts["sequence"] = videos.get(video)
    return Capture.from_json(facts, strict=False)


def _remarks(
    where: str,
    left_out: Sequence[int],
    measured: int,
    unknown: Mapping[int | str, Sequence[bytes]],
    repeated: Severity,
) -> list[Problem]:
    """Return what is to be said about a file as a whole.

    Args:
        where: Name of the file.
        left_out: Number of annotations of each picture that another file contains, too.
        measured: Number of pictures whose size was read from them.
        unknown: Annotations of pictures that the file does not list.
        repeated: Severity of pictures that are left out.
    """
    problems = []
    if left_out:
        found = f"{len(left_out)} picture(s) that another annotation file contains too; left out here"
        found += f" with {sum(left_out)} annotation(s)"
        expected = "each picture once"
        todo = "remove or join the files"
        problems.append(Problem(where, "image-duplicate", found, expected, todo, repeated))
    if measured:
        found = f"{measured} image(s) without width and height, which were read from the pictures"
        problems.append(Problem(where, "image-size-unknown", found, "width and height in px", severity="warning"))
    for number, left in sorted(unknown.items(), key=str):
        text = f"{len(left)} annotation(s) of image_id {number}"
        problems.append(Problem(where, "image-unknown", text, "the id of a picture that can be read"))
    return problems


def _read_radiometry(found: Findings, r: Mapping[str, object], scale: object, where: str) -> Radiometry | None:
    """Return the scale of a picture, its own or that of all, with the camera's settings; None without one."""
    radiometry: Radiometry | None = found.checked(scale_of_record(r.get(_SCALE, scale), NAME, where))
    return None if radiometry is None else replace(radiometry, **_settings(r.get(_SETTINGS)))


def _settings(value: object) -> dict[str, Any]:
    """Return what a camera was told about the air and the objects; values that cannot be are left out."""
    given = value if isinstance(value, dict) else {}
    numbers = {name: to_number(given.get(name)) for name in SETTINGS}
    return {name: v for name, v in numbers.items() if v is not None and 0 <= v <= 1e5}


def _read_annotations(
    found: Findings,
    records: Sequence[Mapping[str, object]],
    names: Mapping[int | str, str],
    size_wh: tuple[int, int] | None,
    where: str,
) -> tuple[Instance, ...]:
    instances: list[Instance] = []
    seen: set[int | str] = set()
    for a in records:
        number = to_key(a.get("id"))
        here = f"{where}: annotation {a.get('id')}"
        _leave_out_objects(found, a, _OF_ANNOTATION, "annotations.", here)
        if number is not None and number in seen:
            found.warn(here, "annotation-duplicate", f"a second annotation with id {number}", "each id once")
        seen |= {number} if number is not None else set()
        category = to_key(a.get("category_id"))
        if category is None or category not in names:
            text = f"category_id {a.get('category_id')!r}"
            expected = f"one of {sorted(names, key=str)}"
            found.add(here, "category-unknown", text, expected, "add it to categories")
            continue
        bbox = to_floats(a.get("bbox"), 4)
        if bbox is None:
            found.add(here, "box-malformed", f"bbox {a.get('bbox')!r}"[:120], "[x, y, w, h]", "correct the annotation")
            continue
        edges: Sequence[float] = edges_of_xywh(bbox, size_wh)
        corners = to_floats(a.get("obb"), 8)
        if corners is None and (angle := _rotation_rad(a)) and min(bbox[2:]) > 0 and is_near(bbox):
            if a.get("segmentation"):
                # CVAT's box then encloses the mask and the rectangle before it is turned, which is not known any more.
                found.leave_out("rotation beside a segmentation", here)
            else:
                x, y, w, h = bbox
                turned, edges = turned_box((x + w / 2, y + h / 2, w, h, angle), size_wh)
                corners = tuple(turned.ravel().tolist())
        box = found.box(edges, size_wh, here)
        if box is None:
            continue
        if a.get("keypoints"):
            found.leave_out("keypoints", here)
        extra = {k: a[k] for k in ("source_id",) if k in a} | _read_occlusion(a)
        if a.get("iscrowd") == 1:
            extra["iscrowd"] = 1
        if a.get("tight_box") is True:
            extra["tight_box"] = True
        extra |= known(**{k: to_number(a.get(k)) for k in MEASURED})
        others = {k: to_floats(a.get(k), n) for k, n in _OTHER_BOXES.items()}
        extra |= {
            k: list(v) for k, v in others.items() if v is not None and is_near(v) and (len(v) > 4 or min(v[2:]) > 0)
        }
        instances.append(
            Instance(
                names[category],
                box,
                None if corners is None or not is_near(corners) else clockwise_corners(np.array(corners).reshape(4, 2)),
                _read_mask(found, a, size_wh, here),
                to_share(a.get("visibility")),
                to_bool(a.get("truncated")),
                to_bool(a.get("difficult")),
                a.get("inserted") is True,
                None if number is None else to_id(a.get("id")),
                extra,
                _track_id(a),
            )
        )
    return tuple(instances)


def _track_id(a: Mapping[str, object]) -> int | str | None:
    """Return the track of an object: COCO's field, that of CocoVID, or CVAT's attribute; None without one."""
    attributes = a.get("attributes")
    of_cvat = attributes.get("track_id") if isinstance(attributes, dict) else None
    stated = (to_id(value) for value in (a.get("track_id"), a.get("instance_id"), of_cvat))
    return next(iter(sorted((track for track in stated if track is not None), key=is_unassigned)), None)


def _rotation_rad(a: Mapping[str, object]) -> float:
    """Return the angle by which CVAT turns a box about its centre; 0 without one."""
    attributes = a.get("attributes")
    degrees = to_number(attributes.get("rotation")) if isinstance(attributes, dict) else None
    return math.radians((degrees or 0.0) % 360)


def _read_mask(found: Findings, a: Mapping[str, object], size_wh: tuple[int, int] | None, where: str) -> Mask | None:
    """Return the mask from run lengths or polygons; None if there is none or it was derived from the box."""
    value = a.get("segmentation")
    if not value or size_wh is None or a.get("segmentation_from") in ("obb", "box"):
        return None
    size_hw = (size_wh[1], size_wh[0])
    try:
        return Mask.from_rings(value, size_hw) if isinstance(value, list) else Mask.from_coco(value, size_hw)
    except (ValueError, TypeError, OverflowError) as error:
        text = f"a segmentation that cannot be read and is left out ({type(error).__name__}: {error})"
        found.warn(where, "mask-malformed", text, "run lengths or polygons")
        return None
