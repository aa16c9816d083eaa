"""Read annotation files that may be damaged or hostile: JSON, XML and text, within size limits."""

from __future__ import annotations

import codecs
import json
import re
import stat
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from defusedxml import ElementTree
from defusedxml.common import DefusedXmlException

from infrablend.core.file_names import leaves_folder
from infrablend.core.files import LFS_POINTER, open_regular, or_lfs_pointer
from infrablend.core.json_records import (
    MAX_DEPTH,
    MAX_RECORD,
    NOT_JSON,
    TOO_LARGE,
    JsonList,
    JsonTable,
    depth,
    open_json,
    open_rows,
    too_deep,
)
from infrablend.errors import DatasetError, Problem

# Larger files are refused unread: parsed, they would take about thirty times the memory.
MAX_TEXT_BYTES = 50_000_000
WHOLE_JSON = MAX_RECORD
"""Bytes of the largest JSON file that is parsed as a whole, which is a little faster."""
_DECLARED = re.compile(rb"""<\?xml[^>]{1,80}encoding\s*=\s*["']([\w.-]{1,40})["']""", re.ASCII)
_MULTI_BYTE = re.compile(r"gb|hz|big5|euc|shift|cp9|johab|iso2022|utf")
_WITH_MORE = {"gb2312": "gb18030", "gbk": "gb18030", "shift_jis": "cp932", "euc_kr": "cp949"}
_WESTERN = (b"iso-8859-1", b"latin-1", b"latin1", b"windows-1252", b"cp1252")
_THREE_BYTES = "\u0800"
_files_read: ContextVar[set[Path] | None] = ContextVar("files_read", default=None)


@contextmanager
def noting_files_read() -> Iterator[set[Path]]:
    """Collect the files that are read without a problem within the block: others say nothing yet.

    Among them are the pictures whose sizes are read, because no label states them.
    """
    files: set[Path] = set()
    token = _files_read.set(files)
    try:
        yield files
    finally:
        _files_read.reset(token)


def note_read(path: Path) -> None:
    """State that a file was read, or of a picture that its size was."""
    files = _files_read.get()
    if files is not None:
        files.add(path)


def leave_out(files: Iterable[Path]) -> None:
    """State that a reader knows what files are, and that nothing of them was wanted."""
    for path in files:
        note_read(path)


def only_looked_at(path: Path) -> None:
    """State that a file was read to see what it is, and is not what was looked for: nothing of it was taken."""
    files = _files_read.get()
    if files is not None:
        files.discard(path)


def _refusal_to_open(path: Path, where: str, expected: str, limit: int | None) -> Problem | None:
    """Return why a file must not be opened: a link out of its folder, not a regular file, or too large."""
    if leaves_folder(path):
        found = f"{path.name!r} is a link out of its folder"
        todo = "copy the file, or link the whole folder instead"
        return Problem(where, "name-climbs", found, "a file inside it", todo)
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        return Problem(where, "annotation-unreadable", "not a regular file", expected, "replace or remove it")
    if limit is None or status.st_size <= limit:
        return None
    found = f"{status.st_size / 1e6:.0f} MB of text"
    most = f"at most {limit / 1e6:.0f} MB"
    return Problem(where, "annotation-too-large", found, most, "split it into several files")


def read_json(path: Path, *, rows: bool = False) -> Any:
    """Return the JSON value in a UTF-8 file (a byte order mark is accepted).

    Files of more than `WHOLE_JSON` bytes are checked, but not kept in memory: lists and objects one level below the top
    are then `JsonList` and `JsonTable`, and so is a list at the top.

    Args:
        path: The file.
        rows: Whether the members of an object at the top are the records: it is then a `JsonTable`, too.

    Raises:
        DatasetError: The file is missing, unreadable, not JSON, a link out of its folder, nested more than `MAX_DEPTH`
            levels, or a record takes more than `MAX_RECORD` characters.
    """
    expected = "a JSON file"
    todo = "fetch the file again or leave it out"
    try:
        problem = _refusal_to_open(path, path.name, expected, None)
        if problem is None:
            value = _whole(path) if path.stat().st_size <= WHOLE_JSON else (open_rows if rows else open_json)(path)
            note_read(path)
            return value
    except OSError as error:
        problem = Problem(path.name, "annotation-missing", error.strerror or str(error), expected, todo)
    except ValueError as error:
        if isinstance(error, DatasetError):
            raise
        problem = Problem(path.name, NOT_JSON, f"not JSON ({error or type(error).__name__})", expected, todo)
        problem = or_lfs_pointer(problem, path)
    raise DatasetError(f"{path}: {problem.found}", [problem])


