"""What cameras write into their pictures: rows of text, reticles, a bar of grey levels, dead rows at the edge.

A detector that never saw them takes letters and the corners of reticles for small bright objects.
"""

from __future__ import annotations

import string
from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import boxes_mask
from infrablend.core.mesh import FloatArray
from infrablend.core.rng import stream

_FONTS = (cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX, cv2.FONT_HERSHEY_PLAIN, cv2.FONT_HERSHEY_COMPLEX_SMALL)
_GLYPHS = [*string.ascii_uppercase, *string.digits, *(string.digits * 3), *":.-/ "]
# Heights of glyphs and sides of reticles as shares of the picture's height, the former at least so many px.
_TEXT_HEIGHT = (0.02, 0.05)
_LEAST_TEXT_PX = 6.0
_RETICLE = (0.06, 0.35)
# Shares of the pictures with graphics that have each kind of them.
_WITH_TEXT = 0.85
_WITH_RETICLE = 0.6
_WITH_BAR = 0.15
_WITH_DEAD_EDGE = 0.3
# How far graphics stay away from labelled objects, px.
_CLEAR_PX = 2


def draw_graphics(
    picture: NDArray[np.float64], levels: tuple[float, float], seed: int, objects_xyxy: FloatArray
) -> NDArray[np.float64]:
    """Return a picture with burnt-in graphics.

    Args:
        picture: (h, w) levels.
        levels: Levels of black and white.
        seed: Seed of what is drawn.
        objects_xyxy: (n, 4) boxes of labelled objects, px. A mark that would come near one of them is left out, so that
            no small object disappears below a letter.
    """
    rng = stream(seed, "graphics")
    black, white = levels
    drawn = picture.copy()
    occupied = boxes_mask(objects_xyxy + _CLEAR_PX * np.array([-1.0, -1, 1, 1]), picture.shape)
    # White, black, or whichever differs from what is below.
    colour = rng.choice(("white", "black", "contrast"), p=(0.6, 0.15, 0.25))
    for mark in _marks(picture.shape, rng):
        on_mark = mark > 0
        if not on_mark.any() or (on_mark & occupied).any():
            continue
        is_black = colour == "black" or (colour == "contrast" and float(picture[on_mark].mean()) > (black + white) / 2)
        share = mark.astype(np.float64) / 255
        drawn = drawn * (1 - share) + (black if is_black else white) * share
    return drawn


def _marks(shape: Sequence[int], rng: np.random.Generator) -> Iterator[NDArray[np.uint8]]:
    """Yield the marks of a picture, each as (h, w) opacities."""
    if rng.random() < _WITH_TEXT:
        yield from _rows_of_text(shape, rng)
    if rng.random() < _WITH_RETICLE:
        yield from _reticle(shape, rng)
    if rng.random() < _WITH_BAR:
        yield _grey_bar(shape, rng)
    if rng.random() < _WITH_DEAD_EDGE:
        yield _dead_edge(shape, rng)


def _rows_of_text(shape: Sequence[int], rng: np.random.Generator) -> Iterator[NDArray[np.uint8]]:
    """Yield words in one to four rows at the top or the bottom."""
    height, width = shape
    size = max(float(rng.uniform(*_TEXT_HEIGHT)) * height, _LEAST_TEXT_PX)
    font = int(rng.choice(_FONTS))
    (_, glyph_px), _ = cv2.getTextSize("8", font, 1.0, 1)
    scale = size / glyph_px
    thickness = int(rng.integers(1, 3)) if size > 12 else 1
    line_type = int(rng.choice((cv2.LINE_8, cv2.LINE_AA)))
    rows = int(rng.integers(1, 5))
    at_bottom = rng.random() < 0.3
    for row in range(rows):
        y = int((row + 1) * 1.8 * size + 2)
        y = height - y + int(size) if at_bottom else y
        x = float(rng.uniform(0.01, 0.1)) * width
        for _ in range(int(rng.integers(1, 6))):
            word = "".join(rng.choice(_GLYPHS, int(rng.integers(2, 11))))
            mark = np.zeros((height, width), np.uint8)
            cv2.putText(mark, word, (int(x), y), font, scale, 255, thickness, line_type)
            yield mark
            x += cv2.getTextSize(word, font, scale, thickness)[0][0] + float(rng.uniform(1, 4)) * size
            if x > width:
                break


def _reticle(shape: Sequence[int], rng: np.random.Generator) -> Iterator[NDArray[np.uint8]]:
    """Yield the lines of a cross with a gap, of a frame of corners, or of both, about the middle."""
    height, width = shape
    x, y = (int(size * rng.uniform(0.45, 0.55)) for size in (width, height))
    thickness = int(rng.integers(1, 3))
    half_h = int(height * rng.uniform(*_RETICLE))
    half_w = int(half_h * rng.uniform(0.8, 1.5))
    arm = max(int(min(half_h, half_w) * rng.uniform(0.2, 0.8)), 3)
    lines = []
    if rng.random() < 0.7:
        lines += [
            ((x + a * half_w, y + b * half_h), (x + a * (half_w - c * arm), y + b * (half_h - (1 - c) * arm)))
            for a in (-1, 1) for b in (-1, 1) for c in (0, 1)
        ]  # fmt: skip
    if rng.random() < 0.7:
        gap = int(rng.uniform(0.05, 1.0) * min(half_h, half_w))
        lines += [
            ((x + a * gap, y + b * gap), (x + a * (gap + arm), y + b * (gap + arm)))
            for a, b in ((-1, 0), (1, 0), (0, -1), (0, 1))
        ]
    for start, end in lines:
        mark = np.zeros((height, width), np.uint8)
        cv2.line(mark, start, end, 255, thickness)
        yield mark


def _grey_bar(shape: Sequence[int], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return a bar from transparent to opaque at the right edge."""
    height, width = shape
    mark = np.zeros((height, width), np.uint8)
    wide = max(int(width * rng.uniform(0.01, 0.03)), 3)
    right = width - int(width * rng.uniform(0.01, 0.05))
    upper, lower = int(height * rng.uniform(0.1, 0.25)), int(height * rng.uniform(0.7, 0.9))
    mark[upper:lower, right - wide : right] = np.linspace(255, 0, lower - upper)[:, None]
    return mark


def _dead_edge(shape: Sequence[int], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return one to three rows or columns at some edges."""
    height, width = shape
    mark = np.zeros((height, width), np.uint8)
    wide = int(rng.integers(1, 4))
    edges = (mark[:wide], mark[-wide:], mark[:, :wide], mark[:, -wide:])
    for edge, is_dead in zip(edges, rng.random(4) < 0.5, strict=True):
        if is_dead:
            edge[:] = 255
    return mark
