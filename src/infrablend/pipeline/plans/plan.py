"""The plan of a run: its frames, their backgrounds and categories, and the images left out, with reasons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from infrablend.assets.model import ObjectModel
from infrablend.config.recipe import Recipe
from infrablend.core.dataset import Category, Dataset, ImageRecord
from infrablend.errors import Problem
from infrablend.pipeline.plans.shard import Shard
from infrablend.sampling.site import FrameKey
from infrablend.sampling.tracks import Footage


@dataclass(frozen=True, eq=False)
class PlannedFrame:
    """One frame of the run: a background with inserted objects, or the unchanged background.

    Attributes:
        background: Background with classes renamed as the recipe asks.
        configuration: Number k of the configuration, from 0; None for the unchanged background.
        as_read: Background with the source's own class names. Camera height, grey levels and free places are
            derived from these, so that renaming classes does not change the picture.
        name: Stem of the image file: `<background>_c<k>`, or the background's id for the unchanged background; with a
            number appended where another frame of the split has that name.
    """

    background: ImageRecord
    configuration: int | None
    as_read: ImageRecord
    name: str

    @property
    def frame_id(self) -> str:
        """`<split>/<name>`: unique in the run."""
        return f"{self.background.split}/{self.name}"

    @property
    def background_id(self) -> str:
        """`<split>/<id>` of the background."""
        return f"{self.background.split}/{self.background.id}"

    def key(self, size_wh: tuple[int, int]) -> FrameKey:
        """Return the key of the frame's random streams."""
        assert self.configuration is not None
        b = self.background
        return FrameKey(b.id, b.split, self.configuration, size_wh, b.capture)

    def image_path(self, group_by: Sequence[str], suffix: str) -> str:
        """Return the path below `images/`: split, requested groups, file name."""
        b = self.background
        groups = {
            "pitch": "pitch_unknown" if b.capture.pitch_deg is None else f"pitch_{b.capture.pitch_deg:g}",
            "altitude": "altitude_unknown" if b.capture.altitude_m is None else f"altitude_{b.capture.altitude_m:g}",
            "day_night": b.capture.time_of_day or "time_unknown",
        }
        return "/".join([b.split, *(groups[g] for g in group_by), self.name + suffix])


@dataclass(frozen=True, eq=False)
class PlannedSequence:
    """One sequence of a run whose objects move.

    Attributes:
        name: Name of the sequence.
        frames: All of its frames, whichever are made, in their order.
        footage: How camera and time go on.
        first_track: Number of its first track; the source's own are smaller.
        without_place: Frames in which nothing can be placed, such as those of unknown pitch; the run leaves them out.
    """

    name: str
    frames: tuple[PlannedFrame, ...]
    footage: Footage
    first_track: int
    without_place: frozenset[int] = frozenset()


@dataclass(frozen=True, eq=False)
class RunPlan:
    """All decisions made before the first frame.

    Attributes:
        recipe: Validated recipe.
        seed: Seed of the run.
        dataset: Backgrounds, restricted to the requested splits and limit.
        models: Models by the names used in the recipe.
        categories: Categories of the source, then the new ones, with their ids.
        new_categories: Names of the categories that the recipe adds.
        frames: Frames, ordered by split, background and configuration.
        problems: Left-out items with reasons, and warnings.
        key: Values or digests, by field, that must match for a run to be resumed.
        ignored: Original names of the categories that mark ignore regions.
        sample: Pictures from which to measure the grey levels of the dataset. They are spread over all pictures read,
            so that a run with a limit gives the same frames as a full run.
        request: How the backgrounds were read and frames were chosen, for the run record; and under `configurations`,
            what the plan has made of `configurations: auto`, in words.
        levels: Range of grey levels of the dataset, if it has been measured already.
        shard: Shard that `frames` belongs to; None for a whole run.
        run: Identity of the run, in the records of its frames: a digest of recipe and seed. Shards and parts of a run
            have that of the whole.
        sequences: Sequences by name, if the recipe's objects move through them.
        boxes: How loosely boxes are drawn and why, in sentences, where the recipe asked for `labels.loosen: auto`.
    """

    recipe: Recipe
    seed: int
    dataset: Dataset
    models: Mapping[str, ObjectModel]
    categories: tuple[Category, ...]
    new_categories: tuple[str, ...]
    frames: tuple[PlannedFrame, ...]
    problems: tuple[Problem, ...]
    key: Mapping[str, Any]
    ignored: tuple[str, ...] = ()
    sample: tuple[ImageRecord, ...] = ()
    request: Mapping[str, object] = field(default_factory=dict)
    levels: tuple[float, float] | None = None
    shard: Shard | None = None
    run: str = ""
    sequences: Mapping[str, PlannedSequence] = field(default_factory=dict)
    boxes: str = ""

    @property
    def needs_levels(self) -> bool:
        """True if the recipe needs the range of grey levels of the whole dataset."""
        r = self.recipe
        return any(section.needs_levels for section in (r.appearance, r.sensor, r.placement))
