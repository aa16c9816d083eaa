"""Rules that all pools of workers share, wherever the workers are: when one is replaced, and what its end means."""

from __future__ import annotations

import logging
import pickle
from dataclasses import dataclass
from typing import Any

from infrablend.core.tasks import Failure, FailureKind, Task
from infrablend.errors import InfraBlendError, RenderError
from infrablend.execution.worker import ResultMessage

MIN_TASKS_BEFORE_RSS = 20  # a worker that starts above the ceiling must still get work done


@dataclass(frozen=True)
class WorkerLimits:
    """Limits and lifetimes of workers.

    Attributes:
        retries: Number of further attempts at a task after its worker crashed, hung or was lost.
        task_timeout_s: Time limit for one task, after which its worker is killed; None for no limit.
        tasks_per_worker: Number of tasks after which a worker is replaced.
        rss_ceiling_bytes: Resident memory above which a worker is replaced, but not before its 20th task.
        grace_s: Time for running tasks to finish after an interruption.
        log_level: Level of Python's logging in the workers.
    """

    retries: int = 2
    task_timeout_s: float | None = 600.0
    tasks_per_worker: int = 500
    rss_ceiling_bytes: int = 1536 * 2**20
    grace_s: float = 5.0
    log_level: int = logging.INFO

    def is_due(self, finished: int, rss_bytes: int) -> bool:
        """Return whether a worker is replaced after this many tasks, with this much memory after the last one."""
        big = finished >= MIN_TASKS_BEFORE_RSS and rss_bytes > self.rss_ceiling_bytes
        return big or finished >= self.tasks_per_worker


def value_of(done: ResultMessage, task: Task) -> tuple[Any, Failure | None]:
    """Return the value in a worker's message on a task, and the failure if there is none."""
    if done.value is None:
        return None, done.failure
    try:
        return pickle.loads(done.value), done.failure
    except Exception as error:  # for example a class that only the worker can import
        return None, Failure("error", type(error).__name__, f"the result of {task.key} is unreadable: {error}")


def start_error(failure: Failure) -> InfraBlendError:
    """Return the error of a worker's factory, which would fail again in every new worker."""
    error = failure.to_exception()
    if type(error).__name__ == failure.error:
        return error
    return RenderError(f"The renderer could not start: {error.message}", error.problems)


def loss_of(task: Task, kind: FailureKind, what: str, attempts: int, output: str) -> Failure:
    """Return the failure of a task whose worker ended in this way on its last attempt, with what it said."""
    text = f"{task.key}: its worker {what} on attempt {attempts} of {attempts}"
    return Failure(kind, "WorkerDiedError", text, traceback=output)
