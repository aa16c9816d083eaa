"""What is visible of each inserted object: box, oriented box, mask, visibility, truncation.

Boxes come from geometry, so they do not depend on samples or noise: the projected triangles of the parts that
labels count, cut at the near plane and at the frame's edge. Where something nearer hides a corner of that
shape's convex hull, the hull is rebuilt from the corners still visible and from the visible samples of a
depth buffer. Masks come from the renderer's coverage.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import (
    box_of_points,
    clip_triangles_to_rect,
    convex_hull_indices,
    corners_in_frame,
    min_area_rectangle,
    reach_of_triangles,
    rectangle_along,
    smallest_rectangle_inside,
    start_nearest,
)
from infrablend.core.camera import CameraSpec, object_to_world
from infrablend.core.dataset import Instance
from infrablend.core.masks import Mask
from infrablend.core.mesh import FloatArray, Mesh
from infrablend.core.raster import (
    NEAR_M,
    BoolArray,
    ProjectedTriangles,
    SampleGrid,
    covered_samples,
    hidden_points,
    nearest_inverse_depth,
    outline_points,
    project_triangles,
    share_per_pixel,
)
from infrablend.core.render import RenderResult
from infrablend.core.scene import ObjectSpec, SceneSpec
from infrablend.errors import ModelError

ObbMode = Literal["min_area", "heading"]
DropReason = Literal[
    "no_labelled_part",
    "outside_frame",
    "hidden",
    "no_visible_pixel",
    "min_visibility",
    "min_size",
    "max_size",
]

# How many depth samples one object may cost: decides the samples per pixel, 16 along a side at 20 px.
_FRAGMENTS = 200_000
_SUPERSAMPLE = (2, 16)
_AMODAL_LONGEST = 512
# Fewer samples than this inside the frame say too little; the finer lattice over the frame takes their place.
_ENOUGH_SAMPLES = 400
# A heading seen this nearly end-on (sine of the angle to the line of sight) has no direction in the image.
_END_ON = 1e-3


@dataclass(frozen=True)
class LabelSettings:
    """How objects become labels.

    Attributes:
        obb: Oriented box of least area, or aligned with the object's heading. An object cut by the frame's
        edge,
            and one whose oriented box would leave the frame, gets the smallest rectangle inside the frame.
        min_visibility: Objects with a smaller visible share get no label.
        min_size_px: Objects whose box has a shorter longest side get no label.
        max_size_px: Objects whose box has a longer longest side get no label.
        mask_coverage: A pixel belongs to the mask from this coverage on.
        near_m: Geometry nearer to the camera is cut away.
    """

    obb: ObbMode = "min_area"
    min_visibility: float = 0.0
    min_size_px: float = 0.0
    max_size_px: float = math.inf
    mask_coverage: float = 0.5
    near_m: float = NEAR_M


@dataclass(frozen=True)
class Drop:
    """An object of the scene that got no label.

    Attributes:
        index: In `SceneSpec.objects`.
        category: It would have carried.
        reason: Why.
        value: The visibility or size that was too small or large; None for other reasons.
        mask: Its pixels if it has any: the picture shows it all the same, and it hides what is behind it.
    """

    index: int
    category: str
    reason: DropReason
    value: float | None = None
    mask: Mask | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values; the mask is left out."""
        return {"index": self.index, "category": self.category, "reason": self.reason, "value": self.value}


