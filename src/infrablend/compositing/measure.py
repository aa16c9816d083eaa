"""What can be measured of a camera in its pictures: how sharp their edges are, how they overshoot, the grain.

Everything is scale-free in polarity, so black-hot pictures need nothing of their own.
"""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.mapping import GreyImage

# Profiles are read by bilinear interpolation and averaged over three, which widens them by this sigma, px.
PROFILE_SIGMA_PX = 0.43
# Width of a Gaussian edge from 10 to 90 %, in sigmas.
WIDTH_PER_SIGMA = 2.563
# Where profiles are sampled across an edge, and from where on its sides count as flat, px.
EDGE_PX = np.arange(-8, 8.001, 0.25)
PLATEAU_PX = 5.0
CODEC_BLOCK = 8  # side of a block of JPEG and of most video codecs, px
_BLOCK = 32  # side of a block for the grain, px
_FLATTEST = 5
_MAX_EDGES = 3000


def sharpened_sigma(sigma_px: float, gain: float, radius_px: float) -> float:
    """Sigma that `profile_sigmas` reads of a Gaussian edge after detail enhancement.

    The reading's own blur comes after the enhancement, so that taking it off again in quadrature leaves less than the
    edge has: 0.58 px of 0.63 for a sigma of 0.9 px with HIT-UAV's.
    """
    if gain <= 0:
        return sigma_px
    sharp = math.hypot(sigma_px, PROFILE_SIGMA_PX) * math.sqrt(2)
    wide = math.hypot(sharp, radius_px * math.sqrt(2))
    low, high = 0.0, 5 * wide
    # Beyond its crossing of 90 % the edge overshoots and comes back to 100 %: one crossing, so halving finds it.
    for _ in range(40):
        x = (low + high) / 2
        if 0.5 + 0.5 * ((1 + gain) * math.erf(x / sharp) - gain * math.erf(x / wide)) < 0.9:
            low = x
        else:
            high = x
    return math.sqrt(max((2 * high / WIDTH_PER_SIGMA) ** 2 - PROFILE_SIGMA_PX**2, 0.0))


def unsharpened_sigma(seen_px: float, gain: float, radius_px: float) -> float:
    """Return the sigma that detail enhancement turns into `seen_px`; the inverse of `sharpened_sigma`."""
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
    """Profiles across a picture's clean steps.

    Canny finds the edges on a slightly blurred copy; across each, over 8 px either way, three parallel lines are
    averaged. Kept are steps of more than 35 eight-bit levels between two flat sides; where `free` (h, w) is given only
    those in it.

    Returns:
        (n, 65) profiles, 0 on the dark and 1 on the bright side, a sample each quarter pixel; (n,) steps in levels.
    """
    grey = picture.astype(np.float32) / np.float32(scale)
    if picture.dtype != np.uint8:
        grey -= grey.min()
    height, width = grey.shape
    t = EDGE_PX.astype(np.float32)
    soft = cv2.GaussianBlur(grey, (0, 0), 1.0)
    edges = cv2.Canny(np.clip(np.rint(soft), 0, 255).astype(np.uint8), 30, 80)
    edges[:10] = edges[height - 10 :] = 0
    edges[:, :10] = edges[:, width - 10 :] = 0
    if free is not None:
        edges[~free] = 0
    ys, xs = np.nonzero(edges)
    every = max(1, math.ceil(len(ys) / _MAX_EDGES))
    ys, xs = ys[::every], xs[::every]
    if not len(ys):
        return np.zeros((0, len(t))), np.zeros(0)
    nx = cv2.Sobel(soft, cv2.CV_32F, 1, 0)[ys, xs]
    ny = cv2.Sobel(soft, cv2.CV_32F, 0, 1)[ys, xs]
    length = np.maximum(np.hypot(nx, ny), np.float32(1e-6))
    nx, ny = (nx / length)[:, None], (ny / length)[:, None]
    lines = np.zeros((len(ys), len(t)), np.float32)
    for aside in (-1.0, 0.0, 1.0):
        mx = (xs[:, None] + t * nx - aside * ny).astype(np.float32)
        my = (ys[:, None] + t * ny + aside * nx).astype(np.float32)
        lines += cv2.remap(grey, mx, my, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE) / np.float32(3)
    dark, bright = lines[:, t <= -PLATEAU_PX], lines[:, t >= PLATEAU_PX]
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
    sigma = profile_sigmas(edge_profiles(picture, scale)[0])
    sigma = sigma[~np.isnan(sigma)]
    return (float(np.percentile(sigma, percentile)), len(sigma)) if len(sigma) else (None, 0)


