"""Removed labels that the report shows as crops: the object, and the insert that covers most of its box."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from infrablend.report.run.facts import Box, FrameFacts, InsertFacts, RemovedLabel

_NEAR, _NEAR_PX = 2.0, 30.0


@dataclass(frozen=True)
class RemovedCrop:
    """A removed label with what the crop shows.

    Attributes:
        frame: Number of its frame.
        label: The removed label.
        box_xyxy: Its box.
        cover: Insert that covers most of the box; None if none touches it.
    """

    frame: int
    label: RemovedLabel
    box_xyxy: Box
    cover: InsertFacts | None

    @property
    def window_xyxy(self) -> Box:
        """Box around the object and the insert, or the part of it near the object where that would be tiny."""
        if self.cover is None:
            return self.box_xyxy
        a, b = self.box_xyxy, self.cover.box_xyxy
        far = max(_NEAR_PX, _NEAR * max(a[2] - a[0], a[3] - a[1]))
        left, top = (max(min(a[k], b[k]), a[k] - far) for k in (0, 1))
        right, bottom = (min(max(a[k], b[k]), a[k] + far) for k in (2, 3))
        return left, top, right, bottom


def removed_crops(frames: Sequence[FrameFacts], most: int) -> dict[str, list[RemovedCrop]]:
    """Return at most `most` removed labels by reason; those of which most can still be seen come first."""
    found: dict[str, list[RemovedCrop]] = {}
    for number, frame in enumerate(frames):
        for label in frame.removed:
            if label.box_xyxy is not None:
                one = RemovedCrop(number, label, label.box_xyxy, _cover(label.box_xyxy, frame.inserts))
                found.setdefault(label.reason, []).append(one)
    return {
        reason: sorted(labels, key=lambda c: (c.label.covered_share, c.frame, c.box_xyxy))[:most]
        for reason, labels in sorted(found.items())
    }


def _cover(box: Box, inserts: Sequence[InsertFacts]) -> InsertFacts | None:
    shared = [(_shared_px(box, i.box_xyxy), i) for i in inserts]
    most = max((area for area, _ in shared), default=0.0)
    return next((i for area, i in shared if area == most), None) if most > 0 else None


def _shared_px(a: Box, b: Box) -> float:
    width, height = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    return max(0.0, width) * max(0.0, height)
