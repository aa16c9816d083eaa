"""Inspects and checks a dataset folder without changing it."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

from infrablend.core.output_checks import require_apart
from infrablend.core.tasks import OnProgress, paced
from infrablend.core.workspace import workspace
from infrablend.errors import DatasetError, UnknownFormatError
from infrablend.formats import detection
from infrablend.formats.labels import shards
from infrablend.formats.reading import READ_ALL, Reading
from infrablend.pipeline.runs.written import changes_since_written
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
    dataset = detection.read(root, reading)
    reason = "as asked for" if reading.format else detection.detect(dataset.root).reasons[dataset.format]
    return inspect_dataset(dataset, reason, decode=decode)


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
        dataset = detection.read(root, reading)
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
        for part in detection.read_parts(root, Path(pictures), reading):
            checking.add(part, on_image=on_image, total=total)
    return checking.report(changes_since_written(root, digests=decode))
