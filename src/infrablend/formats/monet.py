"""MONET (Riz et al. 2023): COCO JSON with the drone's telemetry inside, pictures in folders by sequence.

    [train/|val/|test/]<sequence>/lwir/image*.png      COCO files anywhere below the folder

No file of MONET was at hand. Known are: COCO, PNG in `<sequence>/lwir`, sequences `runway_NN` and `dirtroad_NN`,
telemetry inside the annotation files and empty for some of them, a gimbal pitch below 0 for a camera that looks down.
Where the JSON lies, how it names pictures, keys, units and sizes are searched for, said in `Dataset.notes`, checked,
and set by options. See docs/formats/monet.md for what rests on what.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from fnmatch import fnmatch
from pathlib import Path, PurePosixPath
from typing import Any, Literal, TypeVar

from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Split, TimeOfDay
from infrablend.core.files import link_or_copy, write_text
from infrablend.errors import DatasetError, Problem
from infrablend.formats import coco
from infrablend.formats.base import (
    Match,
    Written,
    category_ids,
    check_splits,
    few,
    leaves_folder,
    number_ids,
    read_json,
    require_size,
    sort_images,
    to_floats,
    to_int,
    to_size,
)
from infrablend.formats.capture import Capture, Captures, find_table, read_table
from infrablend.formats.pictures import (
    PictureFolder,
    assign_ids,
    check_link,
    check_name,
    is_hidden,
    list_pictures,
    read_size,
)

NAME = "monet"
OPTIONS = {
    "pitch_sign": "-1 where negative pitch looks down, +1 where positive does; told from the majority by default",
    "pitch_key": "gimbal pitch in an image record, dotted for an object inside it, e.g. metadata.g_pitch",
    "altitude_key": "altitude in metres, likewise",
    "time_key": "time of capture, likewise",
    "angle_unit": "of the pitch: deg (default) or rad",
    "time_of_day": "of every image: day or night",
    "exclude": "sequences to leave out: a,b,c",
    "empty": "sequences without any pitch: exclude (default) or keep",
    "split": "of every image: train, val or test; told from folder and file names by default",
    "annotations": "pattern of the annotation files below the folder, e.g. annotations/*.json",
    "pictures": "folder of an annotation file's pictures below the data set's, e.g. {stem}/lwir",
}

# Only g_pitch and alt are read off a figure of the authors; the others are guesses that cost nothing.
PITCH_KEYS = ("g_pitch", "gimbal_pitch")
ALTITUDE_KEYS = ("alt", "altitude")
TIME_KEYS = ("timestamp", "time_stamp", "time", "date_captured")
# Where the writer puts telemetry if the source had none.
NEST = "metadata"

Place = tuple[str, ...]
T = TypeVar("T")
_COCO_FIELDS = ("id", "file_name", "width", "height", "source_id")
# No annotations of backgrounds: pictures' tables, our own runs.
_NO_ANNOTATIONS = (
    "metadata.json",
    "world.json",
    "run.json",
    "package.json",
    "convert.json",
    "split.json",
    "SOURCE.json",
)
_SKIPPED_FOLDERS = ("coco", "native", "scenes", "log")
_JSON_DEPTH = 4
_SPLITS: Mapping[str, Split] = {
    "train": "train", "training": "train", "val": "val", "valid": "val", "validation": "val", "test": "test",
    "testing": "test",
}  # fmt: skip
_SEQUENCE = re.compile(r"(?:runway|dirtroad)_\d+")
_NUMBERED = re.compile(r"[A-Za-z]+_\d+")
# A gimbal that points straight down reads a little more at times.
_BEYOND_DEG = 1.0
_SAMPLE = 50
_INFO: Mapping[str, Any] = {"description": "MONET layout, written by InfraBlend"}


# -- finding ---------------------------------------------------------------------------------------------------


def find_files(root: Path, pattern: str | None = None) -> list[Path]:
    """JSON files that may hold annotations, sorted: at most four folders down, or those that fit a pattern."""
    found: list[Path] = []
    for base, folders, names in os.walk(root):
        here = Path(base)
        depth = len(here.relative_to(root).parts)
        folders[:] = sorted(
            d for d in folders if not is_hidden(d) and depth < _JSON_DEPTH and (d not in _SKIPPED_FOLDERS or pattern)
        )
        # No pipes or devices: they would be waited for.
        files = [here / n for n in names if n.lower().endswith(".json") and not is_hidden(n) and (here / n).is_file()]
        if pattern is None:
            found += [p for p in files if p.name not in _NO_ANNOTATIONS]
        else:
            found += [p for p in files if fnmatch(p.relative_to(root).as_posix(), pattern)]
    return sorted(found)


def detect(root: Path) -> Match:
    """Whether `root` is MONET: JSON below it that mentions a gimbal pitch, or beside folders named as its sequences."""
    files = find_files(root)
    if not files:
        return Match(NAME, False, "no JSON file in the folder or up to four below")
    for path in files:
        key = _mentioned(path)
        if key is not None:
            return Match(NAME, True, f"{path.relative_to(root).as_posix()} holds {key!r}")
    for base, folders, _ in os.walk(root):
        depth = len(Path(base).relative_to(root).parts)
        # COCO and others keep our pictures' folders below `images`: those are theirs.
        folders[:] = sorted(d for d in folders if not is_hidden(d) and d != "images" and depth < _JSON_DEPTH)
        named = next((d for d in (Path(base).resolve().name, *folders) if _SEQUENCE.fullmatch(d)), None)
        if named is not None:
            return Match(NAME, True, f"JSON files and a sequence folder {named}")
    return Match(NAME, False, f"no JSON file mentions {' or '.join(PITCH_KEYS)}, no folder runway_NN or dirtroad_NN")


def _mentioned(path: Path) -> str | None:
    """The pitch key that a file holds as text, found without parsing it."""
    keys = [f'"{k}"'.encode() for k in PITCH_KEYS]
    keep = max(map(len, keys))
    if leaves_folder(path) or not path.is_file():
        return None
    try:
        with path.open("rb") as file:
            tail = b""
            while chunk := file.read(1 << 20):
                block = tail + chunk
                for name, key in zip(PITCH_KEYS, keys, strict=True):
                    if key in block:
                        return name
                tail = block[-keep:]
    except OSError:
        return None
    return None


# -- options ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Options:
    sign: int | None
    pitch: Sequence[str]
    altitude: Sequence[str]
    time: Sequence[str]
    radians: bool
    time_of_day: TimeOfDay | None
    exclude: tuple[str, ...]
    keep_empty: bool
    split: Split | None


def _check_options(root: Path, given: Mapping[str, str | None]) -> _Options:
    allowed: dict[str, Mapping[str, Any]] = {
        "pitch_sign": {"-1": -1, "+1": 1, "1": 1},
        "angle_unit": {"deg": False, "rad": True},
        "time_of_day": {"day": "day", "night": "night"},
        "empty": {"exclude": False, "keep": True},
        "split": {s: s for s in SPLITS},
    }
    problems: list[Problem] = []
    value: dict[str, Any] = {}
    for name, choices in allowed.items():
        text = given[name]
        if text is not None and text not in choices:
            problems.append(Problem(f"option {name}", "option-value", repr(text), f"one of {', '.join(choices)}"))
        value[name] = choices.get(text) if text is not None else None
    for name in ("pitch_key", "altitude_key", "time_key"):
        text = given[name]
        if text is not None and not all(text.split(".")):
            problems.append(Problem(f"option {name}", "option-value", repr(text), "a key, or keys joined by dots"))
    if problems:
        raise DatasetError(f"{root}: options that cannot be used", problems)

    def keys(name: str, otherwise: Sequence[str]) -> Sequence[str]:
        text = given[name]
        return otherwise if text is None else (text,)

    return _Options(
        value["pitch_sign"], keys("pitch_key", PITCH_KEYS), keys("altitude_key", ALTITUDE_KEYS),
        keys("time_key", TIME_KEYS), bool(value["angle_unit"]), value["time_of_day"],
        tuple(sorted({s.strip() for s in (given["exclude"] or "").split(",") if s.strip()})), bool(value["empty"]),
        value["split"],
    )  # fmt: skip


# -- telemetry -------------------------------------------------------------------------------------------------


def _places(record: Mapping[str, Any], keys: Sequence[str]) -> Iterator[Place]:
    """Where one of the keys stands: as dotted path, in the record itself, in an object one level inside."""
    for key in keys:
        path = tuple(key.split("."))
        if len(path) > 1 and _at(record, path) is not None:
            yield path
        if key in record:
            yield (key,)
        for nest, inside in sorted(record.items()):
            if isinstance(inside, dict) and key in inside:
                yield nest, key


def _at(record: Mapping[str, Any], place: Place) -> Any:
    value: Any = record
    for key in place:
        if not isinstance(value, dict):
            return None
        value = value.get(key)
    return value


def _find(record: Mapping[str, Any], keys: Sequence[str], read: Callable[[Any], T | None]) -> tuple[Place | None, Any]:
    """The first place whose value can be read, else the first with a value, else the first; and the value there."""
    best: tuple[int, Place | None, Any] = (0, None, None)
    for place in _places(record, keys):
        value = _at(record, place)
        rank = 1 if value in (None, "", [], {}) else 2 if read(value) is None else 3
        if rank > best[0]:
            best = rank, place, value
    return best[1], best[2] if best[0] > 1 else None


def _join_lists(top: Mapping[str, Any]) -> dict[int, dict[str, Any]]:
    """Top-level lists of objects with an `image_id`, other than the annotations: telemetry kept beside the images."""
    joined: dict[int, dict[str, Any]] = defaultdict(dict)
    for name, entries in sorted(top.items()):
        if name in ("images", "annotations", "categories", "licenses") or not isinstance(entries, list):
            continue
        for entry in entries:
            number = to_int(entry.get("image_id")) if isinstance(entry, dict) else None
            if number is not None:
                joined[number][name] = {k: v for k, v in entry.items() if k != "image_id"}
    return joined


def _tidy_time(value: Any) -> str | None:
    """ISO 8601 of a time in a form of it, None of anything else."""
    try:
        return datetime.fromisoformat(value.strip()).isoformat() if isinstance(value, str) else None
    except ValueError:
        return None


# -- pictures --------------------------------------------------------------------------------------------------


class _Pictures:
    """All pictures below the data set's folder, and where an annotation file's own are among them."""

    def __init__(self, root: Path) -> None:
        self.by_path = list_pictures(root, _SKIPPED_FOLDERS)
        self._by_name: dict[str, list[tuple[str, ...]]] = defaultdict(list)
        stems: dict[str, str] = {}
        for path in self.by_path:
            stem = path.rpartition(".")[0]
            stems.setdefault(stem, path)
            for known in (path, stem):
                parts = tuple(known.split("/"))
                self._by_name[parts[-1]].append(parts)
        self.folder = PictureFolder(root, self.by_path, stems)

    def resolve(self, name: str, base: str, strip: int) -> str:
        """A name of an annotation as path below the data set's folder."""
        parts = PurePosixPath(name).parts[strip:]
        return str(PurePosixPath(base, *parts)) if parts else name

    def locate(self, names: Sequence[str], where: str) -> tuple[str, int] | Problem:
        """The folder that a file's names are relative to, and how many leading folders to take off them first.

        A folder that shares names with the file's path (`runway_04.json`, `runway_04/...`) is preferred over one
        where more pictures happen to bear the same names.
        """
        step = max(1, len(names) // _SAMPLE)
        said = PurePosixPath(where).with_suffix("").parts
        votes: Counter[tuple[str, int]] = Counter()
        shared: dict[tuple[str, int], int] = defaultdict(int)
        for name in names[::step]:
            wanted = PurePosixPath(name).parts
            for parts in self._by_name.get(wanted[-1] if wanted else "", ()):
                same = 0
                while same < min(len(wanted), len(parts)) and wanted[-1 - same] == parts[-1 - same]:
                    same += 1
                known = sum(s in parts for s in said)
                for used in range(1, same + 1):
                    choice = ("/".join(parts[: len(parts) - used]), len(wanted) - used)
                    votes[choice] += 1
                    shared[choice] = max(shared[choice], known)
        if not votes:
            return "", 0

        def rank(choice: tuple[str, int]) -> tuple[int, int, int]:
            return shared[choice], -choice[1], votes[choice]

        best = max(rank(c) for c in votes)
        top = sorted(c for c in votes if rank(c) == best)
        if len({c[0] for c in top}) == 1:
            return top[0]
        found = f"pictures of its names ({names[0]}, ...) lie in {', '.join(c[0] or '.' for c in top[:4])}"
        return Problem(where, "pictures-ambiguous", found, "one folder", "say which, e.g. --read pictures={stem}/lwir")

    def given(self, pattern: str, names: Sequence[str], where: str) -> tuple[str, int]:
        """As `locate`, for the folder that the option `pictures` says."""
        path = PurePosixPath(where)
        base = pattern.replace("{stem}", path.stem).replace("{folder}", str(path.parent))
        base = str(PurePosixPath(base))
        deepest = max((len(PurePosixPath(n).parts) for n in names[:_SAMPLE]), default=1)
        counts = {
            strip: sum(self.resolve(n, base, strip) in self.by_path for n in names[:_SAMPLE])
            for strip in range(deepest)
        }
        return base, max(counts, key=lambda strip: (counts[strip], -strip))


def _split_in(parts: Sequence[str]) -> Split | None:
    """The split that a folder is named after: `val`, `monet_val`."""
    for part in parts:
        name = part.lower().removeprefix("monet").lstrip("_-")
        if name in _SPLITS:
            return _SPLITS[name]
    return None


def _split_in_stem(stem: str) -> Split | None:
    words = [w.rstrip("0123456789") for w in re.split(r"[^a-z0-9]+", stem.lower())]
    return next((_SPLITS[w] for w in words if w in _SPLITS), None)


def _sequence_of(path: str, stem: str, root_name: str) -> str | None:
    """The sequence of a picture: the folder that holds `lwir`, else its own folder, else the annotation file's name.

    The data set's own folder counts if it is named as MONET's sequences: somebody may have fetched but one.
    """
    folders = PurePosixPath(path).parent.parts
    if "lwir" in folders:
        folders = folders[: folders.index("lwir")]
        own = folders[-1] if folders else ""
    else:
        own = next((f for f in reversed(folders) if f not in ("images", ".")), "")
    if own and _split_in([own]) is None:
        return own
    if _SEQUENCE.fullmatch(root_name):
        return root_name
    return stem if _NUMBERED.fullmatch(stem) and _split_in_stem(stem) is None else None


def _below_split(path: str) -> str:
    """Where a picture lies below its split's folder."""
    parts = PurePosixPath(path).parts
    at = next((k for k, p in enumerate(parts[:-1]) if _split_in([p]) is not None), -1)
    return "/".join(parts[at + 1 :])


# -- reading ---------------------------------------------------------------------------------------------------


@dataclass(slots=True)
class _Frame:
    """A picture as read, its telemetry not yet interpreted."""

    record: ImageRecord
    where: str
    raw_deg: float | None
    altitude_m: float | None
    sequence: str | None


@dataclass(slots=True)
class _Tally:
    """Values of one file that cannot be used: how many, and the first few."""

    counts: Counter[str] = field(default_factory=Counter)
    shown: dict[str, list[str]] = field(default_factory=lambda: defaultdict(list))

    def add(self, what: str, text: str) -> None:
        self.counts[what] += 1
        if len(self.shown[what]) < 3:
            self.shown[what].append(text)

    def problems(self, where: str, expected: Mapping[str, str]) -> list[Problem]:
        return [
            Problem(
                where, "metadata-value", f"{n} image(s) with {what} {', '.join(self.shown[what])}, ignored",
                expected[what], "correct the file, or leave it", "warning",
            )
            for what, n in sorted(self.counts.items())
        ]  # fmt: skip


def read(
    root: Path,
    *,
    splits: Iterable[str] | None = None,
    metadata: Path | None = None,
    pitch_sign: str | None = None,
    pitch_key: str | None = None,
    altitude_key: str | None = None,
    time_key: str | None = None,
    angle_unit: str | None = None,
    time_of_day: str | None = None,
    exclude: str | None = None,
    empty: str | None = None,
    split: str | None = None,
    annotations: str | None = None,
    pictures: str | None = None,
) -> Dataset:
    """Read MONET, or what is laid out like it; the options are in `OPTIONS`, as text.

    `pitch_deg` is the gimbal's pitch turned into a depression angle, negative where the camera looks up. The sign is
    that for which most of the frames look down. Sequences without any pitch are left out, as in the paper; single
    frames without one are kept, with pitch None. All of it is counted in `notes`.

    Args:
        root: Folder of the data set, or of one of its splits.
        splits: The splits wanted; None reads all there are.
        metadata: Table of pitch and altitude that counts more than the telemetry; None takes `metadata.csv` or
            `.json` in the folder, if there.

    Raises:
        DatasetError: No annotation file; nothing to read; no telemetry where it was looked for; a file in which more
            than half of the cameras would look up; an option's value.
    """
    wanted = check_splits(splits)
    chosen = _check_options(
        root,
        {
            "pitch_sign": pitch_sign, "pitch_key": pitch_key, "altitude_key": altitude_key, "time_key": time_key,
            "angle_unit": angle_unit, "time_of_day": time_of_day, "exclude": exclude, "empty": empty, "split": split,
        },
    )  # fmt: skip
    problems: list[Problem] = []
    categories: list[Category] = []
    frames: list[_Frame] = []
    extra: dict[str, Any] = {}
    notes: dict[str, Any] = {"labels": "coco", "annotations": [], "pictures": {}}
    seen: set[str] = set()
    listing = _Pictures(root)
    files = find_files(root, annotations)
    for path in files:
        where = path.relative_to(root).as_posix()
        try:
            top = read_json(path)
        except DatasetError as error:
            problems += [Problem(where, p.code, p.found, p.expected, p.todo) for p in error.problems]
            continue
        if not coco.is_coco(top):
            found, expected = "no COCO keys, left out", "images with file_name, annotations, categories"
            problems.append(Problem(where, "annotation-layout", found, expected, severity="warning"))
            continue
        names = [
            i["file_name"] for i in top["images"] if isinstance(i, dict) and check_name(i.get("file_name"), "") is None
        ]
        place = listing.given(pictures, names, where) if pictures else listing.locate(names, where)
        if isinstance(place, Problem):
            problems.append(place)
            continue
        extra = {k: top[k] for k in ("info", "licenses") if k in top} | extra
        notes["annotations"].append(where)
        notes["pictures"][where] = place[0] or "."
        frames += _read_file(root, top, where, place, listing, chosen, wanted, seen, categories, problems)
    if not notes["annotations"]:
        raise _nothing_found(root, files, annotations, problems)
    notes["excluded"] = _leave_out(frames, chosen.exclude, "exclude", "named in exclude", problems, root)
    if not frames:
        raise DatasetError(f"{root}: nothing to read in the splits {', '.join(wanted)}", few(problems))
    notes["gimbal_pitch"] = _set_pitches(root, frames, chosen, problems)
    captures, notes["table"] = _apply_table(root, metadata, frames, problems)
    if not chosen.keep_empty:
        _require_pitch(root, frames, chosen, problems)
        has_pitch = {(f.record.split, f.sequence) for f in frames if f.record.pitch_deg is not None}
        bare = {(f.record.split, f.sequence) for f in frames} - has_pitch
        excluded = _leave_out(frames, bare, "empty", "no telemetry in any frame", problems, root)
        notes["excluded"] |= excluded
        captures.sources["none"] -= sum(entry["images"] for entry in excluded.values())
    notes["pitch"] = captures.note()
    without = Counter(f"{f.record.split}/{f.sequence}" for f in frames if f.record.pitch_deg is None)
    notes["frames_without_pitch"] = dict(sorted(without.items()))
    return Dataset(root, NAME, tuple(categories), _records(frames), tuple(problems), notes, extra)


def _nothing_found(root: Path, files: Sequence[Path], pattern: str | None, problems: Sequence[Problem]) -> DatasetError:
    """The error for a folder without a COCO file that can be used, with what was tried."""
    shown = ", ".join(p.relative_to(root).as_posix() for p in files[:8]) or "no JSON file"
    found = f"{shown}{f' and {len(files) - 8} more' if len(files) > 8 else ''}"
    expected = f"COCO files that fit {pattern}" if pattern else "COCO files at most four folders down"
    todo = "say where they are with --read annotations=PATTERN"
    return DatasetError(
        f"{root}: no annotations of MONET",
        [Problem(str(root), "annotation-missing", found, expected, todo), *few(problems)],
    )


def _read_file(
    root: Path,
    top: Mapping[str, Any],
    where: str,
    place: tuple[str, int],
    listing: _Pictures,
    chosen: _Options,
    wanted: Sequence[Split],
    seen: set[str],
    categories: list[Category],
    problems: list[Problem],
) -> list[_Frame]:
    """The pictures of one annotation file with what it says about them."""
    path = PurePosixPath(where)
    of_file = chosen.split or _split_in_stem(path.stem) or _split_in(path.parent.parts)
    of_root = _split_in([root.resolve().name])
    joined = _join_lists(top)
    images: list[Any] = []
    fields: dict[int, dict[str, Any]] = {}
    skipped: set[int] = set()
    twice = measured = 0
    for r in top["images"]:
        if not isinstance(r, dict) or check_name(r.get("file_name"), "") is not None:
            images.append(r)
            continue
        below = listing.resolve(r["file_name"], *place)
        name = below if below in listing.by_path else listing.folder.by_stem.get(below, below)
        file = listing.by_path.get(name)
        r = r | {"file_name": name if file is not None else r["file_name"]}
        number = to_int(r.get("id"))
        in_split = of_file or _split_in(PurePosixPath(below).parent.parts) or of_root or "train"
        if number is not None and (in_split not in wanted or (file is not None and name in seen)):
            twice += in_split in wanted
            skipped.add(number)
            continue
        if file is not None:
            seen.add(name)
            no_size = to_size(r.get("width"), r.get("height")) is None
            if no_size and check_link(file, root, where) is None:
                size_wh, problem = read_size(file, f"{where}: image {r.get('id')}")
                problems += [problem] if problem else []
                r |= {"width": size_wh[0], "height": size_wh[1]} if size_wh else {}
                measured += 1
        if number is not None:
            fields.setdefault(number, {k: v for k, v in r.items() if k not in _COCO_FIELDS} | joined.get(number, {}))
        images.append(r)
    if twice:
        found = f"{twice} picture(s) that another annotation file holds, too; left out here"
        problems.append(Problem(where, "image-duplicate", found, "each picture once", "remove one of the files"))
    if measured:
        found = f"{measured} image(s) without width and height, taken from the pictures"
        problems.append(Problem(where, "image-size-unknown", found, "width and height in px", severity="warning"))
    annotations = [a for a in top["annotations"] if not isinstance(a, dict) or to_int(a.get("image_id")) not in skipped]
    part = dict(top) | {"images": images, "annotations": annotations}
    records = coco.read_records(part, listing.folder, "train", where, categories, Captures(None, problems), problems)
    tally = _Tally()
    frames = []
    for _, record in records:
        number = record.source_id if isinstance(record.source_id, int) else -1
        own = fields.get(number, {})
        in_split = of_file or _split_in(PurePosixPath(record.name).parent.parts) or of_root or "train"
        sequence = _sequence_of(record.name, path.stem, root.resolve().name)
        frames.append(_frame(record, where, in_split, sequence, own, chosen, tally))
    expected = {
        "pitch": f"a number of at most {90 + _BEYOND_DEG:g} degrees", "altitude": "metres, at least 0",
        "time": "ISO 8601",
    }  # fmt: skip
    problems += tally.problems(where, expected)
    return frames


def _frame(
    record: ImageRecord,
    where: str,
    split: Split,
    sequence: str | None,
    fields: dict[str, Any],
    chosen: _Options,
    tally: _Tally,
) -> _Frame:
    """A record with its telemetry looked up; what cannot be used is tallied."""
    here = f"(image {record.source_id})"
    pitch_at, pitch = _find(fields, chosen.pitch, _number)
    altitude_at, altitude = _find(fields, chosen.altitude, _number)
    time_at, time = _find(fields, chosen.time, _tidy_time)
    raw = _number(pitch)
    if raw is not None and chosen.radians:
        raw = math.degrees(raw)
    if pitch is not None and (raw is None or abs(raw) > 90 + _BEYOND_DEG):
        tally.add("pitch", f"{_show(pitch)} {here}")
        raw = None
    metres = _number(altitude)
    if altitude is not None and (metres is None or not 0 <= metres <= 1e5):
        tally.add("altitude", f"{_show(altitude)} {here}")
        metres = None
    captured = _tidy_time(time)
    if time is not None and captured is None:
        tally.add("time", f"{_show(time)} {here}")
    places = {"pitch": pitch_at, "altitude": altitude_at, "time": time_at, "radians": chosen.radians}
    extra = {**record.extra, "fields": fields, "telemetry": places}
    kept = replace(
        record, split=split, sequence=sequence or record.sequence, captured=captured, extra=extra,
        file_name=_below_split(record.name), time_of_day=chosen.time_of_day or record.time_of_day,
    )  # fmt: skip
    return _Frame(kept, where, raw, metres, kept.sequence)


def _number(value: Any) -> float | None:
    numbers = to_floats([value], 1)
    return numbers[0] if numbers is not None and math.isfinite(numbers[0]) else None


def _show(value: Any) -> str:
    return ascii(value)[:40]


def _set_pitches(root: Path, frames: list[_Frame], chosen: _Options, problems: list[Problem]) -> dict[str, Any]:
    """Decide which sign looks down, turn all pitches into depression angles, and judge the result file by file."""
    raw = [f.raw_deg for f in frames if f.raw_deg is not None]
    below, above = sum(v < 0 for v in raw), sum(v > 0 for v in raw)
    keys = sorted({".".join(f.record.extra["telemetry"]["pitch"]) for f in frames if f.raw_deg is not None})
    name = ", ".join(keys)
    todo = "give --read pitch_sign=-1 (negative looks down) or +1"
    if chosen.sign is None and raw and below == above and below > 0:
        found = f"{below} values of {name} below 0 and as many above"
        problem = Problem(str(root), "pitch-sign", found, "most frames looking down", todo)
        raise DatasetError(f"{root}: which sign of the gimbal's pitch looks down cannot be told", [problem])
    sign = chosen.sign if chosen.sign is not None else -1 if below >= above else 1
    upward: Counter[str] = Counter()
    known: Counter[str] = Counter()
    clamped = 0
    for f in frames:
        if f.raw_deg is None:
            pitch = f.record.pitch_deg
        else:
            # Not -0.0 for a level camera.
            pitch = sign * f.raw_deg + 0.0
            clamped += abs(pitch) > 90
            pitch = max(-90.0, min(90.0, pitch))
            upward[f.where] += pitch < 0
            known[f.where] += 1
        altitude = f.record.altitude_m if f.altitude_m is None else f.altitude_m
        extra = {**f.record.extra, "telemetry": f.record.extra["telemetry"] | {"sign": sign}}
        f.record = replace(f.record, pitch_deg=pitch, altitude_m=altitude, extra=extra)
    if chosen.sign is None:
        wrong = [w for w in sorted(known) if 2 * upward[w] > known[w]]
    else:
        wrong = ["all files"] if 2 * sum(upward.values()) > sum(known.values()) else []
        upward["all files"], known["all files"] = sum(upward.values()), sum(known.values())
    if wrong:
        faults = [
            Problem(w, "pitch-sign", f"{upward[w]} of {known[w]} cameras look up with pitch = {'+-'[sign < 0]}{name}",
                    "most cameras looking down", todo)
            for w in wrong
        ]  # fmt: skip
        raise DatasetError(f"{root}: more than half of the pitches are negative", few(faults))
    said = f"pitch = {'+-'[sign < 0]}{name}: {below} values below 0, {above} above"
    if chosen.sign is None and raw:
        problems.append(
            Problem(root.name, "pitch-sign", said, "most frames looking down",
                    f"if that is wrong, {todo}; giving it silences this", "warning")
        )  # fmt: skip
    if not chosen.radians and len(raw) >= 10 and 0 < max(map(abs, raw)) <= math.pi / 2:
        found = f"all {len(raw)} values of {name} lie within {max(map(abs, raw)):.4g}: radians?"
        problems.append(
            Problem(root.name, "pitch-unit", found, "degrees", "if so, give --read angle_unit=rad", "warning")
        )
    return {
        "key": name, "unit": "rad" if chosen.radians else "deg", "sign": sign,
        "sign_from": "majority" if chosen.sign is None else "pitch_sign", "below_0": below, "above_0": above,
        "missing": len(frames) - len(raw), "beyond_90_clamped": clamped,
    }  # fmt: skip


def _apply_table(
    root: Path, metadata: Path | None, frames: Sequence[_Frame], problems: list[Problem]
) -> tuple[Captures, str | None]:
    """Let a table say more, or otherwise, than the telemetry; what counted where pitch came from, the table's name."""
    path = metadata or find_table(root)
    table = read_table(path) if path else None
    captures = Captures(table, problems)
    for f in frames:
        r = f.record
        own = Capture(r.pitch_deg, r.altitude_m, r.time_of_day)
        known = captures.of(r.name, f"{r.split}/{r.name}", own, r.sequence)
        f.record = replace(r, pitch_deg=known.pitch_deg, altitude_m=known.altitude_m, time_of_day=known.time_of_day)
    if table is not None:
        problems += table.problems
        unused = table.unused([f.record.name for f in frames], {f.record.sequence for f in frames})
        if unused:
            found = f"{len(unused)} row(s) of the table name no picture and no sequence: {', '.join(unused[:3])}"
            expected = "a picture or sequence for each row"
            problems.append(Problem(root.name, "table-unused", found, expected, severity="warning"))
    return captures, path.name if path else None


def _require_pitch(root: Path, frames: Sequence[_Frame], chosen: _Options, problems: Sequence[Problem]) -> None:
    """An error that names the keys there are, if no frame at all has a pitch: the key is another one, likely."""
    if any(f.record.pitch_deg is not None for f in frames):
        return
    keys = {k for f in frames[:1000] for k in _dotted(f.record.extra["fields"])}
    there = ", ".join(sorted(keys)[:40]) or "nothing more"
    found = f"no {' or '.join(chosen.pitch)} with a value; image records hold {there}"
    todo = "name it with --read pitch_key=KEY, or take the images without pitch with --read empty=keep"
    problem = Problem(str(root), "no-telemetry", found, "the gimbal's pitch in image records", todo)
    raise DatasetError(f"{root}: no telemetry in {len(frames)} image(s)", [problem, *few(problems)])


def _dotted(record: Mapping[str, Any], depth: int = 4) -> Iterator[str]:
    """The keys of a record and of objects inside it, as the options take them."""
    for key, value in record.items():
        if isinstance(value, dict) and value and depth:
            yield from (f"{key}.{inner}" for inner in _dotted(value, depth - 1))
        else:
            yield key


def _leave_out(
    frames: list[_Frame],
    sequences: Iterable[Any],
    option: Literal["exclude", "empty"],
    why: str,
    problems: list[Problem],
    root: Path,
) -> dict[str, Any]:
    """Take sequences (names, or pairs of split and name) out of `frames`; count them in the notes and as a warning."""
    wanted = set(sequences)
    out = [f for f in frames if f.sequence in wanted or (f.record.split, f.sequence) in wanted]
    frames[:] = [f for f in frames if not (f.sequence in wanted or (f.record.split, f.sequence) in wanted)]
    counts: dict[str, dict[str, Any]] = {}
    for f in out:
        entry = counts.setdefault(f"{f.record.split}/{f.sequence}", {"why": why, "images": 0, "labels": 0})
        entry["images"] += 1
        entry["labels"] += len(f.record.instances)
    if counts:
        images, labels = (sum(c[k] for c in counts.values()) for k in ("images", "labels"))
        found = (
            f"{len(counts)} sequence(s) left out, {why}: {', '.join(sorted(counts))} ({images} images, {labels} labels)"
        )
        todo = "keep them with --read empty=keep" if option == "empty" else ""
        problems.append(Problem(root.name, "sequence-excluded", found, todo=todo, severity="warning"))
    if option == "exclude" and (unknown := sorted(wanted - {f.sequence for f in out})):
        there = ", ".join(sorted({str(f.sequence) for f in frames})[:20])
        problems.append(
            Problem("option exclude", "option-value", f"no sequence {', '.join(unknown)}", f"some of {there}",
                    severity="warning")
        )  # fmt: skip
    return dict(sorted(counts.items()))


def _records(frames: Sequence[_Frame]) -> tuple[ImageRecord, ...]:
    """The records with ids: `<sequence>_<stem>` where that is unique."""
    plain: dict[str, str] = {}
    for f in frames:
        r = f.record
        name = PurePosixPath(r.name).name
        # Pictures that InfraBlend wrote bear the sequence in their names already.
        if f.sequence and not name.startswith(f"{f.sequence}_"):
            name = f"{f.sequence}_{name}"
        plain[f"{r.split}/{r.name}"] = f"{r.split}/{name}"
    clear = Counter(plain.values())
    keys = {full: short if clear[short] == 1 else full for full, short in plain.items()}
    ids = assign_ids(keys.values())
    return sort_images(replace(f.record, id=ids[keys[f"{f.record.split}/{f.record.name}"]]) for f in frames)


# -- writing ---------------------------------------------------------------------------------------------------


def write(
    out: Path,
    images: Iterable[ImageRecord],
    categories: Sequence[Category],
    *,
    ids: Literal["source", "new"] = "new",
    extra: Mapping[str, Any] | None = None,
    pictures: bool = True,
) -> Written:
    """Write `out/<split>/<sequence>.json` and pictures in `out/<split>/<sequence>/lwir/`, see `native_files`.

    Pictures are hard links of `ImageRecord.path` (copies where that is impossible).

    Args:
        out: Folder; made if need be.
        images: With `size_wh` known.
        categories: With the ids to write.
        ids: `new` numbers images and annotations from 1 over all files and writes the source's id as `source_id`;
            `source` writes the source's own.
        extra: Top-level fields `info` and `licenses`, e.g. `Dataset.extra`.
        pictures: False writes annotations alone.

    Raises:
        OutputError: A file cannot be written.
        ValueError: A size, category or id is missing, or two pictures would have one name.
    """
    ordered = sort_images(images)
    texts, losses = native_files(ordered, categories, ids=ids, extra=extra)
    files = [write_text(out / name, text) for name, text in texts.items()]
    for image in ordered if pictures else ():
        files.append(link_or_copy(image.path, out / image.split / _picture_name(image)))
    return Written(tuple(files), losses, tuple(_pitch_remarks(ordered)))


def native_files(
    images: Sequence[ImageRecord],
    categories: Sequence[Category],
    *,
    ids: Literal["source", "new"] = "new",
    extra: Mapping[str, Any] | None = None,
) -> tuple[dict[str, str], dict[str, int]]:
    """Text of every annotation file by POSIX path below the output folder, and the losses; see `write`.

    Image records carry what the source's did, with pitch and altitude where they stood there, else as `g_pitch` and
    `alt` in `metadata`. Annotations are as `coco.write` makes them: masks as run lengths, oriented boxes in `obb`.
    """
    ordered = sort_images(images)
    of_category = category_ids(categories)
    ignored = {c.name for c in categories if c.ignore}
    image_ids, object_ids = number_ids(ordered, ids, 1)
    new = ids == "new"
    losses: Counter[str] = Counter()
    # Without any pitch nothing would tell these files from a folder of bare pictures.
    unknown = all(i.pitch_deg is None for i in ordered)
    tops: dict[str, dict[str, Any]] = {}
    taken: set[tuple[str, str]] = set()
    for image, image_id, numbers in zip(ordered, image_ids, object_ids, strict=True):
        name = _picture_name(image)
        if (image.split, name) in taken:
            raise ValueError(f"{image.id}: a second picture would be {image.split}/{name}")
        taken.add((image.split, name))
        top = tops.setdefault(
            f"{image.split}/{_folder_name(image) or image.split}.json",
            {
                "info": (extra or {}).get("info", _INFO),
                "licenses": (extra or {}).get("licenses", []),
                "categories": coco.category_records(categories),
                "images": [],
                "annotations": [],
            },
        )
        record = _image_record(image, image_id, name, new, losses)
        if unknown:
            _put(record, (NEST, PITCH_KEYS[0]), None)
        top["images"].append(record)
        for instance, number in zip(image.instances, numbers, strict=True):
            a = coco.annotation_record(instance, require_size(image), new, "polygon", losses)
            a |= {"id": number, "image_id": image_id, "category_id": of_category[instance.category]}
            a["iscrowd"] |= int(instance.category in ignored)
            top["annotations"].append(a)
    texts = {
        name: json.dumps(_finite(top, losses), sort_keys=True, allow_nan=False, separators=(",", ":")) + "\n"
        for name, top in sorted(tops.items())
    }
    return texts, {k: v for k, v in sorted(losses.items()) if v}


def _pitch_remarks(images: Sequence[ImageRecord]) -> list[Problem]:
    """A warning for sequences without any pitch: the reader leaves them out unless it is told to keep them."""
    known: dict[tuple[str, str], bool] = {}
    for i in images:
        place = (i.split, _folder_name(i))
        known[place] = known.get(place, False) or i.pitch_deg is not None
    empty = sum(not k for k in known.values())
    if not empty:
        return []
    found, todo = f"{empty} sequence(s) without any camera pitch", "read it with --read empty=keep"
    return [Problem("monet", "telemetry-absent", found, "the pitch that makes a sequence usable", todo, "warning")]


def _folder_name(image: ImageRecord) -> str:
    """The sequence as a folder's name; empty if there is none."""
    name = (image.sequence or "").replace("/", "__").replace("\\", "__").strip()
    return "" if name in (".", "..") or _split_in([name]) else name


def _picture_name(image: ImageRecord) -> str:
    """Where a picture lies below its split's folder: `<sequence>/lwir/...`."""
    folder = _folder_name(image)
    parts = list(PurePosixPath(image.name).parts)
    for known in (folder, "lwir"):
        if len(parts) > 1 and parts[0] == known:
            parts.pop(0)
    return str(PurePosixPath(folder, "lwir", *parts))


def _image_record(image: ImageRecord, number: int, name: str, new: bool, losses: Counter[str]) -> dict[str, Any]:
    w, h = require_size(image)
    # A copy of the objects that are changed below.
    fields = {k: dict(v) if isinstance(v, dict) else v for k, v in image.extra.get("fields", {}).items()}
    places: Mapping[str, Any] = image.extra.get("telemetry", {})
    nest = next((p[:-1] for k in ("pitch", "altitude", "time") if (p := places.get(k))), (NEST,))
    if image.pitch_deg is not None:
        pitch = places.get("sign", -1) * image.pitch_deg + 0.0
        value = math.radians(pitch) if places.get("radians") else pitch
        _put(fields, places.get("pitch") or (*nest, PITCH_KEYS[0]), value)
    if image.altitude_m is not None:
        _put(fields, places.get("altitude") or (*nest, ALTITUDE_KEYS[0]), image.altitude_m)
    if image.captured is not None and not places.get("time"):
        _put(fields, (*nest, TIME_KEYS[0]), image.captured)
    if image.time_of_day is not None:
        fields["time_of_day"] = image.time_of_day
    record = {"id": number, "file_name": name, "width": w, "height": h}
    return fields | record | coco.source_id_field(image, new)


def _put(record: dict[str, Any], place: Place, value: Any) -> None:
    """Set a value, with objects on the way to it copied or made."""
    for key in place[:-1]:
        inside = record.get(key)
        record[key] = dict(inside) if isinstance(inside, dict) else {}
        record = record[key]
    record[place[-1]] = value


def _finite(value: Any, losses: Counter[str]) -> Any:
    """The value with numbers that JSON cannot hold (the source's telemetry may) as null, counted."""
    if isinstance(value, dict):
        return {k: _finite(v, losses) for k, v in value.items()}
    if isinstance(value, list):
        return [_finite(v, losses) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        losses["not_finite_dropped"] += 1
        return None
    return value
