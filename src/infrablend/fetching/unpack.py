"""Unpack an untrusted zip, tar or tar.gz archive into a new folder, regular files only.

Nothing is ever written outside the folder. Links, devices, names that lead out of the folder, and archives that would
grow beyond the limits are refused.
"""

from __future__ import annotations

import contextlib
import gzip
import io
import os
import re
import shutil
import stat
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO

from infrablend.core.file_names import MAX_NAME_BYTES
from infrablend.core.files import output_error
from infrablend.errors import DatasetError, InfraBlendError, OutputError, Problem
from infrablend.formats.base import shorten

CHUNK_BYTES = 1 << 20  # of a single read; longer headers of a tar are refused
_DIRECTORY_BYTES = 64 << 20  # of a zip's list of entries, which is read whole
_GLOBAL_HEADERS = 100  # of a tar, which are kept
_TRAILING_BYTES = 64 << 20  # of padding after a tar's end
_ZIP_METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
# Files that other systems add beside the one folder that wraps everything.
_LITTER = re.compile(r"\.DS_Store|__MACOSX|\._.*|Thumbs\.db")

# Exceptions of the libraries on bytes that are not an archive, or a damaged one.
_DAMAGE = (
    zipfile.BadZipFile,
    tarfile.TarError,
    zlib.error,
    struct.error,
    EOFError,
    ValueError,
    ArithmeticError,
    LookupError,
    RuntimeError,
)

OnFiles = Callable[[int, int | None], None]
"""Called with the number of files written and of all files, None if the archive does not state it."""


@dataclass(frozen=True)
class Limits:
    """Limits on the contents of an archive.

    Attributes:
        total_bytes: Size of all files together.
        files: Number of files and folders.
        ratio: Unpacked bytes per packed byte.
        free_bytes: Unpacked size up to which the ratio does not apply.
    """

    total_bytes: int = 200 * 10**9
    files: int = 500_000
    ratio: float = 50.0
    free_bytes: int = 16 * 10**6


@dataclass(frozen=True)
class Unpacked:
    """Number and size of the files, and the git commit that the archive names as its source, if any."""

    files: int
    size_bytes: int
    commit: str | None = None


@dataclass(frozen=True)
class _Entry:
    """A file or folder of an archive; `refused` is the reason if it must not be unpacked."""

    name: str
    size_bytes: int
    folder: bool
    refused: str
    open: Callable[[], IO[bytes]]


@dataclass(frozen=True)
class _Contents:
    """What an opened archive contains.

    Attributes:
        entries: Files and folders in order.
        count: Number of entries, if known beforehand.
        size_bytes: Size of all files, if known beforehand.
        commit: Returns the git commit of which the archive is a copy, once all entries have been read.
    """

    entries: Iterator[_Entry]
    count: int | None
    size_bytes: int | None
    commit: Callable[[], str | None]


@dataclass(frozen=True)
class _SizeLimit:
    """Limit on the unpacked size of an archive."""

    archive: Path
    packed_bytes: int
    limits: Limits

    def require(self, size_bytes: int) -> None:
        """Raise DatasetError if the contents are larger than allowed."""
        most = max(int(self.packed_bytes * self.limits.ratio), self.limits.free_bytes)
        most = min(self.limits.total_bytes, most)
        if size_bytes > most:
            found = f"{self.packed_bytes} bytes would become {size_bytes} or more"
            raise _refusal(self.archive, "archive-grows", found, f"at most {most}")

    def require_count(self, count: int, found: str) -> None:
        """Raise DatasetError if there are more entries than allowed."""
        if count > self.limits.files:
            raise _refusal(self.archive, "too-many-files", found, f"at most {self.limits.files}")


