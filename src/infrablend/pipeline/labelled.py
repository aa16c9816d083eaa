"""Joins a finished frame with the metadata of its background."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from infrablend.core.dataset import ImageRecord
from infrablend.pipeline.plan import PlannedFrame
from infrablend.pipeline.record import FrameRecord


def labelled_image(frame: PlannedFrame, record: FrameRecord, path: Path) -> ImageRecord:
    """Return a finished frame as a dataset image at this path, with the metadata of its background."""
    source = frame.background
    kept = record.originals(source.instances)
    width, height = record.background["size_wh"]
    return replace(
        source,
        id=frame.name,
        path=path,
        size_wh=(width, height),
        instances=kept + record.inserted,
        file_name=record.image.partition("/")[2],
    )
