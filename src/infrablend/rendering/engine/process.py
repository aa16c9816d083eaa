"""Blender's process: started with the first need, asked over a socket, and started again after it has died.

Users' 3D files are read by a process of their own, with limits.
"""

from __future__ import annotations

import contextlib
import os
import re
import socket
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from infrablend.assets.model_files import NO_FILE, too_large
from infrablend.assets.user_model import GroupFacts, ImportJob, write_geometry
from infrablend.core.files import replace_atomically
from infrablend.core.operating_system import CHILD_BYTES, describe_exit, memory_folder
from infrablend.core.tasks import Failure, Task
from infrablend.core.wire import PROTOCOL, Message, ModelFileMessage, Wire
from infrablend.errors import MissingDependencyError, ModelError, Problem, WorkerDiedError
from infrablend.rendering.engine.programs import TODO, Program, find_blender, version_of

OLDEST, NEWEST = (4, 2), (4, 5)
"""Versions of Blender that can be used. Tried by hand: 4.2 and 4.5; in 5.0, coverage is missing from the picture."""

_LAST_BYTES = 4000
_LAST_LINES = 20
_MOST_OUTPUT_BYTES = 2**20
# Limits of the time that Blender may take to start and to end.
_START_S = 120.0
_END_S = 5.0


class BlenderProcess:
    """A render server. Its methods are not thread-safe.

    Attributes:
        greeting: What the server said of itself: versions of `blender`, `python` and `numpy`.
    """

    def __init__(self, program: Program) -> None:
        """Start a program without waiting for it.

        Raises:
            MissingDependencyError: It cannot be started.
        """
        self._program = program
        self.greeting: Message = {}
        ours, theirs = socket.socketpair()
        self._wire = Wire(ours)
        # Workers get a TMPDIR in memory that their parent removes, so a killed one leaves nothing behind.
        self._folder = tempfile.TemporaryDirectory(
            prefix="infrablend_", dir=os.environ.get("TMPDIR") or memory_folder()
        )
        self._output = Path(self._folder.name, "output.txt")
        given = {k: v for k, v in os.environ.items() if program.is_python or not k.startswith("PYTHON")}
        with theirs, self._output.open("ab") as output:
            try:
                self._process = subprocess.Popen(
                    program.command(theirs.fileno()),
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=subprocess.STDOUT,
                    pass_fds=[theirs.fileno()],
                    env={**given, "TMPDIR": self._folder.name},
                )
            except OSError as error:
                raise MissingDependencyError(f"Blender, {program}, cannot be started: {error}. Run: {TODO}") from error

    def greet(self) -> None:
        """Wait for the greeting and check it.

        Raises:
            MissingDependencyError: The program gives no greeting, or cannot be used.
        """
        if self.greeting:
            return
        try:
            greeting = self._wire.receive(_START_S)
        except (EOFError, TimeoutError) as error:
            ended, said = self._end()
            self._require_version(version_of(self._program) or "")
            what = f"gave no sign within {_START_S:g} s" if isinstance(error, TimeoutError) else ended
            raise MissingDependencyError(
                f"Blender, {self._program}, does not start: it {what}. `infrablend doctor` shows what was found.{said}"
            ) from None
        assert greeting["protocol"] == PROTOCOL, "the server's code is that of this package"
        self._require_version(greeting["blender"])
        self.greeting = greeting

    def _require_version(self, version: str) -> None:
        """Check a version of Blender, `4.5.15`; one that is not known passes."""
        numbers = tuple(int(n) for n in re.findall(r"\d+", version)[:2])
        if numbers and not OLDEST <= numbers <= NEWEST:
            self.close()
            oldest, newest = (".".join(map(str, v)) for v in (OLDEST, NEWEST))
            raise MissingDependencyError(
                f"Blender {version}, {self._program}, cannot be used: {oldest} to {newest} can. Run: {TODO}"
            )

    def ask(self, do: str, job: Mapping[str, object] | None = None) -> Any:
        """Have a job performed, see `blender.server.Jobs`, and return its answer.

        Raises:
            WorkerDiedError: Blender died; its last words are in the message.
            InfraBlendError: What the job raised.
        """
        self.greet()
        if self._output.stat().st_size > _MOST_OUTPUT_BYTES:
            os.truncate(self._output, 0)
        try:
            self._wire.send({"do": do, **(job or {})})
            reply = self._wire.receive()
        except (EOFError, OSError):
            ended, said = self._end()
            raise WorkerDiedError(f"Blender {ended}{said}") from None
        CHILD_BYTES[self._process.pid] = reply["rss_bytes"]
        if "failure" in reply:
            raise Failure.from_json({"kind": "error", **reply["failure"]}).to_exception()
        return reply["answer"]

    def open(self, kind: str, device: str) -> str:
        """Prepare for scenes of a kind (`objects`, `world`); return the kind of device that was taken.

        Raises:
            MissingDependencyError: There is no such device.
        """
        # Those of this process, which may have taken a core of its own since it started Blender.
        cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
        return str(self.ask("open", {"kind": kind, "device": device, "folder": self._folder.name, "cores": cores}))

    def channels(self, number: int = 0) -> dict[str, NDArray[np.float32]]:
        """Return the (h, w) channels of a picture of the last scene, by their names in lower case."""
        with OpenEXR.File(str(Path(self._folder.name, f"{number}.exr")), separate_channels=True) as exr:
            return {name.lower(): np.array(c.pixels, np.float32) for name, c in exr.channels().items()}

    def close(self) -> None:
        """End the process."""
        self._end()

    def _end(self) -> tuple[str, str]:
        """End the process; return how it ended, and the last lines of its output."""
        self._wire.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_END_S)
        self._process.kill()
        code = self._process.wait()
        CHILD_BYTES.pop(self._process.pid, None)
        lines = _last_lines(self._output)
        self._folder.cleanup()
        return describe_exit(code), "\nLast lines of its output:\n" + "\n".join(lines) if lines else ""


