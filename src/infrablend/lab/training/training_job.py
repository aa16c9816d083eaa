"""What the process of a training is told, how far it got, and what the trainers of both back ends share."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from infrablend.core.rng import stream
from infrablend.detection.scale import CHECKPOINT, DAMAGED, LOG, RUN
from infrablend.lab.training.presets import Backend

Say = Callable[..., None]
"""Reports an event, with its facts as named arguments."""

REACHED = "infrablend_reached"
"""Entry of a checkpoint with the progress, as the fields of `Reached`."""


@dataclass(frozen=True)
class Job:
    """Settings of the training process; those of `TrainRequest` and `Preset` are explained there.

    Attributes:
        data: Path of the data.yaml of the written data.
        out: Folder for checkpoint and weights.
        model: File of weights, or name of a network or of its description, to start from scratch.
        device: `cpu`, `mps` or the number of a GPU.
        images: Number of images the train split must have.
        labels: Number of labels the train split must have.
        shown: Images shown per epoch. If it differs from `images`, each epoch continues in the shuffled data where the
            last one ended.
        val_images: Number of images the val split must have; 0 if nothing depends on it.
        val_labels: Number of labels the val split must have.
        picture_px: Longer side of most pictures that tiles were cut from; 0 without tiles.
        agc: Automatic gain control that turned 16-bit pictures into the images, as JSON values; None for 8-bit ones.
        backend: Library that trains.
        classes: Names of the classes.
        network: Name of the network; weights of Ultralytics bring their own along.
    """

    data: str
    out: str
    task: str
    model: str
    device: str
    epochs: int
    batch: int
    image_size: int
    patience: int
    seed: int
    images: int
    labels: int
    shown: int
    arguments: dict[str, object] = field(default_factory=dict)
    val_images: int = 0
    val_labels: int = 0
    tile: int = 0
    picture_px: int = 0
    agc: Mapping[str, object] | None = None
    backend: Backend = "ultralytics"
    classes: Sequence[str] = ()
    network: str = ""


@dataclass(frozen=True)
class Reached:
    """Progress of a training, which its checkpoint contains: a resumed training reports the same as an undisturbed one.

    Attributes:
        epochs: Number of finished epochs.
        ended: Whether the training is finished, by the number of epochs or because val no longer improved.
        gate: Numbers of images and labels that the trainer has loaded.
        losses: Losses of the last epoch.
        batch: Images per step.
        short_of_memory: Whether the batch was reduced because memory was short.
    """

    epochs: int = 0
    ended: bool = False
    gate: dict[str, int] = field(default_factory=dict)
    losses: dict[str, float] = field(default_factory=dict)
    batch: int = 0
    short_of_memory: bool = False


class IncompleteDataError(Exception):
    """The trainer would not use all images and labels."""


class ShuffledPasses:
    """Sampler of `shown` indices per epoch, from consecutive shuffled passes over all images.

    The same seed and epoch give the same indices, so a resumed training continues in the same order.
    """

    def __init__(self, images: int, shown: int, seed: int, epoch: int = 0) -> None:
        self.images = images
        self.shown = shown
        self.seed = seed
        self.epoch = epoch

    def __len__(self) -> int:
        return self.shown

    def __iter__(self) -> Iterator[int]:
        first = self.epoch * self.shown
        self.epoch += 1
        for walk in range(first // self.images, (first + self.shown - 1) // self.images + 1):
            order = stream(self.seed, "train", walk).permutation(self.images).tolist()
            start = walk * self.images
            yield from order[max(first - start, 0) : first + self.shown - start]


def require_all(job: Job, shown: int, train: tuple[int, int], val: tuple[int, int] = (0, 0)) -> dict[str, int]:
    """Return what a trainer has loaded, for the record; refuse other images and labels than those that were prepared.

    Args:
        job: What was prepared.
        shown: Images that an epoch shows.
        train: Images and labels of split train.
        val: Those of split val, if it decides when to stop.
    """
    images, labels = train
    loaded = {"images": images, "labels": labels, "images_per_epoch": shown}
    if job.val_images:
        loaded |= {"val_images": val[0], "val_labels": val[1]}
    log = Path(job.out) / LOG
    if train != (job.images, job.labels) or shown != job.shown or shown * job.epochs < job.images:
        raise IncompleteDataError(
            f"of {job.images} images and {job.labels} labels the trainer would use "
            f"{min(images, shown * job.epochs)} and {labels}; its log lists those it left out ({log})"
        )
    if val != (job.val_images, job.val_labels):
        raise IncompleteDataError(
            f"of {job.val_images} images and {job.val_labels} labels of split val, which decides when to stop, "
            f"the trainer would use {val[0]} and {val[1]}; its log lists those it left out ({log})"
        )
    return loaded


def reseed(job: Job, epoch: int) -> int:
    """Seed all generators by the job and the epoch, so that a resumed run draws the same as an undisturbed one."""
    import numpy as np
    import torch

    seed = (job.seed * 100_003 + epoch) % 2**31
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 - Ultralytics draws from it
    torch.manual_seed(seed)
    return seed


def last_checkpoint(checkpoint: Path, torch: Any, say: Any) -> Reached:
    """Return the progress in the checkpoint; move an unreadable one away and return no progress."""
    if not checkpoint.is_file():
        return Reached()
    try:
        return read_checkpoint(checkpoint, torch)
    except (MemoryError, ImportError):
        raise
    except Exception as error:  # unpickling can raise anything
        checkpoint.replace(checkpoint.with_name(DAMAGED))
        shutil.rmtree(checkpoint.with_name(RUN), ignore_errors=True)
        text = " ".join(f"{type(error).__name__}: {error}".split())[:100]
        say("damaged", message=f"{CHECKPOINT} cannot be read ({text}): moved to {DAMAGED}; the training starts again")
        return Reached()


def read_checkpoint(checkpoint: Path, torch: Any) -> Reached:
    """Return the progress in a checkpoint."""
    content = torch.load(checkpoint, map_location="cpu", weights_only=False)
    return Reached(**content[REACHED])
