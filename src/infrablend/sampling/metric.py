"""Metric placement: objects in the real camera's view, at its real height over a ground plane.

The camera's pitch comes from the metadata, its height from the annotated objects (`calibration`). Standing objects are
put on the ground at a point drawn uniformly over the image, provided the ground there is even and not annotated.
Flying objects are put at a drawn distance on the ray through such a point, always in front of the ground.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.config.recipe import (
    Align,
    FixedAltitude,
    Group,
    MetricObject,
    MetricRecipe,
    Object,
    RandomAltitude,
    RealGround,
)
from infrablend.core.boxes import box_of_points, clip_boxes
from infrablend.core.burnt_in import find_burnt_in
from infrablend.core.camera import CameraSpec, object_to_world
from infrablend.core.dataset import Instance, TimeOfDay
from infrablend.core.ground_plane import at_height, find_ground_lines, ground_point, ground_z_m, pixel_ray
from infrablend.core.margin import find_margin, on_margin
from infrablend.core.mesh import FloatArray
from infrablend.core.scene import View
from infrablend.core.skyline import Skyline, find_skyline, noise_of
from infrablend.sampling.calibration import FROM_TABLE, Calibration, HeightPrior, calibrate
from infrablend.sampling.placement import (
    MAX_OVERLAP,
    DrawStatistics,
    PlacementRequest,
    Pose,
    attempts_after,
    box_px,
    boxes_of,
    collides,
    examine,
    is_covered,
)
from infrablend.sampling.real_ground import draw_aim, ground_around
from infrablend.sampling.volume import volume_of

# A flying object is at most at this share of the way to the ground.
_BEFORE_GROUND = 0.9
# Side of the windows that relief is measured in, and margin around the feet, px.
_RELIEF_WINDOW_PX = 7
_FEET_MARGIN_PX = 3
# Number of vertices, about, whose box is taken for an object's in the search for ground.
_ROUGH_VERTICES = 200
# Share of an object's height, from below, that counts as its feet.
_FEET = 0.12
# Share of the attempts, from the first, that place an object where it can be partly hidden, and largest number of
# places that are examined closely for that.
_HIDDEN = 0.75
_HIDING_PLACES = 8
# Share of the attempts, from the first, that place a grouped object beside another; the rest place it anywhere.
_IN_COMPANY = 0.5
# Clarity of the lines on the ground below which they give no direction.
_LEAST_CLARITY = 0.08
# Largest difference in heading between neighbouring parked cars, degrees.
_ROW_TURN_DEG = 4.0


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
    """A background as metric placement sees it.

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
        return 2 * np.count_nonzero(self.skyline.sky) >= self.pixels.size

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


def real_camera(
    recipe: MetricRecipe, like: CameraSpec, site: Site, rng: np.random.Generator
) -> tuple[CameraSpec, View]:
    """Return the background's own camera over the ground; height and roll are drawn where the recipe says so.

    `like` has its pitch, roll, lens and size; the recipe's roll is added to its own.
    """
    c = recipe.camera
    drawn = float(rng.random())  # always drawn, so that other draws do not depend on the choice
    if isinstance(c.altitude, FixedAltitude):
        stated = c.altitude.fixed_m
    elif isinstance(c.altitude, RandomAltitude):
        low, high = c.altitude.random_m
        stated = low + (high - low) * drawn
    elif site.altitude_m is not None:
        stated = site.altitude_m
    else:
        raise ValueError("no altitude; the plan must have left this background out")
    roll = like.roll_rad + math.radians(rng.uniform(*c.roll_deg))
    camera = at_height(replace(like, roll_rad=roll), stated)
    # A height stated by the recipe is taken literally; only the metadata's height is nominal.
    nominal = c.calibrate and c.altitude == "metadata"
    found = (
        calibrate(camera, stated, site.labels, site.height_prior)
        if nominal
        else Calibration(stated, stated, 1.0, 0.0, {})
    )
    camera = at_height(camera, found.height_m)
    ground = ground_z_m(camera, found.height_m)
    return camera, View(found.height_m, stated, ground, dict(found.anchors), found.sd, found.at_limit)


