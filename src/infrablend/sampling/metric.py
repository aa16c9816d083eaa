"""Metric placement: objects in the real camera's view, at its real height over a ground plane.

The camera's pitch comes from the metadata, its height from the annotated objects (`calibration`). Standing objects are
put on the ground at a point drawn uniformly over the image, provided the ground there is even and not annotated.
Flying objects are put at a drawn distance on the ray through such a point, always in front of the ground.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.config.recipe import MetricObject, MetricRecipe, RealGround
from infrablend.core.boxes import box_of_points, clip_boxes
from infrablend.core.camera import CameraSpec, object_to_world
from infrablend.core.dataset import ImageRecord, Instance, boxes_of
from infrablend.core.ground_plane import (
    GroundEdges,
    at_height,
    find_ground_edges,
    ground_point,
    ground_z_m,
    pixel_ray,
)
from infrablend.core.mesh import FloatArray
from infrablend.core.scene import SceneSpec, View
from infrablend.imaging.margin import on_margin
from infrablend.sampling.calibration import PRIORS, Calibration, HeightPrior, calibrate, prior_of
from infrablend.sampling.placement import (
    MAX_OVERLAP,
    DrawStatistics,
    PlacementRequest,
    Pose,
    attempts_after,
    box_px,
    collides,
    examine,
    is_covered,
    volume_of,
)
from infrablend.sampling.placer import Arrangement, Placer, Streams
from infrablend.sampling.real_ground import draw_aim, ground_around
from infrablend.sampling.site import Hiding, Site
from infrablend.sampling.suitable_ground import SuitableGround, plants_of, suitable_ground

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
# How far away trees and shrubs may stand that are to hide an object, px.
_NEAR_PX = 10.0
# Share of the attempts, from the first, that place a grouped object beside another; the rest place it anywhere.
_IN_COMPANY = 0.5
# Clarity of the lines on the ground below which they give no direction.
_LEAST_CLARITY = 0.08
# With `along: road`: how far edges count, metres.
_EDGES_M = 9.0
# How far the road is followed to tell its direction from that across it, metres; one of them is taken if the road
# reaches so many times farther there.
_FOLLOWED_M = 25.0
_LONGER = 1.25
# Number of edges, about, that are looked at around each place.
_MOST_EDGES = 3000
# Largest difference in heading between neighbouring parked cars, degrees.
_ROW_TURN_DEG = 4.0


@dataclass(frozen=True, eq=False)
class MetricPlacer(Placer):
    """The placement of `placement.mode: metric`."""

    recipe: MetricRecipe

    def height_prior(self, image: ImageRecord) -> HeightPrior:
        """Return what is known about the picture's stated height, by its origin."""
        known = PRIORS.get(str(image.capture.altitude_from))
        return known or prior_of(self.recipe.camera.stated_heights, image.capture)

    def corrected(
        self, camera: CameraSpec, stated_m: float, labels: Sequence[Instance], prior: HeightPrior
    ) -> Calibration:
        """Return the height of a camera, at its stated height, that a run uses.

        A height stated by the recipe is taken literally; only the metadata's height is nominal.
        """
        if self.recipe.camera.calibrate and self.recipe.camera.needs_height:
            return calibrate(camera, stated_m, labels, prior)
        return Calibration(stated_m, 1.0, 0.0, {})

    def arrange(
        self,
        like: CameraSpec,
        wanted: Sequence[PlacementRequest],
        site: Site | None,
        streams: Streams,
        tally: DrawStatistics,
    ) -> Arrangement:
        """Return the camera, the ground below it, and a pose per object."""
        if site is None:
            raise ValueError("metric placement needs the background")
        camera, view = self._camera(like, site, streams("camera"))
        headings = self._headings(camera, view, site, streams("heading"))
        search = _Search(camera, view, self.recipe, site, headings, streams("placement"), tally)
        return Arrangement(camera, view, [search.place(item) for item in wanted])

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
        """Return other poses of some objects, as often as the recipe asks for."""
        if attempt > self.recipe.placement.contrast_redraws:
            return None
        assert spec.view is not None
        headings = self._headings(spec.camera, spec.view, site, streams("heading"))
        rng = streams(f"placement-{attempt}")
        search = _Search(spec.camera, spec.view, self.recipe, site, headings, rng, tally, others)
        return [search.place(item) for item in wanted]

    def _camera(self, like: CameraSpec, site: Site, rng: np.random.Generator) -> tuple[CameraSpec, View]:
        """Return the background's own camera over the ground; height and roll are drawn where the recipe says so.

        `like` has its pitch, roll, lens and size; the recipe's roll is added to its own.
        """
        c = self.recipe.camera
        stated = c.height_m(site.altitude_m, float(rng.random()))
        roll = like.roll_rad + math.radians(rng.uniform(*c.roll_deg))
        camera = at_height(replace(like, roll_rad=roll), stated)
        found = self.corrected(camera, stated, site.labels, site.height_prior)
        camera = at_height(camera, found.height_m)
        ground = ground_z_m(camera, found.height_m)
        return camera, View(found.height_m, stated, ground, dict(found.anchors), found.sd, found.at_limit)

    def _headings(self, camera: CameraSpec, view: View, site: Site, rng: np.random.Generator) -> _Headings:
        """Return the directions along which objects stand, and the edges that show them."""
        kinds = [(id(kind), kind.align) for kind in self.recipe.objects]
        aligned = {k: a for k, a in kinds if a is not None and a.time_of_day in (None, site.time_of_day)}
        if not aligned:
            return _Headings({}, None)
        turn = float(rng.random())
        across = bool(rng.random() < 0.5)
        off_view = float(rng.standard_normal())
        along_lines = math.pi * turn
        edges = None
        if any(align.along != "view" for align in aligned.values()):
            boxes = [*boxes_of(site.labels), *site.text_boxes]
            edges = find_ground_edges(site.pixels, camera, view.ground_z_m, boxes, site.margin)
            lines = None if edges is None else edges.lines()
            if lines is not None and lines.clarity >= _LEAST_CLARITY:
                along_lines = lines.yaw_rad + (math.pi / 2 if across else 0.0)
        # The camera looks along +Y.
        of_kind = {
            kind: along_lines if align.along != "view" else math.pi / 2 + math.radians(align.turn_deg) * off_view
            for kind, align in aligned.items()
        }
        return _Headings(of_kind, None if edges is None else edges.thinned(_MOST_EDGES))


