"""Runs tasks in worker processes that may crash, hang or grow without ending the run.

Workers are fresh Python interpreters, like those of multiprocessing's `spawn`. They are started by `subprocess`, which
gives each worker its own environment, its own process group (so that Ctrl-C reaches only the parent) and pipes: stdin
and stdout for messages, stderr for what is printed, by C code too. Unlike `spawn`, it does not import the caller's main
module again. Threads read the pipes, since not every system can wait for several of them.
"""

from __future__ import annotations

import contextlib
import errno
import itertools
import json
import logging
import math
import os
import pickle
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from infrablend.core.operating_system import (
    IN_BACKGROUND,
    describe_exit,
    hold,
    is_own,
    kill_tree,
    memory_folder,
)
from infrablend.core.tasks import Failure, FailureKind, Task, TaskResult, WorkerSpec
from infrablend.errors import Interrupted, OutputError, Problem, WorkerDiedError
from infrablend.pipeline.execution.interrupt import STOPPED, Interruption
from infrablend.pipeline.execution.worker import (
    ONE_THREAD,
    ResultMessage,
    StartMessage,
    WorkerLimits,
    loss_of,
    send,
    start_error,
    value_of,
)

_SCRATCH = "infrablend-workers-"
_NEW = "infrablend-new-"
_LOCK = ".lock"
_MIN_MEMORY_BYTES = 48 * 2**20  # a full-frame float image is 5 MiB; containers often give 64 MiB


@contextlib.contextmanager
def scratch_folder() -> Iterator[str]:
    """Create the folder for temporary files of workers: in memory unless TMPDIR is set or memory is short.

    The parent removes it, since a killed worker cannot. The next run removes the folder of a killed parent. A lock
    beside a folder marks it as in use; it ends with its process.

    Raises:
        OutputError: The folder cannot be created.
    """
    folder = None if os.environ.get("TMPDIR") else memory_folder()
    if folder is None or shutil.disk_usage(folder).free < _MIN_MEMORY_BYTES:
        folder = Path(tempfile.gettempdir())
    with contextlib.ExitStack() as stack:
        try:
            _sweep(folder)
            # Create under another name, lock, then rename: no sweep can find it without its lock.
            made = Path(tempfile.mkdtemp(prefix=_NEW, dir=folder))
            scratch = folder / (_SCRATCH + made.name.removeprefix(_NEW))
            stack.enter_context(hold(_lock_of(scratch)))
            made.rename(scratch)
        except OSError as error:
            raise OutputError(
                f"{folder}: cannot create a temporary folder ({error.strerror or error}); free some space there, or "
                "set TMPDIR to another folder",
                [Problem(str(folder), "disk-full" if error.errno == errno.ENOSPC else "not-writable", str(error))],
            ) from error
        stack.callback(shutil.rmtree, scratch, ignore_errors=True)
        yield str(scratch)


def _lock_of(scratch: Path) -> Path:
    return scratch.with_name(scratch.name + _LOCK)


def _sweep(folder: Path) -> None:
    for left in sorted(folder.glob(_SCRATCH + "*")):
        scratch = left.with_name(left.name.removesuffix(_LOCK))
        with contextlib.suppress(OSError):
            if is_own(left):
                with hold(_lock_of(scratch)):
                    shutil.rmtree(scratch, ignore_errors=True)


logger = logging.getLogger(__name__)

IN_FLIGHT = 2  # tasks per worker: one runs and one waits in its inbox, so that the worker never idles
TAIL_LINES = 20  # lines of a dead worker's output that its failure quotes
_TICK_S = 0.5  # longest wait without a look at signals, which do not end a wait on Windows
_LAST_WORDS_S = 1.0

# -c and not -m: the child must find the caller's modules, whatever the caller did to its sys.path.
_BOOT = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from infrablend.pipeline.execution.worker import main; main()"
)


