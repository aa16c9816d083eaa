"""Hugging Face's `imagefolder`: pictures in a folder per split, and a `metadata.jsonl` with a line per picture.

    <split>/<name>.jpg    <split>/metadata.jsonl

    {"file_name": "a.jpg", "width": 640, "height": 512, "pitch_deg": 60.0, "objects": {"bbox": [[x, y, w, h]], ...}}

`datasets` takes the type of a column from the first megabytes of each split, and refuses splits whose types differ.
JSON cannot state the type of a null or of an empty list. Columns of objects therefore have a value for every object,
and a number that is known in some splits alone is left out of all.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import corners_of_box
from infrablend.core.capture import FACTS, Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance, Split
from infrablend.core.files import finite, link_or_copy, write_chunks
from infrablend.core.format_table import FIELDS
from infrablend.core.rle_masks import Mask
from infrablend.errors import DatasetError, Problem
from infrablend.formats.annotation_files import files_with, read_lines, titles_of
from infrablend.formats.base import (
    SPLIT_FOLDERS,
    Match,
    category_ids,
    check_splits,
    count_crowds,
    in_order,
    is_ignored_name,
    require_known,
    require_size,
    shorten,
    split_parts,
)
from infrablend.formats.box_checks import clockwise_corners, edges_of_xywh, is_near
from infrablend.formats.losses import BOXES, Written
from infrablend.formats.picture_facts import SURPLUS, csv_rows
from infrablend.formats.pictures.listing import PictureFolder
from infrablend.formats.pictures.temperature_scale import scale_of_record
from infrablend.formats.records import Findings, with_ids
from infrablend.formats.values import to_bool, to_floats, to_id, to_int, to_share, to_size

NAME = "huggingface"
TAKES_TABLE = False  # the lines contain pitch and altitude
FILE = "metadata.jsonl"

# `datasets` takes any of these for the name of a split.
_FOLDERS: Mapping[str, Split] = {"train": "train", "val": "val", "validation": "val", "valid": "val", "test": "test"}
_SCALE = "temperature_scale"
# Columns of pictures that may be null, and what is lost where a split has no value at all.
_NULLABLE = {n: FIELDS[f.field][1] for n, f in FACTS.items() if f.type is not str} | {_SCALE: FIELDS["temperature"][1]}
# Columns of texts that every line has, empty where unknown; further texts are columns if any picture has one.
_TEXTS = ("time_of_day", "sequence", "captured")
_UNKNOWN_VISIBILITY = -1.0
_OBJECTS = "objects"
_DIGITS = 9
_ON = "on "  # before dates


# -- writing ---------------------------------------------------------------------------------------------------


def write(
    out: Path, images: Iterable[ImageRecord], categories: Sequence[Category], *, pictures: bool = True
) -> Written:
    """Write `<split>/metadata.jsonl`, and link the pictures into the same folders unless they are there already.

    Masks are COCO's compressed run lengths, of a frame of `height` by `width`. An oriented box is written for every
    object as soon as one has it; `oriented` states whether it is more than the corners of the axis-aligned box.

    Raises:
        OutputError: A file cannot be written.
        ValueError: A size is missing, or a category is not in the list.
    """
    ordered = in_order(images)
    losses: Counter[str] = Counter()
    parts = split_parts(ordered)
    table = _Columns.of(ordered, categories)
    typed = {split: _Typed.of(part) for split, part in parts.items()}
    written, dropped, problems = _drop_untyped(typed, losses)
    table = replace(table, dropped=dropped)
    files = []
    for split in written:
        files.append(write_chunks(out / split / FILE, table.lines(parts[split], typed[split], losses)))
    for image in ordered if pictures else ():
        files.append(link_or_copy(image.path, out / image.split / image.name))
    return Written.of(files, losses, problems)


@dataclass(frozen=True)
class _Columns:
    """Columns of the objects of one dataset: those that every object has, and those that any object needs.

    Attributes:
        ids: Number of each category.
        ignored: Names of the categories to ignore.
        optional: Value of each further column for an object.
        texts: Columns of pictures with texts.
        dropped: Columns of pictures that are left out.
    """

    ids: Mapping[str, int]
    ignored: frozenset[str]
    optional: Mapping[str, Callable[[Instance], Any]]
    texts: Sequence[str] = _TEXTS
    dropped: frozenset[str] = frozenset()

    @classmethod
    def of(cls, images: Sequence[ImageRecord], categories: Sequence[Category]) -> _Columns:
        """Return the columns that the objects of the images need."""
        needed: set[str] = set()
        for image in images:
            needed |= image.capture.to_json().keys()
            for o in image.instances:
                needed |= {n for n, (is_needed, _) in _OPTIONAL.items() if n not in needed and is_needed(o)}
        optional = {n: value for n, (_, value) in _OPTIONAL.items() if n in needed}
        texts = [n for n, f in FACTS.items() if f.type is str and (n in _TEXTS or n in needed)]
        ignored = frozenset(c.name for c in categories if c.ignore)
        return cls(category_ids(categories), ignored, optional, tuple(texts))

    def lines(self, images: Sequence[ImageRecord], typed: _Typed, losses: Counter[str]) -> Iterator[str]:
        """Yield the lines of a split: first those that give each column its type, then the others in order."""
        ahead = sorted({n for name, n in typed.first.items() if name not in self.dropped})
        rest = (image for n, image in enumerate(images) if n not in set(ahead))
        for image in chain((images[n] for n in ahead), rest):
            losses["ignore_as_class"] += count_crowds(image.instances, self.ignored)
            row = {k: v for k, v in self.row(image).items() if k not in self.dropped}
            yield json.dumps(finite(row, losses), allow_nan=False, separators=(",", ":")) + "\n"

    def row(self, image: ImageRecord) -> dict[str, object]:
        """Return the line of a picture; the columns in `_NULLABLE` may be null."""
        w, h = require_size(image)
        facts = image.capture.to_json()
        scale = image.capture.scale
        require_known(image, self.ids)
        return {
            "file_name": image.name,
            "width": w,
            "height": h,
            # A column of one type: no whole numbers among others.
            **{n: None if (v := facts.get(n)) is None else FACTS[n].type(v) for n in _NULLABLE if n != _SCALE},
            _SCALE: None if scale is None else scale.to_json(),
            **{name: _as_text(facts.get(name)) for name in self.texts},
            _OBJECTS: {
                "bbox": [_xywh(i.box_xyxy) for i in image.instances],
                "category": [i.category for i in image.instances],
                "category_id": [self.ids[i.category] for i in image.instances],
                "ignore": [i.category in self.ignored for i in image.instances],
                "inserted": [i.inserted for i in image.instances],
                **{name: [value(i) for i in image.instances] for name, value in self.optional.items()},
            },
        }


def _as_text(value: str | None) -> str:
    """Return a text that Arrow does not take for a time, which is another type than that of an empty text."""
    return f"{_ON}{value}" if value and value[:4].isdigit() and value[4:5] == "-" else value or ""


def _tidy(values: NDArray[np.float64]) -> list[float]:
    return [round(float(v), _DIGITS) for v in values.reshape(-1)]


def _xywh(xyxy: NDArray[np.float64]) -> list[float]:
    return _tidy(np.concatenate([xyxy[:2], xyxy[2:] - xyxy[:2]]))


def _obb(i: Instance) -> list[float]:
    return _tidy(corners_of_box(i.box_xyxy) if i.corners_xy is None else i.corners_xy)


def _extra_box(name: str) -> tuple[Callable[[Instance], bool], Callable[[Instance], list[float]]]:
    return lambda i: name in i.extra, lambda i: _xywh(np.array(i.extra.get(name, i.box_xyxy), np.float64))


_OPTIONAL: Mapping[str, tuple[Callable[[Instance], bool], Callable[[Instance], Any]]] = {
    "obb": (lambda i: i.corners_xy is not None, _obb),
    "oriented": (lambda i: i.corners_xy is not None, lambda i: i.corners_xy is not None),
    "segmentation": (lambda i: i.mask is not None, lambda i: "" if i.mask is None else i.mask.counts),
    "visibility": (
        lambda i: i.visibility is not None,
        lambda i: _UNKNOWN_VISIBILITY if i.visibility is None else float(i.visibility),
    ),
    "truncated": (lambda i: i.truncated is not None, lambda i: bool(i.truncated)),
    "difficult": (lambda i: i.difficult is not None, lambda i: bool(i.difficult)),
    "occluded": (lambda i: "occluded" in i.extra, lambda i: bool(i.extra.get("occluded"))),
    **{name: _extra_box(name) for name in BOXES},
    "track_id": (lambda i: i.track_id is not None, lambda i: "" if i.track_id is None else str(i.track_id)),
}
"""Columns of objects that are written if any object of the dataset needs them: when it does, and its value."""


@dataclass(frozen=True)
class _Typed:
    """Pictures of a split that have values of columns which may be null or empty.

    Attributes:
        known: Number of pictures with a value, by column.
        first: Index of the first of them, by column.
    """

    known: Mapping[str, int]
    first: Mapping[str, int]

    @classmethod
    def of(cls, images: Sequence[ImageRecord]) -> _Typed:
        """Return those of the pictures of a split."""
        known: Counter[str] = Counter()
        first: dict[str, int] = {}
        for n, image in enumerate(images):
            facts = image.capture.to_json()
            values = {name: facts.get(name) for name in _NULLABLE}
            values |= {_SCALE: image.capture.scale, _OBJECTS: image.instances or None}
            for name in (k for k, v in values.items() if v is not None):
                known[name] += 1
                first.setdefault(name, n)
        return cls(known, first)


def _drop_untyped(
    typed: Mapping[Split, _Typed], losses: Counter[str]
) -> tuple[list[Split], frozenset[str], list[Problem]]:
    """Return the splits to write, the columns to leave out, and problems.

    A column would have another type in a split without any of its values; what is left out is counted or reported.
    """
    dropped = set()
    for name, loss in _NULLABLE.items():
        known = [t.known.get(name, 0) for t in typed.values()]
        if not all(known):
            losses[loss] += sum(known)
            dropped.add(name)
    empty = [s for s, t in typed.items() if not t.known.get(_OBJECTS)]
    if len(empty) == len(typed):
        return list(typed), frozenset({*dropped, _OBJECTS}), []
    written = [s for s in typed if s not in empty]
    if not empty:
        return written, frozenset(dropped), []
    found = f"no object in any picture of {', '.join(empty)}, so {FILE} is not written for it"
    todo = "load those pictures without metadata, or leave them out"
    problem = Problem(NAME, "split-without-objects", found, "an object in each split", todo, "warning")
    return written, frozenset(dropped), [problem]


# -- reading ---------------------------------------------------------------------------------------------------


def _files(root: Path) -> dict[Path, Split | None]:
    """Return the files with their splits; None for one of the whole folder, in which the pictures' folders tell."""
    files: dict[Path, Split | None] = {p: s for name, s in _FOLDERS.items() for p in _in_folder(root / name)}
    return files or dict.fromkeys(_in_folder(root))


