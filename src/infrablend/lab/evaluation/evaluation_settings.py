"""Settings of an evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from infrablend.core.arguments import require_names
from infrablend.core.dataset import SPLITS
from infrablend.detection.detections import Task
from infrablend.detection.tracking import Tracker
from infrablend.errors import DatasetError

Group = Literal["image", "sequence", "date", "gap"]


@dataclass(frozen=True)
class EvaluationSettings:
    """Settings of an evaluation.

    Attributes:
        split: train, val or test [default: test; without it val, or the only split].
        task: Geometry to compare [default: that of the detector].
        image_size: Longer side of the pictures that the network sees; 0: native size [default: as in training].
        classes: Classes to evaluate [default: all of the dataset].
        ignore_regions: Ignore detections in DontCare regions.
        bootstrap: Bootstrap draws for the intervals; 0: none.
        group: Unit to draw: images, sequences, days, or runs of frame numbers.
        seed: Seed of the draws.
        list_first: List which objects are found among the N detections with the highest scores; 0: no list.
        list_iou: Least overlap to be listed as found.
        by_body: Measure what the pictures show of the objects, and give AP by its size from 2 px.
        tracks: Run a tracker on the sequences, and compare with the labelled tracks: HOTA, MOTA, IDF1.
        tracker: Tracker of `--tracks`, with Ultralytics' default settings.
        stress: Also detect on the same pictures with other borders, places, scales and levels, which must not matter.

    Raises:
        ArgumentError: `classes` is no list of names.
        DatasetError: Another value is not one of these.
    """

    split: str | None = None
    task: Task | None = None
    image_size: int | None = None
    classes: Sequence[str] | None = None
    ignore_regions: bool = True
    bootstrap: int = 1000
    group: Group = "image"
    seed: int = 0
    list_first: int = 0
    list_iou: float = 0.3
    by_body: bool = False
    tracks: bool = False
    tracker: Tracker = "bytetrack"
    stress: bool = False

    def __post_init__(self) -> None:
        require_names("classes", self.classes)
        if self.split is not None and self.split not in SPLITS:
            raise DatasetError(f"split: found {self.split!r}, expected one of {', '.join(SPLITS)}")
        if self.group not in get_args(Group):
            raise DatasetError(f"group: found {self.group!r}, expected one of {', '.join(get_args(Group))}")
        if self.tracker not in get_args(Tracker):
            raise DatasetError(f"tracker: found {self.tracker!r}, expected one of {', '.join(get_args(Tracker))}")
        if self.bootstrap < 0 or (self.image_size or 0) < 0 or self.list_first < 0:
            raise DatasetError("bootstrap, image_size and list_first: expected numbers of at least 0")
        if not 0 < self.list_iou <= 1:
            raise DatasetError(f"list_iou: found {self.list_iou}, expected a number above 0 and up to 1")


DEFAULT_SETTINGS: EvaluationSettings = EvaluationSettings()
