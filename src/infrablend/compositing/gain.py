"""The camera's gain: grey levels per unit of radiance, estimated for each background and drawn from its posterior.

A camera's automatic gain is unknown, differs from image to image and saturates. The estimate combines a prior with
annotated objects of roughly known temperature (anchors). Clipped objects give only a lower bound. Statistics of the
whole picture are not used.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.mapping import GreyImage, grey_unit
from infrablend.core.boxes import boxes_mask, pixel_box
from infrablend.core.class_names import known_class
from infrablend.core.dataset import Instance, TimeOfDay
from infrablend.thermal.radiometry import band_radiance, band_radiance_slope

# A level within this distance of the dataset's darkest or brightest one counts as clipped; 8-bit levels.
CLIP_MARGIN = 3
# Standard deviation of reading an annotated object's level, in addition to that of its temperature; 8-bit levels.
_READING_GREY = 5.0
_FACE_K = 301.15
# An anchor on the other side of the ground's temperature gets its uncertainty multiplied by this factor.
_OTHER_SIDE = 2.0
# Share of the clothes' contrast visible in the middle of a person's box; limbs, straps and blur reduce it. Measured
# on rendered people of 8 to 30 px through the HIT-UAV chain: median 0.79, at all of these sizes.
_CLOTHING_SEEN = 0.8

AnchorKind = Literal["clothing", "car_roof", "face_clipped", "clothing_clipped", "land", "land_clipped"]
ANCHORS: tuple[AnchorKind, ...] = get_args(AnchorKind)
Doubt = Literal["gain_negative", "gain_at_bound", "anchors_contradict", "no_anchor"]
DOUBTS: tuple[Doubt, ...] = get_args(Doubt)
# Mean squared residual of the anchors, in units of their noise, above which they contradict each other.
_MOST_MISFIT = 4.0


def is_untrusted(doubts: Sequence[str]) -> bool:
    """Return whether a gain's doubts are reasons not to trust it; the prior alone (`no_anchor`) is no such reason."""
    return any(kind != "no_anchor" for kind in doubts)


@dataclass(frozen=True)
class GainPrior:
    """The gain expected before looking at the picture, grey levels per kelvin at air temperature.

    HIT-UAV's night scenes have about 6, with a spread of 30 % (person-ground contrast of 101 levels over 12 to 22 K).

    Attributes:
        mean: Expected gain.
        sd: Standard deviation.
        low: Smallest gain that is drawn.
        high: Largest gain that is drawn.
    """

    mean: float = 6.0
    sd: float = 1.8
    low: float = 2.5
    high: float = 12.0


@dataclass(frozen=True, eq=False)
class Backdrop:
    """A background as matching sees it.

    Attributes:
        pixels: (h, w) grey levels, 8 or 16 bit.
        labels: The background's own annotated objects: excluded from the ground, used as anchors.
        time_of_day: Time of day, None if unknown; by day no object is an anchor, by night people and cars are.
        levels: Darkest and brightest level that the dataset uses.
    """

    pixels: GreyImage
    labels: Sequence[Instance]
    time_of_day: TimeOfDay | None
    levels: tuple[float, float]

    @property
    def grey_unit(self) -> float:
        """Number of the picture's levels per level of an 8-bit dataset; all gains are per 8-bit level."""
        return grey_unit(self.pixels, self.levels)

    def free(self) -> NDArray[np.bool_]:
        """Mark the (h, w) pixels outside all labels' boxes."""
        return ~boxes_mask((i.box_xyxy for i in self.labels), self.pixels.shape)


@dataclass(frozen=True)
class Anchor:
    """An annotated object with a roughly known temperature.

    Attributes:
        kind: `clothing`, `car_roof`, `land` (ground and trees, against the sky), or `face_clipped`,
            `clothing_clipped`, `land_clipped` (lower bounds only).
        grey: Level of the object minus that of what it is compared with: the ground around it, or the sky.
        kelvin: Assumed apparent temperature.
        sd_k: Standard deviation of that temperature.
    """

    kind: AnchorKind
    grey: float
    kelvin: float
    sd_k: float


