"""A plain folder of pictures, with YOLO or COCO labels or none, and perhaps a table of pitch and altitude.

[images/][train|val|test/]**/*.jpg    [**/*.txt beside the pictures or in labels/]    [classes.txt | data.yaml]
[one COCO .json]    [metadata.csv | metadata.json]
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import Literal

from infrablend.core.dataset import Dataset, ImageRecord, Split
from infrablend.core.file_names import real_path
from infrablend.errors import DatasetError, Problem
from infrablend.formats.annotation_files import read_text
from infrablend.formats.base import Match, check_splits, split_folders
from infrablend.formats.labels import coco
from infrablend.formats.labels.yolo import (
    FoundPicture,
    Task,
    build_records,
    categories_of,
    class_names,
    find_label,
    find_yaml,
    line_form,
    read_yaml,
    report_orphans,
)
from infrablend.formats.labels.yolo import native_writer as yolo_writer
from infrablend.formats.picture_facts import facts_from_name
from infrablend.formats.pictures.listing import list_pictures
from infrablend.formats.records import Findings

NAME = "folder"

Labels = Literal["auto", "none", "yolo", "coco"]
# Folders without backgrounds.
_SKIP = ("labels", "annotations", "coco", "scenes")
# Longer numbers are times.
_END = re.compile(r"(|.*\D)(\d{1,9})", re.ASCII | re.DOTALL)
# Fewer numbers than this do not show whether they run.
_LEAST = 4
# Share of the steps between numbers that are equal in frames of a clip, of which some may have been removed.
_EQUAL = 0.5
_UNNAMED_FRAMES = "frames"


def detect(root: Path) -> Match:
    """Decide whether `root` contains any pictures."""
    if not root.is_dir():
        return Match(NAME, False, "no such folder")
    if not list_pictures(root, _SKIP):
        return Match(NAME, False, "no picture (JPEG, PNG, BMP, TIFF, WebP) in it or below")
    return Match(NAME, True, "a folder with pictures")


def _split_folders(found: Findings) -> list[tuple[Split, Path]]:
    """Return (split, folder) pairs: `train`, `val`, `test` (also in `images/`), else the whole folder as train."""
    root = found.root
    for base in (root, root / "images"):
        named = split_folders(base)
        inside = {p for _, d in named for p in list_pictures(d, _SKIP, lambda p: find_label(p, root)).values()}
        if inside:
            return named
    return [("train", root)]


def _belongs_to(root: Path) -> Path | None:
    """Return the annotation file of a larger dataset of which this folder is only one split's pictures, or None."""
    here = real_path(root)
    for name in (f"{here.name}.json", f"instances_{here.name}.json"):
        file = here.parent / "annotations" / name
        if file.is_file():
            return file
    return None


def native_writer(dataset: Dataset) -> str:
    """Return the name of the writer for the labels that were found beside the pictures."""
    labels = str(dataset.notes.get("labels"))
    return yolo_writer(dataset) if labels == "yolo" else labels


def read(
    root: Path,
    *,
    splits: Iterable[str] | None = None,
    metadata: Path | None = None,
    labels: Labels = "auto",
    task: Task | None = None,
) -> Dataset:
    """Read a folder of pictures. Nothing is decoded; sizes are read only where labels need them.

    Without subfolders `train`, `val`, `test` everything is train. Names in HIT-UAV's grammar give pitch and altitude,
    too; the table counts more. With `labels` auto, one COCO file is read if there is one, else text files. `task` says
    what YOLO lines of nine numbers are, see `yolo.build_records`.

    Raises:
        DatasetError: No picture, or the labels asked for are not there.
    """
    wanted = check_splits(splits)
    if not root.is_dir():
        problem = Problem(str(root), "folder-missing", "no such folder", "a folder of pictures", "check the path")
        raise DatasetError(f"{root}: no such folder", [problem])
    whole = _belongs_to(root)
    if whole is not None and labels == "auto":
        problem = Problem(
            str(root),
            "split-folder",
            f"a split's pictures; their labels are in {whole}",
            "the folder of the dataset",
            f"give {whole.parent.parent}",
        )
        raise DatasetError(f"{root}: one split of a dataset, read alone it would lose every label", [problem])
    if labels in ("auto", "coco"):
        files = coco.find_files(root)
        if files:
            return replace(coco.read(root, splits=wanted, metadata=metadata), format=NAME)
        if labels == "coco":
            raise DatasetError(f"{root}: no COCO file", [Problem(str(root), "annotation-missing", "no COCO file")])
    found = Findings(root)
    pictures = [
        FoundPicture(name, path, split, None if labels == "none" else find_label(path, root))
        for split, folder in _split_folders(found)
        if split in wanted
        for name, path in list_pictures(folder, _SKIP, lambda p: find_label(p, root)).items()
    ]
    labelled = [p for p in pictures if p.label is not None]
    if labels == "yolo" and pictures and not labelled:
        problem = Problem(str(root), "annotation-missing", "no label file", "a .txt for each picture")
        raise DatasetError(f"{root}: no YOLO labels", [problem])
    names = _find_names(root, pictures) if labelled else None
    described = find_yaml(root) if labelled else None
    task, keypoints = line_form(read_yaml(described, root) if described else {}, task)
    records, known = build_records(found, pictures, names, task, keypoints)
    if labels != "none":
        report_orphans(found, pictures, keypoints)
    return found.dataset(
        NAME,
        records,
        categories_of(known),
        {"labels": "yolo" if labelled else "none"},
        metadata=metadata,
        splits=wanted,
        others=[found.place(p.path) for p in pictures],
    )


