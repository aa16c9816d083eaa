"""Walks the header of a JPEG file segment by segment without decoding it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from infrablend.errors import DatasetError, Problem

# A radiometric header has a few dozen segments of 64 KiB; a visible picture inside adds up to 200.
MAX_SEGMENTS = 2_000
# Bytes of each segment that are kept while walking: enough for every signature.
_PREFIX = 64
_SOI = 0xD8
_SOS = 0xDA
_EOI = 0xD9
# Frame headers hold the size; DHT, JPG and DAC share their range.
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_STANDALONE = frozenset((0x01, *range(0xD0, 0xD8)))

APP1 = 0xE1
APP3 = 0xE3
APP4 = 0xE4


@dataclass(frozen=True)
class Segment:
    """One segment of a JPEG header.

    Attributes:
        marker: Second byte of its marker, e.g. 0xE1 for APP1.
        start: Offset of its contents in the file.
        length: Length of its contents in bytes.
        prefix: First bytes of its contents, at most 64.
    """

    marker: int
    start: int
    length: int
    prefix: bytes


@dataclass(frozen=True)
class JpegHeader:
    """Segments of a JPEG file up to its picture.

    Attributes:
        path: The file.
        size_wh: Width and height of the picture in pixels.
        segments: Segments in the order of the file.
    """

    path: Path
    size_wh: tuple[int, int]
    segments: tuple[Segment, ...]

    def find(self, marker: int, signature: bytes = b"") -> tuple[Segment, ...]:
        """Return the segments with a marker whose contents start with a signature."""
        return tuple(s for s in self.segments if s.marker == marker and s.prefix.startswith(signature))

    def read(self, segments: Iterable[Segment], skip: int = 0) -> bytes:
        """Return the joined contents of segments, each without its first `skip` bytes.

        Raises:
            DatasetError: The file has changed or cannot be read.
        """
        parts = []
        try:
            with self.path.open("rb") as file:
                for s in segments:
                    file.seek(s.start + skip)
                    wanted = max(0, s.length - skip)
                    data = file.read(wanted)
                    if len(data) != wanted:
                        raise bad_file(self.path, "jpeg-truncated", "the file ends inside a segment")
                    parts.append(data)
        except OSError as error:
            raise bad_file(self.path, "image-unreadable", error.strerror or str(error)) from error
        return b"".join(parts)


def bad_file(
    path: Path,
    code: str,
    found: str,
    expected: str = "a JPEG file as the camera wrote it",
    todo: str = "copy it from the card again, or remove it",
) -> DatasetError:
    """Return the error for a faulty file."""
    return DatasetError(f"{path}: {found}", [Problem(path.name, code, found, expected, todo)])


def read_header(path: Path) -> JpegHeader:
    """Return the segments of a JPEG file up to its picture; a few hundred bytes are read.

    Raises:
        DatasetError: With one problem: `jpeg-missing` (not a JPEG file), `jpeg-truncated`, `jpeg-length` (a length that
            cannot be), `jpeg-segments` (too many), `image-unreadable`.
    """
    if not path.is_file():  # a pipe would wait for ever
        raise bad_file(path, "image-unreadable", "no regular file")
    try:
        with path.open("rb") as file:
            return _walk(path, file, path.stat().st_size)
    except OSError as error:
        raise bad_file(path, "image-unreadable", error.strerror or str(error)) from error


def _walk(path: Path, file: BinaryIO, size: int) -> JpegHeader:
    signature = file.read(2)
    if signature in (b"II", b"MM"):
        todo = "use the camera's JPEG files, or state the unit of the values with --read unit=..."
        raise bad_file(path, "jpeg-missing", "a TIFF file, whose temperatures and telemetry are not read", todo=todo)
    if signature != bytes((0xFF, _SOI)):
        raise bad_file(path, "jpeg-missing", "it does not start like a JPEG file")
    segments: list[Segment] = []
    size_wh: tuple[int, int] | None = None
    while True:
        marker = _next_marker(path, file)
        if marker in _STANDALONE:
            continue
        if marker in (_SOS, _EOI):
            break
        head = file.read(2)
        length = int.from_bytes(head, "big") - 2
        start = file.tell()
        if len(head) < 2 or start + length > size:
            raise bad_file(path, "jpeg-truncated", f"segment {marker:02X} at byte {start} leads past the file's end")
        if length < 0:
            raise bad_file(path, "jpeg-length", f"segment {marker:02X} at byte {start} has length {length + 2}")
        if len(segments) >= MAX_SEGMENTS:
            raise bad_file(path, "jpeg-segments", f"more than {MAX_SEGMENTS} segments before the picture")
        segments.append(Segment(marker, start, length, file.read(min(length, _PREFIX))))
        if marker in _FRAMES:
            frame = segments[-1].prefix
            if len(frame) < 6:
                raise bad_file(path, "jpeg-length", f"a frame header of {length} bytes")
            size_wh = int.from_bytes(frame[3:5], "big"), int.from_bytes(frame[1:3], "big")
        file.seek(start + length)
    if size_wh is None or 0 in size_wh:
        raise bad_file(path, "jpeg-truncated", "no picture size before the picture")
    return JpegHeader(path, size_wh, tuple(segments))


def _next_marker(path: Path, file: BinaryIO) -> int:
    first = file.read(1)
    if first != b"\xff":
        where = file.tell() - len(first)
        found = f"a byte {first.hex()} instead of a marker at byte {where}" if first else "the file ends in its header"
        raise bad_file(path, "jpeg-length" if first else "jpeg-truncated", found)
    for _ in range(_PREFIX):  # a marker may be preceded by fill bytes
        byte = file.read(1)
        if byte != b"\xff":
            break
    if byte in (b"", b"\xff", b"\0"):
        raise bad_file(path, "jpeg-truncated", f"no marker at byte {file.tell()}")
    return byte[0]
