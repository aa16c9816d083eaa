"""Features and measures of one object in one picture, the same for real and inserted objects.

Everything is computed from the saved picture and the label's box. What is known of inserted objects only (mask, alpha,
scene) is not used: otherwise a classifier would separate labels and not pictures.

Pictures are in 8-bit levels. For HIT-UAV's night people the definitions reproduce the medians published with the
method (docs/explanation/realism.md).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.object_contrast import LEAST_PX, Picture
from infrablend.core.boxes import pixel_box
from infrablend.core.dataset import Instance
from infrablend.core.quantiles import percentile

Bool = NDArray[np.bool_]

FEATURES = (
    "max",
    "p99",
    "mean",
    "std",
    "highpass_inside",
    "highpass_outside",
    "gradient_max",
    "gradient_p90",
    "laplacian_max",
    "laplacian_p90",
    "dark_ring",
    "levels",
    "share_231",
    "share_236",
)
"""The classifier's 14 features, in order; see `Measured.features`."""

MEASURES = (
    "p95_minus_ring",
    "centre_minus_ring",
    "edge_width_px",
    "overshoot",
    "noise_inside",
    "noise_outside",
    "noise_ratio",
    "share_above_245",
    "height_px",
    "width_px",
)
"""Measures that are reported beside the features; NaN where they cannot be read."""

PATCH_PX = 48
RING_SHARE = 0.5  # reach of the ring, as a share of the longer side
MOST_COVERED = 0.1  # largest share of the box that other labels may cover
LEAST_CONTRAST = 10.0
LEAST_INTERIOR_PX = 6
EDGE_MARGIN_PX = 4  # closer to the frame's edge a box has no complete ring
_CLIPPED = (19.0, 232.0)  # grain is read only between these levels
_THREE = np.ones((3, 3), np.uint8)


@dataclass(frozen=True, eq=False)
class Measured:
    """A measured object.

    Attributes:
        key: `<image>#<number>`, unique among the objects of its population.
        group: Background of the object; objects of one background stay in one fold.
        category: Class of the object.
        box_xyxy: (4,) box of the label.
        altitude_m: Altitude of the camera; None if unknown.
        flaw: Reason why the outline cannot be found (`no_ring`, `no_contrast`, `thin`), or empty. With a flaw the
            features are NaN, and so are the measures that need the outline.
        features: (14,) float64, see `FEATURES`.
        measures: (10,) float64, see `MEASURES`.
        histogram: (64,) counts of the box's pixels, four levels per bin.
        patch: (48, 48) uint8 crop of the object and its surroundings; larger ones are scaled down.
    """

    key: str
    group: str
    category: str
    box_xyxy: NDArray[np.float64]
    altitude_m: float | None
    flaw: str
    features: NDArray[np.float64]
    measures: NDArray[np.float64]
    histogram: NDArray[np.int64] = field(repr=False)
    patch: NDArray[np.uint8] = field(repr=False)

    @property
    def height_px(self) -> float:
        """Height of the box."""
        return float(self.box_xyxy[3] - self.box_xyxy[1])


class Labels:
    """The labels of a picture on its pixels.

    Attributes:
        free: (h, w) pixels in no label's box.
    """

    def __init__(self, shape_hw: tuple[int, ...], labels: Sequence[Instance]) -> None:
        count = np.zeros(shape_hw, np.uint8)
        for i in labels:
            x0, y0, x1, y1 = pixel_box(i.box_xyxy, shape_hw)
            part = count[y0:y1, x0:x1]
            part[part < 2] += 1
        self.free: Bool = count == 0
        self._twice: Bool = count > 1

    def overlaps(self, box_xyxy: NDArray[np.float64]) -> bool:
        """Return whether other labels cover more than a tenth of this label's box."""
        x0, y0, x1, y1 = pixel_box(box_xyxy, self.free.shape)
        return bool(self._twice[y0:y1, x0:x1].mean() > MOST_COVERED)


def reason_not_measured(instance: Instance, labels: Labels) -> str | None:
    """Return why an object cannot be measured as far as its label shows, or None if it can."""
    h, w = labels.free.shape
    x0, y0, x1, y1 = instance.box_xyxy
    if max(x1 - x0, y1 - y0) < LEAST_PX:
        return "small"
    if instance.truncated or min(x0, y0, w - x1, h - y1) < EDGE_MARGIN_PX:
        return "truncated"
    if labels.overlaps(instance.box_xyxy):
        return "overlapping"
    return None


