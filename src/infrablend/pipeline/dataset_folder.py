"""Output folder of `convert` and `split`: a record written first and last, and a list of the files written between."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from infrablend import __version__
from infrablend.core.files import part_path, require_still_there, write_json
from infrablend.core.finished import COMPLETE
from infrablend.core.manifest import JOURNAL, REPLACED, Manifest, files_below
from infrablend.core.output import OutputFolder
from infrablend.core.typed_command import command_facts
from infrablend.errors import OutputError, Problem
from infrablend.report.card import CARD_FILE

# Exists only while files are written; then the record lists them.


class DatasetFolder:
    """Folder that one call of a command writes a dataset to."""

    def __init__(self, root: Path, noun: str, record: str) -> None:
        """Name the folder, what is written to it, and the file name of the record."""
        self.root = root
        self._record = record
        self._output = OutputFolder(root, noun, record, can_overwrite=True)
        self._manifest = self._new_manifest()
        self._kept: list[str] = []

    def _new_manifest(self) -> Manifest:
        ignored = (self._record, part_path(Path(self._record)).name)
        return Manifest(self.root, self.root / JOURNAL, self.root / REPLACED, ignored)

    def require_usable(self, overwrite: bool) -> None:
        """Check the folder without touching it.

        Raises:
            OutputError: It is not empty and may not be overwritten, or InfraBlend did not write it.
        """
        entries = self._entries(overwrite)
        if entries:
            self._require_ours(entries)

    @contextlib.contextmanager
    def writing(self, header: Mapping[str, Any], overwrite: bool) -> Iterator[None]:
        """Claim and empty the folder, and record the files that are written to it within the block.

        Args:
            header: Part of the record that is known before the first file.
            overwrite: Delete what an earlier call wrote, except changed files.

        Raises:
            OutputError: The folder cannot be used, or another process is writing to it.
        """
        head = {"infrablend": __version__, **header, **command_facts()}  # the finished record does without the command
        with self._output.claimed():
            self._empty(overwrite, head)
            self._write_record({**head, "status": "running"})
            with self._manifest.recording():
                try:
                    yield
                except BaseException:
                    with contextlib.suppress(OutputError):  # a full disk: the list of files stays in the journal
                        self._write_record({**head, "status": "interrupted", "written": self._manifest.to_json()})
                    raise

    def finish(self, header: Mapping[str, Any], rest: Mapping[str, Any]) -> None:
        """Write the final record, which marks the dataset as finished. Call it within `writing`.

        Raises:
            OutputError: Files have been removed since they were written, or the record cannot be written.
        """
        require_still_there(self._manifest.missing(), "repeat the command with --overwrite")
        head = {"infrablend": __version__, **header, **rest}
        self._write_record({**head, "status": COMPLETE, "written": self._manifest.to_json()})
        self._manifest.delete()
        # After the last change, because a folder may be removed at any moment.
        require_still_there(
            [*self._manifest.missing(), self.root / self._record], "repeat the command with --overwrite"
        )

    def problems(self) -> list[Problem]:
        """Return a warning per file in the folder that this call did not write."""
        self._manifest.drop_equal()
        moved = self._manifest.problems()
        gone = {p.where for p in moved} | {*self._manifest.paths}
        kept = [
            Problem(name, "file-kept", "not written by InfraBlend, or changed since", "",
                    "kept; delete it if the dataset should not contain it", "warning")
            for name in self._kept if name not in gone
        ]  # fmt: skip
        return [*moved, *kept]

    def _write_record(self, data: Mapping[str, Any]) -> None:
        write_json(self.root / self._record, data, indent=2)

    def _entries(self, overwrite: bool) -> list[str]:
        """Return what is in the folder, without what a kill before the first record left."""
        ignored = [part_path(Path(self._record)).name]
        return self._output.require_empty(existing="overwrite" if overwrite else "refuse", ignore=ignored)

    def _require_ours(self, entries: list[str]) -> Manifest:
        """Return the files that an earlier call wrote.

        Raises:
            OutputError: The folder contains anything else.
        """
        record = self._output.read_record()
        earlier = self._new_manifest()
        if record is None or "infrablend" not in record or "status" not in record:
            raise self._output.refuse_not_ours(f"no {self._record} that InfraBlend wrote")
        if not isinstance(record.get("written"), Mapping) and not earlier.exists and record["status"] != "running":
            raise self._output.refuse_not_ours(f"{self._record} does not list the files that were written")
        earlier.read().add_all(record.get("written"))
        own = {path.split("/")[0] for path in earlier.paths}
        own |= {part_path(Path(name)).name for name in own}  # what a kill left of a file
        self._output.require_only({*own, self._record, JOURNAL, REPLACED, CARD_FILE}, entries)
        return earlier

    def _empty(self, overwrite: bool, head: Mapping[str, Any]) -> None:
        """Delete what an earlier call wrote, and note what else there is; the folder is unfinished from then on."""
        entries = self._entries(overwrite)
        if not entries:
            return
        earlier = self._require_ours(entries)
        # With the list, so that a call that is killed while it deletes can be repeated.
        self._write_record({**head, "status": "running", "written": earlier.to_json()})
        earlier.remove_own()
        rest = files_below(self.root, [e for e in entries if e != REPLACED])
        rest += [e for e in entries if not (self.root / e).is_dir() and (self.root / e).exists()]
        self._kept = sorted({*rest} - {self._record, JOURNAL, CARD_FILE})
        # The record stays until the next one replaces it: an interrupted call can be repeated.
        if earlier.exists:
            self._manifest.reset()
