"""Copies of datasets in object storage on this machine, made before they are read.

A copy is in a scratch folder, see `storage.scratch`: it is used again by the next command, only files that changed are
copied anew, and it is removed by any command after a week without use.
"""

from __future__ import annotations

import json
import logging
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from infrablend.core.addresses import address_of
from infrablend.core.file_names import join_inside
from infrablend.core.files import read_object, write_json
from infrablend.core.output import OutputFolder
from infrablend.errors import DatasetError, StorageError
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
        OutputError: Another process makes the same copy, or it cannot be written.
    """
    if (address := address_of(path)) is None:
        return Path(path)
    store = store or Store(address)
    root = lasting(f"copy of {address}")
    with OutputFolder(root, f"copy of {address}").claimed():
        wanted = store.tree()
        if not wanted:
            raise DatasetError(
                f"{address}: found no files, expected a dataset. Check the address with the storage's tools"
            )
        known = (read_object(root / _INDEX) or {}).get("files", {})
        stale = {name for name, facts in wanted.items() if not _is_same(root, name, facts, known)}
        _require_space(address, sum(int(wanted[name]["bytes"]) for name in stale), root)
        for name in sorted(known.keys() - wanted.keys()):
            join_inside(root / _FILES, name).unlink(missing_ok=True)
        # Files that are being replaced are not in the index, should this process end here.
        _write_index(root, address, {n: f for n, f in wanted.items() if n not in stale})
        for name in sorted(stale):
            target = join_inside(root / _FILES, name)
            target.parent.mkdir(parents=True, exist_ok=True)
            store.download(name, target)
        _write_index(root, address, wanted)
    log.info("%s: %d files, %d of them copied now", address, len(wanted), len(stale))
    return root / _FILES


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
