"""Facts about the computer and the installed packages, for records and `doctor`."""

from __future__ import annotations

import platform
import subprocess
from collections.abc import Iterable
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Literal

import psutil

from infrablend.core.operating_system import processor_name, read_system_file, usable_processors

_CGROUP = Path("/sys/fs/cgroup")

Device = Literal["auto", "cpu", "cuda", "optix", "hip", "metal", "oneapi"]
"""Device that Cycles computes on."""


@cache
def describe_machine() -> dict[str, object]:
    """Return processor, cores, memory, operating system and Python version as plain JSON values."""
    return {
        "processor": processor_name(),
        "cores": len(usable_processors()),
        "memory_gib": round(psutil.virtual_memory().total / 2**30),
        "system": platform.system(),
        "python": platform.python_version(),
    }


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
    cores = float(len(usable_processors()))
    words = read_system_file(_CGROUP / "cpu.max").split()
    if len(words) == 2 and words[0].isdigit():
        cores = min(cores, int(words[0]) / int(words[1]))
    return cores


def usable_memory_bytes() -> int:
    """Return the memory that this process may still use: the available memory, within the limit of the container."""
    available = int(psutil.virtual_memory().available)
    limit, used = (read_system_file(_CGROUP / name).strip() for name in ("memory.max", "memory.current"))
    if limit.isdigit() and used.isdigit():
        available = min(available, int(limit) - int(used))
    return max(available, 0)
