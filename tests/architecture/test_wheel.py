"""A built wheel, installed into an environment of its own, is the whole program."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.slow


def run(*command: str | Path, cwd: Path) -> str:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder, cwd=ROOT)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of an environment that holds the wheel and, by a path entry, our locked dependencies.

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
