"""Ultralytics' YOLO formats (detect, OBB and seg): reader and writer.

    data.yaml    images/<split>/<name>.<ext>    labels/<split>/<name>.txt

There is one line per object; coordinates are shares of the picture's width and height. A line of detect is
`cls cx cy w h`, of OBB `cls x1 y1 x2 y2 x3 y3 x4 y4` (corners clockwise on screen), of seg `cls x1 y1 x2 y2 ...` (one
closed polygon). Detectors and trackers write the confidence, the number of the track, or both in this order behind it.
"""

from __future__ import annotations

import contextlib
import datetime
import math
import os
import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any, Literal, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from infrablend.core.boxes import box_of_points, corners_of_box
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance, Split
from infrablend.core.files import link_or_copy, write_text
from infrablend.core.rle_masks import Mask
from infrablend.core.yaml_text import read_yaml as plain_yaml
from infrablend.errors import DatasetError, Problem
from infrablend.formats.annotation_files import files_with, only_looked_at, read_text
from infrablend.formats.base import (
    Match,
    check_splits,
    count_crowds,
    in_order,
    is_ignored_name,
    require_size,
    stated_split,
)
from infrablend.formats.box_checks import clockwise_corners, edges_of_shares, overhang_px, snap_edges
from infrablend.formats.losses import Losses, Written, count_dropped, without_regions
from infrablend.formats.pictures.listing import check_link, check_name, is_hidden, list_pictures, walk
from infrablend.formats.polygons import outline, rasterise
from infrablend.formats.records import Findings

NAME = "yolo"

Task = Literal["detect", "obb", "seg"]
TASKS: tuple[Task, ...] = ("detect", "obb", "seg")
Classes = Mapping[str, int]
WithoutMask = Literal["omit", "obb"]

# Ten decimals: the rounding error is at most 640 px * 0.5e-10 = 3e-8 px.
_DECIMALS = 10
# What data.yaml may say about lines of nine numbers. Ultralytics reads polygons for `detect`, too.
_STATED_TASKS: Mapping[object, Task] = {"detect": "detect", "segment": "seg", "obb": "obb"}
# Larger shares of a picture are pixels.
_FAR_SHARE = 10
# Opposite corners of an oriented box have one middle; in rounded shares of the picture twice that differs by this.
_UNEVEN = 2e-3
# A confidence and the number of a track.
_MOST_ADDED = 2
_DOUBT = (
    "remove the last two values if they are a confidence and a track; "
    "if they are a corner, add `task: segment` to data.yaml"
)
# More classes than any detector has, so that a large `nc` cannot exhaust memory.
_MOST_UNNAMED = 10_000
# Folders in the longest end of a path that is looked for in a dataset.
_DEEPEST = 20
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


_FLAGS = ("truncated", "difficult", "visibility", "occlusion")


def _box_in_frame(instance: Instance, size_wh: tuple[int, int], losses: Counter[str]) -> NDArray[np.float64] | None:
    """Return the box clipped to the frame; None if it is outside, which counts as a loss."""
    w, h = size_wh
    box = np.clip(instance.box_xyxy, 0.0, np.array([w, h, w, h], np.float64))
    if box[2] <= box[0] or box[3] <= box[1]:
        losses["box_outside"] += 1
        return None
    losses["box_clipped"] += bool((box != instance.box_xyxy).any())
    return box


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


def _box_values(instance: Instance, size_wh: tuple[int, int], losses: Counter[str]) -> list[float] | None:
    box = _box_in_frame(instance, size_wh, losses)
    if box is None:
        return None
    count_dropped(instance, losses, "obb", "mask")
    x0, y0, x1, y1 = box.tolist()
    w, h = size_wh
    return [(x0 + x1) / 2 / w, (y0 + y1) / 2 / h, (x1 - x0) / w, (y1 - y0) / h]


def _corner_values(instance: Instance, size_wh: tuple[int, int], losses: Counter[str]) -> list[float] | None:
    corners = _corners_in_frame(instance, size_wh, losses)
    if corners is None:
        return None
    count_dropped(instance, losses, "mask")
    return _shares(corners, size_wh)


