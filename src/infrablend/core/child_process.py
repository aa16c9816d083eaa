"""What a process has to know of those that it started: their memory, and how they ended."""

from __future__ import annotations

import signal

import psutil

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
