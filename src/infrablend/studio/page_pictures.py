"""Pictures for the pages: thumbnails, made once and cached, and frames with their labels drawn."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.files import cache_folder, read_regular, write_bytes
from infrablend.core.frame_row import FrameRow
from infrablend.core.run_folder import RunFolder
from infrablend.errors import OutputError
from infrablend.imaging.surfaces import SurfaceMap
from infrablend.report.preview import INSERTED, Rgb, decode_picture, to_rgb
from infrablend.report.surface_sheet import coloured

THUMBNAIL_PX = 208
"""Width of thumbnails, twice that of the smallest cell."""
_VERSION = "1"
_JPEG_QUALITY = 82
_MARGIN_PX = 4
_DASH_PX = 3
_COLOUR, _DARK = 0.5, 0.25  # opacity of the surfaces' colours; brightness where objects do not stand
ORIGINAL_COLOUR = (130, 220, 150)


class Thumbnails:
    """Small pictures of a run's frames, cached in the user's cache folder by the digest of the frame's image."""

    def __init__(self, layout: RunFolder) -> None:
        self._layout = layout
        place = hashlib.sha256(os.fsencode(os.path.realpath(layout.root))).hexdigest()[:24]
        self.folder = cache_folder() / "studio" / place

    def get(self, row: FrameRow) -> bytes:
        """Return the JPEG of a frame.

        Raises:
            DatasetError: The frame's image cannot be read.
        """
        marks = hashlib.sha256(repr((_VERSION, row.digest, row.boxes)).encode()).hexdigest()[:32]
        path = self.folder / marks[:2] / f"{marks}.jpg"
        return _cached(path, lambda: _jpeg(to_rgb(read_pixels(self._layout, row)), row.boxes))


def cached_thumbnail(path: Path, read: Callable[[], NDArray[Any]]) -> bytes:
    """Return a small JPEG of a picture, cached in the user's cache folder as long as its file does not change.

    Raises:
        DatasetError: `read` cannot read it.
    """
    try:
        state = path.stat()
    except OSError:  # `read` says what is wrong
        return _jpeg(to_rgb(read()), ())
    return cached_picture("backgrounds", f"{path} {state.st_mtime_ns} {state.st_size}", read)


def cached_picture(folder: str, marks: str, read: Callable[[], NDArray[Any]]) -> bytes:
    """Return a small JPEG of what `read` returns, from a folder of the user's cache folder under its marks."""
    name = hashlib.sha256(f"{_VERSION} {marks}".encode(errors="surrogateescape")).hexdigest()[:32]
    return _cached(cache_folder() / "studio" / folder / f"{name}.jpg", lambda: _jpeg(to_rgb(read()), ()))


def _cached(path: Path, make: Callable[[], bytes]) -> bytes:
    try:
        return read_regular(path)
    except (OSError, ValueError):
        data = make()
    with contextlib.suppress(OutputError):  # a full or read-only cache costs time only
        write_bytes(path, data)
    return data


def read_pixels(layout: RunFolder, row: FrameRow) -> NDArray[Any]:
    """Return the grey levels of a frame of a run.

    Raises:
        DatasetError: The image is missing, damaged, or not in the folder of the run.
    """
    return decode_picture(layout.image(row.image), "a frame of the run. Run `generate --resume`", layout.root)


def _jpeg(rgb: Rgb, boxes_xyxy: Iterable[Sequence[float]]) -> bytes:
    h, w = rgb.shape[:2]
    size = (THUMBNAIL_PX, max(1, round(h * THUMBNAIL_PX / w)))
    small = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    for box in boxes_xyxy:
        x0, y0, x1, y1 = (round(v * THUMBNAIL_PX / w) for v in box)
        cv2.rectangle(small, (x0 - 2, y0 - 2), (x1 + 2, y1 + 2), INSERTED["boxes"], 1)
    return bytes(cv2.imencode(".jpg", small[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1])


def to_png(picture: NDArray[np.uint8]) -> bytes:
    """Return a picture, (h, w) or (h, w, 3), as a PNG, encoded quickly."""
    bgr = picture if picture.ndim == 2 else picture[:, :, ::-1]
    return bytes(cv2.imencode(".png", bgr, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1])


def with_originals(rgb: Rgb, boxes_xyxy: Iterable[Sequence[float]]) -> Rgb:
    """Return a picture with dashed boxes of original objects."""
    canvas = rgb.copy()
    h, w = canvas.shape[:2]
    for left, top, right, bottom in boxes_xyxy:
        x0, x1 = (int(np.clip(v, 0, w - 1)) for v in (left, np.ceil(right) - 1))
        y0, y1 = (int(np.clip(v, 0, h - 1)) for v in (top, np.ceil(bottom) - 1))
        for ax, ay, bx, by in ((x0, y0, x1, y0), (x1, y0, x1, y1), (x0, y1, x1, y1), (x0, y0, x0, y1)):
            across = np.linspace(ax, bx, max(abs(bx - ax), abs(by - ay)) + 1).round().astype(int)
            down = np.linspace(ay, by, len(across)).round().astype(int)
            dash = np.arange(len(across)) % (2 * _DASH_PX) < _DASH_PX
            canvas[down[dash], across[dash]] = ORIGINAL_COLOUR
    return canvas


def with_surfaces(rgb: Rgb, surfaces: SurfaceMap) -> Rgb:
    """Return a picture with its surfaces in colour over it."""
    return np.asarray(cv2.addWeighted(coloured(surfaces.kinds()), _COLOUR, rgb, 1 - _COLOUR, 0), np.uint8)


def darkened(rgb: Rgb, suits: NDArray[np.float32]) -> Rgb:
    """Return a picture that is the darker the less its (h', w') cells suit, in [0, 1]."""
    h, w = rgb.shape[:2]
    light = _DARK + (1 - _DARK) * cv2.resize(suits, (w, h), interpolation=cv2.INTER_LINEAR)
    return np.asarray(np.rint(rgb * light[:, :, None]), np.uint8)


def enlarged(rgb: Rgb, box_xyxy: Sequence[float], zoom: int) -> Rgb:
    """Return the part of a picture around a box, each pixel as `zoom` x `zoom` pixels."""
    h, w = rgb.shape[:2]
    margin = _MARGIN_PX + 0.35 * max(box_xyxy[2] - box_xyxy[0], box_xyxy[3] - box_xyxy[1])
    x0, y0 = (int(max(0, v - margin)) for v in box_xyxy[:2])
    x1, y1 = (int(min(end, v + margin + 1)) for v, end in zip(box_xyxy[2:], (w, h), strict=True))
    part = rgb[y0 : max(y1, y0 + 1), x0 : max(x1, x0 + 1)]
    return np.ascontiguousarray(np.repeat(np.repeat(part, zoom, 0), zoom, 1))
