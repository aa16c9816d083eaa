"""Measurements of a camera in its pictures: sharpness and overshoot of edges, grain and codec blocks.

None of them depends on polarity, so black-hot pictures need no special treatment.
"""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.mapping import GreyImage

# Blur that `edge_profiles` adds itself (bilinear interpolation, mean of three lines), as a sigma, px.
PROFILE_SIGMA_PX = 0.43
# Distance from 10 to 90 % of a Gaussian edge, in sigmas.
WIDTH_PER_SIGMA = 2.563
# Positions of the samples across an edge, and distance from the edge at which its sides count as flat, px.
EDGE_PX = np.arange(-8, 8.001, 0.25)
PLATEAU_PX = 5.0
CODEC_BLOCK = 8  # side of the blocks of JPEG and of most video codecs, px
_BLOCK = 32  # side of the blocks that grain is measured in, px
_FLATTEST = 5
_MAX_EDGES = 3000


def sharpened_sigma(sigma_px: float, gain: float, radius_px: float) -> float:
    """Return the sigma that `profile_sigmas` measures on a Gaussian edge after detail enhancement.

    The measurement adds its own blur after the enhancement and subtracts it in quadrature, which removes too much. With
    HIT-UAV's enhancement an edge of sigma 0.9 px has 0.63 px afterwards and is measured as 0.58 px.
    """
    if gain <= 0:
        return sigma_px
    sharp = math.hypot(sigma_px, PROFILE_SIGMA_PX) * math.sqrt(2)
    wide = math.hypot(sharp, radius_px * math.sqrt(2))
    low, high = 0.0, 5 * wide
    # The edge crosses 90 % only once (it overshoots and then falls back to 100 %), so bisection finds the crossing.
    for _ in range(40):
        x = (low + high) / 2
        if 0.5 + 0.5 * ((1 + gain) * math.erf(x / sharp) - gain * math.erf(x / wide)) < 0.9:
            low = x
        else:
            high = x
    return math.sqrt(max((2 * high / WIDTH_PER_SIGMA) ** 2 - PROFILE_SIGMA_PX**2, 0.0))


def unsharpened_sigma(seen_px: float, gain: float, radius_px: float) -> float:
    """Return the sigma before detail enhancement of an edge measured as `seen_px` after it.

    The inverse of `sharpened_sigma`.
    """
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


