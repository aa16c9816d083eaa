"""Landlock, with which a process on Linux gives up access to files. Imports the standard library only."""

from __future__ import annotations

import ctypes
import sys

# This system call has the same number on every architecture.
CREATE_RULESET = 444
_GET_VERSION = 1


def landlock_version() -> int:
    """Return the version of Landlock that the kernel offers; 0 without it."""
    if sys.platform != "linux":
        return 0
    libc = ctypes.CDLL(None, use_errno=True)
    return max(0, int(libc.syscall(CREATE_RULESET, None, ctypes.c_size_t(0), _GET_VERSION)))
