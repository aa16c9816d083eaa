"""Renaming, joining and dropping classes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from infrablend.annotation.classes import drop_classes, rename_classes
from infrablend.core.dataset import Category, Dataset, ImageRecord, Instance

CATEGORIES = (
    Category(0, "Person"),
    Category(1, "Car", "Vehicle"),
    Category(3, "Van", "Vehicle"),
    Category(4, "DontCare", "", True),
)


def dataset() -> Dataset:
    instances = tuple(Instance(c.name, np.array([1.0, 2, 3, 4]), source_id=c.id) for c in CATEGORIES)
    image = ImageRecord("a", Path("a.png"), "train", (64, 48), instances)
    return Dataset(Path(), "yolo", CATEGORIES, (image,))


def names(data: Dataset) -> list[str]:
    return [i.category for i in data.images[0].instances]


def test_several_become_one_and_keep_the_first_id() -> None:
    data = rename_classes(dataset(), {"Car": "vehicle", "Van": "vehicle"})
    assert data.categories == (CATEGORIES[0], Category(1, "vehicle", "Vehicle"), CATEGORIES[3])
    assert names(data) == ["Person", "vehicle", "vehicle", "DontCare"]
    assert [i.source_id for i in data.images[0].instances] == [0, 1, 3, 4]


def test_one_that_joins_an_existing_class_takes_its_id() -> None:
    data = rename_classes(dataset(), {"Person": "Van", "DontCare": "Van"})
    assert data.categories == (CATEGORIES[2], CATEGORIES[1])
    assert names(data) == ["Van", "Car", "Van", "Van"]


def test_two_can_change_places() -> None:
    data = rename_classes(dataset(), {"Car": "Van", "Van": "Car"})
    assert [(c.id, c.name) for c in data.categories] == [(0, "Person"), (1, "Van"), (3, "Car"), (4, "DontCare")]
    assert names(data) == ["Person", "Van", "Car", "DontCare"]


def test_ignored_class_stays_ignored_only_if_not_merged() -> None:
    assert rename_classes(dataset(), {"DontCare": "crowd"}).category("crowd").ignore
    assert not rename_classes(dataset(), {"DontCare": "crowd", "Person": "crowd"}).category("crowd").ignore


def test_dropped_classes_go_with_their_objects() -> None:
    data = drop_classes(dataset(), ["Car", "DontCare"])
    assert names(data) == ["Person", "Van"]
    assert [c.id for c in data.categories] == [0, 3]


@pytest.mark.parametrize("change", [lambda d: rename_classes(d, {"car": "x"}), lambda d: drop_classes(d, ["car"])])
def test_unknown_class_is_refused(change) -> None:
    with pytest.raises(ValueError, match="no such class: car"):
        change(dataset())
