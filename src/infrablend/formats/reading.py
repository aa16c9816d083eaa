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
        splits: Splits to read, some of train, val and test; None reads all of them.
        format: Name of the format (docs/reference/formats.md); None detects it.
        form: Annotation form to read where a dataset has several (HIT-UAV: normal_json, rotate_json, normal_xml,
            rotate_xml); None reads all of them.
        metadata: CSV or JSON table of pitch and altitude, for formats whose own files do not contain them.
        options: Further options of the format's reader as text, e.g. `{"pitch_sign": "-1"}` for MONET.

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
