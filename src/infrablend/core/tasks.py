"""Interface of executors: they take tasks and yield results in the order of completion.

A task is a small picklable value with a stable key. Heavy state (Blender, loaded models) is created once per worker by
a factory, which is referred to by its dotted name so that the parent process does not import it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, Protocol

from infrablend import errors
from infrablend.errors import InfraBlendError, Problem, RenderError, WorkerDiedError

FailureKind = Literal["error", "crash", "timeout"]

# A rate over less time than this says nothing.
_FIRST_MOMENT_S = 0.05


@dataclass(frozen=True)
class Task:
    """A unit of work.

    Attributes:
        key: Name of the task in results, logs and errors; the same in every run (a frame id).
        payload: Input of the work, picklable and small (kilobytes).
    """

    key: str
    payload: Any = None


@dataclass(frozen=True)
class Failure:
    """Reason why a task has no value, as picklable data.

    Attributes:
        kind: `error`: the task raised; `crash`: its worker died; `timeout`: its worker hung and was killed.
        error: Name of the exception class.
        message: One sentence for people.
        problems: Problems of an `InfraBlendError`; empty otherwise.
        traceback: Traceback of the exception, or the last output of a dead worker; may be empty.
    """

    kind: FailureKind
    error: str
    message: str
    problems: tuple[Problem, ...] = ()
    traceback: str = ""

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values, without the traceback."""
        problems = [p.to_json() for p in self.problems]
        return {"kind": self.kind, "error": self.error, "message": self.message, "problems": problems}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Failure:
        """Return the failure from JSON values written by `to_json`.

        Raises:
            LookupError, TypeError, AttributeError: The values are damaged.
        """
        problems = tuple(Problem(**p) for p in data["problems"])
        return cls(data["kind"], data["error"], data["message"], problems, data.get("traceback", ""))

    def to_exception(self) -> InfraBlendError:
        """Return the failure as an exception: of the raised class if it is one of ours, else a `RenderError`."""
        known = getattr(errors, self.error, None)
        if isinstance(known, type) and issubclass(known, InfraBlendError):
            return known(self.message, self.problems)
        if self.kind != "error":
            return WorkerDiedError(self.message, self.problems)
        return RenderError(f"{self.error}: {self.message}", self.problems)


@dataclass(frozen=True)
class TaskResult:
    """Outcome of a task: a value, or a failure.

    Attributes:
        key: Key of the task.
        value: Return value of the worker's callable.
        failure: Reason for a missing value, or None.
        attempts: Number of attempts; more than 1 after a crash or a hang.
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
        """Whether there is a value."""
        return self.failure is None


@dataclass(frozen=True)
class WorkerSpec:
    """Recipe for a worker.

    Attributes:
        factory: Dotted name `module:function`. Called once per worker with `settings`; returns a callable
            `task -> picklable value`. If that callable has a `close()`, it is called before the worker ends.
        settings: Picklable argument of the factory.
    """

    factory: str
    settings: Any = None


class Executor(Protocol):
    """Runner of tasks. Values depend neither on the executor, nor on the number of workers, nor on the order."""

    def run(self, tasks: Iterable[Task]) -> Iterator[TaskResult]:
        """Yield one result per task in the order of completion; `tasks` is read as workers become free.

        A task that raises yields a failed result; it does not stop the run. Closing the iterator ends the workers.

        Raises:
            Interrupted: After the first SIGINT or SIGTERM, once running tasks have finished or were abandoned;
                their results come first. A second signal raises `KeyboardInterrupt` at once.
            InfraBlendError: Workers cannot start: the factory's own error, or `RenderError`.
        """
        ...


@dataclass(frozen=True)
class Progress:
    """Progress of a run.

    Attributes:
        done: Number of finished frames, including those of an earlier, resumed run.
        total: Number of frames of the whole run.
        frames_per_s: Frames per second of this run; 0 before the first frame.
        eta_s: Remaining seconds, or None if not known yet.
        counts: Number of frames per outcome, e.g. `{"inserted": 40, "skipped": 1, "failed": 0}`.
    """

    done: int
    total: int
    frames_per_s: float = 0.0
    eta_s: float | None = None
    counts: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def since(cls, started: float, done: int, total: int, counts: Mapping[str, int] = MappingProxyType({})) -> Progress:
        """Return the progress of a loop that began at `started`, monotonic clock; no rate in its first moment."""
        seconds = time.monotonic() - started
        rate = done / seconds if seconds >= _FIRST_MOMENT_S else 0.0
        return cls(done, total, rate, (total - done) / rate if rate > 0 else None, counts)


OnProgress = Callable[[Progress], None]


def paced(on_progress: OnProgress | None) -> Callable[[int, int], None] | None:
    """Return a callback `(done, total)` for a plain loop that calls `on_progress` with rate and remaining time."""
    if on_progress is None:
        return None
    started = time.monotonic()

    def report(done: int, total: int) -> None:
        on_progress(Progress.since(started, done, total))

    return report
