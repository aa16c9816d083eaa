"""Ground that suits an object: where a recipe, the model and the dataset's labels let it stand.

Places are drawn in proportion to how well they suit, and the whole footprint has to suit nearly as well as the place
that was drawn: a car whose wheels are over a kerb, or in a hedge, does not stand on the road.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.config.recipe import Where
from infrablend.core.camera import CameraSpec, object_to_world
from infrablend.core.mesh import FloatArray
from infrablend.core.surface_kinds import Affinity
from infrablend.sampling.labelled_ground import with_labels
from infrablend.sampling.placement import PlacementRequest, Pose
from infrablend.sampling.site import Site

# Points of a footprint, along and across.
_ALONG = 7
_ACROSS = 4
# How far a footprint reaches beyond the object, metres.
_BEYOND_M = 0.25
# The worst share of the footprint, which does not count.
_WORST = 0.08
# How well the rest suits at least, relative to the place drawn.
_NEARLY = 0.5
# What hides standing objects.
_PLANTS: Affinity = {"tree": 1.0, "shrub": 1.0}


@dataclass(frozen=True, eq=False)
class SuitableGround:
    """How well each cell of a background suits objects of one kind.

    Attributes:
        suits: (h', w') affinity in [0, 1]; 0 where the object does not stand.
        size_wh: Size of the picture.
    """

    suits: NDArray[np.float32]
    size_wh: tuple[int, int]

    @property
    def exists(self) -> bool:
        """Whether there is any."""
        return bool((self.suits > 0).any())

    @cached_property
    def _up_to(self) -> NDArray[np.float64]:
        return np.cumsum(self.suits.ravel(), dtype=np.float64)

    def draw(self, rng: np.random.Generator) -> tuple[float, float]:
        """Draw a position in the picture, px, in proportion to how well it suits."""
        share, du, dv = rng.random(3)
        h, w = self.suits.shape
        cell = min(int(np.searchsorted(self._up_to, share * self._up_to[-1], side="right")), h * w - 1)
        return (cell % w + du) * self.size_wh[0] / w, (cell // w + dv) * self.size_wh[1] / h

    def at(self, xy: FloatArray) -> NDArray[np.float32]:
        """Return how well (n, 2) positions in the picture suit; 0 outside."""
        h, w = self.suits.shape
        cells = np.floor(xy * (w / self.size_wh[0], h / self.size_wh[1])).astype(np.int64)
        inside = ((cells >= 0) & (cells < (w, h))).all(axis=1)
        found = np.zeros(len(xy), np.float32)
        found[inside] = self.suits[cells[inside, 1], cells[inside, 0]]
        return found

    def carries(self, camera: CameraSpec, item: PlacementRequest, pose: Pose, like: Pose | None = None) -> bool:
        """Return whether the ground suits under the whole object, nearly as well as at its place or another one.

        Parts of the footprint outside the picture do not count.

        Args:
            camera: The camera.
            item: The object.
            pose: Its pose.
            like: Pose of an object beside which it is to stand; None for its own place.
        """
        (x0, y0, _), (x1, y1, _) = item.extent_m
        beyond = _BEYOND_M / item.scale
        xs, ys = np.linspace(x0 - beyond, x1 + beyond, _ALONG), np.linspace(y0 - beyond, y1 + beyond, _ACROSS)
        grid = np.stack([*(a.ravel() for a in np.meshgrid(xs, ys)), np.zeros(_ALONG * _ACROSS)], axis=1)
        xy, depth_m = camera.project(object_to_world(grid, pose[:3], pose[3], item.scale))
        seen = (depth_m > 0) & (xy >= 0).all(axis=1) & (xy < self.size_wh).all(axis=1)
        place, _ = camera.project(np.array([(like or pose)[:3]]))
        aim = _NEARLY * float(self.at(place)[0])
        if not seen.any() or aim <= 0:
            return False
        under = np.sort(self.at(xy[seen]))
        return bool(under[int(_WORST * len(under))] >= aim)

    def reach_m(self, camera: CameraSpec, place_m: tuple[float, float, float], yaw_rad: float, most_m: float) -> float:
        """Return how far ground that suits as well as a place goes on from there, to both sides of a direction."""
        steps = np.arange(1.0, most_m + 1)
        away = np.concatenate([[0.0], steps, -steps])
        points = np.array(place_m) + away[:, None] * (math.cos(yaw_rad), math.sin(yaw_rad), 0.0)
        xy, depth_m = camera.project(points)
        suits = np.where(depth_m > 0, self.at(xy), 0)
        good = suits >= _NEARLY * suits[0]
        sides = (good[1 : len(steps) + 1], good[len(steps) + 1 :])
        return float(sum(int(np.argmin(side)) if not side.all() else len(side) for side in sides))


def suitable_ground(
    where: Where | None, site: Site, item: PlacementRequest, *, among_plants: bool = False
) -> SuitableGround | None:
    """Return the ground that suits an object, or also that under trees and shrubs; None where any does."""
    if not item.model.stands:
        return None
    if (needed := item.model.needed_ground(item.params)) is not None:
        affinity = needed
    elif where is None:
        return None
    else:
        affinity = affinity_of(where, site, item)
    if among_plants and needed is None:
        affinity = {**affinity, **dict.fromkeys(_PLANTS, max(affinity.values(), default=0.0))}
    suits = site.surfaces.suitability(affinity)
    if site.allowed is not None:
        h, w = suits.shape
        suits *= cv2.resize(site.allowed.astype(np.uint8), (w, h), interpolation=cv2.INTER_AREA)
    return SuitableGround(suits, site.surfaces.size_wh)


def plants_of(where: Where | None, site: Site) -> SuitableGround | None:
    """Return where trees and shrubs are; None if the recipe does not look at surfaces."""
    if where is None:
        return None
    return SuitableGround(site.surfaces.suitability(_PLANTS), site.surfaces.size_wh)


def affinity_of(where: Where, site: Site, item: PlacementRequest) -> Affinity:
    """Return the affinity of an object to kinds of surface: the recipe's, or its model's with what labels show."""
    if where.surfaces:
        return where.surfaces
    if not where.learned:
        return item.model.surfaces
    category = item.kind.category or item.model.category
    return with_labels(item.model.surfaces, site.labelled_ground, category, site.time_of_day)