def unpack(archive: Path, folder: Path, limits: Limits | None = None, on_files: OnFiles | None = None) -> Unpacked:
    """Unpack `archive` into `folder`, which must not exist; on any error the folder is removed again.

    Raises:
        DatasetError: The file is damaged, is not an archive, or contains entries that must not be unpacked: all of
            them are listed for a zip, the first one for a tar.
        OutputError: The disk failed.
    """
    try:
        growth = _SizeLimit(archive, archive.stat().st_size, limits or Limits())
        with _opened(archive, folder) as contents:
            if contents.count is not None:
                growth.require_count(contents.count, f"{contents.count} entries")
            if contents.size_bytes is not None:
                growth.require(contents.size_bytes)
                require_room(folder.parent, contents.size_bytes)
            with _disk(folder):
                folder.mkdir(parents=True)
            try:
                files, written = _write(folder, contents, growth, on_files)
            except BaseException:
                shutil.rmtree(folder, ignore_errors=True)
                raise
            return Unpacked(files, written, contents.commit())
    except _DAMAGE as error:
        if isinstance(error, InfraBlendError):
            raise
        raise _damaged(archive, str(error)) from error
    except OSError as error:
        if isinstance(error, InfraBlendError):
            raise
        # Disk errors are already OutputErrors, so this is a position outside the archive or an error of gzip.
        raise _damaged(archive, error.strerror or str(error)) from error


def _write(folder: Path, contents: _Contents, growth: _SizeLimit, on_files: OnFiles | None) -> tuple[int, int]:
    """Write every entry; return the number of files and of bytes."""
    archive = growth.archive
    files = written = 0
    for seen, entry in enumerate(contents.entries, 1):
        growth.require_count(seen, f"more than {growth.limits.files} entries")
        if entry.refused:
            raise _refusal(archive, "archive-entry", f"{entry.name!r}: {entry.refused}", "plain files and folders")
        # Neither library returns more bytes of an entry than it announces.
        growth.require(written + entry.size_bytes)
        target = folder.joinpath(*_parts(entry.name))
        try:
            with _disk(target):
                (target if entry.folder else target.parent).mkdir(parents=True, exist_ok=True)
                if entry.folder:
                    continue
                out = target.open("xb")
        except (FileExistsError, NotADirectoryError) as error:
            raise _refusal(
                archive, "archive-duplicate", f"{entry.name!r} collides with an earlier entry", "each name once"
            ) from error
        with _closed_safely(out, target), entry.open() as source:
            while chunk := source.read(CHUNK_BYTES):
                with _disk(target):
                    out.write(chunk)
            if out.tell() != entry.size_bytes:
                raise _damaged(archive, f"{entry.name!r} has {out.tell()} bytes, {entry.size_bytes} were announced")
        written += entry.size_bytes
        files += 1
        if on_files is not None:
            on_files(files, contents.count)
    return files, written


@contextlib.contextmanager
def _disk(path: Path) -> Iterator[None]:
    """Report errors as those of the disk and not of the archive, except for a name that already exists."""
    try:
        yield
    except (FileExistsError, NotADirectoryError):
        raise
    except OSError as error:
        raise output_error(path, error) from error


@contextlib.contextmanager
def _closed_safely(out: IO[bytes], path: Path) -> Iterator[None]:
    """Close a written file; writing the last bytes may fail on a full disk."""
    try:
        yield
    except BaseException:
        with contextlib.suppress(OSError):
            out.close()
        raise
    with _disk(path):
        out.close()


class _CappedReader(io.BufferedReader):
    """A file that refuses single reads above a limit.

    `zipfile` reads the list of an archive whole, and `tarfile` every long name, at the size that the archive announces.
    """

    def __init__(self, raw: io.RawIOBase, most: int, refusal: Callable[[int], Exception]) -> None:
        super().__init__(raw)
        self._most, self._refusal = most, refusal

    def read(self, size: int | None = -1, /) -> bytes:
        """Return at most `size` bytes.

        Raises:
            Exception: `size` is above the limit.
        """
        if size is not None and size > self._most:
            raise self._refusal(size)
        return super().read(size)


