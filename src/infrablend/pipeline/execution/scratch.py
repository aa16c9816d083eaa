"""The temporary folder of a pool's workers: in memory where possible, and removed even after crashes."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from infrablend.errors import OutputError, Problem

_SCRATCH = "infrablend-workers-"
_MIN_MEMORY_BYTES = 48 * 2**20  # a full-frame float image is 5 MiB; containers often give /dev/shm 64 MiB


@contextlib.contextmanager
def scratch_folder() -> Iterator[str]:
    """Create the folder for temporary files of workers: in memory unless TMPDIR is set or memory is short.

    The parent removes it, since a killed worker cannot. The next run removes the folder of a killed parent. A lock
    marks a folder in use; it ends with its process.

    Raises:
        OutputError: The folder cannot be created.
    """
    memory = Path("/dev/shm")
    roomy = os.access(memory, os.W_OK) and shutil.disk_usage(memory).free >= _MIN_MEMORY_BYTES
    folder = Path(tempfile.gettempdir()) if os.environ.get("TMPDIR") or not roomy else memory
    try:
        _sweep(folder)
        # Create under another name, lock, then rename: no sweep can find it without its lock.
        made = Path(tempfile.mkdtemp(prefix="infrablend-new-", dir=folder))
        handle = os.open(made, os.O_RDONLY)
        with contextlib.suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        scratch = made.rename(folder / (_SCRATCH + made.name.removeprefix("infrablend-new-")))
    except OSError as error:
        raise OutputError(
            f"{folder}: cannot create a temporary folder ({error.strerror or error}); free some space there, or set "
            "TMPDIR to another folder",
            [Problem(str(folder), "disk-full" if error.errno == errno.ENOSPC else "not-writable", str(error))],
        ) from error
    try:
        yield str(scratch)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
        os.close(handle)


def _sweep(folder: Path) -> None:
    for left in sorted(folder.glob(_SCRATCH + "*")):
        with contextlib.suppress(OSError):
            if left.is_symlink() or left.stat().st_uid != os.getuid():
                continue
            handle = os.open(left, os.O_RDONLY | os.O_DIRECTORY)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(left, ignore_errors=True)
            finally:
                os.close(handle)
