"""Training with YOLOX: what it needs, which settings it takes, and how its networks become ONNX."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from infrablend.detection.detections import Task
from infrablend.detection.scale import ONNX_WEIGHTS, STATES
from infrablend.lab.training import start_weights
from infrablend.lab.training.presets import Preset
from infrablend.lab.training.start_weights import StartWeights
from infrablend.lab.training.yolox_network import network_as_onnx, require_yolox
from infrablend.lab.training.yolox_settings import require_yolox_settings


class YoloxBackend:
    """The networks of YOLOX."""

    weights = STATES
    result = ONNX_WEIGHTS

    def require_packages(self, *, export: bool) -> None:
        """Raise MissingDependencyError if a package is missing; each training writes ONNX."""
        require_yolox()

    def require_settings(self, preset: Preset, task: Task) -> None:
        """Raise OutputError for settings that the trainer does not take, with all reasons."""
        require_yolox_settings(preset, task)

    def require_start(self, wanted: str, preset: Preset, task: Task) -> None:
        """Raise FetchError for start weights that are not there."""
        start_weights.find_yolox_start(wanted, preset)

    def find_start(self, wanted: str, preset: Preset, task: Task) -> StartWeights:
        """Return the weights to start from; none are downloaded."""
        return start_weights.find_yolox_start(wanted, preset)

    def network_of(self, wanted: str, preset: Preset, task: Task) -> str:
        """Return the name of the network; weights do not bring one along."""
        return preset.model

    def as_onnx(self, weights: Path, side_px: int) -> Any:
        """Return the ONNX model of trained weights, for pictures of this side."""
        require_yolox()
        import onnx

        return onnx.load_from_string(network_as_onnx(weights, side_px))

    def onnx_metadata(self, side_px: int) -> dict[str, str]:
        """Return nothing: Deepness does not know what YOLOX expects and returns."""
        return {}
