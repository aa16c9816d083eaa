"""Reads the rows of a run's frames from its ledger in the background.

A page can show the frames by name at once, and any single one, long before the last record is read.
"""

from __future__ import annotations

import logging
import threading
from functools import cached_property

from infrablend.core.frame_row import FrameRow
from infrablend.core.run_folder import RunFolder
from infrablend.errors import OutputError

_PAUSE_EVERY = 50
_PAUSE_S = 0.001
# Reading takes a core for a second per 4,000 records; the first page comes first, unless it needs them.
_FEW = 500
_START_S = 1.5

log = logging.getLogger(__name__)


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
