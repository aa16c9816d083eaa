"""Measure whether the memory of a worker stays constant."""

from __future__ import annotations

import resource
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scenes import Work

from infrablend.core.tasks import Task
from infrablend.pipeline.compose.frame_worker import FrameMaker

# The first frames fill caches and buffers; the slope is fitted after them.
SETTLING_FRAMES = 50
PAGE_BYTES = resource.getpagesize()


@dataclass(frozen=True)
class Memory:
    """Resident memory of one worker.

    Attributes:
        rss_mb: Resident memory after each frame, MiB.
        peak_mb: Largest resident memory, MiB.
    """

    rss_mb: list[float]
    peak_mb: float

    @property
    def slope_mb_per_100_frames(self) -> float:
        """Slope by least squares over the frames after the settling ones."""
        y = np.array(self.rss_mb[min(SETTLING_FRAMES, len(self.rss_mb) // 2) :])
        return float(np.polyfit(np.arange(len(y)), y, 1)[0] * 100) if len(y) > 1 else 0.0


def measure_memory(work: Work, frames: int) -> Memory:
    """Make this number of frames in one process that is never replaced, repeating the work's frames if needed."""
    maker = FrameMaker(work.settings)
    rss = []
    for n in range(frames):
        frame = work.frames[n % len(work.frames)]
        maker(Task(frame.frame_id, frame))
        rss.append(resident_mb())
    # ru_maxrss counts KiB on Linux.
    return Memory(rss, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def resident_mb() -> float:
    """Return the current resident memory of this process, MiB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * PAGE_BYTES / 2**20
