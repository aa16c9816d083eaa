"""Write formats with a folder per sequence: folders, numbers of frames and tracks, and what they change."""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from pathlib import Path
from statistics import median_low
from typing import Any, Protocol

from infrablend.core.capture import FACTS, Capture
from infrablend.core.dataset import Category, ImageRecord, Instance, Split
from infrablend.core.file_names import distinct_names, file_name
from infrablend.core.files import link_or_copy, write_chunks
from infrablend.errors import Problem
from infrablend.formats.base import in_order, require_known
from infrablend.formats.losses import Losses, Written, count_dropped
from infrablend.formats.picture_facts import fits_table
from infrablend.formats.records import Findings
from infrablend.formats.values import csv_text, plain_id

NAMES_FILE = "names.csv"
NAMES_COLUMNS = ("file", "name", "sequence", "frame", "captured", "time_s")
_NAMES_FACTS = NAMES_COLUMNS[2:]
_TABLE_FACTS = tuple(name for name, fact in FACTS.items() if fact.field == "telemetry")
_POSITION = ("latitude_deg", "longitude_deg", "yaw_deg")
_UNNAMED = "pictures"
PathOf = Callable[[ImageRecord, "Place"], str]
"""Returns the path of a picture below the dataset's folder."""
Row = Callable[[int, int, Instance], str]
"""Returns the row of an object from the number of its picture, that of its track, and the object."""
# Time stamps are kept to this.
_MICROSECOND = 1e-6
# Steps between pictures are equal if they differ by at most this: some containers count milliseconds.
_SAME_S = 2e-3


@dataclass(frozen=True, slots=True)
class Place:
    """Where a picture goes: its split, the folder of its sequence, and its number in it, from 0."""

    split: Split
    sequence: str
    number: int

    @property
    def folder(self) -> str:
        """Folder of the sequence below the dataset's."""
        return f"{self.split}/{self.sequence}"

    @property
    def capture(self) -> Capture:
        """What a reader finds out from the place alone."""
        return Capture(sequence=self.sequence, frame=self.number)


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


@dataclass(frozen=True)
class Frames:
    """The pictures of a sequence in order; each is fetched when it is asked for, as a dataset may be stored on disk."""

    images: Sequence[ImageRecord]
    chosen: Sequence[int]

    def __len__(self) -> int:
        """Return the number of pictures."""
        return len(self.chosen)

    def __getitem__(self, index: int) -> ImageRecord:
        """Return one picture."""
        return self.images[self.chosen[index]]

    def __iter__(self) -> Iterator[ImageRecord]:
        """Yield the pictures."""
        return (self.images[n] for n in self.chosen)


def is_labelled(image: ImageRecord) -> bool:
    """Return whether the labels of a picture are known, even if there are none."""
    return bool(image.instances) or image.extra.get("labelled", True) is True


