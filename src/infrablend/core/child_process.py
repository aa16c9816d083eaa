"""Processes and those that they started: their memory, how they ended, and that they end with their parent."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
import threading
import time

import psutil

_PR_SET_PDEATHSIG = 1
_CHECK_EVERY_S = 1.0

CHILD_BYTES: dict[int, int] = {}
"""Resident memory that children of this process last reported, by process number."""


def resident_bytes() -> int:
    """Return the resident memory of this process and of its children in `CHILD_BYTES`."""
    return int(psutil.Process().memory_info().rss) + sum(CHILD_BYTES.values())


def describe_exit(code: int) -> str:
    """Return how a process ended, by the return code of `subprocess`."""
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = "unknown"
    hint = " (often: out of memory)" if -code == signal.SIGKILL else ""
    return f"was ended by signal {-code} {name}{hint}"


def die_with_parent(parent_pid: int) -> None:
    """Ask Linux to kill this process when its parent ends, even while C code holds Python's lock.

    On other systems, call `watch_parent` as well.
    """
    if sys.platform != "linux":
        return
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent_pid:  # the parent ended before the request
        os._exit(1)


def watch_parent(parent_pid: int) -> None:
    """Start a thread that ends this process within a second or so after its parent."""

    def watch() -> None:
        while os.getppid() == parent_pid:
            time.sleep(_CHECK_EVERY_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