@dataclass(frozen=True)
class PoolSettings(WorkerLimits):
    """Number and limits of the workers of a pool.

    Attributes:
        workers: Maximum number of workers; a pool never starts more workers than there are tasks.
        start_timeout_s: Time limit for a worker to start.
        log_path: File to which the output and the log of workers are appended, each line with the worker's number.
    """

    workers: int = 1
    start_timeout_s: float = 300.0
    log_path: Path | None = None

    def __post_init__(self) -> None:
        if self.workers < 1 or self.tasks_per_worker < 1 or self.retries < 0:
            raise ValueError(
                f"workers {self.workers} and tasks_per_worker {self.tasks_per_worker} must be at least 1, "
                f"retries {self.retries} at least 0"
            )


class ProcessPool:
    """Executor that runs tasks in worker processes."""

    def __init__(self, worker: WorkerSpec, settings: PoolSettings | None = None) -> None:
        """Keep the settings; workers start with `run`."""
        self._worker = worker
        self._settings = settings or PoolSettings()

    def run(self, tasks: Iterable[Task]) -> Generator[TaskResult, None, None]:
        """Run tasks and yield their results, see `core.tasks.Executor`."""
        with contextlib.ExitStack() as stack:
            run = _open_run(self._worker, self._settings, stack)
            stop = stack.enter_context(Interruption(run.signal_all, run.wake))
            stack.callback(run.kill_all)
            yield from run.results(iter(tasks), stop)
            run.finish_all()


class WarmPool:
    """Worker processes that stay between calls, for callers that decide on the next task when they see a result.

    It leaves signals alone: Ctrl-C raises KeyboardInterrupt where the caller waits. Closing it ends the workers.
    """

    def __init__(self, worker: WorkerSpec, settings: PoolSettings | None = None) -> None:
        """Open the pool; workers start with `start` or with the first task."""
        self._stack = contextlib.ExitStack()
        self._run = _open_run(worker, settings or PoolSettings(), self._stack)
        self._stack.callback(self._run.kill_all)

    def start(self, workers: int = 1) -> None:
        """Start workers before there are tasks for them, so that they load while the caller prepares."""
        self._run.start(workers)

    def run(self, tasks: Iterable[Task]) -> Generator[TaskResult, None, None]:
        """Yield one result per task in the order of completion; `tasks` is read as workers become free.

        Calls may overlap: a call within the loop over another one shares its workers. What an unfinished call leaves
        is dropped.

        Raises:
            InfraBlendError: Workers cannot start: the factory's own error, or `RenderError`.
        """
        yield from self._run.results(iter(tasks))

    def close(self) -> None:
        """End the workers at once; no task may follow."""
        self._stack.close()


def _open_run(worker: WorkerSpec, settings: PoolSettings, stack: contextlib.ExitStack) -> _Run:
    """Return the state of a new pool; its log and its scratch folder are closed with `stack`."""
    spec = pickle.dumps(worker, pickle.HIGHEST_PROTOCOL)
    log = stack.enter_context(settings.log_path.open("ab", buffering=0)) if settings.log_path else None
    return _Run(settings, spec, log, stack.enter_context(scratch_folder()))


@dataclass(eq=False)
class _Call:
    """One caller's loop over results.

    Attributes:
        open: Number of tasks without a result.
        arrived: Results that the caller has not taken yet.
        abandoned: Whether the caller has left the loop.
    """

    open: int = 0
    arrived: deque[TaskResult] = field(default_factory=deque)
    abandoned: bool = False


@dataclass
class _Attempt:
    """An attempt at a task.

    Attributes:
        index: Number of the task in the messages to and from workers.
        task: The task.
        call: The loop that waits for the result.
        number: Number of the current attempt, from 1.
    """

    index: int
    task: Task
    call: _Call
    number: int = 1


@dataclass(eq=False)
class _Worker:
    """The parent's view of one worker."""

    number: int
    process: subprocess.Popen[bytes]
    since: float  # start of the worker or of its current task, on the monotonic clock
    ready: bool = False
    ending: bool = False  # receives no more tasks
    finished: int = 0
    rss_bytes: int = 0
    in_flight: deque[_Attempt] = field(default_factory=deque)
    tail: deque[str] = field(default_factory=lambda: deque(maxlen=TAIL_LINES))
    printer: threading.Thread | None = None  # reads its output