def common_headings(
    camera: CameraSpec, view: View, recipe: MetricRecipe, site: Site, rng: np.random.Generator
) -> dict[int, float]:
    """Return the direction along which objects stand, radians, by identity of their kind; only of aligned kinds."""
    aligned = {id(kind): align for kind in recipe.objects if (align := _align_of(kind, site)) is not None}
    if not aligned:
        return {}
    turn, across, off_view = float(rng.random()), bool(rng.random() < 0.5), float(rng.standard_normal())
    along_lines = math.pi * turn
    if any(align.along == "lines" for align in aligned.values()):
        boxes = [*boxes_of(site.labels), *site.text_boxes]
        lines = find_ground_lines(site.pixels, camera, view.ground_z_m, boxes, site.margin)
        if lines is not None and lines.clarity >= _LEAST_CLARITY:
            along_lines = lines.yaw_rad + (math.pi / 2 if across else 0.0)
    # The camera looks along +Y.
    return {
        kind: along_lines if align.along == "lines" else math.pi / 2 + math.radians(align.turn_deg) * off_view
        for kind, align in aligned.items()
    }


def _align_of(kind: Object, site: Site) -> Align | None:
    """Return how objects of a kind are aligned in this picture."""
    align = kind.align if isinstance(kind, MetricObject) else None
    return align if align is not None and align.time_of_day in (None, site.time_of_day) else None


def place_metric(
    camera: CameraSpec,
    view: View,
    recipe: MetricRecipe,
    wanted: Sequence[PlacementRequest],
    site: Site,
    rng: np.random.Generator,
    tally: DrawStatistics,
    occupied: Sequence[tuple[PlacementRequest, Pose]] = (),
    headings: Mapping[int, float] = MappingProxyType({}),
) -> list[Pose | None]:
    """Draw a pose per object, None where no place was found; rejections are counted by reason in `tally`.

    `occupied` has the inserts that have their place already, `headings` are those of `common_headings`.
    """
    rules = recipe.placement
    tally.first_distance_m = camera.distance_m
    ignored = boxes_of([i for i in site.labels if i.category in site.ignored])
    annotated = boxes_of([i for i in site.labels if i.category not in site.ignored])
    boxes = (box_px(camera, item.in_world(pose), item) for item, pose in occupied)
    inserted = np.array([box for box in boxes if box is not None], np.float64).reshape(-1, 4)
    placed = [*occupied]
    relief = relief_of(site.pixels) / site.grey_unit if rules.max_relief_grey > 0 else None
    real = _real_ground(recipe, site)
    poses: list[Pose | None] = []
    missed: dict[int, int] = {}  # by identity of the kind: objects in a row, up to now, without a place
    for number, item in enumerate(wanted):
        found = None
        in_a_row = missed.get(id(item.kind), 0)
        attempts = attempts_after(in_a_row, rules.attempts)
        heading = headings.get(id(item.kind))
        group = _kind(item).group
        mates: list[Pose] = []
        if group is not None and item.model.stands and rng.random() < group.share:
            mates = [p for p, other in zip(poses, wanted[:number], strict=True) if p and other.kind is item.kind]
        wanted_ground = None if real is None or not item.model.stands else (draw_aim(real, rng), _outline(item))
        hiding = None if item.visible_aim is None else site.hiding
        examined = 0
        for attempt in range(attempts):
            tally.attempts += 1
            company = bool(mates) and attempt < _IN_COMPANY * attempts
            pose = _draw_pose_beside(item, mates, rng, heading) if company else _draw(camera, view, item, rng, heading)
            if isinstance(pose, str):
                tally.reject(pose)
                continue
            if attempt >= _HIDDEN * attempts or examined == _HIDING_PLACES:
                hiding = None
            if hiding is not None:
                if not _has_structure(hiding, camera, pose, item):
                    tally.reject("no_occluder")
                    continue
                examined += 1
            if wanted_ground is not None and hiding is None:
                # Before the exact checks, which cost far more.
                aim, outline = wanted_ground
                ground = ground_around(site, _rough_box(camera, pose, outline, item.scale), annotated)
                if ground is None or not aim.accepts(ground, attempt / attempts, company):
                    tally.reject("unlike_real_ground")
                    continue
            world = item.in_world(pose)
            reason, box = examine(camera, world, item, rules)
            if reason is None:
                if is_covered(box, site.text_boxes, 0.0):
                    reason = "on_text"
                elif on_margin(site.margin, box):
                    reason = "on_margin"
                elif rules.clear_of_ignored and collides(box, ignored):
                    reason = "on_ignored"
                elif rules.clear_of_labels and (
                    collides(box, annotated) or _hides_insert(box, inserted, group if company else None)
                ):
                    reason = "on_annotated"
                elif hiding is not None:
                    # What hides an object is not even ground.
                    reason = None if hiding.hides(camera, world, item) else "no_occluder"
                elif item.model.stands and relief is not None:
                    feet = feet_box(camera, world)
                    reason = None if is_even(relief, feet, rules.max_relief_grey) else "uneven_ground"
            # People in a group touch, and boxes around them intersect before they do; cars in a row must not.
            if reason is None and group is not None and group.in_row:
                volume = volume_of(item, pose)
                reason = "in_another" if any(volume.intersects(volume_of(*other)) for other in placed) else None
            if reason is None:
                found = pose
                assert box is not None
                inserted = np.concatenate([inserted, box[None]])
                placed.append((item, pose))
                break
            tally.reject(reason)
        if found is None:
            tally.leave_out("no_place")
        missed[id(item.kind)] = 0 if found else in_a_row + 1
        poses.append(found)
    return poses


