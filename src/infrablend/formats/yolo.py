"""Ultralytics' YOLO formats (detect, OBB and seg): reader and writer.

    data.yaml    images/<split>/<name>.<ext>    labels/<split>/<name>.txt

There is one line per object; coordinates are shares of the picture's width and height. A line of detect is
`cls cx cy w h`, of OBB `cls x1 y1 x2 y2 x3 y3 x4 y4` (corners clockwise on screen), of seg `cls x1 y1 x2 y2 ...` (one
closed polygon).
"""

from __future__ import annotations

import contextlib
import datetime
import math
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, Literal

import numpy as np
import yaml
from numpy.typing import NDArray

from infrablend.core.boxes import box_of_points, corners_of_box
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance, Split
from infrablend.core.files import link_or_copy, write_text
from infrablend.core.masks import Mask
from infrablend.core.yaml_text import read_yaml as plain_yaml
from infrablend.errors import DatasetError, Problem
from infrablend.formats.annotation_files import read_text
from infrablend.formats.base import (
    Match,
    check_splits,
    count_crowds,
    in_order,
    is_ignored_name,
    require_size,
    shorten,
    sort_images,
    stated_split,
)
from infrablend.formats.box_checks import check_box, clockwise_corners, overhang_px, snap
from infrablend.formats.capture import Captures, CaptureTable, find_table, read_table
from infrablend.formats.losses import Text, Written
from infrablend.formats.occlusion import loses_occlusion
from infrablend.formats.pictures import assign_ids, check_link, check_name, is_hidden, list_pictures, read_size, walk
from infrablend.formats.polygons import outline, rasterise

NAME = "yolo"

Task = Literal["detect", "obb", "seg"]
TASKS: tuple[Task, ...] = ("detect", "obb", "seg")
Classes = Mapping[str, int]
WithoutMask = Literal["omit", "obb"]

# Ten decimals: the rounding error is at most 640 px * 0.5e-10 = 3e-8 px.
_DECIMALS = 10
# More classes than any detector has, so that a large `nc` cannot exhaust memory.
_MOST_UNNAMED = 10_000
_YAML_NAMES = ("data.yaml", "data.yml", "dataset.yaml", "dataset.yml")


# -- writing ---------------------------------------------------------------------------------------------------


def native_writer(dataset: Dataset) -> str:
    """Return the name of the writer for a dataset's labels: of oriented boxes, polygons, or boxes."""
    instances = [i for image in dataset.images for i in image.instances]
    if any(i.corners_xy is not None for i in instances):
        return "yolo-obb"
    return "yolo-seg" if any(i.mask is not None for i in instances) else "yolo"


def yolo_classes(categories: Iterable[Category], dont_care: Literal["drop", "keep"] = "drop") -> dict[str, int]:
    """Return class numbers by category name, from 0 in the order of the ids; ignore regions are left out or kept.

    For HIT-UAV with a drone: Person 0, Car 1, Bicycle 2, OtherVehicle 3, drone 4; with "keep", DontCare 4, drone 5.
    """
    kept = [c for c in sorted(categories, key=lambda c: c.id) if dont_care == "keep" or not c.ignore]
    return {c.name: k for k, c in enumerate(kept)}


def _number(value: float) -> str:
    """Return a share of the frame as text, clipped to [0, 1], with at most ten decimals."""
    text = f"{min(max(value, 0.0), 1.0):.{_DECIMALS}f}".rstrip("0").rstrip(".")
    return text or "0"


def _line(number: int, values: Iterable[float]) -> str:
    return " ".join([str(number), *map(_number, values)]) + "\n"


def _shares(points_xy: NDArray[np.float64], size_wh: tuple[int, int]) -> list[float]:
    return [float(v) for v in (points_xy / np.array(size_wh, np.float64)).reshape(-1)]


def _count_flags(instance: Instance, losses: Counter[str]) -> None:
    losses["truncated_dropped"] += instance.truncated is True
    losses["difficult_dropped"] += instance.difficult is True
    losses["visibility_dropped"] += instance.visibility is not None
    losses["occlusion_dropped"] += loses_occlusion(instance)


