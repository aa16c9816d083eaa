"""Runs that the studio has opened: checked, read in the background, and reviewed.

A page can show the frames by name at once, and any single one, long before the last record is read.
"""

from __future__ import annotations

import logging
import threading
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from infrablend.core.frame_row import FrameRow
from infrablend.core.run_folder import TRACKS, RunFolder
from infrablend.detection.detections import RECORD
from infrablend.errors import DatasetError, InfraBlendError, OutputError
from infrablend.formats.labels.mot import ASSUMED_RATE
from infrablend.pipeline.runs.review_file import REVIEW_FILE
from infrablend.report.preview import draw_labels, to_8_bit, to_rgb
from infrablend.studio.page_pictures import Thumbnails, enlarged, read_pixels, to_png, with_originals
from infrablend.studio.run_labels import Box, Place, RunLabels
from infrablend.studio.verdicts import Review

if TYPE_CHECKING:
    from infrablend.studio.run_labels import Disagreement

log = logging.getLogger(__name__)

_PAUSE_EVERY = 50
_PAUSE_S = 0.001
# Reading takes a core for a second per 4,000 records; the first page comes first, unless it needs them.
_FEW = 500
_START_S = 1.5


class RowReading:
    """The rows of a run, read once by a thread.

    Attributes:
        ids: Ids of all frames, in the order of the rows.
        count: Number of rows that are read.
    """

    def __init__(self, layout: RunFolder) -> None:
        """List the frames, and begin to read them."""
        self._layout = layout
        try:
            with layout.ledger() as ledger:
                self.ids: list[str] = ledger.frame_ids()
        except OutputError as error:  # removed, or written again meanwhile
            log.warning("%s", error)
            self.ids = []
        self._rows: list[FrameRow | None] = [None] * len(self.ids)
        self.count = 0
        self._needed = threading.Event()
        self._read = threading.Event()
        threading.Thread(target=self._run, name="studio-rows", daemon=True).start()

    @property
    def is_complete(self) -> bool:
        """Whether all rows are read."""
        return self._read.is_set()

    @cached_property
    def names(self) -> list[FrameRow]:
        """Rows with nothing but the ids, to show until the others are read."""
        return [FrameRow(frame_id) for frame_id in self.ids]

    def wait(self) -> list[FrameRow]:
        """Return all rows, once they are read."""
        self._needed.set()
        self._read.wait()
        return [row or name for row, name in zip(self._rows, self.names, strict=True)]

    def row(self, number: int) -> FrameRow:
        """Return one row, read now if the thread has not come to it yet."""
        if (row := self._rows[number]) is not None:
            return row
        with self._layout.ledger() as ledger:
            return ledger.row(self.ids[number])

    def _run(self) -> None:
        try:
            if len(self.ids) > _FEW:
                self._needed.wait(_START_S)
            with self._layout.ledger() as ledger:
                for number, frame_id in enumerate(self.ids):
                    self._rows[number] = ledger.row(frame_id)
                    self.count += 1
                    if self.count % _PAUSE_EVERY == 0:
                        self._read.wait(_PAUSE_S)  # requests of pages come first
        except (OutputError, KeyError) as error:
            log.warning("%s: the records of the frames cannot be read (%s)", self._layout.root, error)
        self._read.set()


@dataclass(frozen=True)
class RunTrack:
    """An object through a sequence; objects of a class that have no ids share one track.

    Attributes:
        category: Class.
        id: Id in the sequence; empty for objects without one.
        inserted: Whether the run inserted it.
        boxes: Position of a frame in the sequence, from 0, and box in it, pixels; in the order of the positions.
    """

    category: str
    id: str
    inserted: bool
    boxes: tuple[tuple[int, Box], ...]


@dataclass(frozen=True)
class RunSequence:
    """A sequence of a run.

    Attributes:
        name: `<split>/<sequence>`.
        frames: Numbers of the rows of its frames, in order.
        times_s: Seconds of the frames since the first.
        tracks: Inserted tracks, then original ones.
    """

    name: str
    frames: tuple[int, ...]
    times_s: tuple[float, ...]
    tracks: tuple[RunTrack, ...]


def find_sequences(rows: Sequence[FrameRow], labels: RunLabels) -> list[RunSequence]:
    """Return the sequences of the frames of a run, by name; frames outside of sequences are left out."""
    groups: dict[str, list[tuple[Place, int]]] = defaultdict(list)
    for number, row in enumerate(rows):
        if (place := labels.place(row.image)) is not None:
            groups[place.sequence].append((place, number))
    found = []
    for name, group in sorted(groups.items()):
        group.sort(key=lambda one: (one[0].frame, one[1]))
        numbers = tuple(number for _, number in group)
        images = [rows[number].image for number in numbers]
        found.append(RunSequence(name, numbers, _seconds([place for place, _ in group]), _tracks(images, labels)))
    return found


def _seconds(places: Sequence[Place]) -> tuple[float, ...]:
    times = [place.time_s for place in places if place.time_s is not None]
    if len(times) < len(places) or any(b <= a for a, b in pairwise(times)):
        times = [place.frame / ASSUMED_RATE for place in places]
    return tuple(round(t - times[0], 6) for t in times)


def _tracks(images: Sequence[str], labels: RunLabels) -> tuple[RunTrack, ...]:
    boxes: dict[tuple[bool, str, str], list[tuple[int, Box]]] = defaultdict(list)
    for at, image in enumerate(images):
        for label in labels.of(image):
            if not label.ignore:
                boxes[not label.inserted, label.category, label.track].append((at, label.box_xyxy))
    ordered = sorted(boxes.items(), key=lambda one: (one[0][:2], len(one[0][2]), one[0][2]))
    return tuple(RunTrack(category, track, not original, tuple(b)) for (original, category, track), b in ordered)


