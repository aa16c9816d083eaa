"""Training with YOLOX: our own loop around the networks, the loss and the average of weights of `pixeltable-yolox`."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from infrablend.core.files import replace_atomically
from infrablend.core.rng import stream
from infrablend.detection.scale import CHECKPOINT, MARK, NEW_CHECKPOINT, STATES
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

_AVERAGE = 0.9999  # decay of the average of weights, which the package approaches over 2000 steps; as in Ultralytics
_LONGEST_GRADIENT = 10.0
_LOSSES = {"iou_loss": "box_loss", "conf_loss": "obj_loss", "cls_loss": "cls_loss"}


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
        training.load(torch.load(checkpoint, map_location="cpu", weights_only=False))
    changes = Changes(**{f.name: float(str(job.arguments[f.name])) for f in fields(Changes)})
    order = ShuffledPasses(job.images, job.shown, job.seed, reached.epochs)
    for epoch in range(reached.epochs, job.epochs):
        losses = training.run_epoch(epoch, _batches(shown, order, changes_of(job, changes, epoch), epoch, job), say)
        reached = Reached(epoch + 1, epoch + 1 == job.epochs, gate, losses, job.batch)
        with replace_atomically(
            checkpoint, beside=checkpoint.with_name(NEW_CHECKPOINT), durable=True
        ) as temporary:
            torch.save({**training.state(), REACHED: asdict(reached)}, temporary)
        say("epoch", epoch=epoch + 1, epochs=job.epochs, batch=job.batch, losses=losses, metrics={})
