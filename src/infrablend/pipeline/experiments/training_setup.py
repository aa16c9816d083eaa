"""Preset and time of a training stage, and whether it can run on this machine."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from infrablend.config.experiment import Training
from infrablend.core.machine import available_cores
from infrablend.errors import InfraBlendError
from infrablend.pipeline.detectors.training_plan import require_settings
from infrablend.pipeline.experiments.request import ExperimentRequest
from infrablend.pipeline.experiments.stage import Stage
from infrablend.training.predict import pick_device
from infrablend.training.presets import Preset, estimate_seconds, tiles_expected
from infrablend.training.request import choose_preset
from infrablend.training.weights import require_ultralytics


def training_preset(spec: Training, request: ExperimentRequest) -> Preset:
    """Return the preset of a training: the scale's, with the experiment's settings, then the user's."""
    return choose_preset(request.scale, preset_settings(spec, request))


def preset_settings(spec: Training, request: ExperimentRequest) -> dict[str, Any]:
    """Return the settings of a training: the experiment's, then the user's."""
    return {**spec.settings, **request.training}


def preset_inputs(preset: Preset) -> dict[str, Any]:
    """Return everything of a preset that decides a training, as plain JSON."""
    return {k: v for k, v in asdict(preset).items() if k != "summary"}


def training_seconds(preset: Preset, images: int, *, gpu: bool) -> float:
    """Estimate the seconds of a training on that many images."""
    shown = tiles_expected(images, 5 * images) if preset.tile else images
    shown = min(shown, preset.tiles) if preset.tiles else shown
    return estimate_seconds(preset, shown, gpu=gpu, cores=available_cores())


def runs_on_gpu(device: str) -> bool:
    """Return True if networks run on a GPU; False also if nothing can be trained at all."""
    if device == "cpu":
        return False
    try:
        return pick_device(device) != "cpu"
    except InfraBlendError:  # reported where a training is required, not where its time is estimated
        return False


def require_trainer(device: str) -> None:
    """Check that Ultralytics and the device are available, before anything is made.

    Raises:
        MissingDependencyError: One of them is not.
    """
    require_ultralytics()
    pick_device(device)


def require_training_settings(stages: Iterable[Stage], request: ExperimentRequest) -> None:
    """Check the settings of all trainings now rather than hours later; without Ultralytics only our own fields.

    Raises:
        OutputError: The trainer does not know a setting.
    """
    for stage in stages:
        if stage.kind == "train":
            require_settings(training_preset(stage.spec, request))
