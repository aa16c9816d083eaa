"""Runs a plan: distributes its frames to workers, keeps the ledger, and exports labels once all frames are finished."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from infrablend.core.addresses import shown
from infrablend.core.file_names import real_path
from infrablend.core.files import sha256_of
from infrablend.core.ledger import LEDGER, DoneFrame, Ledger
from infrablend.core.run_folder import DERIVED, EXCLUDED, RUN_FILE, WORKERS_LOG, RunFolder
from infrablend.core.tasks import Executor, OnProgress, Progress, Task, WorkerSpec
from infrablend.core.typed_command import COMMAND, command_facts
from infrablend.core.workspace import Existing, Workspace, workspace
from infrablend.errors import Interrupted, MissingDependencyError, OtherSettingsError, Problem, RenderError
from infrablend.formats.pictures.images import output_suffix
from infrablend.pipeline.compose.composed import MadeFrame
from infrablend.pipeline.compose.settings import settings_for
from infrablend.pipeline.plans.levels import dataset_levels, recorded_levels
from infrablend.pipeline.plans.plan import PlannedFrame, RunPlan
from infrablend.pipeline.plans.run_request import DEFAULT_EXECUTION, Execution
from infrablend.pipeline.runs.executors import Pace, make_executor
from infrablend.pipeline.runs.exports import (
    LabelSummary,
    export_run,
    has_size,
    list_exports,
    lost_exports,
    remove_exports,
    require_nothing_added,
)
from infrablend.pipeline.runs.inserted import NOTHING_INSERTED, count_objects, nothing_first
from infrablend.pipeline.runs.key import differences
from infrablend.pipeline.runs.record import RUN, RunState, record_header, recorded_versions, run_record

log = logging.getLogger(__name__)

FACTORY = "infrablend.pipeline.compose.frame_worker:FrameMaker"

Choose = Callable[[Mapping[str, str]], Mapping[str, str]]
"""Returns the frames to leave out from now on, each with its reason, from those that are left out now."""


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

    def to_json(self) -> dict[str, Any]:
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
    packages: Mapping[str, Any]


@dataclass(frozen=True)
class Choice:
    """Change of the frames that are left out of a finished run.

    Attributes:
        choose: Called while no other process can change them.
        purge: Whether to delete the pictures of all frames that are left out then.
    """

    choose: Choose
    purge: bool = False


def run_plan(
    plan: RunPlan,
    out: Path,
    execution: Execution = DEFAULT_EXECUTION,
    existing: Existing = "refuse",
    on_progress: OnProgress | None = None,
    choice: Choice | None = None,
    source: FrameSource | None = None,
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

    Raises:
        OutputError: The folder cannot be used, another run is writing to it, or the disk is full.
        OtherSettingsError: The run to resume was started with another recipe, data or seed.
        Interrupted: The user stopped the run; `resume` continues it.
        RenderError: The renderer cannot start.
    """
    noun = "run" if plan.shard is None else "shard"
    with workspace(out, noun, RUN_FILE, existing, keep=True, derived=DERIVED) as space:
        report, record = run_in(space, plan, execution, on_progress, choice, source)
        if record is not None:
            space.finish(record)
    return replace(report, out=out)


def run_in(
    space: Workspace,
    plan: RunPlan,
    execution: Execution,
    on_progress: OnProgress | None = None,
    choice: Choice | None = None,
    source: FrameSource | None = None,
) -> tuple[RunReport, dict[str, Any] | None]:
    """Make a run in an open workspace; return its record, or None if it was finished already and nothing changed.

    The arguments and errors are those of `run_plan`.
    """
    started = time.monotonic()
    folder = RunFolder(space.folder)
    if (folder.root / LEDGER).is_file():
        with Ledger.open(folder.root) as ledger:
            previous = ledger.read_run()
            done = ledger.done()
            excluded = ledger.excluded()
            _require_same_run(previous, plan, space.out, execution)
            plan = replace(plan, run=str(previous[RUN]), levels=recorded_levels(previous.get("levels")))
            kept_out = dict(excluded if choice is None else choice.choose(excluded))
            todo = _remaining(plan, folder, ledger, done, kept_out)
            written = list(plan.recipe.output.formats) == previous["formats"] and not lost_exports(folder, ledger)
        kept = kept_out == excluded and not (choice and choice.purge)
        if space.state == "complete":
            if not todo and kept and (written or plan.shard is not None):
                return RunReport.of_record(previous, space.out), None
            if todo:
                named = ", ".join(f.frame_id for f in todo[:3])
                log.warning("%d frames were missing, damaged or failed, and are made again: %s", len(todo), named)
            require_nothing_added(folder, plan)
        space.reopen()
        folder = RunFolder(space.folder)
        opened = Ledger.open(folder.root, write=True)
    else:
        previous = {}
        done = {}
        kept_out = {}
        todo = list(plan.frames)
        if plan.levels is None and plan.needs_levels:
            plan = replace(plan, levels=dataset_levels(plan))
        opened = Ledger.create(folder.root, _header(plan, execution, source))
    with opened as ledger:
        header = {**_header(plan, execution, source), **_command(previous, choice is not None)}
        ledger.write_run({**previous, **header})
        ledger.exclude(kept_out)
        _place_excluded(folder, done, kept_out, purge=choice is not None and choice.purge)
        plan, state = _without(plan, kept_out, done, todo)
        log.info("%d frames, %d already there, seed %d", len(plan.frames), state.resumed, plan.seed)
        try:
            _make_frames(plan, todo, folder, ledger, state, execution, on_progress, source)
        except Interrupted as error:
            raise Interrupted(
                f"interrupted after {state.done + state.resumed} of {len(plan.frames)} frames; finished ones are kept "
                f"in {folder.root}. Repeat the command with --resume to continue."
            ) from error
        except (MissingDependencyError, RenderError):  # the renderer could not start
            if not previous and not state.done:
                ledger.close()
                space.discard()
            raise
        made = time.monotonic()
        try:
            record, problems = _export(space, folder, plan, ledger, state, header, started, made)
        except KeyboardInterrupt as error:
            raise Interrupted(
                f"interrupted while labels were being written; all {state.done + state.resumed} frames are kept in "
                f"{folder.root}. Repeat the command with --resume to write the labels."
            ) from error
    seconds = time.monotonic() - started
    return RunReport(space.out, record["counts"], tuple(problems), seconds, losses=record["losses"]), record


