"""How fast frames are made, for the remaining time: start-up of the workers does not count."""

from __future__ import annotations

from infrablend.core.tasks import TaskResult


class Pace:
    """Frames per second of a run, from the time that workers spend on each frame.

    Dividing finished frames by the time since the start would count the start-up of Blender as work: with the first
    frame the estimate would be many times too long. The first frame of each worker, which loads models, counts only
    until another frame is done.
    """

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._seen: set[int] = set()
        self._first: list[float] = []
        self._later_s = 0.0
        self._later_n = 0

    def add(self, result: TaskResult) -> None:
        """Count a finished frame."""
        if result.worker in self._seen:
            self._later_s += result.seconds
            self._later_n += 1
        else:
            self._seen.add(result.worker)
            self._first.append(result.seconds)

    def frames_per_s(self) -> float:
        """Return the rate of all workers together; 0 before the first frame."""
        if not self._first:
            return 0.0
        mean_s = self._later_s / self._later_n if self._later_n else sum(self._first) / len(self._first)
        return self._workers / max(mean_s, 1e-6)
