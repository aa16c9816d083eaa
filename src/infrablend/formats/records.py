"""What readers share: the problems and counts on the way, and the last steps from records to a dataset."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import Category, Dataset, ImageRecord, Split
from infrablend.core.mesh import FloatArray
from infrablend.errors import DatasetError, Problem
from infrablend.formats.annotation_files import read_json, read_text, read_xml
from infrablend.formats.base import shorten, sort_images
from infrablend.formats.box_checks import check_box
from infrablend.formats.picture_facts import Captures, CaptureTable, find_table, read_table
from infrablend.formats.pictures import derived
from infrablend.formats.pictures.listing import assign_ids, read_size
from infrablend.formats.pictures.video import Video
from infrablend.imaging.paint_out import How

T = TypeVar("T")
KEEP_OR_DROP = ("keep", "drop")
LEFT_OUT = "left out"
"""How the problem of pictures without labels ends that a reader left out."""


@dataclass
class Findings:
    """What a reader finds in the folder of a dataset: problems, counts for its notes, kinds left out."""

    root: Path
    problems: list[Problem] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    left_out: Counter[str] = field(default_factory=Counter)
    left_out_at: str = ""

    def add(self, where: str, code: str, found: str, expected: str = "", todo: str = "") -> None:
        """Record an error: the item is left out."""
        self.problems.append(Problem(where, code, found, expected, todo))

    def warn(self, where: str, code: str, found: str, expected: str = "", todo: str = "") -> None:
        """Record a warning: the item is kept."""
        self.problems.append(Problem(where, code, found, expected, todo, "warning"))

    def leave_out(self, kind: str, where: str, count: int = 1) -> None:
        """Count things that the reader does not understand; `report_left_out` reports all of them at once."""
        self.left_out[kind[:40]] += count
        self.left_out_at = self.left_out_at or where

    def report_left_out(self) -> None:
        """Record a warning with the number of each kind that was left out, at the place of the first."""
        if self.left_out:
            listed = ", ".join(f"{n} {kind}" for kind, n in sorted(self.left_out.items()))
            found = f"left out (in all; the first is here): {listed}"[:400]
            self.warn(self.left_out_at, "kind-unread", found, "kinds that are read, see docs/formats")

    def add_all(self, problems: Iterable[Problem], where: str) -> None:
        """Record the problems of a file under its name in the dataset."""
        self.problems += [replace(p, where=where) for p in problems]

    @cached_property
    def folder(self) -> Path:
        """Folder of the dataset; of a single video, the one that it is in."""
        return self.root if self.root.is_dir() else self.root.parent

    def place(self, path: Path) -> str:
        """Return the name of a file in problems: its path below the dataset's folder."""
        return path.relative_to(self.folder).as_posix()

    def rows(self, *keys: str) -> dict[str, int]:
        """Return some of the counts, for `Dataset.notes`."""
        return {k: self.counts[k] for k in keys}

    def checked(self, result: tuple[Any, Problem | None]) -> Any:
        """Return a result after recording its problem, if there is one."""
        value, problem = result
        self.problems += [problem] if problem else []
        return value

    def box(self, xyxy: Sequence[float], size_wh: tuple[int, int] | None, where: str) -> NDArray[np.float64] | None:
        """Return what `check_box` leaves of a box; None for no box, with a problem."""
        box: NDArray[np.float64] | None = self.checked(check_box(xyxy, size_wh, where))
        return box

    def size(self, path: Path, where: str) -> tuple[int, int] | None:
        """Return a picture's size from its header; None, with a problem, if it cannot be read."""
        size_wh: tuple[int, int] | None = self.checked(read_size(path, where))
        return size_wh

    def text(self, path: Path, expected: str) -> str | None:
        """Return the text of a file; None, with a problem, if it cannot be read."""
        text, problem = read_text(path, self.place(path), expected)
        if problem is not None:
            self.problems.append(problem)
            return None
        return text

    def track_twice(self, where: str, track: int, frame: int, todo: str = "") -> None:
        """Warn of a second label of one object in a frame."""
        found = f"object {track} occurs twice in frame {frame}; both are kept"
        self.warn(where, "track-twice", found, "each object once per frame", todo)

    def own_table(self, name: str, columns: Sequence[str]) -> list[list[str]]:
        """Return the rows, with the titles, of a table that our writer adds; none if there is no such file."""
        path = self.root / name
        text = self.text(path, ",".join(columns)) if path.is_file() else None
        try:
            return list(csv.reader(io.StringIO(text or "", newline="")))
        except csv.Error as error:
            self.add(name, "table-unreadable", str(error), "a CSV table")
            return []

    def own_rows(self, name: str, columns: Sequence[str], read_row: Callable[[list[str]], T | None]) -> list[T]:
        """Return what each row says of a table that our writer adds; rows that `read_row` cannot read are errors."""
        said = []
        for number, row in enumerate(self.own_table(name, columns)[1:], 2):
            value = read_row(row) if len(row) == len(columns) else None
            if value is None:
                found = repr(",".join(row))[:80]
                self.add(f"{name}: line {number}", "row-malformed", found, ",".join(columns), "correct the line")
            else:
                said.append(value)
        return said

    def xml(self, path: Path) -> Any:
        """Return the root element of an XML file; None, with a problem, if it cannot be read."""
        return self.checked(read_xml(path, self.place(path)))

    def json(self, path: Path) -> dict[str, Any] | None:
        """Return the object in a JSON file, empty if it holds something else; None, with problems, if unreadable."""
        try:
            top = read_json(path)
        except DatasetError as error:
            self.add_all(error.problems, self.place(path))
            return None
        return top if isinstance(top, dict) else {}

    def video_frames(self, path: Path, numbers: Sequence[int], left: float = 1.0) -> Mapping[int, Path] | None:
        """Return the pictures of a video's frames, see `derived.video_frames`; None, with problems, if unreadable."""
        try:
            frames, problems = derived.video_frames(path, numbers, left)
        except DatasetError as error:
            self.add_all(error.problems, self.place(path))
            return None
        self.add_all(problems, self.place(path))
        return frames

    def video_times(self, path: Path) -> Sequence[float] | None:
        """Return the second of each frame of a video, from the first; None, with problems, if it is unreadable."""
        try:
            return Video(path).timeline.seconds
        except DatasetError as error:
            self.add_all(error.problems, self.place(path))
            return None

    def painted_frames(
        self, path: Path, numbers: Sequence[int], boxes: Sequence[FloatArray | None]
    ) -> Mapping[int, tuple[Path, How]] | None:
        """Return frames without their object, see `derived.painted_frames`; None, with problems, if unreadable."""
        try:
            frames, problems = derived.painted_frames(path, numbers, boxes)
        except DatasetError as error:
            self.add_all(error.problems, self.place(path))
            return None
        # The frames as they are were read before, with the same faults.
        where = self.place(path)
        known = {(p.where, p.code) for p in self.problems}
        self.add_all([p for p in problems if (where, p.code) not in known], where)
        return frames

    def dataset(
        self,
        format: str,
        records: Iterable[ImageRecord],
        categories: Sequence[Category],
        notes: Mapping[str, object],
        *,
        metadata: Path | None = None,
        splits: Sequence[Split] = (),
        others: Iterable[str] = (),
    ) -> Dataset:
        """Return a dataset of records, which get an id, and pitch and altitude from a table or their names.

        Args:
            format: Name of the format.
            records: Records without ids.
            categories: Categories of the dataset.
            notes: Facts of the reader, to which `pitch` (its sources) and `table` are added.
            metadata: Table of pitch and altitude; None uses `metadata.csv` or `.json` in the folder, if it exists.
            splits: Requested splits, for the error message if nothing is left.
            others: Further pictures that the table may have rows for.

        Raises:
            DatasetError: No record is left, or the table cannot be read.
        """
        root = self.root
        self.report_left_out()
        inside: dict[str, ImageRecord] = {}
        for name, record in sorted(((_name_in(root, r), r) for r in records), key=lambda named: named[0]):
            if name in inside:
                found = f"a second picture of this name; it is left out, with {len(record.instances)} object(s)"
                self.add(name, "image-duplicate", found, "one picture per name", "rename one of them")
            inside.setdefault(name, record)
        names = list(inside)
        if not inside:
            asked = f" in the splits {', '.join(splits)}" if splits else ""
            self.add(str(root), "image-missing", "no usable picture" + asked, "JPEG, PNG, BMP, TIFF or WebP")
            raise DatasetError(f"{root}: no picture to read", shorten(self.problems))
        table, more = table_of(root, metadata)
        captures = Captures(table, self.problems)
        ids = assign_ids(names)
        complete = [
            replace(record, id=ids[name], capture=captures.of(name, name, record.capture))
            for name, record in inside.items()
        ]
        if table is not None:
            self.problems += table.problems
            self.problems += table.remarks(root, [*names, *others], {r.capture.sequence for r in inside.values()})
        more |= {"pitch": captures.note()}
        return Dataset(root, format, tuple(categories), sort_images(complete), tuple(self.problems), {**notes, **more})


