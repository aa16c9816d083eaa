"""Runs tasks in this process or in worker processes; the port is `core.tasks.Executor`.

`WarmPool` keeps its workers between calls.
"""

from infrablend.execution.process_pool import PoolSettings, ProcessPool, WarmPool
from infrablend.execution.serial import Serial

__all__ = ["PoolSettings", "ProcessPool", "Serial", "WarmPool"]
