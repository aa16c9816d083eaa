"""Facts that the report of a run shows, lists of frames that its numbers lead to, and removed labels to show as crops.

The records of the frames already hold all facts. A list has an anchor; the page's style hides all other frames when the
anchor is the target of a link, so that the page works without scripts.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from infrablend.core.frame_row import Box, FrameRow, InsertRow, RemovedLabel
from infrablend.core.run_record import RunTiming
from infrablend.errors import Problem

_NEAR = 2.0
_NEAR_PX = 30.0


@dataclass(frozen=True)
class RunFacts:
    """Content of the report of a run.

    Attributes:
        root: Folder of the run, from which the pictures are read; the page does not name it.
        recipe: Name of the recipe.
        settings: Settings of the recipe that are not the default, as YAML.
        command: Command that makes the run again from `settings`.
        version: Version of InfraBlend.
        made: Further facts about how the run was made, (name, value).
        excluded: Frames that were left out of the finished run, each with its reason.
        timing: Times, as in its record; the only facts that differ between equal runs.
        frames: Finished frames.
    """

    root: Path
    recipe: str
    description: str
    settings: str
    command: str
    version: str
    made: Sequence[tuple[str, str]]
    counts: Mapping[str, Any]
    problems: Sequence[Problem]
    excluded: Mapping[str, str]
    timing: RunTiming
    machine: Mapping[str, Any]
    frames: Sequence[FrameRow]


@dataclass(frozen=True)
class RemovedCrop:
    """A removed label with what the crop shows: its box, and the insert that covers most of it, if any does."""

    frame: int
    label: RemovedLabel
    box_xyxy: Box
    cover: InsertRow | None

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


def removed_crops(frames: Sequence[FrameRow], most: int) -> dict[str, list[RemovedCrop]]:
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


def _cover(box: Box, inserts: Sequence[InsertRow]) -> InsertRow | None:
    shared = [(_shared_px(box, i.box_xyxy), i) for i in inserts]
    most = max((area for area, _ in shared), default=0.0)
    return next((i for area, i in shared if area == most), None) if most > 0 else None


def _shared_px(a: Box, b: Box) -> float:
    width, height = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    return max(0.0, width) * max(0.0, height)


@dataclass(frozen=True)
class Filter:
    """A list of frames: its anchor, what they have in common, and their numbers, ascending."""

    name: str
    title: str
    frames: tuple[int, ...]


class Filters:
    """All lists of frames of a page."""

    def __init__(self) -> None:
        self.all: list[Filter] = []

    def add(self, title: str, frames: Iterable[int]) -> str:
        """Add a list of frames and return the link to it; empty without frames."""
        found = tuple(sorted(set(frames)))
        if not found:
            return ""
        name = f"f{len(self.all)}"
        self.all.append(Filter(name, title, found))
        return f"#{name}"

    def classes(self, count: int) -> list[list[str]]:
        """Return for each of `count` frames the names of its lists."""
        found: list[list[str]] = [[] for _ in range(count)]
        for one in self.all:
            for k in one.frames:
                found[k].append(one.name)
        return found