_ZOOM = 4  # of crops


class RunFrames:
    """The frames of a finished run.

    Attributes:
        layout: Paths of the run.
        record: Record of the run.
        thumbnails: Small pictures of its frames.
        labels: Labels of its frames.
    """

    _sequences: list[RunSequence] | None

    def __init__(self, folder: Path) -> None:
        """Check the run, and begin to read its frames.

        Raises:
            DatasetError: The run has no frames.
            OutputError: The folder is not a finished run.
        """
        self.layout = RunFolder(folder)
        with self.layout.ledger() as ledger:
            self.record = ledger.read_run()
            if not ledger.frame_ids():
                raise DatasetError(f"{folder}: a run without frames; expected at least one. Choose another run")
        self.thumbnails = Thumbnails(self.layout)
        self._guard = threading.Lock()
        self._begin()

    @property
    def reading(self) -> RowReading:
        """Rows of the frames, as far as they are read; read again after frames were excluded or included."""
        with self._guard:
            if self._stamp != self._stamp_now():
                self._begin()
            return self._reading

    @property
    def rows(self) -> list[FrameRow]:
        """Rows of all frames, in the order of their ids; waits until they are read."""
        return self.reading.wait()

    @property
    def has_sequences(self) -> bool:
        """Whether its objects move through sequences."""
        return (self.layout.root / TRACKS).is_dir()

    @property
    def sequences(self) -> list[RunSequence]:
        """Its sequences, by name; waits until all records are read."""
        rows = self.rows
        with self._guard:
            if self._sequences is None:
                self._sequences = find_sequences(rows, self.labels)
            return self._sequences

    def row(self, number: int) -> FrameRow:
        """Return a row by its number, without waiting for the others.

        Raises:
            DatasetError: There is no such row.
        """
        reading = self.reading
        if not reading.ids:
            raise DatasetError(
                f"{self.layout.root}: its frames are gone; expected the run that was opened. If it was removed or is "
                "being written again, open it again when it is finished"
            )
        if not 0 <= number < len(reading.ids):
            raise DatasetError(f"frame {number}: no such frame; the run has {len(reading.ids)}")
        return reading.row(number)

    def picture(self, number: int, *, boxes: bool, originals: bool) -> bytes:
        """Return the PNG of a frame, with the labels of its inserts and of its original objects if they are asked for.

        Raises:
            DatasetError: There is no such frame, or its picture cannot be read.
            OutputError: Its record cannot be read.
        """
        row = self.row(number)
        pixels = read_pixels(self.layout, row)
        if not (boxes or originals):
            return to_png(to_8_bit(pixels))
        rgb = to_rgb(pixels)
        if originals:
            rgb = with_originals(rgb, [o.box_xyxy for o in self.labels.of(row.image) if not o.inserted])
        return to_png(draw_labels(rgb, self.layout.record(row.id).inserted) if boxes else rgb)

    def crop(self, number: int, insert: int) -> bytes:
        """Return the PNG of an insert of a frame, enlarged without smoothing.

        Raises:
            DatasetError: There is no such frame or insert, or its picture cannot be read.
        """
        row = self.row(number)
        if not 0 <= insert < len(row.inserts):
            raise DatasetError(f"{row.id}: no insert {insert}; the frame has {len(row.inserts)}")
        return to_png(enlarged(to_rgb(read_pixels(self.layout, row)), row.inserts[insert].box_xyxy, _ZOOM))

    def _begin(self) -> None:
        self._stamp = self._stamp_now()
        self.labels = RunLabels(self.layout)
        self._sequences = None
        self._reading = RowReading(self.layout)

    def _stamp_now(self) -> int:
        try:
            return self.layout.run_file.stat().st_mtime_ns
        except OSError:
            return 0


class OpenedRun(RunFrames):
    """A run to review.

    Attributes:
        review: Verdicts on its frames.
        evaluation: Folder of an evaluation of the run; None if there is none.
        disagreement: Disagreement of its detector by image; empty until it is read.
    """

    def __init__(self, folder: Path, results: Sequence[Path] = ()) -> None:
        """Check the run, and begin to read its frames.

        Args:
            folder: Folder of the run.
            results: Further folders of reports on it.

        Raises:
            DatasetError: The run has no frames.
            OutputError: The folder is not a finished run, or its review is damaged.
        """
        super().__init__(folder)
        self.review = Review(folder / REVIEW_FILE)
        reports = (path for path in (*inner_folders(folder), *results) if (path / RECORD).is_file())
        self.evaluation = next(reports, None)
        self.disagreement: Mapping[str, Disagreement] = {}
        if self.evaluation is not None:
            arguments = (self.evaluation,)
            threading.Thread(target=self._read, args=arguments, name="studio-evaluation", daemon=True).start()

    def _read(self, evaluation: Path) -> None:
        from infrablend.studio.run_labels import read_disagreement  # loads slowly, and few runs need it

        try:
            images = [row.image for row in self.rows if row.image]
            self.disagreement = read_disagreement(evaluation, self.labels, images)
        except InfraBlendError as error:
            log.warning("%s", error)


def inner_folders(run: Path) -> list[Path]:
    """Return the folders in that of a run that are no links, by name."""
    return [path for path in sorted(run.iterdir()) if path.is_dir() and not path.is_symlink()]
