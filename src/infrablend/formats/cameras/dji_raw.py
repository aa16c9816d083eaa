"""DJI's raw layer: 16-bit counts in segments APP3, or APP4 in files of the XT S.

The conversion of these counts to temperatures is DJI's secret. They rise with temperature, and that is all that is
known: a scale has to come from the user.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from infrablend.formats.cameras.jpeg_segments import APP1, APP3, APP4, JpegHeader, Segment, bad_file

# DJI's cameras store two bytes per pixel; other programs put at most a few hundred bytes into these segments.
_LEAST_BYTES = 32_768
_SIZES_WH = ((640, 512), (1280, 1024), (640, 480), (336, 256), (320, 256), (160, 120), (640, 360), (384, 288))


def raw_segments(header: JpegHeader) -> tuple[Segment, ...]:
    """Return the segments of the raw layer; none in files without one."""
    if header.find(APP1, b"FLIR\0"):
        return ()
    found = [header.find(marker) for marker in (APP3, APP4)]
    longest = max(found, key=lambda segments: sum(s.length for s in segments))
    return longest if sum(s.length for s in longest) >= _LEAST_BYTES else ()


def counts(header: JpegHeader) -> NDArray[np.uint16]:
    """Return the (h, w) raw counts.

    Raises:
        DatasetError: With one problem: `raw-missing`, or `raw-truncated` if the length is that of no known sensor.
    """
    segments = raw_segments(header)
    if not segments:
        raise bad_file(header.path, "raw-missing", "no raw layer", "16-bit counts in segments APP3 or APP4")
    data = header.read(segments)
    size_wh = _size(len(data) // 2, header.size_wh)
    if size_wh is None or len(data) % 2:
        found = f"a raw layer of {len(data)} bytes, which is no picture of the shape of {header.size_wh}"
        raise bad_file(header.path, "raw-truncated", found, "two bytes per pixel of the sensor")
    width, height = size_wh
    return np.frombuffer(data, "<u2").reshape(height, width).astype(np.uint16)


def _size(pixels: int, picture_wh: tuple[int, int]) -> tuple[int, int] | None:
    """Return the size of a raw layer: a known sensor's, or that of the picture divided by a whole number."""
    whole = math.isqrt(picture_wh[0] * picture_wh[1] // pixels) if pixels else 0
    scaled = [(picture_wh[0] // whole, picture_wh[1] // whole)] if whole else []
    return next((wh for wh in (*scaled, *_SIZES_WH) if wh[0] * wh[1] == pixels), None)
