"""Facts of backgrounds: what physical matching needs of one, and the range of grey levels that a dataset uses."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

import numpy as np

from infrablend.compositing.mapping import measure_levels
from infrablend.config.recipe import Recipe
from infrablend.core.dataset import ImageRecord
from infrablend.core.file_names import real_path
from infrablend.core.files import sha256_of
from infrablend.core.temperature import TemperatureScale, describe_plausible, implausible_counts
from infrablend.errors import DatasetError, Problem
from infrablend.formats.pictures.images import (
    COLOUR_REMEDY,
    COLOURS,
    IN_COLOUR,
    REFUSED_COLOUR,
    Background,
    load_background,
)
from infrablend.formats.pictures.temperature_scale import CHECK_SCALE, IMPLAUSIBLE, shows_ground
from infrablend.pipeline.plans.plan import RunPlan

# With a smaller span, the picture does not show how grey levels depend on temperature.
MIN_SPAN_LEVELS = 4


def require_thermal_levels(background: Background) -> None:
    """Refuse a picture with grey levels that do not follow temperature, which physical matching requires.

    Raises:
        DatasetError: The picture is in colour or has no contrast.
    """
    name = background.path.name
    if any(p.code == IN_COLOUR for p in background.problems):
        found = f"{COLOURS}; {REFUSED_COLOUR}"
        expected = "a grey picture, as physical matching needs"
        todo = f"{COLOUR_REMEDY}, or use appearance.mode: artistic for a palette"
        problem = Problem(name, "image-colour-mapped", found, expected, todo)
        raise DatasetError(f"{background.path}: in colour", [problem])
    low, high = (float(v) for v in np.percentile(background.pixels, [0.5, 99.5]))
    if high - low < MIN_SPAN_LEVELS:
        expected = f"a picture with at least {MIN_SPAN_LEVELS} levels between its 0.5 and 99.5 percentiles"
        todo = "leave it out, or use appearance.mode: artistic"
        problem = Problem(name, "image-no-contrast", f"grey levels {low:g} to {high:g}", expected, todo)
        raise DatasetError(f"{background.path}: no contrast", [problem])


def require_temperatures(background: Background, scale: TemperatureScale | None, ground: bool) -> None:
    """Refuse a picture without temperatures of a scene in 16 bits, which radiometric matching requires.

    Args:
        background: The picture.
        scale: Its scale; None for counts alone.
        ground: Whether it shows the ground, not the sky alone.

    Raises:
        DatasetError: The picture has 8 bits, or no scene has the temperatures that its scale gives.
    """
    if background.bit_depth != 16:
        problem = Problem(
            background.path.name,
            "image-no-temperatures",
            f"{background.bit_depth} bits per pixel",
            "a 16-bit picture, as radiometric matching needs",
            "use the radiometric files of the camera, or leave matching.mode out",
        )
        raise DatasetError(f"{background.path}: no temperatures", [problem])
    median = None if scale is None else implausible_counts(background.pixels, scale, ground)
    if median is not None:
        problem = Problem(
            background.path.name,
            IMPLAUSIBLE,
            f"temperatures of no scene: a median of {median:,.1f} K",
            describe_plausible(ground),
            f"{CHECK_SCALE}; leave the picture out if it is empty or saturated",
        )
        raise DatasetError(f"{background.path}: implausible temperatures", [problem])


def is_ground(source: ImageRecord, recipe: Recipe) -> bool:
    """Return whether a picture shows the ground, by its pitch or the recipe's, and not perhaps the sky alone."""
    stated = recipe.camera.stated_pitch_deg
    if stated is not None:
        return stated[0] > 0
    return recipe.camera.horizon is None and shows_ground(source)


def background_facts(source: ImageRecord, background: Background, data_root: Path) -> dict[str, object]:
    """Return the facts about the background for a frame's record; without a file, the digest is that of its pixels."""
    if source.path.is_file():
        digest = sha256_of(real_path(source.path))
    else:
        digest = hashlib.sha256(background.pixels.tobytes()).hexdigest()
    return {
        "id": source.id,
        "path": Path(os.path.relpath(source.path, data_root)).as_posix(),
        "sha256": digest,
        "size_wh": list(background.size_wh),
        **source.capture.to_json(),
        **({} if source.capture.time_from is None else {"time_from": source.capture.time_from}),
        "source_id": source.source_id,
    }


Load = Callable[[ImageRecord], Background]


def load_file(image: ImageRecord) -> Background:
    """Return the picture of an image's file."""
    return load_background(image.path, image.size_wh)


def dataset_levels(plan: RunPlan, load: Load = load_file) -> tuple[float, float]:
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