@contextlib.contextmanager
def _opened(archive: Path, folder: Path) -> Iterator[_Contents]:
    """Open an archive of any supported type; `folder` is where its entries will be written."""
    with archive.open("rb") as file:
        start = file.read(512)
    if start[:4] in {b"PK\x03\x04", b"PK\x05\x06"}:
        with _zip(archive) as contents:
            yield contents
    elif start[:2] == b"\x1f\x8b" or start[257:262] == b"ustar":
        with _tar(archive, folder, packed=start[:2] == b"\x1f\x8b") as contents:
            yield contents
    else:
        begins = "an HTML page" if b"<html" in start.lower() or b"<!doctype" in start.lower() else repr(start[:8])
        found = f"starts with {begins}" if start else "is empty"
        raise _refusal(archive, "archive-unknown", found, "a zip, tar or tar.gz file")


@contextlib.contextmanager
def _zip(archive: Path) -> Iterator[_Contents]:
    def too_large(size: int) -> Exception:
        found = f"a list of {size} bytes"
        return _refusal(archive, "too-many-files", found, f"a list of at most {_DIRECTORY_BYTES} bytes")

    with _CappedReader(io.FileIO(archive), _DIRECTORY_BYTES, too_large) as file, zipfile.ZipFile(file) as packed:
        entries = [_zip_entry(packed, info) for info in packed.infolist()]
        refused = [
            Problem(archive.name, "archive-entry", f"{e.name!r}: {e.refused}", "plain files and folders")
            for e in entries
            if e.refused
        ]
        if refused:
            message = f"{archive.name}: contains entries that must not be unpacked; nothing was written"
            raise DatasetError(message, shorten(refused))
        size_bytes = sum(e.size_bytes for e in entries)
        commit = _commit(packed.comment.decode("ascii", "replace"))
        yield _Contents(iter(entries), len(entries), size_bytes, lambda: commit)


def _zip_entry(packed: zipfile.ZipFile, info: zipfile.ZipInfo) -> _Entry:
    # The name in the file: ZipInfo cuts it at a NUL.
    name = info.orig_filename.replace("\\", "/")
    kind = stat.S_IFMT(info.external_attr >> 16) if info.create_system == 3 else 0
    refused = _bad_name(name)
    if kind not in {0, stat.S_IFREG, stat.S_IFDIR}:
        refused = "a link" if kind == stat.S_IFLNK else "not a plain file"
    elif info.flag_bits & 0x1:
        refused = "is encrypted"
    elif info.compress_type not in _ZIP_METHODS:
        refused = f"compression method {info.compress_type}, expected stored or deflated"
    folder = name.endswith("/") or kind == stat.S_IFDIR
    return _Entry(name, 0 if folder else info.file_size, folder, refused, lambda: packed.open(info))


@contextlib.contextmanager
def _tar(archive: Path, folder: Path, *, packed: bool) -> Iterator[_Contents]:
    def too_large(size: int) -> Exception:
        return tarfile.ReadError(f"a header of {size} bytes, expected at most {CHUNK_BYTES}")

    with contextlib.ExitStack() as stack:
        raw = stack.enter_context(gzip.GzipFile(archive) if packed else io.FileIO(archive))
        file = stack.enter_context(_CappedReader(raw, CHUNK_BYTES, too_large))  # type: ignore[arg-type] # GzipFile will do
        tar = stack.enter_context(tarfile.TarFile(fileobj=file))
        # git writes the commit into the global header.
        yield _Contents(
            _tar_entries(tar, file, folder), None, None, lambda: _commit(tar.pax_headers.get("comment", ""))
        )


