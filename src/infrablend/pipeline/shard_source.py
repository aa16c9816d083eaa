"""Finished shards as sources of frames, in either layout."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from infrablend.core.checked_files import CheckedFiles
from infrablend.core.files import link_or_copy, write_bytes
from infrablend.core.run_layout import ShardFiles
from infrablend.core.tasks import Failure
from infrablend.errors import OutputError
from infrablend.formats.shard_tar import PackedFrame, key_of, packed_frames
from infrablend.pipeline.folder import RUN, RunFolder
from infrablend.pipeline.plan import PlannedFrame
from infrablend.pipeline.record import FrameRecord, RecordError, load_record, parse_record
from infrablend.pipeline.shard import Shard
from infrablend.pipeline.shard_damage import damage_of


class ShardSource(Protocol):
    """A finished shard."""

    @property
    def record_file(self) -> Path:
        """Record of the shard."""
        ...

    @property
    def place(self) -> Path:
        """Folder or tar with its frames, in the folder of the run in shards."""
        ...

    def damage(self, frames: Sequence[str], record: Mapping[str, Any], checked: CheckedFiles) -> str | None:
        """Return what is wrong with these frames, of the shard with this record; None if all are whole."""
        ...

    def put(self, frame_id: str, folder: RunFolder, checked: CheckedFiles) -> FrameRecord:
        """Put record and picture of a frame into the folder of a run; frames are asked for in the order of the plan.

        Raises:
            OutputError: The frame is not there, or cannot be written.
        """
        ...

    def packed(self) -> AbstractContextManager[ShardFiles] | None:
        """Return the files of a packed shard, while the context is open; None if it has a file per frame."""
        ...

    def close(self) -> None:
        """Close what is open; the shard can be read again from its start."""
        ...


@dataclass(frozen=True)
class FinishedShard:
    """A finished shard with its record.

    Attributes:
        shard: The shard.
        source: Where its frames are.
        record: Its run record.
        failures: Reasons of its unfinished frames, by id.
    """

    shard: Shard
    source: ShardSource
    record: Mapping[str, Any]
    failures: Mapping[str, Failure]

    def finished(self, frames: Sequence[PlannedFrame]) -> tuple[str, ...]:
        """Return the ids of its frames that have a picture, in their order; `frames` are those of the whole run."""
        return tuple(f.frame_id for f in self.shard.part_of(frames) if f.frame_id not in self.failures)


class ShardFolder:
    """Shard with a file per picture and record."""

    def __init__(self, folder: RunFolder) -> None:
        """Name the folder of the shard."""
        self._folder = folder

    @property
    def record_file(self) -> Path:
        """Record of the shard."""
        return self._folder.run_file

    @property
    def place(self) -> Path:
        """Folder of the shard."""
        return self._folder.root

    def damage(self, frames: Sequence[str], record: Mapping[str, Any], checked: CheckedFiles) -> str | None:
        """Return how many frames are missing or changed."""
        broken = [f for f in frames if not self._is_intact(f, record.get(RUN), checked)]
        return f"{len(broken)} frames are missing or damaged, such as {broken[0]}" if broken else None

    def _is_intact(self, frame_id: str, run: str | None, checked: CheckedFiles) -> bool:
        try:
            record = load_record(self._folder.record(frame_id))
            image = self._folder.image(record.image)
        except (RecordError, ValueError):
            return False
        if not record.is_of(run) or record.frame_id != frame_id:
            return False
        return checked.has_digest(image, self._folder.root, record.image_sha256)

    def put(self, frame_id: str, folder: RunFolder, checked: CheckedFiles) -> FrameRecord:
        """Link the files of a frame, or copy them."""
        record = load_record(self._folder.record(frame_id))
        # The record comes first, as in `frame.FrameMaker`.
        link_or_copy(self._folder.record(frame_id), folder.record(frame_id))
        link_or_copy(self._folder.image(record.image), folder.image(record.image))
        return record

    def packed(self) -> None:
        """Return None."""
        return

    def close(self) -> None:
        """Do nothing: no file stays open."""


class ShardArchive:
    """Shard in a tar, which is read once from start to end."""

    def __init__(self, files: ShardFiles) -> None:
        """Name the files of the shard."""
        self._files = files
        self._frames: Iterator[PackedFrame] | None = None

    @property
    def record_file(self) -> Path:
        """Record of the shard."""
        return self._files.marker

    @property
    def place(self) -> Path:
        """Tar of the shard."""
        return self._files.tar

    def damage(self, frames: Sequence[str], record: Mapping[str, Any], checked: CheckedFiles) -> str | None:
        """Return what is wrong with the tar or the table."""
        return damage_of(self._files, record)

    def put(self, frame_id: str, folder: RunFolder, checked: CheckedFiles) -> FrameRecord:
        """Unpack a frame that follows the last one that was asked for."""
        if self._frames is None:
            self._frames = packed_frames(self._files.tar)
        key = key_of(frame_id)
        frame = next((f for f in self._frames if f.key == key), None)
        if frame is None:
            raise self._changed(f"frame {frame_id} is missing")
        try:
            record = parse_record(frame.scene)
        except RecordError as error:
            raise self._changed(f"frame {frame_id}: {error}") from error
        if record.frame_id != frame_id or hashlib.sha256(frame.image).hexdigest() != record.image_sha256:
            raise self._changed(f"frame {frame_id} has another record or picture")
        write_bytes(folder.record(frame_id), frame.scene)
        checked.add(write_bytes(folder.image(record.image), frame.image), record.image_sha256)
        return record

    def _changed(self, found: str) -> OutputError:
        return OutputError(f"{self._files.tar}: {found}; expected the tar as it was written. Repeat with --resume")

    def packed(self) -> AbstractContextManager[ShardFiles]:
        """Return its files."""
        return nullcontext(self._files)

    def close(self) -> None:
        """Close the tar."""
        self._frames = None
