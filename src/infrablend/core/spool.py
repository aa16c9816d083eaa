"""Sequences that need not fit into memory: of any items, and of the images of a dataset in their order."""

from __future__ import annotations

import pickle
import tempfile
import threading
import weakref
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import IO, Generic, TypeVar, overload

from infrablend.core.dataset import SPLITS, ImageRecord
from infrablend.core.files import output_error

Item = TypeVar("Item")

IN_MEMORY = 1000
"""Number of items that a spool keeps in memory: a small run then never reads an item twice."""


class Spool(Sequence[Item], Generic[Item]):
    """Sequence that keeps its first items in memory and the others in a file; those are new objects each time.

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
        self._file: IO[bytes] | None = None
        self._lock = threading.Lock()  # one place in the file serves all threads

    def append(self, item: Item) -> None:
        """Add an item; an `OutputError` if the file cannot be written, for example because the disk is full."""
        if len(self._first) < self._limit:
            self._first.append(item)
            return
        data = pickle.dumps(item, protocol=pickle.HIGHEST_PROTOCOL)
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile(buffering=0, dir=self._folder)  # noqa: SIM115
                weakref.finalize(self, self._file.close)
            with self._lock:
                self._file.seek(self._starts[-1])
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
        with self._lock:
            self._file.seek(start)
            found: Item = pickle.loads(self._file.read(end - start))
        return found

    def __iter__(self) -> Iterator[Item]:
        """Yield all items in order."""
        return (self[n] for n in range(len(self)))


def _write_all(stream: IO[bytes], data: bytes) -> None:
    view = memoryview(data)
    while view:
        view = view[stream.write(view) :]


@dataclass(frozen=True, eq=False)
class StoredImages(Sequence[ImageRecord]):
    """Images by (split order, id), the order of a `Dataset`; each is read when it is needed.

    Attributes:
        stored: The images in any order.
        order: Their indices in the order of this sequence.
        names: New names of pictures by index in `stored`.
    """

    stored: Sequence[ImageRecord]
    order: Sequence[int]
    names: Mapping[int, str] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of images."""
        return len(self.order)

    @overload
    def __getitem__(self, index: int) -> ImageRecord: ...
    @overload
    def __getitem__(self, index: slice) -> StoredImages: ...
    def __getitem__(self, index: int | slice) -> ImageRecord | StoredImages:
        """Return an image, or a part of the images that shares their storage."""
        if isinstance(index, slice):
            return replace(self, order=self.order[index])
        n = self.order[index]
        image = self.stored[n]
        return replace(image, file_name=self.names[n]) if n in self.names else image

    def __iter__(self) -> Iterator[ImageRecord]:
        """Yield all images in order."""
        return (self[n] for n in range(len(self)))

    def renamed(self, names: Mapping[int, str]) -> StoredImages:
        """Return the images with new names of pictures, by index in this sequence."""
        return replace(self, names={**self.names, **{self.order[n]: name for n, name in names.items()}})


def store_images(images: Iterable[ImageRecord], folder: Path) -> StoredImages:
    """Return the images sorted; all but the first are on the disk of `folder`, see `Spool`."""
    stored: Spool[ImageRecord] = Spool(folder)
    keys: list[tuple[int, str]] = []
    for image in images:
        keys.append((SPLITS.index(image.split), image.id))
        stored.append(image)
    order: Sequence[int] = range(len(keys))
    if any(a > b for a, b in pairwise(keys)):
        order = sorted(order, key=keys.__getitem__)
    return StoredImages(stored, order)