def too_long(where: str, name: str, value: object) -> Problem | None:
    """Return the warning about a part of a JSON file that can only be kept in memory, and is too long for it."""
    if not isinstance(value, JsonList | JsonTable):
        return None
    found = f"{name!r} of {len(value)} entries, left out"
    return Problem(where, TOO_LARGE, found, f"at most {MAX_RECORD / 1e6:g} MB", "shorten it", "warning")


def _whole(path: Path) -> Any:
    with open_regular(path) as stream:
        data = stream.read(WHOLE_JSON + 1)
    if len(data) > WHOLE_JSON:
        raise ValueError("grew while it was read")
    try:
        value = json.loads(data.decode("utf-8-sig"))
    except RecursionError:
        raise too_deep(path) from None
    if data.count(b"[") + data.count(b"{") > MAX_DEPTH < depth(value):
        raise too_deep(path)
    return value


def read_lines(path: Path, where: str, expected: str, problems: list[Problem]) -> Iterator[tuple[int, str]]:
    """Yield the number and text of each UTF-8 line that is not blank, one in memory at a time (JSON Lines).

    Args:
        path: The file.
        where: Name of the file in problems.
        expected: What a line is, in problems.
        problems: List to which the problems of the file and of lines that are left out are appended.
    """
    try:
        if problem := _refusal_to_open(path, where, expected, None):
            problems.append(problem)
            return
        with open_regular(path) as stream:
            note_read(path)
            number = 0
            while line := stream.readline(MAX_RECORD + 1):
                number += 1
                here = f"{where}: line {number}"
                todo = "correct the line"
                if len(line) > MAX_RECORD:
                    found = f"more than {MAX_RECORD / 1e6:g} MB"
                    most = f"at most {MAX_RECORD / 1e6:g} MB a line"
                    problems.append(Problem(here, TOO_LARGE, found, most, todo))
                    while line and not line.endswith(b"\n"):
                        line = stream.readline(MAX_RECORD)
                    continue
                try:
                    text = line.decode("utf-8-sig" if number == 1 else "utf-8").strip()
                except UnicodeDecodeError as error:
                    problems.append(Problem(here, NOT_JSON, f"not UTF-8 ({error.reason})", expected, todo))
                    continue
                if number == 1 and text.startswith(LFS_POINTER.decode()):
                    problems.append(or_lfs_pointer(Problem(where, NOT_JSON, "", expected), path))
                    return
                if text:
                    yield number, text
    except OSError as error:
        found = f"cannot be read ({error.strerror or error})"
        problems.append(Problem(where, "annotation-unreadable", found, expected, "replace or remove it"))


def files_with(
    root: Path, pattern: str, is_ours: Callable[[bytes], bool], head_bytes: int, most: int | None = None
) -> list[Path]:
    """Return the files in a folder whose first bytes are those of a format, sorted; no links out of the folder.

    Only the first `most` files with any text are looked at.
    """
    found = []
    looked_at = 0
    for path in (p for p in sorted(root.glob(pattern)) if not leaves_folder(p)):
        if looked_at == most:
            break
        with suppress(OSError), open_regular(path) as stream:
            head = as_utf8(stream.read(head_bytes))
            looked_at += bool(head.strip())
            found += [path] if is_ours(head) else []
    return found


def as_utf8(text: bytes) -> bytes:
    """Return the start of a text in UTF-8 if it is in UTF-16, which the mark or a zero in its first bytes tells."""
    marked = text.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    if not marked and b"\0" not in text[:2]:
        return text
    return text.decode("utf-16" if marked else "utf-16-be" if text[:1] == b"\0" else "utf-16-le", "ignore").encode()


def read_text(path: Path, where: str, expected: str) -> tuple[str, Problem | None]:
    """Return the UTF-8 text of a file (a byte order mark is accepted), or an empty text and the problem."""
    try:
        problem = _refusal_to_open(path, where, expected, MAX_TEXT_BYTES)
        if problem is not None:
            return "", problem
        text = path.read_text(encoding="utf-8-sig")
        if text.startswith(LFS_POINTER.decode()):
            return "", or_lfs_pointer(Problem(where, "annotation-unreadable", "", expected), path)
        note_read(path)
        return text, None
    except (OSError, UnicodeDecodeError) as error:
        found = f"not text ({getattr(error, 'strerror', None) or type(error).__name__})"
    return "", Problem(where, "annotation-unreadable", found, expected, "replace or remove it")


