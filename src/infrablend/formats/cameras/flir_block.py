"""FLIR's FFF block in segments APP1 of a radiometric JPEG: camera facts, constants of the conversion and raw counts.

The layout follows the published tables of ExifTool. The block's directory and its records may have different byte
orders; each record states its own by a number that is 2 in the right one.
"""

from __future__ import annotations

import io
import math
import struct
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields
from datetime import UTC, datetime, timedelta, timezone

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from infrablend.errors import DatasetError
from infrablend.formats.cameras.jpeg_segments import APP1, JpegHeader, Segment, bad_file
from infrablend.thermal.radiometry import ObjectSettings, Planck

SIGNATURE = b"FLIR\0"
# Contents of a FLIR segment: signature, a fixed byte, number of the segment, number of the last one, FFF bytes.
_HEAD_BYTES = 8
_FILE_HEADER_BYTES = 0x40
_ENTRY_BYTES = 0x20
MAX_RECORDS = 512
# The largest microbolometers have 1.3 million pixels, and 3.1 million after FLIR's own enlargement.
MAX_LAYER_PIXELS = 4 * 1024 * 1024
_RAW_DATA = 0x01
_CAMERA_INFO = 0x20
_RAW_HEADER_BYTES = 0x20
# The camera record of every known model is longer; shorter ones lack the last constants.
_CAMERA_INFO_BYTES = 0x310
_FLOATS = {
    "emissivity": 0x20, "distance_m": 0x24, "reflected_k": 0x28, "air_k": 0x2C, "window_k": 0x30,
    "window_transmission": 0x34, "humidity": 0x3C, "r1": 0x58, "b": 0x5C, "f": 0x60, "r2": 0x30C,
}  # fmt: skip
# Settings and what they can be; records that were never filled in contain zeros or NaN.
_SETTINGS = {
    "emissivity": (0.01, 1.0), "distance_m": (0.0, 1e5), "reflected_k": (100.0, 2000.0), "air_k": (100.0, 2000.0),
    "humidity": (0.0, 1.0), "window_k": (100.0, 2000.0), "window_transmission": (0.01, 1.0),
}  # fmt: skip
_FIELD_OF_VIEW = 0x1B4
_MODEL = 0xD4
_OFFSET = 0x308
_DATE = 0x384


@dataclass(frozen=True)
class CameraRecord:
    """Facts in the camera record of an FFF block; None where the camera left them empty.

    Attributes:
        model: Model of the camera.
        hfov_deg: Field of view across the width of the raw picture, degrees.
        captured: Local date and time, ISO 8601, and `+HH:MM`.
        planck: Constants of the conversion.
        settings: Emissivity, distance and temperatures that the camera was set to.
        stated: Names of the settings that the record contains; the others have their usual values.
    """

    model: str
    hfov_deg: float | None
    captured: str | None
    planck: Planck | None
    settings: ObjectSettings
    stated: frozenset[str] = frozenset(f.name for f in fields(ObjectSettings))


