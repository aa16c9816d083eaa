"""The worker that runs inside a Ray actor, on whatever machine Ray chooses."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil

from infrablend.core.tasks import Failure, Task, WorkerSpec
from infrablend.execution.worker import ResultMessage, close_callable, failure_of, make_callable, perform


class RayWorker:
    """Creates its callable once and performs one task at a time."""

    def __init__(self, log_level: int, module_path: list[str], folder: str) -> None:
        """Log to the files that Ray keeps per worker; work in the driver's folder, with its modules, where it is."""
        if Path(folder).is_dir():
            os.chdir(folder)
        sys.path += [p for p in module_path if p not in sys.path and Path(p).exists()]
        logging.basicConfig(level=log_level, format="%(levelname)s %(name)s: %(message)s", force=True)
        self._work: Callable[[Task], Any] | None = None
        self._process = psutil.Process()

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
        return [perform(self._work, task, self._process) for task in tasks]

    def finish(self) -> None:
        """Close the callable; no task may follow."""
        if self._work is not None:
            close_callable(self._work)
            self._work = None
