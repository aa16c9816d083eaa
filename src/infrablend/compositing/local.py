"""Grey levels by physics: around the place of insertion, grey = ground grey + gain * (radiance - ground radiance).

A camera's automatic gain is unknown, differs from image to image and saturates, so the gain is estimated for each
background from annotated objects whose temperature is roughly known, together with a prior, and drawn from what
remains uncertain. Clipped objects say only that the gain is at least so much. Nothing is guessed from the
picture's own statistics.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.mapping import GreyImage, GreyMapping
from infrablend.core.dataset import Instance, TimeOfDay
from infrablend.core.scene import Weather
from infrablend.thermal.radiometry import band_radiance, band_radiance_slope

# A level this near to the dataset's darkest or brightest counts as clipped, in levels of an 8-bit picture.
CLIP_MARGIN = 3
# What an annotated object's level is worth as a reading, beside its temperature's uncertainty.
_READING_GREY = 5.0
_FACE_K = 301.15


@dataclass(frozen=True)
class GainPrior:
    """What is known of the gain before looking, grey levels per kelvin at air temperature.

    HIT-UAV's night scenes have about 6, give or take 30 % (person-ground contrast of 101 levels over 12 to 22 K).
    """

    mean: float = 6.0
    sd: float = 1.8
    low: float = 2.5
    high: float = 12.0


@dataclass(frozen=True)
class Anchor:
    """An annotated object with a roughly known temperature.

    Attributes:
        what: `clothing`, `car_roof`, or `face_clipped` (a lower bound only).
        grey: Its level minus that of the ground around it.
        kelvin: Assumed apparent temperature.
        sd_k: How uncertain that is.
    """

    what: Literal["clothing", "car_roof", "face_clipped"]
    grey: float
    kelvin: float
    sd_k: float


def local_mapping(
    background: GreyImage,
    insert_xyxy: NDArray[np.float64],
    labels: Sequence[Instance],
    weather: Weather,
    time_of_day: TimeOfDay | None,
    levels: tuple[float, float],
    rng: np.random.Generator,
    *,
    prior: GainPrior | None = None,
    polarity: Literal["white-hot", "black-hot"] = "white-hot",
) -> tuple[GreyMapping, dict[str, Any]]:
    """The mapping for one insertion, and what was estimated on the way.

    Args:
        background: (h, w) grey, 8 or 16 bit.
        insert_xyxy: (4,) box of what is inserted, pixels; may reach outside the frame.
        labels: The background's own annotated objects: left out of the ground, used as anchors.
        weather: Air and ground temperature.
        time_of_day: Cars are anchors at night only.
        levels: Darkest and brightest level that the dataset uses.
        rng: Draws the gain from its posterior.
        prior: Of the gain; for 16 bit it is scaled by the range of `levels`.
        polarity: Black-hot pictures are turned over on the way in and out.
    """
    prior = prior or GainPrior()
    low, high = levels
    picture = background.astype(np.float32)
    if polarity == "black-hot":
        picture = low + high - picture
    # All gains are per 8-bit level of a dataset that spans about 220 of them.
    scale = 1.0 if background.dtype == np.uint8 else (high - low) / 220.0
    free = np.ones(picture.shape, np.bool_)
    for i in labels:
        x0, y0, x1, y1 = _pixels(i.box_xyxy, picture.shape)
        free[y0:y1, x0:x1] = False
    ground = ring_level(picture, insert_xyxy, free)
    anchors = find_anchors(picture, free, labels, weather, time_of_day, levels, scale)

    slope = float(band_radiance_slope(weather.air_k))
    of_ground = float(band_radiance(weather.ground_k))
    mean, variance = prior.mean * scale / slope, (prior.sd * scale / slope) ** 2
    weight, total = 1 / variance, mean / variance
    for a in anchors:
        contrast = float(band_radiance(a.kelvin)) - of_ground
        if a.what == "face_clipped" or abs(contrast) < 1e-6:
            continue
        noise = math.hypot(_READING_GREY * scale, mean * slope * a.sd_k)
        weight += (contrast / noise) ** 2
        total += contrast * a.grey / noise**2
    bounds = [prior.low * scale / slope, prior.high * scale / slope]
    clipped = [a for a in anchors if a.what == "face_clipped"]
    if clipped:
        warm = float(band_radiance(_FACE_K)) - of_ground
        if warm > 0:
            at_least = float(np.median([a.grey for a in clipped])) / warm
            bounds[0] = min(max(bounds[0], at_least), bounds[1])
    centre, sd = total / weight, 1 / math.sqrt(weight)
    gain = _truncated_normal(rng, centre, sd, bounds[0], bounds[1])
    dark = ground - gain * of_ground
    mapping = GreyMapping(dark, dark + gain, (low, high))
    if polarity == "black-hot":
        mapping = GreyMapping(low + high - dark, low + high - dark - gain, (low, high))
    facts = {
        "ground_grey": round(ground, 3),
        "gain_grey_per_k": round(gain * slope, 4),
        "gain_posterior": [round(centre * slope, 4), round(sd * slope, 4)],
        "gain_bounds": [round(b * slope, 4) for b in bounds],
        "anchors": {w: sum(a.what == w for a in anchors) for w in ("clothing", "car_roof", "face_clipped")},
        "levels": [low, high],
    }
    return mapping, facts


def ring_level(picture: NDArray[np.float32], box_xyxy: NDArray[np.float64], free: NDArray[np.bool_]) -> float:
    """Median level of the free pixels around a box, out to one and a half of its size (at least 12 px) on each side.

    Falls back on the whole free picture, then on the whole picture, where too little is free.
    """
    x0, y0, x1, y1 = box_xyxy
    reach = max(1.5 * max(x1 - x0, y1 - y0), 12.0)
    left, top, right, bottom = _pixels(np.array([x0 - reach, y0 - reach, x1 + reach, y1 + reach]), picture.shape)
    inner = _pixels(box_xyxy, picture.shape)
    use = np.zeros_like(free)
    use[top:bottom, left:right] = free[top:bottom, left:right]
    use[inner[1] : inner[3], inner[0] : inner[2]] = False
    for mask in (use, free):
        if mask.sum() >= 50:
            return float(np.median(picture[mask]))
    return float(np.median(picture))


def find_anchors(
    picture: NDArray[np.float32],
    free: NDArray[np.bool_],
    labels: Sequence[Instance],
    weather: Weather,
    time_of_day: TimeOfDay | None,
    levels: tuple[float, float],
    scale: float = 1.0,
) -> tuple[Anchor, ...]:
    """Annotated people (clothing, 5 K above air, +-3) and, at night, cars' middles (8 K below air apparent, +-3).

    A person whose brightest part is clipped gives a lower bound; clipped clothing gives nothing.
    """
    found = []
    ceiling = levels[1] - CLIP_MARGIN * scale
    floor = levels[0] + CLIP_MARGIN * scale
    for i in labels:
        x0, y0, x1, y1 = _pixels(i.box_xyxy, picture.shape)
        inside = picture[y0:y1, x0:x1]
        if inside.size < 20:
            continue
        around = ring_level(picture, i.box_xyxy, free)
        name = i.category.casefold()
        if name == "person":
            middle, bright = (float(v) for v in np.percentile(inside, [50, 95]))
            if floor < middle < ceiling - 4 * scale:
                found.append(Anchor("clothing", middle - around, weather.air_k + 5, 3.0))
            if bright >= ceiling:
                found.append(Anchor("face_clipped", bright - around, _FACE_K, 3.0))
        elif name == "car" and time_of_day == "night":
            h, w = inside.shape
            roof = float(np.median(inside[h // 4 : h - h // 4, w // 4 : w - w // 4]))
            if floor < roof < ceiling:
                found.append(Anchor("car_roof", roof - around, weather.air_k - 8, 3.0))
    return tuple(found)


def measure_levels(backgrounds: Sequence[GreyImage]) -> tuple[float, float]:
    """Darkest and brightest level a dataset uses: the 0.05 and 99.95 % quantiles of all pixels given."""
    if not backgrounds:
        raise ValueError("levels are measured on at least one picture")
    pixels = np.concatenate([np.asarray(b)[::4, ::4].ravel() for b in backgrounds])
    low, high = (float(v) for v in np.percentile(pixels, [0.05, 99.95]))
    return low, max(high, low + 1)


def _pixels(box_xyxy: NDArray[np.float64], shape_hw: tuple[int, ...]) -> tuple[int, int, int, int]:
    x0, y0, x1, y1 = box_xyxy
    h, w = shape_hw
    return (
        int(np.clip(math.floor(x0), 0, w)),
        int(np.clip(math.floor(y0), 0, h)),
        int(np.clip(math.ceil(x1), 0, w)),
        int(np.clip(math.ceil(y1), 0, h)),
    )


def _truncated_normal(rng: np.random.Generator, mean: float, sd: float, low: float, high: float) -> float:
    for _ in range(200):
        draw = float(rng.normal(mean, sd))
        if low <= draw <= high:
            return draw
    return min(max(mean, low), high)
