"""Renders the virtual thermal world on several workers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from infrablend.core.tasks import OnProgress, Task, WorkerSpec, paced
from infrablend.lab.world.frame_files import FinishedFrame
from infrablend.lab.world.world_dataset import WorldRequest, write_world
from infrablend.lab.world.world_frames import FrameFacts
from infrablend.pipeline.execution.process_pool import PoolSettings, ProcessPool

WORKER = "infrablend.lab.world.blender_world:make_world_worker"


def make_world(
    out: Path,
    request: WorldRequest,
    workers: int,
    on_progress: OnProgress | None = None,
    *,
    overwrite: bool = False,
) -> None:
    """Render a background dataset of the virtual world; the bytes do not depend on the number of workers.

    Raises:
        RecipeError: The number of frames is out of range.
        OutputError: `out` has something that may not be replaced, or cannot be written.
        RenderError: Blender failed on a frame.
        Interrupted: The user stopped the run; nothing is left behind.
    """

    def rendered(frames: Sequence[FrameFacts], folder: Path) -> Iterator[FinishedFrame]:
        spec = WorkerSpec(WORKER, {"seed": request.seed, "folder": str(folder)})
        # The scene below a flight is rendered once, which takes longer than cutting hundreds of frames from it.
        most = 1 if request.layout == "flight" else len(frames)
        pool = ProcessPool(spec, PoolSettings(workers=max(1, min(workers, most))))
        for result in pool.run(Task(frame.name, frame) for frame in frames):
            if result.failure is not None:
                raise result.failure.to_exception()
            yield result.value

    write_world(out, request, rendered, paced(on_progress), overwrite=overwrite)
