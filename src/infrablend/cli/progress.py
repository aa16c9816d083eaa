"""Progress on stderr: a live bar on a terminal, a plain line every few seconds anywhere else."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from infrablend.cli.results import human_bytes
from infrablend.core.tasks import OnProgress, Progress
from infrablend.report.figures import human_seconds

if TYPE_CHECKING:
    from infrablend.cli.session import Session
    from infrablend.fetching.fetch import FetchProgress, OnFetch

LINE_EVERY_S = 5.0


def pace_text(frames_per_s: float) -> str:
    """Return, for example, `9.8 frames/s`, or `4.2 frames/min` below one frame per second; empty for no rate."""
    if frames_per_s == 0:
        return ""
    if frames_per_s < 1:
        return f"{60 * frames_per_s:.1f} frames/min"
    return f"{frames_per_s:.1f} frames/s"


def progress_line(p: Progress) -> str:
    """Return, for example, `120/3738 frames, 9.8 frames/s, 6 min 09 s to go, inserted 118, skipped 2`."""
    parts = [f"{p.done}/{p.total} frames"]
    if pace := pace_text(p.frames_per_s):
        parts.append(pace)
    if p.eta_s is not None and p.done < p.total:
        parts.append(f"{human_seconds(p.eta_s)} to go")
    return ", ".join(parts + [f"{name} {n}" for name, n in p.counts.items()])


class LineProgress:
    """Writer of progress lines: at the first frame, every few seconds, and at the last."""

    def __init__(self, write: Callable[[str], None], clock: Callable[[], float] = time.monotonic) -> None:
        self._write = write
        self._clock = clock
        self._next_at = clock()
        self._finished = False

    def __call__(self, p: Progress) -> None:
        """Write a line if one is due."""
        last = p.done >= p.total and not self._finished
        if last or (self._clock() >= self._next_at and not self._finished):
            self._write(progress_line(p))
            self._next_at = self._clock() + LINE_EVERY_S
        self._finished = p.done >= p.total


@contextlib.contextmanager
def shown_progress(session: Session, what: str) -> Iterator[OnProgress | None]:
    """Yield a callable that shows progress, or None if progress is off."""
    if session.quiet:
        yield None
    elif not session.console.is_terminal:
        console = session.console
        yield LineProgress(lambda line: console.print(line, markup=False, soft_wrap=True))
    else:
        with _live_bar(session, what) as show:
            yield show


@contextlib.contextmanager
def _live_bar(session: Session, what: str) -> Iterator[OnProgress]:
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
            pace = pace_text(p.frames_per_s)
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
        next_at = 0.0

        def show(p: FetchProgress) -> None:
            nonlocal next_at
            if time.monotonic() >= next_at or p.done == p.total:
                session.console.print(fetch_line(p), markup=False, soft_wrap=True)
                next_at = time.monotonic() + LINE_EVERY_S

        yield show
