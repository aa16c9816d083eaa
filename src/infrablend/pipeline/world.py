"""Rendering the virtual thermal world on several workers."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from infrablend.core.registry import resolve
from infrablend.core.tasks import OnProgress, Progress, Task, WorkerSpec
from infrablend.execution.process_pool import PoolSettings, ProcessPool

WORKER = "infrablend.blender.world:make_world_worker"
RENDER = "infrablend.blender.world:render_world"


def make_world(
    out: Path, count: int, seed: int, workers: int, on_progress: OnProgress | None = None, layout: str = "hit-uav"
) -> Any:
    """Render a background dataset in HIT-UAV's layout or in MONET's; the same bytes for any number of workers.

    Raises:
        RecipeError: `count` is out of range.
        OutputError: `out` is not empty or cannot be written.
        RenderError: Blender failed on a frame.
        Interrupted: The user stopped it; nothing half-done is left behind.
    """
    started = time.monotonic()

    def paint(frames: Sequence[Any], folder: Path) -> Iterator[Any]:
        spec = WorkerSpec(WORKER, {"seed": seed, "folder": str(folder)})
        pool = ProcessPool(spec, PoolSettings(workers=max(1, min(workers, len(frames)))))
        for result in pool.run(Task(frame.name, frame) for frame in frames):
            if result.failure is not None:
                raise result.failure.to_exception()
            yield result.value

    def report(done: int, total: int) -> None:
        if on_progress is not None:
            rate = done / max(time.monotonic() - started, 1e-9)
            on_progress(Progress(done, total, rate, (total - done) / rate))

    render: Callable[..., Any] = resolve(RENDER)
    return render(out, count, seed, layout=layout, paint=paint, progress=report)
