"""Prepares the folder of a run for a new, resumed or overwriting run."""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from infrablend.core.files import load_json, output_error, part_path, sha256_of_json, write_json
from infrablend.core.format_table import NATIVE, written_names
from infrablend.core.manifest import REPLACED, Manifest, files_below, remove_empty
from infrablend.core.output import Existing, OutputFolder
from infrablend.core.run_layout import (
    EIGHT_BIT,
    EXCLUDED,
    EXCLUDED_FILE,
    IMAGES,
    LOGS,
    PICTURE_TABLES,
    RUN_FILE,
    SCENES,
    SHARDS_FILE,
    RunLayout,
)
from infrablend.errors import OutputError, Problem
from infrablend.pipeline.excluded import excluded_files, read_choice
from infrablend.pipeline.record import RecordError, load_record
from infrablend.pipeline.review import REVIEW_FILE
from infrablend.pipeline.run_fields import damage

log = logging.getLogger(__name__)

# Folders that contain nothing but what the run writes.
DATASET_FOLDERS = (IMAGES, *written_names(), NATIVE, SCENES, EIGHT_BIT)
LOG_FILES = ("run.log", "workers.log")
MANIFEST = "files.jsonl"


RUN = "run"
"""Field of a run record with the identity that the records of its frames name."""
FILES = "files"
"""Field of a run record with the number of files in its manifest, without those of frames."""
DIGEST = "sha256"
"""Field of a run record with the digest of the fields that decide what the run is."""

ARCHIVE = "archive"
"""Field of the record of a shard with sizes and digests of its tar and its table."""

_DECIDING = (ARCHIVE, "categories", "formats", "key", "levels", "recipe", "request", "run", "seed", "shard")


def _digest_of(record: Mapping[str, Any]) -> str:
    deciding: dict[str, Any] = {k: record[k] for k in _DECIDING if k in record}
    machine = record.get("machine")  # but not the number of workers, which decides nothing
    deciding["renderer"] = machine.get("renderer") if isinstance(machine, Mapping) else None
    return sha256_of_json(deciding)


def is_edited(record: Mapping[str, Any]) -> bool:
    """Return whether a field of a run record that decides what the run is was changed after it was written."""
    return DIGEST in record and record[DIGEST] != _digest_of(record)


def read_run_file(file: Path) -> dict[str, Any]:
    """Return the record of a run or of a shard.

    Raises:
        OutputError: The record does not exist or cannot be read.
    """
    try:
        data = load_json(file)
    except (OSError, ValueError) as error:
        raise OutputError(
            f"{file}: cannot be read ({error}); expected the record of a run. Use a folder written by "
            "`infrablend generate --out`, or make the run again with --overwrite."
        ) from error
    if not isinstance(data, dict) or not {"recipe", "infrablend"} <= data.keys():
        raise OutputError(f"{file}: not a run record; expected one written by `infrablend generate`")
    if is_edited(data):
        raise OutputError(
            f"{file}: changed after InfraBlend wrote it ({', '.join(_DECIDING)} or machine.renderer); "
            "expected the record as written. Restore it, or make the run again with --overwrite."
        )
    if (found := damage(data)) is not None:
        raise OutputError(
            f"{file}: damaged ({found}); expected the record of a run as `infrablend generate` writes it. "
            "Restore it, or make the run again with --overwrite."
        )
    return data


