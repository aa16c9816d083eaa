"""The sensor chain of the camera behind a background: optics, detail enhancement, grain, range, codec.

An insert is an ideal picture; its background has been through a lens, a detector, sharpening and compression. As far as
possible that chain is measured in the background itself (`measure`); the rest comes from the camera's profile. It is
applied to the insert only: pixels that the insert does not reach keep their value to the bit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.mapping import GreyImage
from infrablend.compositing.measure import (
    CODEC_BLOCK,
    edge_sigma,
    flat_noise,
    sharpened_sigma,
    true_grain,
    unsharpened_sigma,
)
from infrablend.compositing.overlay import Bloom, Layer, blur_radius_px
from infrablend.config.sensor_profile import SensorProfile, find_profile

# Variance of the renderer's pixel filter, a box of one pixel, which is part of the total blur, px^2.
PIXEL_BOX_VARIANCE = 1 / 12
# Weight of the profile's own sharpness, as a number of edges. It is high because a camera's optics hardly change, and
# the soft edges of some scenes (sunlit ground) would be mistaken for blur of the camera.
_PRIOR_EDGES = 100.0
# Coverage below this changes a pixel by at most two levels and is no reason to compress its block.
_LEAST_COVER = 0.01


@dataclass(frozen=True)
class SensorStrength:
    """Strength of each step of the chain: 0 leaves it out, 1 applies it as measured.

    Attributes:
        optics: Blur by the optics.
        halo: Detail enhancement.
        noise: Grain.
        codec: Compression.
        clip: Whether to limit the insert's levels.
        defocus: Blur by being out of focus.
    """

    optics: float = 1.0
    halo: float = 1.0
    noise: float = 1.0
    codec: float = 1.0
    clip: bool = True
    defocus: float = 1.0


@dataclass(frozen=True)
class Sensor:
    """The chain fitted to one frame, with all strengths included; a record stores it, `apply_sensor` applies it.

    Attributes:
        profile: Name of the profile.
        blur_sigma_px: Sigma of the optics' blur of the render, without the render's own pixel; None for the recipe's
            softness.
        halo_gain: Gain of the detail enhancement; 0 for none.
        halo_radius_px: Radius of the detail enhancement.
        noise_grey: Standard deviation of the grain, in the picture's own levels; 0 for none.
        noise_grain_px: Size of the grain.
        noise_seed: Seed of the grain.
        limits: Darkest and brightest level of the insert before the codec; None for no limit.
        codec_quality: JPEG quality of the touched blocks; None for no codec.
        edge_sigma_px: Sharpness measured in the background, None without a usable edge; for information.
        edges: Number of edges measured.
        flat_blocks: Number of blocks that the grain was measured in.
        range_m: Distance from the camera to the nearest object; None with the paper's placement, whose camera is not
            the real one.
        defocus_sigma_px: Blur added by defocus at that range, in quadrature.
        speed_px_s: Motion relative to the camera that causes the scene's motion tail; for information.
        bloom_share: Share of the light that the optics scatter; see `Bloom`.
        bloom_sigma_px: Sigma of that.
    """

    profile: str
    blur_sigma_px: float | None = None
    halo_gain: float = 0.0
    halo_radius_px: float = 1.6
    noise_grey: float = 0.0
    noise_grain_px: float = 1.05
    noise_seed: int = 0
    limits: tuple[float, float] | None = None
    codec_quality: int | None = None
    edge_sigma_px: float | None = None
    edges: int = 0
    flat_blocks: int = 0
    range_m: float | None = None
    defocus_sigma_px: float = 0.0
    speed_px_s: float = 0.0
    bloom_share: float = 0.0
    bloom_sigma_px: float = 0.0

    @property
    def bloom(self) -> Bloom:
        """Light scattered around bright objects."""
        return Bloom(self.bloom_share, self.bloom_sigma_px)

    def layer_sigma_px(self, softness_px: float) -> float:
        """Return the sigma to blur the render with; `softness_px` is the recipe's, for chains without optics."""
        return math.hypot(softness_px if self.blur_sigma_px is None else self.blur_sigma_px, self.defocus_sigma_px)

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        plain = asdict(self)
        return {**plain, "limits": None if self.limits is None else list(self.limits)}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Sensor:
        """Return the chain that `to_json` wrote."""
        limits = data["limits"]
        return cls(**{**data, "limits": None if limits is None else (limits[0], limits[1])})


