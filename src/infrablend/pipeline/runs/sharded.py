"""Folder of a run in shards: the plan that all shards share, a folder per shard, and the state of each.

    OUT/shards.json                  the plan: recipe, seed, digest of the data, and what is measured over all of it
    OUT/shard-00002-of-00007/        one shard, a run folder without label files: images/ run.sqlite run.json

or, with `output.layout: shards`,

    OUT/shard-00002-of-00007.tar     pictures, labels and records of the frames
    OUT/shard-00002-of-00007.parquet a row per frame
    OUT/shard-00002-of-00007.json    the record of the shard

A shard has a workspace of its own, so several jobs may share OUT.
"""

from __future__ import annotations

import json
import os
import shlex
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, reduce
from pathlib import Path
from typing import Any, Literal, get_args

from infrablend import __version__
from infrablend.core.files import DAMAGED, read_object, replace_atomically
from infrablend.core.ledger import LEDGER, Ledger
from infrablend.core.run_folder import RUN_FILE, SHARDS_FILE, RunFolder, ShardFiles
from infrablend.core.tasks import OnProgress, Progress
from infrablend.core.typed_command import recorded_command
from infrablend.core.workspace import NOTE, Existing, is_being_written, partial_of
from infrablend.errors import OtherSettingsError, OutputError
from infrablend.pipeline.plans.levels import dataset_levels, recorded_levels
from infrablend.pipeline.plans.plan import RunPlan
from infrablend.pipeline.plans.run_request import Execution
from infrablend.pipeline.plans.shard import MAX_SHARDS, Shard
from infrablend.pipeline.runs.inserted import nothing_inserted
from infrablend.pipeline.runs.key import differences
from infrablend.pipeline.runs.packed_shard import damage_of, run_packed
from infrablend.pipeline.runs.run import RunReport, run_plan
from infrablend.pipeline.runs.shard_source import ShardArchive, ShardFolder, ShardSource

Layout = Literal["files", "shards"]
State = Literal["done", "running", "failed", "stopped", "missing"]
"""State of a shard: `failed` is finished without some frames, `stopped` is unfinished and nobody works on it."""


@dataclass(frozen=True)
class SharedPlan:
    """What all shards of a run share.

    Attributes:
        count: Number of shards.
        frames: Number of frames of the run.
        key: Key of the run, see `RunPlan.key`.
        formats: Label formats of the merged dataset.
        renderer: Renderer of all shards.
        levels: Range of grey levels of the dataset; None if the recipe does not need it.
        layout: Layout of finished shards.
    """

    count: int
    frames: int
    key: Mapping[str, Any]
    formats: tuple[str, ...]
    renderer: str
    levels: tuple[float, float] | None
    layout: Layout = "files"

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "infrablend": __version__,
            "shards": self.count,
            "frames": self.frames,
            "key": dict(self.key),
            "formats": list(self.formats),
            "renderer": self.renderer,
            "levels": None if self.levels is None else list(self.levels),
            "layout": self.layout,
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> SharedPlan:
        """Return the plan from JSON values written by `to_json`.

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
        return cls(
            count,
            frames,
            dict(data["key"]),
            tuple(data["formats"]),
            str(data["renderer"]),
            recorded_levels(data["levels"]),
            layout,
        )

    def require_same(self, other: SharedPlan, where: Path | str) -> None:
        """Check that another plan gives the same shards, in whatever layout.

        Raises:
            OtherSettingsError: It does not; the message lists the differences.
        """
        found = differences(self.key, other.key)
        for name in ("count", "frames", "formats", "renderer"):
            was, now = getattr(self, name), getattr(other, name)
            found += [f"{'shards' if name == 'count' else name} was {was!r}, is {now!r}"] if was != now else []
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

    def describe(self) -> str:
        """Return the state in words."""
        return f"{self.state}: {self.damage or f'{self.finished} of {self.frames} frames'}"

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values, without an empty command and an empty damage."""
        found = asdict(self) | {"shard": str(self.shard)}
        return {name: value for name, value in found.items() if value != ""}


