"""Virtual worlds with one sample per pixel, for tests that need a dataset, not its finest pixels."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import pytest


@contextmanager
def coarse_worlds() -> Iterator[None]:
    """Render all virtual worlds coarsely, in worker processes and in this one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("infrablend.lab.world.world_dataset.WORKER", "tests.coarse_world:make_coarse_worker")
        patch.setattr("infrablend.lab.world.world_renderer.OVERSAMPLE", 1)
        patch.setattr("infrablend.lab.world.world_renderer.SAMPLES", 1)
        yield


def make_coarse_worker(settings: Mapping[str, Any]) -> Any:
    """Return a worker for virtual worlds, in a process of its own."""
    from infrablend.lab.world import world_renderer

    world_renderer.OVERSAMPLE = world_renderer.SAMPLES = 1
    return world_renderer.make_world_worker(settings)
