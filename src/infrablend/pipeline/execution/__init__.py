"""Runs tasks in this process, in worker processes or in Ray actors; the port is `core.tasks.Executor`.

`WarmPool` keeps its workers between calls.
"""

from infrablend.pipeline.execution.process_pool import PoolSettings, ProcessPool, WarmPool
from infrablend.pipeline.execution.ray_pool import RayPool, RaySettings
from infrablend.pipeline.execution.serial import Serial

__all__ = ["PoolSettings", "ProcessPool", "RayPool", "RaySettings", "Serial", "WarmPool"]
