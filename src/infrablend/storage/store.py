"""A folder in object storage: files appear whole, are read back after writing, and calls are repeated with back-off.

Credentials, endpoints and proxies are those that the storage's library finds by itself; none is passed or recorded.
"""

from __future__ import annotations

import errno
import hashlib
import logging
import random
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from infrablend.core.addresses import EXTRAS, without_user
from infrablend.core.files import free_part, output_error, sha256_of
from infrablend.errors import InfraBlendError, MissingDependencyError, Problem, StorageError

log = logging.getLogger(__name__)

Result = TypeVar("Result")

ATTEMPTS = 8
"""Calls until a busy, slow or unreachable storage is given up; each pause is twice the one before, from a second."""

_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 1.0, 20.0
_BLOCK = 4 << 20
# What file systems call the fact about a file that changes with its content.
_VERSIONS = ("ETag", "etag", "md5Hash", "blob_id", "LastModified", "last_modified", "created")
# What no repetition mends.
_FINAL = (PermissionError, FileNotFoundError, FileExistsError, IsADirectoryError, NotADirectoryError, ImportError)
_FINAL_NAMES = {"NoCredentialsError", "PartialCredentialsError", "ParamValidationError", "ProfileNotFound",
                "DefaultCredentialsError", "LocalTokenNotFoundError", "TokenRetrievalError"}  # fmt: skip
_CHECKSUM = "FlexibleChecksumError"  # of botocore: the bytes are not those that the storage has a checksum of
DAMAGED = "storage-damaged"
"""Code of the problem that the bytes of a file are not those that were written."""
_READ_BACK = "Repeat the command; if it happens again, the storage is at fault"


@dataclass(frozen=True)
class Stored:
    """A file in storage.

    Attributes:
        size: Bytes.
    """

    size: int


