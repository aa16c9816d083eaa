"""A folder in object storage, by fsspec, which repeats calls and finds credentials and endpoints by itself.

Datasets there are copied to the user's cache folder before they are read.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from infrablend.core.addresses import address_of, without_user
from infrablend.core.file_names import join_inside
from infrablend.core.files import (
    cache_folder,
    output_error,
    read_object,
    replace_atomically,
    require_free_space,
    sha256_of,
    write_json,
)
from infrablend.errors import DatasetError, InfraBlendError, MissingDependencyError, StorageError


class Store:
    """A folder in object storage.

    Every method raises `StorageError` if the storage cannot be reached, or refuses.
    """

    def __init__(self, address: str) -> None:
        """Connect to a folder by its address, such as `s3://bucket/run`.

        Raises:
            MissingDependencyError: The library for this storage is not installed.
        """
        self.address = address
        scheme, _, self._root = address.partition("://")
        self._files = _file_system(scheme)

    def place(self, name: str) -> str:
        """Return the address of a file, for messages."""
        return f"{self.address}/{name}"

    def files(self) -> dict[str, int]:
        """Return the bytes of the files directly in the folder by name; empty if there is no such folder."""
        with self._reported("be listed"):
            try:
                found = self._files.ls(self._root, detail=True)
            except FileNotFoundError:
                return {}
        return {f["name"].rpartition("/")[2]: int(f["size"] or 0) for f in found if f["type"] == "file"}

    def tree(self) -> dict[str, int]:
        """Return the bytes of all files below the folder, by their paths in it."""
        with self._reported("be listed"):
            found = self._files.find(self._root, detail=True)
        before = len(self._root) + 1
        # Names with a slash at their end stand for folders; consoles and programs that mount buckets make them.
        return {p[before:]: int(f["size"] or 0) for p, f in found.items() if not p.endswith("/")}

    def read(self, name: str) -> bytes | None:
        """Return the content of a small file, or None if there is none."""
        with self._reported("be read", name):
            try:
                return bytes(self._files.cat_file(self._path(name)))
            except FileNotFoundError:
                return None

    def upload(self, source: Path, name: str) -> None:
        """Write a file, and check that it has the same size in the storage."""
        with self._reported("be written", name):
            self._files.put_file(str(source), self._path(name))
            found = int(self._files.info(self._path(name))["size"])
        if found != source.stat().st_size:
            raise StorageError(
                f"{self.place(name)}: has {found} bytes after writing, expected {source.stat().st_size}. Repeat the "
                "command; if it happens again, the storage is at fault"
            )

    def download(self, name: str, target: Path, sha256: str | None = None) -> None:
        """Copy a file to this machine; it appears whole, with this digest, or not at all.

        Raises:
            StorageError: It is missing, cannot be read, or has another digest.
            OutputError: The target cannot be written.
        """
        with replace_atomically(target) as part:
            with self._reported("be read", name):
                self._files.get_file(self._path(name), str(part))
            if sha256 is not None and (found := sha256_of(part)) != sha256:
                raise StorageError(
                    f"{self.place(name)}: found {part.stat().st_size} bytes with the digest {found[:12]}..., expected "
                    f"{sha256[:12]}.... Make the shard again with --resume"
                )

    def remove(self, name: str) -> None:
        """Remove a file, if there is one."""
        with self._reported("be removed", name), contextlib.suppress(FileNotFoundError):
            if self._files.exists(self._path(name)):
                self._files.rm_file(self._path(name))

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}"

    @contextlib.contextmanager
    def _reported(self, what: str, name: str = "") -> Iterator[None]:
        """Turn what a storage's library raises into an error that says what to do."""
        self._files.invalidate_cache()  # other jobs write to the same folder
        try:
            yield
        except InfraBlendError:
            raise
        except Exception as error:
            place = self.place(name) if name else self.address
            text = without_user(" ".join(f"{type(error).__name__}: {error}".split())[:300])
            todo = "Check the address, the credentials and their rights, and the network, and repeat with --resume"
            raise StorageError(f"{place}: cannot {what} ({text}). {todo}") from error


def _file_system(scheme: str) -> Any:
    try:
        import fsspec

        # Listings are never cached: other jobs write to the same folder.
        return fsspec.filesystem(scheme, use_listings_cache=False, skip_instance_cache=True)
    except ImportError as error:
        raise MissingDependencyError(
            f"{scheme}:// needs a library that is not installed ({error.name or error}). "
            "Install it, for s3:// with: pip install 'infrablend[s3]'"
        ) from error
    except Exception as error:
        raise StorageError(
            f"{scheme}://: cannot be used ({without_user(str(error))}). Check its configuration"
        ) from error


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
