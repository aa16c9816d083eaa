"""The Anti-UAV family: drones against the sky in thermal and visible video, one box per frame.

    [train|val|test/]<sequence>/infrared.mp4   infrared.json   [visible.mp4  visible.json]    Anti-UAV300
    [train|val|test/]<sequence>/IR.mp4         IR_label.json   [RGB.mp4      RGB_label.json]  its first version
    [train|val|test/]<sequence>/000001.jpg ..  IR_label.json                                  Anti-UAV410, Anti-UAV600
    [train|val|test/]<sequence>.avi            <sequence>.txt   [osd.csv]                     the project's clips

A JSON label file has `exist`, one flag per frame, and `gt_rect`, one box `x, y, width, height` in px per frame, empty
or zeros where there is no drone; our writer may add `visibility`, a visible share or null per frame. A text has one
such box per line. Frames in order of their names, or of the video, are those of the lists. The cameras are on the
ground and look up; `osd.csv` has their field of view and elevation.
"""

from __future__ import annotations

import itertools
import json
import re
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice, repeat
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from infrablend.core.capture import UNKNOWN, Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance, Split
from infrablend.core.file_names import distinct_names, file_name, leaves_folder
from infrablend.core.files import link_or_copy
from infrablend.core.json_records import is_list
from infrablend.core.mesh import FloatArray
from infrablend.errors import DatasetError, Problem
from infrablend.formats.base import (
    Match,
    check_splits,
    count_crowds,
    require_options,
    step_of,
)
from infrablend.formats.box_checks import check_box, edges_of_xywh
from infrablend.formats.losses import Losses, Written, count_dropped
from infrablend.formats.picture_facts import csv_rows, table_of_rows
from infrablend.formats.pictures.listing import folders_of_sequences, is_hidden, is_picture_name
from infrablend.formats.pictures.video import SUFFIXES, is_video
from infrablend.formats.records import Findings
from infrablend.formats.sequence_writing import Frames, Place, SequenceWriter, is_labelled, with_names
from infrablend.formats.values import plain_id, to_bool, to_floats, to_int, to_number, to_share
from infrablend.imaging.paint_out import How

NAME = "anti-uav"
OPTIONS = {
    "modality": "video to read: ir (the default), rgb or both",
    "every": "step in frames; 1 for folders of pictures and 25 for videos by default",
    "drones": "keep (the default) the drones in frames of videos, or paint-out: paint over them, and drop their labels",
}
TAKES_VIDEO = True
CATEGORIES = (Category(0, "drone"),)

_LABELS = {"ir": ("infrared.json", "IR_label.json"), "rgb": ("visible.json", "RGB_label.json")}
_VIDEOS = {"ir": ("infrared.mp4", "IR.mp4"), "rgb": ("visible.mp4", "RGB.mp4")}
_FOLDERS = {"ir": ("infrared", "IR"), "rgb": ("visible", "RGB")}
_SPLITS: Mapping[str, Split] = {
    "train": "train", "val": "val", "validation": "val", "test": "test", "test-dev": "test", "test_dev": "test",
}  # fmt: skip
_DATE = re.compile(r"(20\d\d)(0[1-9]|1[0-2])(0[1-9]|[12]\d|3[01])_", re.ASCII)
_PICTURE_STEP = 1
_VIDEO_STEP = 25


_TEXT = ".txt"
_VIEWS = "osd.csv"
_BETWEEN_NUMBERS = re.compile(r"[\s,;]+")
_COLUMNS = {"field_of_view_deg": "hfov_deg", "elevation_at_start_deg": "pitch_deg"}
_PAINTED: Mapping[How, str] = {"other-frames": "painted", "in-part": "painted_in_part", "guessed": "painted_by_guess"}


_DRONE = (CATEGORIES[0].name, 0)
_TARGETS_FILE = "targets.csv"
_TARGETS_COLUMNS = ("folder", "of", "first", "category", "track_id", "ignore")


