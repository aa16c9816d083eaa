"""How to read a dataset folder: one value that every command and every function hands on whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from infrablend.core.arguments import require_names


@dataclass(frozen=True)
class Reading:
    """How to read a dataset folder. By default the format is detected and every split is read.

    Attributes:
        splits: Splits to read, from train,val,test [default: all].
        format: Format of the dataset to read [default: detected].
        form: Annotation form to read, e.g. rotate_json [default: all].
        metadata: CSV or JSON table of pitch and altitude.
        options: Option of the dataset reader (docs/formats); repeatable.

    Raises:
        ArgumentError: `splits` is no list of names.
    """

    splits: Sequence[str] | None = None
    format: str | None = None
    form: str | None = None
    metadata: str | Path | None = None
    options: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        require_names("splits", self.splits)


READ_ALL = Reading()
"""The default: detect the format, read every split."""
