"""Defines a finished frame in memory, before it is written or handed to a caller."""

from __future__ import annotations

from dataclasses import dataclass

from infrablend.pipeline.frame_settings import FrameDone
from infrablend.pipeline.record import FrameRecord


@dataclass(frozen=True, eq=False)
class ComposedFrame:
    """A finished frame, as a worker returns it; picklable.

    Attributes:
        record: Scene, labels and the decisions made.
        image_bytes: Image file, the same bytes as in a run.
        done: Counts and times for progress and the run record.
    """

    record: FrameRecord
    image_bytes: bytes
    done: FrameDone