def _box_in_frame(instance: Instance, size_wh: tuple[int, int], losses: Counter[str]) -> NDArray[np.float64] | None:
    """Return the box clipped to the frame; None if it is outside, which counts as a loss."""
    w, h = size_wh
    box = np.clip(instance.box_xyxy, 0.0, np.array([w, h, w, h], np.float64))
    if box[2] <= box[0] or box[3] <= box[1]:
        losses["box_outside"] += 1
        return None
    losses["box_clipped"] += bool((box != instance.box_xyxy).any())
    return box


def detect_text(image: ImageRecord, classes: Classes) -> Text:
    """Return the text of an image's detect label file, and the losses; an image without objects gives empty text."""
    size_wh = require_size(image)
    w, h = size_wh
    losses: Counter[str] = Counter()
    lines = []
    for instance in image.instances:
        if instance.category not in classes:
            losses["ignore_dropped"] += 1
            continue
        box = _box_in_frame(instance, size_wh, losses)
        if box is None:
            continue
        _count_flags(instance, losses)
        losses["obb_dropped"] += instance.corners_xy is not None
        losses["mask_dropped"] += instance.mask is not None
        x0, y0, x1, y1 = box.tolist()
        values = ((x0 + x1) / 2 / w, (y0 + y1) / 2 / h, (x1 - x0) / w, (y1 - y0) / h)
        lines.append(_line(classes[instance.category], values))
    return Text("".join(lines), _counted(losses))


def _corners_in_frame(instance: Instance, size_wh: tuple[int, int], losses: Counter[str]) -> NDArray[np.float64] | None:
    """Return four corners inside the frame, because Ultralytics rejects an image with a single corner outside."""
    corners = instance.corners_xy
    if corners is None:
        box = _box_in_frame(instance, size_wh, losses)
        losses["obb_from_box"] += box is not None
        return None if box is None else corners_of_box(box)
    if overhang_px(corners, size_wh) > 0:
        box = box_of_points(corners)
        if box[0] >= size_wh[0] or box[1] >= size_wh[1] or box[2] <= 0 or box[3] <= 0:
            losses["box_outside"] += 1
            return None
        losses["corners_clamped"] += 1
        corners = np.clip(corners, 0.0, np.array(size_wh, np.float64))
    return corners


def obb_text(image: ImageRecord, classes: Classes) -> Text:
    """Return the text of an image's OBB label file, and the losses; corners are clockwise on screen."""
    size_wh = require_size(image)
    losses: Counter[str] = Counter()
    lines = []
    for instance in image.instances:
        if instance.category not in classes:
            losses["ignore_dropped"] += 1
            continue
        corners = _corners_in_frame(instance, size_wh, losses)
        if corners is None:
            continue
        _count_flags(instance, losses)
        losses["mask_dropped"] += instance.mask is not None
        lines.append(_line(classes[instance.category], _shares(corners, size_wh)))
    return Text("".join(lines), _counted(losses))


def seg_text(image: ImageRecord, classes: Classes, without_mask: WithoutMask = "omit") -> Text:
    """Return the text of an image's seg label file, and the losses; each mask is one polygon (`polygons.outline`).

    Args:
        image: The image.
        classes: Class numbers from `yolo_classes`.
        without_mask: Whether to `omit` objects without a mask, or to write their oriented box, else their box (`obb`).
    """
    size_wh = require_size(image)
    losses: Counter[str] = Counter()
    lines = []
    for instance in image.instances:
        if instance.category not in classes:
            losses["ignore_dropped"] += 1
            continue
        if instance.mask is None or instance.mask.area_px == 0:
            if without_mask == "omit":
                losses["without_mask_omitted"] += 1
                continue
            corners = _corners_in_frame(instance, size_wh, losses)
            if corners is None:
                continue
            losses["mask_from_obb"] += 1
            points = corners
        else:
            if instance.mask.size_hw != (size_wh[1], size_wh[0]):
                raise ValueError(f"{image.id}: mask of {instance.mask.size_hw} in a frame of {size_wh}")
            made = outline(instance.mask)
            points = made.polygon_xy
            losses["mask_raster_px"] += made.raster_difference_px
        _count_flags(instance, losses)
        losses["obb_dropped"] += instance.corners_xy is not None
        losses["box_dropped"] += not np.allclose(box_of_points(points), instance.box_xyxy, rtol=0, atol=0.03)
        lines.append(_line(classes[instance.category], _shares(points, size_wh)))
    return Text("".join(lines), _counted(losses))


