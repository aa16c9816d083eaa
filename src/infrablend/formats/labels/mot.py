"""MOTChallenge (MOT15 to MOT20, and what CVAT and Datumaro call MOT): sequences of frames with a text of tracks each.

    [train|val|test/]<sequence>/img1/000001.png ..    <sequence>/gt/gt.txt    [gt/labels.txt]    [seqinfo.ini]

A line of `gt.txt` is `frame,id,x,y,width,height,conf,class,visibility`. Everything is counted from 1: frames, ids,
classes, and pixels, so that a box at the top left corner of the picture begins at 1, 1. A row whose conf is 0 does not
count in evaluation. Line k of `labels.txt` is the name of class k.
"""

from __future__ import annotations

import configparser
import itertools
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance, Split
from infrablend.core.file_names import leaves, leaves_folder, real_path
from infrablend.errors import Problem
from infrablend.formats.annotation_files import leave_out
from infrablend.formats.base import (
    SPLIT_FOLDERS,
    Match,
    check_splits,
    is_ignored_name,
    require_options,
    require_size,
)
from infrablend.formats.box_checks import edges_of_xywh, snap_edges
from infrablend.formats.losses import Written
from infrablend.formats.pictures.listing import SEQUENCE_DEPTH, folders_of_sequences, list_pictures
from infrablend.formats.records import KEEP_OR_DROP, Findings, unlabelled_problems
from infrablend.formats.sequence_writing import (
    Frames,
    Place,
    SequenceWriter,
    Tracks,
    is_labelled,
    rate_of,
    second_of,
    with_names,
)
from infrablend.formats.values import number_text, plain_id, to_floats, to_int, to_number, to_share

NAME = "mot"
OPTIONS = {
    "origin": "number of the first column and row: 1 (the default), as in MOTChallenge, or 0, as CVAT and Datumaro do",
    "frames": "meaning of a row's frame: number (the default), as in the picture's name, or order, its position from 1",
    "unlabelled": "keep or drop pictures of sequences without gt/gt.txt; keep is the default",
}
CLASSES = (
    "pedestrian", "person on vehicle", "car", "bicycle", "motorbike", "non motorized vehicle", "static person",
    "distractor", "occluder", "occluder on the ground", "occluder full", "reflection",
)  # fmt: skip
"""Names of MOTChallenge's classes, from 1 on, as Datumaro and CVAT call them."""

_GT = "gt/gt.txt"
_LABELS = "labels.txt"
_INFO = "seqinfo.ini"
_PICTURES = "img1"
# Id of boxes that no tracker has assigned to an object yet.
_UNTRACKED = -1
_ROW = "frame,id,x,y,width,height,conf,class,visibility, counted from 1"
_CHALLENGE = re.compile(r"(?:2D)?MOT-?(?:20)?(?:15|16|17|20)(?!\d)", re.IGNORECASE)
_NUMBER = re.compile(r"\d{1,12}", re.ASCII)
ASSUMED_RATE = 30.0
"""Frames per second where nothing says it: trackers need one, and MOTChallenge's own value is mostly this."""
# Field of our own that says which rate nobody knows; at the end, because some trackers find fields by their neighbours.
_ASSUMED = "assumedFrameRate"
_TRACKS_FILE = "tracks.csv"
_TRACKS_COLUMNS = ("sequence", "id", "category", "track_id")
_LACKS = ("obb", "mask", "occlusion", "truncated", "difficult")


# -- finding ---------------------------------------------------------------------------------------------------


def _sequences(root: Path) -> list[Path]:
    return folders_of_sequences(root, lambda folder: (folder / _GT).is_file() or (folder / _INFO).is_file())


def _split_of(root: Path, folder: Path) -> Split:
    """Return the split that a folder above a sequence states, or the dataset's own, else train."""
    parts = (real_path(root).name, *folder.relative_to(root).parts[:-1])
    return next((s for p in reversed(parts) if (s := SPLIT_FOLDERS.get(p.lower()))), "train")


