"""Read annotation files that may be damaged or hostile: JSON, XML and text, within size limits."""

from __future__ import annotations

import json
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from defusedxml import ElementTree

from infrablend.core.file_names import leaves_folder
from infrablend.errors import DatasetError, Problem

# Larger files are refused unread: parsed, they would take about thirty times the memory.
MAX_JSON_BYTES = 200_000_000
MAX_TEXT_BYTES = 50_000_000
# An empty list takes three bytes of text and sixty of memory; COCO's largest file has about four million lists.
MAX_JSON_LISTS = 10_000_000
MAX_JSON_DEPTH = 64
_understood: ContextVar[set[Path] | None] = ContextVar("understood", default=None)


@contextmanager
def noting_understood() -> Iterator[set[Path]]:
    """Collect the JSON and XML files that are read without a problem within the block, so that none is read again."""
    files: set[Path] = set()
    token = _understood.set(files)
    try:
        yield files
    finally:
        _understood.reset(token)


def _note(path: Path) -> None:
    files = _understood.get()
    if files is not None:
        files.add(path)


def _refusal_to_open(path: Path, where: str, expected: str, limit: int) -> Problem | None:
    """Return why a file must not be opened: a link out of its folder, not a regular file, or too large."""
    if leaves_folder(path):
        found, todo = f"{path.name!r} is a link out of its folder", "copy the file, or link the whole folder instead"
        return Problem(where, "name-climbs", found, "a file inside it", todo)
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        return Problem(where, "annotation-unreadable", "not a regular file", expected, "replace or remove it")
    if status.st_size <= limit:
        return None
    found, most = f"{status.st_size / 1e6:.0f} MB of text", f"at most {limit / 1e6:.0f} MB"
    return Problem(where, "annotation-too-large", found, most, "split it into several files")


def read_json(path: Path) -> Any:
    """Return the JSON value in a UTF-8 file (a byte order mark is accepted).

    Raises:
        DatasetError: The file is missing, unreadable, not JSON, a link out of its folder, or exceeds `MAX_JSON_BYTES`,
            `MAX_JSON_LISTS` or `MAX_JSON_DEPTH`.
    """
    problem = None
    try:
        problem = _refusal_to_open(path, path.name, "a JSON file", MAX_JSON_BYTES)
        data = path.read_bytes() if problem is None else b""
        lists = data.count(b"[") + data.count(b"{")
        if lists > MAX_JSON_LISTS:
            found, expected = f"{lists} lists and objects", f"at most {MAX_JSON_LISTS}"
            problem = Problem(path.name, "annotation-too-large", found, expected, "split it into several files")
        if problem is None:
            value = json.loads(data.decode("utf-8-sig"))
            if lists <= MAX_JSON_DEPTH or _depth(value) <= MAX_JSON_DEPTH:
                _note(path)
                return value
            problem = _nested(path)
    except OSError as error:
        found = error.strerror or str(error)
        problem = Problem(path.name, "annotation-missing", found, "a JSON file", "fetch the file again or leave it out")
    except RecursionError:
        problem = _nested(path)
    except ValueError as error:
        found = f"not JSON ({error or type(error).__name__})"
        problem = Problem(
            path.name, "annotation-not-json", found, "a JSON file", "fetch the file again or leave it out"
        )
    raise DatasetError(f"{path}: {problem.found}", [problem])


def _nested(path: Path) -> Problem:
    found = "lists and objects nested too deeply"
    return Problem(path.name, "annotation-not-json", found, f"at most {MAX_JSON_DEPTH} levels", "fetch the file again")


def _depth(value: Any) -> int:
    """Return the nesting depth of lists and objects, counted up to one level more than allowed."""
    level, depth = [value], 0
    while level and depth <= MAX_JSON_DEPTH:
        inner: list[Any] = []
        for v in level:
            inside = v.values() if type(v) is dict else v if type(v) is list else ()
            inner += [w for w in inside if type(w) in (dict, list)]
        level, depth = inner, depth + 1
    return depth


def read_text(path: Path, where: str, expected: str) -> tuple[str, Problem | None]:
    """Return the UTF-8 text of a file (a byte order mark is accepted), or an empty text and the problem."""
    try:
        problem = _refusal_to_open(path, where, expected, MAX_TEXT_BYTES)
        return ("", problem) if problem else (path.read_text(encoding="utf-8-sig"), None)
    except (OSError, UnicodeDecodeError) as error:
        found = f"not text ({getattr(error, 'strerror', None) or type(error).__name__})"
    return "", Problem(where, "annotation-unreadable", found, expected, "replace or remove it")


def read_xml(path: Path, where: str) -> tuple[Any, Problem | None]:
    """Return the root element of an XML file, or None and the problem; entities and DTDs are refused as unsafe."""
    try:
        problem = _refusal_to_open(path, where, "an XML file", MAX_TEXT_BYTES)
        if problem is None:
            top = ElementTree.parse(path, forbid_dtd=True).getroot()
            _note(path)
            return top, None
        return None, problem
    except Exception as error:  # parse errors, refused entities, wrong encodings
        found = f"not safe XML ({type(error).__name__}: {error})"[:200].replace(str(path), path.name)
    return None, Problem(where, "annotation-not-xml", found, "a VOC or roLabelImg file", "fetch it again")
