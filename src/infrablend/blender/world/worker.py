"""Worker that renders frames of the virtual world in its own process."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from infrablend.blender.world.renderer import WorldRenderer
from infrablend.core.cores import take_core
from infrablend.core.tasks import Task
from infrablend.world.frame_files import FinishedFrame, make_frame


class WorldWorker:
    """Renders frames of one virtual dataset; owns the Blender scene of its process."""

    def __init__(self, seed: int, folder: Path, threads: int) -> None:
        """Start Blender with `threads` render threads (0: one per core); images go to `folder`/<split>/."""
        self._seed, self._folder = seed, folder
        self._renderer = WorldRenderer(threads)

    def __call__(self, task: Task) -> FinishedFrame:
        """Render the `FrameFacts` in the payload of a task."""
        return make_frame(task.payload, self._seed, self._renderer, self._folder)

    def close(self) -> None:
        """Release Blender's scene."""
        self._renderer.close()


def make_world_worker(settings: Mapping[str, Any]) -> WorldWorker:
    """Create a worker from `seed` and `folder`; it uses one render thread, since workers run in parallel."""
    take_core()
    return WorldWorker(settings["seed"], Path(settings["folder"]), 1)
