"""The maker of merged datasets: the images of several data items in one dataset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from infrablend.config.experiment import Merge
from infrablend.core.dataset import Category, Dataset, ImageRecord
from infrablend.errors import DatasetError, Problem
from infrablend.formats.base import sort_images
from infrablend.pipeline.convert import convert_dataset
from infrablend.pipeline.dataset_requests import Selection
from infrablend.pipeline.experiments.dataset_facts import dataset_facts, read_dataset
from infrablend.pipeline.experiments.job import StageJob
from infrablend.pipeline.select import select


def make_merge(job: StageJob) -> dict[str, Any]:
    """Write the images of several data items as one dataset."""
    spec: Merge = job.stage.spec
    parts = []
    for k, (part, asked) in enumerate(zip(spec.parts, job.stage.inputs["parts"], strict=True)):
        source = job.needs[f"part{k}"]
        dataset = read_dataset(source.dataset, options=source.reader_options)
        images = [i for i in dataset.images if i.split in part.splits]
        dataset = replace(dataset, images=tuple(images))
        parts.append((part.of, draw_images(dataset, asked["images"], job.stage.inputs["seed"])))
    merged = merge_datasets(parts)
    if not merged.images:
        names = ", ".join(name for name, _ in parts)
        problem = Problem(job.stage.id, "split-empty", f"no image in the splits taken from {names}", "at least one")
        raise DatasetError(f"{job.stage.id}: cannot be used", [problem])
    convert_dataset(merged, "coco", job.empty_out())
    return {**dataset_facts(merged), "dataset": "out", "there": ["out"]}


def draw_images(dataset: Dataset, limits: Mapping[str, int], seed: int) -> Dataset:
    """Return at most `limits` images per split, drawn at random; smaller draws are parts of larger ones."""
    images: list[ImageRecord] = []
    for split in dict.fromkeys(i.split for i in dataset.images):
        of_split = replace(dataset, images=tuple(i for i in dataset.images if i.split == split))
        n = limits.get(split, len(of_split.images))
        drawn = of_split if n >= len(of_split.images) else select(of_split, Selection(images=n, seed=seed))[0]
        images += drawn.images
    return replace(dataset, images=tuple(images))


def merge_datasets(parts: Sequence[tuple[str, Dataset]]) -> Dataset:
    """Return one dataset with the images of several, each in a folder named after its part.

    Classes of the same name are one class, with the id of the first that has it; an id that is taken is replaced by the
    next free one. Such a class is ignored only if it is ignored in all datasets that have it.

    Args:
        parts: Names and datasets; a name that occurs again gets a number.
    """
    categories: dict[str, Category] = {}
    images = []
    names: list[str] = []
    for name, dataset in parts:
        folder = name if name not in names else f"{name}-{names.count(name) + 1}"
        names.append(name)
        for c in dataset.categories:
            if (known := categories.get(c.name)) is not None:
                categories[c.name] = replace(known, ignore=known.ignore and c.ignore)
                continue
            ids = {k.id for k in categories.values()}
            categories[c.name] = replace(c, id=c.id if c.id not in ids else max(ids) + 1)
        for image in dataset.images:
            images.append(replace(image, id=f"{folder}/{image.id}", file_name=f"{folder}/{image.name}"))
    first = parts[0][1]
    problems = tuple(p for _, dataset in parts for p in dataset.problems)
    return Dataset(first.root, first.format, tuple(categories.values()), sort_images(images), problems)
