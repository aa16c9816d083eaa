"""Writes the report of a run, `report.html`, from the records that the run wrote anyway."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from infrablend.core.files import write_bytes
from infrablend.core.frame_row import FrameRow
from infrablend.core.run_folder import RunFolder
from infrablend.core.run_record import RunRecord
from infrablend.core.typed_command import run_command
from infrablend.errors import Problem
from infrablend.pipeline.datasets.origin import recipe_yaml
from infrablend.pipeline.runs.recorded import recorded_recipe
from infrablend.report.run.run_facts import RunFacts
from infrablend.report.run.run_page import run_page


def report_run(run: Path) -> Path:
    """Write the report of a finished run again, and return its path.

    Raises:
        OutputError: The folder is not a finished run, or cannot be written.
    """
    folder = RunFolder(run)
    with folder.ledger() as ledger:
        return write_report(folder, ledger.read_run(), ledger.rows(), ledger.excluded())


def write_report(layout: RunFolder, record: RunRecord, frames: Iterable[FrameRow], excluded: Mapping[str, str]) -> Path:
    """Write the report of a run and return its path."""
    rows = sorted(frames, key=lambda f: f.id)
    page = run_page(_run_facts(layout.root, record, rows, excluded))
    # Names from the data may hold what UTF-8 cannot.
    return write_bytes(layout.report_file, page.encode("utf-8", "replace"))


def _run_facts(root: Path, record: RunRecord, frames: Sequence[FrameRow], excluded: Mapping[str, str]) -> RunFacts:
    recipe = dict(record["recipe"])
    data = record.get("data", {})
    return RunFacts(
        root=root,
        recipe=str(recipe.get("name", "")),
        description=str(recipe.get("description") or ""),
        settings=recipe_yaml(recorded_recipe(record)),
        command=shlex.join(run_command(record, "recipe.yaml", "DATA", "RUN")),  # of no machine
        version=str(record["infrablend"]),
        made=(
            ("backgrounds", f"{data.get('backgrounds', 0)} pictures, format {data.get('format', 'unknown')}"),
            ("seed", str(record.get("seed", ""))),
            ("label formats", ", ".join(record.get("formats", ()))),
        ),
        counts=record.get("counts", {}),
        problems=[Problem(**p) for p in record.get("problems", ())],
        excluded=excluded,
        timing=record.get("timing", {}),
        machine=record.get("machine", {}),
        frames=frames,
    )
