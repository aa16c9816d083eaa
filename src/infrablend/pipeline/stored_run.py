"""Run in shards in object storage: the files of a folder with packed shards, below an address such as `s3://bucket/run`.

A shard is made in a scratch folder of this machine, as in any folder, and then copied: tar and table, each read back,
and the record last, which marks it as finished. What has no record is not there for any reader.

    s3://bucket/run/shards.json                     the plan
    s3://bucket/run/shard-00002-of-00007.tar        and .parquet, .json: a finished shard
    s3://bucket/run/shard-00002-of-00007.claim      a job makes this shard; gone when it ends

Claims only save time. A storage without conditional writes, or a job that was cut off for long, can let two jobs make
one shard: they write the same bytes.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from infrablend.config.recipe import Recipe
from infrablend.core.addresses import address_of
from infrablend.core.checked_files import CheckedFiles
from infrablend.core.files import read_object, read_regular, sha256_of, sha256_of_json
from infrablend.core.finished import COMPLETE
from infrablend.core.output import Existing
from infrablend.core.run_layout import SHARDS_FILE, ShardFiles
from infrablend.core.tasks import OnProgress, Progress
from infrablend.errors import ArgumentError, OutputError, Problem, StorageError
from infrablend.pipeline.folder import ARCHIVE, RunFolder, read_run_file
from infrablend.pipeline.plan import RunPlan
from infrablend.pipeline.record import FrameRecord
from infrablend.pipeline.request import Execution
from infrablend.pipeline.run import RunReport, require_same_key
from infrablend.pipeline.shard import Shard
from infrablend.pipeline.shard_claim import ShardClaim
from infrablend.pipeline.shard_damage import number_damage
from infrablend.pipeline.shard_source import ShardArchive, ShardSource
from infrablend.pipeline.sharded_run import ShardedRun, ShardState, SharedPlan, joined_reports, run_shard, shifted
from infrablend.storage.scratch import scratch
from infrablend.storage.store import DAMAGED, Store, Stored

log = logging.getLogger(__name__)

_numbers = itertools.count()  # of readers in this process


@dataclass
class StoredRun:
    """Run in shards in object storage, with its small files in a folder of this machine.

    Attributes:
        store: The storage.
        mirror: Folder for the plan and the records of finished shards.
        files: What the storage has, by name.
    """

    store: Store
    mirror: Path
    files: dict[str, Stored]

    @classmethod
    @contextlib.contextmanager
    def opened(cls, address: str, store: Store | None = None) -> Iterator[StoredRun]:
        """Yield the run at an address, as it is now.

        Raises:
            StorageError, MissingDependencyError: The storage cannot be used.
        """
        with scratch(f"reading {address} in process {os.getpid()}, {next(_numbers)}") as folder:
            run = cls(store or Store(address), folder, {})
            run.refresh()
            yield run

    @property
    def root(self) -> str:
        """Address of the run."""
        return self.store.address

    @property
    def _local(self) -> ShardedRun:
        return ShardedRun(self.mirror)

    def refresh(self) -> None:
        """Look again at what the storage has, and copy the plan and the records that are new."""
        self.files = self.store.files()
        for name in self.files:
            copy = self.mirror / name
            small = name == SHARDS_FILE or (name.startswith("shard-") and name.endswith(".json"))
            if small and not (copy.exists() and copy.stat().st_size == self.files[name].size):
                self._copy(name)
        for path in sorted(self.mirror.glob("shard*.json")):
            if path.name not in self.files:
                path.unlink()

    def _copy(self, name: str) -> None:
        """Copy a small file; a record that is damaged is none, so that its shard is made again."""
        try:
            self.store.download(name, self.mirror / name)
        except StorageError as error:
            if name == SHARDS_FILE or all(p.code != DAMAGED for p in error.problems):
                raise
            log.warning("%s", error)

    def read_plan(self) -> SharedPlan:
        """Return the shared plan.

        Raises:
            OutputError: There is none, or it is damaged.
        """
        if SHARDS_FILE not in self.files:
            raise OutputError(
                f"{self.root}: no {SHARDS_FILE}; expected a run in shards. Give the --out of "
                "`infrablend generate ... --out ADDRESS`"
            )
        try:
            return self._local.read_plan()
        except OutputError as error:
            raise OutputError(error.message.replace(str(self.mirror), self.root), error.problems) from error

    def states(self) -> list[ShardState]:
        """Return the state of every shard, in the order of their numbers."""
        shared = self.read_plan()
        return [self._state(Shard(n, shared.count), shared) for n in range(1, shared.count + 1)]

    def wait(self, interval_s: float = 30) -> list[ShardState]:
        """Return the states once every shard is done or failed; the plan may be missing until the first one starts."""
        while True:
            if SHARDS_FILE in self.files:
                states = self.states()
                if all(s.state in ("done", "failed") for s in states):
                    return states
            time.sleep(interval_s)
            self.refresh()

    def command(self, shard: Shard) -> str:
        """Return the command that makes a shard: that of another shard, with its number."""
        return self._local.command(shard, self.root)

    def shard_source(self, shard: Shard) -> ShardSource:
        """Return a finished shard as a source of frames; its tar is on this machine while it is read."""
        return _StoredShard(self, shard)

    def damage(self, shard: Shard, record: Mapping[str, Any]) -> str | None:
        """Return what is wrong with the sizes of a shard's files; None if nothing is."""
        return stored_damage(ShardFiles(self.mirror, shard.folder_name), record, self.files)

    def _state(self, shard: Shard, shared: SharedPlan) -> ShardState:
        planned = len(shard.part_of(range(shared.frames)))
        record = read_object(ShardFiles(self.mirror, shard.folder_name).marker)
        claimed = f"{shard.folder_name}.claim" in self.files and ShardClaim(self.store, shard).is_fresh()
        if record is None:
            begun = any(name.startswith(f"{shard.folder_name}.") for name in self.files)
            state = ShardState(shard, "running" if claimed else "stopped" if begun else "missing", planned)
        else:
            counts = record.get("counts")
            finished = counts.get("frames") if isinstance(counts, Mapping) else None
            damage = self.damage(shard, record)
            if damage is None and record.get("status") == COMPLETE and isinstance(finished, int):
                kind = "done" if finished == planned else "failed"
                state = ShardState(shard, kind, planned, finished, planned - finished)  # type: ignore[arg-type]
            else:
                state = ShardState(shard, "running" if claimed else "stopped", planned, damage=damage or "damaged")
        return state if state.state in ("done", "running") else replace(state, command=self.command(shard))