def _counted(losses: Counter[str]) -> dict[str, int]:
    return {k: v for k, v in sorted(losses.items()) if v}


def label_text(image: ImageRecord, classes: Classes, task: Task, without_mask: WithoutMask = "omit") -> Text:
    """Return the text of an image's label file for a task, and the losses."""
    if task == "detect":
        return detect_text(image, classes)
    return obb_text(image, classes) if task == "obb" else seg_text(image, classes, without_mask)


def write_frame(
    out: Path, image: ImageRecord, classes: Classes, task: Task, *, without_mask: WithoutMask = "omit"
) -> Written:
    """Write one image: its labels to `labels/<split>/<name>.txt`, and a link to it as `images/<split>/<name>`.

    The label file is written first, so that no picture is ever without one. Files appear complete or not at all.

    Raises:
        OutputError: A file cannot be written.
        ValueError: `size_wh` is unknown.
    """
    name = PurePosixPath(image.name)
    made = label_text(image, classes, task, without_mask)
    label = write_text(out / "labels" / image.split / name.with_suffix(".txt"), made.text)
    picture = link_or_copy(image.path, out / "images" / image.split / name)
    return Written((label, picture), made.losses)


class _QuotedForBoth(yaml.SafeDumper):
    """Dumper that quotes class names which YAML 1.1 (Ultralytics) or YAML 1.2 (our reader) would not read as text."""


def _represent_name(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    try:
        plain = isinstance(plain_yaml(text), str)
    except ValueError:
        plain = True  # PyYAML quotes what is not a plain scalar
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=None if plain else "'")


_QuotedForBoth.add_representer(str, _represent_name)


def data_yaml(classes: Classes, splits: Iterable[str]) -> tuple[str, tuple[Problem, ...]]:
    """Return the text of a `data.yaml`, and warnings.

    There is no `path`, so that Ultralytics uses the file's own folder and the dataset can be moved. Ultralytics needs
    `train` and `val`. A missing val therefore points to train, and a missing train to a split that exists, each with a
    warning. `stand_ins` lists these splits for our reader; Ultralytics ignores that key.
    """
    present = [s for s in SPLITS if s in set(splits)]
    if not present:
        raise ValueError("data.yaml needs at least one split")
    problems = []
    stand_ins = []
    lines = ["# InfraBlend; paths are relative to this file\n"]
    for split in SPLITS:
        stand_in: str = split
        if split not in present:
            if split == "test":
                continue
            stand_in = "train" if "train" in present else present[0]
            stand_ins.append(split)
            found = f"no split {split}; data.yaml points to {stand_in} instead"
            todo = f"do not treat results on {split} as independent"
            problems.append(
                Problem("data.yaml", f"{split}-absent", found, f"pictures of split {split}", todo, severity="warning")
            )
        lines.append(f"{split}: images/{stand_in}\n")
    if stand_ins:
        lines.append(f"stand_ins: [{', '.join(stand_ins)}]\n")
    names = {number: name for name, number in sorted(classes.items(), key=lambda item: item[1])}
    text = yaml.dump({"names": names}, Dumper=_QuotedForBoth, allow_unicode=True, default_flow_style=False)
    lines.append(text)
    return "".join(lines), tuple(problems)


def write_data_yaml(out: Path, classes: Classes, splits: Iterable[str]) -> Written:
    """Write `out/data.yaml`; see `data_yaml`."""
    text, problems = data_yaml(classes, splits)
    return Written((write_text(out / "data.yaml", text),), {}, problems)


def write(
    out: Path,
    images: Iterable[ImageRecord],
    categories: Sequence[Category],
    *,
    task: Task = "detect",
    dont_care: Literal["drop", "keep"] = "drop",
    without_mask: WithoutMask = "omit",
) -> Written:
    """Write a dataset: every image with `write_frame`, and `data.yaml` with `write_data_yaml`.

    Crowds are left out like regions of ignored categories; `dont_care="keep"` writes them as objects of their class.
    """
    ordered = in_order(images)
    classes = yolo_classes(categories, dont_care)
    regions = {c.name for c in categories if c.ignore}
    losses: Counter[str] = Counter()

    def frames() -> Iterator[Written]:
        for image in ordered:
            if any(i.is_crowd for i in image.instances):
                kept = tuple(i for i in image.instances if dont_care == "keep" or not i.is_crowd)
                losses["ignore_dropped"] += len(image.instances) - len(kept)
                losses["ignore_as_class"] += count_crowds(kept, regions)
                image = replace(image, instances=kept)
            yield write_frame(out, image, classes, task, without_mask=without_mask)

    written = Written.together(frames())
    parts = [written, Written(losses=_counted(losses)), write_data_yaml(out, classes, {i.split for i in ordered})]
    return Written.together(parts)