def _polygon_values(
    image: ImageRecord, instance: Instance, losses: Counter[str], without_mask: WithoutMask
) -> list[float] | None:
    """Return the polygon of the mask (`polygons.outline`) as shares of the frame; without one, the oriented box."""
    size_wh = require_size(image)
    if instance.mask is None or instance.mask.area_px == 0:
        if without_mask == "omit":
            losses["without_mask_omitted"] += 1
            return None
        corners = _corners_in_frame(instance, size_wh, losses)
        if corners is None:
            return None
        losses["mask_from_obb"] += 1
        points = corners
    else:
        if instance.mask.size_hw != (size_wh[1], size_wh[0]):
            raise ValueError(f"{image.id}: mask of {instance.mask.size_hw} in a frame of {size_wh}")
        made = outline(instance.mask)
        points = made.polygon_xy
        losses["mask_raster_px"] += made.raster_difference_px
    count_dropped(instance, losses, "obb")
    losses["box_dropped"] += not np.allclose(box_of_points(points), instance.box_xyxy, rtol=0, atol=0.03)
    return _shares(points, size_wh)


def label_text(
    image: ImageRecord, classes: Classes, task: Task, losses: Losses, without_mask: WithoutMask = "omit"
) -> str:
    """Return the text of an image's label file, and count losses; an image without objects gives empty text.

    Args:
        image: The image.
        classes: Class numbers from `yolo_classes`; objects of other classes are left out.
        task: What the lines are.
        losses: Counts what the format cannot hold.
        without_mask: For `seg`, whether to `omit` objects without a mask, or to write their oriented box, else their
            box (`obb`).
    """
    size_wh = require_size(image)
    lines = []
    for instance in image.instances:
        if instance.category not in classes:
            losses.leave_out("ignore_dropped", image, instance)
            continue
        if task == "seg":
            values = _polygon_values(image, instance, losses, without_mask)
        else:
            values = (_box_values if task == "detect" else _corner_values)(instance, size_wh, losses)
        if values is None:
            losses.left_out[image.split, instance.category] += 1
            continue
        count_dropped(instance, losses, *_FLAGS)
        lines.append(_line(classes[instance.category], values))
    return "".join(lines)


class _QuotedForBoth(yaml.SafeDumper):
    """Dumper that quotes class names which YAML 1.1 (Ultralytics) or YAML 1.2 (our reader) would not read as text."""


def _represent_name(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    try:
        plain = isinstance(plain_yaml(text), str)
    except ValueError:
        plain = True  # PyYAML quotes what is not a plain scalar
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=None if plain else "'")


_QuotedForBoth.add_representer(str, _represent_name)


def data_yaml(classes: Classes, splits: Iterable[str], task: Task = "detect") -> tuple[str, tuple[Problem, ...]]:
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
    if task == "seg":
        lines.append("task: segment\n")  # for our reader: polygons of four corners look like oriented boxes
    if stand_ins:
        lines.append(f"stand_ins: [{', '.join(stand_ins)}]\n")
    names = {number: name for name, number in sorted(classes.items(), key=lambda item: item[1])}
    text = yaml.dump({"names": names}, Dumper=_QuotedForBoth, allow_unicode=True, default_flow_style=False)
    lines.append(text)
    return "".join(lines), tuple(problems)


def write(
    out: Path,
    images: Iterable[ImageRecord],
    categories: Sequence[Category],
    *,
    task: Task = "detect",
    dont_care: Literal["drop", "keep"] = "drop",
    without_mask: WithoutMask = "omit",
) -> Written:
    """Write `labels/<split>/<name>.txt`, links to the pictures as `images/<split>/<name>`, and `data.yaml`.

    A label file is written before its picture, so that no picture is ever without one. Crowds are left out like regions
    of ignored categories; `dont_care="keep"` writes them as objects of their class.

    Raises:
        OutputError: A file cannot be written.
        ValueError: `size_wh` is unknown.
    """
    ordered = in_order(images)
    classes = yolo_classes(categories, dont_care)
    regions = {c.name for c in categories if c.ignore}
    losses = Losses()
    files: list[Path] = []
    for image in ordered:
        if dont_care == "drop":
            image = without_regions(image, (), losses)
        losses["ignore_as_class"] += count_crowds(image.instances, regions)
        name = PurePosixPath(image.name)
        label = out / "labels" / image.split / name.with_suffix(".txt")
        files.append(write_text(label, label_text(image, classes, task, losses, without_mask)))
        files.append(link_or_copy(image.path, out / "images" / image.split / name))
    text, problems = data_yaml(classes, {i.split for i in ordered}, task)
    files.append(write_text(out / "data.yaml", text))
    return Written.of(files, losses, problems)


