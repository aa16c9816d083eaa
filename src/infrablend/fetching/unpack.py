"""Unpacking an archive that nobody vouches for: zip, tar or tar.gz into a new folder, regular files only.

Nothing is ever written outside the folder. Links and devices are refused, not followed; so are names that climb, and
archives that would grow beyond reason.
"""

from __future__ import annotations

import contextlib
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
from pathlib import Path
from typing import IO

from infrablend.core.files import output_error
from infrablend.errors import DatasetError, InfraBlendError, OutputError, Problem
from infrablend.formats.base import shorten

CHUNK_BYTES = 1 << 20
_DIRECTORY_BYTES = 64 << 20  # of a zip's own list, which is read whole
_HEADER_BYTES = 64 << 10  # of a tar's long names, which are read whole
_TRAILING_BYTES = 64 << 20  # after a tar's end: padding
_ZIP_METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
# What packing on other systems leaves beside the one folder that wraps everything.
_LITTER = re.compile(r"\.DS_Store|__MACOSX|\._.*|Thumbs\.db")

# What the libraries raise on bytes that are no archive, or no longer one.
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
"""Called with the files written and their number, None if the archive does not say it."""


@dataclass(frozen=True)
class Limits:
    """What an archive may become.

    Attributes:
        total_bytes: All files together.
        files: Files and folders.
        ratio: Unpacked bytes for each packed one.
        free_bytes: Below this the ratio does not matter.
    """

    total_bytes: int = 200 * 10**9
    files: int = 500_000
    ratio: float = 50.0
    free_bytes: int = 16 * 10**6


@dataclass(frozen=True)
class Unpacked:
    """What came out: files, their bytes, and the git commit the archive says it is a picture of, if it says one."""

    files: int
    size_bytes: int
    commit: str | None = None


@dataclass(frozen=True)
class _Entry:
    """A file or folder of an archive; `refused` says why it is neither."""

    name: str
    size_bytes: int
    folder: bool
    refused: str
    open: Callable[[], IO[bytes]]


def unpack(archive: Path, folder: Path, limits: Limits | None = None, on_files: OnFiles | None = None) -> Unpacked:
    """Unpack `archive` into `folder`, which must not exist; on any error it is removed again.

    Raises:
        DatasetError: The archive is damaged, is none, or holds what must not be unpacked; all such entries of a zip
            are named, the first one of a tar.
        OutputError: The disk.
    """
    limits = limits or Limits()
    try:
        packed_bytes = archive.stat().st_size
        most = min(limits.total_bytes, max(int(packed_bytes * limits.ratio), limits.free_bytes))
        with _opened(archive) as (entries, count, size_bytes, commit):
            if count is not None and count > limits.files:
                raise _refusal(archive, "too-many-files", f"{count} entries", f"at most {limits.files}")
            if size_bytes is not None:
                _require_growth(archive, size_bytes, most, packed_bytes)
                require_room(folder.parent, size_bytes)
            with _disk(folder):
                folder.mkdir(parents=True)
            try:
                files, written = _write(archive, folder, entries, count, most, packed_bytes, limits, on_files)
            except BaseException:
                shutil.rmtree(folder, ignore_errors=True)
                raise
            return Unpacked(files, written, commit())
    except _DAMAGE as error:
        if isinstance(error, InfraBlendError):
            raise
        raise _damaged(archive, str(error)) from error
    except OSError as error:
        if isinstance(error, InfraBlendError):
            raise
        # Errors of the disk are OutputErrors by now: this is a place outside the archive, or gzip's own complaint.
        raise _damaged(archive, error.strerror or str(error)) from error


def _write(
    archive: Path,
    folder: Path,
    entries: Iterator[_Entry],
    count: int | None,
    most: int,
    packed_bytes: int,
    limits: Limits,
    on_files: OnFiles | None,
) -> tuple[int, int]:
    """Write every entry; (files, bytes)."""
    files = written = seen = 0
    for entry in entries:
        seen += 1
        if seen > limits.files:
            raise _refusal(archive, "too-many-files", f"more than {limits.files} entries", f"at most {limits.files}")
        if entry.refused:
            raise _refusal(archive, "archive-entry", f"{entry.name!r}: {entry.refused}", "plain files and folders")
        # Neither library gives out more bytes of an entry than it announces.
        _require_growth(archive, written + entry.size_bytes, most, packed_bytes)
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
        with _closing(out, target), entry.open() as source:
            while chunk := source.read(CHUNK_BYTES):
                with _disk(target):
                    out.write(chunk)
            if out.tell() != entry.size_bytes:
                raise _damaged(archive, f"{entry.name!r} has {out.tell()} bytes, {entry.size_bytes} were announced")
        written += entry.size_bytes
        files += 1
        if on_files is not None:
            on_files(files, count)
    return files, written


