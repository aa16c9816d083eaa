"""Folder of an evaluation: what an earlier call wrote there is replaced, edited and foreign files are kept."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from infrablend.core.files import part_path, require_still_there
from infrablend.core.manifest import JOURNAL, REPLACED, Manifest, files_below
from infrablend.core.output import OutputFolder
from infrablend.errors import OutputError, Problem
from infrablend.evaluation.detections import MATCHES, RECORD
from infrablend.pipeline.detection_source import PREDICTIONS

PAGE, PLOTS = "evaluation.html", "plots"
_OWN = frozenset({PREDICTIONS, RECORD, PAGE, MATCHES, PLOTS})
# What a killed call leaves of a file that it was writing.
_PARTS = frozenset(part_path(Path(name)).name for name in (*_OWN - {PLOTS}, JOURNAL))


class EvaluationFolder:
    """Folder that one call of `evaluate` writes."""

    def __init__(self, root: Path) -> None:
        """Name the folder without touching it."""
        self._root = root
        self._output = OutputFolder(root, "evaluation", RECORD, can_overwrite=True)
        self._manifest = Manifest(root, root / JOURNAL, root / REPLACED)

    def require_usable(self, overwrite: bool) -> None:
        """Check the folder without touching it.

        Raises:
            OutputError: It is not empty and may not be overwritten, or contains something else.
        """
        entries = self._output.entries(ignore=[JOURNAL, part_path(Path(JOURNAL)).name])
        self._output.require_only({*_OWN, *_PARTS, REPLACED}, entries)
        if entries and not overwrite:
            self._output.require_empty()

    def claimed(self) -> contextlib.AbstractContextManager[object]:
        """Return a context in which no other command writes to the folder."""
        return self._output.claimed()

    @contextlib.contextmanager
    def writing(self) -> Iterator[None]:
        """Delete an earlier evaluation, and list the files that are written within the block.

        Its detections stay until the new ones replace them.

        Raises:
            OutputError: A file cannot be deleted, or files were removed before the end.
        """
        self._manifest.read()
        self._remove_record()
        self._output.remove(name for name in sorted(_PARTS) if not (self._root / name).is_dir())
        self._manifest.remove_own(keep=[PREDICTIONS])
        if (self._root / PLOTS).is_symlink():
            self._manifest.move_aside(PLOTS)
        self._manifest.forget_missing()
        with self._manifest.recording():
            yield
        self._manifest.forget_missing()
        try:  # after the last write: a folder may be removed at any moment
            require_still_there(self._manifest.missing(), "repeat the command with --overwrite")
        except OutputError:
            self._remove_record()
            raise

    def _remove_record(self) -> None:
        """Remove the record, which marks the evaluation as complete, before anything else."""
        if self._manifest.is_own(RECORD):
            self._manifest.delete_own(RECORD)
        elif os.path.lexists(self._root / RECORD):
            self._manifest.move_aside(RECORD)

    def problems(self) -> list[Problem]:
        """Return a warning per file that was moved aside, and per file in the folder that this call did not write."""
        self._manifest.drop_equal()
        kept = sorted({*files_below(self._root, [PLOTS])} - {*self._manifest.written})
        return [
            *self._manifest.problems(),
            *(
                Problem(name, "file-kept", "not written by InfraBlend, or changed since", "",
                        "kept; delete it if the evaluation should not contain it", "warning")
                for name in kept
            ),
        ]  # fmt: skip
