"""Turns Ctrl-C and SIGTERM into a request that an executor honours when it can."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any

from infrablend.core.operating_system import STOP_SIGNALS

STOPPED = "Stopped on request. Finished work is kept; the same command with --resume continues."


class Interruption:
    """Context in which the first signal to stop sets `requested` and the second raises KeyboardInterrupt.

    Signals only reach the main thread of Python; in another thread this does nothing.

    Attributes:
        requested: Whether the user asked to stop.
    """

    def __init__(
        self, on_force: Callable[[], None] = lambda: None, on_request: Callable[[], None] = lambda: None
    ) -> None:
        """Call `on_request` with the first signal, and `on_force` with the second, before KeyboardInterrupt."""
        self.requested = False
        self._on_force = on_force
        self._on_request = on_request
        self._forced = False
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interruption:
        if threading.current_thread() is threading.main_thread():
            for s in STOP_SIGNALS:
                self._before[s] = signal.signal(s, self._receive)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for s, handler in self._before.items():
            # None: the handler was not set from Python and cannot be restored.
            signal.signal(s, signal.SIG_DFL if handler is None else handler)
        self._before.clear()

    def _receive(self, number: int, frame: FrameType | None) -> None:
        if not self.requested:
            self.requested = True
            self._on_request()
            return
        if self._forced:  # already leaving: let the clean-up finish
            return
        self._forced = True
        self._on_force()
        raise KeyboardInterrupt
