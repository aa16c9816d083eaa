"""The folder of a run: claimed, prepared, resumed."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, get_args

from infrablend.core.files import claimed_folder, write_json
from infrablend.core.format_table import NATIVE, written_names
from infrablend.core.output import Existing
from infrablend.core.run_layout import IMAGES, LOGS, RUN_FILE, SCENES, RunLayout
from infrablend.errors import OutputError
from infrablend.report.card import CARD_FILE, is_own

# What `--overwrite` may delete: these names and nothing else.
OWN_FOLDERS = (IMAGES, *written_names(), NATIVE, SCENES, "realism", LOGS)


@dataclass(frozen=True)
class RunFolder(RunLayout):
    """The folder of one run."""

    def read_run(self) -> dict[str, Any]:
        """The run record.

        Raises:
            OutputError: If there is none or it cannot be read.
        """
        try:
            data = json.loads(self.run_file.read_text("utf-8"))
        except (OSError, ValueError) as error:
            raise OutputError(
                f"{self.run_file}: cannot be read ({error}); expected the record of a run. "
                "Give the folder that `infrablend generate --out` wrote."
            ) from error
        if not isinstance(data, dict) or "recipe" not in data:
            raise OutputError(f"{self.run_file}: not a run record; expected one written by `infrablend generate`")
        return data

    def write_run(self, data: dict[str, Any]) -> None:
        """Write the run record, whole or not at all."""
        write_json(self.run_file, data, indent=2)

    def _sweep(self) -> None:
        """Remove what a killed process had half written; nobody else writes here now."""
        for name in OWN_FOLDERS:
            for left in sorted((self.root / name).rglob(".*.part*")):
                with contextlib.suppress(OSError):
                    left.unlink()

    @contextlib.contextmanager
    def claimed(self) -> Iterator[None]:
        """Keep every other process from writing a run here; the claim ends with the process, however that ends.

        Raises:
            OutputError: If another run is at work here, or the folder cannot be made.
        """
        with claimed_folder(self.root, "another run is writing here; wait for it to end, or give another --out"):
            yield

    def forget_start(self) -> None:
        """Remove what a run leaves that could not make its first frame, so that the same command can be given again."""
        shutil.rmtree(self.log_folder, ignore_errors=True)
        self.run_file.unlink(missing_ok=True)

    def prepare(self, existing: Existing) -> dict[str, Any] | None:
        """Make the folder ready; return the record of the run to resume, or None for a new run.

        Raises:
            OutputError: The folder contains a run and `existing` is `refuse`, it contains something else, or it
                cannot be written.
        """
        if existing not in get_args(Existing):
            raise OutputError(f"existing: found {existing!r}, expected refuse, resume or overwrite")
        if self.root.exists() and not self.root.is_dir():
            raise OutputError(f"{self.root}: is a file; expected a folder, or a name that does not exist yet")
        if self.root.is_dir() and not os.access(self.root, os.R_OK | os.W_OK | os.X_OK):
            raise OutputError(f"{self.root}: cannot be written; expected a folder you may write to")
        entries = sorted(p.name for p in self.root.iterdir()) if self.root.is_dir() else []
        if entries and existing == "refuse":
            raise OutputError(
                f"{self.root}: not empty (found {', '.join(entries[:4])}{' ...' if len(entries) > 4 else ''}); "
                "expected an empty or new folder. Use --resume to go on with an interrupted run, "
                "--overwrite to begin it anew, or another --out."
            )
        if entries and RUN_FILE not in entries:
            raise OutputError(
                f"{self.root}: not empty and not a run of InfraBlend (no {RUN_FILE}); nothing was touched. "
                "Choose another --out."
            )
        if entries:
            record = self.read_run()  # a run.json may be another program's
            if existing == "resume":
                self._sweep()
                return record
        try:
            if entries:
                for name in OWN_FOLDERS:
                    if (self.root / name).is_dir() and not (self.root / name).is_symlink():
                        shutil.rmtree(self.root / name)
                if is_own(self.root / CARD_FILE):
                    (self.root / CARD_FILE).unlink()
                # The record goes last: an overwrite that is interrupted can be repeated.
                self.run_file.unlink()
            self.root.mkdir(parents=True, exist_ok=True)
            probe = self.root / ".writable"
            probe.write_bytes(b"")
            probe.unlink()
        except OSError as error:
            raise OutputError(
                f"{self.root}: cannot be written ({error.strerror or error}); expected a folder you may write to"
            ) from error
        return None
