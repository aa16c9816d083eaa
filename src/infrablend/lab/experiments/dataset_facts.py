"""Facts of datasets that stages record, and the evenly spread part of a dataset that a limited source uses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import cast

from infrablend.annotation.looseness import loosened_counts
from infrablend.core.dataset import SPLITS, Dataset, ImageRecord
from infrablend.formats import dataset_folder
from infrablend.formats.read_write import Reading
from infrablend.lab.experiments.result_record import DataResult, DatasetFacts


def read_dataset(
    folder: Path, *, splits: Sequence[str] | None = None, options: Mapping[str, str] | None = None
) -> Dataset:
    """Return the dataset in a folder, its format detected."""
    return dataset_folder.read(folder, Reading(splits=splits, options=options or {}))


def dataset_facts(dataset: Dataset) -> DatasetFacts:
    """Return images and labels per split, classes and kinds of labels. Regions to ignore are not a class."""
    ignored = {c.name for c in dataset.categories if c.ignore}
    objects = [o for i in dataset.images for o in i.instances if o.category not in ignored]
    labels: dict[str, dict[str, int]] = {}
    for split in SPLITS:
        found = Counter(o.category for i in dataset.images if i.split == split for o in i.instances)
        labels[split] = {n: k for n, k in sorted(found.items()) if n not in ignored}
    kinds = {
        "AABB": bool(objects),
        "OBB": any(o.corners_xy is not None for o in objects),
        "Masks": any(o.mask is not None for o in objects),
    }
    return {
        "images": {s: n for s in SPLITS if (n := sum(i.split == s for i in dataset.images))},
        "labels": labels,
        "classes": [c.name for c in dataset.categories if not c.ignore],
        "label_kinds": [k for k, present in kinds.items() if present],
        "format": dataset.format,
    }


def data_result(dataset: Dataset, folder: str = "out", counts: Mapping[str, object] | None = None) -> DataResult:
    """Return the result of a stage that makes data.

    Args:
        dataset: The data.
        folder: Where they are, relative to the stage's folder.
        counts: What was counted on the way; those of loosened boxes are recorded.
    """
    facts = dataset_facts(dataset)
    result = {**facts, **loosened_counts(counts or {}), "dataset": folder, "there": [folder]}
    return cast("DataResult", result)


def spread_images(dataset: Dataset, limits: Mapping[str, int]) -> Iterator[ImageRecord]:
    """Yield up to `limits` images per split: first one per class, rarest class first, then evenly spread ones."""
    for split in SPLITS:
        images = [i for i in dataset.images if i.split == split]
        n = limits.get(split, len(images))
        if len(images) <= n:
            yield from images
            continue
        counts = Counter(o.category for i in images for o in i.instances)
        chosen: set[int] = set()
        for name, _ in sorted(counts.items(), key=lambda pair: (pair[1], pair[0])):
            if len(chosen) < n and not any(o.category == name for k in chosen for o in images[k].instances):
                chosen.add(next(k for k, i in enumerate(images) if any(o.category == name for o in i.instances)))
        for k in range(n):
            if len(chosen) < n:
                wanted = k * len(images) // n
                chosen.add(min((j for j in range(len(images)) if j not in chosen), key=lambda j: (abs(j - wanted), j)))
        yield from (images[k] for k in sorted(chosen))
