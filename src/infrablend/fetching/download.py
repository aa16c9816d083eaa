"""Download one file over HTTP; received bytes are kept, and broken connections are resumed."""

from __future__ import annotations

import http.client
import json
import logging
import re
import ssl
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any
from urllib.parse import urlsplit, urlunsplit

from infrablend import __version__
from infrablend.core.files import output_error, read_regular, write_json
from infrablend.errors import FetchError, InfraBlendError, Interrupted, Problem

log = logging.getLogger(__name__)

CHUNK_BYTES = 1 << 18
_RETRY_STATUS = {408, 425, 429, 500, 502, 503, 504}
_LONGEST_WAIT_S = 60.0

OnBytes = Callable[[int, int | None], None]
"""Called with the number of bytes received and the total, None if the server does not report it."""


@dataclass(frozen=True)
class RetryPolicy:
    """When to retry and when to give up.

    Attributes:
        failures: Number of consecutive attempts without new bytes after which to give up.
        first_wait_s: Pause after the first of them, s; doubled each time.
        timeout_s: Longest time without data on a connection, s.
        sleep: Function that waits; tests replace it.
    """

    failures: int = 6
    first_wait_s: float = 1.0
    timeout_s: float = 30.0
    sleep: Callable[[float], None] = time.sleep


@dataclass(frozen=True)
class _Remote:
    """Facts about the remote file, by which a resumed download recognises it."""

    url: str
    total: int | None = None
    etag: str = ""
    last_modified: str = ""

    @property
    def validator(self) -> str:
        """Value for `If-Range`: a strong ETag, else the date, else empty."""
        return self.etag if self.etag and not self.etag.startswith("W/") else self.last_modified


class _IncompleteDownload(Exception):  # noqa: N818 - a signal between two functions here
    """The connection ended early, or the server asked to come back later (`wait_s`)."""

    def __init__(self, why: str, wait_s: float = 0.0) -> None:
        super().__init__(why)
        self.wait_s = wait_s


def public_url(url: str) -> str:
    """Return the address without user, query and fragment, which may hold secrets."""
    parts = urlsplit(url)
    host = parts.netloc.rpartition("@")[2]
    return urlunsplit((parts.scheme, host, parts.path, "", ""))


def require_url(url: str) -> None:
    """Check that an address is a plain web address.

    Raises:
        FetchError: The scheme is not http or https, there is no host, or it contains a user name or invalid characters.
    """
    try:
        parts = urlsplit(url)
        good = parts.scheme in {"http", "https"} and bool(parts.hostname) and parts.port != 0
    except ValueError:
        parts, good = urlsplit(""), False
    if not good or "@" in parts.netloc or re.search(r"[\s\x00-\x20\x7f]", url):
        raise FetchError(
            f"address {url!r}: cannot be fetched; expected http:// or https:// and a host, without a user name. "
            "For a file on this machine give --archive FILE"
        )


def download(
    url: str,
    part: Path,
    *,
    size_bytes: int | None = None,
    room: Callable[[int], None] = lambda missing: None,
    on_bytes: OnBytes = lambda done, total: None,
    patience: RetryPolicy | None = None,
) -> dict[str, Any]:
    """Fetch `url` into `part`; resume an earlier download if the file on the server has not changed.

    Args:
        url: http or https.
        part: File to write; facts about the remote file are kept beside it, in `<part>.json`.
        size_bytes: Expected size, to check for free space if the server does not report the size.
        room: Called with the number of missing bytes once it is known; raises if the disk has no space.
        on_bytes: Receives the progress.
        patience: When to retry and when to give up.

    Returns:
        The server's facts: `url` (after redirects, without query), `size_bytes`, `etag`, `last_modified`.

    Raises:
        FetchError: The server refuses, the certificate is invalid, or the connection keeps breaking; received bytes
            are kept.
        Interrupted: Ctrl-C was pressed; received bytes are kept.
        OutputError: The file cannot be written.
    """
    require_url(url)
    patience = patience or RetryPolicy()
    fails, best = 0, _size(part)
    try:
        while True:
            try:
                remote, final = _attempt(url, part, size_bytes, room, on_bytes, patience.timeout_s)
                break
            except _IncompleteDownload as broken:
                here = _size(part)
                # A server that restarts and breaks every time makes no progress, however much it sends.
                fails = 0 if here > best else fails + 1
                best = max(best, here)
                if fails >= patience.failures:
                    raise FetchError(
                        f"{public_url(url)}: given up after {fails} attempts without new data: {broken}; "
                        f"{here} bytes are kept. Repeat the command to resume"
                    ) from broken
                wait = max(broken.wait_s, patience.first_wait_s * 2 ** max(fails - 1, 0))
                log.info("%s: %s; retrying in %.0f s", public_url(url), broken, wait)
                patience.sleep(min(wait, _LONGEST_WAIT_S))
    except KeyboardInterrupt as stop:
        raise Interrupted(f"interrupted; {_size(part)} bytes are kept. Repeat the command to resume.") from stop
    return {
        "url": public_url(final),
        "size_bytes": _size(part),
        "etag": remote.etag,
        "last_modified": remote.last_modified,
    }


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _known(url: str, part: Path) -> tuple[_Remote | None, int]:
    """Return the remote file and the bytes that an earlier call left; (None, 0) if they cannot be resumed."""
    try:
        remote = _Remote(**json.loads(read_regular(_validator_file(part))))
    except (OSError, ValueError, TypeError):
        return None, 0
    here = _size(part)
    types = isinstance(remote.total, int | None) and all(
        isinstance(v, str) for v in (remote.url, remote.etag, remote.last_modified)
    )
    # Without a version mark or at least a length, a changed file could not be recognised.
    usable = types and remote.url == url and here > 0 and bool(remote.validator or remote.total)
    return (remote, here) if usable else (None, 0)


