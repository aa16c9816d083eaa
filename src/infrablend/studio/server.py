"""Serves the pages: checks the address, opens the run, prints the address, ends with Ctrl-C."""

from __future__ import annotations

import contextlib
import os
import socket
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from infrablend.core.user_folders import cache_folder
from infrablend.errors import ArgumentError, MissingDependencyError
from infrablend.formats.reading import READ_ALL, Reading
from infrablend.pipeline.request import ONE_WORKER, Execution
from infrablend.studio.guard import LOOPBACK, QUERY, Guard, is_loopback, new_token

_CLOSE_S = 1


@dataclass(frozen=True)
class Address:
    """Where to serve.

    Attributes:
        host: Name or address of this machine's interface.
        port: Port; 0 for any free one.
        expose: Whether other machines may connect, with the token.
    """

    host: str = LOOPBACK[0]
    port: int = 0
    expose: bool = False

    def __post_init__(self) -> None:
        if not is_loopback(self.host) and not self.expose:
            raise ArgumentError(
                f"--host {self.host}: other machines could connect, and the connection is not encrypted; expected a "
                "loopback address such as 127.0.0.1. Give --yes-expose as well if that is what you want; an SSH tunnel "
                "is safer"
            )


@dataclass(frozen=True)
class StudioRequest:
    """What to open.

    Attributes:
        recipe: Recipe to tune: name, or path of a YAML file.
        data: Folder of the background dataset.
        run: Folder of a run to review.
        compare: Folder of a second run, or a second recipe, to compare with.
        results: Further folders of reports on the run.
        seed: Seed of the frames to tune.
        reading: How to read `data`.
        execution: Device and renderer.
    """

    recipe: str | None = None
    data: Path | None = None
    run: Path | None = None
    compare: str | None = None
    results: tuple[Path, ...] = ()
    seed: int = 0
    reading: Reading = READ_ALL
    execution: Execution = ONE_WORKER


def require_nicegui() -> None:
    """Check that the extra is installed.

    Raises:
        MissingDependencyError: It is not.
    """
    if find_spec("nicegui") is None:
        raise MissingDependencyError(
            'nicegui not installed, which the studio needs; install with\n  pip install "infrablend[studio]"\n'
            "(in a checkout: make studio)"
        )


def serve(request: StudioRequest, address: Address, on_ready: Callable[[str], None]) -> None:
    """Serve the pages until Ctrl-C; `on_ready` is called with the address to open once the server accepts requests.

    Raises:
        InfraBlendError: The run, the recipe or the data cannot be opened, the port is taken, or the extra is missing.
    """
    require_nicegui()
    from infrablend.studio.session import Session

    with Session(request) as session, _listening(address) as listening, _no_storage():
        import uvicorn
        from fastapi import FastAPI
        from nicegui import ui

        from infrablend.studio.pages import add_pages

        port = listening.getsockname()[1]
        token = new_token()
        add_pages(session)
        app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
        ui.run_with(app, title="InfraBlend studio", show_welcome_message=False, reconnect_timeout=30)
        shown = f"[{address.host}]" if ":" in address.host else address.host

        class Server(uvicorn.Server):
            async def startup(self, sockets: list[socket.socket] | None = None) -> None:
                await super().startup(sockets)
                on_ready(f"http://{shown}:{port}/?{QUERY}={token}")

        config = uvicorn.Config(
            Guard(app, token, port, address.host),
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
