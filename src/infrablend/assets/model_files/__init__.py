"""The files that a 3D model consists of: found without Blender, each checked, and copied for the import.

A 3D file may name others: buffers, material libraries, layers, linked libraries. Those that decide the shape must be
regular files in the folder of the 3D file; a reference that leaves the folder is an error. The digest of a model covers
the content of all of them and the version of the importer, so a change of any is a change of the model. Textures are
never read: only the shape, the names and the InfraredEffect values of a file are used.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

from infrablend.assets.model_files import blend, gltf, obj, usd
from infrablend.assets.model_files.reference import (
    Reference,
    UnreadableFileError,
    UnsupportedContentError,
)
from infrablend.core.files import NotRegularError, open_regular, output_error
from infrablend.errors import ModelError, Problem

# Version of what the import makes of the same files, geometry and names; a new one imports every model again.
IMPORTER_VERSION = 2
MAX_BYTES = 2**30
MAX_FILES = 1000
_SHOWN = 300  # characters of a name in a message
OUTSIDE, TOO_LARGE, NO_FILE = "model-outside", "model-too-large", "model-reference"


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

    def copy_to(self, folder: Path) -> Path:
        """Copy the files to a folder and return the path of the copied 3D file; paths it does not need are emptied.

        Raises:
            ModelError: A file has changed since it was checked.
            OutputError: The folder cannot be written.
        """
        root = self.main.parent
        for name, digest in self.digests.items():
            data = _read(self.main, root / name, name)
            if hashlib.sha256(data).hexdigest() != digest:
                raise ModelError(f"model file {self.main}: {name} changed while it was being read; run again")
            if name.lower().endswith(".blend"):
                data = blend.empty_unneeded_paths(blend.read_blend(data))
            target = folder / name
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(data)
            except OSError as error:
                raise output_error(target, error) from error
        return folder / self.main.name


def find_model_files(main: Path) -> ModelFiles:
    """Return the 3D file and all files that its shape depends on.

    Raises:
        ModelError: A file cannot be read, a reference leaves the folder of the 3D file or names no regular file, or the
            files are too large. The problems name every reference.
    """
    main = Path(os.path.realpath(main))
    digests: dict[str, str] = {}
    problems: list[Problem] = []
    waiting, size = [main.name], 0
    while waiting:
        name = waiting.pop(0)
        if name in digests:
            continue
        data = _read(main, main.parent / name, name)
        size += len(data)
        if size > MAX_BYTES or len(digests) >= MAX_FILES:
            raise too_large(main, f"more than {MAX_BYTES >> 20} MB or {MAX_FILES} files")
        digests[name] = hashlib.sha256(data).hexdigest()
        try:
            references = _references(name, data)
        except UnreadableFileError as error:
            unsupported = isinstance(error, UnsupportedContentError)
            expected = "a shape that is all in the file" if unsupported else f"a valid {Path(name).suffix} file"
            where = f"model file {main}" if name == main.name else f"model file {main}: {name}"
            raise ModelError(f"{where}: {error}; expected {expected}") from error
        for reference in references:
            try:
                waiting += _resolved(main.parent, Path(name).parent, reference)
            except _ReferenceError as error:
                problems.append(_problem(main, name, reference, error))
    if problems:
        raise ModelError(f"model file {main}: cannot use {len(problems)} of the files it refers to", problems)
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


class _ReferenceError(ValueError):
    """A reference that cannot be followed; the arguments are the code of the problem and what was found."""


def _references(name: str, data: bytes) -> list[Reference]:
    path = Path(name)
    suffix = path.suffix.lower()
    if suffix in (".gltf", ".glb"):
        return gltf.find_references(data)
    if suffix == ".obj":
        return obj.find_references(data, path.stem)
    if suffix == ".mtl":
        return obj.find_textures(data)
    if suffix in (".usd", ".usda", ".usdc", ".usdz"):
        return usd.find_references(data)
    if suffix == ".blend":
        return blend.find_references(blend.read_blend(data))
    return []  # FBX and what is referred to: buffers, caches


def _resolved(root: Path, folder: Path, reference: Reference) -> Iterator[str]:
    """Yield the path of the file that a reference names, relative to `root`, if the import needs it.

    Args:
        root: Folder of the 3D file.
        folder: Folder of the file with the reference, relative to `root`.
        reference: The reference.

    Raises:
        _ReferenceError: It leaves the folder, is missing although required, or names no regular file.
    """
    written = reference.name
    portable = written.replace("\\", "/")
    # Some importers take a backslash for a separator, others do not.
    inside = [_inside(root, folder, name) for name in dict.fromkeys((written, portable))]
    if None in inside:
        if reference.certain or ("\0" not in written and os.path.lexists(root / folder / portable)):
            at_root = Path(portable).is_relative_to(root) and ".." not in Path(portable).parts
            raise _ReferenceError(OUTSIDE, "given as an absolute path" if at_root else "outside of its folder")
        return
    there = [name for name in inside if name is not None and os.path.lexists(root / name)]
    if not there:
        if reference.required:
            raise _ReferenceError(NO_FILE, "missing")
        return
    for name in there:
        path = root / name
        if not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(root)):
            raise _ReferenceError(OUTSIDE, "a link that leaves its folder")
        if reference.what in blend.folder_kinds():
            raise _ReferenceError(NO_FILE, "not in the file")
        if not is_regular_file(path):
            if not reference.certain and path.is_dir():
                continue
            raise _ReferenceError(NO_FILE, "no regular file")
        if reference.needed:
            yield name


def _inside(root: Path, folder: Path, name: str) -> str | None:
    """Return a path relative to `root`; None if it is absolute, an address on the network, or leaves `root`."""
    if "\0" in name or "://" in name or name.startswith("/") or PureWindowsPath(name).drive:
        return None
    relative = os.path.normpath(folder / name)
    if relative.startswith("..") and (relative == ".." or relative.startswith("../")):
        return None
    return relative


def _problem(main: Path, name: str, reference: Reference, error: _ReferenceError) -> Problem:
    code, found = error.args
    inside = "a regular file in the folder of the model"
    if reference.what in blend.folder_kinds():
        inside = "no cache outside of the file"
    todo = {
        ".blend": "make linked data local, apply caches and pack files in Blender, and save it again",
        ".gltf": "save it as .glb, which contains everything",
    }.get(Path(name).suffix.lower(), "put the file beside the model, and refer to it by its name")
    where = str(main) if name == main.name else f"{main}: {name}"
    named = reference.name if len(reference.name) <= _SHOWN else reference.name[:_SHOWN] + "..."
    return Problem(where, code, f"refers to the {reference.what} {named!r}, which is {found}", inside, todo)


def _read(main: Path, path: Path, name: str) -> bytes:
    """Return the content of a regular file.

    Raises:
        ModelError: It is not one, cannot be read, or is too large.
    """
    try:
        with open_regular(path) as stream:
            size = os.fstat(stream.fileno()).st_size
            if size > MAX_BYTES:
                raise too_large(main, f"{name} has {size >> 20} MB")
            return stream.read(MAX_BYTES + 1)
    except NotRegularError as error:
        raise ModelError(f"model file {main}: {name} is no regular file; expected one") from error
    except OSError as error:
        raise ModelError(f"model file {path}: cannot be read ({error.strerror or error})") from error