def detect(root: Path) -> Match:
    """Decide whether `root` is or contains sequences with `gt/gt.txt`, or with `seqinfo.ini`, and pictures."""
    for folder in _sequences(root) if root.is_dir() else ():
        if (folder / _PICTURES).is_dir() or (folder / _INFO).is_file():
            where = folder.relative_to(root).as_posix()
            return Match(NAME, True, f"{'the folder' if where == '.' else where} is a sequence with {_GT} or {_INFO}")
    return Match(NAME, False, f"no folder with {_PICTURES}/ and {_GT}, and none with {_INFO}")


# -- reading ---------------------------------------------------------------------------------------------------


@dataclass(kw_only=True)
class _Reading(Findings):
    """Options of the reader, and what it found so far.

    Attributes:
        origin: Number of the first column and row of pixels.
        by_order: Whether a row's frame is the position of a picture, not the number in its name.
        numbers: Number of each class by name; the first sequence that has a class decides.
        originals: Track by sequence and id, for ids that our writer had to change.
    """

    origin: int
    by_order: bool
    numbers: dict[str, int]
    originals: Mapping[tuple[str, int], int | str]


@dataclass(frozen=True)
class _Row:
    where: str
    frame: int
    track: int | None
    xywh: tuple[float, ...]
    category: str
    ignored: bool
    visibility: float | None


def read(
    root: Path,
    *,
    splits: Iterable[str] | None = None,
    metadata: Path | None = None,
    origin: str = "1",
    frames: str = "number",
    unlabelled: str = "keep",
) -> Dataset:
    """Read all sequences below a folder; `Capture.frame` counts from 0, so that frame 1 of a text is 0.

    Raises:
        DatasetError: An option has a wrong value, or no picture can be read.
    """
    require_options(
        root,
        origin=(origin, ("0", "1")),
        frames=(frames, ("number", "order")),
        unlabelled=(unlabelled, KEEP_OR_DROP),
    )
    wanted = check_splits(splits)
    reading = _Reading(root, origin=int(origin), by_order=frames == "order", numbers={}, originals={})
    reading.originals = dict(reading.own_rows(_TRACKS_FILE, _TRACKS_COLUMNS, _read_track))
    records: list[ImageRecord] = []
    for folder in _sequences(root):
        split = _split_of(root, folder)
        if split in wanted:
            reading.counts["sequences"] += 1
            records += _read_sequence(reading, folder, split, unlabelled)
    records = with_names(reading, records)
    keys = ("sequences", "rows", "read", "ignored", "untracked", "without_picture", "unlabelled", "without_seqinfo")
    notes = {"labels": NAME, "origin": int(origin), "frames": frames, "rows": reading.rows(*keys)}
    numbered = sorted((number, name) for name, number in reading.numbers.items())
    categories = [Category(number, name, "", is_ignored_name(name)) for number, name in numbered]
    return reading.dataset(NAME, records, categories, notes, metadata=metadata, splits=wanted)


def _read_track(row: Sequence[str]) -> tuple[tuple[str, int], int | str] | None:
    """Return sequence, id and track of a row of `tracks.csv`, in which our writer lists tracks whose ids it changed."""
    number = to_int(row[1])
    return None if number is None else ((row[0], number), plain_id(row[3]))


