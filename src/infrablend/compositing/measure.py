"""What can be measured of a camera in its pictures: how sharp their edges are, how they overshoot, the grain.

Everything is scale-free in polarity, so black-hot pictures need nothing of their own.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.mapping import GreyImage

# Profiles are read by bilinear interpolation and averaged over three, which widens them by this sigma, px.
PROFILE_SIGMA_PX = 0.43
# Width of a Gaussian edge from 10 to 90 %, in sigmas.
WIDTH_PER_SIGMA = 2.563
_BLOCK = 32  # side of a block for the grain, px
_FLATTEST = 5
_MAX_EDGES = 3000


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
