"""What both placements use: objects to be placed, rules that a place has to meet, counts of draws."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from infrablend.assets.model import ObjectModel, Params
from infrablend.config.recipe import Object, Placement
from infrablend.core.boxes import box_of_points, clip_triangles_to_rect
from infrablend.core.camera import CameraSpec, object_to_world
from infrablend.core.mesh import FloatArray, IntArray, Mesh
from infrablend.core.raster import NEAR_M, inside_fraction, project_triangles

# Largest share of the smaller of two boxes that may be shared by an object and what it has to avoid. The paper's
# placement knows the object's box only.
MAX_OVERLAP = 0.02
# Share of the attempts that each object gets, however many of its kind before it found no place.
_FEWEST_ATTEMPTS = 0.05

Pose = tuple[float, float, float, float]  # x_m, y_m, z_m, yaw_rad


@dataclass(frozen=True, eq=False)
class PlacementRequest:
    """An object to be placed.

    Attributes:
        kind: The recipe's entry.
        model: Model of the object.
        params: Arguments of the model's `build`.
        mesh: Geometry in object coordinates, unscaled.
        scale: Extra factor on the model's size.
        visible_aim: Visible share that structures of the background should leave, or None.
        number: Number among the objects drawn for the frame, from 0.
    """

    kind: Object
    model: ObjectModel
    params: Params
    mesh: Mesh
    scale: float
    visible_aim: float | None = None
    number: int = 0

    @cached_property
    def labelled(self) -> NDArray[np.bool_]:
        """(T,) mask of the triangles whose parts count for labels."""
        return np.array([self.model.parts[n].label for n in self.mesh.part_names])[self.mesh.part_of_triangle]

    @cached_property
    def labelled_vertices(self) -> NDArray[np.intp]:
        """(k,) numbers of the vertices of the labelled parts.

        Others, such as ground that a car warms, take up no space and depend on the look, and places must not.
        """
        used = np.zeros(len(self.mesh.vertices_m), np.bool_)
        used[self.mesh.triangles[self.labelled]] = True
        return np.flatnonzero(used)

    @cached_property
    def labelled_vertices_m(self) -> FloatArray:
        """(k, 3) these vertices in object coordinates, unscaled."""
        vertices: FloatArray = self.mesh.vertices_m[self.labelled_vertices]
        return vertices

    @cached_property
    def extent_m(self) -> tuple[FloatArray, FloatArray]:
        """(3,) least and (3,) greatest coordinates of these vertices."""
        return self.labelled_vertices_m.min(axis=0), self.labelled_vertices_m.max(axis=0)

    def in_world(self, pose: Pose) -> FloatArray:
        """Return the (V, 3) vertices in the world, metres."""
        return object_to_world(self.mesh.vertices_m, pose[:3], pose[3], self.scale)


@dataclass
class DrawStatistics:
    """Statistics of the draws for one frame, stored in the scene's `draws`.

    Attributes:
        attempts: Number of poses drawn.
        first_distance_m: Camera distance of the first draw.
        rejected: Rejected draws by reason.
        left_out: Why objects have no place, by their numbers.
        too_small_px: Longer side of the largest box that was too small; None if none was.
    """

    attempts: int = 0
    first_distance_m: float | None = None
    rejected: Counter[str] = field(default_factory=Counter)
    left_out: dict[int, str] = field(default_factory=dict)
    too_small_px: float | None = None

    def note_size(self, reason: str | None, box_xyxy: FloatArray | None) -> None:
        """Keep the size of a box that was too small, if no larger one was."""
        if reason == "too_small" and box_xyxy is not None:
            size = float(max(box_xyxy[2] - box_xyxy[0], box_xyxy[3] - box_xyxy[1]))
            self.too_small_px = max(size, self.too_small_px or 0.0)

    @property
    def absent(self) -> Counter[str]:
        """Number of objects without a place, by reason."""
        return Counter(self.left_out.values())

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {
            "attempts": self.attempts,
            "first_distance_m": self.first_distance_m,
            "rejected": dict(sorted(self.rejected.items())),
            "absent": dict(sorted(self.absent.items())),
            **({} if self.too_small_px is None else {"too_small_px": round(self.too_small_px, 2)}),
        }


def attempts_after(missed: int, attempts: int) -> int:
    """Return the number of draws for an object after `missed` objects of its kind in a row found no place.

    Each missed object halves the number, down to a twentieth, so that a picture that is too small or too full does not
    cost all attempts for every object. The next object that finds a place restores the number.
    """
    return max(attempts >> missed, math.ceil(_FEWEST_ATTEMPTS * attempts))


def examine(
    camera: CameraSpec, world_m: FloatArray, item: PlacementRequest, rules: Placement
) -> tuple[str | None, FloatArray | None]:
    """Return the rule on visibility or size that an object with these (V, 3) vertices breaks, or None, and its box.

    The box is that of `box_px`; objects that are too near or outside the frame have none.
    """
    inside, depth_m = inside_fraction(camera, world_m, item.mesh.triangles)
    if depth_m < rules.min_depth_m:
        return "too_near", None
    if inside < max(rules.min_inside, rules.min_visibility):
        return "outside_frame", None
    box = box_px(camera, world_m, item)
    if rules.size_px is not None:
        size = 0.0 if box is None else float(max(box[2] - box[0], box[3] - box[1]))
        if size < rules.size_px[0]:
            return "too_small", box
        if size > rules.size_px[1]:
            return "too_large", box
    return None, box


def box_px(camera: CameraSpec, world_m: FloatArray, item: PlacementRequest) -> FloatArray | None:
    """Return the (4,) box around an object's labelled parts, cut to the frame as labels are; None outside it."""
    positions, depth_m = camera.project(world_m)
    if float(depth_m.min()) >= NEAR_M:
        box = box_of_points(positions[item.labelled_vertices])
        if (box[:2] >= 0).all() and (box[2:] <= camera.size_wh).all():
            return box
    triangles: IntArray = item.mesh.triangles[item.labelled]
    xy = project_triangles(camera, world_m, triangles).xy
    points = clip_triangles_to_rect(xy, np.array([0, 0, *camera.size_wh], np.float64))
    return np.concatenate([points.min(axis=0), points.max(axis=0)]) if len(points) else None


