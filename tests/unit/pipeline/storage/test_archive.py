"""Downloads from a local server, and archives that are damaged or lead out of their folder."""

from __future__ import annotations

import contextlib
import errno
import http.server
import io
import random
import shutil
import ssl
import stat
import subprocess
import tarfile
import threading
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from infrablend.errors import DatasetError, FetchError, OutputError
from infrablend.pipeline.storage import archive as archives
from infrablend.pipeline.storage.archive import Unpacked, download, unpack, without_wrapper
from tests.unit.pipeline.storage.server import BODY, Handler, Server, member, tarred, tree, zip_entry, zipped


def get(url: str, file: Path, on_bytes: Callable[[int, int | None], None] = lambda done, total: None) -> str:
    return download(url, file, 0, on_bytes)


def test_a_file_is_fetched_with_progress(server: Server, tmp_path: Path) -> None:
    seen: list[tuple[int, int | None]] = []
    final = get(f"{server.url}/a.zip?token=secret", tmp_path / "a", lambda n, of: seen.append((n, of)))
    assert (tmp_path / "a").read_bytes() == BODY
    assert final == f"{server.url}/a.zip"
    assert seen[-1] == (len(BODY), len(BODY))
    assert [n for n, _ in seen] == sorted(n for n, _ in seen)


@pytest.mark.parametrize(
    ("status", "says"),
    [(403, "refuses access"), (404, "give --url"), (401, "requires a login"), (410, "gone"), (503, "try again later")],
)
def test_refusals_say_what_to_do(server: Server, tmp_path: Path, status: int, says: str) -> None:
    server.acts = [("status", status)]
    with pytest.raises(FetchError, match=f"(?si)HTTP {status}.*{says}") as caught:
        get(f"{server.url}/a.zip?token=secret", tmp_path / "a")
    assert "secret" not in str(caught.value)
    assert not (tmp_path / "a").exists()


def test_a_connection_that_breaks_or_is_silent(server: Server, tmp_path: Path, monkeypatch) -> None:
    server.acts = [("cut", 100_000)]
    with pytest.raises(FetchError, match=r"broken one.*Repeat the command"):
        get(f"{server.url}/a.zip", tmp_path / "a")
    monkeypatch.setattr(archives, "_TIMEOUT_S", 0.2)
    server.acts = [("stall",)]
    with pytest.raises(FetchError, match="timed out"):
        get(f"{server.url}/a.zip", tmp_path / "b")
    with pytest.raises(FetchError, match="no connection"):
        get("http://127.0.0.1:1/a.zip", tmp_path / "c")


