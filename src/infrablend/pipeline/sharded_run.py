"""Folder of a run in shards: the plan that all shards share, a folder per shard, and the state of each.

    OUT/shards.json                  the plan: recipe, seed, digest of the data, and what is measured over all of it
    OUT/shard-00002-of-00007/        one shard, a run folder without label files: images/ scenes/ log/ run.json

A shard has a lock of its own, so several jobs may share OUT. Its `run.json` is its marker: it is complete last.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import logging
import os
import shlex
import socket
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from infrablend import __version__
from infrablend.core.files import DAMAGED, output_error, read_object, replace_atomically
from infrablend.core.finished import COMPLETE
from infrablend.core.output import Existing, OutputFolder
from infrablend.core.run_layout import RUN_FILE, SHARDS_FILE
from infrablend.core.tasks import OnProgress
from infrablend.core.typed_command import recorded_command
from infrablend.errors import OtherSettingsError, OutputError
from infrablend.pipeline.folder import RunFolder
from infrablend.pipeline.levels import dataset_levels
from infrablend.pipeline.plan import RunPlan
from infrablend.pipeline.request import Execution
from infrablend.pipeline.run import RunReport, run_plan
from infrablend.pipeline.run_key import differences
from infrablend.pipeline.shard import MAX_SHARDS, Shard

log = logging.getLogger(__name__)

State = Literal["done", "running", "failed", "stopped", "missing"]
"""State of a shard: `failed` is finished without some frames, `stopped` is unfinished and nobody works on it."""

_TEMPORARY = ".shards."


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
    """

    count: int
    frames: int
    key: Mapping[str, Any]
    formats: tuple[str, ...]
    renderer: str
    levels: tuple[float, float] | None

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
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> SharedPlan:
        """Return the plan from JSON values written by `to_json`.

        Raises:
            LookupError, TypeError, ValueError, ArithmeticError: The values are damaged.
        """
        levels, count, frames = data["levels"], int(data["shards"]), int(data["frames"])
        if not 1 <= count <= MAX_SHARDS or frames < 0:
            raise ValueError(f"{count} shards of {frames} frames, expected 1 to {MAX_SHARDS} of at least 0")
        return cls(
            count,
            frames,
            dict(data["key"]),
            tuple(data["formats"]),
            str(data["renderer"]),
            None if levels is None else (float(levels[0]), float(levels[1])),
        )

    def require_same(self, other: SharedPlan, where: Path) -> None:
        """Check that another plan gives the same shards.

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
    """

    shard: Shard
    state: State
    frames: int
    finished: int = 0
    failed: int = 0
    command: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "shard": str(self.shard),
            "state": self.state,
            "frames": self.frames,
            "finished": self.finished,
            "failed": self.failed,
            **({"command": self.command} if self.command else {}),
        }


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

    def shard_folder(self, shard: Shard) -> RunFolder:
        """Return the folder of a shard."""
        return RunFolder(self.root / shard.folder_name, "shard")

    def read_plan(self) -> SharedPlan:
        """Return the shared plan.

        Raises:
            OutputError: There is none, or it is damaged.
        """
        if not os.path.lexists(self.file):
            raise OutputError(
                f"{self.root}: no {SHARDS_FILE}; expected a folder with shards. Give the --out of "
                "`infrablend generate ... --shard I/N`."
            )
        try:
            return SharedPlan.from_json(read_object(self.file) or {})
        except DAMAGED as error:
            raise OutputError(
                f"{self.file}: damaged ({type(error).__name__}: {error}); expected the plan of a run in shards. "
                "Delete this file; the next shard writes it again."
            ) from error

    def share_plan(self, plan: RunPlan, count: int, renderer: str) -> SharedPlan:
        """Return the plan that all shards use; the first shard measures the data and writes it.

        Raises:
            OtherSettingsError: The folder has shards of another plan.
            OutputError: The folder has something else, or cannot be written.
        """
        formats = tuple(plan.recipe.output.formats)
        wanted = SharedPlan(count, len(plan.frames), plan.key, formats, renderer, None)
        with self._locked():
            if os.path.lexists(self.file):
                known = self.read_plan()
                known.require_same(wanted, self.root)
                return known
            folder = OutputFolder(self.root, "run in shards", SHARDS_FILE)
            found = [n for n in folder.entries() if not n.startswith(_TEMPORARY)]
            if any(not n.endswith(f"-of-{count:05d}") for n in found):
                raise folder.refuse_not_ours()
            folder.make_writable()
            shared = replace(wanted, levels=dataset_levels(plan) if plan.needs_levels else None)
            # A name of its own: where the file system has no locks, several jobs may write the same bytes at once.
            temporary = self.root / f"{_TEMPORARY}{socket.gethostname()}.{os.getpid()}.part.json"
            with replace_atomically(self.file, beside=temporary, durable=True) as part:
                part.write_text(json.dumps(shared.to_json(), sort_keys=True, indent=2) + "\n", encoding="utf-8")
            return shared

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        """Wait for other jobs that read or write the shared plan."""
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            handle = os.open(self.root, os.O_RDONLY | os.O_DIRECTORY)
        except OSError as error:
            raise output_error(self.root, error) from error
        try:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX)
            except OSError as error:  # file systems without locks
                log.warning("%s: cannot be locked (%s)", self.root, error)
            yield
        finally:
            os.close(handle)

    def states(self) -> list[ShardState]:
        """Return the state of every shard, in the order of their numbers.

        Raises:
            OutputError: The folder has no readable plan.
        """
        shared = self.read_plan()
        states = [self._state(Shard(n, shared.count), shared.frames) for n in range(1, shared.count + 1)]
        return [s if s.state in ("done", "running") else replace(s, command=self.command(s.shard)) for s in states]

    def command(self, shard: Shard) -> str:
        """Return the command that makes or finishes a shard: its own, or that of another shard of the folder."""
        for record in (read_object(self.shard_folder(shard).run_file), self._any_record):
            if (command := recorded_command(record, self.root, str(shard))) is not None:
                return command
        return f"infrablend generate ... --out {shlex.quote(str(self.root))} --shard {shard} --resume"

    @cached_property
    def _any_record(self) -> dict[str, Any] | None:
        """Record of a shard, to learn the command of the others."""
        files = (folder / RUN_FILE for folder in sorted(self.root.glob("shard-*-of-*")))
        return next((record for f in files if (record := read_object(f)) is not None), None)

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

    def _state(self, shard: Shard, frames: int) -> ShardState:
        folder, planned = self.shard_folder(shard), len(shard.part_of(range(frames)))
        if not folder.root.is_dir():
            return ShardState(shard, "missing", planned)
        record = read_object(folder.run_file) or {}
        claimed = folder.output.is_claimed()
        counts = record.get("counts")
        finished = counts.get("frames") if isinstance(counts, Mapping) else None
        if record.get("status") == COMPLETE and isinstance(finished, int) and not claimed:
            state: State = "done" if finished == planned else "failed"
            return ShardState(shard, state, planned, finished, planned - finished)
        return ShardState(shard, "running" if claimed else "stopped", planned, len(folder.records()))


def run_shard(
    plan: RunPlan,
    shard: Shard,
    out: Path,
    execution: Execution,
    existing: Existing = "refuse",
    on_progress: OnProgress | None = None,
) -> RunReport:
    """Render the frames of one shard into its folder below `out`; label files are written when shards are merged.

    Args:
        plan: Plan of the whole run.
        shard: Shard to produce.
        out: Folder of the run in shards.
        execution: Workers, device and renderer.
        existing: What to do if the shard has been started.
        on_progress: Called after each frame.

    Raises:
        OtherSettingsError: `out` has shards of another run.
        OutputError, Interrupted, RenderError: See `run_plan`.
    """
    sharded = ShardedRun(out)
    shared = sharded.share_plan(plan, shard.count, execution.renderer)
    # Problems of the data are those of the whole run: merging reports them once.
    part = replace(plan, frames=tuple(shard.part_of(plan.frames)), shard=shard, levels=shared.levels, problems=())
    return run_plan(part, sharded.shard_folder(shard).root, execution, existing, on_progress)
