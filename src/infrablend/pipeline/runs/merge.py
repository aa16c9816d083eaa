"""Merges finished shards into one run: links their frames, and writes labels, card and record as a single run does."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import get_args

from infrablend.core.addresses import address_of, shown
from infrablend.core.arguments import require_choice
from infrablend.core.file_names import real_path
from infrablend.core.output_checks import require_apart
from infrablend.core.run_folder import RunFolder
from infrablend.core.tasks import OnProgress, Task, TaskResult
from infrablend.core.workspace import Existing
from infrablend.errors import ArgumentError, Interrupted, OtherSettingsError, OutputError, Problem
from infrablend.pipeline.execution.interrupt import STOPPED, Interruption
from infrablend.pipeline.plans.plan import RunPlan
from infrablend.pipeline.plans.run_request import Execution
from infrablend.pipeline.plans.shard import Shard
from infrablend.pipeline.runs.begun_run import differences
from infrablend.pipeline.runs.make_shards import make_shards
from infrablend.pipeline.runs.record import RecordedRun
from infrablend.pipeline.runs.run import FrameSource, RunReport, run_plan
from infrablend.pipeline.runs.shard_source import FinishedShard, finished_shard
from infrablend.pipeline.runs.sharded import Layout, ShardedRun, ShardState, SharedPlan, opened_run

_PROGRESS = {"missing": 0, "stopped": 1, "running": 1, "failed": 2, "done": 2}
"""How far a shard is, by its state: what is furthest counts if several folders have the same shard."""


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
        for run in runs:
            _require_apart(run.root, out)
        recorded = RecordedRun.from_record(shards[0].record, Path(shards[0].place))
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
        shard_of = {f.frame_id: one for one in shards for f in one.shard.part_of(plan.frames)}
        if len(shards) < shared.shards:
            plan = replace(recorded.select(tuple(shard_of)).plan(data), run=plan.run)
        execution = Execution(device=recorded.device, renderer=shared.renderer, in_process=shared.renderer == "flat")
        source = FrameSource(
            lambda folder: _ShardFrames(shard_of, folder), shared.levels, recorded.machine, recorded.packages
        )
        if layout == "files":
            return run_plan(plan, out, execution, existing, on_progress, source=source)
        output = plan.recipe.output.model_copy(update={"layout": "shards"})
        plan = replace(plan, recipe=plan.recipe.model_copy(update={"output": output}), levels=shared.levels)
        return make_shards(plan, [Shard(1, 1)], out, execution, existing, on_progress, source)


def _finished_shards(runs: Sequence[ShardedRun], partial: bool) -> tuple[SharedPlan, list[FinishedShard]]:
    shared = runs[0].read_plan()
    for run in runs[1:]:
        other_plan = run.read_plan()
        shared.require_same(other_plan, run.place)
        if other_plan.levels != shared.levels:
            raise OtherSettingsError(f"{run.place}: other grey levels than {runs[0].place}, of equal data")
    furthest: dict[int, tuple[ShardedRun, ShardState]] = {}
    for run in runs:
        for state in run.states():
            other, known = furthest.get(state.shard.number, (run, None))
            if known is not None and known.is_finished and state.is_finished:
                raise OutputError(
                    f"shard {state.shard} is in {other.place} and in {run.place}; expected it once. Move one of them "
                    "away."
                )
            if known is None or _PROGRESS[state.state] > _PROGRESS[known.state]:
                furthest[state.shard.number] = run, state
    finished = [(run, state.shard) for run, state in furthest.values() if state.is_finished]
    lacking = [
        Problem(f"shard {s.shard}", "shard-unfinished", s.describe(), "a finished shard", run.command(s.shard))
        for run, s in furthest.values()
        if not s.is_finished
    ]
    if lacking and not partial:
        raise OutputError(
            f"{len(lacking)} of {shared.shards} shards are not finished. Finish them (infrablend status lists them), "
            "or merge the others with --partial.",
            lacking,
        )
    if not finished:
        raise ArgumentError(f"none of the {shared.shards} shards is finished; expected at least one")
    return shared, [finished_shard(run, shard, shared) for run, shard in finished]


def _require_intact(plan: RunPlan, shards: Sequence[FinishedShard]) -> None:
    """Check that every frame that a shard has finished is there and unchanged.

    Raises:
        OutputError: One is not; `problems` names each shard.
    """
    problems = []
    for one in shards:
        if (found := one.damage(one.finished(plan.frames))) is not None:
            command = one.run.command(one.shard)
            problems.append(Problem(one.place, "shard-truncated", found, "all frames of a finished shard", command))
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

    def __init__(self, shard_of: Mapping[str, FinishedShard], folder: RunFolder) -> None:
        self._shard_of = shard_of
        self._folder = folder

    def run(self, tasks: Iterable[Task]) -> Iterator[TaskResult]:
        """Link or unpack the frame of each task, see `core.tasks.Executor`."""
        with Interruption() as stop:
            for shard, of_shard in groupby(tasks, key=lambda task: self._shard_of[task.key]):
                keys = [task.key for task in of_shard]
                wanted = [key for key in keys if key not in shard.failures]
                with contextlib.closing(shard.put(wanted, self._folder)) as frames:
                    for key in keys:
                        if stop.requested:
                            raise Interrupted(STOPPED)
                        failure = shard.failures.get(key)
                        yield TaskResult(key, None if failure else next(frames), failure)
