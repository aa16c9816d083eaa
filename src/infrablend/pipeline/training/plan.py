"""Plan of a training: number of images, epochs, time and disk space."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from infrablend.core.dataset import Dataset
from infrablend.core.machine import available_cores
from infrablend.core.output import Existing
from infrablend.pipeline.training.data import most_tiles, select_training_data
from infrablend.pipeline.training.folder import earlier_training
from infrablend.pipeline.training.requirements import choose_device, require_settings
from infrablend.training import presets, tiles, weights
from infrablend.training.presets import Preset
from infrablend.training.request import TrainRequest


@dataclass(frozen=True)
class TrainPlan:
    """Plan of a training.

    Attributes:
        images: Number of pictures, or of tiles cut from them, in the train split.
        labels: Number of labels in the train split.
        epochs: Maximum number of epochs.
        shown: Images shown per epoch.
        tiled: Whether `images` are tiles.
        device: Ultralytics' name of the device.
        seconds: Estimated duration, s.
        disk_bytes: Estimated peak disk space, bytes.
    """

    images: int
    labels: int
    epochs: int
    shown: int
    tiled: bool
    device: str
    seconds: float
    disk_bytes: int


def plan_training(
    dataset: Dataset, request: TrainRequest, *, out: Path | None = None, existing: Existing = "refuse"
) -> TrainPlan:
    """Return what `train_dataset` would do, without doing it; whatever it would refuse is refused here too.

    Two checks are left to the training: arguments of Ultralytics where that is not installed, and whether published
    weights can be downloaded.
    """
    preset = request.chosen_preset()
    device = choose_device(request.device, planning=True)
    require_settings(preset)
    weights.require_known(request.weights)
    if out is not None and out.is_dir():
        earlier_training(out, existing)
    wanted, _ = select_training_data(dataset, preset, request.task, request.classes, request.agc)
    return plan_of(wanted, preset, device, request.seed)


def plan_of(wanted: Dataset, preset: Preset, device: str, seed: int) -> TrainPlan:
    """Return the plan of a training on selected data; see `select_training_data`."""
    parts = {s: [i for i in wanted.images if i.split == s] for s in ("train", "val")}
    if preset.tile:
        cut = {s: tiles.plan_tiles(p, preset.tile, seed=seed, most=most_tiles(preset, s)) for s, p in parts.items()}
        images, size = len(cut["train"]), sum(len(c) for c in cut.values()) * preset.tile**2
    else:
        images, size = len(parts["train"]), sum(i.path.stat().st_size for i in wanted.images if i.path.is_file())
    labels = sum(len(i.instances) for i in parts["train"])
    epochs, shown = preset.epochs_for(images)
    return TrainPlan(
        images=images, labels=labels, epochs=epochs, shown=shown, tiled=preset.tile > 0, device=device,
        seconds=presets.estimate_seconds(preset, images, gpu=device != "cpu", cores=available_cores()),
        disk_bytes=round(size + presets.weights_bytes(preset)),
    )  # fmt: skip
