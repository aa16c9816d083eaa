"""Finds text, logos and symbols that a camera has written into its pictures.

Glyphs are small, nearly as bright as the brightest level, sharper than any lens, and in rows of equal height. A picture
with one such row has more marks, which need not be as clear: shorter rows, dimmer glyphs, the outline of a battery, and
lines of a reticle, bright before what is dark and dark before what is bright.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.mesh import FloatArray

# A glyph has pixels that are this much brighter than what surrounds them and this near to the brightest level, 8-bit
# levels; its other pixels, which are smoothed, are brighter than the surroundings by the third figure.
_ABOVE = 50.0
_BELOW_BRIGHTEST = 40.0
_EDGE_ABOVE = 25.0
# Least height of a glyph, px, greatest as a share of the picture's height, and greatest width in heights. A stroke is
# at most this wide in small and in large glyphs.
_LEAST_PX = 5
_LARGEST = 0.1
_WIDTH_HEIGHTS = 1.6
_STROKES_PX = (5, 9)
# Glyphs of a row: tops and heights that differ by at most this share of the height, at least 1 px; gaps of at most that
# many heights; least number.
_SAME = 0.12
_GAP_HEIGHTS = 1.5
_LEAST_GLYPHS = 4
# Marks in a picture with text: their brightest pixel reaches the text's level less this, and marks with gaps of at most
# this many px are one.
_BELOW_TEXT = 60.0
_JOIN_PX = 9
_LEAST_MARK_PX = 4
# Details on a larger share of the picture, or more of them, are its texture; clips with text and reticle have up to 70.
_MOST_MARKED = 0.25
_MOST_MARKS = 200
_MARGIN_PX = 2
# A line of a reticle is along the picture's rows or columns: at most so wide and at least so long, px ...
_LINE_PX = 3
_LINE_LONG_PX = 32
# ... with gaps of at most so many px ...
_LINE_GAP_PX = 5
# ... and it differs from both sides by this much, 8-bit levels.
_LINE_ABOVE = 30.0


_Box = tuple[int, int, int, int]


class _Glyph(NamedTuple):
    x: int
    y: int
    w: int
    h: int


def find_burnt_in(picture: NDArray[np.float32], scale: float = 1.0) -> FloatArray:
    """Return the (n, 4) boxes around text and other marks in a picture (h, w); none if it has no row of bright text.

    Bright details of the scene may be among the marks of a picture that has text. `scale` is the number of levels per
    8-bit level.
    """
    grey = np.asarray(picture, np.float32) / np.float32(scale)
    boxes = _text(grey)
    if boxes:
        # Some cameras write black before what is bright.
        boxes += _text(-grey)
        lines = _lines(grey)
        bands = [(y0, y1) for _, y0, _, y1 in boxes]
        light, dark = ([image[y0:y1, x0:x1].max() for x0, y0, x1, y1 in boxes] for image in (grey, -grey))
        dark_marks = _marks(-grey, float(np.median(dark)), lines)
        marks = [m for m in dark_marks if any(m[1] < y1 and y0 < m[3] for y0, y1 in bands)]
        marks += [*_marks(grey, float(np.median(light)), lines), *_boxes_of(lines)]
        boxes += marks if len(marks) <= _MOST_MARKS else []
    grown = np.array(boxes, np.float64).reshape(-1, 4)
    return np.asarray(grown + np.array([-_MARGIN_PX, -_MARGIN_PX, _MARGIN_PX, _MARGIN_PX]))


def _above_surroundings(grey: NDArray[np.float32], stroke_px: int) -> NDArray[np.float32]:
    return np.asarray(cv2.morphologyEx(grey, cv2.MORPH_TOPHAT, np.ones((stroke_px, stroke_px), np.uint8)), np.float32)


def _glyphs(grey: NDArray[np.float32], stroke_px: int) -> Iterable[list[_Glyph]]:
    """Yield the connected strokes of the size of glyphs, from left to right, without and with smoothed edges.

    Smoothed edges join the letters of small text; without them those of large text fall apart.
    """
    above = _above_surroundings(grey, stroke_px)
    certain = (above > _ABOVE) & (grey > float(grey.max()) - _BELOW_BRIGHTEST)
    highest = max(2.8 * _LEAST_PX, _LARGEST * grey.shape[0])
    # Wide strokes are those of large glyphs.
    least = _LEAST_PX if stroke_px == _STROKES_PX[0] else 2 * stroke_px
    for strokes in (certain, above > _EDGE_ABOVE):
        found = _components(strokes, certain)
        yield sorted(g for g in found if least <= g.h <= highest and g.w <= _WIDTH_HEIGHTS * g.h)


def _components(strokes: NDArray[np.bool_], certain: NDArray[np.bool_]) -> Iterable[_Glyph]:
    """Yield the connected regions of the first mask that contain pixels of the second."""
    count, names, facts, _ = cv2.connectedComponentsWithStats(strokes.astype(np.uint8), connectivity=8)
    kept = np.bincount(names[certain], minlength=count) > 0
    return (_Glyph(*(int(v) for v in facts[k, :4])) for k in range(1, count) if kept[k])


def _rows(glyphs: list[_Glyph]) -> list[list[_Glyph]]:
    """Return the glyphs of equal height that are beside each other, where they are enough for a row.

    Takes them from left to right.
    """
    rows: list[list[_Glyph]] = []
    numbers: defaultdict[int, list[int]] = defaultdict(list)  # of rows, by the top of their last glyph
    for glyph in glyphs:
        same = max(1.0, _SAME * glyph.h)
        tops = range(glyph.y - int(same), glyph.y + int(same) + 1)
        for number in sorted(k for top in tops for k in numbers[top]):
            last = rows[number][-1]
            near = 0 <= glyph.x - (last.x + last.w) <= _GAP_HEIGHTS * glyph.h
            if near and abs(glyph.h - last.h) <= same:
                rows[number].append(glyph)
                numbers[last.y].remove(number)
                break
        else:
            number = len(rows)
            rows.append([glyph])
        numbers[glyph.y].append(number)
    return [row for row in rows if len(row) >= _LEAST_GLYPHS]


def _text(grey: NDArray[np.float32]) -> list[_Box]:
    """Return the boxes around the rows of glyphs that are brighter than their surroundings."""
    rows: list[list[_Glyph]] = []
    for stroke in _STROKES_PX:
        for glyphs in _glyphs(grey, stroke):
            rows += _rows(glyphs)
    return [_box_around(row) for row in rows]


def _box_around(glyphs: list[_Glyph]) -> _Box:
    left, top = min(g.x for g in glyphs), min(g.y for g in glyphs)
    right, bottom = max(g.x + g.w for g in glyphs), max(g.y + g.h for g in glyphs)
    return left, top, right, bottom


def _lines(grey: NDArray[np.float32]) -> list[NDArray[np.bool_]]:
    """Return the (h, w) masks of the horizontal and the vertical lines of a reticle."""
    found = []
    for image in (grey, grey.T):
        apart = np.zeros(image.shape, np.float32)
        above = image[_LINE_PX:-_LINE_PX] - image[: -2 * _LINE_PX]
        below = image[_LINE_PX:-_LINE_PX] - image[2 * _LINE_PX :]
        apart[_LINE_PX:-_LINE_PX] = np.maximum(np.minimum(above, below), np.minimum(-above, -below))
        sharp = (apart > _LINE_ABOVE).astype(np.uint8)
        joined = cv2.morphologyEx(sharp, cv2.MORPH_CLOSE, np.ones((1, _LINE_GAP_PX), np.uint8))
        long = cv2.morphologyEx(joined, cv2.MORPH_OPEN, np.ones((1, _LINE_LONG_PX), np.uint8)).astype(np.bool_)
        found.append(long)
    return [found[0], found[1].T]


def _boxes_of(lines: Sequence[NDArray[np.bool_]]) -> list[_Box]:
    return [(g.x, g.y, g.x + g.w, g.y + g.h) for mask in lines for g in _components(mask, mask)]


def _marks(grey: NDArray[np.float32], text_level: float, lines: Sequence[NDArray[np.bool_]]) -> list[_Box]:
    """Return boxes around sharp details about as bright as the text, joined to words, without the lines."""
    above = _above_surroundings(grey, _STROKES_PX[0])
    for mask in lines:
        above[mask] = 0
    certain = (above > _ABOVE) & (grey > text_level - _BELOW_TEXT)
    joined = cv2.morphologyEx((above > _EDGE_ABOVE).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((1, _JOIN_PX), np.uint8))
    found = _components(joined.astype(np.bool_), certain)
    marks = [m for m in found if m.h >= _LEAST_MARK_PX and m.w >= _LEAST_MARK_PX]
    if sum(m.w * m.h for m in marks) > _MOST_MARKED * grey.size:
        return []
    return [(m.x, m.y, m.x + m.w, m.y + m.h) for m in marks]
