"""Access control: nobody but the owner of the terminal reaches a page, a picture or the websocket."""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qsl, urlencode, urlsplit

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]

QUERY = "token"
LOOPBACK = ("127.0.0.1", "::1", "localhost")

_REFUSED = (
    "403: this page belongs to the terminal that started it.\n\n"
    "Open the address that `infrablend studio` printed there, with its token. An address of an earlier start has\n"
    "another token.\n"
)
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; frame-ancestors 'none'; base-uri 'self'; "
    "form-action 'self'; object-src 'none'"
)
# Of Starlette, when a browser has left the page before it had the answer.
_LEFT = ("No response returned.",)
_HEADERS = (
    (b"content-security-policy", _POLICY.encode()),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
)


def is_loopback(host: str) -> bool:
    """Return whether only this machine can connect to a host name."""
    return host in LOOPBACK or host.startswith("127.")


class Guard:
    """An ASGI application that passes on only requests with the token.

    The token in an address sets a cookie and is removed from the address, so that it does not stay in the history.
    A request of another site's page, or for another host name (DNS rebinding), is refused even with the cookie.

    Attributes:
        token: The token, at random.
        cookie: Name of the cookie; one per port, since browsers share cookies between ports.
    """

    def __init__(self, app: Application, port: int, host: str = LOOPBACK[0]) -> None:
        """Guard `app`, which is served at this port; any host name is accepted unless `host` is a loopback one."""
        self.token = secrets.token_urlsafe(32)
        self.cookie = f"infrablend_studio_{port}"
        self._app = app
        self._hosts = {*LOOPBACK, "[::1]", host} if is_loopback(host) else None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        query = parse_qsl(scope.get("query_string", b"").decode("latin-1"), keep_blank_values=True)
        host = headers.get("host", "")
        own = self._is_own(host) and self._same_origin(headers.get("origin"), host)
        if own and self._matches(_cookie(headers.get("cookie", ""), self.cookie)):
            if scope["type"] == "http" and any(name == QUERY for name, _ in query):
                await _redirect(scope, send, query, None)
                return
            try:
                await self._app(scope, receive, _with_headers(send))
            except RuntimeError as error:
                if error.args != _LEFT:
                    raise
        elif own and scope["type"] == "http" and self._matches(dict(query).get(QUERY, "")):
            await _redirect(scope, send, query, f"{self.cookie}={self.token}; Path=/; HttpOnly; SameSite=Strict")
        else:
            await _refuse(scope, send)

    def _matches(self, given: str) -> bool:
        return hmac.compare_digest(given.encode("utf-8", "replace"), self.token.encode())

    def _is_own(self, host: str) -> bool:
        if self._hosts is None:
            return True
        try:
            name = urlsplit(f"//{host}").hostname
        except ValueError:
            return False
        return name in self._hosts

    @staticmethod
    def _same_origin(origin: str | None, host: str) -> bool:
        return origin is None or urlsplit(origin).netloc == host


def _cookie(header: str, name: str) -> str:
    try:
        found = SimpleCookie(header).get(name)
    except CookieError:
        return ""
    return "" if found is None else found.value


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            message = {**message, "headers": [*message.get("headers", ()), *_HEADERS]}
        await send(message)

    return sending


async def _redirect(scope: Scope, send: Send, query: list[tuple[str, str]], cookie: str | None) -> None:
    """Lead to the same address without the token."""
    rest = urlencode([(name, value) for name, value in query if name != QUERY])
    # A path with two slashes in front would be the address of another host.
    path = "/" + scope.get("raw_path", scope["path"].encode()).decode("latin-1").lstrip("/\\")
    headers = [(b"location", (path + (f"?{rest}" if rest else "")).encode("latin-1")), *_HEADERS]
    if cookie is not None:
        headers.append((b"set-cookie", cookie.encode("latin-1")))
    await _answer(send, 303, headers)


async def _refuse(scope: Scope, send: Send) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008})
        return
    await _answer(send, 403, [(b"content-type", b"text/plain; charset=utf-8"), *_HEADERS], _REFUSED.encode())


async def _answer(send: Send, status: int, headers: list[tuple[bytes, bytes]], body: bytes = b"") -> None:
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
