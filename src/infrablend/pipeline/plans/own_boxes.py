"""Finds how loosely people drew the boxes of a dataset, for `labels.loosen: auto`."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from infrablend.annotation.looseness import BY_SIZE, TYPICAL_TEXT, BySize
from infrablend.annotation.measured_looseness import MIN_BOXES, BoxExtent, box_extent, typical_looseness
from infrablend.compositing.mapping import measure_levels
from infrablend.compositing.object_contrast import LEAST_PX, ObjectContrast, eight_bit, object_contrast
from infrablend.config.recipe import MAX_LOOSEN, MAX_LOOSEN_PX, Recipe
from infrablend.core.dataset import Dataset, ImageRecord, Instance
from infrablend.errors import DatasetError
from infrablend.pipeline.plans.backgrounds import Load, load_file

MAX_BOXES = 400
"""Largest number of labels that are measured for a class, evenly spread over the pictures."""


@dataclass(frozen=True, eq=False)
class OwnBoxes:
    """The boxes that people drew in a dataset, those of train if there are any; what is visible is measured once.

    Attributes:
        dataset: Dataset as read.
        load: Loads a picture.
    """

    dataset: Dataset
    load: Load = load_file
    _found: dict[frozenset[str], Sequence[BoxExtent]] = field(default_factory=dict)

    @property
    def classes(self) -> frozenset[str]:
        """The classes of objects, without those that mark regions to ignore."""
        return frozenset(c.name for c in self.dataset.categories if not c.ignore)

    def of(self, classes: frozenset[str]) -> Sequence[BoxExtent]:
        """Return the boxes and visible extents of objects of some classes."""
        if classes not in self._found:
            self._found[classes] = list(self._measured(classes))
        return self._found[classes]

    def _measured(self, classes: Collection[str]) -> Iterator[BoxExtent]:
        labels = [
            (image, label)
            for image in sorted(self.dataset.images, key=lambda i: (i.split, i.id))
            for label in sorted(image.instances, key=lambda i: i.box_xyxy.tolist())
            if label.category in classes and _is_drawn(label)
        ]
        # Those of val and test are for measuring a detector, and must not decide how it is trained.
        labels = [(image, label) for image, label in labels if image.split == "train"] or labels
        count = min(len(labels), MAX_BOXES)
        chosen: dict[int, tuple[ImageRecord, list[Instance]]] = {}
        for image, label in (labels[k * len(labels) // count] for k in range(count)):
            chosen.setdefault(id(image), (image, []))[1].append(label)
        for image, of_image in chosen.values():
            with contextlib.suppress(DatasetError):  # reported when a frame is made of it
                pixels = self.load(image).pixels
                picture = eight_bit(pixels, measure_levels([pixels]))
                for label in of_image:
                    if (contrast := object_contrast(picture, label, image.instances)) is None:
                        continue
                    of = ObjectContrast(label.category, f"{image.split}/{image.id}", "unknown", contrast, 0.0)
                    if (extent := box_extent(picture, label, image.instances, of)) is not None:
                        yield extent


def _is_drawn(label: Instance) -> bool:
    """Return whether a person has drawn the box of a whole object that is large enough to be measured."""
    x0, y0, x1, y1 = label.box_xyxy
    return not (label.inserted or label.truncated or label.is_crowd) and max(x1 - x0, y1 - y0) >= LEAST_PX


def with_measured_boxes(recipe: Recipe, classes: Collection[str], boxes: OwnBoxes) -> tuple[Recipe, str]:
    """Return a recipe with numbers in place of `labels.loosen: auto`, and in a sentence for each where they are from.

    Args:
        recipe: The recipe; one without `auto` stays as it is, and has no sentence.
        classes: Classes of the inserted objects.
        boxes: The boxes of the dataset.
    """
    labels = recipe.labels
    if labels.loosen != "auto":
        return recipe, ""
    stated = labels.loosen_px
    margins: dict[str, Any] = dict(stated) if isinstance(stated, Mapping) else dict.fromkeys(classes, stated)
    factors: dict[str, float] = {}
    texts: dict[str, list[str]] = {}
    for name in dict.fromkeys(classes):
        if not margins.get(name):
            factors[name], margins[name], text = _looseness_like(_boxes_like(name, recipe, boxes))
            texts.setdefault(text, []).append(name)
    if not texts:
        update: dict[str, Any] = {"loosen": 1.0}
    else:
        update = {"loosen": factors, "loosen_px": margins, "loosen_obb": bool(labels.loosen_obb)}
    sentences = [f"Boxes of inserted objects ({', '.join(names)}) {text}." for text, names in texts.items()]
    if texts and not update["loosen_obb"]:
        sentences.append("Oriented boxes stay exact.")
    return recipe.model_copy(update={"labels": labels.model_copy(update=update)}), " ".join(sentences)


def _boxes_like(name: str, recipe: Recipe, boxes: OwnBoxes) -> Sequence[BoxExtent]:
    """Return the measured boxes of a class, by its name after `labels.rename`, or of all if it has too few."""
    own = frozenset(c for c in boxes.classes if recipe.labels.rename.get(c, c) == name)
    found = boxes.of(own)
    return found if len(found) >= MIN_BOXES else boxes.of(boxes.classes)


def _looseness_like(drawn: Sequence[BoxExtent]) -> tuple[float, float | BySize, str]:
    """Return factor and margin for boxes that are drawn like others, and both in words."""
    if len(drawn) < MIN_BOXES:
        few = f"as {len(drawn)} boxes of this dataset could be measured, and {MIN_BOXES} are needed"
        return 1.0, BY_SIZE, f"get {TYPICAL_TEXT}, {few}"
    factor, px = typical_looseness(drawn)
    factor, px = min(factor, MAX_LOOSEN), min(px, MAX_LOOSEN_PX)
    text = f"get {px:g} px on each side" if px else f"are enlarged by the factor {factor:g}"
    if (factor, px) == (1, 0):
        text = "stay exact"
    classes = ", ".join(sorted({b.category for b in drawn}))
    return factor, px, f"{text}, as measured on {len(drawn)} boxes of {classes} in this dataset"