@dataclass(frozen=True)
class _Target:
    """What a sequence shows.

    Attributes:
        of: Folder of the sequence with all pictures, of which this one has a part for a further target; else empty.
        first: Position of its first picture there.
        category: Class.
        track_id: Track.
        ignore: Whether it is a region to ignore.
    """

    of: str = ""
    first: int = 0
    category: str = CATEGORIES[0].name
    track_id: int | str = 0
    ignore: bool = False


@dataclass(frozen=True)
class _Sequence:
    """One sequence in one modality: its folder, kind, label file, video (None for pictures) and target."""

    folder: Path
    kind: str
    label: Path
    video: Path | None
    pictures: Path
    target: _Target = field(default_factory=_Target)

    @property
    def name(self) -> str:
        return self.label.stem if self.label.suffix == _TEXT else self.folder.name

    def split(self, root: Path) -> Split:
        if root.is_file():  # one video alone
            return "train"
        parts = self.label.relative_to(root).parts[: -1 if self.label.suffix == _TEXT else -2]
        return next((_SPLITS[p.lower()] for p in parts if p.lower() in _SPLITS), "train")


def _sequences(root: Path) -> list[_Sequence]:
    """Return the sequences at most three folders below the dataset's, sorted by path; that of a video given alone."""
    if root.is_file():
        return [s for s in _in_folder(root.parent) if s.video == root]
    found = (s for folder in folders_of_sequences(root, _in_folder) for s in _in_folder(folder))
    return sorted(found, key=lambda s: (s.folder, s.kind, s.label))


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
    return found or _clips_in(folder)


def _clips_in(folder: Path) -> list[_Sequence]:
    """Return the videos of a folder that have a text of boxes beside them."""
    videos = sorted(p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES and not is_hidden(p.name))
    return [
        _Sequence(folder, "ir", label, video, folder)
        for video in videos
        if (label := video.with_suffix(_TEXT)).is_file() and not leaves_folder(label) and not leaves_folder(video)
    ]


def _is_box(line: str) -> bool:
    """Return whether a line of text has four numbers."""
    return to_floats(_BETWEEN_NUMBERS.split(line.strip()), 4) is not None


def detect(root: Path) -> Match:
    """Decide whether `root` contains sequences with a label file of this family."""
    for sequence in _sequences(root):
        try:
            with sequence.label.open("rb") as file:
                start = file.read(1 << 16)
        except OSError:
            continue
        lines = start.decode("utf-8-sig", "replace").splitlines() if sequence.label.suffix == _TEXT else []
        if b'"exist"' in start or b'"gt_rect"' in start or any(map(_is_box, lines)):
            where = sequence.label.name if root == sequence.video else sequence.label.relative_to(root).as_posix()
            return Match(NAME, True, f"{where} has the boxes of a sequence")
    expected = "infrared.json, IR_label.json, visible.json or RGB_label.json with exist and gt_rect"
    return Match(NAME, False, f"no {expected}, and no video with a text of four numbers per line")


