"""Write images and labels in HIT-UAV's four forms."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import corners_of_box, corners_of_cxcywha
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance
from infrablend.core.files import link_or_copy, write_chunks
from infrablend.core.json_stream import SPACED, Streamed, json_chunks
from infrablend.formats.base import (
    category_ids,
    ignored_by_class,
    in_order,
    number_ids,
    require_size,
    split_parts,
    unmarked_regions,
)
from infrablend.formats.box_checks import is_rectangle, obb_from_corners
from infrablend.formats.hit_uav.forms import DATABASE, Form
from infrablend.formats.losses import Written
from infrablend.formats.occlusion import loses_occlusion

# Digits written for an oriented box, enough to read corners back within 1e-6 px at 1000 px.
_COORDINATE_DIGITS = 8
_ANGLE_DIGITS = 10
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
    extra: Mapping[str, Any] | None = None,
    pictures: bool = True,
) -> Written:
    """Write images in some of HIT-UAV's forms, each in a folder named after the form below `out`.

    Pictures are hard links to `ImageRecord.path` (copies where that is impossible), named by `ImageRecord.name`. Equal
    records give equal bytes. Losses are counted as `<form>.<kind>`, see `losses.LOSSES`.

    Args:
        out: Output folder, created if necessary.
        images: Images with known `size_wh`.
        categories: Categories with the ids to write.
        forms: Forms to write.
        ids: `new` numbers images and annotations from 0 over all splits, as HIT-UAV does, and keeps the source's id
            as `source_id`; `source` writes the source's ids.
        extra: Top-level fields (`info`, `licenses`, ...), e.g. `Dataset.extra`.
        pictures: False writes only annotations.

    Raises:
        OutputError: A file cannot be written.
        ValueError: A size, category or id is missing.
    """
    ordered = in_order(images)
    texts = native_chunks(ordered, categories, forms=forms, ids=ids, extra=extra)
    files = [write_chunks(out / name, chunks) for name, chunks in texts.files]
    for form in forms if pictures else ():
        for image in ordered:
            folder = out / form / ("JPEGImages" if form.endswith("_xml") else image.split)
            files.append(link_or_copy(image.path, folder / image.name))
    return Written(tuple(files), texts.losses)


def native_files(
    images: Sequence[ImageRecord],
    categories: Sequence[Category],
    *,
    forms: Sequence[Form] = ("normal_json", "rotate_json"),
    ids: Literal["source", "new"] = "new",
    extra: Mapping[str, Any] | None = None,
) -> tuple[dict[str, str], dict[str, int]]:
    """Return the text of every annotation file by POSIX path below the output folder, and the losses; see `write`."""
    texts = native_chunks(images, categories, forms=forms, ids=ids, extra=extra)
    whole = {name: "".join(chunks) for name, chunks in texts.files}
    return whole, texts.losses


@dataclass(frozen=True)
class NativeTexts:
    """Annotation files that are composed one after the other, in pieces.

    Attributes:
        files: POSIX path below the output folder and text of each file.
        counted: Losses per form, complete once all texts are composed.
    """

    files: Iterator[tuple[str, Iterable[str]]]
    counted: Mapping[Form, Counter[str]]

    @property
    def losses(self) -> dict[str, int]:
        """Losses so far, by `<form>.<kind>`."""
        return dict(sorted((f"{form}.{k}", v) for form, counts in self.counted.items() for k, v in counts.items() if v))


def native_chunks(
    images: Sequence[ImageRecord],
    categories: Sequence[Category],
    *,
    forms: Sequence[Form] = ("normal_json", "rotate_json"),
    ids: Literal["source", "new"] = "new",
    extra: Mapping[str, Any] | None = None,
) -> NativeTexts:
    """Return every annotation file in pieces, and the losses; see `write`."""
    ordered = in_order(images)
    counted: dict[Form, Counter[str]] = {form: Counter() for form in forms}
    numbers = number_ids(ordered, ids, 0)

    def files() -> Iterator[tuple[str, Iterable[str]]]:
        for form in forms:
            if form.endswith("_json"):
                parts = split_parts(ordered)
                start = 0
                for split, part in parts.items():
                    end = start + len(part)
                    numbered = _Numbered(part, numbers[0][start:end], numbers[1][start:end])
                    top = _json_file(form, numbered, categories, ids == "new", extra or {}, counted[form])
                    # ASCII, as in the original.
                    chunks = json_chunks(top, counted[form], separators=SPACED, sort_keys=False)
                    yield f"{form}/annotations/{split}.json", chunks
                    start = end
            else:
                yield from _xml_texts(form, ordered, categories, counted[form])

    return NativeTexts(files(), counted)


@dataclass(frozen=True)
class _Numbered:
    """Images with their ids and those of their objects."""

    images: Sequence[ImageRecord]
    image_ids: Sequence[int]
    object_ids: Sequence[Sequence[int]]

    def __iter__(self) -> Iterator[tuple[ImageRecord, int, Sequence[int]]]:
        """Yield each image with its id and the ids of its objects."""
        return zip(self.images, self.image_ids, self.object_ids, strict=True)


def _count_losses(instance: Instance, form: Form, unsaid: Collection[str], losses: Counter[str]) -> None:
    losses["ignore_as_class"] += unmarked_regions([instance], unsaid)
    losses["mask_dropped"] += instance.mask is not None
    losses["visibility_dropped"] += instance.visibility is not None
    losses["occlusion_dropped"] += loses_occlusion(instance)
    if form.endswith("_json"):
        losses["truncated_dropped"] += instance.truncated is True
    if form == "normal_json":
        losses["difficult_dropped"] += instance.difficult is True
    if form.startswith("normal"):
        losses["obb_dropped"] += instance.corners_xy is not None
    else:
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


def _source_fields(item: ImageRecord | Instance, new: bool) -> dict[str, Any]:
    """Return the field `source_id`: the source's id if ids are new, or the field that was read."""
    if new and item.source_id is not None:
        return {"source_id": item.source_id}
    return {"source_id": item.extra["source_id"]} if "source_id" in item.extra else {}


