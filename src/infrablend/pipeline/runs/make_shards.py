"""Makes shards: renders their frames, then packs them and copies them to storage where layout or place ask for it."""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any

from infrablend.core.addresses import address_of
from infrablend.core.files import read_object, sha256_of_json
from infrablend.core.ledger import Ledger
from infrablend.core.operating_system import user_id
from infrablend.core.run_folder import RUN_FILE, SHARDS_FILE, RunFolder, ShardFiles
from infrablend.core.tasks import OnProgress, Progress
from infrablend.core.workspace import Existing, Workspace, is_being_written, partial_of, workspace
from infrablend.errors import OutputError
from infrablend.pipeline.plans.plan import RunPlan
from infrablend.pipeline.plans.run_request import Execution
from infrablend.pipeline.plans.shard import Shard
from infrablend.pipeline.runs.begun_run import require_same_key
from infrablend.pipeline.runs.packed_shard import pack, require_pyarrow
from infrablend.pipeline.runs.run import FrameSource, RunReport, run_plan
from infrablend.pipeline.runs.sharded import ShardedRun
from infrablend.pipeline.storage.store import Store
from infrablend.report.run_warnings import nothing_inserted

log = logging.getLogger(__name__)


def make_shards(
    plan: RunPlan,
    shards: Sequence[Shard],
    out: Path,
    execution: Execution,
    existing: Existing = "refuse",
    on_progress: OnProgress | None = None,
    source: FrameSource | None = None,
) -> RunReport:
    """Make shards one after the other, and return a report that counts the frames of all; `merge` writes label files.

    Args:
        plan: Plan of the whole run.
        shards: Shards to make.
        out: Folder of the run, or its address in object storage, which takes packed shards only.
        execution: Workers, device and renderer.
        existing: What to do with shards that are there; `resume` leaves whole ones as they are.
        on_progress: Called after each frame.
        source: Where to take finished frames from; None renders them.

    Raises:
        MissingDependencyError: pyarrow, or the library for the storage, is not installed.
        StorageError: The storage cannot be used.
        OtherSettingsError: `out` has shards of another run.
        OutputError, Interrupted, RenderError: See `run_plan`.
    """
    reports: list[RunReport] = []
    before = 0
    total = sum(len(s.part_of(plan.frames)) for s in shards)
    with _opened(plan, shards, out) as run:
        shared = run.share_plan(plan, shards[0].count, execution.renderer)
        for shard in shards:
            frames = tuple(shard.part_of(plan.frames))
            part = replace(plan, frames=frames, shard=shard, levels=shared.levels)
            if reports or len(shards) < shard.count:
                part = replace(part, problems=())  # those of the data are reported once: by merging, or with the first
            progress = None if on_progress is None else _progress_of_all(on_progress, before, total)
            reports.append(_make(run, part, shard, execution, existing, progress, source))
            before += len(frames)
    counts: Mapping[str, object] = reduce(_added, (r.counts for r in reports))
    whole = len(shards) == shards[0].count  # a part alone may have no object of a kind
    nothing = tuple(nothing_inserted(plan.recipe, counts)) if whole else ()
    problems = nothing + tuple(p for r in reports for p in r.problems)
    if len(reports) == 1:
        return replace(reports[0], problems=problems)
    return RunReport(out, counts, problems, sum(r.seconds for r in reports), out / SHARDS_FILE)


def _added(a: Mapping[str, object], b: Mapping[str, object]) -> dict[str, object]:
    """Return the sums of two sets of counts, nested ones as well; what is no count, as a factor, is equal in both."""
    found = dict(a)
    for name, value in b.items():
        known = found.get(name)
        if isinstance(known, int) and isinstance(value, int):
            found[name] = known + value
        elif isinstance(known, Mapping) and isinstance(value, Mapping):
            found[name] = _added(known, value)
        else:
            found[name] = value
    return found


def _progress_of_all(on_progress: OnProgress, before: int, total: int) -> OnProgress:
    """Return what takes the progress of a shard after some frames, and reports that of all shards."""

    def report(progress: Progress) -> None:
        done = before + progress.done
        rate = progress.frames_per_s
        on_progress(replace(progress, done=done, total=total, eta_s=(total - done) / rate if rate else None))

    return report