class FlirBlock:
    """The FFF block of one file, read record by record.

    Raises:
        DatasetError: With one problem: `flir-chunks` (segments are missing), `flir-header`, `flir-records`.
    """

    def __init__(self, header: JpegHeader) -> None:
        """Find the block and read its directory."""
        self._header = header
        self._chunks = _in_order(header)
        self.length = sum(s.length - _HEAD_BYTES for s in self._chunks)
        head = self._read(0, _FILE_HEADER_BYTES, "flir-header")
        if head[:4] not in (b"FFF\0", b"AFF\0"):
            raise self._bad("flir-header", "a FLIR block without its signature FFF")
        order = next((o for o in "><" if 100 <= struct.unpack_from(f"{o}I", head, 0x14)[0] < 200), None)
        if order is None:
            raise self._bad("flir-header", "a FLIR block of an unknown version")
        start, count = struct.unpack_from(f"{order}II", head, 0x18)
        if count > MAX_RECORDS:
            raise self._bad("flir-records", f"a FLIR block that says it has {count} records")
        entries = self._read(start, count * _ENTRY_BYTES, "flir-records")
        self._records: dict[int, tuple[int, int]] = {}
        for k in range(count):
            kind, _, _, _, offset, length = struct.unpack_from(f"{order}HHIIII", entries, k * _ENTRY_BYTES)
            if kind and offset + length <= self.length:
                self._records.setdefault(kind, (offset, length))

    def camera(self) -> CameraRecord | None:
        """Return the camera record; None without one."""
        data = self._record(_CAMERA_INFO)
        if data is None or len(data) < _CAMERA_INFO_BYTES:
            return None
        order = _byte_order(data)
        values = {name: struct.unpack_from(f"{order}f", data, at)[0] for name, at in _FLOATS.items()}
        values["o"] = float(struct.unpack_from(f"{order}i", data, _OFFSET)[0])
        fov = struct.unpack_from(f"{order}f", data, _FIELD_OF_VIEW)[0]
        date = _date(data, order)
        values["humidity"] /= 100.0 if values["humidity"] > 2 else 1.0
        stated = {n: float(values[n]) for n, (low, high) in _SETTINGS.items() if low <= values[n] <= high}
        return CameraRecord(
            data[_MODEL : _MODEL + 32].split(b"\0")[0].decode("ascii", "replace").strip(" *"),
            float(fov) if math.isfinite(fov) and 0.1 <= fov < 170 else None,
            date,
            _planck(values),
            ObjectSettings(**stated),
            frozenset(stated),
        )

    def counts(self) -> NDArray[np.uint16]:
        """Return the (h, w) raw counts.

        Raises:
            DatasetError: With one problem: `raw-missing`, `raw-truncated`, `raw-unreadable` or `raw-size`.
        """
        data = self._record(_RAW_DATA)
        if data is None:
            raise self._bad("raw-missing", "no raw layer in the FLIR block")
        if len(data) < _RAW_HEADER_BYTES:
            raise self._bad("raw-truncated", f"a raw layer of {len(data)} bytes")
        order = _byte_order(data)
        width, height = struct.unpack_from(f"{order}HH", data, 2)
        if not 0 < width * height <= MAX_LAYER_PIXELS:
            raise self._bad("raw-size", f"a raw layer of {width}x{height} px")
        body = data[_RAW_HEADER_BYTES:]
        if body.startswith(b"\x89PNG"):
            return self._png(body, (width, height))
        if len(body) < 2 * width * height:
            wanted = 2 * width * height
            raise self._bad("raw-truncated", f"{len(body)} bytes of raw counts; {width}x{height} px need {wanted}")
        counts = np.frombuffer(body, f"{order}u2", width * height).reshape(height, width)
        return counts.astype(np.uint16)

    def _png(self, data: bytes, size_wh: tuple[int, int]) -> NDArray[np.uint16]:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", Image.DecompressionBombWarning)
                with Image.open(io.BytesIO(data), formats=("PNG",)) as picture:
                    if picture.size != size_wh:
                        found = f"a PNG of {picture.width}x{picture.height} px; its record states {size_wh}"
                        raise self._bad("raw-size", found)
                    if not picture.mode.startswith("I"):
                        raise self._bad("raw-unreadable", f"a PNG of mode {picture.mode}, not 16 bit")
                    counts = np.asarray(picture).astype(np.uint16)
        except DatasetError:
            raise
        except Exception as error:  # Pillow raises what it likes on broken pictures
            raise self._bad("raw-unreadable", f"a PNG that cannot be decoded ({type(error).__name__})") from error
        # Nearly all cameras write the PNG's two bytes in the wrong order. Neighbouring pixels tell which is right.
        swapped = counts.byteswap()
        return swapped if _roughness(swapped) < _roughness(counts) else counts

    def _record(self, kind: int) -> bytes | None:
        place = self._records.get(kind)
        return None if place is None else self._read(*place, "flir-records")

    def _read(self, start: int, length: int, code: str) -> bytes:
        if start + length > self.length:
            raise self._bad(code, f"a FLIR block of {self.length} bytes that points to byte {start + length}")
        parts = []
        at = 0
        for chunk in self._chunks:
            size = chunk.length - _HEAD_BYTES
            low, high = max(start, at), min(start + length, at + size)
            if low < high:
                part = Segment(chunk.marker, chunk.start + _HEAD_BYTES + low - at, high - low, b"")
                parts.append(self._header.read([part]))
            at += size
        return b"".join(parts)

    def _bad(self, code: str, found: str) -> DatasetError:
        return bad_file(self._header.path, code, found, "the FLIR block as the camera wrote it")


def _in_order(header: JpegHeader) -> list[Segment]:
    """Return the segments of the block in the order of their numbers."""
    found = [s for s in header.find(APP1, SIGNATURE) if s.length >= _HEAD_BYTES]
    if not found:
        raise bad_file(header.path, "flir-chunks", "no FLIR segment", "a FLIR block")
    by_number = {s.prefix[6]: s for s in found}
    last = found[0].prefix[7]
    if sorted(by_number) != list(range(last + 1)) or len(found) != last + 1:
        missing = f"{len(by_number)} of {last + 1} FLIR segments"
        raise bad_file(header.path, "flir-chunks", missing, "every segment of the FLIR block once")
    return [by_number[k] for k in range(last + 1)]


def _byte_order(record: bytes) -> str:
    return ">" if struct.unpack_from(">H", record)[0] < 0x100 else "<"


def _planck(values: Mapping[str, float]) -> Planck | None:
    found = [values[k] for k in ("r1", "b", "f", "o", "r2")]
    if not all(math.isfinite(v) and abs(v) < 1e12 for v in found) or min(values["r1"], values["b"], values["r2"]) <= 0:
        return None
    return Planck(*map(float, found))


def _date(data: bytes, order: str) -> str | None:
    if len(data) < _DATE + 10:
        return None
    seconds, milliseconds, west_min = struct.unpack_from(f"{order}IIh", data, _DATE)
    if not seconds or abs(west_min) > 14 * 60:
        return None
    zone = timezone(timedelta(minutes=-west_min))
    when = datetime.fromtimestamp(seconds, UTC) + timedelta(milliseconds=min(milliseconds & 0xFFFF, 999))
    return when.astimezone(zone).isoformat(timespec="milliseconds")


def _roughness(counts: NDArray[np.uint16]) -> float:
    """Return the mean difference between neighbouring pixels, about 2**14 for bytes in the wrong order."""
    return float(np.abs(np.diff(counts.astype(np.int32), axis=1)).mean()) if counts.shape[1] > 1 else 0.0