def read(
    root: Path,
    *,
    splits: Iterable[str] | None = None,
    metadata: Path | None = None,
    modality: str = "ir",
    every: str = "",
    drones: str = "keep",
) -> Dataset:
    """Read frames and boxes of all sequences.

    Sequences outside the folders of splits are train. Records of visible light have `modality` `visible` in their
    `extra`. Frames of videos are PNG files in the cache folder.

    Raises:
        DatasetError: An option has a wrong value, or no frame can be read.
        MissingDependencyError: The frames are in videos, and PyAV is not installed.
    """
    require_options(root, modality=(modality, ("ir", "rgb", "both")), drones=(drones, ("keep", "paint-out")))
    step = step_of(root, every)
    found = Findings(root)
    wanted = check_splits(splits)
    records: list[ImageRecord] = []
    sequences = _sequences(root)
    if root.is_file():
        modality = "both"  # of a video given alone, whatever it shows
    _name_unlabelled(found, sequences)
    views = _views(found, sequences)
    targets = dict(found.own_rows(_TARGETS_FILE, _TARGETS_COLUMNS, _read_target))
    sequences = [replace(s, target=targets.get(found.place(s.folder), s.target)) for s in sequences]
    places: dict[tuple[str, int | None], int] = {}
    order = {folder: n for n, (folder, target) in enumerate(targets.items()) if target.of}
    for sequence in sorted(sequences, key=lambda s: order.get(found.place(s.folder), -1)):  # all pictures come first
        split = sequence.split(root)
        if split in wanted and modality in (sequence.kind, "both"):
            found.counts["sequences"] += 1
            view = views.get(sequence.label, UNKNOWN)
            read = _read_sequence(found, sequence, split, step, view, drones == "paint-out")
            _add(found, records, places, sequence, read)
    records = with_names(found, records)
    further = {t.category: t.ignore for t in targets.values() if t.category != CATEGORIES[0].name}
    categories = [*CATEGORIES, *(Category(n, name, "", ignore) for n, (name, ignore) in enumerate(further.items(), 1))]
    keys = ("sequences", "frames", "objects", "read", "absent", "hidden_boxes", "unlabelled", "without_picture")
    rows = found.rows(*keys, *(_PAINTED.values() if drones == "paint-out" else ()))
    notes = {"labels": NAME, "modality": modality, "rows": rows}
    return found.dataset(NAME, records, categories, notes, metadata=metadata, splits=wanted)


def _read_target(row: Sequence[str]) -> tuple[str, _Target] | None:
    """Return a folder and its target from a row of the table that our writer adds."""
    first = to_int(row[2])
    if first is None or first < 0 or not row[3]:
        return None
    of = row[1] if row[1] != row[0] else ""
    return row[0], _Target(of, first, row[3], plain_id(row[4] or "0"), row[5] == "1")


def _add(
    found: Findings,
    records: list[ImageRecord],
    places: dict[tuple[str, int | None], int],
    sequence: _Sequence,
    read: Sequence[ImageRecord],
) -> None:
    """Add the records of a sequence; those of a further target give their object to the pictures that were read.

    Args:
        found: Counts.
        records: Records so far.
        places: Their indices by folder and frame, of sequences with all pictures.
        sequence: The sequence.
        read: Its records.
    """
    target = sequence.target
    for record in read:
        frame = record.capture.frame
        known = places.get((target.of, target.first + (frame or 0))) if target.of else None
        if known is not None:
            records[known] = replace(records[known], instances=records[known].instances + record.instances)
            found.counts["frames"] -= 1
            continue
        if not target.of:
            places[found.place(sequence.folder), frame] = len(records)
        records.append(record)


def _name_unlabelled(found: Findings, sequences: Sequence[_Sequence]) -> None:
    """Warn of videos beside clips with a text that have none."""
    if found.root.is_file():
        return
    for folder in sorted({s.folder for s in sequences if s.label.suffix == _TEXT}):
        read = {s.video for s in sequences}
        left = sorted(p.name for p in folder.iterdir() if is_video(p) and not is_hidden(p.name) and p not in read)
        if left:
            text = f"{len(left)} video(s) without a text of boxes, left out, such as {left[0]}"
            todo = "give such a video alone to read it without labels"
            found.warn(found.place(folder / left[0]), "label-missing", text, "a text per clip", todo)


