"""Scratch folders on this machine for what goes to object storage or comes from there.

They are in the temporary folder (`$TMPDIR`, which clusters point at a local disk), for this user alone, and are removed
when their work is done. Those of jobs that were killed are used again by a job for the same thing, and removed by any
job after a week.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from infrablend.core.files import output_error
from infrablend.core.output import OutputFolder
from infrablend.errors import OutputError, Problem
from infrablend.storage.locks import is_used

log = logging.getLogger(__name__)

_UNUSED_S = 7 * 24 * 3600


@contextlib.contextmanager
def scratch(purpose: str, *, keep: bool = False) -> Iterator[Path]:
    """Yield a folder that no other process uses, and remove it at the end.

    Args:
        purpose: What the folder is for; the same text gives the same folder.
        keep: Keep the folder, to go on with, if the block raises.

    Raises:
        OutputError: Another process uses it, or it cannot be made.
    """
    root = lasting(purpose)
    with OutputFolder(root, f"scratch folder for {purpose}").claimed():
        try:
            yield root
        except BaseException:
            if not keep:
                shutil.rmtree(root, ignore_errors=True)
            with contextlib.suppress(OSError):
                root.rmdir()  # nothing was kept
            raise
        shutil.rmtree(root, ignore_errors=True)


def lasting(purpose: str) -> Path:
    """Return a folder that stays until nobody has used it for a week; the same text gives the same folder.

    Raises:
        OutputError: The folder of all scratch folders is somebody else's, or cannot be made.
    """
    parent = _parent()
    _remove_unused(parent)
    root = parent / hashlib.sha256(purpose.encode("utf-8", "surrogateescape")).hexdigest()[:24]
    with contextlib.suppress(OSError):
        os.utime(root)
    return root


def _parent() -> Path:
    """Return the folder of all scratch folders of this user, which nobody else can write to.

    Raises:
        OutputError: It is somebody else's, or cannot be made, or TMPDIR is no folder.
    """
    given = os.environ.get("TMPDIR")
    if given and not (Path(given).is_dir() and os.access(given, os.W_OK | os.X_OK)):
        # Python would take /tmp, which may be small, or in memory, or the folder that the command runs in.
        expected = "a folder that exists and can be written, for what goes to object storage or comes from there"
        problem = Problem("TMPDIR", "not-writable", given, expected, "make it, or set TMPDIR to another one")
        raise OutputError("the temporary folder cannot be used", [problem])
    folder = Path(tempfile.gettempdir()) / f"infrablend-{os.getuid()}"
    try:
        with contextlib.suppress(FileExistsError):
            folder.mkdir(mode=0o700)
        status = folder.lstat()
    except OSError as error:
        raise output_error(folder, error) from error
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o022:
        raise OutputError(
            f"{folder}: belongs to somebody else, or others may write to it; expected a folder of this user alone. "
            "Remove it, or set TMPDIR to another folder"
        )
    return folder


def _is_used(root: Path) -> bool:
    return any(is_used(folder) for folder in (root, *(f for f in root.iterdir() if f.is_dir())))


def _remove_unused(parent: Path) -> None:
    """Delete scratch folders that no process has used for a week."""
    for root in sorted(parent.iterdir()):
        try:
            old = time.time() - root.lstat().st_mtime > _UNUSED_S
            unused = old and not root.is_symlink() and root.is_dir() and not _is_used(root)
        except OSError:  # removed by another command
            continue
        if unused:
            log.info("%s: removed; nobody used it for a week", root)
            shutil.rmtree(root, ignore_errors=True)