def _hides_insert(box_xyxy: FloatArray | None, inserted: FloatArray, group: Group | None) -> bool:
    """Return whether a box shares too much with those of other inserts; members of a group may hide each other."""
    return collides(box_xyxy, inserted, MAX_OVERLAP if group is None else group.max_overlap)


def _real_ground(recipe: MetricRecipe, site: Site) -> RealGround | None:
    by_time = recipe.placement.ground
    if by_time is None or site.time_of_day is None:
        return None
    return by_time.day if site.time_of_day == "day" else by_time.night


def _kind(item: PlacementRequest) -> MetricObject:
    assert isinstance(item.kind, MetricObject)
    return item.kind


def _draw(
    camera: CameraSpec, view: View, item: PlacementRequest, rng: np.random.Generator, heading: float | None
) -> Pose | str:
    """Draw a pose, or return the reason for rejecting it; every call uses the same number of random numbers."""
    kind = _kind(item)
    w, h = camera.size_wh
    u, v = float(rng.uniform(0, w)), float(rng.uniform(0, h))
    yaw = math.radians(rng.uniform(*kind.yaw_deg))
    if kind.align is not None and heading is not None and item.model.stands:
        yaw = _aligned(yaw, kind.align, heading, rng)
    above = float(rng.uniform(*kind.z_m))
    away = float(rng.uniform(*kind.range_m))
    below = ground_point(camera, u, v, view.ground_z_m)
    if item.model.stands:
        if below is None:
            return "no_ground"
        if above < 0:
            return "below_ground"
        return float(below[0]), float(below[1]), view.ground_z_m + above, yaw
    if below is not None and away > _BEFORE_GROUND * float(np.linalg.norm(below - camera.position_m)):
        return "beyond_ground"
    place = camera.position_m + away * pixel_ray(camera, u, v)
    return float(place[0]), float(place[1]), float(place[2]), yaw


def _aligned(yaw: float, align: Align, heading: float, rng: np.random.Generator) -> float:
    """Return a heading along the common one, or the given one for objects that do not follow it."""
    follows, back, off = rng.random() < align.share, rng.random() < 0.5, float(rng.standard_normal())
    return heading + (math.pi if back else 0.0) + math.radians(align.spread_deg) * off if follows else yaw


