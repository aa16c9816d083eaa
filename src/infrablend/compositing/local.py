"""Grey levels by physics: around the place of insertion, grey = ground grey + gain * (radiance - ground radiance).

A camera's automatic gain is unknown, differs from image to image and saturates, so the gain is estimated for each
background from annotated objects whose temperature is roughly known, together with a prior, and drawn from what
remains uncertain. Clipped objects say only that the gain is at least so much. Nothing is guessed from the
picture's own statistics.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.mapping import GreyImage, GreyMapping, Place
from infrablend.core.dataset import Instance, TimeOfDay
from infrablend.core.kinds import kind_of
from infrablend.core.scene import ObjectSpec, Weather
from infrablend.thermal.radiometry import band_radiance, band_radiance_slope
from infrablend.thermal.sky import relative_humidity, sky_radiance, transmittance

# A level this near to the dataset's darkest or brightest counts as clipped, in levels of an 8-bit picture.
CLIP_MARGIN = 3
# What an annotated object's level is worth as a reading, beside its temperature's uncertainty.
_READING_GREY = 5.0
_FACE_K = 301.15
# An anchor on the other side of the ground is this much less sure.
_OTHER_SIDE = 2.0
# This share of an object must stand out from the ground.
_SEEN_SHARE = 0.2
# What the middle of a person's box shows of the clothes' contrast: limbs, straps and the optics take the rest. Measured
# on rendered people of 8 to 30 px through the HIT-UAV chain: median 0.79, at all of these sizes.
_CLOTHING_SEEN = 0.8


@dataclass(frozen=True)
class GainPrior:
    """What is known of the gain before looking, grey levels per kelvin at air temperature.

    HIT-UAV's night scenes have about 6, give or take 30 % (person-ground contrast of 101 levels over 12 to 22 K).
    """

    mean: float = 6.0
    sd: float = 1.8
    low: float = 2.5
    high: float = 12.0


ANCHORS = ("clothing", "car_roof", "face_clipped", "clothing_clipped")


@dataclass(frozen=True)
class Anchor:
    """An annotated object with a roughly known temperature.

    Attributes:
        what: `clothing`, `car_roof`, or `face_clipped`, `clothing_clipped` (lower bounds only).
        grey: Its level minus that of the ground around it.
        kelvin: Assumed apparent temperature.
        sd_k: How uncertain that is.
    """

    what: Literal["clothing", "car_roof", "face_clipped", "clothing_clipped"]
    grey: float
    kelvin: float
    sd_k: float


@dataclass(frozen=True)
class Insert:
    """Where an insert lies.

    Attributes:
        box_xyxy: (4,) pixels; may reach outside the frame.
        range_m: From the camera, or None with a virtual camera, which knows no real distances.
        ground_range_m: From the camera to the ground behind it, or None for none in sight.
        warm: Whether it is on the whole warmer than the ground.
    """

    box_xyxy: NDArray[np.float64]
    range_m: float | None = None
    ground_range_m: float | None = None
    warm: bool = True


def local_mapping(
    background: GreyImage,
    inserts: Sequence[Insert],
    labels: Sequence[Instance],
    weather: Weather,
    time_of_day: TimeOfDay | None,
    levels: tuple[float, float],
    rng: np.random.Generator,
    *,
    prior: GainPrior | None = None,
    polarity: Literal["white-hot", "black-hot"] = "white-hot",
    clothing_k: float = 6.0,
) -> tuple[GreyMapping, dict[str, Any]]:
    """The mapping for the inserts of one frame, and what was estimated on the way.

    Every insert is set against the ground around itself. Cameras stretch what is warmer than the ground and what is
    colder differently, so what is warm takes its gain above all from warm anchors, what is cold from cold ones.

    Args:
        background: (h, w) grey, 8 or 16 bit.
        inserts: At least one.
        labels: The background's own annotated objects: left out of the ground, used as anchors.
        weather: Air and ground temperature.
        time_of_day: Cars are anchors at night only.
        levels: Darkest and brightest level that the dataset uses.
        rng: Draws the gain from its posterior.
        prior: Of the gain; for 16 bit it is scaled by the range of `levels`.
        polarity: Black-hot pictures are turned over on the way in and out.
        clothing_k: How much warmer than the air people's clothes are taken to be.
    """
    prior = prior or GainPrior()
    low, high = levels
    picture = background.astype(np.float32)
    if polarity == "black-hot":
        picture = low + high - picture
    # All gains are per 8-bit level of a dataset that spans about 220 of them.
    scale = grey_unit(background, levels)
    free = np.ones(picture.shape, np.bool_)
    for i in labels:
        x0, y0, x1, y1 = _pixels(i.box_xyxy, picture.shape)
        free[y0:y1, x0:x1] = False
    anchors = find_anchors(picture, free, labels, weather, time_of_day, levels, scale, clothing_k)
    gains, gain_facts = {}, {}
    for warm in (True, False):  # both are drawn, so that one insert's draw does not depend on another's
        gains[warm], gain_facts[warm] = _draw_gain(anchors, weather, scale, prior, warm, rng)

    of_ground, of_air = float(band_radiance(weather.ground_k)), float(band_radiance(weather.air_k))
    grounds, places = [], []
    for insert in inserts:
        ground = ring_level(picture, insert.box_xyxy, free)
        # Contrasts in the picture have come through the air down to the ground; an object nearer loses less.
        clearer, hazier = _through_air(insert, weather)
        gain = gains[insert.warm]
        span = gain * clearer
        dark = ground - gain * of_ground + gain * hazier * of_air
        if polarity == "black-hot":
            dark, span = low + high - dark, -span
        middle = (insert.box_xyxy[:2] + insert.box_xyxy[2:]) / 2
        places.append(Place((float(middle[0]), float(middle[1])), dark, dark + span))
        grounds.append(round(ground, 3))
    first = places[0]
    mapping = GreyMapping(first.dark, first.bright, (low, high), tuple(places) if len(places) > 1 else ())
    facts = {
        "ground_grey": grounds,
        "warm": [i.warm for i in inserts],
        "gain": {("warm" if w else "cold"): gain_facts[w] for w in (True, False) if w in {i.warm for i in inserts}},
        "anchors": {w: sum(a.what == w for a in anchors) for w in ANCHORS},
        "levels": [low, high],
    }
    return mapping, facts


def is_warm(item: ObjectSpec, areas: Mapping[str, float], weather: Weather) -> bool:
    """Whether an object is on the whole warmer than the ground: by area of its labelled parts, half sky mirrored."""
    zenith = float(sky_radiance(weather.air_k, weather.dew_point_k, 0.0, weather.cloud, weather.cloud_base_k))
    ground = float(band_radiance(weather.ground_k))
    total = 0.0
    for name, part in item.parts.items():
        if part.label:
            own = part.emissivity * float(band_radiance(part.temperature_k))
            total += areas.get(name, 0.0) * (own + (1 - part.emissivity) * (zenith + ground) / 2 - ground)
    return bool(total > 0)


def expected_contrast(
    item: ObjectSpec, areas: Mapping[str, float], place: GreyMapping | Place, ground_grey: float, weather: Weather
) -> float:
    """Difference from the ground that a fifth of an object's labelled surface reaches, in the picture's levels.

    Each part is taken to mirror the ground or the zenith, whichever shows more: what this calls invisible is so.

    Args:
        item: The object.
        areas: What is seen of each part, in any unit of area.
        place: The mapping there.
        ground_grey: Level of the ground there.
        weather: Sky and ground.
    """
    zenith = float(sky_radiance(weather.air_k, weather.dew_point_k, 0.0, weather.cloud, weather.cloud_base_k))
    around = (zenith, float(band_radiance(weather.ground_k)))
    found = []
    for name, part in item.parts.items():
        if part.label and areas.get(name, 0.0) > 0:
            own = part.emissivity * float(band_radiance(part.temperature_k))
            levels = [
                place.dark + (place.bright - place.dark) * (own + (1 - part.emissivity) * mirrored)
                for mirrored in around
            ]
            found.append((max(abs(v - ground_grey) for v in levels), areas[name]))
    total, seen = sum(area for _, area in found), 0.0
    for contrast, area in sorted(found, reverse=True):
        seen += area
        if seen >= _SEEN_SHARE * total:
            return contrast
    return 0.0


def grey_unit(background: GreyImage, levels: tuple[float, float]) -> float:
    """How many of a picture's levels make what is one level of an 8-bit dataset spanning about 220 of them."""
    return 1.0 if background.dtype == np.uint8 else (levels[1] - levels[0]) / 220.0


