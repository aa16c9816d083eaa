"""Making one stage: claim its folder, make or adopt the result, and record what happened."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from infrablend import __version__
from infrablend.core.files import write_json
from infrablend.core.machine import describe_machine, installed_versions, source_commit
from infrablend.core.output import OutputFolder
from infrablend.core.tasks import OnProgress
from infrablend.errors import Interrupted, OutputError
from infrablend.pipeline.experiments.adopting import adopt_result
from infrablend.pipeline.experiments.job import StageJob
from infrablend.pipeline.experiments.makers import MAKERS
from infrablend.pipeline.experiments.request import ExperimentRequest
from infrablend.pipeline.experiments.stage import (
    RECORD,
    FinishedStage,
    Stage,
    find_finished,
    read_stage_record,
    stage_folder,
)

# Packages that figures depend on.
_PACKAGES = ("bpy", "numpy", "opencv-python-headless", "Pillow", "pycocotools", "ultralytics", "torch")


def make_stage(
    stage: Stage,
    key: str,
    finished: Mapping[str, FinishedStage],
    request: ExperimentRequest,
    *,
    adopt: Path | None = None,
    on_progress: OnProgress | None = None,
) -> FinishedStage:
    """Make a stage, continuing what an interrupted run left of it.

    Args:
        stage: Stage to make.
        key: Key of the stage.
        finished: Finished stages by id, including those it needs.
        request: Request of the experiment.
        adopt: Folder of a result to use instead of making it.
        on_progress: Called by stages that report progress.

    Raises:
        DatasetError: The result to adopt belongs to something else.
        OutputError: Another process is making the stage, or the disk is full.
        Interrupted: The user stopped the run; everything done so far is kept.
        InfraBlendError: Any error of the stage's maker.
    """
    folder = stage_folder(request.work, stage, key)
    with OutputFolder(folder, f"stage {stage.id}", RECORD).claimed():
        if (done := find_finished(request.work, stage, key)) is not None:  # made by the other command meanwhile
            return done
        spent = float((read_stage_record(folder) or {}).get("seconds", 0.0))
        needs = {role: finished[i] for role, i in stage.needs.items() if i in finished}
        job = StageJob(stage, folder / "out", needs, request, on_progress)
        head = _record_head(stage, key, needs)
        write_json(folder / RECORD, {**head, "status": "running", "seconds": spent})
        started = time.monotonic()

        def seconds() -> float:
            return round(spent + time.monotonic() - started, 3)

        try:
            result = MAKERS[stage.kind](job) if adopt is None else adopt_result(job, adopt)
        except BaseException as error:
            status = "interrupted" if isinstance(error, Interrupted | KeyboardInterrupt) else "failed"
            with contextlib.suppress(OutputError):  # a full disk: the record of the attempt is not worth an error
                write_json(folder / RECORD, {**head, "status": status, "seconds": seconds()})
            raise
        write_json(folder / RECORD, {**head, "status": "complete", "seconds": seconds(), "result": result})
        return FinishedStage.of(stage, folder, read_stage_record(folder) or {})  # exactly as a later run reads it


def _record_head(stage: Stage, key: str, needs: Mapping[str, FinishedStage]) -> dict[str, Any]:
    """Return the part of a stage's record that is known before it is made."""
    return {
        "kind": stage.kind,
        "name": stage.name,
        "key": key,
        "inputs": dict(stage.inputs),
        "needs": {role: made.record["key"] for role, made in needs.items()},
        "machine": describe_machine(),
        "packages": {"infrablend": __version__, **installed_versions(_PACKAGES)},
        "commit": source_commit(),
    }
