"""The wheel works in a clean environment, and the sdist builds the same wheel.

The environment is new and gets the locked dependencies of .venv by a path entry, so the tests need no network. They
prove that the package needs no file of the checkout; they do not prove that the versions in `pyproject.toml` resolve.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DATA_SUFFIXES = {".css", ".jinja", ".js", ".json", ".npz", ".txt", ".typed", ".yaml"}
pytestmark = [pytest.mark.slow, pytest.mark.long]


def run(*command: str | Path, cwd: Path) -> str:
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}  # which would name the checkout
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=300, check=False)
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


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of an environment with the wheel and, by a path entry, our locked dependencies.

    A path entry does not run the .pth files of the folder it adds, so the editable project stays out of it.
    """
    environment = tmp_path_factory.mktemp("clean") / "venv"
    run(sys.executable, "-m", "venv", "--without-pip", environment, cwd=ROOT)
    python = environment / "bin" / "python"
    uv = Path(sys.executable).with_name("uv")
    run(uv, "pip", "install", "--offline", "--no-deps", "--python", python, wheel, cwd=environment)
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_paths()['purelib'])", cwd=environment).strip())
    (site / "dependencies.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
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
