"""Sorted images of a dataset that need not fit into memory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import overload

from infrablend.core.dataset import SPLITS, ImageRecord
from infrablend.core.spool import Spool


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
