"""Compares the height that a run takes for its camera with the sizes of annotated people, cars and two-wheelers."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from infrablend.config.recipe import MetricRecipe, Recipe
from infrablend.core.camera import CameraSpec
from infrablend.core.dataset import ImageRecord, KnownClass
from infrablend.core.ground_plane import at_height
from infrablend.core.mesh import FloatArray
from infrablend.errors import Problem, RecipeError
from infrablend.formats.pictures.listing import read_size
from infrablend.sampling.calibration import log_ratios
from infrablend.sampling.metric import MetricPlacer

HEIGHT_CONTRADICTED = "height-contradicted"
"""Code of the warning about labels that contradict the height of the camera, of which a run is refused."""
_DOUBTFUL = 1.08
_CONTRADICTED = 1.25
# Labels speak about the height if they are of so many objects, and differ by more than twice the standard error.
_LEAST_OBJECTS = 8
# That is 1.25 times 1.48 median distances from a median over the root of their number (normal errors).
_TWO_ERRORS = 2 * 1.25 * 1.48
# Pictures that are looked at, and difference of a stated pitch from a picture's own that shows another view on purpose.
_PICTURES = 100
_SAME_PITCH_DEG = 5.0

# Logarithms of size ratios of each annotated object, which a track shows in several pictures.
_Ratios = dict[tuple[KnownClass, object], list[float]]


def height_problems(recipe: Recipe, images: Sequence[ImageRecord]) -> list[Problem]:
    """Return a warning if annotated objects contradict the height that a run uses over these pictures."""
    metric = cast(MetricRecipe, recipe)
    if not metric.camera.is_real:
        return []
    ratios: _Ratios = {}
    some = [image for image in images if image.instances]
    heights = [_collect(metric, image, ratios) for image in some[:: max(1, len(some) // _PICTURES)]]
    known = [height for height in heights if height is not None]
    if len(ratios) < _LEAST_OBJECTS:
        return []
    found = _contradiction(metric, ratios, np.median(known, axis=0))
    if metric.camera.accept_height:
        todo = "as camera.accept_height asks, the height counts"
        return [replace(p, code="height-accepted", todo=todo) for p in found]
    return found


def require_height(recipe: Recipe, problems: Sequence[Problem]) -> None:
    """Refuse a plan with these problems if labels contradict the height of its camera.

    Raises:
        RecipeError: They do.
    """
    if refused := [p for p in problems if p.code == HEIGHT_CONTRADICTED]:
        raise RecipeError(f"recipe {recipe.name}: labels that contradict the height of the camera", refused)


def _collect(recipe: MetricRecipe, image: ImageRecord, ratios: _Ratios) -> tuple[float, float] | None:
    """Add the annotated objects of a picture; return its stated height and that which a run uses.

    None for a picture whose view is not known before it is decoded, or is another than the recipe's.
    """
    c = recipe.camera
    own = image.capture
    pitch = own.pitch_deg if c.stated_pitch_deg is None else sum(c.stated_pitch_deg) / 2
    stated = own.altitude_m if c.stated_height_m is None else sum(c.stated_height_m) / 2
    size_wh = image.size_wh or read_size(image.path, image.name)[0]
    if pitch is None or stated is None or size_wh is None:
        return None
    if own.pitch_deg is not None and abs(pitch - own.pitch_deg) > _SAME_PITCH_DEG:
        return None
    turns = math.radians(pitch), math.radians(own.roll_deg or 0.0)
    camera = CameraSpec(1.0, *turns, c.lens_mm(own.hfov_deg), c.sensor_width_mm, size_wh)
    placer = MetricPlacer(recipe)
    prior = placer.height_prior(image)
    used = placer.corrected(at_height(camera, stated), stated, image.instances, prior).height_m
    for kind, label, ratio in log_ratios(at_height(camera, used), used, image.instances, prior):
        which = id(label) if label.track_id is None else (own.sequence, label.track_id)
        ratios.setdefault((kind, which), []).append(ratio)
    return stated, used


def _contradiction(recipe: MetricRecipe, ratios: _Ratios, heights_m: FloatArray) -> list[Problem]:
    """Return the warning; none if the labels agree with the height used, or their statement is not sure."""
    common, error = _common(ratios)
    stated, used = (float(height) for height in heights_m)
    shown = used / math.exp(common)
    if (drawn := recipe.camera.stated_height_m) is not None:
        stated = used = min(max(shown, drawn[0]), drawn[1])
    off = abs(math.log(used / shown))
    if off <= max(math.log(_DOUBTFUL), error):
        return []
    objects = ", ".join(f"{n} of class {kind}" for kind, n in Counter(kind for kind, _ in ratios).items())
    found = (
        f"{used:.3g} m above the ground{'' if stated == used else f' ({stated:.3g} m as stated)'}, but the sizes of "
        f"labelled objects ({objects}) say {shown:.3g} m, within {shown * math.expm1(error):.2g}: objects are "
        f"inserted {math.exp(off):.2f} times too {'small' if used > shown else 'large'}"
    )
    better = "stated_heights.factor, true over stated height" if recipe.camera.calibrate else "calibrate=true"
    todo = (
        f"correct the heights of the pictures, or set camera.{better}"
        if recipe.camera.needs_height
        else f"set camera.altitude={{fixed_m: {shown:.2g}}}, or give each picture its height (camera.altitude=metadata "
        "with camera.calibrate=true, so that labels correct it)"
    )
    todo += ", or correct pitch or lens if these are wrong; or set camera.accept_height=true if the height is right"
    contradicted = off > max(math.log(_CONTRADICTED), error + math.log(_DOUBTFUL))
    code = HEIGHT_CONTRADICTED if contradicted else "height-doubtful"
    return [Problem("camera.altitude", code, found, "labels of the size that the height gives", todo, "warning")]


def _common(ratios: Mapping[tuple[KnownClass, object], Sequence[float]]) -> tuple[float, float]:
    """Return the common logarithm of the ratios, an object's being one, and twice its standard error.

    The error counts how far classes disagree: then it is not the height.
    """
    kinds = dict.fromkeys(kind for kind, _ in ratios)
    of_kind = [np.array([np.median(of) for (k, _), of in ratios.items() if k == kind]) for kind in kinds]
    middles = np.array([np.median(of) for of in of_kind])
    shares = np.array([len(of) for of in of_kind]) / len(ratios)
    common = float(shares @ middles)
    away = np.abs(np.concatenate([of - middle for of, middle in zip(of_kind, middles, strict=True)]))
    within = _TWO_ERRORS * float(np.median(away)) / math.sqrt(len(away))
    return common, math.hypot(within, 2 * math.sqrt(float(shares @ (middles - common) ** 2)))
