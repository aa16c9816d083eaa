"""Reads the rows of a run's frames in the background; rows of unchanged records come from the user's cache folder.

A page can show the frames by name at once, and any single one, long before the last record is read.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import threading
from collections.abc import Iterator, Mapping
from dataclasses import fields
from functools import cached_property
from pathlib import Path
from typing import Any

from infrablend.core.files import read_regular, write_text
from infrablend.core.run_layout import SCENES, RunLayout
from infrablend.errors import OutputError
from infrablend.studio.frame_index import UNREADABLE, FrameRow, read_row

_VERSION = 1
_FIELDS = tuple(f.name for f in fields(FrameRow))
_PAUSE_EVERY = 50
_PAUSE_S = 0.001
# Reading takes a core for a second per 8,000 records; the first page comes first, unless it needs them.
_FEW = 500
_START_S = 1.5

log = logging.getLogger(__name__)

_State = tuple[int, int]
"""Time of change and size of a record."""


class RowReading:
    """The rows of a run, read once by a thread.

    Attributes:
        ids: Ids of all frames, in the order of the rows.
    """

    def __init__(self, layout: RunLayout, cache: Path) -> None:
        """List the frames, and begin to read them.

        Args:
            layout: Paths of the run.
            cache: File with the rows of an earlier studio.
        """
        self._layout, self._cache = layout, cache
        found = sorted(_records(layout))
        self.ids: list[str] = [frame_id for frame_id, _, _ in found]
        self._found = found
        self._rows: list[FrameRow | None] = [None] * len(found)
        self._count = 0
        self._needed = threading.Event()
        self._read = threading.Event()
        threading.Thread(target=self._run, name="studio-rows", daemon=True).start()

    @property
    def count(self) -> int:
        """Number of rows that are read."""
        return self._count

    @property
    def is_complete(self) -> bool:
        """Whether all rows are read."""
        return self._read.is_set()

    @cached_property
    def names(self) -> list[FrameRow]:
        """Rows with nothing but the ids, to show until the others are read."""
        return [FrameRow(frame_id) for frame_id in self.ids]

    def wait(self) -> list[FrameRow]:
        """Return all rows, once they are read."""
        self._needed.set()
        self._read.wait()
        return self._rows  # type: ignore[return-value]

    def row(self, number: int) -> FrameRow:
        """Return one row, read now if the thread has not come to it yet."""
        row = self._rows[number]
        return read_row(self._layout, Path(self._found[number][1])) if row is None else row

    def _run(self) -> None:
        try:
            self._read_all()
        except Exception:
            log.exception("%s: the records of the frames cannot be read", self._layout.root)
        for number, frame_id in enumerate(self.ids):
            if self._rows[number] is None:
                self._rows[number] = FrameRow(frame_id, warnings=(UNREADABLE,))
        self._read.set()

    def _read_all(self) -> None:
        known = _load(self._cache)
        self._rows = [_cached(known.get(frame_id), state) for frame_id, _, state in self._found]
        missing = [number for number, row in enumerate(self._rows) if row is None]
        self._count = len(self._found) - len(missing)
        if len(missing) > _FEW:
            self._needed.wait(_START_S)
        for read, number in enumerate(missing, 1):
            self._rows[number] = read_row(self._layout, Path(self._found[number][1]))
            self._count += 1
            if read % _PAUSE_EVERY == 0:
                self._read.wait(_PAUSE_S)  # requests of pages come first
        if missing or len(known) != len(self._found):
            self._save()

    def _save(self) -> None:
        rows = {
            row.id: [*state, *(getattr(row, name) for name in _FIELDS)]
            for row, (frame_id, _, state) in zip(self._rows, self._found, strict=True)
            if row is not None and row.id == frame_id and row.image
        }
        with contextlib.suppress(OutputError):  # a full or read-only cache costs time only
            write_text(self._cache, json.dumps({"version": _VERSION, "rows": rows}, separators=(",", ":")))


def _records(layout: RunLayout) -> Iterator[tuple[str, str, _State]]:
    """Yield id, path and state of every record; links to folders are not followed."""
    top = str(layout.root / SCENES)
    folders = [top]
    while folders:
        try:
            entries = sorted(os.scandir(folders.pop()), key=lambda e: e.name)
        except OSError as error:  # removed, or written again meanwhile
            log.warning("%s: %s", layout.root, error)
            continue
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                folders.append(entry.path)
            elif entry.name.endswith(".json"):
                yield entry.path[len(top) + 1 : -5], entry.path, _state(entry)


def _state(entry: os.DirEntry[str]) -> _State:
    try:
        status = entry.stat()
    except OSError:
        return 0, -1
    return status.st_mtime_ns, status.st_size


def _load(path: Path) -> Mapping[str, Any]:
    try:
        content = json.loads(read_regular(path))
        rows = content["rows"] if content["version"] == _VERSION else {}
    except (OSError, ValueError, LookupError, TypeError):
        return {}
    return rows if isinstance(rows, dict) else {}


def _cached(values: Any, state: _State) -> FrameRow | None:
    if not isinstance(values, list) or tuple(values[:2]) != state:
        return None
    try:
        found: dict[str, Any] = dict(zip(_FIELDS, values[2:], strict=True))
        found["boxes"] = tuple(tuple(box) for box in found["boxes"])
        listed: dict[str, Any] = {name: tuple(v) if isinstance(v, list) else v for name, v in found.items()}
        return FrameRow(**listed)
    except (TypeError, ValueError):
        return None
