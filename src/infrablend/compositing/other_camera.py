"""Another camera for a finished picture: optics, gain, noise, bit depth and graphics, over insert and background.

A detector for a camera that nobody has pictures of must not depend on one camera's blur or noise. The picture has been
through its own camera already, so this can only add to it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.graphics import draw_graphics
from infrablend.compositing.mapping import GreyImage
from infrablend.compositing.sensor import blurred, enhance, grain
from infrablend.config.recipe import Randomise
from infrablend.core.mesh import FloatArray
from infrablend.core.rng import stream

# Sigmas, px: of scattered light, of the detail enhancement, and of the noise's grain.
_BLOOM_PX = 3.0
_HALO_PX = 1.6
_GRAIN_PX = 0.6


@dataclass(frozen=True)
class OtherCamera:
    """What is done to a picture; `take` has the order.

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
        vignette_grey: Levels that the corners are brighter than the middle, 8-bit levels; negative: darker.
        vignette_power: Power of the distance from the middle by which this grows: 2 for a bowl, 8 for bright corners.
        stripes_grey: Standard deviation of the offsets of whole columns, 8-bit levels.
        stripes_seed: Seed of these; a pattern of the core, which stays through a sequence, unlike noise.
        graphics_seed: Seed of text and reticles; None for none.
        objects_xyxy: Boxes that these stay clear of, px.
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
    vignette_grey: float = 0.0
    vignette_power: float = 2.0
    stripes_grey: float = 0.0
    stripes_seed: int = 0
    graphics_seed: int | None = None
    objects_xyxy: Sequence[Sequence[float]] = ()

    @classmethod
    def draw(cls, rules: Randomise, grey_unit: float, rng: np.random.Generator) -> OtherCamera:
        """Draw a camera; every call uses the same number of random numbers."""
        ranges = (rules.blur_px, rules.bloom, rules.gain, rules.noise_grey, rules.halo)
        blur, bloom, gain, noise, halo = (round(float(rng.uniform(*r)), 4) for r in ranges)
        inverted = bool(rng.random() < rules.invert)
        bits = int(rng.integers(round(rules.bits[0]), round(rules.bits[1]), endpoint=True))
        noise_seed = int(rng.integers(1 << 31))
        vignette, stripes = (round(float(rng.uniform(*r)), 4) for r in (rules.vignette_grey, rules.stripes_grey))
        power = round(float(rng.uniform(2, 8)), 4)
        has_graphics = bool(rng.random() < rules.graphics)
        graphics_seed = int(rng.integers(1 << 31))
        if rng.random() >= rules.share:
            return cls(0.0, 0.0, 1.0, 0.0, noise_seed, 0.0, False, 8, grey_unit)
        return cls(
            blur, bloom, gain, noise, noise_seed, halo, inverted, bits, grey_unit, vignette, power, stripes,
            noise_seed, graphics_seed if has_graphics else None,
        )  # fmt: skip

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> OtherCamera:
        """Return the camera that `to_json` wrote."""
        return cls(**data)

    def clear_of(self, objects_xyxy: FloatArray) -> OtherCamera:
        """Return this camera for a picture with labelled objects in (n, 4) boxes, px, that no graphics may cover."""
        if self.graphics_seed is None:
            return self
        return replace(self, objects_xyxy=tuple(tuple(round(v, 2) for v in box) for box in objects_xyxy.tolist()))

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
        if self.vignette_grey != 0:
            corners = self.vignette_grey * self.grey_unit
            picture = picture + corners * _from_middle(picture.shape) ** self.vignette_power
        if self.stripes_grey > 0:
            rng = stream(self.stripes_seed, "stripes")
            picture = picture + rng.normal(0.0, self.stripes_grey * self.grey_unit, picture.shape[1])
        if self.noise_grey > 0:
            picture = picture + grain(picture.shape, self.noise_grey * self.grey_unit, _GRAIN_PX, self.noise_seed)
        if self.halo > 0:
            picture = enhance(picture, self.halo, _HALO_PX)
        if self.inverted:
            picture = float(pixels.min()) + float(pixels.max()) - picture
        if self.bits < 8:
            step = self.grey_unit * 2.0 ** (8 - self.bits)
            picture = np.rint(picture / step) * step
        if self.graphics_seed is not None:
            # Few of 16 bits are in use: white at the last level would leave a gain control no contrast for the scene.
            levels = (0.0, float(top)) if top == 255 else (float(picture.min()), float(picture.max()))
            picture = draw_graphics(picture, levels, self.graphics_seed, np.reshape(self.objects_xyxy, (-1, 4)))
        return np.asarray(np.clip(np.rint(picture), 0, top).astype(pixels.dtype))


def _from_middle(shape: tuple[int, ...]) -> FloatArray:
    """Return the (h, w) distance from the middle of a picture; 1 in its corners."""
    rows, columns = (np.linspace(-1.0, 1.0, size) for size in shape)
    return np.asarray(np.hypot(rows[:, None], columns) / math.sqrt(2))
