"""Turns Ctrl-C and SIGTERM into a request that an executor honours when it can."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any

STOPPED = "Stopped on request. Finished work is kept; the same command with --resume continues."

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interruption:
    """Context in which the first SIGINT or SIGTERM sets `requested` and the second raises KeyboardInterrupt.

    Signals only reach the main thread of Python; in another thread this does nothing.

    Attributes:
        requested: Whether the user asked to stop.
        wakeup: File descriptor that becomes readable with the first signal, to interrupt a wait.
    """

    def __init__(self, on_force: Callable[[], None] = lambda: None) -> None:
        """Call `on_force` with the second signal, before KeyboardInterrupt."""
        self.requested = False
        self.wakeup = -1
        self._on_force = on_force
        self._forced = False
        self._write_end = -1
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interruption:
        self.wakeup, self._write_end = os.pipe()
        os.set_blocking(self._write_end, False)
        if threading.current_thread() is threading.main_thread():
            for s in _SIGNALS:
                self._before[s] = signal.signal(s, self._receive)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for s, handler in self._before.items():
            # None: the handler was not set from Python and cannot be restored.
            signal.signal(s, signal.SIG_DFL if handler is None else handler)
        self._before.clear()
        os.close(self.wakeup)
        os.close(self._write_end)

    def _receive(self, number: int, frame: FrameType | None) -> None:
        if not self.requested:
            self.requested = True
            os.write(self._write_end, b"!")
            return
        if self._forced:  # already leaving: let the clean-up finish
            return
        self._forced = True
        self._on_force()
        raise KeyboardInterrupt
