"""Occluders: branches, masts and fences of a background that stay in front of an inserted object.

Nothing is invented: an occluder is a structure that the background itself shows at the object's place, brighter or
darker than what surrounds it and thinner than the object, so that its grey levels and its grain are the camera's own.
The threshold that separates structure from surroundings is chosen so that the wanted share of the object stays visible.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.compositing.mapping import GreyImage
from infrablend.compositing.overlay import Layer
from infrablend.core.boxes import pixel_box
from infrablend.core.quantiles import quantile
from infrablend.imaging.skyline import noise_of

Share = NDArray[np.float32]

# Occluders stay in front this far around an object's box, since optics and sharpening spread the object.
_MARGIN_PX = 8
# Blur that keeps the grain of the picture out of the structures.
_SMOOTHING_PX = 0.7
# Least strength of a structure, in multiples of the picture's noise and in 8-bit levels, and its least size.
_LEAST_NOISE = 5.0
_LEAST_GREY = 16.0
_LEAST_PIXELS = 6
# Width of the widest structures, as multiples of the object's longer side, within limits in px.
_WIDTHS = (0.3, 0.55)
_WIDTH_LIMITS_PX = (5, 41)
# Width of the structures that make a place worth a closer look.
_TEXTURE_WIDTH_PX = 15
# Visible shares keep this distance from both ends of the range, because renderer and geometry differ by less.
_TOLERANCE = 0.02
_STEPS = 8
# Least slope of the picture along the outline of structures, per pixel, as a share of their least strength; and largest
# agreement in direction of the edges there, 0 to 1.
_LEAST_SLOPE = 0.45
_MOST_ALIKE = 0.7
# Share of the difference between structures and surroundings by which structures must differ more from the ground.
_CLEARLY = 0.5
# Least share of structures, and largest agreement in direction of all edges, this far around an object on the ground.
_TANGLE_PX = 12
_LEAST_TANGLE = 0.35
_MOST_TANGLE_ALIKE = 0.35
# The ground is the smoothest share of the picture this far around an object, px.
_AROUND_PX = 40
_SMOOTH_SHARE = 0.3
# Largest hidden share of an object in spots that do not reach beyond its outline.
_MOST_HOLES = 0.1


@dataclass(frozen=True)
class Occluder:
    """Structures of a background in front of one object.

    Attributes:
        window: Left, top, right and bottom edge of the part of the picture where they are in front, px.
        bright: Whether they are brighter than their surroundings.
        width_px: Width below which something is a structure.
        limit_grey: Strength, in the picture's levels above or below the surroundings, that is half transparent.
        soft_grey: Rise in strength from transparent to opaque.
        visible: Share of the object's silhouette that they leave visible.
    """

    window: tuple[int, int, int, int]
    bright: bool
    width_px: int
    limit_grey: float
    soft_grey: float
    visible: float

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {**asdict(self), "window": list(self.window)}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Occluder:
        """Return the occluder that `to_json` wrote; further fields are ignored."""
        left, top, right, bottom = data["window"]
        fields = {k: data[k] for k in ("bright", "width_px", "limit_grey", "soft_grey", "visible")}
        return cls((left, top, right, bottom), **fields)


@dataclass(frozen=True)
class Wanted:
    """The visible share that an object should have.

    Attributes:
        aim: The share itself.
        low: Least share that is accepted.
        high: Largest share that is accepted.
    """

    aim: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Scenery:
    """A background as the source of occluders.

    Attributes:
        pixels: (h, w) grey levels.
        grey_unit: Levels of the picture per 8-bit level.
    """

    pixels: GreyImage
    grey_unit: float = 1.0

    @cached_property
    def least_grey(self) -> float:
        """Least strength of a structure, in the picture's levels."""
        return max(_LEAST_NOISE * noise_of(self.pixels, self.grey_unit), _LEAST_GREY) * self.grey_unit

    @cached_property
    def _gradient(self) -> tuple[Share, Share]:
        """(h, w) slopes of the picture to the right and down, levels per pixel."""
        grey = cv2.GaussianBlur(self.pixels.astype(np.float32), (0, 0), _SMOOTHING_PX)
        x, y = (cv2.Sobel(grey, cv2.CV_32F, dx, 1 - dx, scale=1 / 8) for dx in (1, 0))
        return np.asarray(x, np.float32), np.asarray(y, np.float32)

    def _ground_grey(self, window: tuple[int, int, int, int]) -> float:
        """Return the level of the ground around a window: that of the smoothest pixels."""
        part = _around(window, _AROUND_PX)
        x, y = self._gradient
        slope = np.hypot(x[part], y[part])
        return float(np.median(self.pixels[part][slope <= quantile(slope, _SMOOTH_SHARE)]))

    @cached_property
    def _texture_sums(self) -> NDArray[np.float64]:
        """(h + 1, w + 1) sums of the pixels that some structure covers, over the rectangle from the origin."""
        h, w = self.pixels.shape
        whole = (0, 0, w, h)
        strong = [self.strength(whole, bright, _TEXTURE_WIDTH_PX) > self.least_grey for bright in (True, False)]
        return np.asarray(cv2.integral((strong[0] | strong[1]).astype(np.uint8)), np.float64)

    def texture(self, box_xyxy: NDArray[np.float64]) -> float:
        """Return the share of a box that structures of the picture cover, whatever their size."""
        x0, y0, x1, y1 = pixel_box(box_xyxy, self.pixels.shape)
        if x1 <= x0 or y1 <= y0:
            return 0.0
        s = self._texture_sums
        return float(s[y1, x1] - s[y0, x1] - s[y1, x0] + s[y0, x0]) / ((x1 - x0) * (y1 - y0))

    def strength(self, window: tuple[int, int, int, int], bright: bool, width_px: int) -> Share:
        """Return how far each pixel of a window is above (or below) its surroundings, in the picture's levels.

        The surroundings are the picture without its structures narrower than `width_px` (a morphological opening or
        closing by a disc), so that the edge of a road or roof is no structure.
        """
        h, w = self.pixels.shape
        left, top, right, bottom = window
        room = width_px + 3
        x0, y0 = max(left - room, 0), max(top - room, 0)
        x1, y1 = min(right + room, w), min(bottom + room, h)
        grey = cv2.GaussianBlur(self.pixels[y0:y1, x0:x1].astype(np.float32), (0, 0), _SMOOTHING_PX)
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width_px, width_px))
        found = cv2.morphologyEx(grey, cv2.MORPH_TOPHAT if bright else cv2.MORPH_BLACKHAT, disc)
        return np.asarray(found[top - y0 : bottom - y0, left - x0 : right - x0], np.float32)

    def matte(self, occluder: Occluder) -> Share:
        """Return the share of each pixel of the occluder's window that the occluder hides, in [0, 1].

        It rises with the strength of the structure, so that there is no hard cut. Specks are left out.
        """
        strength = self.strength(occluder.window, occluder.bright, occluder.width_px)
        return _matte_of(strength, occluder.limit_grey, occluder.soft_grey)

    def find(
        self, silhouette: Share, offset_xy: tuple[int, int], wanted: Wanted, *, lines: bool = False
    ) -> Occluder | None:
        """Find structures that hide the wanted share of an object.

        Args:
            silhouette: (h, w) share of each pixel of a crop that the object covers.
            offset_xy: Column and row of the crop in the picture.
            wanted: Visible share of the object.
            lines: Whether a single straight structure may hide the object, such as a mast or wire in front of a drone;
                on the ground it may be a kerb or a road marking.

        Returns:
            The occluder; None if the picture has too little structure there.
        """
        if (at := self._at(silhouette, offset_xy)) is None:
            return None
        window, share, shape_hw = at
        if not lines and not self.is_tangled(np.array(window, np.float64)):
            return None
        best = None
        most = 0.0
        for width in _widths(shape_hw):
            for bright in (True, False):
                strength = self.strength(window, bright, width)
                found = self._steer(strength, share, wanted)
                if found is None:
                    continue
                occluder = replace(found, window=window, bright=bright, width_px=width)
                matte = _matte_of(strength, occluder.limit_grey, occluder.soft_grey)
                merit = self._prominence(window, matte)
                if merit > most and self._is_outlined(window, matte, share, lines):
                    best = occluder
                    most = merit
        return best

    def again(
        self, occluder: Occluder, silhouette: Share, offset_xy: tuple[int, int], *, in_tangle: bool
    ) -> Occluder | None:
        """Return the structures of the same strength in front of an object in another frame of its sequence.

        Args:
            occluder: What was in front of it in a frame, with strengths in the levels of this one.
            silhouette: (h, w) share of each pixel of a crop that the object covers.
            offset_xy: Column and row of the crop in the picture.
            in_tangle: Whether nothing is in front unless structures in all directions are around the object.
        """
        if (at := self._at(silhouette, offset_xy)) is None:
            return None
        window, share, _ = at
        if in_tangle and not self.is_tangled(np.array(window, np.float64)):
            return None
        matte = self.matte(replace(occluder, window=window))
        hidden = float((matte * share).sum(dtype=np.float64)) / float(share.sum(dtype=np.float64))
        return replace(occluder, window=window, visible=round(1 - hidden, 4))

    def _at(
        self, silhouette: Share, offset_xy: tuple[int, int]
    ) -> tuple[tuple[int, int, int, int], Share, tuple[int, int]] | None:
        """Return the window around a silhouette, the share of its pixels that the object covers, and its own size.

        None for an empty silhouette.
        """
        rows, columns = np.flatnonzero(silhouette.any(axis=1)), np.flatnonzero(silhouette.any(axis=0))
        if not rows.size:
            return None
        x, y = offset_xy
        h, w = self.pixels.shape
        left = max(x + int(columns[0]) - _MARGIN_PX, 0)
        top = max(y + int(rows[0]) - _MARGIN_PX, 0)
        right = min(x + int(columns[-1]) + 1 + _MARGIN_PX, w)
        bottom = min(y + int(rows[-1]) + 1 + _MARGIN_PX, h)
        share = np.zeros((bottom - top, right - left), np.float32)
        inner = silhouette[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        at_x, at_y = x + int(columns[0]) - left, y + int(rows[0]) - top
        share[at_y : at_y + inner.shape[0], at_x : at_x + inner.shape[1]] = inner
        return (left, top, right, bottom), share, (inner.shape[0], inner.shape[1])

    def _steer(self, strength: Share, share: Share, wanted: Wanted) -> Occluder | None:
        """Choose the threshold that leaves the wanted share visible; None if no threshold does."""
        low, high = wanted.low + _TOLERANCE, wanted.high - _TOLERANCE
        if low > high:
            low = high = (wanted.low + wanted.high) / 2
        aim = min(max(wanted.aim, low), high)

        whole = float(share.sum(dtype=np.float64))

        def at(limit: float) -> Occluder:
            limit = round(limit, 3)
            soft = round(limit / 2, 3)
            hidden = float((_matte_of(strength, limit, soft) * share).sum(dtype=np.float64)) / whole
            return Occluder((0, 0, 0, 0), True, 0, limit, soft, round(1 - hidden, 4))

        # The visible share rises with the threshold.
        below = self.least_grey
        above = float(strength.max())
        best = at(below)
        if best.visible < aim < 1:
            for _ in range(_STEPS):
                tried = at((below + above) / 2)
                if abs(tried.visible - aim) < abs(best.visible - aim):
                    best = tried
                below, above = (tried.limit_grey, above) if tried.visible < aim else (below, tried.limit_grey)
        return best if low <= best.visible <= high or (low == high and abs(best.visible - low) < _TOLERANCE) else None

    def _prominence(self, window: tuple[int, int, int, int], matte: Share) -> float:
        """Return how much more the structures of a window differ from the ground around it than the rest does.

        Between leaves one sees the ground, so what differs more is in front. The result is 0 where that is not clear.
        """
        left, top, right, bottom = window
        grey = self.pixels[top:bottom, left:right].astype(np.float32)
        front, behind = (float((grey * m).sum()) / max(float(m.sum()), 1e-6) for m in (matte, 1 - matte))
        ground = self._ground_grey(window)
        ahead = abs(front - ground) - abs(behind - ground)
        return ahead if ahead >= _CLEARLY * abs(front - behind) else 0.0

    def is_tangled(self, box_xyxy: NDArray[np.float64]) -> bool:
        """Return whether structures in all directions fill the surroundings of a box, as in a canopy, unlike a road."""
        h, w = self.pixels.shape
        limits = np.array([w, h, w, h])
        around = np.clip(box_xyxy + _TANGLE_PX * np.array([-1, -1, 1, 1]), 0, limits)
        if self.texture(around) < _LEAST_TANGLE:
            return False
        left, top, right, bottom = (int(v) for v in around)
        x, y = (g[top:bottom, left:right] for g in self._gradient)
        return _agreement(x, y) <= _MOST_TANGLE_ALIKE

    def _is_outlined(self, window: tuple[int, int, int, int], matte: Share, share: Share, lines: bool) -> bool:
        """Return whether the picture itself shows an edge where the structures cut the object.

        Without `lines`, the edges must not all run the same way, as those of kerbs, road markings and roofs do.
        """
        part = _around(window, 0)
        x, y = (g[part] for g in self._gradient)
        core = (matte > 0.5).astype(np.uint8)
        _, spots = cv2.connectedComponents(core, connectivity=8)
        reaching = np.unique(spots[(share < 0.5) & (core > 0)])
        hidden = (core > 0) & (share >= 0.5)
        if np.count_nonzero(hidden & ~np.isin(spots, reaching)) > _MOST_HOLES * np.count_nonzero(hidden):
            return False
        outline = cv2.morphologyEx(core, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)).astype(np.bool_)
        outline &= cv2.dilate(share, np.ones((3, 3), np.uint8)) > 0.5
        if not outline.any():
            return False
        steep = np.hypot(x, y)[outline]
        return float(np.median(steep)) >= _LEAST_SLOPE * self.least_grey and (
            lines or _agreement(x[outline], y[outline]) <= _MOST_ALIKE
        )


