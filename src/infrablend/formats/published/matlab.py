"""Reads the workspace of MATLAB objects out of a MAT file (level 5), which mcos-decoder then decodes.

scipy reads it too, but its compiled reader ends the process on some damaged files. Layout: MathWorks, "MAT-File
Format": a header of 128 bytes, then elements of a tag (type and number of bytes) and data, padded to 8 bytes.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

_HEADER_BYTES = 128
_INT8 = 1
_UINT8 = 2
_MATRIX = 14
_COMPRESSED = 15
_MAX_BYTES = 200_000_000


def object_workspace(data: bytes) -> bytes:
    """Return the workspace of the objects in a MAT file: the bytes of its variable without a name.

    Raises:
        ValueError: The file is damaged, of another kind, or has no objects.
    """
    if len(data) < _HEADER_BYTES or data[126:128] != b"IM":
        raise ValueError("no MAT file of level 5 with little-endian numbers")
    for kind, content in _elements(data[_HEADER_BYTES:]):
        inner = content
        if kind == _COMPRESSED:
            inside = next(_elements(_inflated(content)), None)
            if inside is None:
                raise ValueError("an empty compressed element")
            kind, inner = inside
        if kind != _MATRIX:
            raise ValueError(f"an element of type {kind}, not a variable")
        parts = list(_elements(inner))
        # Flags, dimensions, name, values.
        if len(parts) >= 4 and parts[2] == (_INT8, b"") and parts[3][0] == _UINT8:
            return parts[3][1]
    raise ValueError("no variable with MATLAB objects")


def _inflated(content: bytes) -> bytes:
    unpacker = zlib.decompressobj()
    try:
        found = unpacker.decompress(content, _MAX_BYTES)
    except zlib.error as error:
        raise ValueError(f"damaged compression ({error})") from error
    if unpacker.unconsumed_tail:
        raise ValueError(f"more than {_MAX_BYTES // 10**6} MB after decompression")
    return found


def _elements(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield type and content of the elements that follow each other.

    Raises:
        ValueError: An element is longer than the data.
    """
    at = 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from("<II", data, at)
        start = at + 8
        if kind >> 16:  # a short element: type and size are two bytes each, and the content is in the tag
            kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
            if size > 4:
                raise ValueError(f"a short element of {size} bytes")
        if start + size > len(data):
            raise ValueError(f"an element of {size} bytes where {len(data) - start} are left")
        yield kind, data[start : start + size]
        end = at + 8 if start == at + 4 else start + size
        # Compressed elements are not padded.
        at = end if kind == _COMPRESSED else end + -end % 8
