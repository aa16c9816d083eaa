"""What the camera behind a background does to what it sees: optics, detail enhancement, grain, range, codec.

An insert is an ideal picture; its background has been through a lens, a detector, sharpening and compression. This
module measures what can be measured of that chain in the background itself and applies it to the insert alone:
pixels that the insert does not reach keep their value to the bit. Everything is scale-free in polarity, so black-hot
pictures need nothing of their own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.mapping import GreyImage
from infrablend.compositing.overlay import Layer, blur_radius_px

# Variance of the renderer's pixel filter, a box of one pixel: part of the total blur, px^2.
PIXEL_BOX_VARIANCE = 1 / 12
# Profiles are read by bilinear interpolation and averaged over three, which widens them by this sigma, px.
PROFILE_SIGMA_PX = 0.43
# Width of a Gaussian edge from 10 to 90 %, in sigmas.
WIDTH_PER_SIGMA = 2.563
_BLOCK = 32  # side of a block for the grain, px
_FLATTEST = 5
_MAX_EDGES = 3000
# How many edges the profile's own sharpness is worth. Much, as the bounds are narrow: a camera's optics hardly change,
# and a picture without sharp edges (sunlit ground) says more of its scene than of its camera.
_PRIOR_EDGES = 100.0
_CODEC_BLOCK = 8


@dataclass(frozen=True)
class SensorProfile:
    """What is known of a kind of picture before looking at one.

    Attributes:
        psf_sigma_px: Gaussian of all that blurs, the pixel included, before sharpening.
        edge_bounds_px: Least and largest sigma believed of a picture's sharpest edges, after sharpening.
        halo_gain, halo_radius_px: Detail enhancement: `P + gain * (P - G_radius * P)`.
        noise_grey: Standard deviation of the grain where a picture has no flat place, 8-bit levels.
        noise_grain_px: Sigma of the blur that gives white noise the picture's grain.
        codec_quality: JPEG quality that stands for the stream the picture came through; None for none.
    """

    psf_sigma_px: float
    edge_bounds_px: tuple[float, float]
    halo_gain: float
    halo_radius_px: float
    noise_grey: float
    noise_grain_px: float
    codec_quality: int | None


# HIT-UAV: measured on its frames. MONET: provisional, HIT-UAV's sharpening and codec until fitted on real frames.
# generic: a straight 12 um f/1.0 frame, neither upscaled nor sharpened.
PROFILES: Mapping[str, SensorProfile] = {
    "hit-uav": SensorProfile(0.9, (0.5, 0.8), 0.6, 1.6, 1.5, 1.05, 68),
    "monet": SensorProfile(0.9, (0.5, 0.9), 0.6, 1.6, 1.5, 1.05, 75),
    "generic-640x512": SensorProfile(0.55, (0.45, 1.3), 0.0, 1.6, 1.5, 0.5, None),
}


@dataclass(frozen=True)
class SensorStrength:
    """How much of each step to apply: 0 leaves it out, 1 is as measured."""

    optics: float = 1.0
    halo: float = 1.0
    noise: float = 1.0
    codec: float = 1.0
    clip: bool = True


@dataclass(frozen=True)
class Sensor:
    """The chain for one frame, with all strengths worked in; what a record keeps and `apply_sensor` needs.

    Attributes:
        profile: Name in `PROFILES`.
        blur_sigma_px: Gaussian to blur the render with, its own pixel taken off; None leaves the recipe's softness.
        halo_gain, halo_radius_px: Detail enhancement; gain 0 for none.
        noise_grey, noise_grain_px: Grain, in the picture's own levels; 0 for none.
        noise_seed: Of the grain.
        limits: Darkest and brightest level the insert may take before the codec; None for no limit.
        codec_quality: JPEG quality of the touched blocks; None for none.
        edge_sigma_px: Sharpness found in the background, None if it has no edge that serves; for the reader.
        edges: How many edges that rests on.
        flat_blocks: How many blocks the grain rests on.
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

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        plain = asdict(self)
        return {**plain, "limits": None if self.limits is None else list(self.limits)}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Sensor:
        """The chain that `to_json` wrote."""
        limits = data["limits"]
        return cls(**{**data, "limits": None if limits is None else (limits[0], limits[1])})


