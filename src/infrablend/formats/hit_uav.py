"""HIT-UAV (Suo et al. 2023): the four annotation forms of one set of pictures, read, united and written.

    normal_json/{train,val,test}/*.jpg   normal_json/annotations/{train,val,test}.json    axis-aligned, integers
    rotate_json/{train,val,test}/*.jpg   rotate_json/annotations/{train,val,test}.json    oriented, radians
    normal_xml/{Annotations,JPEGImages,ImageSets/Main}                                    VOC
    rotate_xml/{Annotations,JPEGImages,ImageSets/Main}                                    roLabelImg

Oriented boxes are `cx, cy, w, h, angle`, angle in radians in [0, pi], positive clockwise on screen, w the side along
the angle. The axis-aligned box of a form with integers is that of the oriented one, truncated toward zero.
"""

from __future__ import annotations

import json
import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, Literal
from xml.sax.saxutils import escape, quoteattr

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import corners_of_box, corners_of_cxcywha
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance, Split
from infrablend.core.files import link_or_copy, write_text
from infrablend.errors import DatasetError, Problem
from infrablend.formats.base import (
    OVERHANG_PX,
    Match,
    Written,
    category_ids,
    check_box,
    check_splits,
    few,
    is_ignored_name,
    is_near,
    number_ids,
    obb_from_corners,
    overhang_px,
    read_json,
    read_text,
    read_xml,
    require_size,
    sort_images,
    to_bool,
    to_floats,
    to_int,
    to_size,
)
from infrablend.formats.capture import Capture, facts_from_name, pitch_note
from infrablend.formats.pictures import PictureFolder, check_name, is_hidden

NAME = "hit-uav"

Form = Literal["normal_json", "rotate_json", "normal_xml", "rotate_xml"]
# Also the order in which forms are asked for what several of them hold.
FORMS: tuple[Form, ...] = ("normal_json", "rotate_json", "normal_xml", "rotate_xml")
OPTIONS = {"form": "read this annotation form alone: " + ", ".join(FORMS)}
TAKES_TABLE = False  # the file names say pitch and altitude

CATEGORIES: tuple[Category, ...] = (
    Category(0, "Person", "Person"),
    Category(1, "Car", "Vehicle"),
    Category(2, "Bicycle", "Vehicle"),
    Category(3, "OtherVehicle", "Vehicle"),
    Category(4, "DontCare", "DontCare", ignore=True),
)
"""HIT-UAV's own categories; the XML forms carry no list and mean these."""

# Digits written for an oriented box: coordinates and angles come back within 1e-6 px (corner at 1000 px).
_COORDINATE_DIGITS = 8
_ANGLE_DIGITS = 10
_DATABASE = "The pegasus Database"
_INFO = {"description": "HIT-UAV layout, written by InfraBlend"}


# -- what one form says, before it is united with the others ---------------------------------------------------


@dataclass(slots=True)
class _Object:
    """One object as one form describes it. `raw` is the box as it stands in the file, `box` after clipping."""

    where: str
    category: str
    raw: tuple[float, ...] | None = None
    box: NDArray[np.float64] | None = None
    obb: tuple[float, ...] | None = None
    corners: NDArray[np.float64] | None = None
    truncated: bool | None = None
    difficult: bool | None = None
    inserted: bool = False
    source_id: int | None = None
    extra: dict[str, Any] = field(default_factory=dict)

    def bounds(self) -> NDArray[np.float64]:
        """Axis-aligned bounds as this form knows them, unclipped."""
        if self.corners is not None:
            return np.concatenate([self.corners.min(axis=0), self.corners.max(axis=0)])
        return np.array(self.raw, np.float64)


@dataclass(slots=True)
class _Picture:
    """One picture as one form describes it."""

    stem: str
    name: str
    path: Path | None
    split: Split
    size_wh: tuple[int, int] | None
    where: str
    capture: Capture = field(default_factory=Capture)
    source_id: int | None = None
    extra: dict[str, Any] = field(default_factory=dict)
    objects: list[_Object] = field(default_factory=list)


@dataclass(slots=True)
class _FormData:
    """All that one form says."""

    form: Form
    pictures: dict[str, _Picture] = field(default_factory=dict)
    categories: list[Category] = field(default_factory=list)
    extra: dict[str, Any] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    files_read: int = 0

    def add(self, where: str, code: str, found: str, expected: str = "", todo: str = "") -> None:
        """Note an error: the item is skipped."""
        self.problems.append(Problem(where, code, found, expected, todo))

    def warn(self, where: str, code: str, found: str, expected: str = "", todo: str = "") -> None:
        """Note a warning: the item is kept."""
        self.problems.append(Problem(where, code, found, expected, todo, severity="warning"))


# -- which forms are there -------------------------------------------------------------------------------------


def find_forms(root: Path) -> dict[Form, Path]:
    """The forms in a folder: its own form if it is one, else those of its subfolders with the four names."""
    found: dict[Form, Path] = {}
    for form in FORMS:
        if _has_layout(root / form, form):
            found[form] = root / form
    if found:
        return found
    own = _own_form(root)
    return {own: root} if own else {}


def _has_layout(folder: Path, form: Form) -> bool:
    if form.endswith("_json"):
        return any((folder / "annotations" / f"{s}.json").is_file() for s in SPLITS)
    return (folder / "Annotations").is_dir()


