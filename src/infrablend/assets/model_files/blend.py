"""Finds the files that a .blend names, and empties the paths that the import does not need.

A .blend is a list of blocks, each an array of one C structure of Blender, and a description of all structures. Every
path of a file is text in a field with a telling name (`filepath`, `dir`, ...), whatever the structure. Linked libraries
and caches decide the shape, so they must be beside the file; all other paths (pictures, sounds, output folders) are
emptied in the copy that is imported.
"""

from __future__ import annotations

import io
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import zstandard

from infrablend.assets.model_files.reference import (
    Reference,
    UnreadableFileError,
    UnsupportedContentError,
)

MAX_BYTES = 2**30
_MAX_BLOCKS = 2_000_000
_MAX_STRUCTURES = 5_000_000
_MAX_FIELDS = 50_000
_PATH_FIELD = re.compile(r"file|path|dir|pic$|cachepath|cache_directory")
# Paths within a scene or a cache, not of files.
_WITHIN = {"object_path", "reader_object_path", "context_data_path"}
# Old versions call the path of these `name`.
_NAMED_BY_PATH = {"Library", "Image", "VFont", "bSound", "MovieClip", "Script"}
_FILES = {
    "Library": "linked library",
    "CacheFile": "Alembic or USD cache",
    "CacheFileLayer": "Alembic or USD cache",
    "MeshCacheModifierData": "mesh cache",
    "CustomDataExternal": "file of sculpted details",
    "Volume": "volume",
    "VFont": "font",
}
_FOLDERS = {
    "OceanModifierData": "cache of an ocean",
    "FluidDomainSettings": "cache of a fluid",
    "PointCache": "cache of a simulation",
    "NodesModifierData": "cache of geometry nodes",
    "NodesModifierBake": "cache of geometry nodes",
}
_IMAGE_TEXTURE = 8  # Tex.type
_FROM_FILE = {1, 2, 3}  # Image.source: a file, a sequence, a movie
_READING_NODES = re.compile(rb"GeometryNodeImport\w+")
_PICTURE_NODE = b"GeometryNodeImageTexture"


class _Field(NamedTuple):
    """A field of a structure, also one of a nested structure.

    Attributes:
        owner: Name of the structure that contains it directly.
        kind: Name of its type.
        name: Its name, without stars and dimensions.
        inside: Names of the nested structures that contain it, `packedfiles.` for a list of packed files.
        pointer: Whether it is an address.
        offset, size: Its place in the outermost structure, in bytes.
    """

    owner: str
    kind: str
    name: str
    inside: str
    pointer: bool
    offset: int
    size: int


# Name, size and fields of a structure.
_Layout = tuple[str, int, tuple[_Field, ...]]


class _Block(NamedTuple):
    """A block: its structure, the address it had in Blender, and the place of its data."""

    struct_index: int
    address: int
    start: int
    length: int
    items: int


