"""Runs all tasks in this process, one after the other: for debugging, tests and small runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable
from typing import Any

from infrablend.core.operating_system import resident_bytes
from infrablend.core.tasks import Task, TaskResult, WorkerSpec
from infrablend.errors import InfraBlendError, Interrupted, RenderError
from infrablend.pipeline.execution.interrupt import STOPPED, Interruption
from infrablend.pipeline.execution.worker import close_callable, failure_of, make_callable


class Serial:
    """Executor without worker processes.

    A crash or a hang of a task is one of the whole program.
    """

    def __init__(self, worker: WorkerSpec) -> None:
        """Keep the recipe for the worker; it is made with `run`."""
        self._worker = worker

    def run(self, tasks: Iterable[Task]) -> Generator[TaskResult, None, None]:
        """Run tasks and yield their results, see `core.tasks.Executor`."""
        with Interruption() as stop:
            try:
                work = make_callable(self._worker)
            except InfraBlendError:
                raise
            except Exception as e:
                raise RenderError(f"The renderer could not start: {type(e).__name__}: {e}") from e
            try:
                for task in tasks:
                    if stop.requested:
                        raise Interrupted(STOPPED)
                    yield _performed(work, task)
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
            yield _performed(self._work, task)

    def close(self) -> None:
        """Close the callable."""
        if self._work is not None:
            close_callable(self._work)
            self._work = None


def _performed(work: Callable[[Task], Any], task: Task) -> TaskResult:
    begun = time.monotonic()
    value = None
    failure = None
    try:
        value = work(task)
    except (Exception, SystemExit) as e:
        failure = failure_of(e)
    seconds = time.monotonic() - begun
    rss_bytes = resident_bytes()
    return TaskResult(task.key, value, failure, seconds=seconds, rss_bytes=rss_bytes)
