"""What commands show: results on stdout, as aligned lines or JSON; progress, problems and warnings on stderr."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from infrablend.cli.call_state import Session
from infrablend.cli.exits import PARTIAL, fields_together, printable, problem_lines
from infrablend.core.tasks import OnProgress, Progress
from infrablend.errors import OutputError, Problem, format_problems
from infrablend.report.figures import human_seconds

if TYPE_CHECKING:
    from infrablend.pipeline.storage.fetch import FetchProgress, OnFetch

SHOWN_WARNINGS = 5
LINE_EVERY_S = 5.0

log = logging.getLogger(__name__)


def print_result(text: str) -> None:
    """Print lines of the result on stdout, with control characters from names escaped."""
    _write(printable(text))


def print_json(data: Any) -> None:
    """Print a result as JSON on stdout; paths become text."""
    _write(json.dumps(data, indent=2, default=str, ensure_ascii=False))


def show_result(session: Session, data: Any, text: Callable[[], str]) -> None:
    """Print a result: `data` as JSON if that was asked for, else the text."""
    if session.json:
        print_json(data)
    else:
        print_result(text())


def show_report(session: Session, report: Any, record: Path, data: Any, text: Callable[[], str]) -> None:
    """Print a report's result as `show_result`, its problems on stderr; exit with 1 if something was left out.

    Args:
        session: State of the call.
        report: Report with `problems` and `ok`.
        record: File that lists all problems.
        data: Result for JSON.
        text: Result for people.
    """
    print_problems(report.problems, session.log_path, record)
    show_result(session, data, text)
    if not report.ok:
        raise typer.Exit(PARTIAL)


def _write(text: str) -> None:
    """Print a text on stdout; an `OutputError` if it cannot be written, e.g. to a file on a full disk."""
    try:
        typer.echo(text)
    except BrokenPipeError:
        raise
    except OSError as error:
        # What is left in the buffer would raise again when Python ends.
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        reason = error.strerror or str(error)
        problem = Problem("stdout", "not-writable", reason, "", "repeat the command with another output", "error")
        message = "the result could not be printed; files that the command wrote are complete"
        raise OutputError(message, [problem]) from error


def print_problems(problems: Iterable[Problem], log_path: Path | None, record: Path) -> None:
    """Print problems on stderr: errors first, then a few warnings; `record` is the file that lists them all."""
    found = list(problems)
    for p in found:
        log.info("%s: %s", p.severity, p)
    errors = [p for p in found if p.severity == "error"]
    warnings = format_problems(sorted(fields_together({p for p in found if p.severity != "error"})))
    if errors:
        lines = problem_lines(errors, log_path)
        typer.echo("\n".join([f"{len(errors)} problem(s):", *lines]), err=True)
    print_warnings(warnings, f"all in {record}")


def print_warnings(warnings: Sequence[str], where: str) -> None:
    """Print the first warnings on stderr, and where to find all."""
    if warnings:
        lines = [f"  - {p}" for p in warnings[:SHOWN_WARNINGS]]
        if len(warnings) > SHOWN_WARNINGS:
            lines.append(f"  ... and {len(warnings) - SHOWN_WARNINGS} more, {where}")
        typer.echo(printable("\n".join([f"{len(warnings)} warning(s):", *lines])), err=True)


def table(rows: Mapping[str, str]) -> str:
    """Return lines of two aligned columns; empty for no rows."""
    width = max((len(k) for k in rows), default=0)
    return "\n".join(f"{k:<{width}}  {v}".rstrip() for k, v in rows.items())


def grid(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return lines of aligned columns under a header: the first column left-aligned, the others right-aligned."""
    lines = [[str(cell) for cell in row] for row in (header, *rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(header))]
    return "\n".join(
        "  ".join(
            c.ljust(w) if k == 0 else c.rjust(w) for k, (c, w) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


def loss_lines(losses: Mapping[str, int]) -> list[str]:
    """Return a line for each kind of loss, from counts by kind or by `<form>.<kind>`."""
    from infrablend.formats.losses import LOSSES

    by_kind: dict[str, list[str]] = {}
    for key, n in losses.items():
        of, _, kind = key.rpartition(".")
        by_kind.setdefault(kind, []).append(f"{of} {n}".lstrip())
    return [f"lost: {kind} {', '.join(counts)}: {LOSSES[kind]}" for kind, counts in by_kind.items()]


def losses_by_format(losses: Mapping[str, int], record: str) -> list[str]:
    """Return one line that says which of several formats lose something, from counts by `<format>.<kind>`; or none.

    What they lose is in the record, under `losses`, and in words on the card.
    """
    named = ", ".join(f"{name} ({n})" for name, n in Counter(key.rpartition(".")[0] for key in losses).items())
    line = f"lost: kinds of facts that a format cannot hold, in {named}, in no other: README.md, `losses` in {record}"
    return [line] if losses else []


def facts(data: Mapping[str, object]) -> dict[str, str]:
    """Return the rows for `table` of a mapping of plain values: units come from the names, lists become lengths.

    Nested mappings are joined into one line; None and empty values are left out.
    """
    rows = {}
    for key, value in data.items():
        if value is None or value in ({}, [], ()):
            continue
        name, text = _fact(key, value)
        rows[name] = text
    return rows


def _fact(key: str, value: Any) -> tuple[str, str]:
    stem, _, unit = key.rpartition("_")
    numeric = isinstance(value, int | float) and not isinstance(value, bool)
    if numeric and stem and unit == "bytes":
        return _words(stem), human_bytes(value)
    if numeric and stem and unit == "s" and not stem.endswith("_per"):
        return _words(stem), human_seconds(value)
    if isinstance(value, Mapping):
        if any(isinstance(v, Mapping) for v in value.values()):
            return _words(key), "; ".join(f"{k}: {_fact(str(k), v)[1] or 'none'}" for k, v in value.items())
        return _words(key), ", ".join(f"{k} {_fact(str(k), v)[1]}" for k, v in value.items())
    if isinstance(value, list | tuple):
        if all(isinstance(v, str | int | float) for v in value) and len(value) <= 8:
            return _words(key), ", ".join(str(v) for v in value)
        return _words(key), str(len(value))
    if isinstance(value, bool):
        return _words(key), "yes" if value else "no"
    return _words(key), f"{value:g}" if isinstance(value, float) else str(value)


def _words(key: str) -> str:
    return key.replace("_", " ")


def human_bytes(n: float) -> str:
    """Format a number of bytes, e.g. `1.4 GiB`."""
    for unit in ("B", "KiB", "MiB", "GiB"):
        if abs(n) < 1024:
            return f"{n:.0f} {unit}" if unit == "B" else f"{n:.1f} {unit}"
        n /= 1024
    return f"{n:.1f} TiB"


def pace_text(frames_per_s: float, unit: str = "frames") -> str:
    """Return, for example, `9.8 frames/s`, or `4.2 frames/min` below one frame per second; empty for no rate."""
    if frames_per_s == 0:
        return ""
    if frames_per_s < 1:
        return f"{60 * frames_per_s:.1f} {unit}/min"
    return f"{frames_per_s:.1f} {unit}/s"


def progress_line(p: Progress, unit: str = "frames") -> str:
    """Return, for example, `120/3738 frames, 9.8 frames/s, 6 min 09 s to go, inserted 118, skipped 2`."""
    parts = [f"{p.done}/{p.total} {unit}"]
    if pace := pace_text(p.frames_per_s, unit):
        parts.append(pace)
    if p.eta_s is not None and p.done < p.total:
        parts.append(f"{human_seconds(p.eta_s)} to go")
    return ", ".join(parts + [f"{name} {n}" for name, n in p.counts.items()])


class LineProgress:
    """Writer of progress lines: at the first call, every few seconds, and when everything is done."""

    def __init__(
        self,
        write: Callable[[str], None],
        text: Callable[[Any], str] = progress_line,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._write = write
        self._text = text
        self._clock = clock
        self._next_at = clock()
        self._finished = False

    def __call__(self, p: Progress | FetchProgress) -> None:
        """Write a line if one is due."""
        was_finished = self._finished
        self._finished = p.total is not None and p.done >= p.total
        if not was_finished and (self._finished or self._clock() >= self._next_at):
            self._write(self._text(p))
            self._next_at = self._clock() + LINE_EVERY_S


@contextlib.contextmanager
def shown_progress(session: Session, what: str, unit: str = "frames") -> Iterator[OnProgress | None]:
    """Yield a callable that shows progress in a unit, or None if progress is off."""
    if session.quiet:
        yield None
    elif not session.console.is_terminal:
        yield LineProgress(session.tell, partial(progress_line, unit=unit))
    else:
        with _live_bar(session, what, unit) as show:
            yield show


@contextlib.contextmanager
def _live_bar(session: Session, what: str, unit: str) -> Iterator[OnProgress]:
    from rich.progress import BarColumn, MofNCompleteColumn, SpinnerColumn, TextColumn
    from rich.progress import Progress as Bar

    bar = Bar(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(bar_width=None),
        MofNCompleteColumn(),
        TextColumn("{task.fields[pace]}"),
        TextColumn("{task.fields[counts]}"),
        console=session.console,
        transient=False,
        refresh_per_second=8,
    )
    with bar:
        row = bar.add_task(what, total=None, pace="reading", counts="")

        def show(p: Progress) -> None:
            pace = pace_text(p.frames_per_s, unit)
            if p.eta_s is not None and p.done < p.total:
                pace += f", {human_seconds(p.eta_s)} to go"
            counts = " ".join(f"{name} {n}" for name, n in p.counts.items())
            bar.update(row, completed=p.done, total=p.total, pace=pace, counts=counts)

        yield show


def fetch_line(p: FetchProgress) -> str:
    """Return, for example, `train.zip: 1.2 GiB of 2.1 GiB`, or the number of unpacked files."""
    if p.step == "unpack":
        return f"{p.file}: {p.done}{'' if p.total is None else f' of {p.total}'} files unpacked"
    return f"{p.file}: {human_bytes(p.done)}" + ("" if p.total is None else f" of {human_bytes(p.total)}")


@contextlib.contextmanager
def shown_fetch(session: Session) -> Iterator[OnFetch | None]:
    """Yield a callable that shows progress, or None if progress is off."""
    if session.quiet:
        yield None
    elif session.console.is_terminal:
        from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        text = TextColumn("{task.description}", markup=False)
        with Bar(SpinnerColumn(), BarColumn(), text, TimeRemainingColumn(), console=session.console) as bar:
            row = bar.add_task("connecting", total=None)
            yield lambda p: bar.update(row, completed=p.done, total=p.total, description=fetch_line(p))
    else:
        yield LineProgress(session.tell, fetch_line)