def is_covered(box_xyxy: FloatArray | None, others: FloatArray, share: float = MAX_OVERLAP) -> bool:
    """Return whether one of (n, 4) other boxes covers more than `share` of the box."""
    if box_xyxy is None or not len(others):
        return False
    area = float(np.prod(box_xyxy[2:] - box_xyxy[:2]))
    return bool((_shared_area(box_xyxy, others) > share * area).any())


def collides(box_xyxy: FloatArray | None, others: FloatArray, share: float = MAX_OVERLAP) -> bool:
    """Return whether the box shares more than `share` of the smaller box's area with one of (n, 4) other boxes."""
    if box_xyxy is None or not len(others):
        return False
    area = float(np.prod(box_xyxy[2:] - box_xyxy[:2]))
    smaller = np.minimum(np.prod(others[:, 2:] - others[:, :2], axis=1), area)
    return bool((_shared_area(box_xyxy, others) > share * smaller).any())


def _shared_area(box_xyxy: FloatArray, others: FloatArray) -> FloatArray:
    low = np.maximum(others[:, :2], box_xyxy[:2])
    high = np.minimum(others[:, 2:], box_xyxy[2:])
    shared: FloatArray = np.prod(np.maximum(high - low, 0), axis=1)
    return shared


@dataclass(frozen=True, eq=False)
class Volume:
    """Upright box around an object, turned as the object is: space that no other insert may take.

    Boxes in the picture do not show that: cars in a row may hide each other and still be metres apart, seen at a low
    angle.

    Attributes:
        corners_xy: (4, 2) corners in world x and y, in order, metres.
        z_m: (2,) lowest and highest z.
    """

    corners_xy: FloatArray
    z_m: FloatArray

    def intersects(self, other: Volume) -> bool:
        """Return whether both volumes share more than an edge or a face."""
        if min(self.z_m[1], other.z_m[1]) <= max(self.z_m[0], other.z_m[0]):
            return False
        for sides in (self.corners_xy[1:3] - self.corners_xy[:2], other.corners_xy[1:3] - other.corners_xy[:2]):
            # Rectangles are apart if their projections on a side of one of them are.
            for side in sides:
                a, b = self.corners_xy @ side, other.corners_xy @ side
                if min(a.max(), b.max()) <= max(a.min(), b.min()):
                    return False
        return True


def volume_of(item: PlacementRequest, pose: Pose) -> Volume:
    """Return the volume of an object's labelled parts."""
    (x0, y0, z0), (x1, y1, z1) = item.extent_m
    corners = np.array([(x0, y0, z0), (x1, y0, z0), (x1, y1, z0), (x0, y1, z1)], np.float64)
    world = object_to_world(corners, pose[:3], pose[3], item.scale)
    return Volume(world[:, :2], world[[0, 3], 2])
