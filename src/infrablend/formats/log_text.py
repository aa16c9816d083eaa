"""Read the text of a log, whatever program wrote it."""

from __future__ import annotations

import stat
from pathlib import Path

from infrablend.errors import DatasetError, Problem

MAX_LOG_BYTES = 200_000_000


def read_log_text(path: Path) -> str:
    """Return the text of a log: UTF-8 with or without a mark, UTF-16 with one, else Latin-1; without null characters.

    Raises:
        DatasetError: The file is missing, not a regular file, too large or empty.
    """
    found, expected, todo = "", "a log", "check the path"
    data = b""
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            found = "not a regular file"
        elif status.st_size > MAX_LOG_BYTES:
            found, expected = f"{status.st_size / 1e6:.0f} MB", f"at most {MAX_LOG_BYTES / 1e6:.0f} MB"
            todo = "split the log"
        else:
            data = path.read_bytes()
            found = "" if data.strip() else "an empty file"
    except OSError as error:
        found = error.strerror or str(error)
    if found:
        problem = Problem(path.name, "log-unreadable", found, expected, todo)
        raise DatasetError(f"{path}: cannot be read", [problem])
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", "replace").replace("\0", "")
    data = data.replace(b"\0", b"")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")
