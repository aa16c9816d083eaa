"""Finished shards as sources of frames, in either layout."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from typing import Any

from infrablend.core.files import link_or_copy, read_object, read_regular, sha256_of, write_bytes
from infrablend.core.frame_record import FrameRecord
from infrablend.core.ledger import DoneFrame, Ledger
from infrablend.core.run_folder import RunFolder, ShardFiles
from infrablend.core.tasks import Failure
from infrablend.errors import OutputError
from infrablend.formats.labels.shard_tar import PackedFrame, key_of, packed_frames
from infrablend.pipeline.compose.composed import MadeFrame
from infrablend.pipeline.runs.packed_shard import UNFINISHED, damage_of


class ShardFolder:
    """Shard with a ledger and a file per picture.

    Attributes:
        place: Folder with its frames, for messages.
    """

    def __init__(self, folder: RunFolder) -> None:
        self._folder = folder
        self.place = folder.root
        self._stack = ExitStack()
        self._opened: tuple[Ledger, dict[str, DoneFrame]] | None = None

    def _open(self) -> tuple[Ledger, dict[str, DoneFrame]]:
        if self._opened is None:
            ledger = self._stack.enter_context(self._folder.ledger())
            self._opened = ledger, ledger.done()
        return self._opened

    def record(self) -> Mapping[str, Any]:
        """Return the record of the shard."""
        return self._folder.read_run()

    def failures(self) -> Mapping[str, Failure]:
        """Return why frames of the shard have no picture, by id."""
        with self._folder.ledger() as ledger:
            return ledger.failures()

    def damage(self, frames: Sequence[str]) -> str | None:
        """Return how many frames are missing or changed."""
        with self._folder.ledger() as ledger:
            done = ledger.done()
        broken = [f for f in frames if f not in done or not self._is_intact(done[f])]
        return f"{len(broken)} frames are missing or damaged, such as {broken[0]}" if broken else None

    def _is_intact(self, frame: DoneFrame) -> bool:
        try:
            return sha256_of(self._folder.image(frame.image), self._folder.root) == frame.sha256
        except (OSError, ValueError):
            return False

    def read(self, frame_id: str) -> tuple[str, bytes]:
        """Return record and picture of a frame; frames are asked for in the order of the plan."""
        ledger, done = self._open()
        return ledger.record_text(frame_id), read_regular(self._folder.image(done[frame_id].image), self._folder.root)

    def put(self, frame_id: str, folder: RunFolder) -> MadeFrame:
        """Link the picture of a frame, or copy it."""
        ledger, done = self._open()
        frame = done[frame_id]
        text = ledger.record_text(frame_id)
        link_or_copy(self._folder.image(frame.image), folder.image(frame.image))
        return MadeFrame(frame, text, str(json.loads(text)["background"].get("sha256")), {})

    def close(self) -> None:
        """Close the ledger."""
        self._stack.close()
        self._opened = None


class ShardArchive:
    """Shard in a tar, which is read once from start to end.

    Attributes:
        place: The tar, for messages.
    """

    def __init__(self, files: ShardFiles) -> None:
        self._files = files
        self.place = files.tar
        self._frames: Iterator[PackedFrame] | None = None

    def record(self) -> Mapping[str, Any]:
        """Return the record of the shard."""
        found = read_object(self._files.marker)
        if found is None:
            raise OutputError(f"{self._files.marker}: damaged; expected the record of a shard. Repeat with --resume")
        return found

    def failures(self) -> Mapping[str, Failure]:
        """Return why frames of the shard have no picture, by id."""
        try:
            return {frame: Failure.from_json(f) for frame, f in self.record()[UNFINISHED].items()}
        except (LookupError, TypeError, AttributeError) as error:
            raise OutputError(f"{self._files.marker}: damaged ({error}); repeat the shard with --resume") from error

    def damage(self, frames: Sequence[str]) -> str | None:
        """Return what is wrong with the tar or the table."""
        return damage_of(self._files, self.record())

    def read(self, frame_id: str) -> tuple[str, bytes]:
        """Return record and picture of a frame that follows the last one that was asked for.

        Raises:
            OutputError: The frame is not there, or damaged.
        """
        if self._frames is None:
            self._frames = packed_frames(self._files.tar)
        key = key_of(frame_id)
        frame = next((f for f in self._frames if f.key == key), None)
        if frame is None:
            raise self._changed(f"frame {frame_id} is missing")
        try:
            record = FrameRecord.from_text(frame.scene)
        except (LookupError, TypeError, ValueError, AttributeError) as error:
            raise self._changed(f"frame {frame_id}: {error}") from error
        if record.frame_id != frame_id or hashlib.sha256(frame.image).hexdigest() != record.image_sha256:
            raise self._changed(f"frame {frame_id} has another record or picture")
        return record.to_text(), frame.image

    def put(self, frame_id: str, folder: RunFolder) -> MadeFrame:
        """Unpack the picture of a frame that follows the last one that was asked for."""
        text, picture = self.read(frame_id)
        record = FrameRecord.from_text(text)
        write_bytes(folder.image(record.image), picture)
        return MadeFrame.of(record, len(picture), {})

    def close(self) -> None:
        """Close the tar; it can be read again from its start."""
        self._frames = None

    def _changed(self, found: str) -> OutputError:
        return OutputError(f"{self._files.tar}: {found}; expected the tar as it was written. Repeat with --resume")


ShardSource = ShardFolder | ShardArchive