def _marks(instance: Instance) -> dict[str, Any]:
    """Return InfraBlend's own fields: inserted; box drawn tightly, unlike HIT-UAV's bounds of the oriented box."""
    marks = {"inserted": instance.inserted, "tight_box": bool(instance.extra.get("tight_box"))}
    return {name: True for name, is_set in marks.items() if is_set}


_TOP: Mapping[str, Any] = {
    "info": _INFO,
    "licenses": [],
    "scenarios": [{"id": 0, "name": "day"}, {"id": 1, "name": "night"}],
    "weather": [{"id": 0, "name": "sunny"}, {"id": 1, "name": "rainy"}],
}


def _json_file(
    form: Form,
    numbered: _Numbered,
    categories: Sequence[Category],
    new: bool,
    extra: Mapping[str, Any],
    losses: Counter[str],
) -> dict[str, Any]:
    """Return the content of a JSON file, with keys in the order of the original."""
    normal = form == "normal_json"
    of_category = category_ids(categories)
    unsaid = ignored_by_class(categories)
    image_record = _normal_image if normal else _rotate_image
    images = Streamed(image_record(image, n) | _source_fields(image, new) for image, n, _ in numbered)

    def annotations() -> Iterator[dict[str, Any]]:
        for image, image_id, object_ids in numbered:
            for instance, object_id in zip(image.instances, object_ids, strict=True):
                _count_losses(instance, form, unsaid, losses)
                ids = {"id": object_id, "image_id": image_id, "category_id": of_category[instance.category]}
                if normal:
                    annotation = _normal_object(_truncated_box(instance.box_xyxy, require_size(image), losses), ids)
                else:
                    difficult = bool(instance.difficult)
                    annotation = {**ids, "difficult": difficult, "bbox": _oriented_numbers(instance, losses)}
                yield annotation | _source_fields(instance, new) | _marks(instance)

    objects = Streamed(annotations())
    if normal:
        names = [{"supercategory": c.supercategory or c.name, "id": c.id, "name": c.name} for c in categories]
        top = {k: extra.get(k, _TOP[k]) for k in ("info", "licenses")}
        return top | {"images": images, "categories": names, "annotation": objects}
    names = [{"id": c.id, "name": c.name} for c in categories]
    top = {k: extra.get(k, v) for k, v in _TOP.items()}
    return top | {"images": images, "categories": names, "annotations": objects}


def _normal_image(image: ImageRecord, image_id: int) -> dict[str, Any]:
    w, h = require_size(image)
    date = str(image.extra.get("date", ""))
    return {"filename": image.name, "height": h, "width": w, "id": image_id, "date_captured": date}


def _rotate_image(image: ImageRecord, image_id: int) -> dict[str, Any]:
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


def _normal_object(box_xyxy: Sequence[int], ids: Mapping[str, int]) -> dict[str, Any]:
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
    known, unsaid = category_ids(categories), ignored_by_class(categories)
    stems: dict[str, list[str]] = defaultdict(list)
    for image in images:
        if "/" in image.name:
            raise ValueError(f"{image.id}: the XML forms are flat, but {image.name!r} is in a folder")
        stem = image.name.rpartition(".")[0]
        stems[image.split].append(stem)
        yield f"{form}/Annotations/{stem}.xml", (_xml_text(form, image, stem, known, unsaid, losses),)
    stems["trainval"] = stems["train"] + stems["val"]
    for split in (*SPLITS, "trainval"):
        yield f"{form}/ImageSets/Main/{split}.txt", (f"{s}\n" for s in stems[split])


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
    for instance in image.instances:
        if instance.category not in known:
            raise ValueError(f"{image.id}: category {instance.category!r} is not in the list of categories")
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