# -- reading one label file ------------------------------------------------------------------------------------


class LabelLine(NamedTuple):
    """Number of a line, and the class, the place and the track of its object."""

    n: int
    class_: int
    values: tuple[float, ...]
    track: int | None = None


@dataclass(frozen=True)
class LabelLines:
    """Content of a label file: a line per object, and the problems."""

    rows: list[LabelLine] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)


def parse_labels(text: str, where: str, keypoints: int = 0) -> LabelLines:
    """Parse the text of a label file; malformed lines are left out and reported as errors.

    With `keypoints`, see `line_form`, each line is a box, usually with that many further values. What detectors and
    trackers add stays among the values, see `without_predictions`.
    """
    found = LabelLines()
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
        values = tuple(numbers[1:])
        polygon = not keypoints and len(values) >= 6 and len(values) % 2 == 0
        size = _size_of_place(len(values), keypoints)
        if polygon and size == len(values) and _outline_track(values) is not None:
            size -= _MOST_ADDED
        shape = polygon or size < len(values) or len(values) in (4, 4 + keypoints)
        said = repr(line[:80])
        todo = "correct the line"
        if not shape or not numbers[0].is_integer() or numbers[0] < 0:
            found.problems.append(Problem(here, "label-malformed", said, _line_text(keypoints), todo))
            continue
        class_ = int(numbers[0])
        if not all(abs(v) < _FAR_SHARE for v in values[:size]):  # the number of a track may be large
            code = "box-outside" if all(map(math.isfinite, values)) else "box-not-finite"
            expected = "shares of the picture, from 0 to 1"
            todo = "divide pixels by its width and height"
            found.problems.append(Problem(here, code, said, expected, todo))
            continue
        if (class_, values) in seen:
            text = "a repeated line, kept"
            found.problems.append(Problem(here, "object-duplicate", text, "each object once", severity="warning"))
        seen.add((class_, values))
        found.rows.append(LabelLine(n, class_, values))
    return found


def _line_text(keypoints: int) -> str:
    further = f"then {keypoints} values of keypoints" if keypoints else "or class and three or more x y pairs"
    return f"class cx cy w h, {further}"


def _size_of_place(count: int, keypoints: int) -> int:
    """Return how many of a line's values are the place of its object if it is one that a detector or tracker wrote."""
    sizes = (4 + keypoints,) if keypoints else (4, 8)
    return next((size for size in sizes if 1 <= count - size <= _MOST_ADDED), count)


def _is_box(values: Sequence[float]) -> bool:
    # A box that reaches out of the picture is clipped later.
    return all(-0.5 <= v <= 1.5 for v in values) and min(values[2:]) > 0


def _is_turned_box(values: Sequence[float]) -> bool:
    return all(abs(values[k] + values[4 + k] - values[2 + k] - values[6 + k]) <= _UNEVEN for k in (0, 1))


def _is_place(values: Sequence[float], plain: Collection[int], only_boxes: bool) -> bool:
    """Return whether values may be a box or a polygon, and not a polygon with the number of a track behind it."""
    *others, last = values
    is_track = last.is_integer() and last > 1 and max(others) <= 1
    fits = len(values) in plain or not (only_boxes or len(values) % 2)
    return fits and not is_track and max(values) < _FAR_SHARE


def _is_number(value: float) -> bool:
    """Return whether a value may be the number of a track, -1 for none; larger ones are rounded."""
    return value.is_integer() and -1 <= value < 2**53


def _outline_track(values: Sequence[float]) -> float | None:
    """Return what may be the number of a track behind a polygon and a confidence; None if it cannot be one."""
    *corners, score, number = values
    return number if len(corners) >= 8 and 0 <= score <= 1 and _is_number(number) and max(corners) <= 1 else None


