"""Find label files that a reader did not understand, so that lost labels do not look like pictures without objects."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from pathlib import Path, PurePosixPath

from infrablend.core.dataset import Dataset
from infrablend.core.file_names import fold_name
from infrablend.core.json_records import is_list
from infrablend.errors import DatasetError, Problem
from infrablend.formats import coco, folder, yolo
from infrablend.formats.annotation_files import read_json, read_xml
from infrablend.formats.pictures import PICTURE_SUFFIXES, is_hidden, list_pictures, walk

_SUFFIXES = {".xml", ".json", ".txt", ".csv", ".label"}
_PART = re.compile(r"\.part(-\d+)?$")
_EXPECTED = "a label file that can be read"


def unread_label_files(dataset: Dataset, understood: Collection[Path] = ()) -> list[Problem]:
    """Return a problem for every label file below the dataset's folder that its reader did not understand.

    These are damaged XML and JSON files, and text files with a suffix such as `.TXT`. In a plain folder of pictures,
    whose labels were not recognised, they are also files named like a picture, and intact annotations.

    Args:
        dataset: The dataset.
        understood: Files that are known to be intact, and are not read again (see `noting_understood`).
    """
    stems = {fold_name(i.path.stem) for i in dataset.images}
    plain = dataset.format == folder.NAME
    used = _used(dataset) if plain else set()
    reported = {p.where.partition(":")[0] for p in dataset.problems if p.severity == "error"}
    problems = []
    for name in _candidates(dataset.root):
        path = dataset.root / name
        if name in reported or PurePosixPath(name).name in reported or path in used:
            continue
        found, todo = "" if path in understood else _fault(path, name), "restore or remove the file"
        if not found and path.suffix != path.suffix.lower() == ".txt" and fold_name(path.stem) in stems:
            found, todo = f"labels with the suffix {path.suffix}, which are not read", "rename it to .txt"
        if not found and plain and (fold_name(path.stem) in stems or _is_annotation(path, name)):
            found = "labels in no known layout, which are not read"
            todo = "see docs/formats, and name the format with --format"
        if found:
            problems.append(Problem(name, "label-unread", found, _EXPECTED, todo))
    return problems


def hidden_pictures(root: Path) -> list[Problem]:
    """Return a warning if there are hidden pictures with label files of their stems: no reader takes them."""
    pictures: list[str] = []
    labelled: set[str] = set()
    for base, names in walk(root):
        for path in (Path(base, n) for n in names if is_hidden(n)):
            if path.name.startswith("._") or _PART.search(path.stem):  # notes of macOS; parts of files
                continue
            if path.suffix.lower() in PICTURE_SUFFIXES:
                pictures.append(path.relative_to(root).as_posix())
            elif path.suffix.lower() in _SUFFIXES:
                labelled.add(path.stem)
    left_out = sorted(p for p in pictures if PurePosixPath(p).stem in labelled)
    if not left_out:
        return []
    found = f"{len(left_out)} hidden picture(s) with labels, left out, such as {left_out[0]}"
    expected, todo = "names that do not begin with a dot", "rename pictures and label files"
    return [Problem(root.name, "picture-hidden", found, expected, todo, "warning")]


def _candidates(root: Path) -> Iterator[str]:
    """Yield the files below a folder that may be label files, by relative POSIX path, sorted within each folder."""
    for base, names in walk(root):
        prefix = "" if Path(base) == root else Path(base).relative_to(root).as_posix() + "/"
        yield from (
            prefix + n for n in sorted(names) if not is_hidden(n) and PurePosixPath(n).suffix.lower() in _SUFFIXES
        )


def _used(dataset: Dataset) -> set[Path]:
    root = dataset.root
    labels = {yolo.find_label(p, root) for p in list_pictures(root).values()}
    files = set(coco.find_files(root)) if dataset.notes.get("labels") == "coco" else set()
    table = dataset.notes.get("table")
    return {p for p in labels if p is not None} | files | ({root / table} if table else set())


def _fault(path: Path, name: str) -> str:
    """Return why an XML or JSON file cannot be read; empty for readable files and those of other types."""
    if path.suffix.lower() == ".xml":
        problem = read_xml(path, name)[1]
        return "" if problem is None else problem.found
    if path.suffix.lower() == ".json":
        try:
            read_json(path)
        except DatasetError as error:
            return error.problems[0].found
    return ""


def _is_annotation(path: Path, name: str) -> bool:
    """Return whether a readable file contains annotations of a usual layout, whatever its name."""
    if path.suffix.lower() == ".xml":
        return bool(read_xml(path, name)[0].tag == "annotation")
    if path.suffix.lower() == ".json":
        top = read_json(path)
        return isinstance(top, dict) and is_list(top.get("annotations", top.get("annotation")))
    return False
