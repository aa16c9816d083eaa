"""Writes radiometric JPEG files as DJI and FLIR cameras do: EXIF, XMP and a raw layer around a picture.

The virtual world writes its made-up flights with it, so that users can try a flight without a drone, and the tests run
on the same files.
"""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Literal
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from infrablend.formats.cameras import flir_block, xmp
from infrablend.formats.cameras.header_facts import DJI, FLIR, PIX4D, fov_of_35mm
from infrablend.formats.cameras.jpeg_segments import APP1, APP3
from infrablend.thermal.radiometry import ObjectSettings, Planck

Maker = Literal["dji", "flir"]
MAKERS: tuple[Maker, ...] = ("dji", "flir")

_MOST_SEGMENT_BYTES = 65_533
_FFF_CHUNK_BYTES = 65_000
_RDF_HEAD = '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about=""'

PLANCK = Planck(17_096.453, 1428.0, 1.0, -267.0, 0.046582058)
"""Constants of a real camera, for made-up FLIR files."""
# Constants of the air's transmission by their place in the camera record: those of every known camera.
_AIR = {0x70: 0.006569, 0x74: 0.01262, 0x78: -0.002276, 0x7C: -0.00667, 0x80: 1.9}


@dataclass(frozen=True)
class Shot:
    """How a made-up picture was taken; None leaves a fact out of the file.

    Attributes:
        pitch_deg: Camera pitch, degrees below the horizon.
        altitude_m: Height above take-off.
        captured: Local time of capture.
        focal_length_35mm: Focal length of a 35 mm camera with the same diagonal field of view.
        place: Latitude and longitude, degrees.
        laser_m: Distance that the laser range finder measured.
        roll_deg: Roll of the gimbal.
        yaw_deg: Yaw of the gimbal, clockwise from north.
        utc: Time of capture in UTC.
        settings: What the camera was told about the scene; FLIR's files hold it.
    """

    pitch_deg: float | None = 60.0
    altitude_m: float | None = 50.0
    captured: datetime | None = datetime(2026, 1, 12, 6, 30)
    focal_length_35mm: float | None = 40.0
    place: tuple[float, float] | None = (46.2, 15.1)
    laser_m: float | None = None
    roll_deg: float = 0.0
    yaw_deg: float = 0.0
    utc: datetime | None = None
    settings: ObjectSettings = field(default_factory=ObjectSettings)


def radiometric_jpeg(
    maker: Maker, grey: NDArray[np.uint8], counts: NDArray[np.uint16] | None, shot: Shot, *, elements: bool = False
) -> bytes:
    """Return the bytes of a radiometric JPEG file.

    Args:
        maker: Whose layout to follow.
        grey: (h, w) picture.
        counts: (h, w) raw counts; None for a file without a raw layer.
        shot: How the picture was taken.
        elements: Write XMP properties as elements instead of attributes.
    """
    buffer = io.BytesIO()
    Image.fromarray(grey).save(buffer, "JPEG", quality=95)
    jpeg = buffer.getvalue()
    w, h = grey.shape[1], grey.shape[0]
    segments = [(APP1, _exif(maker, shot)), (APP1, xmp.STANDARD + _xmp(maker, shot, elements))]
    if counts is not None and maker == "dji":
        data = counts.astype("<u2").tobytes()
        segments += [(APP3, data[k : k + _MOST_SEGMENT_BYTES]) for k in range(0, len(data), _MOST_SEGMENT_BYTES)]
    elif counts is not None:
        block = _fff(counts, shot, (w, h))
        chunks = [block[k : k + _FFF_CHUNK_BYTES] for k in range(0, len(block), _FFF_CHUNK_BYTES)]
        segments += [(APP1, flir_block.SIGNATURE + bytes((1, k, len(chunks) - 1)) + c) for k, c in enumerate(chunks)]
    return jpeg[:2] + b"".join(segment_bytes(marker, data) for marker, data in segments) + jpeg[2:]


def segment_bytes(marker: int, data: bytes) -> bytes:
    """Return a JPEG segment with its marker and length."""
    return bytes((0xFF, marker)) + (len(data) + 2).to_bytes(2, "big") + data


def _exif(maker: Maker, shot: Shot) -> bytes:
    exif = Image.Exif()
    exif[0x010F], exif[0x0110] = ("DJI", "WORLD-T") if maker == "dji" else ("FLIR Systems AB", "FLIR Vue Pro R")
    detail = exif.get_ifd(0x8769)
    if shot.captured is not None:
        detail[0x9003] = shot.captured.strftime("%Y:%m:%d %H:%M:%S")
    if shot.focal_length_35mm is not None and maker == "dji":
        detail[0xA405] = round(shot.focal_length_35mm)
    if shot.place is not None:
        gps = exif.get_ifd(0x8825)
        for at, (value, letters) in zip((1, 3), zip(shot.place, ("NS", "EW"), strict=True), strict=True):
            gps[at] = letters[value < 0]
            gps[at + 1] = (float(int(abs(value))), abs(value) % 1 * 60, 0.0)
    return bytes(exif.tobytes())


