"""Makes file names out of data, and joins paths from data without leaving a folder."""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePosixPath, PureWindowsPath

MAX_NAME_BYTES = 255
"""Longest file name of the usual file systems."""
MAX_PATH_BYTES = 4096
"""Length from which on paths are too long on Linux; elsewhere they are shorter."""

UNFIT = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\ufffe\uffff]")
"""Characters that label files cannot hold: XML has none of the control characters, text files split lines at others."""

_PLAIN = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_./-]*")
"""Names that fit as they are, unless they contain `..`: nearly all, so that large datasets are named quickly."""

_EDGE_BLANKS = re.compile(r"^\s+|\s+$")
_RESERVED = frozenset('/\\<>:"|?*')
_NOT_IN_PATHS = re.compile(f'{UNFIT.pattern}|[\\\\<>:"|?*]')
_DEVICE = re.compile(r"(^|/)(con|prn|aux|nul|(?:com|lpt)[0-9¹²³])(?=[./]|$)", re.IGNORECASE)
"""Names that Windows takes for devices, whatever their suffix."""


def fold_name(name: str) -> str:
    """Return a key that is equal for names which some disk takes for one file, such as `A.jpg` and `a.jpg`."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def distinct_names(wanted: Sequence[str], taken: Iterable[str] = ()) -> list[str]:
    """Return the names, with a number appended to those that some disk would take for an earlier one.

    The first of equal names keeps it. An appended number never gives a name that is wanted by another item, so the
    result depends on the names and their order alone.

    Args:
        wanted: Wanted names, in the order of their claims.
        taken: Further names that must not be used.
    """
    reserved = {fold_name(n) for n in (*wanted, *taken)}
    used = {fold_name(n) for n in taken}
    names = []
    for name in wanted:
        chosen = name
        number = 2
        while fold_name(chosen) in (used if chosen == name else reserved):
            chosen = f"{name}-{number}"
            number += 1
        used.add(fold_name(chosen))
        reserved.add(fold_name(chosen))
        names.append(chosen)
    return names


def escape_unfit(text: str, keep: str = "") -> str:
    r"""Return the text with characters that label files cannot hold written as escapes such as `\x01`.

    Args:
        text: Any text.
        keep: Characters to leave as they are.
    """
    return UNFIT.sub(lambda m: m[0] if m[0] in keep else m[0].encode("unicode_escape").decode("ascii"), text)


def fit_name(name: str) -> str:
    """Return a relative path with `_` for what label files cannot hold, or readers take for something else.

    These are control characters, blanks at either end of a stem, which lists of stems lose, backslashes, which some
    readers take for separators, and what Windows reserves: some characters, dots at the end, and names of devices,
    which get a `_` (`nul_.png`).
    """
    if not (_PLAIN.fullmatch(name) and ".." not in name and "./" not in name) or name.endswith("."):
        name = "/".join(_fit_part(part) for part in _NOT_IN_PATHS.sub("_", name).split("/"))
    return _DEVICE.sub(r"\1\2_", name)


def _fit_part(part: str) -> str:
    """Return one part of a path without blanks at the ends of the part and of its stem, and dots at its end."""
    if part in (".", ".."):
        return part
    whole = part.rstrip(".")
    part = whole + "_" * (len(part) - len(whole))
    stem, dot, suffix = part.rpartition(".") if "." in part[1:] else (part, "", "")
    return "".join(_EDGE_BLANKS.sub(lambda m: "_" * len(m[0]), p) + d for p, d in ((stem, dot), (suffix, "")))


def file_name(text: str) -> str:
    """Return a file name for a text from data, such as the name of a class: one part of a path, on any system.

    Separators, control characters and what Windows reserves become `_`, and names of devices get one (`nul_`). A name
    does not begin or end with a dot or a blank, and has at most 100 bytes. Different texts may give the same name; see
    `distinct_names`.
    """
    kept = "".join("_" if c in _RESERVED or not c.isprintable() else c for c in unicodedata.normalize("NFC", text))
    name = kept.encode("utf-8")[:100].decode("utf-8", "ignore").strip(" .") or "_"
    return _DEVICE.sub(r"\1\2_", name)


def leaves(name: str) -> bool:
    """Return whether a relative path from data leads out of its folder, on any system."""
    posix = PurePosixPath(name)
    windows = PureWindowsPath(name)
    climbs = ".." in posix.parts or ".." in windows.parts
    return climbs or "\0" in name or posix.is_absolute() or bool(windows.drive or windows.root)


def can_exist(path: str | Path) -> bool:
    """Return whether a file system can hold a file of this path, which may be from a damaged record."""
    try:
        whole = os.fsencode(path)
    except UnicodeEncodeError:  # half of a surrogate pair
        return False
    longest = max((len(os.fsencode(part)) for part in Path(path).parts), default=0)
    return len(whole) < MAX_PATH_BYTES and b"\0" not in whole and longest <= MAX_NAME_BYTES


def real_path(path: Path) -> Path:
    """Return the absolute path with all links followed, as far as they lead somewhere.

    `Path.resolve` raises RuntimeError for links in a circle, which nobody expects from a path.
    """
    return Path(os.path.realpath(path))


def is_inside(path: Path, folder: Path) -> bool:
    """Return whether a path is in or below `folder` once all links are followed."""
    return real_path(path).is_relative_to(real_path(folder))


def leaves_folder(path: Path, folder: Path | None = None) -> bool:
    """Return whether a file is a link out of the folder that owns it.

    Args:
        path: The file. That a folder above it is a link, for example to another disk, does not matter.
        folder: Folder that owns the file; by default the one that it is in.
    """
    if not path.is_symlink() or is_inside(path, path.parent):
        return False
    return folder is None or not is_inside(path, folder)


def join_inside(folder: Path, name: str) -> Path:
    """Return the path of a file below `folder` by a relative path from data; a `ValueError` if it leads out of it."""
    if leaves(name):
        raise ValueError(f"{name!r} leads out of {folder}")
    return folder / name


def is_text(name: str) -> bool:
    """Return False for a file name with bytes that are not UTF-8 (Python keeps them as lone surrogates)."""
    return name == as_text(name)


def as_text(name: str) -> str:
    """Return the name with bytes that are not UTF-8 written as escapes such as `\\udcff`."""
    return name.encode("utf-8", "backslashreplace").decode("utf-8")
