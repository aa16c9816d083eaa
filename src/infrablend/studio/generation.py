"""A run that the studio has made: `infrablend generate` in a process of its own, as the shell would start it."""

from __future__ import annotations

import contextlib
import re
import shlex
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

from infrablend.core.child_process import describe_exit

_PROGRESS = re.compile(r"(\d+)/(\d+) frames\b")
# Of the command, and of a process that was stopped before the command could see to it, or twice.
_STOPPED = (130, -signal.SIGTERM)
_KEPT_LINES = 200
_CLOSE_S = 20


class Generation:
    """A run being made.

    Attributes:
        command: The command, as for the shell.
        out: Folder of the run.
        done: Finished frames, as far as it has said.
        total: All frames; 0 until it has said how many.
        progress: The last line on its progress: frames, pace, time left.
        lines: What else it has said, such as warnings; the last ones.
    """

    def __init__(self, words: Sequence[str], out: Path) -> None:
        """Start `infrablend` with these words."""
        self.command = shlex.join(["infrablend", *words])
        self.out = out
        self.done = self.total = 0
        self.progress = ""
        self.lines: list[str] = []
        # In a session of its own: Ctrl-C in the terminal ends the studio, which then stops the run.
        self._process = subprocess.Popen(
            [sys.executable, "-m", "infrablend", *words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            encoding="utf-8",
            errors="replace",
            start_new_session=True,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as said:
            for line in said:
                if (found := _PROGRESS.search(line)) is not None:
                    self.done, self.total = int(found[1]), int(found[2])
                    self.progress = line.strip()
                elif line.strip():
                    self.lines = [*self.lines, line.rstrip()][-_KEPT_LINES:]

    @property
    def is_running(self) -> bool:
        """Whether it goes on, or has not yet been heard to its end."""
        return self._process.poll() is None or self._reader.is_alive()

    @property
    def is_complete(self) -> bool:
        """Whether the run is there."""
        return self._process.poll() == 0

    @property
    def state(self) -> str:
        """What has become of it, in words."""
        code = self._process.poll()
        if code is None:
            return self.progress or "Starting..."
        if code == 0:
            return f"Done. Review it with: {shlex.join(['infrablend', 'studio', '--run', str(self.out)])}"
        if code in _STOPPED and not self.total:
            return "Stopped before it began."
        if code in _STOPPED:
            return f"Stopped. To go on, choose Resume, or: {self.command.removesuffix(' --resume')} --resume"
        return f"It {describe_exit(code)}."

    def stop(self) -> None:
        """Do what Ctrl-C does: finished frames are kept for `--resume`. A second time ends it at once."""
        if self._process.poll() is None:
            self._process.terminate()  # where a studio in the background has children that ignore SIGINT, too

    def close(self) -> None:
        """Stop it, and wait for its end."""
        for end in (self.stop, self.stop, self._process.kill):
            end()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_CLOSE_S)
                break
        self._reader.join()
