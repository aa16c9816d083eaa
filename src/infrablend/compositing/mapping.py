"""Grey-level mapping: what radiance becomes in a background's own display space.

A mapping is affine, `grey = dark + (bright - dark) * radiance`, because only then may it be applied to light that is
premultiplied by alpha. `Mapper` is the port; the percentile mapper stands in it until a physical one does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

GreyImage = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True)
class Place:
    """The mapping around one of several inserts: what lies nearest to `centre_xy` (pixels of the frame) uses it."""

    centre_xy: tuple[float, float]
    dark: float
    bright: float


@dataclass(frozen=True)
class GreyMapping:
    """`grey = dark + (bright - dark) * radiance`, in the background's own levels; black-hot has dark > bright.

    `limits` are the darkest and brightest level that the camera writes; surfaces beyond them saturate there. `places`,
    if there are several, say how the mapping differs between inserts; `dark` and `bright` are then the first one's.
    """

    dark: float
    bright: float
    limits: tuple[float, float] | None = None
    places: tuple[Place, ...] = ()

    def apply(
        self, radiance: NDArray[np.float32], alpha: NDArray[np.float32], offset_xy: tuple[int, int] = (0, 0)
    ) -> NDArray[np.float32]:
        """(h, w) premultiplied grey levels of premultiplied radiance, of a crop at `offset_xy`."""
        dark: Any = np.float32(self.dark)
        span: Any = np.float32(self.bright - self.dark)
        if len(self.places) > 1:
            rows, columns = np.indices(alpha.shape, np.float32)
            x, y = columns + np.float32(offset_xy[0] + 0.5), rows + np.float32(offset_xy[1] + 0.5)
            away = [np.hypot(x - np.float32(p.centre_xy[0]), y - np.float32(p.centre_xy[1])) for p in self.places]
            nearest = np.argmin(away, axis=0)
            dark = np.array([p.dark for p in self.places], np.float32)[nearest]
            span = np.array([p.bright - p.dark for p in self.places], np.float32)[nearest]
        grey = dark * alpha + span * radiance
        if self.limits is not None:
            low, high = (np.float32(v) for v in self.limits)
            grey = np.clip(grey, low * alpha, high * alpha)
        return np.asarray(grey, np.float32)

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        plain: dict[str, Any] = {"dark": self.dark, "bright": self.bright}
        if self.limits is not None:
            plain["limits"] = list(self.limits)
        if self.places:
            plain["places"] = [[*p.centre_xy, p.dark, p.bright] for p in self.places]
        return plain

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> GreyMapping:
        """The mapping that `to_json` wrote."""
        limits = data.get("limits")
        places = tuple(Place((x, y), dark, bright) for x, y, dark, bright in data.get("places", ()))
        return cls(data["dark"], data["bright"], None if limits is None else (limits[0], limits[1]), places)


class Mapper(Protocol):
    """Chooses the mapping for one background."""

    def __call__(self, background: GreyImage) -> GreyMapping:
        """The mapping for a (h, w) grey background of 8 or 16 bit."""
        ...


@dataclass(frozen=True)
class PercentileMapper:
    """Anchors cold and hot at two percentiles of the background itself.

    Attributes:
        low, high: Percentiles, 0 to 100.
        min_span: Least distance of the two levels as a share of the type's range (8 bit) or of the background's own
            range (16 bit, whose full range means nothing); the pair is widened about its middle if nearer.
        polarity: `black-hot` swaps the ends.
    """

    low: float = 1.0
    high: float = 99.5
    min_span: float = 0.35
    polarity: Literal["white-hot", "black-hot"] = "white-hot"

    def __call__(self, background: GreyImage) -> GreyMapping:
        """The mapping for this background."""
        dark, bright = (float(v) for v in np.percentile(background, [self.low, self.high]))
        if background.dtype == np.uint8:
            top, bottom = 255.0, 0.0
        else:
            top, bottom = float(background.max()), float(background.min())
        span = max(self.min_span * (top - bottom), 1.0)
        if bright - dark < span:
            middle = (dark + bright) / 2
            middle = min(max(middle, bottom + span / 2), top - span / 2)
            dark, bright = middle - span / 2, middle + span / 2
        return GreyMapping(dark, bright) if self.polarity == "white-hot" else GreyMapping(bright, dark)
