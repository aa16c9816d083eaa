"""Write images and labels in HIT-UAV's four forms."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import corners_of_box, corners_of_cxcywha
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance
from infrablend.core.files import link_or_copy, write_chunks
from infrablend.core.json_records import SPACED, Streamed, json_chunks
from infrablend.formats.base import (
    Numbered,
    category_ids,
    ignored_by_class,
    in_order,
    number_ids,
    require_known,
    require_size,
    unmarked_regions,
)
from infrablend.formats.box_checks import is_rectangle, obb_from_corners
from infrablend.formats.labels.coco import source_id_field
from infrablend.formats.losses import Written, count_dropped
from infrablend.formats.published.hit_uav.form_records import DATABASE, Form

# Digits written for an oriented box, enough to read corners back within 1e-6 px at 1000 px.
_COORDINATE_DIGITS = 8
_ANGLE_DIGITS = 10
# What each form drops beside masks, visibility and occlusion.
_DROPPED: Mapping[Form, Sequence[str]] = {
    "normal_json": ("truncated", "difficult", "obb"), "rotate_json": ("truncated",), "normal_xml": ("obb",),
    "rotate_xml": (),
}  # fmt: skip
_INFO = {"description": "HIT-UAV layout, written by InfraBlend"}


def native_writer(dataset: Dataset) -> str:
    """Return the name of the writer for the forms that a dataset was read from."""
    forms = dataset.notes.get("forms") or ("normal_json",)
    return "hit-uav" if any(f.endswith("_json") for f in forms) else "hit-uav-xml"


def write(
    out: Path,
    images: Iterable[ImageRecord],
    categories: Sequence[Category],
    *,
    forms: Sequence[Form] = ("normal_json", "rotate_json"),
    ids: Literal["source", "new"] = "new",
    extra: Mapping[str, object] | None = None,
    pictures: bool = True,
) -> Written:
    """Write images in some of HIT-UAV's forms, each in a folder named after the form below `out`.

    Pictures are hard links to `ImageRecord.path` (copies where that is impossible), named by `ImageRecord.name`. Equal
    records give equal bytes. Losses are counted as `<form>.<kind>`, see `losses.LOSSES`.

    New ids count from 0 over all splits, as HIT-UAV does, and keep the source's id as `source_id`. `extra` are
    top-level fields (`info`, `licenses`, ...), e.g. `Dataset.extra`.

    Raises:
        OutputError: A file cannot be written.
        ValueError: A size, category or id is missing.
    """
    ordered = in_order(images)
    numbered = number_ids(ordered, ids, 0)
    files: list[Path] = []
    losses: dict[str, int] = {}
    for form in forms:
        counts: Counter[str] = Counter()
        if form.endswith("_json"):
            texts = _json_texts(form, numbered, categories, ids == "new", extra or {}, counts)
        else:
            texts = _xml_texts(form, ordered, categories, counts)
        files += [write_chunks(out / form / name, chunks) for name, chunks in texts]
        losses |= {f"{form}.{kind}": n for kind, n in counts.items()}
    for form in forms if pictures else ():
        for image in ordered:
            folder = out / form / ("JPEGImages" if form.endswith("_xml") else image.split)
            files.append(link_or_copy(image.path, folder / image.name))
    return Written.of(files, losses)


def _count_losses(instance: Instance, form: Form, unsaid: Collection[str], losses: Counter[str]) -> None:
    losses["ignore_as_class"] += unmarked_regions([instance], unsaid)
    count_dropped(instance, losses, "mask", "visibility", "occlusion", *_DROPPED[form])
    if form.startswith("rotate"):
        losses["obb_from_box"] += instance.corners_xy is None


def _truncated_box(box_xyxy: NDArray[np.float64], size_wh: tuple[int, int], losses: Counter[str]) -> list[int]:
    """Return xmin, ymin, xmax, ymax as in HIT-UAV: truncated toward zero, at least one pixel wide and high."""
    box = [math.trunc(v) for v in box_xyxy.tolist()]
    losses["fraction_truncated"] += any(t != v for t, v in zip(box, box_xyxy.tolist(), strict=True))
    widened = False
    for low, high, size in ((0, 2, size_wh[0]), (1, 3, size_wh[1])):
        if box[high] <= box[low]:
            widened = True
            box[low] = min(box[low], size - 1)
            box[high] = box[low] + 1
    losses["box_widened"] += widened
    return box


def _oriented_numbers(instance: Instance, losses: Counter[str]) -> list[float]:
    """Return cx, cy, w, h, angle: the source's own numbers if they still match the corners, else from the corners."""
    corners = instance.corners_xy if instance.corners_xy is not None else corners_of_box(instance.box_xyxy)
    source = instance.extra.get("obb")
    if source is not None:
        again = corners_of_cxcywha(np.array([source], np.float64))[0]
        if (np.abs(again - corners) <= 1e-9).all():
            return [float(v) for v in source]
    numbers = obb_from_corners(corners)
    losses["obb_not_rectangle"] += not is_rectangle(corners, numbers)
    return [round(v, _COORDINATE_DIGITS) for v in numbers[:4]] + [round(numbers[4], _ANGLE_DIGITS)]


