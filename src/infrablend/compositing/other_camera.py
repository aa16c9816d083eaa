"""Another camera for a finished picture: optics, gain, noise and bit depth, over insert and background alike.

A detector for a camera that nobody has pictures of must not depend on one camera's blur or noise. The picture has been
through its own camera already, so this can only add to it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.mapping import GreyImage
from infrablend.compositing.sensor import blurred, enhance, grain
from infrablend.config.recipe import Randomise

# Sigmas, px: of scattered light, of the detail enhancement, and of the noise's grain.
_BLOOM_PX = 3.0
_HALO_PX = 1.6
_GRAIN_PX = 0.6


@dataclass(frozen=True)
class OtherCamera:
    """What is done to a picture, in this order.

    Attributes:
        blur_px: Sigma of an additional blur; 0 for none.
        bloom: Share of the light that is scattered around each point.
        gain: Factor on the contrast, around the median level.
        noise_grey: Standard deviation of additional noise, 8-bit levels.
        noise_seed: Seed of the noise.
        halo: Gain of the detail enhancement.
        inverted: Whether warm becomes dark, or bright where it was dark.
        bits: Number of bits that are left of 8.
        grey_unit: Levels of the picture per 8-bit level.
    """

    blur_px: float
    bloom: float
    gain: float
    noise_grey: float
    noise_seed: int
    halo: float
    inverted: bool
    bits: int
    grey_unit: float = 1.0

    @classmethod
    def draw(cls, rules: Randomise, grey_unit: float, rng: np.random.Generator) -> OtherCamera:
        """Draw a camera; every call uses the same number of random numbers."""
        ranges = (rules.blur_px, rules.bloom, rules.gain, rules.noise_grey, rules.halo)
        blur, bloom, gain, noise, halo = (round(float(rng.uniform(*r)), 4) for r in ranges)
        inverted = bool(rng.random() < rules.invert)
        bits = int(rng.integers(round(rules.bits[0]), round(rules.bits[1]), endpoint=True))
        return cls(blur, bloom, gain, noise, int(rng.integers(1 << 31)), halo, inverted, bits, grey_unit)

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> OtherCamera:
        """Return the camera that `to_json` wrote."""
        return cls(**data)

    def take(self, pixels: GreyImage) -> GreyImage:
        """Return an (h, w) picture as this camera shows it, in the same type."""
        top = np.iinfo(pixels.dtype).max
        picture: NDArray[np.float64] = pixels.astype(np.float64)
        if self.blur_px > 0:
            picture = blurred(picture, self.blur_px)
        if self.bloom > 0:
            picture = (1 - self.bloom) * picture + self.bloom * blurred(picture, _BLOOM_PX)
        middle = float(np.median(picture))
        picture = middle + self.gain * (picture - middle)
        if self.noise_grey > 0:
            picture = picture + grain(picture.shape, self.noise_grey * self.grey_unit, _GRAIN_PX, self.noise_seed)
        if self.halo > 0:
            picture = enhance(picture, self.halo, _HALO_PX)
        if self.inverted:
            picture = float(pixels.min()) + float(pixels.max()) - picture
        if self.bits < 8:
            step = self.grey_unit * 2.0 ** (8 - self.bits)
            picture = np.rint(picture / step) * step
        return np.asarray(np.clip(np.rint(picture), 0, top).astype(pixels.dtype))