@contextlib.contextmanager
def _opened(plan: RunPlan, shards: Sequence[Shard], out: Path) -> Iterator[ShardedRun]:
    """Yield the run to write; shards for object storage are made in a folder that the same call finds after a kill."""
    if (address := address_of(out)) is None:
        yield ShardedRun(out)
        return
    job = f"{address} {sha256_of_json(plan.key)} {len(shards)} {shards[0]}"
    name = f"infrablend-{user_id()}-{hashlib.sha256(job.encode()).hexdigest()[:16]}"
    root = Path(tempfile.gettempdir()) / name
    root.mkdir(mode=0o700, parents=True, exist_ok=True)
    run = ShardedRun(root, Store(address))
    try:
        _remove_copies(root)
        run.refresh(SHARDS_FILE)
        yield run
    finally:
        _remove_copies(root)
        with contextlib.suppress(OSError):  # has a shard that was not finished, or not copied
            root.rmdir()


def _remove_copies(root: Path) -> None:
    """Remove the plan and records that were copied from the storage."""
    for path in sorted(root.glob("*.json")):
        path.unlink(missing_ok=True)


def _make(
    run: ShardedRun,
    plan: RunPlan,
    shard: Shard,
    execution: Execution,
    existing: Existing,
    on_progress: OnProgress | None,
    source: FrameSource | None,
) -> RunReport:
    """Make one shard, whose frames the plan has, in its workspace; then pack it, and show it to its readers."""
    if plan.recipe.output.layout == "files":
        return run_plan(plan, run.folder_of(shard).root, execution, existing, on_progress, source=source)
    files = run.files_of(shard)
    place = files.folder / files.name
    run.refresh(files.marker.name)
    if (whole := _whole(run, plan, shard, existing)) is not None:
        if partial_of(place).is_dir() and not is_being_written(place):  # left by a kill after the record had appeared
            with workspace(place, "shard", RUN_FILE, existing, keep=True) as space:
                space.discard()
        return whole
    if run.store is not None and existing == "refuse":
        existing = "resume"  # what a killed job left on this machine; the storage has no such shard
    counts: Mapping[str, object] = {}

    def pack_up(space: Workspace, record: Mapping[str, Any]) -> None:
        nonlocal counts
        packed = ShardFiles(space.folder, files.name)
        with Ledger.open(space.folder) as ledger:
            counts = pack(plan, RunFolder(space.folder), ledger, packed, record)
        run.publish(packed)
        space.discard()

    report = run_plan(plan, place, execution, existing, on_progress, source=source, finish=pack_up)
    return replace(report, out=Path(run.place), record_file=Path(run.place_of(files.marker)), counts=counts)


def _whole(run: ShardedRun, plan: RunPlan, shard: Shard, existing: Existing) -> RunReport | None:
    """Return the report of a packed shard that need not be made; None if it has to be.

    Raises:
        MissingDependencyError: pyarrow is not installed.
        OutputError: There is one, and `existing` forbids to replace it.
        OtherSettingsError: The shard to resume is of another run.
    """
    require_pyarrow()
    marker = run.files_of(shard).marker
    place = run.place_of(marker)
    if not os.path.lexists(marker) or existing == "overwrite":
        return None
    if existing == "refuse":
        raise OutputError(
            f"{place}: exists already; expected no such shard. Use --resume to make it only if it is not whole, or "
            "--overwrite to replace it."
        )
    record = read_object(marker) or {}
    if record.get("shard") != str(shard):
        found: str | None = f"it is the record of shard {record.get('shard')}, expected {shard}"
    elif (found := run.damage(shard, record, digests=True)) is None:
        require_same_key(record, plan, place)
        if record["counts"]["frames"] == len(plan.frames):
            return RunReport.of_record(record, Path(run.place), Path(place))
        found = "some of its frames failed"
    log.warning("%s: %s; the shard is made again", place, found)
    return None