def _through_air(insert: Insert, weather: Weather) -> tuple[float, float]:
    """Factors on the object's radiance and on the air's that is added, relative to what the ground's contrast keeps.

    With tau(d) of the object's path and tau(R) of the ground's, grey is ground + gain / tau(R) * (tau(d) L +
    (1 - tau(d)) L_air - tau(R) L_ground - (1 - tau(R)) L_air); for an object on the ground both paths are equal.
    """
    if insert.range_m is None or insert.ground_range_m is None or insert.range_m >= insert.ground_range_m:
        return 1.0, 0.0
    humidity = relative_humidity(weather.air_k, weather.dew_point_k)
    near, far = (
        float(transmittance(d, weather.air_k, humidity)) for d in (insert.range_m, min(insert.ground_range_m, 1_000.0))
    )
    return near / far, (far - near) / far


def _draw_gain(
    anchors: Sequence[Anchor],
    weather: Weather,
    scale: float,
    prior: GainPrior,
    warm: bool,
    rng: np.random.Generator,
) -> tuple[float, dict[str, Any]]:
    """The gain, levels per W m^-2 sr^-1, from its posterior, and what the posterior is, in 8-bit levels per kelvin.

    `warm` says on which side of the ground it will be used; an anchor on the other side counts for half as sure.
    """
    slope = float(band_radiance_slope(weather.air_k))
    of_ground = float(band_radiance(weather.ground_k))
    mean, variance = prior.mean * scale / slope, (prior.sd * scale / slope) ** 2
    weight, total = 1 / variance, mean / variance
    for a in anchors:
        contrast = float(band_radiance(a.kelvin)) - of_ground
        if a.what.endswith("clipped") or abs(contrast) < 1e-6:
            continue
        noise = math.hypot(_READING_GREY * scale, mean * slope * a.sd_k)
        if (contrast > 0) != warm:
            noise *= _OTHER_SIDE
        weight += (contrast / noise) ** 2
        total += contrast * a.grey / noise**2
    bounds = [prior.low * scale / slope, prior.high * scale / slope]
    for what in ("face_clipped", "clothing_clipped"):
        clipped = [a for a in anchors if a.what == what] if warm else []
        hotter = float(band_radiance(clipped[0].kelvin)) - of_ground if clipped else 0.0
        if hotter > 0:
            at_least = float(np.median([a.grey for a in clipped])) / hotter
            bounds[0] = min(max(bounds[0], at_least), bounds[1])
    centre, sd = total / weight, 1 / math.sqrt(weight)
    gain = _truncated_normal(rng, centre, sd, bounds[0], bounds[1])
    unit = slope / scale
    return gain, {
        "grey_per_k": round(gain * unit, 4),
        "posterior": [round(centre * unit, 4), round(sd * unit, 4)],
        "bounds": [round(b * unit, 4) for b in bounds],
    }


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
    clothing_k: float = 6.0,
) -> tuple[Anchor, ...]:
    """Annotated people (clothes, `clothing_k` above air) and, at night, cars (8 K below air apparent), each +-3 K.

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
        kind = kind_of(i.category)
        h, w = inside.shape
        # Boxes are drawn loosely: half of a person's box is ground. Its middle is the object.
        middle = float(np.median(inside[h // 4 : h - h // 4, w // 4 : w - w // 4]))
        if kind == "person":
            bright = float(np.percentile(inside, 95))
            seen = (middle - around) / _CLOTHING_SEEN
            if floor < middle:
                clipped = middle >= ceiling - 4 * scale
                what: Literal["clothing", "clothing_clipped"] = "clothing_clipped" if clipped else "clothing"
                found.append(Anchor(what, seen, weather.air_k + clothing_k, 3.0))
            if bright >= ceiling:
                found.append(Anchor("face_clipped", bright - around, _FACE_K, 3.0))
        elif kind == "car" and time_of_day == "night" and floor < middle < ceiling:
            found.append(Anchor("car_roof", middle - around, weather.air_k - 8, 3.0))
    return tuple(found)


def measure_levels(backgrounds: Sequence[GreyImage]) -> tuple[float, float]:
    """Darkest and brightest level a dataset uses: the 0.05 and 99.9 % quantiles of all pixels given.

    The codec's ringing reaches beyond the level where scenes are clipped: on HIT-UAV the 99.95 % quantile, 238, is
    ringing already; the 99.9 % one is 235 or 236, where they are.
    """
    if not backgrounds:
        raise ValueError("levels are measured on at least one picture")
    pixels = np.concatenate([np.asarray(b)[::4, ::4].ravel() for b in backgrounds])
    low, high = (float(v) for v in np.percentile(pixels, [0.05, 99.9]))
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
