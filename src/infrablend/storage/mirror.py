"""Copies of datasets in object storage on this machine, made before they are read.

A copy is in a scratch folder, see `storage.scratch`: it is used again by the next command, only files that changed are
copied anew, and it is removed by any command after a week without use.
"""

from __future__ import annotations

import contextlib
import json
import logging
import shutil
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from infrablend.core.addresses import address_of
from infrablend.core.file_names import MAX_NAME_BYTES, join_inside
from infrablend.core.files import read_object, write_json
from infrablend.errors import DatasetError, OutputError, Problem, StorageError
from infrablend.storage.locks import is_used, keep_read, locked, release
from infrablend.storage.scratch import lasting
from infrablend.storage.store import Store

log = logging.getLogger(__name__)

_INDEX = "storage.json"
_FILES = "files"
_SPARE_BYTES = 1 << 30


def local_folder(path: str | Path, store: Store | None = None) -> Path:
    """Return a folder on this machine with the files of a folder, which may be in object storage.

    Args:
        path: Folder, which is returned as it is, or address.
        store: The storage; None connects to that of the address.

    Raises:
        DatasetError: There is nothing at the address.
        StorageError, MissingDependencyError: The storage cannot be used, or this machine has no space for a copy.
        OutputError: It cannot be written, or another process reads files in it that have changed.
    """
    if (address := address_of(path)) is None:
        return Path(path)
    store = store or Store(address)
    root = lasting(f"copy of {address}")
    files = root / _FILES
    # Jobs that start together on one machine need the same copy: the first one makes it, the others wait.
    with locked(root, f"copy of {address}"):
        wanted = store.tree()
        if not wanted:
            raise DatasetError(
                f"{address}: found no files, expected a dataset. Check the address with the storage's tools"
            )
        _require_names(address, wanted)
        known = (read_object(root / _INDEX) or {}).get("files", {})
        stale = {name for name, facts in wanted.items() if not _is_same(root, name, facts, known)}
        _require_space(address, sum(int(wanted[name]["bytes"]) for name in stale), root)
        gone = known.keys() - wanted.keys()
        _require_unread(address, files, len(gone | (stale & known.keys())))
        for name in sorted(gone):
            _remove(files, name)
        # Files that are being replaced are not in the index, should this process end here.
        _write_index(root, address, {n: f for n, f in wanted.items() if n not in stale})
        for name in sorted(stale):
            target = join_inside(files, name)
            target.parent.mkdir(parents=True, exist_ok=True)
            store.download(name, target)
        _write_index(root, address, wanted)
        keep_read(files)
    log.info("%s: %d files, %d of them copied now", address, len(wanted), len(stale))
    return files


def _require_unread(address: str, files: Path, changed: int) -> None:
    """Check that no other process reads files that are to be replaced or removed.

    Raises:
        OutputError: One does.
    """
    release(files)
    if changed and is_used(files):
        raise OutputError(
            f"{address}: {changed} files were changed or removed since another process of this machine began to read "
            f"its copy in {files}; expected none while it does. Wait until it ends, or set TMPDIR to another folder"
        )


def _require_names(address: str, names: Collection[str]) -> None:
    """Check that files with these names can be on this machine, each in a place of its own.

    Raises:
        DatasetError: One cannot; `problems` names each.
    """
    folders = {"/".join(parts[:n]) for name in names for parts in [name.split("/")] for n in range(1, len(parts))}
    problems = [
        Problem(f"{address}/{name}", "name-unfit", found, "a file that a folder can have", "rename or remove it there")
        for name in sorted(names)
        if (found := _unfit(name, folders)) is not None
    ]
    if problems:
        raise DatasetError(f"{address}: cannot be copied to a folder; nothing was copied", problems)


def _unfit(name: str, folders: Collection[str]) -> str | None:
    parts = name.split("/")
    if any(part in ("", ".", "..") for part in parts):
        return "an empty, '.' or '..' part of the name"
    if "\0" in name or any(len(part.encode()) > MAX_NAME_BYTES for part in parts):
        return f"a part of the name with a NUL or more than {MAX_NAME_BYTES} bytes"
    return "a file with the name of a folder" if name in folders else None


def _remove(files: Path, name: str) -> None:
    """Delete a copy and the folders that are empty without it, which may be files of that name now."""
    path = join_inside(files, name)
    with contextlib.suppress(FileNotFoundError, NotADirectoryError):
        path.unlink()
    for folder in path.parents:
        if folder == files or not folder.is_dir():
            break
        try:
            folder.rmdir()
        except OSError:  # not empty
            break


def origin_of(folder: Path) -> str | None:
    """Return the address that a folder is a copy of; None for another folder."""
    if folder.name != _FILES:
        return None
    found = (read_object(folder.parent / _INDEX) or {}).get("address")
    return found if isinstance(found, str) else None


def _is_same(root: Path, name: str, facts: Mapping[str, Any], known: Mapping[str, Any]) -> bool:
    try:
        return known.get(name) == facts and join_inside(root / _FILES, name).stat().st_size == facts["bytes"]
    except OSError:
        return False


def _write_index(root: Path, address: str, files: Mapping[str, Any]) -> None:
    write_json(root / _INDEX, {"address": address, "files": json.loads(json.dumps(files))})


def _require_space(address: str, needed: int, root: Path) -> None:
    free = shutil.disk_usage(root).free
    if needed + _SPARE_BYTES > free:
        raise StorageError(
            f"{address}: {needed / 1e9:.1f} GB to copy, and {free / 1e9:.1f} GB free in {root.parent}; expected 1 GB "
            "to spare. Set TMPDIR to a larger disk, or mount the storage"
        )