def _without(
    plan: RunPlan, kept_out: Mapping[str, str], done: Mapping[str, DoneFrame], todo: Sequence[PlannedFrame]
) -> tuple[RunPlan, RunState]:
    """Return the plan without some frames, and the counts of those of the others that an earlier call finished."""
    frames = tuple(f for f in plan.frames if f.frame_id not in kept_out)
    again = {f.frame_id for f in todo}
    earlier = [done[f.frame_id] for f in frames if f.frame_id not in again]
    inserted = sum(frame.inserted for frame in earlier)
    state = RunState(excluded=len(plan.frames) - len(frames), resumed=len(earlier), inserted=inserted)
    return replace(plan, frames=frames), state


def _export(
    space: Workspace,
    folder: RunFolder,
    plan: RunPlan,
    ledger: Ledger,
    state: RunState,
    header: Mapping[str, Any],
    started: float,
    made: float,
) -> tuple[dict[str, Any], list[Problem]]:
    if not state.failures:
        (folder.root / WORKERS_LOG).unlink(missing_ok=True)
    remove_exports(space, folder, ledger)
    frames = [f for f in plan.frames if f.frame_id not in state.unfinished]
    if plan.shard is None:
        labels = export_run(plan, folder, ledger, frames)
    else:  # whether nothing was inserted is known with all shards
        labels = LabelSummary(count_objects(plan.recipe, ledger.records(f.frame_id for f in frames)))
    problems = state.problems(plan, labels)
    timing = {
        "seconds": round(time.monotonic() - started, 3),
        "frames_seconds": round(made - started, 3),
        "labels_seconds": round(time.monotonic() - made, 3),
        "resumed_frames": state.resumed,
        "worker_seconds": {k: round(v, 3) for k, v in sorted(state.render_seconds.items())},
        "peak_worker_rss_mb": round(state.peak_rss_bytes / 2**20, 1),
    }
    record = run_record(header, plan, state, labels, timing)
    if plan.shard is None:
        from infrablend.pipeline.runs.run_report import write_report

        record.pop(COMMAND, None)  # finished runs are equal, whatever their folders
        write_report(folder, record, ledger.records(f.frame_id for f in frames), ledger.excluded())
    ledger.write_exports(list_exports(folder, ledger, space.foreign))
    ledger.write_run(record)
    return record, problems


def _header(plan: RunPlan, execution: Execution, source: FrameSource | None) -> dict[str, Any]:
    header = record_header(plan, execution)
    if source is not None:
        header |= {"machine": dict(source.machine), "packages": dict(source.packages)}
    levels = plan.levels if source is None else source.levels
    return header if levels is None else {**header, "levels": list(levels)}


def _command(previous: Mapping[str, Any], choosing: bool) -> dict[str, Any]:
    """Return the command line for the record of an unfinished run; a choice of frames keeps that of the run."""
    if not choosing and (facts := command_facts()):
        return facts
    return {k: v for k, v in previous.items() if k == COMMAND}


