"""What a scheduler has to know about a run in shards."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal

from infrablend.core.addresses import require_folder, require_known, shown
from infrablend.core.arguments import require_whole
from infrablend.errors import ArgumentError
from infrablend.pipeline.plans.shard import Shard

Scheduler = Literal["slurm", "kubernetes"]
SCHEDULERS: tuple[Scheduler, ...] = ("slurm", "kubernetes")

_NAME = re.compile(r"[a-z0-9]([-a-z0-9]{0,38}[a-z0-9])?")
_CLAIM = re.compile(r"[a-z0-9]([-.a-z0-9]{0,250}[a-z0-9])?")
_WORD = re.compile(r"[\w.-]+", re.ASCII)
_IMAGE = re.compile(r"[\w.:@/-]+", re.ASCII)


@dataclass(frozen=True)
class Volume:
    """Storage that all pods share.

    Attributes:
        claim: Name of a PersistentVolumeClaim.
        path: Folder that it is mounted on.

    Raises:
        ArgumentError: One is no such name.
    """

    claim: str
    path: str

    def __post_init__(self) -> None:
        _require_match("volume", self.claim, _CLAIM, "the name of a PersistentVolumeClaim")
        place = PurePosixPath(self.path)
        if not place.is_absolute() or ".." in place.parts or ":" in self.path or place == PurePosixPath("/"):
            raise ArgumentError(f"volume {self.claim}: found path {self.path!r}, expected an absolute one without ':'")

    @classmethod
    def parse(cls, text: str) -> Volume:
        """Return the volume that CLAIM:PATH names.

        Raises:
            ArgumentError: It is something else.
        """
        claim, colon, path = text.partition(":")
        if not colon:
            raise ArgumentError(f"volume: found {text!r}, expected CLAIM:/PATH")
        return cls(claim, path)

    def contains(self, path: Path) -> bool:
        """Return whether a path of the pods lies on it."""
        place = PurePosixPath(path)
        return ".." not in place.parts and PurePosixPath(self.path) in (place, *place.parents)


@dataclass(frozen=True)
class Submission:
    """Run in shards for a scheduler.

    Attributes:
        words: Arguments of `infrablend generate` without shard and `--resume`.
        shards: Number of shards.
        out: Folder or address of the shards, the `--out` in `words`.
        into: Folder of the merged run.
        program: Words that start InfraBlend on the cluster.
        paths: Files and folders in `words` and `program` that have to exist on the cluster.
        name: Name of the jobs.
        cores: Cores, and worker processes, of a shard.
        memory_gib: Memory of a shard.
        minutes: SLURM: time limit of a shard, which is then queued again and continues.
        parallel: Most shards at the same time [default: all].
        partition: SLURM: partition.
        account: SLURM: account.
        image: Kubernetes: container image with InfraBlend.
        volumes: Kubernetes: shared storage of the pods; repeatable.

    Raises:
        ArgumentError: A value is out of range, or could be taken for something else by the scheduler.
    """

    words: Sequence[str]
    shards: int
    out: Path
    into: Path
    program: Sequence[str] = ("infrablend",)
    paths: Sequence[Path] = ()
    name: str = "infrablend"
    cores: int = 8
    memory_gib: int = 16
    minutes: int = 240
    parallel: int | None = None
    partition: str | None = None
    account: str | None = None
    image: str | None = None
    volumes: Sequence[Volume] = ()

    def __post_init__(self) -> None:
        require_known("out", self.out)
        require_folder("into", self.into)
        Shard(1, self.shards)
        for where, value in (
            ("cores", self.cores),
            ("memory", self.memory_gib),
            ("parallel", 1 if self.parallel is None else self.parallel),
        ):
            require_whole(where, value, 1)
        require_whole("minutes", self.minutes, MARGIN_S // 60 + 1)
        _require_match("name", self.name, _NAME, "at most 40 of a-z, 0-9 and -, not - at the ends")
        for where, text in (("partition", self.partition), ("account", self.account)):
            if text is not None:
                _require_match(where, text, _WORD, "letters, digits, '.', '_' and '-'")
        if self.image is not None:
            _require_match("image", self.image, _IMAGE, "the name of a container image")

    @property
    def at_once(self) -> int:
        """Number of shards that may run at the same time."""
        return min(self.shards, self.parallel or self.shards)

    @property
    def generate(self) -> list[str]:
        """Words of a shard, before the number of the shard."""
        return [*self.program, "--quiet", "generate", *self.words, "--resume"]

    @property
    def merge(self) -> list[str]:
        """Words of the job that merges the shards."""
        return [*self.program, "--quiet", "merge", "--resume", "--", shown(self.out), str(self.into)]


MARGIN_S = 120
"""Seconds before its time limit at which a shard is told to stop: frames that are being rendered are finished."""

MERGE_GIB = 4
"""Memory of the job that merges: it does not grow with the number of frames."""


def _require_match(where: str, text: str, pattern: re.Pattern[str], expected: str) -> None:
    if not pattern.fullmatch(text):
        raise ArgumentError(f"{where}: found {text!r}, expected {expected}")
