"""The scale at which a detector sees pictures: the one it was trained at, unless somebody asks for another.

Objects have to be as large for the network as they were in training. A detector trained on tiles at native resolution
sees pictures at their own size; one trained on whole pictures sees them scaled to the size of its training.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from infrablend.errors import Problem

# The size of Ultralytics' defaults, and of the paper.
DEFAULT_SIZE = 640
# Entry of our own weights, and the record of a training beside them.
MARK, RECORD = "infrablend", "train.json"


@dataclass(frozen=True)
class Scale:
    """The size at which pictures go into the network.

    Attributes:
        image_size: Longer side of the pictures, px; 0 leaves every picture its own size.
        origin: Where that comes from, in words for the report.
        known: Whether it is known to be the scale of the training, or the one asked for.
    """

    image_size: int
    origin: str
    known: bool = True

    def warnings(self, weights: Path) -> list[Problem]:
        """Return the warning that the scale is a guess, if it is."""
        if self.known:
            return []
        found = f"{self.origin}; pictures are taken {self.text}"
        todo = "give the size it was trained at with --image-size (0 after training on tiles)"
        return [Problem(weights.name, "image-size-unknown", found, "a training scale", todo, severity="warning")]

    @property
    def text(self) -> str:
        """The size in words."""
        return f"with a longer side of {self.image_size} px" if self.image_size else "at their own size"


def training_scale(weights: Path, checkpoint: Mapping[str, object]) -> Scale:
    """Return the scale that a detector was trained at.

    Args:
        weights: File of weights; an InfraBlend training leaves its record beside it.
        checkpoint: What the file contains.
    """
    mark = checkpoint.get(MARK)
    if isinstance(mark, Mapping):
        return _of_settings(mark)
    arguments = checkpoint.get("train_args")
    arguments = arguments if isinstance(arguments, Mapping) else {}
    if weights.name == "weights.pt":
        settings = _recorded_settings(weights.with_name(RECORD))
        if settings is not None:
            return _of_settings(settings)
    size = _side(arguments.get("imgsz"))
    if size is None:
        return Scale(DEFAULT_SIZE, "the weights do not name the size they were trained at", known=False)
    if _is_ours(arguments) and size != DEFAULT_SIZE:
        # Trained before weights carried the mark, and away from their record: `small` and `smoke` cut tiles.
        return Scale(0, "the record of the training is not beside the weights", known=False)
    return Scale(size, f"imgsz of the weights' training with Ultralytics: {size} px")


def _of_settings(settings: Mapping[str, object]) -> Scale:
    tile, size = (_side(settings.get(key)) for key in ("tile", "image_size"))
    if tile:
        return Scale(0, f"trained on tiles of {tile} px at native resolution")
    if size is None:
        return Scale(DEFAULT_SIZE, "the record of the training names no size", known=False)
    return Scale(size, f"trained on whole pictures at {size} px")


def _recorded_settings(record: Path) -> Mapping[str, object] | None:
    try:
        settings = json.loads(record.read_text("utf-8"))["settings"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return settings if isinstance(settings, dict) else None


def _side(value: object) -> int | None:
    """Return a positive number of pixels, the longer of a pair; None for anything else."""
    sides = value if isinstance(value, list | tuple) and value else [value]
    whole = [v for v in sides if isinstance(v, int) and not isinstance(v, bool) and v > 0]
    return max(whole) if len(whole) == len(sides) else None


def _is_ours(arguments: Mapping[str, object]) -> bool:
    """Whether the arguments are those that `infrablend train` gives Ultralytics."""
    return arguments.get("name") == "run" and str(arguments.get("data")).replace("\\", "/").endswith("data/data.yaml")