def fit_sensor(
    background: GreyImage,
    profile: str | SensorProfile,
    strength: SensorStrength,
    levels: tuple[float, float],
    noise_seed: int,
    *,
    range_m: float | None = None,
    motion_px: tuple[float, float] = (0.0, 0.0),
) -> Sensor:
    """Fit the chain to one background: measure what can be measured, and take the rest from the profile.

    Args:
        background: (h, w) grey, 8 or 16 bit.
        profile: Name of a shipped profile, or a profile.
        strength: Strength of each step.
        levels: Darkest and brightest level that the dataset uses; a profile's levels override them for 8 bit.
        noise_seed: Seed of the grain.
        range_m: Distance from the camera to the nearest object, for defocus; None for no defocus. The blur
            disc is replaced by a Gaussian of the same variance, with a sigma of a quarter of the disc's diameter. After
            the whole chain an edge differs from that of a true disc by less than 1 % of its step for diameters up to
            3 px (HIT-UAV: from 15 m), and by 3 % at 9 px.
        motion_px: The scene's motion tail.
    """
    p = find_profile(profile)
    if p.levels is not None and background.dtype == np.uint8:
        levels = p.levels
    scale = 1.0 if background.dtype == np.uint8 else (levels[1] - levels[0]) / 220.0
    gain = strength.halo * p.halo_gain
    blur = None
    sigma = None
    edges = 0
    if strength.optics > 0:
        sigma, edges = edge_sigma(background, scale)
        prior = sharpened_sigma(p.psf_sigma_px, p.halo_gain, p.halo_radius_px)
        low, high = p.edge_bounds_px
        believed = prior if sigma is None else (edges * sigma + _PRIOR_EDGES * prior) / (edges + _PRIOR_EDGES)
        # Edges in the picture have been sharpened already: undo that, since the insert will be sharpened as well.
        total = strength.optics * unsharpened_sigma(min(max(believed, low), high), gain, p.halo_radius_px)
        blur = round(math.sqrt(max(total**2 - PIXEL_BOX_VARIANCE, 0.0)), 4)
    noise = 0.0
    grain = p.noise_grain_px
    blocks = 0
    if strength.noise > 0:
        found, correlation, blocks = flat_noise(background, levels, scale)
        noise = p.noise_grey * scale if found is None else found
        if found is not None and correlation is not None:
            noise, size = true_grain(found, correlation, 1.0)
            grain = min(max(size, 0.8 * p.noise_grain_px), 1.25 * p.noise_grain_px)
        noise = min(noise, 4 * p.noise_grey * scale)
    quality = None
    if strength.codec > 0 and p.codec_quality is not None and background.dtype == np.uint8:
        quality = max(5, round(100 - strength.codec * (100 - p.codec_quality)))
    fitted = Sensor(
        profile=p.name,
        blur_sigma_px=blur,
        halo_gain=round(gain, 4),
        halo_radius_px=p.halo_radius_px,
        noise_grey=round(strength.noise * noise, 4),
        noise_grain_px=round(grain, 4),
        noise_seed=noise_seed,
        limits=levels if strength.clip else None,
        codec_quality=quality,
        edge_sigma_px=None if sigma is None else round(sigma, 4),
        edges=edges,
        flat_blocks=blocks,
        speed_px_s=round(math.hypot(*motion_px) / p.time_constant_s, 2),
        bloom_share=round(strength.optics * p.bloom_share, 4),
        bloom_sigma_px=p.bloom_px,
    )
    return focus_missed(fitted, p, strength, range_m)


