"""Compares a finished run with the sizes and digests in its ledger, or in the records of its packed shards."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from infrablend.core.file_names import real_path
from infrablend.core.files import read_object, sha256_of
from infrablend.core.ledger import LEDGER, Ledger
from infrablend.core.run_folder import SHARDS_FILE, RunFolder, ShardFiles
from infrablend.errors import Problem, Severity
from infrablend.pipeline.runs.exports import unknown_files
from infrablend.pipeline.runs.packed_shard import damage_of
from infrablend.report.card import CARD_FILE

CHANGED = "file-changed"
GONE = "file-gone"
_TODO = "repeat the command of the run with --resume, which makes missing pictures and writes the labels again"


def changes_since_written(folder: Path, *, digests: bool = True) -> list[Problem]:
    """Return a problem per file of a run that was changed or removed since it was written; none for other folders.

    Args:
        folder: Folder of a run, or a folder inside it; then only files of that folder, and the pictures of the run, are
            compared.
        digests: Whether to read the files; otherwise only their sizes are compared.
    """
    inside = real_path(folder)
    if (inside / SHARDS_FILE).is_file():
        return list(_of_shards(inside, digests))
    for root in (inside, inside.parent):
        if (root / LEDGER).is_file():
            problems = list(_of_run(RunFolder(root), digests))
            wanted = {inside.name, "images"}
            return [p for p in problems if root == inside or p.where.split("/")[0] in wanted]
    return []


def _of_run(folder: RunFolder, digests: bool) -> Iterator[Problem]:
    with folder.ledger() as ledger:
        for name, size, sha256 in _files(ledger):
            path = folder.root / name
            if not path.is_file():
                yield Problem(name, GONE, "removed after InfraBlend wrote it", "the file as written", _TODO)
            elif path.lstat().st_size != size or (digests and sha256_of(path, folder.root) != sha256):
                # Texts for readers decide nothing; labels and pictures do.
                level: Severity = "error" if "/" in name else "warning"
                advice = f"remove it and {_TODO}. To edit labels, convert the run and edit the conversion"
                yield Problem(name, CHANGED, "changed after InfraBlend wrote it", "the file as written", advice, level)
        for name in unknown_files(folder, ledger):
            yield Problem(name, "file-foreign", "not written by this run", "", "move it elsewhere", "warning")


def _files(ledger: Ledger) -> Iterator[tuple[str, int, str]]:
    """Yield path, size and digest of the files of a run; the last line of its card invites edits."""
    excluded = ledger.excluded()
    for frame_id, frame in ledger.done().items():
        if frame_id not in excluded:
            yield f"images/{frame.image}", frame.bytes, frame.sha256
    yield from (file for file in ledger.exports() if file[0] != CARD_FILE)


def _of_shards(root: Path, digests: bool) -> Iterator[Problem]:
    for marker in sorted(root.glob("shard-*-of-*.json")):
        record = read_object(marker) or {}
        todo = "repeat the command of the shard with --resume, which makes it again"
        if (found := damage_of(ShardFiles(root, marker.stem), record, digests=digests)) is not None:
            yield Problem(marker.stem, CHANGED, found, "the shard as written", todo)
