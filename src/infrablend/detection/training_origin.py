"""What a detector was trained on, as far as the record of `infrablend train` beside its weights says."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from infrablend.core.files import read_object
from infrablend.core.run_folder import RUN_FILE
from infrablend.detection.scale import RECORD


@dataclass(frozen=True)
class TrainingOrigin:
    """Origin of a detector's training pictures.

    Attributes:
        data: Folder of the dataset it was trained on.
        real: Labels of real objects in its tiles or pictures, of both splits.
        inserted: Those of inserted objects.
        recipe: Name of the recipe that inserted them; empty if the run is not there any more.
    """

    data: str
    real: int
    inserted: int
    recipe: str = ""


def training_origin(detector: Path) -> TrainingOrigin | None:
    """Return the origin of a detector's training; None for a detector without a record.

    Args:
        detector: Folder of a training, or a file in it.
    """
    record = read_object((detector if detector.is_dir() else detector.parent) / RECORD)
    prepared = record.get("prepared") if record else None
    if not record or not isinstance(prepared, dict) or not isinstance(record.get("data"), str):
        return None
    data = str(record["data"])
    inserted = int(prepared.get("losses", {}).get("inserted_dropped", 0))
    run = read_object(Path(data) / RUN_FILE) if inserted else None
    recipe = run.get("recipe") if run else None
    name = recipe.get("name", "") if isinstance(recipe, dict) else ""
    labels = int(prepared.get("labels", 0)) + int(prepared.get("labels_val", 0))
    return TrainingOrigin(data, labels - inserted, inserted, str(name))
