"""`fetch` from a local server that breaks connections, sends false sizes and serves hostile archives."""

from __future__ import annotations

import errno
import gzip
import hashlib
import http.server
import io
import json
import os
import random
import shutil
import ssl
import stat
import subprocess
import sys
import tarfile
import threading
import time
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from infrablend import api
from infrablend.cli import main
from infrablend.cli.output import FetchPace, fetch_line
from infrablend.errors import DatasetError, FetchError, InfraBlendError, Interrupted, OutputError
from infrablend.fetching import download as downloading
from infrablend.fetching import fetch as fetching
from infrablend.fetching.download import RetryPolicy, download
from infrablend.fetching.fetch import FetchProgress
from infrablend.fetching.unpack import Limits, unpack, without_wrapper
from infrablend.formats import sources
from infrablend.formats.sources import CC_BY_4, HIT_UAV, Archive, Source
from tests.samples import SAMPLES

BODY = random.Random(4).randbytes(300_000)


@dataclass
class Server:
    """A server with scripted faults: each request uses one of `acts`; afterwards it serves correctly.

    An act: `("cut", n)` closes after n bytes of the body, `("status", code, headers)`, `("ignore-range",)`,
    `("length", n)` lies about the length, `("redirect", url)`, `("encoding", name)`, `("stall",)`.
    """

    files: dict[str, bytes] = field(default_factory=dict)
    acts: list[tuple] = field(default_factory=list)
    always: tuple | None = None
    ranges: bool = True
    etag: str | None = '"v1"'
    modified: str | None = None
    chunked: bool = False
    requests: list[dict[str, str | None]] = field(default_factory=list)
    sent: list[int] = field(default_factory=list)
    url: str = ""


