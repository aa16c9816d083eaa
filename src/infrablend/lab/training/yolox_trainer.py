"""Training with YOLOX: our own loop around the networks, the loss and the average of weights of `pixeltable-yolox`."""

from __future__ import annotations

import logging
import math
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, fields, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from infrablend.core.files import replace_atomically
from infrablend.core.rng import stream
from infrablend.detection.scale import CHECKPOINT, NEW_CHECKPOINT, STATES
from infrablend.detection.ultralytics_environment import has_fast_bfloat16
from infrablend.lab.training.presets import cpu_threads
from infrablend.lab.training.shown_pictures import Changes, ShownPicture, ShownPictures
from infrablend.lab.training.training_job import (
    REACHED,
    Job,
    Reached,
    Say,
    ShuffledPasses,
    last_checkpoint,
    require_all,
    reseed,
)
from infrablend.lab.training.yolox_network import load_states, make_network

log = logging.getLogger(__name__)  # goes to train.log

_AVERAGE = 0.9999  # decay of the average of weights, which the package approaches over 2000 steps; as in Ultralytics
_LONGEST_GRADIENT = 10.0  # as in Ultralytics
# Names of the losses in the record, and in the package.
_LOSSES = {"box_loss": "iou_loss", "obj_loss": "conf_loss", "cls_loss": "cls_loss"}


def train_yolox(job: Job, say: Say) -> None:
    """Train from the start or the last checkpoint, and write the weights; see `trainer`."""
    import torch

    torch.set_num_threads(cpu_threads())
    shown = ShownPictures(Path(job.data).parent, "train", job.image_size)
    gate = require_all(job, job.shown, (len(shown.paths), shown.labels))
    checkpoint = Path(job.out) / CHECKPOINT
    reached = last_checkpoint(checkpoint, torch, say)
    training = YoloxTraining(job)
    if reached.epochs:
        training.restore(torch.load(checkpoint, map_location=training.device, weights_only=True))
    order = ShuffledPasses(job.images, job.shown, job.seed, reached.epochs)
    for epoch in range(reached.epochs, job.epochs):
        losses = training.run_epoch(epoch, shown_batches(job, shown, list(order), epoch), say)
        reached = Reached(epoch + 1, epoch + 1 == job.epochs, gate, losses, job.batch)
        beside = checkpoint.with_name(NEW_CHECKPOINT)
        with replace_atomically(checkpoint, beside=beside, durable=True) as temporary:
            torch.save({**training.states(), REACHED: asdict(reached)}, temporary)
        say("epoch", epoch=epoch + 1, epochs=job.epochs, batch=job.batch, losses=losses, metrics={})
    with replace_atomically(Path(job.out) / STATES) as temporary:
        torch.save(
            {"network": job.network, "classes": list(job.classes), "model": training.average.state_dict()}, temporary
        )
    say("end", epochs=reached.epochs, gate=reached.gate, losses=reached.losses, batch=min(job.batch, job.images),
        short_of_memory=False, precision=training.precision, threads=torch.get_num_threads(),
        versions={"pixeltable-yolox": metadata.version("pixeltable-yolox"), "torch": torch.__version__})  # fmt: skip


def shown_batches(job: Job, shown: ShownPictures, order: Sequence[int], epoch: int) -> Iterator[list[ShownPicture]]:
    """Yield the batches of an epoch; the same job and epoch give the same pictures."""
    changes = Changes(**{f.name: float(str(job.arguments[f.name])) for f in fields(Changes)})
    if epoch >= job.epochs - int(str(job.arguments["close_mosaic"])):
        changes = replace(changes, mosaic=0.0)
    rng = stream(job.seed, "shown", epoch)
    for first in range(0, len(order), job.batch):
        yield [shown.show(index, changes, rng) for index in order[first : first + job.batch]]