@contextlib.contextmanager
def _disk(path: Path) -> Iterator[None]:
    """What goes wrong here is the disk's fault, not the archive's; a name that is taken stays what it is."""
    try:
        yield
    except (FileExistsError, NotADirectoryError):
        raise
    except OSError as error:
        raise output_error(path, error) from error


@contextlib.contextmanager
def _closing(out: IO[bytes], path: Path) -> Iterator[None]:
    """Close a file that was written; the last bytes may find the disk full."""
    try:
        yield
    except BaseException:
        with contextlib.suppress(OSError):
            out.close()
        raise
    with _disk(path):
        out.close()


@contextlib.contextmanager
def _opened(archive: Path) -> Iterator[tuple[Iterator[_Entry], int | None, int | None, Callable[[], str | None]]]:
    """Entries, their number and bytes if known beforehand, and how to learn the commit once they are read."""
    with archive.open("rb") as file:
        start = file.read(512)
    if start[:4] in {b"PK\x03\x04", b"PK\x05\x06"}:
        with _zip(archive) as opened:
            yield opened
    elif start[:2] == b"\x1f\x8b" or start[257:262] == b"ustar":
        with tarfile.open(archive, "r:gz" if start[:2] == b"\x1f\x8b" else "r:", tarinfo=_TarInfo) as tar:
            # git writes the commit into the global header.
            yield _tar_entries(tar), None, None, lambda: _commit(tar.pax_headers.get("comment", ""))
    else:
        begins = "an HTML page" if b"<html" in start.lower() or b"<!doctype" in start.lower() else repr(start[:8])
        found = f"begins with {begins}" if start else "is empty"
        raise _refusal(archive, "archive-unknown", found, "a zip, tar or tar.gz file")


@contextlib.contextmanager
def _zip(archive: Path) -> Iterator[tuple[Iterator[_Entry], int, int, Callable[[], str | None]]]:
    with archive.open("rb") as file:
        # The list of a zip is read whole: its size is looked at before.
        end = zipfile._EndRecData(file)  # type: ignore[attr-defined]
        if end and end[zipfile._ECD_SIZE] > _DIRECTORY_BYTES:  # type: ignore[attr-defined]
            raise _refusal(
                archive, "too-many-files", f"a list of {end[5]} bytes", f"a list of at most {_DIRECTORY_BYTES} bytes"
            )
        with zipfile.ZipFile(file) as packed:
            entries = [_zip_entry(packed, info) for info in packed.infolist()]
            refused = [
                Problem(archive.name, "archive-entry", f"{e.name!r}: {e.refused}", "plain files and folders")
                for e in entries
                if e.refused
            ]
            if refused:
                raise DatasetError(
                    f"{archive.name}: holds what must not be unpacked; nothing was written", shorten(refused)
                )
            size_bytes = sum(e.size_bytes for e in entries)
            yield iter(entries), len(entries), size_bytes, lambda: _commit(packed.comment.decode("ascii", "replace"))


def _zip_entry(packed: zipfile.ZipFile, info: zipfile.ZipInfo) -> _Entry:
    # The name as it stands there: ZipInfo cuts it at a NUL.
    name = info.orig_filename.replace("\\", "/")
    kind = stat.S_IFMT(info.external_attr >> 16) if info.create_system == 3 else 0
    refused = _bad_name(name)
    if kind not in {0, stat.S_IFREG, stat.S_IFDIR}:
        refused = "a link" if kind == stat.S_IFLNK else "no plain file"
    elif info.flag_bits & 0x1:
        refused = "is encrypted"
    elif info.compress_type not in _ZIP_METHODS:
        refused = f"compression method {info.compress_type}, expected stored or deflated"
    folder = name.endswith("/") or kind == stat.S_IFDIR
    return _Entry(name, 0 if folder else info.file_size, folder, refused, lambda: packed.open(info))


