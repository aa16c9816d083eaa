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
class GreyMapping:
    """`grey = dark + (bright - dark) * radiance`, in the background's own levels; black-hot has dark > bright.

    `limits` are the darkest and brightest level that the camera writes; surfaces beyond them saturate there.
    """

    dark: float
    bright: float
    limits: tuple[float, float] | None = None

    def apply(self, radiance: NDArray[np.float32], alpha: NDArray[np.float32]) -> NDArray[np.float32]:
        """(h, w) premultiplied grey levels of premultiplied radiance."""
        grey = np.float32(self.dark) * alpha + np.float32(self.bright - self.dark) * radiance
        if self.limits is not None:
            low, high = (np.float32(v) for v in self.limits)
            grey = np.clip(grey, low * alpha, high * alpha)
        return np.asarray(grey, np.float32)

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        plain: dict[str, Any] = {"dark": self.dark, "bright": self.bright}
        return plain if self.limits is None else {**plain, "limits": list(self.limits)}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> GreyMapping:
        """The mapping that `to_json` wrote."""
        low_high = data.get("limits")
        return cls(data["dark"], data["bright"], None if low_high is None else (low_high[0], low_high[1]))


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
