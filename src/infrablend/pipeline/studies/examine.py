"""Inspects and checks a dataset folder without changing it."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from infrablend.core.file_names import real_path
from infrablend.core.files import read_object, sha256_of
from infrablend.core.ledger import LEDGER, Ledger
from infrablend.core.output_checks import require_apart
from infrablend.core.run_folder import SHARDS_FILE, RunFolder, ShardFiles
from infrablend.core.tasks import OnProgress, paced
from infrablend.core.workspace import workspace
from infrablend.errors import DatasetError, Problem, Severity, UnknownFormatError
from infrablend.formats import dataset_folder
from infrablend.formats.labels import shards
from infrablend.formats.read_write import READ_ALL, Reading
from infrablend.pipeline.runs.exports import unknown_files
from infrablend.pipeline.runs.packed_shard import damage_of
from infrablend.pipeline.studies.flight_overlap import glance_at_overlap
from infrablend.report.card import CARD_FILE
from infrablend.report.checking import Checking, CheckReport, check_dataset, unreadable
from infrablend.report.inspection import Inspection, inspect_dataset, write_charts

# Codes of problems caused by the command, not by the data.
_USAGE = {"shards-unmerged", "folder-missing", "option-unknown", "option-value", "table-unused"}
INSPECT_FILE = "inspect.json"


def inspect_folder(
    root: Path, out: Path | None = None, *, reading: Reading = READ_ALL, decode: bool = False
) -> Inspection:
    """Return the contents of a dataset; with `out`, also write `inspect.json` and the charts `inspect.png`.

    An earlier inspection in `out` is replaced.

    Raises:
        DatasetError: The dataset cannot be read.
        OutputError: `out` cannot be written, or has anything else in it.
    """
    if out is None:
        return _inspected(root, reading, decode)
    require_apart(root, out)
    with workspace(out, "report", INSPECT_FILE, "overwrite") as space:
        facts = _inspected(root, reading, decode)
        write_charts(facts, space.folder / "inspect.png")
        space.finish(facts.to_json())
    return facts


def _inspected(root: Path, reading: Reading, decode: bool) -> Inspection:
    dataset = dataset_folder.read(root, reading)
    reason = "as asked for" if reading.format else dataset_folder.detect(dataset.root).reasons[dataset.format]
    return replace(inspect_dataset(dataset, reason, decode=decode), overlap=glance_at_overlap(dataset.images))


def check_folder(
    root: Path, *, reading: Reading = READ_ALL, decode: bool = True, on_progress: OnProgress | None = None
) -> CheckReport:
    """Return every problem of labels and pictures; a dataset that cannot be read at all gives a report with errors.

    Files of finished output that were changed or removed since InfraBlend wrote them are problems, too.

    Raises:
        UnknownFormatError: No known format matches the folder.
        DatasetError: The folder does not exist, or the format does not support one of the options.
    """
    try:
        if reading.format in (None, shards.NAME) and shards.detect(root).ok:
            return _check_packed(root, reading, decode, on_progress)
        dataset = dataset_folder.read(root, reading, compare_sizes=False)  # which is done with the other checks
    except UnknownFormatError:
        raise
    except DatasetError as error:
        if not error.problems or any(p.code in _USAGE for p in error.problems):
            raise
        return unreadable(root, error)
    changed = changes_since_written(root, digests=decode)
    dataset = replace(dataset, problems=(*dataset.problems, *changed))
    return check_dataset(dataset, decode=decode, on_image=paced(on_progress))


def _check_packed(root: Path, reading: Reading, decode: bool, on_progress: OnProgress | None) -> CheckReport:
    """Check a run in packed shards with the labels and pictures of one part in memory and on disk."""
    checking = Checking(decode, in_parts=True)
    total = shards.frame_count(root)
    on_image = paced(on_progress)
    with tempfile.TemporaryDirectory(prefix="infrablend-") as pictures:
        for part in dataset_folder.read_parts(root, Path(pictures), reading):
            checking.add(part, on_image=on_image, total=total)
    return checking.report(changes_since_written(root, digests=decode))


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
