"""Output folder of a virtual world: its record marks it as finished, and an interrupted call can be repeated."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from infrablend import __version__
from infrablend.core.files import part_path, require_still_there, write_json
from infrablend.core.finished import COMPLETE, WORLD_FILE, is_finished
from infrablend.core.manifest import JOURNAL, REPLACED, Manifest
from infrablend.core.output import OutputFolder
from infrablend.core.typed_command import command_facts

_FRAMES = ".frames"


class WorldFolder:
    """Folder that one call of `infrablend world` writes.

    Attributes:
        root: Path of the folder.
    """

    def __init__(self, root: Path) -> None:
        """Name the folder without touching it."""
        self.root = root
        self._output = OutputFolder(root, "virtual world", WORLD_FILE)
        self._manifest = self._new_manifest()

    def _new_manifest(self) -> Manifest:
        ignored = (WORLD_FILE, part_path(Path(WORLD_FILE)).name, _FRAMES)
        return Manifest(self.root, self.root / JOURNAL, self.root / REPLACED, ignored)

    @contextlib.contextmanager
    def writing(self) -> Iterator[Path]:
        """Claim the folder, remove what an interrupted call left, and yield the folder for finished frames.

        If the block fails, nothing that this call wrote remains.

        Raises:
            OutputError: The folder contains anything else, or cannot be written.
        """
        new = not self.root.exists()
        try:
            with self._output.claimed():
                self._remove_unfinished()
                self._write_record({**command_facts(), "status": "running"})
                try:
                    with self._manifest.recording():
                        yield self.root / _FRAMES
                except BaseException:
                    self._remove(self._manifest)
                    raise
                finally:
                    # The dataset links the finished images by now.
                    shutil.rmtree(self.root / _FRAMES, ignore_errors=True)
        finally:
            if new:
                with contextlib.suppress(OSError):  # not empty
                    self.root.rmdir()

    def finish(self, facts: Mapping[str, Any]) -> None:
        """Write the record, which marks the dataset as finished. Call it within `writing`.

        Raises:
            OutputError: Files have been removed since they were written, or the record cannot be written.
        """
        require_still_there(self._manifest.missing())
        self._write_record({**facts, "status": COMPLETE})
        self._manifest.delete()
        require_still_there([*self._manifest.missing(), self.root / WORLD_FILE])  # after the last change

    def _write_record(self, facts: Mapping[str, Any]) -> None:
        write_json(self.root / WORLD_FILE, {"infrablend": __version__, **facts})

    def _remove_unfinished(self) -> None:
        """Delete what an interrupted call wrote; refuse a folder that contains anything else."""
        ignored = [part_path(Path(WORLD_FILE)).name]
        record = self._output.read_record()
        if self._output.entries(ignore=ignored) and record is not None and not is_finished(record):
            self._remove(self._new_manifest().read())
        self._output.require_empty(ignore=ignored)

    def _remove(self, manifest: Manifest) -> None:
        shutil.rmtree(self.root / _FRAMES, ignore_errors=True)
        manifest.remove_own()
        manifest.delete()
        (self.root / WORLD_FILE).unlink(missing_ok=True)
