"""The camera's map from radiance to grey: gain, local share and offset of each background, from its annotated objects.

A camera's automatic gain is unknown, differs from image to image and saturates. The estimate combines priors with
annotated objects of roughly known temperature (anchors). An anchor of radiance L in front of ground at `ring` shows

    level = ground + offset + gain * (L - L_ground) + share * (ring - ground) + noise,

where `ground` is the median level of the picture's ground and L_ground its radiance by the weather that was drawn. The
offset is there because the weather is only a guess: the ground may be warmer or colder than drawn. All three are
estimated from all anchors together and drawn from their joint posterior: first the share, then the gain given the
share; the offset is its expectation given both. Clipped objects give only a lower bound of the gain. Statistics of the
whole picture are not used.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NotRequired, TypedDict, get_args

import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.mapping import GreyImage, grey_unit
from infrablend.core.boxes import boxes_mask, pixel_box
from infrablend.core.capture import TimeOfDay
from infrablend.core.dataset import Instance, known_class
from infrablend.core.quantiles import percentile
from infrablend.thermal.radiometry import band_radiance_slope, radiance_at

# A level within this distance of the dataset's darkest or brightest one counts as clipped; 8-bit levels.
CLIP_MARGIN = 3
# Standard deviation of reading an annotated object's level, in addition to that of its temperature; 8-bit levels.
_READING_GREY = 5.0
_FACE_K = 301.15
# Width of the ring around a box, in lengths of its longer side.
RING_REACH = 1.5
# Standard deviation of the ground's temperature about the drawn one, beyond the scatter of the anchors' own.
_GROUND_K = 2.0
# An anchor on the other side of the ground's temperature gets its uncertainty multiplied by this factor.
_OTHER_SIDE = 2.0
# Share of the clothes' contrast visible in the middle of a person's box; limbs, straps and blur reduce it. Measured
# on rendered people of 8 to 30 px through the HIT-UAV chain: median 0.79, at all of these sizes.
_CLOTHING_SEEN = 0.8

AnchorKind = Literal["clothing", "car_roof", "face_clipped", "clothing_clipped", "land", "land_clipped"]
ANCHORS: tuple[AnchorKind, ...] = get_args(AnchorKind)
Doubt = Literal["gain_negative", "gain_at_bound", "anchors_contradict", "anchors_off", "no_anchor"]
DOUBTS: tuple[Doubt, ...] = get_args(Doubt)
# Mean squared residual of the anchors, in units of their noise, above which they contradict each other.
_MOST_MISFIT = 4.0
# Standard deviations of the mean level of all anchors, by the priors, beyond which weather or polarity are wrong.
_MOST_OFF = 2.5


class GainFacts(TypedDict):
    """How a gain was estimated, as plain JSON values; see `draw_gain`.

    `from_prior` is there, and True, where the doubts are those of anchors that were not used in the end.
    """

    grey_per_k: float
    posterior: list[float]
    bounds: list[float]
    anchors_used: int
    offset_grey: float
    doubts: list[str]
    from_prior: NotRequired[bool]


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
        time_of_day: Time of day, None if unknown; by day no object is an anchor, by night people and cars are, else
            people.
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
        ring: Level of the ground around it minus that of the picture's ground; 0 against the sky.
        sky_radiance: Radiance of the sky it is compared with; None for the ground.
    """

    kind: AnchorKind
    grey: float
    kelvin: float
    sd_k: float
    ring: float = 0.0
    sky_radiance: float | None = None

    def contrast(self, ground_radiance: float) -> float:
        """Return its radiance above that of what it is compared with."""
        behind = ground_radiance if self.sky_radiance is None else self.sky_radiance
        return radiance_at(self.kelvin) - behind

    def above_ground(self, share: float) -> float:
        """Return the level above the picture's ground (or sky), without the local share of the surroundings."""
        return self.grey + (1 - share) * self.ring


