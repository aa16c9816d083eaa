"""Read HIT-UAV's `normal_xml` (VOC) and `rotate_xml` (roLabelImg), whose elements `labels.voc` reads."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree.ElementTree import Element

from infrablend.core.dataset import Category, Split
from infrablend.formats.annotation_files import child_text
from infrablend.formats.base import is_ignored_name
from infrablend.formats.labels import voc
from infrablend.formats.pictures.listing import PictureFolder
from infrablend.formats.published.hit_uav.form_records import FormData, FormObject, FormPicture
from infrablend.formats.published.hit_uav.forms import CATEGORIES, Form, xml_files
from infrablend.formats.values import to_bool


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
