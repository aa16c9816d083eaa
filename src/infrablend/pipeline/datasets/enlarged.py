"""How many boxes of a dataset's inserted objects are enlarged or fitted already, so that no step does it twice."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from infrablend.annotation.looseness import LOOSENED, is_loosened
from infrablend.core.dataset import Dataset
from infrablend.core.files import load_json
from infrablend.core.run_folder import EIGHT_BIT, RUN_FILE
from infrablend.core.workspace import CONVERT_FILE, SPLIT_FILE

AT_MOST = f"{LOOSENED}_at_most"
"""Name of the count in records where only the largest possible number is known."""


def count_enlarged(dataset: Dataset, part: Dataset | None = None) -> tuple[int, bool]:
    """Return how many boxes are enlarged or fitted, and whether this is only the largest possible number.

    COCO and shards mark such boxes. In other formats the record of the dataset's command has their number, but does
    not say which ones they are: any box of a part may be one.

    Args:
        dataset: Dataset as read.
        part: Part of it to count; all by default.
    """
    part = dataset if part is None else part
    if count_marked(dataset):
        return count_marked(part), False
    recorded, labels = _recorded(dataset)
    boxes = _boxes_of(part)
    if boxes == labels == _boxes_of(dataset):
        return recorded, False
    # Pictures may have been drawn several times.
    copies = max(Counter(i.path for i in part.images).values(), default=1)
    most = min(copies * recorded, boxes)
    return most, bool(most)


def enlarged_counts(enlarged: int, at_most: bool) -> dict[str, int]:
    """Return the result of `count_enlarged` for a record; nothing without enlarged boxes."""
    return {AT_MOST if at_most else LOOSENED: enlarged} if enlarged else {}


def count_marked(dataset: Dataset) -> int:
    """Return how many boxes are marked as changed, and so have their exact box beside them."""
    return sum(is_loosened(i) for image in dataset.images for i in image.instances)


def _recorded(dataset: Dataset) -> tuple[int, int | None]:
    """Return the number of enlarged boxes in the record of the dataset's command, and that of labels if it is exact."""
    root = dataset.root
    run = root.parent.parent if root.parent.name == EIGHT_BIT else root.parent
    for record in (root / CONVERT_FILE, root / SPLIT_FILE, root / RUN_FILE, run / RUN_FILE):
        try:
            counts = load_json(record)["counts"]
            if AT_MOST in counts:
                return int(counts[AT_MOST]), None
            enlarged, labels = int(counts[LOOSENED]), counts.get("labels")
            return enlarged, sum(map(int, labels.values())) if isinstance(labels, Mapping) else None
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            continue
    return 0, None


def _boxes_of(dataset: Dataset) -> int:
    return sum(len(image.instances) for image in dataset.images)
