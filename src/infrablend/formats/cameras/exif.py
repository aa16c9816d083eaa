"""Reads the few EXIF fields that say how a picture was taken; Pillow parses the directories."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from PIL import Image

from infrablend.errors import Problem
from infrablend.formats.cameras.jpeg_segments import APP1, JpegHeader
from infrablend.formats.values import to_number

_SIGNATURE = b"Exif\0\0"
_EXIF_IFD = 0x8769
_GPS_IFD = 0x8825
_MAKE = 0x010F
_MODEL = 0x0110
_MODIFY_DATE = 0x0132
_ORIGINAL_DATE = 0x9003
_CREATE_DATE = 0x9004
_FOCAL_LENGTH = 0x920A
_FOCAL_LENGTH_35MM = 0xA405
_ZOOM = 0xA404
_WIDTH, _HEIGHT = 0xA002, 0xA003
_ORIENTATION = 0x0112
_OFFSET = 0x9011
_PLANE_X = 0xA20E
_PLANE_UNIT = 0xA210
_UNITS_UM = {2: 25_400.0, 3: 10_000.0, 4: 1_000.0, 5: 1.0}
_GPS_TIME = 7
_GPS_DATE = 29


@dataclass(frozen=True)
class Exif:
    """EXIF fields of one file; None where absent.

    Attributes:
        make: Maker of the camera.
        model: Model of the camera.
        dates: Dates as written, by the name of their tag, the most exact first.
        focal_length_mm: Focal length of the lens.
        focal_length_35mm: Focal length of a 35 mm camera with the same diagonal field of view.
        zoom: Digital zoom.
        latitude_deg: Latitude, north positive.
        longitude_deg: Longitude, east positive.
        size_wh: Width and height of the picture in pixels as the camera wrote it.
        problems: Faults, as warnings.
        turned: Whether the picture is to be turned or mirrored to be shown.
        pixel_pitch_um: Distance between the pixels of a picture of this width on the detector, micrometres.
        offset: Time zone of the most exact date as written, such as `+02:00`.
        gps_time: Date and time in UTC by the satellites, as `2024:05:14 19:00:00`.
    """

    make: str = ""
    model: str = ""
    dates: Mapping[str, str] = field(default_factory=dict)
    focal_length_mm: float | None = None
    focal_length_35mm: float | None = None
    zoom: float | None = None
    latitude_deg: float | None = None
    longitude_deg: float | None = None
    size_wh: tuple[float, float] | None = None
    problems: tuple[Problem, ...] = ()
    turned: bool = False
    pixel_pitch_um: float | None = None
    offset: str = ""
    gps_time: str = ""


def read_exif(header: JpegHeader) -> Exif:
    """Return the EXIF fields of a file."""
    segments = header.find(APP1, _SIGNATURE)[:1]
    if not segments:
        return Exif()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            exif = Image.Exif()
            exif.load(header.read(segments))
            main = dict(exif)
            detail = exif.get_ifd(_EXIF_IFD)
            gps = exif.get_ifd(_GPS_IFD)
    except Exception as error:  # Pillow raises what it likes on broken directories
        found = f"EXIF that cannot be read ({type(error).__name__}), left out"
        problem = Problem(header.path.name, "exif-unreadable", found, "EXIF as cameras write it", severity="warning")
        return Exif(problems=(problem,))
    dates = {
        "EXIF DateTimeOriginal": _text(detail.get(_ORIGINAL_DATE)),
        "EXIF CreateDate": _text(detail.get(_CREATE_DATE)),
        "EXIF ModifyDate": _text(main.get(_MODIFY_DATE)),
    }
    width = _positive(detail.get(_WIDTH))
    height = _positive(detail.get(_HEIGHT))
    per_unit = _positive(detail.get(_PLANE_X))
    return Exif(
        _text(main.get(_MAKE)),
        _text(main.get(_MODEL)),
        {k: v for k, v in dates.items() if v},
        _positive(detail.get(_FOCAL_LENGTH)),
        _positive(detail.get(_FOCAL_LENGTH_35MM)),
        _positive(detail.get(_ZOOM)),
        _degrees(gps.get(2), gps.get(1), "NS", 90.0),
        _degrees(gps.get(4), gps.get(3), "EW", 180.0),
        None if width is None or height is None else (width, height),
        turned=main.get(_ORIENTATION, 1) != 1,
        pixel_pitch_um=_UNITS_UM.get(detail.get(_PLANE_UNIT, 2), 0.0) / per_unit if per_unit else None,
        offset=_text(detail.get(_OFFSET)),
        gps_time=_gps_time(gps),
    )


def _gps_time(gps: Mapping[int, Any]) -> str:
    clock = gps.get(_GPS_TIME)
    parts = [to_number(v) for v in clock] if isinstance(clock, tuple) else []
    whole = [int(p) for p in parts if p is not None and 0 <= p < 100]
    return f"{_text(gps.get(_GPS_DATE))} {':'.join(f'{p:02}' for p in whole)}" if len(whole) == 3 else ""


def _text(value: Any) -> str:
    if isinstance(value, bytes):
        value = value.decode("ascii", "replace")
    return value.replace("\0", " ").strip()[:200] if isinstance(value, str) else ""


def _positive(value: Any) -> float | None:
    found = to_number(value)
    return found if found is not None and found > 0 else None


def _degrees(value: Any, reference: Any, directions: str, largest: float) -> float | None:
    if not isinstance(value, tuple) or len(value) != 3:
        return None
    parts = [to_number(v) for v in value]
    if any(p is None or p < 0 for p in parts):
        return None
    degrees = math.fsum(p / 60**k for k, p in enumerate(parts) if p is not None)
    direction = _text(reference).upper()
    if degrees > largest or not any(parts) or direction not in tuple(directions):
        return None
    return -degrees if direction == directions[1] else degrees
