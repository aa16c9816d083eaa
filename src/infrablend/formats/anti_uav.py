"""The Anti-UAV family: drones against the sky in thermal and visible video, one box per frame.

    [train|val|test/]<sequence>/infrared.mp4   infrared.json   [visible.mp4  visible.json]    Anti-UAV300
    [train|val|test/]<sequence>/IR.mp4         IR_label.json   [RGB.mp4      RGB_label.json]  its first version
    [train|val|test/]<sequence>/000001.jpg ..  IR_label.json                                  Anti-UAV410, Anti-UAV600

A label file has `exist`, one flag per frame, and `gt_rect`, one box `x, y, width, height` in px per frame, empty or
zeros where there is no drone. Frames in order of their names, or of the video, are those of the lists. The cameras are
on the ground and look up.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import repeat
from pathlib import Path
from typing import Any

from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance, Split
from infrablend.core.file_names import leaves_folder
from infrablend.core.json_records import is_list
from infrablend.errors import DatasetError, Problem
from infrablend.formats import derived
from infrablend.formats.annotation_files import read_json
from infrablend.formats.base import Match, check_splits, require_options
from infrablend.formats.box_checks import check_box
from infrablend.formats.pictures import is_hidden, is_picture_name, read_size
from infrablend.formats.records import make_dataset
from infrablend.formats.values import to_bool, to_floats

NAME = "anti-uav"
OPTIONS = {
    "modality": "video to read: ir (the default), rgb or both",
    "every": "step in frames; 1 for folders of pictures and 25 for videos by default",
}
CATEGORIES = (Category(0, "drone"),)

_LABELS = {"ir": ("infrared.json", "IR_label.json"), "rgb": ("visible.json", "RGB_label.json")}
_VIDEOS = {"ir": ("infrared.mp4", "IR.mp4"), "rgb": ("visible.mp4", "RGB.mp4")}
_FOLDERS = {"ir": ("infrared", "IR"), "rgb": ("visible", "RGB")}
_SPLITS: Mapping[str, Split] = {
    "train": "train", "val": "val", "validation": "val", "test": "test", "test-dev": "test", "test_dev": "test",
}  # fmt: skip
_DEPTH = 3
_DATE = re.compile(r"(20\d\d)(0[1-9]|1[0-2])(0[1-9]|[12]\d|3[01])_", re.ASCII)
_PICTURE_STEP, _VIDEO_STEP = 1, 25


@dataclass(frozen=True)
class _Sequence:
    """One sequence in one modality: its folder, kind, label file and video (None for pictures)."""

    folder: Path
    kind: str
    label: Path
    video: Path | None
    pictures: Path

    @property
    def name(self) -> str:
        return self.folder.name


def _sequences(root: Path) -> list[_Sequence]:
    """Return the sequences at most three folders below the dataset's, sorted by path."""
    found: list[_Sequence] = []
    level = [root]
    for _ in range(_DEPTH + 1):
        deeper: list[Path] = []
        for folder in level:
            here = _in_folder(folder)
            found += here
            deeper += [] if here else _subfolders(folder)
        level = deeper
    return sorted(found, key=lambda s: (s.folder, s.kind))


def _subfolders(folder: Path) -> list[Path]:
    return sorted(p for p in folder.iterdir() if not is_hidden(p.name) and p.is_dir() and not p.is_symlink())


def _in_folder(folder: Path) -> list[_Sequence]:
    found = []
    for kind in ("ir", "rgb"):
        label = next((p for n in _LABELS[kind] if (p := folder / n).is_file() and not leaves_folder(p)), None)
        if label is None:
            continue
        video = next((p for n in _VIDEOS[kind] if (p := folder / n).is_file() and not leaves_folder(p)), None)
        pictures = next((p for n in _FOLDERS[kind] if (p := folder / n).is_dir()), folder)
        found.append(_Sequence(folder, kind, label, video, pictures))
    return found


