"""Executors: the port `core.tasks.Executor`, in this process (`Serial`) and in workers (`ProcessPool`)."""

from infrablend.execution.process_pool import PoolSettings, ProcessPool
from infrablend.execution.serial import Serial

__all__ = ["PoolSettings", "ProcessPool", "Serial"]