class Handler(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "test", ""

    def log_message(self, *_: object) -> None:
        pass

    def do_GET(self) -> None:
        server: Server = self.server.told  # type: ignore[attr-defined]
        wanted_range = self.headers.get("Range")
        server.requests.append(
            {
                "path": self.path,
                "range": wanted_range,
                "if-range": self.headers.get("If-Range"),
                "host": self.headers["Host"],
            }
        )
        act = server.acts.pop(0) if server.acts else server.always or ("serve",)
        self.close_connection = True
        if act[0] == "status":
            return self._head(act[1], {"Content-Length": "0", **(act[2] if len(act) > 2 else {})})
        if act[0] == "redirect":
            return self._head(302, {"Location": act[1], "Content-Length": "0"})
        if act[0] == "stall":
            time.sleep(1.0)
            return None
        body = server.files.get(self.path.partition("?")[0])
        if body is None:
            return self._head(404, {"Content-Length": "0"})
        headers = {k: v for k, v in (("ETag", server.etag), ("Last-Modified", server.modified)) if v}
        begin, status = 0, 200
        fresh = self.headers.get("If-Range") in {None, server.etag, server.modified}
        if wanted_range and server.ranges and act[0] != "ignore-range" and fresh:
            begin = int(wanted_range.removeprefix("bytes=").removesuffix("-"))
            if begin >= len(body):
                return self._head(416, {"Content-Range": f"bytes */{len(body)}", "Content-Length": "0"})
            status = 206
            headers["Content-Range"] = f"bytes {begin}-{len(body) - 1}/{len(body)}"
        rest = body[begin:]
        if act[0] == "range-lie":
            headers["Content-Range"] = act[1]
        if act[0] == "encoding":
            headers["Content-Encoding"] = act[1]
        part = rest[: act[1]] if act[0] == "cut" else rest
        server.sent.append(len(part))  # before the client can see the end of it
        if server.chunked:
            self._head(status, {**headers, "Transfer-Encoding": "chunked"})
            self.wfile.write(b"%x\r\n%s\r\n" % (len(part), part) if part else b"")
            if act[0] != "cut":
                self.wfile.write(b"0\r\n\r\n")
        else:
            length = act[1] if act[0] == "length" else len(rest)
            self._head(status, {**headers, "Content-Length": str(length)})
            self.wfile.write(part)
        return None

    def _head(self, status: int, headers: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()


@pytest.fixture(autouse=True)
def no_proxy(monkeypatch):
    for name in list(os.environ):
        if name.lower().endswith("_proxy"):
            monkeypatch.delenv(name)


@pytest.fixture
def server() -> Iterator[Server]:
    http_server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    told = Server(files={"/a.zip": BODY}, url=f"http://127.0.0.1:{http_server.server_port}")
    http_server.told = told  # type: ignore[attr-defined]
    thread = threading.Thread(target=http_server.serve_forever, args=(0.01,))
    thread.start()
    yield told
    http_server.shutdown()
    thread.join()
    http_server.server_close()


class Waits(list):
    def __call__(self, seconds: float) -> None:
        self.append(seconds)


@pytest.fixture
def waits() -> Waits:
    return Waits()


@pytest.fixture
def patience(waits) -> RetryPolicy:
    return RetryPolicy(failures=3, timeout_s=5.0, sleep=waits)


def get(server: Server, part: Path, patience: RetryPolicy, path: str = "/a.zip", **options) -> dict:
    return download(server.url + path, part, patience=patience, **options)


# -- downloads -------------------------------------------------------------------------------------------------------


def test_a_file_is_fetched_with_progress(server, tmp_path, patience):
    seen: list[tuple[int, int | None]] = []
    told = get(server, tmp_path / "a.part", patience, on_bytes=lambda n, of: seen.append((n, of)))
    assert (tmp_path / "a.part").read_bytes() == BODY
    assert told == {"url": f"{server.url}/a.zip", "size_bytes": len(BODY), "etag": '"v1"', "last_modified": ""}
    assert seen[0] == (0, len(BODY))
    assert seen[-1] == (len(BODY), len(BODY))
    assert [n for n, _ in seen] == sorted(n for n, _ in seen)


def test_broken_connections_resume_without_sending_bytes_twice(server, tmp_path, patience, waits):
    server.acts = [("cut", 100_000), ("cut", 1), ("cut", 50_000)]
    get(server, tmp_path / "a.part", patience)
    assert (tmp_path / "a.part").read_bytes() == BODY
    assert [r["range"] for r in server.requests] == [None, "bytes=100000-", "bytes=100001-", "bytes=150001-"]
    assert sum(server.sent) == len(BODY)
    assert {r["if-range"] for r in server.requests[1:]} == {'"v1"'}
    assert waits == [1.0, 1.0, 1.0]


def test_a_second_call_reads_only_the_missing_bytes(server, tmp_path, patience):
    server.acts = [("cut", 200_000), *[("status", 503)] * 3]
    with pytest.raises(FetchError, match=r"200000 bytes are kept. Repeat the command"):
        get(server, tmp_path / "a.part", patience)
    server.sent.clear()
    get(server, tmp_path / "a.part", patience)
    assert (tmp_path / "a.part").read_bytes() == BODY
    assert server.sent == [100_000]
    get(server, tmp_path / "a.part", patience)  # whole already: not even asked for
    assert server.sent == [100_000]


@pytest.mark.parametrize("how", ["server", "once"])
def test_server_without_ranges_restarts_the_download(server, tmp_path, patience, how):
    server.acts = [("cut", 100_000)] + ([("ignore-range",)] if how == "once" else [])
    server.ranges = how == "once"
    get(server, tmp_path / "a.part", patience)
    assert (tmp_path / "a.part").read_bytes() == BODY
    assert server.sent == [100_000, len(BODY)]


def test_server_that_restarts_and_breaks_every_time_is_given_up(server, tmp_path, patience, waits):
    server.ranges, server.always = False, ("cut", 100_000)
    with pytest.raises(FetchError, match="given up after 3 attempts without new data"):
        get(server, tmp_path / "a.part", patience)
    assert len(server.requests) == 4
    assert waits == [1.0, 1.0, 2.0]


@pytest.mark.parametrize("mark", ["etag", "date", "length"])
def test_changed_file_is_fetched_again(server, tmp_path, patience, mark):
    server.etag = '"v1"' if mark == "etag" else None
    server.modified = "Mon, 01 Jan 2024 00:00:00 GMT" if mark == "date" else None
    server.acts = [("cut", 100_000), *[("status", 503)] * 3]
    with pytest.raises(FetchError):
        get(server, tmp_path / "a.part", patience)
    server.files["/a.zip"] = other = BODY[::-1] + b"!"
    server.etag = '"v2"' if mark == "etag" else None
    server.modified = "Tue, 02 Jan 2024 00:00:00 GMT" if mark == "date" else None
    get(server, tmp_path / "a.part", patience)
    assert (tmp_path / "a.part").read_bytes() == other


def test_shortened_file_is_fetched_again(server, tmp_path, patience):
    server.etag = None
    server.acts = [("cut", 200_000)]
    original = server.files["/a.zip"]
    with pytest.raises(FetchError):
        get(server, tmp_path / "a.part", RetryPolicy(failures=1, sleep=lambda s: None), "/b.zip")
    del original
    with pytest.raises(FetchError):
        server.acts = [("cut", 200_000), ("status", 503)]
        get(server, tmp_path / "a.part", RetryPolicy(failures=1, sleep=lambda s: None))
    server.files["/a.zip"] = BODY[:150_000]
    get(server, tmp_path / "a.part", patience)
    assert (tmp_path / "a.part").read_bytes() == BODY[:150_000]


def test_partial_download_of_another_address_or_without_record_is_not_resumed(server, tmp_path, patience):
    part = tmp_path / "a.part"
    part.write_bytes(b"x" * 5000)  # no note beside it
    get(server, part, patience)
    assert part.read_bytes() == BODY
    (tmp_path / "a.part.json").write_text('{"url": 3, "total": "many", "etag": [], "last_modified": null}')
    get(server, part, patience)
    (tmp_path / "a.part.json").write_text("[")
    get(server, part, patience)
    assert [r["range"] for r in server.requests] == [None, None, None]
    server.files["/b.zip"] = b"other"
    get(server, part, patience, "/b.zip")
    assert part.read_bytes() == b"other"


def test_unknown_length_and_a_chunked_body_that_breaks(server, tmp_path, patience):
    server.chunked, server.acts = True, [("cut", 100_000)]
    seen = []
    get(server, tmp_path / "a.part", patience, on_bytes=lambda n, of: seen.append(of))
    assert (tmp_path / "a.part").read_bytes() == BODY
    assert seen[0] is None
    assert server.requests[1]["range"] == "bytes=100000-"  # the ETag is mark enough


@pytest.mark.parametrize("told", [len(BODY) + 5000, len(BODY) - 5000])
def test_a_wrong_length(server, tmp_path, patience, told, caplog):
    """Too long: the server's answer to a range decides. Too short: the file is cut, which the archive's checks find."""
    server.acts = [("length", told)]
    get(server, tmp_path / "a.part", patience)
    assert (tmp_path / "a.part").read_bytes() == BODY[:told]
    if told > len(BODY):
        assert "the archive's own checks decide" in caplog.text


@pytest.mark.parametrize("lie", ["bytes 0-9/300000", "bytes 5-299999/300000", "nonsense", "bytes 100000-299999/999999"])
def test_mismatched_partial_content_is_not_appended(server, tmp_path, patience, lie):
    server.acts = [("cut", 100_000), ("range-lie", lie)]
    try:
        get(server, tmp_path / "a.part", patience)
    except FetchError as error:
        assert "not requested" in str(error)
    else:
        assert (tmp_path / "a.part").read_bytes() == BODY


def test_part_sent_unasked(server, tmp_path, patience):
    server.acts = [("status", 206, {"Content-Range": "bytes 0-9/10"})]
    with pytest.raises(FetchError, match="not requested"):
        get(server, tmp_path / "a.part", patience)


@pytest.mark.parametrize(
    ("status", "says"), [(403, "refuses access"), (404, "give --url"), (401, "requires a login"), (410, "gone")]
)
def test_refusals_are_reported_at_once(server, tmp_path, patience, status, says, waits):
    server.always = ("status", status)
    with pytest.raises(FetchError, match=f"(?s)HTTP {status}.*{says}"):
        get(server, tmp_path / "a.part", patience, "/a.zip?token=secret")
    assert len(server.requests) == 1
    assert not (tmp_path / "a.part").exists()
    with pytest.raises(FetchError) as caught:
        get(server, tmp_path / "a.part", patience, "/a.zip?token=secret")
    assert "secret" not in str(caught.value)


def test_temporary_errors_are_retried(server, tmp_path, patience, waits):
    server.acts = [
        ("status", 500),
        ("status", 429, {"Retry-After": "7"}),
        ("cut", 10),
        ("status", 503, {"Retry-After": "9999"}),
    ]
    get(server, tmp_path / "a.part", patience)
    assert (tmp_path / "a.part").read_bytes() == BODY
    assert waits == [1.0, 7.0, 1.0, 60.0]


def test_silent_server_times_out(server, tmp_path):
    server.always = ("stall",)
    with pytest.raises(FetchError, match="given up after 2 attempts"):
        get(server, tmp_path / "a.part", RetryPolicy(failures=2, timeout_s=0.2, sleep=lambda s: None))


def test_no_server_at_all(tmp_path, patience):
    with pytest.raises(FetchError, match="no connection"):
        download("http://127.0.0.1:1/a.zip", tmp_path / "a.part", patience=patience)


def test_redirects_are_followed_on_the_web_alone(server, tmp_path, patience):
    secret = tmp_path / "secret"
    secret.write_text("mine")
    server.acts = [("redirect", "/a.zip?signature=abc")]
    told = get(server, tmp_path / "a.part", patience, "/start")
    assert told["url"] == f"{server.url}/a.zip"
    for target in (secret.as_uri(), "ftp://127.0.0.1/x"):
        server.acts = [("redirect", target)]
        with pytest.raises(FetchError):
            get(server, tmp_path / "b.part", patience)
        assert not (tmp_path / "b.part").exists()
    server.always = ("redirect", "/round")
    with pytest.raises(FetchError):
        get(server, tmp_path / "b.part", patience)


def test_encrypted_connections_do_not_become_plain():
    import urllib.request

    request = urllib.request.Request("https://example.org/a.zip")
    with pytest.raises(FetchError, match="expected https"):
        downloading._Redirects().redirect_request(request, None, 302, "", {}, "http://example.org/a.zip")


@pytest.mark.parametrize(
    "url",
    [
        "file:///etc/passwd",
        "ftp://x/y",
        "x",
        "",
        "http:///a",
        "http://u:p@h/a",
        "http://h/a b",
        "http://h\r\nX: y/",
        "http://[::1",
    ],
)
def test_invalid_addresses(url, tmp_path):
    with pytest.raises(FetchError, match="expected http"):
        download(url, tmp_path / "a.part")


def test_an_encoded_answer_is_refused(server, tmp_path, patience):
    server.acts = [("encoding", "gzip")]
    with pytest.raises(FetchError, match="encoding gzip"):
        get(server, tmp_path / "a.part", patience)


def test_interrupted_download_keeps_received_bytes_and_resumes(server, tmp_path, patience):
    def stop(done: int, total: int | None) -> None:
        if done > 100_000:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted, match="bytes are kept"):
        get(server, tmp_path / "a.part", patience, on_bytes=stop)
    here = (tmp_path / "a.part").stat().st_size
    assert here > 100_000
    get(server, tmp_path / "a.part", patience)
    assert [r["range"] for r in server.requests] == [None, f"bytes={here}-"]
    assert (tmp_path / "a.part").read_bytes() == BODY


def test_room_is_asked_for_what_is_missing(server, tmp_path, patience):
    asked: list[int] = []
    server.acts = [("cut", 100_000)]
    get(server, tmp_path / "a.part", patience, room=asked.append)
    assert asked == [len(BODY), len(BODY) - 100_000]


def test_proxies_of_the_environment_are_used(server, tmp_path, patience, monkeypatch):
    monkeypatch.setenv("http_proxy", server.url)
    server.files["http://data.example/a.zip"] = b"through the proxy"
    download("http://data.example/a.zip", tmp_path / "a.part", patience=patience)
    assert (tmp_path / "a.part").read_bytes() == b"through the proxy"
    assert server.requests[0]["host"] == "data.example"


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the certificate")
def test_untrusted_certificate_is_reported_plainly(tmp_path, patience, waits):
    key, certificate = tmp_path / "key.pem", tmp_path / "cert.pem"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost",
         "-keyout", key, "-out", certificate], check=True, capture_output=True,
    )  # fmt: skip
    https = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    https.told = Server(files={"/a.zip": BODY})  # type: ignore[attr-defined]
    https.handle_error = lambda *_: None  # type: ignore[method-assign] # the handshake that we break off
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    https.socket = context.wrap_socket(https.socket, server_side=True)
    thread = threading.Thread(target=https.serve_forever, args=(0.01,))
    thread.start()
    try:
        with pytest.raises(FetchError, match=r"(?s)certificate was not accepted.*SSL_CERT_FILE"):
            download(f"https://127.0.0.1:{https.server_port}/a.zip", tmp_path / "a.part", patience=patience)
    finally:
        https.shutdown()
        thread.join()
        https.server_close()
    assert waits == []  # trying again would not help