def _own_form(folder: Path) -> Form | None:
    """The form of a folder whatever its name: told by the content, and by the name if that says nothing."""
    named: Form | None = next((f for f in FORMS if f == folder.name), None)
    for split in SPLITS:
        path = folder / "annotations" / f"{split}.json"
        if not path.is_file():
            continue
        try:
            top = read_json(path)
        except DatasetError:
            continue
        if not isinstance(top, dict) or not isinstance(top.get("images"), list):
            continue
        images = top["images"]
        if images and not (isinstance(images[0], dict) and "filename" in images[0]):
            continue
        if isinstance(top.get("annotation"), list):
            return "normal_json"
        first = next(iter(top.get("annotations") or []), None)
        bbox = first.get("bbox") if isinstance(first, dict) else None
        if "scenarios" in top or (isinstance(bbox, list) and len(bbox) == 5):
            return "rotate_json"
    if named and named.endswith("_json") and _has_layout(folder, named):
        return named
    # XML: the first file says whether it is HIT-UAV's at all, the first with an object which of the two.
    ours = named is not None
    for path in _xml_files(folder):
        tree, _ = read_xml(path, path.name)  # a broken file is reported when it is read
        if tree is None:
            continue
        if not ours and not _is_ours(tree, path):
            return None
        ours = True
        if tree.find("object/robndbox") is not None:
            return "rotate_xml"
        if tree.find("object/bndbox") is not None:
            return "normal_xml"
    return named if named and named.endswith("_xml") and (folder / "Annotations").is_dir() else None


def _is_ours(tree: Any, path: Path) -> bool:
    """Whether an XML file is HIT-UAV's and not any VOC file: by the database it names, or by the file's name."""
    database = (tree.findtext("source/database") or "").strip()
    return database == _DATABASE or (database == "Unknown" and facts_from_name(path.name) is not None)


def _xml_files(folder: Path) -> list[Path]:
    return sorted(p for p in (folder / "Annotations").glob("*.xml") if not is_hidden(p.name))


def detect(root: Path) -> Match:
    """Whether `root` is a HIT-UAV folder: one form's own folder, or one that holds some of the four."""
    forms = find_forms(root)
    if forms:
        return Match(NAME, True, f"holds the form{'s' if len(forms) > 1 else ''} {', '.join(forms)}")
    reason = "no normal_json, rotate_json, normal_xml or rotate_xml folder, and it is not laid out as one of them"
    return Match(NAME, False, reason)


# -- reading ---------------------------------------------------------------------------------------------------


def read(root: Path, *, splits: Iterable[str] | None = None, form: Form | None = None) -> Dataset:
    """Read a HIT-UAV folder: every form found is read, and they are united by file stem.

    Axis-aligned boxes come from normal_json (else normal_xml, else from the oriented box), unchanged; oriented boxes
    from rotate_json (else rotate_xml); truncated, difficult and pose from where they exist. Forms that disagree are
    reported as warnings and counted in `notes["disagreements"]`.

    Args:
        root: A folder with some of the four forms, or the folder of one.
        splits: The splits wanted; None reads all there are.
        form: Read this form alone.

    Raises:
        DatasetError: No form is there, the wanted one is not, or nothing can be read.
    """
    wanted = check_splits(splits)
    forms = find_forms(root)
    if not forms:
        raise DatasetError(f"{root}: no HIT-UAV folder", [Problem(str(root), "no-form", detect(root).reason)])
    if form is not None:
        if form not in FORMS:
            problem = Problem("form", "option-value", f"{form!r}", f"one of {', '.join(FORMS)}")
            raise DatasetError(f"{root}: no such form", [problem])
        if form not in forms:
            found, expected = f"the forms {', '.join(forms)}", f"the form {form}"
            raise DatasetError(
                f"{root}: form {form} is not there",
                [Problem(str(root), "no-form", found, expected, "leave out --form")],
            )
        forms = {form: forms[form]}

    data = [
        _read_json_form(root, f, folder, wanted) if f.endswith("_json") else _read_xml_form(root, f, folder, wanted)
        for f, folder in forms.items()
    ]
    problems = [p for d in data for p in d.problems]
    if not any(d.pictures for d in data):
        raise DatasetError(f"{root}: nothing to read in the splits {', '.join(wanted)}", few(problems))
    borrowed = _borrow_pictures(root, forms, data)
    categories = _unite_categories(data)
    images, notes, more = _unite(data)
    notes |= {"pictures_borrowed": borrowed} if borrowed else {}
    problems += more
    if not images:
        raise DatasetError(f"{root}: none of the annotated pictures is there", few(problems))
    for split in wanted if splits is not None else ():
        if not any(i.split == split for i in images):
            problems.append(Problem(str(root), "split-missing", f"no picture of split {split}", severity="warning"))
    extra: dict[str, Any] = {}
    for d in reversed(data):
        extra.update(d.extra)
    return Dataset(root, NAME, categories, sort_images(images), tuple(problems), notes, extra)


def _borrow_pictures(root: Path, forms: Mapping[Form, Path], data: Sequence[_FormData]) -> dict[str, int]:
    """Give pictures that lie in no form read the copy of a form beside it: HIT-UAV's four folders hold the same ones.

    Returns how many were taken from which folder.
    """
    have = {s for d in data for s, p in d.pictures.items() if p.path is not None}
    missing = [p for d in data for s, p in d.pictures.items() if s not in have]
    if not missing:
        return {}
    home = root if root not in forms.values() else root.parent
    known = (f for f in FORMS if f in forms or root not in forms.values() or root.name in FORMS)
    count: Counter[str] = Counter()
    for form in known:
        for part in (*SPLITS, "JPEGImages"):
            folder = home / form / part
            if not missing or not folder.is_dir():
                continue
            listing = PictureFolder.scan(folder)
            for p in missing:
                if part in (p.split, "JPEGImages"):
                    name, path, fault = listing.find(p.name, p.where)
                    if path is not None and fault is None:
                        p.name, p.path = name, path
                        count[f"{form}/{part}"] += 1
            missing = [p for p in missing if p.path is None]
    return dict(sorted(count.items()))


def _relative(root: Path, path: Path) -> str:
    return path.relative_to(root).as_posix()


