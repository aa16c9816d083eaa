"""Pictures for the pages: thumbnails, made once and cached, and frames with their labels drawn."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import Instance
from infrablend.core.file_names import is_inside
from infrablend.core.files import LinkOutError, read_regular, write_bytes
from infrablend.core.run_folder import RunFolder
from infrablend.core.user_folders import cache_folder
from infrablend.errors import DatasetError, OutputError
from infrablend.report.preview import INSERTED, decode_picture, draw_labels, to_rgb
from infrablend.studio.frame_index import FrameRow
from infrablend.studio.run_labels import RunLabel

THUMBNAIL_PX = 208
"""Width of thumbnails, twice that of the smallest cell."""
_VERSION = "1"
_MARGIN_PX = 4
_DASH_PX = 3
ORIGINAL_COLOUR = (130, 220, 150)

Rgb = NDArray[np.uint8]


class Thumbnails:
    """Small pictures of a run's frames, cached in the user's cache folder by the digest of the frame's image."""

    def __init__(self, layout: RunFolder) -> None:
        """Use a cache folder of the run's own."""
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
        try:
            return read_regular(path)
        except (OSError, ValueError):
            data = _thumbnail(read_pixels(self._layout, row), row)
        with contextlib.suppress(OutputError):  # a full or read-only cache costs time only
            write_bytes(path, data)
        return data


def read_pixels(layout: RunFolder, row: FrameRow) -> NDArray[Any]:
    """Return the grey levels of a frame of a run.

    Raises:
        DatasetError: The image is missing, damaged, or not in the folder of the run.
    """
    path = layout.image(row.image) if row.image else layout.root
    if row.image and not is_inside(path, layout.root):
        raise DatasetError(f"{path}: a link out of the run's folder; not shown")
    return decode(path, "a frame of the run. Run `generate --resume`", layout.root)


def decode(path: Path, what: str, folder: Path | None = None) -> NDArray[Any]:
    """Return the pixels of a picture file; (h, w), or (h, w, 3) in the order red, green, blue.

    Raises:
        DatasetError: It is missing or damaged.
    """
    try:
        pixels = decode_picture(path, folder)
    except LinkOutError:
        pixels = None
    if pixels is None:
        raise DatasetError(f"{path}: not a readable picture; expected {what}")
    return pixels


def _thumbnail(pixels: NDArray[Any], row: FrameRow) -> bytes:
    rgb = to_rgb(pixels)
    h, w = rgb.shape[:2]
    size = (THUMBNAIL_PX, max(1, round(h * THUMBNAIL_PX / w)))
    small = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    for box in row.boxes:
        x0, y0, x1, y1 = (round(v * THUMBNAIL_PX / w) for v in box)
        cv2.rectangle(small, (x0 - 2, y0 - 2), (x1 + 2, y1 + 2), INSERTED["boxes"], 1)
    return to_jpeg(small)


def to_jpeg(rgb: Rgb, quality: int = 82) -> bytes:
    """Return a picture as a JPEG."""
    return bytes(cv2.imencode(".jpg", rgb[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1])


def to_png(rgb: Rgb) -> bytes:
    """Return a picture as a PNG, encoded quickly."""
    return bytes(cv2.imencode(".png", rgb[:, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 1])[1])


def frame_picture(layout: RunFolder, row: FrameRow, *, boxes: bool, originals: Sequence[RunLabel] = ()) -> bytes:
    """Return the PNG of a frame, with the boxes and masks of its inserts if `boxes` is set.

    Args:
        layout: Paths of the run.
        row: The frame.
        boxes: Whether to draw the labels of its inserts.
        originals: Original labels to draw, with dashed lines.

    Raises:
        DatasetError: The image or the record cannot be read.
    """
    rgb = with_originals(to_rgb(read_pixels(layout, row)), originals)
    return to_png(draw_labels(rgb, inserted_labels(layout, row)) if boxes else rgb)


def with_originals(rgb: Rgb, originals: Sequence[RunLabel]) -> Rgb:
    """Return a picture with dashed boxes of original objects."""
    if not originals:
        return rgb
    canvas = rgb.copy()
    h, w = canvas.shape[:2]
    for label in originals:
        left, top, right, bottom = label.box_xyxy
        x0, x1 = (int(np.clip(v, 0, w - 1)) for v in (left, np.ceil(right) - 1))
        y0, y1 = (int(np.clip(v, 0, h - 1)) for v in (top, np.ceil(bottom) - 1))
        for ax, ay, bx, by in ((x0, y0, x1, y0), (x1, y0, x1, y1), (x0, y1, x1, y1), (x0, y0, x0, y1)):
            across = np.linspace(ax, bx, max(abs(bx - ax), abs(by - ay)) + 1).round().astype(int)
            down = np.linspace(ay, by, len(across)).round().astype(int)
            dash = np.arange(len(across)) % (2 * _DASH_PX) < _DASH_PX
            canvas[down[dash], across[dash]] = ORIGINAL_COLOUR
    return canvas


def inserted_labels(layout: RunFolder, row: FrameRow) -> tuple[Instance, ...]:
    """Return the labels of a frame's inserts.

    Raises:
        OutputError: The run has no such frame.
    """
    return layout.record(row.id).inserted


def crop_picture(layout: RunFolder, row: FrameRow, number: int, *, zoom: int = 4) -> bytes:
    """Return the PNG of an insert, enlarged without smoothing.

    Raises:
        DatasetError: The image cannot be read, or the frame has no such insert.
    """
    if not 0 <= number < len(row.boxes):
        raise DatasetError(f"{row.id}: no insert {number}; the frame has {len(row.boxes)}")
    return to_png(enlarged(to_rgb(read_pixels(layout, row)), row.boxes[number], zoom))


def enlarged(rgb: Rgb, box_xyxy: Sequence[float], zoom: int, *, margin_px: float = _MARGIN_PX) -> Rgb:
    """Return the part of a picture around a box, each pixel as `zoom` x `zoom` pixels."""
    h, w = rgb.shape[:2]
    margin = margin_px + 0.35 * max(box_xyxy[2] - box_xyxy[0], box_xyxy[3] - box_xyxy[1])
    x0, y0 = (int(max(0, v - margin)) for v in box_xyxy[:2])
    x1, y1 = (int(min(end, v + margin + 1)) for v, end in zip(box_xyxy[2:], (w, h), strict=True))
    part = rgb[y0 : max(y1, y0 + 1), x0 : max(x1, x0 + 1)]
    return np.ascontiguousarray(np.repeat(np.repeat(part, zoom, 0), zoom, 1))