def _views(found: Findings, sequences: Sequence[_Sequence]) -> dict[Path, Capture]:
    """Return field of view and pitch of clips by their label files, from the tables beside them."""
    clips = [s for s in sequences if s.label.suffix == _TEXT and s.video is not None]
    views: dict[Path, Capture] = {}
    for folder in sorted({s.folder for s in clips if (s.folder / _VIEWS).is_file()}):
        path = folder / _VIEWS
        here = [s for s in clips if s.folder == folder]
        try:
            rows = [(where, _named(row)) for where, row in csv_rows(path)]
            table = table_of_rows(path, rows)
        except DatasetError as error:
            found.add_all(error.problems, found.place(path))
            continue
        found.problems += table.problems
        # The table also has rows of the clips beside one that is given alone.
        found.problems += table.remarks(path, [s.video.name for s in _clips_in(folder) if s.video is not None])
        known = {s.label: row for s in here if s.video is not None and (row := table.find(s.video.name))}
        lacking = ", ".join(s.name for s in here if s.label not in known)
        if lacking:
            text = f"no usable row for {lacking}"
            found.warn(found.place(path), "table-value", text, "field of view and elevation of each clip", "add them")
        views |= known
    return views


def _named(row: Mapping[str, object]) -> dict[str, object]:
    """Return a row with our names of columns; pitch is below the horizon, elevation above it."""
    named = {_COLUMNS.get(k, k): v for k, v in row.items()}
    elevation = to_number(named.get("pitch_deg"))
    return named if elevation is None else {**named, "pitch_deg": -elevation}


def _labels(found: Findings, sequence: _Sequence) -> tuple[Any, Any, Any] | None:
    """Return the boxes, flags and visible shares in a label file; None, with a problem, if it cannot be read."""
    if sequence.label.suffix != _TEXT:
        top = found.json(sequence.label)
        return None if top is None else (top.get("gt_rect"), top.get("exist"), top.get("visibility"))
    text = found.text(sequence.label, "a box per line")
    if text is None:
        return None
    cells = [[c for c in _BETWEEN_NUMBERS.split(line) if c] for line in text.splitlines()]
    return [[] if all(c.lower() == "nan" for c in row) else row for row in cells], None, None


def _read_sequence(
    found: Findings, sequence: _Sequence, split: Split, step: int | None, view: Capture, paint: bool
) -> list[ImageRecord]:
    where = found.place(sequence.label)
    labels = _labels(found, sequence)
    if labels is None:
        return []
    boxes, exist, shares = labels
    if not is_list(boxes) or not (exist is None or is_list(exist)):
        expected = "gt_rect, a list of boxes, and exist, a list of flags"
        found.add(where, "annotation-layout", "no list of boxes", expected, "fetch the file again")
        return []
    if exist is not None and len(exist) != len(boxes):
        text = f"{len(exist)} flags and {len(boxes)} boxes; frames after the shorter list are left out"
        found.warn(where, "annotation-length", text, "one of each per frame")
    labelled = len(boxes) if exist is None else min(len(boxes), len(exist))
    frames, total, times = _frames(found, sequence, labelled, step)
    found.counts["unlabelled"] += max(total - labelled, 0)
    found.counts["without_picture"] += max(labelled - total, 0)
    if total != labelled:
        text = f"{labelled} label(s) for {total} frame(s); the frames or labels without the other are left out"
        found.warn(where, "annotation-length", text, "a label per frame")
    captured = _date(sequence.name)
    extra = {"modality": "visible"} if sequence.kind == "rgb" else {}
    records: list[ImageRecord] = []
    size_wh: tuple[int, int] | None = None
    flags = repeat(None) if exist is None else exist
    visible = itertools.chain(shares if is_list(shares) else (), repeat(None))
    for number, (box, flag, share) in enumerate(zip(boxes, flags, visible, strict=False)):
        if number not in frames:
            continue
        path = frames[number]
        here = f"{where}: frame {number}"
        if sequence.video is None or size_wh is None:
            size_wh = found.size(path, here)
        if size_wh is None:
            continue
        found.counts["frames"] += 1
        instances = _instance(found, sequence.target, box, flag, size_wh, here)
        instances = tuple(replace(i, visibility=to_share(share)) for i in instances)
        time_s = times[number] if number < len(times) else None
        capture = replace(view, sequence=sequence.name, captured=captured, frame=number, time_s=time_s)
        name = f"{sequence.name}/{sequence.kind}/{path.name}"
        records.append(ImageRecord("", path, split, size_wh, instances, capture, extra=extra, file_name=name))
    return _painted(found, sequence, records, islice(boxes, labelled), exist) if paint else records


