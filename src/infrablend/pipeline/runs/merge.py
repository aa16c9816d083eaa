"""Merges finished shards into one run: links their frames, and writes labels, card and record as a single run does."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import get_args

from infrablend.core.addresses import address_of, shown
from infrablend.core.arguments import require_choice
from infrablend.core.file_names import real_path
from infrablend.core.output_checks import require_apart
from infrablend.core.run_folder import RUN_FILE, SHARDS_FILE, RunFolder, ShardFiles
from infrablend.core.tasks import Failure, OnProgress, Task, TaskResult
from infrablend.core.workspace import Existing, workspace
from infrablend.errors import ArgumentError, Interrupted, OtherSettingsError, OutputError, Problem
from infrablend.pipeline.compose.composed import MadeFrame
from infrablend.pipeline.execution.interrupt import STOPPED, Interruption
from infrablend.pipeline.plans.plan import PlannedFrame, RunPlan
from infrablend.pipeline.plans.run_request import Execution
from infrablend.pipeline.plans.shard import Shard
from infrablend.pipeline.runs.exports import LabelSummary
from infrablend.pipeline.runs.inserted import nothing_inserted
from infrablend.pipeline.runs.key import differences
from infrablend.pipeline.runs.packed_shard import find_whole, pack, publish
from infrablend.pipeline.runs.record import RunState, record_header, run_record
from infrablend.pipeline.runs.recorded import RecordedRun
from infrablend.pipeline.runs.run import FrameSource, RunReport, run_plan
from infrablend.pipeline.runs.shard_source import ShardSource
from infrablend.pipeline.runs.sharded import Layout, ShardedRun, ShardState, SharedPlan, added_counts
from infrablend.pipeline.runs.stored import opened_run


@dataclass(frozen=True)
class _Finished:
    """A finished shard, and the run in shards that it is part of."""

    shard: Shard
    source: ShardSource
    failures: Mapping[str, Failure]
    run: ShardedRun

    def finished(self, frames: Sequence[PlannedFrame]) -> tuple[str, ...]:
        """Return the ids of its frames that have a picture, in their order; `frames` are those of the whole run."""
        return tuple(f.frame_id for f in self.shard.part_of(frames) if f.frame_id not in self.failures)


def merge_shards(
    sources: Sequence[str | Path],
    out: Path,
    data: Path | None = None,
    *,
    partial: bool = False,
    layout: Layout = "files",
    existing: Existing = "refuse",
    on_progress: OnProgress | None = None,
) -> RunReport:
    """Write one run from the shards of a run; the result has the bytes of an undivided run.

    Pictures become hard links where the file system can, and copies elsewhere; tars are unpacked. Shards stay
    unchanged, and may have different layouts.

    Args:
        sources: Folders with shards, from one machine or several, or their addresses in object storage.
        out: Folder to write.
        data: Folder of the backgrounds, if it has moved.
        partial: Merge the finished shards only; the result is that of a run of their frames.
        layout: Layout of the result: `files`, a run, or `shards`, one packed shard.
        existing: What to do if `out` already contains a run; `resume` finishes an interrupted merge.
        on_progress: Called after each frame.

    Raises:
        ArgumentError: No shard is finished.
        OutputError: A shard is missing, unfinished, damaged or given twice; or `out` cannot be used.
        OtherSettingsError: The shards belong to different runs, or the backgrounds have changed.
        StorageError, MissingDependencyError: Object storage cannot be used.
        Interrupted: The user stopped; `resume` continues.
    """
    require_choice("layout", layout, get_args(Layout))
    if not sources:
        raise ArgumentError("merge: found no folder with shards, expected at least one")
    with contextlib.ExitStack() as stack:
        places = dict.fromkeys(Path(address_of(s) or real_path(Path(s))) for s in sources)
        runs = [stack.enter_context(opened_run(place)) for place in places]
        shared, shards = _finished_shards(runs, partial)
        for one in shards:
            stack.callback(one.source.close)
        for run in runs:
            _require_apart(run.root, out)
        first = shards[0].source
        recorded = RecordedRun.from_record(first.record(), first.place)
        for backgrounds in {recorded.data, data or recorded.data}:
            if address_of(backgrounds) is None:
                require_apart(backgrounds, out)
        plan = recorded.plan(data)
        if changed := differences(shared.key, plan.key):
            raise OtherSettingsError(
                f"{shown(recorded.data)}: the backgrounds are read differently now: {'; '.join(changed)}. Restore "
                "them, or give their folder with --data."
            )
        _require_intact(plan, shards)
        places_of = {f.frame_id: one for one in shards for f in one.shard.part_of(plan.frames)}
        if len(shards) < shared.count:
            plan = replace(recorded.select(tuple(places_of)).plan(data), run=plan.run)
        execution = Execution(device=recorded.device, renderer=shared.renderer, in_process=shared.renderer == "flat")
        if layout == "shards":
            return _pack(plan, places_of, shared, ShardedRun(out), execution, existing)
        frames = FrameSource(
            lambda folder: _ShardFrames(places_of, folder), shared.levels, recorded.machine, recorded.packages
        )
        return run_plan(plan, out, execution, existing, on_progress, source=frames)


def _pack(
    plan: RunPlan,
    places: Mapping[str, _Finished],
    shared: SharedPlan,
    target: ShardedRun,
    execution: Execution,
    existing: Existing,
) -> RunReport:
    started = time.monotonic()
    output = plan.recipe.output.model_copy(update={"layout": "shards"})
    recipe = plan.recipe.model_copy(update={"output": output})
    plan = replace(plan, recipe=recipe, levels=shared.levels, shard=Shard(1, 1))
    target.share_plan(plan, 1, shared.renderer)
    files = target.shard_files(Shard(1, 1))
    if (whole := find_whole(plan, files, existing)) is not None:
        return whole
    state = RunState()
    names = [f.frame_id for f in plan.frames]
    failures = {name: failure for name in names if (failure := places[name].failures.get(name)) is not None}
    frames = ((f, *places[f.frame_id].source.read(f.frame_id)) for f in plan.frames if f.frame_id not in failures)
    for frame in plan.frames:
        if (failure := failures.get(frame.frame_id)) is not None:
            state.add(TaskResult(frame.frame_id, None, failure), frame)
    state.done = len(plan.frames) - len(failures)
    counted = {one.shard: one.source.record()["counts"] for one in places.values()}
    objects = reduce(added_counts, ({k: n for k, n in c.items() if k.startswith("objects_")} for c in counted.values()))
    state.inserted = objects.pop("objects_inserted")
    labels = LabelSummary(objects, problems=tuple(nothing_inserted(plan.recipe, objects)))
    header = record_header(plan, execution) | ({} if shared.levels is None else {"levels": list(shared.levels)})
    record = run_record(header, plan, state, labels, {"seconds": round(time.monotonic() - started, 3)})
    with workspace(files.folder / files.name, "shard", RUN_FILE, existing, keep=True) as space:
        packed = ShardFiles(space.folder, files.name)
        counts = pack(plan, frames, packed, record, failures)
        publish(packed, files)
        space.discard()
    problems = tuple(state.problems(plan, labels))
    return RunReport(files.folder, counts, problems, time.monotonic() - started, files.marker)


def _finished_shards(runs: Sequence[ShardedRun], partial: bool) -> tuple[SharedPlan, list[_Finished]]:
    shared = runs[0].read_plan()
    for run in runs[1:]:
        other = run.read_plan()
        shared.require_same(other, run.place)
        if other.levels != shared.levels:
            raise OtherSettingsError(f"{run.place}: other grey levels than {runs[0].place}, of equal data")
    found: dict[int, tuple[ShardedRun, ShardState]] = {}
    started: dict[int, tuple[ShardedRun, ShardState]] = {}
    for run in runs:
        for state in run.states():
            number = state.shard.number
            if state.state in ("done", "failed"):
                if number in found:
                    raise OutputError(
                        f"shard {state.shard} is in {found[number][0].place} and in {run.place}; expected it once. "
                        "Move one of them away."
                    )
                found[number] = run, state
            elif state.state != "missing":
                started.setdefault(number, (run, state))
    lacking = [n for n in range(1, shared.count + 1) if n not in found]
    if lacking and not partial:
        raise OutputError(
            f"{len(lacking)} of {shared.count} shards are not finished. Finish them (infrablend status lists them), "
            "or merge the others with --partial.",
            [_unfinished(Shard(n, shared.count), *started.get(n, (runs[0], None))) for n in lacking],
        )
    if not found:
        raise ArgumentError(f"none of the {shared.count} shards is finished; expected at least one")
    return shared, [_read(run, state.shard, shared) for _, (run, state) in sorted(found.items())]


def _unfinished(shard: Shard, run: ShardedRun, state: ShardState | None) -> Problem:
    found = "missing" if state is None else state.describe()
    return Problem(f"shard {shard}", "shard-unfinished", found, "a finished shard", run.command(shard))


def _read(run: ShardedRun, shard: Shard, shared: SharedPlan) -> _Finished:
    """Return a finished shard, if its record is that of this shard of this run."""
    source = run.shard_source(shard)
    record = source.record()
    if record.get("shard") != str(shard):
        raise OutputError(f"{source.place}: found shard {record.get('shard')} of a run, expected shard {shard}")
    if changed := differences(shared.key, record.get("key", {})):
        raise OtherSettingsError(
            f"{source.place}: belongs to a different run than {SHARDS_FILE} beside it: {'; '.join(changed)}. "
            f"Repeat its command with --overwrite."
        )
    if record.get("levels") != (shared.levels and list(shared.levels)):
        raise OtherSettingsError(
            f"{source.place}: made with grey levels {record.get('levels')}; expected {shared.levels}, as in "
            f"{SHARDS_FILE}. Restore the file as it was, or repeat the command of the shard with --overwrite"
        )
    return _Finished(shard, source, source.failures(), run)


def _require_intact(plan: RunPlan, shards: Iterable[_Finished]) -> None:
    """Check that every frame that a shard has finished is there and unchanged.

    Raises:
        OutputError: One is not; `problems` names each shard.
    """
    problems = [
        Problem(
            shown(one.source.place),
            "shard-truncated",
            found,
            "all frames of a finished shard",
            one.run.command(one.shard),
        )
        for one in shards
        if (found := one.source.damage(one.finished(plan.frames))) is not None
    ]
    if problems:
        raise OutputError(f"{len(problems)} shards are truncated; nothing was written", problems)


def _require_apart(source: Path, out: Path) -> None:
    a, b = real_path(source), real_path(out)
    if a == b or a in b.parents or b in a.parents:
        raise OutputError(f"{out}: is, contains or is inside the folder of shards {source}; choose a separate folder")


class _ShardFrames:
    """Executor that takes finished frames from shards instead of rendering them, and repeats their failures.

    Tasks come in the order of the plan, in which each shard has its frames, too: a tar is read once.
    """

    def __init__(self, places: Mapping[str, _Finished], folder: RunFolder) -> None:
        self._places = places
        self._folder = folder
        self._open: ShardSource | None = None

    def run(self, tasks: Iterable[Task]) -> Iterator[TaskResult]:
        """Link or unpack the frame of each task, see `core.tasks.Executor`."""
        with Interruption() as stop:
            for task in tasks:
                if stop.requested:
                    raise Interrupted(STOPPED)
                failure = self._places[task.key].failures.get(task.key)
                yield TaskResult(task.key, None if failure else self._take(task.key), failure)

    def _take(self, frame_id: str) -> MadeFrame:
        source = self._places[frame_id].source
        if self._open is not None and self._open is not source:
            self._open.close()
        self._open = source
        return source.put(frame_id, self._folder)
