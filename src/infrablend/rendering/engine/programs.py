"""Finds Blender: this Python, an environment beside it or in the cache folder, or a program that is installed.

`INFRABLEND_BLENDER`, or `--blender`, names one of them by its path (a Blender program, or a Python that has `bpy`), or
switches Blender off: `none`.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import distributions
from pathlib import Path

from infrablend.core.files import cache_folder
from infrablend.core.machine import installed_version
from infrablend.errors import MissingDependencyError

VARIABLE = "INFRABLEND_BLENDER"
OFF = "none"
TODO = "infrablend blender install"
_PACKAGE = Path(__file__).resolve().parents[2]

# Only this package is importable from its folder: the libraries beside it may be for another version of Python.
_PACKAGE_ALONE = (
    "import sys, types; p = types.ModuleType('infrablend'); p.__path__ = [{folder!r}]; sys.modules['infrablend'] = p\n"
)


@dataclass(frozen=True)
class Program:
    """A way to start Blender.

    Attributes:
        path: The program.
        origin: What it is, for people.
    """

    path: Path
    origin: str

    def command(self, descriptor: int) -> list[str]:
        """Return the command that starts the render server on a socket with this file descriptor."""
        return self.running(f"from infrablend.blender.server import serve; serve({descriptor})")

    def running(self, code: str) -> list[str]:
        """Return the command that runs code in Blender's Python, in which `infrablend` can be imported."""
        code = _PACKAGE_ALONE.format(folder=str(_PACKAGE)) + code
        if self.is_python:
            # -P: a file of the user's in the current folder must not be imported in place of a module.
            return [str(self.path), "-P", "-c", code]
        return [str(self.path), "--background", "--factory-startup", "--python-exit-code", "3", "--python-expr", code]

    @property
    def is_python(self) -> bool:
        """Whether it is a Python with the module `bpy`."""
        return self.path.name.startswith("python")

    def __str__(self) -> str:
        return f"{self.origin} ({self.path})"


def private_environment() -> Path:
    """Return the folder of the environment that `infrablend blender install` makes."""
    return cache_folder() / "blender"


def python_of(environment: Path) -> Path:
    """Return the Python of a virtual environment."""
    return environment / "bin" / "python"


def marker_of(environment: Path) -> Path:
    """Return the file that marks an environment as made by `infrablend blender install`; empty until it is complete."""
    return environment / "infrablend-blender.txt"


def candidates(wanted: str | None = None) -> Iterator[Program]:
    """Yield the ways to start Blender on this machine, the preferred one first; nothing is started.

    Args:
        wanted: Path, or `none`; by default `INFRABLEND_BLENDER`, and where that is empty, everything that is found.

    Raises:
        MissingDependencyError: There is no program of the given path.
    """
    wanted = wanted or os.environ.get(VARIABLE, "")
    if wanted == OFF or sys.platform == "win32":
        return
    if wanted:
        path: str | None = shutil.which(Path(wanted).expanduser())
        if path is None:
            raise MissingDependencyError(
                f"Blender: {wanted} is no program; --blender and {VARIABLE} expect the path of a Blender program, of a "
                f"Python that has bpy, or {OFF}"
            )
        yield Program(Path(path).absolute(), "the one that --blender or INFRABLEND_BLENDER names")
        return
    if importlib.util.find_spec("bpy") is not None:
        yield Program(Path(sys.executable), "bpy in this Python")
    for folder, origin in (
        (Path(f"{sys.prefix}-blender"), "environment beside this one"),
        (private_environment(), "environment of `infrablend blender install`"),
    ):
        if marker_of(folder).is_file() and marker_of(folder).stat().st_size:
            yield Program(python_of(folder), origin)
    installed = shutil.which("blender")
    if installed is not None:
        yield Program(Path(installed), "blender on the path")


def find_blender(wanted: str | None = None) -> Program:
    """Return the preferred way to start Blender, see `candidates`.

    Raises:
        MissingDependencyError: There is none, or it is switched off.
    """
    for program in candidates(wanted):
        return program
    found, todo = absence(wanted)
    raise MissingDependencyError(f"{found}. {todo}")


def absence(wanted: str | None = None) -> tuple[str, str]:
    """Return why `candidates` found nothing, and what to do."""
    if (wanted or os.environ.get(VARIABLE)) == OFF:
        return "Blender is switched off", f"Leave out --blender {OFF} and {VARIABLE}={OFF}"
    if sys.platform == "win32":
        return "Blender is not used on Windows", "Use Linux, or the Windows Subsystem for Linux"
    found = (
        "Blender is not there: this Python has no bpy, no environment of `infrablend blender install` was found, and "
        "no program blender on the path"
    )
    return found, f"Run: {TODO}"


def blender_version(wanted: str | None = None) -> str | None:
    """Return the version of the Blender that `find_blender` finds; None where there is none."""
    try:
        return version_of(find_blender(wanted))
    except MissingDependencyError:
        return None


def version_of(program: Program) -> str | None:
    """Return the version that a program or the package `bpy` states, without starting the server; None if neither."""
    if not program.is_python:
        done = subprocess.run([program.path, "--version"], capture_output=True, text=True, check=False)
        return done.stdout.partition("\n")[0].removeprefix("Blender ").strip() or None
    if program.path == Path(sys.executable):
        return installed_version("bpy")
    libraries = sorted(map(str, program.path.parent.parent.glob("lib/python*/site-packages")))
    return next((found.version for found in distributions(name="bpy", path=libraries)), None)
