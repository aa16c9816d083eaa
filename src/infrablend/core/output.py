"""Output folders: where results may be written."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from infrablend.errors import OutputError

Existing = Literal["refuse", "resume", "overwrite"]
"""What to do with an output folder that already has results: refuse it, finish them, or replace them."""


def require_apart(data: Path, out: Path) -> None:
    """Check that a command does not write into the data it reads.

    Raises:
        OutputError: `out` is the data folder, contains it, or is inside it.
    """
    a, b = data.resolve(), out.resolve()
    if a == b or b in a.parents:
        raise OutputError(f"--out {out}: is or holds the data folder {data}; choose a folder of its own")
    if a in b.parents:
        raise OutputError(
            f"--out {out}: lies inside the data folder {data}, which is never written to (and a later run would "
            "take its pictures for backgrounds); choose a folder outside it"
        )
