"""The Blender job that writes the InfraredEffect node group to a file, run in a worker process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from infrablend.blender.materials import write_infrared_effect
from infrablend.core.tasks import Task


def make_node_group_writer(_settings: Any) -> Callable[[Task], str]:
    """Create a worker; the payload of its tasks is the .blend to write."""

    def run(task: Task) -> str:
        return str(write_infrared_effect(Path(task.payload)))

    return run
