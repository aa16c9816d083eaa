"""Facts that the report of a run shows; the records of the frames already hold all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from infrablend.errors import Problem

Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class InsertFacts:
    """An inserted object that has a label.

    Attributes:
        category: Class of the label.
        box_xyxy: Its box, pixels.
        range_m: Distance from the camera to the object; None if it is not recorded.
        change_grey: Smaller of the change of its pixels and the change of its box against the ring, 8-bit levels; None
            if it is not recorded.
        signed_grey: Contrast against the ring, 8-bit levels, negative for a darker object; None if not measured.
        visibility: Visible share; None if unknown.
    """

    category: str
    box_xyxy: Box
    range_m: float | None = None
    change_grey: float | None = None
    signed_grey: float | None = None
    visibility: float | None = None

    @property
    def size_px(self) -> float:
        """Longer side of the box."""
        x0, y0, x1, y1 = self.box_xyxy
        return max(x1 - x0, y1 - y0)


@dataclass(frozen=True)
class RemovedLabel:
    """A label that was left out of a frame.

    Attributes:
        category: Class of the object.
        reason: `covered`, `category` or `labels`, see `annotation.merge.Removal`.
        covered_share: Share of the object under inserted objects.
        inserted: True for the label of an inserted object.
        box_xyxy: Its box, pixels; None if it is not recorded.
    """

    category: str
    reason: str
    covered_share: float
    inserted: bool = False
    box_xyxy: Box | None = None


@dataclass(frozen=True)
class FrameFacts:
    """A finished frame.

    Attributes:
        frame_id: Id of the frame.
        image: Path of its picture, relative to the folder of the run.
        size_wh: Size of the picture.
        background: Names that problems use for its background: id, path, file name.
        time_of_day: Time of day; None if unknown.
        pitch_deg: Pitch of the camera that the objects were rendered with, else of the background; None if unknown.
        altitude_m: Height of the camera; None if unknown.
        inserts: Labelled inserted objects.
        removed: Labels that were left out.
        dropped: Reasons why wanted objects are absent or have no label, one per object.
        warnings: Codes of the warnings that the frame contributes to.
    """

    frame_id: str
    image: str
    size_wh: tuple[int, int]
    background: frozenset[str]
    time_of_day: str | None
    pitch_deg: float | None
    altitude_m: float | None
    inserts: tuple[InsertFacts, ...]
    removed: tuple[RemovedLabel, ...] = ()
    dropped: tuple[str, ...] = ()
    warnings: frozenset[str] = frozenset()


@dataclass(frozen=True)
class RunFacts:
    """Content of the report of a run.

    Attributes:
        root: Folder of the run, from which the pictures are read; the page does not name it.
        recipe: Name of the recipe.
        description: Its description.
        settings: Settings of the recipe that are not the default, as YAML.
        command: Command that makes the run again from `settings`.
        version: Version of InfraBlend.
        made: Further facts about how the run was made, (name, value).
        counts: Counts of the run, as in its record.
        problems: Problems of the run, as in its record.
        excluded: Frames that were left out of the finished run, each with its reason.
        timing: Times, as in its record; the only facts that differ between equal runs.
        machine: Machine of the run, as in its record.
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
    timing: Mapping[str, Any]
    machine: Mapping[str, Any]
    frames: Sequence[FrameFacts]
