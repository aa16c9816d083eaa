"""Runs a plan: distributes frames to workers, reports progress, resumes, and writes labels and the run record."""

from __future__ import annotations

import contextlib
import logging
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any

from infrablend.core.addresses import shown
from infrablend.core.checked_files import CheckedFiles
from infrablend.core.file_names import real_path
from infrablend.core.files import output_error, require_still_there, sha256_of
from infrablend.core.finished import EXCLUDING, require_unchanged
from infrablend.core.log_file import LogFileHandler, part_from_links
from infrablend.core.machine import installed_versions
from infrablend.core.manifest import Manifest
from infrablend.core.output import Existing
from infrablend.core.run_layout import EIGHT_BIT, IMAGES, PICTURE_TABLES, SCENES
from infrablend.core.tasks import Executor, OnProgress, Progress, Task, WorkerSpec
from infrablend.core.typed_command import COMMAND, command_facts
from infrablend.errors import (
    Interrupted,
    MissingDependencyError,
    OtherSettingsError,
    OutputError,
    Problem,
    RenderError,
)
from infrablend.formats.images import output_suffix
from infrablend.pipeline.excluded import CHOICE, choice_digest, place_frames, require_choice, write_choice
from infrablend.pipeline.executors import make_executor
from infrablend.pipeline.folder import FILES, RUN, RunFolder
from infrablend.pipeline.frame_pool import settings_for
from infrablend.pipeline.label_files import FinishedFrames, LabelSummary, write_formats
from infrablend.pipeline.levels import dataset_levels
from infrablend.pipeline.pace import Pace
from infrablend.pipeline.plan import PlannedFrame, RunPlan
from infrablend.pipeline.record import FrameRecord, read_record
from infrablend.pipeline.request import DEFAULT_EXECUTION, Execution
from infrablend.pipeline.run_key import differences
from infrablend.pipeline.run_record import RECORDED_PACKAGES, RunState, record_header, run_record
from infrablend.pipeline.run_report import write_report

log = logging.getLogger(__name__)

FACTORY = "infrablend.pipeline.frame:make_frame_maker"


@dataclass(frozen=True)
class RunReport:
    """Result of a run.

    Attributes:
        out: Folder of the run.
        status: Status of the run, always `complete`.
        counts: Counts of frames, objects, labels and problems, as under `counts` in the run record.
        problems: Skipped backgrounds, failed frames and warnings, and files that the run did not write or that were
            changed; the run record does not have the latter, because equal runs have equal records.
        seconds: Wall-clock time of this call.
        record_file: Record with all problems; None for `run.json` in `out`.
    """

    out: Path
    status: str
    counts: Mapping[str, Any]
    problems: tuple[Problem, ...] = ()
    seconds: float = 0.0
    record_file: Path | None = None

    @property
    def ok(self) -> bool:
        """True if no background was skipped and no frame failed."""
        return not (self.counts.get("skipped_backgrounds") or self.counts.get("failed_frames"))

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "out": shown(self.out),
            "status": self.status,
            "ok": self.ok,
            "counts": dict(self.counts),
            "problems": [p.to_json() for p in self.problems],
            "seconds": round(self.seconds, 3),
        }


@dataclass(frozen=True)
class FrameSource:
    """Where a run gets its frames from, if it does not render them.

    Attributes:
        executor: Puts the frames into the folder of the run.
        levels: Range of grey levels with which they were rendered.
        machine: Machine that rendered them, as in a run record.
        packages: Versions of the packages that rendered them.
        checked: Pictures that the executor has verified already.
    """

    executor: Executor
    levels: tuple[float, float] | None
    machine: Mapping[str, Any]
    packages: Mapping[str, Any]
    checked: CheckedFiles