@contextlib.contextmanager
def opened_run(out: str | Path) -> Iterator[ShardedRun | StoredRun]:
    """Yield the run in shards in a folder, or at an address.

    Raises:
        StorageError, MissingDependencyError: The storage cannot be used.
    """
    if (address := address_of(out)) is None:
        yield ShardedRun(Path(out))
        return
    with StoredRun.opened(address) as run:
        yield run


def stored_damage(files: ShardFiles, record: Mapping[str, Any], there: Mapping[str, Stored]) -> str | None:
    """Return what is wrong with the sizes of a shard's files in storage; None if nothing is."""
    for path, kind in ((files.tar, "tar"), (files.table, "table")):
        try:
            expected = record[ARCHIVE][kind]["bytes"]
        except (LookupError, TypeError):
            return f"{files.marker.name} is damaged: no facts about the {kind}"
        if path.name not in there:
            return f"{path.name} is missing"
        if (size := there[path.name].size) != expected:
            return f"{path.name} has {size} bytes, expected {expected}"
    return None


class _StoredShard:
    """Finished shard in storage; its tar is copied when the first frame is asked for, and deleted when it is closed."""

    def __init__(self, run: StoredRun, shard: Shard) -> None:
        self._run, self._shard = run, shard
        self._files = ShardFiles(run.mirror, shard.folder_name)
        self._archive: ShardArchive | None = None

    @property
    def record_file(self) -> Path:
        """Copy of the shard's record."""
        return self._files.marker

    @property
    def place(self) -> Path:
        """Address of the tar."""
        return Path(self._run.store.place(self._files.tar.name))

    def damage(self, frames: Sequence[str], record: Mapping[str, Any], checked: CheckedFiles) -> str | None:
        """Return what is wrong with the sizes in storage; the digest is checked when the tar is copied."""
        return self._run.damage(self._shard, record)

    def put(self, frame_id: str, folder: RunFolder, checked: CheckedFiles) -> FrameRecord:
        """Unpack a frame that follows the last one that was asked for."""
        if self._archive is None:
            self._fetch(self._files.tar, "tar")
            self._archive = ShardArchive(self._files)
        return self._archive.put(frame_id, folder, checked)

    @contextlib.contextmanager
    def packed(self) -> Iterator[ShardFiles]:
        """Copy its files, and delete the copies at the end."""
        self._fetch(self._files.tar, "tar")
        self._fetch(self._files.table, "table")
        try:
            yield self._files
        finally:
            self._files.table.unlink(missing_ok=True)
            self.close()

    def _fetch(self, file: Path, name: str) -> None:
        sha256 = read_run_file(self._files.marker)[ARCHIVE][name]["sha256"]
        self._run.store.download(file.name, file, sha256)

    def close(self) -> None:
        """Delete the copy of the tar."""
        if self._archive is not None:
            self._archive.close()
        self._archive = None
        self._files.tar.unlink(missing_ok=True)


