"""Facts about the computer and the installed packages, for records and `doctor`; and a core for each worker."""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import platform
import subprocess
from collections.abc import Iterable
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Literal

import psutil

_CGROUP = Path("/sys/fs/cgroup")
log = logging.getLogger(__name__)

Device = Literal["auto", "cpu", "cuda", "optix", "hip", "metal", "oneapi"]
"""Device that Cycles computes on."""

_CORE_LOCKS: list[int] = []


@cache
def describe_machine() -> dict[str, object]:
    """Return processor, cores, memory, operating system and Python version as plain JSON values."""
    return {
        "processor": processor_name(),
        "cores": available_cores(),
        "memory_gib": round(psutil.virtual_memory().total / 2**30),
        "system": platform.system(),
        "python": platform.python_version(),
    }


@cache
def processor_name() -> str:
    """Return the model name of the processor, or its architecture where the system does not report a name."""
    for line in _read(Path("/proc/cpuinfo")).splitlines():
        if line.startswith("model name"):
            return " ".join(line.partition(":")[2].split())
    return platform.processor() or platform.machine()


def installed_version(package: str) -> str | None:
    """Return the version of an installed package without importing it, or None."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def installed_versions(packages: Iterable[str]) -> dict[str, str]:
    """Return the versions of those packages that are installed, by name."""
    return {name: version for name in packages if (version := installed_version(name)) is not None}


@cache
def source_commit() -> str | None:
    """Return the commit of the repository this code runs from, or None; `+` marks changed sources."""
    root = Path(__file__).resolve().parents[3]
    if not ((root / ".git").exists() and (root / "pyproject.toml").is_file()):
        return None
    try:
        head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=root, capture_output=True, text=True, check=True)
        changed = subprocess.run(["git", "diff", "--quiet", "HEAD", "--", "src"], cwd=root, check=False)
    except (OSError, subprocess.CalledProcessError):
        return None
    return head.stdout.strip() + ("+" if changed.returncode else "")


def usable_cores() -> float:
    """Return the cores this process may use: its affinity, limited by the quota of the container."""
    cores = float(available_cores())
    words = _read(_CGROUP / "cpu.max").split()
    if len(words) == 2 and words[0].isdigit():
        cores = min(cores, int(words[0]) / int(words[1]))
    return cores


def has_matrix_units() -> bool:
    """Return whether the processor has matrix units for bfloat16 (AMX), which double the speed of a training."""
    return "amx_tile" in _read(Path("/proc/cpuinfo"))


def usable_memory_bytes() -> int:
    """Return the memory that this process may still use: the available memory, within the limit of the container."""
    available = int(psutil.virtual_memory().available)
    limit, used = (_read(_CGROUP / name).strip() for name in ("memory.max", "memory.current"))
    if limit.isdigit() and used.isdigit():
        available = min(available, int(limit) - int(used))
    return max(available, 0)


def _read(path: Path) -> str:
    with contextlib.suppress(OSError, UnicodeDecodeError):
        return path.read_text("utf-8")
    return ""


def available_cores() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


def take_core() -> None:
    """Pin this process to a processor core that no other worker on this machine uses.

    Measured: with one render thread, the main thread of Cycles waits by spinning and burns as much processor time as
    the render itself; on a single core it cannot. File locks, which end with the process, assign the cores. Without a
    free core (more workers than cores) nothing is pinned.
    """
    if not hasattr(os, "sched_setaffinity"):
        return
    folder = Path("/dev/shm" if Path("/dev/shm").is_dir() else "/tmp")
    for core in sorted(os.sched_getaffinity(0)):
        path = folder / f"infrablend_core_{core}_{os.getuid()}.lock"
        try:
            handle = os.open(path, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
        except OSError:
            return
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(handle)
            continue
        _CORE_LOCKS.append(handle)
        os.sched_setaffinity(0, {core})
        return
    log.info("no free core to pin this worker to")
