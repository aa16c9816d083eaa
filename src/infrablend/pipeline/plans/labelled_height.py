"""Compares the height that a run takes for its camera with the sizes of annotated people, cars and two-wheelers."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from infrablend.config.recipe import MetricRecipe, Recipe
from infrablend.core.camera import CameraSpec, fov_of_width
from infrablend.core.dataset import ImageRecord, KnownClass
from infrablend.core.ground_plane import at_height
from infrablend.errors import Problem, RecipeError
from infrablend.formats.pictures.listing import read_size
from infrablend.sampling.calibration import calibrate, log_ratios
from infrablend.sampling.metric import MetricPlacer

HEIGHT_DOUBTFUL = "height-doubtful"
"""Code of the warning about labels that are larger or smaller than the height of the camera gives."""
HEIGHT_CONTRADICTED = "height-contradicted"
"""Code of the same warning where a run is refused."""
_DOUBTFUL = 1.08
_CONTRADICTED = 1.25
# Labels speak about the height if they are of so many objects, and differ by more than twice the standard error.
_LEAST_OBJECTS = 12
_SURE = 2.0
# Standard error of a median, times the root of the number, over the median distance from it (normal errors).
_MEDIAN_ERROR = 1.25 * 1.48
# Pictures that are looked at.
_PICTURES = 100
# A pitch or lens of the recipe that differs by more from the picture's own shows another view on purpose.
_SAME_PITCH_DEG = 5.0
_SAME_LENS = 0.15


@dataclass(frozen=True)
class _Reading:
    """An annotated object of known size in one picture.

    Attributes:
        kind: Its class.
        which: What tells it from other objects; several pictures may show one track.
        ratio: Logarithm of its size over that at the height used.
        height_m: That height.
        stated_m: Height that picture or recipe state.
    """

    kind: KnownClass
    which: object
    ratio: float
    height_m: float
    stated_m: float


@dataclass(frozen=True)
class _Statement:
    """What annotated objects say about a height.

    Attributes:
        code: Code of the warning.
        labels: Number of labels by class.
        used_m: Height that a run uses; the nearest of those that are drawn.
        stated_m: Height that labels have corrected to that, as far as they may.
        shown_m: Height that the labels show.
        error_m: Error of that.
        off: How many times too small or too large objects are inserted.
    """

    code: str
    labels: Mapping[KnownClass, int]
    used_m: float
    stated_m: float
    shown_m: float
    error_m: float
    off: float


def height_problems(recipe: Recipe, images: Sequence[ImageRecord]) -> list[Problem]:
    """Return a warning if annotated objects contradict the height that a run uses over these pictures."""
    metric = cast(MetricRecipe, recipe)
    if not metric.camera.is_real or metric.camera.accept_height:
        return []
    some = [image for image in images if image.instances]
    some = some[:: max(1, len(some) // _PICTURES)]
    found = _statement(metric, [reading for image in some for reading in _readings(metric, image)])
    return [] if found is None else [_problem(metric, found)]


def require_height(recipe: Recipe, problems: Sequence[Problem]) -> None:
    """Refuse a plan with these problems if labels contradict the height of its camera.

    Raises:
        RecipeError: They do.
    """
    if refused := [p for p in problems if p.code == HEIGHT_CONTRADICTED]:
        raise RecipeError(f"recipe {recipe.name}: labels that contradict the height of the camera", refused)


def _readings(recipe: MetricRecipe, image: ImageRecord) -> Iterator[_Reading]:
    """Yield the annotated objects of known size in a picture whose view is known before it is decoded."""
    c = recipe.camera
    own = image.capture
    stated = c.stated_pitch_deg
    pitch = own.pitch_deg if stated is None else (stated[0] + stated[1]) / 2
    height = given = own.altitude_m if c.stated_height_m is None else sum(c.stated_height_m) / 2
    size_wh = image.size_wh
    if size_wh is None:
        size_wh, _ = read_size(image.path, image.name)
    if pitch is None or height is None or given is None or size_wh is None or _other_view(recipe, image, pitch):
        return
    lens_mm = c.lens_mm(own.hfov_deg)
    roll = math.radians(own.roll_deg or 0.0)
    camera = CameraSpec(1.0, math.radians(pitch), roll, lens_mm, c.sensor_width_mm, size_wh)
    camera = at_height(camera, height)
    prior = MetricPlacer(recipe).height_prior(image)
    if c.calibrate and c.needs_height:
        height = calibrate(camera, height, image.instances, prior).height_m
        camera = at_height(camera, height)
    for kind, label, ratio in log_ratios(camera, height, image.instances, prior):
        which = (own.sequence, label.track_id) if label.track_id is not None else id(label)
        yield _Reading(kind, which, ratio, height, given)


def _other_view(recipe: MetricRecipe, image: ImageRecord, pitch_deg: float) -> bool:
    """Return whether the recipe replaces pitch or lens of a picture, which others report."""
    c = recipe.camera
    own = image.capture
    turned = own.pitch_deg is not None and abs(pitch_deg - own.pitch_deg) > _SAME_PITCH_DEG
    stated = fov_of_width(c.sensor_width_mm, c.focal_length_mm)
    wider = not c.needs_lens and own.hfov_deg is not None and abs(stated / own.hfov_deg - 1) > _SAME_LENS
    return turned or wider


def _statement(recipe: MetricRecipe, readings: Sequence[_Reading]) -> _Statement | None:
    """Return what some objects say about the height; None if they are too few, differ too much, or agree with it."""
    factor = _factor(readings)
    if factor is None:
        return None
    used = float(np.median([r.height_m for r in readings]))
    given = float(np.median([r.stated_m for r in readings]))
    shown = used / math.exp(factor[0])
    if (stated := recipe.camera.stated_height_m) is not None:  # drawn for each frame
        used = given = min(max(shown, stated[0]), stated[1])
    off, error = abs(math.log(used / shown)), _SURE * factor[1]
    if off <= math.log(_DOUBTFUL) or off <= error:
        return None
    contradicted = off > math.log(_CONTRADICTED) and off > error + math.log(_DOUBTFUL)
    code = HEIGHT_CONTRADICTED if contradicted else HEIGHT_DOUBTFUL
    labels = Counter(r.kind for r in readings)
    return _Statement(code, labels, used, given, shown, shown * (math.exp(error) - 1), math.exp(off))


def _factor(readings: Sequence[_Reading]) -> tuple[float, float] | None:
    """Return the common logarithm of the ratios, and its standard error; None for too few objects.

    An object of many pictures counts once. The error counts how far classes disagree: then it is not the height.
    """
    by_object: dict[tuple[KnownClass, object], list[float]] = {}
    for reading in readings:
        by_object.setdefault((reading.kind, reading.which), []).append(reading.ratio)
    if len(by_object) < _LEAST_OBJECTS:
        return None
    by_kind: dict[KnownClass, list[float]] = {}
    for (kind, _), ratios in by_object.items():
        by_kind.setdefault(kind, []).append(float(np.median(ratios)))
    shares = np.array([len(of) for of in by_kind.values()]) / len(by_object)
    middles = np.array([np.median(of) for of in by_kind.values()])
    common = float(shares @ middles)
    away = [abs(ratio - middle) for of, middle in zip(by_kind.values(), middles, strict=True) for ratio in of]
    within = _MEDIAN_ERROR * float(np.median(away)) / math.sqrt(len(away))
    return common, math.hypot(within, math.sqrt(float(shares @ (middles - common) ** 2)))


def _problem(recipe: MetricRecipe, found: _Statement) -> Problem:
    c = recipe.camera
    size = "small" if found.used_m > found.shown_m else "large"
    labels = ", ".join(f"{n} of class {kind}" for kind, n in found.labels.items())
    text = f"{found.used_m:.3g} m above the ground"
    text += f" ({found.stated_m:.3g} m as stated)" if found.stated_m != found.used_m else ""
    text += f", but the sizes of labels ({labels}) say {found.shown_m:.3g} m, within {found.error_m:.2g}: "
    text += f"objects are inserted {found.off:.2f} times too {size}"
    todo = f"set camera.altitude={{fixed_m: {found.shown_m:.2g}}}, or give each picture its height (camera.altitude="
    todo += "metadata with camera.calibrate=true, so that labels correct it)"
    if c.needs_height:
        todo = "correct the heights of the pictures, or set "
        todo += "camera.stated_heights.factor, true over stated height" if c.calibrate else "camera.calibrate=true"
    todo += ", or correct pitch or lens if these are wrong; or set camera.accept_height=true if the height is right"
    return Problem("camera.altitude", found.code, text, f"sizes within a factor of {_DOUBTFUL:g}", todo, "warning")
