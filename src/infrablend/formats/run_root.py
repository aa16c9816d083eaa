"""Finds the labels of a run that is given as a dataset by its root folder."""

from __future__ import annotations

from pathlib import Path

from infrablend.core.files import read_object
from infrablend.core.format_table import FORMATS
from infrablend.core.run_folder import RUN_FILE, RunFolder
from infrablend.errors import DatasetError, Problem

_FIRST = "coco"


def labels_of_run(root: Path, format: str | None) -> tuple[Path, str | None]:
    """Return the folder to read a run from, and the format of its labels; other folders are returned as they are.

    COCO files are read from the root of the run, the labels of the other formats from their own folders, so that each
    picture is read once and with its labels.

    Args:
        root: Folder of a dataset, perhaps of a run.
        format: Wanted format; None takes COCO if the run has it, else the first of the run's formats.

    Raises:
        DatasetError: The run has no labels of the wanted format.
    """
    record = (read_object(root / RUN_FILE) if (root / RUN_FILE).is_file() else None) or {}
    formats = record.get("formats")
    if "infrablend" not in record or not isinstance(formats, list):
        return root, format
    layout = RunFolder(root)
    there = [str(f) for f in formats if str(f) in {*(x.name for x in FORMATS), "native"} and layout.labels(f).is_dir()]
    wanted = format or (_FIRST if _FIRST in there or not there else there[0])
    if not there or (wanted == _FIRST and _FIRST in there):
        return root, format
    if wanted in there:
        return layout.labels(wanted), None if wanted == "native" else wanted
    found = f"a run with labels in {', '.join(there)}"
    problem = Problem(
        str(root), "format-none", found, f"labels in {wanted}", f"leave out --format, or give one of {', '.join(there)}"
    )
    raise DatasetError(f"{root}: cannot be read as {wanted}", [problem])
