"""Compare folders before and after an attack."""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
import sqlite3
import stat
import zipfile
from pathlib import Path
from typing import Any

from tests.run_files import ledger_rows, without_times

# Parts of records that differ between equal calls.
_TIMES = {"timing", "seconds", "sessions", "fetched", "commit", "commits"}
_DURATION = re.compile(rb"\b\d+(\.\d+)? (s|min|h)\b")
_COMMIT = re.compile(rb"\* commit: .*\n")
_DIGEST = re.compile(rb"[0-9a-f]{64}")


def contents(root: Path, left_out: tuple[str, ...] = ("workers.log",), trained: bool = False) -> dict[str, str]:
    """Return the digest of each file below a folder, without what differs between equal calls.

    These are times, logs, and, where a network was trained, the name of the file in its weights and what is derived
    from their digest.

    Args:
        root: The folder.
        left_out: Beginnings of paths, and parts of paths, that are left out.
        trained: Whether the output depends on weights that were trained.
    """
    found = {}
    for path in sorted(root.rglob("*")):
        name = path.relative_to(root).as_posix()
        if path.is_file() and not any(name.startswith(part) or f"/{part}" in name for part in left_out):
            found[name] = hashlib.sha256(_comparable(path, trained)).hexdigest()
    return found


def _comparable(path: Path, trained: bool) -> bytes:
    if path.name == "run.sqlite":
        with contextlib.suppress(sqlite3.OperationalError):  # a kill may leave one without tables in a workspace
            return repr(ledger_rows(path)).encode()
    data = without_times(path.name, path.read_bytes())
    if path.suffix == ".json":
        with contextlib.suppress(ValueError):
            data = json.dumps(_without_times(json.loads(data)), sort_keys=True).encode()
    if path.suffix == ".md":
        data = _COMMIT.sub(b"", _DURATION.sub(b"time", data))
    if path.suffix == ".pt":
        with contextlib.suppress(zipfile.BadZipFile), zipfile.ZipFile(path) as archive:
            data = b"".join(archive.read(n) for n in sorted(archive.namelist()) if "/data/" in n)
    if trained and path.suffix in (".json", ".md", ".html"):
        data = _DIGEST.sub(b"digest", data)
    return data


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_times(v) for k, v in value.items() if k not in _TIMES}
    return [_without_times(v) for v in value] if isinstance(value, list) else value


def snapshot(root: Path, *left_out: str) -> dict[str, tuple[Any, ...]]:
    """Return type, size, time and digest of everything below a folder, except in the entries `left_out`."""
    found: dict[str, tuple[Any, ...]] = {}
    for entry in sorted(root.iterdir()):
        if entry.name in left_out:
            continue
        for path in (entry, *(sorted(entry.rglob("*")) if entry.is_dir() and not entry.is_symlink() else ())):
            status = path.lstat()
            regular = stat.S_ISREG(status.st_mode)
            digest = hashlib.sha256(path.read_bytes()).hexdigest() if regular else ""
            time = status.st_mtime_ns if regular else 0
            found[path.relative_to(root).as_posix()] = (
                stat.S_IFMT(status.st_mode),
                status.st_size * regular,
                time,
                digest,
            )
    return found


def differences(a: dict[str, Any], b: dict[str, Any], most: int = 6) -> str:
    """Return the names whose values differ between two mappings."""
    names = sorted(k for k in {*a, *b} if a.get(k) != b.get(k))
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")
