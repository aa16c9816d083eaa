"""Paints an object out of a frame of a video: other frames show what is behind it, as camera and object move.

Nothing else of the frame changes: text and reticle that the camera writes over the object stay as they are.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import boxes_mask
from infrablend.core.mesh import FloatArray
from infrablend.imaging.burnt_in import find_burnt_in
from infrablend.imaging.camera_shift import Matrix, View, find_shift

Pixels = NDArray[np.uint8] | NDArray[np.uint16]
How = Literal["other-frames", "in-part", "guessed"]
"""Where the pixels come from: from other frames; some from what is around them, as no other frame shows them; all from
there, as no other frame can be aligned or shows any of them."""

HOWS: tuple[How, ...] = ("other-frames", "in-part", "guessed")

STEP = 8
"""Other frames are those whose numbers are multiples of this ..."""
REACH = 96
"""... at most so many frames away ..."""
SAMPLES = 24
"""... and about as many over the whole video."""

# Frames, of those that can be aligned, from which the pixels come, if they show all of them.
_ENOUGH = 8

# Boxes grow by this many px and this share of their size: objects glow.
_GROW_PX = 6
_GROW = 0.2
# Width of the surroundings by which frames are compared, px.
_AROUND_PX = 14
# Frames are used besides the best if they differ from the surroundings by at most so many times as much.
_WORSE = 4.0
# Width over which painted and real pixels blend, px.
_BLEND_PX = 3.0
# How far levels of the surroundings reach into the hole, px.
_LEVEL_PX = 8.0
# Strokes of text differ by this from their surroundings, 8-bit levels, within so many px.
_STROKE = 25.0
_STROKE_PX = 7
# Interpolation of the video spreads strokes by so many px.
_SPREAD_PX = 3
# What is finer than this is grain, px.
_GRAIN_PX = 1.5


@dataclass(frozen=True, eq=False)
class Shown:
    """A frame and where its object is.

    Attributes:
        pixels: (h, w) grey levels, or (h, w, 3) colour.
        box_xyxy: (4,) box around the object; None for no object.
    """

    pixels: Pixels
    box_xyxy: FloatArray | None

    @cached_property
    def grey(self) -> NDArray[np.uint8]:
        """(h, w) 8-bit levels."""
        grey = self.pixels if self.pixels.ndim == 2 else self.pixels.mean(axis=2)
        return np.asarray(grey / self.unit, np.uint8)

    @property
    def unit(self) -> float:
        """Levels per 8-bit level."""
        return 257.0 if self.pixels.dtype == np.uint16 else 1.0

    @cached_property
    def object(self) -> NDArray[np.bool_]:
        """(h, w) mask of the object and its glow."""
        if self.box_xyxy is None:
            return np.zeros(self.pixels.shape[:2], np.bool_)
        grow = _GROW_PX + _GROW * (self.box_xyxy[2:] - self.box_xyxy[:2])
        return boxes_mask([np.concatenate([self.box_xyxy[:2] - grow, self.box_xyxy[2:] + grow])], self.pixels.shape[:2])

    @cached_property
    def marked(self) -> NDArray[np.bool_]:
        """(h, w) mask of the boxes of text."""
        return boxes_mask(find_burnt_in(self.grey.astype(np.float32)), self.pixels.shape[:2])

    @cached_property
    def thin(self) -> NDArray[np.bool_]:
        """(h, w) mask of what is as thin and as distinct as a stroke of text."""
        kernel = np.ones((_STROKE_PX, _STROKE_PX), np.uint8)
        bright, dark = (cv2.morphologyEx(self.grey, kind, kernel) for kind in (cv2.MORPH_TOPHAT, cv2.MORPH_BLACKHAT))
        return np.asarray(np.maximum(bright, dark) > _STROKE)

    @cached_property
    def strokes(self) -> NDArray[np.bool_]:
        """(h, w) mask of the strokes of text themselves."""
        return np.asarray(self.marked & self.thin)


@dataclass(frozen=True, eq=False)
class Written:
    """Text and reticle of a video: (h, w) masks of the boxes around them, and of their strokes."""

    marked: NDArray[np.bool_]
    strokes: NDArray[np.bool_]


def find_written(frames: Sequence[Shown]) -> Written:
    """Return what is written in most of some frames, where their object is elsewhere: text stays, the scene moves."""
    free = [~f.object for f in frames]
    seen = sum(f.astype(np.int32) for f in free)

    def most(masks: Iterable[NDArray[np.bool_]]) -> NDArray[np.bool_]:
        return np.asarray(2 * sum((m & f).astype(np.int32) for m, f in zip(masks, free, strict=True)) > seen)

    return Written(most(f.marked for f in frames), most(f.strokes for f in frames))


def paint_out(shown: Shown, others: Iterable[tuple[int, Shown]], written: Written) -> tuple[Pixels, How]:
    """Return a frame without its object, and where the pixels come from: the first of the other frames that suffice.

    Each of them comes with its number of frames after this one, the nearest first: views go on moving as they did.
    """
    hole = shown.object
    taken = hole | written.marked
    window = _window(hole)
    frame = shown.pixels[window].astype(np.float32)
    inside = hole[window]
    view = View(shown.grey, taken)
    found: list[_Aligned] = []
    unseen = inside & ~written.strokes[window]
    per_frame: dict[bool, Matrix] = {}  # by direction: change of the matrix in one frame
    for after, other in others:
        if len(found) >= _ENOUGH and not unseen.any():
            break
        guess = np.eye(3) + after * per_frame.get(after > 0, np.zeros((3, 3)))
        shift = find_shift(view, View(other.grey, other.object | written.marked), guess)
        if shift is not None:
            found.append(_aligned(shown, other, written.marked, shift.matrix, window))
            unseen &= ~found[-1].known
            per_frame[after > 0] = (shift.matrix - np.eye(3)) / after
    painted, missing = _fill(frame, inside, taken[window], found)
    missing &= ~written.strokes[window]
    if missing.any():
        made_up = _inpainted(shown, window, missing, taken)
        painted[missing] = made_up[missing]
    # The distance from the hole's own edge: text within it is no edge.
    depth = cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, 3)
    share = np.where(written.strokes[window], 0, np.clip(depth / _BLEND_PX, 0, 1)).astype(np.float32)
    share = share[..., None] if frame.ndim == 3 else share
    result = shown.pixels.copy()
    top = np.iinfo(result.dtype).max
    result[window] = np.clip(np.rint(frame + share * (painted - frame)), 0, top).astype(result.dtype)
    if not missing.any():
        return result, "other-frames" if found else "guessed"
    return result, "in-part" if (inside & ~written.strokes[window] & ~missing).any() else "guessed"


def _window(hole: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return rows and columns of a hole and its surroundings."""
    rows, columns = np.flatnonzero(hole.any(axis=1)), np.flatnonzero(hole.any(axis=0))
    low, high = max(rows[0] - _AROUND_PX, 0), rows[-1] + 1 + _AROUND_PX
    return slice(low, high), slice(max(columns[0] - _AROUND_PX, 0), columns[-1] + 1 + _AROUND_PX)


