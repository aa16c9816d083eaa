"""Presets of trainings, and estimates of their duration and disk space."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from infrablend.core.machine import usable_cores
from infrablend.core.operating_system import has_matrix_units
from infrablend.detection.detections import Task

PresetName = Literal["paper", "medium", "small", "smoke"]
Backend = Literal["ultralytics", "yolox"]
SUFFIX: Mapping[Task, str] = {"detect": "", "obb": "-obb", "segment": "-seg"}


@dataclass(frozen=True)
class Preset:
    """Settings of a training.

    Attributes:
        name: Name for `--preset`.
        summary: Description in one line.
        model: The library's name of the network, without the suffix of the task.
        image_size: Side of the network's square input, px.
        batch: Images per step.
        epochs: Maximum number of passes over the data; 0 if `passes` applies.
        passes: Total number of images shown, whatever the size of the dataset; 0 if `epochs` applies.
        patience: Epochs without improvement before the training stops; 0 trains to the end and keeps the last weights.
        tile: Side of the object-centred tiles in px at native resolution; 0 for whole pictures.
        tiles: Maximum number of tiles; 0 for all.
        arguments: Further arguments of Ultralytics, which has defaults for all others.
    """

    name: str
    summary: str
    model: str
    image_size: int
    batch: int
    epochs: int = 0
    passes: int = 0
    patience: int = 0
    tile: int = 0
    tiles: int = 0
    arguments: Mapping[str, object] = field(default_factory=dict)

    def epochs_for(self, images: int) -> tuple[int, int]:
        """Return the number of epochs, and of images (or tiles) shown per epoch, for a number of images.

        If `passes` applies, an epoch is a twentieth of them instead of one pass over the data: the learning rate falls
        by epoch, so trainings on different numbers of images would otherwise differ in their schedules, too. Every
        image is shown at least once.
        """
        if self.epochs:
            return self.epochs, images
        batches = math.ceil(max(self.passes, images) / ROUNDS / self.batch)
        return ROUNDS, batches * self.batch


# Epochs of a training with a fixed number of passes.
ROUNDS = 20

# Thermal pictures have no hue to change. The first epoch of a short training is its warm-up.
_SHORT_TRAINING = {
    "optimizer": "AdamW", "lr0": 0.002, "momentum": 0.9, "warmup_bias_lr": 0.0, "warmup_epochs": 1.0, "nbs": 16,
    "hsv_h": 0.0, "hsv_s": 0.0,
}  # fmt: skip
# The scale stays near 1 (`TrainRequest.fitted_to` widens it for pictures from above): tiles exist to preserve the sizes
# of objects, and with scales of 0.5 to 1.5 the border of a picture told a detector of drones how large objects are, so
# that it named 0.92 of them with and 0.74 without a border.
# Half of the images are mosaics of four tiles: without them, a detector learns which pictures have which class.
_TILE_ARGUMENTS = {**_SHORT_TRAINING, "scale": 0.2, "mosaic": 0.5, "close_mosaic": 0}

PRESETS: Mapping[str, Preset] = {
    p.name: p
    for p in (
        # "the 's' model variant, with a learning rate set to 0.002, a batch size of 64, and an image resolution of 640,
        # while keeping all other parameters at their default values", 1000 epochs, patience 100. Ultralytics' default
        # optimizer `auto` ignores a given learning rate, so the preset names an optimizer.
        Preset(
            "paper", "whole pictures as in the paper; for a GPU", "yolov8s", 640, 64, epochs=1000,
            patience=100, arguments={"optimizer": "AdamW", "lr0": 0.002},
        ),
        # Ultralytics' augmentation with mosaic, which ends in the last quarter.
        Preset(
            "medium", "whole pictures of 640 px, from given weights; hours on two cores", "yolov8n", 640, 16,
            passes=40_000, arguments={**_SHORT_TRAINING, "close_mosaic": 5},
        ),
        Preset(
            "small", "tiles of up to 320 px around objects; for two cores", "yolov8n", 320, 16, passes=16_000,
            tile=320, arguments=_TILE_ARGUMENTS,
        ),
        Preset(
            "smoke", "a few steps, to check that everything runs", "yolov8n", 160, 4, epochs=1, tile=160, tiles=8,
            arguments=_TILE_ARGUMENTS,
        ),
    )
}  # fmt: skip

_MOST_THREADS = 8  # of a training on a CPU, as in Ultralytics

# Images per second in training at 320 px, by model and device. YOLOv8n on two cores with matrix units for bfloat16: 21
# measured on one core, times 1.6. The others follow from Ultralytics' published speeds; YOLO11n, which has fewer
# operations in more layers, is taken as YOLOv8n, and YOLOX on a GPU as YOLOv8. Used for estimates only.
_RATE_320 = {
    ("yolov8n", "cpu"): 32.0, ("yolov8s", "cpu"): 10.0, ("yolo11n", "cpu"): 32.0,
    ("yolox_n", "cpu"): 38.0, ("yolox_n", "gpu"): 1200.0, ("yolox_s", "gpu"): 600.0,
    ("yolov8n", "gpu"): 1200.0, ("yolov8s", "gpu"): 600.0, ("yolo11n", "gpu"): 1200.0,
}  # fmt: skip
_WITHOUT_MATRIX_UNITS = 0.42


def cpu_threads() -> int:
    """Return the threads of a training on a CPU: what `OMP_NUM_THREADS` says, else one per core, at most eight."""
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return int(asked) if asked.isdecimal() and int(asked) else max(1, min(int(usable_cores()), _MOST_THREADS))


def estimate_seconds(preset: Preset, images: int, *, gpu: bool, threads: int = 2) -> float:
    """Estimate the wall-clock seconds of a training on that many pictures or tiles, within a factor of two."""
    rate = _RATE_320.get((preset.model, "gpu" if gpu else "cpu"), 5.0) * (320 / preset.image_size) ** 2
    rate *= 1 if gpu else threads / 2 * (1 if has_matrix_units() else _WITHOUT_MATRIX_UNITS)
    epochs, shown = preset.epochs_for(images)
    return 20 + epochs * shown / rate


# Parameters of YOLOv8 by size letter, in millions; later versions have fewer. YOLOX has about as many.
_PARAMETERS_M = {"yolox_nano": 0.9, "yolox_tiny": 5.1, "n": 3.2, "s": 11.2, "m": 25.9, "l": 43.7, "x": 68.2}


def weights_bytes(preset: Preset) -> float:
    """Estimate the peak disk space of a training's weights, in bytes.

    There are four checkpoints (Ultralytics' last and best, ours, and ours while it is replaced) with weights and the
    optimizer's two moments, and the final weights, all in half precision. YOLOX has two in single precision.
    """
    letter = preset.model[-1:]
    parameters_m = _PARAMETERS_M.get(preset.model, _PARAMETERS_M.get(letter, _PARAMETERS_M["x"]))
    return parameters_m * 1e6 * 2 * (4 * 3 + 1)
