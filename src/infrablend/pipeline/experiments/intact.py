"""Tells whether the output of a finished stage is still whole, without reading its files."""

from __future__ import annotations

from pathlib import Path

from infrablend.core.ledger import LEDGER
from infrablend.pipeline.written import changes_since_written


def lost_files(out: Path) -> list[str]:
    """Return the files of a stage that makes a run that are gone or have another size than when written, sorted."""
    if not (out / LEDGER).is_file():
        return []
    return sorted(p.where for p in changes_since_written(out, digests=False) if p.severity == "error")