# -- reading one label file ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LabelLines:
    """Content of a label file: (line number, class, values) per object, and the problems."""

    rows: tuple[tuple[int, int, tuple[float, ...]], ...]
    problems: tuple[Problem, ...]


def parse_labels(text: str, where: str) -> LabelLines:
    """Parse the text of a label file; malformed lines are left out and reported as errors."""
    rows: list[tuple[int, int, tuple[float, ...]]] = []
    problems: list[Problem] = []
    seen: set[tuple[int, tuple[float, ...]]] = set()
    for n, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if not words:
            continue
        here = f"{where}: line {n}"
        try:
            numbers = [float(w) for w in words]
        except ValueError:
            numbers = []
        shape = len(numbers) == 5 or (len(numbers) >= 7 and len(numbers) % 2 == 1)
        if not shape or not numbers[0].is_integer() or numbers[0] < 0:
            expected = "class cx cy w h, or class and three or more x y pairs"
            problems.append(Problem(here, "label-malformed", repr(line[:80]), expected, "correct the line"))
            continue
        values = tuple(numbers[1:])
        if not all(math.isfinite(v) and abs(v) < 1000 for v in values):
            problems.append(
                Problem(here, "box-not-finite", repr(line[:80]), "finite shares of the picture", "correct the line")
            )
            continue
        if (int(numbers[0]), values) in seen:
            found = "a repeated line, kept"
            problems.append(Problem(here, "object-duplicate", found, "each object once", severity="warning"))
        seen.add((int(numbers[0]), values))
        rows.append((n, int(numbers[0]), values))
    return LabelLines(tuple(rows), tuple(problems))


def _instances(
    labels: LabelLines, names: Mapping[int, str], size_wh: tuple[int, int], where: str, task: Task
) -> tuple[tuple[Instance, ...], list[Problem]]:
    problems = list(labels.problems)
    instances: list[Instance] = []
    w, h = size_wh
    for n, number, values in labels.rows:
        here = f"{where}: line {n}"
        if number not in names:
            found, expected = f"class {number}", f"one of {sorted(names)}"
            problems.append(Problem(here, "category-unknown", found, expected, "add it to data.yaml"))
            continue
        if len(values) == 4:
            cx, cy, bw, bh = values[0] * w, values[1] * h, values[2] * w, values[3] * h
            points = None
            raw: Sequence[float] = (cx - bw / 2, cy - bh / 2, cx + bw / 2, cy + bh / 2)
            # Rounding to ten decimals moves a box at the frame's edge up to 1e-7 px outside.
            raw = [snap(raw[0], w), snap(raw[1], h), snap(raw[2], w), snap(raw[3], h)]
        else:
            points = np.array(values, np.float64).reshape(-1, 2) * np.array([w, h], np.float64)
            raw = [float(v) for v in box_of_points(points)]
        box, problem = check_box(raw, size_wh, here)
        if problem is not None:
            problems.append(problem)
        if box is None:
            continue
        corners = clockwise_corners(points) if points is not None and task == "obb" and len(points) == 4 else None
        mask = Mask.from_array(rasterise(points, size_wh)) if points is not None and corners is None else None
        instances.append(Instance(names[number], box, corners, mask))
    return tuple(instances), problems


# -- reading folders -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class FoundPicture:
    """A picture, its name relative to the folder of its split, and its label file, if there is one."""

    name: str
    path: Path
    split: Split
    label: Path | None
    unique_name: str


def find_label(path: Path, root: Path) -> Path | None:
    """Return the label file of a picture: beside it, in `labels` in place of `images`, or below `root/labels`."""
    candidates = [path.with_suffix(".txt")]
    relative = path.relative_to(root)
    parts = list(relative.parts)
    for k in reversed(range(len(parts) - 1)):
        if parts[k] == "images":
            candidates.append(root.joinpath(*parts[:k], "labels", *parts[k + 1 :]).with_suffix(".txt"))
            break
    candidates.append((root / "labels" / relative).with_suffix(".txt"))
    return next((c for c in candidates if c.is_file() and c.name not in ("classes.txt",)), None)