def run_plan(
    plan: RunPlan,
    out: Path,
    execution: Execution = DEFAULT_EXECUTION,
    existing: Existing = "refuse",
    on_progress: OnProgress | None = None,
    choose: Callable[[Mapping[str, str]], Mapping[str, str]] | None = None,
    source: FrameSource | None = None,
) -> RunReport:
    """Render every frame of the plan that is not excluded, then write the label files.

    Args:
        plan: Plan of the run.
        out: Folder of the run.
        execution: Workers, device and renderer.
        existing: What to do if `out` already contains a run; `resume` keeps its finished frames.
        on_progress: Called after each frame.
        choose: Returns the frames to leave out from now on, each with its reason, from those that are left out now; it
            is called while no other process can change them. None keeps the choice of a resumed run.
        source: Where to take finished frames from; None renders them.

    Raises:
        OutputError: The folder cannot be used, another run is writing to it, or the disk is full.
        OtherSettingsError: The run to resume was started with another recipe, data or seed.
        Interrupted: The user stopped the run; `resume` continues it.
        RenderError: The renderer cannot start.
    """
    workers, device, renderer = execution.worker_count(), execution.device, execution.renderer
    started = time.monotonic()
    folder = RunFolder(out, "run" if plan.shard is None else "shard")
    with contextlib.ExitStack() as stack:
        require_claim = stack.enter_context(folder.output.claimed())  # locks out other runs
        previous = folder.prepare(existing)
        if previous is not None:
            _require_same_run(previous, plan, out, device, renderer)
            # Records of its frames name the run as the version that began it did.
            plan = replace(plan, run=str(previous.get(RUN, plan.run)))
        stack.enter_context(_log_file(folder.log_folder / "run.log"))
        header = {**record_header(plan, workers, device, renderer), **_command(previous, choose is not None)}
        if execution.executor != "local":
            header["machine"]["executor"] = execution.executor
        if source is not None:
            plan = replace(plan, levels=source.levels)
            header |= {"machine": dict(source.machine), "packages": dict(source.packages)}
        levels = _levels(plan, previous)
        if levels is not None:
            header["levels"] = list(levels)
        manifest = folder.manifest()
        stack.push(_clearing_remains(folder, manifest, header, require_claim))
        if previous is None:
            manifest.reset()
        kept_out = {} if previous is None else require_choice(previous, folder)
        if choose is not None:
            kept_out = dict(choose(kept_out))
        folder.write_run({**header, "status": "running" if choose is None else EXCLUDING})
        if choose is not None:
            write_choice(folder, kept_out)
        state = RunState(excluded=sum(f.frame_id in kept_out for f in plan.frames))
        if previous is None:
            todo = list(plan.frames)
        else:
            manifest.read().remove_parts()
            place_frames(folder, manifest, {f.frame_id: _frame_files(plan, f) for f in plan.frames}, kept_out)
            plan = replace(plan, frames=tuple(f for f in plan.frames if f.frame_id not in kept_out))
            todo = _remaining(plan, folder, manifest, state)
            if todo and previous.get("status") == "complete":
                shown = ", ".join(f.frame_id for f in todo[:3])
                log.warning("%d frames were missing, damaged or failed, and are made again: %s", len(todo), shown)
        for frame in todo:
            _make_way(plan, folder, manifest, frame)
        stack.enter_context(manifest.recording())
        manifest.begin(name for frame in todo for name in _frame_files(plan, frame))
        log.info(
            "%d frames, %d already there, seed %d, %d workers", len(plan.frames), state.resumed, plan.seed, workers
        )
        worker = WorkerSpec(FACTORY, settings_for(plan, levels, execution, out))
        workers_log = folder.log_folder / "workers.log"
        part_from_links(workers_log)
        executor = make_executor(worker, execution, workers_log) if source is None else source.executor
        status, stopped = "complete", "interrupted" if choose is None else EXCLUDING
        try:
            _make_frames(
                executor,
                todo,
                plan,
                state,
                1 if execution.in_process or source else workers,
                on_progress,
                require_claim,
            )
        except Interrupted:
            status = stopped
        except (MissingDependencyError, RenderError):  # the renderer could not start
            if previous is None and not state.done:
                folder.forget_start()
            raise
        made = time.monotonic()
        finished, notes = LabelSummary(), []
        records = FinishedFrames.none(folder)
        try:
            if status == "complete":
                require_unchanged(plan.dataset.root, plan.dataset.markers)
                checked = CheckedFiles() if source is None else source.checked
                records = _finished_frames(plan, folder, state, checked)
                if plan.shard is None:
                    finished = write_formats(plan, folder, records)
                if records.frames:  # labels of frames that are gone
                    manifest.remove_unwritten([*PICTURE_TABLES, *plan.recipe.output.formats, EIGHT_BIT])
            problems = state.problems(plan, finished)
            timing = {
                "seconds": round(time.monotonic() - started, 3),
                "frames_seconds": round(made - started, 3),
                "labels_seconds": round(time.monotonic() - made, 3),
                "resumed_frames": state.resumed,
                "worker_seconds": {k: round(v, 3) for k, v in sorted(state.render_seconds.items())},
                "peak_worker_rss_mb": round(state.peak_rss_bytes / 2**20, 1),
            }
            record = run_record(header, status, plan, state, finished, timing)
            if status == "complete":
                if plan.shard is None:
                    record.pop(COMMAND, None)  # finished runs are equal, whatever their folders
                    write_report(folder, record, records.records, kept_out)
                if kept_out:
                    record[CHOICE] = choice_digest(kept_out)
                notes = _file_notes(plan, folder, manifest, records.frames)
                record[FILES] = sum((folder.root / name).is_file() for name in folder.listed(manifest))
        except KeyboardInterrupt as error:
            folder.write_run({**header, "status": stopped})
            raise Interrupted(
                f"interrupted while labels were being written; all {state.done + state.resumed} frames are kept. "
                "Repeat the command with --resume to write the labels."
            ) from error
        require_claim()
        folder.write_run(record)
        if status == "complete":
            manifest.forget_missing()  # e.g. labels of frames that are excluded now
            _require_whole(plan, folder, manifest, records.frames, {**record, "status": stopped})
        log.info("%s: %s", status, record["counts"])
        for note in notes:
            log.info("%s", note)
        if status == stopped:
            raise Interrupted(
                f"interrupted after {state.done + state.resumed} of {len(plan.frames)} frames; finished ones are kept. "
                "Repeat the command with --resume to continue."
            )
    return RunReport(out, status, record["counts"], (*problems, *notes), time.monotonic() - started)


