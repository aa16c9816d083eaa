"""What a scene is drawn for: the key of its frame, and the background as placement sees it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from infrablend.core.camera import CameraSpec
from infrablend.core.capture import UNKNOWN, Capture, TimeOfDay
from infrablend.core.dataset import Instance, boxes_of
from infrablend.core.mesh import FloatArray
from infrablend.imaging.burnt_in import find_burnt_in
from infrablend.imaging.margin import find_margin
from infrablend.imaging.skyline import Skyline, find_skyline, noise_of
from infrablend.imaging.surfaces import SurfaceMap, find_surfaces
from infrablend.sampling.calibration import FROM_TABLE, HeightPrior
from infrablend.sampling.labelled_ground import LabelledGround
from infrablend.sampling.placement import PlacementRequest


@dataclass(frozen=True)
class FrameKey:
    """Key of a frame: together with the run's seed, it determines the random streams.

    Attributes:
        background_id: Id of the image record.
        split: Split of the image record.
        configuration: Number of the scene on this background, from 0.
        size_wh: Size of the background.
        capture: How the background was taken. All frames of a sequence have the same sun.
    """

    background_id: str
    split: str
    configuration: int
    size_wh: tuple[int, int]
    capture: Capture = UNKNOWN

    @property
    def frame_id(self) -> str:
        """`<split>/<background>_c<configuration>`."""
        return f"{self.split}/{self.background_id}_c{self.configuration}"


class Hiding(Protocol):
    """What can hide objects in part: structures of the background."""

    def has_structure(self, x: float, y: float, stands: bool) -> bool:
        """Return whether structures around a position in the picture may hide an object that stands or flies there."""
        ...

    def hides(self, camera: CameraSpec, world_m: FloatArray, item: PlacementRequest) -> bool:
        """Return whether structures can hide an object with these world vertices as much as it asks for."""
        ...


@dataclass(frozen=True, eq=False)
class Site:
    """A background as placement sees it.

    Attributes:
        pixels: (h, w) grey levels.
        labels: The background's own objects.
        ignored: Names of the categories that mark ignore regions.
        altitude_m: Height of the camera according to the metadata, or None.
        grey_unit: Levels of the picture per 8-bit level; 1 for 8-bit pictures.
        black_hot: Whether hot is dark.
        max_noise_grey: Noise above which nothing is inserted, 8-bit levels; None for no limit.
        hiding: What can hide objects in part; None for nothing.
        height_prior: What is known about `altitude_m`.
        time_of_day: Time of day, or None if unknown.
        labelled_ground: On which kinds of ground the dataset's labelled objects are; see `sampling.labelled_ground`.
        allowed: (h, w) mask of where objects may stand; None for anywhere.
    """

    pixels: NDArray[np.uint8] | NDArray[np.uint16]
    labels: tuple[Instance, ...] = ()
    ignored: frozenset[str] = frozenset()
    altitude_m: float | None = None
    grey_unit: float = 1.0
    black_hot: bool = False
    max_noise_grey: float | None = None
    hiding: Hiding | None = None
    height_prior: HeightPrior = FROM_TABLE
    time_of_day: TimeOfDay | None = None
    labelled_ground: LabelledGround = field(default_factory=dict)
    allowed: NDArray[np.bool_] | None = None

    @cached_property
    def surfaces(self) -> SurfaceMap:
        """What lies where; annotated objects are objects."""
        return find_surfaces(self.pixels, boxes_of([i for i in self.labels if i.category not in self.ignored]))

    @cached_property
    def median_level(self) -> float:
        """Median level of the picture."""
        return float(np.median(self.pixels))

    @cached_property
    def skyline(self) -> Skyline:
        """Sky and horizon of the picture."""
        grey = self.pixels.astype(np.float32)
        return find_skyline(-grey if self.black_hot else grey, self.grey_unit)

    @property
    def horizon_px(self) -> float | None:
        """Row of the horizon; None if none is found."""
        return self.skyline.horizon_px

    @property
    def shows_sky(self) -> bool:
        """Whether at least half of the picture is sky."""
        return 2 * int(np.count_nonzero(self.skyline.sky)) >= self.pixels.size

    @cached_property
    def unfit(self) -> str | None:
        """Reason why nothing may be inserted into the picture, or None."""
        if self.max_noise_grey is not None and noise_of(self.pixels, self.grey_unit) > self.max_noise_grey:
            return "noise"
        return None

    @cached_property
    def text_boxes(self) -> FloatArray:
        """(n, 4) boxes of text in the picture."""
        return find_burnt_in(self.pixels.astype(np.float32), self.grey_unit)

    @cached_property
    def margin(self) -> NDArray[np.bool_] | None:
        """(h, w) mask of margins where the camera saw nothing; None without any."""
        return find_margin(self.pixels, self.grey_unit)
