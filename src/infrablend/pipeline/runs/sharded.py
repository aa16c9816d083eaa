"""Folder of a run in shards: the plan that all shards share, and the state of each, here or in object storage.

    OUT/shards.json                  the plan: recipe, seed, digest of the data, and what is measured over all of it
    OUT/shard-00002-of-00007/        one shard, a run folder without label files: images/ run.sqlite run.json

or, with `output.layout: shards`,

    OUT/shard-00002-of-00007.tar     pictures, labels and records of the frames
    OUT/shard-00002-of-00007.parquet a row per frame
    OUT/shard-00002-of-00007.json    the record of the shard

A shard is `missing` until a job opens its workspace, then `running` while that job holds the lock, and `stopped` if the
job ended too early. Its record appears last and makes it `done`, or `failed` if some frames have no picture. Each shard
has a workspace of its own, so several jobs may share OUT.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import shlex
import socket
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from fnmatch import fnmatch
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

from infrablend import __version__
from infrablend.core.addresses import address_of
from infrablend.core.files import DAMAGED, read_object, replace_atomically, write_bytes
from infrablend.core.ledger import LEDGER, Ledger
from infrablend.core.operating_system import flush_file
from infrablend.core.run_folder import RUN_FILE, SHARDS_FILE, RunFolder, ShardFiles
from infrablend.core.typed_command import recorded_command
from infrablend.core.workspace import NOTE, is_being_written, partial_of
from infrablend.errors import OtherSettingsError, OutputError, StorageError
from infrablend.pipeline.plans.backgrounds import dataset_levels, recorded_levels
from infrablend.pipeline.plans.plan import RunPlan
from infrablend.pipeline.plans.shard import MAX_SHARDS, Shard
from infrablend.pipeline.runs.begun_run import differences
from infrablend.pipeline.runs.packed_shard import damage_of
from infrablend.pipeline.storage.store import Store

log = logging.getLogger(__name__)

Layout = Literal["files", "shards"]
State = Literal["done", "running", "failed", "stopped", "missing"]
"""State of a shard: `failed` is finished without some frames, `stopped` is unfinished and nobody works on it."""


@dataclass(frozen=True)
class SharedPlan:
    """What all shards of a run share.

    Attributes:
        shards: Number of shards.
        frames: Number of frames of the run.
        key: Key of the run, see `RunPlan.key`.
        formats: Label formats of the merged dataset.
        renderer: Renderer of all shards.
        levels: Range of grey levels of the dataset; None if the recipe does not need it.
        layout: Layout of finished shards.
    """

    shards: int
    frames: int
    key: Mapping[str, object]
    formats: tuple[str, ...]
    renderer: str
    levels: tuple[float, float] | None
    layout: Layout = "files"

    def to_text(self) -> str:
        """Return the content of `shards.json`."""
        return json.dumps({"infrablend": __version__, **asdict(self)}, sort_keys=True, indent=2) + "\n"

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> SharedPlan:
        """Return the plan from the values of `shards.json`.

        Raises:
            LookupError, TypeError, ValueError, ArithmeticError: The values are damaged.
        """
        count = int(data["shards"])
        frames = int(data["frames"])
        if not 1 <= count <= MAX_SHARDS or frames < 0:
            raise ValueError(f"{count} shards of {frames} frames, expected 1 to {MAX_SHARDS} of at least 0")
        layout: Layout = data.get("layout", "files")
        if layout not in get_args(Layout):
            raise ValueError(f"layout {layout!r}, expected one of {', '.join(get_args(Layout))}")
        levels = recorded_levels(data["levels"])
        return cls(count, frames, dict(data["key"]), tuple(data["formats"]), str(data["renderer"]), levels, layout)

    def require_same(self, other: SharedPlan, where: str) -> None:
        """Check that another plan gives the same shards, in whatever layout.

        Raises:
            OtherSettingsError: It does not; the message lists the differences.
        """
        found = differences(self.key, other.key)
        for name in ("shards", "frames", "formats", "renderer"):
            was, now = getattr(self, name), getattr(other, name)
            if was != now:
                found.append(f"{name} was {was!r}, is {now!r}")
        if found:
            raise OtherSettingsError(
                f"{where}: its shards belong to a different run: {'; '.join(found)}. Shards of one run need the same "
                "recipe, data, seed, choice of frames, formats, renderer and number of shards; use another folder."
            )


@dataclass(frozen=True)
class ShardState:
    """State of one shard.

    Attributes:
        shard: The shard.
        state: Its state.
        frames: Number of its frames.
        finished: Number of frames that are finished.
        failed: Number of frames that failed, or whose background was skipped.
        command: Command that makes or finishes it; empty if it is done or running.
        damage: What is wrong with the files of a packed shard that was finished; empty if nothing is.
    """

    shard: Shard
    state: State
    frames: int
    finished: int = 0
    failed: int = 0
    command: str = ""
    damage: str = ""

    @property
    def is_finished(self) -> bool:
        """Whether the shard is there, with all frames or without some."""
        return self.state in ("done", "failed")

    def describe(self) -> str:
        """Return the state in words."""
        if self.state == "missing":
            return self.state
        return f"{self.state}: {self.damage or f'{self.finished} of {self.frames} frames'}"

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values, without an empty command and an empty damage."""
        found = asdict(self) | {"shard": str(self.shard)}
        return {name: value for name, value in found.items() if value != ""}