def _read_json_form(root: Path, form: Form, folder: Path, splits: Sequence[Split]) -> _FormData:
    data = _FormData(form)
    for split in splits:
        path = folder / "annotations" / f"{split}.json"
        where = _relative(root, path)
        if not path.is_file():
            if (folder / split).is_dir():
                data.warn(where, "split-missing", "no annotation file for a folder of pictures", "a JSON file")
            continue
        try:
            top = read_json(path)
        except DatasetError as error:
            data.problems += [Problem(where, p.code, p.found, p.expected, p.todo) for p in error.problems]
            continue
        key = "annotation" if form == "normal_json" else "annotations"
        lists = {k: top.get(k) if isinstance(top, dict) else None for k in ("images", key, "categories")}
        bad = [k for k, v in lists.items() if not isinstance(v, list)]
        if bad:
            data.add(
                where, "annotation-layout", f"no list {', '.join(map(repr, bad))}", "HIT-UAV's keys", "use its files"
            )
            continue
        data.files_read += 1
        data.extra.update({k: v for k, v in top.items() if k not in lists})
        names = _read_categories(data, lists["categories"] or [], where)
        pictures = _read_json_images(data, lists["images"] or [], folder / split, split, where)
        _read_json_objects(data, lists[key] or [], pictures, names, where)
    return data


def _read_categories(data: _FormData, records: Sequence[Any], where: str) -> dict[int, str]:
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
            data.warn(
                where, "category-id", f"{name!r} has id {number}", f"id {known.id} as in another file; names count"
            )
    return names


def _read_json_images(
    data: _FormData, records: Sequence[Any], folder: Path, split: Split, where: str
) -> dict[int, _Picture]:
    """The pictures by image id; those that cannot be used are noted and left out."""
    listing = PictureFolder.scan(folder)
    pictures: dict[int, _Picture] = {}
    named: set[str] = set()
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
        named.add(name)
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
        if "depth" in record:
            extra["depth"] = record["depth"]
        if "source_id" in record:
            extra["source_id"] = record["source_id"]
        picture = _Picture(stem, name, path, split, size_wh, here, capture, number, extra)
        pictures[number] = picture
        data.pictures[stem] = picture
    unlisted = sorted(set(listing.by_name) - named)
    if unlisted:
        found = (
            f"{len(unlisted)} picture(s) in {folder.name}/ that no record names, left out: {', '.join(unlisted[:3])}"
        )
        data.warn(where, "image-unlisted", found + (" ..." if len(unlisted) > 3 else ""), "a record for every picture")
    return pictures


def _json_facts(data: _FormData, record: Mapping[str, Any], where: str) -> tuple[Capture, dict[str, Any]]:
    """Capture facts of a rotate_json record (strings in HIT-UAV), and fields kept for writing back."""
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
    data: _FormData, records: Sequence[Any], pictures: Mapping[int, _Picture], names: Mapping[int, str], where: str
) -> None:
    rotated = data.form == "rotate_json"
    seen: set[int] = set()
    found: list[_Object] = []
    owners: list[_Picture] = []
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
        item = _Object(here, names[category], source_id=number)
        if "difficult" in record:
            item.difficult = to_bool(record["difficult"])
            if item.difficult is None:
                data.warn(here, "flag-value", f"difficult {record['difficult']!r}, ignored", "true or false")
        item.inserted = record.get("inserted") is True
        if record.get("tight_box") is True:
            item.extra["tight_box"] = True
        if "source_id" in record:
            item.extra["source_id"] = record["source_id"]
        if _set_geometry(data, item, record.get("bbox"), rotated, picture.size_wh):
            found.append(item)
            owners.append(picture)
    _set_corners(data, found, owners)


def _set_geometry(data: _FormData, item: _Object, bbox: object, rotated: bool, size_wh: tuple[int, int] | None) -> bool:
    """Judge and store the numbers of one annotation; False if it has to be dropped."""
    values = to_floats(bbox, 5 if rotated else 4)
    if values is None:
        expected = "[cx, cy, w, h, angle]" if rotated else "[x, y, w, h]"
        data.add(item.where, "box-malformed", f"bbox {bbox!r}"[:120], expected, "correct the annotation")
        return False
    if not rotated:
        x, y, w, h = values
        item.raw = (x, y, x + w, y + h)
        item.box, problem = check_box(item.raw, size_wh, item.where)
        if problem is not None:
            data.problems.append(problem)
        return item.box is not None
    if not is_near(values):
        data.add(item.where, "box-not-finite", f"bbox {bbox!r}"[:120], "finite numbers", "correct the annotation")
        return False
    if values[2] <= 0 or values[3] <= 0:
        data.add(
            item.where, "box-empty", f"bbox {bbox!r}"[:120], "a width and height above 0", "correct the annotation"
        )
        return False
    item.obb = values
    return True


def _set_corners(data: _FormData, items: list[_Object], owners: list[_Picture]) -> None:
    """Corners of all oriented boxes at once, with a check that they lie in their frames; drops those outside."""
    turned = [(i, o) for i, o in zip(items, owners, strict=True) if i.obb is not None]
    if turned:
        corners = corners_of_cxcywha(np.array([i.obb for i, _ in turned], np.float64))
        low, high = corners.min(axis=1), corners.max(axis=1)
        for k, (item, owner) in enumerate(turned):
            if owner.size_wh is None:
                item.corners = corners[k]
                continue
            w, h = owner.size_wh
            inside = low[k, 0] >= 0 and low[k, 1] >= 0 and high[k, 0] <= w and high[k, 1] <= h
            if not inside:
                if low[k, 0] >= w or low[k, 1] >= h or high[k, 0] <= 0 or high[k, 1] <= 0:
                    found = f"oriented box {list(item.obb or ())} outside the frame"
                    data.add(item.where, "box-outside", found, f"a box inside {w}x{h} px", "correct the annotation")
                    continue
                over = overhang_px(corners[k], owner.size_wh)
                if over > OVERHANG_PX:
                    found = f"oriented box reaches {over:.3g} px out of the frame, kept"
                    data.warn(item.where, "box-overhang", found, f"at most {OVERHANG_PX} px outside {w}x{h} px")
            item.corners = corners[k]
    for item, owner in zip(items, owners, strict=True):
        if item.box is not None or item.corners is not None:
            owner.objects.append(item)