@dataclass(frozen=True)
class BlendFile:
    """A .blend in memory, without its compression.

    Attributes:
        data: Content.
        blocks: All blocks.
        layouts: Name, size and fields of every structure.
    """

    data: bytes
    blocks: list[_Block]
    layouts: list[_Layout]

    def structures(self, wanted: set[int]) -> Iterator[tuple[_Block, int, _Layout]]:
        """Yield block, position and layout of each structure whose number is in `wanted`."""
        seen = 0
        for block in self.blocks:
            if block.struct_index in wanted:
                layout = self.layouts[block.struct_index]
                items = min(block.items, block.length // max(1, layout[1]))
                seen += items
                if seen > _MAX_STRUCTURES:
                    raise UnreadableFileError(f"more than {_MAX_STRUCTURES:,} structures")
                for k in range(items):
                    yield block, block.start + k * layout[1], layout

    @cached_property
    def by_address(self) -> dict[int, _Block]:
        """All blocks by the address they had in Blender."""
        return {b.address: b for b in self.blocks}

    def text(self, at: int, size: int) -> str:
        """Return the text in a field of characters."""
        return self.data[at : at + size].split(b"\0", 1)[0].decode("utf-8", "surrogateescape")

    def number(self, at: int, size: int) -> int:
        """Return an unsigned whole number or an address."""
        return int.from_bytes(self.data[at : at + size], "little")


def read_blend(data: bytes) -> BlendFile:
    """Return a .blend without its compression, with its blocks and the layout of their structures.

    Raises:
        UnreadableFileError: The data is not a .blend that can be searched.
    """
    try:
        plain = _decompressed(data)
        if plain[:7] != b"BLENDER":
            raise UnreadableFileError("not a .blend")
        return _read_blocks(plain)
    except UnreadableFileError:
        raise
    except (struct.error, IndexError, ValueError, zlib.error, OSError, EOFError, zstandard.ZstdError) as error:
        raise UnreadableFileError(f"not a .blend: {error}") from error


def find_references(blend: BlendFile) -> list[Reference]:
    """Return the files and folders that the shape in a .blend depends on.

    Raises:
        UnreadableFileError: The shape depends on files in a way that cannot be followed.
    """
    found: set[Reference] = set()
    for _, at, layout, one in _paths(blend):
        name = blend.text(*_place_of(blend, at, one)).removeprefix("//")
        if not name or not _is_needed(layout, one) or name == "<builtin>":
            continue
        packed = any(blend.number(at + f.offset, f.size) for f in layout[2] if f.name == "packedfile")
        if one.owner in _FOLDERS:  # Blender sets most of them before there is a cache
            found.add(Reference(name.rstrip("/\\") or name, _FOLDERS[one.owner], certain=False))
        elif packed and one.owner == "Library":
            raise UnsupportedContentError(
                f"it contains the packed library {name!r}, which is not supported; make it local"
            )
        elif not packed:
            if one.owner.startswith("CacheFile") and not name.lower().endswith(".abc"):
                raise UnsupportedContentError(f"it uses the cache {name!r}; only Alembic caches (.abc) are supported")
            found.add(Reference(name, _FILES[one.owner], required=True))
    if nodes := _READING_NODES.search(blend.data):
        raise UnsupportedContentError(f"its geometry nodes read files ({nodes[0].decode()}), which is not supported")
    if picture := _shaping_picture(blend):
        raise UnsupportedContentError(
            f"the picture {picture!r} changes its shape, but is not in the file; pack it into the .blend"
        )
    return sorted(found)


def folder_kinds() -> frozenset[str]:
    """Return the kinds of references that name folders; these must be absent, since nobody copies them."""
    return frozenset(_FOLDERS.values())


def empty_unneeded_paths(blend: BlendFile) -> bytes:
    """Return the content of a .blend with every path emptied but those of files that decide the shape."""
    emptied = bytearray(blend.data)
    for _, at, layout, one in _paths(blend):
        if one.owner in _FOLDERS or not _is_needed(layout, one):
            start, size = _place_of(blend, at, one)
            emptied[start : start + size] = bytes(size)
    return bytes(emptied)


def _paths(blend: BlendFile) -> Iterator[tuple[_Block, int, _Layout, _Field]]:
    """Yield each field with a path: block, position of its structure, layout of the structure, field."""
    fields = {
        k: chosen for k, (_, _, all_) in enumerate(blend.layouts) if (chosen := [f for f in all_ if _holds_path(f)])
    }
    for block, at, layout in blend.structures(set(fields)):
        for one in fields[block.struct_index]:
            yield block, at, layout, one


def _holds_path(one: _Field) -> bool:
    if one.kind != "char" or one.owner in ("FileGlobal", "CacheObjectPath") or one.name in _WITHIN:
        return False
    if one.pointer:  # texts of any length, in blocks of their own
        return one.owner in _FOLDERS and one.name.endswith("directory")
    return one.size > 8 and (bool(_PATH_FIELD.search(one.name)) or (one.name == "name" and one.owner in _NAMED_BY_PATH))


def _place_of(blend: BlendFile, at: int, one: _Field) -> tuple[int, int]:
    """Return position and size of the text of a field, which is elsewhere if the field is a pointer."""
    if not one.pointer:
        return at + one.offset, one.size
    address = blend.number(at + one.offset, one.size)
    block = blend.by_address.get(address) if address else None
    return (block.start, block.length) if block else (at, 0)


def _is_needed(layout: _Layout, one: _Field) -> bool:
    """Return whether the shape depends on the file or folder that a field names."""
    if one.owner == "Library":  # `filepath` in new versions; `name` in old ones, whose other fields say where it was
        own = {f.name for f in layout[2] if f.owner == "Library" and f.kind == "char" and not f.pointer}
        return one.name == ("name" if "name" in own else "filepath")
    return one.owner in _FOLDERS or (one.owner in _FILES and not one.name.startswith("handle_"))


def _shaping_picture(blend: BlendFile) -> str | None:
    """Return the path of a picture outside the .blend that a modifier reads, if there is one."""
    outside: dict[int, str] = {}
    textures: dict[int, int] = {}
    users: set[int] = set()
    wanted = {
        k
        for k, (name, _, fields) in enumerate(blend.layouts)
        if name in ("Image", "Tex") or (name.endswith("ModifierData") and any(_is_texture(f) for f in fields))
    }
    for block, at, (name, _, fields) in blend.structures(wanted):
        value = {f.name: (at + f.offset, f.size) for f in fields if f.owner == name}
        if name == "Image":
            path = blend.text(*value.get("filepath", value.get("name", (at, 0))))
            packs = (f for f in fields if f.name == "packedfile" or f.inside + f.name == "packedfiles.first")
            packed = any(blend.number(at + f.offset, f.size) for f in packs)
            if path and not packed and blend.number(*value.get("source", (at, 0))) in _FROM_FILE:
                outside[block.address] = path
        elif name == "Tex":
            if blend.number(*value.get("type", (at, 0))) == _IMAGE_TEXTURE and "ima" in value:
                textures[block.address] = blend.number(*value["ima"])
        else:
            users |= {blend.number(at + f.offset, f.size) for f in fields if _is_texture(f)}
    for user in users:
        if textures.get(user) in outside:
            return outside[textures[user]]
    return next(iter(outside.values()), None) if _PICTURE_NODE in blend.data else None


def _is_texture(one: _Field) -> bool:
    return one.pointer and one.kind == "Tex"


def _decompressed(data: bytes) -> bytes:
    if data[:4] == b"\x28\xb5\x2f\xfd":
        stream: io.BufferedIOBase | zstandard.ZstdDecompressionReader = zstandard.ZstdDecompressor().stream_reader(
            io.BytesIO(data), read_across_frames=True
        )
        plain = stream.read(MAX_BYTES + 1)
    elif data[:2] == b"\x1f\x8b":
        inflater = zlib.decompressobj(31)
        plain = inflater.decompress(data, MAX_BYTES + 1)
    else:
        plain = data
    if len(plain) > MAX_BYTES:
        raise UnreadableFileError(f"more than {MAX_BYTES >> 20} MB when unpacked")
    return plain


def _read_blocks(data: bytes) -> BlendFile:
    if data[7:8] in b"_-":
        pointer, large, at = (4 if data[7:8] == b"_" else 8), False, 12
        if data[8:9] != b"v":
            raise UnreadableFileError("not a .blend of a computer of today (big-endian)")
    else:  # version 5: BLENDER17-01v0500
        pointer, large, at = 8, True, int(data[7:9])
    form = struct.Struct("<4sI" + ("Q" if pointer == 8 else "I") + "II") if not large else struct.Struct("<4sIQqq")
    blocks: list[_Block] = []
    layout_block = None
    while True:
        if large:
            code, index, address, length, count = form.unpack_from(data, at)
        else:
            code, length, address, index, count = form.unpack_from(data, at)
        at += form.size
        if code == b"ENDB":
            break
        if length < 0 or at + length > len(data):
            raise UnreadableFileError("a .blend that is cut off")
        if code == b"DNA1":
            layout_block = (at, length)
        blocks.append(_Block(index, address, at, length, count))
        if len(blocks) > _MAX_BLOCKS:
            raise UnreadableFileError(f"more than {_MAX_BLOCKS:,} blocks")
        at += length
    if layout_block is None:
        raise UnreadableFileError("a .blend without a description of its structures")
    return BlendFile(data, blocks, _read_layouts(data[layout_block[0] : sum(layout_block)], pointer))


def _read_layouts(data: bytes, pointer: int) -> list[_Layout]:
    """Return name, size and fields of each structure, from the block DNA1."""
    names, at = _read_texts(data, 4, b"NAME")
    types, at = _read_texts(data, at, b"TYPE")
    at = _expect(data, at, b"TLEN")
    sizes = struct.unpack_from(f"<{len(types)}H", data, at)
    at = _expect(data, at + 2 * len(types), b"STRC")
    (count,) = struct.unpack_from("<I", data, at)
    at += 4
    direct: dict[int, list[tuple[int, int]]] = {}
    order: list[int] = []
    for _ in range(count):
        of, number = struct.unpack_from("<HH", data, at)
        flat = struct.unpack_from(f"<{2 * number}H", data, at + 4)
        direct[of] = list(zip(flat[::2], flat[1::2], strict=True))
        order.append(of)
        at += 4 + 4 * number
    flattened: dict[int, tuple[_Field, ...]] = {}

    def fields_of(of: int, depth: int = 0) -> tuple[_Field, ...]:
        if of in flattened:
            return flattened[of]
        if depth > 32:
            raise UnreadableFileError("structures that contain each other")
        found: list[_Field] = []
        offset = 0
        for kind, number in direct[of]:
            written = names[number]
            is_pointer = written.startswith(("*", "("))
            items = 1
            for dimension in re.findall(r"\[(\d+)\]", written):
                items *= int(dimension)
            one = pointer if is_pointer else sizes[kind]
            name = re.sub(r"[*()]|\[.*", "", written)
            if kind in direct and not is_pointer:
                inner = fields_of(kind, depth + 1)
                for k in range(min(items, 64)):
                    start = offset + k * one
                    found += [f._replace(inside=f"{name}.{f.inside}", offset=start + f.offset) for f in inner]
            else:
                found.append(_Field(types[of], types[kind], name, "", is_pointer, offset, one * items))
            offset += one * items
            if len(found) > _MAX_FIELDS:
                raise UnreadableFileError("structures with too many fields")
        useful = (f for f in found if f.pointer or f.kind in ("char", "short", "int"))
        flattened[of] = tuple(f for f in useful if f.offset + f.size <= sizes[of])
        return flattened[of]

    return [(types[of], sizes[of], fields_of(of)) for of in order]


def _read_texts(data: bytes, at: int, tag: bytes) -> tuple[list[str], int]:
    at = _expect(data, at, tag)
    (count,) = struct.unpack_from("<I", data, at)
    at += 4
    found = []
    for _ in range(count):
        end = data.index(b"\0", at)
        found.append(data[at:end].decode("ascii"))
        at = end + 1
    return found, at


def _expect(data: bytes, at: int, tag: bytes) -> int:
    """Return the position after a tag, which starts at a multiple of four bytes."""
    at += -at % 4
    if data[at : at + 4] != tag:
        raise UnreadableFileError("a .blend with a damaged description of its structures")
    return at + 4
