"""The last steps of readers whose files contain no ids and no pitch: from records to a dataset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from infrablend.core.dataset import Category, Dataset, ImageRecord, Split
from infrablend.errors import DatasetError, Problem
from infrablend.formats.base import shorten, sort_images
from infrablend.formats.capture import Captures, find_table, read_table
from infrablend.formats.pictures import assign_ids

KEEP_OR_DROP = ("keep", "drop")


def make_dataset(
    root: Path,
    format: str,
    records: Sequence[ImageRecord],
    categories: Sequence[Category],
    problems: Sequence[Problem],
    notes: Mapping[str, Any],
    *,
    metadata: Path | None = None,
    splits: Sequence[Split] = (),
) -> Dataset:
    """Return a dataset of records without ids, which get an id, and pitch and altitude from a table or their names.

    Args:
        root: Folder of the dataset, with the picture of every record, or the file that the picture was made from.
        format: Name of the format.
        records: Records of the reader.
        categories: Categories of the dataset.
        problems: Problems found so far.
        notes: Facts of the reader, to which `pitch` (its sources) and `table` are added.
        metadata: Table of pitch and altitude; None uses `metadata.csv` or `.json` in the folder, if it exists.
        splits: Requested splits, for the error message if nothing is left.

    Raises:
        DatasetError: No record is left, or the table cannot be read.
    """
    found = list(problems)
    inside = {_name_in(root, r): r for r in records}
    if not inside:
        asked = f" in the splits {', '.join(splits)}" if splits else ""
        missing = Problem(str(root), "image-missing", "no usable picture" + asked, "JPEG, PNG, BMP or TIFF")
        raise DatasetError(f"{root}: no picture to read", shorten([*found, missing]))
    path = metadata or find_table(root)
    table = read_table(path) if path else None
    captures = Captures(table, found)
    ids = assign_ids(inside)
    complete = []
    for name, record in sorted(inside.items()):
        capture = captures.of(name, name, record.capture)
        complete.append(replace(record, id=ids[name], capture=capture))
    if table is not None:
        found += table.problems
        unused = table.unused(inside, {r.capture.sequence for r in inside.values()})
        if unused:
            text = f"{len(unused)} row(s) of the table match no picture and no sequence: {', '.join(unused[:3])}"
            found.append(
                Problem(root.name, "table-unused", text, "a picture or sequence for each row", severity="warning")
            )
    more = {"table": path.name if path else None, "pitch": captures.note()}
    return Dataset(root, format, tuple(categories), sort_images(complete), tuple(found), {**notes, **more})


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