def detect(root: Path) -> Match:
    """Decide whether `root` contains sequences with a label file of this family."""
    for sequence in _sequences(root):
        try:
            with sequence.label.open("rb") as file:
                start = file.read(1 << 16)
        except OSError:
            continue
        if b'"exist"' in start or b'"gt_rect"' in start:
            where = sequence.label.relative_to(root).as_posix()
            return Match(NAME, True, f"{where} has the boxes of a sequence")
    return Match(NAME, False, "no infrared.json, IR_label.json, visible.json or RGB_label.json with exist and gt_rect")


@dataclass
class _Reading:
    """State of reading one dataset: its folder, problems, counts and step in frames (None for the usual ones)."""

    root: Path
    every: int | None
    problems: list[Problem] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)


def read(
    root: Path,
    *,
    splits: Iterable[str] | None = None,
    metadata: Path | None = None,
    modality: str = "ir",
    every: str = "",
) -> Dataset:
    """Read frames and boxes of all sequences.

    Args:
        root: Folder of splits, or of sequences; sequences outside the folders of splits are train.
        splits: Splits to read; None reads all.
        metadata: Table of pitch and altitude, by file or by sequence; None uses any `metadata.csv` or `.json`.
        modality: `ir`, `rgb` or `both`; records of visible light have `modality` `visible` in their `extra`.
        every: Step in frames. Frames of videos are PNG files in the cache folder.

    Raises:
        DatasetError: An option has a wrong value, or no frame can be read.
        MissingDependencyError: The frames are in videos, and PyAV is not installed.
    """
    require_options(root, modality=(modality, ("ir", "rgb", "both")))
    state = _Reading(root, step_of(root, every))
    wanted = check_splits(splits)
    records: list[ImageRecord] = []
    for sequence in _sequences(root):
        split = _split(sequence.folder.relative_to(root).parts[:-1])
        if split in wanted and modality in (sequence.kind, "both"):
            state.counts["sequences"] += 1
            records += _read_sequence(state, sequence, split)
    keys = ("sequences", "frames", "objects", "read", "absent", "hidden_boxes", "unlabelled", "without_picture")
    notes = {"labels": NAME, "modality": modality, "rows": {k: state.counts[k] for k in keys}}
    return make_dataset(root, NAME, records, CATEGORIES, state.problems, notes, metadata=metadata, splits=wanted)


def step_of(root: Path, every: str) -> int | None:
    """Return the step in frames that an option states; None for an empty one.

    Raises:
        DatasetError: It is not a positive whole number.
    """
    text = str(every).strip()
    if text and not (text.isascii() and text.isdigit() and 0 < int(text) < 10**9):
        problem = Problem("option every", "option-value", f"every={every}", "a positive number of frames")
        raise DatasetError(f"{root}: an option has a value that is not allowed", [problem])
    return int(text) if text else None


def _split(parts: Sequence[str]) -> Split:
    return next((_SPLITS[p.lower()] for p in parts if p.lower() in _SPLITS), "train")