@dataclass(frozen=True, eq=False)
class _Headings:
    """Directions along which objects of a picture stand.

    Attributes:
        of_kind: Direction, radians, by identity of the kind; only of aligned kinds.
        edges: Edges on the ground, thinned; None if no kind follows them, or the picture shows none.
    """

    of_kind: Mapping[int, float]
    edges: GroundEdges | None


class _Search:
    """The search for places in one picture, for one object after the other."""

    def __init__(
        self,
        camera: CameraSpec,
        view: View,
        recipe: MetricRecipe,
        site: Site,
        headings: _Headings,
        rng: np.random.Generator,
        tally: DrawStatistics,
        occupied: Sequence[tuple[PlacementRequest, Pose]] = (),
    ) -> None:
        """Measure the background; `occupied` has the inserts that have their place already."""
        self._camera = camera
        self._view = view
        self._site = site
        self._rules = recipe.placement
        self._headings = headings
        self._rng = rng
        self._tally = tally
        tally.first_distance_m = camera.distance_m
        self._ignored = boxes_of([i for i in site.labels if i.category in site.ignored])
        self._annotated = boxes_of([i for i in site.labels if i.category not in site.ignored])
        boxes = (box_px(camera, item.in_world(pose), item) for item, pose in occupied)
        self._inserted = np.array([box for box in boxes if box is not None], np.float64).reshape(-1, 4)
        self._placed = [*occupied]
        self._known = len(occupied)
        even = recipe.placement.max_relief_grey > 0
        self._relief = relief_of(site.pixels) / site.grey_unit if even else None
        self._real = _real_ground(recipe, site)
        # By identity of the kind, and the kinds of surface that an individual needs.
        self._suitable: dict[tuple[int, bool, tuple[str, ...]], SuitableGround | None] = {}
        self._missed: dict[int, int] = {}  # by identity of the kind: objects in a row, up to now, without a place

    def place(self, item: PlacementRequest) -> Pose | None:
        """Draw poses until one is fit, and return it; None if none is. Rejections are counted by reason."""
        suitable = self._suitable_ground(item)
        if suitable is not None and not suitable.exists:
            self._tally.left_out[item.number] = "no_ground"
            return None
        in_a_row = self._missed.get(id(item.kind), 0)
        attempts = attempts_after(in_a_row, self._rules.attempts)
        mates = self._mates(item)
        aim = self._ground_aim(item)
        hiding = None if item.visible_aim is None else self._site.hiding
        examined = 0
        for attempt in range(attempts):
            self._tally.attempts += 1
            if attempt >= _HIDDEN * attempts or examined == _HIDING_PLACES:
                hiding = None
            beside = mates if attempt < _IN_COMPANY * attempts else []
            ground = suitable if hiding is None else self._suitable_ground(item, among_plants=True)
            pose = self._draw_beside(item, beside) if beside else self._draw(item, ground)
            if isinstance(pose, str):
                self._tally.rejected[pose] += 1
            elif hiding is not None and not self._has_structure(hiding, item, pose):
                self._tally.rejected["no_occluder"] += 1
            # Before the exact checks, which cost far more.
            elif aim is not None and hiding is None and not aim(pose, attempt / attempts, bool(beside)):
                self._tally.rejected["unlike_real_ground"] += 1
            else:
                examined += 1
                reason = self._misfit(item, pose, hiding, bool(beside))
                if reason is None:
                    self._missed[id(item.kind)] = 0
                    self._placed.append((item, pose))
                    return pose
                self._tally.rejected[reason] += 1
        self._tally.left_out[item.number] = "no_place"
        self._missed[id(item.kind)] = in_a_row + 1
        return None

    def _suitable_ground(self, item: PlacementRequest, *, among_plants: bool = False) -> SuitableGround | None:
        """Return the ground that suits objects of this kind, or also that under trees and shrubs; None for any."""
        kind = id(item.kind), among_plants, tuple(item.model.needed_ground(item.params) or ())
        if kind not in self._suitable:
            self._suitable[kind] = suitable_ground(self._rules.surfaces, self._site, item, among_plants=among_plants)
        return self._suitable[kind]

    def _mates(self, item: PlacementRequest) -> list[Pose]:
        """Return the poses of the objects beside one of which the object is to stand; empty for anywhere."""
        group = _kind(item).group
        if group is None or not item.model.stands or self._rng.random() >= group.share:
            return []
        ground = item.model.needed_ground(item.params)  # people in water have none beside them who stand dry
        return [
            pose
            for other, pose in self._placed[self._known :]
            if other.kind is item.kind and other.model.needed_ground(other.params) == ground
        ]

    def _ground_aim(self, item: PlacementRequest) -> Callable[[Pose, float, bool], bool] | None:
        """Draw the ground that the object looks for, and return whether a pose has it; None for any ground.

        The function takes the pose, the share of the attempts made, and whether the pose is beside another object.
        """
        if self._real is None or not item.model.stands:
            return None
        aim = draw_aim(self._real, self._rng)
        vertices = item.labelled_vertices_m
        outline = vertices[:: max(len(vertices) // _ROUGH_VERTICES, 1)]

        def accepts(pose: Pose, tried: float, beside: bool) -> bool:
            box = _rough_box(self._camera, pose, outline, item.scale)
            ground = ground_around(self._site, box, self._annotated)
            return ground is not None and aim.accepts(ground, tried, beside)

        return accepts

    def _misfit(self, item: PlacementRequest, pose: Pose, hiding: Hiding | None, beside: bool) -> str | None:
        """Return the rule that a pose breaks, or None; then the box of the object is taken."""
        world = item.in_world(pose)
        group = _kind(item).group
        reason, box = examine(self._camera, world, item, self._rules)
        self._tally.note_size(reason, box)
        reason = reason or self._collision(box, MAX_OVERLAP if group is None or not beside else group.max_overlap)
        if reason is None and hiding is not None:
            # What hides an object is not even ground.
            reason = None if hiding.hides(self._camera, world, item) else "no_occluder"
        elif reason is None and item.model.stands and self._relief is not None:
            even = is_even(self._relief, feet_box(self._camera, world), self._rules.max_relief_grey)
            reason = None if even else "uneven_ground"
        # People in a group touch, and boxes around them intersect before they do; cars in a row must not.
        if reason is None and group is not None and group.in_row:
            volume = volume_of(item, pose)
            reason = "in_another" if any(volume.intersects(volume_of(*other)) for other in self._placed) else None
        if reason is None:
            assert box is not None
            self._inserted = np.concatenate([self._inserted, box[None]])
        return reason

    def _collision(self, box: FloatArray | None, max_overlap: float) -> str | None:
        """Return what a box covers and must not, or None; inserts share at most `max_overlap` of the smaller box."""
        if is_covered(box, self._site.text_boxes, 0.0):
            return "on_text"
        if on_margin(self._site.margin, box):
            return "on_margin"
        if self._rules.clear_of_ignored and collides(box, self._ignored):
            return "on_ignored"
        if self._rules.clear_of_labels and (
            collides(box, self._annotated) or collides(box, self._inserted, max_overlap)
        ):
            return "on_annotated"
        return None

    def _has_structure(self, hiding: Hiding, item: PlacementRequest, pose: Pose) -> bool:
        (xy,), (depth_m,) = self._camera.project(np.array([pose[:3]]))
        if item.model.stands and not self._near_plants(xy):  # walls, lamps and gratings are no branches
            return False
        return bool(depth_m > 0) and hiding.has_structure(float(xy[0]), float(xy[1]), item.model.stands)

    @cached_property
    def _plants(self) -> SuitableGround | None:
        return plants_of(self._rules.surfaces, self._site)

    def _near_plants(self, xy: FloatArray) -> bool:
        """Return whether there are trees or shrubs around a position in the picture, as far as surfaces are known."""
        if self._plants is None:
            return True
        around = np.array([xy + (i * _NEAR_PX, j * _NEAR_PX) for i in (-1, 0, 1) for j in (-1, 0, 1)])
        return bool((self._plants.at(around) >= 0.5).any())

    def _draw(self, item: PlacementRequest, suitable: SuitableGround | None) -> Pose | str:
        """Draw a pose, or return the reason for rejecting it; every call uses the same number of random numbers."""
        kind = _kind(item)
        camera = self._camera
        rng = self._rng
        w, h = camera.size_wh
        if suitable is None:
            u, v = float(rng.uniform(0, w)), float(rng.uniform(0, h))
        else:
            u, v = suitable.draw(rng)
        yaw = math.radians(rng.uniform(*kind.yaw_deg))
        above = float(rng.uniform(*kind.z_m))
        share = float(rng.random())
        below = ground_point(camera, u, v, self._view.ground_z_m)
        if item.model.stands:
            if below is None:
                return "no_ground"
            if above < 0:
                return "below_ground"
            yaw = self._aligned(yaw, item, (float(below[0]), float(below[1])))
            pose = float(below[0]), float(below[1]), self._view.ground_z_m + above, yaw
            return pose if suitable is None or suitable.carries(camera, item, pose) else "unfit_ground"
        away = _distance_m(item, camera, share)
        if below is not None and away > _BEFORE_GROUND * float(np.linalg.norm(below - camera.position_m)):
            return "beyond_ground"
        place = camera.position_m + away * pixel_ray(camera, u, v)
        return float(place[0]), float(place[1]), float(place[2]), yaw

    def _draw_beside(self, item: PlacementRequest, mates: Sequence[Pose]) -> Pose | str:
        """Draw a pose beside one of the objects already placed, on the same ground, or return why it is rejected.

        Objects in a row have the heading of their neighbour, whether or not that follows the picture's.
        """
        kind = _kind(item)
        rng = self._rng
        group = kind.group
        assert group is not None
        mate = mates[int(rng.integers(len(mates)))]
        x, y, z, mate_yaw = mate
        away = float(rng.uniform(*group.apart_m))
        turn = float(rng.random())
        heading = float(rng.random())
        if group.in_row:
            yaw = mate_yaw + math.radians(_ROW_TURN_DEG) * (2 * heading - 1) + (math.pi if rng.random() < 0.5 else 0.0)
            towards = mate_yaw + (math.pi / 2 if turn < 0.5 else -math.pi / 2)
        else:
            low, high = (math.radians(d) for d in kind.yaw_deg)
            yaw = self._aligned(low + (high - low) * heading, item, (x, y))
            towards = 2 * math.pi * turn
        pose = x + away * math.cos(towards), y + away * math.sin(towards), z, yaw
        suitable = self._suitable_ground(item)
        return pose if suitable is None or suitable.carries(self._camera, item, pose, mate) else "unfit_ground"

    def _aligned(self, yaw: float, item: PlacementRequest, place_xy: tuple[float, float]) -> float:
        """Return a heading along the picture's or the road's, or the given one for objects that do not follow it."""
        align = _kind(item).align
        common = self._headings.of_kind.get(id(item.kind))
        rng = self._rng
        if align is None or common is None:
            return yaw
        follows = rng.random() < align.share
        back = rng.random() < 0.5
        off = float(rng.standard_normal())
        if align.along == "road" and follows:
            common = self._along_road(common, item, place_xy)
        return common + (math.pi if back else 0.0) + math.radians(align.spread_deg) * off if follows else yaw

    def _along_road(self, common: float, item: PlacementRequest, place_xy: tuple[float, float]) -> float:
        """Return the direction of the road at a place, or that of the picture where no edges are clear."""
        edges = self._headings.edges
        z = self._view.ground_z_m
        lines = None if edges is None else edges.lines(place_xy, _EDGES_M)
        along = common if lines is None or lines.clarity < _LEAST_CLARITY else lines.yaw_rad
        suitable = self._suitable_ground(item)
        if suitable is None:
            return along
        reach = [suitable.reach_m(self._camera, (*place_xy, z), along + turn, _FOLLOWED_M) for turn in (0, math.pi / 2)]
        if max(reach) > _LONGER * min(reach):
            return along if reach[0] > reach[1] else along + math.pi / 2
        # A place as wide as long: in one of both directions, the same in the whole picture.
        return along + math.pi / 2 * round((common - along) / (math.pi / 2))


def _real_ground(recipe: MetricRecipe, site: Site) -> RealGround | None:
    by_time = recipe.placement.ground
    if by_time is None or site.time_of_day is None:
        return None
    return by_time.day if site.time_of_day == "day" else by_time.night


def _kind(item: PlacementRequest) -> MetricObject:
    """Return the recipe's entry of an object; a recipe of metric placement has no others."""
    return cast(MetricObject, item.kind)


def _distance_m(item: PlacementRequest, camera: CameraSpec, share: float) -> float:
    """Return the distance of a flying object, metres, at a drawn share of its range or of its sizes, in [0, 1)."""
    kind = _kind(item)
    if kind.size_px is None:
        near, far = kind.range_m
        return float(near + (far - near) * share)
    small, large = kind.size_px
    low, high = item.extent_m
    length_m = float((high - low).max()) * item.scale
    return camera.focal_px * length_m / float(small * (large / small) ** share)


def _rough_box(camera: CameraSpec, pose: Pose, outline_m: FloatArray, scale: float) -> FloatArray:
    """Return the (4,) box around vertices of an object, cut to the frame; empty if one is behind the camera."""
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
