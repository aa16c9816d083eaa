"""Measures the range of grey levels that a dataset uses."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

from infrablend.compositing.mapping import measure_levels
from infrablend.core.dataset import ImageRecord
from infrablend.errors import DatasetError
from infrablend.formats.pictures.images import Background, load_background
from infrablend.pipeline.plans.plan import RunPlan

Load = Callable[[ImageRecord], Background]


def _load_file(image: ImageRecord) -> Background:
    return load_background(image.path, image.size_wh)


def dataset_levels(plan: RunPlan, load: Load = _load_file) -> tuple[float, float]:
    """Return the darkest and brightest grey level of the dataset, measured on at most 64 evenly spread pictures.

    Raises:
        DatasetError: None of these pictures can be read, or some have 8 and others 16 bits.
    """
    pictures = []
    for image in plan.sample or plan.dataset.images:
        with contextlib.suppress(DatasetError):  # reported when its frame is rendered
            pictures.append(load(image))
    if not pictures:
        raise DatasetError(f"{plan.dataset.root}: none of the pictures can be read; grey levels cannot be measured")
    if not plan.recipe.matching.needs_temperatures:  # these leave frames of 8 bits out one by one
        require_one_depth(plan.dataset.root, {p.bit_depth for p in pictures})
    return measure_levels([p.pixels for p in pictures])


def recorded_levels(levels: Sequence[float] | None) -> tuple[float, float] | None:
    """Return the levels that the record of a run, or the plan that its shards share, has under `levels`."""
    if levels is None:
        return None
    low, high = levels
    return float(low), float(high)


def require_one_depth(root: Path, depths: Collection[int]) -> None:
    """Refuse pictures of several bit depths, whose levels have no common range.

    Raises:
        DatasetError: There are several.
    """
    if len(depths) > 1:
        raise DatasetError(
            f"{root}: found pictures of 8 and of 16 bits, whose levels have no common range; expected one bit depth. "
            "Put them in two folders"
        )