def _read_xml_form(root: Path, form: Form, folder: Path, splits: Sequence[Split]) -> _FormData:
    data = _FormData(form, categories=list(CATEGORIES))
    split_of = _read_image_sets(data, root, folder)
    listing = PictureFolder.scan(folder / "JPEGImages")
    unlisted: list[str] = []
    for path in _xml_files(folder):
        split = split_of.get(path.stem)
        if split is None:
            if split_of:
                unlisted.append(path.stem)
            split = "train"
        if split in splits:
            picture = _read_xml_file(data, root, path, listing, split)
            if picture is not None and picture.stem in data.pictures:
                data.add(picture.where, "image-duplicate", f"{picture.name!r} a second time", "each picture once")
            elif picture is not None:
                data.pictures[picture.stem] = picture
    where = _relative(root, folder) if folder != root else folder.name
    if unlisted:
        found = f"{len(unlisted)} file(s) in no list of ImageSets/Main, taken as train: {', '.join(unlisted[:3])}"
        data.warn(where, "split-unknown", found, "every stem in one list")
    missing = sorted(s for s, split in split_of.items() if split in splits and s not in data.pictures)
    missing = [s for s in missing if not (folder / "Annotations" / f"{s}.xml").is_file()]
    if missing:
        found = f"{len(missing)} stem(s) of ImageSets/Main have no XML file: {', '.join(missing[:3])}"
        data.warn(where, "annotation-missing", found, "an XML file for each")
    return data


def _read_image_sets(data: _FormData, root: Path, folder: Path) -> dict[str, Split]:
    """Split by stem; empty if there are no lists, and then all is train."""
    split_of: dict[str, Split] = {}
    there = {p.stem for p in _xml_files(folder)}
    sets = folder / "ImageSets" / "Main"
    for split in SPLITS:
        path = sets / f"{split}.txt"
        if not path.is_file():
            continue
        text, fault = read_text(path, _relative(root, path), "a list of stems")
        if fault is not None:
            data.problems.append(fault)
            continue
        # A stem a line, which may hold blanks.
        lines = (line.strip() for line in text.splitlines())
        for stem in (s for line in lines for s in ([line] if line in there else line.split())):
            if split_of.setdefault(stem, split) != split:
                found = f"{stem!r} is also in {split_of[stem]}, which counts"
                data.warn(_relative(root, path), "split-twice", found, "each stem in one list")
    if not split_of:
        data.warn(
            _relative(root, sets), "split-unknown", "no lists of splits; all is train", "train.txt, val.txt, test.txt"
        )
    return split_of


def _read_xml_file(data: _FormData, root: Path, path: Path, listing: PictureFolder, split: Split) -> _Picture | None:
    where = _relative(root, path)
    top, fault = read_xml(path, where)
    if fault is not None:
        data.problems.append(fault)
        return None
    data.files_read += 1
    if top is None or top.tag != "annotation":
        found = f"root element <{getattr(top, 'tag', '')}>"
        data.add(where, "annotation-layout", found, "<annotation>", "use HIT-UAV's files")
        return None

    def text(element: Any, key: str) -> str | None:
        value = element.findtext(key)
        return value.strip() if value is not None else None

    raw_name = text(top, "filename")
    fault = check_name(raw_name, where)
    if fault is not None:
        data.problems.append(fault)
        return None
    name, file, fault = listing.find(str(raw_name), where)
    if fault is not None:
        data.problems.append(fault)
        return None
    stem = name.rpartition(".")[0] or name
    size_wh = to_size(text(top, "size/width"), text(top, "size/height"))
    if size_wh is None:
        found = f"size {text(top, 'size/width')!r} x {text(top, 'size/height')!r}"
        data.warn(where, "image-size-unknown", found, "width and height in px")
    extra: dict[str, Any] = {}
    folder = text(top, "folder") or ""
    if data.form == "rotate_xml" and folder.isdigit():
        extra["date"] = folder
    picture = _Picture(stem, name, file, split, size_wh, where, extra=extra)
    items: list[_Object] = []
    for k, element in enumerate(top.findall("object")):
        here = f"{where}: object {k}"
        label = text(element, "name")
        if not label:
            data.add(here, "category-unknown", "no name", "a category's name", "correct the annotation")
            continue
        if all(c.name != label for c in data.categories):
            number = max(c.id for c in data.categories) + 1
            data.categories.append(Category(number, label, "", is_ignored_name(label)))
            data.warn(here, "category-unknown", f"{label!r}, taken as a new category", "one of HIT-UAV's five")
        item = _Object(here, label)
        for flag in ("truncated", "difficult"):
            value = text(element, flag)
            setattr(item, flag, to_bool(value))
            if value is not None and to_bool(value) is None:
                data.warn(here, "flag-value", f"{flag} {value!r}, ignored", "0 or 1")
        pose = text(element, "pose")
        if pose and pose != "Unspecified":
            item.extra["pose"] = pose
        item.inserted = to_bool(text(element, "inserted")) is True
        rotated = element.find("robndbox")
        if rotated is not None:
            bbox: object = [text(rotated, f) for f in ("cx", "cy", "w", "h", "angle")]
            good = _set_geometry(data, item, bbox, True, size_wh)
        else:
            corners = to_floats([text(element, f"bndbox/{f}") for f in ("xmin", "ymin", "xmax", "ymax")], 4)
            # x1 - x0 and back would round: the numbers of the file are kept.
            box = (
                None if corners is None else [corners[0], corners[1], corners[2] - corners[0], corners[3] - corners[1]]
            )
            good = _set_geometry(data, item, box, False, size_wh)
        if good:
            items.append(item)
    _set_corners(data, items, [picture] * len(items))
    return picture


# -- uniting ---------------------------------------------------------------------------------------------------


def _unite_categories(data: Sequence[_FormData]) -> tuple[Category, ...]:
    """The first form's categories, then names only others have, with their id or the next free one."""
    united: list[Category] = []
    for d in data:
        for c in d.categories:
            known = next((u for u in united if u.name == c.name), None)
            if known is None:
                number = c.id if all(u.id != c.id for u in united) else max(u.id for u in united) + 1
                united.append(Category(number, c.name, c.supercategory, c.ignore))
            elif c.supercategory and not known.supercategory:
                united[united.index(known)] = c if c.id == known.id else known
    return tuple(united)


