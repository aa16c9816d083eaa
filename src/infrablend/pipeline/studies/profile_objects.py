"""Readings of the annotated objects of a dataset for its profile: local share of the camera, looseness of the boxes."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypedDict

import numpy as np

from infrablend.annotation.looseness import tighten_image
from infrablend.annotation.measured_looseness import BoxExtent, BoxFigures, box_extent, looseness, looseness_against
from infrablend.compositing.object_contrast import (
    TIMES,
    LocalShareBound,
    ObjectContrast,
    bound_local_share,
    eight_bit,
    object_contrast,
)
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.errors import DatasetError
from infrablend.formats.pictures.images import load_background

MAX_PICTURES = 1000
"""Largest number of annotated pictures that are read, evenly spread."""


@dataclass
class ObjectReadings:
    """Readings of objects.

    Attributes:
        contrasts: Contrast of each object.
        extents: Box and visible extent of each object that has one.
    """

    contrasts: list[ObjectContrast] = field(default_factory=list)
    extents: list[BoxExtent] = field(default_factory=list)


def annotated_pictures(dataset: Dataset, *, inserted: bool = False) -> list[ImageRecord]:
    """Return the pictures to read objects from: those with annotated objects, or those with inserted ones."""
    found = [i for i in dataset.images if any(o.inserted == inserted for o in i.instances)]
    count = min(len(found), MAX_PICTURES)
    return [found[k * len(found) // count] for k in range(count)]


def read_objects(
    dataset: Dataset,
    images: Sequence[ImageRecord],
    levels: tuple[float, float],
    *,
    inserted: bool = False,
    on_picture: Callable[[], None] | None = None,
) -> ObjectReadings:
    """Measure the annotated objects, or the inserted ones, of pictures; pictures that cannot be read are left out.

    Args:
        dataset: Dataset of the pictures; regions to ignore are no objects.
        images: Pictures to read.
        levels: Darkest and brightest level, for 16-bit pictures.
        inserted: Whether to measure inserted objects instead of annotated ones, in the boxes that `labels.loosen`
            starts from.
        on_picture: Called after each picture.
    """
    ignored = {c.name for c in dataset.categories if c.ignore}
    found = ObjectReadings()
    for given in images:
        # Enlarged boxes of inserted objects say nothing about those of annotators.
        image = tighten_image(given, fitted=True) if inserted else given
        with contextlib.suppress(DatasetError):  # the problems of pictures are reported where the camera is fitted
            picture = eight_bit(load_background(image.path, image.size_wh).pixels, levels)
            key = f"{image.split}/{image.id}"
            level = float(np.median(picture))
            for o in image.instances:
                if o.inserted != inserted or o.category in ignored or o.truncated:
                    continue
                if (contrast := object_contrast(picture, o, image.instances)) is None:
                    continue
                time = image.capture.time_of_day or "unknown"
                of_object = ObjectContrast(o.category, key, time, contrast, level)
                found.contrasts.append(of_object)
                if (extent := box_extent(picture, o, image.instances, of_object)) is not None:
                    found.extents.append(extent)
        if on_picture is not None:
            on_picture()
    return found


class ObjectFigures(TypedDict):
    """Figures of a dataset's annotated objects, as plain JSON values; see `object_figures`."""

    local_share: dict[str, LocalShareBound]
    box_looseness: dict[str, BoxFigures]


def object_figures(annotated: ObjectReadings, rendered: ObjectReadings | None = None) -> ObjectFigures:
    """Return the figures of a dataset's annotated objects as plain JSON values.

    Args:
        annotated: Readings of annotated objects.
        rendered: Readings of inserted objects of the same classes, in boxes without a margin.

    Returns:
        `local_share` by time of day (see `bound_local_share`) and `box_looseness` by class: `by_time` (see `looseness`,
        and `against_rendered` from `looseness_against`), and the figures of the time with the smallest factor, because
        parts that cannot be seen make the extent smaller, never larger. Without times and classes that have too few
        objects.
    """
    by_daytime = {time: [c for c in annotated.contrasts if c.time_of_day == time] for time in TIMES}
    share = {time: bound for time, of in by_daytime.items() if (bound := bound_local_share(of)) is not None}
    boxes: dict[str, BoxFigures] = {}
    for category in sorted({e.category for e in annotated.extents}):
        by_time = {time: found for time in TIMES if (found := _looseness(annotated, rendered, category, time))}
        if by_time:
            least = min(by_time.values(), key=lambda of: float((of.get("against_rendered") or of)["factor"]))
            boxes[category] = {**least, "by_time": by_time}
    return {"local_share": share, "box_looseness": boxes}


def _looseness(
    annotated: ObjectReadings, rendered: ObjectReadings | None, category: str, time: str
) -> BoxFigures | None:
    drawn, exact = (
        [e for e in (of.extents if of else ()) if (e.category, e.time_of_day) == (category, time)]
        for of in (annotated, rendered)
    )
    figures = looseness(drawn)
    if figures is None or rendered is None:
        return None if figures is None else {**figures}
    return {**figures, "against_rendered": looseness_against(drawn, exact)}
