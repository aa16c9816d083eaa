"""Remembers which files have been compared with their digests, so that no picture is read twice for that."""

from __future__ import annotations

import hashlib
import os
import stat
from pathlib import Path

from infrablend.core.files import sha256_of


class CheckedFiles:
    """Remembers files by device, inode, size and times: a hard link to a verified file needs no second reading."""

    def __init__(self) -> None:
        """Start without any file."""
        self._known: set[bytes] = set()

    def has_digest(self, path: Path, folder: Path, sha256: str) -> bool:
        """Return whether a file of `folder` has this SHA-256; False if it is missing or cannot be read.

        A file that was read before is only read again if it has been changed or replaced since.
        """
        try:
            status = path.lstat()
            key = _key(status, sha256)
            if key in self._known:
                return True
            if not path.is_file() or sha256_of(path, folder) != sha256:
                return False
        except (OSError, ValueError):
            return False
        if stat.S_ISREG(status.st_mode):  # a link does not change with the file that it leads to
            self._known.add(key)
        return True

    def add(self, path: Path, sha256: str) -> None:
        """Take note of a file that was just written, with content that has this SHA-256."""
        self._known.add(_key(path.lstat(), sha256))


def _key(status: os.stat_result, sha256: str) -> bytes:
    facts = (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, sha256)
    return hashlib.blake2b(repr(facts).encode(), digest_size=16).digest()
