"""Run measurements in child processes, each on its own processor core, with Blender's output in a log file.

A separate process gives each measurement the same initial state, and its own count of CPU time and memory. It has one
core because Cycles' main thread waits by spinning: on a second core it would waste CPU time. Libraries start no threads
of their own, as in the workers of a run.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from infrablend.pipeline.execution.worker import ONE_THREAD


class ChildError(RuntimeError):
    """A child process failed; the message contains its traceback."""


@dataclass(frozen=True, eq=False)
class Child:
    """A running measurement."""

    process: BaseProcess
    pipe: Connection
    log: Path

    def result(self) -> Any:
        """Return the function's value.

        Raises:
            ChildError: The function raised an exception, or the process died.
        """
        try:
            good, value = self.pipe.recv()
        except EOFError:
            self.process.join()
            raise ChildError(f"died with exit code {self.process.exitcode}; see {self.log}") from None
        self.process.join()
        if not good:
            raise ChildError(value)
        return value


def start(function: Callable[..., Any], *args: Any, core: int, log: Path) -> Child:
    """Run a module-level `function(*args)` in a new process on one core."""
    log.parent.mkdir(parents=True, exist_ok=True)
    os.environ.update(ONE_THREAD)  # read by libraries when the child imports them
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_run, args=(theirs, core, str(log), function, args), daemon=True)
    process.start()
    theirs.close()
    return Child(process, ours, log)


def in_parallel(
    function: Callable[..., Any], shares: Sequence[tuple[Any, ...]], cores: Sequence[int], log: Path
) -> list[Any]:
    """Return the results of `function(*share)` for every share; one share at a time runs on each core."""
    results: list[Any] = []
    for begin in range(0, len(shares), len(cores)):
        batch = shares[begin : begin + len(cores)]
        running = [
            start(function, *share, core=core, log=log.with_name(f"{log.stem}_{begin + n}.log"))
            for n, (share, core) in enumerate(zip(batch, cores, strict=False))
        ]
        results += [child.result() for child in running]
    return results


def own_cores(count: int = 2) -> list[int]:
    """Return the cores to measure on."""
    return sorted(os.sched_getaffinity(0))[:count]


def cpu_s() -> float:
    """Return the CPU seconds (user and system) that all threads of this process have used."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


class Stopwatch:
    """Measure the CPU and wall-clock seconds of a `with` block."""

    cpu_s = 0.0
    wall_s = 0.0

    def __enter__(self) -> Stopwatch:
        self._begin = (cpu_s(), time.perf_counter())
        return self

    def __exit__(self, *_: object) -> None:
        self.cpu_s, self.wall_s = cpu_s() - self._begin[0], time.perf_counter() - self._begin[1]


def _run(pipe: Connection, core: int, log: str, function: Callable[..., Any], args: tuple[Any, ...]) -> None:
    os.sched_setaffinity(0, {core})
    handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    os.dup2(handle, 1)
    os.dup2(handle, 2)
    try:
        pipe.send((True, function(*args)))
        code = 0
    except BaseException:
        pipe.send((False, traceback.format_exc()))
        code = 1
    pipe.close()
    sys.stdout.flush()
    sys.stderr.flush()
    # Blender may hang or crash while the interpreter shuts down.
    os._exit(code)
