"""Run in shards in object storage: the files of a folder with packed shards, below an address such as `s3://bucket/run`.

A shard is made in a scratch folder of this machine, as in any folder, and then copied: tar and table, and the record
last, which marks it as finished. A shard without record is not there for any reader. Two jobs that make the same shard
write the same bytes.

    s3://bucket/run/shards.json                     the plan
    s3://bucket/run/shard-00002-of-00007.tar        and .parquet, .json: a finished shard
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from infrablend.config.recipe import Recipe
from infrablend.core.addresses import address_of
from infrablend.core.files import read_object, sha256_of_json, write_bytes
from infrablend.core.run_folder import SHARDS_FILE
from infrablend.core.tasks import OnProgress
from infrablend.core.workspace import Existing
from infrablend.errors import ArgumentError, OutputError, StorageError
from infrablend.pipeline.plans.plan import RunPlan
from infrablend.pipeline.plans.run_request import Execution
from infrablend.pipeline.plans.shard import Shard
from infrablend.pipeline.runs.key import require_same_key
from infrablend.pipeline.runs.packed_shard import ARCHIVE
from infrablend.pipeline.runs.run import RunReport
from infrablend.pipeline.runs.shard_source import ShardArchive, ShardSource
from infrablend.pipeline.runs.sharded import ShardedRun, run_shard, run_shards
from infrablend.pipeline.storage.store import Store

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class StoredRun(ShardedRun):
    """Run in shards in object storage; `root` is a folder of this machine with copies of its small files.

    Attributes:
        store: The storage.
        sizes: Bytes of its files, by name.
    """

    store: Store
    sizes: dict[str, int] = field(default_factory=dict)

    @property
    def place(self) -> str:
        """Address of the run."""
        return self.store.address

    def refresh(self) -> None:
        """Look again at what the storage has, and copy the plan and the records that are new."""
        self.sizes.clear()
        self.sizes.update(self.store.files())
        for path in sorted(self.root.glob("*.json")):
            if path.name not in self.sizes:
                path.unlink()
        for name, size in self.sizes.items():
            copy = self.root / name
            known = copy.is_file() and copy.stat().st_size == size
            if name.endswith(".json") and not known and (text := _read_marker(self.store, name)) is not None:
                write_bytes(copy, text)

    def states(self) -> list[Any]:
        """Return the state of every shard, as the storage has it now."""
        self.refresh()
        return super().states()

    def damage(self, shard: Shard, record: Mapping[str, Any]) -> str | None:
        """Return what is wrong with the sizes of a shard's files in storage; None if nothing is."""
        files = self.shard_files(shard)
        for path, kind in ((files.tar, "tar"), (files.table, "table")):
            expected = record.get(ARCHIVE, {}).get(kind, {}).get("bytes")
            if self.sizes.get(path.name) != expected or expected is None:
                return f"{path.name} has {self.sizes.get(path.name)} bytes in storage, expected {expected}"
        return None

    def shard_source(self, shard: Shard) -> ShardSource:
        """Return a finished shard as a source of frames; its tar is on this machine while it is read."""
        return _StoredShard(self, shard)


class _StoredShard(ShardArchive):
    """Finished shard in storage; its tar is copied when the first frame is asked for, and deleted when it is closed."""

    def __init__(self, run: StoredRun, shard: Shard) -> None:
        super().__init__(run.shard_files(shard))
        self.place = Path(run.store.place(self._files.tar.name))
        self._run = run
        self._shard = shard

    def damage(self, frames: Sequence[str]) -> str | None:
        """Return what is wrong with the sizes in storage; the digest is checked when the tar is copied."""
        return self._run.damage(self._shard, self.record())

    def read(self, frame_id: str) -> tuple[str, bytes]:
        """Return record and picture of a frame that follows the last one that was asked for."""
        if not self._files.tar.is_file():
            self._run.store.download(self._files.tar.name, self._files.tar, self.record()[ARCHIVE]["tar"]["sha256"])
        return super().read(frame_id)

    def close(self) -> None:
        """Delete the copy of the tar."""
        super().close()
        self._files.tar.unlink(missing_ok=True)


