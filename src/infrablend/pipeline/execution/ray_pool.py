"""Runs tasks in Ray actors: on this machine, or on the machines of a Ray cluster.

A worker is an actor that keeps its callable, as a process of `ProcessPool` does, and the rules are the same: a task
whose worker died or hung is tried again on another one, workers are replaced after a number of tasks, and values do
not depend on who computed them. Short tasks are sent several at a time, because a message costs as much as a tenth of a
small frame; if their worker is lost, each is tried again by itself, so that the one at fault is found. Ray decides
where the actors run, waits for machines, and notices their loss. Only tasks, each of a few kilobytes, and results go
through the driver; pictures, models and frames are read and written by the workers, so all machines need the same paths
and packages.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

from infrablend.core.tasks import Failure, FailureKind, Task, TaskResult, WorkerSpec
from infrablend.errors import Interrupted, MissingDependencyError, OutputError, WorkerDiedError
from infrablend.pipeline.execution.interrupt import STOPPED, Interruption
from infrablend.pipeline.execution.worker import (
    ONE_THREAD,
    ResultMessage,
    WorkerLimits,
    close_callable,
    failure_of,
    loss_of,
    make_callable,
    perform,
    start_error,
    value_of,
)

log = logging.getLogger(__name__)

_POLL_S = 0.2
_CONNECT_S = 10.0
_REMIND_S = 60.0
_BATCH_S = 0.5
_BATCH_MOST = 8


@dataclass(frozen=True)
class RaySettings(WorkerLimits):
    """Where Ray runs, and the number and limits of its workers.

    Attributes:
        workers: Maximum number of workers; None for one per processor core of the cluster.
        address: Address of a cluster, as for `ray.init`; None takes `RAY_ADDRESS`, else starts Ray on this machine and
            stops it at the end. A Ray that the program has already started is used as it is.
        worker_bytes: Memory that each worker reserves with Ray, which places no more workers on a machine than fit.
        gpus: Share of a GPU that each worker reserves; 0 for none.
    """

    workers: int | None = None
    address: str | None = None
    worker_bytes: int = 0
    gpus: float = 0.0


class RayPool:
    """Executor that runs tasks in Ray actors."""

    def __init__(self, worker: WorkerSpec, settings: RaySettings | None = None) -> None:
        self._worker = worker
        self._settings = settings or RaySettings()

    def run(self, tasks: Iterable[Task]) -> Generator[TaskResult, None, None]:
        """Run tasks and yield their results, see `core.tasks.Executor`.

        Raises:
            MissingDependencyError: Ray is not installed.
            OutputError: There is no cluster at the address.
        """
        source = iter(tasks)
        first = next(source, None)
        if first is None:
            return  # without starting Ray
        with contextlib.ExitStack() as stack:
            stack.enter_context(_messages_to_log())
            ray, own = stack.enter_context(_connected(self._settings))
            run = _Run(ray, self._settings, self._worker, own)
            stop = stack.enter_context(Interruption(run.kill_all))
            stack.callback(run.kill_all)
            yield from run.results(chain([first], source), stop)
            run.finish_all()


@contextlib.contextmanager
def _connected(settings: RaySettings) -> Iterator[tuple[Any, bool]]:
    """Connect to a cluster, or start Ray on this machine; stop what was started.

    Yields:
        The module `ray`, and whether Ray was started here, with the variables that workers need.

    Raises:
        MissingDependencyError: Ray is not installed.
        OutputError: There is no cluster at the address.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nothing is sent anywhere unless the user asks for it
    try:
        import ray
    except ImportError as error:
        raise MissingDependencyError(
            'Ray is not installed. Run: pip install "infrablend[ray]" (in a checkout: make ray)'
        ) from error
    if ray.is_initialized():
        yield ray, False
        return
    address = settings.address or os.environ.get("RAY_ADDRESS")
    if address is None:
        # Tokens protect clusters from others on the network; this Ray listens to this machine, and ends with the run.
        os.environ.setdefault("RAY_AUTH_MODE", "disabled")
        # `local` also where somebody else has started a Ray on this machine.
        options: dict[str, object] = {
            "address": "local",
            "num_cpus": settings.workers,
            "object_store_memory": 100 * 2**20,
        }
        options |= {"include_dashboard": False, "_node_ip_address": "127.0.0.1"}
    else:
        options = {"address": address}
    terminated = signal.getsignal(signal.SIGTERM)
    try:
        _require_listener(address)
        with _variables(ONE_THREAD if address is None else {}):
            ray.init(log_to_driver=False, configure_logging=False, **options)
    except (ConnectionError, RuntimeError, ValueError, OSError) as error:
        where = "on this machine" if address is None else f"at {address}"
        raise OutputError(
            f"Ray {where}: {type(error).__name__}: {error}; expected a running cluster with the same versions of Ray "
            "and Python. Check --address and RAY_ADDRESS, or leave both out to start Ray on this machine"
        ) from error
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, terminated)  # Ray has a handler of its own
    try:
        yield ray, address is None
    finally:
        ray.shutdown()