def targets_of(pictures: Sequence[ShownPicture]) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Return the (b, n, 5) targets of YOLOX: class, centre and size in px; rows of zeros are none."""
    most = max((len(p.classes) for p in pictures), default=0)
    targets = np.zeros((len(pictures), max(most, 1), 5), np.float32)
    for target, picture in zip(targets, pictures, strict=True):
        boxes = picture.boxes_xyxy
        target[: len(boxes), 0] = picture.classes
        target[: len(boxes), 1:3] = (boxes[:, :2] + boxes[:, 2:]) / 2
        target[: len(boxes), 3:] = boxes[:, 2:] - boxes[:, :2]
    return targets


class YoloxTraining:
    """Network, the average of its weights, and its optimizer.

    Attributes:
        device: Where they are.
        precision: Of the layers before the loss.
    """

    def __init__(self, job: Job) -> None:
        """Begin with the start weights of a job."""
        import torch
        from yolox.utils import ModelEMA

        self._job = job
        self._arguments = {k: float(str(v)) for k, v in job.arguments.items()}
        self.device = torch.device(f"cuda:{job.device}" if job.device.isdigit() else job.device)
        reseed(job, 0)
        network = make_network(job.network, len(job.classes))
        if job.model != job.network and (left := load_states(network, Path(job.model))):
            log.warning("%s: %d layers start from scratch: %s", job.model, len(left), ", ".join(left))
        # With the channels innermost, convolutions are faster on a processor.
        layout = torch.channels_last if job.device == "cpu" else torch.contiguous_format
        self._network = network.to(self.device, memory_format=layout)
        self._average = ModelEMA(self._network, _AVERAGE)
        weights = [p for p in self._network.parameters() if p.ndim > 1]
        rest = [p for p in self._network.parameters() if p.ndim <= 1]  # biases and normalization are not held small
        self._optimizer = torch.optim.AdamW(
            [{"params": weights, "weight_decay": self._arguments["weight_decay"]},
             {"params": rest, "weight_decay": 0.0}],
            betas=(self._arguments["momentum"], 0.999),
        )  # fmt: skip
        narrow = has_fast_bfloat16(torch) if job.device == "cpu" else job.device.isdigit()
        self.precision = "bfloat16" if narrow else "float32"

    @property
    def average(self) -> Any:
        """The averaged network, which is the result."""
        return self._average.ema

    def states(self) -> dict[str, Any]:
        """Return what `restore` needs to continue."""
        return {
            "network": self._network.state_dict(),
            "average": self.average.state_dict(),
            "updates": self._average.updates,
            "optimizer": self._optimizer.state_dict(),
        }

    def restore(self, states: dict[str, Any]) -> None:
        """Continue from the states of a checkpoint."""
        self._network.load_state_dict(states["network"])
        self.average.load_state_dict(states["average"])
        self._average.updates = states["updates"]
        self._optimizer.load_state_dict(states["optimizer"])

    def run_epoch(self, epoch: int, batches: Iterator[list[ShownPicture]], say: Say) -> dict[str, float]:
        """Train on the batches of an epoch, report once a second, and return the mean losses."""
        job = self._job
        steps = math.ceil(job.shown / job.batch)
        sums: Counter[str] = Counter()
        next_s = 0.0
        for step, pictures in enumerate(batches):
            sums.update(self.step(pictures, self.rate_at(epoch * steps + step, steps)))
            means = {k: round(v / (step + 1), 5) for k, v in sums.items()}
            if time.monotonic() >= next_s:
                next_s = time.monotonic() + 1.0
                done = epoch * job.shown + min((step + 1) * job.batch, job.shown)
                say("step", epoch=epoch + 1, epochs=job.epochs, images=done, losses=means)
        return means

    def rate_at(self, step: int, steps: int) -> float:
        """Return the learning rate of a step of the training: rising while it warms up, then falling in a line.

        Args:
            step: Number of the step, from 0.
            steps: Steps of an epoch.
        """
        a = self._arguments
        fall = 1 - (1 - a["lrf"]) * step / (steps * self._job.epochs)
        rise = min(1.0, (step + 1) / max(a["warmup_epochs"] * steps, 1))
        return a["lr0"] * fall * rise

    def step(self, pictures: Sequence[ShownPicture], rate: float) -> dict[str, float]:
        """Take one step with a batch, and return its losses."""
        import torch

        levels = torch.from_numpy(np.stack([p.levels for p in pictures])).to(self.device)
        x = levels[:, None].float().expand(-1, 3, -1, -1).contiguous(memory_format=torch.channels_last)
        targets = torch.from_numpy(targets_of(pictures)).to(self.device)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.precision == "bfloat16"):
            losses = self._network(x, targets)
        for group in self._optimizer.param_groups:
            group["lr"] = rate
        self._optimizer.zero_grad()
        losses["total_loss"].backward()
        torch.nn.utils.clip_grad_norm_(self._network.parameters(), _LONGEST_GRADIENT)
        self._optimizer.step()
        self._average.update(self._network)
        return {name: float(losses[theirs].detach()) for name, theirs in _LOSSES.items()}
