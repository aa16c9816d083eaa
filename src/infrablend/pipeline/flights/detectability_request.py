"""Request for the detectability of a recipe's objects: what counts, and in which pictures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from infrablend.core.arguments import require_whole
from infrablend.errors import ArgumentError
from infrablend.formats.read_write import READ_ALL, Reading
from infrablend.pipeline.plans.run_request import DEFAULT_EXECUTION, Execution, Settings
from infrablend.pipeline.plans.selection import ALL_FRAMES, FrameSelection

CONFIDENCES = (0.1, 0.25, 0.4)
_SEED = 1_000_003


@dataclass(frozen=True)
class DetectabilitySettings:
    """Settings of `detectability`.

    Attributes:
        until: Insert until half of the interval of the share found is at most this.
        confidence: Least score of a detection that counts as one.
        category: Class to look for [default: that of the recipe's first object].
        least_overlap: Least overlap of a detection with its object.
        most_rounds: Most times that each picture is used, each time with other objects.
        group: Pictures whose results depend on each other: image, sequence, date or gap.
        sizes: Sizes of objects to weight by: those of the labelled objects (real), or of the inserted ones (inserted).
        looks: flight: an object stays at its place through all pictures that show it; single: each picture has its own;
            auto: flight for pictures with poses that overlap, else single.
        sectors: GeoJSON file with the sectors of a search, to give figures for each.
        cell_m: Side of a cell of the map, metres [default: some 2,500 cells].

    Raises:
        ArgumentError: A value is not one of these.
    """

    until: float = 0.03
    confidence: float = 0.25
    category: str | None = None
    least_overlap: float = 0.3
    most_rounds: int = 10
    group: Literal["image", "sequence", "date", "gap"] = "image"
    sizes: Literal["real", "inserted"] = "real"
    looks: Literal["auto", "single", "flight"] = "auto"
    sectors: Path | None = None
    cell_m: float | None = None

    def __post_init__(self) -> None:
        require_whole("most_rounds", self.most_rounds, 1)
        if self.cell_m is not None and not 0.01 <= self.cell_m <= 1000:
            raise ArgumentError(f"cell_m: found {self.cell_m}, expected metres from 0.01 to 1000")
        for name, low, high in (("until", 0.0, 0.5), ("confidence", 0.01, 1.0), ("least_overlap", 0.0, 1.0)):
            value = getattr(self, name)
            if not low < value <= high and not (name == "confidence" and value == low):
                raise ArgumentError(f"{name}: found {value}, expected a number above {low:g} and up to {high:g}")

    @property
    def confidences(self) -> tuple[float, ...]:
        """Confidences to report, in ascending order."""
        return tuple(sorted({*CONFIDENCES, self.confidence}))


DEFAULT_DETECTABILITY = DetectabilitySettings()


@dataclass(frozen=True)
class DetectabilityRequest:
    """Request for the detectability of a recipe's objects.

    Attributes:
        recipe: Name of a shipped recipe, or path of a YAML file.
        detector: Weights, an ONNX file, or the folder of a training.
        data: Folder of the pictures.
        settings: What counts, and how narrow the interval has to be.
        recipe_settings: Recipe fields to set.
        selection: Pictures to use.
        reading: How to read the pictures.
        execution: Workers and renderer of the inserted objects.
        device: Device of the detector.
        classes: Names of the classes of a detector that has none.
        seed: Seed of the objects, their places and the order of the pictures.
    """

    recipe: str | Path
    detector: Path
    data: Path
    settings: DetectabilitySettings = DEFAULT_DETECTABILITY
    recipe_settings: Settings = ()
    selection: FrameSelection = ALL_FRAMES
    reading: Reading = READ_ALL
    execution: Execution = DEFAULT_EXECUTION
    device: str = "auto"
    classes: tuple[str, ...] = ()
    seed: int = 0

    @property
    def trial_seed(self) -> int:
        """Seed of the objects: others than those of a run with the same seed, on which a detector may be trained."""
        return _SEED + self.seed
