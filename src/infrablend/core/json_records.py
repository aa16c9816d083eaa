"""Reads and composes JSON that is larger than memory, one record at a time, as `json.loads` and `json.dumps` do it.

A record is an item of a list, or a member of an object, at the top of the file or one level below.
"""

from __future__ import annotations

import codecs
import functools
import json
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NoReturn, TypeGuard

from infrablend.core.files import finite, open_regular
from infrablend.errors import DatasetError, Problem

MAX_RECORD = 16_000_000
"""Characters of a record; parsed, they take at most twenty times the memory. Smaller files are one record."""
MAX_DEPTH = 64
MAX_KEYS = 2_000_000
"""Members of an object: their keys are kept, because a key given twice would hide a record."""
NOT_JSON = "annotation-not-json"
TOO_LARGE = "annotation-too-large"

_CHUNK = 1 << 20
_SHORT = 1 << 20
"""Characters of a list that is kept in memory instead of being read again record by record."""
_TAIL = 12
"""Characters of the longest token that an end of the text can cut, `-Infinity`, `\\ud83d\\ude00` or 1e+0, and some."""
_DECODER = json.JSONDecoder()
_BLANKS = re.compile(r"[ \t\n\r]*")
_CLOSING = {"[": "]", "{": "}"}


@dataclass(frozen=True)
class _InFile:
    """List or object in a file.

    Attributes:
        path: The file.
        name: Name of the list in messages; empty for the top of the file.
        stamp: Identity, size and time of the file.
        start: Byte after the opening bracket.
        count: Number of items or members.
    """

    path: Path
    name: str
    stamp: tuple[int, ...]
    start: int
    count: int

    def __len__(self) -> int:
        """Return the number of items or members."""
        return self.count


class JsonList(_InFile):
    """List in a file, read anew each time it is iterated."""

    def __iter__(self) -> Iterator[Any]:
        """Yield the items.

        Raises:
            DatasetError: The file has been changed or removed since it was checked.
        """
        return (value for _, value in _read_again(self, "]"))


class JsonTable(_InFile):
    """Object in a file, whose members are read anew each time."""

    def items(self) -> Iterator[tuple[str, Any]]:
        """Yield the keys with their values.

        Raises:
            DatasetError: The file has been changed or removed since it was checked.
        """
        return ((str(key), value) for key, value in _read_again(self, "}"))


def is_list(value: object) -> TypeGuard[list[Any] | JsonList]:
    """Return whether a JSON value is a list, in memory or in a file."""
    return isinstance(value, list | JsonList)


def is_table(value: object) -> TypeGuard[dict[str, Any] | JsonTable]:
    """Return whether a JSON value is an object, in memory or in a file."""
    return isinstance(value, dict | JsonTable)


def open_json(path: Path) -> Any:
    """Check a whole JSON file and return its value, in which long lists and objects are `JsonList` and `JsonTable`.

    The top of the file, if it is an object, is a dictionary. A byte order mark is accepted.

    Raises:
        OSError: The file is missing, cannot be read, is no regular file, or is a link out of its folder.
        DatasetError: It is not JSON, nested more than `MAX_DEPTH` levels, or has a record of more than `MAX_RECORD`
            characters or an object of more than `MAX_KEYS` members.
    """
    with open_regular(path) as stream:
        stamp = _stamp(stream)
    value = _checked(path, stamp)
    return dict(value) if isinstance(value, dict) else value


def open_rows(path: Path) -> Any:
    """Like `open_json`, for files whose top is the long list or object: an object is a `JsonTable`, too."""
    with open_regular(path) as stream:
        return _check(path, stream, in_parts=False)


@functools.lru_cache(maxsize=8)
def _checked(path: Path, stamp: tuple[int, ...]) -> Any:
    """Return the value of a file that was checked before, so that detecting and reading it check it once."""
    with open_regular(path) as stream:
        return _check(path, stream, in_parts=True)


def _stamp(stream: BinaryIO) -> tuple[int, ...]:
    status = os.fstat(stream.fileno())
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


def _check(path: Path, stream: BinaryIO, *, in_parts: bool) -> Any:
    window = _Window(path, stream)
    value: Any = _check_parts(window) if in_parts and window.peek() == "{" else _check_value(window, "", 0)[0]
    if window.peek():
        window.fail("Extra data")
    return value


def _check_parts(window: _Window) -> dict[str, Any]:
    """Return an object whose members are records, or lists or objects of records."""
    found: dict[str, Any] = {}
    free = MAX_RECORD
    window.at += 1
    for key in _places(window, "}", ""):
        name = str(key)
        # Readers take objects such as `info` as a whole, and lists item by item.
        value, size = _check_value(window, name, free if window.peek() == "{" else min(free, _SHORT))
        free -= len(name) + size
        if free < 0:
            much = f"{MAX_RECORD / 1e6:g} MB of names and values at the top of the file"
            window.refuse(f"more than {much}", f"at most {much}", "use lists of records")
        found[name] = value
    return found