def _read_sequence(reading: _Reading, folder: Path, split: Split, unlabelled: str) -> list[ImageRecord]:
    where = reading.place(folder) if folder != reading.root else reading.root.name
    info = _read_info(reading, folder)
    pictures = _numbered_pictures(reading, folder, where, info)
    sequence = real_path(folder).name if folder == reading.root else folder.name
    labelled = (folder / _GT).is_file()
    leave_out(sorted(folder.glob("det/*.txt")))  # what a detector found: no labels
    of_frame: dict[int, list[_Row]] = defaultdict(list)
    if labelled:
        rows = _read_rows(reading, folder, where)
        if rows is None:  # not readable: its frames are not known to be without objects
            return []
        places = dict(enumerate(sorted(pictures), 1)) if reading.by_order else {n: n for n in pictures}
        for row in rows:
            if row.frame in places:
                of_frame[places[row.frame]].append(row)
        _report_lost(reading, rows, places, reading.place(folder / _GT))
    else:
        reading.counts["unlabelled"] += len(pictures)
        reading.problems += unlabelled_problems(where, len(pictures), unlabelled, f"no {_GT}")
        if unlabelled == "drop":
            return []
    rate = to_number(info.get("framerate"))
    if rate is not None and (rate <= 0 or rate == to_number(info.get(_ASSUMED.lower()))):
        rate = None
    extra = ({} if labelled else {"labelled": False}) | ({} if rate is None else {"frame_rate": rate})
    records: list[ImageRecord] = []
    for number, path in pictures.items():
        size_wh = reading.size(path, reading.place(path))
        if size_wh is not None:
            instances = _instances(reading, of_frame[number], size_wh, where)
            capture = Capture(sequence=sequence, frame=number - 1, time_s=second_of(number - 1, rate))
            name = f"{sequence}/{path.name}"
            records.append(ImageRecord("", path, split, size_wh, instances, capture, extra=extra, file_name=name))
    _compare_info(reading, info, pictures, records, reading.place(folder / _INFO))
    return records


def _read_info(reading: _Reading, folder: Path) -> Mapping[str, str]:
    """Return the fields of `seqinfo.ini`, names in lower case; none without one."""
    path = folder / _INFO
    if not path.is_file():
        reading.counts["without_seqinfo"] += 1
        return {}
    text = reading.text(path, "a section [Sequence] with name, imDir, seqLength, ...")
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    try:
        parser.read_string(text or "")
        return dict(parser["Sequence"]) if text else {}
    except (configparser.Error, KeyError) as error:
        found = f"no section [Sequence] ({type(error).__name__})"
        reading.warn(reading.place(path), "annotation-layout", found, "[Sequence]", "correct it; sizes are not needed")
        return {}


def _numbered_pictures(reading: _Reading, folder: Path, where: str, info: Mapping[str, str]) -> dict[int, Path]:
    """Return the pictures of a sequence by number: that in the name, else the position among them, from 1."""
    inside = info.get("imdir", "").strip() or _PICTURES
    if leaves(inside) or leaves_folder(folder / inside):
        reading.add(where, "name-climbs", f"imDir {inside!r} leads out of the folder", "a folder inside it", "move it")
        return {}
    listed = list(list_pictures(folder / inside, is_labelled=lambda p: True).values())
    if not listed:
        expected = f"pictures in {inside}/, named 000001.jpg and so on"
        todo = "extract the frames of the video there"
        reading.add(where, "image-missing", f"no picture in {inside}/", expected, todo)
    numbers = [int(p.stem) if _NUMBER.fullmatch(p.stem) else 0 for p in listed]
    if len({*numbers, 0}) == len(listed) + 1:
        return dict(sorted(zip(numbers, listed, strict=True)))
    if listed:
        found = f"{len(listed)} picture(s) whose names are not numbers from 1, each once; they are numbered in order"
        todo = "compare some boxes with their pictures"
        reading.warn(where, "name-grammar", found, "names such as 000001.jpg", todo)
    return dict(enumerate(listed, 1))