def edge_profiles(
    picture: GreyImage, scale: float = 1.0, free: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the profiles across the clean edges of a picture, and their heights.

    Canny detects the edges on a slightly blurred copy. A profile is the mean of three parallel lines that reach 8 px to
    both sides. Clean edges are steps of more than 35 eight-bit levels between two flat sides. `scale` is the number of
    levels per 8-bit level; `free` are the pixels where edges may be.

    Returns:
        (n, 65) profiles, 0 on the dark and 1 on the bright side, four samples per pixel; (n,) heights in levels.
    """
    grey = picture.astype(np.float32) / np.float32(scale)
    if picture.dtype != np.uint8:
        grey -= grey.min()
    height, width = grey.shape
    t = EDGE_PX.astype(np.float32)
    soft = cv2.GaussianBlur(grey, (0, 0), 1.0)
    # Steps instead of 8-bit levels: one dead pixel far below the scene would leave the rest of 16-bit pictures clipped.
    rounded = np.rint(soft)
    most = np.iinfo(np.int16).max
    right, down = (
        np.clip(cv2.Sobel(rounded, cv2.CV_32F, dx, 1 - dx, borderType=cv2.BORDER_REPLICATE), -most, most)
        for dx in (1, 0)
    )
    edges = cv2.Canny(right.astype(np.int16), down.astype(np.int16), 30, 80)
    edges[:10] = edges[height - 10 :] = 0
    edges[:, :10] = edges[:, width - 10 :] = 0
    if free is not None:
        edges[~free] = 0
    ys, xs = np.nonzero(edges != 0)
    every = max(1, math.ceil(len(ys) / _MAX_EDGES))
    ys, xs = ys[::every], xs[::every]
    if not len(ys):
        return np.zeros((0, len(t))), np.zeros(0)
    nx = cv2.Sobel(soft, cv2.CV_32F, 1, 0)[ys, xs]
    ny = cv2.Sobel(soft, cv2.CV_32F, 0, 1)[ys, xs]
    length = np.maximum(np.hypot(nx, ny), np.float32(1e-6))
    nx, ny = (nx / length)[:, None], (ny / length)[:, None]
    lines = np.zeros((len(ys), len(t)), np.float32)
    across_x, across_y = xs[:, None] + t * nx, ys[:, None] + t * ny
    for aside in (-1.0, 0.0, 1.0):
        mx = (across_x - aside * ny).astype(np.float32)
        my = (across_y + aside * nx).astype(np.float32)
        lines += cv2.remap(grey, mx, my, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) / np.float32(3)
    dark, bright = lines[:, t <= -PLATEAU_PX], lines[:, t >= PLATEAU_PX]
    low, high = np.median(dark, axis=1), np.median(bright, axis=1)
    step = high - low
    keep = (step > 35) & (np.maximum(dark.std(axis=1), bright.std(axis=1)) < 0.06 * step)
    profiles = (lines[keep] - low[keep, None]) / step[keep, None]
    return profiles.astype(np.float64), (step[keep] * scale).astype(np.float64)


def edge_sigma(picture: GreyImage, scale: float = 1.0, percentile: float = 20.0) -> tuple[float | None, int]:
    """Return the sigma of a picture's sharpest edges, px, and the number of clean edges.

    The sigma is a low percentile, because most edges of a scene are soft before any optics. The blur of the measurement
    is subtracted. Without a clean edge the sigma is None.
    """
    sigma = profile_sigmas(edge_profiles(picture, scale)[0])
    sigma = sigma[~np.isnan(sigma)]
    return (float(np.percentile(sigma, percentile)), len(sigma)) if len(sigma) else (None, 0)


def profile_sigmas(profiles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (n,) sigmas of (n, 65) profiles; NaN for a profile that does not cross 10 and 90 %.

    Measured between the two crossings nearest to the middle; the blur of the measurement is subtracted.
    """
    rows = np.arange(len(profiles))
    middle = len(EDGE_PX) // 2
    at = np.arange(len(EDGE_PX))
    centre = middle - 8 + np.argmin(np.abs(profiles[:, middle - 8 : middle + 9] - 0.5), axis=1)[:, None]
    above = (profiles >= 0.9) & (at >= centre)
    below = (profiles <= 0.1) & (at <= centre)
    i = np.argmax(above, axis=1)
    j = len(at) - 1 - np.argmax(below[:, ::-1], axis=1)
    good = above.any(axis=1) & below.any(axis=1) & (i > centre[:, 0]) & (j < centre[:, 0])
    i, j = np.where(good, i, 1), np.where(good, j, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        right = i - (profiles[rows, i] - 0.9) / (profiles[rows, i] - profiles[rows, i - 1])
        left = j + (0.1 - profiles[rows, j]) / (profiles[rows, j + 1] - profiles[rows, j])
        width = 0.25 * (right - left)
        sigma = np.sqrt(np.maximum((width / WIDTH_PER_SIGMA) ** 2 - PROFILE_SIGMA_PX**2, 0))
    return np.where(good, sigma, np.nan)


def overshoots(profiles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (n, 2) overshoots of profiles on the bright and on the dark side, as shares of the step.

    These are extreme samples near the edge, so noise alone yields a small overshoot; averaging profiles
    first reduces it.
    """
    near = np.abs(EDGE_PX) < PLATEAU_PX
    return np.stack([profiles[:, near].max(axis=1) - 1, -profiles[:, near].min(axis=1)], axis=1)


def flat_noise(
    picture: GreyImage, levels: tuple[float, float], scale: float = 1.0
) -> tuple[float | None, float | None, int]:
    """Measure the grain of a picture in its flattest blocks, see `flat_blocks`.

    Returns:
        Median standard deviation in levels, None without any block; median correlation between neighbouring pixels,
        None without any grain; number of blocks.
    """
    blocks = flat_blocks(picture, levels, scale)
    if not len(blocks):
        return None, None, 0
    correlation = grain_correlation(blocks, 1)
    return float(np.median(blocks.std(axis=(1, 2)))), correlation, len(blocks)


def flat_blocks(
    picture: GreyImage,
    levels: tuple[float, float],
    scale: float = 1.0,
    free: NDArray[np.bool_] | None = None,
) -> NDArray[np.float64]:
    """Return the (n, 32, 32) residuals of a picture's flattest blocks after fitting a quadratic surface; at most five.

    Blocks near the darkest or brightest level, and blocks not entirely inside `free` (if given), are left out.
    """
    h, w = (n // _BLOCK for n in picture.shape)
    if not h or not w:
        return np.zeros((0, _BLOCK, _BLOCK))
    blocks = _blocks(picture).astype(np.float64)
    y, x = np.mgrid[-1 : 1 : _BLOCK * 1j, -1 : 1 : _BLOCK * 1j].reshape(2, -1)
    basis, _ = np.linalg.qr(np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1))
    rest = blocks - (blocks @ basis) @ basis.T
    order = np.argsort(rest.std(axis=1), kind="stable")
    if free is not None:
        order = order[np.all(_blocks(free), axis=1)[order]]
    found: list[int] = []
    # Percentiles are expensive: compute them for the flattest blocks first, and stop when enough are unclipped.
    for start in range(0, len(order), 16):
        some = order[start : start + 16]
        lowest, highest = np.percentile(blocks[some], [5, 95], axis=1)
        found += some[(lowest > levels[0] + 3 * scale) & (highest < levels[1] - 3 * scale)].tolist()
        if len(found) >= _FLATTEST:
            break
    return np.asarray(rest[found[:_FLATTEST]].reshape(-1, _BLOCK, _BLOCK))


def _blocks(picture: NDArray[Any]) -> NDArray[Any]:
    """Return the (n, 1024) complete blocks of a picture."""
    h, w = (n // _BLOCK for n in picture.shape)
    cut = picture[: h * _BLOCK, : w * _BLOCK].reshape(h, _BLOCK, w, _BLOCK)
    return cut.swapaxes(1, 2).reshape(h * w, _BLOCK * _BLOCK)


def grain_correlation(blocks: NDArray[np.float64], lag: int) -> float | None:
    """Return the median autocorrelation of (n, 32, 32) blocks at a lag in pixels; None without any grain.

    The mean of the horizontal and the vertical direction.
    """
    found = [
        0.5 * float((r[:, lag:] * r[:, :-lag]).mean() + (r[lag:] * r[:-lag]).mean()) / float(r.var())
        for r in blocks
        if r.var() > 1e-6
    ]
    return float(np.median(found)) if found else None


def block_steps(picture: GreyImage) -> NDArray[np.float64] | None:
    """Return the (8,) mean differences between neighbouring pixels, in levels, per position in the codec's 8 px grid.

    The position is that of the right or lower pixel. None for pictures smaller than 24 px.
    """
    if min(picture.shape) < 3 * CODEC_BLOCK:
        return None
    signed = picture.astype(np.int32)
    across = np.abs(np.diff(signed, axis=1)).mean(axis=0)
    down = np.abs(np.diff(signed, axis=0)).mean(axis=1)
    steps = []
    for n in range(CODEC_BLOCK):
        at = slice((n - 1) % CODEC_BLOCK, None, CODEC_BLOCK)
        steps.append(0.5 * (across[at].mean() + down[at].mean()))
    return np.array(steps)


def blockiness(steps: NDArray[np.float64]) -> float:
    """Return the ratio of `block_steps` between two blocks to those inside a block; 1 without any codec.

    The middle of the block is left out: in a picture shifted by half a block, the old grid is there.
    """
    inside = [n for n in range(1, CODEC_BLOCK) if n != CODEC_BLOCK // 2]
    return float(steps[0] / max(float(steps[inside].mean()), 1e-6))


def grain_of(correlation: float) -> float:
    """Return the blur sigma that gives white noise this correlation between neighbours, exp(-1 / (4 sigma^2))."""
    return math.sqrt(-1 / (4 * math.log(min(max(correlation, 0.02), 0.98))))


def true_grain(noise: float, correlation: float, step: float) -> tuple[float, float]:
    """Return standard deviation and blur sigma of the grain that `flat_noise` measures as `noise` and `correlation`.

    Two effects are undone. Rounding to multiples of `step` adds white noise of variance step^2 / 12, which inserts get
    from their own rounding. Subtracting the quadratic surface removes six low-frequency components of the block, which
    hold more of the variance the coarser the grain is.
    """
    sigma = noise
    grain = grain_of(correlation)
    for _ in range(4):
        taken = min(6 * 4 * math.pi * grain**2 / _BLOCK**2, 0.5)
        variance = noise**2 / (1 - taken)
        together = (correlation * (1 - taken) + taken) * variance
        unrounded = max(variance - step**2 / 12, 0.1 * variance)
        sigma = math.sqrt(unrounded)
        grain = grain_of(together / unrounded)
    return sigma, grain
