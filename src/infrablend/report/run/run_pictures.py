"""Pictures inside the report: a small one per frame, and enlarged crops of inserted objects.

Boxes are drawn over them by the page, so that they never hide pixels for good.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.file_names import leaves_folder
from infrablend.core.frame_row import Box
from infrablend.errors import DatasetError
from infrablend.formats.pictures.images import load_background
from infrablend.report.preview import to_8_bit

THUMBNAIL_PX = 200
CROP_PX = 240
_MIN_WINDOW_PX = 48
_THUMBNAIL_QUALITY = 70
_CROP_QUALITY = 88


@dataclass(frozen=True)
class Crop:
    """A part of a frame around an object.

    Attributes:
        uri: Picture as a data URI.
        view: Left, top, width and height in the frame, pixels.
        zoom: Factor by which the page enlarges it.
    """

    uri: str
    view: tuple[int, int, int, int]
    zoom: float


def read_levels(path: Path) -> NDArray[np.uint8] | None:
    """Return the (h, w) 8-bit levels of a frame, 16-bit ones stretched; None if it cannot be read."""
    if leaves_folder(path):
        return None
    try:
        pixels: NDArray[Any] = load_background(path).pixels
    except DatasetError:
        return None
    return to_8_bit(pixels)


def thumbnail(pixels: NDArray[np.uint8]) -> str:
    """Return a small JPEG of a frame as a data URI."""
    return _jpeg(_at_most(pixels, THUMBNAIL_PX), _THUMBNAIL_QUALITY)


def crop(pixels: NDArray[np.uint8], box: Box) -> Crop:
    """Return the part of a frame around a box."""
    height, width = pixels.shape
    left, top, wide, high = _window(box, (width, height))
    part = pixels[top : top + high, left : left + wide]
    small = max(wide, high) <= CROP_PX // 2
    uri = _uri(".png", part, (), "png") if small else _jpeg(_at_most(part, CROP_PX), _CROP_QUALITY)
    return Crop(uri, (left, top, wide, high), round(CROP_PX / wide, 1))


def _window(box: Box, frame_wh: Sequence[int]) -> tuple[int, int, int, int]:
    """Return left, top, width and height of a window of 4:3 around a box, inside the frame."""
    x0, y0, x1, y1 = box
    wide = max(_MIN_WINDOW_PX, 1.5 * (x1 - x0), 1.5 * 4 / 3 * (y1 - y0))
    w, h = min(frame_wh[0], round(wide)), min(frame_wh[1], round(wide * 3 / 4))
    left = min(max(0, round((x0 + x1 - w) / 2)), frame_wh[0] - w)
    top = min(max(0, round((y0 + y1 - h) / 2)), frame_wh[1] - h)
    return left, top, w, h


def _at_most(pixels: NDArray[np.uint8], side_px: int) -> NDArray[np.uint8]:
    height, width = pixels.shape
    factor = side_px / max(width, height)
    if factor >= 1:
        return pixels
    size = (max(1, round(width * factor)), max(1, round(height * factor)))
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)


def _jpeg(pixels: NDArray[np.uint8], quality: int) -> str:
    return _uri(".jpg", pixels, (cv2.IMWRITE_JPEG_QUALITY, quality), "jpeg")


def _uri(suffix: str, pixels: NDArray[np.uint8], options: Sequence[int], kind: str) -> str:
    done, data = cv2.imencode(suffix, np.ascontiguousarray(pixels), list(options))
    assert done
    return f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode('ascii')}"