def _read_rows(reading: _Reading, folder: Path, sequence: str) -> list[_Row] | None:
    where = reading.place(folder / _GT)
    text = reading.text(folder / _GT, "a line per box: " + _ROW)
    if text is None:
        return None
    names = _class_names(reading, folder)
    rows: list[_Row] = []
    seen: Counter[tuple[int, int]] = Counter()
    for n, line in enumerate(text.split("\n"), 1):
        if not line.strip():
            continue
        reading.counts["rows"] += 1
        row = _read_row(reading, line, f"{where}: line {n}", names)
        if row is None:
            continue
        rows.append(row)
        if row.track is None:
            continue
        seen[row.frame, row.track] += 1
        if seen[row.frame, row.track] > 1:
            reading.track_twice(row.where, row.track, row.frame, "give one of them another id")
    if untracked := sum(row.track is None for row in rows):
        reading.counts["untracked"] += untracked
        found = f"{untracked} row(s) with id {_UNTRACKED}, read as objects without a track"
        reading.warn(where, "track-missing", found, "ids from 1 on, the same for an object in all its frames")
    if not text.strip():
        todo = "fetch it again, if the sequence shows objects"
        reading.warn(where, "label-empty", f"no line: no object in all of {sequence}", "a line per box", todo)
    return rows


def _read_row(reading: _Reading, line: str, where: str, names: Mapping[int, str]) -> _Row | None:
    cells = [c.strip() for c in line.strip().rstrip(",").split(",")]
    numbers = to_floats(cells, len(cells)) if 6 <= len(cells) <= 10 else None
    frame, track = (to_int(c) for c in cells[:2]) if numbers else (None, None)
    if numbers is None or frame is None or track is None or frame < 1:
        reading.add(where, "row-malformed", repr(line.strip()[:80]), _ROW, "correct the line")
        return None
    number = to_int(numbers[7]) if len(numbers) > 7 else -1
    name = None if number is None else names.get(number)
    if name is None and number is not None and (number > 0 or number == -1) and not names:
        name = "object" if number == -1 else f"class_{number}"
    if name is None:
        expected = "one of " + ", ".join(f"{k} {v}" for k, v in sorted(names.items()))[:120] if names else "from 1"
        reading.add(where, "category-unknown", f"class {cells[7]}", expected, f"name it in gt/{_LABELS}")
        return None
    _enter(reading.numbers, name, number or 0)
    ignored = len(numbers) > 6 and numbers[6] == 0
    visibility = to_share(numbers[8]) if len(numbers) > 8 else None
    return _Row(where, frame, None if track == _UNTRACKED else track, numbers[2:6], name, ignored, visibility)


def _class_names(reading: _Reading, folder: Path) -> Mapping[int, str]:
    """Return the names of a sequence's classes: from the nearest `labels.txt`, or MOTChallenge's own; else none."""
    above = itertools.takewhile(lambda p: p.is_relative_to(reading.root), folder.parents)
    for path in (p / _LABELS for p in (folder / "gt", folder, *above)):
        if path.is_file():
            lines = (reading.text(path, "a name of a class per line") or "").splitlines()
            names = {n: name for n, line in enumerate(lines, 1) if (name := line.strip())}
            for n, name in names.items():
                _enter(reading.numbers, name, n)
            return names
    if any(_CHALLENGE.match(p.name) for p in (real_path(reading.root), folder, *folder.parents[:SEQUENCE_DEPTH])):
        names = dict(enumerate(CLASSES, 1))
        for n, name in names.items():
            _enter(reading.numbers, name, n)
        return {-1: CLASSES[0], **names}  # MOT15 has no classes: all are pedestrians
    return {}


def _enter(numbers: dict[str, int], name: str, number: int) -> None:
    """Give a class its number in the file, or a free one if another sequence uses that for another class."""
    if name not in numbers:
        taken = {*numbers.values()}
        numbers[name] = number if number > 0 and number not in taken else max(taken, default=0) + 1


def _report_lost(reading: _Reading, rows: Sequence[_Row], places: Mapping[int, int], where: str) -> None:
    """Count rows whose frame has no picture, and warn."""
    lost = [r.frame for r in rows if r.frame not in places]
    reading.counts["without_picture"] += len(lost)
    if lost:
        found = f"{len(lost)} of {len(rows)} row(s) left out because their frame has no picture, such as {lost[0]}"
        todo = "restore the pictures; if frames are positions among the pictures, add --read frames=order"
        reading.warn(where, "row-without-picture", found, "a picture per frame, named by its number", todo)