@dataclass(frozen=True)
class _Prediction:
    """A line as detectors and trackers write it: the values of the place, then a confidence, a whole number, or both.

    Attributes:
        size: How many values the place has.
        number: The whole number; None without one. A single value may be either.
        scored: Whether a confidence is beside the whole number.
    """

    size: int
    number: float | None
    scored: bool

    @classmethod
    def of(cls, values: Sequence[float], keypoints: int) -> _Prediction | None:
        """Return a line's values as those of a prediction; None if they cannot be."""
        size = _size_of_place(len(values), keypoints)
        added = values[size:]
        if not added or not (_is_turned_box(values) if size == 8 and not keypoints else _is_box(values[:4])):
            return None
        if len(added) == 1:
            number = added[0] if _is_number(added[0]) else None
            return cls(size, number, False) if number is not None or 0 <= added[0] <= 1 else None
        pairs = ((score, number) for score, number in (added, added[::-1]) if 0 <= score <= 1)
        found = next((number for _, number in pairs if _is_number(number)), None)
        return None if found is None else cls(size, found, True)

    @property
    def is_certain(self) -> bool:
        """Whether the values behind the place can be no corner of a polygon."""
        return self.scored and self.number not in (0, 1)


def without_predictions(
    found: Findings, files: Mapping[str, LabelLines], task: Task | None, keypoints: int = 0
) -> Mapping[str, LabelLines]:
    """Return the lines of a dataset with their tracks, and without the confidences, which are counted.

    A box and two numbers have as many values as a triangle, an oriented box and two numbers as a pentagon. Lines of one
    length are of one kind: if the whole number of none is above 1, they are polygons in a dataset that has others, and
    where `task` says so. Polygons with both numbers are read if all are such; errors if that is in doubt.

    Args:
        found: Problems: lines that are neither.
        files: Lines of each label file by its name.
        task: What data.yaml or the user says of the lines.
        keypoints: Number of values after a box, see `line_form`.
    """
    lines = [row.values for labels in files.values() for row in labels.rows]
    plain = {4, 4 + keypoints} if keypoints else {4, 8}
    if all(len(values) in plain for values in lines):
        return files
    stated = task == "seg" and not keypoints  # lines of an even length are polygons
    predictions = {v: None if stated and len(v) % 2 == 0 else _Prediction.of(v, keypoints) for v in lines}
    outlines = [v for v, p in predictions.items() if p is None and len(v) >= 6 and len(v) % 2 == 0]
    tracked_outlines, doubtful = _tracked_outlines([] if keypoints else outlines, stated)
    predictions |= tracked_outlines
    polygons = {len(v) for v in outlines if v not in tracked_outlines}
    # Lengths of which some line can only be a prediction, and each may be one.
    certain = {len(v) for v, p in predictions.items() if p is not None and p.is_certain} - polygons
    single = [p.number for p in predictions.values() if p is not None and not p.scored]
    # Behind boxes alone, 0 and 1 are confidences unless all are whole and others larger.
    tracked = None not in single and any(number not in (0, 1) for number in single)
    result = {}
    for where, labels in files.items():
        rows = []
        for row in labels.rows:
            here = f"{where}: line {row.n}"
            p = predictions[row.values]
            # `size`: corners without a confidence
            if p is not None and (p.is_certain or len(row.values) in certain or not polygons - {p.size}):
                track = p.number if p.scored or tracked or p.number not in (0, 1) else None
                if p.scored or track is None:
                    found.leave_out("confidences of predicted objects", here)
                rows.append(
                    row._replace(
                        values=row.values[: p.size],
                        track=None if track is None or track < 0 else int(track),  # -1: not assigned
                    )
                )
            elif row.values not in doubtful and _is_place(row.values, plain, bool(keypoints)):
                rows.append(row)
            else:
                said = repr(" ".join(f"{v:g}" for v in (row.class_, *row.values))[:80])
                todo = _DOUBT if row.values in doubtful else "correct the line"
                found.add(here, "label-malformed", said, _line_text(keypoints), todo)
        result[where] = replace(labels, rows=rows)
    return result


def _tracked_outlines(
    outlines: Sequence[tuple[float, ...]], stated: bool
) -> tuple[Mapping[tuple[float, ...], _Prediction], Collection[tuple[float, ...]]]:
    """Return the polygons that have a confidence and a track behind them, and those of which nobody can tell.

    Args:
        outlines: Values of all lines that may be polygons.
        stated: Whether data.yaml says that they are.
    """
    tracks = {v: number for v in outlines if (number := _outline_track(v)) is not None}
    complete = len(tracks) == len(outlines)
    if any(number not in (0, 1) for number in tracks.values()):
        if complete:
            return {v: _Prediction(len(v) - _MOST_ADDED, number, True) for v, number in tracks.items()}, ()
    elif not complete or stated or not all(number == 1 and v[-2] not in (0, 1) for v, number in tracks.items()):
        return {}, ()
    return {}, tracks


