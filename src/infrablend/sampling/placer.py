"""The base of placements: from a recipe and a background to a camera and the poses of objects."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from infrablend.core.camera import CameraSpec
from infrablend.core.dataset import ImageRecord
from infrablend.core.scene import SceneSpec, View
from infrablend.sampling.calibration import FROM_TABLE, HeightPrior
from infrablend.sampling.placement import DrawStatistics, PlacementRequest, Pose
from infrablend.sampling.site import Site

Streams = Callable[[str], np.random.Generator]
"""Returns the random stream of a frame for a purpose, by its name; each call starts the stream again."""


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Where the objects of a frame are.

    Attributes:
        camera: Camera that sees them.
        view: The ground below a real camera; None for a virtual one.
        poses: Pose of each object; None where no place was found.
    """

    camera: CameraSpec
    view: View | None
    poses: list[Pose | None]


class Placer(ABC):
    """One way to place objects; there is a class for each `placement.mode`. The same streams give the same result."""

    def height_prior(self, image: ImageRecord) -> HeightPrior:
        """Return what is known about a picture's stated height; by default one that nothing uses."""
        return FROM_TABLE

    @abstractmethod
    def arrange(
        self,
        like: CameraSpec,
        wanted: Sequence[PlacementRequest],
        site: Site | None,
        streams: Streams,
        tally: DrawStatistics,
    ) -> Arrangement:
        """Draw the camera and a pose per object; rejections are counted by reason in `tally`.

        `like` is the camera, apart from what is drawn; its roll is that of the background. `site` is None if nothing
        is known of the background.
        """

    def arrange_again(
        self,
        spec: SceneSpec,
        wanted: Sequence[PlacementRequest],
        others: Sequence[tuple[PlacementRequest, Pose]],
        site: Site,
        attempt: int,
        streams: Streams,
        tally: DrawStatistics,
    ) -> list[Pose | None] | None:
        """Draw other poses for some objects of a scene; None, as by default, if they are not to be moved (again).

        The `others` keep their places; attempts are numbered from 1.
        """
        return None
