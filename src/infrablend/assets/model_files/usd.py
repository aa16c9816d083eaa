"""Finds the files that a USD layer names, in its text form, its binary form ("crate") and in packages (.usdz).

In text, every asset path stands between `@`. A crate does not show which of its texts are paths without a full reader,
so every text that can be a path counts as one if it names an existing file or ends like one.
"""

from __future__ import annotations

import io
import posixpath
import re
import struct
import zipfile
from collections.abc import Iterator

from infrablend.assets.model_files.reference import (
    Reference,
    UnreadableFileError,
    UnsupportedContentError,
)

# Comments and texts are matched first, so that an `@` within them opens no path.
# The closing mark is optional, so that a missing one costs no second look at the rest.
_TEXT = re.compile(
    rb'"""(?:\\.|[^"\\]|"(?!""))*+(?:""")?|'
    rb"\'\'\'(?:\\.|[^'\\]|'(?!''))*+(?:\'\'\')?|"
    rb'"(?:\\.|[^"\\\n])*+"?|'
    rb"'(?:\\.|[^'\\\n])*+'?|#[^\n]*+|"
    rb"@@@(?P<long>(?:\\@@@|[^@]|@(?!@@))*+)(?:@@@)?|@(?P<short>[^@\n]*+)@",
    re.DOTALL,
)
_PICTURE = re.compile(r"\.(?:png|jpe?g|exr|hdr|tiff?|tga|bmp|webp|gif|dds)$", re.I)
_FILE = re.compile(rf"{_PICTURE.pattern[:-2]}|usd[acz]?|abc|mtlx|vdb|obj|fbx|stl|ply|gltf|glb|blend)$", re.I)
# Value clips build the names of files while the scene is read.
_CLIPS = b"templateAssetPath"
_MAX_TOKEN_BYTES = 16 * 2**20


def find_references(data: bytes) -> list[Reference]:
    """Return the files that a USD layer or package names.

    Raises:
        UnreadableFileError: The data is not USD, or names files in a way that cannot be followed.
    """
    if data.startswith(b"PK\x03\x04"):
        return _of_package(data)
    return sorted(_of_layer(data))


def _of_layer(data: bytes) -> set[Reference]:
    if data.startswith(b"PXR-USDC"):
        try:
            texts = _tokens(data)
        except (struct.error, ValueError, IndexError) as error:
            raise UnreadableFileError(f"not a USD crate: {error}") from error
        if _CLIPS in texts:
            raise UnsupportedContentError("it has value clips, which are not supported")
        named = {name for name in map(_decoded, texts) if _may_be_path(name)}
        found = {_reference(name, certain=_is_certain(name)) for name in named}
    elif data.lstrip().startswith((b"#usda", b"#sdf")):
        if _CLIPS in data:
            raise UnsupportedContentError("it has value clips, which are not supported")
        named = {_decoded(m["long"] or m["short"] or b"") for m in _TEXT.finditer(data)} - {""}
        found = {_reference(name) for name in named}
    else:
        raise UnreadableFileError("neither a USD text, nor a USD crate, nor a package")
    for reference in found:
        if reference.name.startswith("`"):
            raise UnsupportedContentError("it computes the name of a file, which is not supported")
        if reference.name.lower().endswith(".mtlx"):
            raise UnsupportedContentError(f"it refers to {reference.name!r}; MaterialX is not supported")
    return found


def _of_package(data: bytes) -> list[Reference]:
    """Return the references of a package that leave it: a package contains everything that it names."""
    leaving: set[Reference] = set()
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as package:
            entries = package.infolist()
            if any(entry.compress_type != zipfile.ZIP_STORED or entry.flag_bits & 1 for entry in entries):
                raise UnreadableFileError("the files in its package are compressed, which USD does not allow")
            if sum(entry.file_size for entry in entries) > len(data):
                raise UnreadableFileError("the files in its package overlap")
            for entry in entries:
                if re.search(r"\.usd[acz]?$", entry.filename, re.I):
                    folder = posixpath.dirname(entry.filename)
                    for found in find_references(package.read(entry)):
                        name = found.name.replace("\\", "/")
                        if name.startswith("/") or posixpath.normpath(posixpath.join(folder, name)).startswith(".."):
                            leaving.add(Reference(found.name, found.what))
    except UnreadableFileError:
        raise
    except (zipfile.BadZipFile, RuntimeError, ValueError, struct.error, OSError, EOFError) as error:
        raise UnreadableFileError(f"not a USD package: {error}") from error
    return sorted(leaving)