def fit_sensor(
    background: GreyImage,
    profile: str,
    strength: SensorStrength,
    levels: tuple[float, float],
    noise_seed: int,
) -> Sensor:
    """The chain of one background: measured where it can be, the profile's where not.

    Args:
        background: (h, w) grey, 8 or 16 bit.
        profile: Name in `PROFILES`.
        strength: Of each step.
        levels: Darkest and brightest level that the dataset uses.
        noise_seed: Of the grain.
    """
    p = PROFILES[profile]
    scale = 1.0 if background.dtype == np.uint8 else (levels[1] - levels[0]) / 220.0
    gain = strength.halo * p.halo_gain
    blur, sigma, edges = None, None, 0
    if strength.optics > 0:
        sigma, edges = edge_sigma(background, scale)
        prior = sharpened_sigma(p.psf_sigma_px, p.halo_gain, p.halo_radius_px)
        low, high = p.edge_bounds_px
        believed = prior if sigma is None else (edges * sigma + _PRIOR_EDGES * prior) / (edges + _PRIOR_EDGES)
        # What shows in the picture has been sharpened: undo that, since the insert is sharpened as well.
        total = strength.optics * unsharpened_sigma(min(max(believed, low), high), gain, p.halo_radius_px)
        blur = round(math.sqrt(max(total**2 - PIXEL_BOX_VARIANCE, 0.0)), 4)
    noise, grain, blocks = 0.0, p.noise_grain_px, 0
    if strength.noise > 0:
        found, correlation, blocks = flat_noise(background, levels, scale)
        noise = p.noise_grey * scale if found is None else min(found, 4 * p.noise_grey * scale)
        if correlation is not None:
            grain = min(max(grain_of(correlation), 0.8 * p.noise_grain_px), 1.25 * p.noise_grain_px)
    quality = None
    if strength.codec > 0 and p.codec_quality is not None and background.dtype == np.uint8:
        quality = max(5, round(100 - strength.codec * (100 - p.codec_quality)))
    return Sensor(
        profile=profile,
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
    )


def apply_sensor(background: GreyImage, layer: Layer, sensor: Sensor) -> GreyImage:
    """The layer on its background, as the camera would show it; `layer` is already blurred by the optics.

    Halo, grain and range act on what the layer changes; the codec on the 8 px blocks with a changed pixel. With
    every step off this is `overlay.compose`.
    """
    rows, columns = layer.alpha.shape
    if not layer.alpha.size:
        return background.copy()
    height, width = background.shape
    reach = blur_radius_px(sensor.halo_radius_px) if sensor.halo_gain > 0 else 0
    x0, y0 = layer.offset_xy
    left, top = max(x0 - reach, 0), max(y0 - reach, 0)
    right, bottom = min(x0 + columns + reach, width), min(y0 + rows + reach, height)
    inner = (slice(y0 - top, y0 - top + rows), slice(x0 - left, x0 - left + columns))

    under = background[top:bottom, left:right]
    ground = under.astype(np.float64)
    alpha = np.zeros(ground.shape)
    alpha[inner] = layer.alpha
    grey = np.zeros(ground.shape)
    grey[inner] = layer.grey
    mixed = np.where(alpha > 0, grey + (1 - alpha) * ground, ground)
    if sensor.halo_gain > 0:
        # The background is sharpened already. What the insert hides of it must be taken away as it was before, or its
        # texture would shine through the insert, inverted.
        wide = 3 * reach
        up, back = min(top, wide), min(left, wide)
        around = background[top - up : bottom + wide, left - back : right + wide].astype(np.float64)
        before = unsharpen(around, sensor.halo_gain, sensor.halo_radius_px)
        before = before[up : up + bottom - top, back : back + right - left]
        added = np.where(alpha > 0, grey - alpha * before, 0.0)
        mixed = ground + enhance(added, sensor.halo_gain, sensor.halo_radius_px)
    if sensor.noise_grey > 0:
        # The background keeps (1 - alpha) of its own grain; this weight brings the variance back to the whole.
        weight = np.sqrt(alpha * (2 - alpha))
        mixed += weight * grain(ground.shape, sensor.noise_grey, sensor.noise_grain_px, sensor.noise_seed)
    if sensor.limits is not None:
        low, high = sensor.limits
        # A background pixel beyond the limits (ringing of its own codec) is no fault of the insert.
        mixed = np.clip(mixed, np.minimum(low, ground), np.maximum(high, ground))
    picture = background.copy()
    picture[top:bottom, left:right] = np.clip(np.rint(mixed), 0, np.iinfo(background.dtype).max).astype(picture.dtype)
    if sensor.codec_quality is not None:
        cover = np.zeros(background.shape, np.float32)
        cover[top:bottom, left:right] = alpha
        picture = recode(background, picture, sensor.codec_quality, cover)
    return picture


