"""Tracks in time: how contrast, size and place of small objects vary from frame to frame, inserted against real.

One track is one object, and differs from every other in what it is. What counts here is how it changes: each measure
is relative to that of its track, in windows of eight frames. A classifier then tells windows of inserted tracks from
those of real ones in the same clip; the floor is what it makes of the first and the second half of a real track.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infrablend.lab.realism.classify import auc, out_of_fold

WINDOW = 8
FEATURES = (
    "contrast, spread", "contrast, step", "size, spread", "size, step", "shape, spread", "jitter across",
    "jitter along", "blur along the motion", "speed",
)  # fmt: skip
"""Measures of a window: spreads and steps are of logarithms; jitter is what a smooth path leaves, px against the
background; blur is the variance along the motion beyond that of the track's still frames, px²; speed, px per frame."""

# Half width and half height of what is looked at around an object, px, and the share of its peak that counts as object.
_HALF_WH, _LEVEL = (16, 12), 0.3
# Windows of a stretch of the clip share a fold, so many in a row.
_STRETCH = 4


@dataclass(frozen=True)
class Look:
    """An object in one frame.

    Attributes:
        contrast: Peak above what is around it, levels.
        size_px: Square root of its area.
        spread_px2: (2, 2) covariance of its light, px².
    """

    contrast: float
    size_px: float
    spread_px2: NDArray[np.float64]


def look_at(picture: NDArray[np.uint8], middle_xy: Sequence[float]) -> Look | None:
    """Measure a small object that is brighter or darker than what is around it; None at the edge, or without one."""
    (half_w, half_h), (x, y) = _HALF_WH, (round(v) for v in middle_xy)
    h, w = picture.shape
    if x < half_w or y < half_h or x + half_w >= w or y + half_h >= h:
        return None
    part = picture[y - half_h : y + half_h + 1, x - half_w : x + half_w + 1].astype(np.float64)
    part -= np.median(part)
    inner = part[half_h // 2 : -(half_h // 2), half_w // 2 : -(half_w // 2)]
    part *= 1.0 if inner.max() >= -inner.min() else -1.0
    peak = float(part[half_h // 2 : -(half_h // 2), half_w // 2 : -(half_w // 2)].max())
    light = np.clip(part - _LEVEL * peak, 0, None)
    if peak <= 0 or light.sum() <= 0:
        return None
    rows, columns = np.mgrid[-half_h : half_h + 1, -half_w : half_w + 1]
    places, weight = np.stack([columns.ravel(), rows.ravel()]), light.ravel() / light.sum()
    centre = places @ weight
    off = places - centre[:, None]
    return Look(peak, float(np.sqrt((light > 0).sum())), (off * weight) @ off.T)


def windows(
    looks: Sequence[Look | None], first_xy: NDArray[np.float64], shown_xy: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return (n, features) of the windows of a track in which it is seen in every frame.

    Args:
        looks: The object, frame by frame; None where it cannot be measured.
        first_xy: (frames, 2) its place in the picture of one frame: without the camera's motion.
        shown_xy: (frames, 2) its place in each picture.
    """
    seen = [k for k in looks if k is not None]
    if not seen:
        return np.zeros((0, len(FEATURES)))
    contrast, size = (np.median([getattr(k, name) for k in seen]) for name in ("contrast", "size_px"))
    still = np.median([np.trace(k.spread_px2) for k in seen]) / 2
    found = []
    for k in range(0, len(looks) - WINDOW + 1, WINDOW):
        part = [one for one in looks[k : k + WINDOW] if one is not None]
        if len(part) < WINDOW:
            continue
        c = np.log([max(p.contrast, 1) / contrast for p in part])
        s = np.log([p.size_px / size for p in part])
        shape = [np.log(max(np.linalg.eigvalsh(p.spread_px2)[1], 0.05)) for p in part]
        along, across, speed, blur = _movement(part, first_xy[k : k + WINDOW], shown_xy[k : k + WINDOW], still)
        row = (c.std(), np.abs(np.diff(c)).mean(), s.std(), np.abs(np.diff(s)).mean(), np.std(shape))
        found.append((*row, across, along, blur, speed))
    return np.array(found, np.float64).reshape(-1, len(FEATURES))


def _movement(
    looks: Sequence[Look], first_xy: NDArray[np.float64], shown_xy: NDArray[np.float64], still_px2: float
) -> tuple[float, float, float, float]:
    """Return jitter along and across the motion, speed, and blur along the motion in the picture."""
    time = np.linspace(-1, 1, len(looks))
    fit = np.polynomial.polynomial.polyfit(time, first_xy, 2)
    left = first_xy - np.polynomial.polynomial.polyval(time, fit).T
    step = np.diff(shown_xy, axis=0)
    speed = float(np.linalg.norm(step, axis=1).mean())
    way = step.mean(axis=0)
    length = float(np.linalg.norm(way))
    unit = way / length if length > 1e-6 else np.array([1.0, 0.0])
    along = left @ unit
    across = left @ np.array([-unit[1], unit[0]])
    blur = float(np.mean([unit @ k.spread_px2 @ unit for k in looks])) / still_px2
    return float(along.std()), float(across.std()), speed, float(np.log(blur))


def tell_apart(one: NDArray[np.float64], other: NDArray[np.float64]) -> float | None:
    """Return the AUC of telling (n, features) windows of one kind from those of another; None if there are too few.

    Stretches of neighbouring windows are in one fold.
    """
    groups = np.concatenate([np.arange(len(one)) // _STRETCH, np.arange(len(other)) // _STRETCH])
    if min(len(one), len(other)) < WINDOW or len(np.unique(groups)) < 5:
        return None
    x, y = np.concatenate([one, other]), np.repeat([0, 1], [len(one), len(other)])
    return auc(y, out_of_fold(x, y, groups.astype(np.int64), "logistic"))


def floor_of(real: NDArray[np.float64]) -> float | None:
    """Return the AUC of telling the first half of a real track from the second."""
    half = len(real) // 2
    return tell_apart(real[:half], real[half:])