def _unite(data: Sequence[_FormData]) -> tuple[list[ImageRecord], dict[str, Any], list[Problem]]:
    problems: list[Problem] = []
    counts: Counter[str] = Counter()
    stems = sorted({s for d in data for s in d.pictures})
    images: list[ImageRecord] = []
    used: Counter[str] = Counter()
    pitch_from: Counter[str] = Counter()
    for stem in stems:
        held = [(d.form, d.pictures[stem]) for d in data if stem in d.pictures]
        first = held[0][1]
        file = next((p for _, p in held if p.path is not None), None)
        if file is None:
            found = f"no picture {first.name!r}"
            problems.append(Problem(first.where, "image-missing", found, "a file in the picture folder", "restore it"))
            continue
        images.append(_unite_picture(stem, held, file, counts, problems))
        pitch = images[-1].pitch_deg is not None
        pitch_from["none" if not pitch else "file names" if facts_from_name(file.name) else "annotation"] += 1
        used.update(form for form, _ in held)
    for d in data:
        if used[d.form] < len(images) and d.pictures:
            found = f"{d.form} holds {used[d.form]} of {len(images)} pictures"
            problems.append(
                Problem(d.form, "form-partial", found, "the same pictures in every form", severity="warning")
            )
    # Which form a kind of label was taken from, in the order of trust.
    present = [d.form for d in data if d.pictures]
    notes: dict[str, Any] = {
        "forms": {
            d.form: {
                "files": d.files_read,
                "pictures": len(d.pictures),
                "objects": sum(len(p.objects) for p in d.pictures.values()),
            }
            for d in data
        },
        "boxes_from": [f for f in ("normal_json", "normal_xml", "rotate_json", "rotate_xml") if f in present],
        "oriented_from": [f for f in ("rotate_json", "rotate_xml") if f in present],
        "disagreements": {k: counts[k] for k in ("boxes", "oriented", "categories", "flags", "objects", "metadata")},
        "boxes_checked": counts["checked"],
        "derived_boxes_clipped": counts["derived_clipped"],
        "pitch": pitch_note(pitch_from),
        "without_pitch": sum(i.pitch_deg is None for i in images),
    }
    return images, notes, problems


def _unite_picture(
    stem: str, held: list[tuple[Form, _Picture]], file: _Picture, counts: Counter[str], problems: list[Problem]
) -> ImageRecord:
    first = held[0][1]

    def differ(kind: str, where: str, found: str, expected: str) -> None:
        counts[kind] += 1
        problems.append(Problem(where, f"forms-disagree-{kind}", found, expected, severity="warning"))

    facts = facts_from_name(file.name)
    capture = facts.capture if facts is not None else Capture()
    if facts is None:
        found = f"name {file.name!r} does not say pitch and altitude"
        problems.append(Problem(first.where, "name-grammar", found, "T_HHH_AA_W_NNNNN", severity="warning"))
    extra: dict[str, Any] = {}
    source_id: int | None = None
    size_wh: tuple[int, int] | None = None
    for _, p in held:
        for conflict in capture.conflicts(p.capture):
            differ(
                "metadata", p.where, f"{conflict} (file name or another form, and here)", "the same; the first counts"
            )
        capture = capture.over(p.capture)
        if p.split != first.split:
            differ("metadata", p.where, f"split {p.split}", f"{first.split}, which counts")
        if size_wh and p.size_wh and p.size_wh != size_wh:
            differ("metadata", p.where, f"size {p.size_wh}", f"{size_wh}, which counts")
        size_wh = size_wh or p.size_wh
        if source_id is not None and p.source_id is not None and p.source_id != source_id:
            differ("metadata", p.where, f"image id {p.source_id}", f"{source_id}, which counts")
        source_id = p.source_id if source_id is None else source_id
        for key, value in p.extra.items():
            if extra.setdefault(key, value) != value and key != "depth":
                differ("metadata", p.where, f"{key} {value!r}", f"{extra[key]!r}, which counts")
    if facts is not None:
        extra.setdefault("weather", str(facts.weather))
        extra["frame"] = facts.frame
    merged = list(first.objects)
    for form, p in held[1:]:
        merged = _unite_objects(merged, p, form, counts, differ)
    instances = tuple(_instance(o, size_wh, counts) for o in merged)
    return ImageRecord(
        id=stem.replace("/", "__"),
        path=file.path or Path(file.name),
        split=first.split,
        size_wh=size_wh,
        pitch_deg=capture.pitch_deg,
        altitude_m=capture.altitude_m,
        time_of_day=capture.time_of_day,
        instances=instances,
        source_id=source_id,
        extra=extra,
        file_name=file.name,
        sequence=_sequence(extra.get("date"), capture),
        captured=_iso_date(extra.get("date")),
    )


def _iso_date(date: object) -> str | None:
    """`2021-01-16` of HIT-UAV's `20210116`, or None."""
    try:
        return datetime.strptime(str(date), "%Y%m%d").date().isoformat()
    except ValueError:
        return None


def _sequence(date: object, capture: Capture) -> str | None:
    """What was flown in one go as far as the files tell: one date, time of day, altitude and perspective."""
    parts = [
        str(date) if date else "",
        capture.time_of_day or "",
        "" if capture.altitude_m is None else f"{capture.altitude_m:g}m",
        "" if capture.pitch_deg is None else f"{capture.pitch_deg:g}deg",
    ]
    return "-".join(p for p in parts if p) or None


def _same_place(a: _Object, b: _Object) -> bool:
    """True if two forms mean the same place: truncated toward zero, the bounds are equal."""
    if a.corners is not None and b.corners is not None:
        return bool(np.allclose(a.corners, b.corners, rtol=0, atol=1e-6))
    x, y = a.bounds(), b.bounds()
    return bool((np.trunc(x) == np.trunc(y)).all())


