"""Runs all tasks in this process, one after the other: for debugging, tests and small runs."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from pathlib import Path
from typing import Any

from infrablend.core.child_process import resident_bytes
from infrablend.core.tasks import Task, TaskResult, WorkerSpec
from infrablend.errors import InfraBlendError, Interrupted, RenderError
from infrablend.execution.interrupt import STOPPED, Interruption
from infrablend.execution.worker import close_callable, failure_of, make_callable


class Serial:
    """Executor without worker processes.

    A crash or a hang of a task is one of the whole program.
    """

    def __init__(self, worker: WorkerSpec, log_path: Path | None = None) -> None:
        """Append what the tasks print from C to `log_path`, or drop it if None."""
        self._worker = worker
        self._log_path = log_path

    def run(self, tasks: Iterable[Task]) -> Generator[TaskResult, None, None]:
        """Run tasks and yield their results, see `core.tasks.Executor`."""
        with Interruption() as stop:
            try:
                with _stdout_to(self._log_path):
                    work = make_callable(self._worker)
            except InfraBlendError:
                raise
            except Exception as e:
                raise RenderError(f"The renderer could not start: {type(e).__name__}: {e}") from e
            try:
                for task in tasks:
                    if stop.requested:
                        raise Interrupted(STOPPED)
                    yield _performed(work, task, self._log_path)
            finally:
                close_callable(work)


class WarmSerial:
    """`WarmPool` without worker processes: the callable is created with the first task and kept between calls."""

    def __init__(self, worker: WorkerSpec) -> None:
        self._worker = worker
        self._work: Callable[[Task], Any] | None = None

    def start(self, workers: int = 1) -> None:
        """Create the callable."""
        if self._work is None:
            self._work = make_callable(self._worker)

    def run(self, tasks: Iterable[Task]) -> Generator[TaskResult, None, None]:
        """Run tasks in their order and yield their results."""
        self.start()
        assert self._work is not None
        for task in tasks:
            yield _performed(self._work, task, None)

    def close(self) -> None:
        """Close the callable."""
        if self._work is not None:
            close_callable(self._work)
            self._work = None


def _performed(work: Callable[[Task], Any], task: Task, log_path: Path | None) -> TaskResult:
    begun = time.monotonic()
    value, failure = None, None
    try:
        with _stdout_to(log_path):
            value = work(task)
    except (Exception, SystemExit) as e:
        failure = failure_of(e)
    seconds, rss_bytes = time.monotonic() - begun, resident_bytes()
    return TaskResult(task.key, value, failure, seconds=seconds, rss_bytes=rss_bytes)


@contextlib.contextmanager
def _stdout_to(path: Path | None) -> Iterator[None]:
    """Redirect file descriptor 1 to a file: Blender prints to it from C, but stdout is for results.

    Descriptor 2 stays, because a progress bar may be drawn on it.
    """
    sys.stdout.flush()
    kept = os.dup(1)
    sink = os.open(path or os.devnull, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
    try:
        os.dup2(sink, 1)
        yield
    finally:
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).fflush(None)
        sys.stdout.flush()
        os.dup2(kept, 1)
        os.close(kept)
        os.close(sink)
