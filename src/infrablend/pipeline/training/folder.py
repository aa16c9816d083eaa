"""Folder of a training: its files, and the record of an earlier training in it."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from infrablend import __version__
from infrablend.core.files import load_json, part_path, write_json
from infrablend.core.manifest import JOURNAL, REPLACED, Manifest
from infrablend.core.output import Existing, OutputFolder, require_existing
from infrablend.errors import OtherSettingsError, OutputError, Problem
from infrablend.training.files import (
    CHECKPOINT,
    DAMAGED,
    LOG,
    NEW_CHECKPOINT,
    RUN,
    ULTRALYTICS,
    WEIGHTS,
    remove_folders,
)

RECORD = "train.json"
JOB = "job.json"
DATA = "data"
TILES = "tiles"
EIGHT_BIT = "8bit"
# What only an unfinished training needs.
WORKING_FOLDERS = (DATA, TILES, EIGHT_BIT, RUN, ULTRALYTICS)
WORKING_FILES = (*WORKING_FOLDERS, CHECKPOINT, NEW_CHECKPOINT)
_OVERWRITTEN = "overwritten"
_SHOWN = 10

log = logging.getLogger(__name__)


def begin_training(out: Path, existing: Existing, manifest: Manifest) -> dict[str, Any] | None:
    """Return the record of the earlier call to continue, or None after emptying the folder."""
    record, damaged = earlier_training(out, existing)
    if record is not None and existing == "resume":
        return record
    if damaged:
        log.warning("%s: cannot be read, or was being replaced; the training starts again", out / RECORD)
    if record is not None or damaged:
        # The record stays until that of the new training replaces it: an interrupted overwrite can be repeated.
        with manifest.recording():
            write_json(out / RECORD, {"infrablend": __version__, "status": _OVERWRITTEN})
        remove_folders(manifest, WORKING_FOLDERS)
        output_folder(out).remove([CHECKPOINT, NEW_CHECKPOINT, DAMAGED, LOG])
        for name in (WEIGHTS, JOB):
            manifest.delete_own(name)
            if os.path.lexists(out / name):
                manifest.move_aside(name)
        manifest.forget_missing()
    return None


def remove_working_files(out: Path, manifest: Manifest) -> None:
    """Delete what a finished training no longer needs; if that fails, warn, because the weights are complete."""
    try:
        remove_folders(manifest, WORKING_FOLDERS)
        output_folder(out).remove([CHECKPOINT, NEW_CHECKPOINT])
        manifest.forget_missing()
    except OutputError as error:
        log.warning("%s; the training is complete, and what is left in %s can be deleted", error, out)


def report_moved(manifest: Manifest) -> None:
    """Log a warning per file that was moved aside."""
    manifest.drop_equal()
    problems = manifest.problems()
    for problem in problems[:_SHOWN]:
        log.warning("%s", problem)
    if len(problems) > _SHOWN:
        log.warning("%d more files were moved to %s", len(problems) - _SHOWN, manifest.root / REPLACED)


def output_folder(out: Path) -> OutputFolder:
    """Return the output folder of a training."""
    return OutputFolder(out, "training", RECORD, can_resume=True, can_overwrite=True)


def earlier_training(out: Path, existing: Existing) -> tuple[dict[str, Any] | None, bool]:
    """Return an earlier call's record and whether it is damaged; refuse both without `resume` or `overwrite`."""
    require_existing(existing)
    path = out / RECORD
    entries = output_folder(out).entries(ignore=[part_path(path).name, JOURNAL, part_path(Path(JOURNAL)).name])
    if not entries:
        return None, False
    try:
        record: dict[str, Any] | None = load_json(path)
        ours = isinstance(record, dict) and "infrablend" in record and "status" in record
    except (OSError, ValueError):
        ours, record = False, None
    damaged = not ours and RECORD in entries and JOB in entries
    if ours and record is not None and record["status"] == _OVERWRITTEN:
        record, damaged = None, True
    if not ours and not damaged:
        raise output_folder(out).refuse_not_ours()
    if existing == "refuse":
        what = f"{RECORD} cannot be read, or was being replaced" if damaged else record["status"] if record else "?"
        raise OutputError(
            f'{out}: contains a training ({what}). Use --resume (existing="resume" in Python) to '
            f'{"start it again" if damaged else "continue it"}, --overwrite (existing="overwrite" in Python) to '
            "replace it, or give another folder."
        )
    return (None, True) if damaged else (record, False)


def require_own_weights(out: Path, manifest: Manifest) -> None:
    """Check that the weights of a finished training are those that it wrote.

    Raises:
        OutputError: They were changed, replaced or linked.
    """
    linked = (out / WEIGHTS).is_symlink()
    if linked or (manifest.exists and not manifest.is_own(WEIGHTS)):  # earlier versions wrote no manifest
        found = "a link" if linked else "changed after the training wrote it"
        raise OutputError(
            f"{out / WEIGHTS}: {found}; expected the weights as the training wrote them. Restore the file, or move it "
            'away and train again with --overwrite (existing="overwrite" in Python)'
        )


def require_same(out: Path, record: Mapping[str, Any], asked: Mapping[str, Any]) -> None:
    """Raise OtherSettingsError if a training to resume was started with other data or settings."""
    now, record = _flat(json.loads(json.dumps(asked))), _flat(record)
    # The data must be the same, not their folder; records of earlier versions have the folder only.
    now.pop("data" if "content" in record else "content")
    # A setting that only one side has also differs.
    more = [k for k in record if k.startswith("settings.") and k not in now]
    other = [k for k in [*now, *more] if record.get(k) != now.get(k)]
    if other:
        problems = [
            Problem(asked["data"], "resume-other",
                    "other labels or pictures", f"those it was started with, then in {record.get('data')}")
            if k == "content"
            else Problem(k, "resume-other", str(now.get(k)), f"{record.get(k)}, as at the start")
            for k in other
        ]  # fmt: skip
        raise OtherSettingsError(f"{out}: was started with other settings; use the same, or another folder", problems)


def _flat(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return a record with flattened settings (`settings.passes`, `settings.arguments.lr0`), without their summary."""
    flat = dict(record)
    settings = dict(flat.pop("settings", {}))
    settings.pop("summary", None)  # prose, which may be reworded
    settings |= {f"arguments.{k}": v for k, v in settings.pop("arguments", {}).items()}
    return flat | {f"settings.{k}": v for k, v in settings.items()}