def ring(picture: Picture, box_xyxy: NDArray[np.float64], free: Bool) -> float | None:
    """Return the median level of the free pixels within half a longer side around a box; None if too few are free."""
    x0, y0, x1, y1 = pixel_box(box_xyxy, picture.shape)
    reach = max(round(RING_SHARE * max(x1 - x0, y1 - y0)), 3)
    part = (slice(max(y0 - reach, 0), y1 + reach), slice(max(x0 - reach, 0), x1 + reach))
    use = free[part].copy()
    use[y0 - part[0].start : y1 - part[0].start, x0 - part[1].start : x1 - part[1].start] = False
    return float(np.median(picture[part][use])) if use.sum() >= 30 else None


@dataclass(frozen=True, eq=False)
class Outline:
    """The outline of an object, found from its pixels.

    Attributes:
        part: Rows and columns of the window.
        level: Median level of the ring.
        contrast: Difference between ring and the object's bright end (positive) or dark end (negative), whichever is
            larger.
        silhouette: The window's pixels beyond half of the contrast; the largest connected part of those in the box.
    """

    part: tuple[slice, slice]
    level: float
    contrast: float
    silhouette: Bool


def outline(picture: Picture, box_xyxy: NDArray[np.float64], free: Bool) -> Outline | str:
    """Find the outline of the object in a box, or return the reason why there is none: `no_ring`, `no_contrast`."""
    level = ring(picture, box_xyxy, free)
    if level is None:
        return "no_ring"
    x0, y0, x1, y1 = pixel_box(box_xyxy, picture.shape)
    inside = picture[y0:y1, x0:x1]
    dark, bright = (float(v) for v in np.percentile(inside, [5, 95]))
    contrast = bright - level if bright - level >= level - dark else dark - level
    if abs(contrast) < LEAST_CONTRAST:
        return "no_contrast"
    reach = 12
    part = (slice(max(y0 - reach, 0), y1 + reach), slice(max(x0 - reach, 0), x1 + reach))
    rows, columns = picture[part].shape
    beyond = np.zeros((rows, columns), np.uint8)
    at = (slice(y0 - part[0].start, y1 - part[0].start), slice(x0 - part[1].start, x1 - part[1].start))
    beyond[at] = (inside - level) / contrast > 0.5
    count, names, facts, _ = cv2.connectedComponentsWithStats(beyond, connectivity=8)
    if count < 2:
        return "no_contrast"
    largest = names == 1 + int(np.argmax(facts[1:, cv2.CC_STAT_AREA]))
    return Outline(part, level, contrast, largest)


