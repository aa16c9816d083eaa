"""How to read a dataset folder: one value that every command and every function hands on whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from infrablend.core.arguments import require_names
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
