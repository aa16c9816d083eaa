"""The wheel and the sdist work in a clean environment, and the sdist builds the same wheel.

The environments are new and get the versions of .venv from uv's cache, so the tests need no network. They prove that
the package needs nothing but its requirements; they do not prove that the versions in `pyproject.toml` resolve.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.metadata import requires, version
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from tests.conftest import NEEDS

ROOT = Path(__file__).resolve().parents[2]
DATA_SUFFIXES = {".css", ".jinja", ".js", ".json", ".npz", ".txt", ".typed", ".yaml"}
pytestmark = [pytest.mark.slow, pytest.mark.long]


PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
ENVIRONMENT = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}  # which would name the checkout


def run(*command: str | Path, cwd: Path) -> str:
    done = subprocess.run(command, cwd=cwd, env=ENVIRONMENT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder, cwd=ROOT)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of an unpacked source distribution."""
    folder = tmp_path_factory.mktemp("sdist")
    run(sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", folder, cwd=ROOT)
    (built,) = folder.glob("*.tar.gz")
    with tarfile.open(built) as archive:
        archive.extractall(folder, filter="data")
    return folder / built.name.removesuffix(".tar.gz")


def locked_requirements() -> list[str]:
    """Return what the package needs to run, and what that needs, in the versions of .venv."""
    found: dict[str, str] = {}
    waiting = [Requirement(r) for r in PYPROJECT["project"]["dependencies"]]
    while waiting:
        requirement = waiting.pop()
        if requirement.name in found or (requirement.marker and not requirement.marker.evaluate({"extra": ""})):
            continue
        found[requirement.name] = f"{requirement.name}=={version(requirement.name)}"
        waiting += map(Requirement, requires(requirement.name) or ())
    return sorted(found.values())


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of an environment in which nothing is but the package and what it needs, without a network.

    The sdist builds the same wheel, see below.
    """
    environment = tmp_path_factory.mktemp("clean") / "venv"
    run(sys.executable, "-m", "venv", "--without-pip", environment, cwd=ROOT)
    uv = Path(sys.executable).with_name("uv")
    command = [uv, "pip", "install", "--offline", "--no-deps", "--python", environment, wheel, *locked_requirements()]
    done = subprocess.run(command, env=ENVIRONMENT, capture_output=True, text=True, timeout=300, check=False)
    if "network was disabled" in done.stderr or "Network connectivity is disabled" in done.stderr:
        pytest.skip(f"{NEEDS} WHEELS in uv's cache, which `make setup` leaves there: the wheel is not installed")
    assert done.returncode == 0, done.stderr
    run(uv, "pip", "check", "--python", environment, cwd=environment)
    return environment


def test_the_wheel_holds_package_data_and_licence_and_no_tests(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert any(n.endswith("/LICENSE") for n in names)
    assert "infrablend/py.typed" in names
    data = {p.relative_to(ROOT / "src").as_posix() for p in (ROOT / "src").rglob("*") if p.suffix in DATA_SUFFIXES}
    assert data and data <= set(names)
    for folder in ("recipes", "experiments"):
        files = {p.name for p in (ROOT / "src" / "infrablend" / "config" / folder).glob("*.yaml")}
        assert files <= {n.rsplit("/", 1)[-1] for n in names if n.startswith(f"infrablend/config/{folder}/")}
    assert not [n for n in names if n.startswith(("tests/", "docs/", "src/"))]


def test_the_installed_command_works(installed: Path, tmp_path: Path) -> None:
    command = installed / "bin" / "infrablend"
    where = run(installed / "bin" / "python", "-c", "import infrablend; print(infrablend.__file__)", cwd=tmp_path)
    assert str(installed) in where
    assert run(command, "--version", cwd=tmp_path).startswith("infrablend ")
    assert "drone" in run(command, "models", "list", cwd=tmp_path)
    assert "hit-uav-drone" in run(command, "recipes", "list", cwd=tmp_path)


def test_the_first_example_of_the_readme_runs(installed: Path, tmp_path: Path) -> None:
    example = re.search(r"^```bash\n(.*?)^```", (ROOT / "README.md").read_text("utf-8"), re.MULTILINE | re.DOTALL)
    assert example and "infrablend generate" in example[1]
    path = f"{installed / 'bin'}{os.pathsep}{ENVIRONMENT['PATH']}"
    output = run("env", f"PATH={path}", "INFRABLEND_BLENDER=none", "bash", "-euc", example[1], cwd=tmp_path)
    assert (tmp_path / output.splitlines()[-1]).stat().st_size > 1000  # a contact sheet


def test_the_installed_package_finds_its_templates(installed: Path, tmp_path: Path) -> None:
    code = (
        "from infrablend.report.page import _environment as e; "
        "print(e('infrablend.lab.pages').get_template('evaluation.html.jinja').name)"
    )
    assert run(installed / "bin" / "python", "-c", code, cwd=tmp_path).strip() == "evaluation.html.jinja"


def test_the_metadata_of_the_wheel_are_complete(wheel: Path) -> None:
    archive = zipfile.ZipFile(wheel)
    (name,) = [n for n in archive.namelist() if n.endswith(".dist-info/METADATA")]
    metadata = archive.read(name).decode()
    for line in (
        "Author: InfraBlend developers",
        "Classifier: Typing :: Typed",
        "License-Expression: GPL-3.0-or-later",
    ):
        assert line in metadata
    assert "Keywords: " in metadata and "Project-URL: " in metadata and "Requires-Python: <3.14,>=3.11" in metadata


def test_the_sdist_builds_the_same_wheel_and_can_be_set_up(sdist: Path, wheel: Path, tmp_path: Path) -> None:
    for name in ("Makefile", "pyproject.toml", "requirements/project.txt", "scripts/setup.sh", "tests/conftest.py"):
        assert (sdist / name).is_file(), name
    assert not (sdist / ".venv").exists() and not (sdist / "build").exists()
    run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path, cwd=sdist)
    (again,) = tmp_path.glob("*.whl")
    first, second = ({i.filename: i.CRC for i in zipfile.ZipFile(p).infolist()} for p in (wheel, again))
    assert first == second