# -- archives --------------------------------------------------------------------------------------------------------


def zipped(entries: dict[str, bytes], comment: bytes = b"") -> bytes:
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as z:
        for name, content in entries.items():
            z.writestr(name, content)
        z.comment = comment
    return data.getvalue()


def tarred(entries: list[tuple[tarfile.TarInfo, bytes]], mode: str = "w:gz", comment: str = "") -> bytes:
    data = io.BytesIO()
    headers = {"comment": comment} if comment else {}
    with tarfile.open(fileobj=data, mode=mode, format=tarfile.PAX_FORMAT, pax_headers=headers) as t:
        for info, content in entries:
            info.size = len(content)
            t.addfile(info, io.BytesIO(content))
    return data.getvalue()


def member(name: str, kind: bytes = tarfile.REGTYPE, link: str = "") -> tarfile.TarInfo:
    info = tarfile.TarInfo(name)
    info.type, info.linkname = kind, link
    return info


def tree(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


FILES = {"top/a.txt": b"a" * 1000, "top/sub/b.bin": BODY[:5000], "top/sub/with space.txt": b"", "top/\u00e9.txt": b"e"}


@pytest.mark.parametrize("kind", ["zip", "tar", "tar.gz"])
def test_good_archives(tmp_path, kind):
    commit = "0123456789abcdef" * 2 + "01234567"
    if kind == "zip":
        data = zipped({"top/": b"", **FILES}, comment=commit.encode())
    else:
        entries = [(member("top", tarfile.DIRTYPE), b""), *((member(n), c) for n, c in FILES.items())]
        data = tarred(entries, "w" if kind == "tar" else "w:gz", commit)
    archive = tmp_path / f"a.{kind}"
    archive.write_bytes(data)
    seen: list[tuple[int, int | None]] = []
    done = unpack(archive, tmp_path / "out", on_files=lambda n, of: seen.append((n, of)))
    assert tree(tmp_path / "out") == FILES
    assert (done.files, done.size_bytes, done.commit) == (4, 6001, commit)
    assert [n for n, _ in seen] == [1, 2, 3, 4]
    assert without_wrapper(tmp_path / "out") == tmp_path / "out" / "top"
    assert not any(p.stat().st_mode & 0o111 for p in (tmp_path / "out").rglob("*") if p.is_file())


def zip_entry(name: str, content: bytes = b"x", mode: int = stat.S_IFREG | 0o644) -> bytes:
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as z:
        info = zipfile.ZipInfo("placeholder")
        info.filename, info.create_system, info.external_attr = name, 3, mode << 16
        z.writestr(info, content)
    return data.getvalue()


HOSTILE: dict[str, Callable[[], bytes]] = {
    "zip climbs": lambda: zip_entry("../escaped"),
    "zip climbs inside": lambda: zip_entry("a/../../escaped"),
    "zip climbs in Windows' way": lambda: zip_entry("..\\escaped"),
    "zip absolute": lambda: zip_entry("/tmp/escaped"),
    "zip drive": lambda: zip_entry("C:/escaped"),
    "zip symlink": lambda: zip_entry("link", b"/etc/passwd", stat.S_IFLNK | 0o777),
    "zip device": lambda: zip_entry("device", b"", stat.S_IFCHR | 0o666),
    "zip fifo": lambda: zip_entry("fifo", b"", stat.S_IFIFO | 0o666),
    "zip newline": lambda: zip_entry("a\nb"),
    "zip long name": lambda: zip_entry("x" * 300),
    "tar climbs": lambda: tarred([(member("../escaped"), b"x")]),
    "tar absolute": lambda: tarred([(member("/tmp/escaped"), b"x")]),
    "tar symlink out": lambda: tarred([(member("link", tarfile.SYMTYPE, "/etc"), b""), (member("link/x"), b"x")]),
    "tar symlink inside": lambda: tarred([(member("link", tarfile.SYMTYPE, "."), b"")]),
    "tar hardlink": lambda: tarred([(member("link", tarfile.LNKTYPE, "/etc/passwd"), b"")]),
    "tar device": lambda: tarred([(member("device", tarfile.CHRTYPE), b"")]),
    "tar fifo": lambda: tarred([(member("fifo", tarfile.FIFOTYPE), b"")]),
    "tar name of a file twice": lambda: tarred([(member("a"), b"x"), (member("a"), b"y")]),
    "tar file as folder": lambda: tarred([(member("a"), b"x"), (member("a/b"), b"y")]),
    "zip bomb": lambda: zipped({"zeros": bytes(60_000_000)}),
    "tar bomb": lambda: tarred([(member("zeros"), bytes(60_000_000))]),
    "tar gz bomb after its end": lambda: gzip.compress(tarred([(member("a"), b"x")], "w") + bytes(80_000_000)),
    "tar header bomb": lambda: gzip.compress(header_bomb()),
    "html": lambda: b"<!DOCTYPE html><html>please log in</html>",
    "empty": lambda: b"",
    "rar": lambda: b"Rar!\x1a\x07\x00" + bytes(100),
    "xz": lambda: b"\xfd7zXZ\x00" + bytes(100),
    "zip cut short": lambda: zipped(FILES)[:-200],
    "zip without a start": lambda: zipped(FILES)[100:],
    "zip flipped byte": lambda: flipped(zipped({"a": BODY[:1000]}), 300),
    "zip list flipped": lambda: flipped(zipped(FILES), -180),
    "tar.gz cut short": lambda: tarred([(member("a"), BODY)])[:-5000],
    "tar.gz wrong checksum": lambda: flipped(tarred([(member("a"), BODY)]), -6),
    "tar cut between entries": lambda: tarred([(member("a"), b"x" * 512), (member("b"), b"y")], "w")[:1024],
    "tar broken header": lambda: flipped(tarred([(member("a"), b"x" * 512), (member("b"), b"y")], "w", ""), 1024 + 150),
}  # fmt: skip


def header_bomb() -> bytes:
    """A long-name header that announces and contains 200 MB."""
    info = member("././@LongLink", tarfile.GNUTYPE_LONGNAME)
    info.size = 50_000_000
    return info.tobuf(tarfile.GNU_FORMAT) + b"a" * info.size


def flipped(data: bytes, at: int) -> bytes:
    changed = bytearray(data)
    changed[at] ^= 0x55
    return bytes(changed)


@pytest.mark.parametrize("what", HOSTILE)
def test_hostile_and_broken_archives_leave_nothing_behind(tmp_path, what):
    archive = tmp_path / "a.zip"
    archive.write_bytes(HOSTILE[what]())
    before = tree(tmp_path)
    with pytest.raises(DatasetError) as caught:
        unpack(archive, tmp_path / "deep" / "out")
    assert tree(tmp_path) == before
    assert not (tmp_path / "deep" / "out").exists()
    assert caught.value.problems
    assert all(p.expected for p in caught.value.problems)


def test_all_bad_entries_of_a_zip_are_named(tmp_path):
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as z:
        for name in ("../a", "good", "/b", "c/../../d"):
            z.writestr(name, b"x")
    (tmp_path / "a.zip").write_bytes(data.getvalue())
    with pytest.raises(DatasetError) as caught:
        unpack(tmp_path / "a.zip", tmp_path / "out")
    assert [p.found for p in caught.value.problems] == [
        "'../a': a path that leads out of the folder",
        "'/b': an absolute path",
        "'c/../../d': a path that leads out of the folder",
    ]


def test_encrypted_and_oddly_packed_zips_are_refused(tmp_path):
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_LZMA) as z:
        z.writestr("a", b"x" * 100)
    (tmp_path / "a.zip").write_bytes(data.getvalue())
    with pytest.raises(DatasetError, match="compression method 14"):
        unpack(tmp_path / "a.zip", tmp_path / "out")
    plain = bytearray(zipped({"a": b"x"}))
    plain[plain.index(b"PK\x01\x02") + 8] |= 1
    (tmp_path / "a.zip").write_bytes(plain)
    with pytest.raises(DatasetError, match="encrypted"):
        unpack(tmp_path / "a.zip", tmp_path / "out")


