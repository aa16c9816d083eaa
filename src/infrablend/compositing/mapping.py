"""Grey-level mapping: from radiance to the levels of a background.

A mapping is affine, `grey = dark + (bright - dark) * radiance`, because only then may it be applied to light that is
premultiplied by alpha. `percentile_mapping` takes it from the background's own levels, `local` from physics.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.config.recipe import PercentileMatching
from infrablend.core.temperature import TemperatureScale

GreyImage = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True)
class Place:
    """The mapping around one of several inserts, used by all pixels nearer to it than to the others.

    Attributes:
        centre_xy: Middle of the insert, pixels of the frame.
        dark: Level of radiance 0.
        bright: Level of radiance 1.
    """

    centre_xy: tuple[float, float]
    dark: float
    bright: float


@dataclass(frozen=True)
class GreyMapping:
    """`grey = dark + (bright - dark) * radiance`, in the background's own levels; black-hot has dark > bright.

    Attributes:
        dark: Level of radiance 0.
        bright: Level of radiance 1.
        limits: Darkest and brightest level of surfaces, before the optics; surfaces beyond them saturate there.
        places: The mapping around each insert if there are several; `dark` and `bright` are then those of the first.
        scale: Scale of a background's temperatures; the mapping then gives radiance at the sensor, W m^-2 sr^-1,
            instead of levels (`radiometric`). None for backgrounds in grey levels.
    """

    dark: float
    bright: float
    limits: tuple[float, float] | None = None
    places: tuple[Place, ...] = ()
    scale: TemperatureScale | None = None

    @classmethod
    def around(
        cls, places: Sequence[Place], limits: tuple[float, float] | None = None, scale: TemperatureScale | None = None
    ) -> GreyMapping:
        """Return the mapping around inserts, at least one."""
        return cls(places[0].dark, places[0].bright, limits, tuple(places) if len(places) > 1 else (), scale)

    def apply(
        self, radiance: NDArray[np.float32], alpha: NDArray[np.float32], offset_xy: tuple[int, int] = (0, 0)
    ) -> NDArray[np.float32]:
        """Return the (h, w) premultiplied grey levels of the premultiplied radiance of a crop at `offset_xy`."""
        dark: Any = np.float32(self.dark)
        span: Any = np.float32(self.bright - self.dark)
        if len(self.places) > 1:
            rows, columns = np.nonzero((alpha != 0) | (radiance != 0))
            x, y = (n.astype(np.float32) + np.float32(o + 0.5) for n, o in zip((columns, rows), offset_xy, strict=True))
            away = [np.hypot(x - np.float32(p.centre_xy[0]), y - np.float32(p.centre_xy[1])) for p in self.places]
            nearest = np.argmin(away, axis=0)
            dark = np.zeros_like(alpha)
            span = np.zeros_like(alpha)
            dark[rows, columns] = np.array([p.dark for p in self.places], np.float32)[nearest]
            span[rows, columns] = np.array([p.bright - p.dark for p in self.places], np.float32)[nearest]
        grey = dark * alpha + span * radiance
        if self.limits is not None:
            low, high = (np.float32(v) for v in self.limits)
            grey = np.clip(grey, low * alpha, high * alpha)
        return np.asarray(grey, np.float32)

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        plain: dict[str, object] = {"dark": self.dark, "bright": self.bright}
        if self.limits is not None:
            plain["limits"] = list(self.limits)
        if self.places:
            plain["places"] = [[*p.centre_xy, p.dark, p.bright] for p in self.places]
        if self.scale is not None:
            plain["scale"] = self.scale.to_json()
        return plain

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> GreyMapping:
        """Return the mapping that `to_json` wrote."""
        limits = data.get("limits")
        places = tuple(Place((x, y), dark, bright) for x, y, dark, bright in data.get("places", ()))
        scale = None if "scale" not in data else TemperatureScale.from_json(data["scale"])
        return cls(data["dark"], data["bright"], None if limits is None else (limits[0], limits[1]), places, scale)


# Percentiles between which a 16-bit picture's own range lies.
_RANGE_OF_16_BIT = (0.05, 99.95)


def percentile_mapping(background: GreyImage, matching: PercentileMatching) -> GreyMapping:
    """Return the mapping that shows cold and hot surfaces at two percentiles of the background itself.

    The least span is a share of the type's range (8 bit) or of the background's own range (16 bit, whose full range
    means nothing); a smaller one is widened about its middle.
    """
    percentiles = [matching.low_percentile, matching.high_percentile]
    dark, bright = (float(v) for v in np.percentile(background, percentiles))
    if background.dtype == np.uint8:
        top, bottom = 255.0, 0.0
    else:
        # Not the extremes: a dead or hot pixel may be far from the scene.
        bottom, top = (float(v) for v in np.percentile(background, _RANGE_OF_16_BIT))
    span = max(matching.min_span * (top - bottom), 1.0)
    if bright - dark < span:
        middle = (dark + bright) / 2
        middle = min(max(middle, bottom + span / 2), top - span / 2)
        dark, bright = middle - span / 2, middle + span / 2
    return GreyMapping(dark, bright) if matching.polarity == "white-hot" else GreyMapping(bright, dark)


def measure_levels(backgrounds: Sequence[GreyImage]) -> tuple[float, float]:
    """Return the darkest and brightest level a dataset uses: the 0.05 and 99.9 % quantiles of all pixels given.

    The codec's ringing reaches beyond the level where scenes are clipped: on HIT-UAV the 99.95 % quantile, 238, is
    already ringing; the 99.9 % one is 235 or 236, where they are clipped.
    """
    if not backgrounds:
        raise ValueError("levels are measured on at least one picture")
    pixels = np.concatenate([np.asarray(b)[::4, ::4].ravel() for b in backgrounds])
    low, high = (float(v) for v in np.percentile(pixels, [0.05, 99.9]))
    return low, max(high, low + 1)


def grey_unit(background: GreyImage, levels: tuple[float, float]) -> float:
    """Return the number of a picture's levels per level of an 8-bit dataset that spans about 220 of them."""
    return 1.0 if background.dtype == np.uint8 else (levels[1] - levels[0]) / 220.0
