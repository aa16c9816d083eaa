"""Finished shards as sources of frames, in either layout and place."""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from infrablend.core.files import link_or_copy, read_object, sha256_of, write_bytes
from infrablend.core.frame_row import FrameRecord
from infrablend.core.ledger import DoneFrame
from infrablend.core.run_folder import SHARDS_FILE, RunFolder
from infrablend.core.tasks import Failure
from infrablend.errors import OtherSettingsError, OutputError
from infrablend.formats.labels.shard_tar import PackedFrame, key_of, packed_frames
from infrablend.pipeline.compose.composed import MadeFrame
from infrablend.pipeline.plans.plan import PlannedFrame
from infrablend.pipeline.plans.shard import Shard
from infrablend.pipeline.runs.begun_run import differences
from infrablend.pipeline.runs.packed_shard import ARCHIVE, UNFINISHED
from infrablend.pipeline.runs.sharded import ShardedRun, SharedPlan


@dataclass(frozen=True, eq=False)
class FinishedShard(ABC):
    """A finished shard.

    Attributes:
        run: The run in shards that it is part of.
        shard: Which part.
        place: Where its frames are, for messages.
        record: Its record.
        failures: Why frames of the shard have no picture, by id.
    """

    run: ShardedRun
    shard: Shard
    place: str
    record: Mapping[str, Any]
    failures: Mapping[str, Failure]

    def finished(self, frames: Sequence[PlannedFrame]) -> list[str]:
        """Return the ids of its frames that have a picture, in their order; `frames` are those of the whole run."""
        return [f.frame_id for f in self.shard.part_of(frames) if f.frame_id not in self.failures]

    @abstractmethod
    def damage(self, frames: Sequence[str]) -> str | None:
        """Return what is wrong with the files of these frames; None if nothing is."""

    @abstractmethod
    def put(self, frames: Iterable[str], folder: RunFolder) -> Generator[MadeFrame]:
        """Put the pictures of frames, in their order, into the folder of a run."""


class ShardFolder(FinishedShard):
    """Shard with a ledger and a file per picture."""

    def damage(self, frames: Sequence[str]) -> str | None:
        """Return how many frames are missing or changed."""
        folder = self.run.folder_of(self.shard)
        with folder.ledger() as ledger:
            done = ledger.done()
        broken = [f for f in frames if f not in done or not _is_intact(folder, done[f])]
        return f"{len(broken)} frames are missing or damaged, such as {broken[0]}" if broken else None

    def put(self, frames: Iterable[str], folder: RunFolder) -> Generator[MadeFrame]:
        """Link the pictures of frames, or copy them."""
        source = self.run.folder_of(self.shard)
        with source.ledger() as ledger:
            done = ledger.done()
            for frame_id in frames:
                frame = done[frame_id]
                text = ledger.record_text(frame_id)
                link_or_copy(source.image(frame.image), folder.image(frame.image))
                yield MadeFrame(frame, text, str(json.loads(text)["background"].get("sha256")), {})


class ShardArchive(FinishedShard):
    """Shard in a tar, which is read once from start to end."""

    def damage(self, frames: Sequence[str]) -> str | None:
        """Return what is wrong with tar or table; the digest of a tar in storage is checked when it is copied."""
        return self.run.damage(self.shard, self.record, digests=True)

    def put(self, frames: Iterable[str], folder: RunFolder) -> Generator[MadeFrame]:
        """Unpack the pictures of frames; a tar in storage is on this machine meanwhile.

        Raises:
            OutputError: A frame is missing or damaged.
            StorageError: The tar cannot be copied, or was changed.
        """
        tar = self.run.files_of(self.shard).tar
        if self.run.store is not None:
            self.run.store.download(tar.name, tar, self.record[ARCHIVE]["tar"]["sha256"])
        try:
            packed = packed_frames(tar)
            for frame_id in frames:
                key = key_of(frame_id)
                frame = next((f for f in packed if f.key == key), None)
                if frame is None:
                    raise self._changed(f"frame {frame_id} is missing")
                record = self._verified(frame_id, frame)
                write_bytes(folder.image(record.image), frame.image)
                yield MadeFrame.of(record, len(frame.image), {})
        finally:
            if self.run.store is not None:
                tar.unlink(missing_ok=True)

    def _verified(self, frame_id: str, frame: PackedFrame) -> FrameRecord:
        """Return the record of a frame, which has to be of this frame and picture."""
        try:
            record = FrameRecord.from_text(frame.scene)
        except (LookupError, TypeError, ValueError, AttributeError) as error:
            raise self._changed(f"frame {frame_id}: {error}") from error
        if record.frame_id != frame_id or hashlib.sha256(frame.image).hexdigest() != record.image_sha256:
            raise self._changed(f"frame {frame_id} has another record or picture")
        return record

    def _changed(self, found: str) -> OutputError:
        return OutputError(f"{self.place}: {found}; expected the tar as it was written. Repeat with --resume")


def finished_shard(run: ShardedRun, shard: Shard, shared: SharedPlan) -> FinishedShard:
    """Return a finished shard of a run, if its record is that of this shard of this run.

    Raises:
        OutputError: It is the record of another shard, or damaged.
        OtherSettingsError: It is the record of another run.
    """
    found = _archive(run, shard) if run.read_plan().layout == "shards" else _folder(run, shard)
    record = found.record
    if record.get("shard") != str(shard):
        raise OutputError(f"{found.place}: found shard {record.get('shard')} of a run, expected shard {shard}")
    if changed := differences(shared.key, record.get("key", {})):
        raise OtherSettingsError(
            f"{found.place}: belongs to a different run than {SHARDS_FILE} beside it: {'; '.join(changed)}. "
            f"Repeat its command with --overwrite."
        )
    if record.get("levels") != (shared.levels and list(shared.levels)):
        raise OtherSettingsError(
            f"{found.place}: made with grey levels {record.get('levels')}; expected {shared.levels}, as in "
            f"{SHARDS_FILE}. Restore the file as it was, or repeat the command of the shard with --overwrite"
        )
    return found


def _folder(run: ShardedRun, shard: Shard) -> ShardFolder:
    folder = run.folder_of(shard)
    with folder.ledger() as ledger:
        return ShardFolder(run, shard, str(folder.root), ledger.read_run(), ledger.failures())


def _archive(run: ShardedRun, shard: Shard) -> ShardArchive:
    files = run.files_of(shard)
    marker = run.place_of(files.marker)
    record = read_object(files.marker)
    if record is None:
        raise OutputError(f"{marker}: damaged; expected the record of a shard. Repeat with --resume")
    try:
        failures = {frame: Failure.from_json(f) for frame, f in record[UNFINISHED].items()}
    except (LookupError, TypeError, AttributeError) as error:
        raise OutputError(f"{marker}: damaged ({error}); repeat the shard with --resume") from error
    return ShardArchive(run, shard, run.place_of(files.tar), record, failures)


def _is_intact(folder: RunFolder, frame: DoneFrame) -> bool:
    try:
        return sha256_of(folder.image(frame.image), folder.root) == frame.sha256
    except (OSError, ValueError):
        return False
