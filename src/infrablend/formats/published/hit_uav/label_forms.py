"""Read HIT-UAV's four forms of labels: two as JSON, two as XML.

`normal_json` has axis-aligned integers, `rotate_json` oriented boxes in radians; `normal_xml` is VOC and `rotate_xml`
roLabelImg, whose elements `labels.voc` reads.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from xml.etree.ElementTree import Element

from infrablend.core.capture import Capture, TimeOfDay
from infrablend.core.dataset import Category, Split
from infrablend.core.json_records import is_list
from infrablend.formats.annotation_files import child_text, too_long
from infrablend.formats.base import is_ignored_name
from infrablend.formats.labels import voc
from infrablend.formats.labels.voc import TURNED_FIELDS
from infrablend.formats.pictures.listing import PictureFolder
from infrablend.formats.published.hit_uav.form_records import (
    CATEGORIES,
    Form,
    FormData,
    FormObject,
    FormPicture,
    xml_files,
)
from infrablend.formats.values import to_bool, to_int, to_key, to_number

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
) -> dict[int | str, FormPicture]:
    """Return the pictures by image id; unusable ones are reported and left out."""
    listing = PictureFolder.scan(folder)
    pictures: dict[int | str, FormPicture] = {}
    for i, record in enumerate(records):
        if not isinstance(record, dict):
            data.add(f"{where}: image {i}", "image-malformed", repr(record)[:80], "an image record")
            continue
        here = f"{where}: image {record.get('id', i)}"
        size = (record.get("width"), record.get("height"))
        picture = data.find_picture(listing, record.get("filename"), size, split, here)
        if picture is None:
            continue
        number = to_key(record.get("id"))
        if number is None:
            data.add(here, "image-malformed", f"id {record.get('id')!r}", "a whole number or a text")
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
    data: FormData,
    records: Iterable[object],
    pictures: Mapping[int | str, FormPicture],
    names: Mapping[int, str],
    where: str,
) -> None:
    fields = TURNED_FIELDS if data.form == "rotate_json" else ("x", "y", "w", "h")
    seen: set[int | str] = set()
    items: list[FormObject] = []
    for i, record in enumerate(records):
        if not isinstance(record, dict):
            data.add(f"{where}: annotation {i}", "annotation-malformed", repr(record)[:80], "an annotation record")
            continue
        number = to_key(record.get("id"))
        here = f"{where}: annotation {i if number is None else number}"
        if number is None:
            data.warn(here, "annotation-id", f"id {record.get('id')!r}", "a whole number")
        elif number in seen:
            data.warn(here, "annotation-duplicate", f"id {number} a second time", "each id once")
        else:
            seen.add(number)
        image, category = to_key(record.get("image_id")), to_int(record.get("category_id"))
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


def read_xml_form(root: Path, form: Form, folder: Path, splits: Sequence[Split]) -> FormData:
    """Return everything that the XML files of one form state about the pictures of some splits."""
    data = FormData(root, form=form, categories=list(CATEGORIES))
    files = xml_files(folder)
    stems = {path.stem for path in files}
    sets = folder / "ImageSets" / "Main"
    split_of = voc.read_lists(data, sets, stems)
    if not split_of:
        expected = "train.txt, val.txt, test.txt"
        data.warn(data.place(sets), "split-unknown", "no lists of splits; all is train", expected)
    listing = PictureFolder.scan(folder / "JPEGImages")
    for path in files:
        split = split_of.get(path.stem, "train")
        picture = _read_xml_file(data, path, listing, split) if split in splits else None
        if picture is not None and picture.stem in data.pictures:
            data.add(picture.where, "image-duplicate", f"{picture.name!r} a second time", "each picture once")
        elif picture is not None:
            data.pictures[picture.stem] = picture
    where = data.place(folder) if folder != root else folder.name
    unlisted = [path.stem for path in files if split_of and path.stem not in split_of]
    if unlisted:
        found = f"{len(unlisted)} file(s) in no list of ImageSets/Main, taken as train: {', '.join(unlisted[:3])}"
        data.warn(where, "split-unknown", found, "every stem in one list")
    missing = sorted(s for s, split in split_of.items() if split in splits and s not in data.pictures)
    missing = [s for s in missing if not (folder / "Annotations" / f"{s}.xml").is_file()]
    if missing:
        found = f"{len(missing)} stem(s) of ImageSets/Main have no XML file: {', '.join(missing[:3])}"
        data.warn(where, "annotation-missing", found, "an XML file for each")
    return data


def _read_xml_file(data: FormData, path: Path, listing: PictureFolder, split: Split) -> FormPicture | None:
    where = data.place(path)
    top = data.xml(path)
    if top is None:
        return None
    data.counts["files"] += 1
    if top.tag != "annotation":
        data.add(where, "annotation-layout", f"root element <{top.tag}>", "<annotation>", "use HIT-UAV's files")
        return None
    size = (child_text(top, "size/width"), child_text(top, "size/height"))
    picture = data.find_picture(listing, child_text(top, "filename"), size, split, where)
    if picture is None:
        return None
    folder = child_text(top, "folder") or ""
    if data.form == "rotate_xml" and folder.isdigit():
        picture.extra["date"] = folder
    read = (_read_object(data, e, f"{where}: object {k}", picture) for k, e in enumerate(top.findall("object")))
    data.enter_objects(item for item in read if item is not None)
    return picture


def _read_object(data: FormData, element: Element, where: str, picture: FormPicture) -> FormObject | None:
    """Return one object, and enter a new category; None, with a problem, if it has no name."""
    label = child_text(element, "name")
    if not label:
        data.add(where, "category-unknown", "no name", "a category's name", "correct the annotation")
        return None
    if all(c.name != label for c in data.categories):
        number = max(c.id for c in data.categories) + 1
        data.categories.append(Category(number, label, "", is_ignored_name(label)))
        data.warn(where, "category-unknown", f"{label!r}, taken as a new category", "one of HIT-UAV's five")
    item = FormObject(where, label, picture)
    item.truncated = voc.read_flag(data, element, "truncated", where)
    item.difficult = voc.read_flag(data, element, "difficult", where)
    item.inserted = to_bool(child_text(element, "inserted")) is True
    pose = voc.read_pose(element)
    if pose is not None:
        item.extra["pose"] = pose
    data.set_geometry(item, *voc.box_fields(element))
    return item
