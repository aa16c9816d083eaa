"""Ends a child process together with its parent, so that it does not go on writing for nobody."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
import threading
import time

_PR_SET_PDEATHSIG = 1
_CHECK_EVERY_S = 1.0


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
