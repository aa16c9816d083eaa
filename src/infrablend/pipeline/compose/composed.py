"""Defines a finished frame in memory, before it is written or handed to a caller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from infrablend.annotation.merge import MergedLabels
from infrablend.core.frame_record import FrameRecord
from infrablend.core.ledger import DoneFrame


@dataclass(frozen=True, eq=False)
class ComposedFrame:
    """A finished frame, as a worker returns it; picklable.

    Attributes:
        record: Scene, labels and the decisions made.
        image_bytes: Image file, the same bytes as in a run.
        seconds: Time spent per step of rendering.
    """

    record: FrameRecord
    image_bytes: bytes
    seconds: Mapping[str, float]


@dataclass(frozen=True)
class MadeFrame:
    """A finished frame whose picture is in the folder of the run, as a worker returns it; picklable.

    Attributes:
        frame: The picture, for the ledger.
        record: Record of the frame, see `FrameRecord.to_text`.
        background_sha256: Digest of its background.
        seconds: Time spent per step of rendering.
    """

    frame: DoneFrame
    record: str
    background_sha256: str
    seconds: Mapping[str, float]

    @classmethod
    def of(cls, record: FrameRecord, size: int, seconds: Mapping[str, float]) -> MadeFrame:
        """Return the frame with this record, and a picture of `size` bytes."""
        frame = DoneFrame(record.image, size, record.image_sha256, len(record.inserted))
        return cls(frame, record.to_text(), str(record.background.get("sha256")), seconds)


def covered_facts(merged: MergedLabels) -> dict[int, dict[str, Any]]:
    """Return `FrameRecord.covered` for merged labels."""
    return {
        n: {"visibility": i.visibility, **({} if i.mask is None else {"mask": i.mask.to_coco()})}
        for n, i in merged.partly_covered.items()
    }