def focus_missed(
    sensor: Sensor, profile: str | SensorProfile, strength: SensorStrength, range_m: float | None
) -> Sensor:
    """Return a fitted chain with the defocus of objects at a distance from the camera; None for no defocus."""
    if range_m is None:
        return replace(sensor, range_m=None, defocus_sigma_px=0.0)
    lens = find_profile(profile).lens
    defocus = 0.0 if lens is None else strength.defocus * lens.blur_disc_px(range_m) / 4
    return replace(sensor, range_m=round(range_m, 3), defocus_sigma_px=round(defocus, 4))


def apply_sensor(background: GreyImage, layer: Layer, sensor: Sensor) -> GreyImage:
    """Lay the layer, already blurred by the optics, over its background as the camera would show it.

    Halo, grain and range apply to what the layer changes, the codec to the 8 px blocks that it covers in part. With all
    steps off the result is that of `overlay.compose`.
    """
    rows, columns = layer.alpha.shape
    if not layer.alpha.size:
        return background.copy()
    height, width = background.shape
    reach = blur_radius_px(sensor.halo_radius_px) if sensor.halo_gain > 0 else 0
    x0, y0 = layer.offset_xy
    left = max(x0 - reach, 0)
    top = max(y0 - reach, 0)
    right = min(x0 + columns + reach, width)
    bottom = min(y0 + rows + reach, height)
    inner = (slice(y0 - top, y0 - top + rows), slice(x0 - left, x0 - left + columns))

    under = background[top:bottom, left:right]
    ground = under.astype(np.float64)
    alpha = np.zeros(ground.shape)
    alpha[inner] = layer.alpha
    grey = np.zeros(ground.shape)
    grey[inner] = layer.grey
    mixed = grey + (1 - alpha) * ground
    if sensor.halo_gain > 0:
        # The background is already sharpened. The part hidden by the insert must be subtracted in its unsharpened form;
        # otherwise its texture would show through the insert, inverted.
        wide = 3 * reach
        up = min(top, wide)
        back = min(left, wide)
        around = background[top - up : bottom + wide, left - back : right + wide]
        hidden = np.zeros(around.shape, np.uint8)
        inside = (slice(up, up + bottom - top), slice(back, back + right - left))
        hidden[inside] = alpha > 0
        before = unsharpen_around(around, hidden, wide, sensor)[inside]
        mixed = ground + enhance(grey - alpha * before, sensor.halo_gain, sensor.halo_radius_px)
    if sensor.noise_grey > 0:
        # The background keeps (1 - alpha) of its own grain; this weight restores the full variance.
        weight = np.sqrt(alpha * (2 - alpha))
        mixed += weight * grain(ground.shape, sensor.noise_grey, sensor.noise_grain_px, sensor.noise_seed)
    if sensor.limits is not None:
        low, high = sensor.limits
        # Background pixels may exceed the limits (ringing of their own codec) and are left as they are.
        mixed = np.clip(mixed, np.minimum(low, ground), np.maximum(high, ground))
    picture = background.copy()
    picture[top:bottom, left:right] = np.clip(np.rint(mixed), 0, np.iinfo(background.dtype).max).astype(picture.dtype)
    if sensor.codec_quality is not None:
        cover = np.zeros(background.shape, np.float32)
        cover[top:bottom, left:right] = alpha
        picture = recode(background, picture, sensor.codec_quality, cover)
    return picture


def blurred(picture: NDArray[np.float64], sigma_px: float) -> NDArray[np.float64]:
    """Return an (h, w) picture blurred by a Gaussian of `sigma_px`, above 0."""
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE), np.float64)


def enhance(picture: NDArray[np.float64], gain: float, radius_px: float) -> NDArray[np.float64]:
    """Return the picture after detail enhancement, `P + gain * (P - G * P)`; linear, so it works on additions alone."""
    return np.asarray(picture + gain * (picture - blurred(picture, radius_px)), np.float64)


def unsharpen(picture: NDArray[np.float64], gain: float, radius_px: float) -> NDArray[np.float64]:
    """Invert `enhance` by iteration; with gain 0.6 each step reduces the error to 0.375 of it."""
    before = picture
    for _ in range(12):
        before = (picture + gain * blurred(before, radius_px)) / (1 + gain)
    return np.asarray(before, np.float64)