@dataclass(frozen=True)
class ShardedRun:
    """Folder of a run in shards.

    In object storage only packed shards are kept. They are made in a folder of this machine and then copied: the
    record last, without which no reader takes them for a shard.

    Attributes:
        root: The folder; for a run in object storage, a folder of this machine that has copies of its small files.
        store: The storage; None for a folder of this machine.
        sizes: Bytes of the files in the storage, by name.
    """

    root: Path
    store: Store | None = None
    sizes: dict[str, int] = field(default_factory=dict)

    @property
    def file(self) -> Path:
        """File of the shared plan."""
        return self.root / SHARDS_FILE

    @property
    def place(self) -> str:
        """Where the run is, for messages and commands."""
        return str(self.root) if self.store is None else self.store.address

    def place_of(self, path: Path) -> str:
        """Return where readers find a file of the run, for messages."""
        return str(path) if self.store is None else self.store.place(path.name)

    def folder_of(self, shard: Shard) -> RunFolder:
        """Return the folder of a shard: where it is, or while it is made, depending on the layout."""
        return RunFolder(self.root / shard.folder_name)

    def files_of(self, shard: Shard) -> ShardFiles:
        """Return the files of a packed shard."""
        return ShardFiles(self.root, shard.folder_name)

    def refresh(self, pattern: str = "*.json") -> None:
        """Look again at what the storage has, and copy its small files of such names that are new."""
        if self.store is None:
            return
        self.sizes.clear()
        self.sizes.update(self.store.files())
        for path in sorted(self.root.glob(pattern)):
            if path.name not in self.sizes:
                path.unlink()
        for name, size in self.sizes.items():
            copy = self.root / name
            if not fnmatch(name, pattern) or (copy.is_file() and copy.stat().st_size == size):
                continue
            try:
                text = self.store.read(name)
            except StorageError as error:
                if "Checksum" not in error.message:
                    raise
                log.warning("%s", error)  # a damaged record is none: its shard is made again
                continue
            if text is not None:
                write_bytes(copy, text)

    def read_plan(self) -> SharedPlan:
        """Return the shared plan.

        Raises:
            OutputError: There is none, or it is damaged.
        """
        if not os.path.lexists(self.file):
            raise OutputError(
                f"{self.place}: no {SHARDS_FILE}; expected a run in shards. Give the --out of "
                "`infrablend generate ... --shard I/N`. To join datasets, see docs/how_to/evaluate.md#join-datasets."
            )
        try:
            return SharedPlan.from_json(read_object(self.file) or {})
        except DAMAGED as error:
            raise OutputError(
                f"{self.place}/{SHARDS_FILE}: damaged ({type(error).__name__}: {error}); expected the plan of a run in "
                "shards. Delete this file; the next shard writes it again."
            ) from error

    def share_plan(self, plan: RunPlan, count: int, renderer: str) -> SharedPlan:
        """Return the plan that all shards use; the first shard measures the data and writes it.

        Shards that start together may all do so: they write the same bytes.

        Raises:
            OtherSettingsError: The folder has shards of another plan.
            OutputError: The folder has something else, or cannot be written.
        """
        output = plan.recipe.output
        formats = tuple(output.formats)
        wanted = SharedPlan(count, len(plan.frames), dict(plan.key), formats, renderer, None, output.layout)
        if os.path.lexists(self.file):
            known = self.read_plan()
            known.require_same(wanted, self.place)
            if known.layout != wanted.layout:
                raise OtherSettingsError(
                    f"{self.place}: its shards have output.layout: {known.layout}, not {wanted.layout}. Use another "
                    "folder; `infrablend merge` takes folders of both layouts."
                )
            return known
        found = sorted(p.name for p in self.root.iterdir()) if self.root.is_dir() else []
        foreign = [n for n in found if f"-of-{count:05d}" not in n and not n.startswith(".")]
        if foreign:
            raise OutputError(
                f"{self.root}: not empty and not a run in shards of InfraBlend (no {SHARDS_FILE}; found {foreign[0]}); "
                "nothing was touched. Give another folder."
            )
        if plan.needs_levels:
            wanted = replace(wanted, levels=plan.levels or dataset_levels(plan))
        temporary = self.root / f".shards.{socket.gethostname()}.{os.getpid()}.part.json"
        with replace_atomically(self.file, beside=temporary, durable=True) as part:
            part.write_text(wanted.to_text(), encoding="utf-8")
        if self.store is not None:
            self.store.upload(self.file, SHARDS_FILE)
        return wanted

    def states(self) -> list[ShardState]:
        """Return the state of every shard, in the order of their numbers.

        Raises:
            OutputError: The folder has no readable plan.
        """
        shared = self.read_plan()
        states = [self._state(Shard(n, shared.shards), shared) for n in range(1, shared.shards + 1)]
        return [s if s.state in ("done", "running") else replace(s, command=self.command(s.shard)) for s in states]

    def wait(self, interval_s: float = 30) -> list[ShardState]:
        """Return the states once every shard is done or failed; the plan may be missing until the first one starts.

        Raises:
            OutputError: The plan is damaged.
        """
        while True:
            self.refresh()
            if os.path.lexists(self.file):
                states = self.states()
                if all(s.is_finished for s in states):
                    return states
            time.sleep(interval_s)

    def damage(self, shard: Shard, record: Mapping[str, object], *, digests: bool = False) -> str | None:
        """Return what is wrong with the files of a packed shard; only the sizes of those in storage are compared."""
        if self.store is None:
            return damage_of(self.files_of(shard), record, digests=digests)
        return damage_of(self.files_of(shard), record, digests=False, sizes=self.sizes)

    def command(self, shard: Shard) -> str:
        """Return the command that makes or finishes a shard: its own, or that of another shard of the folder."""
        for record in (*map(read_object, self._record_files(shard.folder_name)), self._any_record):
            if (command := recorded_command(record, Path(self.place), str(shard))) is not None:
                return command
        return f"infrablend generate ... --out {shlex.quote(self.place)} --shard {shard} --resume"

    @cached_property
    def _any_record(self) -> Mapping[str, object] | None:
        """Record of a shard, to learn the command of the others."""
        names = sorted({p.name.lstrip(".").partition(".")[0] for p in self.root.glob("*shard-*-of-*")})
        files = (file for name in names for file in self._record_files(name))
        return next((record for f in files if "command" in (record := read_object(f) or {})), None)

    def _record_files(self, name: str) -> tuple[Path, ...]:
        """Return where the command of a shard of this name may be recorded, finished or not, in either layout."""
        folder = self.root / name
        return ShardFiles(self.root, name).marker, folder / RUN_FILE, partial_of(folder) / NOTE

    def _state(self, shard: Shard, shared: SharedPlan) -> ShardState:
        folder = self.folder_of(shard)
        packed = shared.layout == "shards"
        planned = len(shard.part_of(range(shared.frames)))
        record = read_object(self.files_of(shard).marker if packed else folder.run_file)
        claimed = is_being_written(folder.root)
        partial = partial_of(folder.root)
        if record is None and not partial.is_dir():
            return ShardState(shard, "missing", planned)
        damage = None
        if record is not None:
            damage = self.damage(shard, record) if packed else None
            finished = _finished(record)
            if finished is not None and not claimed and damage is None:
                state: State = "done" if finished == planned else "failed"
                return ShardState(shard, state, planned, finished, planned - finished)
        made = 0
        if (partial / LEDGER).is_file():
            with Ledger.open(partial) as ledger:
                made = len(ledger.done())
        return ShardState(shard, "running" if claimed else "stopped", planned, made, damage=damage or "")

    def publish(self, packed: ShardFiles) -> None:
        """Move or copy a packed shard to its readers: the record last, and that of an earlier one goes first."""
        if self.store is not None:
            self.store.remove(packed.marker.name)
            for path in (packed.tar, packed.table, packed.marker):
                self.store.upload(path, path.name)
            return
        target = ShardFiles(self.root, packed.name)
        target.marker.unlink(missing_ok=True)
        packed.tar.replace(target.tar)
        packed.table.replace(target.table)
        flush_file(self.root)
        packed.marker.replace(target.marker)
        flush_file(self.root)


def _finished(record: Mapping[str, object]) -> int | None:
    """Return the number of finished frames in the record of a shard; None if it is damaged."""
    counts = record.get("counts")
    found = counts.get("frames") if isinstance(counts, Mapping) else None
    return found if isinstance(found, int) else None


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
        run = ShardedRun(Path(folder), Store(address))
        run.refresh()
        yield run
