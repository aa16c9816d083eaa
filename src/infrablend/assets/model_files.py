"""The files that a 3D model consists of, found without Blender: the cached geometry follows a change of any of them.

A 3D file may name others: buffers, material libraries, layers, linked libraries. Their names are found in its text, or
in the bytes of a .blend. A binary USD layer compresses its names, so every USD file in its folder counts. Textures
do not: only the shape, the names and the InfraredEffect values of a file are used.
"""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import os
import re
import stat
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import zstandard

from infrablend.core.files import LFS_FOUND, LFS_POINTER, LFS_TODO, NotRegularError, open_regular
from infrablend.errors import ModelError, Problem

# Version of what the import makes of the same files, geometry and names; a new one imports every model again.
IMPORTER_VERSION = 2
MAX_BYTES = 2**30
MAX_FILES = 1000
TOO_LARGE = "model-too-large"
NO_FILE = "model-reference"

_USD = (".usd", ".usda", ".usdc", ".usdz")
_LIBRARY = re.compile(rb"^[ \t]*mtllib[ \t]+([^\r\n]*)", re.MULTILINE)
# Comments and texts are matched first, so that an `@` within them opens no path.
_ASSET = re.compile(rb'#[^\n]*+|"(?:\\.|[^"\\\n])*+"|@@@(?P<long>[^\n]+?)@@@|@(?P<short>[^@\n]++)@')
# A path relative to a .blend, in a field of characters.
_LINKED = re.compile(rb"//([^\0\n]{1,1000}?\.(?:blend|abc|mdd|pc2|vdb|usd[acz]?))\0", re.IGNORECASE)


@dataclass(frozen=True)
class ModelFiles:
    """The files of a 3D model.

    Attributes:
        main: The 3D file.
        digests: SHA-256 of each file, by path relative to the folder of `main`; `main` comes first.
    """

    main: Path
    digests: dict[str, str]

    @property
    def digest(self) -> str:
        """SHA-256 of the importer's version and the model: its only file, or the names and digests of all of them."""
        content = self.digests.values() if len(self.digests) == 1 else self.digests.items()
        return hashlib.sha256(json.dumps([IMPORTER_VERSION, *content]).encode()).hexdigest()

    @property
    def paths(self) -> list[Path]:
        """All files, `main` first."""
        return [self.main.parent / name for name in self.digests]


def find_model_files(main: Path) -> ModelFiles:
    """Return the 3D file and all files that its shape depends on.

    Raises:
        ModelError: A file cannot be read or is damaged, a buffer of a glTF is missing, or the files are too large.
    """
    main = Path(os.path.realpath(main))
    digests: dict[str, str] = {}
    waiting = [main.name]
    size = 0
    while waiting:
        name = waiting.pop(0)
        if name in digests:
            continue
        data = _read(main, name)
        size += len(data)
        if size > MAX_BYTES or len(digests) >= MAX_FILES:
            raise too_large(main, f"more than {MAX_BYTES >> 20} MB or {MAX_FILES} files")
        digests[name] = hashlib.sha256(data).hexdigest()
        try:
            named = sorted(set(_references(main.parent / name, data)))
        except (ValueError, struct.error, RecursionError, EOFError, OSError, zlib.error, zstandard.ZstdError) as error:
            where = f"model file {main}" if name == main.name else f"model file {main}: {name}"
            raise ModelError(f"{where}: {error}; expected a valid {Path(name).suffix} file") from error
        inside = [os.path.normpath(Path(name).parent / other) for other in named if "\0" not in other]
        waiting += [other for other in inside if os.path.lexists(main.parent / other)]
        if Path(name).suffix.lower() in (".gltf", ".glb"):
            _require_buffers(main, [other for other in inside if other not in waiting])
    return ModelFiles(main, {main.name: digests.pop(main.name), **dict(sorted(digests.items()))})


def is_regular_file(path: Path) -> bool:
    """Return whether a path names a regular file; False also for paths that cannot exist."""
    try:
        return stat.S_ISREG(os.stat(path).st_mode)  # noqa: PTH116 - Path.is_file raises for names that are too long
    except (OSError, ValueError):
        return False


def too_large(main: Path, found: str) -> ModelError:
    """Return the error for a model that needs more than it may."""
    todo = "reduce it in Blender (Decimate modifier), remove what is not visible, and save it again"
    expected = "a model of some ten thousand triangles, enough for an object of a few hundred pixels"
    problem = Problem(str(main), TOO_LARGE, found, expected, todo)
    return ModelError(f"model file {main}: too large ({found})", [problem])