@pytest.mark.parametrize("announced", [10, 5000])
def test_zip_with_false_sizes(tmp_path, announced):
    data = bytearray(zipped({"a": b"y" * 1000}))
    at = data.index(b"PK\x01\x02") + 24
    data[at : at + 4] = announced.to_bytes(4, "little")
    (tmp_path / "a.zip").write_bytes(data)
    with pytest.raises(DatasetError, match="damaged"):
        unpack(tmp_path / "a.zip", tmp_path / "out")


def test_limits_on_number_size_and_the_list_of_a_zip(tmp_path, monkeypatch):
    archive = tmp_path / "a.zip"
    for data in (zipped({f"{i}": b"" for i in range(30)}), tarred([(member(f"{i}"), b"") for i in range(30)])):
        archive.write_bytes(data)
        with pytest.raises(DatasetError, match="at most 20"):
            unpack(archive, tmp_path / "out", Limits(files=20))
        assert unpack(archive, tmp_path / "out", Limits(files=30)).files == 30
        shutil.rmtree(tmp_path / "out")
    archive.write_bytes(zipped({"a": BODY}))
    with pytest.raises(DatasetError, match=r"would become 300000 or more; expected at most 299999"):
        unpack(archive, tmp_path / "out", Limits(total_bytes=299_999))
    monkeypatch.setattr("infrablend.fetching.unpack._DIRECTORY_BYTES", 40)
    with pytest.raises(DatasetError, match="a list of"):
        unpack(archive, tmp_path / "out")