def _last_lines(output: Path) -> list[str]:
    """Return the last lines of a process's output, marked as quoted."""
    try:
        with output.open("rb") as stream:
            stream.seek(max(0, stream.seek(0, os.SEEK_END) - _LAST_BYTES))
            lines = stream.read().decode(errors="replace").splitlines()
    except OSError:
        return []
    return [f"  | {line}" for line in lines[-_LAST_LINES:] if line.strip()]


@contextlib.contextmanager
def blender_process(program: Program | None = None) -> Iterator[BlenderProcess]:
    """Yield a Blender, by default the one that `find_blender` finds, and end it.

    Raises:
        MissingDependencyError: There is none.
    """
    process = BlenderProcess(program or find_blender())
    try:
        yield process
    finally:
        process.close()


def make_importer(_settings: None) -> Callable[[Task], None]:
    """Return the callable that performs one import: the payload of its task is an `ImportJob`."""
    return lambda task: _import(task.payload)


def _import(job: ImportJob) -> None:
    """Read a 3D file and write its geometry: triangles in world coordinates, Z up, metres, and named pieces.

    Raises:
        ModelError: Blender cannot read the file, it contains no surface, or too many triangles.
        MissingDependencyError: There is no Blender.
        WorkerDiedError: Blender crashed on the file, or exceeded a limit.
    """
    asked: ModelFileMessage = {
        "file": str(job.files.main.absolute()),
        "shown": job.shown,
        "known": [str(path.resolve()) for path in job.files.paths],
        "memory_bytes": job.memory_bytes,
        "cpu_seconds": job.cpu_seconds,
    }
    with blender_process() as blender:
        found = blender.ask("read_file", asked)
    if "too_large" in found:
        raise too_large(Path(job.shown), found["too_large"])
    if "libraries" in found:
        raise _unknown_libraries(job.shown, found["libraries"])
    write_geometry(job.target, [GroupFacts(**g) for g in found["groups"]], found["arrays"])


def _unknown_libraries(shown: str, libraries: list[tuple[str, str]]) -> ModelError:
    todo = "make linked data local, or paths relative (File > External Data), and save it again"
    problems = [
        Problem(
            shown, NO_FILE, f"refers to the linked library {path!r}, which is {found}", "a file beside the model", todo
        )
        for path, found in libraries
    ]
    return ModelError(f"model file {shown}: cannot use {len(problems)} of the files it refers to", problems)


def write_infrared_effect(path: Path) -> Path:
    """Write the node groups InfraredEffect and InfraredEffect Physical, with an example of each; return the path.

    Raises:
        MissingDependencyError: There is no Blender.
        OutputError: The file cannot be written.
    """
    with replace_atomically(path) as temporary, blender_process() as blender:
        blender.ask("write_infrared_effect", {"file": str(temporary.absolute())})
    return path
