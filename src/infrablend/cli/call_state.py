"""State of one call of the program: the console, the log file, and the output format."""

from __future__ import annotations

import contextlib
import logging
import os
import re
import stat
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from infrablend.cli.exits import printable
from infrablend.core.addresses import require_folder, without_user
from infrablend.core.files import state_folder
from infrablend.errors import ArgumentError

if TYPE_CHECKING:
    from rich.console import Console

LOG_SIZE_BYTES = 5_000_000  # a longer log is renamed and a new one started

logger = logging.getLogger(__name__)


@dataclass
class Session:
    """One call of the program.

    Attributes:
        console: Console on stderr.
        log_path: Log file, or None if none could be opened.
        quiet: True to show no progress.
        json: True to write results and errors to stdout as JSON.
    """

    console: Console
    log_path: Path | None
    quiet: bool = False
    json: bool = False

    def tell(self, line: str) -> None:
        """Print a line on stderr."""
        self.console.print(line, markup=False, soft_wrap=True)


class _ConsoleHandler(logging.Handler):
    """Writes log lines through the console, so that they do not break its live progress bar."""

    def __init__(self, console: Console) -> None:
        super().__init__()
        self._console = console
        self._warned: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        try:
            line = printable(self.format(record))
            if record.levelno == logging.WARNING:  # shown once; stages of an experiment repeat them
                if line in self._warned:
                    return
                self._warned.add(line)
            self._console.print(line, markup=False, highlight=False, soft_wrap=True)
        except Exception:
            self.handleError(record)


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


@contextlib.contextmanager
def open_session(verbose: bool, quiet: bool, log: Path | None) -> Iterator[Session]:
    """Open a session with logging: INFO and above to the file, warnings to stderr (INFO if `verbose`)."""
    from rich.console import Console

    console = Console(stderr=True, highlight=False)
    root = logging.getLogger()
    level_before = root.level
    root.setLevel(logging.INFO)
    screen = _ConsoleHandler(console)
    screen.setLevel(logging.INFO if verbose else logging.WARNING)
    screen.setFormatter(logging.Formatter("%(levelname)s: %(message)s"))
    handlers: list[logging.Handler] = [screen]
    log_path = _usable(log or default_log_path())
    if log_path is not None:
        file = LogFileHandler(log_path)
        file.setFormatter(logging.Formatter("%(asctime)s %(process)d %(levelname)s %(name)s: %(message)s"))
        handlers.append(file)
    for h in handlers:
        root.addHandler(h)
    logging.captureWarnings(True)
    try:
        logger.info("infrablend %s", without_user(" ".join(sys.argv[1:])))
        yield Session(console, log_path, quiet)
    finally:
        logging.captureWarnings(False)
        for h in handlers:
            root.removeHandler(h)
            h.close()
        root.setLevel(level_before)


def _may_be_log(path: Path) -> bool:
    """Return whether a path is free, or a device, or a file that is empty or begins like a log."""
    try:
        mode = path.stat().st_mode
        if stat.S_ISCHR(mode) or stat.S_ISDIR(mode):  # the latter cannot be opened, and another file is used
            return True
        if not stat.S_ISREG(mode):
            return False
        with path.open("rb") as stream:
            start = stream.read(5)
    except OSError:
        return True
    return not start or bool(re.fullmatch(rb"\d{4}-", start))


def default_log_path() -> Path:
    """Return `$INFRABLEND_LOG`, or `infrablend.log` in the user's state folder."""
    given = os.environ.get("INFRABLEND_LOG")
    return Path(given) if given else state_folder() / "infrablend.log"


def _usable(path: Path) -> Path | None:
    """Return the path if it can be written, else a file in the temporary folder, else None.

    Raises:
        ArgumentError: It is an address, or something else than a log of InfraBlend, e.g. a record of a dataset.
    """
    require_folder("log", path)
    if not _may_be_log(path):
        raise ArgumentError(
            f"{path}: not a log of InfraBlend; nothing was written to it. Give another file for the log"
        )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("ab") as f:
            size_bytes = f.tell()
        if size_bytes > LOG_SIZE_BYTES:
            path.replace(path.with_name(path.name + ".1"))
        return path
    except OSError:
        try:
            fd, name = tempfile.mkstemp(prefix="infrablend-", suffix=".log")
        except OSError:
            return None
        os.close(fd)
        return Path(name)