def _make_frames(
    plan: RunPlan,
    todo: Sequence[PlannedFrame],
    folder: RunFolder,
    ledger: Ledger,
    state: RunState,
    execution: Execution,
    on_progress: OnProgress | None,
    source: FrameSource | None,
) -> None:
    if source is None:
        worker = WorkerSpec(FACTORY, settings_for(plan, plan.levels, execution, folder.root))
        executor = make_executor(worker, execution, folder.root / WORKERS_LOG)
    else:
        executor = source.executor(folder)
    for frame in todo:
        ledger.forget(frame.frame_id)
    of_key = {f.frame_id: f for f in todo}
    pace = Pace(1 if execution.in_process or source else execution.worker_count())
    tasks: Iterator[Task] = (Task(f.frame_id, f) for f in todo)
    for finished, result in enumerate(executor.run(tasks), start=1):
        frame = of_key[result.key]
        if result.failure is None:
            made: MadeFrame = result.value
            ledger.add(frame.frame_id, made.frame, made.record)
            try:
                status = frame.background.path.stat()
            except OSError:  # removed meanwhile: its frames are made again by the next call that finds it
                pass
            else:
                facts = status.st_size, status.st_mtime_ns, made.background_sha256
                ledger.add_background(frame.background_id, *facts)
        else:
            ledger.add_failure(frame.frame_id, result.failure)
            if result.failure.error == MissingDependencyError.__name__:  # other frames would fail like this one
                raise result.failure.to_exception()
        state.add(result, frame)
        if on_progress is not None:
            pace.add(result)
            rate = pace.frames_per_s()
            done = state.resumed + finished
            eta_s = (len(todo) - finished) / rate
            on_progress(Progress(done, len(plan.frames), rate, eta_s, state.outcomes))


def _remaining(
    plan: RunPlan, folder: RunFolder, ledger: Ledger, done: Mapping[str, DoneFrame], kept_out: Mapping[str, str]
) -> list[PlannedFrame]:
    """Return the frames to make: those without a picture of the recorded size, or whose background has changed."""
    known = ledger.backgrounds()
    unchanged = dict[str, bool]()
    output = plan.recipe.output
    todo = []
    for frame in plan.frames:
        if frame.frame_id in kept_out:
            continue
        row = done.get(frame.frame_id)
        name = frame.background_id
        image = frame.image_path(output.group_by, output_suffix(frame.background.path, output.image))
        if row is None or row.image != image or not _is_there(folder, row):
            todo.append(frame)
            continue
        if name not in unchanged:
            unchanged[name] = is_unchanged(frame.background.path, known.get(name))
        if not unchanged[name]:
            log.warning("%s: the background has changed since the frame was made; making it again", frame.frame_id)
            todo.append(frame)
    return todo


def _is_there(folder: RunFolder, frame: DoneFrame) -> bool:
    """Return whether a picture is there, in its place or left out, with the size in the ledger."""
    return any(has_size(path, frame.bytes) for path in (folder.image(frame.image), folder.excluded(frame.image)))


def is_unchanged(path: Path, known: tuple[int, int, str] | None) -> bool:
    """Return whether a background is the one that a frame was made of; it is read only if its size or time differs."""
    try:
        status = path.stat()
        if known is not None and (status.st_size, status.st_mtime_ns) == known[:2]:
            return True
        return known is not None and sha256_of(real_path(path)) == known[2]
    except OSError:
        return False


def _place_excluded(
    folder: RunFolder, done: Mapping[str, DoneFrame], kept_out: Mapping[str, str], *, purge: bool
) -> None:
    """Move the pictures of excluded frames to `excluded/`, and those of other frames back."""
    if not kept_out and not (folder.root / EXCLUDED).is_dir():
        return
    for frame_id, frame in done.items():
        here = folder.image(frame.image)
        aside = folder.excluded(frame.image)
        left_out = frame_id in kept_out
        source, target = (here, aside) if left_out else (aside, here)
        if source.is_file():
            target.parent.mkdir(parents=True, exist_ok=True)
            source.replace(target)
        if left_out and purge:
            aside.unlink(missing_ok=True)
    root = folder.root / EXCLUDED
    for path in sorted((root, *root.rglob("*")), reverse=True):
        if path.is_dir() and not any(path.iterdir()):
            path.rmdir()


def _require_same_run(previous: Mapping[str, Any], plan: RunPlan, out: Path, execution: Execution) -> None:
    """Refuse to resume if frames would differ; warn if they might."""
    machine = previous["machine"]
    renderer = execution.renderer
    device = execution.device
    if machine["renderer"] != renderer:
        raise OtherSettingsError(f"{out}: was rendered with {machine['renderer']}, not {renderer}; use another --out")
    if machine["device"] != device:
        was = machine["device"]
        log.warning(
            "%s: started with --device %s, resumed with %s; devices may differ by one grey level", out, was, device
        )
    versions = previous["packages"]
    installed = recorded_versions(execution)
    for name in sorted(n for n in installed if versions.get(n, installed[n]) != installed[n]):
        log.warning("%s: started with %s %s, resumed with %s", out, name, versions[name], installed[name])
    require_same_key(previous, plan, out)


def require_same_key(previous: Mapping[str, Any], plan: RunPlan, out: Path | str) -> None:
    """Check that the record of an earlier run, or of a shard, is of the run that is planned.

    Raises:
        OtherSettingsError: It is of another run; the message lists the differences.
    """
    if texts := differences(previous.get("key", {}), plan.key, previous.get("request"), plan.request):
        raise OtherSettingsError(
            f"{out}: cannot be resumed because this is a different run: {'; '.join(texts)}. "
            "Use the same recipe, data, seed, splits and choice of frames, or --overwrite, or another --out."
        )