def orphan_labels(root: Path, pictures: Sequence[FoundPicture]) -> list[Problem]:
    """Return a warning for every label file without a picture, in the folders with labels of the pictures.

    If no picture has a label file, there is one warning if folders `labels` contain some.
    """
    used = {p.label for p in pictures if p.label is not None}
    problems: list[Problem] = []
    if pictures and not used and (lost := _labels_elsewhere(root, {p.split for p in pictures})) is not None:
        found = f"no picture has a label file, though there are label files such as {lost}"
        todo = "put each picture's label file where docs/formats/yolo.md says"
        problems.append(Problem(root.name, "label-missing", found, "a label file per picture", todo, "warning"))
    for path in sorted(f for folder in {u.parent for u in used} for f in folder.glob("*.txt")):
        if path in used or path.name == "classes.txt" or path.name.startswith("."):
            continue
        where = path.relative_to(root).as_posix()
        text, fault = read_text(path, where, "a YOLO label file")
        labels = parse_labels(text, where)
        if fault is None and labels.rows and not labels.problems:  # else it is a note, a list, a count
            found = f"{len(labels.rows)} label(s) without a picture, left out"
            problems.append(
                Problem(where, "label-without-picture", found, "a picture of that name", severity="warning")
            )
    return problems


def _labels_elsewhere(root: Path, splits: Collection[Split]) -> str | None:
    """Return the first label file in a folder `labels` that is not that of another split; None without one."""
    for base, names in walk(root):
        parts = Path(base).relative_to(root).parts
        split = next((s for s in map(stated_split, parts) if s), None)
        if "labels" not in parts or (split is not None and split not in splits):
            continue
        for name in sorted(n for n in names if n.endswith(".txt") and n != "classes.txt" and not is_hidden(n)):
            where = Path(base, name).relative_to(root).as_posix()
            text, fault = read_text(Path(base, name), where, "a YOLO label file")
            if fault is None and (labels := parse_labels(text, where)).rows and not labels.problems:
                return where
    return None


def build_records(
    root: Path,
    pictures: Sequence[FoundPicture],
    names: Mapping[int, str] | None,
    captures: Captures,
    problems: list[Problem],
    task: Task | None,
) -> tuple[list[ImageRecord], dict[int, str]]:
    """Return image records with their labels, and the class names; problems are appended to `problems`.

    Args:
        root: The dataset's folder.
        pictures: Pictures of the folder.
        names: Category name per class number; None uses `class_<n>`, with a warning.
        captures: Source of pitch and altitude.
        problems: List to which problems are added.
        task: Meaning of lines of nine numbers: corners of an oriented box (`obb`) or of a polygon (`seg`). None decides
            for oriented boxes if all lines have five or nine numbers.

    Raises:
        DatasetError: There are labels, but the list of class names is empty.
    """
    parsed: dict[str, LabelLines] = {}
    for p in pictures:
        if p.label is None:
            continue
        where = p.label.relative_to(root).as_posix()
        text, fault = read_text(p.label, where, "a YOLO label file")
        if fault is not None:
            problems.append(fault)
        else:
            parsed[p.unique_name] = parse_labels(text, where)
    used = {number for labels in parsed.values() for _, number, _ in labels.rows}
    if names is not None and not names and used:
        found, expected = f"no class names, but labels of {len(used)} class(es)", "a name for each class"
        todo = "name them in data.yaml or classes.txt"
        raise DatasetError(f"{root}: no class names", [Problem(root.name, "names", found, expected, todo)])
    known = dict(names) if names is not None else {n: f"class_{n}" for n in sorted(used)}
    if names is None and used:
        found = f"no data.yaml and no classes.txt; the classes are named {', '.join(known.values())}"
        problems.append(Problem(root.name, "names-missing", found, "names of the classes", severity="warning"))
    if task is None:
        longer = [len(v) for labels in parsed.values() for _, _, v in labels.rows if len(v) != 4]
        task = "obb" if longer and all(n == 8 for n in longer) else "seg"
    ids = assign_ids([p.unique_name for p in pictures])
    records = []
    unlabelled = 0
    for p in pictures:
        where = p.path.relative_to(root).as_posix()
        size_wh: tuple[int, int] | None = None
        instances: tuple[Instance, ...] = ()
        if p.unique_name in parsed:
            size_wh, problem = read_size(p.path, where)
            if size_wh is None:
                problems += [problem] if problem else []
                continue
            label = p.label.relative_to(root).as_posix() if p.label else where
            instances, more = _instances(parsed[p.unique_name], known, size_wh, label, task)
            problems += more
        else:
            unlabelled += 1
        records.append(_record(p, ids[p.unique_name], size_wh, instances, captures, where))
    if parsed and unlabelled:
        found = f"{unlabelled} picture(s) without a label file are read as pictures without objects"
        problems.append(Problem(root.name, "label-missing", found, "a label file per picture", severity="warning"))
    return records, known


