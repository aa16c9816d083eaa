"""Imports by name on first use, so that heavy or optional modules are loaded only when they are needed."""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from infrablend.errors import MissingDependencyError


def lazy_names(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package whose names the stub for type checkers lists.

    Args:
        package: Name of the package.
        file: File of the package, `__init__.py`; every `from MODULE import NAME as NAME` in the `__init__.pyi` beside
            it offers a name.
    """
    stub = ast.parse(Path(file).with_suffix(".pyi").read_text("utf-8"))
    imports = [statement for statement in stub.body if isinstance(statement, ast.ImportFrom)]
    modules = {alias.name: str(i.module) for i in imports for alias in i.names}

    def get(name: str) -> Any:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        found = getattr(import_module(modules[name]), name)
        setattr(sys.modules[package], name, found)
        return found

    def names() -> list[str]:
        return sorted({*vars(sys.modules[package]), *modules})

    return get, names, sorted(modules)


def resolve(dotted: str) -> Any:
    """Return the object that `package.module:name` names; a `MissingDependencyError` if that cannot be imported."""
    module, _, name = dotted.partition(":")
    try:
        return getattr(import_module(module), name)
    except ImportError as error:
        hint = "run `infrablend doctor`, which names the package to install"
        raise MissingDependencyError(f"{module} cannot be imported: {error}; {hint}") from error
