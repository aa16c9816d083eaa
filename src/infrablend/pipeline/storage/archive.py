"""Download a file over HTTP, and unpack a zip, tar or tar.gz that may come from anybody.

Nothing is written outside the folder: members whose names lead out of it, links in a zip, and devices are refused, as
are archives of more than `MAX_BYTES` or `MAX_MEMBERS`. The caller removes what is left when a function here fails.
"""

from __future__ import annotations

import errno
import http.client
import re
import ssl
import stat
import tarfile
import urllib.error
import urllib.request
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit, urlunsplit

from infrablend import __version__
from infrablend.core.files import output_error, require_free_space
from infrablend.errors import DatasetError, FetchError, OutputError, Problem

MAX_BYTES = 200 * 10**9
MAX_MEMBERS = 500_000
_TIMEOUT_S = 60.0
_CHUNK_BYTES = 1 << 18
_SPARE_BYTES = 50_000_000
# Files that other systems add beside the one folder that wraps everything.
_LITTER = re.compile(r"\.DS_Store|__MACOSX|\._.*|Thumbs\.db")
# Exceptions of the libraries on bytes that are not an archive, or a damaged one.
_DAMAGE = (
    zipfile.BadZipFile,
    tarfile.TarError,
    zlib.error,
    EOFError,
    ValueError,
    ArithmeticError,
    LookupError,
    RuntimeError,
    FileExistsError,
    NotADirectoryError,
    IsADirectoryError,
)
_REMEDIES = {
    401: "the server requires a login: download the file in a browser and give --archive FILE",
    403: "the server refuses access: download the file in a browser and give --archive FILE",
    404: "the file is gone or the address is wrong: look at the dataset's page, and give --url",
    410: "the file is gone: look at the dataset's page, and give --url",
}

OnProgress = Callable[[int, int | None], None]
"""Called with the number of bytes or files so far, and of all, None if it is not known."""


@dataclass(frozen=True)
class Unpacked:
    """Number and size of the files, and the git commit that the archive names as its source, if any."""

    files: int
    size_bytes: int
    commit: str | None = None


def public_url(url: str) -> str:
    """Return the address without user, query and fragment, which may hold secrets."""
    parts = urlsplit(url)
    return urlunsplit((parts.scheme, parts.netloc.rpartition("@")[2], parts.path, "", ""))


def require_url(url: str) -> None:
    """Check that an address is a plain web address.

    Raises:
        FetchError: The scheme is not http or https, there is no host, or it contains a user name or invalid characters.
    """
    try:
        parts = urlsplit(url)
        good = parts.scheme in {"http", "https"} and bool(parts.hostname) and parts.port != 0
    except ValueError:
        parts = urlsplit("")
        good = False
    if not good or "@" in parts.netloc or re.search(r"[\x00-\x20\x7f]", url):
        raise FetchError(
            f"address {url!r}: cannot be fetched; expected http:// or https:// and a host, without a user name. "
            "For a file on this machine give --archive FILE"
        )


def download(url: str, file: Path, unpacked_bytes: int, on_bytes: OnProgress) -> str:
    """Download `url` to `file`; return its address after redirects, without query.

    Args:
        url: Address, http or https.
        file: File to write.
        unpacked_bytes: Room on the disk that is needed besides the file.
        on_bytes: Receives the progress.

    Raises:
        FetchError: The server refuses, the certificate is invalid, or the connection breaks.
        OutputError: The file cannot be written.
    """
    require_url(url)
    request = urllib.request.Request(url, headers={"User-Agent": f"infrablend/{__version__}"})
    try:
        answer = urllib.request.urlopen(request, timeout=_TIMEOUT_S)
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise _network_error(url, error) from error
    with answer:
        final = answer.geturl()
        if urlsplit(url).scheme == "https" != urlsplit(final).scheme:
            raise FetchError(f"{public_url(url)}: redirects to {public_url(final)}; expected https")
        length = answer.headers.get("Content-Length", "")
        total = int(length) if length.isdecimal() else None
        require_free_space(file.parent, (total or 0) + unpacked_bytes + _SPARE_BYTES, "the download")
        done = 0
        try:
            with file.open("xb") as stream:
                for chunk in _chunks(url, answer):
                    stream.write(chunk)
                    done += len(chunk)
                    on_bytes(done, total)
        except FetchError:
            raise
        except OSError as error:
            raise output_error(file, error) from error
    if total is not None and done < total:
        raise _network_error(url, EOFError(f"it ended at byte {done} of {total}"))
    return public_url(final)


def _chunks(url: str, answer: http.client.HTTPResponse) -> Iterator[bytes]:
    """Yield what the server sends.

    Raises:
        FetchError: The connection broke.
    """
    try:
        while chunk := answer.read(_CHUNK_BYTES):
            yield chunk
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise _network_error(url, error) from error


def unpack(archive: Path, folder: Path, on_files: OnProgress) -> Unpacked:
    """Unpack `archive` into `folder`, which must not exist.

    Raises:
        DatasetError: The file is damaged, is not an archive, is too large, or contains members that must not be
            unpacked.
        OutputError: The disk failed.
    """
    try:
        if zipfile.is_zipfile(archive):
            return _unpack_zip(archive, folder, on_files)
        return _unpack_tar(archive, folder, on_files)
    except (DatasetError, OutputError):
        raise
    except (*_DAMAGE, OSError) as error:
        # A seek to a place that a damaged archive names is the only error of the system that is not the disk's.
        of_disk = isinstance(error, OSError) and error.errno not in (None, errno.EINVAL)
        if of_disk and not isinstance(error, _DAMAGE):
            raise output_error(folder, error) from error
        expected = "a complete zip, tar or tar.gz file"
        raise _refusal(archive, "archive-damaged", f"is damaged or incomplete ({error})", expected) from error