def _record(
    p: FoundPicture,
    id_: str,
    size_wh: tuple[int, int] | None,
    instances: tuple[Instance, ...],
    captures: Captures,
    where: str,
) -> ImageRecord:
    capture = captures.of(p.unique_name, where)
    return ImageRecord(id_, p.path, p.split, size_wh, instances, capture, file_name=p.name)


def check_table(table: CaptureTable | None, pictures: Sequence[FoundPicture], root: Path) -> list[Problem]:
    """Return the table's own problems, and a warning for rows that match no picture."""
    if table is None:
        return []
    unused = table.unused([p.unique_name for p in pictures])
    problems = list(table.problems)
    if unused:
        found = f"{len(unused)} row(s) of the table name no picture: {', '.join(unused[:3])}"
        problems.append(Problem(root.name, "table-unused", found, "a picture per row", severity="warning"))
    return problems


# -- reading a dataset with data.yaml -------------------------------------------------------------------------


def find_yaml(root: Path) -> Path | None:
    """Return the dataset's description: `data.yaml` or a similar name, or the only YAML file."""
    named = next((root / n for n in _YAML_NAMES if (root / n).is_file()), None)
    if named is not None:
        return named
    others = sorted(p for p in root.glob("*.y*ml") if not p.name.startswith(".") and p.is_file())
    return others[0] if len(others) == 1 else None


def read_yaml(path: Path) -> dict[str, Any]:
    """Return the mapping in a `data.yaml`.

    Raises:
        DatasetError: The file is not YAML, or not a mapping with `names`.
    """
    text, problem = read_text(path, path.name, "a data.yaml")
    value: Any = None
    if problem is None:
        try:
            value = plain_yaml(text, "names")
        except ValueError as error:
            problem = Problem(path.name, "annotation-not-yaml", str(error)[:200], "a data.yaml")
    if problem is not None:
        raise DatasetError(f"{path}: no YAML", [problem])
    if isinstance(value, dict) and value.get("names") is None and str(value.get("nc")).isdecimal():
        value["names"] = [f"class_{n}" for n in range(min(int(value["nc"]), _MOST_UNNAMED))]  # as Ultralytics does
    if not isinstance(value, dict) or "names" not in value:
        problem = Problem(path.name, "annotation-layout", "no key `names`", "train, val, test and names")
        raise DatasetError(f"{path}: not a data.yaml for YOLO", [problem])
    if "val" not in value and "validation" in value:  # as Ultralytics does
        value["val"] = value.pop("validation")
    return value


def name_warnings(path: Path, names: Mapping[int, str]) -> list[Problem]:
    """Return a warning per class that is no text for YAML 1.1 (Ultralytics: `no` is False) or 1.2 (`1e3` is 1000.0).

    The text must have passed `read_yaml`, which refuses aliases that exhaust memory.
    """
    text, found = read_text(path, path.name, "a data.yaml")[0], []
    for read in (yaml.safe_load, plain_yaml):
        with contextlib.suppress(yaml.YAMLError, ValueError, KeyError, TypeError):
            found.append(_by_number(read(text)["names"]))
    others = {
        number: next((o[number] for o in found if number in o and _is_other(o[number], name)), name)
        for number, name in names.items()
    }
    return [
        Problem(
            f"{path.name}: class {number}",
            "name-unquoted",
            f"{name} without quotes is {_kind(others[number])} for some YAML readers",
            "",
            f"Write '{name}' in quotes",
            "warning",
        )
        for number, name in names.items()
        if others[number] is not name
    ]


