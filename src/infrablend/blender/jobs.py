"""Single Blender jobs that the Python interface runs in a worker process: turntables, the node group as a file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from infrablend.blender.materials import write_infrared_effect
from infrablend.core.tasks import Task


def make_asset_writer(_settings: Any) -> Callable[[Task], str]:
    """Worker factory: the task's payload is the .blend to write."""

    def run(task: Task) -> str:
        return str(write_infrared_effect(Path(task.payload)))

    return run