def require_packed(recipe: Recipe, out: Path) -> None:
    """Check that a run in object storage has packed shards.

    Raises:
        ArgumentError: Its layout has a file per frame.
    """
    if (address := address_of(out)) is not None and recipe.output.layout != "shards":
        raise ArgumentError(
            f"out: found {address} and output.layout: files, expected packed shards in object storage. Add "
            "--set output.layout=shards; `infrablend merge` makes files of them"
        )


def run_stored_shards(
    plan: RunPlan,
    shards: Sequence[Shard],
    out: Path,
    execution: Execution,
    existing: Existing = "refuse",
    on_progress: OnProgress | None = None,
    store: Store | None = None,
) -> RunReport:
    """Make packed shards one after the other, and copy each to object storage.

    Args:
        plan: Plan of the whole run.
        shards: Shards to make.
        out: Address of the run.
        execution: Workers, device and renderer.
        existing: What to do with shards that the storage has: `resume` leaves whole ones as they are.
        on_progress: Called after each frame.
        store: The storage; None connects to that of the address.

    Raises:
        ArgumentError: The layout has a file per frame.
        StorageError: The storage cannot be used, or does not keep what is written.
        OutputError, OtherSettingsError, Interrupted, RenderError: See `run_shard`.
    """
    address = address_of(out)
    assert address is not None
    require_packed(plan.recipe, out)
    store = store or Store(address)
    reports: list[RunReport] = []
    for shard, progress in zip(shards, shifted(plan, shards, on_progress), strict=True):
        reports.append(_StoredShardJob(store, plan, shard, execution).run(existing, progress))
        plan = replace(plan, problems=())
    return replace(joined_reports(reports, out), out=out)


