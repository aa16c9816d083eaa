"""The worker that composes frames on demand; `pool` is its other side."""

from __future__ import annotations

from infrablend.core.machine import take_core
from infrablend.core.tasks import Task
from infrablend.pipeline.compose.composed import ComposedFrame
from infrablend.pipeline.compose.frame import FrameComposer
from infrablend.pipeline.compose.pool import FrameJob, WorkerStart
from infrablend.rendering import make_renderer


class FrameWorker:
    """Composes the frame of each task; each worker process has one instance."""

    def __init__(self, start: WorkerStart) -> None:
        if start.pin_cores:
            take_core()
        self._renderer = make_renderer(start.renderer, start.device)
        self._context: int | None = None
        self._composer: FrameComposer | None = None

    def __call__(self, task: Task) -> ComposedFrame:
        """Return the frame of the `FrameJob` in the task's payload."""
        job: FrameJob = task.payload
        if self._composer is None or job.context != self._context:
            self._composer = FrameComposer(job.settings, self._renderer)
            self._context = job.context
        return self._composer.compose(job.frame)

    def close(self) -> None:
        """Release the renderer."""
        self._renderer.close()


def make_frame_worker(start: WorkerStart) -> FrameWorker:
    """Return a frame worker; the worker factory that `execution` calls by its dotted name."""
    return FrameWorker(start)