def _clearing_remains(
    folder: RunFolder, manifest: Manifest, header: Mapping[str, Any], require_claim: Callable[[], None]
) -> Callable[[object, object, object], None]:
    """Return what an exit stack calls last, for a run whose folder was removed and made again by its own writes."""

    def clear(kind: object, error: object, trace: object) -> None:
        if kind is not None:
            try:
                require_claim()
            except OutputError:
                folder.clear_remains(manifest, header)

    return clear


def _levels(plan: RunPlan, previous: Mapping[str, Any] | None) -> tuple[float, float] | None:
    """Return the dataset's levels if the recipe needs them; a resumed run keeps the recorded ones."""
    if not plan.needs_levels:
        return None
    if plan.levels is not None:
        return plan.levels
    if previous is not None and previous.get("levels"):
        low, high = previous["levels"]
        return float(low), float(high)
    return dataset_levels(plan)


def _make_frames(
    executor: Executor,
    todo: list[PlannedFrame],
    plan: RunPlan,
    state: RunState,
    workers: int,
    on_progress: OnProgress | None,
    require_claim: Callable[[], None],
) -> None:
    """Render the frames of `todo`; a failed frame is counted and does not stop the others."""
    of_key = {f.frame_id: f for f in todo}
    pace = Pace(workers)

    def tasks() -> Iterator[Task]:
        for frame in todo:
            require_claim()  # frames must not be written into another run
            yield Task(frame.frame_id, frame)

    for finished, result in enumerate(executor.run(tasks()), start=1):
        state.add(result, of_key[result.key])
        if on_progress is not None:
            pace.add(result)
            rate = pace.frames_per_s()
            done, eta_s = state.resumed + finished, (len(todo) - finished) / rate
            on_progress(Progress(done, len(plan.frames), rate, eta_s, state.outcomes))


def _remaining(plan: RunPlan, folder: RunFolder, manifest: Manifest, state: RunState) -> list[PlannedFrame]:
    """Return the frames to render: their record or image is missing or damaged, or their background has changed."""
    todo = []
    of_background: dict[Path, str | None] = {}
    for frame in plan.frames:
        record, image = _record_of(plan, folder, frame), _frame_files(plan, frame)[0]
        if record is None or not manifest.add_present(image, record.image_sha256):
            todo.append(frame)
        elif _cached_digest(frame.background.path, of_background) != record.background.get("sha256"):
            log.warning(
                "%s: the background has changed since the frame was rendered; rendering it again", frame.frame_id
            )
            todo.append(frame)
        else:
            state.resumed += 1
            state.inserted += len(record.inserted)
    return todo


def _frame_files(plan: RunPlan, frame: PlannedFrame) -> tuple[str, str]:
    """Return the paths of a frame's image and record in the folder of the run."""
    output = plan.recipe.output
    image = frame.image_path(output.group_by, output_suffix(frame.background.path, output.image))
    return f"{IMAGES}/{image}", f"{SCENES}/{frame.frame_id}.json"


def _record_of(plan: RunPlan, folder: RunFolder, frame: PlannedFrame) -> FrameRecord | None:
    """Return the record of a frame; None if there is none, or it is damaged, edited or of something else."""
    record = read_record(folder.record(frame.frame_id))
    if record is None or record.frame_id != frame.frame_id or not record.is_of(plan.run):
        return None
    fits = f"{IMAGES}/{record.image}" == _frame_files(plan, frame)[0]
    return record if fits and all(n < len(frame.background.instances) for n in record.kept) else None