def unsharpen_around(
    picture: GreyImage, hidden: NDArray[np.uint8], wide_px: int, sensor: Sensor
) -> NDArray[np.float64]:
    """Return the picture (h, w) without the sensor's detail enhancement where `hidden` (h, w) is 1; else as it is.

    Pixels farther than `wide_px` away count for nothing, so objects that are apart are treated one by one.
    """
    before = picture.astype(np.float64)
    grown = cv2.dilate(hidden, np.ones((2 * wide_px + 1, 2 * wide_px + 1), np.uint8))
    _, names, facts, _ = cv2.connectedComponentsWithStats(grown)
    for name, (x, y, w, h, _) in enumerate(facts[1:].tolist(), 1):
        part = (slice(y, y + h), slice(x, x + w))
        own = names[part] == name
        before[part][own] = unsharpen(picture[part].astype(np.float64), sensor.halo_gain, sensor.halo_radius_px)[own]
    return before


def grain(shape_hw: tuple[int, ...], sigma_grey: float, grain_px: float, seed: int) -> NDArray[np.float64]:
    """Return (h, w) white noise blurred by a Gaussian of `grain_px`, scaled to standard deviation `sigma_grey`."""
    reach = math.ceil(4 * grain_px)
    h, w = shape_hw
    rng = np.random.Generator(np.random.PCG64(seed))
    white = rng.standard_normal((h + 2 * reach, w + 2 * reach))
    kernel = cv2.getGaussianKernel(2 * reach + 1, grain_px, cv2.CV_64F)
    soft = cv2.sepFilter2D(white, cv2.CV_64F, kernel, kernel)[reach : reach + h, reach : reach + w]
    # Scaled by the kernel's norm and not by the sample's deviation, which varies by chance in small patches.
    return np.asarray(soft * (sigma_grey / float((kernel**2).sum())), np.float64)


def recode(
    background: NDArray[np.uint8] | GreyImage,
    picture: GreyImage,
    quality: int,
    cover: NDArray[np.float32],
) -> GreyImage:
    """Return the picture with the 8 px blocks that the insert covers in part JPEG-compressed at that quality.

    The background around the object has been through the codec already, so its grain is restored: only the object and
    its edges are compressed again. Blocks that show nothing but the faint ring of the detail enhancement stay as they
    are, so that the codec carries no change further than a block from the object.
    """
    height, width = picture.shape
    covered = cover >= _LEAST_COVER
    if not covered.any():
        return picture
    b = CODEC_BLOCK
    padded = np.pad(covered, ((0, -height % b), (0, -width % b)))
    touched = padded.reshape(padded.shape[0] // b, b, padded.shape[1] // b, b).any(axis=(1, 3))
    block_rows, block_columns = np.flatnonzero(np.any(touched, 1)), np.flatnonzero(np.any(touched, 0))
    y0, y1 = int(block_rows[0]) * b, min((int(block_rows[-1]) + 1) * b, height)
    x0, x1 = int(block_columns[0]) * b, min((int(block_columns[-1]) + 1) * b, width)
    part = (slice(y0, y1), slice(x0, x1))
    # Blocks of a grey JPEG are independent, so a block-aligned part gives the same blocks as the whole picture.
    new = through_jpeg(picture[part], quality).astype(np.float64)
    lost = background[part].astype(np.float64) - through_jpeg(background[part], quality)
    new += (1 - cover[part]) * lost
    inside = np.repeat(np.repeat(touched, b, axis=0), b, axis=1)[:height, :width][part]
    out = picture.copy()
    out[part] = np.where(inside, np.clip(np.rint(new), 0, 255), picture[part]).astype(picture.dtype)
    return out


def through_jpeg(part: GreyImage, quality: int) -> NDArray[np.uint8]:
    """Return an 8-bit picture after JPEG compression at that quality."""
    ok, data = cv2.imencode(".jpg", np.ascontiguousarray(part), [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not ok:
        raise ValueError(f"a picture of shape {part.shape} cannot be encoded as JPEG")
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)
