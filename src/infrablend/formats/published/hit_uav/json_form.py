"""Read HIT-UAV's `normal_json` (axis-aligned integers) and `rotate_json` (oriented boxes in radians)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from infrablend.core.capture import Capture, TimeOfDay
from infrablend.core.dataset import Category, Split
from infrablend.core.json_records import is_list
from infrablend.formats.annotation_files import too_long
from infrablend.formats.base import is_ignored_name
from infrablend.formats.labels.voc import TURNED_FIELDS
from infrablend.formats.pictures.listing import PictureFolder
from infrablend.formats.published.hit_uav.form_records import FormData, FormObject, FormPicture
from infrablend.formats.published.hit_uav.forms import Form
from infrablend.formats.values import to_bool, to_int, to_number

_TIMES: Mapping[int | None, TimeOfDay] = {0: "day", 1: "night"}


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


def _read_categories(data: FormData, records: Iterable[object], where: str) -> dict[int, str]:
    names: dict[int, str] = {}
    for i, record in enumerate(records):
        fields = record if isinstance(record, dict) else {}
        number = to_int(fields.get("id"))
        name = fields.get("name")
        if number is None or not isinstance(name, str) or not name or number in names:
            data.add(f"{where}: category {i}", "category-malformed", f"{record!r}", "a new id and a name")
            continue
        names[number] = name
        known = next((c for c in data.categories if c.name == name), None)
        if known is None:
            above = str(fields.get("supercategory") or "")
            data.categories.append(Category(number, name, above, is_ignored_name(name)))
        elif known.id != number:
            expected = f"id {known.id} as in another file; names count"
            data.warn(where, "category-id", f"{name!r} has id {number}", expected)
    return names


def _read_json_images(
    data: FormData, records: Iterable[object], folder: Path, split: Split, where: str
) -> dict[int, FormPicture]:
    """Return the pictures by image id; unusable ones are reported and left out."""
    listing = PictureFolder.scan(folder)
    pictures: dict[int, FormPicture] = {}
    for i, record in enumerate(records):
        if not isinstance(record, dict):
            data.add(f"{where}: image {i}", "image-malformed", repr(record)[:80], "an image record")
            continue
        here = f"{where}: image {record.get('id', i)}"
        size = (record.get("width"), record.get("height"))
        picture = data.find_picture(listing, record.get("filename"), size, split, here)
        if picture is None:
            continue
        number = to_int(record.get("id"))
        if number is None:
            data.add(here, "image-malformed", f"id {record.get('id')!r}", "a whole number")
        elif number in pictures or picture.stem in data.pictures:
            data.add(here, "image-duplicate", f"{picture.name!r}, id {number}, a second time", "each picture once")
        else:
            picture.source_id = number
            picture.capture, picture.extra = _json_facts(data, record, here)
            picture.extra |= {k: record[k] for k in ("depth", "source_id") if k in record}
            pictures[number] = picture
            data.pictures[picture.stem] = picture
    return pictures


def _json_facts(data: FormData, record: Mapping[str, object], where: str) -> tuple[Capture, dict[str, object]]:
    """Return when and how a picture was taken (strings in HIT-UAV's rotate_json), and fields to write back."""
    extra: dict[str, object] = {}
    date = record.get("date") or record.get("date_captured")
    if date:
        extra["date"] = str(date)
    if record.get("weather") not in (None, ""):
        extra["weather"] = str(record["weather"])
    pitch = _number_in(data, record, "perspective", -90.0, 90.0, where)
    altitude = _number_in(data, record, "altitude", 0.0, 1e5, where)
    scenario = record.get("scenario")
    of_day = _TIMES.get(to_int(scenario))
    if scenario not in (None, "") and of_day is None:
        data.warn(where, "metadata-value", f"scenario {scenario!r}, ignored", "0 (day) or 1 (night)")
    return Capture(pitch, altitude, of_day), extra


def _number_in(
    data: FormData, record: Mapping[str, object], key: str, low: float, high: float, where: str
) -> float | None:
    """Return a number of a record in a range; None without it, or with a warning if it is something else."""
    raw = record.get(key)
    if raw in (None, ""):
        return None
    number = to_number(raw)
    if number is not None and low <= number <= high:
        return number
    data.warn(where, "metadata-value", f"{key} {raw!r}, ignored", f"a number from {low:g} to {high:g}")
    return None


def _read_json_objects(
    data: FormData, records: Iterable[object], pictures: Mapping[int, FormPicture], names: Mapping[int, str], where: str
) -> None:
    fields = TURNED_FIELDS if data.form == "rotate_json" else ("x", "y", "w", "h")
    seen: set[int] = set()
    items: list[FormObject] = []
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
        image, category = to_int(record.get("image_id")), to_int(record.get("category_id"))
        picture = None if image is None else pictures.get(image)
        name = None if category is None else names.get(category)
        if picture is None:
            data.add(here, "image-unknown", f"image_id {record.get('image_id')!r}", "the id of a picture that is read")
        elif name is None:
            found = f"category_id {record.get('category_id')!r}"
            data.add(here, "category-unknown", found, f"one of {sorted(names)}", "add it to categories")
        else:
            item = FormObject(here, name, picture, source_id=number)
            _set_marks(data, item, record)
            data.set_geometry(item, fields, record.get("bbox"))
            items.append(item)
    data.enter_objects(items)


def _set_marks(data: FormData, item: FormObject, record: Mapping[str, object]) -> None:
    if "difficult" in record:
        item.difficult = to_bool(record["difficult"])
        if item.difficult is None:
            data.warn(item.where, "flag-value", f"difficult {record['difficult']!r}, ignored", "true or false")
    item.inserted = record.get("inserted") is True
    if record.get("tight_box") is True:
        item.extra["tight_box"] = True
    if "source_id" in record:
        item.extra["source_id"] = record["source_id"]