def _in_folder(folder: Path) -> list[Path]:
    lines = files_with(folder, FILE, lambda head: b"file_name" in head or folder.name in _FOLDERS, 1000)
    return lines or files_with(folder, "metadata.csv", lambda head: {"file_name", "objects"} <= titles_of(head), 1000)


def _without_file(root: Path) -> dict[Path, Split]:
    """Return the folders of splits that have pictures, but no file: those of splits without any object."""
    folders = {root / name: split for name, split in _FOLDERS.items()}
    return {p: s for p, s in folders.items() if p.is_dir() and not _in_folder(p)}


def detect(root: Path) -> Match:
    """Decide whether `root`, or its folder of a split, has a `metadata.jsonl`, or `metadata.csv` with objects."""
    files = _files(root)
    if not files:
        return Match(NAME, False, f"no {FILE} in it or in train, val or test")
    return Match(NAME, True, f"imagefolder: {', '.join(p.relative_to(root).as_posix() for p in files)}")


# Columns that are read, or tell nothing more.
_KNOWN = {"file_name", "width", "height", "image_id", "id", _SCALE, _OBJECTS, *FACTS}
_OF_OBJECTS = {"bbox", "category", "categories", "label", "category_id", "ignore", "inserted", "id", "area", *_OPTIONAL}


