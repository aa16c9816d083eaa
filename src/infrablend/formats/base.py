"""What all formats share: how a box is judged, oriented boxes, detection results, what a writer returns."""

from __future__ import annotations

import itertools
import json
import math
import os
import stat
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from defusedxml import ElementTree
from numpy.typing import NDArray

from infrablend.core.boxes import cxcywha_of_corners
from infrablend.core.dataset import SPLITS, Category, ImageRecord, Split
from infrablend.errors import DatasetError, Problem
from infrablend.formats.pictures import MAX_PIXELS

# Oriented boxes may overhang the frame by this much without a word: HIT-UAV's own reach 0.5 px.
OVERHANG_PX = 0.5

# Beyond these sizes a file is refused unread: parsed, it would take some thirty times as much memory.
MAX_JSON_BYTES = 200_000_000
MAX_TEXT_BYTES = 50_000_000
# Empty lists are three bytes of text and sixty in memory; COCO's own largest file holds some four millions.
MAX_JSON_LISTS = 10_000_000
MAX_JSON_DEPTH = 64

LOSSES: Mapping[str, str] = {
    "box_dropped": "upright box that is not the bounds of the oriented one or polygon, which is all that is held",
    "obb_dropped": "oriented box known, the format holds axis-aligned boxes only",
    "obb_from_box": "no oriented box known, the axis-aligned one was written as one",
    "obb_not_rectangle": "four corners that form no rectangle were written as the nearest one",
    "corners_clamped": "oriented box with a corner outside the frame, moved onto its edge",
    "mask_dropped": "mask known, the format holds none",
    "without_mask_omitted": "object without a mask, left out of a format of masks",
    "mask_from_obb": "object without a mask, its oriented box was written as polygon",
    "mask_raster_px": "pixels by which the polygon, rasterised as Ultralytics does, differs from the mask",
    "ignore_dropped": "object of an ignored or unwanted category left out",
    "ignore_as_class": "object of a category to ignore, which only the category's name may still tell",
    "truncated_dropped": "object flagged as truncated, the format holds no such flag",
    "difficult_dropped": "object flagged as difficult, the format holds no such flag",
    "visibility_dropped": "visibility known, the format holds none",
    "tracks_dropped": "track of an object known, the format holds none",
    "telemetry_dropped": "picture with pitch, altitude or time of day known, the format holds none",
    "not_finite_dropped": "telemetry that is no finite number, written as null",
    "sequence_dropped": "picture with a known sequence or date, the format holds none",
    "class_unfit": "object of a class the format does not have, written as the nearest or under a number of its own",
    "track_made": "object without a track, given one of its own: the format demands it",
    "empty_unsaid": "picture known to show no object: the format cannot tell it from one that nobody labelled",
    "name_changed": "picture renamed: the format knows no folders, or tells pictures by the stem alone",
    "class_name_changed": "class renamed: the format allows no blanks in it",
    "mask_overlap_px": "pixels of masks under a later object's: the format has one object for each pixel",
    "mask_absent": "object without a mask: it stands in the table and has no pixel",
    "fraction_truncated": "box with fractional coordinates, truncated toward zero",
    "box_widened": "box narrower than a pixel, widened to one pixel",
    "box_clipped": "box reaching outside the frame, clipped",
    "box_outside": "box with no part inside the frame, left out",
}
"""Every kind of loss a writer counts, and what it means."""


@dataclass(frozen=True)
class Match:
    """Whether a folder looks like one format, and why (or why not)."""

    format: str
    ok: bool
    reason: str


@dataclass(frozen=True)
class Written:
    """What a writer did: the files, the losses by kind (see `LOSSES`), what to warn about."""

    files: tuple[Path, ...] = ()
    losses: Mapping[str, int] = field(default_factory=dict)
    problems: tuple[Problem, ...] = ()

    @classmethod
    def together(cls, parts: Iterable[Written]) -> Written:
        """One report of several, in order."""
        files: list[Path] = []
        problems: list[Problem] = []
        losses: Counter[str] = Counter()
        for part in parts:
            files += part.files
            problems += part.problems
            losses.update(part.losses)
        return cls(tuple(files), dict(sorted(losses.items())), tuple(problems))


@dataclass(frozen=True)
class Text:
    """A file's text and the losses counted while making it."""

    text: str
    losses: Mapping[str, int] = field(default_factory=dict)