def _instances(
    found: Findings, labels: LabelLines, names: Mapping[int, str], size_wh: tuple[int, int], where: str, task: Task
) -> tuple[Instance, ...]:
    found.problems += labels.problems
    instances: list[Instance] = []
    for n, number, values, track in labels.rows:
        here = f"{where}: line {n}"
        if number not in names:
            found.add(here, "category-unknown", f"class {number}", f"one of {sorted(names)}", "add it to data.yaml")
            continue
        if len(values) == 4:
            points = None
            # Rounding to ten decimals moves a box at the frame's edge up to 1e-7 px outside.
            raw = snap_edges(edges_of_shares(values, size_wh), size_wh)
        else:
            points = np.array(values, np.float64).reshape(-1, 2) * np.array(size_wh, np.float64)
            raw = [float(v) for v in box_of_points(points)]
        box = found.box(raw, size_wh, here)
        if box is None:
            continue
        corners = clockwise_corners(points) if points is not None and task == "obb" and len(points) == 4 else None
        mask = Mask.from_array(rasterise(points, size_wh)) if points is not None and corners is None else None
        instances.append(Instance(names[number], box, corners, mask, track_id=track))
    return tuple(instances)


# -- reading folders -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class FoundPicture:
    """A picture, its name relative to the folder of its split, and its label file, if there is one."""

    name: str
    path: Path
    split: Split
    label: Path | None


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
    return next((c for c in candidates if c.is_file() and c.name != "classes.txt"), None)


def _real_labels(path: Path, where: str, keypoints: int) -> LabelLines | None:
    """Return the lines of a label file; None for a note, a list, a count, or a file that cannot be read."""
    text, fault = read_text(path, where, "a YOLO label file")
    only_looked_at(path)
    labels = parse_labels(text, where, keypoints)
    return labels if fault is None and labels.rows and not labels.problems else None


def report_orphans(found: Findings, pictures: Sequence[FoundPicture], keypoints: int = 0) -> None:
    """Warn of every label file without a picture, in the folders with labels of the pictures.

    If no picture has a label file, there is one warning if folders `labels` contain some.
    """
    used = {p.label for p in pictures if p.label is not None}
    if pictures and not used and (lost := _labels_elsewhere(found.root, {p.split for p in pictures}, keypoints)):
        text = f"no picture has a label file, though there are label files such as {lost}"
        todo = "put each picture's label file where docs/formats/yolo.md says"
        found.warn(found.root.name, "label-missing", text, "a label file per picture", todo)
    for path in sorted(f for folder in {u.parent for u in used} for f in folder.glob("*.txt")):
        if path in used or path.name == "classes.txt" or path.name.startswith("."):
            continue
        where = found.place(path)
        labels = _real_labels(path, where, keypoints)
        if labels is not None:
            text = f"{len(labels.rows)} label(s) without a picture, left out"
            found.warn(where, "label-without-picture", text, "a picture of that name")


def _labels_elsewhere(root: Path, splits: Collection[Split], keypoints: int) -> str | None:
    """Return the first label file in a folder `labels` that is not that of another split; None without one."""
    for base, names in walk(root):
        parts = Path(base).relative_to(root).parts
        split = next((s for s in map(stated_split, parts) if s), None)
        if "labels" not in parts or (split is not None and split not in splits):
            continue
        for name in sorted(n for n in names if n.endswith(".txt") and n != "classes.txt" and not is_hidden(n)):
            where = Path(base, name).relative_to(root).as_posix()
            if _real_labels(Path(base, name), where, keypoints) is not None:
                return where
    return None