def _xmp(maker: Maker, shot: Shot, elements: bool) -> bytes:
    values: dict[str, str] = {}
    gimbal = None if shot.pitch_deg is None else f"{-shot.pitch_deg:.6f}"
    if maker == "dji":
        spaces = {"drone-dji": DJI}
        named = {
            "GimbalPitchDegree": gimbal,
            "GimbalRollDegree": f"{shot.roll_deg:+.2f}",
            "GimbalYawDegree": f"{shot.yaw_deg:+.2f}",
            "RelativeAltitude": None if shot.altitude_m is None else f"{shot.altitude_m:+.6f}",
            "LRFStatus": None if shot.laser_m is None else "Normal",
            "LRFTargetDistance": None if shot.laser_m is None else f"{shot.laser_m:.3f}",
            "UTCAtExposure": None if shot.utc is None else shot.utc.strftime("%Y:%m:%d %H:%M:%S"),
            "ImageSource": "InfraredCamera",
        }
        values = {f"drone-dji:{k}": v for k, v in named.items() if v is not None}
    else:
        spaces = {"FLIR": FLIR, "Camera": PIX4D.rstrip("/")}  # as FLIR writes it
        relative = None if shot.altitude_m is None else f"{shot.altitude_m:.3f}"
        roll = f"{shot.roll_deg:.3f}"
        yaw = f"{shot.yaw_deg:.3f}"
        named = {"FLIR:MAVRelativeAltitude": relative, "Camera:Pitch": gimbal, "Camera:Roll": roll, "Camera:Yaw": yaw}
        values = {k: v for k, v in named.items() if v is not None}
    text = _RDF_HEAD + "".join(f" xmlns:{k}={quoteattr(v)}" for k, v in spaces.items())
    if elements:
        text += ">" + "".join(f"<{k}>{v}</{k}>" for k, v in values.items()) + "</rdf:Description></rdf:RDF>"
    else:
        text += "".join(f" {k}={quoteattr(v)}" for k, v in values.items()) + "/></rdf:RDF>"
    return f'<?xpacket begin=""?><x:xmpmeta xmlns:x="adobe:ns:meta/">{text}</x:xmpmeta><?xpacket end="w"?>'.encode()


def _fff(counts: NDArray[np.uint16], shot: Shot, size_wh: tuple[int, int]) -> bytes:
    """Return an FFF block with raw counts and a camera record."""
    h, w = counts.shape
    raw = struct.pack("<HHH", 2, w, h).ljust(0x20, b"\0") + counts.astype("<u2").tobytes()
    records = [(0x01, raw), (0x20, _camera_record(shot, size_wh))]
    offset = 0x40 + 0x20 * len(records)
    entries = b""
    for kind, data in records:
        entries += struct.pack(">HHIIII", kind, 2, 100, 1, offset, len(data)).ljust(0x20, b"\0")
        offset += len(data)
    head = b"FFF\0" + b"made up\0".ljust(16, b"\0") + struct.pack(">III", 100, 0x40, len(records))
    return head.ljust(0x40, b"\0") + entries + b"".join(data for _, data in records)


def _camera_record(shot: Shot, size_wh: tuple[int, int]) -> bytes:
    data = bytearray(0x480)
    struct.pack_into("<HHH", data, 0, 2, *size_wh)
    s = shot.settings
    floats = {
        0x20: s.emissivity, 0x24: s.distance_m, 0x28: s.reflected_k, 0x2C: s.air_k, 0x30: s.window_k,
        0x34: s.window_transmission, 0x3C: s.humidity, 0x58: PLANCK.r1, 0x5C: PLANCK.b, 0x60: PLANCK.f,
        **_AIR, 0x30C: PLANCK.r2,
    }  # fmt: skip
    for at, value in floats.items():
        struct.pack_into("<f", data, at, value)
    struct.pack_into("<i", data, 0x308, int(PLANCK.o))
    if shot.focal_length_35mm is not None:
        struct.pack_into("<f", data, 0x1B4, fov_of_35mm(shot.focal_length_35mm, size_wh))
    if shot.captured is not None:
        struct.pack_into("<IIh", data, 0x384, int(shot.captured.replace(tzinfo=UTC).timestamp()), 0, 0)
    return bytes(data)
