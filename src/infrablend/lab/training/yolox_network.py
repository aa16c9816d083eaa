"""YOLOX of the package `pixeltable-yolox` (Apache-2.0): its networks, their weights, and their export as ONNX."""

from __future__ import annotations

import warnings
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any

from infrablend.detection.ultralytics_environment import replace_broken_torchvision
from infrablend.errors import MissingDependencyError, ModelError

# Depth and width of a network of the size of YOLOv8n, which the package does not name: its `yolox_nano` has depthwise
# convolutions, which are slow on processors.
_SMALLEST = {"yolox_n": (0.33, 0.25)}
NETWORKS = (*_SMALLEST, "yolox_nano", "yolox_tiny", "yolox_s", "yolox_m", "yolox_l", "yolox_x")


def missing_packages() -> list[str]:
    """Return which of the packages for training and export are not installed."""
    packages = {"pixeltable-yolox": "yolox", "torch": "torch", "onnx": "onnx", "onnxruntime": "onnxruntime"}
    return [package for package, module in packages.items() if find_spec(module) is None]


def require_yolox() -> None:
    """Raise MissingDependencyError with the command to run if a package is missing."""
    if missing := missing_packages():
        raise MissingDependencyError(
            f"{' and '.join(missing)} not installed, which --backend yolox needs; install with\n"
            '  pip install "infrablend[train-yolox]"'
        )


def make_network(name: str, classes: int) -> Any:
    """Return a network in training mode with random weights.

    Its head computes boxes and loss in float32 wherever the layers before them run in bfloat16, which has eight
    significant bits: boxes of 10 px would move.
    """
    replace_broken_torchvision()
    import torch
    from yolox.config import YoloxConfig
    from yolox.models import YoloxHead

    class Head(YoloxHead):  # type: ignore[misc]
        def get_output_and_grid(self, output: Any, k: int, stride: int, dtype: str) -> Any:
            return super().get_output_and_grid(output.float(), k, stride, dtype.replace("BFloat16", "Float"))

        def get_losses(self, imgs: Any, x: Any, y: Any, strides: Any, labels: Any, *more: Any, dtype: Any) -> Any:
            x, y, strides = ([v.float() for v in values] for values in (x, y, strides))
            with torch.autocast(labels.device.type, enabled=False):
                return super().get_losses(imgs, x, y, strides, labels, *more, dtype=torch.float32)

    config = YoloxConfig.get_named_config(name) or YoloxConfig(name)
    config.num_classes = classes
    config.depth, config.width = _SMALLEST.get(name, (config.depth, config.width))
    network = config.get_model()
    network.head.__class__ = Head
    return network