@contextlib.contextmanager
def _variables(variables: Mapping[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _require_listener(address: str | None) -> None:
    """Check that somebody listens at `host:port`: Ray would wait for minutes, and no signal would end that.

    Raises:
        OSError: Nobody does.
    """
    host, colon, port = (address or "").removeprefix("ray://").rpartition(":")
    if colon and port.isdigit():
        socket.create_connection((host.strip("[]"), int(port)), timeout=_CONNECT_S).close()


@contextlib.contextmanager
def _messages_to_log() -> Iterator[None]:
    """Send the messages of Ray's machines to the log: it would print them on stdout, which is for results."""
    try:
        from ray._private import worker
    except ImportError:
        yield
        return
    before: Any = getattr(worker, "print_to_stdstream", None)
    worker.print_to_stdstream = lambda data, *_, **__: log.info("Ray: %s", " ".join(map(str, data["lines"])))
    try:
        yield
    finally:
        worker.print_to_stdstream = before


@dataclass
class _Attempt:
    """An attempt at a task, by itself after its worker was lost; `number` counts from 1."""

    task: Task
    number: int = 1
    alone: bool = False


@dataclass(eq=False)
class _Worker:
    """The driver's view of one actor.

    Attributes:
        starting: Reference to the result of its start, until that is known.
        finished: Number of tasks that it has finished.
        since: Start of its tasks, on the monotonic clock.
        current: Reference to the results of its tasks, and the attempts; None while it is idle.
    """

    number: int
    actor: Any
    starting: Any
    finished: int = 0
    since: float = field(default_factory=time.monotonic)
    current: tuple[Any, Sequence[_Attempt]] | None = None


class _Run:
    def __init__(self, ray: Any, settings: RaySettings, spec: WorkerSpec, own: bool) -> None:
        self._ray = ray
        self._settings = settings
        self._spec = ray.put(spec)
        self._actor_class = _actor_class(ray, settings, own)
        self._most = settings.workers or max(1, int(ray.cluster_resources().get("CPU", 1)))
        self._workers: list[_Worker] = []
        self._started = 0
        self._failed_starts = 0
        self._pending: deque[_Attempt] = deque()
        self._arrived: deque[TaskResult] = deque()
        self._open = 0
        self._batch = 1
        self._task_s = 0.0

    def results(self, source: Iterator[Task], stop: Interruption) -> Iterator[TaskResult]:
        """Feed workers, wait and collect results until no task is left or the user stops the run."""
        exhausted = False
        give_up_at: float | None = None
        remind_at = time.monotonic() + _REMIND_S
        while True:
            if give_up_at is None and stop.requested and not (exhausted and not self._open):
                give_up_at = time.monotonic() + self._settings.grace_s
                self._pending.clear()
            if give_up_at is None:
                while not exhausted and self._open < self._most * self._batch:
                    task = next(source, None)
                    if task is None:
                        exhausted = True
                    else:
                        self._pending.append(_Attempt(task))
                        self._open += 1
                if exhausted and not self._open:
                    return
                self._start_workers()
                self._feed()
            elif not any(w.current for w in self._workers) or time.monotonic() >= give_up_at:
                raise Interrupted(STOPPED)
            self._collect(winding_down=give_up_at is not None)
            if any(w.starting is None for w in self._workers):
                remind_at = time.monotonic() + _REMIND_S
            elif time.monotonic() >= remind_at:
                remind_at += _REMIND_S
                log.warning("waiting for Ray to place %d workers: %s", len(self._workers), self._free())
            while self._arrived:
                yield self._arrived.popleft()

    def _free(self) -> str:
        free = self._ray.available_resources()
        return f"{free.get('CPU', 0):g} cores and {free.get('memory', 0) / 2**30:.1f} GiB are free in the cluster"

    # ---- starting and feeding

    def _start_workers(self) -> None:
        outstanding = len(self._pending) + sum(w.current is not None for w in self._workers)
        for _ in range(min(self._most, outstanding) - len(self._workers)):
            actor = self._actor_class.remote(self._settings.log_level, sys.path, str(Path.cwd()))
            self._workers.append(_Worker(self._started, actor, actor.start.remote(self._spec)))
            self._started += 1

    def _feed(self) -> None:
        for w in self._workers:
            if self._pending and w.starting is None and w.current is None:
                attempts = self._next(w)
                w.since = time.monotonic()
                w.current = w.actor.perform.remote([a.task for a in attempts]), attempts

    def _next(self, w: _Worker) -> list[_Attempt]:
        """Take the next tasks for a worker from those that wait: a fair share, and what was tried before alone."""
        share = -(-len(self._pending) // len(self._workers))
        most = max(1, min(self._batch, share, self._settings.tasks_per_worker - w.finished))
        attempts = [self._pending.popleft()]
        while len(attempts) < most and self._pending and not (attempts[0].alone or self._pending[0].alone):
            attempts.append(self._pending.popleft())
        return attempts

    # ---- collecting

    def _collect(self, winding_down: bool) -> None:
        waiting = [w.starting for w in self._workers if w.starting is not None]
        waiting += [w.current[0] for w in self._workers if w.current is not None]
        if not waiting:
            time.sleep(_POLL_S)
            return
        self._ray.wait(waiting, num_returns=1, timeout=_POLL_S)
        ready = set(self._ray.wait(waiting, num_returns=len(waiting), timeout=0)[0])
        for w in list(self._workers):
            if w.starting is not None and w.starting in ready:
                self._take_start(w)
            if w.current is not None and w.current[0] in ready:
                self._take_results(w, *w.current, winding_down)
        limit = self._settings.task_timeout_s
        for w in list(self._workers):
            if limit is None or w.current is None or time.monotonic() - w.since <= limit:
                continue
            reference, attempts = w.current
            if not self._ray.wait([reference], timeout=0)[0]:  # a slow consumer is not a hang
                self._handle_lost_worker(w, attempts, "timeout", f"took longer than {limit:g} s", winding_down)

    def _take_start(self, w: _Worker) -> None:
        try:
            failure: Failure | None = self._ray.get(w.starting)
        except self._ray.exceptions.RayError as error:
            self._workers.remove(w)
            self._failed_starts += 1
            log.warning("worker %d was lost before its first task: %s", w.number, _first_line(error))
            if self._failed_starts > self._settings.retries:
                raise WorkerDiedError(
                    f"Workers cannot start: {self._failed_starts} in a row ended before their first task; the last: "
                    f"{_first_line(error)}. Run `infrablend doctor` on the machines of the cluster."
                ) from error
            return
        w.starting = None
        if failure is not None:
            log.info("worker %d could not start:\n%s", w.number, failure.traceback)
            raise start_error(failure)
        self._failed_starts = 0

    def _take_results(self, w: _Worker, reference: Any, attempts: Sequence[_Attempt], winding_down: bool) -> None:
        try:
            messages: list[ResultMessage] = self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            self._handle_lost_worker(w, attempts, "crash", "was lost", winding_down, str(error))
            return
        w.current = None
        w.finished += len(messages)
        if self._settings.is_due(w.finished, messages[-1].rss_bytes):
            self._workers.remove(w)
            self._end(w)
        for attempt, done in zip(attempts, messages, strict=True):
            value, failure = value_of(done, attempt.task)
            self._deliver(
                TaskResult(attempt.task.key, value, failure, attempt.number, done.seconds, w.number, done.rss_bytes)
            )
        mean_s = sum(m.seconds for m in messages) / len(messages)
        self._task_s = 0.9 * self._task_s + 0.1 * mean_s if self._task_s else mean_s
        fitting = int(_BATCH_S / max(self._task_s, 1e-6))
        self._batch = max(1, min(_BATCH_MOST, 2 * self._batch, fitting))  # the first task may have been the shortest

    def _deliver(self, result: TaskResult) -> None:
        self._open -= 1
        self._arrived.append(result)

    def _handle_lost_worker(
        self,
        w: _Worker,
        attempts: Sequence[_Attempt],
        kind: FailureKind,
        what: str,
        winding_down: bool,
        output: str = "",
    ) -> None:
        self._workers.remove(w)
        self._ray.kill(w.actor)
        if winding_down:
            return
        if len(attempts) > 1:
            log.warning("worker %d %s on one of %d tasks; trying each again", w.number, what, len(attempts))
            self._pending.extendleft(_Attempt(a.task, a.number, alone=True) for a in reversed(attempts))
            return
        (attempt,) = attempts
        if attempt.number <= self._settings.retries:
            log.warning("worker %d %s on %s; trying again", w.number, what, attempt.task.key)
            self._pending.appendleft(_Attempt(attempt.task, attempt.number + 1, alone=True))
            return
        failure = loss_of(attempt.task, kind, what, attempt.number, output)
        self._deliver(TaskResult(attempt.task.key, None, failure, attempt.number, 0.0, w.number, 0))

    # ---- endings

    def _end(self, w: _Worker) -> None:
        with contextlib.suppress(self._ray.exceptions.RayError):
            self._ray.get(w.actor.finish.remote(), timeout=self._settings.grace_s)
        self._ray.kill(w.actor)

    def finish_all(self) -> None:
        """Let all workers end after the last task."""
        ready = [w for w in self._workers if w.starting is None]
        references = [w.actor.finish.remote() for w in ready]
        if references:
            self._ray.wait(references, num_returns=len(references), timeout=self._settings.grace_s)
        self.kill_all()

    def kill_all(self) -> None:
        """Kill every worker."""
        for w in self._workers:
            with contextlib.suppress(Exception):
                self._ray.kill(w.actor)
        self._workers.clear()


class RayWorker:
    """The worker in a Ray actor, on whatever machine: creates its callable once and performs one task at a time."""

    def __init__(self, log_level: int, module_path: list[str], folder: str) -> None:
        """Log to the files that Ray keeps per worker; work in the driver's folder, with its modules, where it is."""
        if Path(folder).is_dir():
            os.chdir(folder)
        sys.path += [p for p in module_path if p not in sys.path and Path(p).exists()]
        logging.basicConfig(level=log_level, format="%(levelname)s %(name)s: %(message)s", force=True)
        self._work: Callable[[Task], Any] | None = None

    def start(self, spec: WorkerSpec) -> Failure | None:
        """Create the callable; return why it cannot be created, or None."""
        try:
            self._work = make_callable(spec)
        except BaseException as error:
            return failure_of(error)
        return None

    def perform(self, tasks: list[Task]) -> list[ResultMessage]:
        """Perform tasks, one after the other."""
        assert self._work is not None
        return [perform(self._work, task) for task in tasks]

    def finish(self) -> None:
        """Close the callable; no task may follow."""
        if self._work is not None:
            close_callable(self._work)
            self._work = None


def _actor_class(ray: Any, settings: RaySettings, own: bool) -> Any:
    options: dict[str, object] = {"num_cpus": 1, "max_restarts": 0, "max_task_retries": 0}
    if not own:  # whoever started it may have set other variables; workers with an environment of theirs start later
        options["runtime_env"] = {"env_vars": dict(ONE_THREAD)}
    if settings.worker_bytes:
        options["memory"] = settings.worker_bytes
    if settings.gpus:
        options["num_gpus"] = settings.gpus
    return ray.remote(**options)(RayWorker)


def _first_line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0]