@contextlib.contextmanager
def opened_run(out: str | Path) -> Iterator[ShardedRun]:
    """Yield the run in shards in a folder, or at an address.

    Raises:
        StorageError, MissingDependencyError: The storage cannot be used.
    """
    if (address := address_of(out)) is None:
        yield ShardedRun(Path(out))
        return
    with tempfile.TemporaryDirectory(prefix="infrablend-") as folder:
        run = StoredRun(Path(folder), Store(address))
        run.refresh()
        yield run


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
) -> RunReport:
    """Make packed shards one after the other, and copy each to object storage; `resume` leaves whole ones there.

    `out` is the address of the run.

    Raises:
        ArgumentError: The layout has a file per frame.
        StorageError: The storage cannot be used.
        OutputError, OtherSettingsError, Interrupted, RenderError: See `run_shard`.
    """
    address = address_of(out)
    assert address is not None
    require_packed(plan.recipe, out)
    store = Store(address)
    # What a killed job left is found by the next job of the same run on this machine.
    key = hashlib.sha256(f"{address} {sha256_of_json(plan.key)}".encode()).hexdigest()[:16]
    local = ShardedRun(Path(tempfile.gettempdir()) / f"infrablend-{os.getuid()}-{key}")
    _share_plan(local, plan, shards[0].count, execution, store)
    make = partial(_run_stored_shard, local=local, store=store)
    report = run_shards(plan, shards, out, execution, existing, on_progress, make)
    shutil.rmtree(local.root, ignore_errors=True)
    return replace(report, out=Path(address))


def _share_plan(local: ShardedRun, plan: RunPlan, count: int, execution: Execution, store: Store) -> None:
    """Use the shared plan of the storage, or write the one that is made here."""
    local.root.mkdir(mode=0o700, parents=True, exist_ok=True)
    local.file.unlink(missing_ok=True)
    known = store.read(SHARDS_FILE)
    if known is not None:
        local.file.write_bytes(known)
    try:
        local.share_plan(plan, count, execution.renderer)
    except OutputError as error:
        raise type(error)(error.message.replace(str(local.root), store.address), error.problems) from error
    if known is None:
        store.upload(local.file, SHARDS_FILE)


def _run_stored_shard(
    plan: RunPlan,
    shard: Shard,
    out: Path,
    execution: Execution,
    existing: Existing,
    on_progress: OnProgress | None,
    local: ShardedRun,
    store: Store,
) -> RunReport:
    """Make one shard here, and copy its files: the record is removed first and comes last."""
    files = local.shard_files(shard)
    marker = Path(store.place(files.marker.name))
    if existing != "overwrite" and (text := _read_marker(store, files.marker.name)) is not None:
        if existing == "refuse":
            raise OutputError(
                f"{store.place(files.marker.name)}: exists already; expected no such shard. Use --resume to make it "
                "only if it is not whole, or --overwrite to replace it."
            )
        files.marker.write_bytes(text)
        record = read_object(files.marker) or {}
        stored = StoredRun(local.root, store, store.files())
        whole = record.get("shard") == str(shard) and stored.damage(shard, record) is None
        if whole and record["counts"]["frames"] == len(shard.part_of(plan.frames)):
            require_same_key(record, plan, store.place(files.marker.name))
            return RunReport.of_record(record, out, marker)
    for path in (files.marker, files.tar, files.table):
        path.unlink(missing_ok=True)
    here: Existing = "overwrite" if existing == "overwrite" else "resume"
    report = run_shard(plan, shard, local.root, execution, here, on_progress)
    store.remove(files.marker.name)
    for path in (files.tar, files.table, files.marker):
        store.upload(path, path.name)
    for path in (files.tar, files.table, files.marker):
        path.unlink()
    return replace(report, out=out, record_file=marker)


def _read_marker(store: Store, name: str) -> bytes | None:
    """Return the record of a shard, or the plan; None if there is none, or it is damaged: the shard is made again."""
    try:
        return store.read(name)
    except StorageError as error:
        if "Checksum" not in error.message:
            raise
        log.warning("%s", error)
        return None
