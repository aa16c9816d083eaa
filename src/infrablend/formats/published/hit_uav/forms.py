"""HIT-UAV's four annotation forms: their names, where they are kept, and which of them a folder contains."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from infrablend.core.dataset import SPLITS, Category
from infrablend.core.json_records import is_list
from infrablend.errors import DatasetError
from infrablend.formats.annotation_files import read_json, read_xml
from infrablend.formats.base import Match
from infrablend.formats.picture_facts import facts_from_name
from infrablend.formats.pictures.listing import is_hidden

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
