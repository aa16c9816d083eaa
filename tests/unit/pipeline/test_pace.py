"""The remaining time of a run."""

from __future__ import annotations

import pytest

from infrablend.core.tasks import TaskResult
from infrablend.pipeline.runs.executors import Pace


def test_the_first_frame_of_a_worker_counts_only_until_another_is_done() -> None:
    pace = Pace(workers=2)
    assert pace.frames_per_s() == 0
    pace.add(TaskResult("a", seconds=2.0, worker=0))
    assert pace.frames_per_s() == pytest.approx(1.0)
    pace.add(TaskResult("b", seconds=4.0, worker=1))
    assert pace.frames_per_s() == pytest.approx(2 / 3)
    pace.add(TaskResult("c", seconds=0.2, worker=0))
    assert pace.frames_per_s() == pytest.approx(10)
