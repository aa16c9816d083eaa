"""Checks backgrounds for physical matching and returns their facts for the frame record."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import numpy as np

from infrablend.config.recipe import Recipe
from infrablend.core.dataset import ImageRecord
from infrablend.core.file_names import real_path
from infrablend.core.files import sha256_of
from infrablend.core.temperature import TemperatureScale, describe_plausible, implausible_counts
from infrablend.errors import DatasetError, Problem
from infrablend.formats.pictures.images import COLOUR_REMEDY, COLOURS, IN_COLOUR, Background
from infrablend.formats.pictures.temperature_scale import CHECK_SCALE, IMPLAUSIBLE, shows_ground

# With a smaller span, the picture does not show how grey levels depend on temperature.
MIN_SPAN_LEVELS = 4


def require_thermal_levels(background: Background) -> None:
    """Refuse a picture with grey levels that do not follow temperature, which physical matching requires.

    Raises:
        DatasetError: The picture is in colour or has no contrast.
    """
    name = background.path.name
    if any(p.code == IN_COLOUR for p in background.problems):
        found = f"{COLOURS}; grey levels computed from them do not follow temperature"
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
