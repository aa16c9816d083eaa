"""The render server: performs jobs in Blender's Python for the program that started it, over one socket.

It greets, then answers each job with `answer` or `failure`, and ends when the other end closes. What runs here needs
`bpy`, the NumPy beside it, and no other module of this package but `errors`, `core.wire` and `thermal.radiometry`.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import platform
import signal
import socket
import sys
import traceback
from pathlib import Path
from typing import Any

from infrablend.core.wire import PROTOCOL, Message, Wire
from infrablend.errors import InfraBlendError


def serve(descriptor: int) -> None:
    """Serve the socket with this file descriptor until the other end closes it; does not return."""
    wire = Wire(socket.socket(fileno=descriptor))
    import bpy

    # The other end decides what Ctrl-C means. Set after the import, which installs handlers of its own.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    wire.send(
        {
            "protocol": PROTOCOL,
            "blender": ".".join(map(str, bpy.app.version)),
            "python": platform.python_version(),
            "numpy": sys.modules["numpy"].__version__,
        }
    )
    jobs = Jobs()
    with contextlib.suppress(EOFError, OSError):
        while True:
            job = wire.receive()
            wire.send({**_outcome(jobs, job), "rss_bytes": _resident_bytes()})
    os._exit(0)  # Blender may hang or crash during the tear-down of Python or C


class Jobs:
    """The jobs by name. Scenes and world own the one scene of the process: a server renders one of the two."""

    _scenes: Any = None

    def devices(self, _job: Message) -> dict[str, list[str]]:
        """Return the names of the GPUs that Cycles finds, by backend."""
        return _module("session").gpu_devices()  # type: ignore[no-any-return]

    def open(self, job: Message) -> str:
        """Prepare for scenes of a `kind` (`objects`, `world`) in `folder`; return the kind of device that was taken.

        They are rendered on `device`, and on the processor cores in `cores`; all if it is empty.
        """
        if job["cores"] and sys.platform == "linux":
            for thread in sorted(os.listdir("/proc/self/task")):  # noqa: PTH208 - numbers, not files
                os.sched_setaffinity(int(thread), job["cores"])
        stage = _module("session").Stage(job["device"], job["folder"])
        kinds = {"objects": ("objects", "ObjectScenes"), "world": ("world", "WorldScenes")}
        module, name = kinds[job["kind"]]
        self._scenes = getattr(_module(module), name)(stage)
        return stage.device  # type: ignore[no-any-return]

    def render(self, job: Message) -> dict[str, float]:
        """Render a scene to the folder; return the seconds per step."""
        return self._scenes.render(job)  # type: ignore[no-any-return]

    def read_file(self, job: Message) -> dict[str, object]:
        """Read a 3D file, see `importer.read_file`."""
        return _module("importer").read_file(job)  # type: ignore[no-any-return]

    def write_infrared_effect(self, job: Message) -> None:
        """Write the node groups, see `materials.write_infrared_effect`."""
        _module("materials").write_infrared_effect(job)


def _module(name: str) -> Any:
    # On first use: a Blender that is too old for a module still greets, and the caller refuses it by its version.
    return importlib.import_module(f"infrablend.blender.{name}")


def _outcome(jobs: Jobs, job: Message) -> dict[str, object]:
    try:
        return {"answer": getattr(jobs, job["do"])(job)}
    except InfraBlendError as error:
        problems = [p.to_json() for p in error.problems]
        return {"failure": {"error": type(error).__name__, "message": error.message, "problems": problems}}
    except BaseException as error:  # SystemExit too: add-ons raise it
        traceback.print_exc()
        message = f"Blender's process: {type(error).__name__}: {error}"
        return {"failure": {"error": "RenderError", "message": message, "problems": []}}


def _resident_bytes() -> int:
    """Return the resident memory of this process; 0 on other systems than Linux."""
    if sys.platform != "linux":
        return 0
    return int(Path("/proc/self/statm").read_text("ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE")
