"""The interface of renderers: from a placed scene to radiance, alpha and coverage per object."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from infrablend.core.placed import PlacedScene

Image32 = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class RenderResult:
    """A rendered scene, cropped to its objects. Linear, float32, with a box filter of one pixel.

    Attributes:
        offset_xy: Column and row of the crop's top left pixel in the frame.
        frame_wh: Size of the whole frame.
        radiance: (h, w) radiance premultiplied by alpha: `radiance + (1 - alpha) * background` is the picture.
        alpha: (h, w) share of the pixel covered by objects, in [0, 1].
        coverage: (n, h, w) share of the pixel in which labelled parts of object k are the nearest surface.
        ground_radiance: Radiance of ground at air temperature if the translucent parts are ground that objects warm
            (`PartState.glow`): what exceeds it is added to the background. None if translucent parts cover it.
        seconds: Time spent per step, for the run record; never part of any output that must repeat.
    """

    offset_xy: tuple[int, int]
    frame_wh: tuple[int, int]
    radiance: Image32
    alpha: Image32
    coverage: Image32
    ground_radiance: float | None = None
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


def empty_result(frame_wh: tuple[int, int], objects: int) -> RenderResult:
    """Return the result of a scene of which nothing is in the frame: a crop without pixels."""
    nothing = np.zeros((0, 0), np.float32)
    return RenderResult((0, 0), frame_wh, nothing, nothing.copy(), np.zeros((objects, 0, 0), np.float32))


class Renderer(Protocol):
    """A renderer of scenes. One per process; not thread-safe."""

    def start(self) -> None:
        """Start, without waiting for it, what scenes need that this process cannot draw alone.

        Raises:
            MissingDependencyError: It is not there.
        """
        ...

    def render(self, scene: PlacedScene) -> RenderResult:
        """Render a scene, cropped to what its objects cover.

        Raises:
            RenderError: The renderer fails.
            MissingDependencyError: The scene needs a program or device that is not there.
        """
        ...

    def close(self) -> None:
        """Release everything the renderer holds."""
        ...
