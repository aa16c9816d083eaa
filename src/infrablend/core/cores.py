"""Devices that compute: those of Cycles, the processor cores of this process, and reserving one for each worker."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Literal

log = logging.getLogger(__name__)

Device = Literal["auto", "cpu", "cuda", "optix", "hip", "metal", "oneapi"]
"""Device that Cycles computes on."""

_CORE_LOCKS: list[int] = []


def available_cores() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


def take_core() -> int | None:
    """Pin this process to a processor core that no other worker on this machine uses; return its number.

    Measured: with one render thread, the main thread of Cycles waits by spinning and burns as much processor time as
    the render itself; on a single core it cannot. File locks, which end with the process, assign the cores. Without a
    free core (more workers than cores) nothing is pinned and None is returned.
    """
    if not hasattr(os, "sched_setaffinity"):
        return None
    import fcntl  # not available on every system

    folder = Path("/dev/shm" if Path("/dev/shm").is_dir() else "/tmp")
    for core in sorted(os.sched_getaffinity(0)):
        path = folder / f"infrablend_core_{core}_{os.getuid()}.lock"
        try:
            handle = os.open(path, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
        except OSError:
            return None
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(handle)
            continue
        _CORE_LOCKS.append(handle)
        os.sched_setaffinity(0, {core})
        return core
    log.info("no free core to pin this worker to")
    return None
