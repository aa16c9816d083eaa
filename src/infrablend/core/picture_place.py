"""Refuses to write sheets of a run into a dataset: readers would take these pictures for frames."""

from __future__ import annotations

from pathlib import Path

from infrablend.core.file_names import can_exist, real_path
from infrablend.core.files import read_object
from infrablend.core.format_table import NATIVE, written_names
from infrablend.core.output import require_apart
from infrablend.core.run_folder import EIGHT_BIT, EXCLUDED, IMAGES, RUN_FILE
from infrablend.core.workspace import CONVERT_FILE, SPLIT_FILE
from infrablend.errors import OutputError

_OF_RUN = {IMAGES, EIGHT_BIT, EXCLUDED, NATIVE, *written_names()}


def require_outside_datasets(run: Path, out: Path, data: Path | None = None) -> None:
    """Check that a picture of a run is written neither into its backgrounds nor among the files of a dataset.

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