@dataclass(frozen=True, eq=False)
class _Aligned:
    """Another frame, shifted so that its background is that of the window: levels, and where they are known."""

    pixels: NDArray[np.float32]
    known: NDArray[np.bool_]


def _aligned(
    shown: Shown, other: Shown, marked: NDArray[np.bool_], shift: Matrix, window: tuple[slice, slice]
) -> _Aligned:
    """Return another frame as the window would see it; `shift` leads from this frame to the other one."""
    rows, columns = window
    size = shown.pixels[window].shape[1::-1]
    # That of the window begins at the window's corner.
    moved = shift @ np.array([[1, 0, columns.start], [0, 1, rows.start], [0, 0, 1]], np.float64)
    unknown = cv2.dilate((other.object | marked).astype(np.uint8), np.ones((2 * _SPREAD_PX + 1,) * 2, np.uint8))
    back = cv2.WARP_INVERSE_MAP
    pixels = cv2.warpPerspective(other.pixels.astype(np.float32), moved, size, flags=cv2.INTER_LANCZOS4 | back)
    edge = cv2.warpPerspective(
        unknown, moved, size, flags=cv2.INTER_NEAREST | back, borderMode=cv2.BORDER_CONSTANT, borderValue=1
    )
    return _Aligned(np.asarray(pixels, np.float32), np.asarray(edge == 0))


def _fill(
    frame: NDArray[np.float32], inside: NDArray[np.bool_], blocked: NDArray[np.bool_], found: Sequence[_Aligned]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the window with the pixels of other frames, the most alike first, and what none of them shows.

    A pixel is that of one frame: the mean of several would have less grain than the rest of the picture.
    """
    alike: list[tuple[float, int, NDArray[np.float32]]] = []
    for number, other in enumerate(found):
        around = other.known & ~blocked
        if not around.any() or not (other.known & inside).any():
            continue
        levelled = other.pixels + _smoothed(frame - other.pixels, around)
        alike.append((float(np.abs(levelled - frame)[around].mean()), number, levelled))
    painted = frame.copy()
    missing = inside.copy()
    for difference, number, levelled in sorted(alike, key=lambda a: a[:2]):
        if difference > _WORSE * min(a[0] for a in alike) + 1:
            break
        new = missing & found[number].known
        painted[new] = levelled[new]
        missing &= ~new
    return painted, missing


def _smoothed(values: NDArray[np.float32], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the local mean of the known values."""
    weights = known.astype(np.float32)
    each = weights[..., None] if values.ndim == 3 else weights
    total, count = (cv2.GaussianBlur(v, (0, 0), _LEVEL_PX) for v in (values * each, weights))
    count = np.maximum(count, 1e-6)
    return np.asarray(total / (count[..., None] if values.ndim == 3 else count), np.float32)


def _inpainted(
    shown: Shown, window: tuple[slice, slice], missing: NDArray[np.bool_], blocked: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Return the window with missing pixels made from those around them, with the grain of a place nearby."""
    level = cv2.inpaint(shown.pixels[window], blocked[window].astype(np.uint8), 5, cv2.INPAINT_TELEA)
    level = cv2.GaussianBlur(level.astype(np.float32), (0, 0), _GRAIN_PX)
    rows, columns = window
    height, width = missing.shape
    best = np.inf
    grain = np.zeros_like(level)
    for down, right in ((0, -1), (0, 1), (-1, 0), (1, 0), (-1, -1), (-1, 1), (1, -1), (1, 1)):
        top = rows.start + down * height
        left = columns.start + right * width
        if top < 0 or left < 0 or top + height > blocked.shape[0] or left + width > blocked.shape[1]:
            continue
        there = slice(top, top + height), slice(left, left + width)
        if (blocked[there] & missing).any():
            continue
        source = shown.pixels[there].astype(np.float32)
        soft = cv2.GaussianBlur(source, (0, 0), _GRAIN_PX)
        apart = float(np.abs(soft - level)[missing].mean())
        if apart < best:
            best = apart
            grain = source - soft
    return np.asarray(level + grain, np.float32)
