"""A local server with scripted faults, and writers of archives, for the tests of `fetch`."""

from __future__ import annotations

import http.server
import io
import random
import stat
import tarfile
import time
import zipfile
from dataclasses import dataclass, field
from pathlib import Path

BODY = random.Random(4).randbytes(300_000)


@dataclass
class Server:
    """A server with scripted faults: each request uses one of `acts`; afterwards it serves correctly.

    An act: `("cut", n)` closes after n bytes of the body, `("status", code)`, `("redirect", url)`, `("stall",)`.
    """

    files: dict[str, bytes] = field(default_factory=dict)
    acts: list[tuple] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
    url: str = ""


class Handler(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "test", ""

    def log_message(self, *_: object) -> None:
        pass

    def do_GET(self) -> None:
        server: Server = self.server.told  # type: ignore[attr-defined]
        server.requests.append(self.path)
        act = server.acts.pop(0) if server.acts else ("serve",)
        self.close_connection = True
        body = server.files.get(self.path.partition("?")[0])
        if act[0] == "stall":
            time.sleep(1.0)
        elif act[0] == "redirect":
            self._head(302, {"Location": act[1], "Content-Length": "0"})
        elif act[0] == "status" or body is None:
            self._head(act[1] if act[0] == "status" else 404, {"Content-Length": "0"})
        else:
            self._head(200, {"Content-Length": str(len(body))})
            self.wfile.write(body[: act[1]] if act[0] == "cut" else body)

    def _head(self, status: int, headers: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()


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


def zip_entry(name: str, content: bytes = b"x", mode: int = stat.S_IFREG | 0o644) -> bytes:
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as z:
        info = zipfile.ZipInfo("placeholder")
        info.filename, info.create_system, info.external_attr = name, 3, mode << 16
        z.writestr(info, content)
    return data.getvalue()