@dataclass
class _StoredShardJob:
    """Making of one shard."""

    store: Store
    plan: RunPlan
    shard: Shard
    execution: Execution

    def run(self, existing: Existing, on_progress: OnProgress | None) -> RunReport:
        self._found(existing)
        files = ShardFiles(Path(), self.shard.folder_name)
        claim = ShardClaim(self.store, self.shard)

        def progressed(progress: Progress) -> None:
            claim.renew()
            if on_progress is not None:
                on_progress(progress)

        # Another run at this address has another folder.
        purpose = f"shard {self.shard} of {self.store.address}, run {sha256_of_json(self.plan.key)[:12]}"
        with scratch(purpose, keep=True) as folder, claim.held(wait=existing == "resume"):
            there = self._found(existing)  # now that no other job can finish it
            local = ShardedRun(folder / "run")  # the scratch folder itself is locked
            local.root.mkdir(exist_ok=True)
            packed = local.shard_files(self.shard)
            if existing == "overwrite":
                shutil.rmtree(packed.folder / packed.name, ignore_errors=True)
            for path in (packed.marker, packed.tar, packed.table):
                path.unlink(missing_ok=True)
            self._share_plan(local)
            record_file = Path(self.store.place(files.marker.name))
            if existing == "resume" and files.marker.name in there:
                counts, problems = self._fetch(packed, there)
                if counts.get("frames") == len(self.shard.part_of(self.plan.frames)):
                    return RunReport(Path(self.store.address), COMPLETE, counts, problems, record_file=record_file)
            report = run_shard(self.plan, self.shard, local.root, self.execution, "resume", progressed)
            claim.renew()
            self._publish(packed)
            return replace(report, out=Path(self.store.address), record_file=record_file)

    def _found(self, existing: Existing) -> Mapping[str, Stored]:
        """Return the files of the run.

        Raises:
            OutputError: `existing` or their origin forbid to replace those of the shard.
        """
        there, files = self.store.files(), ShardFiles(Path(), self.shard.folder_name)
        if existing == "refuse" and files.marker.name in there:
            raise OutputError(
                f"{self.store.place(files.marker.name)}: exists already; expected no such shard. Use --resume to make "
                "it only if it is not whole, or --overwrite to replace it."
            )
        if SHARDS_FILE not in there and files.marker.name not in there:
            for path in (files.tar, files.table):
                if path.name in there:
                    raise OutputError(
                        f"{self.store.place(path.name)}: exists without {SHARDS_FILE}, which is written before any "
                        "shard, so nothing shows that InfraBlend wrote it; nothing was touched. Move it elsewhere, "
                        "and repeat the command."
                    )
        return there

    def _share_plan(self, local: ShardedRun) -> None:
        """Put the shared plan of the storage into the scratch folder, or write the one that is made there."""
        local.file.unlink(missing_ok=True)
        known = self.store.read(SHARDS_FILE)
        if known is None:
            local.share_plan(self.plan, self.shard.count, self.execution.renderer)
            if self.store.write(SHARDS_FILE, read_regular(local.file), new=True):
                return
            known = self.store.read(SHARDS_FILE) or b""  # another job was first
        local.file.write_bytes(known)
        try:
            local.share_plan(self.plan, self.shard.count, self.execution.renderer)
        except OutputError as error:
            message = error.message.replace(str(local.root), self.store.address)
            raise type(error)(message, error.problems) from error

    def _fetch(self, packed: ShardFiles, there: Mapping[str, Stored]) -> tuple[Mapping[str, Any], tuple[Problem, ...]]:
        """Return counts and problems of a finished shard in the storage; nothing if it is not whole.

        If some of its frames failed, it is copied into the scratch folder, where a run continues with them.
        """
        try:
            self.store.download(packed.marker.name, packed.marker)
            record = read_run_file(packed.marker)
            found = number_damage(record, self.shard) or stored_damage(packed, record, there)
            if found is None and record["counts"]["frames"] < len(self.shard.part_of(self.plan.frames)):
                for path, kind in ((packed.tar, "tar"), (packed.table, "table")):
                    self.store.download(path.name, path, record[ARCHIVE][kind]["sha256"])
        except OutputError as error:  # a damaged record
            found = error.message.removeprefix(f"{packed.marker}: ")
        except StorageError as error:
            found = error.message
        if found is None:
            require_same_key(record, self.plan, self.store.place(packed.marker.name))
            return record["counts"], tuple(Problem(**p) for p in record.get("problems", ()))
        log.warning("%s: %s; the shard is made again", self.store.place(packed.marker.name), found)
        for path in (packed.marker, packed.tar, packed.table):
            path.unlink(missing_ok=True)
        return {}, ()

    def _publish(self, packed: ShardFiles) -> None:
        """Copy the files of a shard: the record is removed first and comes last."""
        record = read_run_file(packed.marker)
        self.store.remove(packed.marker.name)
        for path, kind in ((packed.tar, "tar"), (packed.table, "table")):
            self.store.upload(path, path.name, record[ARCHIVE][kind]["sha256"])
        self.store.upload(packed.marker, packed.marker.name, sha256_of(packed.marker))
