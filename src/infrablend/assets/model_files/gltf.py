"""Finds the files that a glTF names: in .gltf as well as in .glb, whose JSON may name external buffers, too."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from typing import Any
from urllib.parse import unquote

from infrablend.assets.model_files.reference import Reference, UnreadableFileError

_MAX_JSON_BYTES = 100 * 2**20


def find_references(data: bytes) -> list[Reference]:
    """Return the files that a glTF names, by `uri` anywhere in its JSON.

    Raises:
        UnreadableFileError: The data is not glTF.
    """
    try:
        text = _json_chunk(data)
        if len(text) > _MAX_JSON_BYTES:
            raise ValueError(f"its JSON has {len(text) >> 20} MB")
        content = json.loads(str(text, "utf-8"))
        found = {
            Reference(name, what, needed=what != "image")
            for what, uri in _uris(content, "file")
            if not (uri.startswith("data:") and ";base64," in uri)
            for name in {uri, unquote(uri)}
        }
    except (ValueError, struct.error, RecursionError) as error:
        raise UnreadableFileError(f"not glTF: {error}") from error
    if not isinstance(content, dict):
        raise UnreadableFileError("not glTF: its JSON is not an object")
    return sorted(found)


def _json_chunk(data: bytes) -> bytes:
    """Return the JSON of either form; the form is that of the content, as for Blender, whatever the name says."""
    if data[:4] != b"glTF":
        return data
    length, kind = struct.unpack_from("<I4s", data, 12)
    if kind != b"JSON" or len(data) < 20 + length:
        raise ValueError("its first chunk is not JSON, or cut off")
    return data[20 : 20 + length]


def _uris(value: Any, what: str) -> Iterator[tuple[str, str]]:
    """Yield the kind and URI of all files in the JSON; `extras` contain the author's own data, which nobody opens."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if key == "uri" and isinstance(inner, str):
                yield what, inner
            elif key != "extras":
                yield from _uris(inner, {"buffers": "buffer", "images": "image"}.get(key, what))
    elif isinstance(value, list):
        for inner in value:
            yield from _uris(inner, what)