@dataclass
class _Reading(Findings):
    """What the reader found so far: also the categories by name, in the order in which they were found."""

    categories: dict[str, Category] = field(default_factory=dict)

    def category(self, name: object, number: object, ignore: object) -> str | None:
        """Return the name of an object's category, and enter new ones; None if it has neither name nor number."""
        n = to_int(number)
        text = name if isinstance(name, str) and name.strip() else None if n is None else f"class {n}"
        if text is None:
            return None
        if text not in self.categories:
            taken = {c.id for c in self.categories.values()}
            free = n if n is not None and n not in taken else max(taken, default=-1) + 1
            self.categories[text] = Category(free, text, "", ignore is True or is_ignored_name(text))
        return text


def read(root: Path, *, splits: Iterable[str] | None = None) -> Dataset:
    """Read the lines of every split and find their pictures.

    Raises:
        DatasetError: There is no `metadata.jsonl`, or no picture can be read.
    """
    wanted = check_splits(splits)
    state = _Reading(root)
    records: list[ImageRecord] = []
    files = _files(root)
    for path, stated in files.items():
        if stated not in (*wanted, None):
            continue
        where = state.place(path)
        folder = PictureFolder.scan(path.parent)
        seen: set[str] = set()
        for here, row in _rows(path, where, state):
            split = stated or SPLIT_FOLDERS.get(str(row.get("file_name")).partition("/")[0].lower(), "train")
            record = _read_row(row, here, split, folder, state)
            if record is not None and record.name in seen:
                state.add(here, "image-duplicate", f"a second line for {record.name!r}", "each picture once")
            elif record is not None:
                seen.add(record.name)
                records += [record] if split in wanted else []
    for path, split in _without_file(root).items() if records and None not in files.values() else ():
        folder = PictureFolder.scan(path)
        if split not in wanted or not folder.by_name:
            continue
        where = state.place(path)
        for name in sorted(folder.by_name):
            record = _read_row({"file_name": name}, where, split, folder, state)
            records += [] if record is None else [record]
        text = f"{len(folder.by_name)} picture(s) without a {FILE}, read as pictures without objects"
        state.warn(where, "image-unlisted", text, "a line per picture")
    if not records:
        state.add(str(root), "annotation-missing", "no picture with a line", f"<split>/{FILE}")
        raise DatasetError(f"{root}: nothing to read in {', '.join(wanted)}", shorten(state.problems))
    state.report_left_out()
    ordered = tuple(sorted(state.categories.values(), key=lambda c: c.id))
    return Dataset(root, NAME, ordered, with_ids(records), tuple(state.problems), {"labels": NAME})