def _make_way(plan: RunPlan, folder: RunFolder, manifest: Manifest, frame: PlannedFrame) -> None:
    """Remove what an earlier call left of a frame that has to be rendered, and move aside what others changed.

    If the frame fails, nothing of it remains: a picture without labels would be taken for one without objects.
    """
    image, record = _frame_files(plan, frame)
    known = _record_of(plan, folder, frame)
    if known is not None:
        manifest.add_present(record)
        manifest.add_present(image, known.image_sha256)
    for name in (image, record):
        path = folder.root / name
        if manifest.is_own(name):
            manifest.delete_own(name)
        elif os.path.lexists(path):
            log.warning("%s: changed, damaged or not written by this run; moved aside, and made again", path)
            manifest.move_aside(name)


def _finished_frames(plan: RunPlan, folder: RunFolder, state: RunState, checked: CheckedFiles) -> FinishedFrames:
    """Return the frames whose record and image are there and intact; the others are counted as failed.

    Files may have been removed or changed while the run was going on.
    """
    found = FinishedFrames.none(folder)
    inserted = 0
    for frame in plan.frames:
        if frame.frame_id in state.unfinished:
            continue
        record = _record_of(plan, folder, frame)
        if record is not None and checked.has_digest(folder.image(record.image), folder.root, record.image_sha256):
            found.add(frame, record)
            inserted += len(record.inserted)
            continue
        state.failures[frame.frame_id] = Problem(
            frame.frame_id,
            "frame-lost",
            "its picture or record was removed or changed while the run was going on",
            "a finished frame",
            "run again with --resume",
        )
        log.error("%s", state.failures[frame.frame_id])
    state.inserted = inserted
    state.finished = len(found.frames)
    return found


def _require_whole(
    plan: RunPlan, folder: RunFolder, manifest: Manifest, frames: Sequence[PlannedFrame], unfinished: dict[str, Any]
) -> None:
    """Check that nothing was removed until the run was marked as complete; else record it as unfinished.

    Raises:
        OutputError: Files were removed; the message names them.
    """
    written = [folder.run_file, *manifest.missing()]
    of_frames = (folder.root / name for frame in frames for name in _frame_files(plan, frame))
    try:
        require_still_there(chain(written, of_frames), "run again with --resume")
    except OutputError:
        with contextlib.suppress(OutputError):
            folder.write_run(unfinished)
        raise


def _file_notes(plan: RunPlan, folder: RunFolder, manifest: Manifest, frames: Iterable[PlannedFrame]) -> list[Problem]:
    """Return warnings about files in the folder that the run did not write, or that were changed since."""
    manifest.drop_equal()
    known = {*manifest.paths}
    known |= {name for f in frames for name in _frame_files(plan, f)}
    return manifest.problems() + [
        Problem(name, "file-foreign", "not written by this run", "", "kept; move it elsewhere", "warning")
        for name in folder.strays(known)
    ]


def _cached_digest(path: Path, known: dict[Path, str | None]) -> str | None:
    """Return the SHA-256 of a background, None if it cannot be read; results are kept in `known`."""
    if path not in known:
        try:
            known[path] = sha256_of(real_path(path)) if path.is_file() else None
        except OSError:
            known[path] = None
    return known[path]


def _require_same_run(previous: Mapping[str, Any], plan: RunPlan, out: Path, device: str, renderer: str) -> None:
    """Refuse to resume if frames would differ; warn if they might."""
    machine = previous.get("machine", {})
    if machine.get("renderer", renderer) != renderer:
        raise OtherSettingsError(f"{out}: was rendered with {machine['renderer']}, not {renderer}; use another --out")
    if machine.get("device", device) != device:
        log.warning(
            "%s: started with --device %s, resumed with %s; devices may differ by one grey level",
            out,
            machine["device"],
            device,
        )
    versions, installed = previous.get("packages", {}), installed_versions(RECORDED_PACKAGES)
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


def _command(previous: Mapping[str, Any] | None, choosing: bool) -> dict[str, Any]:
    """Return the command line for the record of an unfinished run; a choice of frames keeps that of the run."""
    if not choosing and (facts := command_facts()):
        return facts
    return {k: v for k, v in (previous or {}).items() if k == COMMAND}


@contextlib.contextmanager
def _log_file(path: Path) -> Iterator[None]:
    """Also write InfraBlend's log messages to a file within this context."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part_from_links(path)
        handler = LogFileHandler(path)
    except OSError as error:
        raise output_error(path, error) from error
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    logger = logging.getLogger("infrablend")
    level = logger.level
    logger.setLevel(min(level or logging.INFO, logging.INFO))
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        handler.close()
