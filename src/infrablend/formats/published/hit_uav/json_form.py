"""Read HIT-UAV's `normal_json` (axis-aligned integers) and `rotate_json` (oriented boxes in radians)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Split
from infrablend.core.json_records import is_list
from infrablend.errors import Problem
from infrablend.formats.annotation_files import too_long
from infrablend.formats.base import is_ignored_name
from infrablend.formats.pictures.listing import PictureFolder, check_name
from infrablend.formats.published.hit_uav.form_records import (
    FormData,
    FormObject,
    FormPicture,
    set_corners,
    set_geometry,
)
from infrablend.formats.published.hit_uav.forms import Form
from infrablend.formats.values import to_bool, to_floats, to_int, to_size


def read_json_form(root: Path, form: Form, folder: Path, splits: Sequence[Split]) -> FormData:
    """Return everything that the JSON files of one form state about the pictures of some splits."""
    data = FormData(root, form=form)
    for split in splits:
        path = folder / "annotations" / f"{split}.json"
        where = data.place(path)
        if not path.is_file():
            if (folder / split).is_dir():
                data.warn(where, "split-missing", "no annotation file for a folder of pictures", "a JSON file")
            continue
        top = data.json(path)
        if top is None:
            continue
        key = "annotation" if form == "normal_json" else "annotations"
        lists = {k: top.get(k) for k in ("images", key, "categories")}
        bad = [k for k, v in lists.items() if not is_list(v)]
        if bad:
            found = f"no list {', '.join(map(repr, bad))}"
            data.add(where, "annotation-layout", found, "HIT-UAV's keys", "use its files")
            continue
        data.counts["files"] += 1
        for name, value in top.items():
            if name not in lists and (problem := too_long(where, name, value)):
                data.problems.append(problem)
            elif name not in lists:
                data.extra[name] = value
        names = _read_categories(data, lists["categories"] or [], where)
        pictures = _read_json_images(data, lists["images"] or [], folder / split, split, where)
        _read_json_objects(data, lists[key] or [], pictures, names, where)
    return data


def _read_categories(data: FormData, records: Iterable[Any], where: str) -> dict[int, str]:
    names: dict[int, str] = {}
    for i, record in enumerate(records):
        number = to_int(record.get("id")) if isinstance(record, dict) else None
        name = record.get("name") if isinstance(record, dict) else None
        if number is None or not isinstance(name, str) or not name or number in names:
            data.add(f"{where}: category {i}", "category-malformed", f"{record!r}", "a new id and a name")
            continue
        names[number] = name
        category = Category(number, name, str(record.get("supercategory") or ""), is_ignored_name(name))
        known = next((c for c in data.categories if c.name == name), None)
        if known is None:
            data.categories.append(category)
        elif known.id != number:
            expected = f"id {known.id} as in another file; names count"
            data.warn(where, "category-id", f"{name!r} has id {number}", expected)
    return names


def _read_json_images(
    data: FormData, records: Iterable[Any], folder: Path, split: Split, where: str
) -> dict[int, FormPicture]:
    """Return the pictures by image id; unusable ones are reported and left out."""
    listing = PictureFolder.scan(folder)
    pictures: dict[int, FormPicture] = {}
    for i, record in enumerate(records):
        if not isinstance(record, dict):
            data.add(f"{where}: image {i}", "image-malformed", repr(record)[:80], "an image record")
            continue
        here = f"{where}: image {record.get('id', i)}"
        raw_name = record.get("filename")
        fault = check_name(raw_name, here)
        number = to_int(record.get("id"))
        if fault is None and number is None:
            fault = Problem(here, "image-malformed", f"id {record.get('id')!r}", "a whole number")
        name = str(raw_name)
        if fault is None:
            name, path, fault = listing.find(name, here)
        if fault is not None or number is None:
            data.problems += [fault] if fault else []
            continue
        stem = name.rpartition(".")[0] or name
        if number in pictures or stem in data.pictures:
            data.add(here, "image-duplicate", f"{name!r}, id {number}, a second time", "each picture once")
            continue
        size_wh = to_size(record.get("width"), record.get("height"))
        if size_wh is None:
            found = f"size {record.get('width')!r} x {record.get('height')!r}"
            data.warn(here, "image-size-unknown", found, "width and height in px")
        capture, extra = _json_facts(data, record, here)
        extra |= {k: record[k] for k in ("depth", "source_id") if k in record}
        picture = FormPicture(stem, name, path, split, size_wh, here, capture, number, extra)
        pictures[number] = picture
        data.pictures[stem] = picture
    return pictures


def _json_facts(data: FormData, record: Mapping[str, Any], where: str) -> tuple[Capture, dict[str, Any]]:
    """Return when and how a picture was taken (strings in HIT-UAV's rotate_json), and fields to write back."""
    extra: dict[str, Any] = {}
    for key in ("date_captured", "date"):
        if record.get(key):
            extra["date"] = str(record[key])
    if record.get("weather") not in (None, ""):
        extra["weather"] = str(record["weather"])
    numbers: dict[str, float | None] = {}
    for key, low, high in (("perspective", -90.0, 90.0), ("altitude", 0.0, 1e5)):
        raw = record.get(key)
        values = None if raw in (None, "") else to_floats([raw], 1)
        good = values is not None and low <= values[0] <= high
        numbers[key] = values[0] if good and values is not None else None
        if raw not in (None, "") and not good:
            data.warn(where, "metadata-value", f"{key} {raw!r}, ignored", f"a number from {low:g} to {high:g}")
    scenario = to_int(record.get("scenario"))
    if record.get("scenario") not in (None, "") and scenario not in (0, 1):
        data.warn(where, "metadata-value", f"scenario {record.get('scenario')!r}, ignored", "0 (day) or 1 (night)")
    of_day: Literal["day", "night"] | None = "day" if scenario == 0 else "night" if scenario == 1 else None
    return Capture(numbers["perspective"], numbers["altitude"], of_day), extra


def _read_json_objects(
    data: FormData, records: Iterable[Any], pictures: Mapping[int, FormPicture], names: Mapping[int, str], where: str
) -> None:
    rotated = data.form == "rotate_json"
    seen: set[int] = set()
    found: list[FormObject] = []
    owners: list[FormPicture] = []
    for i, record in enumerate(records):
        if not isinstance(record, dict):
            data.add(f"{where}: annotation {i}", "annotation-malformed", repr(record)[:80], "an annotation record")
            continue
        number = record.get("id")
        number = number if type(number) is int else to_int(number)
        here = f"{where}: annotation {i if number is None else number}"
        if number is None:
            data.warn(here, "annotation-id", f"id {record.get('id')!r}", "a whole number")
        elif number in seen:
            data.warn(here, "annotation-duplicate", f"id {number} a second time", "each id once")
        else:
            seen.add(number)
        picture = pictures.get(image) if (image := to_int(record.get("image_id"))) is not None else None
        if picture is None:
            data.add(here, "image-unknown", f"image_id {record.get('image_id')!r}", "the id of a picture that is read")
            continue
        category = to_int(record.get("category_id"))
        if category is None or category not in names:
            found_ = f"category_id {record.get('category_id')!r}"
            data.add(here, "category-unknown", found_, f"one of {sorted(names)}", "add it to categories")
            continue
        item = FormObject(here, names[category], source_id=number)
        if "difficult" in record:
            item.difficult = to_bool(record["difficult"])
            if item.difficult is None:
                data.warn(here, "flag-value", f"difficult {record['difficult']!r}, ignored", "true or false")
        item.inserted = record.get("inserted") is True
        if record.get("tight_box") is True:
            item.extra["tight_box"] = True
        if "source_id" in record:
            item.extra["source_id"] = record["source_id"]
        if set_geometry(data, item, record.get("bbox"), rotated, picture.size_wh):
            found.append(item)
            owners.append(picture)
    set_corners(data, found, owners)
