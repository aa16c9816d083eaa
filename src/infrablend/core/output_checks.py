"""Checks of the places that commands write to, before anything is written; each raises an `OutputError`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from infrablend.core.file_names import can_exist, real_path
from infrablend.core.files import read_object
from infrablend.core.format_table import NATIVE, written_names
from infrablend.core.run_folder import EIGHT_BIT, EXCLUDED, IMAGES, RUN_FILE
from infrablend.core.workspace import CONVERT_FILE, SPLIT_FILE
from infrablend.errors import OutputError, Problem

_OF_RUN = {IMAGES, EIGHT_BIT, EXCLUDED, NATIVE, *written_names()}


def require_replaceable(path: Path, noun: str, *, ours: bool) -> None:
    """Check that a command may write this file: it does not exist, or has the mark of the command (`ours`)."""
    if path.is_dir():
        raise OutputError(f"{path}: is a folder; expected the name of a file")
    if not ours and (path.exists() or path.is_symlink()):
        raise OutputError(
            f"{path}: exists and is not a {noun} of InfraBlend; nothing was touched. Give another file or folder."
        )


def require_no_foreign(foreign: Sequence[Path], out: Path, what: str, expected: str, option: str) -> None:
    """Refuse to replace files in a folder which InfraBlend did not write, in the place of what the command writes."""
    if foreign:
        todo = f"move it away, or give another folder with {option}"
        raise OutputError(
            f"{out}: files in the place of {what} were not written by InfraBlend",
            [Problem(str(p), "file-foreign", "another file", expected, todo) for p in foreign],
        )


def require_apart(data: Path, out: Path) -> None:
    """Check that a command does not write into the data it reads."""
    a, b = real_path(data), real_path(out)
    if a == b or b in a.parents:
        raise OutputError(f"--out {out}: is or contains the data folder {data}; choose a separate folder")
    if a in b.parents:
        raise OutputError(
            f"--out {out}: is inside the data folder {data}, which is never written to (and a later run would "
            "use its images as backgrounds); choose a folder outside it"
        )


def require_outside_datasets(run: Path, out: Path, data: Path | None = None) -> None:
    """Check that a picture of a run is written neither into its backgrounds nor among the files of a dataset.

    Readers would take it for a frame.

    Args:
        run: Folder of the run.
        out: Picture to write.
        data: Folder of the backgrounds, if it has moved.

    Raises:
        OutputError: It would be.
    """
    recorded = (read_object(run / RUN_FILE) or {}).get("data")
    root = recorded.get("root") if isinstance(recorded, dict) else None
    for folder in (data, Path(root) if isinstance(root, str) and can_exist(root) else None):
        if folder is not None:
            require_apart(folder, out)
    place = real_path(out)
    for parent in place.parents:
        first, *deeper = place.relative_to(parent).parts
        of_run = first in _OF_RUN and (parent / RUN_FILE).is_file()
        if deeper and (of_run or any((parent / name).is_file() for name in (CONVERT_FILE, SPLIT_FILE))):
            raise OutputError(
                f"--out {out}: is inside {first}/ of the dataset {parent}, where it would be taken for a file of the "
                "dataset; choose a place outside it"
            )
