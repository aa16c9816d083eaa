"""Defines finished frames: in memory, in the folder of a run, and as pictures of a dataset with their labels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from infrablend.annotation.looseness import Looseness, loosen_image
from infrablend.core.dataset import ImageRecord
from infrablend.core.frame_row import FrameRecord
from infrablend.core.ledger import DoneFrame
from infrablend.pipeline.plans.plan import PlannedFrame


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


def labelled_image(
    frame: PlannedFrame, record: FrameRecord, path: Path, looseness: Looseness
) -> tuple[ImageRecord, int]:
    """Return a finished frame as a dataset image at this path, with the metadata of its background.

    The boxes of the objects that the frame inserted are drawn as `looseness` says. Those of its background stay, also
    if an earlier run inserted them.

    Returns:
        The image, and the number of boxes that were changed.
    """
    source = frame.background
    width, height = record.background["size_wh"]
    inserted = replace(
        source,
        id=frame.name,
        path=path,
        size_wh=(width, height),
        instances=record.inserted,
        file_name=record.image.partition("/")[2],
    )
    inserted, count = loosen_image(inserted, looseness)
    return replace(inserted, instances=record.originals(source.instances) + inserted.instances), count