def _validator_file(part: Path) -> Path:
    return part.with_name(part.name + ".json")


def _attempt(
    url: str,
    part: Path,
    size_bytes: int | None,
    room: Callable[[int], None],
    on_bytes: OnBytes,
    timeout_s: float,
) -> tuple[_Remote, str]:
    """Send one request and return when the file is complete.

    Raises:
        _IncompleteDownload: Another attempt may succeed.
    """
    remote, here = _known(url, part)
    if remote is not None and remote.total == here:
        on_bytes(here, here)
        return remote, url
    headers = {
        "User-Agent": f"infrablend/{__version__}",
        "Accept": "*/*",
        "Accept-Encoding": "identity",  # ranges count bytes of the file, not of a compressed stream
    }
    if remote is not None:
        headers["Range"] = f"bytes={here}-"
        if remote.validator:
            headers["If-Range"] = remote.validator
    try:
        response = _opener().open(urllib.request.Request(url, headers=headers), timeout=timeout_s)
    except FetchError:  # of a redirect
        raise
    except urllib.error.HTTPError as error:
        with error:
            if error.code == 416 and remote is not None:
                return _handle_range_not_satisfiable(error, remote, here, part)
            raise _refused(url, error) from error
    except (OSError, http.client.HTTPException) as error:
        raise _unreachable(url, error) from error
    with response:
        final = response.geturl()
        if response.headers.get("Content-Encoding", "identity").lower() not in {"", "identity"}:
            raise FetchError(
                f"{public_url(final)}: sent with encoding {response.headers['Content-Encoding']}; expected the "
                "unencoded file that was requested. Try another --url"
            )
        begin, total = _placed(response, remote, here, part)
        if begin == 0 and here:
            log.info("%s: the server restarts from the beginning", public_url(url))
        now = _Remote(url, total, response.headers.get("ETag", ""), response.headers.get("Last-Modified", ""))
        expected = total if total is not None else size_bytes
        if expected is not None:
            room(max(expected - begin, 0))
        try:
            part.parent.mkdir(parents=True, exist_ok=True)
            with part.open("r+b" if begin else "wb") as file:
                # Write the facts only now that old bytes are gone or known to belong to this file.
                write_json(_validator_file(part), asdict(now))
                file.seek(begin)
                file.truncate()
                _receive(response, file, begin, total, on_bytes)
        except OSError as error:
            if isinstance(error, InfraBlendError):
                raise
            raise output_error(part, error) from error
        return now, final


def _placed(response: Any, remote: _Remote | None, here: int, part: Path) -> tuple[int, int | None]:
    """Return where the body begins in the file, and the file's length, or None if the server does not report it."""
    length = response.headers.get("Content-Length", "")
    if response.status != 206:
        return 0, int(length) if length.isdecimal() else None
    found = re.fullmatch(r"bytes (\d+)-(\d+)/(\d+|\*)", response.headers.get("Content-Range", "").strip())
    if remote is None or found is None:
        raise FetchError(f"{public_url(response.geturl())}: sent a range that was not requested; try another --url")
    first, total = int(found[1]), None if found[3] == "*" else int(found[3])
    if first != here or (remote.total is not None and total is not None and total != remote.total):
        raise _changed(part)
    return first, total if total is not None else remote.total


def _changed(part: Path) -> _IncompleteDownload:
    """Discard the part because the server's file has changed; the next attempt starts from zero."""
    _validator_file(part).unlink(missing_ok=True)
    return _IncompleteDownload("the file on the server has changed")


