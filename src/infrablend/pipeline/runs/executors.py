"""What computes the frames of a run (worker processes, Ray, or this process), and how fast it does."""

from __future__ import annotations

from pathlib import Path

from infrablend.core.tasks import Executor, TaskResult, WorkerSpec
from infrablend.pipeline.execution.process_pool import PoolSettings, ProcessPool
from infrablend.pipeline.execution.ray_pool import RayPool, RaySettings
from infrablend.pipeline.execution.serial import Serial
from infrablend.pipeline.plans.run_request import WORKER_BYTES, Execution


def make_executor(worker: WorkerSpec, execution: Execution, log_path: Path) -> Executor:
    """Return the executor that a request asks for; `log_path` is for workers of this machine: Ray has its own logs."""
    if execution.in_process:
        return Serial(worker)
    if execution.executor == "ray":
        gpus = 0.0 if execution.device in ("auto", "cpu") else 1.0
        settings = RaySettings(
            workers=execution.workers, address=execution.address, worker_bytes=WORKER_BYTES, gpus=gpus
        )
        return RayPool(worker, settings)
    return ProcessPool(worker, PoolSettings(workers=max(1, execution.worker_count()), log_path=log_path))


class Pace:
    """Frames per second of a run, from the time that workers spend on each frame.

    Dividing finished frames by the time since the start would count the start-up of Blender as work: with the first
    frame the estimate would be many times too long. The first frame of each worker, which loads models, counts only
    until another frame is done.
    """

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._seen: set[int] = set()
        self._first: list[float] = []
        self._later_s = 0.0
        self._later_n = 0

    def add(self, result: TaskResult) -> None:
        """Count a finished frame."""
        if result.worker in self._seen:
            self._later_s += result.seconds
            self._later_n += 1
        else:
            self._seen.add(result.worker)
            self._first.append(result.seconds)

    def frames_per_s(self) -> float:
        """Return the rate of all workers together; 0 before the first frame."""
        if not self._first:
            return 0.0
        mean_s = self._later_s / self._later_n if self._later_n else sum(self._first) / len(self._first)
        return self._workers / max(mean_s, 1e-6)