def test_decompression_bombs_do_not_fill_memory(tmp_path):
    """Peak memory of a process of its own that meets three bombs."""
    names = ("zip bomb", "tar bomb", "tar header bomb", "tar gz bomb after its end")
    for k, name in enumerate(names):
        (tmp_path / f"{k}").write_bytes(HOSTILE[name]())
    code = f"""
import resource, pathlib
from infrablend.errors import DatasetError
from infrablend.fetching.unpack import unpack
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for k in range({len(names)}):
    try:
        unpack(pathlib.Path({str(tmp_path)!r}) / str(k), pathlib.Path({str(tmp_path)!r}) / "out")
    except DatasetError:
        pass
    else:
        raise SystemExit(f"bomb {{k}} was unpacked")
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(done.stdout) < 30  # MB


def test_a_full_disk_while_unpacking(tmp_path, monkeypatch):
    (tmp_path / "a.zip").write_bytes(zipped(FILES))
    monkeypatch.setattr(shutil, "disk_usage", lambda path: type("U", (), {"free": 1000})())
    with pytest.raises(OutputError, match="not enough room"):
        unpack(tmp_path / "a.zip", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_zip_pointing_before_its_start_is_not_a_disk_error(tmp_path):
    data = bytearray(zipped(FILES))
    end = data.rindex(b"PK\x05\x06")
    data[end + 16 : end + 20] = (2**31 - 1).to_bytes(4, "little")  # where its list begins
    (tmp_path / "a.zip").write_bytes(data)
    with pytest.raises(DatasetError, match="damaged"):
        unpack(tmp_path / "a.zip", tmp_path / "out")


def test_a_disk_that_fills_up_while_a_file_is_written(tmp_path, monkeypatch):
    (tmp_path / "a.zip").write_bytes(zipped(FILES))
    opened = Path.open

    def full(self: Path, mode: str = "r", *rest: object, **more: object):
        if mode != "xb":
            return opened(self, mode, *rest, **more)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(OutputError) as caught:
        unpack(tmp_path / "a.zip", tmp_path / "out")
    assert [p.code for p in caught.value.problems] == ["disk-full"]
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("seed", range(40))
def test_archives_with_random_damage(tmp_path, seed):
    """A broken archive is refused with our own error, or gives regular files inside the folder."""
    draw = random.Random(seed)
    entries = [(member(n), c) for n, c in FILES.items()]
    data = bytearray(draw.choice([zipped(FILES), tarred(entries), tarred(entries, "w")]))
    for _ in range(draw.choice([1, 2, 5, 30])):
        at = draw.randrange(len(data) - 40)
        if draw.random() < 0.6:
            data[at] = draw.randrange(256)
        elif draw.random() < 0.5:
            data[at : at + 4] = draw.choice([b"\xff" * 4, b"../.", bytes(4)])
        else:
            del data[at : at + draw.randrange(1, 30)]
    (tmp_path / "a.bin").write_bytes(data)
    try:
        unpack(tmp_path / "a.bin", tmp_path / "in" / "out")
    except DatasetError:
        assert not (tmp_path / "in" / "out").exists()
    else:
        found = list((tmp_path / "in" / "out").rglob("*"))
        assert all((p.is_file() or p.is_dir()) and not p.is_symlink() for p in found)
    assert sorted(p.name for p in tmp_path.iterdir() if p.name != "in") == ["a.bin"]


# -- the whole -------------------------------------------------------------------------------------------------------

COMMIT = "f" * 40
CONTENT = {
    "LICENSE": b"licence text",
    "images/a.jpg": BODY[:9000],
    "images/b.jpg": BODY[9000:20000],
    "labels.json": b'{"annotations": [1, 2, 3]}',
}


def archive_of(content: dict[str, bytes], wrapper: str = "repo-ffff/", comment: str = COMMIT) -> bytes:
    return zipped({wrapper + n: c for n, c in content.items()}, comment.encode())


@pytest.fixture
def tiny(server, monkeypatch) -> Source:
    """A dataset of one archive on the server, one of two parts, one by hand, instead of the real ones."""
    one = Archive(
        "all", "tiny.zip", f"{server.url}/tiny.zip", commit=COMMIT,
        counts={"images/*.jpg": 2, "LICENSE": 1}, lists={"labels.json": {"annotations": 3}},
    )  # fmt: skip
    source = Source("tiny", "Tiny", "https://example.org/tiny", CC_BY_4, "A. Author", "@misc{tiny}", (one,))
    parts = tuple(
        Archive(
            p, f"{p}.zip", f"{server.url}/{p}.zip", into=f"Real{p}", counts={"*.csv": 1}, size_bytes=1, checked=False
        )
        for p in ("train", "test")
    )
    two = Source("two", "Two", "https://example.org/two", CC_BY_4, "B. Author", "@misc{two}", parts)
    by_hand = (Archive("all", "hand.zip"),)
    hand = Source(
        "hand", "Hand", "https://example.org/hand", sources.UNKNOWN, "C", "@misc{c}", by_hand, "None.", "Click there."
    )
    monkeypatch.setattr(sources, "SOURCES", (source, two, hand))
    monkeypatch.setattr(fetching, "SOURCES", (source, two, hand))
    server.files["/tiny.zip"] = archive_of(CONTENT)
    for p in ("train", "test"):  # folders doubled, and litter of another system beside them
        server.files[f"/{p}.zip"] = zipped(
            {f"R{p}/R{p}/s.csv": b"1,2", f"R{p}/R{p}/images/x.jpg": b"x", f"R{p}/.DS_Store": b"", "__MACOSX/x": b""}
        )
    return source


def fetch(name: str, out: Path, **options):
    of_call = {k: options.pop(k) for k in ("limits", "patience", "on_progress") if k in options}
    patience = RetryPolicy(failures=2, timeout_s=5, sleep=lambda s: None)
    return fetching.fetch(name, out, fetching.FetchRequest(**options), **{"patience": patience, **of_call})


def test_fetch_from_end_to_end(tiny, server, tmp_path):
    seen: list[FetchProgress] = []
    out = tmp_path / "deep" / "tiny"
    report = fetch("tiny", out, on_progress=seen.append)
    found = tree(out)
    record = json.loads(found.pop("SOURCE.json"))
    assert found == CONTENT
    assert sorted(p.name for p in out.iterdir()) == ["LICENSE", "SOURCE.json", "images", "labels.json"]
    assert (report.fetched, report.present, report.files, report.problems) == (("all",), (), 4, ())
    data = server.files["/tiny.zip"]
    facts = record["archives"]["all"]
    assert facts["sha256"] == hashlib.sha256(data).hexdigest()
    assert (facts["size_bytes"], facts["url"], facts["commit"]) == (len(data), f"{server.url}/tiny.zip", COMMIT)
    assert record["licence"] == {"id": "cc-by-4.0", "name": "CC BY 4.0", "url": CC_BY_4.url}
    assert (record["name"], record["attribution"], record["citation"]) == ("tiny", "A. Author", "@misc{tiny}")
    assert {p.step for p in seen} == {"download", "unpack"}
    assert (seen[-1].done, seen[-1].total) == (4, 4)
    # Again: nothing is asked of the server.
    asked = len(server.requests)
    again = fetch("tiny", out)
    assert (again.fetched, again.present) == ((), ("all",))
    assert len(server.requests) == asked


def test_fetch_resumes_after_interruption_at_every_step(tiny, server, tmp_path, monkeypatch):
    out = tmp_path / "tiny"
    server.files["/tiny.zip"] = archive_of({**CONTENT, "images/c.bin": BODY})
    whole = len(server.files["/tiny.zip"])

    def stop_at(step: str, done: int) -> Callable[[FetchProgress], None]:
        def show(p: FetchProgress) -> None:
            if p.step == step and p.done >= done:
                raise KeyboardInterrupt

        return show

    with pytest.raises(Interrupted, match="Repeat the command"):
        fetch("tiny", out, on_progress=stop_at("download", 100_000))
    assert [p.name for p in out.iterdir()] == [".fetch"]
    here = (out / ".fetch" / "tiny.zip.part").stat().st_size
    with pytest.raises(Interrupted, match="Repeat the command"):
        fetch("tiny", out, on_progress=stop_at("unpack", 2))
    assert 100_000 < here < whole
    assert [r["range"] for r in server.requests] == [None, f"bytes={here}-"]
    assert [p.name for p in out.iterdir()] == [".fetch"]
    # Stopped while entries are moved to their place: all but one are there, and what is left is a single folder.
    rename, moved = Path.rename, []

    def stops(self: Path, target: Path) -> Path:
        if len(moved) == 1:
            raise KeyboardInterrupt
        moved.append(target)
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", stops)
    with pytest.raises(Interrupted):
        fetch("tiny", out)
    assert [p.name for p in moved] == ["LICENSE"]
    monkeypatch.setattr(Path, "rename", rename)
    (out / ".fetch" / "all.unpacked" / "repo-ffff" / "labels.json").rename(out / "labels.json")
    asked = len(server.requests)
    # And at the very end, once all is in place and recorded but not yet cleared away.
    monkeypatch.setattr(fetching, "_sweep", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(Interrupted):
        fetch("tiny", out)
    monkeypatch.undo()
    monkeypatch.setattr(sources, "SOURCES", (tiny,))
    fetch("tiny", out)
    assert len(server.requests) == asked
    assert not (out / ".fetch").exists()
    found = tree(out)
    assert found.pop("SOURCE.json")
    assert found == {**CONTENT, "images/c.bin": BODY}


def test_removed_files_of_a_part_are_fetched_again(tiny, server, tmp_path):
    out = tmp_path / "tiny"
    fetch("tiny", out)
    whole = json.loads((out / "SOURCE.json").read_text())
    shutil.rmtree(out / "images")
    (out / "labels.json").write_bytes(b"mine")
    again = fetch("tiny", out)
    assert (again.fetched, again.present) == (("all",), ())
    found = tree(out)
    record = json.loads(found.pop("SOURCE.json"))
    assert found == {**CONTENT, "labels.json": b"mine"}  # what is there stays
    for facts in (whole["archives"]["all"], record["archives"]["all"]):
        assert facts.pop("places") == ["LICENSE", "images", "labels.json"] and facts.pop("fetched")
    assert record == whole


def test_folder_removed_while_it_is_fetched_is_not_fetched(tiny, server, tmp_path):
    out = tmp_path / "tiny"

    def remove(p: FetchProgress) -> None:
        if p.step == "unpack" and p.done == 2:
            shutil.rmtree(out)

    with pytest.raises(OutputError, match=r"removed|No such file"):
        fetch("tiny", out, on_progress=remove)
    shutil.rmtree(out, ignore_errors=True)
    fetch("tiny", out)
    found = tree(out)
    assert found.pop("SOURCE.json") and found == CONTENT


def test_parts_doubled_folders_and_litter(tiny, server, tmp_path):
    out = tmp_path / "two"
    report = fetch("two", out, parts=["test"])
    assert sorted(n for n in tree(out)) == ["Realtest/images/x.jpg", "Realtest/s.csv", "SOURCE.json"]
    assert [p.code for p in report.problems] == ["size"]
    assert report.problems[0].severity == "warning"
    report = fetch("two", out)
    assert (report.fetched, report.present) == (("train",), ("test",))
    assert (out / "Realtrain" / "s.csv").read_bytes() == b"1,2"
    record = json.loads((out / "SOURCE.json").read_text())
    assert sorted(record["archives"]) == ["test", "train"]


def test_wrong_content_is_refused_and_fetched_again(tiny, server, tmp_path):
    out = tmp_path / "tiny"
    less = {k: v for k, v in CONTENT.items() if k != "images/b.jpg"} | {"labels.json": b'{"annotations": [1]}'}
    server.files["/tiny.zip"] = archive_of(less, comment="e" * 40)
    with pytest.raises(DatasetError, match="does not contain the known files of tiny") as caught:
        fetch("tiny", out)
    assert [(p.code, p.found) for p in caught.value.problems] == [
        ("commit", f"made from commit {'e' * 40}"),
        ("content-files", "1 file(s)"),
        ("content-json", "1 items in 'annotations'"),
    ]
    assert not out.exists() or tree(out) == {}
    server.files["/tiny.zip"] = archive_of(CONTENT)
    fetch("tiny", out)
    # The user's own address may serve something else, which is reported.
    server.files["/own.zip"] = archive_of(less)
    report = fetch("tiny", tmp_path / "own", url=f"{server.url}/own.zip")
    assert [p.code for p in report.problems] == ["content-files", "content-json"]
    assert json.loads((tmp_path / "own" / "SOURCE.json").read_text())["archives"]["all"]["differs"]


def test_checksums(tiny, server, tmp_path):
    right = hashlib.sha256(server.files["/tiny.zip"]).hexdigest()
    fetch("tiny", tmp_path / "a", sha256=right.upper())
    with pytest.raises(DatasetError, match="not the expected file") as caught:
        fetch("tiny", tmp_path / "b", sha256="0" * 64)
    assert right in str(caught.value)
    assert "repeat the command to download it again" in str(caught.value)
    with pytest.raises(DatasetError, match="64 hexadecimal digits"):
        fetch("tiny", tmp_path / "c", sha256="abc")


def test_corrupt_archive_is_deleted_and_fetched_again(tiny, server, tmp_path):
    good = server.files["/tiny.zip"]
    server.files["/tiny.zip"] = good[:-100]
    with pytest.raises(DatasetError, match="damaged or incomplete"):
        fetch("tiny", tmp_path / "out")
    server.files["/tiny.zip"] = flipped(good, 200)
    with pytest.raises(DatasetError, match="damaged or incomplete"):
        fetch("tiny", tmp_path / "out")
    server.files["/tiny.zip"], server.etag = good, '"v2"'
    fetch("tiny", tmp_path / "out")
    assert (tmp_path / "out" / "images" / "a.jpg").read_bytes() == CONTENT["images/a.jpg"]


def test_a_hostile_archive_writes_nothing_outside(tiny, server, tmp_path):
    server.files["/tiny.zip"] = zip_entry("../../escaped")
    before = tree(tmp_path)
    with pytest.raises(DatasetError, match="leads out of the folder"):
        fetch("tiny", tmp_path / "out")
    assert tree(tmp_path) == before


def test_nothing_is_overwritten(tiny, server, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    with pytest.raises(OutputError, match="not empty"):
        fetch("tiny", out)
    (out / "mine.txt").unlink()
    fetch("two", out, parts=["train"])
    (out / "Realtest").mkdir()
    (out / "Realtest" / "mine.txt").write_text("mine")
    with pytest.raises(OutputError, match="exists and was not written"):
        fetch("two", out)
    with pytest.raises(OutputError, match="holds two"):
        fetch("tiny", out)
    assert (out / "Realtest" / "mine.txt").read_text() == "mine"
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match="is a file"):
        fetch("tiny", tmp_path / "file")
    server.files["/tiny.zip"] = archive_of({**CONTENT, "SOURCE.json": b"{}"})
    with pytest.raises(DatasetError, match="a name that `fetch` needs"):
        fetch("tiny", tmp_path / "new")


def test_two_fetches_at_once(tiny, tmp_path):
    from infrablend.core.output import OutputFolder

    with (
        OutputFolder(tmp_path / "out", "download").claimed(),
        pytest.raises(OutputError, match="another process is writing this download"),
    ):
        fetch("tiny", tmp_path / "out")


def test_lack_of_disk_space_is_detected_before_the_download(tiny, server, tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda path: type("U", (), {"free": 1000})())
    with pytest.raises(OutputError, match="not enough room"):
        fetch("tiny", tmp_path / "out")
    assert len(server.sent) <= 1


def test_a_failure_leaves_no_empty_folders(tiny, server, tmp_path):
    server.always = ("status", 404)
    with pytest.raises(FetchError):
        fetch("tiny", tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_keep_archive_and_archive_by_hand(tiny, server, tmp_path):
    fetch("tiny", tmp_path / "a", keep_archive=True)
    assert (tmp_path / "a" / "tiny.zip").read_bytes() == server.files["/tiny.zip"]
    by_hand = tmp_path / "download (1).zip"
    by_hand.write_bytes(zipped({"x/1.jpg": b"x", "x/2.jpg": b"y"}))
    asked = len(server.requests)
    report = fetch("hand", tmp_path / "b", archive=by_hand)
    assert report.files == 2
    assert len(server.requests) == asked
    assert by_hand.exists()
    record = json.loads((tmp_path / "b" / "SOURCE.json").read_text())
    assert record["licence"]["id"] == "unknown"
    assert record["archives"]["all"]["file"] == "download (1).zip"
    with pytest.raises(DatasetError, match=r"(?s)nothing was fetched.*Click there.*--archive"):
        fetch("hand", tmp_path / "c")


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("nothing", {}, "expected one of tiny, two, hand"),
        ("two", {"parts": ["val"]}, "no part val; expected some of train, test"),
        ("two", {"url": "http://x/y"}, "with --part"),
        ("tiny", {"url": "http://x/y", "archive": Path("z")}, "exclude each other"),
        ("tiny", {"archive": Path("no-such-file.zip")}, "no such file"),
        ("tiny", {"url": "file:///etc/passwd"}, "expected http"),
    ],
)
def test_invalid_requests(tiny, tmp_path, name, options, says):
    with pytest.raises(InfraBlendError, match=says):
        fetch(name, tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


def test_the_command(tiny, server, tmp_path, capsys):
    log = ["--log", str(tmp_path / "log")]
    assert main([*log, "fetch", "--list"]) == 0
    assert "by hand, licence unknown" in capsys.readouterr().out
    assert main([*log, "fetch", "hand"]) == 0
    assert "Click there." in capsys.readouterr().out
    assert main([*log, "fetch", "hand", str(tmp_path / "x")]) == 2
    assert main([*log, "fetch"]) == 2
    capsys.readouterr()
    assert main([*log, "fetch", "tiny", str(tmp_path / "out"), "--json"]) == 0
    shown = capsys.readouterr()
    assert json.loads(shown.out)["fetched"] == ["all"]
    licence, download_line = shown.err.index("CC BY 4.0"), shown.err.index("tiny.zip: ")
    assert licence < download_line  # before anything is fetched
    server.always = ("status", 403)
    assert main([*log, "fetch", "two", str(tmp_path / "two"), "--part", "train"]) == 3
    assert "refuses access" in capsys.readouterr().err


def test_progress_lines():
    assert fetch_line(FetchProgress("unpack", "a.zip", 3, 9)) == "a.zip: 3 of 9 files unpacked"
    assert fetch_line(FetchProgress("download", "a.zip", 2**20, None)) == "a.zip: 1.0 MiB"
    now = iter([0.0, 0.0, 2.0])
    pace = FetchPace(clock=lambda: next(now))
    pace(FetchProgress("download", "a.zip", 0, 4 * 2**20))
    assert (
        pace(FetchProgress("download", "a.zip", 2**20, 4 * 2**20))
        == "a.zip: 1.0 MiB of 4.0 MiB, 512.0 KiB/s, 6.0 s to go"
    )


def test_the_table_of_sources():
    assert [s.name for s in sources.SOURCES] == [
        "hit-uav", "birdsai", "monet", "wisard", "wit-uas", "dut-anti-uav", "bambi", "drone-vehicle", "anti-uav",
        "halmstad",
    ]  # fmt: skip
    for s in sources.SOURCES:
        fetched = [a.url for a in s.archives if a.url]
        assert all(u.startswith("https://") for u in fetched)
        assert bool(s.by_hand) != bool(fetched)
        assert s.citation.startswith("@")
        assert s.citation.count("{") == s.citation.count("}")
        assert len({a.part for a in s.archives}) == len(s.archives)
        assert s.name in api.describe_source(s.name)


@pytest.mark.slow
def test_hit_uav_as_it_is_known(server, tmp_path):
    """An archive of empty pictures with the real layout, numbers and commit passes; one picture less does not."""
    (known,) = HIT_UAV.archives
    entries = {"LICENSE": b"Attribution 4.0 International"}
    for pattern, n in known.counts.items():
        if "*" in pattern:
            entries |= {pattern.replace("*", f"{k:05}"): b"" for k in range(n)}
    for name, lists in known.lists.items():
        entries[name] = json.dumps({k: [0] * n for k, n in lists.items()}).encode()
    assert sum(n.endswith(".jpg") for n in entries) == 4 * 2898
    file = tmp_path / "a.zip"
    file.write_bytes(archive_of(entries, "HIT-UAV-Infrared-Thermal-Dataset-x/", known.commit))
    report = api.fetch("hit-uav", tmp_path / "out", api.FetchRequest(archive=file))
    assert report.problems == ()
    assert report.files == len(entries)
    del entries["normal_json/train/00007.jpg"]
    file.write_bytes(archive_of(entries, "HIT-UAV-Infrared-Thermal-Dataset-x/", known.commit))
    (problem,) = api.fetch("hit-uav", tmp_path / "less", api.FetchRequest(archive=file)).problems
    assert (problem.where, problem.found, problem.expected) == ("normal_json/train/*.jpg", "2028 file(s)", "2029")


def packed(folder, file):
    with zipfile.ZipFile(file, "w") as archive:
        for path in sorted(p for p in folder.rglob("*") if p.is_file()):
            archive.write(path, path.relative_to(folder))
    return file


def test_an_archive_of_another_dataset_is_refused(tmp_path):
    other = packed(SAMPLES["yolo:detect"](tmp_path / "yolo"), tmp_path / "mine.zip")
    shown = []
    with pytest.raises(DatasetError, match=r"mine.zip: not wit-uas") as error:
        fetch("wit-uas", tmp_path / "out", archive=other, on_progress=shown.append)
    (problem,) = error.value.problems
    assert "it is read as yolo" in problem.found and "licence" in problem.todo
    assert not (tmp_path / "out").exists() and {p.file for p in shown} == {"mine.zip"}


def test_a_part_of_another_dataset_is_a_warning(tmp_path):
    other = packed(SAMPLES["yolo:detect"](tmp_path / "yolo"), tmp_path / "mine.zip")
    (problem,) = fetch("monet", tmp_path / "out", parts=["val"], archive=other).problems
    assert (problem.code, problem.severity) == ("not-this-format", "warning") and "monet" in problem.expected


def test_the_own_archive_of_a_dataset_is_accepted(tmp_path):
    own = packed(SAMPLES["wit-uas"](tmp_path / "wit"), tmp_path / "mine.zip")
    assert fetch("wit-uas", tmp_path / "out", archive=own).problems == ()
    assert api.read_dataset(tmp_path / "out").format == "wit-uas"
