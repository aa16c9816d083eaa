"""Measures the range of grey levels that a dataset uses."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import numpy as np

from infrablend.compositing.mapping import measure_levels
from infrablend.config.recipe import RadiometricMatching
from infrablend.core.dataset import ImageRecord
from infrablend.errors import DatasetError
from infrablend.formats.images import Background, load_background
from infrablend.pipeline.plan import RunPlan

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
            pictures.append(load(image).pixels)
    if not pictures:
        raise DatasetError(f"{plan.dataset.root}: none of the pictures can be read; grey levels cannot be measured")
    # Radiometric frames of 8 bits are left out one by one.
    by_temperature = isinstance(plan.recipe.matching, RadiometricMatching)
    if len({p.dtype == np.uint8 for p in pictures}) > 1 and not by_temperature:
        raise DatasetError(
            f"{plan.dataset.root}: found pictures of 8 and of 16 bits, whose levels have no common range; expected one "
            "bit depth. Put them in two folders"
        )
    return measure_levels(pictures)
