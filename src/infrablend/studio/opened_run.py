"""A run that the studio has opened: checked, locked against a second studio, and read in the background."""

from __future__ import annotations

import fcntl
import logging
import os
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from infrablend.core.finished import require_finished
from infrablend.core.run_layout import SCENES
from infrablend.errors import DatasetError, OutputError
from infrablend.pipeline.folder import RunFolder
from infrablend.pipeline.review import REVIEW_FILE
from infrablend.studio.frame_index import FrameRow, read_rows
from infrablend.studio.pictures import Thumbnails
from infrablend.studio.verdicts import Review

log = logging.getLogger(__name__)


class OpenedRun:
    """A finished run and its review.

    Attributes:
        layout: Paths of the run.
        record: Record of the run.
        review: Verdicts on its frames.
        thumbnails: Small pictures of its frames.
    """

    def __init__(self, folder: Path) -> None:
        """Check and lock the run, and begin to read its frames.

        Raises:
            DatasetError: The run is being written, or has no frames.
            OutputError: The folder is not a run, its review is damaged, or another studio has it open.
        """
        self.layout = RunFolder(folder)
        self.record: Mapping[str, Any] = self.layout.read_run()
        require_finished(folder)
        if not self.layout.records():
            raise DatasetError(f"{folder}: a run without frames; expected at least one. Choose another run")
        self.review = Review(folder / REVIEW_FILE)
        self._lock = self._locked()
        self.thumbnails = Thumbnails(self.layout)
        self._rows: list[FrameRow] = []
        self._read = threading.Event()
        self._stamp = self._stamp_now()
        self._start()

    @property
    def rows(self) -> list[FrameRow]:
        """Rows of all frames, in the order of their ids; waits until they are read."""
        if self._read.is_set() and self._stamp != self._stamp_now():
            self._read.clear()  # frames were excluded or included meanwhile
            self._stamp = self._stamp_now()
            self._start()
        self._read.wait()
        return self._rows

    def row(self, number: int) -> FrameRow:
        """Return a row by its number.

        Raises:
            DatasetError: There is no such row.
        """
        rows = self.rows
        if not 0 <= number < len(rows):
            raise DatasetError(f"frame {number}: no such frame; the run has {len(rows)}")
        return rows[number]

    def close(self) -> None:
        """Release the run."""
        os.close(self._lock)

    def _start(self) -> None:
        threading.Thread(target=self._read_rows, name="studio-rows", daemon=True).start()

    def _read_rows(self) -> None:
        found: list[FrameRow] = []
        try:
            for some in read_rows(self.layout):
                found += some
        finally:
            self._rows = found
            self._read.set()

    def _stamp_now(self) -> int:
        try:
            return self.layout.run_file.stat().st_mtime_ns
        except OSError:
            return 0

    def _locked(self) -> int:
        """Lock the folder of the records: it leaves no file, and does not keep commands from writing the run."""
        folder = self.layout.root / SCENES
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(handle)
            raise OutputError(
                f"{self.layout.root}: open in another studio; expected one per run, since both would write its "
                f"{REVIEW_FILE}. Use the page of the other one, or close it with Ctrl-C in its terminal"
            ) from error
        except OSError as error:  # file systems without locks
            log.warning("%s: cannot be locked (%s); do not open it in two studios", folder, error)
        return handle
