"""Makes the environment that Blender runs in where this one cannot hold it: a Python 3.11 with `bpy`.

Its packages are pinned with their hashes in `infrablend/blender/requirements.txt`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from infrablend.core.files import write_text
from infrablend.errors import ArgumentError, MissingDependencyError, OutputError, Problem
from infrablend.rendering.engine.process import blender_process
from infrablend.rendering.engine.programs import Program, marker_of, private_environment, python_of
from infrablend.rendering.engine.system_libraries import install_command, missing_packages

REQUIREMENTS = Path(__file__).resolve().parents[2] / "blender" / "requirements.txt"
_PYTHON = (3, 11)
_LAST_LINES = 10


def install_blender(out: Path | None = None, wheels: Path | None = None, python: Path | None = None) -> Path:
    """Make Blender's environment, start Blender once, and return the environment's folder.

    Args:
        out: Folder to make; by default one in the cache folder. What an earlier call made there is replaced.
        wheels: Folder with the wheels of all packages, to install without a network.
        python: Python 3.11 to use; by default this one, or one on the path.

    Raises:
        ArgumentError: `wheels` is no folder, or `python` is no Python 3.11.
        MissingDependencyError: There is no Python 3.11, a package cannot be had, or Blender does not start.
        OutputError: `out` is something else than such an environment.
    """
    folder = (out or private_environment()).absolute()
    if wheels is not None and not wheels.is_dir():
        raise ArgumentError(f"wheels: {wheels} is no folder; expected one with the files that `pip download` fetched")
    marker = marker_of(folder)
    if folder.exists() and not marker.is_file():
        problem = Problem(str(folder), "not-ours", "something else", "no such path", "remove it, or give another --out")
        raise OutputError(f"{folder}: is there and is no environment of this command", [problem])
    interpreter = find_python(python)
    folder.parent.mkdir(parents=True, exist_ok=True)
    # An environment cannot be moved, so it is built in its place; the marker is filled last.
    shutil.rmtree(folder, ignore_errors=True)
    try:
        _run([interpreter, "-m", "venv", folder], "its Python cannot make environments; install its venv module")
        write_text(marker, "")
        offline: list[str | Path] = [] if wheels is None else ["--no-index", "--find-links", wheels]
        pip: list[str | Path] = [python_of(folder), "-m", "pip", "install", "--disable-pip-version-check", "--no-input"]
        _run(
            [*pip, "--require-hashes", "--only-binary", ":all:", *offline, "-r", REQUIREMENTS],
            "check the network and pip's settings, or give a folder of wheels (--wheels)",
        )
        with blender_process(Program(python_of(folder), "the new environment")) as blender:
            blender.greet()
            version = blender.greeting["blender"]
        write_text(marker, f"Blender {version}, for InfraBlend\n")
    except MissingDependencyError as error:
        shutil.rmtree(folder, ignore_errors=True)
        missing = missing_packages()
        todo = f"\nSystem libraries are missing. Run: {install_command(missing)}" if missing else ""
        raise MissingDependencyError(error.message + todo) from error
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return folder


def find_python(wanted: Path | None = None) -> Path:
    """Return a Python of the version that `bpy` is built for: the wanted one, this one, or one on the path.

    Raises:
        ArgumentError: The wanted one is of another version.
        MissingDependencyError: There is none.
    """
    version = ".".join(map(str, _PYTHON))
    names = [str(wanted)] if wanted is not None else [sys.executable, f"python{version}", "python3", "python"]
    for name in names:
        path = shutil.which(name)
        if path is not None and _is_right(path):
            return Path(path)
    if wanted is not None:
        raise ArgumentError(f"python: {wanted} is no Python {version}")
    raise MissingDependencyError(
        f"no Python {version} was found, which Blender's module needs. Install it (`uv python install {version}`, "
        "conda, or the system's package), and name it if it is not on the path: --python PATH"
    )


def _is_right(python: str) -> bool:
    code = f"import sys, venv; sys.exit(sys.version_info[:2] != {_PYTHON})"
    return subprocess.run([python, "-c", code], capture_output=True, check=False).returncode == 0


def _run(command: list[str | Path], todo: str) -> None:
    """Run a step; its output is quoted if it fails."""
    # Packages of the environment that this command runs in must not be seen.
    variables = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")}
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", env=variables, check=False)
    if done.returncode:
        lines = (done.stdout + done.stderr).strip().splitlines()[-_LAST_LINES:]
        said = "\n".join(f"  | {line}" for line in lines)
        raise MissingDependencyError(f"Blender could not be installed: {todo}. The last lines were:\n{said}")
