"""DroneVehicle (Sun et al. 2022): vehicles from a drone, thermal and visible pictures in pairs, oriented boxes.

    <split>/<split>imgr/NNNNN.jpg   <split>/<split>labelr/NNNNN.xml     thermal
    <split>/<split>img/NNNNN.jpg    <split>/<split>label/NNNNN.xml      visible light

Pictures are 840 x 712 px with a white border of 100 px on every side; labels count from the corner of the border. The
reader takes the border off both.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import box_of_points, clockwise, corners_of_box
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance, Split
from infrablend.errors import DatasetError, Problem
from infrablend.formats import derived
from infrablend.formats.annotation_files import read_xml
from infrablend.formats.base import Match, check_splits, require_options
from infrablend.formats.box_checks import check_box, is_near
from infrablend.formats.pictures import is_picture_name, read_size
from infrablend.formats.records import KEEP_OR_DROP, make_dataset, unlabelled_problems
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


@dataclass
class _Reading:
    """State of reading one dataset.

    Attributes:
        root: Folder of the dataset.
        crop: Whether to take the white border off.
        problems: Problems found so far.
        counts: Numbers of pictures and objects.
        names: Number of objects with a name that is no class.
    """

    root: Path
    crop: bool
    problems: list[Problem] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    names: Counter[str] = field(default_factory=Counter)


def read(
    root: Path,
    *,
    splits: Iterable[str] | None = None,
    metadata: Path | None = None,
    modality: str = "ir",
    border: str = "crop",
    unlabelled: str = "drop",
) -> Dataset:
    """Read pictures and oriented boxes.

    Args:
        root: Folder with `train`, `val` and `test`, or some of them.
        splits: Splits to read; None reads all.
        metadata: Table of pitch and altitude; None uses any `metadata.csv` or `.json`.
        modality: `ir`, `rgb` or `both`; records of visible light have `modality` `visible` in their `extra`.
        border: Whether to `crop` or `keep` the white border. Crops are PNG files in the cache folder.
        unlabelled: Whether to `keep` or `drop` pictures without a label file.

    Raises:
        DatasetError: An option has a wrong value, or no picture can be read.
    """
    require_options(
        root, modality=(modality, ("ir", "rgb", "both")), border=(border, ("crop", "keep")),
        unlabelled=(unlabelled, KEEP_OR_DROP),
    )  # fmt: skip
    wanted = check_splits(splits)
    state = _Reading(root, border == "crop")
    records: list[ImageRecord] = []
    for split, folder in _folders(root).items():
        if split not in wanted:
            continue
        for kind in ("ir", "rgb") if modality == "both" else (modality,):
            records += _read_split(state, split, folder, kind, unlabelled)
    if state.names:
        found = "names that are no class, left out: " + ", ".join(f"{n!r} {k}" for n, k in sorted(state.names.items()))
        expected = f"one of {', '.join(c.name for c in CATEGORIES)}"
        state.problems.append(Problem(root.name, "category-unknown", found, expected, severity="warning"))
    if state.counts["clipped"]:
        found = f"{state.counts['clipped']} object(s) that reach out of the picture; their boxes are clipped to it"
        state.problems.append(Problem(root.name, "box-clipped", found, "boxes inside", severity="warning"))
    keys = ("pictures", "objects", "read", "clipped", "outside", "unknown", "unlabelled", "cropped", "pairs")
    notes = {"labels": NAME, "modality": modality, "rows": {k: state.counts[k] for k in keys}}
    return make_dataset(root, NAME, records, CATEGORIES, state.problems, notes, metadata=metadata, splits=wanted)


def _read_split(state: _Reading, split: Split, folder: Path, kind: str, unlabelled: str) -> list[ImageRecord]:
    pictures, labels = (folder / f"{split}{suffix}" for suffix in _KINDS[kind])
    twins = folder / f"{split}{_KINDS['rgb' if kind == 'ir' else 'ir'][0]}"
    names = sorted(p.name for p in pictures.iterdir() if is_picture_name(p.name)) if pictures.is_dir() else []
    records, without = [], 0
    for name in names:
        path, label = pictures / name, labels / f"{Path(name).stem}.xml"
        where = path.relative_to(state.root).as_posix()
        without += not label.is_file()
        if not label.is_file() and unlabelled == "drop":
            continue
        state.counts["pictures"] += 1
        path_read, size_wh, offset, problem = _picture(state, path, where)
        state.problems += [problem] if problem else []
        if size_wh is None:
            continue
        instances = _instances(state, label, size_wh, offset) if label.is_file() else ()
        if instances is None:
            continue
        extra: dict[str, Any] = {"modality": "visible"} if kind == "rgb" else {}
        extra |= {} if label.is_file() else {"labelled": False}
        if (twins / name).is_file():
            state.counts["pairs"] += 1
            extra["twin"] = (twins / name).relative_to(state.root).as_posix()
        file = f"{path.parent.name}/{path_read.name}"
        records.append(ImageRecord("", path_read, split, size_wh, instances, extra=extra, file_name=file))
    state.counts["unlabelled"] += without
    where = f"{split}{_KINDS[kind][0]}"
    state.problems += unlabelled_problems(where, without, unlabelled)
    stems = {Path(n).stem for n in names}
    for label in sorted(labels.glob("*.xml")) if labels.is_dir() else ():
        if label.stem not in stems and not label.name.startswith("."):
            where = label.relative_to(state.root).as_posix()
            state.problems.append(Problem(where, "image-missing", "no picture of that name", "restore it"))
    return records


def _picture(
    state: _Reading, path: Path, where: str
) -> tuple[Path, tuple[int, int] | None, int, Problem | None]:  # fmt: skip
    """Return the picture to read, its size (None if it cannot be read), and the width of the border taken off."""
    size_wh, problem = read_size(path, where)
    if size_wh is None:
        return path, None, 0, problem
    if size_wh != WITH_BORDER_WH or not state.crop:
        return path, size_wh, 0, None
    try:
        cropped = derived.crop(path, BORDER_PX)
    except DatasetError as error:
        fault = error.problems[0]
        return path, None, 0, Problem(where, fault.code, fault.found, fault.expected, fault.todo)
    state.counts["cropped"] += 1
    return cropped, (size_wh[0] - 2 * BORDER_PX, size_wh[1] - 2 * BORDER_PX), BORDER_PX, None


def _instances(
    state: _Reading, path: Path, size_wh: tuple[int, int], offset: int
) -> tuple[Instance, ...] | None:  # fmt: skip
    """Return the objects in a label file; None, with a problem, if it cannot be read."""
    where = path.relative_to(state.root).as_posix()
    top, problem = read_xml(path, where)
    if problem is not None:
        state.problems.append(problem)
        return None
    found = []
    for n, element in enumerate(top.findall("object"), 1):
        here = f"{where}: object {n}"
        state.counts["objects"] += 1
        written = " ".join((element.findtext("name") or "").split())
        name = SPELLINGS.get(written.lower(), written.lower())
        if name not in {c.name for c in CATEGORIES}:
            state.names[written[:40]] += 1
            state.counts["unknown"] += 1
            continue
        corners = _corners(element)
        if corners is None:
            expected = "a polygon of four corners x1, y1 to x4, y4, or a bndbox"
            state.problems.append(Problem(here, "annotation-layout", "no box", expected, "correct the annotation"))
            continue
        corners = corners - offset
        corners = clockwise(corners)
        box, problem = check_box(box_of_points(corners).tolist(), size_wh, here)
        if box is None:
            state.counts["outside"] += problem is not None and problem.code == "box-outside"
            state.problems += [problem] if problem else []
            continue
        state.counts["clipped"] += problem is not None
        state.counts["read"] += 1
        found.append(Instance(name, box, corners))
    return tuple(found)


def _corners(element: Any) -> NDArray[np.float64] | None:
    """Return the corners of an object, from its polygon or else its box; None if it has neither."""
    polygon, box = element.find("polygon"), element.find("bndbox")
    if polygon is not None:
        numbers = to_floats([polygon.findtext(k) for k in _CORNERS], 8)
        if numbers is not None and is_near(numbers):
            return np.array(numbers, np.float64).reshape(4, 2)
    if box is not None:
        edges = to_floats([box.findtext(k) for k in ("xmin", "ymin", "xmax", "ymax")], 4)
        if edges is not None and is_near(edges):
            return corners_of_box(np.array(edges, np.float64))
    return None
