"""Defines the request for a run, built by the command line or the Python caller."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from infrablend.core.addresses import require_known
from infrablend.core.arguments import require_choice, require_whole
from infrablend.core.machine import Device
from infrablend.core.operating_system import usable_processors
from infrablend.core.workspace import Existing, require_existing
from infrablend.errors import ArgumentError
from infrablend.formats.read_write import READ_ALL, Reading
from infrablend.pipeline.plans.selection import ALL_FRAMES, FrameSelection
from infrablend.pipeline.plans.shard import ShardRequest
from infrablend.rendering import RENDERERS

log = logging.getLogger(__name__)

Executor = Literal["local", "ray"]
WORKER_BYTES = 500 * 2**20  # memory of one rendering worker, measured and rounded up

Settings = Sequence[str] | Mapping[str, Any]
"""Recipe fields to set: `["output.image=png"]` or `{"output.image": "png"}`."""


@dataclass(frozen=True)
class Execution:
    """Settings for computing frames. They do not change labels; the device may change pixels by one grey level.

    With Ray, the machines of the cluster need the same paths and packages; there is one worker for each core of the
    cluster by default, and a worker reserves a core, 500 MB and, if `device` names a kind of GPU, a GPU.

    Attributes:
        workers: Number of worker processes [default: one per core].
        device: Device that Cycles renders on; auto uses a GPU if there is one.
        renderer: `blender`, or `flat`, which shades flatly and needs no Blender.
        in_process: Compute all frames in the calling process; Blender has its own in any case.
        executor: Where the workers run: processes of this machine, or Ray (extra infrablend[ray]).
        address: Ray cluster to use [default: RAY_ADDRESS, else Ray is started for the run].
        blender: Blender to use: the path of a program, or of a Python that has bpy; none: do without
            [default: INFRABLEND_BLENDER, else what `infrablend doctor` shows].

    Raises:
        ArgumentError: A value is not one of these.
    """

    workers: int | None = None
    device: Device = "auto"
    renderer: str = "blender"
    in_process: bool = False
    executor: Executor = "local"
    address: str | None = None
    blender: str | None = None

    def __post_init__(self) -> None:
        if self.workers is not None:
            require_whole("workers", self.workers, 1)
        require_choice("device", self.device, get_args(Device))
        require_choice("renderer", self.renderer, RENDERERS)
        require_choice("executor", self.executor, get_args(Executor))
        if self.address is not None and self.executor != "ray":
            raise ArgumentError("address: used by executor='ray' only (--executor ray). Give both, or leave it out")

    @property
    def pins_cores(self) -> bool:
        """Whether each worker keeps to a processor core of its own."""
        return self.renderer == "blender" and self.device in {"cpu", "auto"} and not self.in_process

    def worker_count(self) -> int:
        """Return the number of workers to start: the requested number, limited by free memory and cores.

        A run that exhausts the memory would swap endlessly.
        """
        cores = len(usable_processors())
        if self.workers is None or self.workers <= cores or self.executor == "ray":  # Ray places them where they fit
            return self.workers or cores
        import psutil

        most = max(cores, int(psutil.virtual_memory().available // WORKER_BYTES))
        if self.workers > most:
            log.warning(
                "--workers %d: free memory is enough for about %d on %d cores; using %d",
                self.workers,
                most,
                cores,
                most,
            )
        return min(self.workers, most)


DEFAULT_EXECUTION: Execution = Execution()
ONE_WORKER: Execution = Execution(workers=1)


@dataclass(frozen=True)
class RunRequest:
    """Request for a run of the generator.

    Attributes:
        recipe: Name of a shipped recipe, or path of a YAML file.
        data: Folder of the background dataset, a video, or the address of the folder in object storage.
        out: Folder to write, or with packed shards an address; None only for describing a run.
        selection: Frames to produce: `FrameSelection(sample=20)`, `FrameSelection(frames=["test/a_c0"])`.
        seed: Seed of every random stream. The same seed, data and recipe give the same bytes.
        settings: Recipe fields to set: `["output.image=png"]` or `{"output.formats": ["yolo", "coco"]}`.
        reading: How to read `data`, e.g. `Reading(splits=("train",))`.
        execution: Workers, device and renderer, e.g. `Execution(workers=2, device="cuda")`.
        existing: What to do if `out` already contains a run: `refuse`, `resume` or `overwrite`.
        shard: Shard to produce; None for the whole run.

    Raises:
        ArgumentError: A value is not one of these.
        OutputError: `existing` is not one of the choices.
    """

    recipe: str | Path
    data: Path
    out: Path | None = None
    selection: FrameSelection = ALL_FRAMES
    seed: int = 0
    settings: Settings = ()
    reading: Reading = READ_ALL
    execution: Execution = DEFAULT_EXECUTION
    existing: Existing = "refuse"
    shard: ShardRequest | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "data", Path(self.data))  # texts work, too
        if self.out is not None:
            object.__setattr__(self, "out", Path(self.out))
            require_known("out", self.out)
        require_known("data", self.data)
        require_whole("seed", self.seed)
        require_existing(self.existing)