def leaves_folder(path: Path) -> bool:
    """True if `path` is a link to something outside the folder it lies in, which no dataset needs."""
    if not path.is_symlink():
        return False
    real, folder = os.path.realpath(path), os.path.realpath(path.parent)
    return os.path.commonpath([real, folder]) != folder


def _unfit(path: Path, where: str, expected: str, limit: int) -> Problem | None:
    """Why a file is not to be opened: a link out of its folder, no regular file, too large."""
    if leaves_folder(path):
        found, todo = f"{path.name!r} is a link out of its folder", "copy the file, or link the whole folder instead"
        return Problem(where, "name-climbs", found, "a file inside it", todo)
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        return Problem(where, "annotation-unreadable", "no regular file", expected, "replace or remove it")
    if status.st_size <= limit:
        return None
    found, most = f"{status.st_size / 1e6:.0f} MB of text", f"at most {limit / 1e6:.0f} MB"
    return Problem(where, "annotation-too-large", found, most, "split it into several files")


def read_json(path: Path) -> Any:
    """The JSON value in a UTF-8 file (a byte order mark is accepted).

    Raises:
        DatasetError: Not there, not readable, not JSON, a link out of its folder, above `MAX_JSON_BYTES`,
            `MAX_JSON_LISTS` or `MAX_JSON_DEPTH`.
    """
    problem = None
    try:
        problem = _unfit(path, path.name, "a JSON file", MAX_JSON_BYTES)
        data = path.read_bytes() if problem is None else b""
        lists = data.count(b"[") + data.count(b"{")
        if lists > MAX_JSON_LISTS:
            found, expected = f"{lists} lists and objects", f"at most {MAX_JSON_LISTS}"
            problem = Problem(path.name, "annotation-too-large", found, expected, "split it into several files")
        if problem is None:
            value = json.loads(data.decode("utf-8-sig"))
            if lists <= MAX_JSON_DEPTH or _depth(value) <= MAX_JSON_DEPTH:
                return value
            problem = _nested(path)
    except OSError as error:
        found = error.strerror or str(error)
        problem = Problem(path.name, "annotation-missing", found, "a JSON file", "fetch the file again or leave it out")
    except RecursionError:
        problem = _nested(path)
    except ValueError as error:
        found = f"no JSON ({error or type(error).__name__})"
        problem = Problem(
            path.name, "annotation-not-json", found, "a JSON file", "fetch the file again or leave it out"
        )
    raise DatasetError(f"{path}: {problem.found}", [problem])


def _nested(path: Path) -> Problem:
    found = "lists and objects nested too deeply"
    return Problem(path.name, "annotation-not-json", found, f"at most {MAX_JSON_DEPTH} levels", "fetch the file again")


def _depth(value: Any) -> int:
    """How deeply lists and objects are nested, up to one more than is allowed."""
    level, depth = [value], 0
    while level and depth <= MAX_JSON_DEPTH:
        inner: list[Any] = []
        for v in level:
            inside = v.values() if type(v) is dict else v if type(v) is list else ()
            inner += [w for w in inside if type(w) in (dict, list)]
        level, depth = inner, depth + 1
    return depth


def read_text(path: Path, where: str, expected: str) -> tuple[str, Problem | None]:
    """The UTF-8 text of a file (a byte order mark is accepted); empty, and what is wrong, if it cannot be had."""
    try:
        problem = _unfit(path, where, expected, MAX_TEXT_BYTES)
        return ("", problem) if problem else (path.read_text(encoding="utf-8-sig"), None)
    except (OSError, UnicodeDecodeError) as error:
        found = f"no text ({getattr(error, 'strerror', None) or type(error).__name__})"
    return "", Problem(where, "annotation-unreadable", found, expected, "replace or remove it")


def read_xml(path: Path, where: str) -> tuple[Any, Problem | None]:
    """The root element of an XML file, or None and what is wrong. Entities and DTDs are refused: they load and grow."""
    try:
        problem = _unfit(path, where, "an XML file", MAX_TEXT_BYTES)
        return (None, problem) if problem else (ElementTree.parse(path, forbid_dtd=True).getroot(), None)
    except Exception as error:  # parse errors, refused entities, wrong encodings
        found = f"no XML that may be read ({type(error).__name__}: {error})"[:200].replace(str(path), path.name)
    return None, Problem(where, "annotation-not-xml", found, "a VOC or roLabelImg file", "fetch it again")


