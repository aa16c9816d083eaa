"""Imports objects by dotted name, so that heavy or optional modules are loaded only when needed."""

from __future__ import annotations

import importlib
from typing import Any

from infrablend.errors import MissingDependencyError


def resolve(dotted: str) -> Any:
    """Return the object that `package.module:name` names.

    Raises:
        MissingDependencyError: If the module cannot be imported because something it needs is missing.
    """
    module, _, name = dotted.partition(":")
    try:
        return getattr(importlib.import_module(module), name)
    except ImportError as error:
        hint = "run `infrablend doctor`, which names the package to install"
        raise MissingDependencyError(f"{module} cannot be imported: {error}; {hint}") from error
