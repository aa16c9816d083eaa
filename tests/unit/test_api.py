"""The Python interface: its examples run, and the package root exports what it lists."""

from __future__ import annotations

import doctest
import pkgutil
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import pytest

import infrablend
from infrablend import api


def test_the_examples_in_the_docstrings_run(
    write_tiny_hit_uav: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_tiny_hit_uav(tmp_path / "hit-uav")
    finder = doctest.DocTestFinder()
    modules = [import_module(f"infrablend.api.{m.name}") for m in pkgutil.iter_modules(api.__path__)]
    examples = [t for m in modules for t in finder.find(m, globs=vars(api).copy()) if t.examples]
    assert len(examples) >= 8
    runner = doctest.DocTestRunner()
    for example in examples:
        runner.run(example, clear_globs=False)
    assert runner.summarize(verbose=False).failed == 0


def test_the_package_root_offers_what_it_lists() -> None:
    assert set(infrablend.__all__) <= set(dir(infrablend))
    for name in infrablend.__all__:
        found = getattr(infrablend, name)
        assert name == "__version__" or found.__name__ == name
    assert infrablend.generate is api.generate
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = infrablend.no_such_name


def test_importing_the_package_is_light() -> None:
    code = "import infrablend, sys; print(sorted({'numpy', 'bpy', 'pydantic', 'infrablend.api'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
