"""Sequence that keeps its first items in memory and the others in a temporary file that nobody else sees."""

from __future__ import annotations

import os
import pickle
import tempfile
import weakref
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Generic, TypeVar, overload

from infrablend.core.files import output_error

Item = TypeVar("Item")

IN_MEMORY = 1000
"""Number of items that a spool keeps in memory: a small run then never reads an item twice."""


class Spool(Sequence[Item], Generic[Item]):
    """Sequence of any length in little memory; items from the file are new objects each time.

    The file has no name, so nothing of it remains however the process ends.
    """

    def __init__(self, folder: Path, in_memory: int | None = None) -> None:
        """Start an empty sequence.

        Args:
            folder: Existing folder on the disk that may be filled: `/tmp` may be memory.
            in_memory: Number of items to keep in memory; None for `IN_MEMORY`.
        """
        self._folder = folder
        self._limit = IN_MEMORY if in_memory is None else in_memory
        self._first: list[Item] = []
        self._starts = array("Q", [0])
        self._file: int | None = None

    def append(self, item: Item) -> None:
        """Add an item.

        Raises:
            OutputError: The file cannot be written, for example because the disk is full.
        """
        if len(self._first) < self._limit:
            self._first.append(item)
            return
        data = pickle.dumps(item, protocol=pickle.HIGHEST_PROTOCOL)
        try:
            if self._file is None:
                self._file = _nameless_file(self._folder)
                weakref.finalize(self, os.close, self._file)
            _write_all(self._file, data)
        except OSError as error:
            raise output_error(self._folder, error) from error
        self._starts.append(self._starts[-1] + len(data))

    def __len__(self) -> int:
        """Return the number of items."""
        return len(self._first) + len(self._starts) - 1

    @overload
    def __getitem__(self, index: int) -> Item: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Item]: ...
    def __getitem__(self, index: int | slice) -> Item | Sequence[Item]:
        """Return an item, or a list of items."""
        if isinstance(index, slice):
            return [self[n] for n in range(*index.indices(len(self)))]
        n = index + len(self) if index < 0 else index
        if not 0 <= n < len(self):
            raise IndexError(index)
        if n < len(self._first):
            return self._first[n]
        assert self._file is not None
        start, end = self._starts[n - len(self._first)], self._starts[n - len(self._first) + 1]
        found: Item = pickle.loads(os.pread(self._file, end - start, start))
        return found

    def __iter__(self) -> Iterator[Item]:
        """Yield all items in order."""
        return (self[n] for n in range(len(self)))


def _nameless_file(folder: Path) -> int:
    """Return a handle of a new file that is gone when the handle is closed."""
    with tempfile.TemporaryFile(dir=folder) as stream:
        return os.dup(stream.fileno())


def _write_all(handle: int, data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(handle, view) :]