def _has_structure(hiding: Hiding, camera: CameraSpec, pose: Pose, item: PlacementRequest) -> bool:
    (xy,), (depth_m,) = camera.project(np.array([pose[:3]]))
    return bool(depth_m > 0) and hiding.has_structure(float(xy[0]), float(xy[1]), item.model.stands)


def _draw_pose_beside(
    item: PlacementRequest, mates: Sequence[Pose], rng: np.random.Generator, common: float | None
) -> Pose:
    """Draw a pose beside one of the objects already placed, on the same ground.

    `common` is the picture's heading, radians; objects in a row have their neighbour's, whether or not it follows that.
    """
    kind = _kind(item)
    group = kind.group
    assert group is not None
    x, y, z, mate_yaw = mates[int(rng.integers(len(mates)))]
    away, turn, heading = float(rng.uniform(*group.apart_m)), float(rng.random()), float(rng.random())
    low, high = (math.radians(d) for d in kind.yaw_deg)
    if group.in_row:
        yaw = mate_yaw + math.radians(_ROW_TURN_DEG) * (2 * heading - 1) + (math.pi if rng.random() < 0.5 else 0.0)
        towards = mate_yaw + (math.pi / 2 if turn < 0.5 else -math.pi / 2)
    else:
        yaw, towards = low + (high - low) * heading, 2 * math.pi * turn
        if kind.align is not None and common is not None:
            yaw = _aligned(yaw, kind.align, common, rng)
    return x + away * math.cos(towards), y + away * math.sin(towards), z, yaw


def _outline(item: PlacementRequest) -> FloatArray:
    """Return some (k, 3) vertices of an object's labelled parts, in object coordinates, unscaled."""
    vertices = item.labelled_vertices_m
    return vertices[:: max(len(vertices) // _ROUGH_VERTICES, 1)]


def _rough_box(camera: CameraSpec, pose: Pose, outline_m: FloatArray, scale: float) -> FloatArray:
    """Return the (4,) box around an object's outline, cut to the frame; empty if a vertex is behind the camera."""
    xy, depth_m = camera.project(object_to_world(outline_m, pose[:3], pose[3], scale))
    if (depth_m <= 0).any():
        return np.zeros(4)
    return clip_boxes(box_of_points(xy), camera.size_wh)


def feet_box(camera: CameraSpec, world_m: FloatArray) -> FloatArray:
    """Return the (4,) box in the image around the lowest part of a standing object; NaN behind the camera."""
    z = world_m[:, 2]
    low = world_m[z <= z.min() + _FEET * np.ptp(z)]
    xy, depth_m = camera.project(low)
    if not (depth_m > 0).any():
        return np.full(4, np.nan)
    return np.concatenate([np.nanmin(xy, axis=0), np.nanmax(xy, axis=0)])


def relief_of(pixels: NDArray[np.uint8] | NDArray[np.uint16]) -> NDArray[np.float32]:
    """Return the (h, w) standard deviation of the grey levels around each pixel: low on road, grass and sand."""
    grey = pixels.astype(np.float32)
    window = (_RELIEF_WINDOW_PX, _RELIEF_WINDOW_PX)
    grey -= grey.mean()
    mean = cv2.blur(grey, window)
    return np.asarray(np.sqrt(np.maximum(cv2.blur(grey * grey, window) - mean * mean, 0)), np.float32)


def is_even(relief: NDArray[np.float32], feet_xyxy: FloatArray, limit_grey: float) -> bool:
    """Return whether the ground at the feet is even: at most a tenth of it has more relief than the limit."""
    h, w = relief.shape
    x0, y0 = (max(math.floor(c) - _FEET_MARGIN_PX, 0) for c in feet_xyxy[:2])
    x1 = min(math.ceil(feet_xyxy[2]) + _FEET_MARGIN_PX, w)
    y1 = min(math.ceil(feet_xyxy[3]) + _FEET_MARGIN_PX, h)
    part = relief[y0:y1, x0:x1]
    return bool(part.size) and float((part > limit_grey).mean()) <= 0.1