def _painted(
    found: Findings, sequence: _Sequence, records: list[ImageRecord], boxes: Iterable[Any], exist: Iterable[Any] | None
) -> list[ImageRecord]:
    """Return the records with drones painted over and without labels; those that cannot be painted stay as they are."""
    where = found.place(sequence.label)
    flags = repeat(None) if exist is None else exist
    size_wh = records[0].size_wh if records else None
    shown = [] if size_wh is None else [_where(box, flag, size_wh) for box, flag in zip(boxes, flags, strict=False)]
    # Without a usable box nobody knows where the drone is: the frame is no background without one.
    unknown = [r for r in records if not r.instances and shown[r.capture.frame or 0] is not None]
    if unknown:
        text = f"{len(unknown)} frame(s) with a drone whose box cannot be used, left out"
        found.warn(where, "not-painted", text, "a box for every drone")
        records = [r for r in records if r not in unknown]
    wanted = {r.capture.frame: r for r in records if r.instances and r.capture.frame is not None}
    if not wanted:
        return records
    if sequence.video is None or records[0].path.parent == sequence.pictures:
        text = f"{len(wanted)} drone(s) in a folder of pictures, kept with their labels"
        found.warn(where, "not-painted", text, "a video, in whose other frames drones are elsewhere")
        return records
    painted = found.painted_frames(sequence.video, sorted(wanted), shown) or {}
    for how, key in _PAINTED.items():
        count = sum(h == how for _, h in painted.values())
        found.counts[key] += count
        if count and how != "other-frames":
            shown_there = "all of the background behind them" if how == "in-part" else "the same background"
            text = f"{count} drone(s) painted over from what is around them: no other frame shows {shown_there}"
            found.warn(where, "painted-by-guess", text, "other frames that show the background behind it")
    if len(painted) < len(wanted):
        found.warn(
            where, "not-painted", f"{len(wanted) - len(painted)} drone(s), kept with their labels", "an intact video"
        )
    return [
        replace(r, path=painted[k][0], instances=()) if (k := r.capture.frame) is not None and k in painted else r
        for r in records
    ]


def _where(rect: Any, flag: Any, size_wh: tuple[int, int]) -> FloatArray | None:
    """Return the box of a frame's drone, the whole frame where its label has none to use; None for no drone."""
    numbers = to_floats(rect, 4)
    if to_bool(flag) is False or (flag is None and (rect in ([], None) or (numbers is not None and not any(numbers)))):
        return None
    box = None if numbers is None else check_box(edges_of_xywh(numbers, None), size_wh, "")[0]
    return np.array([0, 0, *size_wh], np.float64) if box is None else box


def _frames(
    found: Findings, sequence: _Sequence, labelled: int, step: int | None
) -> tuple[Mapping[int, Path], int, Sequence[float]]:
    """Return the frames to read by number, the number of frames that the sequence has, and their seconds if known."""
    names = sorted(p for p in sequence.pictures.iterdir() if is_picture_name(p.name) and p.is_file())
    if names or sequence.video is None:
        step = step or _PICTURE_STEP
        numbers = range(-sequence.target.first % step, min(len(names), labelled), step)
        return {n: names[n] for n in numbers}, len(names), ()
    times = found.video_times(sequence.video)
    if times is None:
        return {}, 0, ()
    total = len(times) if sequence.label.suffix == _TEXT else labelled
    numbers = range(0, min(labelled, total), step or _VIDEO_STEP)
    frames = found.video_frames(sequence.video, numbers)
    if frames is None:
        return {}, 0, ()
    lost = len(numbers) - len(frames)
    if lost:
        text = f"{lost} of {len(numbers)} frame(s) that cannot be decoded, left out"
        found.add(found.place(sequence.video), "frames-lost", text, "an intact video", "fetch the file again")
    return frames, total, times


