"""How many boxes of a dataset's inserted objects are enlarged or fitted already, so that no step does it twice."""

from __future__ import annotations

from infrablend.annotation.looseness import is_loosened
from infrablend.core.dataset import Dataset
from infrablend.core.files import load_json
from infrablend.core.finished import CONVERT_FILE, SPLIT_FILE
from infrablend.core.run_layout import EIGHT_BIT, RUN_FILE


def count_enlarged(dataset: Dataset, part: Dataset | None = None) -> int:
    """Return how many boxes are enlarged or fitted: by their marks, or else by the record of the dataset's command.

    COCO and shards mark such boxes, other formats do not: any box of a `part` of these may be an enlarged one.
    """
    part = dataset if part is None else part
    if count_marked(dataset):
        return count_marked(part)
    recorded = _recorded(dataset)
    return recorded if is_whole(part, dataset) or not recorded else _boxes_of(part)


def is_whole(part: Dataset, dataset: Dataset) -> bool:
    """Return whether a part of a dataset has all of its pictures and boxes."""
    return len(part.images) == len(dataset.images) and _boxes_of(part) == _boxes_of(dataset)


def _boxes_of(dataset: Dataset) -> int:
    return sum(len(image.instances) for image in dataset.images)


def count_marked(dataset: Dataset) -> int:
    """Return how many boxes are marked as changed, and so have their exact box beside them."""
    return sum(is_loosened(i) for image in dataset.images for i in image.instances)


def _recorded(dataset: Dataset) -> int:
    root = dataset.root
    run = root.parent.parent if root.parent.name == EIGHT_BIT else root.parent
    for record in (root / CONVERT_FILE, root / SPLIT_FILE, root / RUN_FILE, run / RUN_FILE):
        try:
            return int(load_json(record)["counts"]["boxes_loosened"])
        except (OSError, ValueError, KeyError, TypeError):
            continue
    return 0