def _decoded(name: bytes) -> str:
    return name.decode("utf-8", "surrogateescape")


def _file_part(name: str) -> str:
    """Return the file of an asset path, without format arguments and without the layer inside a package."""
    return name.split(":SDF_FORMAT_ARGS:")[0].split("[")[0]


def _may_be_path(text: str) -> bool:
    """Return whether a text of a crate may be the path of a file."""
    return text.startswith("`") or ("\n" not in text and ("/" in text or bool(_FILE.search(_file_part(text)))))


def _reference(name: str, *, certain: bool = True) -> Reference:
    file = _file_part(name)
    picture = bool(_PICTURE.search(file))
    return Reference(file, "texture" if picture else "USD layer", needed=not picture, certain=certain)


def _is_certain(text: str) -> bool:
    return "://" not in text and bool(_FILE.search(_file_part(text)))


def _tokens(data: bytes) -> set[bytes]:
    """Return the texts of a crate, among them all asset paths.

    Raises:
        ValueError: The table of texts is damaged.
    """
    (start,) = struct.unpack_from("<q", data, 16)
    (count,) = struct.unpack_from("<Q", data, start)
    for k in range(min(count, 64)):
        name, offset, _size = struct.unpack_from("<16sqq", data, start + 8 + 32 * k)
        if name.rstrip(b"\0") != b"TOKENS":
            continue
        if data[8:11] < b"\x00\x04\x00":  # not compressed before version 0.4.0
            _, size = struct.unpack_from("<QQ", data, offset)
            return set(data[offset + 16 : offset + 16 + size].split(b"\0"))
        _, size, packed = struct.unpack_from("<QQQ", data, offset)
        if size > _MAX_TOKEN_BYTES:
            raise ValueError("its table of texts is too large")
        return set(b"".join(_unpacked(data[offset + 24 : offset + 24 + packed], size)).split(b"\0"))
    raise ValueError("it has no table of texts")


def _unpacked(packed: bytes, size: int) -> Iterator[bytes]:
    """Yield the chunks of USD's compression: a count of chunks (0 for one without a length), then LZ4 blocks."""
    if not packed:
        raise ValueError("its table of texts is cut off")
    if packed[0] == 0:
        yield _lz4_block(memoryview(packed)[1:], size)
        return
    at = 1
    for _ in range(packed[0]):
        (length,) = struct.unpack_from("<i", packed, at)
        chunk = _lz4_block(memoryview(packed)[at + 4 : at + 4 + length], size)
        at, size = at + 4 + length, size - len(chunk)
        yield chunk


def _lz4_block(block: memoryview, size: int) -> bytes:
    """Return the content of an LZ4 block of at most `size` bytes.

    Raises:
        ValueError: The block is damaged.
        IndexError: The block is cut off.
    """
    out, at = bytearray(), 0
    while at < len(block):
        token = block[at]
        literals, at = _length(block, at + 1, token >> 4)
        if at + literals > len(block) or len(out) + literals > size:
            raise ValueError("its table of texts is damaged")
        out += block[at : at + literals]
        at += literals
        if at == len(block):  # the last sequence has no match
            break
        distance = block[at] | block[at + 1] << 8
        match, at = _length(block, at + 2, token & 15)
        match += 4
        if not 0 < distance <= len(out) or len(out) + match > size:
            raise ValueError("its table of texts is damaged")
        start = len(out) - distance
        piece = bytes(out[start : start + match])
        out += (piece * (match // len(piece) + 1))[:match]
    return bytes(out)


def _length(block: memoryview, at: int, start: int) -> tuple[int, int]:
    """Return a length that continues in further bytes if it starts with 15, and the position after it."""
    length = start
    while start == 15:
        length += block[at]
        at += 1
        if block[at - 1] != 255:
            break
    return length, at
