"""The forms of HIT-UAV's labels, and what each states about pictures and objects before it is united with others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import corners_of_cxcywha
from infrablend.core.capture import Capture
from infrablend.core.dataset import SPLITS, Category, Split
from infrablend.core.json_records import is_list
from infrablend.errors import DatasetError
from infrablend.formats.annotation_files import read_json, read_xml
from infrablend.formats.base import Match
from infrablend.formats.box_checks import OVERHANG_PX, is_near, overhang_px
from infrablend.formats.picture_facts import facts_from_name
from infrablend.formats.pictures.listing import PictureFolder, check_name, is_hidden
from infrablend.formats.records import Findings
from infrablend.formats.values import to_floats, to_size

NAME = "hit-uav"
Form = Literal["normal_json", "rotate_json", "normal_xml", "rotate_xml"]
# Also the order of precedence where several forms state the same thing.
FORMS: tuple[Form, ...] = ("normal_json", "rotate_json", "normal_xml", "rotate_xml")
OPTIONS = {"form": "read only this annotation form: " + ", ".join(FORMS)}
TAKES_TABLE = False  # pitch and altitude come from the file names
CATEGORIES: tuple[Category, ...] = (
    Category(0, "Person", "Person"),
    Category(1, "Car", "Vehicle"),
    Category(2, "Bicycle", "Vehicle"),
    Category(3, "OtherVehicle", "Vehicle"),
    Category(4, "DontCare", "DontCare", ignore=True),
)
"""HIT-UAV's own categories; the XML forms contain no list and imply these."""
DATABASE = "The pegasus Database"


def find_forms(root: Path) -> dict[Form, Path]:
    """Return the forms among the four subfolders, or the form of the folder itself, with their folders."""
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
    """Return the form of a folder from its content, or from its name if the content does not decide."""
    named: Form | None = next((f for f in FORMS if f == folder.name), None)
    for split in SPLITS:
        path = folder / "annotations" / f"{split}.json"
        if not path.is_file():
            continue
        try:
            top = read_json(path)
        except DatasetError:
            continue
        if not isinstance(top, dict) or not is_list(top.get("images")):
            continue
        image = next(iter(top["images"]), None)
        if image is not None and not (isinstance(image, dict) and "filename" in image):
            continue
        if is_list(top.get("annotation")):
            return "normal_json"
        objects = top.get("annotations")
        first = next(iter(objects), None) if is_list(objects) else None
        bbox = first.get("bbox") if isinstance(first, dict) else None
        if "scenarios" in top or (isinstance(bbox, list) and len(bbox) == 5):
            return "rotate_json"
    if named and named.endswith("_json") and _has_layout(folder, named):
        return named
    # XML: the first file decides whether this is HIT-UAV, the first object which of the two forms.
    ours = named is not None
    for path in xml_files(folder):
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
    """Return whether an XML file is HIT-UAV's rather than any VOC file, by its database or its file name."""
    database = (tree.findtext("source/database") or "").strip()
    return database == DATABASE or (database == "Unknown" and facts_from_name(path.name) is not None)


def xml_files(folder: Path) -> list[Path]:
    """Return the XML files of a form, sorted."""
    return sorted(p for p in (folder / "Annotations").glob("*.xml") if not is_hidden(p.name))


def detect(root: Path) -> Match:
    """Decide whether `root` is a HIT-UAV folder: the folder of one form, or one that contains some of the four."""
    forms = find_forms(root)
    if forms:
        return Match(NAME, True, f"contains the form{'s' if len(forms) > 1 else ''} {', '.join(forms)}")
    reason = "no normal_json, rotate_json, normal_xml or rotate_xml folder, and it is not laid out as one of them"
    return Match(NAME, False, reason)


@dataclass(slots=True)
class FormPicture:
    """One picture as one form describes it."""

    stem: str
    name: str
    path: Path | None
    split: Split
    size_wh: tuple[int, int] | None
    where: str
    capture: Capture = field(default_factory=Capture)
    source_id: int | str | None = None
    extra: dict[str, object] = field(default_factory=dict)
    objects: list[FormObject] = field(default_factory=list)


