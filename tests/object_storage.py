"""An S3 server for tests (moto's), which can be busy, slow, full, read-only, dishonest, or end its client."""

from __future__ import annotations

import io
import threading
import uuid
from collections.abc import Callable, Iterable
from typing import Any

import pytest

pytest.importorskip("s3fs", reason="NEEDS S3FS: `make s3` installs it; object storage is not tested without it")
pytest.importorskip("moto.server", reason="NEEDS MOTO: `make s3` installs it; object storage is not tested without it")

Answer = tuple[str, str]
"""Status line and code of an error, as S3 answers it."""
BUSY = ("503 Slow Down", "SlowDown")
FULL = ("507 Insufficient Storage", "QuotaExceeded")
FORBIDDEN = ("403 Forbidden", "AccessDenied")
Rule = Callable[[str, str, dict[str, Any]], "Answer | None"]


class Server:
    """S3 on this machine, with one bucket.

    Attributes:
        address: Address of a folder in the bucket.
        rule: Called with method, path and WSGI environment of each request; may answer it.
        requests: Method and path of each request.
    """

    def __init__(self) -> None:
        from moto.server import DomainDispatcherApplication, create_backend_app
        from werkzeug.serving import WSGIRequestHandler, make_server

        class Quiet(WSGIRequestHandler):
            def log_request(self, *args: object) -> None:
                pass

        self.rule: Rule | None = None
        self.requests: list[tuple[str, str]] = []
        self._app = DomainDispatcherApplication(create_backend_app)
        self._server = make_server("127.0.0.1", 0, self._answer, threaded=True, request_handler=Quiet)
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()
        self.endpoint = f"http://127.0.0.1:{self._server.server_port}"
        self.bucket = f"bucket-{uuid.uuid4().hex[:12]}"
        self.address = f"s3://{self.bucket}/run"

    def _answer(self, environ: dict[str, Any], start: Callable[..., Any]) -> Iterable[bytes]:
        method, path = environ["REQUEST_METHOD"], environ["PATH_INFO"]
        self.requests.append((method, path))
        found = self.rule(method, path, environ) if self.rule is not None else None
        if found is None:
            return self._app(environ, start)  # type: ignore[no-any-return]
        status, code = found
        environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
        body = f"<?xml version='1.0'?><Error><Code>{code}</Code><Message>{code}</Message></Error>".encode()
        start(status, [("Content-Type", "application/xml"), ("Content-Length", str(len(body)))])
        return [] if method == "HEAD" else [body]

    def files(self) -> Any:
        """Return a file system of its own, which no test disturbs."""
        import s3fs

        return s3fs.S3FileSystem(endpoint_url=self.endpoint, skip_instance_cache=True, use_listings_cache=False)

    def names(self) -> list[str]:
        """Return the names of the files in the folder, sorted."""
        rule, self.rule = self.rule, None
        try:
            return sorted(p.rpartition("/")[2] for p in self.files().find(f"{self.bucket}/run"))
        finally:
            self.rule = rule

    def stop(self) -> None:
        """Stop the server."""
        self._server.shutdown()
        self._thread.join()


def shorten_body(environ: dict[str, Any], length: int) -> None:
    """Cut a request's body."""
    body = environ["wsgi.input"].read(int(environ["CONTENT_LENGTH"]))[:length]
    environ["wsgi.input"], environ["CONTENT_LENGTH"] = io.BytesIO(body), str(len(body))


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> Iterable[Server]:
    """S3 that the libraries find by themselves, by the environment, as they do in a cluster."""
    s3 = Server()
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    for name, value in {
        "AWS_ENDPOINT_URL": s3.endpoint, "AWS_ACCESS_KEY_ID": "AKIATESTTESTTEST", "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_SECRET_ACCESS_KEY": "very-secret-word", "AWS_EC2_METADATA_DISABLED": "true", "TMPDIR": str(scratch),
    }.items():  # fmt: skip
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("tempfile.tempdir", None)
    s3.files().mkdir(s3.bucket)
    yield s3
    s3.stop()
    monkeypatch.setattr("tempfile.tempdir", None)
