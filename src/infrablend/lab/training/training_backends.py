"""The libraries that train detectors, by the name that `--backend` gives them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from infrablend.detection.detections import Task
from infrablend.lab.training.presets import Backend, Preset
from infrablend.lab.training.start_weights import StartWeights
from infrablend.lab.training.ultralytics_backend import UltralyticsBackend
from infrablend.lab.training.yolox_backend import YoloxBackend


class TrainingBackend(Protocol):
    """A library that trains detectors.

    Attributes:
        weights: Name of the file that the trainer leaves, in the library's own format.
        result: Name of the file that `infrablend detect` reads.
    """

    weights: str
    result: str

    def require_packages(self, *, export: bool) -> None:
        """Raise MissingDependencyError if a package that a training needs is missing."""

    def require_settings(self, preset: Preset, task: Task) -> None:
        """Raise OutputError for settings that the library does not take."""

    def require_start(self, wanted: str, preset: Preset, task: Task) -> None:
        """Raise FetchError or ModelError for start weights that cannot be used; nothing is downloaded."""

    def find_start(self, wanted: str, preset: Preset, task: Task) -> StartWeights:
        """Return the weights to start from."""

    def network_of(self, wanted: str, preset: Preset, task: Task) -> str:
        """Return the name of the network that a training from these weights has; empty if not yet known."""

    def as_onnx(self, weights: Path, side_px: int) -> Any:
        """Return trained weights as an `onnx.ModelProto` for square pictures of this side."""

    def onnx_metadata(self, side_px: int) -> dict[str, str]:
        """Return what other programs read of the ONNX file, by key; values are JSON."""


BACKENDS: Mapping[Backend, TrainingBackend] = {"ultralytics": UltralyticsBackend(), "yolox": YoloxBackend()}