def enhance(picture: NDArray[np.float64], gain: float, radius_px: float) -> NDArray[np.float64]:
    """Detail enhancement, `P + gain * (P - G * P)`; linear, so it may be had of what an insert adds alone."""
    soft = cv2.GaussianBlur(picture, (0, 0), radius_px, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(picture + gain * (picture - soft), np.float64)


def unsharpen(picture: NDArray[np.float64], gain: float, radius_px: float) -> NDArray[np.float64]:
    """The picture of which `enhance` makes this one, by iteration; for gain 0.6 the error falls to 0.375 each time."""
    before = picture
    for _ in range(12):
        soft = cv2.GaussianBlur(before, (0, 0), radius_px, borderType=cv2.BORDER_REPLICATE)
        before = (picture + gain * soft) / (1 + gain)
    return np.asarray(before, np.float64)


def grain(shape_hw: tuple[int, ...], sigma_grey: float, grain_px: float, seed: int) -> NDArray[np.float64]:
    """(h, w) white noise blurred by a Gaussian of `grain_px`, scaled to standard deviation `sigma_grey`."""
    reach = math.ceil(4 * grain_px)
    h, w = shape_hw
    rng = np.random.Generator(np.random.PCG64(seed))
    white = rng.standard_normal((h + 2 * reach, w + 2 * reach))
    kernel = cv2.getGaussianKernel(2 * reach + 1, grain_px, cv2.CV_64F)
    soft = cv2.sepFilter2D(white, cv2.CV_64F, kernel, kernel)[reach : reach + h, reach : reach + w]
    # By the kernel's own norm, not the sample's: a patch of few pixels keeps its chance deviation.
    return np.asarray(soft * (sigma_grey / float((kernel**2).sum())), np.float64)


def recode(
    background: NDArray[np.uint8] | GreyImage,
    picture: GreyImage,
    quality: int,
    cover: NDArray[np.float32],
) -> GreyImage:
    """The picture with its touched 8 px blocks (those with a changed pixel) through a JPEG of that quality.

    Around the object the background's own grain, which has already been through the codec, is put back: only what
    the codec does to the object and its edges is new.
    """
    height, width = picture.shape
    changed = picture != background
    if not changed.any():
        return picture
    b = _CODEC_BLOCK
    padded = np.pad(changed, ((0, -height % b), (0, -width % b)))
    touched = padded.reshape(padded.shape[0] // b, b, padded.shape[1] // b, b).any(axis=(1, 3))
    block_rows, block_columns = np.flatnonzero(touched.any(axis=1)), np.flatnonzero(touched.any(axis=0))
    y0, y1 = int(block_rows[0]) * b, min((int(block_rows[-1]) + 1) * b, height)
    x0, x1 = int(block_columns[0]) * b, min((int(block_columns[-1]) + 1) * b, width)
    part = (slice(y0, y1), slice(x0, x1))
    # Blocks of a grey JPEG are independent: encoding a block-aligned part gives the same blocks as the whole.
    new = _through_jpeg(picture[part], quality).astype(np.float64)
    lost = background[part].astype(np.float64) - _through_jpeg(background[part], quality)
    new += (1 - cover[part]) * lost
    inside = np.repeat(np.repeat(touched, b, axis=0), b, axis=1)[:height, :width][part]
    out = picture.copy()
    out[part] = np.where(inside, np.clip(np.rint(new), 0, 255), picture[part]).astype(picture.dtype)
    return out


def _through_jpeg(part: GreyImage, quality: int) -> NDArray[np.uint8]:
    ok, data = cv2.imencode(".jpg", np.ascontiguousarray(part), [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not ok:
        raise ValueError(f"a {part.shape} picture cannot be encoded as JPEG")
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)


def sharpened_sigma(sigma_px: float, gain: float, radius_px: float) -> float:
    """Sigma that the 10 to 90 % width of a Gaussian edge shows after detail enhancement."""
    if gain <= 0:
        return sigma_px
    sharp, wide = sigma_px * math.sqrt(2), math.hypot(sigma_px, radius_px) * math.sqrt(2)
    low, high = 0.0, 5 * wide
    # Beyond its crossing of 90 % the edge overshoots and comes back to 100 %: one crossing, so halving finds it.
    for _ in range(40):
        x = (low + high) / 2
        if 0.5 + 0.5 * ((1 + gain) * math.erf(x / sharp) - gain * math.erf(x / wide)) < 0.9:
            low = x
        else:
            high = x
    return 2 * high / WIDTH_PER_SIGMA


def unsharpened_sigma(seen_px: float, gain: float, radius_px: float) -> float:
    """The sigma before detail enhancement whose edge shows `seen_px` after it; the inverse of `sharpened_sigma`."""
    if gain <= 0:
        return seen_px
    low, high = 0.05, 6.0
    for _ in range(30):
        middle = (low + high) / 2
        if sharpened_sigma(middle, gain, radius_px) < seen_px:
            low = middle
        else:
            high = middle
    return (low + high) / 2


def edge_profiles(picture: GreyImage, scale: float = 1.0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Profiles across a picture's clean steps.

    Canny finds the edges on a slightly blurred copy; across each, over 8 px either way, three parallel lines are
    averaged. Kept are steps of more than 35 eight-bit levels between two flat sides.

    Returns:
        (n, 65) profiles, 0 on the dark and 1 on the bright side, a sample each quarter pixel; (n,) steps in levels.
    """
    grey = picture.astype(np.float32) / np.float32(scale)
    if picture.dtype != np.uint8:
        grey -= grey.min()
    soft = cv2.GaussianBlur(grey, (0, 0), 1.0)
    edges = cv2.Canny(np.clip(np.rint(soft), 0, 255).astype(np.uint8), 30, 80)
    gx = cv2.Sobel(soft, cv2.CV_32F, 1, 0)
    gy = cv2.Sobel(soft, cv2.CV_32F, 0, 1)
    height, width = grey.shape
    edges[:10] = edges[height - 10 :] = 0
    edges[:, :10] = edges[:, width - 10 :] = 0
    ys, xs = np.nonzero(edges)
    every = max(1, math.ceil(len(ys) / _MAX_EDGES))
    ys, xs = ys[::every], xs[::every]
    t = np.arange(-8, 8.001, 0.25, dtype=np.float32)
    if not len(ys):
        return np.zeros((0, len(t))), np.zeros(0)
    nx, ny = gx[ys, xs], gy[ys, xs]
    length = np.maximum(np.hypot(nx, ny), np.float32(1e-6))
    nx, ny = (nx / length)[:, None], (ny / length)[:, None]
    lines = np.zeros((len(ys), len(t)), np.float32)
    for aside in (-1.0, 0.0, 1.0):
        mx = (xs[:, None] + t * nx - aside * ny).astype(np.float32)
        my = (ys[:, None] + t * ny + aside * nx).astype(np.float32)
        lines += cv2.remap(grey, mx, my, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) / np.float32(3)
    dark, bright = lines[:, t <= -5], lines[:, t >= 5]
    low, high = np.median(dark, axis=1), np.median(bright, axis=1)
    step = high - low
    keep = (step > 35) & (np.maximum(dark.std(axis=1), bright.std(axis=1)) < 0.06 * step)
    profiles = (lines[keep] - low[keep, None]) / step[keep, None]
    return profiles.astype(np.float64), (step[keep] * scale).astype(np.float64)


def edge_sigma(picture: GreyImage, scale: float = 1.0, percentile: float = 20.0) -> tuple[float | None, int]:
    """Sigma of a picture's sharpest edges, px: the 20th percentile, as most edges of a scene are soft by themselves.

    Returns:
        Sigma with the reading's own width taken off, None if there is no clean edge; number of edges.
    """
    profiles, _ = edge_profiles(picture, scale)
    widths = [w for w in (_width_10_90(p) for p in profiles) if w is not None]
    if not widths:
        return None, 0
    sigma = np.sqrt(np.maximum((np.array(widths) / WIDTH_PER_SIGMA) ** 2 - PROFILE_SIGMA_PX**2, 0))
    return float(np.percentile(sigma, percentile)), len(widths)


def _width_10_90(profile: NDArray[np.float64]) -> float | None:
    """Distance between the crossings of 10 % and 90 % nearest to the middle, px; None if there are none."""
    middle = len(profile) // 2
    centre = middle + int(np.argmin(np.abs(profile[middle - 8 : middle + 9] - 0.5))) - 8
    above = np.flatnonzero(profile[centre:] >= 0.9)
    below = np.flatnonzero(profile[: centre + 1] <= 0.1)
    if not len(above) or not len(below) or above[0] == 0 or below[-1] == centre:
        return None
    i, j = centre + int(above[0]), int(below[-1])
    right = i - (profile[i] - 0.9) / (profile[i] - profile[i - 1])
    left = j + (0.1 - profile[j]) / (profile[j + 1] - profile[j])
    return float(0.25 * (right - left))


def flat_noise(
    picture: GreyImage, levels: tuple[float, float], scale: float = 1.0
) -> tuple[float | None, float | None, int]:
    """Grain of a picture from its flattest places.

    Of all 32 px blocks away from the dark and bright limit, a quadratic surface removed, the five of least deviation.

    Returns:
        Their median deviation in levels, their median correlation of neighbours, how many they are; None without
        any block, and for the correlation without any grain.
    """
    h, w = (n // _BLOCK for n in picture.shape)
    if not h or not w:
        return None, None, 0
    cut = picture[: h * _BLOCK, : w * _BLOCK].astype(np.float64)
    blocks = cut.reshape(h, _BLOCK, w, _BLOCK).swapaxes(1, 2).reshape(h * w, _BLOCK * _BLOCK)
    lowest, highest = np.percentile(blocks, [5, 95], axis=1)
    blocks = blocks[(lowest > levels[0] + 3 * scale) & (highest < levels[1] - 3 * scale)]
    if not len(blocks):
        return None, None, 0
    y, x = np.mgrid[-1 : 1 : _BLOCK * 1j, -1 : 1 : _BLOCK * 1j].reshape(2, -1)
    basis, _ = np.linalg.qr(np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1))
    rest = blocks - (blocks @ basis) @ basis.T
    deviation = rest.std(axis=1)
    flattest = np.argsort(deviation, kind="stable")[:_FLATTEST]
    of = rest[flattest].reshape(-1, _BLOCK, _BLOCK)
    noise = float(np.median(deviation[flattest]))
    correlations = [
        0.5 * float((r[:, 1:] * r[:, :-1]).mean() + (r[1:] * r[:-1]).mean()) / float(r.var())
        for r in of
        if r.var() > 1e-6
    ]
    return noise, (float(np.median(correlations)) if correlations else None), len(flattest)


def grain_of(correlation: float) -> float:
    """Blur sigma that gives white noise this correlation between neighbours: exp(-1 / (4 sigma^2))."""
    return math.sqrt(-1 / (4 * math.log(min(max(correlation, 0.02), 0.98))))