@dataclass(slots=True)
class FormObject:
    """One object as one form describes it: `raw` is the box in the file, `box` the box after clipping."""

    where: str
    category: str
    picture: FormPicture
    raw: tuple[float, ...] | None = None
    box: NDArray[np.float64] | None = None
    obb: tuple[float, ...] | None = None
    corners: NDArray[np.float64] | None = None
    truncated: bool | None = None
    difficult: bool | None = None
    inserted: bool = False
    source_id: int | str | None = None
    extra: dict[str, object] = field(default_factory=dict)

    def bounds(self) -> NDArray[np.float64]:
        """Return the axis-aligned bounds as this form states them, unclipped."""
        if self.corners is not None:
            return np.concatenate([self.corners.min(axis=0), self.corners.max(axis=0)])
        return np.array(self.raw, np.float64)


@dataclass(kw_only=True)
class FormData(Findings):
    """Everything that one form states; `counts` has its `files`."""

    form: Form
    pictures: dict[str, FormPicture] = field(default_factory=dict)
    categories: list[Category] = field(default_factory=list)
    extra: dict[str, object] = field(default_factory=dict)

    def find_picture(
        self, listing: PictureFolder, name: object, size: tuple[object, object], split: Split, where: str
    ) -> FormPicture | None:
        """Return a picture of a name, whose file may be missing; None, with a problem, if the name cannot be used."""
        path = None
        found = str(name)
        fault = check_name(name, where)
        if fault is None:
            found, path, fault = listing.find(found, where)
        if fault is not None:
            self.problems.append(fault)
            return None
        size_wh = to_size(*size)
        if size_wh is None:
            self.warn(where, "image-size-unknown", f"size {size[0]!r} x {size[1]!r}", "width and height in px")
        return FormPicture(found.rpartition(".")[0] or found, found, path, split, size_wh, where)

    def set_geometry(self, item: FormObject, fields: Sequence[str], written: object) -> None:
        """Check and store the numbers of one annotation, whose fields have these names; faulty ones are reported."""
        values = to_floats(written, len(fields))
        said = f"bbox {written!r}"[:120]
        todo = "correct the annotation"
        if values is None:
            self.add(item.where, "box-malformed", said, f"[{', '.join(fields)}]", todo)
        elif len(fields) == 4:
            x, y, x1, y1 = values
            item.raw = values if "xmax" in fields else (x, y, x + x1, y + y1)
            item.box = self.box(item.raw, item.picture.size_wh, item.where)
        elif not is_near(values):
            self.add(item.where, "box-not-finite", said, "finite numbers", todo)
        elif values[2] <= 0 or values[3] <= 0:
            self.add(item.where, "box-empty", said, "a width and height above 0", todo)
        else:
            item.obb = values

    def enter_objects(self, items: Iterable[FormObject]) -> None:
        """Give objects to their pictures: all with a box that can be used, oriented ones with their corners."""
        listed = list(items)
        turned = [i for i in listed if i.obb is not None]
        boxes = np.array([i.obb for i in turned], np.float64).reshape(-1, 5)
        for item, corners in zip(turned, corners_of_cxcywha(boxes), strict=True):
            if self._is_in_frame(item, corners):
                item.corners = corners
        for item in listed:
            if item.box is not None or item.corners is not None:
                item.picture.objects.append(item)

    def _is_in_frame(self, item: FormObject, corners: NDArray[np.float64]) -> bool:
        """Return whether a part of an oriented box is in its frame; report one that is outside or overhangs."""
        if item.picture.size_wh is None:
            return True
        w, h = item.picture.size_wh
        over = overhang_px(corners, (w, h))
        low, high = corners.min(axis=0), corners.max(axis=0)
        if over > 0 and (low[0] >= w or low[1] >= h or high[0] <= 0 or high[1] <= 0):
            found = f"oriented box {list(item.obb or ())} outside the frame"
            self.add(item.where, "box-outside", found, f"a box inside {w}x{h} px", "correct the annotation")
            return False
        if over > OVERHANG_PX:
            found = f"oriented box reaches {over:.3g} px out of the frame, kept"
            self.warn(item.where, "box-overhang", found, f"at most {OVERHANG_PX} px outside {w}x{h} px")
        return True
