"""Locks on folders of this machine that several processes read: one writes while nobody reads.

The locks are on the folders themselves, leave no files behind, and end with the process. Where the file system has
none, nothing is locked.
"""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
from collections.abc import Iterator
from pathlib import Path

from infrablend.core.files import output_error

log = logging.getLogger(__name__)

_read: dict[Path, int] = {}
"""Handles of the folders that this process reads, until it ends."""


@contextlib.contextmanager
def locked(folder: Path, noun: str) -> Iterator[None]:
    """Make a folder, and lock out other processes during the block; waits for another one that has locked it.

    Args:
        folder: The folder.
        noun: What it holds, for the message of the wait.

    Raises:
        OutputError: It cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = _opened(folder)
    except OSError as error:
        raise output_error(folder, error) from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            log.warning("%s: another process makes this %s; waiting for it", folder, noun)
            fcntl.flock(handle, fcntl.LOCK_EX)
        except OSError as error:
            log.warning("%s: cannot be locked (%s); do not let two commands make this %s", folder, error, noun)
        yield
    finally:
        os.close(handle)


def keep_read(folder: Path) -> None:
    """Mark a folder as read by this process until it ends."""
    release(folder)
    with contextlib.suppress(OSError):
        _read[folder] = _opened(folder)
        fcntl.flock(_read[folder], fcntl.LOCK_SH)


def release(folder: Path) -> None:
    """Take back `keep_read`."""
    if folder in _read:
        os.close(_read.pop(folder))


def is_used(folder: Path) -> bool:
    """Return whether any process reads or has locked a folder."""
    try:
        handle = _opened(folder)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    finally:
        os.close(handle)
    return False


def _opened(folder: Path) -> int:
    return os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