def _rows(path: Path, where: str, state: _Reading) -> Iterator[tuple[str, dict[str, object]]]:
    """Yield the place and the columns of each line of a file."""
    if path.suffix == ".csv":
        try:
            rows = csv_rows(path)
        except DatasetError as error:
            state.add_all(error.problems, where)
            return
        for place, cells in rows:
            if SURPLUS in cells:
                state.add(f"{where}: {place}", "table-value", "more cells than columns", "a cell for each column")
                continue
            row = {k: v for k, v in cells.items() if v}
            yield f"{where}: {place}", {**row, _OBJECTS: _json(str(row.get(_OBJECTS, "null")))}
        return
    for n, line in read_lines(path, where, "a line of JSON per picture", state.problems):
        row = _json(line)
        if isinstance(row, dict):
            yield f"{where}: line {n}", row
        else:
            state.add(f"{where}: line {n}", "annotation-not-json", line[:80], "a JSON object", "correct the line")


def _json(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


def _read_row(
    row: Mapping[str, object], where: str, split: Split, folder: PictureFolder, state: _Reading
) -> ImageRecord | None:
    name, picture, fault = folder.find_named(row.get("file_name"), where, f"a file in {folder.folder.name}")
    if fault is not None or picture is None:
        state.problems += [fault] if fault else []
        return None
    for unknown in (k for k in row if k not in _KNOWN and row[k] not in (None, "")):
        state.leave_out(f"column {unknown}", where)
    size_wh = to_size(row.get("width"), row.get("height"))
    facts = {fact: _text(v) if isinstance(v := row.get(fact), str) else v for fact in FACTS}
    capture = Capture.from_json(facts, strict=False)
    capture = replace(capture, radiometry=state.checked(scale_of_record(row.get(_SCALE), NAME, where)))
    instances = _read_objects(row.get("objects"), where, size_wh, state)
    return ImageRecord("", picture, split, size_wh, instances, capture, file_name=name)


def _text(value: object) -> str | None:
    return value.removeprefix(_ON) if isinstance(value, str) and value else None


def _read_objects(value: object, where: str, size_wh: tuple[int, int] | None, state: _Reading) -> tuple[Instance, ...]:
    columns = value if isinstance(value, dict) else {}
    boxes = columns.get("bbox")
    if not isinstance(boxes, list):
        if value is not None:
            state.add(where, "annotation-layout", "objects without a list `bbox`", "bbox: [[x, y, w, h], ...]")
        return ()
    for unknown in (k for k in columns if boxes and k not in _OF_OBJECTS):
        state.leave_out(f"column {unknown} of objects", where)
    # Columns of the wrong length cannot be assigned to objects.
    short = sorted(k for k, v in columns.items() if not isinstance(v, list) or len(v) != len(boxes))
    if short:
        found = f"column {', '.join(map(str, short[:3]))} of objects is no list of {len(boxes)} values"
        state.warn(where, "annotation-layout", found, "a value per object")
    rows = [{k: v[n] for k, v in columns.items() if k not in short} for n in range(len(boxes))]
    read = (_read_object(r, f"{where}: object {n}", size_wh, state) for n, r in enumerate(rows))
    return tuple(i for i in read if i is not None)


def _read_object(
    row: Mapping[str, object], where: str, size_wh: tuple[int, int] | None, state: _Reading
) -> Instance | None:
    # Hugging Face's own examples have numbers in `category` or `categories`.
    named = next((row[k] for k in ("category", "categories", "label") if k in row), None)
    category = state.category(named, row.get("category_id", named), row.get("ignore"))
    xywh = to_floats(row.get("bbox"), 4)
    if category is None or xywh is None:
        state.add(where, "annotation-malformed", json.dumps(row)[:80], "a category and a bbox [x, y, w, h]")
        return None
    box = state.box(edges_of_xywh(xywh, size_wh), size_wh, where)
    if box is None:
        return None
    said = to_floats(row.get("obb"), 8) if row.get("oriented", True) is True else None
    corners = None if said is None or not is_near(said) else np.array(said, np.float64).reshape(4, 2)
    return Instance(
        category,
        box,
        None if corners is None else clockwise_corners(corners),
        _read_mask(row.get("segmentation"), size_wh, where, state),
        to_share(row.get("visibility")),
        to_bool(row.get("truncated")),
        to_bool(row.get("difficult")),
        row.get("inserted") is True,
        None,
        _read_occlusion(row, size_wh),
        _text(track) if isinstance(track := row.get("track_id"), str) else to_id(track),
    )


def _read_occlusion(row: Mapping[str, object], size_wh: tuple[int, int] | None) -> dict[str, object]:
    """Return the flag, and the whole and the visible box where the object is hidden in part."""
    found: dict[str, object] = {"occluded": row["occluded"]} if isinstance(row.get("occluded"), bool) else {}
    boxes = {name: to_floats(row.get(name), 4) for name in BOXES}
    if found.get("occluded") is True and all(b is not None and is_near(b) for b in boxes.values()):
        found |= {name: list(edges_of_xywh(b, size_wh)) for name, b in boxes.items() if b is not None}
    return found


def _read_mask(value: object, size_wh: tuple[int, int] | None, where: str, state: _Reading) -> Mask | None:
    if size_wh is None or not isinstance(value, str) or not value:
        return None
    size_hw = (size_wh[1], size_wh[0])
    try:
        return Mask.from_coco({"size": list(size_hw), "counts": value}, size_hw)
    except (ValueError, OverflowError) as error:
        found = f"a segmentation that cannot be read and is left out ({error})"
        state.warn(where, "mask-malformed", found, "COCO run lengths")
        return None
