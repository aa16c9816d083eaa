"""Runs tasks, in this process (`Serial`) or in worker processes (`ProcessPool`); the port is `core.tasks.Executor`."""

from infrablend.execution.process_pool import PoolSettings, ProcessPool
from infrablend.execution.serial import Serial

__all__ = ["PoolSettings", "ProcessPool", "Serial"]