@dataclass(frozen=True)
class LabelReport:
    """What happened on the way from objects to labels. All numbers are indices in `SceneSpec.objects`.

    Attributes:
        kept: Object of each instance, in order.
        drops: Objects without a label.
        mask_fallbacks: Masks that were empty and became the single pixel of largest coverage.
        obb_held_inside: Oriented boxes replaced by the smallest rectangle inside the frame.
        heading_end_on: Headings without a direction in the image; the box of least area was taken.
        boxes_from_samples: Boxes whose extent something nearer decides, so that depth samples measured it.
    """

    kept: tuple[int, ...] = ()
    drops: tuple[Drop, ...] = ()
    mask_fallbacks: tuple[int, ...] = ()
    obb_held_inside: tuple[int, ...] = ()
    heading_end_on: tuple[int, ...] = ()
    boxes_from_samples: tuple[int, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        return {
            "kept": list(self.kept),
            "drops": [d.to_json() for d in self.drops],
            "mask_fallbacks": list(self.mask_fallbacks),
            "obb_held_inside": list(self.obb_held_inside),
            "heading_end_on": list(self.heading_end_on),
            "boxes_from_samples": list(self.boxes_from_samples),
        }


@dataclass(frozen=True, eq=False)
class _Projected:
    """One object in the image: triangles that labels count, the others, and all of them; no translucent ones."""

    labelled: ProjectedTriangles
    unlabelled: ProjectedTriangles
    every: ProjectedTriangles


@dataclass(frozen=True, eq=False)
class _Shape:
    """What of one object can be seen.

    Attributes:
        hull_xy: (H, 2) corners of the convex hull of what is visible.
        visibility: Visible share in [0, 1].
        truncated: Some of it projects outside the frame.
        coverage: (h, w) share of each pixel of a crop, or None where no samples were needed.
        offset_xy: The crop's top left pixel.
        from_samples: True if depth samples decided the hull.
    """

    hull_xy: FloatArray
    visibility: float
    truncated: bool
    coverage: NDArray[np.float32] | None
    offset_xy: tuple[int, int]
    from_samples: bool


def annotate(
    scene: SceneSpec,
    meshes: Sequence[Mesh],
    result: RenderResult | None = None,
    settings: LabelSettings | None = None,
) -> tuple[tuple[Instance, ...], LabelReport]:
    """Labels of a scene's objects, and what happened to those that got none.

    Each object is decided upon once: what is returned here is what every output format holds.

    Args:
        scene: The frame.
        meshes: Geometry of object k, in object coordinates, unscaled.
        result: The rendered frame, which gives the masks; without it they come from the geometry.
        settings: How objects become labels.

    Returns:
        The instances, in the order of the objects (`extra["object"]` is the index), and the report.

    Raises:
        ValueError: If the numbers of objects, meshes and coverage layers, or the frame sizes, disagree.
        ModelError: If a mesh has a part that the scene does not know.
    """
    settings = settings if settings is not None else LabelSettings()
    _require_matching(scene, meshes, result)
    projected = [
        _project(scene.camera, spec, mesh, settings.near_m) for spec, mesh in zip(scene.objects, meshes, strict=True)
    ]
    instances: list[Instance] = []
    kept: list[int] = []
    drops: list[Drop] = []
    fallbacks: list[int] = []
    held_inside: list[int] = []
    end_on: list[int] = []
    from_samples: list[int] = []
    for k, spec in enumerate(scene.objects):
        shape = _visible_shape(k, projected, scene.camera.size_wh, with_coverage=result is None)
        if isinstance(shape, str):
            drops.append(Drop(k, spec.category, shape))
            continue
        taken: BoolArray | None = None
        if result is not None:
            coverage, offset_xy = np.asarray(result.coverage[k]), result.offset_xy
            taken = _taken(result.coverage, k)
        else:
            assert shape.coverage is not None
            coverage, offset_xy = shape.coverage, shape.offset_xy
        mask, fallback = _mask(coverage, offset_xy, scene.camera.size_wh, settings.mask_coverage, taken)
        if mask is None:
            drops.append(Drop(k, spec.category, "no_visible_pixel"))
            continue
        box = box_of_points(shape.hull_xy)
        too = _too_little(shape.visibility, float((box[2:] - box[:2]).max()), settings)
        if too is not None:
            drops.append(Drop(k, spec.category, too[0], too[1], mask))
            continue
        direction = _heading(scene.camera, spec, meshes[k]) if settings.obb == "heading" else None
        corners, held = _oriented_box(shape, direction, scene.camera.size_wh)
        kept.append(k)
        if fallback:
            fallbacks.append(k)
        if held:
            held_inside.append(k)
        if settings.obb == "heading" and direction is None:
            end_on.append(k)
        if shape.from_samples:
            from_samples.append(k)
        instances.append(
            Instance(
                category=spec.category,
                box_xyxy=box,
                corners_xy=corners,
                mask=mask,
                visibility=shape.visibility,
                truncated=shape.truncated,
                inserted=True,
                extra={"object": k},
            )
        )
    report = LabelReport(
        kept=tuple(kept),
        drops=tuple(drops),
        mask_fallbacks=tuple(fallbacks),
        obb_held_inside=tuple(held_inside),
        heading_end_on=tuple(end_on),
        boxes_from_samples=tuple(from_samples),
    )
    return tuple(instances), report


def _require_matching(scene: SceneSpec, meshes: Sequence[Mesh], result: RenderResult | None) -> None:
    n = len(scene.objects)
    if len(meshes) != n:
        raise ValueError(f"{scene.frame_id}: {n} objects need {n} meshes, got {len(meshes)}")
    if result is None:
        return
    if len(result.coverage) != n:
        raise ValueError(f"{scene.frame_id}: {n} objects need {n} coverages, got {len(result.coverage)}")
    if result.frame_wh != scene.camera.size_wh:
        raise ValueError(f"{scene.frame_id}: rendered {result.frame_wh}, not {scene.camera.size_wh}")
    (x, y), (h, w) = result.offset_xy, result.alpha.shape
    if x < 0 or y < 0 or x + w > result.frame_wh[0] or y + h > result.frame_wh[1]:
        raise ValueError(f"{scene.frame_id}: crop {w}x{h} at {result.offset_xy} leaves {result.frame_wh}")


def _project(camera: CameraSpec, spec: ObjectSpec, mesh: Mesh, near_m: float) -> _Projected:
    unknown = [name for name in mesh.part_names if name not in spec.parts]
    if unknown:
        raise ModelError(
            f"model {spec.model!r}: the mesh has parts {unknown} that the scene gives no state; "
            f"expected some of {sorted(spec.parts)}"
        )
    world = object_to_world(mesh.vertices_m, spec.position_m, spec.yaw_rad, spec.scale)
    states = [spec.parts[name] for name in mesh.part_names]
    counts = np.array([s.label for s in states])[mesh.part_of_triangle]
    hides = ~counts & np.array([s.opacity == 1 for s in states])[mesh.part_of_triangle]
    labelled = project_triangles(camera, world, mesh.triangles[counts], near_m)
    if not hides.any():
        nothing = labelled.select(np.zeros(len(labelled.xy), np.bool_))
        return _Projected(labelled, nothing, labelled)
    unlabelled = project_triangles(camera, world, mesh.triangles[hides], near_m)
    return _Projected(labelled, unlabelled, _joined([labelled, unlabelled]))


def _joined(pieces: Sequence[ProjectedTriangles]) -> ProjectedTriangles:
    return ProjectedTriangles(
        np.concatenate([p.xy for p in pieces]),
        np.concatenate([p.inverse_depth for p in pieces]),
        np.concatenate([p.source for p in pieces]),
        any(p.cut for p in pieces),
    )


def _visible_shape(
    k: int, projected: Sequence[_Projected], size_wh: tuple[int, int], with_coverage: bool
) -> _Shape | DropReason:
    """What can be seen of object k, or why nothing can."""
    own = projected[k].labelled
    if not len(own.xy):
        return "outside_frame" if own.cut else "no_labelled_part"
    frame = np.array([0, 0, *size_wh], np.float64)
    corners = own.xy.reshape(-1, 2)
    full_box = box_of_points(corners)
    truncated = own.cut or bool((full_box[:2] < 0).any() or (full_box[2:] > frame[2:]).any())
    points = np.concatenate([own.xy, own.inverse_depth[:, :, None]], axis=2)
    points = clip_triangles_to_rect(points, frame) if truncated else points.reshape(-1, 3)
    if not len(points):
        return "outside_frame"
    box = box_of_points(points[:, :2])
    if not (box[2:] > box[:2]).all():
        return "outside_frame" if truncated else "no_visible_pixel"
    hull = points[convex_hull_indices(points[:, :2])]

    # At equal depth the object that comes first is the nearer one: of two in one place one is seen, not both.
    others = [p.every if j > k else _nearer(p.every, 1e-9) for j, p in enumerate(projected) if j != k]
    others = [p for p in (_in_front(p, box, float(own.inverse_depth.min())) for p in others) if len(p.xy)]
    hidden = hidden_points(hull[:, :2], hull[:, 2], _joined([projected[k].unlabelled, *others]))
    offset_xy = (math.floor(box[0]), math.floor(box[1]))
    if not (truncated or others or hidden.any() or with_coverage):
        return _Shape(hull[:, :2], 1.0, False, None, offset_xy, False)

    crop_wh = (math.ceil(box[2]) - offset_xy[0], math.ceil(box[3]) - offset_xy[1])
    supersample = _samples_per_pixel([projected[k].every, *others], offset_xy, crop_wh)
    grid = SampleGrid.over_pixels(offset_xy, crop_wh, supersample)
    alone = _alone(projected[k], grid)
    seen = alone
    if others:
        front = _joined(others)
        depth = nearest_inverse_depth(own.xy, own.inverse_depth, grid)
        seen = alone & (depth >= nearest_inverse_depth(front.xy, front.inverse_depth, grid))
    hull_xy = hull[:, :2]
    if hidden.any():
        points_xy = np.concatenate([outline_points(seen, grid), hull_xy[~hidden]])
        if len(points_xy) < 3:
            return "hidden"
        # A sample is the middle of a cell, so it stays in the box.
        hull_xy = points_xy[convex_hull_indices(points_xy)]
        box = box_of_points(hull_xy)
        if not (box[2:] > box[:2]).all():
            return "hidden"
    alone_count, seen_count = int(alone.sum()), int(seen.sum())
    visibility = seen_count / alone_count if alone_count else 1.0
    if truncated:
        visibility *= _share_in_frame(projected[k], full_box, size_wh, alone_count * grid.pitch_px**2)
    coverage = share_per_pixel(seen, supersample) if with_coverage else None
    return _Shape(hull_xy, visibility, truncated, coverage, offset_xy, bool(hidden.any()))


def _nearer(triangles: ProjectedTriangles, share: float) -> ProjectedTriangles:
    """The triangles, nearer by a share of their depth."""
    return replace(triangles, inverse_depth=triangles.inverse_depth * (1 + share))


def _in_front(triangles: ProjectedTriangles, box_xyxy: FloatArray, inverse_depth: float) -> ProjectedTriangles:
    """The triangles that reach into a box and are nearer than the farthest point of what is there."""
    low, high = reach_of_triangles(triangles.xy)
    over = (low < box_xyxy[2:]).all(axis=1) & (high > box_xyxy[:2]).all(axis=1)
    return triangles.select(over & (triangles.inverse_depth.max(axis=1) > inverse_depth))


def _samples_per_pixel(
    pieces: Sequence[ProjectedTriangles], offset_xy: tuple[int, int], crop_wh: tuple[int, int]
) -> int:
    """Samples along a pixel's side such that all triangles in the crop together cost about `_FRAGMENTS`."""
    low = np.array(offset_xy, np.float64)
    high = low + crop_wh
    total = 0.0
    for p in pieces:
        a, b = p.xy[:, 1] - p.xy[:, 0], p.xy[:, 2] - p.xy[:, 0]
        area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
        first, last = reach_of_triangles(p.xy)
        within = np.clip(last, low, high) - np.clip(first, low, high)
        total += float(np.minimum(area, within.prod(axis=1)).sum())
    return int(np.clip(math.sqrt(_FRAGMENTS / max(total, 1.0)), *_SUPERSAMPLE))


def _alone(projected: _Projected, grid: SampleGrid) -> BoolArray:
    """Samples at which a labelled part is nearest if the object stands alone."""
    own, parts = projected.labelled, projected.unlabelled
    if not len(parts.xy):
        return covered_samples(own.xy, grid)
    depth = nearest_inverse_depth(own.xy, own.inverse_depth, grid)
    return np.asarray((depth > 0) & (depth >= nearest_inverse_depth(parts.xy, parts.inverse_depth, grid)))


def _share_in_frame(
    projected: _Projected, full_box_xyxy: FloatArray, size_wh: tuple[int, int], in_frame_px: float
) -> float:
    """Share of an object's own visible area that is inside the frame, in [0, 1]."""
    longest = _AMODAL_LONGEST if not len(projected.unlabelled.xy) else _AMODAL_LONGEST // 2
    grid = SampleGrid.over_box(full_box_xyxy, longest)
    whole = _alone(projected, grid)
    x, y = grid.columns_x(), grid.rows_y()
    inside = int(whole[(y > 0) & (y < size_wh[1])][:, (x > 0) & (x < size_wh[0])].sum())
    total = int(whole.sum())
    if inside >= _ENOUGH_SAMPLES or not in_frame_px:
        return inside / max(total, 1)
    # So large that hardly a sample fell into the frame, or so thin: the frame's own lattice measures better.
    return in_frame_px / max(total * grid.pitch_px**2, in_frame_px)


def _taken(coverage: NDArray[np.float32], k: int) -> BoolArray:
    """(h, w) pixels of a crop that another object covers more; of two that share one evenly, the first has it."""
    others = np.delete(np.arange(len(coverage)), k)
    more = [coverage[j] >= coverage[k] if j < k else coverage[j] > coverage[k] for j in others]
    return np.asarray(np.any(more, axis=0)) if more else np.zeros(coverage.shape[1:], np.bool_)


def _mask(
    coverage: NDArray[np.float32],
    offset_xy: tuple[int, int],
    size_wh: tuple[int, int],
    threshold: float,
    taken: BoolArray | None,
) -> tuple[Mask | None, bool]:
    """The mask of a crop's coverage in the whole frame, and whether it had to fall back on a single pixel.

    Pixels `taken` by another object are left out: masks of one frame share no pixel.
    """
    if not coverage.size or not float(coverage.max()) > 0:
        return None, False
    chosen = coverage >= threshold
    if taken is not None:
        chosen = chosen & ~taken
    fallback = not chosen.any()
    if fallback:
        chosen = np.zeros(coverage.shape, np.bool_)
        chosen.flat[int(np.argmax(coverage))] = True
    full = np.zeros((size_wh[1], size_wh[0]), np.bool_)
    x, y = offset_xy
    full[y : y + chosen.shape[0], x : x + chosen.shape[1]] = chosen
    return Mask.from_array(full), bool(fallback)


def _too_little(visibility: float, longest_px: float, settings: LabelSettings) -> tuple[DropReason, float] | None:
    if visibility < settings.min_visibility:
        return "min_visibility", visibility
    if longest_px < settings.min_size_px:
        return "min_size", longest_px
    if longest_px > settings.max_size_px:
        return "max_size", longest_px
    return None


def _heading(camera: CameraSpec, spec: ObjectSpec, mesh: Mesh) -> FloatArray | None:
    """(2,) direction in the image in which the object's heading (+X of its own) points, or None if end-on.

    Taken at the middle of the object's extent: in perspective the direction differs from place to place.
    """
    middle = (mesh.vertices_m.min(axis=0) + mesh.vertices_m.max(axis=0))[None] / 2
    x, y, z = camera.to_camera(object_to_world(middle, spec.position_m, spec.yaw_rad, spec.scale))[0]
    ahead = np.array([math.cos(spec.yaw_rad), math.sin(spec.yaw_rad), 0.0])
    dx, dy, dz = camera.world_to_camera @ ahead
    if z <= 0:
        return None
    # Derivative of (x / z, y / z) along the heading, times z.
    direction = np.array([dx - x * dz / z, dy - y * dz / z])
    length = float(np.hypot(*direction))
    return direction / length if length > _END_ON else None


def _oriented_box(shape: _Shape, direction: FloatArray | None, size_wh: tuple[int, int]) -> tuple[FloatArray, bool]:
    """Corners (4, 2) of the oriented box, and whether staying inside the frame decided it."""
    free = min_area_rectangle(shape.hull_xy) if direction is None else rectangle_along(shape.hull_xy, direction)
    size = np.asarray(size_wh, np.float64)
    in_frame = corners_in_frame(free, size_wh, 1e-9)
    if in_frame and (direction is None or not shape.truncated):
        return np.clip(free, 0.0, size), False
    corners = smallest_rectangle_inside(shape.hull_xy, size_wh)
    return (corners if direction is None else start_nearest(corners, direction)), True