class _TarInfo(tarfile.TarInfo):
    """Refuses long-name headers that would fill the memory."""

    def _proc_member(self, tar: tarfile.TarFile) -> tarfile.TarInfo:
        long_headers = {tarfile.GNUTYPE_LONGNAME, tarfile.GNUTYPE_LONGLINK, tarfile.XHDTYPE, tarfile.XGLTYPE}
        if self.type in long_headers | {tarfile.SOLARIS_XHDTYPE} and self.size > _HEADER_BYTES:
            raise tarfile.ReadError(f"a header of {self.size} bytes, expected at most {_HEADER_BYTES}")
        return super()._proc_member(tar)  # type: ignore[misc,no-any-return]


def _tar_entries(tar: tarfile.TarFile) -> Iterator[_Entry]:
    while (member := tar.next()) is not None:
        tar.members.clear()  # type: ignore[attr-defined] # else it keeps every member it has seen
        refused = _bad_name(member.name)
        if member.issym() or member.islnk():
            refused = "a link"
        elif not (member.isreg() or member.isdir()) or member.issparse():
            refused = "no plain file"
        yield _tar_entry(tar, member, refused)
    _require_end(tar)


def _tar_entry(tar: tarfile.TarFile, member: tarfile.TarInfo, refused: str) -> _Entry:
    def opened() -> IO[bytes]:
        source = tar.extractfile(member)
        assert source is not None  # a regular file
        return source

    return _Entry(member.name, 0 if member.isdir() else member.size, member.isdir(), refused, opened)


def _require_end(tar: tarfile.TarFile) -> None:
    """tarfile takes a broken header for the end: look whether the end mark stands there, and gzip's checksum holds."""
    file, rest = tar.fileobj, 0
    assert file is not None
    file.seek(tar.offset)
    if file.read(tarfile.BLOCKSIZE) != bytes(tarfile.BLOCKSIZE):
        raise tarfile.ReadError(f"no header and no end at byte {tar.offset}")
    while chunk := file.read(CHUNK_BYTES):
        rest += len(chunk)
        if rest > _TRAILING_BYTES:
            raise tarfile.ReadError(f"more than {_TRAILING_BYTES} bytes after its end")


def _parts(name: str) -> list[str]:
    return [p for p in name.split("/") if p not in {"", "."}]


def _bad_name(name: str) -> str:
    """Why a name must not become a path below the folder; empty if it may."""
    parts = _parts(name)
    if name.startswith("/") or re.match(r"[A-Za-z]:", name):
        return "an absolute path"
    if ".." in parts:
        return "a path that climbs out"
    if re.search(r"[\x00-\x1f\x7f]", name):
        return "a name with control characters"
    if name != name.encode("utf-8", "replace").decode("utf-8"):
        return "a name that is not UTF-8"
    if any(len(p.encode()) > 255 for p in parts) or len(name.encode()) > 2000:
        return "a name that is too long"
    return ""


def _commit(text: str) -> str | None:
    return text if re.fullmatch(r"[0-9a-f]{40}", text) else None


def _require_growth(archive: Path, size_bytes: int, most: int, packed_bytes: int) -> None:
    if size_bytes > most:
        raise _refusal(
            archive,
            "archive-grows",
            f"{packed_bytes} bytes would become {size_bytes} or more",
            f"at most {most}",
        )


def require_room(folder: Path, size_bytes: int) -> None:
    """Raise OutputError unless the disk of `folder` has so much room, and a little more."""
    while not folder.exists():
        folder = folder.parent
    free = shutil.disk_usage(folder).free
    if free < size_bytes + 50_000_000:
        problem = Problem(
            str(folder),
            "disk-full",
            f"{free / 1e9:.2f} GB free",
            f"{size_bytes / 1e9:.2f} GB and a little more",
            "free some space, or give a folder on another disk; what is there is kept",
        )
        raise OutputError("not enough room on the disk", [problem])


def _refusal(archive: Path, code: str, found: str, expected: str) -> DatasetError:
    todo = "do not use this file; fetch it from its authors' page"
    return DatasetError(f"{archive.name}: not unpacked", [Problem(archive.name, code, found, expected, todo)])


def _damaged(archive: Path, why: str) -> DatasetError:
    problem = Problem(
        archive.name, "archive-damaged", f"is damaged or cut short ({why})", "a whole zip, tar or tar.gz file"
    )
    return DatasetError(f"{archive.name}: cannot be unpacked", [problem])


def without_wrapper(folder: Path) -> Path:
    """The innermost folder that holds everything: archives often wrap their content in a folder, or in two."""
    while True:
        names = sorted(e.name for e in os.scandir(folder) if not _LITTER.fullmatch(e.name))
        if len(names) != 1 or not (folder / names[0]).is_dir():
            return folder
        folder = folder / names[0]