def test_redirects_are_followed_on_the_web_alone(server: Server, tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("mine")
    server.acts = [("redirect", "/a.zip?signature=abc")]
    assert get(f"{server.url}/start", tmp_path / "a") == f"{server.url}/a.zip"
    for k, target in enumerate(((tmp_path / "secret").as_uri(), "/a.zip" + 20 * "/..", "ftp:///x")):
        server.acts = [("redirect", target)]
        with pytest.raises(FetchError):
            get(f"{server.url}/start", tmp_path / f"{k}")


def test_encrypted_connections_do_not_become_plain(tmp_path: Path, monkeypatch) -> None:
    class Answer:
        def geturl(self) -> str:
            return "http://example.org/a.zip"

        def __enter__(self) -> Answer:
            return self

        def __exit__(self, *_: object) -> None:
            pass

    monkeypatch.setattr("urllib.request.urlopen", lambda *_, **__: Answer())
    with pytest.raises(FetchError, match="expected https"):
        get("https://example.org/a.zip", tmp_path / "a")


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
def test_invalid_addresses(url: str, tmp_path: Path) -> None:
    with pytest.raises(FetchError, match="expected http"):
        get(url, tmp_path / "a")


def test_proxies_of_the_environment_are_used(server: Server, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("http_proxy", server.url)
    monkeypatch.setattr("urllib.request._opener", None)  # made for the first address of a process
    server.files["http://data.example/a.zip"] = b"through the proxy"
    get("http://data.example/a.zip", tmp_path / "a")
    assert (tmp_path / "a").read_bytes() == b"through the proxy"


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the certificate")
def test_untrusted_certificate_is_reported_plainly(tmp_path):
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
            get(f"https://127.0.0.1:{https.server_port}/a.zip", tmp_path / "a")
    finally:
        https.shutdown()
        thread.join()
        https.server_close()


def unpacked(archive: Path, out: Path) -> Unpacked:
    return unpack(archive, out, lambda done, total: None)


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
    done = unpack(archive, tmp_path / "out", lambda n, of: seen.append((n, of)))
    assert tree(tmp_path / "out") == FILES
    assert (done.files, done.size_bytes, done.commit) == (4, 6001, commit)
    assert [n for n, _ in seen] == [1, 2, 3, 4]
    assert without_wrapper(tmp_path / "out") == tmp_path / "out" / "top"
    assert not any(p.stat().st_mode & 0o111 for p in (tmp_path / "out").rglob("*") if p.is_file())


HOSTILE: dict[str, Callable[[], bytes]] = {
    "zip climbs": lambda: zip_entry("../escaped"),
    "zip climbs inside": lambda: zip_entry("a/../../escaped"),
    "zip climbs in Windows' way": lambda: zip_entry("..\\escaped"),
    "zip absolute": lambda: zip_entry("/tmp/escaped"),
    "zip drive": lambda: zip_entry("C:/escaped"),
    "zip symlink": lambda: zip_entry("link", b"/etc/passwd", stat.S_IFLNK | 0o777),
    "zip device": lambda: zip_entry("device", b"", stat.S_IFCHR | 0o666),
    "zip fifo": lambda: zip_entry("fifo", b"", stat.S_IFIFO | 0o666),
    "tar climbs": lambda: tarred([(member("../escaped"), b"x")]),
    "tar symlink out": lambda: tarred([(member("link", tarfile.SYMTYPE, "/etc"), b""), (member("link/x"), b"x")]),
    "tar hardlink": lambda: tarred([(member("link", tarfile.LNKTYPE, "/etc/passwd"), b"")]),
    "tar device": lambda: tarred([(member("device", tarfile.CHRTYPE), b"")]),
    "tar fifo": lambda: tarred([(member("fifo", tarfile.FIFOTYPE), b"")]),
    "tar file as folder": lambda: tarred([(member("a"), b"x"), (member("a/b"), b"y")]),
    "html": lambda: b"<!DOCTYPE html><html>please log in</html>",
    "empty": lambda: b"",
    "rar": lambda: b"Rar!\x1a\x07\x00" + bytes(100),
    "zip cut short": lambda: zipped(FILES)[:-200],
    "zip without a start": lambda: zipped(FILES)[100:],
    "zip flipped byte": lambda: flipped(zipped({"a": BODY[:1000]}), 300),
    "tar.gz cut short": lambda: tarred([(member("a"), BODY)])[:-5000],
    "tar.gz wrong checksum": lambda: flipped(tarred([(member("a"), BODY)]), -6),
    "tar cut between entries": lambda: tarred([(member("a"), b"x" * 512), (member("b"), b"y")], "w")[:1024],
    "tar broken header": lambda: flipped(tarred([(member("a"), b"x" * 512), (member("b"), b"y")], "w", ""), 1024 + 150),
}  # fmt: skip


def flipped(data: bytes, at: int) -> bytes:
    changed = bytearray(data)
    changed[at] ^= 0x55
    return bytes(changed)


@pytest.mark.parametrize("what", HOSTILE)
def test_unsafe_and_broken_archives_are_refused(tmp_path: Path, what: str) -> None:
    archive = tmp_path / "a.zip"
    archive.write_bytes(HOSTILE[what]())
    (tmp_path / "deep").mkdir()
    with pytest.raises(DatasetError) as caught:
        unpacked(archive, tmp_path / "deep" / "out")
    assert sorted(p.name for p in tmp_path.rglob("*") if "out" not in p.parts) == ["a.zip", "deep"]
    assert caught.value.problems
    assert all(p.expected for p in caught.value.problems)


def test_all_bad_entries_of_a_zip_are_named(tmp_path):
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as z:
        for name in ("../a", "good", "/b", "c/../../d"):
            z.writestr(name, b"x")
    (tmp_path / "a.zip").write_bytes(data.getvalue())
    with pytest.raises(DatasetError) as caught:
        unpacked(tmp_path / "a.zip", tmp_path / "out")
    assert [p.found for p in caught.value.problems] == [
        "'../a': a path that leads out of the folder",
        "'/b': a path that leads out of the folder",
        "'c/../../d': a path that leads out of the folder",
    ]


def test_an_encrypted_zip_is_refused(tmp_path: Path) -> None:
    plain = bytearray(zipped({"a": b"x"}))
    for mark, at in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        plain[plain.index(mark) + at] |= 1
    (tmp_path / "a.zip").write_bytes(plain)
    with pytest.raises(DatasetError, match="encrypted"):
        unpacked(tmp_path / "a.zip", tmp_path / "out")


def test_zip_with_a_false_size(tmp_path):
    data = bytearray(zipped({"a": b"y" * 1000}))
    at = data.index(b"PK\x01\x02") + 24
    data[at : at + 4] = (10).to_bytes(4, "little")
    (tmp_path / "a.zip").write_bytes(data)
    with pytest.raises(DatasetError, match="damaged"):
        unpacked(tmp_path / "a.zip", tmp_path / "out")


def test_limits_on_number_and_size(tmp_path: Path, monkeypatch) -> None:
    archive = tmp_path / "a.zip"
    for k, data in enumerate((zipped({"a": b"x", "b": b"y"}), tarred([(member("a"), b"x"), (member("b"), b"y")]))):
        archive.write_bytes(data)
        for name, most in (("MAX_MEMBERS", 1), ("MAX_BYTES", 1)):
            with monkeypatch.context() as patch, pytest.raises(DatasetError, match="expected at most"):
                patch.setattr(archives, name, most)
                unpacked(archive, tmp_path / f"{name}{k}")
        assert unpacked(archive, tmp_path / f"{k}").files == 2


def test_a_full_disk(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "a.zip").write_bytes(zipped(FILES))
    with monkeypatch.context() as patch, pytest.raises(OutputError, match="not enough disk space"):
        patch.setattr(shutil, "disk_usage", lambda path: type("U", (), {"free": 1000})())
        unpacked(tmp_path / "a.zip", tmp_path / "out")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(shutil, "copyfileobj", full)
    with pytest.raises(OutputError) as caught:
        unpacked(tmp_path / "a.zip", tmp_path / "out")
    assert [p.code for p in caught.value.problems] == ["disk-full"]


def test_zip_pointing_before_its_start_is_not_a_disk_error(tmp_path):
    data = bytearray(zipped(FILES))
    end = data.rindex(b"PK\x05\x06")
    data[end + 16 : end + 20] = (2**31 - 1).to_bytes(4, "little")  # where its list begins
    (tmp_path / "a.zip").write_bytes(data)
    with pytest.raises(DatasetError, match="damaged"):
        unpacked(tmp_path / "a.zip", tmp_path / "out")


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
    (tmp_path / "in").mkdir()
    with contextlib.suppress(DatasetError):
        unpacked(tmp_path / "a.bin", tmp_path / "in" / "out")
    assert sorted(p.name for p in tmp_path.iterdir() if p.name != "in") == ["a.bin"]
