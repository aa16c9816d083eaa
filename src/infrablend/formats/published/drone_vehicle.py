"""DroneVehicle (Sun et al. 2022): vehicles from a drone, thermal and visible pictures in pairs, oriented boxes.

    <split>/<split>imgr/NNNNN.jpg   <split>/<split>labelr/NNNNN.xml     thermal
    <split>/<split>img/NNNNN.jpg    <split>/<split>label/NNNNN.xml      visible light

Pictures are 840 x 712 px with a white border of 100 px on every side; labels count from the corner of the border. The
reader takes the border off both.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import box_of_points, clockwise, corners_of_box
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance, Split
from infrablend.errors import DatasetError
from infrablend.formats.annotation_files import leave_out
from infrablend.formats.base import Match, check_splits, require_options
from infrablend.formats.box_checks import is_near
from infrablend.formats.pictures import derived
from infrablend.formats.pictures.listing import is_picture_name
from infrablend.formats.published.sidecar import Fault, LabelledFolder, Stated, checked, if_file
from infrablend.formats.records import KEEP_OR_DROP, Findings
from infrablend.formats.values import to_floats

NAME = "drone-vehicle"
OPTIONS = {
    "modality": "pictures to read: ir (the default), rgb or both",
    "border": "crop (the default) or keep the white border of 100 px",
    "unlabelled": "keep or drop pictures without a label file; drop is the default",
}
CATEGORIES = tuple(Category(k, n) for k, n in enumerate(("car", "truck", "bus", "van", "freight car")))
SPELLINGS = {
    "feright car": "freight car", "feright_car": "freight car", "feright": "freight car", "freight_car": "freight car",
    "truvk": "truck",
}  # fmt: skip
"""Spellings in the published files, and the class they mean."""
BORDER_PX = 100
WITH_BORDER_WH = (840, 712)

_KINDS = {"ir": ("imgr", "labelr"), "rgb": ("img", "label")}
_CORNERS = ("x1", "y1", "x2", "y2", "x3", "y3", "x4", "y4")


def _folders(root: Path) -> dict[Split, Path]:
    """Return the folder of each split with its pictures, directly in the dataset or in a folder of the same name."""
    found: dict[Split, Path] = {}
    for split in SPLITS:
        for folder in (root / split, root / split / split):
            if any((folder / f"{split}{pictures}").is_dir() for pictures, _ in _KINDS.values()):
                found.setdefault(split, folder)
    return found


def detect(root: Path) -> Match:
    """Decide whether `root` contains a split with pictures in `<split>img` or `<split>imgr`."""
    folders = _folders(root)
    if not folders:
        return Match(NAME, False, "no train/trainimgr, val/valimgr or test/testimgr, nor the like for visible light")
    return Match(NAME, True, f"pictures of {', '.join(folders)} in folders such as {next(iter(folders))}imgr")


def read(
    root: Path,
    *,
    splits: Iterable[str] | None = None,
    metadata: Path | None = None,
    modality: str = "ir",
    border: str = "crop",
    unlabelled: str = "drop",
) -> Dataset:
    """Read pictures and oriented boxes; crops are PNG files in the cache folder.

    Records of visible light have `modality` `visible` in their `extra`.

    Raises:
        DatasetError: An option has a wrong value, or no picture can be read.
    """
    require_options(
        root, modality=(modality, ("ir", "rgb", "both")), border=(border, ("crop", "keep")),
        unlabelled=(unlabelled, KEEP_OR_DROP),
    )  # fmt: skip
    wanted = check_splits(splits)
    found = Findings(root)
    unknown: Counter[str] = Counter()
    records: list[ImageRecord] = []
    for split, folder in _folders(root).items():
        if split not in wanted:
            continue
        for kind in _KINDS:
            if modality in (kind, "both"):
                records += _read_split(found, split, folder, kind, border == "crop", unlabelled, unknown)
            else:
                leave_out(sorted((folder / f"{split}{_KINDS[kind][1]}").glob("*.xml")))
    counts = found.counts
    if unknown:
        text = "names that are no class, left out: " + ", ".join(f"{n!r} {k}" for n, k in sorted(unknown.items()))
        found.warn(root.name, "category-unknown", text, f"one of {', '.join(c.name for c in CATEGORIES)}")
    if counts["box-clipped"]:
        text = f"{counts['box-clipped']} object(s) that reach out of the picture; their boxes are clipped to it"
        found.warn(root.name, "box-clipped", text, "boxes inside")
    counts |= Counter(unknown=unknown.total(), clipped=counts["box-clipped"], outside=counts["box-outside"])
    keys = ("pictures", "objects", "read", "clipped", "outside", "unknown", "unlabelled", "cropped", "pairs")
    notes = {"labels": NAME, "modality": modality, "rows": found.rows(*keys)}
    return found.dataset(NAME, records, CATEGORIES, notes, metadata=metadata, splits=wanted)


def _read_split(
    found: Findings, split: Split, folder: Path, kind: str, crop: bool, unlabelled: str, unknown: Counter[str]
) -> Iterator[ImageRecord]:
    """Yield the pictures of one kind in a split; `unknown` counts names that are no class."""
    pictures, labels = (folder / f"{split}{suffix}" for suffix in _KINDS[kind])
    twins = folder / f"{split}{_KINDS['rgb' if kind == 'ir' else 'ir'][0]}"
    names = sorted(p.name for p in pictures.iterdir() if is_picture_name(p.name)) if pictures.is_dir() else []
    labelled = LabelledFolder(
        where=pictures.name,
        pictures={name: pictures / name for name in names},
        label_of=lambda picture: if_file(labels / f"{picture.stem}.xml"),
        missing="no label file",
        split=split,
        is_visible=lambda _: kind == "rgb",
        look=partial(_look, crop),
    )
    for record in labelled.read(found, unlabelled, partial(_read_label, pictures, unknown)):
        extra = dict(record.extra)
        if (twins / record.name).is_file():
            found.counts["pairs"] += 1
            extra["twin"] = found.place(twins / record.name)
        yield replace(record, extra=extra, file_name=f"{pictures.name}/{record.path.name}")
    stems = {Path(n).stem for n in names}
    for label in sorted(labels.glob("*.xml")) if labels.is_dir() else ():
        if label.stem not in stems and not label.name.startswith("."):
            found.add(found.place(label), "image-missing", "no picture of that name", "restore it")


def _look(crop: bool, found: Findings, path: Path) -> tuple[Path, tuple[int, int] | None]:
    """Return the picture to read, perhaps without its border, and its size; None if it cannot be read."""
    found.counts["pictures"] += 1
    where = found.place(path)
    size_wh = found.size(path, where)
    if size_wh != WITH_BORDER_WH or not crop:
        return path, size_wh
    try:
        made = derived.crop(path, BORDER_PX)
    except DatasetError as error:
        found.add_all(error.problems, where)
        return path, None
    found.counts["cropped"] += 1
    return made, (WITH_BORDER_WH[0] - 2 * BORDER_PX, WITH_BORDER_WH[1] - 2 * BORDER_PX)


def _read_label(
    pictures: Path, unknown: Counter[str], found: Findings, picture: Path, label: Path, size_wh: tuple[int, int]
) -> list[Instance] | None:
    top = found.xml(label)
    if top is None:
        return None
    elements = top.findall("object")
    found.counts["objects"] += len(elements)
    where = found.place(label)
    offset = 0 if picture.parent == pictures else BORDER_PX
    entries = ((f"{where}: object {n}", _stated(unknown, e, offset)) for n, e in enumerate(elements, 1))
    # Boxes that are clipped are counted, not reported one by one.
    return checked(found, entries, size_wh, silent=("box-clipped",))


def _stated(unknown: Counter[str], element: Element, offset: int) -> Stated:
    written = " ".join((element.findtext("name") or "").split())
    name = SPELLINGS.get(written.lower(), written.lower())
    if name not in {c.name for c in CATEGORIES}:
        unknown[written[:40]] += 1
        return None
    corners = _corners(element)
    if corners is None:
        expected = "a polygon of four corners x1, y1 to x4, y4, or a bndbox"
        return Fault("annotation-layout", "no box", expected, "correct the annotation")
    corners = clockwise(corners - offset)
    return Instance(name, box_of_points(corners), corners)


def _corners(element: Element) -> NDArray[np.float64] | None:
    """Return the corners of an object, from its polygon or else its box; None if it has neither."""
    for tag, keys in (("polygon", _CORNERS), ("bndbox", ("xmin", "ymin", "xmax", "ymax"))):
        place = element.find(tag)
        numbers = None if place is None else to_floats([place.findtext(k) for k in keys], len(keys))
        if numbers is not None and is_near(numbers):
            values = np.array(numbers, np.float64)
            return values.reshape(4, 2) if tag == "polygon" else corners_of_box(values)
    return None
