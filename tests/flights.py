"""Made-up flights: radiometric JPEG files of both makers, with whatever each test needs changed."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from infrablend.formats.cameras.jpeg_segments import APP1, read_header
from infrablend.formats.cameras.xmp import STANDARD
from infrablend.lab.world.rjpeg_writing import Maker, Shot, radiometric_jpeg, segment_bytes

SIZE_WH = (160, 128)
_EXIF = b"Exif\0\0"
START = datetime(2026, 1, 12, 6, 30)


def grey(number: int) -> Any:
    """Return a made-up picture."""
    w, h = SIZE_WH
    y, x = np.mgrid[:h, :w]
    return (90 + 60 * np.sin(x / 17 + number) * np.cos(y / 23)).astype(np.uint8)


def counts(number: int) -> Any:
    """Return made-up raw counts, which rise with the grey levels."""
    return (15_000 + 4 * grey(number).astype(np.uint16)).astype(np.uint16)


def shot(path: Path, maker: Maker = "dji", number: int = 0, **changes: Any) -> Path:
    """Write a made-up picture; `changes` are fields of `Shot`, `raw=False` leaves the raw layer out."""
    raw, elements = changes.pop("raw", True), changes.pop("elements", False)
    one = replace(Shot(captured=START + timedelta(seconds=10 * number)), **changes)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(radiometric_jpeg(maker, grey(number), counts(number) if raw else None, one, elements=elements))
    return path


def flight(folder: Path, count: int = 4, maker: Maker = "dji", **changes: Any) -> Path:
    """Write a made-up flight as it comes off the card."""
    for k in range(count):
        shot(folder / f"DJI_{k + 1:04}_T.JPG", maker, k, **changes)
    return folder


def plain_jpeg(path: Path, size_wh: tuple[int, int] = SIZE_WH, exif: dict[int, Any] | None = None) -> Path:
    """Write a JPEG file of no thermal camera; `exif` has the main tags."""
    tags = Image.Exif()
    for tag, value in (exif or {}).items():
        tags[tag] = value
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", size_wh, (40, 90, 30)).save(path, "JPEG", exif=tags)
    return path


def with_exif_size(path: Path, size_wh: tuple[int, int]) -> Path:
    """Write a picture size into the EXIF fields of a JPEG file, as if a program had cropped or scaled it since."""
    return with_exif(path, detail={0xA002: size_wh[0], 0xA003: size_wh[1]})


def with_exif(
    path: Path,
    main: dict[int, Any] | None = None,
    detail: dict[int, Any] | None = None,
    gps: dict[int, Any] | None = None,
) -> Path:
    """Write further EXIF tags into a JPEG file."""
    header = read_header(path)
    old = header.read(header.find(APP1, _EXIF))
    assert old.startswith(_EXIF)
    tags = Image.Exif()
    tags.load(old)
    for tag, value in (main or {}).items():
        tags[tag] = value
    tags.get_ifd(0x8769).update(detail or {})
    if gps:
        tags.get_ifd(0x8825).update(gps)
    new = _EXIF + tags.tobytes().removeprefix(_EXIF)
    data = path.read_bytes()
    assert data.count(segment_bytes(APP1, old)) == 1
    path.write_bytes(data.replace(segment_bytes(APP1, old), segment_bytes(APP1, new)))
    return path


def with_xmp(path: Path, text: bytes) -> Path:
    """Put another standard XMP packet into a JPEG file, before all other segments."""
    data = path.read_bytes()
    path.write_bytes(data[:2] + segment_bytes(APP1, STANDARD + text) + data[2:])
    return path
