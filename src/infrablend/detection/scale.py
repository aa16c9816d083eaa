"""The scale at which a detector sees pictures: the scale of its training unless another is requested.

Objects must have the same size for the network as in training. A detector trained on tiles at native resolution sees
pictures at their own size; one trained on whole pictures sees them scaled to the image size of its training.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from infrablend.config.agc import Agc, agc_from_json
from infrablend.core.files import read_object
from infrablend.errors import Problem

RECORD = "train.json"
JOB = "job.json"
CHECKPOINT = "checkpoint.pt"
NEW_CHECKPOINT = "checkpoint.new"
DAMAGED = "checkpoint.damaged.pt"
WEIGHTS = "weights.pt"
ONNX_WEIGHTS = "weights.onnx"
STATES = "weights.pth"  # of YOLOX, in its own format
LOG = "train.log"
DATA = "data"
TILES = "tiles"
EIGHT_BIT = "8bit"
RUN = "run"
ULTRALYTICS = "ultralytics"
WORKING_FILES = (DATA, TILES, EIGHT_BIT, RUN, ULTRALYTICS, CHECKPOINT, NEW_CHECKPOINT)
"""What only an unfinished training needs."""


# Default of Ultralytics, and the size in the paper.
DEFAULT_SIZE = 640
# Entry in the weights of `infrablend train`.
MARK = "infrablend"


@dataclass(frozen=True)
class Scale:
    """The size at which pictures go into the network.

    Attributes:
        image_size: Longer side of the pictures, px; 0 leaves every picture its own size.
        origin: Source of the size, as text for the report.
        known: Whether the size is known to be the scale of the training, or was requested.
    """

    image_size: int
    origin: str
    known: bool = True

    def warnings(self, weights: Path) -> list[Problem]:
        """Return a warning if the scale is a guess."""
        if self.known:
            return []
        found = f"{self.origin}; pictures are evaluated {self.text}"
        todo = "give the training size with --image-size (0 after training on tiles)"
        return [Problem(weights.name, "image-size-unknown", found, "a training scale", todo, severity="warning")]

    @property
    def text(self) -> str:
        """Size as text."""
        return f"with a longer side of {self.image_size} px" if self.image_size else "at their own size"


def training_scale(weights: Path, checkpoint: Mapping[str, object]) -> Scale:
    """Return the scale of a detector's training.

    Args:
        weights: File of weights; `infrablend train` writes its record beside it.
        checkpoint: Content of the file.
    """
    mark = checkpoint.get(MARK)
    settings = mark if isinstance(mark, Mapping) else _record_of(weights).get("settings")
    if isinstance(settings, Mapping):
        tile, size = (_side(settings.get(key)) for key in ("tile", "image_size"))
        if tile:
            return Scale(0, f"trained on tiles of {tile} px at native resolution")
        if size is None:
            return Scale(DEFAULT_SIZE, "the record of the training contains no size", known=False)
        return Scale(size, f"trained on whole pictures at {size} px")
    arguments = checkpoint.get("train_args")
    arguments = arguments if isinstance(arguments, Mapping) else {}
    size = _side(arguments.get("imgsz"))
    if size is None:
        return Scale(DEFAULT_SIZE, "the weights do not contain their training size", known=False)
    if _is_ours(arguments) and size != DEFAULT_SIZE:
        # Weights without the mark, separated from their record. `small` and `smoke` cut tiles.
        return Scale(0, "the record of the training is not beside the weights", known=False)
    return Scale(size, f"imgsz of the weights' training with Ultralytics: {size} px")


def training_agc(weights: Path, checkpoint: Mapping[str, object]) -> Agc | None:
    """Return the automatic gain control that a detector's 16-bit pictures went through; None for other detectors."""
    mark = checkpoint.get(MARK)
    found = mark.get("agc") if isinstance(mark, Mapping) else None
    found = _record_of(weights).get("agc") if found is None else found
    try:
        return agc_from_json(found) if isinstance(found, Mapping) else None
    except ValueError:
        return None


def _record_of(weights: Path) -> Mapping[str, object]:
    """Return the record of the training beside the weights of `infrablend train`; empty for other weights."""
    return (read_object(weights.with_name(RECORD)) or {}) if weights.name == WEIGHTS else {}


def _side(value: object) -> int | None:
    """Return a positive number of pixels, the larger one of a pair; None for other values."""
    sides = value if isinstance(value, list | tuple) and value else [value]
    whole = [v for v in sides if isinstance(v, int) and not isinstance(v, bool) and v > 0]
    return max(whole) if len(whole) == len(sides) else None


def _is_ours(arguments: Mapping[str, object]) -> bool:
    """Whether the arguments are those that `infrablend train` gives Ultralytics."""
    return arguments.get("name") == "run" and str(arguments.get("data")).replace("\\", "/").endswith("data/data.yaml")
