"""Runs a plan: distributes its frames to workers, keeps the ledger, and exports labels once all frames are finished."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from infrablend.core.addresses import shown
from infrablend.core.run_folder import DERIVED, RUN_FILE, WORKERS_LOG, RunFolder
from infrablend.core.run_record import RunRecord
from infrablend.core.tasks import Executor, OnProgress, Progress, Task, TaskResult, WorkerSpec
from infrablend.core.workspace import Existing, Workspace, workspace
from infrablend.errors import Interrupted, MissingDependencyError, Problem, RenderError
from infrablend.pipeline.compose.composed import MadeFrame
from infrablend.pipeline.compose.settings import settings_for
from infrablend.pipeline.execution.process_pool import PoolSettings, ProcessPool
from infrablend.pipeline.execution.ray_pool import RayPool, RaySettings
from infrablend.pipeline.execution.serial import Serial
from infrablend.pipeline.plans.plan import PlannedFrame, RunPlan
from infrablend.pipeline.plans.run_request import DEFAULT_EXECUTION, WORKER_BYTES, Execution
from infrablend.pipeline.runs.begun_run import BegunRun, Choice, begin_run, find_earlier, go_on, with_levels
from infrablend.pipeline.runs.exports import LabelSummary, export_run, list_exports, remove_exports
from infrablend.pipeline.runs.record import record_header, run_record
from infrablend.report.run_warnings import NOTHING_INSERTED, count_objects, nothing_first

log = logging.getLogger(__name__)

FACTORY = "infrablend.pipeline.compose.frame_worker:FrameMaker"


@dataclass(frozen=True)
class RunReport:
    """Result of a run.

    Attributes:
        out: Folder of the run.
        counts: Counts of frames, objects, labels and problems, as under `counts` in the run record.
        problems: That nothing was inserted, skipped backgrounds, failed frames and warnings.
        seconds: Wall-clock time of this call.
        record_file: Record with all problems; None for `run.json` in `out`.
        losses: Counts of what formats cannot hold, by `<format>.<kind>`; see `losses.LOSSES`.
    """

    out: Path
    counts: Mapping[str, Any]
    problems: tuple[Problem, ...] = ()
    seconds: float = 0.0
    record_file: Path | None = None
    losses: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def of_record(cls, record: Mapping[str, Any], out: Path, record_file: Path | None = None) -> RunReport:
        """Return the report of a run that is finished already, from its record."""
        problems = tuple(nothing_first(Problem(**p) for p in record.get("problems", ())))
        return cls(out, record["counts"], problems, record_file=record_file, losses=record.get("losses", {}))

    @property
    def ok(self) -> bool:
        """True if no background was skipped, no frame failed, and something of each kind of object was inserted."""
        nothing = any(p.code == NOTHING_INSERTED for p in self.problems)
        return not (self.counts.get("skipped_backgrounds") or self.counts.get("failed_frames") or nothing)

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {
            "out": shown(self.out),
            "ok": self.ok,
            "counts": dict(self.counts),
            "losses": dict(self.losses),
            "problems": [p.to_json() for p in self.problems],
            "seconds": round(self.seconds, 3),
        }


@dataclass(frozen=True)
class FrameSource:
    """Where a run gets its frames from, if it does not render them.

    Attributes:
        executor: Makes the executor that puts the frames into the folder of the run.
        levels: Range of grey levels with which they were rendered.
        machine: Machine that rendered them, as in a run record.
        packages: Versions of the packages that rendered them.
    """

    executor: Callable[[RunFolder], Executor]
    levels: tuple[float, float] | None
    machine: Mapping[str, Any]
    packages: Mapping[str, str]


Finish = Callable[[Workspace, RunRecord], None]
"""Finishes the folder of a run whose labels are written, from the record of the run."""


def run_plan(
    plan: RunPlan,
    out: Path,
    execution: Execution = DEFAULT_EXECUTION,
    existing: Existing = "refuse",
    on_progress: OnProgress | None = None,
    choice: Choice | None = None,
    source: FrameSource | None = None,
    finish: Finish = Workspace.finish,
) -> RunReport:
    """Render every frame of the plan that is not excluded, then export labels, card and report.

    Args:
        plan: Plan of the run.
        out: Folder of the run.
        execution: Workers, device and renderer.
        existing: What to do if `out` already contains a run; `resume` keeps its finished frames.
        on_progress: Called after each frame.
        choice: Change of the frames that are left out; None keeps those of a resumed run.
        source: Where to take finished frames from; None renders them.
        finish: Finishes the folder; by default it becomes `out`.

    Raises:
        OutputError: The folder cannot be used, another run is writing to it, or the disk is full.
        OtherSettingsError: The run to resume was started with another recipe, data or seed.
        Interrupted: The user stopped the run; `resume` continues it.
        RenderError: The renderer cannot start.
    """
    started = time.monotonic()
    noun = "run" if plan.shard is None else "shard"
    with workspace(out, noun, RUN_FILE, existing, keep=True, derived=DERIVED) as space:
        earlier = find_earlier(space, plan, execution, choice)
        if earlier is None:
            plan = with_levels(plan)
            run = begin_run(space, plan, _header(plan, execution, source))
        elif earlier.is_same:
            return RunReport.of_record(earlier.record, out)
        else:
            run = go_on(space, earlier, _header(earlier.plan, execution, source), choice)
        with run.ledger:
            log.info("%d frames, %d already there, seed %d", len(run.plan.frames), run.state.resumed, plan.seed)
            try:
                make_frames(run, execution, on_progress, source)
            except (MissingDependencyError, RenderError):  # the renderer could not start
                if run.is_new and not run.state.done:
                    run.ledger.close()
                    space.discard()
                raise
            report, record = _finish_labels(space, run, started)
        finish(space, record)
    return replace(report, out=out)


def make_frames(
    run: BegunRun, execution: Execution, on_progress: OnProgress | None, source: FrameSource | None
) -> None:
    """Have the frames of a run made that it lacks, and add each to its ledger when its picture is there.

    Raises:
        Interrupted: The user stopped the run.
        InfraBlendError: A frame failed for a reason that stops the run.
    """
    if source is None:
        settings = settings_for(run.plan, run.plan.levels, execution, run.folder.root)
        executor = make_executor(WorkerSpec(FACTORY, settings), execution, run.folder.root / WORKERS_LOG)
    else:
        executor = source.executor(run.folder)
    pace = Pace(1 if execution.in_process or source else execution.worker_count())
    todo = {f.frame_id: f for f in run.todo}
    for frame_id in todo:
        run.ledger.forget(frame_id)
    results = executor.run(Task(frame_id, frame) for frame_id, frame in todo.items())
    try:
        for finished, result in enumerate(results, start=1):
            _keep(result, todo[result.key], run)
            if on_progress is not None:
                pace.add(result)
                rate = pace.frames_per_s()
                done = run.state.resumed + finished
                eta_s = (len(todo) - finished) / rate
                on_progress(Progress(done, len(run.plan.frames), rate, eta_s, run.state.outcomes))
    except Interrupted as error:
        raise Interrupted(
            f"interrupted after {run.state.done + run.state.resumed} of {len(run.plan.frames)} frames; finished ones "
            f"are kept in {run.folder.root}. Repeat the command with --resume to continue."
        ) from error


def _keep(result: TaskResult, frame: PlannedFrame, run: BegunRun) -> None:
    """Add the result of a frame to the ledger and the counts."""
    if result.failure is None:
        made: MadeFrame = result.value
        run.ledger.add(frame.frame_id, made.frame, made.record)
        run.ledger.add_background(frame.background_id, frame.background.path, made.background_sha256)
    else:
        run.ledger.add_failure(frame.frame_id, result.failure)
        if result.failure.error == MissingDependencyError.__name__:  # other frames would fail like this one
            raise result.failure.to_exception()
    run.state.add(result, frame)


def _finish_labels(space: Workspace, run: BegunRun, started: float) -> tuple[RunReport, RunRecord]:
    """Export a run whose frames are made; return its report and its record.

    Raises:
        Interrupted: The user stopped the run.
    """
    made = time.monotonic()
    try:
        labels = _export(space, run)
        record = run_record(run.header, run.plan, run.state, labels, run.state.timing(started, made))
        if run.plan.shard is None:
            from infrablend.pipeline.runs.record import write_report

            record.pop("command", None)  # finished runs are equal, whatever their folders
            rows = run.ledger.rows(f.frame_id for f in run.finished_frames)
            write_report(run.folder, record, rows, run.ledger.excluded())
        run.ledger.write_exports(list_exports(run.folder, run.ledger, space.foreign))
        run.ledger.write_run(record)
    except KeyboardInterrupt as error:
        raise Interrupted(
            f"interrupted while labels were being written; all {run.state.done + run.state.resumed} frames are kept in "
            f"{run.folder.root}. Repeat the command with --resume to write the labels."
        ) from error
    problems = tuple(run.state.problems(run.plan, labels))
    seconds = time.monotonic() - started
    return RunReport(space.out, record["counts"], problems, seconds, losses=record["losses"]), record


def _export(space: Workspace, run: BegunRun) -> LabelSummary:
    """Write the labels of a run, or count the objects of a shard, whose labels are written when shards are merged."""
    if not run.state.failures:
        (run.folder.root / WORKERS_LOG).unlink(missing_ok=True)
    remove_exports(space, run.folder, run.ledger)
    if run.plan.shard is None:
        return export_run(run.plan, run.folder, run.ledger, run.finished_frames)
    # Whether nothing was inserted is known with all shards.
    rows = run.ledger.rows(f.frame_id for f in run.finished_frames)
    return LabelSummary(count_objects(run.plan.recipe, rows))


def _header(plan: RunPlan, execution: Execution, source: FrameSource | None) -> RunRecord:
    header = record_header(plan, execution)
    if source is not None:
        header = {**header, "machine": dict(source.machine), "packages": dict(source.packages)}
    levels = plan.levels if source is None else source.levels
    return header if levels is None else {**header, "levels": list(levels)}


def make_executor(worker: WorkerSpec, execution: Execution, log_path: Path) -> Executor:
    """Return the executor that a request asks for; `log_path` is for workers of this machine: Ray has its own logs."""
    if execution.in_process:
        return Serial(worker)
    if execution.executor == "ray":
        gpus = 0.0 if execution.device in ("auto", "cpu") else 1.0
        settings = RaySettings(
            workers=execution.workers, address=execution.address, worker_bytes=WORKER_BYTES, gpus=gpus
        )
        return RayPool(worker, settings)
    return ProcessPool(worker, PoolSettings(workers=max(1, execution.worker_count()), log_path=log_path))


class Pace:
    """Frames per second of a run, from the time that workers spend on each frame.

    Dividing finished frames by the time since the start would count the start-up of Blender as work: with the first
    frame the estimate would be many times too long. The first frame of each worker, which loads models, counts only
    until another frame is done.
    """

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._seen: set[int] = set()
        self._first: list[float] = []
        self._later_s = 0.0
        self._later_n = 0

    def add(self, result: TaskResult) -> None:
        """Count a finished frame."""
        if result.worker in self._seen:
            self._later_s += result.seconds
            self._later_n += 1
        else:
            self._seen.add(result.worker)
            self._first.append(result.seconds)

    def frames_per_s(self) -> float:
        """Return the rate of all workers together; 0 before the first frame."""
        if not self._first:
            return 0.0
        mean_s = self._later_s / self._later_n if self._later_n else sum(self._first) / len(self._first)
        return self._workers / max(mean_s, 1e-6)
