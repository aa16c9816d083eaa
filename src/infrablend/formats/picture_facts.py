"""How pictures were taken, from their file names or from a table."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

from infrablend.core.capture import FACTS, UNKNOWN, Capture
from infrablend.core.json_records import is_list, is_table
from infrablend.errors import DatasetError, Problem
from infrablend.formats.annotation_files import comma_of, delimiter_of, files_with, read_json, read_text, titles_of
from infrablend.formats.values import to_time

TABLE_NAMES = ("metadata.csv", "metadata.json")
_KEYS = ("file", "file_name", "stem", "sequence")
# Facts that a row for a whole sequence cannot state, because they are those of one picture.
_OF_PICTURE = ("sequence", "captured", "frame", "time_s")
SURPLUS = "\0"
"""Key of the cells of a row beyond the last column."""
# HIT-UAV's grammar T_HHH_AA_W_NNNNN, open for other heights and angles, plus our own suffix for a configuration.
_NAME = re.compile(r"([01])_(\d{1,4})_(\d{1,2})_([01])_(\d{1,9})(?:_c(\d+))?", re.ASCII)


@dataclass(frozen=True)
class NameFacts:
    """Parts of a file name in HIT-UAV's grammar."""

    capture: Capture
    weather: int
    frame: int
    configuration: int | None


def facts_from_name(name: str) -> NameFacts | None:
    """Return the parts of a name `T_HHH_AA_W_NNNNN[_c<k>][.ext]` (folders are ignored), or None for other names."""
    base = PurePosixPath(name).name
    stem = base.rpartition(".")[0] if "." in base else base
    match = _NAME.fullmatch(stem)
    if match is None or int(match[3]) > 90:
        return None
    capture = Capture(float(match[3]), float(match[2]), "night" if match[1] == "1" else "day")
    return NameFacts(capture, int(match[4]), int(match[5]), None if match[6] is None else int(match[6]))


def find_table(root: Path) -> Path | None:
    """Return `metadata.csv` or `metadata.json` in the folder, in this order, or None.

    Hugging Face calls a table of labels or texts `metadata.csv`, too: with a column `file_name`, and none of ours.
    """
    foreign = files_with(
        root, TABLE_NAMES[0], lambda head: "file_name" in (t := titles_of(head)) and not t & set(FACTS), 1000
    )
    return next((p for n in TABLE_NAMES if (p := root / n).is_file() and p not in foreign), None)


def _keys(name: str) -> tuple[str, ...]:
    """Return the keys of a relative path: itself, without suffix, the file name, the stem."""
    path = PurePosixPath(name)
    return name, str(path.with_suffix("")), path.name, path.stem


@dataclass(frozen=True)
class CaptureTable:
    """A table of captures by file path, file name, stem or sequence."""

    rows: Mapping[str, Capture]
    problems: tuple[Problem, ...]
    name: str = "table"

    def find(self, name: str) -> Capture | None:
        """Return the row for a relative path: by the path, else by the file name, else by the stem."""
        return next((self.rows[k] for k in _keys(name) if k in self.rows), None)

    def unused(self, names: Iterable[str], sequences: Iterable[str | None] = ()) -> list[str]:
        """Return the keys that match none of the relative paths and none of the sequences."""
        known = {k for name in names for k in _keys(name)} | {*sequences}
        return sorted(k for k in self.rows if k not in known)

    def remarks(self, root: Path, names: Iterable[str], sequences: Iterable[str | None] = ()) -> list[Problem]:
        """Return a warning if rows match none of the relative paths and none of the sequences."""
        unused = self.unused(names, sequences)
        if not unused:
            return []
        found = f"{len(unused)} row(s) of the table match no picture and no sequence: {', '.join(unused[:3])}"
        expected = "a picture or sequence for each row"
        return [Problem(root.name, "table-unused", found, expected, severity="warning")]