def _check_value(window: _Window, name: str, in_place: int) -> tuple[Any, int]:
    """Return a value and its number of characters; lists and objects of more than `in_place` stay in the file: 0."""
    window.level = 1 + bool(name)
    opening = window.peek()
    if opening not in _CLOSING:
        return window.value(name)
    closing = _CLOSING[opening]
    window.at += 1
    start = window.offset()
    count = 0
    size = 2
    kept: list[tuple[str | int, Any]] | None = []
    keys: set[str | int] = set()
    twice = ""
    for key in _places(window, closing, name):
        value, length = window.value(name, key)
        count += 1
        if closing == "}":
            length += len(str(key))
            if count > MAX_KEYS:
                found = f"an object of more than {MAX_KEYS} members{_in(name, None)}"
                window.refuse(found, f"at most {MAX_KEYS} members", "use a list")
            twice = twice or (str(key) if key in keys else "")
            keys.add(key)
        if kept is not None:
            kept.append((key, value))
            size += length + 1
            if size > in_place:
                kept = None
    if kept is not None:
        return (dict(kept) if closing == "}" else [value for _, value in kept]), size
    if twice:
        window.fail("two members of one name", name, twice)
    kind = JsonTable if closing == "}" else JsonList
    return kind(window.path, name, _stamp(window.stream), start, count), 0


def _places(window: _Window, closing: str, name: str) -> Iterator[str | int]:
    """Yield the index or key of each item of a list or object, with the window at its value, which is then read."""
    n = 0
    if window.peek() == closing:
        window.at += 1
        return
    while True:
        if closing == "}":
            if window.peek() != '"':
                window.fail("Expecting property name enclosed in double quotes", name, n)
            key = window.value(name, n)[0]
            if window.peek() != ":":
                window.fail("Expecting ':' delimiter", name, key)
            window.at += 1
            window.peek()
            yield key
        else:
            yield n
        n += 1
        sign = window.peek()
        if sign not in (closing, ",") or not sign:
            window.fail("Expecting ',' delimiter", name, n)
        window.at += 1
        if sign == closing:
            return
        window.peek()


def _read_again(part: JsonList | JsonTable, closing: str) -> Iterator[tuple[str | int, Any]]:
    try:
        with open_regular(part.path) as stream:
            if _stamp(stream) != part.stamp:
                raise OSError(f"was changed while {part.name or 'it'} was read")
            window = _Window(part.path, stream, part.start)
            window.level = 1 + bool(part.name)
            for key in _places(window, closing, part.name):
                yield key, window.value(part.name, key)[0]
    except OSError as error:
        found = error.strerror or str(error)
        problem = Problem(part.path.name, "annotation-missing", found, "the file that was checked before", "try again")
        raise DatasetError(f"{part.path}: {found}", [problem]) from error


class _Window:
    """Part of a JSON file that is in memory.

    Attributes:
        path: The file.
        stream: The file, open.
        text: The part.
        at: Place in the text.
        level: Number of lists and objects around the records.
    """

    def __init__(self, path: Path, stream: BinaryIO, start: int = 0) -> None:
        self.path = path
        self.stream = stream
        self.text = ""
        self.at = 0
        self.level = 0
        self._decoder = codecs.getincrementaldecoder("utf-8")()
        self._ended = False
        if start == 0 and stream.read(len(codecs.BOM_UTF8)) == codecs.BOM_UTF8:
            start = len(codecs.BOM_UTF8)
        stream.seek(start)
        self._counted_to = 0
        self._offset = start

    def offset(self) -> int:
        """Return the byte of the file that the place in the text is at."""
        self._offset += len(self.text[self._counted_to : self.at].encode())
        self._counted_to = self.at
        return self._offset

    def peek(self) -> str:
        """Move to the next character that is no blank and return it; empty at the end of the file."""
        while True:
            if self.at < len(self.text):
                sign = self.text[self.at]
                if sign not in " \t\n\r":
                    return sign
                blanks = _BLANKS.match(self.text, self.at)
                self.at = blanks.end() if blanks else self.at
            elif not self._go_on():
                return ""

    def value(self, name: str, key: str | int | None = None) -> tuple[Any, int]:
        """Move behind the value at this place; return it and its number of characters."""
        while True:
            try:
                value, end = _DECODER.raw_decode(self.text, self.at)
            except json.JSONDecodeError as error:
                cut = error.pos + _TAIL > len(self.text) or error.msg.startswith("Unterminated string")
                if self._ended or not cut:
                    self.at = error.pos
                    self.fail(error.msg, name, key)
            except RecursionError:
                self._fail_nested(name, key)
            except ValueError as error:  # a number of too many digits
                self.fail(str(error), name, key)
            else:
                # A number at the end of the text may go on; anything else ends with a sign of its own.
                if self._ended or self.text[end - 1] in '}]"' or end + _TAIL <= len(self.text):
                    break
            if len(self.text) - self.at > MAX_RECORD:
                self._refuse_record(name, key)
            self._go_on()
        size = end - self.at
        if size > MAX_RECORD:
            self._refuse_record(name, key)
        inner = self.text.count("[", self.at, end) + self.text.count("{", self.at, end)
        if inner + self.level > MAX_DEPTH and depth(value) + self.level > MAX_DEPTH:
            self._fail_nested(name, key)
        self.at = end
        return value, size

    def fail(self, why: str, name: str = "", key: str | int | None = None) -> NoReturn:
        """Raise the error for text that is not JSON."""
        found = f"not JSON ({why.removesuffix(' at')} at byte {self.offset()}{_in(name, key)})"
        raise _error(self.path, NOT_JSON, found, "a JSON file", "fetch the file again or leave it out")

    def refuse(self, found: str, expected: str, todo: str) -> NoReturn:
        """Raise the error for a part of the file that takes too much memory."""
        raise _error(self.path, TOO_LARGE, found, expected, todo)

    def _refuse_record(self, name: str, key: str | int | None) -> NoReturn:
        found = f"a record of more than {MAX_RECORD / 1e6:g} MB at byte {self.offset()}{_in(name, key)}"
        self.refuse(found, f"at most {MAX_RECORD / 1e6:g} MB a record", "shorten it or leave it out")

    def _fail_nested(self, name: str, key: str | int | None) -> NoReturn:
        raise too_deep(self.path, f" at byte {self.offset()}{_in(name, key)}")

    def _go_on(self) -> bool:
        """Forget the text before this place and read more behind it; return False at the end of the file."""
        if self._ended:
            return False
        self.offset()
        rest = self.text[self.at :]
        data = self.stream.read(max(_CHUNK, min(len(rest), MAX_RECORD + _TAIL - len(rest))))
        self._ended = not data
        self.at = self._counted_to = 0
        try:
            self.text = rest + self._decoder.decode(data, final=self._ended)
        except UnicodeDecodeError as error:
            self.fail(f"not UTF-8: {error.reason} within the {len(rest) + len(data)} bytes")
        return True