def _compare_info(
    reading: _Reading, info: Mapping[str, str], pictures: Mapping[int, Path], records: Sequence[ImageRecord], where: str
) -> None:
    """Warn where `seqinfo.ini` states another length or size than the pictures have, which count."""
    length = to_int(info.get("seqlength"))
    if length is not None and pictures and length != max(pictures):
        found = f"seqLength {length}; the last picture is number {max(pictures)}"
        reading.warn(where, "sequence-length", found, "the number of the last frame", "restore the pictures")
    stated = (to_int(info.get("imwidth")), to_int(info.get("imheight")))
    others = [r for r in records if r.size_wh != stated]
    if None not in stated and others:
        size = f"{stated[0]}x{stated[1]} px"
        found = f"{len(others)} of {len(records)} picture(s) are not of {size}, such as {others[0].name}"
        reading.warn(where, "image-size", found, "pictures of imWidth x imHeight", "the pictures' own sizes are used")


def _instances(
    reading: _Reading, rows: Sequence[_Row], size_wh: tuple[int, int], sequence: str
) -> tuple[Instance, ...]:
    instances: list[Instance] = []
    for row in rows:
        x, y, w, h = row.xywh
        edges = edges_of_xywh((x - reading.origin, y - reading.origin, w, h), None)
        box = reading.box(snap_edges(edges, size_wh), size_wh, row.where)
        if box is None:
            continue
        # Of a class to ignore, the name says it; any other box that does not count is what COCO calls a crowd.
        crowd = {"iscrowd": 1} if row.ignored and not is_ignored_name(row.category) else {}
        reading.counts["ignored"] += row.ignored
        reading.counts["read"] += 1
        track = None if row.track is None else reading.originals.get((sequence, row.track), row.track)
        instances.append(Instance(row.category, box, visibility=row.visibility, extra=crowd, track_id=track))
    return tuple(instances)


# -- writing ---------------------------------------------------------------------------------------------------


def write(
    out: Path, images: Iterable[ImageRecord], categories: Sequence[Category], *, pictures: bool = True
) -> Written:
    """Write `<split>/<sequence>/` with `gt/gt.txt`, `gt/labels.txt` and `seqinfo.ini`, and link the pictures to `img1`.

    Classes are numbered from 1 in the order of their ids. Numbers of frames are `Capture.frame` plus 1, or those of the
    names' order where it is unknown or occurs twice. Pictures without a sequence form one of their own. `names.csv`
    lists names, sequences and frames that `read` would not find out, `tracks.csv` the tracks whose ids were changed:
    texts, numbers below 1, and numbers of several classes. `metadata.csv` has pitch, altitude and the like.

    Raises:
        OutputError: A file cannot be written.
        ValueError: A size is missing, or a category is not in the list.
    """
    writer = SequenceWriter(out, images, categories, _LACKS)
    names = [c.name for c in sorted(categories, key=lambda c: c.id)]
    classes = {name: n for n, name in enumerate(names, 1)}
    ignored = {c.name for c in categories if c.ignore}
    changed: list[tuple[str, int, str, int | str]] = []
    rates: dict[str, float | None] = {}

    def row(number: int, track: int, o: Instance) -> str:
        writer.losses["visibility_made"] += o.visibility is None
        counts = int(not o.is_crowd and o.category not in ignored)
        return _line(number + 1, track, o, counts, classes[o.category])

    def find_out(place: Place) -> Capture:
        return replace(place.capture, time_s=second_of(place.number, rates[place.folder]))

    for folder, frames, numbers in writer.sequences():
        rates[folder] = _rate(folder, frames, numbers, writer.problems)
        writer.text(f"{folder}/{_INFO}", [_info(folder, frames, numbers[-1] + 1, rates[folder], writer.problems)])
        if not any(is_labelled(image) for image in frames):
            continue  # as in the test parts of MOTChallenge
        writer.losses["unlabelled_unsaid"] += sum(not is_labelled(image) for image in frames)
        tracks = Tracks(frames, 1)
        changed += [(folder, number, *key) for key, number in tracks.changed.items()]
        writer.text(f"{folder}/{_GT}", writer.rows(frames, numbers, tracks, row))
        writer.text(f"{folder}/gt/{_LABELS}", (f"{name}\n" for name in names))
    writer.table(_TRACKS_FILE, _TRACKS_COLUMNS, changed)
    writer.pictures(_path_of, pictures, find_out=find_out)
    return writer.written()