def _tar_entries(tar: tarfile.TarFile, file: IO[bytes], folder: Path) -> Iterator[_Entry]:
    """Yield the entries one by one; iterating over the TarFile would keep every one of them in memory."""
    member, after = tar.next(), 0
    while member is not None:
        yield _Entry(
            member.name,
            0 if member.isdir() else member.size,
            member.isdir(),
            _tar_refusal(member, folder),
            partial(_tar_content, tar, member),
        )
        if len(tar.pax_headers) > _GLOBAL_HEADERS:
            raise tarfile.ReadError(f"more than {_GLOBAL_HEADERS} global headers")
        blocks = 0 if member.isdir() else -(-member.size // tarfile.BLOCKSIZE)
        after = member.offset_data + blocks * tarfile.BLOCKSIZE
        file.seek(after)
        try:
            member = tarfile.TarInfo.fromtarfile(tar)
        except tarfile.HeaderError:
            member = None
    _require_end(file, after)


def _tar_content(tar: tarfile.TarFile, member: tarfile.TarInfo) -> IO[bytes]:
    content = tar.extractfile(member)
    assert content is not None  # a regular file
    return content


def _tar_refusal(member: tarfile.TarInfo, folder: Path) -> str:
    """Return the reason not to write an entry, or an empty string if it may be written.

    This is stricter than `data_filter`, which keeps some links.
    """
    if member.issym() or member.islnk():
        return "a link"
    if not (member.isreg() or member.isdir()) or member.issparse():
        return "not a plain file"
    if reason := _bad_name(member.name):
        return reason
    try:
        tarfile.data_filter(member, str(folder))
    except tarfile.FilterError as error:
        return str(error)
    return ""


def _require_end(file: IO[bytes], position: int) -> None:
    """Check for the end mark, since a broken header looks like the end, and read on to verify gzip's checksum."""
    file.seek(position)
    if file.read(tarfile.BLOCKSIZE) != bytes(tarfile.BLOCKSIZE):
        raise tarfile.ReadError(f"neither a header nor the end at byte {position}")
    rest = 0
    while chunk := file.read(CHUNK_BYTES):
        rest += len(chunk)
        if rest > _TRAILING_BYTES:
            raise tarfile.ReadError(f"more than {_TRAILING_BYTES} bytes after its end")


def _parts(name: str) -> list[str]:
    return [p for p in name.split("/") if p not in {"", "."}]


def _bad_name(name: str) -> str:
    """Return the reason why a name is not a safe path below the folder, or an empty string if it is."""
    parts = _parts(name)
    if name.startswith("/") or re.match(r"[A-Za-z]:", name):
        return "an absolute path"
    if ".." in parts:
        return "a path that leads out of the folder"
    if re.search(r"[\x00-\x1f\x7f]", name):
        return "a name with control characters"
    if name != name.encode("utf-8", "replace").decode("utf-8"):
        return "a name that is not UTF-8"
    if any(len(p.encode()) > MAX_NAME_BYTES for p in parts) or len(name.encode()) > 2000:
        return "a name that is too long"
    return ""


def _commit(text: str) -> str | None:
    return text if re.fullmatch(r"[0-9a-f]{40}", text) else None


def require_room(folder: Path, size_bytes: int) -> None:
    """Raise OutputError unless the disk of `folder` has room for `size_bytes` and 50 MB more."""
    while not folder.exists():
        folder = folder.parent
    free = shutil.disk_usage(folder).free
    if free < size_bytes + 50_000_000:
        problem = Problem(
            str(folder),
            "disk-full",
            f"{free / 1e9:.2f} GB free",
            f"at least {(size_bytes + 50_000_000) / 1e9:.2f} GB",
            "free some space, or choose a folder on another disk; files that are complete are kept",
        )
        raise OutputError("not enough room on the disk", [problem])


def _refusal(archive: Path, code: str, found: str, expected: str) -> DatasetError:
    todo = "do not use this file; download it from its authors' page"
    return DatasetError(f"{archive.name}: not unpacked", [Problem(archive.name, code, found, expected, todo)])


def _damaged(archive: Path, why: str) -> DatasetError:
    problem = Problem(
        archive.name, "archive-damaged", f"is damaged or incomplete ({why})", "a complete zip, tar or tar.gz file"
    )
    return DatasetError(f"{archive.name}: cannot be unpacked", [problem])


def without_wrapper(folder: Path) -> Path:
    """Return the innermost folder that contains everything, since archives often wrap their content in folders."""
    while True:
        names = sorted(e.name for e in os.scandir(folder) if not _LITTER.fullmatch(e.name))
        if len(names) != 1 or not (folder / names[0]).is_dir():
            return folder
        folder = folder / names[0]
