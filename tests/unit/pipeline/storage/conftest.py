"""A local server for the tests of `fetch`, which ignore the proxies of the environment."""

from __future__ import annotations

import http.server
import os
import threading
from collections.abc import Iterator

import pytest

from tests.unit.pipeline.storage.server import BODY, Handler, Server


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