def _marks(instance: Instance) -> dict[str, object]:
    """Return InfraBlend's own fields: inserted; box drawn tightly, unlike HIT-UAV's bounds of the oriented box."""
    marks = {"inserted": instance.inserted, "tight_box": bool(instance.extra.get("tight_box"))}
    return {name: True for name, is_set in marks.items() if is_set}


_TOP: Mapping[str, object] = {
    "info": _INFO,
    "licenses": [],
    "scenarios": [{"id": 0, "name": "day"}, {"id": 1, "name": "night"}],
    "weather": [{"id": 0, "name": "sunny"}, {"id": 1, "name": "rainy"}],
}


def _json_texts(
    form: Form,
    numbered: Numbered,
    categories: Sequence[Category],
    new: bool,
    extra: Mapping[str, object],
    losses: Counter[str],
) -> Iterator[tuple[str, Iterable[str]]]:
    for split, part in numbered.by_split().items():
        top = _json_file(form, part, categories, new, extra, losses)
        # ASCII, as in the original.
        yield f"annotations/{split}.json", json_chunks(top, losses, separators=SPACED, sort_keys=False)


def _json_file(
    form: Form,
    numbered: Numbered,
    categories: Sequence[Category],
    new: bool,
    extra: Mapping[str, object],
    losses: Counter[str],
) -> dict[str, object]:
    """Return the content of a JSON file, with keys in the order of the original."""
    normal = form == "normal_json"
    of_category = category_ids(categories)
    unsaid = ignored_by_class(categories)
    image_record = _normal_image if normal else _rotate_image

    def annotations() -> Iterator[dict[str, object]]:
        for image, image_id, object_ids in numbered:
            require_known(image, of_category)
            for instance, object_id in zip(image.instances, object_ids, strict=True):
                _count_losses(instance, form, unsaid, losses)
                ids = {"id": object_id, "image_id": image_id, "category_id": of_category[instance.category]}
                if normal:
                    annotation = _normal_object(_truncated_box(instance.box_xyxy, require_size(image), losses), ids)
                else:
                    difficult = bool(instance.difficult)
                    annotation = {**ids, "difficult": difficult, "bbox": _oriented_numbers(instance, losses)}
                yield annotation | source_id_field(instance, new) | _marks(instance)

    names = [
        ({"supercategory": c.supercategory or c.name} if normal else {}) | {"id": c.id, "name": c.name}
        for c in categories
    ]
    return {
        **{k: extra.get(k, _TOP[k]) for k in (("info", "licenses") if normal else _TOP)},
        "images": Streamed(image_record(image, n) | source_id_field(image, new) for image, n, _ in numbered),
        "categories": names,
        "annotation" if normal else "annotations": Streamed(annotations()),
    }


def _normal_image(image: ImageRecord, image_id: int | str) -> dict[str, object]:
    w, h = require_size(image)
    date = str(image.extra.get("date", ""))
    return {"filename": image.name, "height": h, "width": w, "id": image_id, "date_captured": date}