def _instance(
    found: Findings, target: _Target, rect: Any, exist: Any, size_wh: tuple[int, int], where: str
) -> tuple[Instance, ...]:
    """Return the object in a frame; nothing where the flag or an empty box says that there is none."""
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
    return (Instance(target.category, box, track_id=target.track_id),)


# -- writing ---------------------------------------------------------------------------------------------------


_Key = tuple[str, int | str]
_Shown = dict[int, tuple[tuple[float, ...], float | None]]


def write(
    out: Path,
    images: Iterable[ImageRecord],
    categories: Sequence[Category],
    *,
    dont_care: str = "drop",
    pictures: bool = True,
) -> Written:
    """Write `<split>/<sequence>/IR_label.json`, and link the pictures beside it as `000001.png` and so on.

    A folder has one target. The one that a sequence shows first is in the folder with all of its pictures; each further
    one has a folder `<sequence>_<track>` with the pictures from its first to its last box. `targets.csv` lists folders
    of further targets, and classes and tracks other than drone 0, from which `read` puts the objects of a picture
    together. `names.csv` has what `read` would not find out of the pictures, `metadata.csv` pitch and the like.

    Objects without a track are one target if no picture of a numbered sequence shows two of their class, else one
    target each. Regions to ignore are left out, or kept as targets.

    Raises:
        OutputError: A file cannot be written.
        ValueError: A category is not in the list.
    """
    writer = SequenceWriter(out, images, categories)
    ignored = {c.name for c in categories if c.ignore}
    used: dict[str, set[str]] = defaultdict(set)
    for place in writer.places:
        used[place.split].add(place.sequence)
    rows: list[tuple[str, str, int, str, int | str, int]] = []
    digits = max(6, len(str(len(writer.places))))  # frames are in the order of their names

    def path_of(image: ImageRecord, place: Place) -> str:
        return f"{place.folder}/{place.number + 1:0{digits}d}{PurePosixPath(image.name).suffix}"

    for folder, frames, numbers in writer.sequences():
        _number_without_gaps(writer, folder, frames, numbers)
        for image in frames:
            writer.losses["unlabelled_unsaid"] += not is_labelled(image)
            writer.losses["ignore_as_class"] += dont_care == "keep" and count_crowds(image.instances, ignored)
        targets = _targets(frames, ignored if dont_care == "drop" else None, writer.losses) or {_DRONE: {}}
        split = writer.places[frames.chosen[0]].split
        names = _target_folders(folder, targets, used[split])
        for (key, shown), name in zip(targets.items(), names, strict=True):
            whole = Place(split, name, 0)
            first, last = (0, len(frames) - 1) if whole.folder == folder else (min(shown), max(shown))
            writer.text(f"{whole.folder}/{_LABELS['ir'][1]}", [_label_text(shown, range(first, last + 1))])
            if whole.folder != folder or key != _DRONE:
                rows.append((whole.folder, folder, first, *key, int(key[0] in ignored)))
            for k in range(first, last + 1) if pictures and whole.folder != folder else ():
                path = path_of(frames[k], replace(whole, number=k - first))
                writer.files.append(link_or_copy(frames[k].path, out / path))
    writer.table(_TARGETS_FILE, _TARGETS_COLUMNS, rows)
    writer.pictures(path_of, pictures, find_out=_found_out, within="ir/")
    return writer.written()


def _number_without_gaps(writer: SequenceWriter, folder: str, frames: Frames, numbers: Sequence[int]) -> None:
    """Give the pictures of a sequence their positions as numbers, and warn if some had others."""
    missing = numbers[-1] + 1 - len(frames)
    if missing:
        text = f"{len(frames)} picture(s), without {missing} of the numbers up to the last; counted without gaps"
        writer.problems.append(Problem(folder, "frames-missing", text, "all frames of a sequence", "", "warning"))
    for position, (n, number) in enumerate(zip(frames.chosen, numbers, strict=True)):
        capture = writer.images[n].capture
        own = capture.sequence is not None and capture.frame == number
        writer.losses["frame_renumbered"] += own and number != position
        writer.places[n] = replace(writer.places[n], number=position)