def _pairs(ours: Sequence[_Object], theirs: Sequence[_Object]) -> list[tuple[int | None, int | None]]:
    """Which of our objects is which of theirs: by annotation id, else by order, else by overlap.

    A long oriented box that lies across its upright one overlaps it little, and a box thinner than a pixel is widened:
    what overlap leaves over is paired where it stands at the same place of both lists and touches.
    """
    ids, other = [o.source_id for o in ours], [o.source_id for o in theirs]
    if (
        ids
        and other
        and None not in ids
        and None not in other
        and len(set(ids)) == len(ids)
        and len(set(other)) == len(other)
    ):
        place = {n: k for k, n in enumerate(other)}
        pairs: list[tuple[int | None, int | None]] = [(i, place.get(n)) for i, n in enumerate(ids)]
        return pairs + [(None, k) for k, n in enumerate(other) if n not in set(ids)]
    if len(ours) == len(theirs) and all(
        a.category == b.category and _same_place(a, b) for a, b in zip(ours, theirs, strict=True)
    ):
        return [(i, i) for i in range(len(ours))]
    ranked, touching = [], set()
    for i, a in enumerate(ours):
        x = a.bounds()
        for k, b in enumerate(theirs):
            y = b.bounds()
            w, h = min(x[2], y[2]) - max(x[0], y[0]), min(x[3], y[3]) - max(x[1], y[1])
            if i == k and len(ours) == len(theirs) and a.category == b.category and min(w, h) >= -1:
                touching.add(i)
            if w <= 0 or h <= 0:
                continue
            both = w * h
            iou = both / ((x[2] - x[0]) * (x[3] - x[1]) + (y[2] - y[0]) * (y[3] - y[1]) - both)
            if iou >= 0.5:
                ranked.append((a.category != b.category, -iou, i, k))
    match: dict[int, int] = {}
    for _, _, i, k in sorted(ranked):
        if i not in match and k not in match.values():
            match[i] = k
    taken = set(match.values())
    match |= {i: i for i in touching if i not in match and i not in taken}
    left = [k for k in range(len(theirs)) if k not in match.values()]
    return [(i, match.get(i)) for i in range(len(ours))] + [(None, k) for k in left]


def _unite_objects(
    ours: list[_Object], picture: _Picture, form: Form, counts: Counter[str], differ: Any
) -> list[_Object]:
    united: list[_Object] = []
    for i, k in _pairs(ours, picture.objects):
        if i is None and k is not None:
            differ("objects", picture.objects[k].where, "an object no form before has, kept", "the same objects")
            united.append(picture.objects[k])
            continue
        a = ours[i or 0]
        united.append(a)
        if k is None:
            differ("objects", a.where, f"an object {form} has not, kept", "the same objects in every form")
            continue
        b = picture.objects[k]
        if a.category != b.category:
            differ("categories", b.where, f"category {b.category}", f"{a.category}, which counts")
        # The oriented box of an object that InfraBlend made encloses empty corners; its bounds are not the box.
        if not (a.inserted or b.inserted or a.extra.get("tight_box")):
            counts["checked"] += 1
            if not _same_place(a, b):
                kind = "oriented" if a.corners is not None and b.corners is not None else "boxes"
                found = f"bounds {np.round(b.bounds(), 4).tolist()}"
                differ(kind, b.where, found, f"{np.round(a.bounds(), 4).tolist()} truncated; each form's own is kept")
        for flag in ("truncated", "difficult"):
            x, y = getattr(a, flag), getattr(b, flag)
            if x is not None and y is not None and x != y:
                differ("flags", b.where, f"{flag} {y}", f"{x}, which counts")
            setattr(a, flag, y if x is None else x)
        if a.box is None and b.box is not None:
            a.raw, a.box = b.raw, b.box
        if a.corners is None and b.corners is not None:
            a.obb, a.corners = b.obb, b.corners
        a.inserted = a.inserted or b.inserted
        a.source_id = b.source_id if a.source_id is None else a.source_id
        for key, value in b.extra.items():
            a.extra.setdefault(key, value)
    return united


def _instance(o: _Object, size_wh: tuple[int, int] | None, counts: Counter[str]) -> Instance:
    box = o.box
    if box is None:
        box = o.bounds()
        if size_wh is not None:
            clipped = np.clip(box, 0.0, np.array([*size_wh, *size_wh], np.float64))
            counts["derived_clipped"] += bool((clipped != box).any())
            box = clipped
    if o.obb is not None:
        # The five numbers of the file, so that writing gives them back to the last digit.
        o.extra["obb"] = o.obb
    return Instance(o.category, box, o.corners, None, None, o.truncated, o.difficult, o.inserted, o.source_id, o.extra)


# -- what is known of the published data set ----------------------------------------------------------------------

_DATES = (
    "20201217", "20210114", "20210115", "20210116", "20210118", "20210119", "20210120", "20210121", "20210123",
)  # fmt: skip
# On a basketball court; looked at one by one. The frames just before name the same players Person.
_PEOPLE_CALLED_CAR = (4053, 4054, 4057, 4062, 4063, 4064, 4073, 4077)


def remarks(dataset: Dataset) -> tuple[str, ...]:
    """What one should know of HIT-UAV itself (not of other data in its layout, such as the virtual world).

    The figures are of the published data set, all 2,898 images and 24,899 objects.
    """
    info = dataset.extra.get("info")
    authors = isinstance(info, dict) and info.get("description") == "PegasusDrone"
    if dataset.format != NAME or not (authors or any(i.extra.get("date") in _DATES for i in dataset.images)):
        return ()
    frames = {facts.frame: i for i in dataset.images if (facts := facts_from_name(i.name)) is not None}
    found: list[str] = []
    splits = {i.split for i in frames.values()}
    if {"train", "test"} <= splits:
        found.append(
            "HIT-UAV's published split is random over frames, not over scenes: train and test share near-identical "
            "neighbours. In the full data set 525 of the 579 test images have a training image at most 5 frame numbers "
            "away. It stays the default; `infrablend split` makes one without neighbours"
        )
    wrong = [i for n in _PEOPLE_CALLED_CAR if (i := frames.get(n)) and i.name.startswith("1_130_90_0_")]
    boxes = sum(o.category == "Car" and not o.inserted for i in wrong for o in i.instances)
    if boxes:
        found.append(
            f"{boxes} boxes labelled Car in {len(wrong)} picture(s) are people on a basketball court, who are not all "
            f"labelled either: {', '.join(i.name for i in wrong)}. They distort the sizes of Car at 130 m"
        )
    if any(o.category == "DontCare" for i in frames.values() for o in i.instances):
        found.append(
            "DontCare marks what cannot be told apart (groups of people, rows of bicycles): regions to ignore, no "
            "objects. Conversions found elsewhere treat it in at least four ways"
        )
    found.append(
        "altitude alone does not give the scale: pixels per metre differ by a factor of about 1.5 at the same nominal "
        "altitude. Calibrate on objects of known size"
    )
    return tuple(found)


