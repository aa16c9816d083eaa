"""How to read a dataset folder: one value that every command and every function hands on whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from infrablend.core.arguments import require_choice, require_names
from infrablend.errors import ArgumentError


@dataclass(frozen=True)
class Reading:
    """How to read a dataset folder or a video. By default the format is detected and every split is read.

    Attributes:
        splits: Splits to read, from train,val,test [default: all].
        format: Format of the dataset to read [default: detected].
        form: Annotation form to read, e.g. rotate_json [default: all].
        metadata: CSV or JSON table of pitch and altitude.
        options: Option of the dataset reader (docs/formats); repeatable.
        val_share: Make a val split of this share of the training pictures, by whole days and sequences, of data that
            have none.

    Raises:
        ArgumentError: `splits` is no list of names, or the share is not between 0 and 1.
    """

    splits: Sequence[str] | None = None
    format: str | None = None
    form: str | None = None
    metadata: str | Path | None = None
    options: Mapping[str, str] = field(default_factory=dict)
    val_share: float | None = None

    def __post_init__(self) -> None:
        require_names("splits", self.splits)
        share = self.val_share
        if share is not None and not (isinstance(share, int | float) and 0 < share < 1):
            raise ArgumentError(f"val_share: found {share!r}, expected a number between 0 and 1, such as 0.2")


READ_ALL = Reading()
"""The default: detect the format, read every split."""


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