def _rotate_image(image: ImageRecord, image_id: int | str) -> dict[str, object]:
    w, h = require_size(image)
    return {
        "id": image_id,
        "width": w,
        "height": h,
        "depth": image.extra.get("depth", 1),
        "filename": image.name,
        "scenario": {"day": "0", "night": "1"}.get(str(image.capture.time_of_day), ""),
        "weather": str(image.extra.get("weather", "")),
        "perspective": "" if image.capture.pitch_deg is None else f"{image.capture.pitch_deg:.10g}",
        "altitude": "" if image.capture.altitude_m is None else f"{image.capture.altitude_m:.10g}",
        "date": str(image.extra.get("date", "")),
    }


def _normal_object(box_xyxy: Sequence[int], ids: Mapping[str, int | str]) -> dict[str, object]:
    x0, y0, x1, y1 = box_xyxy
    return {
        "segmentation": [[x0, y0, x1, y0, x1, y1, x0, y1]],
        "area": (x1 - x0) * (y1 - y0),
        "image_id": ids["image_id"],
        "bbox": [x0, y0, x1 - x0, y1 - y0],
        "category_id": ids["category_id"],
        "id": ids["id"],
    }


def _xml_texts(
    form: Form, images: Sequence[ImageRecord], categories: Sequence[Category], losses: Counter[str]
) -> Iterator[tuple[str, Iterable[str]]]:
    """Yield path and text of one VOC or roLabelImg file per picture, and of the lists of splits."""
    known = category_ids(categories)
    unsaid = ignored_by_class(categories)
    stems: dict[str, list[str]] = defaultdict(list)
    for image in images:
        if "/" in image.name:
            raise ValueError(f"{image.id}: the XML forms are flat, but {image.name!r} is in a folder")
        stem = image.name.rpartition(".")[0]
        stems[image.split].append(stem)
        yield f"Annotations/{stem}.xml", (_xml_text(form, image, stem, known, unsaid, losses),)
    stems["trainval"] = stems["train"] + stems["val"]
    for split in (*SPLITS, "trainval"):
        yield f"ImageSets/Main/{split}.txt", (f"{s}\n" for s in stems[split])


def _xml_text(
    form: Form,
    image: ImageRecord,
    stem: str,
    known: Collection[str],
    unsaid: Collection[str],
    losses: Counter[str],
) -> str:
    w, h = require_size(image)
    rotated = form == "rotate_xml"
    folder, name = (str(image.extra.get("date", "")), stem) if rotated else ("./JPEGImages", image.name)
    lines = [
        f"<annotation verified={quoteattr('no')}>" if rotated else "<annotation>",
        f"  <folder>{escape(folder)}</folder>",
        f"  <filename>{escape(name)}</filename>",
        "  <source>",
        f"    <database>{'Unknown' if rotated else DATABASE}</database>",
        "  </source>",
        "  <size>",
        f"    <width>{w}</width>",
        f"    <height>{h}</height>",
        f"    <depth>{image.extra.get('depth', 1)}</depth>",
        "  </size>",
        "  <segmented>0</segmented>",
    ]
    pitch = "Unspecified" if image.capture.pitch_deg is None else f"{image.capture.pitch_deg:.10g}"
    require_known(image, known)
    for instance in image.instances:
        _count_losses(instance, form, unsaid, losses)
        lines += ["  <object>"] + (["    <type>robndbox</type>"] if rotated else [])
        lines += [
            f"    <name>{escape(instance.category)}</name>",
            f"    <pose>{'Unspecified' if rotated else escape(str(instance.extra.get('pose', pitch)))}</pose>",
            f"    <truncated>{int(bool(instance.truncated))}</truncated>",
            f"    <difficult>{int(bool(instance.difficult))}</difficult>",
        ]
        if instance.inserted:
            lines.append("    <inserted>1</inserted>")
        if rotated:
            tag = "robndbox"
            keys: Sequence[str] = ("cx", "cy", "w", "h", "angle")
            values: Sequence[float] = _oriented_numbers(instance, losses)
        else:
            tag = "bndbox"
            keys = ("xmin", "ymin", "xmax", "ymax")
            values = _truncated_box(instance.box_xyxy, (w, h), losses)
        lines.append(f"    <{tag}>")
        lines += [f"      <{k}>{v}</{k}>" for k, v in zip(keys, values, strict=True)]
        lines += [f"    </{tag}>", "  </object>"]
    return "\n".join([*lines, "</annotation>", ""])
