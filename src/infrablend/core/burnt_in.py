"""Finds text and logos that a camera has written into its pictures.

Glyphs are small, nearly as bright as the brightest level, sharper than any lens, and in rows of equal height.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.mesh import FloatArray

# A glyph is this much brighter than what surrounds it, and this near to the brightest level, 8-bit levels.
_ABOVE = 50.0
_BELOW_BRIGHTEST = 40.0
# Height and width of a glyph, px; a stroke is at most this wide.
_HEIGHT_PX = (5, 14)
_WIDTH_PX = 14
_STROKE_PX = 5
# Glyphs of a row: tops and heights that differ by at most this, gaps of at most that many heights, least number.
_SAME_PX = 1
_GAP_HEIGHTS = 1.5
_LEAST_GLYPHS = 4
_MARGIN_PX = 2


def find_burnt_in(picture: NDArray[np.float32], scale: float = 1.0) -> FloatArray:
    """Return the (n, 4) boxes around rows of text in a picture.

    Args:
        picture: (h, w) levels.
        scale: Levels of the picture per 8-bit level.
    """
    grey = np.asarray(picture, np.float32) / np.float32(scale)
    strokes = cv2.morphologyEx(grey, cv2.MORPH_TOPHAT, np.ones((_STROKE_PX, _STROKE_PX), np.uint8)) > _ABOVE
    strokes &= grey > float(grey.max()) - _BELOW_BRIGHTEST
    _, _, found, _ = cv2.connectedComponentsWithStats(strokes.astype(np.uint8), connectivity=8)
    low, high = _HEIGHT_PX
    glyphs = sorted(
        (int(x), int(y), int(w), int(h)) for x, y, w, h, _ in found[1:] if low <= h <= high and w <= _WIDTH_PX
    )
    rows: list[list[tuple[int, int, int, int]]] = []
    for glyph in glyphs:
        x, y, _, h = glyph
        for row in rows:
            last = row[-1]
            near = 0 <= x - (last[0] + last[2]) <= _GAP_HEIGHTS * h
            if near and abs(y - last[1]) <= _SAME_PX and abs(h - last[3]) <= _SAME_PX:
                row.append(glyph)
                break
        else:
            rows.append([glyph])
    boxes = []
    for row in rows:
        if len(row) >= _LEAST_GLYPHS:
            xs, ys = [(g[0], g[0] + g[2]) for g in row], [(g[1], g[1] + g[3]) for g in row]
            boxes.append([min(x for x, _ in xs), min(y for y, _ in ys), max(x for _, x in xs), max(y for _, y in ys)])
    grown = np.array(boxes, np.float64).reshape(-1, 4)
    return np.asarray(grown + np.array([-_MARGIN_PX, -_MARGIN_PX, _MARGIN_PX, _MARGIN_PX]))
