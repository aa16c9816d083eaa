"""Presets for `--backend yolox`: the networks, and the arguments that its trainer knows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from infrablend.errors import OutputError, Problem
from infrablend.lab.training.presets import Preset

# Depth and width of a network of the size of YOLOv8n, which the package does not name: its `yolox_nano` has depthwise
# convolutions, which are slow on processors.
SHAPES = {"yolox_n": (0.33, 0.25)}
NETWORKS = (*SHAPES, "yolox_nano", "yolox_tiny", "yolox_s", "yolox_m", "yolox_l", "yolox_x")
# Arguments with the names, meanings and, except for the learning rate, defaults of Ultralytics.
ARGUMENTS: Mapping[str, float] = {
    "lr0": 0.002, "lrf": 0.01, "momentum": 0.9, "weight_decay": 0.0005, "warmup_epochs": 3.0, "mosaic": 1.0,
    "close_mosaic": 10, "scale": 0.5, "translate": 0.1, "fliplr": 0.5, "hsv_v": 0.4,
}  # fmt: skip
_STRIDE_PX = 32


def as_yolox(preset: Preset) -> Preset:
    """Return a preset of Ultralytics with the network of YOLOX of its size, and the arguments that both know."""
    arguments = {k: preset.arguments.get(k, v) for k, v in ARGUMENTS.items()}
    return replace(preset, model=f"yolox_{preset.model[-1]}", arguments=arguments)


def require_yolox_settings(preset: Preset, task: str) -> None:
    """Raise OutputError for a request that this back end does not fulfil, with all reasons."""
    problems = []
    if task != "detect":
        problems.append(Problem("--task", "setting-malformed", task, "detect", "take --backend ultralytics"))
    if preset.model not in NETWORKS:
        problems.append(Problem("--set model", "setting-malformed", preset.model, f"one of {', '.join(NETWORKS)}"))
    if preset.image_size % _STRIDE_PX:
        expected = f"a multiple of {_STRIDE_PX}"
        problems.append(Problem("--set image_size", "setting-malformed", str(preset.image_size), expected))
    if preset.patience:
        todo = "--set patience=0 --set passes=N, or --backend ultralytics"
        problems.append(
            Problem("--set patience", "setting-malformed", str(preset.patience), "0: it trains to the end", todo)
        )
    for name, value in preset.arguments.items():
        if name not in ARGUMENTS:
            expected = f"arguments of --backend yolox: {', '.join(ARGUMENTS)}"
            problems.append(Problem(f"--set {name}", "setting-malformed", "not one of them", expected))
        elif isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < float("inf"):
            problems.append(Problem(f"--set {name}", "setting-malformed", repr(value), "a number from 0 up"))
    if problems:
        raise OutputError("settings of the training", problems)