def build_records(
    found: Findings,
    pictures: Sequence[FoundPicture],
    names: Mapping[int, str] | None,
    task: Task | None,
    keypoints: int = 0,
) -> tuple[list[ImageRecord], dict[int, str]]:
    """Return image records with their labels, without ids, and the class names.

    Args:
        found: Problems.
        pictures: Pictures of the folder.
        names: Category name per class number; None uses `class_<n>`, with a warning.
        task: Meaning of lines of nine numbers: corners of an oriented box (`obb`) or of a polygon (`seg`). None decides
            for oriented boxes if all lines have five or nine numbers.
        keypoints: Number of values after a box that are left out, see `line_form`.

    Raises:
        DatasetError: There are labels, but the list of class names is empty.
    """
    root = found.root
    parsed: dict[str, LabelLines] = {}
    for p in pictures:
        text = None if p.label is None else found.text(p.label, "a YOLO label file")
        if p.label is not None and text is not None:
            where = found.place(p.label)
            parsed[where] = parse_labels(text, where, keypoints)
    files = without_predictions(found, parsed, task, keypoints)
    for where, labels in files.items() if keypoints else ():
        for row in (row for row in labels.rows if len(row.values) > 4):
            found.leave_out("objects' keypoints", f"{where}: line {row.n}")
        labels.rows[:] = [row._replace(values=row.values[:4]) for row in labels.rows]
    used = {row.class_ for labels in files.values() for row in labels.rows}
    if names is not None and not names and used:
        said = f"no class names, but labels of {len(used)} class(es)"
        expected = "a name for each class"
        todo = "name them in data.yaml or classes.txt"
        raise DatasetError(f"{root}: no class names", [Problem(root.name, "names", said, expected, todo)])
    known = dict(names) if names is not None else {n: f"class_{n}" for n in sorted(used)}
    if names is None and used:
        said = f"no data.yaml and no classes.txt; the classes are named {', '.join(known.values())}"
        found.warn(root.name, "names-missing", said, "names of the classes")
    if task is None:
        longer = [len(row.values) for labels in files.values() for row in labels.rows if len(row.values) != 4]
        task = "obb" if longer and all(n == 8 for n in longer) else "seg"
    records = []
    unlabelled = 0
    for p in pictures:
        size_wh: tuple[int, int] | None = None
        instances: tuple[Instance, ...] = ()
        where = "" if p.label is None else found.place(p.label)
        if p.label is not None and where not in files:
            continue  # its labels cannot be read: it would pass as a picture without objects
        if p.label is not None:
            size_wh = found.size(p.path, found.place(p.path))
            if size_wh is None:
                continue
            instances = _instances(found, files[where], known, size_wh, where, task)
        else:
            unlabelled += 1
        records.append(ImageRecord("", p.path, p.split, size_wh, instances, file_name=p.name))
    if files and unlabelled:
        said = f"{unlabelled} picture(s) without a label file are read as pictures without objects"
        found.warn(root.name, "label-missing", said, "a label file per picture")
    return records, known


# -- reading a dataset with data.yaml -------------------------------------------------------------------------


def find_yaml(root: Path) -> Path | None:
    """Return the dataset's description: `data.yaml` or a similar name, the only YAML file, or Darknet's `obj.data`."""
    named = next((root / n for n in _YAML_NAMES if (root / n).is_file()), None)
    if named is not None:
        return named
    others = sorted(p for p in root.glob("*.y*ml") if not p.name.startswith(".") and p.is_file())
    for place in (root, root / "data"):
        others = others or files_with(place, "*.data", lambda head: b"names" in head, 10_000)
    return others[0] if len(others) == 1 else None


def read_yaml(path: Path, root: Path) -> dict[str, object]:
    """Return the mapping in a `data.yaml`, or what Darknet's `obj.data` says, by the same keys.

    Args:
        path: The file.
        root: Folder of the dataset.

    Raises:
        DatasetError: The file is not YAML, or not a mapping with `names`.
    """
    if path.suffix == ".data":
        return _read_darknet(path, root)
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


def _read_darknet(path: Path, root: Path) -> dict[str, object]:
    """Return the lists of pictures and the names of the classes that a Darknet `.data` file gives as `key = path`."""
    text, problem = read_text(path, path.name, "Darknet's description of a dataset")
    said = {key.strip(): value.strip() for key, _, value in (line.partition("=") for line in text.splitlines())}
    names = end_inside(root, said.get("names", ""))
    if problem is None and names is None:
        found = f"names = {said.get('names')!r}"[:120]
        expected = "a file of the dataset with a class on each line"
        problem = Problem(path.name, "names", found, expected, "correct the line or restore the file")
    if problem is None:
        text, problem = read_text(root / str(names), str(names), "a class on each line")
    if problem is not None:
        raise DatasetError(f"{path}: no description of a dataset", [problem])
    keys = {"train": "train", "valid": "val", "test": "test"}
    lists = {split: end_inside(root, said[key]) or said[key] for key, split in keys.items() if said.get(key)}
    return {**lists, "names": [s.strip() for s in text.splitlines() if s.strip()]}


