"""Joins packed shards into one without unpacking them: tars and tables are appended, and counts are added."""

from __future__ import annotations

import tarfile
import time
from collections.abc import Mapping, Sequence

from infrablend.annotation.looseness import LOOSENED, Looseness
from infrablend.core.files import flush, open_regular, replace_atomically
from infrablend.core.finished import COMPLETE
from infrablend.core.output import Existing
from infrablend.core.run_layout import ShardFiles
from infrablend.core.tasks import OnProgress, Progress, TaskResult
from infrablend.core.typed_command import command_facts
from infrablend.errors import Interrupted, OutputError
from infrablend.execution.interrupt import STOPPED, Interruption
from infrablend.formats.shard_tar import TarWriter
from infrablend.pipeline.folder import ARCHIVE, FILES, RUN
from infrablend.pipeline.label_files import LabelSummary
from infrablend.pipeline.plan import RunPlan
from infrablend.pipeline.request import Execution
from infrablend.pipeline.run import FrameSource, RunReport
from infrablend.pipeline.run_record import RunState, record_header, run_record
from infrablend.pipeline.shard import Shard
from infrablend.pipeline.shard_archive import discard_run, finished_report, made_beside, publish, write_marker
from infrablend.pipeline.shard_source import FinishedShard
from infrablend.pipeline.shard_table import TableWriter, packed_pictures


def can_join(plan: RunPlan, shards: Sequence[FinishedShard]) -> bool:
    """Return whether these shards are packed, agree in what their labels and records name, and count all of it."""
    ids = [(c.id, c.name) for c in plan.categories]
    looseness = bool(Looseness.of_labels(plan.recipe.labels))
    return all(
        one.source.packed() is not None
        and one.record.get(RUN) == plan.run
        and [(c.get("id"), c.get("name")) for c in one.record.get("categories", ()) if isinstance(c, Mapping)] == ids
        # Older shards do not count the boxes that were changed.
        and not (looseness and one.record["counts"].get("objects_inserted") and LOOSENED not in one.record["counts"])
        for one in shards
    )


def join_shards(
    plan: RunPlan,
    shards: Sequence[FinishedShard],
    finished: Mapping[Shard, Sequence[str]],
    files: ShardFiles,
    execution: Execution,
    existing: Existing,
    on_progress: OnProgress | None,
    source: FrameSource,
) -> RunReport:
    """Write one packed shard with the frames of others; it has the bytes of a shard that was made undivided.

    Args:
        plan: Plan of the joined shard.
        shards: Shards for which `can_join` is true, in the order of their numbers.
        finished: Ids of the frames of each shard that have a picture, in their order.
        files: Files to write.
        execution: Device and renderer that the frames were made with.
        existing: What to do if there is such a shard; `resume` leaves one that is whole as it is.
        on_progress: Called after each shard.
        source: Levels, machine and packages that the frames were made with.

    Raises:
        MissingDependencyError: pyarrow is not installed.
        OutputError: The shard exists, another job writes it, a source was changed, or the disk is full.
        Interrupted: The user stopped.
    """
    started = time.monotonic()
    with made_beside(plan, files, existing) as (packed, found), Interruption() as stop:
        state = _counted(plan, shards, finished)
        if found is not None and existing == "resume" and found["counts"].get("frames") == state.done:
            return finished_report(files, found)
        ids = {c.name: c.id for c in plan.categories}
        done = 0
        with replace_atomically(packed.tar, durable=True) as tar_part, replace_atomically(packed.table) as table_part:
            with tar_part.open("wb") as stream, TarWriter(stream) as tar, TableWriter(table_part, ids) as table:
                for one in shards:
                    if stop.requested:
                        raise Interrupted(STOPPED)
                    done += _append(one, finished[one.shard], tar, table)
                    if on_progress is not None:
                        on_progress(Progress.since(started, done, state.done, state.outcomes))
            flush(table_part)
        levels = {} if source.levels is None else {"levels": list(source.levels)}
        header = {
            **record_header(plan, execution.worker_count(), execution.device, execution.renderer),
            **command_facts(),
            "machine": dict(source.machine),
            "packages": dict(source.packages),
            **levels,
        }
        labels, timing = LabelSummary(), {"seconds": round(time.monotonic() - started, 3)}
        record = {**run_record(header, COMPLETE, plan, state, labels, timing), FILES: 0}
        loosened = sum(_count(one, LOOSENED, 0) for one in shards)
        record["counts"] = {**record["counts"], **Looseness.of_labels(plan.recipe.labels).counted(loosened)}
        write_marker(plan, packed, record)
        publish(packed, files)
        discard_run(files)
    problems = tuple(state.problems(plan, labels))
    return RunReport(files.folder, COMPLETE, record["counts"], problems, time.monotonic() - started, files.marker)


def _counted(plan: RunPlan, shards: Sequence[FinishedShard], finished: Mapping[Shard, Sequence[str]]) -> RunState:
    """Return the counts of all shards together, which repeat the failures of their frames."""
    state = RunState()
    failures = {frame: failure for one in shards for frame, failure in one.failures.items()}
    for frame in plan.frames:
        if (failure := failures.get(frame.frame_id)) is not None:
            state.add(TaskResult(frame.frame_id, None, failure), frame)
    for one in shards:
        state.done += len(finished[one.shard])
        state.inserted += _count(one, "objects_inserted")
    return state


def _count(one: FinishedShard, name: str, absent: int | None = None) -> int:
    """Return a count of a shard's record, or `absent` where the record has none.

    Raises:
        OutputError: It is no whole number, or negative.
    """
    found = one.record["counts"].get(name, absent)
    if type(found) is not int or found < 0:
        raise _changed(one, f"{name}: {found!r} in its record")
    return found


def _append(one: FinishedShard, frames: Sequence[str], tar: TarWriter, table: TableWriter) -> int:
    """Append a shard to tar and table, and return the number of its frames."""
    from pyarrow import ArrowException

    files = one.source.packed()
    assert files is not None
    try:
        with files as packed, open_regular(packed.tar) as stream:
            pictures = packed_pictures(packed.table)
            if pictures.frames != tuple(frames):
                raise _changed(one, f"{len(pictures.frames)} frames in its table")
            shift, sha256 = tar.add_files_of(stream, pictures.end)
            if sha256 != one.record[ARCHIVE]["tar"]["sha256"]:
                raise _changed(one, "another content")
            table.add_rows_of(packed.table, shift)
    except (ArrowException, tarfile.TarError) as error:
        raise _changed(one, str(error)) from error
    return len(frames)


def _changed(one: FinishedShard, found: str) -> OutputError:
    return OutputError(
        f"{one.source.place}: found {found}; expected the tar and table as they were written. Repeat the command of "
        "this shard with --resume, which makes it again"
    )
