"""Measures the inserted objects of a finished picture, and finds those that nobody can see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from infrablend.annotation.visible_fit import add_seen_box
from infrablend.compositing.contrast import Contrast, measure_contrast, visible_change
from infrablend.compositing.mapping import GreyImage
from infrablend.config.recipe import Recipe
from infrablend.core.capture import TimeOfDay
from infrablend.core.dataset import Instance
from infrablend.core.render import PlacedScene, RenderResult
from infrablend.pipeline.compose.looks import least_contrast
from infrablend.sampling.site import Site


@dataclass(frozen=True, eq=False)
class MeasuredInsert:
    """An inserted object in the finished picture.

    Attributes:
        number: Number of the object in its scene.
        label: Its label.
        changed_grey: Change of its pixels by the insertion, 8-bit levels; see `visible_change`.
        contrast: Contrast of its box against the ring around it; None if the ring is too small to be measured.
    """

    number: int
    label: Instance
    changed_grey: float
    contrast: Contrast | None

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        measured = {} if self.contrast is None else self.contrast.to_json()
        return {"object": self.number, "changed": round(self.changed_grey, 2), **measured}

    def labelled(self) -> Instance:
        """Return the label with the object's contrast among its further fields."""
        found: dict[str, object] = {"changed_grey": round(self.changed_grey, 2)}
        if self.contrast is not None:
            found |= {"contrast_grey": round(self.contrast.signed, 2), "scr": round(self.contrast.scr, 3)}
        return replace(self.label, extra={**self.label.extra, **found})


def measure_inserts(
    numbers: Sequence[int],
    labels: Sequence[Instance],
    rendered: RenderResult,
    before: GreyImage,
    after: GreyImage,
    site: Site,
) -> list[MeasuredInsert]:
    """Measure the inserted objects that have a label.

    Args:
        numbers: Number of the object in its scene, per label.
        labels: Labels of the inserted objects.
        rendered: The rendered scene.
        before: (h, w) background.
        after: (h, w) finished picture.
        site: The background's own labels and levels.
    """
    found = []
    # Always the whole objects: which box is written must not decide what is seen, and so what is moved.
    whole = [np.asarray(i.extra.get("amodal_box", i.box_xyxy), np.float64) for i in labels]
    boxes = [*(i.box_xyxy for i in site.labels), *whole]
    for n, (number, label) in enumerate(zip(numbers, labels, strict=True)):
        others = boxes[: len(site.labels) + n] + boxes[len(site.labels) + n + 1 :]
        changed = visible_change(before, after, rendered.coverage[number], rendered.offset_xy, site.grey_unit)
        # Only the visible part of a partly hidden object can be seen.
        box = np.asarray(label.extra.get("visible_box", label.box_xyxy), np.float64)
        found.append(MeasuredInsert(number, label, changed, measure_contrast(after, box, others, site.grey_unit)))
    return found


def with_seen_box(insert: MeasuredInsert, before: GreyImage, after: GreyImage, unit: float) -> Instance:
    """Return the object's label as `labelled` does, with the boxes around its visible part where they differ.

    Args:
        insert: The object.
        before: (h, w) background.
        after: (h, w) finished picture.
        unit: Levels of the pictures per 8-bit level.
    """
    label = insert.labelled()
    c = insert.contrast
    change, ring = (insert.changed_grey, None) if c is None else (c.change, c.ring)
    return add_seen_box(label, after, before, change, ring, unit)


def faint_inserts(inserts: Sequence[MeasuredInsert], recipe: Recipe, time_of_day: TimeOfDay | None) -> list[int]:
    """Return the numbers of the objects whose contrast is below the recipe's limit."""
    faint = []
    for insert in inserts:
        least = least_contrast(recipe, insert.label.category, time_of_day)
        if least is None:
            continue
        c = insert.contrast
        # The box alone is not enough: the background's own structures stand out from the ring, too.
        seen = min(insert.changed_grey, np.inf if c is None else c.change)
        clutter = 0.0 if c is None else c.clutter
        if not least.is_met(seen, clutter):
            faint.append(insert.number)
    return faint


class FirstContrasts:
    """Contrast of a frame's objects at the places drawn first: what `placement.min_contrast` was given.

    An object that is expected to be too faint is moved before anything is rendered; its contrast is the expected one.
    """

    def __init__(self, scene: PlacedScene) -> None:
        self._unknown = list(scene.objects)
        self.found: list[dict[str, object]] = []

    def add(self, scene: PlacedScene, contrasts: Mapping[int, Mapping[str, object]]) -> None:
        """Add contrasts by number of the object in the scene, of those that still have their first place."""
        for number, contrast in contrasts.items():
            placed = scene.objects[number]
            if any(placed is o for o in self._unknown):
                self._unknown = [o for o in self._unknown if o is not placed]
                self.found.append(dict(contrast))
