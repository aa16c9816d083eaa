"""Read HIT-UAV's `normal_xml` (VOC) and `rotate_xml` (roLabelImg)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from infrablend.core.dataset import SPLITS, Category, Split
from infrablend.formats.annotation_files import read_text, read_xml
from infrablend.formats.base import is_ignored_name
from infrablend.formats.hit_uav.forms import CATEGORIES, Form, xml_files
from infrablend.formats.hit_uav.records import FormData, FormObject, FormPicture, relative_to, set_corners, set_geometry
from infrablend.formats.pictures import PictureFolder, check_name
from infrablend.formats.values import to_bool, to_floats, to_size


def read_xml_form(root: Path, form: Form, folder: Path, splits: Sequence[Split]) -> FormData:
    """Return everything that the XML files of one form state about the pictures of some splits."""
    data = FormData(form, categories=list(CATEGORIES))
    split_of = _read_image_sets(data, root, folder)
    listing = PictureFolder.scan(folder / "JPEGImages")
    unlisted: list[str] = []
    for path in xml_files(folder):
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
    where = relative_to(root, folder) if folder != root else folder.name
    if unlisted:
        found = f"{len(unlisted)} file(s) in no list of ImageSets/Main, taken as train: {', '.join(unlisted[:3])}"
        data.warn(where, "split-unknown", found, "every stem in one list")
    missing = sorted(s for s, split in split_of.items() if split in splits and s not in data.pictures)
    missing = [s for s in missing if not (folder / "Annotations" / f"{s}.xml").is_file()]
    if missing:
        found = f"{len(missing)} stem(s) of ImageSets/Main have no XML file: {', '.join(missing[:3])}"
        data.warn(where, "annotation-missing", found, "an XML file for each")
    return data


def _read_image_sets(data: FormData, root: Path, folder: Path) -> dict[str, Split]:
    """Return the split per stem; empty if there are no lists, which makes every picture train."""
    split_of: dict[str, Split] = {}
    there = {p.stem for p in xml_files(folder)}
    sets = folder / "ImageSets" / "Main"
    for split in SPLITS:
        path = sets / f"{split}.txt"
        if not path.is_file():
            continue
        text, fault = read_text(path, relative_to(root, path), "a list of stems")
        if fault is not None:
            data.problems.append(fault)
            continue
        # One stem per line; a stem may contain blanks.
        lines = (line.strip() for line in text.splitlines())
        for stem in (s for line in lines for s in ([line] if line in there else line.split())):
            if split_of.setdefault(stem, split) != split:
                found = f"{stem!r} is also in {split_of[stem]}, which counts"
                data.warn(relative_to(root, path), "split-twice", found, "each stem in one list")
    if not split_of:
        data.warn(
            relative_to(root, sets), "split-unknown", "no lists of splits; all is train", "train.txt, val.txt, test.txt"
        )
    return split_of


def _read_xml_file(data: FormData, root: Path, path: Path, listing: PictureFolder, split: Split) -> FormPicture | None:
    where = relative_to(root, path)
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
    picture = FormPicture(stem, name, file, split, size_wh, where, extra=extra)
    items: list[FormObject] = []
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
        item = FormObject(here, label)
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
            good = set_geometry(data, item, bbox, True, size_wh)
        else:
            corners = to_floats([text(element, f"bndbox/{f}") for f in ("xmin", "ymin", "xmax", "ymax")], 4)
            # set_geometry takes width and height.
            box = (
                None if corners is None else [corners[0], corners[1], corners[2] - corners[0], corners[3] - corners[1]]
            )
            good = set_geometry(data, item, box, False, size_wh)
        if good:
            items.append(item)
    set_corners(data, items, [picture] * len(items))
    return picture
