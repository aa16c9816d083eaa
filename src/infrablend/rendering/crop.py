"""The part of a frame that has to be rendered."""

from __future__ import annotations

import math

import numpy as np

from infrablend.core.placed import PlacedScene

# One pixel more than the projected outline, so that rounding loses nothing.
CROP_MARGIN_PX = 1


def crop_of(scene: PlacedScene) -> tuple[int, int, int, int] | None:
    """Return the smallest pixel rectangle x0, y0, x1, y1 that contains all objects in the frame; None if none is."""
    w, h = scene.spec.camera.size_wh
    lows, highs = [], []
    for placed in scene.objects:
        xy, depth = placed.xy, placed.depth_m
        if (depth <= 0.01).any():
            if (depth <= 0.01).all():
                continue
            return (0, 0, w, h)  # reaches behind the camera, so its outline is unbounded
        lows.append(xy.min(axis=0))
        highs.append(xy.max(axis=0))
    if not lows:
        return None
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)
    x0, y0 = (max(0, math.floor(v) - CROP_MARGIN_PX) for v in low)
    x1, y1 = min(w, math.ceil(high[0]) + CROP_MARGIN_PX), min(h, math.ceil(high[1]) + CROP_MARGIN_PX)
    return (x0, y0, x1, y1) if x0 < x1 and y0 < y1 else None