def end_inside(folder: Path, name: str) -> str | None:
    """Return the longest end of a path that is a file below a folder: lists often begin elsewhere, as at `data/`."""
    parts = [p for p in re.split(r"[\\/]", name.rpartition("../")[2]) if p not in ("", ".", "..")]
    parts = parts[-_DEEPEST:]
    ends = ("/".join(parts[k:]) for k in range(len(parts)))
    return next((end for end in ends if _is_file(folder / end)), None)


def _is_file(path: Path) -> bool:
    return os.path.isfile(path)  # noqa: PTH113 - `Path.is_file` raises for names that are too long


def line_form(top: Mapping[str, object], task: Task | None) -> tuple[Task | None, int]:
    """Return the meaning of lines of nine numbers and the number of values of keypoints per line.

    Args:
        top: Content of data.yaml, of which `task` and `kpt_shape` (keypoints, values of each) count.
        task: The meaning, where it is known.

    Raises:
        DatasetError: Lines have keypoints, but `kpt_shape` does not tell how many.
    """
    shape = top.get("kpt_shape")
    if shape is None and top.get("task") != "pose":
        return task or _STATED_TASKS.get(str(top.get("task"))), 0
    if isinstance(shape, list) and len(shape) == 2 and all(type(v) is int and v > 0 for v in shape):
        return task, shape[0] * shape[1]
    expected = "the number of keypoints and the number of values of each, as [17, 3]"
    problem = Problem("data.yaml", "annotation-layout", f"kpt_shape: {shape!r}"[:120], expected, "correct it")
    raise DatasetError("data.yaml: the form of lines with keypoints is unknown", [problem])


def name_warnings(path: Path, names: Mapping[int, str]) -> list[Problem]:
    """Return a warning per class that is no text for YAML 1.1 (Ultralytics: `no` is False) or 1.2 (`1e3` is 1000.0).

    The text must have passed `read_yaml`, which refuses aliases that exhaust memory.
    """
    text = read_text(path, path.name, "a data.yaml")[0]
    found = []
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
    names = {k: str(v) for k, v in _by_number(value).items()}
    empty = isinstance(value, dict | list) and not value
    if (not names and not empty) or len(set(names.values())) != len(names):
        problem = Problem(where, "names", f"names: {value!r}"[:120], "a list, or numbers with one name each")
        raise DatasetError(f"{where}: no class names", [problem])
    return dict(sorted(names.items()))


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
        return Match(NAME, False, "no data.yaml and no obj.data")
    try:
        top = read_yaml(path, root)
        class_names(top["names"], path.name)
    except DatasetError as error:
        return Match(NAME, False, f"{path.name}: {error.problems[0].found if error.problems else error.message}")
    folders, lists = _split_places(Findings(root), top, SPLITS, path.name)
    if not folders and not lists:
        return Match(NAME, False, f"{path.name} names no folder or list of pictures that exists")
    return Match(NAME, True, f"{path.name} with {len(folders) + len(lists)} folder(s) or list(s) of pictures")


def _split_places(
    found: Findings, top: Mapping[str, object], splits: Sequence[Split], where: str
) -> tuple[list[tuple[Split, Path]], list[tuple[Split, Path]]]:
    """Return (split, folder) and (split, text file that lists pictures) according to data.yaml.

    A folder named for several splits belongs to the one in its path, else to the first. The lists of all splits are
    returned, not only those of `splits`, because they may share folders.
    """
    folders: list[tuple[Split, Path]] = []
    lists: list[tuple[Split, Path]] = []
    home = found.root
    base = top.get("path")
    if isinstance(base, str) and base and check_name(base, where) is None and (home / base).is_dir():
        home = home / base
    # Splits that do not exist and only point to another one, see `data_yaml`.
    stand_ins = top.get("stand_ins")
    absent = stand_ins if isinstance(stand_ins, list) else []
    # Files of other tools do so too, without `stand_ins`; then the folder's own name decides.
    said: dict[Path, list[Split]] = {}
    for split in SPLITS:
        value = None if split in absent else top.get(split)
        for entry in value if isinstance(value, list) else [value] if value else []:
            here = f"{where}: {split}"
            # Roboflow writes `../train/images` for folders beside data.yaml, which Ultralytics accepts too.
            name = str(entry).removeprefix("../") if isinstance(entry, str) else entry
            fault = check_name(name, here)
            folder = home / str(name)
            if fault is not None:
                found.problems.append(fault)
            elif folder.is_dir():
                said.setdefault(folder, []).append(split)
            elif folder.suffix.lower() == ".txt" and folder.is_file():
                lists.append((split, folder))
            else:
                expected = "a folder of pictures, or a .txt that lists them"
                found.warn(here, "folder-missing", f"{entry!r} is not a folder", expected)
    for folder, claims in said.items():
        split = next((s for s in claims if s in folder.parts[-2:]), claims[0])
        if len(set(claims)) > 1:
            text = f"{folder.name!r} is the folder of {' and '.join(claims)}; it is read as {split}"
            found.warn(where, "split-twice", text, "a folder per split")
        if split in splits:
            folders.append((split, folder))
    return folders, lists


