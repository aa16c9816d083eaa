"""Copies of datasets in object storage in the user's cache folder, made before they are read."""

from __future__ import annotations

import hashlib
import json
import logging
import tempfile
from pathlib import Path

from infrablend.core.addresses import address_of
from infrablend.core.file_names import join_inside
from infrablend.core.files import output_error, read_object, require_free_space, write_json
from infrablend.core.user_folders import cache_folder
from infrablend.errors import DatasetError
from infrablend.pipeline.storage.store import Store

log = logging.getLogger(__name__)

_INDEX = ".storage.json"
_SPARE_BYTES = 1 << 30


def local_folder(path: str | Path) -> Path:
    """Return a folder on this machine with the files of a folder, which may be in object storage.

    A folder of this machine is returned as it is. A copy is used again as long as the storage lists the same files
    with the same sizes.

    Raises:
        DatasetError: There is nothing at the address.
        StorageError, MissingDependencyError: The storage cannot be used.
        OutputError: The copy cannot be written, or has no space.
    """
    if (address := address_of(path)) is None:
        return Path(path)
    store = Store(address)
    wanted = store.tree()
    if not wanted:
        raise DatasetError(f"{address}: found no files, expected a dataset. Check the address with the storage's tools")
    key = hashlib.sha256(json.dumps([address, sorted(wanted.items())]).encode()).hexdigest()[:24]
    target = cache_folder() / "storage" / key / address.rpartition("/")[2]
    if target.is_dir():
        return target
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        todo = "set XDG_CACHE_HOME to a folder on a larger disk, or mount the storage"
        require_free_space(target.parent, sum(wanted.values()) + _SPARE_BYTES, f"a copy of {address}", todo)
        # Several processes may copy at once; the first one that is ready gives the folder its name.
        with tempfile.TemporaryDirectory(dir=target.parent) as folder:
            part = Path(folder) / "files"
            for name in sorted(wanted):
                store.download(name, join_inside(part, name))
            write_json(part / _INDEX, {"address": address})
            if not target.is_dir():
                part.rename(target)
    except OSError as error:
        raise output_error(target, error) from error
    except ValueError as error:  # names that lead out of a folder
        raise DatasetError(f"{address}: cannot be copied to a folder ({error}); rename the file there") from error
    log.info("%s: %d files copied", address, len(wanted))
    return target


def origin_of(folder: Path) -> str | None:
    """Return the address that a folder is a copy of; None for another folder."""
    found = (read_object(folder / _INDEX) or {}).get("address")
    return found if isinstance(found, str) else None