def front_matte(
    occluders: Mapping[int, Occluder], scenery: Scenery, coverage: Share, offset_xy: tuple[int, int]
) -> Share:
    """Return the (h, w) share of each pixel of the picture that stays in front of the inserted objects.

    `coverage` (n, ch, cw) is that of a crop at `offset_xy`. Where another object covers a pixel more, the occluder is
    not in front.
    """
    front = np.zeros(scenery.pixels.shape, np.float32)
    x, y = offset_xy
    h, w = coverage.shape[1:]
    for k, occluder in sorted(occluders.items()):
        left, top, right, bottom = occluder.window
        free = np.ones((bottom - top, right - left), np.bool_)
        x0, y0 = max(left, x), max(top, y)
        x1, y1 = min(right, x + w), min(bottom, y + h)
        if len(coverage) > 1 and x0 < x1 and y0 < y1:
            shared = coverage[:, y0 - y : y1 - y, x0 - x : x1 - x]
            most = np.delete(shared, k, axis=0).max(axis=0)
            free[y0 - top : y1 - top, x0 - left : x1 - left] = (most <= 0) | (shared[k] >= most)
        part = (slice(top, bottom), slice(left, right))
        front[part] = np.maximum(front[part], scenery.matte(occluder) * free)
    return front


def put_behind(layer: Layer, front: Share) -> Layer:
    """Return the layer as far as it is visible behind what is in front, a share (h, w) per pixel of the picture."""
    x, y = layer.offset_xy
    h, w = layer.alpha.shape
    seen = 1 - front[y : y + h, x : x + w]
    return replace(layer, grey=layer.grey * seen, alpha=layer.alpha * seen)