def _read_sequence(state: _Reading, sequence: _Sequence, split: Split) -> list[ImageRecord]:
    where = sequence.label.relative_to(state.root).as_posix()
    try:
        top = read_json(sequence.label)
    except DatasetError as error:
        state.problems += [Problem(where, p.code, p.found, p.expected, p.todo) for p in error.problems]
        return []
    boxes = top.get("gt_rect") if isinstance(top, dict) else None
    exist = top.get("exist") if isinstance(top, dict) else None
    if not is_list(boxes) or not (exist is None or is_list(exist)):
        expected = "gt_rect, a list of boxes, and exist, a list of flags"
        state.problems.append(Problem(where, "annotation-layout", "no list of boxes", expected, "fetch the file again"))
        return []
    if exist is not None and len(exist) != len(boxes):
        found = f"{len(exist)} flags and {len(boxes)} boxes; frames after the shorter list are left out"
        state.problems.append(Problem(where, "annotation-length", found, "one of each per frame", severity="warning"))
    labelled = len(boxes) if exist is None else min(len(boxes), len(exist))
    frames, total = _frames(state, sequence, labelled)
    state.counts["unlabelled"] += max(total - labelled, 0)
    state.counts["without_picture"] += max(labelled - total, 0)
    if total != labelled:
        found = f"{labelled} label(s) for {total} frame(s); the frames or labels without the other are left out"
        state.problems.append(Problem(where, "annotation-length", found, "a label per frame", severity="warning"))
    records: list[ImageRecord] = []
    size_wh: tuple[int, int] | None = None
    flags = repeat(None) if exist is None else exist
    for number, (box, flag) in enumerate(zip(boxes, flags, strict=False)):
        if number not in frames:
            continue
        path = frames[number]
        here = f"{where}: frame {number}"
        if sequence.video is None or size_wh is None:
            size_wh, problem = read_size(path, here)
            state.problems += [problem] if problem else []
        if size_wh is None:
            continue
        state.counts["frames"] += 1
        instances = _instance(state, box, flag, size_wh, here)
        extra: dict[str, Any] = {"modality": "visible"} if sequence.kind == "rgb" else {}
        date = _DATE.match(sequence.name)
        name = f"{sequence.name}/{sequence.kind}/{path.name}"
        records.append(
            ImageRecord(
                "",
                path,
                split,
                size_wh,
                instances,
                capture=Capture(
                    sequence=sequence.name, captured="-".join(date.groups()) if date else None, frame=number
                ),
                extra=extra,
                file_name=name,
            )
        )
    return records


def _frames(state: _Reading, sequence: _Sequence, labelled: int) -> tuple[Mapping[int, Path], int]:
    """Return the frames to read by number, and the number of frames that the sequence has."""
    names = sorted(p for p in sequence.pictures.iterdir() if is_picture_name(p.name) and p.is_file())
    if names or sequence.video is None:
        numbers = range(0, min(len(names), labelled), state.every or _PICTURE_STEP)
        return {n: names[n] for n in numbers}, len(names)
    where = sequence.video.relative_to(state.root).as_posix()
    try:
        numbers = range(0, labelled, state.every or _VIDEO_STEP)
        frames, problems = derived.video_frames(sequence.video, numbers)
    except DatasetError as error:
        state.problems += [Problem(where, p.code, p.found, p.expected, p.todo) for p in error.problems]
        return {}, 0
    state.problems += [Problem(where, p.code, p.found, p.expected, p.todo, p.severity) for p in problems]
    lost = len(numbers) - len(frames)
    if lost:
        found = f"{lost} of {len(numbers)} frame(s) that cannot be decoded, left out"
        state.problems.append(Problem(where, "frames-lost", found, "an intact video", "fetch the file again"))
    return frames, labelled


def _instance(
    state: _Reading, rect: Any, exist: Any, size_wh: tuple[int, int], where: str
) -> tuple[Instance, ...]:  # fmt: skip
    """Return the drone of a frame; nothing where the flag or an empty box says that there is none."""
    numbers = to_floats(rect, 4)
    empty = rect in ([], None) or (numbers is not None and not any(numbers))
    flag = None if exist is None else to_bool(exist)
    if flag is False or (flag is None and empty and exist is None):
        state.counts["absent"] += 1
        state.counts["hidden_boxes"] += not empty
        return ()
    state.counts["objects"] += 1
    if numbers is None or empty or (flag is None and exist is not None):
        found = f"flag {exist!r} and box {rect!r}"[:80]
        state.problems.append(Problem(where, "annotation-layout", found, "flag 0 or 1 and x, y, width, height"))
        return ()
    x, y, w, h = numbers
    box, problem = check_box((x, y, x + w, y + h), size_wh, where)
    state.problems += [problem] if problem else []
    if box is None:
        return ()
    state.counts["read"] += 1
    return (Instance(CATEGORIES[0].name, box, track_id=0),)
