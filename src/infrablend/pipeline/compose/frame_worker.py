"""The workers that compose frames: on demand, started by `pool`, and for the folder of a run, started by `runs.run`."""

from __future__ import annotations

from infrablend.core.files import write_bytes
from infrablend.core.machine import take_core
from infrablend.core.run_folder import RunFolder
from infrablend.core.tasks import Task
from infrablend.pipeline.compose.composed import ComposedFrame, MadeFrame
from infrablend.pipeline.compose.frame import FrameComposer
from infrablend.pipeline.compose.pool import FrameJob
from infrablend.pipeline.compose.settings import FrameSettings
from infrablend.pipeline.plans.run_request import Execution
from infrablend.rendering import make_renderer


class _Worker:
    """Has a renderer; each worker process has one instance."""

    def __init__(self, execution: Execution) -> None:
        self._renderer = make_renderer(execution.renderer, execution.device, execution.blender)

    def close(self) -> None:
        """Release the renderer."""
        self._renderer.close()


class FrameWorker(_Worker):
    """Composes the frame of each task."""

    _context: int | None = None

    def __init__(self, execution: Execution) -> None:
        """Keep to a core of its own."""
        super().__init__(execution)
        if execution.pins_cores:
            take_core()

    def __call__(self, task: Task) -> ComposedFrame:
        """Return the frame of the `FrameJob` in the task's payload."""
        job: FrameJob = task.payload
        if job.context != self._context:
            self._composer = FrameComposer(job.settings, self._renderer)
            self._context = job.context
        return self._composer.compose(job.frame)


class FrameMaker(_Worker):
    """Composes frames and writes them to the folder of a run."""

    def __init__(self, settings: FrameSettings) -> None:
        """Start the renderer and load the recipe's models."""
        super().__init__(settings.execution)
        assert settings.out is not None
        self._folder = RunFolder(settings.out)
        self._composer = FrameComposer(settings, self._renderer)
        # Only now: Blender, if the recipe needs it, starts on another core meanwhile.
        if settings.execution.pins_cores:
            take_core()

    def __call__(self, task: Task) -> MadeFrame:
        """Write the image of the `PlannedFrame` in the task's payload, and return its record."""
        composed = self._composer.compose(task.payload)
        write_bytes(self._folder.image(composed.record.image), composed.image_bytes)
        return MadeFrame.of(composed.record, len(composed.image_bytes), composed.seconds)
