"""Divides the frames of a run into numbered shards, which separate jobs produce."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from infrablend.core.arguments import require_whole
from infrablend.errors import ArgumentError

Item = TypeVar("Item")

MAX_SHARDS = 100_000
"""Largest number of shards of a run; their folders have numbers of five digits."""


@dataclass(frozen=True)
class Shard:
    """One of the equal parts of a run.

    Attributes:
        number: Number of the shard, from 1.
        count: Number of shards of the run.

    Raises:
        ArgumentError: There is no such shard.
    """

    number: int
    count: int

    def __post_init__(self) -> None:
        require_whole("shards", self.count, 1)
        if self.count > MAX_SHARDS:
            raise ArgumentError(f"{self.count} shards: expected at most {MAX_SHARDS}")
        if type(self.number) is not int or not 1 <= self.number <= self.count:
            raise ArgumentError(f"shard {self.number}/{self.count}: expected a number from 1 to {self.count}")

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    @property
    def folder_name(self) -> str:
        """Name of the shard's folder; names sort by number."""
        return f"shard-{self.number:05d}-of-{self.count:05d}"

    def part_of(self, items: Sequence[Item]) -> Sequence[Item]:
        """Return the shard's items: consecutive ones, so that frames of a background stay together where possible.

        Shards differ by one item at most, and have none if there are more shards than items.
        """
        first, end = ((n * len(items)) // self.count for n in (self.number - 1, self.number))
        return items[first:end]


@dataclass(frozen=True)
class ShardRequest:
    """Request for one shard or all of them; the number of shards is given, or follows from their size.

    Attributes:
        number: Number of the shard, from 1; None for all, one after the other, which needs `output.layout: shards`.
        count: Number of shards of the run.
        size: Most frames per shard.

    Raises:
        ArgumentError: Neither or both of count and size are given, or a value is out of range.
    """

    number: int | None = None
    count: int | None = None
    size: int | None = None

    def __post_init__(self) -> None:
        if self.number is not None:
            require_whole("shard", self.number, 1)
        if (self.count is None) == (self.size is None):
            raise ArgumentError("a shard needs either the number of shards (2/7) or their size; give one of them")
        if self.size is not None:
            require_whole("shard size", self.size, 1)
        if self.count is not None:
            Shard(1 if self.number is None else self.number, self.count)

    def of(self, frames: int) -> list[Shard]:
        """Return the shards to make of a run with this number of frames.

        Raises:
            ArgumentError: The run has fewer shards.
        """
        count = self.count or max(1, -(-frames // (self.size or 1)))
        numbers = range(1, count + 1) if self.number is None else [self.number]
        return [Shard(n, count) for n in numbers]
