"""Access to the studio: nothing without the token, from another site, or for another host name."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Any

import pytest

from infrablend.errors import ArgumentError
from infrablend.studio.guard import Guard, is_loopback
from infrablend.studio.studio_request import Address

TOKEN = "secret-token"
PORT = 8123


async def application(scope: Any, receive: Any, send: Any) -> None:
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"inside"})


def answer(path: str = "/", query: str = "", kind: str = "http", **headers: str) -> dict[str, Any]:
    """Return status and headers of the answer to a request."""
    sent: list[Any] = []

    async def send(message: Any) -> None:
        sent.append(message)

    given = [(k.encode(), v.encode()) for k, v in {"host": f"127.0.0.1:{PORT}", **headers}.items()]
    scope = {"type": kind, "path": path, "query_string": query.encode(), "headers": given}
    guard = Guard(application, PORT)
    guard.token = TOKEN
    asyncio.run(guard(scope, None, send))  # type: ignore[arg-type]
    first = sent[0]
    return {"type": first["type"], "status": first.get("status"), **dict(first.get("headers", ()))}


def cookie(value: str = TOKEN) -> str:
    return f"infrablend_studio_{PORT}={value}"


@pytest.mark.parametrize("path", ["/", "/review", "/run/thumb/0.jpg", "/_nicegui/static/nicegui.js", "//x"])
def test_nothing_is_served_without_the_token(path: str) -> None:
    for query, given in (("", ""), ("token=", ""), ("token=wrong", ""), ("", cookie("")), ("", cookie("wrong"))):
        assert answer(path, query, cookie=given)["status"] == 403
    assert answer(path, kind="websocket")["type"] == "websocket.close"
    assert answer(path, cookie=cookie())["status"] == 200


def test_the_token_becomes_a_cookie_and_leaves_the_address() -> None:
    first = answer("/review", f"sort=id&token={TOKEN}")
    assert first["status"] == 303
    assert first[b"location"] == b"/review?sort=id"
    assert first[b"set-cookie"] == f"{cookie()}; Path=/; HttpOnly; SameSite=Strict".encode()
    again = answer("/review", f"token={TOKEN}", cookie=cookie())
    assert again[b"location"] == b"/review" and b"set-cookie" not in again
    assert answer("//evil.example/", f"token={TOKEN}")[b"location"] == b"/evil.example/"


def test_requests_of_other_sites_and_for_other_names_are_refused_even_with_the_cookie() -> None:
    assert answer(cookie=cookie(), origin="http://evil.example")["status"] == 403
    assert answer(cookie=cookie(), origin="null")["status"] == 403
    assert answer(kind="websocket", cookie=cookie(), origin="http://127.0.0.1:9")["type"] == "websocket.close"
    assert answer(cookie=cookie(), origin=f"http://127.0.0.1:{PORT}")["status"] == 200
    assert answer(cookie=cookie(), host="evil.example")["status"] == 403
    assert answer(cookie=cookie(), host="127.0.0.1.evil.example")["status"] == 403
    assert answer(cookie=cookie(), host="localhost:8123")["status"] == 200
    assert answer(cookie=cookie(), host="[::1]:8123")["status"] == 200


def test_pages_may_load_nothing_from_elsewhere() -> None:
    policy = answer(cookie=cookie())[b"content-security-policy"].decode()
    assert "default-src 'self'" in policy and "frame-ancestors 'none'" in policy
    assert "http" not in policy and "*" not in policy


def test_tokens_are_long_and_differ() -> None:
    first, second = (Guard(application, PORT).token for _ in range(2))
    assert len(first) >= 40 and first != second


def test_other_machines_are_let_in_only_on_request() -> None:
    assert is_loopback("127.0.0.1") and is_loopback("localhost") and is_loopback("::1")
    for host in ("0.0.0.0", "192.168.1.5", "::", "example.org"):
        with pytest.raises(ArgumentError, match="--yes-expose"):
            Address(host)
        assert Address(host, expose=True).host == host


@pytest.mark.parametrize("message", ["No response returned.", "a fault"])
def test_a_browser_that_leaves_before_the_answer_is_no_fault(message: str) -> None:
    async def left(scope: Any, receive: Any, send: Any) -> None:
        raise RuntimeError(message)

    guard = Guard(left, PORT)
    headers = [(b"host", b"localhost"), (b"cookie", cookie(guard.token).encode())]
    call = guard({"type": "http", "path": "/", "query_string": b"", "headers": headers}, None, None)  # type: ignore[arg-type]
    with contextlib.nullcontext() if message.startswith("No response") else pytest.raises(RuntimeError, match=message):
        asyncio.run(call)  # type: ignore[arg-type]
