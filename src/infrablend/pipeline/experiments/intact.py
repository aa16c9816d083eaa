"""Tells whether the output of a finished stage is still whole, without reading its files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from infrablend.core.files import read_object
from infrablend.core.finished import CONVERT_FILE, SPLIT_FILE
from infrablend.core.manifest import JOURNAL, REPLACED, Manifest
from infrablend.pipeline.folder import FILES, RunFolder
from infrablend.report.card import CARD_FILE


def lost_files(out: Path) -> list[str]:
    """Return the files of a stage that are gone or of another size than was recorded when they were written, sorted.

    The dataset card is left out, since its last line invites edits.
    """
    lost = {name for manifest in _manifests(out) for name in manifest.lost()}
    run = RunFolder(out)
    listed = (read_object(run.run_file) or {}).get(FILES)
    if isinstance(listed, int) and len(run.listed(run.manifest().read())) < listed:
        lost.add("log/files.jsonl")
    return sorted(lost - {CARD_FILE})


def _manifests(out: Path) -> Iterator[Manifest]:
    yield RunFolder(out).manifest().read()
    plain = Manifest(out, out / JOURNAL, out / REPLACED).read()
    for name in (CONVERT_FILE, SPLIT_FILE):
        plain.add_all((read_object(out / name) or {}).get("written"))
    yield plain