def read_xml(path: Path, where: str) -> tuple[Any, Problem | None]:
    """Return the root element of an XML file, or None and the problem; entities and DTDs are refused as unsafe."""
    try:
        problem = _refusal_to_open(path, where, "an XML file", MAX_TEXT_BYTES)
        if problem is None:
            top = _xml_root(path)
            note_read(path)
            return top, None
        return None, problem
    except DefusedXmlException:
        found = "XML with a document type or entities, which are refused: they can fill the memory or name other files"
        todo = "remove `<!DOCTYPE ...>`"
    except ElementTree.ParseError as error:
        found = f"damaged XML ({error})"
        todo = "fetch it again"
    except OSError as error:
        found = f"cannot be read ({error.strerror or 'unknown reason'})"
        todo = "check the file and its permissions"
    except (UnicodeError, LookupError) as error:
        found = f"XML that is not in the encoding it declares ({error})"[:200]
        likely = _likely_encoding(path)
        todo = (
            f"write it in UTF-8, as with `iconv -f {likely} -t UTF-8 {path.name}` if it is in that, and declare UTF-8"
        )
    except Exception as error:  # nesting without end
        found = f"XML that cannot be read ({error})"[:200].replace(str(path), path.name)
        todo = "fetch it again"
    return None, or_lfs_pointer(Problem(where, "annotation-not-xml", found, "an XML file with labels", todo), path)


def _xml_root(path: Path) -> Any:
    """Return the root element of an XML file; files in encodings that the parser does not know are decoded first.

    Raises:
        UnicodeError: It is not in its encoding.
        LookupError: Its encoding is unknown.
        Exception: What the parser raises.
    """
    data = path.read_bytes()
    body = data.removeprefix(codecs.BOM_UTF8)
    declared = _DECLARED.match(body)
    if declared and not body.isascii() and (body != data or _is_utf8(body, declared[1])):
        return ElementTree.fromstring(body.decode().partition("?>")[2], forbid_dtd=True)
    try:
        return ElementTree.fromstring(data, forbid_dtd=True)
    except ElementTree.ParseError:
        if declared is None or declared[1].lower() in (b"utf-8", b"utf8"):
            as_utf8(body).decode()  # another encoding explains what the parser stumbled over
        raise
    except (ValueError, LookupError):  # several bytes a character, or a name that is unknown
        name = codecs.lookup(declared[1].decode()).name if declared else ""
        if not _MULTI_BYTE.match(name):
            raise
        # What Windows calls GB2312 or Shift JIS has more characters.
        text = data.decode(_WITH_MORE.get(name, name))
        return ElementTree.fromstring(text.partition("?>")[2], forbid_dtd=True)


def _is_utf8(text: bytes, declared: bytes) -> bool:
    """Return whether a text is in UTF-8 beyond doubt, whatever it declares: a tool has converted its bytes alone.

    Two bytes of UTF-8 may be a character of GB2312, but hardly two letters of Western Europe; three are no such text.
    """
    try:
        beyond_ascii = {c for c in text.decode() if not c.isascii()}
    except UnicodeError:
        return False
    return declared.lower() in _WESTERN or min(beyond_ascii) >= _THREE_BYTES


def _likely_encoding(path: Path) -> str:
    """Return the name, as iconv knows it, of what a text that is not in UTF-8 is probably in."""
    try:
        path.read_bytes().decode("gb2312")
    except (OSError, UnicodeError):
        return "WINDOWS-1252"
    return "GB18030"


def child_text(element: Any, key: str) -> str | None:
    """Return the text of an XML element's child without blanks around it; None without one."""
    value = element.findtext(key)
    return value.strip() if value is not None else None


# -- CSV files of different countries ------------------------------------------------------------------------------

_DECIMAL_POINT = re.compile(r"[-+]?\d+\.\d+", re.ASCII)
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+", re.ASCII)
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(?:,\d{3})+", re.ASCII)
# Characters that are searched for separators, and rows for decimal points and commas.
_LINE_CHARACTERS = 20_000
_ROWS = 200


def delimiter_of(text: str, lines: int = 1) -> str:
    """Return what separates columns: what occurs most often in the first lines, comma, semicolon or tab."""
    start = "\n".join(text[:_LINE_CHARACTERS].splitlines()[:lines])
    return max(",;\t", key=start.count)


def titles_of(head: bytes) -> set[str]:
    """Return the titles of the columns of a table, from its first bytes."""
    line = head.decode("utf-8-sig", "ignore").partition("\n")[0]
    return {title.strip(' "\r') for title in line.split(delimiter_of(line))}


def comma_of(rows: Sequence[Sequence[str]], delimiter: str) -> str:
    """Return what stands for a comma in numbers: nothing where it separates thousands, else a decimal point.

    Args:
        rows: Cells of the table; some rows are looked at.
        delimiter: What separates its columns.
    """
    cells = [cell.strip() for row in rows[:: max(1, len(rows) // _ROWS)] for cell in row]
    if any(_DECIMAL_POINT.fullmatch(c) for c in cells):
        return ""
    decimal = any(_DECIMAL_COMMA.fullmatch(c) and not _THOUSANDS.fullmatch(c) for c in cells)
    return "." if decimal or delimiter != "," else ""