def find_anchors(
    picture: NDArray[np.float32], free: NDArray[np.bool_], backdrop: Backdrop, air_k: float, clothing_k: float = 6.0
) -> tuple[Anchor, ...]:
    """Read the anchors of a picture: people's clothes and, at night, car roofs, each known to 3 K.

    By day there are none: in the sun, one side of a person is 20 K warmer than the other.
    A person whose brightest part is clipped gives a lower bound; clipped clothing gives no reading.

    Args:
        picture: (h, w) levels of the backdrop, white-hot.
        free: (h, w) pixels outside all labels' boxes.
        backdrop: The background.
        air_k: Air temperature. Car roofs are taken to look 8 K colder.
        clothing_k: Assumed excess of clothes over the air temperature.
    """
    found: list[Anchor] = []
    scale, levels = backdrop.grey_unit, backdrop.levels
    ceiling = levels[1] - CLIP_MARGIN * scale
    floor = levels[0] + CLIP_MARGIN * scale
    for i in backdrop.labels:
        x0, y0, x1, y1 = pixel_box(i.box_xyxy, picture.shape)
        inside = picture[y0:y1, x0:x1]
        if inside.size < 20:
            continue
        around = ring_level(picture, i.box_xyxy, free)
        known = known_class(i.category)
        h, w = inside.shape
        # Boxes are drawn loosely: half of a person's box is ground. Its middle is the object.
        middle = float(np.median(inside[h // 4 : h - h // 4, w // 4 : w - w // 4]))
        if known == "person" and backdrop.time_of_day != "day":
            bright = float(np.percentile(inside, 95))
            seen = (middle - around) / _CLOTHING_SEEN
            if floor < middle:
                clipped = middle >= ceiling - 4 * scale
                kind: AnchorKind = "clothing_clipped" if clipped else "clothing"
                found.append(Anchor(kind, seen, air_k + clothing_k, 3.0))
            if bright >= ceiling:
                found.append(Anchor("face_clipped", bright - around, _FACE_K, 3.0))
        elif known == "car" and backdrop.time_of_day == "night" and floor < middle < ceiling:
            found.append(Anchor("car_roof", middle - around, air_k - 8, 3.0))
    return tuple(found)


def draw_gain(
    anchors: Sequence[Anchor],
    air_k: float,
    reference: float,
    scale: float,
    prior: GainPrior,
    warm: bool,
    rng: np.random.Generator,
) -> tuple[float, dict[str, Any]]:
    """Draw the gain, levels per W m^-2 sr^-1, from its posterior.

    Args:
        anchors: Readings of the picture.
        air_k: Air temperature.
        reference: Radiance that the anchors' levels are relative to: that of the ground, or of the sky.
        scale: Levels of the picture per 8-bit level.
        prior: The gain expected beforehand.
        warm: Whether the gain is for inserts warmer than the reference; anchors on the other side get less weight.
        rng: Draws the gain.

    Returns:
        The gain; the posterior it was drawn from, in 8-bit levels per kelvin, with the number of anchors used and
        `doubts`, the reasons not to trust it (`DOUBTS`).
    """
    slope = float(band_radiance_slope(air_k))
    mean, variance = prior.mean * scale / slope, (prior.sd * scale / slope) ** 2
    weight, total = 1 / variance, mean / variance
    used = []
    for a in anchors:
        contrast = float(band_radiance(a.kelvin)) - reference
        if a.kind.endswith("clipped") or abs(contrast) < 1e-6:
            continue
        noise = math.hypot(_READING_GREY * scale, mean * slope * a.sd_k)
        if (contrast > 0) != warm:
            noise *= _OTHER_SIDE
        weight += (contrast / noise) ** 2
        total += contrast * a.grey / noise**2
        used.append((contrast, a.grey, noise))
    bounds = [prior.low * scale / slope, prior.high * scale / slope]
    for kind in ("face_clipped", "clothing_clipped", "land_clipped"):
        clipped = [a for a in anchors if a.kind == kind] if warm else []
        hotter = float(band_radiance(clipped[0].kelvin)) - reference if clipped else 0.0
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
        "anchors_used": len(used),
        "doubts": _doubts(centre, bounds, used),
    }


def _doubts(centre: float, bounds: Sequence[float], used: Sequence[tuple[float, float, float]]) -> list[str]:
    """Return the reasons in `DOUBTS` that hold for a posterior; `used` has contrast, level and noise of each anchor."""
    misfit = [((grey - centre * contrast) / noise) ** 2 for contrast, grey, noise in used]
    found = {
        "gain_negative": centre <= 0,
        "gain_at_bound": not bounds[0] < centre < bounds[1],
        "anchors_contradict": len(used) > 1 and float(np.mean(misfit)) > _MOST_MISFIT,
        "no_anchor": not used,
    }
    return [kind for kind in DOUBTS if found[kind]]


def ring_level(picture: NDArray[np.float32], box_xyxy: NDArray[np.float64], free: NDArray[np.bool_]) -> float:
    """Return the median level of the free pixels around a box.

    On each side the ring extends beyond the box by 1.5 times its longer side, at least 12 px. If too little of the ring
    is free, all free pixels of the picture are used; if these are too few, the whole picture.
    """
    x0, y0, x1, y1 = box_xyxy
    reach = max(1.5 * max(x1 - x0, y1 - y0), 12.0)
    left, top, right, bottom = pixel_box(np.array([x0 - reach, y0 - reach, x1 + reach, y1 + reach]), picture.shape)
    inner = pixel_box(box_xyxy, picture.shape)
    use = np.zeros_like(free)
    use[top:bottom, left:right] = free[top:bottom, left:right]
    use[inner[1] : inner[3], inner[0] : inner[2]] = False
    for mask in (use, free):
        if mask.sum() >= 50:
            return float(np.median(picture[mask]))
    return float(np.median(picture))


def _truncated_normal(rng: np.random.Generator, mean: float, sd: float, low: float, high: float) -> float:
    for _ in range(200):
        draw = float(rng.normal(mean, sd))
        if low <= draw <= high:
            return draw
    return min(max(mean, low), high)
