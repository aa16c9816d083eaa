"""Verdicts on the frames of a run: every one is in `review.json` before the page shows it, and can be undone."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from infrablend.pipeline.runs.review_file import Verdict, read_verdicts, write_verdicts

REASONS = ("too bright", "too dark", "too sharp or blurred", "wrong size", "wrong place", "barely visible")
"""Usual reasons to reject a frame, offered by number."""


class Review:
    """The verdicts of a run's `review.json`.

    Attributes:
        path: The file.
    """

    def __init__(self, path: Path) -> None:
        """Read the file if it exists.

        Raises:
            OutputError: It cannot be read.
        """
        self.path = path
        self._steps: list[tuple[str, Verdict | None, Verdict | None]] = []
        self._verdicts: dict[str, Verdict] = {}
        self._state: tuple[int, int, int] | None = None
        self._read()

    @property
    def words(self) -> Mapping[str, str]:
        """`accept` or `reject` by frame id."""
        self._follow()
        return {frame_id: verdict.word for frame_id, verdict in self._verdicts.items()}

    def of(self, frame_id: str) -> Verdict | None:
        """Return the verdict on a frame, or None."""
        self._follow()
        return self._verdicts.get(frame_id)

    def decide(self, frame_id: str, verdict: Verdict | None) -> None:
        """Write a verdict on a frame; None withdraws it. When this returns, the file has it.

        Raises:
            OutputError: The file cannot be written; the verdict is then not taken.
        """
        self._follow()
        before = self._verdicts.get(frame_id)
        self._write(frame_id, verdict)
        self._steps.append((frame_id, before, verdict))

    def undo(self) -> str | None:
        """Take the last verdict of this session back; return its frame, or None if there is nothing to undo.

        Verdicts that somebody else has changed since stay as they are.
        """
        self._follow()
        while self._steps:
            frame_id, before, after = self._steps.pop()
            if self._verdicts.get(frame_id) == after:
                self._write(frame_id, before)
                return frame_id
        return None

    def counts(self) -> Counter[str]:
        """Return the number of verdicts by word."""
        return Counter(self.words.values())

    def _write(self, frame_id: str, verdict: Verdict | None) -> None:
        changed = {k: v for k, v in self._verdicts.items() if k != frame_id}
        if verdict is not None:
            changed[frame_id] = verdict
        write_verdicts(self.path, changed)
        self._verdicts, self._state = changed, self._state_now()

    def _follow(self) -> None:
        """Read the file again if somebody else has written it."""
        if self._state_now() != self._state:
            self._read()

    def _read(self) -> None:
        self._state = self._state_now()
        self._verdicts = read_verdicts(self.path) if self._state is not None else {}

    def _state_now(self) -> tuple[int, int, int] | None:
        try:
            status = os.lstat(self.path)
        except OSError:
            return None
        return status.st_ino, status.st_mtime_ns, status.st_size
