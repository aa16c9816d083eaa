"""Exit codes, how errors are reported to the user, and what stops the program.

0    done
1    done, but some backgrounds or frames were skipped or failed, or no object was inserted; the reasons are listed
2    the command, the recipe or the data are wrong; nothing was written
3    the environment is at fault: a library, a device, the disk, the network, or Blender itself
70   a bug in InfraBlend; the log file has the details
130  stopped by Ctrl-C or SIGTERM
"""

from __future__ import annotations

import contextlib
import errno
import logging
import signal
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import FrameType

import typer

from infrablend.core.file_names import escape_unfit
from infrablend.core.files import output_error
from infrablend.core.operating_system import STOP_SIGNALS
from infrablend.errors import (
    ArgumentError,
    FetchError,
    InfraBlendError,
    Interrupted,
    MissingDependencyError,
    OutputError,
    Problem,
    RenderError,
    StorageError,
    format_problems,
)

PARTIAL = 1
USAGE = 2
ENVIRONMENT = 3
BUG = 70
INTERRUPTED = 130

SHOWN_PROBLEMS = 20
_DISK = {errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS}
# Of a path that the user gave, or of one below it.
_PATH = {errno.EACCES, errno.EPERM, errno.ENAMETOOLONG}

logger = logging.getLogger(__name__)

_stop_requested = False


def exit_code(error: BaseException) -> int:
    """Return the exit code for an exception that ended the command."""
    match error:
        case KeyboardInterrupt() | Interrupted():
            return INTERRUPTED
        case MissingDependencyError() | RenderError() | FetchError() | StorageError():
            return ENVIRONMENT
        case OutputError():
            # A folder that is not empty is the user's fault; a full disk is not.
            cause = error.__cause__
            # Errors that were raised in a worker have lost their cause.
            if any(p.code in {"disk-full", "not-writable"} for p in error.problems):
                return ENVIRONMENT
            return ENVIRONMENT if isinstance(cause, OSError) and cause.errno in _DISK else USAGE
        case InfraBlendError():
            return USAGE
        case _:
            return BUG


def printable(text: str) -> str:
    """Return the text with control characters, which could command the terminal, written as escapes."""
    return escape_unfit(text, keep="\n\t")


def fields_together(problems: Iterable[Problem]) -> list[Problem]:
    """Return the problems; those of recipe fields that a setting of a mode made meaningless become one, the last.

    Nobody asked for these fields: a field of another mode that the user sets is an error.
    """
    from infrablend.config.modes import DROPPED

    found = list(problems)
    others = [p for p in found if p.code != DROPPED]
    fields = [p for p in found if p.code == DROPPED]
    if len(fields) > 1:
        text = f"{len(fields)} fields of the recipe have no meaning in this mode"
        fields = [Problem("recipe", DROPPED, text, severity="warning")]
    return others + fields


def problem_lines(problems: Iterable[Problem], log_path: Path | None) -> list[str]:
    """Return the first 20 lines of `format_problems`, and a line on how many follow and where they are listed."""
    found = fields_together(problems)
    every = format_problems(found)
    lines = [f"  - {printable(line)}" for line in every[:SHOWN_PROBLEMS]]
    more = len(every) - SHOWN_PROBLEMS
    if more > 0:
        lines.append(f"  ... and {more} more" + (f"; all of them in {log_path}" if log_path else ""))
    elif len(every) < len(found) and log_path:
        lines.append(f"  each by name in {log_path}")
    return lines


def report_error(error: BaseException, log_path: Path | None) -> int:
    """Print an error on stderr, write its details to the log, and return the exit code."""
    if isinstance(error, OSError) and error.errno in _DISK:
        logger.info("the disk", exc_info=error)
        error = output_error(Path(str(error.filename or "the disk")), error)
    elif isinstance(error, OSError) and error.errno in _PATH and isinstance(error.filename, str | Path):
        logger.info("a path", exc_info=error)
        error = ArgumentError(
            f"{error.filename}: cannot be used ({error.strerror}); expected a path that this user may use. "
            "Check its name and its permissions"
        )
    code = exit_code(error)
    if code == BUG and stop_requested():
        logger.info("an error in place of the stop", exc_info=error)
        error = KeyboardInterrupt()
        code = INTERRUPTED
    if isinstance(error, KeyboardInterrupt):
        typer.echo("Stopped.", err=True)
    elif isinstance(error, InfraBlendError):
        logger.info("%s: %s", type(error).__name__, error, exc_info=error)
        for p in error.problems:  # one by one: the message groups similar ones
            logger.info("%s", p)
        head = "" if isinstance(error, Interrupted) else typer.style("Error: ", fg="red", bold=True)
        typer.echo("\n".join([head + printable(error.message), *problem_lines(error.problems, log_path)]), err=True)
    else:
        logger.info("unexpected", exc_info=error)
        where = f" Details are in {log_path}" if log_path else ""
        bug = typer.style("Unexpected error: ", fg="red", bold=True)
        typer.echo(
            f"{bug}{type(error).__name__}: {printable(str(error))}\nThis is a bug in InfraBlend.{where}", err=True
        )
    return code


@contextlib.contextmanager
def stopped_by_signals() -> Iterator[None]:
    """Raise KeyboardInterrupt where the first thread is, at Ctrl-C and SIGTERM; do nothing in other threads."""
    global _stop_requested
    _stop_requested = False
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {}
    for number in STOP_SIGNALS:
        # Whoever starts a program in the background of a shell wants Ctrl-C to be ignored.
        if number != signal.SIGINT or signal.getsignal(number) is signal.default_int_handler:
            before[number] = signal.signal(number, _stop)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)


def stop_requested() -> bool:
    """Return whether a signal came since `stopped_by_signals`: compiled code may raise another error in its place."""
    return _stop_requested


def _stop(number: int, frame: FrameType | None) -> None:
    global _stop_requested
    _stop_requested = True
    raise KeyboardInterrupt