def _find_names(root: Path, pictures: Sequence[FoundPicture]) -> dict[int, str] | None:
    """Return class names from `data.yaml`, from Darknet's files, or from `classes.txt`; None without any of these.

    `classes.txt` may be in the folder, in `labels/` or beside the first label, `_darknet.labels` only there.
    """
    path = find_yaml(root)
    if path is not None:
        return class_names(read_yaml(path, root)["names"], path.name)
    first = next(p.label for p in pictures if p.label is not None)
    names = [root / "classes.txt", root / "labels" / "classes.txt", first.parent / "classes.txt"]
    for candidate in (*names, first.parent / "_darknet.labels", *sorted(root.glob("*.names"))):
        if candidate.is_file():
            text, problem = read_text(candidate, candidate.name, "a class name on each line")
            if problem is not None:
                raise DatasetError(f"{candidate}: {problem.found}", [problem])
            return class_names([s.strip() for s in text.splitlines() if s.strip()], candidate.name)
    return None


# -- sequences of pictures whose names end in a running number ---------------------------------------------------


def with_numbered_frames(images: Sequence[ImageRecord]) -> tuple[ImageRecord, ...]:
    """Return the pictures with the sequence and frame number that their names show.

    The pictures of one folder, in all splits, are a sequence if their names differ in a number at their ends alone,
    each has another one, and the numbers run: at least half of the steps between them are equal. Its name is the path
    of the folder, or what the names have in common in the folder of the split itself. Pictures of which a sequence,
    frame or time is known are left as they are, with all of their folder.
    """
    folders = defaultdict[PurePosixPath, list[int]](list)
    for k, image in enumerate(images):
        folders[PurePosixPath(image.name).parent].append(k)
    taken = {i.capture.sequence for i in images}
    found = list(images)
    for folder, members in sorted(folders.items()):
        numbers = _numbers([images[k] for k in members])
        if numbers is None:
            continue
        prefix, frames = numbers
        sequence = prefix.strip("_-. ") or _UNNAMED_FRAMES if folder == PurePosixPath() else folder.as_posix()
        if sequence in taken:
            continue
        taken.add(sequence)
        for k, frame in zip(members, frames, strict=True):
            found[k] = replace(found[k], capture=replace(found[k].capture, sequence=sequence, frame=frame))
    return tuple(found)


def _numbers(images: Sequence[ImageRecord]) -> tuple[str, list[int]] | None:
    """Return what the names of pictures begin with, and their numbers; None if these do not count frames."""
    ends = [_END.fullmatch(PurePosixPath(i.name).stem) for i in images]
    known = any(i.capture.sequence or i.capture.captured or i.capture.frame is not None for i in images)
    if len(images) < _LEAST or known or any(facts_from_name(i.name) for i in images):
        return None
    names = [(m[1], int(m[2])) for m in ends if m is not None]
    frames = [n for _, n in names]
    if len(names) < len(images) or len({prefix for prefix, _ in names}) > 1 or len({*frames}) < len(frames):
        return None
    ordered = sorted(frames)
    steps = Counter(b - a for a, b in pairwise(ordered))
    most = steps.most_common(1)[0][1]
    return (names[0][0], frames) if most >= _EQUAL * (len(frames) - 1) else None