class _Run:
    """State of a pool: its workers and the waiting tasks."""

    def __init__(self, settings: PoolSettings, spec: bytes, log: IO[bytes] | None, scratch: str) -> None:
        self._settings = settings
        self._scratch = scratch
        self._spec = spec
        self._log = log
        self._workers: list[_Worker] = []
        self._started = 0
        self._failed_starts = 0
        self._winding_down = False
        self._pending: deque[_Attempt] = deque()
        self._indices = itertools.count()
        # What a worker has said; None when it has closed its pipe; without a worker to end the wait.
        self._heard: queue.SimpleQueue[tuple[_Worker | None, Any]] = queue.SimpleQueue()

    def results(self, source: Iterator[Task], stop: Interruption | None = None) -> Iterator[TaskResult]:
        """Feed workers, wait and collect results until no task is left or the user stops the run."""
        call = _Call()
        exhausted = False
        give_up_at: float | None = None
        try:
            while True:
                requested = stop is not None and stop.requested
                if give_up_at is None and requested and not (exhausted and not call.open):
                    give_up_at = time.monotonic() + self._settings.grace_s
                    self._finish_running_tasks()
                if give_up_at is None:
                    while not exhausted and call.open < self._settings.workers * IN_FLIGHT:
                        task = next(source, None)
                        if task is None:
                            exhausted = True
                        else:
                            self._pending.append(_Attempt(next(self._indices), task, call))
                            call.open += 1
                    if exhausted and not call.open:
                        return
                    self._start_workers()
                    self._feed()
                elif not self._workers or time.monotonic() >= give_up_at:
                    raise Interrupted(STOPPED)
                self._collect(give_up_at)
                while call.arrived:
                    yield call.arrived.popleft()
        finally:
            call.abandoned = True
            self._pending = deque(a for a in self._pending if a.call is not call)

    @property
    def _outstanding(self) -> int:
        return len(self._pending) + sum(len(w.in_flight) for w in self._workers)

    # ---- starting and feeding

    def start(self, workers: int) -> None:
        """Start workers before there are tasks."""
        for _ in range(min(self._settings.workers, workers) - len(self._workers)):
            self._workers.append(self._start())

    def _start_workers(self) -> None:
        # An ending worker counts too: it may still occupy resources that its successor needs (a core, GPU memory).
        for _ in range(min(self._settings.workers, self._outstanding) - len(self._workers)):
            self._workers.append(self._start())

    def _start(self) -> _Worker:
        number = self._started
        self._started += 1
        process = subprocess.Popen(
            [sys.executable, "-c", _BOOT, json.dumps(sys.path), f"worker-{number}"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, **ONE_THREAD, "TMPDIR": self._scratch},
            **IN_BACKGROUND,
        )
        worker = _Worker(number, process, time.monotonic())
        worker.printer = threading.Thread(target=self._read_output, args=(worker,), daemon=True)
        for thread in (worker.printer, threading.Thread(target=self._read_messages, args=(worker,), daemon=True)):
            thread.start()
        # Linux signals the child when the thread that started it ends, so request that signal in the main thread only.
        main_thread = threading.current_thread() is threading.main_thread()
        self._send(worker, StartMessage(number, self._spec, os.getpid(), main_thread, self._settings.log_level))
        return worker

    def _feed(self) -> None:
        """Hand out waiting tasks: one to each worker first, then a second one to each."""
        for depth in range(1, IN_FLIGHT + 1):
            for w in self._workers:
                if self._pending and w.ready and not w.ending and len(w.in_flight) < depth:
                    attempt = self._pending.popleft()
                    if not w.in_flight:
                        w.since = time.monotonic()
                    w.in_flight.append(attempt)
                    self._send(w, ("task", attempt.index, attempt.task))

    def _send(self, worker: _Worker, message: Any) -> None:
        assert worker.process.stdin is not None
        with contextlib.suppress(OSError):  # it has died, as the end of its messages will say
            send(worker.process.stdin, message)

    # ---- collecting

    def _collect(self, give_up_at: float | None) -> None:
        """Wait for messages of any worker and hand their results to the calls that wait for them."""
        with contextlib.suppress(queue.Empty):
            heard = self._heard.get(timeout=self._seconds_to_timeout(give_up_at))
            while True:
                self._take(*heard)
                heard = self._heard.get_nowait()
        # A slow consumer is not a hang, so check the limits only when no message is waiting.
        now = time.monotonic()
        for w in list(self._workers):
            limit = self._limit(w)
            if limit is not None and now - w.since > limit:
                self._handle_dead_worker(w, "timeout")

    def _limit(self, w: _Worker) -> float | None:
        if not w.ready:
            return self._settings.start_timeout_s
        if w.in_flight:
            return self._settings.task_timeout_s
        return self._settings.grace_s if w.ending else None

    def _seconds_to_timeout(self, give_up_at: float | None) -> float:
        """Return the seconds until the first time limit of a worker, or the next look at signals."""
        ends = [w.since + limit for w in self._workers if (limit := self._limit(w)) is not None]
        if give_up_at is not None:
            ends.append(give_up_at)
        return min(max(0.0, min(ends, default=math.inf) - time.monotonic()) + 0.01, _TICK_S)

    def wake(self) -> None:
        """End the wait for messages; safe in a signal handler."""
        self._heard.put((None, None))

    def _read_messages(self, w: _Worker) -> None:
        """Pass on what a worker says, in a thread of its own."""
        assert w.process.stdout is not None
        # Any error: what a damaged message raises is not known.
        with w.process.stdout as stream, contextlib.suppress(Exception):
            while True:
                self._heard.put((w, pickle.load(stream)))
        self._heard.put((w, None))

    def _take(self, w: _Worker | None, message: Any) -> None:
        if w not in self._workers:
            return
        if message is None:
            self._handle_dead_worker(w, "crash")
        elif message[0] == "ready":
            w.ready = True
            w.since = time.monotonic()
            self._failed_starts = 0
        elif message[0] == "no-start":
            self._raise_factory_error(w, message[1])
        else:
            self._receive_result(w, message[1], message[2])

    def _deliver(self, attempt: _Attempt, result: TaskResult) -> None:
        attempt.call.open -= 1
        if not attempt.call.abandoned:
            attempt.call.arrived.append(result)

    def _receive_result(self, w: _Worker, index: int, done: ResultMessage) -> None:
        """Deliver the result in a message; dismiss the worker if it is due for replacement."""
        attempt = w.in_flight.popleft()
        assert attempt.index == index, "workers answer in order"
        w.since = time.monotonic()
        w.finished += 1
        w.rss_bytes = done.rss_bytes
        value, failure = value_of(done, attempt.task)
        if self._settings.is_due(w.finished, done.rss_bytes) and not w.ending:
            logger.info("worker %d is replaced after %d tasks, %d MiB", w.number, w.finished, done.rss_bytes >> 20)
            self._retire(w)
        numbers = attempt.number, done.seconds, w.number, done.rss_bytes
        self._deliver(attempt, TaskResult(attempt.task.key, value, failure, *numbers))

    def _retire(self, w: _Worker) -> None:
        """Let the worker end after the tasks in its inbox."""
        w.ending = True
        self._send(w, ("finish",))

    def _read_output(self, w: _Worker) -> None:
        """Copy the output of the worker to the log, line by line with its number, in a thread of its own."""
        assert w.process.stderr is not None
        with w.process.stderr as stream:
            for line in stream:
                said = line.rstrip(b"\r\n")
                w.tail.append(said.decode(errors="replace"))
                if self._log is not None:
                    # A failing log must not end the run; a full disk is reported when the run writes its own files.
                    with contextlib.suppress(OSError, ValueError):  # it is closed when a process outlives the pool
                        self._log.write(b"worker %d: %s\n" % (w.number, said))

    # ---- endings

    def _handle_dead_worker(self, w: _Worker, kind: FailureKind) -> None:
        """Reap a worker that died or hung; retry or fail the task that it was running."""
        code = self._reap(w, patience_s=0.0 if kind == "timeout" else 5.0)
        if self._winding_down or (w.ending and not w.in_flight):
            return
        if not w.ready:
            self._failed_starts += 1
            what = f"took longer than {self._settings.start_timeout_s:g} s to start" if kind == "timeout" else code
            logger.warning("worker %d %s before its first task", w.number, what)
            if self._failed_starts > self._settings.retries:
                raise WorkerDiedError(
                    f"Workers cannot start: {self._failed_starts} in a row ended before their first task; "
                    f"the last one {what}. Run `infrablend doctor`." + _quote(list(w.tail))
                )
            return
        if not w.in_flight:
            logger.warning("worker %d %s while idle", w.number, code)
            return
        guilty, *innocent = w.in_flight
        w.in_flight.clear()
        self._pending.extendleft(a for a in reversed(innocent) if not a.call.abandoned)
        what = f"took longer than {self._settings.task_timeout_s:g} s" if kind == "timeout" else code
        if guilty.call.abandoned:
            return
        if guilty.number <= self._settings.retries:
            logger.warning("worker %d %s on %s; trying again", w.number, what, guilty.task.key)
            self._pending.appendleft(_Attempt(guilty.index, guilty.task, guilty.call, guilty.number + 1))
            return
        failure = loss_of(guilty.task, kind, what, guilty.number, "\n".join(w.tail))
        self._deliver(guilty, TaskResult(guilty.task.key, None, failure, guilty.number, 0.0, w.number, 0))

    def _raise_factory_error(self, w: _Worker, failure: Failure) -> None:
        """Raise the error of a worker factory, which would fail again in every new worker."""
        self._reap(w, patience_s=5.0)
        logger.info("worker %d could not start:\n%s", w.number, failure.traceback)  # the error itself is raised
        raise start_error(failure)

    def _finish_running_tasks(self) -> None:
        """Let running tasks finish after an interruption, and start nothing else."""
        self._winding_down = True
        self._pending.clear()
        for w in list(self._workers):
            if not w.ready or not w.in_flight:
                self._reap(w, patience_s=0.0)
                continue
            w.ending = True
            self._send(w, ("stop",))

    def finish_all(self) -> None:
        """Let all workers end after the last task, and kill those that take too long."""
        for w in self._workers:
            if w.ready:
                self._send(w, ("finish",))
        end = time.monotonic() + self._settings.grace_s
        for w in list(self._workers):
            self._reap(w, patience_s=max(0.0, end - time.monotonic()) if w.ready else 0.0)

    def _reap(self, w: _Worker, patience_s: float) -> str:
        """Wait for the end of a worker, kill it if it takes too long, and return how it ended."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            w.process.wait(patience_s)
        kill_tree(w.process)
        code = w.process.wait()
        assert w.process.stdin is not None and w.printer is not None
        with contextlib.suppress(OSError):  # what it has not read
            w.process.stdin.close()
        w.printer.join(_LAST_WORDS_S)  # a process that it has started may hold its output open
        if w in self._workers:
            self._workers.remove(w)
        return describe_exit(code)

    def kill_all(self) -> None:
        """Kill every worker and leave no zombie."""
        self.signal_all()
        for w in list(self._workers):
            self._reap(w, patience_s=0.0)

    def signal_all(self) -> None:
        """Kill every worker, with the processes that tasks have started; safe in a signal handler."""
        for w in list(self._workers):
            kill_tree(w.process)


def _quote(lines: Iterable[str]) -> str:
    text = "\n".join(f"  | {line}" for line in lines if line.strip())
    return f"\nLast lines of its output:\n{text}" if text else ""
