"""The workers that compose frames: for the folder of a run, started by `runs.run`, and on demand, by `FramePool`.

Those of a pool stay warm when the recipe, dataset or seed changes.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from infrablend.core.files import write_bytes
from infrablend.core.operating_system import take_core
from infrablend.core.run_folder import RunFolder
from infrablend.core.tasks import Task, TaskResult, WorkerSpec
from infrablend.pipeline.compose.composed import ComposedFrame, MadeFrame
from infrablend.pipeline.compose.frame import FrameComposer
from infrablend.pipeline.compose.settings import FrameSettings
from infrablend.pipeline.execution.process_pool import PoolSettings, WarmPool
from infrablend.pipeline.execution.serial import WarmSerial
from infrablend.pipeline.plans.plan import PlannedFrame
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


FACTORY = "infrablend.pipeline.compose.frame_worker:FrameWorker"


@dataclass(frozen=True)
class FrameJob:
    """Payload of a task.

    Attributes:
        context: Number of the settings, so that a worker loads recipe and models once for many frames.
        settings: Recipe, seed and levels.
        frame: Frame to compose.
    """

    context: int
    settings: FrameSettings
    frame: PlannedFrame


class FrameWorkers:
    """Warm workers that compose frames.

    They start with `start` or with the first frame, and end with `close` or with this process.
    """

    def __init__(self, execution: Execution) -> None:
        self._owner = os.getpid()
        worker = WorkerSpec(FACTORY, execution)
        self._contexts = itertools.count()
        self._last: FrameSettings | None = None
        self._context = 0
        self._count = 1 if execution.in_process else execution.worker_count()
        self._pool: WarmPool | WarmSerial = (
            WarmSerial(worker) if execution.in_process else WarmPool(worker, PoolSettings(workers=self._count))
        )

    def start(self) -> None:
        """Start all workers, which load Blender while the caller prepares."""
        self._pool.start(self._count)

    def compose(self, frames: Iterable[PlannedFrame], settings: FrameSettings) -> Iterator[TaskResult]:
        """Yield a result per frame in the order of completion, with a `ComposedFrame`; `frames` is read as needed."""
        if settings != self._last:
            self._last, self._context = settings, next(self._contexts)
        context = self._context
        yield from self._pool.run(Task(f.frame_id, FrameJob(context, settings, f)) for f in frames)

    def compose_one(self, frame: PlannedFrame, settings: FrameSettings) -> ComposedFrame:
        """Return one frame.

        Raises:
            InfraBlendError: It cannot be composed.
        """
        (result,) = self.compose([frame], settings)
        if result.failure is not None:
            raise result.failure.to_exception()
        composed: ComposedFrame = result.value
        return composed

    def close(self) -> None:
        """End the workers, unless they are those of the process that this one was forked from."""
        if os.getpid() == self._owner:
            self._pool.close()
