"""Blender's environment: nothing of others is replaced, and nothing half made is left or used."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from infrablend.errors import ArgumentError, MissingDependencyError, OutputError
from infrablend.rendering.engine.install import find_python, install_blender
from infrablend.rendering.engine.programs import marker_of


def test_what_others_made_is_not_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "venv"
    folder.mkdir()
    (folder / "pyvenv.cfg").write_text("mine")
    with pytest.raises(OutputError, match="no environment of this command"):
        install_blender(folder)
    assert (folder / "pyvenv.cfg").read_text() == "mine"


def test_wheels_are_in_a_folder(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="wheels: "):
        install_blender(tmp_path / "out", wheels=tmp_path / "absent")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.version_info[:2] != (3, 11), reason="this Python is the one that is found")
def test_a_python_of_the_right_version_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = tmp_path / "python3.12"
    other.write_text("#!/bin/sh\nexit 1\n")
    other.chmod(0o755)
    assert find_python() == Path(sys.executable)
    with pytest.raises(ArgumentError, match=r"python3\.12 is no Python 3\.11"):
        find_python(other)
    monkeypatch.setattr(sys, "executable", str(other))
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(MissingDependencyError, match=r"no Python 3\.11 was found"):
        find_python()


@pytest.mark.skipif(sys.version_info[:2] != (3, 11), reason="needs a Python 3.11")
def test_a_failed_installation_leaves_nothing(tmp_path: Path) -> None:
    folder, wheels = tmp_path / "blender", tmp_path / "wheels"
    wheels.mkdir()
    folder.mkdir()
    marker_of(folder).touch()  # an earlier call was killed
    with pytest.raises(MissingDependencyError, match=r"--wheels(?s:.*)No matching distribution"):
        install_blender(folder, wheels=wheels)
    assert not folder.exists()
