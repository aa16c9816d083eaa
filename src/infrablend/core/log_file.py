"""Log files that are appended to."""

from __future__ import annotations

import contextlib
import logging
from pathlib import Path

from infrablend.core.addresses import without_user


class LogFileHandler(logging.FileHandler):
    """Handler that appends to a file and ignores write errors.

    A full disk ends a command with one clear error, or does not concern it, without tracebacks of the log.
    """

    def __init__(self, path: Path) -> None:
        """Open the file.

        Raises:
            OSError: It cannot be opened.
        """
        super().__init__(path, encoding="utf-8", errors="backslashreplace")

    def format(self, record: logging.LogRecord) -> str:
        """Return the text of a record, without secrets in addresses, which messages of libraries may have."""
        return without_user(super().format(record))

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - logging's name
        """Ignore the error."""

    def close(self) -> None:
        """Close the file; what cannot be written any more is lost."""
        with contextlib.suppress(OSError):
            super().close()
