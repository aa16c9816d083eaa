"""What writers of formats with a folder per sequence share: folders, numbers of frames and tracks, what they change."""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from infrablend.core.capture import FACTS, Capture
from infrablend.core.dataset import ImageRecord, Instance, Split
from infrablend.core.file_names import distinct_names, file_name
from infrablend.core.files import write_text
from infrablend.formats.capture import fits_table
from infrablend.formats.records import Findings
from infrablend.formats.values import csv_text, to_int

NAMES_FILE = "names.csv"
_NAMES_COLUMNS = ("file", "name", "sequence", "frame", "captured")
_TABLE_FACTS = tuple(name for name, fact in FACTS.items() if fact.field == "telemetry")
_UNNAMED = "pictures"


@dataclass(frozen=True)
class Place:
    """Where a picture goes: its split, the folder of its sequence, and its number in it, from 0."""

    split: Split
    sequence: str
    number: int

    @property
    def folder(self) -> str:
        """Folder of the sequence below the dataset's."""
        return f"{self.split}/{self.sequence}"


def places_of(images: Sequence[ImageRecord]) -> list[Place]:
    """Return the place of each image.

    Sequences keep their names as far as folders can have them. Pictures without a sequence form one, `pictures`. A
    sequence in which a picture has no number, or two have the same, is numbered in the order of the pictures' names.
    """
    groups: dict[tuple[Split, str | None], list[int]] = defaultdict(list)
    for n, image in enumerate(images):
        groups[image.split, image.capture.sequence].append(n)
    places: dict[int, Place] = {}
    for split in dict.fromkeys(split for split, _ in groups):
        # Names that can stay come first, so that no other gets theirs.
        own = sorted(
            (s for sp, s in groups if sp == split), key=lambda s: (s is None or file_name(s) != s, s is None, s or "")
        )
        folders = distinct_names([_UNNAMED if s is None else file_name(s) for s in own])
        for sequence, folder in zip(own, folders, strict=True):
            group = groups[split, sequence]
            frames = [f for n in group if (f := images[n].capture.frame) is not None]
            if len({*frames}) < len(group) or max(frames) >= 10**9:
                group, frames = sorted(group, key=lambda n: images[n].name), list(range(len(group)))
            places |= {n: Place(split, folder, f) for n, f in zip(group, frames, strict=True)}
    return [places[n] for n in range(len(images))]


def by_sequence(places: Sequence[Place]) -> dict[str, list[int]]:
    """Return the indices of the pictures of each sequence by its folder, in the order of their numbers."""
    groups: dict[str, list[int]] = defaultdict(list)
    for n in sorted(range(len(places)), key=lambda n: (places[n].folder, places[n].number)):
        groups[places[n].folder].append(n)
    return groups


def is_labelled(image: ImageRecord) -> bool:
    """Return whether the labels of a picture are known, even if there are none."""
    return bool(image.instances) or image.extra.get("labelled", True) is True


def write_names(
    out: Path, written: Iterable[tuple[ImageRecord, Place, str]], losses: Counter[str]
) -> Iterator[Path]:  # fmt: skip
    """Write `names.csv` with what `read_names` restores, and `metadata.csv` with pitch, altitude and the like.

    Args:
        out: Folder of the dataset.
        written: Each picture, its place, and its path below the folder.
        losses: Counts what changed, and what a table cannot hold.
    """
    renamed, known = [], []
    for image, place, path in written:
        capture = image.capture
        base = f"{place.sequence}/{path.rpartition('/')[2]}"
        losses["name_changed"] += base != image.name
        losses["sequence_made"] += capture.sequence is None or capture.frame != place.number
        said = (capture.sequence, capture.frame, capture.captured)
        if base != image.name or said != (place.sequence, place.number, None):
            renamed.append((path, image.name, *("" if v is None else v for v in said)))
        facts = {k: v for k, v in capture.to_json().items() if k in _TABLE_FACTS}
        losses["telemetry_dropped"] += not all(fits_table(*fact) for fact in facts.items())
        if facts:
            known.append((path, *(facts.get(k, "") if fits_table(k, facts.get(k)) else "" for k in _TABLE_FACTS)))
    if renamed:
        yield write_text(out / NAMES_FILE, csv_text(_NAMES_COLUMNS, renamed))
    if known:
        yield write_text(out / "metadata.csv", csv_text(("file", *_TABLE_FACTS), known))


def read_names(found: Findings) -> dict[str, Capture]:
    """Return sequence, frame and date by picture from `names.csv`, which our writers add if they changed them."""
    rows = [r for r in found.own_table(NAMES_FILE, _NAMES_COLUMNS)[1:] if len(r) == len(_NAMES_COLUMNS)]
    facts = ("sequence", "frame", "captured")
    return {
        file: Capture.from_json({k: v or None for k, v in zip(facts, values, strict=True)}, strict=False)
        for file, _, *values in rows
    }


# -- tracks ----------------------------------------------------------------------------------------------------


TrackKey = tuple[str, int | str]
"""Class and id of a track: objects of two classes are two objects."""


def plain_id(track: int | str) -> int | str:
    """Return the whole number that a text is, as `7` but not `07`, else the id as it is."""
    number = to_int(track)
    return number if isinstance(track, str) and number is not None and str(number) == track else track


def _key(instance: Instance) -> TrackKey | None:
    return None if instance.track_id is None else (instance.category, plain_id(instance.track_id))


class Tracks:
    """Ids of the tracks of one sequence: whole numbers of one class stay, others get the next free ones.

    Attributes:
        changed: The new numbers of tracks that could not keep their ids: texts, too small numbers, and numbers of
            several classes; in the order in which they appear.
    """

    def __init__(self, sequence: Iterable[ImageRecord], first: int) -> None:
        """Take the images of a sequence in order, and the smallest number that is allowed."""
        keys = dict.fromkeys(k for i in sequence for o in i.instances if (k := _key(o)))
        classes = Counter(track for _, track in keys)
        self._numbers: dict[TrackKey, int] = {
            k: k[1] for k in keys if isinstance(k[1], int) and k[1] >= first and classes[k[1]] == 1
        }
        # Above all ids that were given, as readers may restore those that change.
        self._free = itertools.count(max([first, *(t + 1 for _, t in keys if isinstance(t, int))]))
        self.changed: dict[TrackKey, int] = {k: next(self._free) for k in keys if k not in self._numbers}
        self._numbers |= self.changed

    def of(self, image: ImageRecord, losses: Counter[str]) -> list[tuple[int, TrackKey | None]]:
        """Return number and key of the track of each object of an image.

        Objects without a track, and the second one of a track in a picture, get a new number, and no key.
        """
        used: set[int] = set()
        tracks: list[tuple[int, TrackKey | None]] = []
        for o in image.instances:
            key = _key(o)
            if key is None or self._numbers[key] in used:
                losses["track_made"] += 1
                key, number = None, next(self._free)
            else:
                number = self._numbers[key]
            used.add(number)
            tracks.append((number, key))
        return tracks