def sealed(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return a run record with a digest of what decides the run."""
    return {**record, DIGEST: _digest_of(record)}


@dataclass(frozen=True)
class RunFolder(RunLayout):
    """Folder of one run.

    Attributes:
        noun: Name of what the folder contains, for messages.
    """

    noun: str = "run"

    def read_run(self) -> dict[str, Any]:
        """Return the run record.

        Raises:
            OutputError: The record does not exist or cannot be read.
        """
        if not os.path.lexists(self.run_file) and os.path.lexists(self.root / SHARDS_FILE):
            raise OutputError(
                f"{self.root}: found shards of a run, expected a run. Merge the shards first: "
                f"infrablend merge {self.root} DST"
            )
        return read_run_file(self.run_file)

    def write_run(self, data: dict[str, Any]) -> None:
        """Write the run record atomically, with a digest of what decides the run."""
        write_json(self.run_file, sealed(data), indent=2)

    def manifest(self) -> Manifest:
        """Return the manifest of the files that the run writes, unread; frames have their own records instead."""
        ignored = (IMAGES, SCENES, LOGS, RUN_FILE, EXCLUDED, EXCLUDED_FILE, part_path(self.run_file).name)
        return Manifest(self.root, self.log_folder / MANIFEST, self.log_folder / REPLACED, ignored, PICTURE_TABLES)

    @staticmethod
    def listed(manifest: Manifest) -> list[str]:
        """Return the files with known content in the manifest of a run, without those of frames."""
        names = (name for name in manifest.paths if name.split("/")[0] not in (IMAGES, SCENES, EXCLUDED))
        return [name for name in names if manifest.has_content(name)]

    def strays(self, known: Iterable[str]) -> list[str]:
        """Return the files in the folders of the dataset that are not among the known ones, sorted."""
        return sorted({*files_below(self.root, DATASET_FOLDERS)} - {*known})

    @property
    def output(self) -> OutputFolder:
        """Output folder with the rules for a run."""
        return OutputFolder(self.root, self.noun, RUN_FILE, can_resume=True, can_overwrite=True)

    def forget_start(self) -> None:
        """Remove the record and logs of a run that failed before its first frame; the command can then be repeated."""
        for name in (*LOG_FILES, MANIFEST):
            (self.log_folder / name).unlink(missing_ok=True)
        remove_empty(self.root, [f"{LOGS}/{MANIFEST}"])
        self.run_file.unlink(missing_ok=True)

    def clear_remains(self, manifest: Manifest, record: Mapping[str, Any]) -> None:
        """Remove what this call wrote to a folder that it made itself, because its own had been removed.

        Pictures whose record is gone cannot be shown to be InfraBlend's and stay, with the record of an unfinished run,
        so that `resume` finishes it. Nothing is done if another run uses the folder.
        """
        if self.output.is_claimed() or os.path.lexists(self.run_file):
            return
        with contextlib.suppress(OutputError):
            manifest.remove_own()
            if self.output.entries():
                self.write_run({**record, "status": "interrupted"})

    def _remove_start(self) -> None:
        """Remove what a run leaves that was killed, or ran out of space, before its first record.

        Logs are the only files that are written before the record.
        """
        part_path(self.run_file).unlink(missing_ok=True)
        names = [p.name for p in sorted(self.root.iterdir())]
        if names == [LOGS] and self.log_folder.is_dir() and not self.log_folder.is_symlink():
            found = {p.name for p in sorted(self.log_folder.iterdir())}
            if found <= {*LOG_FILES, MANIFEST, part_path(Path(MANIFEST)).name}:
                shutil.rmtree(self.log_folder, ignore_errors=True)

    def _require_plain_logs(self) -> None:
        """Refuse anything but files where the logs are written: opening a pipe would wait for ever."""
        for name in (*LOG_FILES, MANIFEST):
            path = self.log_folder / name
            if os.path.lexists(path) and (path.is_symlink() or not path.is_file()):
                expected, todo = "a file", "remove it and repeat the command"
                problem = Problem(str(path), "log-not-a-file", "a link, pipe or folder", expected, todo)
                raise OutputError(f"{self.root}: the logs cannot be written", [problem])

    def _require_own_folders(self) -> None:
        """Refuse links in place of the run's folders: files would be written, moved and deleted elsewhere."""
        tops = [self.root / name for name in (*DATASET_FOLDERS, EXCLUDED)]
        below = [child for top in tops if top.is_dir() and not top.is_symlink() for child in sorted(top.iterdir())]
        links = [path for path in (*tops, *below) if path.is_symlink() and path.is_dir()]
        if links:
            todo = "remove the link, or move the folder back"
            raise OutputError(
                f"{self.root}: folders of the {self.noun} are links; nothing was touched",
                [Problem(str(path), "folder-linked", "a link", "a folder", todo) for path in links],
            )

    def outlook(self, existing: Existing) -> str | None:
        """Return what a run would do with the present contents of the folder; None if there are none.

        Nothing is touched.
        """
        output = self.output
        try:
            entries = output.entries()
            if not entries:
                return None
            if RUN_FILE not in entries:
                raise output.refuse_not_ours()
            status = self.read_run().get("status", "unknown")
        except OutputError as error:
            return f"would be refused: {error.message}"
        then = {
            "refuse": "would be refused without --resume (finish it) or --overwrite (replace it)",
            "resume": "--resume would keep its finished frames and make the missing ones",
            "overwrite": "--overwrite would delete it first, except for files that the run did not write",
        }[existing]
        return f"has a run already (status {status}): {then}"

    def prepare(self, existing: Existing) -> dict[str, Any] | None:
        """Prepare the folder; return the record of the run to resume, or None for a new run.

        Raises:
            OutputError: The folder contains a run and `existing` is `refuse`, it contains something else, or it
                cannot be written.
        """
        output = self.output
        if self.root.is_dir():
            self._require_plain_logs()
            try:
                self._remove_start()
            except OSError as error:
                raise output_error(self.root, error) from error
        entries = output.require_empty(existing=existing)
        if entries and RUN_FILE not in entries:
            raise output.refuse_not_ours()
        self._require_own_folders()
        if entries:
            try:
                record = self.read_run()  # raises if another program wrote this run.json
            except OutputError:
                # The manifest proves that the run is ours: a damaged record must not be a dead end.
                if existing != "overwrite" or not self.manifest().exists:
                    raise
                self.manifest().read().keep_aside(RUN_FILE)
                record = {}
            if existing == "resume":
                return record
            self._remove_run(record)
        output.make_writable()
        return None

    def _move_aside(self, manifest: Manifest, name: str) -> None:
        log.warning("%s belongs to the run that is overwritten: moved to %s", name, manifest.move_aside(name))

    def _remove_run(self, record: Mapping[str, Any]) -> None:
        """Delete what a run wrote and nobody changed; the record stays until the next run replaces it."""
        manifest = self.manifest()
        if not manifest.exists:
            raise self.output.refuse_not_ours(f"no {LOGS}/{MANIFEST}, which lists the files that the run wrote")
        # An overwrite that is interrupted can be repeated, and does not pass for a finished run.
        self.write_run({**record, "status": "overwritten"})
        manifest.read()
        for path in self.records():
            with contextlib.suppress(RecordError):
                frame = load_record(path)
                manifest.add_present(f"{IMAGES}/{frame.image}", frame.image_sha256)
                manifest.add_present(path.relative_to(self.root).as_posix())
        for name, digest in excluded_files(self).items():
            manifest.add_present(name, digest)
        if os.path.lexists(self.excluded_file):
            try:
                read_choice(self)
                manifest.add_present(EXCLUDED_FILE)
            except OutputError:  # somebody else wrote it
                self._move_aside(manifest, EXCLUDED_FILE)
        if os.path.lexists(self.root / REVIEW_FILE):  # of the pictures that are removed now
            self._move_aside(manifest, REVIEW_FILE)
        for name in LOG_FILES:
            manifest.add_present(f"{LOGS}/{name}")
        manifest.remove_own()