class Store:
    """A folder in object storage."""

    def __init__(self, address: str, files: Any = None, pause: Callable[[float], None] = time.sleep) -> None:
        """Connect to a folder.

        Args:
            address: Address of the folder, such as `s3://bucket/run`.
            files: File system of fsspec to use; None for that of the address.
            pause: Called with the seconds between two attempts.

        Raises:
            MissingDependencyError: The library for this storage is not installed.
        """
        self.address = address
        self._root = address.partition("://")[2]
        self._files = files if files is not None else _file_system(address.partition("://")[0])
        self._pause = pause

    def place(self, name: str) -> str:
        """Return the address of a file, for messages."""
        return f"{self.address}/{name}"

    def files(self) -> dict[str, Stored]:
        """Return the files directly in the folder by name; empty if there is no such folder.

        Raises:
            StorageError: The storage cannot be reached or read.
        """

        def listed() -> list[dict[str, Any]]:
            self._files.invalidate_cache()
            try:
                return list(self._files.ls(self._root, detail=True))
            except FileNotFoundError:
                return []

        found = self._repeat("be listed", "", listed)
        return {f["name"].rpartition("/")[2]: Stored(int(f["size"] or 0)) for f in found if f["type"] == "file"}

    def tree(self) -> dict[str, dict[str, Any]]:
        """Return size, and what changes with the content, of all files below the folder, by their paths in it.

        Raises:
            StorageError: The storage cannot be reached or read.
        """

        def listed() -> dict[str, dict[str, Any]]:
            self._files.invalidate_cache()
            try:
                return dict(self._files.find(self._root, detail=True))
            except FileNotFoundError:
                return {}

        found = self._repeat("be listed", "", listed)
        before = len(self._root) + 1
        return {
            path[before:]: {
                "bytes": int(facts["size"] or 0),
                "version": str(next((facts[k] for k in _VERSIONS if facts.get(k)), "")),
            }
            for path, facts in found.items()
            # Names with a slash at their end stand for folders; consoles and programs that mount buckets make them.
            if path.startswith(f"{self._root}/") and not path.endswith("/")
        }

    def read(self, name: str) -> bytes | None:
        """Return the content of a small file, or None if there is none.

        Raises:
            StorageError: It cannot be read.
        """

        def content() -> bytes | None:
            self._files.invalidate_cache()
            try:
                return bytes(self._files.cat_file(self._path(name)))
            except FileNotFoundError:
                return None

        return self._repeat("be read", name, content)

    def write(self, name: str, data: bytes, *, new: bool = False) -> bool:
        """Write a small file and read it back; with `new`, only if there is none.

        Returns:
            Whether it was written; always True without `new`.

        Raises:
            StorageError: It cannot be written, or comes back different.
        """
        path = self._path(name)

        def put() -> bool:
            try:
                if not new:
                    self._files.pipe_file(path, data)
                elif not self._create(path, data):
                    return self.read(name) == data  # an attempt of ours that was answered with an error, or another's
            except FileExistsError:
                return self.read(name) == data
            return True

        if not self._repeat("be written", name, put):
            return False
        back = self.read(name)
        if back != data:
            raise self._lost(name, "no file" if back is None else f"{len(back)} other bytes", f"{len(data)} bytes")
        return True

    def _create(self, path: str, data: bytes) -> bool:
        """Write a file that does not exist yet; return False if it does, as far as the storage can decide that."""
        try:
            self._files.pipe_file(path, data, mode="create")
        except (TypeError, NotImplementedError, ValueError):  # no conditional writes: the next best is to look first
            self._files.invalidate_cache()
            if self._files.exists(path):
                return False
            self._files.pipe_file(path, data)
        return True

    def upload(self, source: Path, name: str, sha256: str) -> None:
        """Write a file of any size, and read it back.

        Args:
            source: File to copy.
            name: Name in the folder.
            sha256: Digest of the source.

        Raises:
            StorageError: It cannot be written, or comes back different.
        """
        self._repeat("be written", name, lambda: self._files.put_file(str(source), self._path(name)))
        found = self._repeat("be read back", name, lambda: self._digest(name))
        if found != sha256:
            what = "no file" if found is None else "a file with other bytes"
            raise self._lost(name, what, f"the {source.stat().st_size} bytes that were sent")

    def _digest(self, name: str) -> str | None:
        self._files.invalidate_cache()
        digest = hashlib.sha256()
        try:
            with self._files.open(self._path(name), "rb", block_size=_BLOCK, cache_type="readahead") as stream:
                while block := stream.read(_BLOCK):
                    digest.update(block)
        except FileNotFoundError:
            return None
        return digest.hexdigest()

    def download(self, name: str, target: Path, sha256: str | None = None) -> None:
        """Copy a file to this machine; it appears whole, with this digest, or not at all.

        Raises:
            StorageError: It is missing, cannot be read, or has another digest.
            OutputError: The target cannot be written.
        """

        part = free_part(target)

        def fetch() -> None:
            self._files.invalidate_cache()
            try:
                self._files.get_file(self._path(name), str(part))
            except FileNotFoundError as error:
                raise StorageError(f"{self.place(name)}: missing; expected the file that was listed before") from error
            except OSError as error:
                if error.errno in (errno.ENOSPC, errno.EDQUOT):
                    raise output_error(target, error) from error
                raise

        try:
            self._repeat("be read", name, fetch)
            if sha256 is not None and (found := sha256_of(part)) != sha256:
                raise StorageError(
                    f"{self.place(name)}: found {part.stat().st_size} bytes with the digest {found[:12]}..., expected "
                    f"{sha256[:12]}.... Make the shard again with --resume"
                )
            part.replace(target)
        finally:
            part.unlink(missing_ok=True)

    def remove(self, name: str) -> None:
        """Remove a file, if there is one.

        Raises:
            StorageError: It cannot be removed.
        """

        def gone() -> None:
            self._files.invalidate_cache()
            if self._files.exists(self._path(name)):
                self._files.rm_file(self._path(name))

        self._repeat("be removed", name, gone)

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}"

    def _repeat(self, what: str, name: str, call: Callable[[], Result]) -> Result:
        """Return what a call returns, repeating it while the storage is busy, slow or unreachable."""
        pause_s = _FIRST_PAUSE_S
        for attempt in range(1, ATTEMPTS + 1):
            try:
                return call()
            except InfraBlendError:
                raise
            except Exception as error:
                final = isinstance(error, _FINAL) or type(error).__name__ in {*_FINAL_NAMES, _CHECKSUM}
                if final or attempt == ATTEMPTS or not _is_of_storage(error):
                    raise self._failed(what, name, error, attempt) from error
                log.info("%s: %s; attempt %d of %d", self.place(name), _text(error), attempt, ATTEMPTS)
            # Not all at once: many jobs may have been turned away together.
            self._pause(pause_s * random.uniform(0.5, 1.0))
            pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
        raise AssertionError("unreachable")

    def _failed(self, what: str, name: str, error: Exception, attempts: int) -> StorageError:
        place = self.place(name) if name else self.address
        if type(error).__name__ == _CHECKSUM:
            problem = Problem(place, DAMAGED, "bytes with another checksum", "those that were written", _READ_BACK)
            return StorageError(f"{place}: cannot {what}: damaged in the storage", [problem])
        if isinstance(error, FileNotFoundError):
            todo = "Make the bucket, or give the name of another one"
        elif type(error).__name__ == "ParamValidationError":
            todo = "Check the address"
        elif isinstance(error, PermissionError) or type(error).__name__ in _FINAL_NAMES:
            todo = "Check the credentials that the storage's library finds, and their rights to list, read and write"
        else:
            todo = "Check the network, the endpoint, and the free space, and repeat the command with --resume"
        tries = f" after {attempts} attempts" if attempts > 1 else ""
        return StorageError(f"{place}: cannot {what}{tries} ({_text(error)}). {todo}")

    def _lost(self, name: str, found: str, expected: str) -> StorageError:
        problem = Problem(self.place(name), "storage-lost", found, expected, _READ_BACK)
        return StorageError("the storage reported success, but does not have what was written", [problem])


def _is_of_storage(error: Exception) -> bool:
    """Return whether an error comes from the storage or its library, and not from a fault of ours."""
    package = type(error).__module__.partition(".")[0]
    return isinstance(error, OSError | TimeoutError) or package in {
        "aiobotocore", "aiohttp", "botocore", "fsspec", "gcsfs", "google", "httpx", "huggingface_hub", "requests",
        "s3fs", "urllib3",
    }  # fmt: skip


def _text(error: BaseException) -> str:
    """Return an error in one line, without secrets in addresses."""
    return without_user(" ".join(f"{type(error).__name__}: {error}".strip(": ").split())[:300])


def _file_system(scheme: str) -> Any:
    try:
        import fsspec

        # Attempts are counted here alone; those of the library would multiply them.
        settings = {"config_kwargs": {"retries": {"total_max_attempts": 1}}} if scheme == "s3" else {}
        # Listings are never cached: other jobs write to the same folder.
        files = fsspec.filesystem(scheme, use_listings_cache=False, skip_instance_cache=True, **settings)
        files.retries = 1
        return files
    except ImportError as error:
        raise MissingDependencyError(
            f"{scheme}:// needs a library that is not installed ({error.name or error}). "
            f"Install it with: pip install 'infrablend[{EXTRAS[scheme]}]'"
        ) from error
    except Exception as error:
        raise StorageError(f"{scheme}://: cannot be used ({_text(error)}). Check its configuration") from error
