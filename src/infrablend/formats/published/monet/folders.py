"""Where MONET's pictures and annotations are, which annotations to read, and what folders state: split and sequence."""

from __future__ import annotations

import os
import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path, PurePosixPath
from typing import TypeVar, get_args

from infrablend.core.capture import TimeOfDay
from infrablend.core.dataset import SPLITS, Split
from infrablend.core.file_names import leaves_folder, real_path
from infrablend.errors import DatasetError, Problem
from infrablend.formats.base import SPLIT_FOLDERS, Match
from infrablend.formats.pictures.listing import PictureFolder, is_hidden, list_pictures

_NUMBERED = re.compile(r"[A-Za-z]+_\d+")
_SAMPLE = 50


class Pictures:
    """All pictures of the dataset, and the folder to which each annotation file's picture names are relative."""

    def __init__(self, root: Path) -> None:
        self.by_path = list_pictures(root, SKIPPED_FOLDERS)
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
        """Return a picture's name in an annotation file as path below the dataset's folder."""
        parts = PurePosixPath(name).parts[strip:]
        return str(PurePosixPath(base, *parts)) if parts else name

    def locate(self, names: Sequence[str], where: str) -> tuple[str, int] | Problem:
        """Find the folder to which an annotation file's names are relative.

        A folder that shares parts with the file's path (`runway_04.json`, `runway_04/...`) is preferred over one
        in which more pictures happen to have the same names.

        Returns:
            The folder, and the number of leading folders to remove from the names first; or why it is ambiguous.
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
        found = f"pictures with its names ({names[0]}, ...) exist in {', '.join(c[0] or '.' for c in top[:4])}"
        return Problem(
            where, "pictures-ambiguous", found, "one folder", "name the folder, e.g. --read pictures={stem}/lwir"
        )

    def given(self, pattern: str, names: Sequence[str], where: str) -> tuple[str, int]:
        """Do the same as `locate` for the folder given by the option `pictures`."""
        path = PurePosixPath(where)
        base = pattern.replace("{stem}", path.stem).replace("{folder}", str(path.parent))
        base = str(PurePosixPath(base))
        deepest = max((len(PurePosixPath(n).parts) for n in names[:_SAMPLE]), default=1)
        counts = {
            strip: sum(self.resolve(n, base, strip) in self.by_path for n in names[:_SAMPLE])
            for strip in range(deepest)
        }
        return base, max(counts, key=lambda strip: (counts[strip], -strip))


def split_in(parts: Sequence[str]) -> Split | None:
    """Return the split after which a folder is named, such as `val` or `monet_val`."""
    for part in parts:
        name = part.lower().removeprefix("monet").lstrip("_-")
        if name in SPLIT_FOLDERS:
            return SPLIT_FOLDERS[name]
    return None


def split_in_stem(stem: str) -> Split | None:
    """Return the first split among the words of a file's stem, such as `instances_val2017`."""
    words = [w.rstrip("0123456789") for w in re.split(r"[^a-z0-9]+", stem.lower())]
    return next((SPLIT_FOLDERS[w] for w in words if w in SPLIT_FOLDERS), None)


def sequence_of(path: str, stem: str, root_name: str) -> str | None:
    """Return the sequence of a picture: the folder around `lwir`, else its folder, else the annotation file's name.

    The dataset's own folder is used if it is named like one of MONET's sequences: someone may have only that one.
    """
    folders = PurePosixPath(path).parent.parts
    if "lwir" in folders:
        folders = folders[: folders.index("lwir")]
        own = folders[-1] if folders else ""
    else:
        own = next((f for f in reversed(folders) if f not in ("images", ".")), "")
    if own and split_in([own]) is None:
        return own
    if SEQUENCE.fullmatch(root_name):
        return root_name
    return stem if _NUMBERED.fullmatch(stem) and split_in_stem(stem) is None else None


def below_split(path: str) -> str:
    """Return the path of a picture below its split's folder."""
    parts = PurePosixPath(path).parts
    at = next((k for k, p in enumerate(parts[:-1]) if split_in([p]) is not None), -1)
    return "/".join(parts[at + 1 :])


T = TypeVar("T")
OPTIONS = {
    "pitch_sign": "-1 if negative pitch looks down, +1 if positive does; default: as most frames look down",
    "pitch_key": "key of the gimbal pitch in an image record, dotted for nested objects, e.g. metadata.g_pitch",
    "altitude_key": "key of the altitude in metres, likewise",
    "time_key": "key of the time of capture, likewise",
    "angle_unit": "unit of the pitch: deg (default) or rad",
    "time_of_day": "time of day of every image: day, dusk, night or dawn",
    "exclude": "sequences to leave out: a,b,c",
    "empty": "sequences without any pitch: exclude (default) or keep",
    "split": "split of every image: train, val or test; taken from folder and file names by default",
    "annotations": "pattern of the annotation files, relative to the folder, e.g. annotations/*.json",
    "pictures": "folder of an annotation file's pictures, relative to the dataset's folder, e.g. {stem}/lwir",
}
# g_pitch and alt appear in a figure of the authors; the others are guesses that cost nothing.
PITCH_KEYS = ("g_pitch", "gimbal_pitch")
ALTITUDE_KEYS = ("alt", "altitude")
TIME_KEYS = ("timestamp", "time_stamp", "time", "date_captured")


