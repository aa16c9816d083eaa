"""The ledger of a run: one SQLite file with a row per frame, from which everything but the pictures is exported.

The process that distributes the frames is the only writer; workers return records. A frame is in the ledger after its
picture is on disk, so whatever a kill leaves can be continued: `Ledger.done` is the whole of resuming. Rows are
committed in batches; what a kill takes of the last batch is rendered again and has the same bytes.

A rollback journal is used, not a write-ahead log: the file can be copied when no run is writing it, and it works on
network file systems as far as their locks do. docs/explanation/reliability.md has the measurements.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import sqlite3
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from infrablend.core.file_names import real_path
from infrablend.core.files import DAMAGED, output_error, replace_atomically, sha256_of
from infrablend.core.frame_row import FrameRecord, FrameRow
from infrablend.core.run_record import RunRecord
from infrablend.core.tasks import Failure
from infrablend.errors import OutputError

LEDGER = "run.sqlite"

_VERSION = 1
_COMMIT_S = 1.0
_SCHEMA = """
CREATE TABLE facts (name TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE frames (
    frame_id TEXT PRIMARY KEY,  -- <split>/<name>
    image TEXT,                 -- path below images/; NULL if the frame has no picture
    bytes INTEGER,              -- size of the picture
    sha256 TEXT,                -- digest of the picture
    inserted INTEGER,           -- number of labelled inserts
    failure TEXT,               -- JSON: why there is no picture
    excluded TEXT               -- reason for which the frame is left out of the finished run
) WITHOUT ROWID;
CREATE TABLE tracebacks (frame_id TEXT PRIMARY KEY, text TEXT) WITHOUT ROWID;  -- of failures; differ between equal runs
CREATE TABLE records (frame_id TEXT PRIMARY KEY, record TEXT NOT NULL);  -- JSON, see `FrameRecord`
CREATE TABLE backgrounds (path TEXT PRIMARY KEY, bytes INTEGER, changed_ns INTEGER, sha256 TEXT) WITHOUT ROWID;
CREATE TABLE exports (path TEXT PRIMARY KEY, bytes INTEGER, sha256 TEXT) WITHOUT ROWID;  -- files of the finished run
"""


@dataclass(frozen=True)
class DoneFrame:
    """A finished frame in a ledger.

    Attributes:
        image: Path of the picture below `images/`.
        bytes: Its size.
        sha256: Its digest.
        inserted: Number of labelled inserts.
    """

    image: str
    bytes: int
    sha256: str
    inserted: int


@dataclass(frozen=True)
class KnownBackground:
    """The file of a background, as it was when frames were made of it.

    Attributes:
        bytes: Its size.
        changed_ns: When it was changed last, ns since 1970.
        sha256: Its digest.
    """

    bytes: int
    changed_ns: int
    sha256: str

    def is_still(self, path: Path) -> bool:
        """Return whether a file is this background; it is read only if its size or time differs."""
        try:
            status = path.stat()
            same_times = (status.st_size, status.st_mtime_ns) == (self.bytes, self.changed_ns)
            return same_times or sha256_of(real_path(path)) == self.sha256
        except OSError:
            return False


class Ledger:
    """Open ledger of a run; close it, or use it in a `with` statement.

    Every method raises an `OutputError` if the file is missing or damaged or cannot be written.
    """

    def __init__(self, file: Path, connection: sqlite3.Connection) -> None:
        """Use `Ledger.create` or `Ledger.open`."""
        self.file = file
        self._db = connection
        self._commit_at = time.monotonic() + _COMMIT_S
        self._closed = False

    @classmethod
    def create(cls, folder: Path, record: RunRecord) -> Ledger:
        """Start the ledger of a run with what is known before its first frame."""
        # Under its name once it has all of that: a kill or a full disk leaves nothing that cannot be resumed.
        file = folder / LEDGER
        with (
            replace_atomically(file) as temporary,
            _reported(file),
            cls(file, sqlite3.connect(temporary)) as ledger,
        ):
            ledger._db.executescript(f"PRAGMA journal_mode = MEMORY; PRAGMA user_version = {_VERSION}; {_SCHEMA}")
            ledger.write_run(record)
        return cls.open(folder, write=True)

    @classmethod
    def open(cls, folder: Path, *, write: bool = False) -> Ledger:
        """Open the ledger in the folder of a run or of its workspace; one process at a time may `write`."""
        file = folder / LEDGER
        if not file.is_file() or file.is_symlink():
            raise OutputError(
                f"{folder}: no {LEDGER}; expected the folder of a run. Use a folder that `infrablend generate` or "
                "`infrablend merge` wrote."
            )
        # Read-only folders, as of another user, can be read: without a journal there is nothing to roll back.
        left = write or os.path.lexists(f"{file}-journal")  # by a kill amid a commit: opening to write rolls it back
        with contextlib.ExitStack() as unusable:
            with _reported(file):
                text = f"file:{_quoted(file)}?mode={'rw' if left else 'ro'}"
                database = sqlite3.connect(text, uri=True, check_same_thread=write)
                unusable.callback(database.close)
                (version,) = database.execute("PRAGMA user_version").fetchone()
            if version != _VERSION:
                raise OutputError(f"{file}: a ledger of version {version}, expected {_VERSION}. Make the run again.")
            unusable.pop_all()
        return cls(file, database)

    def __enter__(self) -> Ledger:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Commit what was added, and close the file; a second call does nothing."""
        if self._closed:
            return
        self._closed = True
        try:
            self.commit()
        finally:
            self._db.close()

    def commit(self) -> None:
        """Put what was added on disk."""
        with _reported(self.file):
            self._db.commit()
        self._commit_at = time.monotonic() + _COMMIT_S

    # -- the run -----------------------------------------------------------------------------------------------------

    def write_run(self, record: RunRecord) -> None:
        """Keep the record of the run: its settings, and after its end its counts and problems."""
        self._write("INSERT OR REPLACE INTO facts VALUES ('run', ?)", json.dumps(record, allow_nan=False))
        self.commit()

    def read_run(self) -> RunRecord:
        """Return the record of the run."""
        with _reported(self.file):
            (text,) = self._db.execute("SELECT value FROM facts WHERE name = 'run'").fetchone()
            record: RunRecord = json.loads(text)
        return record

    # -- frames ------------------------------------------------------------------------------------------------------

    def add(self, frame_id: str, frame: DoneFrame, record: str) -> None:
        """Add a finished frame, whose picture is on disk, with its record (see `FrameRecord.to_text`)."""
        row = (frame_id, frame.image, frame.bytes, frame.sha256, frame.inserted, frame_id)
        self._write(
            "INSERT OR REPLACE INTO frames VALUES (?, ?, ?, ?, ?, NULL, "
            "(SELECT excluded FROM frames WHERE frame_id = ?))",
            *row,
        )
        self._write("INSERT OR REPLACE INTO records VALUES (?, ?)", frame_id, record)
        if time.monotonic() >= self._commit_at:
            self.commit()

    def add_failure(self, frame_id: str, failure: Failure) -> None:
        """Note why a frame has no picture; a later call tries it again."""
        self.forget(frame_id)
        self._write("INSERT INTO frames (frame_id, failure) VALUES (?, ?)", frame_id, _text(failure.to_json()))
        self._write("INSERT INTO tracebacks VALUES (?, ?)", frame_id, failure.traceback)

    def forget(self, frame_id: str) -> None:
        """Remove a frame that has to be made again."""
        for table in ("frames", "records", "tracebacks"):
            self._write(f"DELETE FROM {table} WHERE frame_id = ?", frame_id)

    def done(self) -> dict[str, DoneFrame]:
        """Return the frames that have a picture, excluded ones too, by id."""
        rows = self._rows("SELECT frame_id, image, bytes, sha256, inserted FROM frames WHERE image IS NOT NULL")
        return {frame_id: DoneFrame(*facts) for frame_id, *facts in rows}

    def frame_ids(self) -> list[str]:
        """Return the ids of the frames that have a picture and are not excluded, sorted."""
        query = "SELECT frame_id FROM frames WHERE image IS NOT NULL AND excluded IS NULL ORDER BY frame_id"
        return [frame_id for (frame_id,) in self._rows(query)]

    def failures(self) -> dict[str, Failure]:
        """Return why frames have no picture, by id."""
        query = "SELECT frame_id, failure, text FROM frames LEFT JOIN tracebacks USING (frame_id)"
        rows = self._rows(f"{query} WHERE failure IS NOT NULL ORDER BY frame_id")
        return {frame_id: Failure.from_json({**json.loads(text), "traceback": t or ""}) for frame_id, text, t in rows}

    def record_text(self, frame_id: str) -> str:
        """Return the record of a frame as it was added; a `KeyError` if there is no such frame."""
        row = next(self._rows("SELECT record FROM records WHERE frame_id = ?", frame_id), None)
        if row is None:
            raise KeyError(frame_id)
        return str(row[0])

    def record(self, frame_id: str) -> FrameRecord:
        """Return the record of a frame; a `KeyError` if there is no such frame."""
        text = self.record_text(frame_id)
        with self._damage_named(frame_id):
            return FrameRecord.from_text(text)

    def row(self, frame_id: str) -> FrameRow:
        """Return what is shown and counted of a frame; a `KeyError` if there is no such frame."""
        text = self.record_text(frame_id)
        with self._damage_named(frame_id):
            return FrameRow.from_json(json.loads(text))

    def records(self, frame_ids: Iterable[str] | None = None) -> Iterator[FrameRecord]:
        """Yield the records of these frames, or of all that `frame_ids()` returns; one is in memory at a time."""
        for frame_id in self.frame_ids() if frame_ids is None else frame_ids:
            yield self.record(frame_id)

    def rows(self, frame_ids: Iterable[str] | None = None) -> Iterator[FrameRow]:
        """Yield the rows of these frames, or of all that `frame_ids()` returns."""
        for frame_id in self.frame_ids() if frame_ids is None else frame_ids:
            yield self.row(frame_id)

    @contextlib.contextmanager
    def _damage_named(self, frame_id: str) -> Iterator[None]:
        try:
            yield
        except DAMAGED as error:
            raise OutputError(
                f"{self.file}: the record of {frame_id} is damaged ({type(error).__name__}: {error}); expected one as "
                "it was written. Make the run again with --overwrite."
            ) from error

    # -- exclusion ---------------------------------------------------------------------------------------------------

    def excluded(self) -> dict[str, str]:
        """Return the frames that are left out, each with its reason, sorted."""
        rows = self._rows("SELECT frame_id, excluded FROM frames WHERE excluded IS NOT NULL ORDER BY frame_id")
        return {frame_id: str(reason) for frame_id, reason in rows}

    def exclude(self, frames: Mapping[str, str]) -> None:
        """Leave exactly these frames out, each with its reason."""
        self._write("UPDATE frames SET excluded = NULL")
        for frame_id, reason in frames.items():
            self._write("INSERT OR IGNORE INTO frames (frame_id) VALUES (?)", frame_id)
            self._write("UPDATE frames SET excluded = ? WHERE frame_id = ?", reason, frame_id)
        self.commit()

    # -- files -------------------------------------------------------------------------------------------------------

    def backgrounds(self) -> dict[str, KnownBackground]:
        """Return the background pictures that were read, by `<split>/<id>`."""
        return {name: KnownBackground(*facts) for name, *facts in self._rows("SELECT * FROM backgrounds")}

    def add_background(self, name: str, file: Path, sha256: str) -> None:
        """Note the file of a background, `<split>/<id>`, of which a frame was made, with the digest that it had."""
        try:
            status = file.stat()
        except OSError:  # removed meanwhile: its frames are made again by the next call that finds it
            return
        facts = (name, status.st_size, status.st_mtime_ns, sha256)
        self._write("INSERT OR REPLACE INTO backgrounds VALUES (?, ?, ?, ?)", *facts)

    def write_exports(self, files: Iterable[tuple[str, int, str]]) -> None:
        """Keep path, size and digest of the files of the finished run, other than pictures."""
        self._write("DELETE FROM exports")
        with _reported(self.file):
            self._db.executemany("INSERT INTO exports VALUES (?, ?, ?)", files)
        self.commit()

    def exports(self) -> Iterator[tuple[str, int, str]]:
        """Yield path, size and digest of the files of the finished run, other than pictures, sorted."""
        yield from self._rows("SELECT path, bytes, sha256 FROM exports ORDER BY path")

    def _write(self, query: str, *values: Any) -> None:
        with _reported(self.file):
            self._db.execute(query, values)

    def _rows(self, query: str, *values: Any) -> Iterator[tuple[Any, ...]]:
        with _reported(self.file):
            yield from self._db.execute(query, values)


_OF_THE_DISK = {sqlite3.SQLITE_FULL: errno.ENOSPC, sqlite3.SQLITE_IOERR: errno.EIO}


@contextlib.contextmanager
def _reported(file: Path) -> Iterator[None]:
    try:
        yield
    except (sqlite3.Error, ValueError, TypeError) as error:
        if (number := _OF_THE_DISK.get(getattr(error, "sqlite_errorcode", 0) & 0xFF)) is not None:
            raise output_error(file, OSError(number, os.strerror(number))) from error
        raise OutputError(
            f"{file}: {error}; expected the ledger of a run. Check the folder's permissions; if the file is damaged, "
            "make the run again with --overwrite."
        ) from error


def _text(value: Any) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _quoted(file: Path) -> str:
    return file.resolve().as_uri().removeprefix("file://")