@dataclass(frozen=True)
class ShardedRun:
    """Folder of a run in shards.

    Attributes:
        root: The folder.
    """

    root: Path

    @property
    def file(self) -> Path:
        """File of the shared plan."""
        return self.root / SHARDS_FILE

    @property
    def place(self) -> str:
        """Where the run is, for messages and commands."""
        return str(self.root)

    def shard_folder(self, shard: Shard) -> RunFolder:
        """Return the folder of a shard: where it is, or while it is made, depending on the layout."""
        return RunFolder(self.root / shard.folder_name)

    def shard_files(self, shard: Shard) -> ShardFiles:
        """Return the files of a shard with the layout `shards`."""
        return ShardFiles(self.root, shard.folder_name)

    def shard_source(self, shard: Shard) -> ShardSource:
        """Return a finished shard as a source of frames, in its layout."""
        if self.read_plan().layout == "shards":
            return ShardArchive(self.shard_files(shard))
        return ShardFolder(self.shard_folder(shard))

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
        formats = tuple(plan.recipe.output.formats)
        wanted = SharedPlan(count, len(plan.frames), plan.key, formats, renderer, None, plan.recipe.output.layout)
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
        shared = replace(wanted, levels=plan.levels or dataset_levels(plan) if plan.needs_levels else None)
        temporary = self.root / f".shards.{socket.gethostname()}.{os.getpid()}.part.json"
        with replace_atomically(self.file, beside=temporary, durable=True) as part:
            part.write_text(json.dumps(shared.to_json(), sort_keys=True, indent=2) + "\n", encoding="utf-8")
        return shared

    def states(self) -> list[ShardState]:
        """Return the state of every shard, in the order of their numbers.

        Raises:
            OutputError: The folder has no readable plan.
        """
        shared = self.read_plan()
        states = [self._state(Shard(n, shared.count), shared) for n in range(1, shared.count + 1)]
        return [s if s.state in ("done", "running") else replace(s, command=self.command(s.shard)) for s in states]

    def command(self, shard: Shard) -> str:
        """Return the command that makes or finishes a shard: its own, or that of another shard of the folder."""
        for record in (*map(read_object, self._record_files(shard.folder_name)), self._any_record):
            if (command := recorded_command(record, Path(self.place), str(shard))) is not None:
                return command
        return f"infrablend generate ... --out {shlex.quote(self.place)} --shard {shard} --resume"

    @cached_property
    def _any_record(self) -> dict[str, Any] | None:
        """Record of a shard, to learn the command of the others."""
        names = sorted({p.name.lstrip(".").partition(".")[0] for p in self.root.glob("*shard-*-of-*")})
        files = (file for name in names for file in self._record_files(name))
        return next((record for f in files if "command" in (record := read_object(f) or {})), None)

    def _record_files(self, name: str) -> tuple[Path, ...]:
        """Return where the command of a shard of this name may be recorded, finished or not, in either layout."""
        folder = self.root / name
        return ShardFiles(self.root, name).marker, folder / RUN_FILE, partial_of(folder) / NOTE

    def wait(self, interval_s: float = 30) -> list[ShardState]:
        """Return the states once every shard is done or failed; the plan may be missing until the first one starts.

        Raises:
            OutputError: The plan is damaged.
        """
        while True:
            if os.path.lexists(self.file):
                states = self.states()
                if all(s.state in ("done", "failed") for s in states):
                    return states
            time.sleep(interval_s)

    def damage(self, shard: Shard, record: Mapping[str, Any]) -> str | None:
        """Return what is wrong with the sizes of a packed shard's files; None if nothing is."""
        return damage_of(self.shard_files(shard), record, digests=False)

    def _state(self, shard: Shard, shared: SharedPlan) -> ShardState:
        folder = self.shard_folder(shard).root
        packed = shared.layout == "shards"
        planned = len(shard.part_of(range(shared.frames)))
        record = read_object(self.shard_files(shard).marker if packed else folder / RUN_FILE)
        claimed = is_being_written(folder)
        partial = partial_of(folder)
        if record is None and not partial.is_dir():
            return ShardState(shard, "missing", planned)
        counts = (record or {}).get("counts")
        finished = counts.get("frames") if isinstance(counts, Mapping) else None
        damage = self.damage(shard, record) if packed and record is not None else None
        if isinstance(finished, int) and not claimed and damage is None:
            state: State = "done" if finished == planned else "failed"
            return ShardState(shard, state, planned, finished, planned - finished)
        made = 0
        if (partial / LEDGER).is_file():
            with Ledger.open(partial) as ledger:
                made = len(ledger.done())
        return ShardState(shard, "running" if claimed else "stopped", planned, made, damage=damage or "")


def run_shard(
    plan: RunPlan,
    shard: Shard,
    out: Path,
    execution: Execution,
    existing: Existing = "refuse",
    on_progress: OnProgress | None = None,
) -> RunReport:
    """Render the frames of one shard into its folder or files in `out`; merging shards writes the label files.

    `plan` is that of the whole run.

    Raises:
        OtherSettingsError: `out` has shards of another run.
        OutputError, Interrupted, RenderError: See `run_plan`.
    """
    sharded = ShardedRun(out)
    shared = sharded.share_plan(plan, shard.count, execution.renderer)
    part = replace(plan, frames=tuple(shard.part_of(plan.frames)), shard=shard, levels=shared.levels)
    if shared.layout == "shards":
        return run_packed(part, sharded.shard_files(shard), execution, existing, on_progress)
    return run_plan(part, sharded.shard_folder(shard).root, execution, existing, on_progress)


def run_shards(
    plan: RunPlan,
    shards: Sequence[Shard],
    out: Path,
    execution: Execution,
    existing: Existing = "refuse",
    on_progress: OnProgress | None = None,
    make: Callable[..., RunReport] = run_shard,
) -> RunReport:
    """Produce shards one after the other; the report counts the frames of all.

    The arguments and errors are those of `run_shard`, or of another function `make` that makes one shard.
    """
    reports: list[RunReport] = []
    before = 0
    total = sum(len(s.part_of(plan.frames)) for s in shards)
    for shard in shards:
        if reports or len(shards) < shard.count:
            plan = replace(plan, problems=())  # those of the data are reported once: by merging, or with the first

        def report(progress: Progress, before: int = before) -> None:
            assert on_progress is not None
            done = before + progress.done
            rate = progress.frames_per_s
            on_progress(replace(progress, done=done, total=total, eta_s=(total - done) / rate if rate else None))

        reports.append(make(plan, shard, out, execution, existing, None if on_progress is None else report))
        before += len(shard.part_of(plan.frames))
    counts = reduce(added_counts, (r.counts for r in reports))
    whole = len(shards) == shards[0].count  # a part alone may have no object of a kind
    nothing = tuple(nothing_inserted(plan.recipe, counts)) if whole else ()
    problems = nothing + tuple(p for r in reports for p in r.problems)
    if len(reports) == 1:
        return replace(reports[0], problems=problems)
    return RunReport(out, counts, problems, sum(r.seconds for r in reports), out / SHARDS_FILE)


def added_counts(a: Mapping[str, Any], b: Mapping[str, Any]) -> dict[str, Any]:
    """Return the sums of two sets of counts, nested ones as well."""
    found = dict(a)
    for name, value in b.items():
        found[name] = added_counts(a.get(name, {}), value) if isinstance(value, Mapping) else a.get(name, 0) + value
    return found
