"""YOLOX of the package `pixeltable-yolox` (Apache-2.0): its networks, their weights, and their export as ONNX."""

from __future__ import annotations

import warnings
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any

from infrablend.detection.ultralytics_environment import replace_broken_torchvision
from infrablend.errors import MissingDependencyError, ModelError, RenderError
from infrablend.lab.training.yolox_settings import SHAPES


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
    config.depth, config.width = SHAPES.get(name, (config.depth, config.width))
    network = config.get_model()
    network.head.__class__ = Head
    return network


def load_states(network: Any, path: Path) -> list[str]:
    """Load weights of this or another training of the same network, and return the layers that stay as they were.

    These have another shape, like the last layers for other classes.

    Raises:
        ModelError: The file has no weights of the network.
    """
    import torch

    try:
        found = torch.load(path, map_location="cpu", weights_only=True)["model"]
        own = network.state_dict()
        fitting = {k: v for k, v in found.items() if k in own and v.shape == own[k].shape}
    except Exception as error:  # a pickle can contain anything
        raise ModelError(f"--weights {path}: no weights of YOLOX: {' '.join(str(error).split())[:200]}") from error
    if not any(k.startswith("backbone.") for k in fitting):
        raise ModelError(f"--weights {path}: weights of another network; expected those of --set model")
    network.load_state_dict(fitting, strict=False)
    return sorted({*own} - {*fitting})


def network_as_onnx(weights: Path, side_px: int) -> bytes:
    """Return the network of finished weights as ONNX; its output has decoded boxes in px and scores.

    Args:
        weights: File that the trainer wrote.
        side_px: Side of the square input, px.

    Raises:
        RenderError: torch cannot express the network as ONNX.
    """
    import torch

    stored = torch.load(weights, map_location="cpu", weights_only=True)
    network = make_network(stored["network"], len(stored["classes"]))
    network.load_state_dict(stored["model"])
    made = BytesIO()
    picture = torch.zeros(1, 3, side_px, side_px)
    with warnings.catch_warnings():
        # torch prefers its new exporter, which needs more packages.
        warnings.simplefilter("ignore")
        try:
            torch.onnx.export(
                network.eval(), (picture,), made, dynamo=False, opset_version=17,
                input_names=["images"], output_names=["output"],
            )  # fmt: skip
        except Exception as error:  # torch's exporter raises what it likes
            raise RenderError(f"{weights}: cannot be exported as ONNX: {error}") from error
    return made.getvalue()
