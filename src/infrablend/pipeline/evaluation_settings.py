"""Settings of an evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from infrablend.core.arguments import require_names
from infrablend.core.dataset import SPLITS
from infrablend.errors import DatasetError
from infrablend.formats.groups import GROUPINGS

Group = Literal["image", "sequence", "date", "gap"]
GROUPS: tuple[Group, ...] = ("image", *GROUPINGS)


@dataclass(frozen=True)
class EvaluationSettings:
    """Settings of an evaluation.

    Attributes:
        split: train, val or test.
        task: detect, obb or segment; None for what the detector finds.
        image_size: Longer side of the pictures that the network sees, px; 0 for each picture's own; None for the scale
            that the detector was trained at.
        classes: Classes of the dataset to evaluate; None for all.
        ignore_regions: Whether unmatched detections in ignore regions (DontCare) are not counted.
        bootstrap: Number of draws for the intervals; 0 for none.
        group: What is drawn: image, sequence, date or gap.
        seed: Seed of the draws.
        list_first: Number of detections with the highest scores among which the objects are listed as found or missed;
            0 for no list.
        list_iou: Least overlap with an object to be listed as found.

    Raises:
        ArgumentError: `classes` is no list of names.
        DatasetError: Another value is not one of these.
    """

    split: str = "test"
    task: str | None = None
    image_size: int | None = None
    classes: Sequence[str] | None = None
    ignore_regions: bool = True
    bootstrap: int = 1000
    group: str = "image"
    seed: int = 0
    list_first: int = 0
    list_iou: float = 0.3

    def __post_init__(self) -> None:
        require_names("classes", self.classes)
        if self.split not in SPLITS:
            raise DatasetError(f"split: found {self.split!r}, expected one of {', '.join(SPLITS)}")
        if self.group not in GROUPS:
            raise DatasetError(f"group: found {self.group!r}, expected one of {', '.join(GROUPS)}")
        if self.bootstrap < 0 or (self.image_size or 0) < 0 or self.list_first < 0:
            raise DatasetError("bootstrap, image_size and list_first: expected numbers of at least 0")
        if not 0 < self.list_iou <= 1:
            raise DatasetError(f"list_iou: found {self.list_iou}, expected a number above 0 and up to 1")


DEFAULT_SETTINGS = EvaluationSettings()