@dataclass
class Captures:
    """Looks up how each picture of a dataset was taken, and counts the sources of the pitch.

    The most particular counts: a table's row for the picture, the annotation, the file name, a row for the sequence.

    Attributes:
        table: Table given by the user or found in the dataset, or None.
        problems: List to which contradictions between the sources are appended, as warnings.
        sources: Pictures by source of the pitch.
    """

    table: CaptureTable | None
    problems: list[Problem]
    sources: Counter[str] = field(default_factory=Counter)

    def of(self, name: str, where: str, inside: Capture = UNKNOWN) -> Capture:
        """Return how a picture was taken.

        Args:
            name: Relative path, as in tables; the file name itself may contain the values, too.
            where: Name of the picture in problems.
            inside: Values in the annotation.
        """
        facts = facts_from_name(name)
        sources = [("annotation", inside), ("file names", facts.capture if facts else UNKNOWN)]
        flight = inside.sequence
        if self.table is not None:
            row = self.table.find(name)
            if row is not None:
                for conflict in row.conflicts(inside.over(sources[1][1])):
                    found = f"{conflict} (table, annotation or file name); the table is used"
                    self.problems.append(Problem(where, "metadata-disagrees", found, "the same", severity="warning"))
                sources.insert(0, (f"table {self.table.name} per file", row))
                flight = row.sequence or flight
            of_sequence = self.table.rows.get(flight or "")
            if of_sequence is not None and of_sequence is not row:
                sources.append((f"table {self.table.name} per sequence", of_sequence))
        self.sources[next((kind for kind, c in sources if c.pitch_deg is not None), "none")] += 1
        known = UNKNOWN
        for _, c in sources:
            known = known.over(c)
        return known

    def note(self) -> str:
        """Return the sources of the pitch for `Dataset.notes["pitch"]`, see `pitch_note`."""
        return pitch_note(self.sources)


def pitch_note(sources: Mapping[str, int]) -> str:
    """Return the sources of the pictures' pitch in words: `file names`, or `annotation (20 of 30), none (10 of 30)`."""
    left = {kind: n for kind, n in sorted(sources.items()) if n}
    if len(left) < 2:
        return next(iter(left), "none")
    return ", ".join(f"{kind} ({n} of {sum(left.values())})" for kind, n in left.items())


def read_table(path: Path) -> CaptureTable:
    """Read a CSV or JSON table of captures by `file`, `stem` or `sequence`, with some of the fields of a `Capture`.

    A row for a picture may also name its `sequence` and when it was `captured`. Other columns are not read. CSV: a
    header line. JSON: a list of records, or one object with the file names, stems or sequences as keys. Rows
    with a bad value are skipped as errors; empty fields are unknown.

    Raises:
        DatasetError: The file cannot be read, or has no such columns.
    """
    return table_of_rows(path, _json_rows(path) if path.suffix.lower() == ".json" else csv_rows(path))


def table_of_rows(path: Path, rows: Sequence[tuple[str, Mapping[str, object]]]) -> CaptureTable:
    """Return the table in rows, each with its place; see `read_table`, also for what is raised."""
    columns = {k for _, row in rows for k in row}
    keys = columns & set(_KEYS)
    facts = columns & FACTS.keys() - ({"sequence"} if keys == {"sequence"} else set())
    if not rows or not keys or not facts:
        found = f"columns {', '.join(sorted(columns)) or 'none'}"
        expected = f"one of {', '.join(_KEYS)} and some of {', '.join(FACTS)}"
        problem = Problem(path.name, "table-columns", found, expected, "rename the columns")
        raise DatasetError(f"{path}: no table of pitch and altitude", [problem])
    problems: list[Problem] = []
    unknown = sorted(columns - {*_KEYS, *FACTS, SURPLUS, ""})
    if unknown:
        found = f"unknown columns {', '.join(unknown)}, ignored"
        problems.append(Problem(path.name, "table-columns", found, severity="warning"))
    captures: dict[str, Capture] = {}
    for where, row in rows:
        key = next((v for k in _KEYS if (v := str(row.get(k) or "").strip())), "")
        capture, fault = _capture(row)
        surplus = row.get(SURPLUS)
        if isinstance(surplus, list):
            fault = ("table-value", f"{len(surplus)} cell(s) more than columns", "a cell for each column")
        elif not key:
            fault = ("table-value", "no file, stem or sequence", "the name of a picture or sequence")
        elif fault is None and key in captures:
            fault = ("table-duplicate", f"a second row for {key!r}", "one row for each")
        if fault is not None:
            problems.append(Problem(f"{path.name}: {where}", *fault, "correct the table"))
            continue
        of_picture = any(str(row.get(k) or "").strip() for k in _KEYS[:3])
        known = capture if of_picture else replace(capture, **dict.fromkeys(_OF_PICTURE))
        captures[key.removeprefix("./")] = known
    return CaptureTable(captures, tuple(problems), path.name)