def without_wrapper(folder: Path) -> Path:
    """Return the innermost folder that contains everything, since archives often wrap their content in folders."""
    while True:
        names = sorted(p.name for p in folder.iterdir() if not _LITTER.fullmatch(p.name))
        if len(names) != 1 or not (folder / names[0]).is_dir():
            return folder
        folder = folder / names[0]


def _network_error(url: str, error: Exception) -> FetchError:
    reason = error.reason if isinstance(error, urllib.error.URLError) else error
    code = "no-connection"
    expected = "the file"
    found = f"no connection, or a broken one ({getattr(reason, 'strerror', None) or reason or type(reason).__name__})"
    todo = "repeat the command, or download the file in a browser and give --archive FILE"
    if isinstance(error, urllib.error.HTTPError):
        error.close()
        code = f"http-{error.code}"
        found = f"HTTP {error.code} {error.reason}".strip()
        todo = _REMEDIES.get(error.code, "try again later; look at the dataset's page")
    elif isinstance(reason, ssl.SSLCertVerificationError):
        code = "certificate"
        expected = "a certificate that this machine trusts"
        found = f"the server's certificate was not accepted: {reason.verify_message}"
        todo = (
            "check this machine's clock. If a proxy of your organisation opens encrypted connections, set "
            "SSL_CERT_FILE to its certificate. Otherwise stop here: the connection may be intercepted"
        )
    return FetchError("nothing was downloaded", [Problem(public_url(url), code, found, expected, todo)])


def _unpack_zip(archive: Path, folder: Path, on_files: OnProgress) -> Unpacked:
    with zipfile.ZipFile(archive) as packed:
        members = packed.infolist()
        bad = {info.filename: reason for info in members if (reason := _zip_refusal(info))}
        if bad:
            raise _bad_members(archive, bad)
        size = sum(info.file_size for info in members)
        _require_bounded(archive, len(members), size)
        require_free_space(folder.parent, size + _SPARE_BYTES, archive.name)
        files = [info for info in members if not info.is_dir()]
        folder.mkdir()
        for done, info in enumerate(files, 1):
            packed.extract(info, folder)
            on_files(done, len(files))
        return Unpacked(len(files), size, _commit(packed.comment.decode("ascii", "replace")))


def _unpack_tar(archive: Path, folder: Path, on_files: OnProgress) -> Unpacked:
    files = size = 0
    with tarfile.open(archive) as tar:
        folder.mkdir()
        for count, member in enumerate(_members(tar), 1):
            size += member.size
            _require_bounded(archive, count, size)
            try:
                tar.extract(member, folder, filter="data")
            except tarfile.FilterError as error:
                raise _bad_members(archive, {member.name: str(error)}) from error
            if member.isfile():
                files += 1
                on_files(files, None)
        # git writes the commit into the global header.
        return Unpacked(files, size, _commit(tar.pax_headers.get("comment", "")))


def _members(tar: tarfile.TarFile) -> Iterator[tarfile.TarInfo]:
    """Yield the members one by one, and check the end: tarfile takes a damaged header for it."""
    while (member := tar.next()) is not None:
        yield member
    stream = tar.fileobj
    assert stream is not None
    stream.seek(tar.offset)
    if stream.read(tarfile.BLOCKSIZE) != bytes(tarfile.BLOCKSIZE):
        raise tarfile.ReadError(f"neither a header nor the end at byte {tar.offset}")
    while stream.read(_CHUNK_BYTES):  # up to the checksum of a tar.gz
        pass


def _zip_refusal(info: zipfile.ZipInfo) -> str:
    if stat.S_IFMT(info.external_attr >> 16) not in (0, stat.S_IFREG, stat.S_IFDIR):
        return "a link or a device"
    if re.match(r"[/\\]|[A-Za-z]:", info.filename) or ".." in re.split(r"[/\\]", info.filename):
        return "a path that leads out of the folder"
    return ""


def _require_bounded(archive: Path, members: int, size_bytes: int) -> None:
    if members > MAX_MEMBERS or size_bytes > MAX_BYTES:
        found = f"contains {members} members and {size_bytes} bytes, or more"
        raise _refusal(archive, "archive-grows", found, f"at most {MAX_MEMBERS} members and {MAX_BYTES} bytes")


def _bad_members(archive: Path, reasons: dict[str, str]) -> DatasetError:
    todo = "do not use this file; download it from its authors' page"
    expected = "plain files below the folder"
    where = archive.name
    code = "archive-entry"
    problems = [Problem(where, code, f"{name!r}: {reason}", expected, todo) for name, reason in reasons.items()]
    return DatasetError(f"{where}: not unpacked", problems)


def _refusal(archive: Path, code: str, found: str, expected: str) -> DatasetError:
    return DatasetError(f"{archive.name}: cannot be unpacked", [Problem(archive.name, code, found, expected)])


def _commit(text: str) -> str | None:
    return text if re.fullmatch(r"[0-9a-f]{40}", text) else None