def _target_folders(folder: str, targets: Iterable[_Key], used: set[str]) -> list[str]:
    """Return the names of the folders of a sequence's targets, the first of which has the sequence's own.

    Args:
        folder: Folder of the sequence.
        targets: Class and track of each target.
        used: Names of the split's folders, to which the new ones are added.
    """
    whole = folder.partition("/")[2]
    _, *further = targets
    named = distinct_names([file_name(f"{whole}_{track}") for _, track in further], used)
    used.update(named)
    return [whole, *named]


def _found_out(place: Place) -> Capture:
    return replace(place.capture, captured=_date(place.sequence))


def _date(sequence: str) -> str | None:
    """Return the date at the beginning of a sequence's name."""
    date = _DATE.match(sequence)
    return "-".join(date.groups()) if date else None


def _is_kept(o: Instance, dropped: Collection[str] | None) -> bool:
    """Return whether an object is written: no region to ignore, unless `dropped` is None, and not hidden."""
    return o.visibility != 0 and (dropped is None or not (o.category in dropped or o.is_crowd))


def _targets(sequence: Frames, dropped: Collection[str] | None, losses: Losses) -> dict[_Key, _Shown]:
    """Return box and visible share of each target by position, in the order in which they appear.

    Args:
        sequence: The pictures.
        dropped: Classes to ignore, which are left out with crowds; None keeps all.
        losses: Counts what is left out, changed and lost.
    """
    numbered = True
    several = set[str]()
    largest = -1
    for image in sequence:
        numbered = numbered and image.capture.sequence is not None and image.capture.frame is not None
        here = [o for o in image.instances if _is_kept(o, dropped)]
        several |= {name for name, n in Counter(o.category for o in here if o.track_id is None).items() if n > 1}
        ids = (plain_id(o.track_id) for o in here if o.track_id is not None)
        largest = max([largest, *(i for i in ids if isinstance(i, int))])
    free = itertools.count(largest + 1)
    joined: dict[str, int] = {}
    targets: dict[_Key, _Shown] = {}
    for position, image in enumerate(sequence):
        for o in image.instances:
            if not _is_kept(o, dropped):
                losses.leave_out("hidden_absent" if o.visibility == 0 else "ignore_dropped", image, o)
                continue
            count_dropped(o, losses, "obb", "mask", "occlusion", "truncated", "difficult")
            losses["class_unfit"] += o.category != CATEGORIES[0].name
            track: int | str | None = None
            if o.track_id is not None:
                track = plain_id(o.track_id)
            elif numbered and o.category not in several:
                track = joined[o.category] if o.category in joined else joined.setdefault(o.category, next(free))
            twice = track is not None and position in targets.get((o.category, track), {})
            losses["track_made"] += o.track_id is None or twice
            key = o.category, next(free) if track is None or twice else track
            x0, y0, x1, y1 = o.box_xyxy.tolist()
            rect = tuple(_plain(v) for v in (x0, y0, x1 - x0, y1 - y0))
            targets.setdefault(key, {})[position] = rect, o.visibility
    return targets


def _label_text(shown: _Shown, positions: range) -> str:
    """Return the text of a label file."""
    rects = [shown[k][0] if k in shown else () for k in positions]
    top: dict[str, object] = {"exist": [int(k in shown) for k in positions], "gt_rect": rects}
    if any(share is not None for _, share in shown.values()):
        top["visibility"] = [shown[k][1] if k in shown else None for k in positions]
    return json.dumps(top, allow_nan=False) + "\n"


def _plain(value: float) -> float | int:
    """Return a coordinate with up to eight decimals, as a whole number if it is one."""
    rounded = round(value, 8)
    return int(rounded) if rounded == int(rounded) else rounded