def require_options(root: Path, **given: tuple[object, Sequence[str]]) -> None:
    """See that options of a reader have values that it knows: name=(value, choices).

    Raises:
        DatasetError: Names every option that has not.
    """
    problems = [
        Problem(f"option {name}", "option-value", f"{name}={value}", f"one of {', '.join(choices)}")
        for name, (value, choices) in given.items()
        if value not in choices
    ]
    if problems:
        raise DatasetError(f"{root}: an option its reader does not know", problems)


def check_splits(splits: Iterable[str] | None) -> tuple[Split, ...]:
    """The wanted splits in canonical order; None means all.

    Raises:
        DatasetError: A name that is no split, or none at all.
    """
    if splits is None:
        return SPLITS
    wanted = set(splits)
    unknown = sorted(wanted - set(SPLITS))
    if unknown or not wanted:
        raise DatasetError(f"splits: found {unknown or 'none'}, expected some of train, val, test")
    return tuple(s for s in SPLITS if s in wanted)


def is_ignored_name(name: str) -> bool:
    """True for the name of an ignore region, such as HIT-UAV's DontCare or "don't care"."""
    return "".join(c for c in name if c.isalnum()).casefold() == "dontcare"


def few(problems: Sequence[Problem], each: int = 5) -> list[Problem]:
    """The first `each` problems of every code, and one that counts the rest: an error message has to be readable."""
    seen: Counter[str] = Counter()
    kept: list[Problem] = []
    for p in problems:
        seen[p.code] += 1
        if seen[p.code] <= each:
            kept.append(p)
    rest = {code: n - each for code, n in sorted(seen.items()) if n > each}
    if rest:
        found = ", ".join(f"{n} more {code}" for code, n in rest.items())
        kept.append(Problem("elsewhere", "more", found))
    return kept


def to_floats(value: object, count: int) -> tuple[float, ...] | None:
    """`count` numbers from a list of numbers or of strings holding them; None if it is anything else.

    NaN and infinity pass: `check_box` names them.
    """
    if not isinstance(value, list | tuple) or len(value) != count:
        return None
    try:
        if any(isinstance(v, bool) for v in value):
            return None
        return tuple(float(v) for v in value)
    except (TypeError, ValueError, OverflowError):
        return None


def to_int(value: object) -> int | None:
    """The whole number a JSON or XML field means (4, "4", 4.0), or None."""
    if isinstance(value, bool) or value is None:
        return None
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        return None
    return int(number) if math.isfinite(number) and number == int(number) else None


def to_bool(value: object) -> bool | None:
    """The flag a JSON or XML field means (true, 1, "1", "True"), or None."""
    text = str(value).strip().casefold()
    return {"1": True, "true": True, "0": False, "false": False}.get(text)


def to_size(width: object, height: object) -> tuple[int, int] | None:
    """(width, height) in px if both are whole numbers above 0 and no picture may be larger, else None."""
    w, h = to_int(width), to_int(height)
    return (w, h) if w is not None and h is not None and w > 0 and h > 0 and w * h <= MAX_PIXELS else None


def is_near(numbers: Sequence[float]) -> bool:
    """True for finite pixel coordinates of a size that pictures have; others overflow in products and casts."""
    return all(math.isfinite(v) and abs(v) <= 1e6 for v in numbers)


def check_box(
    xyxy: Sequence[float], size_wh: tuple[int, int] | None, where: str
) -> tuple[NDArray[np.float64] | None, Problem | None]:
    """Judge one axis-aligned box.

    Returns:
        The box, unchanged or clipped to the frame, or None if it has to be dropped; and what is wrong, if anything:
        `box-not-finite`, `box-empty`, `box-outside` (errors, dropped), `box-clipped` (warning, kept).
    """
    x0, y0, x1, y1 = xyxy
    if not is_near(xyxy):
        expected = "finite numbers of pixels"
        return None, Problem(where, "box-not-finite", f"box {_show(xyxy)}", expected, "correct the annotation")
    if x1 <= x0 or y1 <= y0:
        found = f"box {_show(xyxy)} of size {x1 - x0:g}x{y1 - y0:g}"
        return None, Problem(where, "box-empty", found, "a width and height above 0", "correct the annotation")
    if size_wh is None:
        return np.array((x0, y0, x1, y1), np.float64), None
    w, h = size_wh
    if x0 >= 0 and y0 >= 0 and x1 <= w and y1 <= h:
        return np.array((x0, y0, x1, y1), np.float64), None
    if x0 >= w or y0 >= h or x1 <= 0 or y1 <= 0:
        found = f"box {_show(xyxy)} outside the frame"
        return None, Problem(where, "box-outside", found, f"a box inside {w}x{h} px", "correct the annotation")
    box = np.array((max(x0, 0.0), max(y0, 0.0), min(x1, float(w)), min(y1, float(h))), np.float64)
    found = f"box {_show(xyxy)} reaches out of the frame, clipped to {_show(box.tolist())}"
    return box, Problem(where, "box-clipped", found, f"a box inside {w}x{h} px", severity="warning")


