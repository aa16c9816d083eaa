"""Joins a finished frame with the metadata of its background."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from infrablend.annotation.looseness import Looseness, loosen_image
from infrablend.core.dataset import ImageRecord
from infrablend.core.frame_record import FrameRecord
from infrablend.pipeline.plans.plan import PlannedFrame


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