def measure(
    picture: Picture,
    instance: Instance,
    free: Bool,
    *,
    key: str,
    group: str,
    altitude_m: float | None = None,
) -> Measured:
    """Measure one object by box and category of its label; `free` are the (h, w) pixels in no label's box."""
    box = np.array(instance.box_xyxy, np.float64)
    x0, y0, x1, y1 = pixel_box(box, picture.shape)
    inside = picture[y0:y1, x0:x1]
    h, w = inside.shape
    centre = float(np.median(inside[h // 4 : h - h // 4, w // 4 : w - w // 4]))
    level = ring(picture, box, free)
    level = math.nan if level is None else level
    features = np.full(len(FEATURES), math.nan)
    outlined = (math.nan,) * 4
    found = outline(picture, box, free)
    flaw = found if isinstance(found, str) else ""
    if isinstance(found, Outline):
        mask = found.silhouette.astype(np.uint8)
        inner = cv2.erode(mask, _THREE).astype(np.bool_)
        if inner.sum() < LEAST_INTERIOR_PX:
            flaw = "thin"
        else:
            window = picture[found.part]
            features = _features(window, found, mask, inner, free[found.part])
            outlined = (*edge(window, found), *_grains(window, found, inner, free[found.part]))
    measures = np.array(
        [
            percentile(inside, 95) - level,
            centre - level,
            *outlined,
            outlined[2] / outlined[3] if outlined[3] > 0 else math.nan,
            (inside > 245).mean(),
            box[3] - box[1],
            box[2] - box[0],
        ],
        np.float64,
    )
    histogram = np.bincount((np.clip(inside, 0, 255) // 4).astype(np.int64).ravel(), minlength=64)
    return Measured(
        key, group, instance.category, box, altitude_m, flaw, features, measures, histogram, patch(picture, box)
    )


def _features(window: Picture, found: Outline, mask: NDArray[np.uint8], inner: Bool, free: Bool) -> NDArray[np.float64]:
    outer = cv2.dilate(mask, _THREE)
    border = outer.astype(np.bool_) & ~inner
    near = cv2.dilate(outer, _THREE, iterations=2).astype(np.bool_) & ~outer.astype(np.bool_)
    apart = cv2.dilate(mask, _THREE, iterations=10) - cv2.dilate(mask, _THREE, iterations=4)
    outside = apart.astype(np.bool_) & free
    if outside.sum() < 10:
        outside = apart.astype(np.bool_)
    fine = window - cv2.GaussianBlur(window, (0, 0), 1.0, borderType=cv2.BORDER_REPLICATE)
    gx = cv2.Sobel(window, cv2.CV_32F, 1, 0, scale=0.125, borderType=cv2.BORDER_REPLICATE)
    gy = cv2.Sobel(window, cv2.CV_32F, 0, 1, scale=0.125, borderType=cv2.BORDER_REPLICATE)
    gradient = np.hypot(gx, gy)[border] / abs(found.contrast)
    bend = np.abs(cv2.Laplacian(window, cv2.CV_32F, borderType=cv2.BORDER_REPLICATE))[border] / abs(found.contrast)
    inside = window[inner]
    # 90th percentile of how far the surroundings are beyond the ring's level, on the side away from the object.
    away = percentile((found.level - window[near]) / found.contrast, 90)
    return np.array(
        [
            window[found.silhouette].max(),
            percentile(inside, 99),
            inside.mean(),
            inside.std(),
            fine[inner].std(),
            fine[outside].std() if outside.any() else 0.0,
            gradient.max(),
            percentile(gradient, 90),
            bend.max(),
            percentile(bend, 90),
            away,
            len(np.unique(np.rint(window[found.silhouette]))),
            (inside >= 231).mean(),
            (inside >= 236).mean(),
        ],
        np.float64,
    )


def _grains(window: Picture, found: Outline, inner: Bool, free: Bool) -> tuple[float, float]:
    """Return the grain of the unclipped pixels inside and outside an object."""
    unclipped = (window > _CLIPPED[0]) & (window < _CLIPPED[1])
    apart = ~cv2.dilate(found.silhouette.astype(np.uint8), _THREE, iterations=4).astype(np.bool_)
    return grain(window, inner & unclipped), grain(window, apart & unclipped & free)


def edge(window: Picture, found: Outline) -> tuple[float, float]:
    """Return the median width from 10 to 90 % of the profiles across an object's outline, px, and their undershoot.

    The undershoot shows the halo of detail enhancement: the distance by which the median profile passes the ring's
    level beside the object, as a share of the contrast. On the object's own side, clipping would hide it.
    """
    soft = cv2.GaussianBlur(window, (0, 0), 1.0, borderType=cv2.BORDER_REPLICATE) * float(np.sign(found.contrast))
    gx = cv2.Sobel(soft, cv2.CV_32F, 1, 0, borderType=cv2.BORDER_REPLICATE)
    gy = cv2.Sobel(soft, cv2.CV_32F, 0, 1, borderType=cv2.BORDER_REPLICATE)
    mask = found.silhouette.astype(np.uint8)
    ys, xs = np.nonzero(mask & ~cv2.erode(mask, _THREE))
    length = np.maximum(np.hypot(gx[ys, xs], gy[ys, xs]), np.float32(1e-6))
    nx, ny = (gx[ys, xs] / length)[:, None], (gy[ys, xs] / length)[:, None]
    t = np.arange(-4, 4.001, 0.25, dtype=np.float32)
    lines = cv2.remap(
        window,
        (xs[:, None] + t * nx).astype(np.float32),
        (ys[:, None] + t * ny).astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    relative = (lines.astype(np.float64) - found.level) / found.contrast
    low, high = np.median(relative[:, t <= -2.5], axis=1), relative[:, (t >= 0) & (t <= 3)].max(axis=1)
    step = high - low
    keep = (step > 0.5) & (np.abs(low) < 0.25)
    if not keep.any():
        return math.nan, math.nan
    profiles = (relative[keep] - low[keep, None]) / step[keep, None]
    widths = _widths_10_90(profiles)
    under = -float(np.median(relative[keep], axis=0)[t <= -0.5].min())
    return (float(np.median(widths)) if len(widths) else math.nan), under


def _widths_10_90(profiles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distances, px, from the last crossing of 10 % before the first one of 50 % to the next of 90 %.

    Takes (n, k) profiles; those without all three crossings have no width and are left out.
    """
    count = profiles.shape[1]
    column = np.arange(count)
    half = np.argmax(profiles >= 0.5, axis=1)
    above = (profiles >= 0.9) & (column >= half[:, None])
    below = (profiles <= 0.1) & (column <= half[:, None])
    crossing = (half > 0) & above.any(axis=1) & below.any(axis=1)
    p = profiles[crossing]
    row = np.arange(np.count_nonzero(crossing))
    i, j = np.argmax(above[crossing], axis=1), count - 1 - np.argmax(below[crossing, ::-1], axis=1)
    right = i - (p[row, i] - 0.9) / (p[row, i] - p[row, i - 1])
    left = j + (0.1 - p[row, j]) / (p[row, j + 1] - p[row, j])
    return np.asarray(0.25 * (right - left), np.float64)


def _quadratic_basis(side: int) -> NDArray[np.float64]:
    y, x = np.mgrid[-1 : 1 : side * 1j, -1 : 1 : side * 1j].reshape(2, -1)
    basis, _ = np.linalg.qr(np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1))
    return np.asarray(basis.T.reshape(6, side, side), np.float64)


_GRAIN_SIDE = 5
_BASIS = _quadratic_basis(_GRAIN_SIDE)


def grain(window: Picture, usable: Bool) -> float:
    """Return the deviation of the flattest places from a quadratic surface, levels; NaN without any usable place.

    The places are all 5 px blocks of usable pixels, since an object is too small for the 32 px blocks that a picture's
    grain is read from; the value is their 20th percentile. In a block this small the surface absorbs much of the
    grain, so the number only serves to compare places. Differences of neighbours (Haar) would be quantised to nothing
    on compressed 8-bit pictures.
    """
    whole = cv2.erode(usable.astype(np.uint8), np.ones((_GRAIN_SIDE, _GRAIN_SIDE), np.uint8), borderValue=0)
    if not whole.any():
        return math.nan
    level = window.astype(np.float64) - float(window.mean())
    rest = cv2.boxFilter(level * level, cv2.CV_64F, (_GRAIN_SIDE, _GRAIN_SIDE), normalize=False)
    for kernel in _BASIS:
        rest -= cv2.filter2D(level, cv2.CV_64F, kernel) ** 2
    variance = np.maximum(rest[whole > 0], 0) / (_GRAIN_SIDE**2 - len(_BASIS))
    return float(np.sqrt(np.percentile(variance, 20)))


def patch(picture: Picture, box_xyxy: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return the (48, 48) crop around a box; for large boxes, 1.5 times the box scaled down."""
    x0, y0, x1, y1 = box_xyxy
    side = max(PATCH_PX, round(1.5 * max(x1 - x0, y1 - y0)))
    h, w = picture.shape
    # Near the frame's edge the object is off-centre; a mirrored edge would look like an object of its own.
    left = max(min(round((x0 + x1 - side) / 2), w - side), min(0, (w - side) // 2))
    top = max(min(round((y0 + y1 - side) / 2), h - side), min(0, (h - side) // 2))
    pad = (max(-top, 0), max(top + side - picture.shape[0], 0), max(-left, 0), max(left + side - picture.shape[1], 0))
    cut = picture[max(top, 0) : top + side, max(left, 0) : left + side]
    whole = cv2.copyMakeBorder(cut, *pad, cv2.BORDER_REFLECT_101) if any(pad) else cut
    if side > PATCH_PX:
        whole = cv2.resize(whole, (PATCH_PX, PATCH_PX), interpolation=cv2.INTER_AREA)
    return np.asarray(np.clip(np.rint(whole), 0, 255), np.uint8)
