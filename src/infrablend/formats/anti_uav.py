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
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import Any

from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance, Split
from infrablend.core.file_names import leaves_folder
from infrablend.core.json_records import is_list
from infrablend.formats.base import Match, check_splits, option_error, require_options
from infrablend.formats.box_checks import edges_of_xywh
from infrablend.formats.pictures import is_hidden, is_picture_name
from infrablend.formats.records import Findings
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
        label, video = (
            next((p for n in names[kind] if (p := folder / n).is_file() and not leaves_folder(p)), None)
            for names in (_LABELS, _VIDEOS)
        )
        if label is not None:
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


def read(
    root: Path,
    *,
    splits: Iterable[str] | None = None,
    metadata: Path | None = None,
    modality: str = "ir",
    every: str = "",
) -> Dataset:
    """Read frames and boxes of all sequences.

    Sequences outside the folders of splits are train. Records of visible light have `modality` `visible` in their
    `extra`. Frames of videos are PNG files in the cache folder.

    Raises:
        DatasetError: An option has a wrong value, or no frame can be read.
        MissingDependencyError: The frames are in videos, and PyAV is not installed.
    """
    require_options(root, modality=(modality, ("ir", "rgb", "both")))
    step = step_of(root, every)
    found = Findings(root)
    wanted = check_splits(splits)
    records: list[ImageRecord] = []
    for sequence in _sequences(root):
        split = _split(sequence.folder.relative_to(root).parts[:-1])
        if split in wanted and modality in (sequence.kind, "both"):
            found.counts["sequences"] += 1
            records += _read_sequence(found, sequence, split, step)
    keys = ("sequences", "frames", "objects", "read", "absent", "hidden_boxes", "unlabelled", "without_picture")
    notes = {"labels": NAME, "modality": modality, "rows": found.rows(*keys)}
    return found.dataset(NAME, records, CATEGORIES, notes, metadata=metadata, splits=wanted)


def step_of(root: Path, every: str) -> int | None:
    """Return the step in frames that an option states; None for an empty one.

    Raises:
        DatasetError: It is not a positive whole number.
    """
    text = str(every).strip()
    if text and not (text.isascii() and text.isdigit() and 0 < int(text) < 10**9):
        raise option_error(root, "every", every, "a positive number of frames")
    return int(text) if text else None


def _split(parts: Sequence[str]) -> Split:
    return next((_SPLITS[p.lower()] for p in parts if p.lower() in _SPLITS), "train")


def _read_sequence(found: Findings, sequence: _Sequence, split: Split, step: int | None) -> list[ImageRecord]:
    where = found.place(sequence.label)
    top = found.json(sequence.label)
    if top is None:
        return []
    boxes, exist = top.get("gt_rect"), top.get("exist")
    if not is_list(boxes) or not (exist is None or is_list(exist)):
        expected = "gt_rect, a list of boxes, and exist, a list of flags"
        found.add(where, "annotation-layout", "no list of boxes", expected, "fetch the file again")
        return []
    if exist is not None and len(exist) != len(boxes):
        text = f"{len(exist)} flags and {len(boxes)} boxes; frames after the shorter list are left out"
        found.warn(where, "annotation-length", text, "one of each per frame")
    labelled = len(boxes) if exist is None else min(len(boxes), len(exist))
    frames, total = _frames(found, sequence, labelled, step)
    found.counts["unlabelled"] += max(total - labelled, 0)
    found.counts["without_picture"] += max(labelled - total, 0)
    if total != labelled:
        text = f"{labelled} label(s) for {total} frame(s); the frames or labels without the other are left out"
        found.warn(where, "annotation-length", text, "a label per frame")
    date = _DATE.match(sequence.folder.name)
    captured = "-".join(date.groups()) if date else None
    extra = {"modality": "visible"} if sequence.kind == "rgb" else {}
    records: list[ImageRecord] = []
    size_wh: tuple[int, int] | None = None
    flags = repeat(None) if exist is None else exist
    for number, (box, flag) in enumerate(zip(boxes, flags, strict=False)):
        if number not in frames:
            continue
        path = frames[number]
        here = f"{where}: frame {number}"
        if sequence.video is None or size_wh is None:
            size_wh = found.size(path, here)
        if size_wh is None:
            continue
        found.counts["frames"] += 1
        instances = _instance(found, box, flag, size_wh, here)
        capture = Capture(sequence=sequence.folder.name, captured=captured, frame=number)
        name = f"{sequence.folder.name}/{sequence.kind}/{path.name}"
        records.append(ImageRecord("", path, split, size_wh, instances, capture, extra=extra, file_name=name))
    return records


def _frames(
    found: Findings, sequence: _Sequence, labelled: int, step: int | None
) -> tuple[Mapping[int, Path], int]:  # fmt: skip
    """Return the frames to read by number, and the number of frames that the sequence has."""
    names = sorted(p for p in sequence.pictures.iterdir() if is_picture_name(p.name) and p.is_file())
    if names or sequence.video is None:
        return {n: names[n] for n in range(0, min(len(names), labelled), step or _PICTURE_STEP)}, len(names)
    numbers = range(0, labelled, step or _VIDEO_STEP)
    frames = found.video_frames(sequence.video, numbers)
    if frames is None:
        return {}, 0
    lost = len(numbers) - len(frames)
    if lost:
        text = f"{lost} of {len(numbers)} frame(s) that cannot be decoded, left out"
        found.add(found.place(sequence.video), "frames-lost", text, "an intact video", "fetch the file again")
    return frames, labelled


def _instance(found: Findings, rect: Any, exist: Any, size_wh: tuple[int, int], where: str) -> tuple[Instance, ...]:
    """Return the drone of a frame; nothing where the flag or an empty box says that there is none."""
    numbers = to_floats(rect, 4)
    empty = rect in ([], None) or (numbers is not None and not any(numbers))
    flag = None if exist is None else to_bool(exist)
    if flag is False or (flag is None and empty and exist is None):
        found.counts["absent"] += 1
        found.counts["hidden_boxes"] += not empty
        return ()
    found.counts["objects"] += 1
    if numbers is None or empty or (flag is None and exist is not None):
        text = f"flag {exist!r} and box {rect!r}"[:80]
        found.add(where, "annotation-layout", text, "flag 0 or 1 and x, y, width, height")
        return ()
    box = found.box(edges_of_xywh(numbers, None), size_wh, where)
    if box is None:
        return ()
    found.counts["read"] += 1
    return (Instance(CATEGORIES[0].name, box, track_id=0),)