def profile_sigmas(profiles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (n,) sigma of each of (n, 65) profiles; NaN where an edge has none.

    It follows from the distance between the crossings of 10 and 90 % nearest to the middle, less the reading's own
    width.
    """
    rows, middle, at = np.arange(len(profiles)), len(EDGE_PX) // 2, np.arange(len(EDGE_PX))
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
    """(n, 2) how far profiles rise above the bright side and fall below the dark side near the edge, share of the step.

    The highest and the lowest sample, so noise alone gives some; the mean of many profiles has less of that.
    """
    near = np.abs(EDGE_PX) < PLATEAU_PX
    return np.stack([profiles[:, near].max(axis=1) - 1, -profiles[:, near].min(axis=1)], axis=1)


def flat_noise(
    picture: GreyImage, levels: tuple[float, float], scale: float = 1.0
) -> tuple[float | None, float | None, int]:
    """Grain of a picture from its flattest places, see `flat_blocks`.

    Returns:
        Their median deviation in levels, their median correlation of neighbours, how many they are; None without
        any block, and for the correlation without any grain.
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
    """(n, 32, 32) what a picture's flattest blocks hold beside a quadratic surface; five at most.

    Those of least deviation of all 32 px blocks away from the dark and bright limit and, where it is given, in `free`.
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
        order = order[_blocks(free).all(axis=1)[order]]
    found: list[int] = []
    # Percentiles are dear: they are taken of the flattest, until enough of them are neither black nor white.
    for start in range(0, len(order), 16):
        some = order[start : start + 16]
        lowest, highest = np.percentile(blocks[some], [5, 95], axis=1)
        found += some[(lowest > levels[0] + 3 * scale) & (highest < levels[1] - 3 * scale)].tolist()
        if len(found) >= _FLATTEST:
            break
    return np.asarray(rest[found[:_FLATTEST]].reshape(-1, _BLOCK, _BLOCK))


def _blocks(picture: NDArray[Any]) -> NDArray[Any]:
    """(n, 1024) the whole blocks of a picture."""
    h, w = (n // _BLOCK for n in picture.shape)
    cut = picture[: h * _BLOCK, : w * _BLOCK].reshape(h, _BLOCK, w, _BLOCK)
    return cut.swapaxes(1, 2).reshape(h * w, _BLOCK * _BLOCK)


def grain_correlation(blocks: NDArray[np.float64], lag: int) -> float | None:
    """Return the median correlation of (n, 32, 32) blocks with themselves `lag` px aside, both ways.

    It is None for blocks without grain.
    """
    found = [
        0.5 * float((r[:, lag:] * r[:, :-lag]).mean() + (r[lag:] * r[:-lag]).mean()) / float(r.var())
        for r in blocks
        if r.var() > 1e-6
    ]
    return float(np.median(found)) if found else None


def block_steps(picture: GreyImage) -> NDArray[np.float64] | None:
    """(8,) mean step between neighbours in levels, by where in a codec's 8 px grid the right or lower one lies.

    None for pictures of less than 24 px.
    """
    if min(picture.shape) < 3 * CODEC_BLOCK:
        return None
    signed = picture.astype(np.int32)
    across = np.abs(np.diff(signed, axis=1)).mean(axis=0)
    down = np.abs(np.diff(signed, axis=0)).mean(axis=1)
    return np.array(
        [0.5 * (across[(n - 1) % CODEC_BLOCK :: CODEC_BLOCK].mean() + down[(n - 1) % CODEC_BLOCK :: CODEC_BLOCK].mean())
         for n in range(CODEC_BLOCK)]
    )  # fmt: skip


def blockiness(steps: NDArray[np.float64]) -> float:
    """How much larger `block_steps` are between two blocks than inside one; 1 for no codec.

    The middle of a block is left out: a picture moved by half a block has its old grid there.
    """
    inside = [n for n in range(1, CODEC_BLOCK) if n != CODEC_BLOCK // 2]
    return float(steps[0] / max(float(steps[inside].mean()), 1e-6))


def grain_of(correlation: float) -> float:
    """Blur sigma that gives white noise this correlation between neighbours: exp(-1 / (4 sigma^2))."""
    return math.sqrt(-1 / (4 * math.log(min(max(correlation, 0.02), 0.98))))


def true_grain(noise: float, correlation: float, step: float) -> tuple[float, float]:
    """Deviation and blur sigma of the grain that `flat_noise` reads as these, in pictures rounded to whole `step`s.

    Rounding adds white noise of step^2 / 12, which an insert gets by its own rounding; the removed surface takes six
    of the block's low frequencies along, more of them the coarser the grain.
    """
    sigma, grain = noise, grain_of(correlation)
    for _ in range(4):
        taken = min(6 * 4 * math.pi * grain**2 / _BLOCK**2, 0.5)
        variance = noise**2 / (1 - taken)
        together = (correlation * (1 - taken) + taken) * variance
        unrounded = max(variance - step**2 / 12, 0.1 * variance)
        sigma, grain = math.sqrt(unrounded), grain_of(together / unrounded)
    return sigma, grain
