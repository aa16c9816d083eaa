"""The executor's port: tasks in, results out in the order in which they finish.

A task is a small picklable thing with a stable key. What is heavy (Blender, loaded models) is made once per
worker by a factory, which is given by its dotted name so that the parent need not import it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

from infrablend import errors
from infrablend.errors import InfraBlendError, Problem, RenderError, WorkerDiedError

FailureKind = Literal["error", "crash", "timeout"]


@dataclass(frozen=True)
class Task:
    """A piece of work.

    Attributes:
        key: Names the task in results, logs and errors; stable from run to run (a frame id).
        payload: What the work needs, picklable and small (kilobytes).
    """

    key: str
    payload: Any = None


@dataclass(frozen=True)
class Failure:
    """Why a task gave no value, in plain picklable data.

    Attributes:
        kind: `error`: the task raised; `crash`: its worker died; `timeout`: its worker hung and was ended.
        error: Name of the exception class.
        message: For people, one sentence.
        problems: Of an `InfraBlendError`; empty otherwise.
        traceback: Of the exception, or the last lines that a dead worker wrote; may be empty.
    """

    kind: FailureKind
    error: str
    message: str
    problems: tuple[Problem, ...] = ()
    traceback: str = ""

    def to_exception(self) -> InfraBlendError:
        """The failure as an exception: of the class that was raised if it is one of ours, else `RenderError`."""
        known = getattr(errors, self.error, None)
        if isinstance(known, type) and issubclass(known, InfraBlendError):
            return known(self.message, self.problems)
        if self.kind != "error":
            return WorkerDiedError(self.message, self.problems)
        return RenderError(f"{self.error}: {self.message}", self.problems)


@dataclass(frozen=True)
class TaskResult:
    """What became of a task: `value` if `failure` is None.

    Attributes:
        key: Of the task.
        value: What the worker's callable returned.
        failure: Why there is no value, or None.
        attempts: How often the task was begun; more than 1 after a crash or a hang.
        seconds: Wall-clock time in the worker, for the run record only.
        worker: Number of the worker, from 0; new workers get new numbers.
        rss_bytes: Resident memory of the worker after the task; 0 if it died.
    """

    key: str
    value: Any = None
    failure: Failure | None = None
    attempts: int = 1
    seconds: float = 0.0
    worker: int = 0
    rss_bytes: int = 0

    @property
    def ok(self) -> bool:
        """True if there is a value."""
        return self.failure is None


@dataclass(frozen=True)
class WorkerSpec:
    """How a worker is made.

    Attributes:
        factory: Dotted name `module:function`. Called once in each worker with `settings`; returns a callable
            `task -> picklable value`. If that callable has a `close()`, it is called before the worker ends.
        settings: Picklable.
    """

    factory: str
    settings: Any = None


WorkerFactory = Callable[[Any], Callable[[Task], Any]]


class Executor(Protocol):
    """Runs tasks. The same values come out whatever the executor, the number of workers and the order."""

    def run(self, tasks: Iterable[Task]) -> Iterator[TaskResult]:
        """Results in the order of completion, one for each task; `tasks` is read as workers become free.

        A task that raises gives a failed result; it does not stop the run. Closing the iterator ends the workers.

        Raises:
            Interrupted: After the first SIGINT or SIGTERM, once running tasks have finished or were given up;
                their results come first. A second signal raises `KeyboardInterrupt` at once.
            InfraBlendError: If workers cannot start: the factory's own error, or `RenderError`.
        """
        ...


@dataclass(frozen=True)
class Progress:
    """How far a run is.

    Attributes:
        done: Frames finished, those of an earlier, resumed run included.
        total: Frames of the whole run.
        frames_per_s: Of this run; 0 before the first frame.
        eta_s: Seconds to go, or None if not known yet.
        counts: What became of the frames, e.g. `{"inserted": 40, "skipped": 1, "failed": 0}`.
    """

    done: int
    total: int
    frames_per_s: float = 0.0
    eta_s: float | None = None
    counts: Mapping[str, int] = field(default_factory=dict)


OnProgress = Callable[[Progress], None]


def paced(on_progress: OnProgress | None) -> Callable[[int, int], None] | None:
    """Return a callback `(done, total)` for a plain loop that calls `on_progress` with rate and remaining time."""
    if on_progress is None:
        return None
    started = time.monotonic()

    def report(done: int, total: int) -> None:
        rate = done / max(time.monotonic() - started, 1e-9)
        on_progress(Progress(done, total, rate, (total - done) / rate))

    return report
