"""Turns Ctrl-C and SIGTERM into KeyboardInterrupt, and remembers that one of them came."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType

_requested = False


@contextlib.contextmanager
def stopped_by_signals() -> Iterator[None]:
    """Raise KeyboardInterrupt where the first thread is, at Ctrl-C and SIGTERM; do nothing in other threads."""
    global _requested
    _requested = False
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {}
    for number in (signal.SIGTERM, signal.SIGINT):
        # Whoever starts a program in the background of a shell wants Ctrl-C to be ignored.
        if number == signal.SIGTERM or signal.getsignal(number) is signal.default_int_handler:
            before[number] = signal.signal(number, _stop)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)


def stop_requested() -> bool:
    """Return whether a signal came since `stopped_by_signals`: compiled code may raise another error in its place."""
    return _requested


def _stop(number: int, frame: FrameType | None) -> None:
    global _requested
    _requested = True
    raise KeyboardInterrupt