class SequenceWriter:
    """Writes a dataset with a folder per sequence: a format adds the files of each sequence, and the rows in them.

    Attributes:
        out: Folder of the dataset.
        images: The pictures, in the order of all writers.
        places: The place of each.
        known: Names of the categories.
        lacks: Fields of an object that the format does not hold, see `losses.count_dropped`.
        losses: Counts what changed, and what is lost.
        problems: Warnings.
        files: The files that were written.
    """

    def __init__(
        self,
        out: Path,
        images: Iterable[ImageRecord],
        categories: Sequence[Category],
        lacks: Sequence[str] = (),
        find_places: Callable[[Sequence[ImageRecord]], list[Place]] = places_of,
    ) -> None:
        self.out = out
        self.images = in_order(images)
        self.places = find_places(self.images)
        self.known = {c.name for c in categories}
        self.lacks = lacks
        self.losses = Losses()
        self.problems: list[Problem] = []
        self.files: list[Path] = []

    def sequences(self) -> Iterator[tuple[str, Frames, list[int]]]:
        """Yield the folder, the pictures and their numbers of each sequence.

        Raises:
            ValueError: A picture shows an object whose category is not in the list.
        """
        for folder, chosen in by_sequence(self.places).items():
            numbers = [self.places[n].number for n in chosen]
            frames = Frames(self.images, chosen)
            for image, number in zip(frames, numbers, strict=True):
                require_known(image, self.known)
                capture = image.capture
                self.losses["sequence_made"] += capture.sequence is None or capture.frame != number
            yield folder, frames, numbers

    def rows(self, frames: Iterable[ImageRecord], numbers: Iterable[int], tracks: Numbering, row: Row) -> Iterator[str]:
        """Yield the rows of a sequence's objects, picture by picture."""
        for image, number in zip(frames, numbers, strict=True):
            for o, (track, key) in zip(image.instances, tracks.of(image, self.losses), strict=True):
                count_dropped(o, self.losses, *self.lacks)
                self.losses["track_renumbered"] += key in tracks.changed
                yield row(number, track, o)

    def text(self, name: str, chunks: Iterable[str]) -> None:
        """Write a text that comes in pieces, by its path below the folder."""
        self.files.append(write_chunks(self.out / name, chunks))

    def table(self, name: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
        """Write a table in CSV, unless it has no rows."""
        lines = (csv_text(row, ()) for row in rows)
        first = next(lines, None)
        if first is not None:
            self.text(name, chain([csv_text(columns, ()), first], lines))

    def pictures(
        self,
        path_of: PathOf,
        link: bool,
        *,
        find_out: Callable[[Place], Capture] = lambda place: place.capture,
        within: str = "",
        facts: Sequence[str] = _TABLE_FACTS,
    ) -> None:
        """Link the pictures; write `names.csv` with what `with_names` restores, and `metadata.csv` with the facts.

        Args:
            path_of: Returns the path of a picture below the folder.
            link: Whether to link the pictures.
            find_out: Returns what a reader finds out of a picture without the tables.
            within: Folder that a reader puts into the names of pictures.
            facts: Columns of `metadata.csv`.
        """

        def pictures() -> Iterator[tuple[ImageRecord, Place, str]]:
            for image, place in zip(self.images, self.places, strict=True):
                yield image, place, path_of(image, place)

        def name_rows() -> Iterator[Sequence[object]]:
            for image, place, path in pictures():
                if _is_unsaid(image, _base(place, within, path), find_out(place)):
                    said = (getattr(image.capture, k) for k in _NAMES_FACTS)
                    yield path, image.name, *("" if v is None else v for v in said)

        def fact_rows() -> Iterator[Sequence[object]]:
            for image, _, path in pictures():
                known = image.capture.to_json()
                if not known.keys().isdisjoint(facts):
                    fitting = {k: known[k] for k in facts if k in known and fits_table(k, known[k])}
                    self.losses["telemetry_dropped"] += len(fitting) < sum(k in known for k in facts)
                    yield path, *(fitting.get(k, "") for k in facts)

        # Tables without a position have the columns that they always had.
        facts = [f for f in facts if f not in _POSITION or any(getattr(i.capture, f) is not None for i in self.images)]
        for image, place, path in pictures():
            if link:
                self.files.append(link_or_copy(image.path, self.out / path))
            self.losses["name_changed"] += _base(place, within, path) != image.name
        self.table(NAMES_FILE, NAMES_COLUMNS, name_rows())
        self.table("metadata.csv", ("file", *facts), fact_rows())

    def written(self) -> Written:
        """Return the result."""
        return Written.of(self.files, self.losses, self.problems)


def _base(place: Place, within: str, path: str) -> str:
    """Return the name that a reader gives a picture: the folder of its sequence, and that of the file."""
    return f"{place.sequence}/{within}{path.rpartition('/')[2]}"


def _is_unsaid(image: ImageRecord, name: str, found_out: Capture) -> bool:
    """Return whether `names.csv` has to list a picture: a reader would find out another name, or other facts."""
    known = replace(found_out, time_s=None) if image.capture.time_s is None else found_out
    return name != image.name or any(getattr(image.capture, k) != getattr(known, k) for k in _NAMES_FACTS)


def with_names(found: Findings, records: Iterable[ImageRecord]) -> list[ImageRecord]:
    """Return the records with what `names.csv` says of them, which our writers add where files cannot say it."""
    titles, *rows = found.own_table(NAMES_FILE, NAMES_COLUMNS) or [[]]
    said: dict[str, dict[str, Any]] = {}
    for cells in rows if tuple(titles[:2]) == NAMES_COLUMNS[:2] else ():
        if len(cells) == len(titles):
            row = {k: v or None for k, v in zip(titles, cells, strict=True)}
            facts = Capture.from_json({k: row.get(k) for k in _NAMES_FACTS}, strict=False)
            # A time that it does not state follows from the rate, which somebody may have corrected.
            said[cells[0]] = {k: getattr(facts, k) for k in _NAMES_FACTS if row.get(k) or (k in row and k != "time_s")}
    # Frames of videos are elsewhere.
    places = ((r, found.place(r.path) if r.path.is_relative_to(found.folder) else "") for r in records)
    return [replace(r, capture=replace(r.capture, **said.get(place, {}))) for r, place in places]


# -- times -----------------------------------------------------------------------------------------------------


def second_of(number: int, rate: float | None) -> float | None:
    """Return the second of a picture by its number from 0 and the rate of its sequence; None if that is unknown."""
    if rate is None or rate <= 0:
        return None
    return Capture.from_json({"time_s": round(number / rate, 6)}, strict=False).time_s


def rate_of(times_s: Iterable[float | None], numbers: Iterable[int], stated: float | None) -> tuple[float | None, str]:
    """Return the pictures per second of a sequence, and how its steps vary, in words.

    The rate is that of the median step between pictures whose times are known, in as few digits as these need. Without
    such steps, and where it agrees with them, it is the one that was stated.
    """
    known = [(n, t) for n, t in zip(numbers, times_s, strict=True) if t is not None]
    steps = [((b - a) / (n - m), n - m) for (m, a), (n, b) in pairwise(known) if b > a]
    if not steps:
        return stated, ""
    median = median_low(s for s, _ in steps)
    usual = [(s, n) for s, n in steps if n * abs(s - median) <= _SAME_S]
    step = sum(s * n for s, n in usual) / sum(n for _, n in usual)
    shortest = min(steps)[0]
    longest = max(steps)[0]
    varies = "" if len(usual) == len(steps) else f"{shortest:.6g} to {longest:.6g} s from one number to the next"
    rates = [r for r in (stated, *(float(f"{1 / step:.{digits}g}") for digits in range(2, 17))) if r]
    near = [r for r in rates if abs(1 / r - step) <= _MICROSECOND]
    return next((r for r in near if all(second_of(n, r) == t for n, t in known)), near[0]), varies


# -- tracks ----------------------------------------------------------------------------------------------------


TrackKey = tuple[str, int | str]
"""Class and id of a track: objects of two classes are two objects."""


def _key(instance: Instance) -> TrackKey | None:
    return None if instance.track_id is None else (instance.category, plain_id(instance.track_id))


class Numbering(Protocol):
    """Numbers of the tracks of one sequence."""

    @property
    def changed(self) -> Container[object]:
        """Return the keys of the tracks that could not keep their ids."""

    def of(self, image: ImageRecord, losses: Counter[str]) -> Sequence[tuple[int, object]]:
        """Return number and key of the track of each object of an image."""


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
                key = None
                number = next(self._free)
            else:
                number = self._numbers[key]
            used.add(number)
            tracks.append((number, key))
        return tracks