def number_text(value: float) -> str:
    """A coordinate as text: whole numbers as such, others with up to eight decimals."""
    text = f"{value:.8f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def snap(value: float, size: int, tolerance: float = 1e-6) -> float:
    """`value`, or the frame's edge (0 or `size`) where it lies outside by less than `tolerance`: that is rounding."""
    if -tolerance < value < 0:
        return 0.0
    return float(size) if size < value < size + tolerance else value


def _show(numbers: Sequence[float]) -> str:
    return "[" + ", ".join(f"{v:g}" for v in numbers) + "]"


def overhang_px(points_xy: NDArray[np.float64], size_wh: tuple[int, int]) -> float:
    """How far the outermost of (n, 2) points lies outside the frame; 0 if none does."""
    out = np.maximum(-points_xy, points_xy - np.array(size_wh, np.float64))
    return float(max(out.max(), 0.0))


def obb_from_corners(corners_xy: NDArray[np.float64]) -> tuple[float, float, float, float, float]:
    """`cx, cy, w, h, angle` of four corners that run clockwise on screen; angle in radians, in [0, pi).

    A box turned by pi is the same box: its corners come back in the same order, begun at the opposite one.
    """
    cx, cy, w, h, angle = (float(v) for v in cxcywha_of_corners(corners_xy))
    angle %= math.pi
    # A hair below 0 becomes a hair below pi, which rounds to pi: that is 0.
    return cx, cy, w, h, 0.0 if math.pi - angle < 1e-12 else angle


def sort_images(images: Iterable[ImageRecord]) -> tuple[ImageRecord, ...]:
    """Images by (split order, id), the order of a `Dataset` and of every file written."""
    return tuple(sorted(images, key=lambda image: (SPLITS.index(image.split), image.id)))


def require_size(image: ImageRecord) -> tuple[int, int]:
    """`image.size_wh`; ValueError if it is not set, which a writer cannot do without."""
    if image.size_wh is None:
        raise ValueError(f"{image.id}: size_wh must be known to write labels")
    return image.size_wh


def number_ids(
    images: Sequence[ImageRecord], ids: Literal["source", "new"], first: int
) -> tuple[list[int], list[list[int]]]:
    """Image ids and annotation ids for sorted images, counted from `first` over all splits, or the source's own.

    With the source's, objects put in by InfraBlend are numbered on from the largest.

    Raises:
        ValueError: `ids="source"` and the source's ids are missing, no integers, or not unique in a split.
    """
    if ids == "source":
        image_ids = [i.source_id for i in images]
        known = [[o.source_id for o in i.instances if not (o.inserted and o.source_id is None)] for i in images]
        for rows in ([[i] for i in image_ids], known):
            for split in SPLITS:
                values = [v for i, row in zip(images, rows, strict=True) if i.split == split for v in row]
                if any(type(v) is not int for v in values) or len(set(values)) != len(values):
                    raise ValueError('ids="source" needs every source_id to be a unique integer; use ids="new"')
        free = itertools.count(max([first - 1, *(v for row in known for v in row if type(v) is int)]) + 1)
        object_ids = [[next(free) if o.source_id is None else o.source_id for o in i.instances] for i in images]
        return image_ids, object_ids  # type: ignore[return-value]
    new_ids, start = [], first
    for image in images:
        new_ids.append(list(range(start, start + len(image.instances))))
        start += len(image.instances)
    return list(range(first, first + len(images))), new_ids


def category_ids(categories: Iterable[Category]) -> dict[str, int]:
    """Native id by category name; ValueError for a name or an id given twice."""
    ids: dict[str, int] = {}
    for c in categories:
        if c.name in ids or c.id in ids.values():
            raise ValueError(f"category {c.id} {c.name!r} is given twice")
        ids[c.name] = c.id
    return ids