def _require_buffers(main: Path, missing: list[str]) -> None:
    """Raise the error that names the missing buffers of a glTF."""
    todo = "put the file beside the model, or save the model as .glb, which contains everything"
    problems = [
        Problem(str(main), NO_FILE, f"refers to the buffer {name[:300]!r}, which is missing", "all its buffers", todo)
        for name in missing
    ]
    if problems:
        raise ModelError(f"model file {main}: cannot find {len(problems)} of the files it refers to", problems)


def _references(file: Path, data: bytes) -> Iterator[str]:
    """Yield the names, relative to the folder of `file`, of the files that decide the shape in it.

    Raises:
        ValueError, struct.error, RecursionError: The data is not of the format that the suffix says.
        EOFError, OSError, zlib.error, ZstdError: A compressed file is damaged.
    """
    suffix = file.suffix.lower()
    if suffix in (".gltf", ".glb"):
        yield from _buffers(data)
    elif suffix == ".obj":
        yield from _libraries(file, data)
    elif suffix in _USD:
        yield from _layers(file, data)
    elif suffix == ".blend":
        for match in _LINKED.finditer(_blend(data)):
            yield _text(match[1]).replace("\\", "/")


def _buffers(data: bytes) -> Iterator[str]:
    """Yield the files of the buffers of a glTF, whose form is that of its content, as for Blender."""
    try:
        if data[:4] == b"glTF":
            length, kind = struct.unpack_from("<I4s", data, 12)
            if kind != b"JSON" or len(data) < 20 + length:
                raise ValueError("its first chunk is not JSON, or cut off")
            data = data[20 : 20 + length]
        content: Any = json.loads(data.decode("utf-8"))
        buffers = content.get("buffers", []) if isinstance(content, dict) else None
        if not isinstance(buffers, list):
            raise ValueError("its JSON has no list of buffers")
    except (ValueError, struct.error, RecursionError) as error:
        raise ValueError(f"not glTF: {error}") from error
    for buffer in buffers:
        uri = buffer.get("uri") if isinstance(buffer, dict) else None
        if isinstance(uri, str) and not uri.startswith("data:"):
            yield unquote(uri)


def _libraries(file: Path, data: bytes) -> Iterator[str]:
    """Yield the material libraries of an OBJ; Blender also reads the one of its own name, which no line names."""
    yield file.with_suffix(".mtl").name
    for match in _LIBRARY.finditer(data):
        yield _text(match[1]).strip().strip("\"'")


def _layers(file: Path, data: bytes) -> Iterator[str]:
    """Yield the layers that a USD file may refer to; a package (.usdz) contains everything that it names."""
    if data.startswith(b"PK\x03\x04"):
        return
    if data.startswith(b"PXR-USDC"):
        others = (p for p in sorted(file.parent.rglob("*")) if p.suffix.lower() in _USD and is_regular_file(p))
        yield from (str(p.relative_to(file.parent)) for p in others if p != file)
    elif data.lstrip().startswith((b"#usda", b"#sdf")):
        for match in _ASSET.finditer(data):
            name = _text(match["long"] or match["short"] or b"").split(":SDF_FORMAT_ARGS:")[0].split("[")[0]
            if name.lower().endswith(_USD):
                yield name
    else:
        raise ValueError("neither a USD text, nor a USD crate, nor a package")


def _blend(data: bytes) -> bytes:
    """Return the content of a .blend without its compression."""
    if data.startswith(b"\x28\xb5\x2f\xfd"):
        data = zstandard.ZstdDecompressor().stream_reader(io.BytesIO(data), read_across_frames=True).read(MAX_BYTES)
    elif data.startswith(b"\x1f\x8b"):
        data = gzip.GzipFile(fileobj=io.BytesIO(data)).read(MAX_BYTES)
    if not data.startswith(b"BLENDER"):
        raise ValueError("not a .blend")
    return data


def _text(name: bytes) -> str:
    return name.decode("utf-8", "surrogateescape")


def _read(main: Path, name: str) -> bytes:
    """Return the content of a regular file.

    Raises:
        ModelError: It is not one, cannot be read, or is too large.
    """
    path = main.parent / name
    try:
        with open_regular(path) as stream:
            size = os.fstat(stream.fileno()).st_size
            if size > MAX_BYTES:
                raise too_large(main, f"{name} has {size >> 20} MB")
            data = stream.read(MAX_BYTES + 1)
    except NotRegularError as error:
        raise ModelError(f"model file {main}: {name} is no regular file; expected one") from error
    except OSError as error:
        raise ModelError(f"model file {path}: cannot be read ({error.strerror or error})") from error
    if data.startswith(LFS_POINTER):
        fault = Problem(str(path), NO_FILE, LFS_FOUND, f"a valid {path.suffix} file", LFS_TODO)
        raise ModelError(f"model file {main}: cannot be read", [fault])
    return data
