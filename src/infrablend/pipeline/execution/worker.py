"""The worker process: creates its callable once, runs tasks until told to stop, and leaves nothing behind.

`main` is the whole life of a worker process. It exchanges pickled tuples with the parent, over its stdin and stdout:

 parent -> worker   StartMessage; then ("task", index, Task), ("finish",) after the last, ("stop",) to drop what waits
 worker -> parent   ("ready",) or ("no-start", Failure); then ("done", index, ResultMessage) for each task, in order

The second part has the rules that all pools share, wherever their workers are: when a worker is replaced, and what its
end means.
"""

from __future__ import annotations

import contextlib
import faulthandler
import importlib
import logging
import os
import pickle
import queue
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from infrablend.core.operating_system import STOP_SIGNALS, die_with_parent, flush_c_output, resident_bytes
from infrablend.core.tasks import Failure, FailureKind, Task, WorkerSpec
from infrablend.errors import InfraBlendError, RenderError

logger = logging.getLogger(__name__)

# A worker is one process with one thread: libraries must not start threads of their own.
ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENCV_FOR_THREADS_NUM": "1",
}
MIN_TASKS_BEFORE_RSS = 20  # a worker that starts above the ceiling must still get work done


@dataclass(frozen=True)
class StartMessage:
    """First message to a new worker. `spec` is a pickled `WorkerSpec`."""

    number: int
    spec: bytes
    parent_pid: int
    die_with_parent: bool
    log_level: int


@dataclass(frozen=True)
class ResultMessage:
    """Message of a worker about a task: a pickled value or a failure."""

    value: bytes | None
    failure: Failure | None
    seconds: float
    rss_bytes: int


def failure_of(error: BaseException) -> Failure:
    """Return the failure that describes an exception, with its traceback as text."""
    text = "".join(traceback.format_exception(error))
    name = type(error).__name__
    if isinstance(error, InfraBlendError):
        return Failure("error", name, error.message, error.problems, text)
    return Failure("error", name, str(error) or name, (), text)


def make_callable(spec: WorkerSpec) -> Callable[[Task], Any]:
    """Import a worker factory and call it with its settings.

    Raises:
        ValueError: The dotted name is not `module:function` or names nothing callable.
    """
    module, _, name = spec.factory.partition(":")
    if not module or not name:
        raise ValueError(f"factory is {spec.factory!r}, expected 'module:function'")
    factory = getattr(importlib.import_module(module), name, None)
    if not callable(factory):
        raise ValueError(f"factory {spec.factory!r}: {module} has no function {name}")
    work = factory(spec.settings)
    if not callable(work):
        raise ValueError(f"factory {spec.factory!r} returned {type(work).__name__}, expected a callable")
    if "cv2" in sys.modules:
        sys.modules["cv2"].setNumThreads(1)
    return work  # type: ignore[no-any-return]


def close_callable(work: Callable[[Task], Any]) -> None:
    """Call `work.close()` if there is one; log an error in it, since every result has been delivered by then."""
    close = getattr(work, "close", None)
    if callable(close):
        try:
            close()
        except Exception:
            logger.exception("closing the worker's callable failed")


def _ignore_signals() -> None:
    # The parent decides what Ctrl-C means. Repeated after imports that install handlers of their own.
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _exit_at_once(code: int) -> None:
    """End the process at once: libraries may hang or crash during the tear-down of Python or C."""
    with contextlib.suppress(Exception):
        logging.shutdown()
        sys.stdout.flush()
        sys.stderr.flush()
        flush_c_output()
    os._exit(code)


def send(pipe: IO[bytes], message: Any) -> None:
    """Send a message through a pipe."""
    pickle.dump(message, pipe, pickle.HIGHEST_PROTOCOL)
    pipe.flush()


def _take_pipes() -> tuple[IO[bytes], IO[bytes]]:
    """Return the pipes from and to the parent; stdin is empty from now on, and what is printed goes to stderr."""
    pipes = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    with Path(os.devnull).open("rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)
    return pipes


def _read(pipe: IO[bytes], inbox: queue.SimpleQueue[tuple[int, Task] | None]) -> None:
    """Move tasks from the pipe to `inbox`, and end the process when the parent is gone.

    It runs in a thread of its own, so that the parent never blocks on a full pipe and its death is noticed during a
    task.
    """
    while True:
        try:
            message = pickle.load(pipe)
        except Exception:
            os._exit(1)
        if message[0] == "stop":
            with contextlib.suppress(queue.Empty):
                while True:
                    inbox.get_nowait()
        inbox.put(message[1:] if message[0] == "task" else None)


def perform(work: Callable[[Task], Any], task: Task) -> ResultMessage:
    """Perform a task; whatever it raises becomes a failure."""
    value: bytes | None = None
    failure = None
    begun = time.monotonic()
    try:
        value = pickle.dumps(work(task), pickle.HIGHEST_PROTOCOL)
    except BaseException as e:  # SystemExit too: the worker must outlive its task
        failure = failure_of(e)
    return ResultMessage(value, failure, time.monotonic() - begun, resident_bytes())


def main() -> None:
    """Serve as a worker of the parent at the other end of stdin and stdout; does not return."""
    _ignore_signals()
    faulthandler.enable()
    orders, answers = _take_pipes()
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    hello: StartMessage = pickle.load(orders)
    if hello.die_with_parent:
        die_with_parent(hello.parent_pid)
    logging.basicConfig(level=hello.log_level, format="%(levelname)s %(name)s: %(message)s", stream=sys.stderr)
    inbox: queue.SimpleQueue[tuple[int, Task] | None] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(orders, inbox), daemon=True, name="inbox").start()
    try:
        work = make_callable(pickle.loads(hello.spec))
    except BaseException as e:
        send(answers, ("no-start", failure_of(e)))
        _exit_at_once(1)
    _ignore_signals()
    send(answers, ("ready",))
    while (item := inbox.get()) is not None:
        index, task = item
        send(answers, ("done", index, perform(work, task)))
    close_callable(work)
    _exit_at_once(0)


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