# -- writing ---------------------------------------------------------------------------------------------------


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
    """Write images in some of HIT-UAV's forms, each in a folder of its name below `out`.

    Pictures are hard links of `ImageRecord.path` (copies where that is impossible), named by `ImageRecord.name`. Files
    are the same bytes for the same records. Losses are counted as `<form>.<kind>`, see `base.LOSSES`.

    Args:
        out: Folder; made if need be.
        images: With `size_wh` known.
        categories: With the ids to write.
        forms: Which forms.
        ids: `new` numbers images and annotations from 0 over all splits, as HIT-UAV does, and writes the source's id
            as `source_id`; `source` writes the source's own.
        extra: Top-level fields (`info`, `licenses`, ...), e.g. `Dataset.extra`.
        pictures: False writes annotations alone.

    Raises:
        OutputError: A file cannot be written.
        ValueError: A size, category or id is missing.
    """
    ordered = sort_images(images)
    texts, losses = native_files(ordered, categories, forms=forms, ids=ids, extra=extra)
    files = [write_text(out / name, text) for name, text in texts.items()]
    for form in forms if pictures else ():
        for image in ordered:
            folder = out / form / ("JPEGImages" if form.endswith("_xml") else image.split)
            files.append(link_or_copy(image.path, folder / image.name))
    return Written(tuple(files), losses)


def native_files(
    images: Sequence[ImageRecord],
    categories: Sequence[Category],
    *,
    forms: Sequence[Form] = ("normal_json", "rotate_json"),
    ids: Literal["source", "new"] = "new",
    extra: Mapping[str, Any] | None = None,
) -> tuple[dict[str, str], dict[str, int]]:
    """Text of every annotation file by POSIX path below the output folder, and the losses; see `write`."""
    ordered = sort_images(images)
    of_category = category_ids(categories)
    image_ids, object_ids = number_ids(ordered, ids, 0)
    numbered = list(zip(ordered, image_ids, object_ids, strict=True))
    new = ids == "new"
    losses: Counter[str] = Counter()
    texts: dict[str, str] = {}
    for form in forms:
        counted: Counter[str] = Counter()
        if form.endswith("_json"):
            for split in [s for s in SPLITS if any(i.split == s for i in ordered)]:
                part = [n for n in numbered if n[0].split == split]
                make = _normal_json if form == "normal_json" else _rotate_json
                top = make(part, categories, of_category, new, dict(extra or {}), counted)
                # The key order of the original; ASCII, as there.
                texts[f"{form}/annotations/{split}.json"] = json.dumps(top, allow_nan=False)
        else:
            texts.update(_xml_files_of(form, ordered, of_category, counted))
        losses.update({f"{form}.{k}": v for k, v in counted.items() if v})
    return texts, dict(sorted(losses.items()))


_Numbered = tuple[ImageRecord, int, list[int]]


def _count_losses(instance: Instance, form: Form, losses: Counter[str]) -> None:
    losses["mask_dropped"] += instance.mask is not None
    losses["visibility_dropped"] += instance.visibility is not None
    if form.endswith("_json"):
        losses["truncated_dropped"] += instance.truncated is True
    if form == "normal_json":
        losses["difficult_dropped"] += instance.difficult is True
    if form.startswith("normal"):
        losses["obb_dropped"] += instance.corners_xy is not None
    else:
        losses["obb_from_box"] += instance.corners_xy is None


def _truncated_box(box_xyxy: NDArray[np.float64], size_wh: tuple[int, int], losses: Counter[str]) -> list[int]:
    """xmin, ymin, xmax, ymax as HIT-UAV writes them: truncated toward zero, at least one pixel wide and high."""
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
    """cx, cy, w, h, angle: the source's own numbers if the corners are still theirs, else made from the corners."""
    corners = instance.corners_xy if instance.corners_xy is not None else corners_of_box(instance.box_xyxy)
    source = instance.extra.get("obb")
    if source is not None:
        again = corners_of_cxcywha(np.array([source], np.float64))[0]
        if np.allclose(again, corners, rtol=0, atol=1e-9):
            return [float(v) for v in source]
    numbers = obb_from_corners(corners)
    made = corners_of_cxcywha(np.array([numbers], np.float64))[0]
    apart = min(float(np.abs(np.roll(made, k, axis=0) - corners).max()) for k in (0, 2))
    losses["obb_not_rectangle"] += apart > 1e-3
    return [round(v, _COORDINATE_DIGITS) for v in numbers[:4]] + [round(numbers[4], _ANGLE_DIGITS)]


def _source_fields(item: ImageRecord | Instance, new: bool) -> dict[str, Any]:
    """`source_id` where ids are numbered anew, or as it was read."""
    if new and item.source_id is not None:
        return {"source_id": item.source_id}
    return {"source_id": item.extra["source_id"]} if "source_id" in item.extra else {}


def _marks(instance: Instance) -> dict[str, Any]:
    """Fields of ours: put in by InfraBlend; box drawn tightly, so not the oriented one's bounds as HIT-UAV's are."""
    marks = {"inserted": instance.inserted, "tight_box": bool(instance.extra.get("tight_box"))}
    return {name: True for name, is_set in marks.items() if is_set}