def _path_of(image: ImageRecord, place: Place) -> str:
    return f"{place.folder}/{_PICTURES}/{place.number + 1:06d}{PurePosixPath(image.name).suffix}"


def _rate(folder: str, sequence: Frames, numbers: Sequence[int], problems: list[Problem]) -> float | None:
    """Return the frames per second; None, with a warning, if nothing says it, and a warning if it varies."""
    stated = (to_number(image.extra.get("frame_rate")) for image in sequence)
    first = next((r for r in stated if r is not None and r > 0), None)
    rate, varies = rate_of((image.capture.time_s for image in sequence), numbers, first)
    where = f"{folder}/{_INFO}"
    expected = "frames per second"
    if rate is None:
        found = f"frame rate unknown; {ASSUMED_RATE:g} is stated"
        todo = "correct frameRate before you use a tracker"
        problems.append(Problem(where, "frame-rate", found, expected, todo, "warning"))
    elif varies:
        found = f"steps of {varies}; the rate of the median step, {number_text(rate)}, is stated"
        problems.append(Problem(where, "frame-rate", found, expected, "names.csv has each time", "warning"))
    return rate


def _info(folder: str, sequence: Frames, last: int, rate: float | None, problems: list[Problem]) -> str:
    """Return the text of `seqinfo.ini`; what one sequence cannot state of several pictures is a warning."""
    sizes = Counter(require_size(image) for image in sequence)
    suffixes = Counter(PurePosixPath(image.name).suffix for image in sequence)
    (width, height), _ = sizes.most_common(1)[0]
    suffix, _ = suffixes.most_common(1)[0]
    where = f"{folder}/{_INFO}"
    if len(sizes) > 1 or len(suffixes) > 1:
        kinds = sorted([*(f"{w}x{h} px" for w, h in sizes), *(suffixes if len(suffixes) > 1 else ())])
        found = f"pictures of {', '.join(kinds)[:100]}; the most frequent is stated"
        problems.append(Problem(where, "image-size", found, "one size and type per sequence", "", "warning"))
    if last > len(sequence):
        found = f"{len(sequence)} picture(s) numbered up to {last}; trackers may expect each number"
        problems.append(Problem(where, "frames-missing", found, "all frames of a sequence", "", "warning"))
    fields: dict[str, object] = {
        "name": folder.partition("/")[2],
        "imDir": _PICTURES,
        "frameRate": number_text(rate or ASSUMED_RATE),
        "seqLength": last,
        "imWidth": width,
        "imHeight": height,
        "imExt": suffix,
        **({_ASSUMED: number_text(ASSUMED_RATE)} if rate is None else {}),
    }
    return "[Sequence]\n" + "".join(f"{k}={v}\n" for k, v in fields.items())


def _line(frame: int, track: int, o: Instance, counts: int, number: int) -> str:
    x0, y0, x1, y1 = o.box_xyxy.tolist()
    box = ",".join(number_text(v) for v in (x0 + 1, y0 + 1, x1 - x0, y1 - y0))
    return f"{frame},{track},{box},{counts},{number},{number_text(1 if o.visibility is None else o.visibility)}\n"
