"""Read HIT-UAV's `normal_xml` (VOC) and `rotate_xml` (roLabelImg)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from infrablend.core.dataset import SPLITS, Category, Split
from infrablend.formats.annotation_files import child_text
from infrablend.formats.base import is_ignored_name
from infrablend.formats.pictures.listing import PictureFolder, check_name
from infrablend.formats.published.hit_uav.form_records import (
    FormData,
    FormObject,
    FormPicture,
    set_corners,
    set_geometry,
)
from infrablend.formats.published.hit_uav.forms import CATEGORIES, Form, xml_files
from infrablend.formats.values import to_bool, to_floats, to_size


def read_xml_form(root: Path, form: Form, folder: Path, splits: Sequence[Split]) -> FormData:
    """Return everything that the XML files of one form state about the pictures of some splits."""
    data = FormData(root, form=form, categories=list(CATEGORIES))
    split_of = _read_image_sets(data, folder)
    listing = PictureFolder.scan(folder / "JPEGImages")
    unlisted: list[str] = []
    for path in xml_files(folder):
        split = split_of.get(path.stem)
        if split is None:
            if split_of:
                unlisted.append(path.stem)
            split = "train"
        if split in splits:
            picture = _read_xml_file(data, path, listing, split)
            if picture is not None and picture.stem in data.pictures:
                data.add(picture.where, "image-duplicate", f"{picture.name!r} a second time", "each picture once")
            elif picture is not None:
                data.pictures[picture.stem] = picture
    where = data.place(folder) if folder != root else folder.name
    if unlisted:
        found = f"{len(unlisted)} file(s) in no list of ImageSets/Main, taken as train: {', '.join(unlisted[:3])}"
        data.warn(where, "split-unknown", found, "every stem in one list")
    missing = sorted(s for s, split in split_of.items() if split in splits and s not in data.pictures)
    missing = [s for s in missing if not (folder / "Annotations" / f"{s}.xml").is_file()]
    if missing:
        found = f"{len(missing)} stem(s) of ImageSets/Main have no XML file: {', '.join(missing[:3])}"
        data.warn(where, "annotation-missing", found, "an XML file for each")
    return data


def _read_image_sets(data: FormData, folder: Path) -> dict[str, Split]:
    """Return the split per stem; empty if there are no lists, which makes every picture train."""
    split_of: dict[str, Split] = {}
    there = {p.stem for p in xml_files(folder)}
    sets = folder / "ImageSets" / "Main"
    for split in SPLITS:
        path = sets / f"{split}.txt"
        text = data.text(path, "a list of stems") if path.is_file() else ""
        # One stem per line; a stem may contain blanks.
        lines = (line.strip() for line in (text or "").splitlines())
        for stem in (s for line in lines for s in ([line] if line in there else line.split())):
            if split_of.setdefault(stem, split) != split:
                found = f"{stem!r} is also in {split_of[stem]}, which counts"
                data.warn(data.place(path), "split-twice", found, "each stem in one list")
    if not split_of:
        expected = "train.txt, val.txt, test.txt"
        data.warn(data.place(sets), "split-unknown", "no lists of splits; all is train", expected)
    return split_of


def _read_xml_file(data: FormData, path: Path, listing: PictureFolder, split: Split) -> FormPicture | None:
    where = data.place(path)
    top = data.xml(path)
    if top is None:
        return None
    data.counts["files"] += 1
    if top.tag != "annotation":
        data.add(where, "annotation-layout", f"root element <{top.tag}>", "<annotation>", "use HIT-UAV's files")
        return None
    raw_name = child_text(top, "filename")
    fault = check_name(raw_name, where)
    name = str(raw_name)
    file = None
    if fault is None:
        name, file, fault = listing.find(name, where)
    if fault is not None:
        data.problems.append(fault)
        return None
    stem = name.rpartition(".")[0] or name
    size_wh = to_size(child_text(top, "size/width"), child_text(top, "size/height"))
    if size_wh is None:
        found = f"size {child_text(top, 'size/width')!r} x {child_text(top, 'size/height')!r}"
        data.warn(where, "image-size-unknown", found, "width and height in px")
    extra: dict[str, Any] = {}
    folder = child_text(top, "folder") or ""
    if data.form == "rotate_xml" and folder.isdigit():
        extra["date"] = folder
    picture = FormPicture(stem, name, file, split, size_wh, where, extra=extra)
    read = (_read_object(data, e, f"{where}: object {k}", size_wh) for k, e in enumerate(top.findall("object")))
    items = [item for item in read if item is not None]
    set_corners(data, items, [picture] * len(items))
    return picture


def _read_object(data: FormData, element: Any, where: str, size_wh: tuple[int, int] | None) -> FormObject | None:
    """Return one object, and enter a new category; None, with a problem, if it has no name or no usable box."""
    label = child_text(element, "name")
    if not label:
        data.add(where, "category-unknown", "no name", "a category's name", "correct the annotation")
        return None
    if all(c.name != label for c in data.categories):
        number = max(c.id for c in data.categories) + 1
        data.categories.append(Category(number, label, "", is_ignored_name(label)))
        data.warn(where, "category-unknown", f"{label!r}, taken as a new category", "one of HIT-UAV's five")
    item = FormObject(where, label)
    for flag in ("truncated", "difficult"):
        value = child_text(element, flag)
        setattr(item, flag, to_bool(value))
        if value is not None and to_bool(value) is None:
            data.warn(where, "flag-value", f"{flag} {value!r}, ignored", "0 or 1")
    pose = child_text(element, "pose")
    if pose and pose != "Unspecified":
        item.extra["pose"] = pose
    item.inserted = to_bool(child_text(element, "inserted")) is True
    rotated = element.find("robndbox")
    if rotated is not None:
        box: object = [child_text(rotated, f) for f in ("cx", "cy", "w", "h", "angle")]
    else:
        edges = to_floats([child_text(element, f"bndbox/{f}") for f in ("xmin", "ymin", "xmax", "ymax")], 4)
        # `set_geometry` takes width and height.
        box = None if edges is None else [edges[0], edges[1], edges[2] - edges[0], edges[3] - edges[1]]
    return item if set_geometry(data, item, box, rotated is not None, size_wh) else None