def too_deep(path: Path, where: str = "") -> DatasetError:
    """Return the error for lists in lists, or objects, beyond `MAX_DEPTH`."""
    found = f"lists and objects nested too deeply{where}"
    return _error(path, NOT_JSON, found, f"at most {MAX_DEPTH} levels", "fetch the file again")


def depth(value: Any) -> int:
    """Return the nesting depth of lists and objects, counted up to one level more than allowed."""
    level = [value] if type(value) in (dict, list) else []
    found = 0
    while level and found <= MAX_DEPTH:
        inner: list[Any] = []
        for v in level:
            inside = v.values() if type(v) is dict else v
            inner += [w for w in inside if type(w) in (dict, list)]
        level = inner
        found += 1
    return found


def _in(name: str, key: str | int | None) -> str:
    where = name[:80] if key is None else f"{name[:80]}[{json.dumps(key)[:80]}]"
    return f", in {where}" if where else ""


def _error(path: Path, code: str, found: str, expected: str, todo: str) -> DatasetError:
    return DatasetError(f"{path}: {found}", [Problem(path.name, code, found, expected, todo)])


COMPACT = (",", ":")
SPACED = (", ", ": ")
"""Separators of items and of keys: without blanks, and those that `json.dumps` uses unless told otherwise."""


@dataclass(frozen=True)
class Streamed:
    """List whose items are composed one at a time.

    Attributes:
        items: The items, iterated once.
    """

    items: Iterable[Any]


def json_chunks(
    value: Any, losses: Counter[str] | None, *, separators: tuple[str, str] = COMPACT, sort_keys: bool = True
) -> Iterator[str]:
    """Yield the text that `json.dumps` would return, in pieces of one item of a streamed list each.

    Args:
        value: JSON values, with `Streamed` lists at the top or as values of a top-level object.
        losses: Counts non-finite numbers, which are written as null, see `finite`; None refuses them.
        separators: Separators of items and of keys.
        sort_keys: Whether to sort the keys of objects; otherwise they keep their order.

    Raises:
        ValueError: A number is not finite, and `losses` is None.
    """

    def text(part: Any) -> str:
        try:
            return json.dumps(part, sort_keys=sort_keys, allow_nan=False, separators=separators)
        except ValueError:
            if losses is None:
                raise
        return json.dumps(finite(part, losses), sort_keys=sort_keys, allow_nan=False, separators=separators)

    if isinstance(value, Streamed):
        yield "["
        for n, item in enumerate(value.items):
            yield (separators[0] if n else "") + text(item)
        yield "]"
    elif isinstance(value, Mapping):
        yield "{"
        for n, key in enumerate(sorted(value) if sort_keys else value):
            yield (separators[0] if n else "") + json.dumps(key) + separators[1]
            if isinstance(value[key], Streamed):
                yield from json_chunks(value[key], losses, separators=separators, sort_keys=sort_keys)
            else:
                yield text(value[key])
        yield "}"
    else:
        yield text(value)