def _is_other(value: object, name: str) -> bool:
    """Return whether a value that a YAML reader found is not the name; the number 5 is, because it is written `5`."""
    return str(value) != name or isinstance(value, datetime.date)


def _kind(value: object) -> str:
    kinds = ((bool, "a truth value"), (int | float, "a number"), (datetime.date, "a date"))
    return next((kind for of, kind in kinds if isinstance(value, of)), "empty" if value is None else "another text")


def class_names(value: object, where: str) -> dict[int, str]:
    """Return the category name per class number from a list or a mapping, which is empty without labels.

    Raises:
        DatasetError: It is neither.
    """
    names = _numbered(value)
    empty = isinstance(value, dict | list) and not value
    if (not names and not empty) or len(set(names.values())) != len(names):
        problem = Problem(where, "names", f"names: {value!r}"[:120], "a list, or numbers with one name each")
        raise DatasetError(f"{where}: no class names", [problem])
    return dict(sorted(names.items()))


def _numbered(value: object) -> dict[int, str]:
    return {k: str(v) for k, v in _by_number(value).items()}


def _by_number(value: object) -> dict[int, Any]:
    if isinstance(value, dict):
        return {int(k): v for k, v in value.items() if str(k).isdecimal()}
    return dict(enumerate(value)) if isinstance(value, list) else {}


def categories_of(names: Mapping[int, str]) -> tuple[Category, ...]:
    """Return categories with the class numbers as ids."""
    return tuple(Category(k, v, "", is_ignored_name(v)) for k, v in sorted(names.items()))


def detect(root: Path) -> Match:
    """Decide whether `root` is a YOLO dataset: its `data.yaml` has `names` and a split that exists."""
    path = find_yaml(root)
    if path is None:
        return Match(NAME, False, "no data.yaml")
    try:
        top = read_yaml(path)
        class_names(top["names"], path.name)
    except DatasetError as error:
        return Match(NAME, False, f"{path.name}: {error.problems[0].found if error.problems else error.message}")
    folders, lists, _ = _split_places(root, top, SPLITS, path.name)
    if not folders and not lists:
        return Match(NAME, False, f"{path.name} names no folder or list of pictures that exists")
    return Match(NAME, True, f"{path.name} with {len(folders) + len(lists)} folder(s) or list(s) of pictures")


def _split_places(
    root: Path, top: Mapping[str, Any], splits: Sequence[Split], where: str
) -> tuple[list[tuple[Split, Path]], list[tuple[Split, Path]], list[Problem]]:
    """Return (split, folder) and (split, text file that lists pictures) according to data.yaml.

    A folder named for several splits belongs to the one in its path, else to the first. The lists of all splits are
    returned, not only those of `splits`, because they may share folders.
    """
    problems: list[Problem] = []
    folders: list[tuple[Split, Path]] = []
    lists: list[tuple[Split, Path]] = []
    home = root
    base = top.get("path")
    if isinstance(base, str) and base and check_name(base, where) is None and (root / base).is_dir():
        home = root / base
    # Splits that do not exist and only point to another one, see `data_yaml`.
    stand_ins = top.get("stand_ins")
    absent = stand_ins if isinstance(stand_ins, list) else []
    # Files of other tools do so too, without `stand_ins`; then the folder's own name decides.
    said: dict[Path, list[Split]] = {}
    for split in SPLITS:
        value = None if split in absent else top.get(split)
        entries = value if isinstance(value, list) else [value] if value else []
        for entry in entries:
            here = f"{where}: {split}"
            # Roboflow writes `../train/images` for folders beside data.yaml, which Ultralytics accepts too.
            name = str(entry).removeprefix("../") if isinstance(entry, str) else entry
            fault = check_name(name, here)
            if fault is not None:
                problems.append(fault)
                continue
            folder = home / str(name)
            if folder.is_dir():
                said.setdefault(folder, []).append(split)
            elif folder.suffix.lower() == ".txt" and folder.is_file():
                lists.append((split, folder))
            else:
                found, expected = f"{entry!r} is not a folder", "a folder of pictures, or a .txt that lists them"
                problems.append(Problem(here, "folder-missing", found, expected, severity="warning"))
    for folder, claims in said.items():
        split = next((s for s in claims if s in folder.parts[-2:]), claims[0])
        if len(set(claims)) > 1:
            found = f"{folder.name!r} is the folder of {' and '.join(claims)}; it is read as {split}"
            problems.append(Problem(where, "split-twice", found, "a folder per split", severity="warning"))
        if split in splits:
            folders.append((split, folder))
    return folders, lists, problems