def csv_rows(path: Path) -> list[tuple[str, dict[str, object]]]:
    """Return the rows of a table with commas, semicolons or tabs; numbers may have decimal commas."""
    text, problem = read_text(path, path.name, "a CSV table")
    if problem is None:
        try:
            delimiter = delimiter_of(text)
            reader = csv.reader(io.StringIO(text, newline=""), strict=True, delimiter=delimiter)
            lines = [(f"line {reader.line_num}", cells) for cells in reader if cells]
        except csv.Error as error:
            problem = Problem(path.name, "table-unreadable", str(error), "a CSV table")
        else:
            titles = [c.strip() for c in lines[0][1]] if lines else []
            twice = sorted({c for c in titles if c and titles.count(c) > 1})
            if not twice:
                return _records(titles, lines[1:], comma_of([cells for _, cells in lines[1:]], delimiter))
            found = f"column(s) {', '.join(twice)} more than once"
            problem = Problem(path.name, "table-columns", found, "each column once", "remove the wrong one")
    raise DatasetError(f"{path}: cannot be read", [problem])


def _records(
    titles: Sequence[str], lines: Sequence[tuple[str, Sequence[str]]], comma: str
) -> list[tuple[str, dict[str, object]]]:
    numbers = {name for name, fact in FACTS.items() if fact.type is not str}
    records = []
    for where, cells in lines:
        row: dict[str, object] = {
            k: v.replace(",", comma) if k in numbers else v for k, v in zip(titles, cells, strict=False)
        }
        if any(c.strip() for c in cells[len(titles) :]):
            row[SURPLUS] = cells[len(titles) :]
        records.append((where, row))
    return records


def _json_rows(path: Path) -> list[tuple[str, dict[str, object]]]:
    value = read_json(path, rows=True)
    if is_table(value):
        value = [{"file": k, **v} for k, v in sorted(value.items()) if isinstance(v, dict)]
    if not is_list(value):
        return []
    return [(f"record {i}", r) for i, r in enumerate(value) if isinstance(r, dict)]


def _capture(row: Mapping[str, object]) -> tuple[Capture, tuple[str, str, str] | None]:
    """Return the facts of a row, or what is wrong with it."""
    known = {name: str(row[name]).strip() for name in FACTS if row.get(name) is not None}
    known = {name: text for name, text in known.items() if text}
    values: dict[str, Any] = {}
    for name, text in known.items():
        try:
            values[name] = _read_cell(name, text)
        except (ValueError, OverflowError):
            return Capture(), ("table-value", f"{name} {row[name]!r}", f"{FACTS[name].expected}, or nothing")
    return Capture(**values), None


def _read_cell(name: str, text: str) -> Any:
    """Return a fact; ValueError if the text is no such fact."""
    if name == "captured" and to_time(text) is None:
        raise ValueError
    return FACTS[name].read(text.casefold() if name == "time_of_day" else text)


def fits_table(name: str, value: object) -> bool:
    """Return whether a table gives back this value of a fact."""
    try:
        return bool(_read_cell(name, str(value).strip()) == value)
    except (ValueError, OverflowError):
        return False