def table_of(root: Path, metadata: Path | None) -> tuple[CaptureTable | None, dict[str, str | None]]:
    """Return the table of pitch and altitude, given or found in the folder, and its name as a note."""
    path = metadata or find_table(root)
    return (read_table(path), {"table": path.name}) if path else (None, {"table": None})


def with_ids(records: Sequence[ImageRecord]) -> tuple[ImageRecord, ...]:
    """Return the records with ids made from split and name, sorted."""
    names = [f"{r.split}/{r.name}" for r in records]
    ids = assign_ids(names)
    return sort_images(replace(r, id=ids[name]) for name, r in zip(names, records, strict=True))


def _name_in(root: Path, record: ImageRecord) -> str:
    """Return the path of a record's picture in the dataset, or the name that a reader gave to one that it made."""
    if record.path.is_relative_to(root):
        return record.path.relative_to(root).as_posix()
    return f"{record.split}/{record.name}"


def annotated_twice(left_out: Mapping[str, Sequence[ImageRecord]]) -> list[Problem]:
    """Return an error per file for its annotations of pictures that were read before, in it or another file."""
    problems = []
    for where, records in left_out.items():
        objects = sum(len(r.instances) for r in records)
        found = f"{len(records)} picture(s) that another file or an earlier entry annotates too, such as "
        found += f"{records[0].name!r}; left out here with {objects} object(s)"
        todo = "remove the file whose labels are out of date"
        problems.append(Problem(where, "image-duplicate", found, "each picture once", todo))
    return problems


def unlabelled_problems(where: str, count: int, choice: str, what: str = "no label file") -> list[Problem]:
    """Return the warning for unlabelled pictures, which may show objects."""
    if not count:
        return []
    kept = choice == "keep"
    found = f"{count} picture(s) with {what}: {'kept, marked as not labelled' if kept else 'left out'}"
    todo = "add their labels, or leave them out with --read unlabelled=drop" if kept else ""
    return [Problem(where, "label-missing", found, "labels for each picture", todo, "warning")]