@dataclass(frozen=True)
class SharePrior:
    """The local share expected before looking at the picture, 0 to 1, and the neighbourhood that it refers to.

    Attributes:
        mean: Expected share.
        sd: Standard deviation; at 0, and with a mean of 0 or 1, the mean is taken as exact.
        reach: Width of the ring around an object's box, in lengths of the box's longer side.
    """

    mean: float = 1.0
    sd: float = 0.05
    reach: float = RING_REACH

    @property
    def is_exact(self) -> bool:
        """Whether nothing is to be estimated."""
        return self.sd == 0 or self.mean in {0.0, 1.0}


def find_anchors(
    picture: NDArray[np.float32],
    free: NDArray[np.bool_],
    backdrop: Backdrop,
    air_k: float,
    clothing_k: float = 6.0,
    ground_grey: float | None = None,
    reach: float = RING_REACH,
) -> tuple[Anchor, ...]:
    """Read the anchors of a picture: people's clothes and, at night, car roofs, each known to 3 K.

    By day there are none: in the sun, one side of a person is 20 K warmer than the other. A person whose brightest part
    is clipped gives a lower bound; clipped clothing gives no reading. `picture` has the backdrop's levels, white-hot;
    `free` are the pixels outside all labels' boxes. Car roofs are taken to look 8 K colder than the air, clothes
    `clothing_k` warmer. Without a `ground_grey`, anchors refer to their own surroundings.
    """
    found: list[Anchor] = []
    scale = backdrop.grey_unit
    levels = backdrop.levels
    ceiling = levels[1] - CLIP_MARGIN * scale
    floor = levels[0] + CLIP_MARGIN * scale
    for i in backdrop.labels:
        x0, y0, x1, y1 = pixel_box(i.box_xyxy, picture.shape)
        inside = picture[y0:y1, x0:x1]
        if inside.size < 20:
            continue
        around = ring_level(picture, i.box_xyxy, free, reach)
        ring = 0.0 if ground_grey is None else around - ground_grey
        known = None if i.is_crowd else known_class(i.category)
        h, w = inside.shape
        # Boxes are drawn loosely: half of a person's box is ground. Its middle is the object.
        middle = float(np.median(inside[h // 4 : h - h // 4, w // 4 : w - w // 4]))
        if known == "person" and backdrop.time_of_day != "day":
            bright = percentile(inside, 95)
            seen = (middle - around) / _CLOTHING_SEEN
            if floor < middle:
                clipped = middle >= ceiling - 4 * scale
                kind: AnchorKind = "clothing_clipped" if clipped else "clothing"
                found.append(Anchor(kind, seen, air_k + clothing_k, 3.0, ring))
            if bright >= ceiling:
                found.append(Anchor("face_clipped", bright - around, _FACE_K, 3.0, ring))
        elif known == "car" and backdrop.time_of_day == "night" and floor < middle < ceiling:
            found.append(Anchor("car_roof", middle - around, air_k - 8, 3.0, ring))
    return tuple(found)


def draw_share(
    anchors: Sequence[Anchor],
    air_k: float,
    reference: float,
    scale: float,
    prior: SharePrior,
    gain: GainPrior,
    rng: np.random.Generator,
) -> tuple[float, dict[str, object]]:
    """Draw the local share from its posterior, whatever gain and offset are.

    `reference` is the radiance of the ground, `scale` the number of levels per 8-bit level.

    Returns:
        The share, 0 to 1; its posterior, and the number of anchors used.
    """
    read = _Readings.of(anchors, air_k, reference, scale, gain)
    if prior.is_exact:
        return prior.mean, {"drawn": prior.mean, "posterior": [prior.mean, 0.0], "anchors_used": 0}
    # The unknown gain makes the levels of all anchors rise and fall together with their contrasts.
    known = np.linalg.inv(read.covariance + (gain.sd * read.grey_per_k) ** 2 * np.outer(read.contrast, read.contrast))
    rest = read.above_ground(0.0) - gain.mean * read.grey_per_k * read.contrast
    weight = 1 / prior.sd**2 + read.ring @ known @ read.ring
    centre = float((prior.mean / prior.sd**2 + read.ring @ known @ rest) / weight)
    sd = float(weight) ** -0.5
    share = _truncated_normal(rng, centre, sd, 0.0, 1.0)
    posterior = [round(centre, 4), round(sd, 4)]
    return share, {"drawn": round(share, 4), "posterior": posterior, "anchors_used": len(read.ring)}


def draw_gain(
    anchors: Sequence[Anchor],
    air_k: float,
    reference: float,
    scale: float,
    prior: GainPrior,
    warm: bool,
    rng: np.random.Generator,
    share: float = 1.0,
) -> tuple[float, float, GainFacts]:
    """Draw the gain, levels per W m^-2 sr^-1, from its posterior given the local share.

    `reference` is the radiance of the ground, `scale` the number of levels per 8-bit level. The gain is for inserts
    warmer or colder than the reference; anchors on the other side get less weight.

    Returns:
        The gain; the expected offset of the ground, in levels of the picture; the posterior that the gain was drawn
        from, in 8-bit levels per kelvin, with the number of anchors used, the offset in 8-bit levels and `doubts`, the
        reasons not to trust the gain (`DOUBTS`).
    """
    read = _Readings.of(anchors, air_k, reference, scale, prior, warm)
    slope = float(band_radiance_slope(air_k))
    grey = read.above_ground(share)
    variance = (prior.sd * read.grey_per_k) ** 2
    known = np.linalg.inv(read.covariance)
    weight = 1 / variance + read.contrast @ known @ read.contrast
    centre = float((prior.mean * read.grey_per_k / variance + read.contrast @ known @ grey) / weight)
    sd = float(weight) ** -0.5
    bounds = [prior.low * read.grey_per_k, prior.high * read.grey_per_k]
    for kind in ("face_clipped", "clothing_clipped", "land_clipped"):
        clipped = [a for a in anchors if a.kind == kind] if warm else []
        hotter = clipped[0].contrast(reference) if clipped else 0.0
        if hotter > 0:
            at_least = float(np.median([a.above_ground(share) for a in clipped])) / hotter
            bounds[0] = min(max(bounds[0], at_least), bounds[1])
    gain = _truncated_normal(rng, centre, sd, bounds[0], bounds[1])
    offset = read.offset_variance * float(read.of_ground @ known @ (grey - gain * read.contrast))
    expected = prior.mean * read.grey_per_k * read.contrast
    alike = np.linalg.inv(read.covariance + variance * np.outer(read.contrast, read.contrast))
    off = abs(float((alike @ (grey - expected)).sum())) / math.sqrt(max(float(alike.sum()), 1e-12))
    unit = slope / scale
    facts: GainFacts = {
        "grey_per_k": round(gain * unit, 4),
        "posterior": [round(centre * unit, 4), round(sd * unit, 4)],
        "bounds": [round(b * unit, 4) for b in bounds],
        "anchors_used": len(grey),
        "offset_grey": round(offset / scale, 3),
        "doubts": _doubts(centre, bounds, off, (grey - offset * read.of_ground - centre * read.contrast) / read.noise),
    }
    return gain, offset, facts


@dataclass(frozen=True, eq=False)
class _Readings:
    """The unclipped anchors of a picture as arrays.

    Attributes:
        grey_per_k: Levels per radiance for a gain of one 8-bit level per kelvin.
        contrast: (n,) radiance above the reference.
        grey: (n,) level above the surroundings.
        ring: (n,) level of the surroundings above the picture's ground.
        noise: (n,) standard deviation of the level, from the reading and the temperature.
        of_ground: (n,) 1 for levels above the ground, 0 for those above the sky.
        offset_variance: Variance of the offset that all levels above the ground share.
    """

    grey_per_k: float
    contrast: NDArray[np.float64]
    grey: NDArray[np.float64]
    ring: NDArray[np.float64]
    noise: NDArray[np.float64]
    of_ground: NDArray[np.float64]
    offset_variance: float

    @classmethod
    def of(
        cls,
        anchors: Sequence[Anchor],
        air_k: float,
        reference: float,
        scale: float,
        prior: GainPrior,
        warm: bool | None = None,
    ) -> _Readings:
        """Read anchors; with `warm`, those on the other side of the reference count less."""
        rows = []
        for a in anchors:
            contrast = a.contrast(reference)
            if a.kind.endswith("clipped") or abs(contrast) < 1e-6:
                continue
            noise = math.hypot(_READING_GREY, prior.mean * a.sd_k) * scale
            if warm is not None and (contrast > 0) != warm:
                noise *= _OTHER_SIDE
            # The sky's radiance is what the weather states, and the step to the land was measured beside it.
            rows.append((contrast, a.grey, a.ring, noise, float(a.sky_radiance is None)))
        contrasts, grey, ring, noises, of_ground = np.array(rows, np.float64).reshape(-1, 5).T
        offset = (prior.mean * _GROUND_K * scale) ** 2
        return cls(scale / float(band_radiance_slope(air_k)), contrasts, grey, ring, noises, of_ground, offset)

    @property
    def covariance(self) -> NDArray[np.float64]:
        """(n, n) covariance of the levels: own noise, and the common offset of those above the ground."""
        common = self.offset_variance * np.outer(self.of_ground, self.of_ground)
        return np.asarray(np.diag(self.noise**2) + common, np.float64)

    def above_ground(self, share: float) -> NDArray[np.float64]:
        """Return the (n,) levels above the picture's ground, without the local share of the surroundings."""
        return self.grey + (1 - share) * self.ring


def _doubts(centre: float, bounds: Sequence[float], off: float, residuals: NDArray[np.float64]) -> list[str]:
    """Return the reasons in `DOUBTS` that hold for a posterior.

    `off` is the distance of the anchors' mean level from the priors', in standard deviations; `residuals` are in units
    of the noise.
    """
    found = {
        "gain_negative": centre <= 0,
        "gain_at_bound": not bounds[0] < centre < bounds[1],
        "anchors_contradict": residuals.size > 1 and float(np.mean(residuals**2)) > _MOST_MISFIT,
        "anchors_off": off > _MOST_OFF,
        "no_anchor": not residuals.size,
    }
    return [kind for kind in DOUBTS if found[kind]]


def ring_level(
    picture: NDArray[np.float32], box_xyxy: NDArray[np.float64], free: NDArray[np.bool_], reach: float = RING_REACH
) -> float:
    """Return the median level of the free pixels around a box.

    On each side the ring extends beyond the box by `reach` times its longer side, at least 12 px. If too little of the
    ring is free, all free pixels of the picture are used; if these are too few, the whole picture.
    """
    x0, y0, x1, y1 = box_xyxy
    width = max(reach * max(x1 - x0, y1 - y0), 12.0)
    left, top, right, bottom = pixel_box(np.array([x0 - width, y0 - width, x1 + width, y1 + width]), picture.shape)
    inner = pixel_box(box_xyxy, picture.shape)
    part = (slice(top, bottom), slice(left, right))
    use = free[part].copy()
    use[max(inner[1] - top, 0) : max(inner[3] - top, 0), max(inner[0] - left, 0) : max(inner[2] - left, 0)] = False
    for levels, mask in ((picture[part], use), (picture, free)):
        if np.count_nonzero(mask) >= 50:
            return float(np.median(levels[mask]))
    return float(np.median(picture))


def _truncated_normal(rng: np.random.Generator, mean: float, sd: float, low: float, high: float) -> float:
    for _ in range(200):
        draw = float(rng.normal(mean, sd))
        if low <= draw <= high:
            return draw
    return min(max(mean, low), high)