def _listed_pictures(found: Findings, lists: Sequence[tuple[Split, Path]]) -> dict[Path, tuple[Split, str]]:
    """Return split and name of the pictures in lists (text files with one path per line, as Ultralytics reads them).

    Paths are relative to the list, else to the dataset, or end in it, see `end_inside`. A picture listed twice belongs
    to the first split.
    """
    root = found.root
    listed: dict[Path, tuple[Split, str]] = {}
    for split, file in lists:
        for n, line in enumerate((found.text(file, "a list of pictures") or "").splitlines(), 1):
            name = line.strip()
            if not name:
                continue
            here = f"{found.place(file)}: line {n}"
            fault = check_name(name, here)
            path = next((p for p in (file.parent / name, root / name) if not fault and _is_file(p)), None)
            if path is None and (end := end_inside(root, name)) is not None:
                path = root / end
                fault = None
            if path is None:
                expected = "a picture of the dataset"
                todo = "correct the list"
                found.problems.append(
                    fault or Problem(here, "image-missing", f"no file {name[:120]!r}", expected, todo)
                )
            elif fault := check_link(path, root, here):
                found.problems.append(fault)
            elif listed.setdefault(path, (split, _below_images(path, root)))[0] != split:
                text = f"{name!r} is also in {listed[path][0]}, which is used"
                found.warn(here, "split-twice", text, "each picture in one list")
    return listed


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
    """Read a YOLO dataset with its `data.yaml`; `task` is the meaning of lines of nine numbers, see `line_form`.

    Raises:
        DatasetError: There is no `data.yaml`, it does not tell the form of lines, or there is no picture.
    """
    wanted = check_splits(splits)
    path = find_yaml(root)
    if path is None:
        problem = Problem(str(root), "annotation-missing", "no data.yaml", "a data.yaml", "read it as a plain folder")
        raise DatasetError(f"{root}: no YOLO dataset", [problem])
    top = read_yaml(path, root)
    names = class_names(top["names"], path.name)
    task, keypoints = line_form(top, task)
    found = Findings(root)
    folders, lists = _split_places(found, top, wanted, path.name)
    found.problems += name_warnings(path, names)
    if (said := top.get("nc")) is not None and said != len(names):
        expected = f"{len(names)}, the number of names; otherwise Ultralytics stops"
        found.warn(path.name, "names", f"nc: {said!r}"[:120], expected, "correct it")
    listed = _listed_pictures(found, lists)
    in_folders = [
        (split, n, f)
        for split, folder in folders
        for n, f in list_pictures(folder, ("labels",), lambda p: find_label(p, root)).items()
    ]
    if twice := sum(f in listed for _, _, f in in_folders):
        text = f"{twice} picture(s) both in a folder of one split and in a list; the list is used"
        found.warn(path.name, "split-twice", text, "each picture in one split")
    placed = [p for p in in_folders if p[2] not in listed] + [(split, n, f) for f, (split, n) in listed.items()]
    pictures = [FoundPicture(name, file, split, find_label(file, root)) for split, name, file in placed]
    records, known = build_records(found, [p for p in pictures if p.split in wanted], names, task, keypoints)
    report_orphans(found, pictures, keypoints)
    return found.dataset(
        NAME,
        records,
        categories_of(known),
        {"labels": "yolo"},
        metadata=metadata,
        splits=wanted,
        others=[found.place(p.path) for p in pictures],
    )
