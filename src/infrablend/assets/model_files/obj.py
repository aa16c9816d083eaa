"""Finds the files that a Wavefront OBJ and its material libraries name."""

from __future__ import annotations

import re

from infrablend.assets.model_files.reference import Reference

_CONTINUED = re.compile(rb"\\[ \t]*\r?\n")
_LIBRARY = re.compile(rb"^[ \t]*mtllib[ \t]+([^\r\n]*)", re.MULTILINE)
_TEXTURE = re.compile(rb"^[ \t]*(?:map_\w+|bump|disp|decal|refl|norm)[ \t]+([^\r\n]*)", re.MULTILINE | re.IGNORECASE)
# Number of values of each texture option; the file name follows the options.
_OPTION_VALUES = {
    b"-blendu": 1, b"-blendv": 1, b"-boost": 1, b"-mm": 2, b"-o": 3, b"-s": 3, b"-t": 3, b"-texres": 1, b"-clamp": 1,
    b"-bm": 1, b"-imfchan": 1, b"-type": 1, b"-cc": 1,
}  # fmt: skip
_NUMBER = re.compile(rb"[-+]?[\d.]+(?:[eE][-+]?\d+)?")


def find_references(data: bytes, stem: str) -> list[Reference]:
    """Return the material libraries of an OBJ.

    Args:
        data: Content of the file.
        stem: Name of the file without its suffix: Blender reads a library of that name even if no line names it.
    """
    found = {Reference(f"{stem}.mtl", "material library")}
    for match in _LIBRARY.finditer(_joined(data)):
        line = _text(match[1])
        # Blender takes the line for one name; others take it for several.
        found |= {Reference(name, "material library") for name in {line, *line.split()} if name}
    return sorted(found)


def find_textures(data: bytes) -> list[Reference]:
    """Return the textures of a material library."""
    names = {_text(_without_options(m[1])) for m in _TEXTURE.finditer(_joined(data))}
    return sorted(Reference(name, "texture", needed=False) for name in names if name)


def _joined(data: bytes) -> bytes:
    return _CONTINUED.sub(b" ", data) if b"\\" in data else data


def _text(name: bytes) -> str:
    return name.strip().strip(b"\"'").decode("utf-8", "surrogateescape")


def _without_options(rest: bytes) -> bytes:
    words = rest.split(maxsplit=1)
    while words and (count := _OPTION_VALUES.get(words[0].lower())) is not None:
        rest = words[1] if len(words) > 1 else b""
        for k in range(count):
            words = rest.split(maxsplit=1)
            if not words or (k and not _NUMBER.fullmatch(words[0])):  # the last values may be left out
                break
            rest = words[1] if len(words) > 1 else b""
        words = rest.split(maxsplit=1)
    return rest
