"""Serves the pages: checks the address, opens the run, prints the address, ends with Ctrl-C."""

from __future__ import annotations

import contextlib
import os
import socket
import tempfile
from collections.abc import Callable, Iterator
from importlib.util import find_spec

from infrablend.core.files import cache_folder
from infrablend.errors import ArgumentError, MissingDependencyError
from infrablend.studio.guard import QUERY, Guard
from infrablend.studio.studio_request import Address, StudioRequest

_CLOSE_S = 1


def serve(request: StudioRequest, address: Address, on_ready: Callable[[str], None]) -> None:
    """Serve the pages until Ctrl-C; `on_ready` is called with the address to open once the server accepts requests.

    Raises:
        InfraBlendError: The run, the recipe or the data cannot be opened, the port is taken, or the extra is missing.
    """
    if find_spec("nicegui") is None:
        raise MissingDependencyError(
            'nicegui not installed, which the studio needs; install with\n  pip install "infrablend[studio]"\n'
            "(in a checkout: make studio)"
        )
    from infrablend.studio.open_studio import Session

    with contextlib.closing(Session(request)) as session, _listening(address) as listening, _no_storage():
        import uvicorn
        from fastapi import FastAPI
        from nicegui import ui

        from infrablend.studio.pages import add_pages

        add_pages(session)
        app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
        ui.run_with(app, title="InfraBlend studio", show_welcome_message=False, reconnect_timeout=30)
        host = address.host
        port = listening.getsockname()[1]
        shown = f"[{host}]" if ":" in host else host
        guard = Guard(app, port, host)

        class Server(uvicorn.Server):
            async def startup(self, sockets: list[socket.socket] | None = None) -> None:
                await super().startup(sockets)
                on_ready(f"http://{shown}:{port}/?{QUERY}={guard.token}")

        config = uvicorn.Config(
            guard,
            log_level="warning",
            access_log=False,
            server_header=False,
            timeout_graceful_shutdown=_CLOSE_S,
        )
        with contextlib.suppress(KeyboardInterrupt):  # the usual end
            Server(config).run(sockets=[listening])


@contextlib.contextmanager
def _listening(address: Address) -> Iterator[socket.socket]:
    try:
        family, *_, place = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_STREAM)[0]
        listening = socket.socket(family, socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(place)
    except (OSError, OverflowError) as error:
        raise ArgumentError(
            f"--host {address.host} --port {address.port}: cannot be used ({error}); expected a free port. Give "
            "another --port, or none for any free one"
        ) from error
    with listening:
        yield listening


@contextlib.contextmanager
def _no_storage() -> Iterator[None]:
    """Keep NiceGUI from leaving a `.nicegui` folder in the current one."""
    folder = cache_folder() / "studio"
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder, prefix="session-") as storage:
        os.environ["NICEGUI_STORAGE_PATH"] = storage
        yield
