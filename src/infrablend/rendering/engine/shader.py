"""Writes the node groups of the looks as a .blend file to append from."""

from __future__ import annotations

from pathlib import Path

from infrablend.core.files import replace_atomically
from infrablend.rendering.engine.process import blender_process


def write_infrared_effect(path: Path) -> Path:
    """Write the node groups InfraredEffect and InfraredEffect Physical, with an example of each; return the path.

    Raises:
        MissingDependencyError: There is no Blender.
        OutputError: The file cannot be written.
    """
    with replace_atomically(path) as temporary, blender_process() as blender:
        blender.ask("write_infrared_effect", {"file": str(temporary.absolute())})
    return path
