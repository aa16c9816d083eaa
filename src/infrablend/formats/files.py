"""Writing files whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from pathlib import Path

from infrablend.errors import OutputError, Problem

# What os.link answers where hard links do not exist or are not allowed; anything else is a real error.
_NO_LINK = {errno.EXDEV, errno.EPERM, errno.EACCES, errno.EMLINK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL}


def part_path(path: Path) -> Path:
    """The name a file has while it is being written: hidden, beside the final one, so that renaming is atomic."""
    return path.with_name(f".{path.name}.part")


def output_error(path: Path, error: OSError) -> OutputError:
    """The `OutputError` for a failed write of `path`."""
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    todo = "free some space and run again with --resume" if full else "check the folder and its permissions"
    problem = Problem(str(path), "disk-full" if full else "not-writable", error.strerror or str(error), todo=todo)
    return OutputError(f"cannot write {path}: {error.strerror or error}", [problem])


def _discard(part: Path) -> None:
    """Remove a half-written file; where even that fails, the first error is the one to tell."""
    with contextlib.suppress(OSError):
        part.unlink(missing_ok=True)


def write_bytes(path: Path, data: bytes) -> Path:
    """Write `data` to `path` atomically (beside, then renamed), making parent folders.

    Raises:
        OutputError: The folder cannot be written or the disk is full; an older file stays as it was.
    """
    part = part_path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_bytes(data)
        part.replace(path)
    except OSError as error:
        _discard(part)
        raise output_error(path, error) from error
    return path


def write_text(path: Path, text: str) -> Path:
    """Write UTF-8 text with LF line ends atomically; errors as in `write_bytes`."""
    return write_bytes(path, text.encode("utf-8"))


def link_or_copy(source: Path, target: Path) -> Path:
    """Make `target` a hard link of `source`, or a copy where links are impossible; atomic, makes folders.

    Raises:
        OutputError: Neither worked.
    """
    part = part_path(target)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        real = Path(os.path.realpath(source))
        # Renaming one link of a file over another does nothing at all, so the case is settled before.
        if target.exists() and not target.is_symlink() and target.samefile(real):
            return target
        part.unlink(missing_ok=True)
        try:
            os.link(real, part)
        except OSError as error:
            if error.errno not in _NO_LINK:
                raise
            shutil.copyfile(real, part)
        part.replace(target)
    except OSError as error:
        _discard(part)
        raise output_error(target, error) from error
    return target