def _listed_pictures(
    root: Path, lists: Sequence[tuple[Split, Path]], problems: list[Problem]
) -> dict[Path, tuple[Split, str]]:
    """Return split and name of the pictures in lists (text files with one path per line, as Ultralytics reads them).

    Paths are relative to the list, else to the dataset. A picture listed twice belongs to the first split.
    """
    found: dict[Path, tuple[Split, str]] = {}
    for split, file in lists:
        where = file.relative_to(root).as_posix()
        text, fault = read_text(file, where, "a list of pictures")
        problems += [fault] if fault else []
        for n, line in enumerate(text.splitlines(), 1):
            name = line.strip()
            if not name:
                continue
            here = f"{where}: line {n}"
            fault = check_name(name, here)
            path = next((p for p in (file.parent / name, root / name) if not fault and p.is_file()), None)
            if path is None:
                expected, todo = "a picture of the dataset", "correct the list"
                problems.append(fault or Problem(here, "image-missing", f"no file {name!r}", expected, todo))
            elif fault := check_link(path, root, here):
                problems.append(fault)
            elif found.setdefault(path, (split, _below_images(path, root)))[0] != split:
                said = f"{name!r} is also in {found[path][0]}, which is used"
                problems.append(Problem(here, "split-twice", said, "each picture in one list", severity="warning"))
    return found


def _below_images(path: Path, root: Path) -> str:
    """Return a picture's path in its dataset, without the folder `images`."""
    parts = path.relative_to(root).parts
    return "/".join(parts[1:] if parts[0] == "images" else parts)


def read(
    root: Path,
    *,
    splits: Iterable[str] | None = None,
    metadata: Path | None = None,
    task: Task | None = None,
) -> Dataset:
    """Read a YOLO dataset with its `data.yaml`.

    Args:
        root: Folder with `data.yaml`.
        splits: Splits to read; None reads all.
        metadata: Table of pitch and altitude; None uses `metadata.csv` or `.json` in the folder, if it exists.
        task: Meaning of lines of nine numbers, see `build_records`.

    Raises:
        DatasetError: There is no `data.yaml`, or no picture.
    """
    wanted = check_splits(splits)
    path = find_yaml(root)
    if path is None:
        problem = Problem(str(root), "annotation-missing", "no data.yaml", "a data.yaml", "read it as a plain folder")
        raise DatasetError(f"{root}: no YOLO dataset", [problem])
    top = read_yaml(path)
    names = class_names(top["names"], path.name)
    folders, lists, problems = _split_places(root, top, wanted, path.name)
    problems += name_warnings(path, names)
    if (said := top.get("nc")) is not None and said != len(names):
        expected = f"{len(names)}, the number of names; otherwise Ultralytics stops"
        problems.append(Problem(path.name, "names", f"nc: {said!r}"[:120], expected, "correct it", "warning"))
    listed = _listed_pictures(root, lists, problems)
    in_folders = [(split, n, f) for split, folder in folders for n, f in list_pictures(folder, ("labels",)).items()]
    if twice := sum(f in listed for _, _, f in in_folders):
        said = f"{twice} picture(s) both in a folder of one split and in a list; the list is used"
        problems.append(Problem(path.name, "split-twice", said, "each picture in one split", severity="warning"))
    placed = [p for p in in_folders if p[2] not in listed] + [(split, n, f) for f, (split, n) in listed.items()]
    found = [
        FoundPicture(name, file, split, find_label(file, root), file.relative_to(root).as_posix())
        for split, name, file in placed
    ]
    pictures = [p for p in found if p.split in wanted]
    table_path = metadata or find_table(root)
    table = read_table(table_path) if table_path else None
    captures = Captures(table, problems)
    records, known = build_records(root, pictures, names, captures, problems, task)
    problems += orphan_labels(root, found) + check_table(table, found, root)
    if not records:
        raise DatasetError(f"{root}: no picture to read", shorten(problems))
    notes = {"labels": "yolo", "table": table_path.name if table_path else None, "pitch": captures.note()}
    return Dataset(root, NAME, categories_of(known), sort_images(records), tuple(problems), notes)
