"""Prepares the folder of a run for a new, resumed or overwriting run."""

from __future__ import annotations

import contextlib
import json
import shutil
from dataclasses import dataclass
from typing import Any

from infrablend.core.files import write_json
from infrablend.core.format_table import NATIVE, written_names
from infrablend.core.output import Existing, OutputFolder
from infrablend.core.run_layout import IMAGES, LOGS, RUN_FILE, SCENES, RunLayout
from infrablend.errors import OutputError
from infrablend.report.card import CARD_FILE, is_own

# The only folders that `--overwrite` may delete.
OWN_FOLDERS = (IMAGES, *written_names(), NATIVE, SCENES, "realism", LOGS)


@dataclass(frozen=True)
class RunFolder(RunLayout):
    """Folder of one run."""

    def read_run(self) -> dict[str, Any]:
        """Return the run record.

        Raises:
            OutputError: The record does not exist or cannot be read.
        """
        try:
            data = json.loads(self.run_file.read_text("utf-8"))
        except (OSError, ValueError) as error:
            raise OutputError(
                f"{self.run_file}: cannot be read ({error}); expected the record of a run. "
                "Use a folder written by `infrablend generate --out`."
            ) from error
        if not isinstance(data, dict) or "recipe" not in data:
            raise OutputError(f"{self.run_file}: not a run record; expected one written by `infrablend generate`")
        return data

    def write_run(self, data: dict[str, Any]) -> None:
        """Write the run record atomically."""
        write_json(self.run_file, data, indent=2)

    def _sweep(self) -> None:
        """Remove partial files of a killed process; the folder is locked, so no other process is writing."""
        for name in OWN_FOLDERS:
            for left in sorted((self.root / name).rglob(".*.part*")):
                with contextlib.suppress(OSError):
                    left.unlink()

    @property
    def output(self) -> OutputFolder:
        """Output folder with the rules for a run."""
        return OutputFolder(self.root, "run", RUN_FILE, can_resume=True, can_overwrite=True)

    def forget_start(self) -> None:
        """Remove the record and logs of a run that failed before its first frame; the command can then be repeated."""
        shutil.rmtree(self.log_folder, ignore_errors=True)
        self.run_file.unlink(missing_ok=True)

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
            "overwrite": "--overwrite would delete it first",
        }[existing]
        return f"has a run already (status {status}): {then}"

    def prepare(self, existing: Existing) -> dict[str, Any] | None:
        """Prepare the folder; return the record of the run to resume, or None for a new run.

        Raises:
            OutputError: The folder contains a run and `existing` is `refuse`, it contains something else, or it
                cannot be written.
        """
        output = self.output
        entries = output.require_empty(existing=existing)
        if entries and RUN_FILE not in entries:
            raise output.refuse_not_ours()
        if entries:
            record = self.read_run()  # raises if another program wrote this run.json
            if existing == "resume":
                self._sweep()
                return record
            own = [n for n in OWN_FOLDERS if not (self.root / n).is_symlink() and (self.root / n).is_dir()]
            # The record goes last: an overwrite that is interrupted can be repeated.
            output.remove([*own, *([CARD_FILE] if is_own(self.root / CARD_FILE) else []), RUN_FILE])
        output.make_writable()
        return None
