"""Runs code of tests in Blender's Python, beside the renderer or by itself."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from infrablend.rendering.engine.process import BlenderProcess
from infrablend.rendering.engine.programs import Program, find_blender
from infrablend.rendering.engine.renderer import BlenderRenderer

# A further job: its code sees the server's jobs as `jobs`, what was given as `given`, and sets `answer`.
_SERVE = """
from infrablend.blender import server
def run_code(jobs, job):
    names = {"jobs": jobs, "given": job["given"]}
    exec(job["code"], names)
    return names.get("answer")
server.Jobs.run_code = run_code
server.serve(%d)
"""


@dataclass(frozen=True)
class OpenProgram(Program):
    """A Blender that also runs the code of tests."""

    def command(self, descriptor: int) -> list[str]:
        return self.running(_SERVE % descriptor)


class OpenRenderer(BlenderRenderer):
    """A renderer whose Blender runs code of tests."""

    def start(self) -> None:
        if self._process is None:
            program = find_blender()
            self._process, self._opened = BlenderProcess(OpenProgram(program.path, program.origin)), False

    def run(self, code: str, **given: Any) -> Any:
        """Run code in Blender and return its `answer`."""
        self.start()
        assert self._process is not None
        return self._process.ask("run_code", {"code": code, "given": given})


def run_script(script: str, argument: Path) -> None:
    """Run a script in a Blender of its own; its argument is in `sys.argv[1]`."""
    command = [*find_blender().running(script), str(argument)]
    subprocess.run(command, check=True, timeout=300, capture_output=True)
