"""Choices for writing a dataset, which light modules such as the command line can import."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from infrablend.core.arguments import require_choice


@dataclass(frozen=True)
class WriteSettings:
    """Choices for writing; a format without such a choice ignores it.

    New ids keep those of the source as `source_id`. BIRDSAI has `dont_care`, too. An object without a mask and without
    an oriented box is written as its box.

    Attributes:
        ids: New ids, or those of the source, where the format has ids.
        category_ids: Category ids of the source, or from 1: many tools read 0 as background.
        dont_care: YOLO: drop regions to ignore, or keep them as a class.
        without_mask: yolo-seg: omit objects without a mask, or write their oriented box.
        pictures: Whether to link the pictures too, for formats that work without.

    Raises:
        ArgumentError: A value is not one of these.
    """

    ids: Literal["new", "source"] = "new"
    category_ids: Literal["source", "from_one"] = "source"
    dont_care: Literal["drop", "keep"] = "drop"
    without_mask: Literal["omit", "obb"] = "omit"
    pictures: bool = True

    def __post_init__(self) -> None:
        require_choice("ids", self.ids, ("new", "source"))
        require_choice("category_ids", self.category_ids, ("source", "from_one"))
        require_choice("dont_care", self.dont_care, ("drop", "keep"))
        require_choice("without_mask", self.without_mask, ("omit", "obb"))
