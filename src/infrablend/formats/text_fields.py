"""Replace texts in a dataset that label files cannot hold, and ids that mean none, so that writers never meet them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from infrablend.core.capture import Capture
from infrablend.core.dataset import Category, Dataset, Instance
from infrablend.core.file_names import escape_unfit
from infrablend.errors import Problem
from infrablend.formats.values import is_unassigned

_UNNAMED = "unnamed"


def with_fitting_fields(dataset: Dataset) -> Dataset:
    """Return the dataset with names of classes and texts that every format can hold, and a warning per change.

    Unfit characters are escaped, and blanks around names of classes removed. Track -1 is none.
    """
    names = _class_names(dataset.categories)
    counts: Counter[str] = Counter()
    images = []
    for image in dataset.images:
        instances = tuple(_instance(i, names, counts) for i in image.instances)
        capture = _capture(image.capture, counts)
        source_id = _fitting(image.source_id, counts)
        extra = _fitting(image.extra, counts)
        same = all(a is b for a, b in zip(instances, image.instances, strict=True))
        if not same or (capture, source_id, extra) != (image.capture, image.source_id, image.extra):
            image = replace(image, instances=instances, capture=capture, source_id=source_id, extra=extra)
        images.append(image)
    extra = _fitting(dataset.extra, counts) if dataset.extra else dataset.extra
    problems = [_renamed(old, new) for old, new in names.items()]
    if unassigned := counts["unassigned"]:
        found = f"{unassigned} object(s) with track -1, read as objects without a track"
        problems.append(Problem(dataset.root.name, "track-missing", found, "an id for each object", "", "warning"))
    if total := counts["text"]:
        found = f"{total} text(s) with control characters"
        expected = "texts that label files can hold"
        problems.append(Problem(dataset.root.name, "field-unfit", f"{found}, replaced", expected, "", "warning"))
    if not problems:
        return dataset
    categories = tuple(
        replace(c, name=names.get(c.name, c.name), supercategory=escape_unfit(c.supercategory))
        for c in dataset.categories
    )
    return replace(
        dataset,
        categories=categories,
        images=tuple(images),
        problems=(*dataset.problems, *problems),
        extra=extra,
    )


def _class_names(categories: Sequence[Category]) -> dict[str, str]:
    fitting = {c.name: escape_unfit(c.name.strip()) or _UNNAMED for c in categories}
    taken = {old for old, new in fitting.items() if old == new}
    names = {}
    for old, new in fitting.items():
        if old == new:
            continue
        name = new
        number = 2
        while name in taken:
            name = f"{new} {number}"
            number = number + 1
        taken.add(name)
        names[old] = name
    return names


def _renamed(old: str, new: str) -> Problem:
    found = f"class {old!a}, read as {new!a}"
    expected = "a name without control characters and blanks around it"
    return Problem("classes", "class-renamed", found, expected, "rename the class in the labels", "warning")


def _instance(instance: Instance, names: Mapping[str, str], counts: Counter[str]) -> Instance:
    category = names.get(instance.category, instance.category)
    extra = _fitting(instance.extra, counts)
    source_id = _fitting(instance.source_id, counts)
    counts["unassigned"] += is_unassigned(instance.track_id)
    track_id = None if is_unassigned(instance.track_id) else _fitting(instance.track_id, counts)
    if (category, extra, source_id, track_id) == (
        instance.category,
        instance.extra,
        instance.source_id,
        instance.track_id,
    ):
        return instance
    return replace(instance, category=category, extra=extra, source_id=source_id, track_id=track_id)


def _capture(capture: Capture, counts: Counter[str]) -> Capture:
    """Return the facts with fitting texts; the same object if all fit."""
    facts = capture.to_json()
    changed = {k: fitting for k, v in facts.items() if (fitting := _fitting(v, counts)) is not v}
    return replace(capture, **changed) if changed else capture


def _fitting(value: Any, counts: Counter[str]) -> Any:
    """Return the value with unfit texts replaced, counted in `counts`; the same object if all fit."""
    if isinstance(value, str):
        fitting = escape_unfit(value)
        counts["text"] += fitting != value
        return fitting if fitting != value else value
    if isinstance(value, Mapping):
        items = {_fitting(k, counts): _fitting(v, counts) for k, v in value.items()}
        same = all(items.get(k) is v for k, v in value.items())
        return value if same else items
    if isinstance(value, list | tuple):
        values = [_fitting(v, counts) for v in value]
        same = all(a is b for a, b in zip(values, value, strict=True))
        return value if same else values
    return value
