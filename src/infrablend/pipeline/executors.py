"""Chooses what computes the frames of a run: worker processes, Ray, or this process."""

from __future__ import annotations

from pathlib import Path

from infrablend.core.tasks import Executor, WorkerSpec
from infrablend.execution.process_pool import PoolSettings, ProcessPool
from infrablend.execution.ray_pool import RayPool, RaySettings
from infrablend.execution.serial import Serial
from infrablend.pipeline.request import WORKER_BYTES, Execution


def make_executor(worker: WorkerSpec, execution: Execution, log_path: Path) -> Executor:
    """Return the executor that a request asks for.

    Args:
        worker: What computes a frame.
        execution: Workers, device and where they run.
        log_path: File for the output of the workers of this machine; Ray keeps that of its own.
    """
    if execution.in_process:
        return Serial(worker, log_path)
    if execution.executor == "ray":
        gpus = 0.0 if execution.device in ("auto", "cpu") else 1.0
        settings = RaySettings(
            workers=execution.workers, address=execution.address, worker_bytes=WORKER_BYTES, gpus=gpus
        )
        return RayPool(worker, settings)
    return ProcessPool(worker, PoolSettings(workers=max(1, execution.worker_count()), log_path=log_path))