def restore_front(picture: GreyImage, background: GreyImage, front: Share) -> GreyImage:
    """Return the picture with the background's own values where the background is wholly in front."""
    restored = picture.copy()
    opaque = front >= 1
    restored[opaque] = background[opaque]
    return restored


def _matte_of(strength: Share, limit: float, soft: float) -> Share:
    matte = np.clip((strength - limit) / soft + 0.5, 0, 1)
    strong = (strength > limit).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(strong, connectivity=8)
    large = stats[:, cv2.CC_STAT_AREA] >= _LEAST_PIXELS
    large[0] = False
    # The soft edge of a structure reaches beyond its core.
    near = cv2.dilate(large[labels].astype(np.uint8), np.ones((3, 3), np.uint8))
    return np.asarray(matte * near, np.float32)


def _around(window: tuple[int, int, int, int], margin_px: int) -> tuple[slice, slice]:
    left, top, right, bottom = window
    return slice(max(top - margin_px, 0), bottom + margin_px), slice(max(left - margin_px, 0), right + margin_px)


def _agreement(x: Share, y: Share) -> float:
    """Return how far slopes agree in direction (or its opposite): 0 for all directions alike, 1 for one direction."""
    xx, yy, xy = (float((p * q).sum()) for p, q in ((x, x), (y, y), (x, y)))
    return math.hypot(xx - yy, 2 * xy) / max(xx + yy, 1e-6)


def _widths(shape_hw: tuple[int, ...]) -> list[int]:
    """Return the odd widths of discs that structures in front of an object of this size fit into."""
    sizes = [factor * max(shape_hw) for factor in _WIDTHS]
    low, high = _WIDTH_LIMITS_PX
    return sorted({int(np.clip(2 * round(s / 2) + 1, low, high)) for s in sizes})
