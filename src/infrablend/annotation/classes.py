"""Renaming and dropping of the classes of a dataset."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import replace

from infrablend.core.dataset import Category, Dataset
from infrablend.errors import Problem


def unknown_classes(dataset: Dataset, names: Collection[str]) -> list[str]:
    """Return the names that are not classes of the dataset, sorted."""
    return sorted(set(names) - {c.name for c in dataset.categories})


def rename_classes(dataset: Dataset, names: Mapping[str, str]) -> Dataset:
    """Return the dataset with classes renamed simultaneously, so that two classes can swap names.

    Classes renamed to the same name are merged. If a class that keeps its name is among them, its id and its `ignore`
    are kept. Otherwise the merged class has the id of the first one, and is ignored only if all of them are.

    Raises:
        ValueError: `names` contains a class that is not in the dataset.
    """
    if unknown := unknown_classes(dataset, names):
        raise ValueError(f"no such class: {', '.join(unknown)}")
    if not names:
        return dataset
    stay = {c.name: c for c in dataset.categories if names.get(c.name, c.name) == c.name}
    categories: dict[str, Category] = {}
    for c in dataset.categories:
        new = names.get(c.name, c.name)
        if new in stay:
            categories[new] = stay[new]
        elif new in categories:
            categories[new] = replace(categories[new], ignore=categories[new].ignore and c.ignore)
        else:
            categories[new] = replace(c, name=new)
    images = tuple(
        replace(
            image,
            instances=tuple(
                replace(i, category=names[i.category]) if names.get(i.category, i.category) != i.category else i
                for i in image.instances
            ),
        )
        for image in dataset.images
    )
    return replace(dataset, categories=tuple(categories.values()), images=images)


def ignored_turned_objects(dataset: Dataset, names: Mapping[str, str]) -> list[Problem]:
    """Return a warning for every region-to-ignore class that `rename_classes` turns into a class of objects."""
    renamed = {c.name: c for c in rename_classes(dataset, names).categories}
    count = Counter(i.category for image in dataset.images for i in image.instances)
    return [
        Problem(
            names[c.name],
            "ignore-renamed",
            f"{count[c.name]} region(s) to ignore ({c.name}) become objects of this class",
            "only objects in a class of objects",
            f"leave {c.name} its name, or drop it",
            "warning",
        )
        for c in dataset.categories
        if c.ignore and c.name in names and not renamed[names[c.name]].ignore
    ]


def drop_classes(dataset: Dataset, names: Collection[str]) -> Dataset:
    """Return the dataset without some classes and their objects; the ids of the other classes do not change.

    Raises:
        ValueError: `names` contains a class that is not in the dataset.
    """
    if unknown := unknown_classes(dataset, names):
        raise ValueError(f"no such class: {', '.join(unknown)}")
    images = tuple(
        replace(image, instances=tuple(i for i in image.instances if i.category not in names))
        for image in dataset.images
    )
    return replace(dataset, categories=tuple(c for c in dataset.categories if c.name not in names), images=images)
