"""Renderers: a registry of the implementations of `core.render.Renderer`, and one that needs no Blender.

`RENDERERS` maps the name that a run records to the dotted name of a class:

`blender`
    `rendering.engine.renderer.BlenderRenderer`. The one that datasets are made with: by the lattice where it can draw a
    scene, else by Cycles.
`flat`
    `rendering.flat.FlatRenderer`: flat shading on the software rasteriser. Fast and without Blender; for tests and
    for trying out a recipe.

To add a renderer, implement the protocol and add a line here. A class is called with the device and the choice of
Blender.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from infrablend.core.lazy_names import resolve

if TYPE_CHECKING:
    from infrablend.core.render import Renderer

RENDERERS: Mapping[str, str] = {
    "blender": "infrablend.rendering.engine.renderer:BlenderRenderer",
    "flat": "infrablend.rendering.flat:FlatRenderer",
}


def make_renderer(name: str, device: str, blender: str | None = None) -> Renderer:
    """Return the renderer of that name; its module is imported here and only here.

    Args:
        name: A key of `RENDERERS`.
        device: Where to compute: `cpu`, or a backend that the renderer knows.
        blender: Which Blender, see `rendering.engine.programs.candidates`; by default the one that is found.

    Raises:
        ValueError: There is no renderer of that name.
        MissingDependencyError: The renderer's module cannot be imported.
    """
    if name not in RENDERERS:
        raise ValueError(f"renderer {name!r} is unknown; expected one of {', '.join(RENDERERS)}")
    make: Callable[[str, str | None], Renderer] = resolve(RENDERERS[name])
    return make(device, blender)