@dataclass(frozen=True)
class MonetOptions:
    """Options of MONET's reader, checked.

    Attributes:
        sign: -1 if negative pitch looks down, 1 if positive does; None decides by majority.
        pitch: Keys to try for the gimbal pitch; a dot leads into a nested object.
        altitude: Keys to try for the altitude.
        time: Keys to try for the time of capture.
        radians: Whether the pitch is in radians.
        time_of_day: Time of day of every image, if it is known.
        exclude: Sequences to leave out.
        keep_empty: Whether sequences without any pitch are kept.
        split: Split of every image; None takes it from folder and file names.
        annotations: Pattern of the annotation files; None searches for them.
        pictures: Folder of an annotation file's pictures; None searches for it.
    """

    sign: int | None
    pitch: Sequence[str]
    altitude: Sequence[str]
    time: Sequence[str]
    radians: bool
    time_of_day: TimeOfDay | None
    exclude: tuple[str, ...]
    keep_empty: bool
    split: Split | None
    annotations: str | None
    pictures: str | None


def check_options(root: Path, options: Mapping[str, str | None]) -> MonetOptions:
    """Return the options as values.

    Raises:
        TypeError: An option does not exist.
        DatasetError: At least one value is not allowed; all such values are listed.
    """
    if unknown := sorted(set(options) - set(OPTIONS)):
        raise TypeError(f"options {', '.join(unknown)}: expected some of {', '.join(OPTIONS)}")
    problems: list[Problem] = []

    def choose(name: str, choices: Mapping[str, T]) -> T | None:
        text = options.get(name)
        if text is None or text in choices:
            return None if text is None else choices[text]
        problems.append(Problem(f"option {name}", "option-value", repr(text), f"one of {', '.join(choices)}"))
        return None

    def keys(name: str, otherwise: Sequence[str]) -> Sequence[str]:
        text = options.get(name)
        if text is not None and not all(text.split(".")):
            problems.append(Problem(f"option {name}", "option-value", repr(text), "a key, or several joined by dots"))
        return otherwise if text is None else (text,)

    times: Mapping[str, TimeOfDay] = {time: time for time in get_args(TimeOfDay)}
    splits: Mapping[str, Split] = {s: s for s in SPLITS}
    excluded = (options.get("exclude") or "").split(",")
    chosen = MonetOptions(
        sign=choose("pitch_sign", {"-1": -1, "+1": 1, "1": 1}),
        radians=choose("angle_unit", {"deg": False, "rad": True}) or False,
        time_of_day=choose("time_of_day", times),
        keep_empty=choose("empty", {"exclude": False, "keep": True}) or False,
        split=choose("split", splits),
        pitch=keys("pitch_key", PITCH_KEYS),
        altitude=keys("altitude_key", ALTITUDE_KEYS),
        time=keys("time_key", TIME_KEYS),
        exclude=tuple(sorted({s.strip() for s in excluded if s.strip()})),
        annotations=options.get("annotations"),
        pictures=options.get("pictures"),
    )
    if problems:
        raise DatasetError(f"{root}: options with unusable values", problems)
    return chosen


NAME = "monet"
# Not annotations: tables of pictures, and records of InfraBlend.
_NO_ANNOTATIONS = (
    "metadata.json",
    "world.json",
    "run.json",
    "package.json",
    "convert.json",
    "split.json",
    "SOURCE.json",
)
SKIPPED_FOLDERS = ("coco", "native", "scenes", "log")
_JSON_DEPTH = 4
SEQUENCE = re.compile(r"(?:runway|dirtroad)_\d+")


def find_files(root: Path, pattern: str | None = None) -> list[Path]:
    """Return the JSON files that may contain annotations, sorted: up to four levels down, or matching a pattern."""
    found: list[Path] = []
    for base, folders, names in os.walk(root):
        here = Path(base)
        depth = len(here.relative_to(root).parts)
        folders[:] = sorted(
            d for d in folders if not is_hidden(d) and depth < _JSON_DEPTH and (d not in SKIPPED_FOLDERS or pattern)
        )
        # No pipes or devices: opening them would block.
        files = [here / n for n in names if n.lower().endswith(".json") and not is_hidden(n) and (here / n).is_file()]
        if pattern is None:
            found += [p for p in files if p.name not in _NO_ANNOTATIONS]
        else:
            found += [p for p in files if fnmatch(p.relative_to(root).as_posix(), pattern)]
    return sorted(found)


def detect(root: Path) -> Match:
    """Decide whether `root` is MONET: its JSON contains a gimbal pitch, or its folders are named like sequences."""
    files = find_files(root)
    if not files:
        return Match(NAME, False, "no JSON file in the folder or up to four levels below")
    for path in files:
        key = _pitch_key_in(path)
        if key is not None:
            return Match(NAME, True, f"{path.relative_to(root).as_posix()} contains {key!r}")
    for base, folders, _ in os.walk(root):
        depth = len(Path(base).relative_to(root).parts)
        # Our writers of COCO and others keep sequence folders below `images`.
        folders[:] = sorted(d for d in folders if not is_hidden(d) and d != "images" and depth < _JSON_DEPTH)
        named = next((d for d in (real_path(Path(base)).name, *folders) if SEQUENCE.fullmatch(d)), None)
        if named is not None:
            return Match(NAME, True, f"JSON files and a sequence folder {named}")
    return Match(NAME, False, f"no JSON file contains {' or '.join(PITCH_KEYS)}, no folder runway_NN or dirtroad_NN")


def _pitch_key_in(path: Path) -> str | None:
    """Return the pitch key that a file contains as text, found without parsing it."""
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
