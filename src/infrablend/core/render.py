"""The renderer's port: a scene in, radiance, alpha and coverage per object out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from infrablend.core.mesh import Mesh
from infrablend.core.scene import SceneSpec

Image32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class RenderResult:
    """What a renderer makes of a scene, cropped to its objects. Linear, float32, box filter of one pixel.

    Attributes:
        offset_xy: Column and row of the crop's top left pixel in the frame.
        frame_wh: Size of the whole frame.
        radiance: (h, w) premultiplied by alpha: `radiance + (1 - alpha) * background` is the picture.
        alpha: (h, w) share of the pixel covered by objects, in [0, 1].
        coverage: (n, h, w) share of the pixel in which labelled parts of object k are the nearest surface.
        seconds: What took how long, for the run record; never part of any output that must repeat.
    """

    offset_xy: tuple[int, int]
    frame_wh: tuple[int, int]
    radiance: Image32
    alpha: Image32
    coverage: Image32
    seconds: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.radiance.shape != self.alpha.shape or self.radiance.ndim != 2:
            raise ValueError(f"radiance {self.radiance.shape} and alpha {self.alpha.shape} must be one (h, w)")
        if self.coverage.ndim != 3 or self.coverage.shape[1:] != self.alpha.shape:
            raise ValueError(f"coverage must be (n, {self.alpha.shape}), got {self.coverage.shape}")
        for a in (self.radiance, self.alpha, self.coverage):
            if a.dtype != np.float32:
                raise ValueError(f"render arrays must be float32, got {a.dtype}")
            a.setflags(write=False)


class Renderer(Protocol):
    """Makes pictures of scenes. One per process; not thread-safe."""

    def render(self, scene: SceneSpec, meshes: Sequence[Mesh]) -> RenderResult:
        """Render `scene`, whose object k has the geometry `meshes[k]` (object coordinates, unscaled).

        Raises:
            RenderError: If the renderer fails.
        """
        ...

    def close(self) -> None:
        """Release what the renderer holds."""
        ...