def _receive(response: Any, file: IO[bytes], begin: int, total: int | None, on_bytes: OnBytes) -> None:
    done = begin
    on_bytes(done, total)
    while True:
        try:
            chunk = response.read1(CHUNK_BYTES)
        except (OSError, http.client.HTTPException, ValueError) as error:
            raise _IncompleteDownload(f"the connection broke at byte {done} ({_reason(error)})") from error
        if not chunk:
            break
        file.write(chunk)
        done += len(chunk)
        on_bytes(done, total)
    if total is not None and done < total:
        raise _IncompleteDownload(f"the connection ended at byte {done} of {total}")


def _handle_range_not_satisfiable(
    error: urllib.error.HTTPError, remote: _Remote, here: int, part: Path
) -> tuple[_Remote, str]:
    """Handle HTTP 416, no bytes after those already here: the file is complete, or it has changed on the server."""
    found = re.fullmatch(r"bytes \*/(\d+)", (error.headers.get("Content-Range") or "").strip())
    if found and int(found[1]) == here:
        if remote.total != here:
            log.warning("the server said %s bytes and has %d; the archive's own checks decide", remote.total, here)
        return remote, error.geturl() or remote.url
    raise _changed(part)


class _Redirects(urllib.request.HTTPRedirectHandler):
    """Follows redirects to web addresses only, and never from https to http."""

    def redirect_request(self, req: Any, fp: Any, code: int, msg: str, headers: Any, newurl: str) -> Any:
        old, new = urlsplit(req.full_url).scheme, urlsplit(newurl).scheme
        if new not in {"http", "https"} or (old == "https" and new != "https"):
            raise FetchError(
                f"{public_url(req.full_url)}: redirects to {public_url(newurl)}, which is not encrypted; "
                "expected https. Nothing was downloaded from there"
            )
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def _opener() -> urllib.request.OpenerDirector:
    """Return an opener for web addresses only (urllib's own also reads local files), with the environment's proxies."""
    opener = urllib.request.OpenerDirector()
    for handler in (
        urllib.request.ProxyHandler(),
        urllib.request.UnknownHandler(),
        urllib.request.HTTPHandler(),
        urllib.request.HTTPSHandler(context=ssl.create_default_context()),
        urllib.request.HTTPDefaultErrorHandler(),
        _Redirects(),
        urllib.request.HTTPErrorProcessor(),
    ):
        opener.add_handler(handler)
    return opener


def _refused(url: str, error: urllib.error.HTTPError) -> Exception:
    """Return the exception for an HTTP status: a retry, or a final error."""
    status = f"HTTP {error.code} {error.reason}".strip()
    if error.code in _RETRY_STATUS:
        return _IncompleteDownload(f"the server answers {status}", _retry_after(error.headers.get("Retry-After")))
    todo = {
        401: "the server requires a login: download the file in a browser and give --archive FILE",
        403: "the server refuses access: download the file in a browser and give --archive FILE",
        404: "the file is gone or the address is wrong: look at the dataset's page, and give --url",
        407: "the proxy requires a login: set it in https_proxy",
        410: "the file is gone: look at the dataset's page, and give --url",
    }.get(error.code, "look at the dataset's page; give --url, or --archive FILE")
    problem = Problem(public_url(url), f"http-{error.code}", status, "the file", todo)
    return FetchError("nothing was downloaded", [problem])


def _retry_after(value: str | None) -> float:
    if value is None or not value.strip().isdecimal():
        return 0.0
    return min(float(value), _LONGEST_WAIT_S)


def _unreachable(url: str, error: Exception) -> Exception:
    """Return the exception for a request without an answer."""
    reason = error.reason if isinstance(error, urllib.error.URLError) else error
    if isinstance(reason, ssl.SSLCertVerificationError):
        found = f"the server's certificate was not accepted: {reason.verify_message}"
        todo = (
            "check this machine's clock. If a proxy of your organisation opens encrypted connections, set "
            "SSL_CERT_FILE to its certificate. Otherwise stop here: the connection may be intercepted"
        )
        problem = Problem(public_url(url), "certificate", found, "a certificate that this machine trusts", todo)
        return FetchError("nothing was downloaded", [problem])
    if isinstance(reason, ssl.SSLError):
        return _IncompleteDownload(f"no encrypted connection ({reason.reason or reason})")
    return _IncompleteDownload(f"no connection ({_reason(reason)})")


def _reason(error: object) -> str:
    if isinstance(error, TimeoutError):
        return "no answer in time"
    if isinstance(error, http.client.IncompleteRead):
        return "it ended early"
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