def _top_fields(extra: dict[str, Any], keys: Sequence[str], defaults: Mapping[str, Any]) -> dict[str, Any]:
    return {k: extra.get(k, defaults[k]) for k in keys}


_TOP: Mapping[str, Any] = {
    "info": _INFO,
    "licenses": [],
    "scenarios": [{"id": 0, "name": "day"}, {"id": 1, "name": "night"}],
    "weather": [{"id": 0, "name": "sunny"}, {"id": 1, "name": "rainy"}],
}


def _normal_json(
    numbered: Sequence[_Numbered],
    categories: Sequence[Category],
    of_category: Mapping[str, int],
    new: bool,
    extra: dict[str, Any],
    losses: Counter[str],
) -> dict[str, Any]:
    images, objects = [], []
    for image, image_id, object_ids in numbered:
        w, h = require_size(image)
        record: dict[str, Any] = {"filename": image.name, "height": h, "width": w, "id": image_id}
        record["date_captured"] = str(image.extra.get("date", ""))
        images.append(record | _source_fields(image, new))
        for instance, object_id in zip(image.instances, object_ids, strict=True):
            _count_losses(instance, "normal_json", losses)
            x0, y0, x1, y1 = _truncated_box(instance.box_xyxy, (w, h), losses)
            annotation: dict[str, Any] = {
                "segmentation": [[x0, y0, x1, y0, x1, y1, x0, y1]],
                "area": (x1 - x0) * (y1 - y0),
                "image_id": image_id,
                "bbox": [x0, y0, x1 - x0, y1 - y0],
                "category_id": of_category[instance.category],
                "id": object_id,
            }
            annotation |= _source_fields(instance, new)
            objects.append(annotation | _marks(instance))
    names = [{"supercategory": c.supercategory or c.name, "id": c.id, "name": c.name} for c in categories]
    top = _top_fields(extra, ("info", "licenses"), _TOP)
    return top | {"images": images, "categories": names, "annotation": objects}


def _rotate_json(
    numbered: Sequence[_Numbered],
    categories: Sequence[Category],
    of_category: Mapping[str, int],
    new: bool,
    extra: dict[str, Any],
    losses: Counter[str],
) -> dict[str, Any]:
    images, objects = [], []
    for image, image_id, object_ids in numbered:
        w, h = require_size(image)
        scenario = {"day": "0", "night": "1"}.get(str(image.time_of_day), "")
        record: dict[str, Any] = {
            "id": image_id,
            "width": w,
            "height": h,
            "depth": image.extra.get("depth", 1),
            "filename": image.name,
            "scenario": scenario,
            "weather": str(image.extra.get("weather", "")),
            "perspective": "" if image.pitch_deg is None else f"{image.pitch_deg:.10g}",
            "altitude": "" if image.altitude_m is None else f"{image.altitude_m:.10g}",
            "date": str(image.extra.get("date", "")),
        }
        images.append(record | _source_fields(image, new))
        for instance, object_id in zip(image.instances, object_ids, strict=True):
            _count_losses(instance, "rotate_json", losses)
            annotation: dict[str, Any] = {
                "id": object_id,
                "image_id": image_id,
                "category_id": of_category[instance.category],
                "difficult": bool(instance.difficult),
                "bbox": _oriented_numbers(instance, losses),
            }
            annotation |= _source_fields(instance, new)
            objects.append(annotation | _marks(instance))
    names = [{"id": c.id, "name": c.name} for c in categories]
    top = _top_fields(extra, ("info", "licenses", "scenarios", "weather"), _TOP)
    return top | {"images": images, "categories": names, "annotations": objects}


def _xml_files_of(
    form: Form, images: Sequence[ImageRecord], of_category: Mapping[str, int], losses: Counter[str]
) -> dict[str, str]:
    """One VOC or roLabelImg file per picture and the lists of splits."""
    texts: dict[str, str] = {}
    stems: dict[str, list[str]] = defaultdict(list)
    for image in images:
        if "/" in image.name:
            raise ValueError(f"{image.id}: the XML forms are flat, {image.name!r} lies in a folder")
        stem = image.name.rpartition(".")[0]
        stems[image.split].append(stem)
        texts[f"{form}/Annotations/{stem}.xml"] = _xml_text(form, image, stem, of_category, losses)
    stems["trainval"] = stems["train"] + stems["val"]
    for split in (*SPLITS, "trainval"):
        texts[f"{form}/ImageSets/Main/{split}.txt"] = "".join(f"{s}\n" for s in stems[split])
    return texts


def _xml_text(form: Form, image: ImageRecord, stem: str, of_category: Mapping[str, int], losses: Counter[str]) -> str:
    w, h = require_size(image)
    rotated = form == "rotate_xml"
    folder, name = (str(image.extra.get("date", "")), stem) if rotated else ("./JPEGImages", image.name)
    lines = [
        f"<annotation verified={quoteattr('no')}>" if rotated else "<annotation>",
        f"  <folder>{escape(folder)}</folder>",
        f"  <filename>{escape(name)}</filename>",
        "  <source>",
        f"    <database>{'Unknown' if rotated else _DATABASE}</database>",
        "  </source>",
        "  <size>",
        f"    <width>{w}</width>",
        f"    <height>{h}</height>",
        f"    <depth>{image.extra.get('depth', 1)}</depth>",
        "  </size>",
        "  <segmented>0</segmented>",
    ]
    pitch = "Unspecified" if image.pitch_deg is None else f"{image.pitch_deg:.10g}"
    for instance in image.instances:
        if instance.category not in of_category:
            raise ValueError(f"{image.id}: category {instance.category!r} is not in the list of categories")
        _count_losses(instance, form, losses)
        lines += ["  <object>"] + (["    <type>robndbox</type>"] if rotated else [])
        lines += [
            f"    <name>{escape(instance.category)}</name>",
            f"    <pose>{'Unspecified' if rotated else instance.extra.get('pose', pitch)}</pose>",
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
