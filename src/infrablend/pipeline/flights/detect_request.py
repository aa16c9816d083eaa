"""What `detect` is asked to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from infrablend.core.arguments import require_names
from infrablend.detection.finder import OVERLAP_PX
from infrablend.errors import ArgumentError


@dataclass(frozen=True)
class DetectRequest:
    """How to detect.

    Attributes:
        confidence: Lowest score in the table and the page; predictions.json has all from 0.01.
        device: auto, cpu, cuda, and for weights cuda:1 or mps.
        classes: Names of the detector's classes in its order, for a file that has none.
        image_size: Longer side of the pictures for the network, 0 for their own size [default: as in the training].
        overlap: Least overlap of an ONNX file's tiles: twice the size of the largest object.
        tracks: Follow objects through each sequence (extras train and tracks); all frames of videos are then read.
        threads: Threads of an ONNX file's network, 0 for one per core.

    Raises:
        ArgumentError: A value is out of its range, or `classes` is no list of names.
    """

    confidence: float = 0.25
    device: str = "auto"
    classes: Sequence[str] | None = None
    image_size: int | None = None
    overlap: int = OVERLAP_PX
    tracks: bool = False
    threads: int = 0

    def __post_init__(self) -> None:
        require_names("classes", self.classes)
        if not 0 < self.confidence < 1:
            raise ArgumentError(f"confidence: found {self.confidence:g}, expected a number between 0 and 1")
        for name, value in (("image_size", self.image_size or 0), ("overlap", self.overlap), ("threads", self.threads)):
            if value < 0:
                raise ArgumentError(f"{name}: found {value}, expected 0 or more")


DEFAULT_DETECT: DetectRequest = DetectRequest()
