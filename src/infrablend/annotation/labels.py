"""Labels of the inserted objects: box, oriented box, mask, visibility, truncation.

Boxes come from geometry, so they do not depend on samples or noise. They enclose the projected triangles of the
labelled parts, clipped at the near plane and at the frame's edge. If a nearer object hides a corner of the convex hull,
the hull is rebuilt from the corners that are still visible and the visible samples of a depth buffer. Masks come from
the renderer's coverage. Objects that structures of the background hide in part have a visible share, the box
of the whole object and the box of what is visible.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import (
    box_of_points,
    clip_triangles_to_rect,
    convex_hull,
    convex_hull_indices,
    corners_in_frame,
    min_area_rectangle,
    reach_of_triangles,
    rectangle_along,
    smallest_rectangle_inside,
    start_nearest,
)
from infrablend.core.camera import object_to_world
from infrablend.core.dataset import Instance
from infrablend.core.mesh import FloatArray
from infrablend.core.raster import (
    BoolArray,
    ProjectedTriangles,
    SampleGrid,
    covered_samples,
    hidden_points,
    nearest_inverse_depth,
    outline_points,
    share_per_pixel,
)
from infrablend.core.render import PlacedObject, PlacedScene, RenderResult
from infrablend.core.rle_masks import Mask, row_corners
from infrablend.errors import ModelError

ObbMode = Literal["min_area", "heading"]
DropReason = Literal["no_labelled_part", "outside_frame", "hidden", "no_visible_pixel", "behind_text"]

# A pixel belongs to the mask if at least this share of it is covered.
_MASK_COVERAGE = 0.5
# Limit on one object's depth samples. It sets the samples per pixel: an object of 20 px gets 16 along a pixel's side.
_FRAGMENTS = 200_000
_SUPERSAMPLE = (2, 16)
_AMODAL_LONGEST = 512
# With fewer samples than this inside the frame, the finer sample grid of the frame is more accurate.
_ENOUGH_SAMPLES = 400
# Below this sine of the angle between heading and line of sight, the heading has no direction in the image.
_END_ON = 1e-3
# Digits of the numbers that partly hidden objects get.
_DIGITS = 9


@dataclass(frozen=True)
class Drop:
    """An object of the scene that got no label.

    Attributes:
        index: Index in `SceneSpec.objects`.
        category: Class that the label would have had.
        reason: Reason for leaving the label out.
    """

    index: int
    category: str
    reason: DropReason


@dataclass(frozen=True)
class LabelReport:
    """Special cases met while labelling. All numbers are indices in `SceneSpec.objects`.

    Attributes:
        kept: Object of each instance, in order.
        drops: Objects without a label.
        mask_fallbacks: Objects whose mask would have been empty and became the pixel of largest coverage.
        obb_held_inside: Objects whose oriented box became the smallest rectangle inside the frame.
        heading_end_on: Objects whose heading has no direction in the image; they got the box of least area.
        boxes_from_samples: Objects whose box was measured with depth samples, since something hides their corners.
    """

    kept: tuple[int, ...] = ()
    drops: tuple[Drop, ...] = ()
    mask_fallbacks: tuple[int, ...] = ()
    obb_held_inside: tuple[int, ...] = ()
    heading_end_on: tuple[int, ...] = ()
    boxes_from_samples: tuple[int, ...] = ()

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return {name: list(found) for name, found in asdict(self).items()}


@dataclass(frozen=True, eq=False)
class _Surfaces:
    """Triangles of one object in the image, without translucent parts.

    Attributes:
        labelled: Triangles of parts that labels count.
        unlabelled: Triangles of the other parts.
        every: All of them.
        corners: (P, 3) x, y and 1 / depth of the corners of labelled triangles; shared ones once, if none is cut.
    """

    labelled: ProjectedTriangles
    unlabelled: ProjectedTriangles
    every: ProjectedTriangles
    corners: FloatArray

    @cached_property
    def box_xyxy(self) -> FloatArray:
        """(4,) box around all triangles."""
        return box_of_points(self.every.xy.reshape(-1, 2))

    @cached_property
    def reach(self) -> tuple[FloatArray, FloatArray]:
        """(T, 2) smallest and largest corners of all triangles."""
        return reach_of_triangles(self.every.xy)

    @cached_property
    def nearest(self) -> FloatArray:
        """(T,) largest 1 / depth of all triangles."""
        return reach_of_triangles(self.every.inverse_depth[:, :, None])[1][:, 0]

    def in_front(self, box_xyxy: FloatArray, inverse_depth: float, factor: float) -> ProjectedTriangles | None:
        """Return the triangles that reach into a box and are nearer than 1 / depth once theirs is multiplied."""
        if not len(self.every.xy) or not _overlap(self.box_xyxy, box_xyxy):
            return None
        low, high = self.reach
        over = (low[:, 0] < box_xyxy[2]) & (low[:, 1] < box_xyxy[3])
        over &= (high[:, 0] > box_xyxy[0]) & (high[:, 1] > box_xyxy[1])
        found = self.every.select(over & (self.nearest * factor > inverse_depth))
        return replace(found, inverse_depth=found.inverse_depth * factor) if len(found.xy) else None


@dataclass(frozen=True, eq=False)
class _Shape:
    """The visible shape of one object.

    Attributes:
        hull_xy: (H, 2) corners of the convex hull of the visible part.
        visibility: Visible share in [0, 1].
        truncated: Whether some of the object projects outside the frame.
        coverage: (h, w) share of each pixel of a crop, or None where no samples were needed.
        offset_xy: The crop's top left pixel.
        from_samples: Whether depth samples decided the hull.
    """

    hull_xy: FloatArray
    visibility: float
    truncated: bool
    coverage: NDArray[np.float32] | None
    offset_xy: tuple[int, int]
    from_samples: bool


def annotate(
    scene: PlacedScene, result: RenderResult | None = None, obb: ObbMode = "min_area"
) -> tuple[tuple[Instance, ...], LabelReport]:
    """Label a scene's objects.

    All output formats start from these labels, so they agree on every object.

    Args:
        scene: The frame's scene.
        result: The rendered frame, which gives the masks; without it they come from the geometry.
        obb: Oriented box of least area, or aligned with the object's heading. An object cut by the frame's edge, and
            one whose oriented box would leave the frame, gets the smallest rectangle inside the frame instead.

    Returns:
        The instances in the order of the objects (`extra["object"]` is the index), and a report of special cases.

    Raises:
        ValueError: The numbers of objects and coverage layers, or the frame sizes, disagree.
        ModelError: A mesh has a part that the scene does not know.
    """
    _require_matching(scene, result)
    size_wh = scene.spec.camera.size_wh
    surfaces = [_surfaces(o) for o in scene.objects]
    instances: list[Instance] = []
    kept: list[int] = []
    drops: list[Drop] = []
    fallbacks: list[int] = []
    held_inside: list[int] = []
    end_on: list[int] = []
    from_samples: list[int] = []
    for k, placed in enumerate(scene.objects):
        category = placed.spec.category
        shape = _visible_shape(k, surfaces, size_wh, with_coverage=result is None)
        if isinstance(shape, str):
            drops.append(Drop(k, category, shape))
            continue
        taken: BoolArray | None = None
        if result is not None:
            coverage, taken, offset_xy = _own_pixels(result, k)
        else:
            assert shape.coverage is not None
            coverage = shape.coverage
            offset_xy = shape.offset_xy
        mask, fallback = _mask(coverage, offset_xy, size_wh, taken)
        if mask is None:
            drops.append(Drop(k, category, "no_visible_pixel"))
            continue
        direction = heading_in_image(placed) if obb == "heading" else None
        corners, held = oriented_box(shape.hull_xy, shape.truncated, direction, size_wh)
        kept.append(k)
        if fallback:
            fallbacks.append(k)
        if held:
            held_inside.append(k)
        if obb == "heading" and direction is None:
            end_on.append(k)
        if shape.from_samples:
            from_samples.append(k)
        instances.append(
            Instance(
                category=category,
                box_xyxy=box_of_points(shape.hull_xy),
                corners_xy=corners,
                mask=mask,
                visibility=shape.visibility,
                truncated=shape.truncated,
                inserted=True,
                extra={"object": k},
                track_id=scene.objects[k].spec.track,
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


def _require_matching(scene: PlacedScene, result: RenderResult | None) -> None:
    n = len(scene.objects)
    frame_id = scene.spec.frame_id
    size_wh = scene.spec.camera.size_wh
    if result is None:
        return
    if len(result.coverage) != n:
        raise ValueError(f"{frame_id}: {n} objects need {n} coverages, got {len(result.coverage)}")
    if result.frame_wh != size_wh:
        raise ValueError(f"{frame_id}: rendered {result.frame_wh}, not {size_wh}")
    x, y = result.offset_xy
    h, w = result.alpha.shape
    if x < 0 or y < 0 or x + w > result.frame_wh[0] or y + h > result.frame_wh[1]:
        raise ValueError(f"{frame_id}: crop {w}x{h} at {result.offset_xy} leaves {result.frame_wh}")


def _surfaces(placed: PlacedObject) -> _Surfaces:
    spec = placed.spec
    mesh = placed.mesh
    unknown = [name for name in mesh.part_names if name not in spec.parts]
    if unknown:
        raise ModelError(
            f"model {spec.model!r}: the mesh has parts {unknown} without a state in the scene; "
            f"expected some of {sorted(spec.parts)}"
        )
    states = [spec.parts[name] for name in mesh.part_names]
    counts = np.array([s.label for s in states])[mesh.part_of_triangle]
    hides = ~counts & np.array([s.opacity == 1 for s in states])[mesh.part_of_triangle]
    labelled = placed.triangles_of(counts)
    corners = np.concatenate([labelled.xy, labelled.inverse_depth[:, :, None]], axis=2).reshape(-1, 3)
    if not labelled.cut:
        vertex = mesh.triangles[labelled.source].ravel()
        corner = np.full(len(mesh.vertices_m), -1)
        corner[vertex] = np.arange(len(vertex))
        corners = corners[corner[corner >= 0]]
    if not hides.any():
        nothing = labelled.select(np.zeros(len(labelled.xy), np.bool_))
        return _Surfaces(labelled, nothing, labelled, corners)
    unlabelled = placed.triangles_of(hides)
    return _Surfaces(labelled, unlabelled, _joined([labelled, unlabelled]), corners)


def _joined(pieces: Sequence[ProjectedTriangles]) -> ProjectedTriangles:
    return ProjectedTriangles(
        np.concatenate([p.xy for p in pieces]),
        np.concatenate([p.inverse_depth for p in pieces]),
        np.concatenate([p.source for p in pieces]),
        any(p.cut for p in pieces),
    )


def _visible_shape(
    k: int, surfaces: Sequence[_Surfaces], size_wh: tuple[int, int], with_coverage: bool
) -> _Shape | DropReason:
    """Return the visible shape of object k, or the reason why it is not visible."""
    own = surfaces[k].labelled
    if not len(own.xy):
        return "outside_frame" if own.cut else "no_labelled_part"
    frame = np.array([0, 0, *size_wh], np.float64)
    points = surfaces[k].corners
    full_box = box_of_points(points[:, :2])
    truncated = own.cut or bool((full_box[:2] < 0).any() or (full_box[2:] > frame[2:]).any())
    if truncated:
        points = clip_triangles_to_rect(np.concatenate([own.xy, own.inverse_depth[:, :, None]], axis=2), frame)
    if not len(points):
        return "outside_frame"
    box = box_of_points(points[:, :2])
    if not (box[2:] > box[:2]).all():
        return "outside_frame" if truncated else "no_visible_pixel"
    hull = points[convex_hull_indices(points[:, :2])]

    # At equal depth the first object counts as nearer, so that only one of two coinciding objects is visible.
    least = float(own.inverse_depth.min())
    pairs = ((other, 1 + 1e-9 if j < k else 1.0) for j, other in enumerate(surfaces) if j != k)
    others = [p for other, factor in pairs if (p := other.in_front(box, least, factor)) is not None]
    hidden = hidden_points(hull[:, :2], hull[:, 2], _joined([surfaces[k].unlabelled, *others]))
    offset_xy = (math.floor(box[0]), math.floor(box[1]))
    if not (truncated or others or hidden.any() or with_coverage):
        return _Shape(hull[:, :2], 1.0, False, None, offset_xy, False)

    crop_wh = (math.ceil(box[2]) - offset_xy[0], math.ceil(box[3]) - offset_xy[1])
    supersample = _samples_per_pixel([surfaces[k].every, *others], offset_xy, crop_wh)
    grid = SampleGrid.over_pixels(offset_xy, crop_wh, supersample)
    alone = _unoccluded(surfaces[k], grid)
    seen = alone & _not_behind(own, others, grid) if others else alone
    hull_xy = hull[:, :2]
    if hidden.any():
        points_xy = np.concatenate([outline_points(seen, grid), hull_xy[~hidden]])
        if len(points_xy) < 3:
            return "hidden"
        # A sample is the middle of a cell, so it never leaves the box.
        hull_xy = points_xy[convex_hull_indices(points_xy)]
        box = box_of_points(hull_xy)
        if not (box[2:] > box[:2]).all():
            return "hidden"
    alone_count = int(alone.sum())
    seen_count = int(seen.sum())
    visibility = seen_count / alone_count if alone_count else 1.0
    if truncated:
        visibility *= _share_in_frame(surfaces[k], full_box, size_wh, alone_count * grid.pitch_px**2)
    coverage = share_per_pixel(seen, supersample) if with_coverage else None
    return _Shape(hull_xy, visibility, truncated, coverage, offset_xy, bool(hidden.any()))


def _not_behind(own: ProjectedTriangles, others: Sequence[ProjectedTriangles], grid: SampleGrid) -> NDArray[np.bool_]:
    front = _joined(others)
    depth = nearest_inverse_depth(own.xy, own.inverse_depth, grid)
    return np.asarray(depth >= nearest_inverse_depth(front.xy, front.inverse_depth, grid))


def _overlap(a_xyxy: FloatArray, b_xyxy: FloatArray) -> bool:
    return bool((a_xyxy[:2] < b_xyxy[2:]).all() and (a_xyxy[2:] > b_xyxy[:2]).all())


def _samples_per_pixel(
    pieces: Sequence[ProjectedTriangles], offset_xy: tuple[int, int], crop_wh: tuple[int, int]
) -> int:
    """Return the samples along a pixel's side for which all triangles in the crop cost about `_FRAGMENTS`."""
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


def _unoccluded(surfaces: _Surfaces, grid: SampleGrid) -> BoolArray:
    """Mark the samples at which a labelled part is nearest, ignoring all other objects."""
    own = surfaces.labelled
    parts = surfaces.unlabelled
    if not len(parts.xy):
        return covered_samples(own.xy, grid)
    depth = nearest_inverse_depth(own.xy, own.inverse_depth, grid)
    return np.asarray((depth > 0) & (depth >= nearest_inverse_depth(parts.xy, parts.inverse_depth, grid)))


def _share_in_frame(
    surfaces: _Surfaces, full_box_xyxy: FloatArray, size_wh: tuple[int, int], in_frame_px: float
) -> float:
    """Return the share of an object's own visible area that is inside the frame, in [0, 1]."""
    longest = _AMODAL_LONGEST if not len(surfaces.unlabelled.xy) else _AMODAL_LONGEST // 2
    grid = SampleGrid.over_box(full_box_xyxy, longest)
    whole = _unoccluded(surfaces, grid)
    x, y = grid.columns_x(), grid.rows_y()
    inside = int(whole[(y > 0) & (y < size_wh[1])][:, (x > 0) & (x < size_wh[0])].sum())
    total = int(whole.sum())
    if inside >= _ENOUGH_SAMPLES or not in_frame_px:
        return inside / max(total, 1)
    # Few samples of a very large or thin object are inside the frame, so the frame's own sample grid is more accurate.
    return in_frame_px / max(total * grid.pitch_px**2, in_frame_px)


def _own_pixels(result: RenderResult, k: int) -> tuple[NDArray[np.float32], BoolArray, tuple[int, int]]:
    """Return an object's coverage (h, w), pixels that another one covers more, and the first column and row.

    At equal shares the first object wins. The arrays span the pixels that the object covers.
    """
    rows, columns = (np.flatnonzero(result.coverage[k].any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return np.zeros((0, 0), np.float32), np.zeros((0, 0), np.bool_), result.offset_xy
    window = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    every = result.coverage[:, *window]
    own = every[k]
    taken = (every[:k] >= own).any(axis=0) | (every[k + 1 :] > own).any(axis=0)
    return own, taken, (result.offset_xy[0] + int(columns[0]), result.offset_xy[1] + int(rows[0]))


def _mask(
    coverage: NDArray[np.float32],
    offset_xy: tuple[int, int],
    size_wh: tuple[int, int],
    taken: BoolArray | None,
) -> tuple[Mask | None, bool]:
    """Return the mask of a crop's coverage in the whole frame, and whether it fell back on a single pixel.

    Pixels `taken` by another object are left out: masks of one frame share no pixel, unless that is all an object has.
    """
    if not coverage.size or not float(coverage.max()) > 0:
        return None, False
    chosen = coverage >= _MASK_COVERAGE
    if taken is not None:
        chosen = chosen & ~taken
    fallback = not chosen.any()
    if fallback:
        # The most covered pixel that is left; if none is, one that another object has as well.
        left = coverage if taken is None or not (coverage[~taken] > 0).any() else np.where(taken, 0, coverage)
        chosen = np.zeros(coverage.shape, np.bool_)
        chosen.flat[int(np.argmax(left))] = True
    full = np.zeros((size_wh[1], size_wh[0]), np.bool_)
    x, y = offset_xy
    full[y : y + chosen.shape[0], x : x + chosen.shape[1]] = chosen
    return Mask.from_array(full), bool(fallback)


def heading_in_image(placed: PlacedObject) -> FloatArray | None:
    """Return the (2,) direction in the image of the object's heading (its own +X), or None if it is end-on.

    In perspective the direction depends on the place, so it is computed at the middle of the object's extent.
    """
    spec = placed.spec
    vertices = placed.mesh.vertices_m
    camera = placed.camera
    middle = (vertices.min(axis=0) + vertices.max(axis=0))[None] / 2
    x, y, z = camera.to_camera(object_to_world(middle, spec.position_m, spec.yaw_rad, spec.scale))[0]
    ahead = np.array([math.cos(spec.yaw_rad), math.sin(spec.yaw_rad), 0.0])
    dx, dy, dz = camera.world_to_camera @ ahead
    if z <= 0:
        return None
    # Derivative of (x / z, y / z) along the heading, times z.
    direction = np.array([dx - x * dz / z, dy - y * dz / z])
    length = float(np.hypot(*direction))
    return direction / length if length > _END_ON else None


def oriented_box(
    hull_xy: FloatArray, truncated: bool, direction: FloatArray | None, size_wh: tuple[int, int]
) -> tuple[FloatArray, bool]:
    """Return the (4, 2) corners of the oriented box, and whether it was fitted into the frame.

    Args:
        hull_xy: (H, 2) convex hull of the visible part.
        truncated: Whether the frame cuts the object.
        direction: (2,) direction of the object's heading, for a box along it; None for the box of least area.
        size_wh: Size of the frame.
    """
    free = min_area_rectangle(hull_xy) if direction is None else rectangle_along(hull_xy, direction)
    size = np.asarray(size_wh, np.float64)
    in_frame = corners_in_frame(free, size_wh, 1e-9)
    if in_frame and (direction is None or not truncated):
        return np.clip(free, 0.0, size), False
    corners = smallest_rectangle_inside(hull_xy, size_wh)
    return (corners if direction is None else start_nearest(corners, direction)), True


def label_occluded(
    label: Instance,
    placed: PlacedObject,
    share: float,
    written: Literal["visible", "amodal"] = "visible",
    obb: ObbMode = "min_area",
) -> Instance:
    """Return the label of a partly hidden object.

    `extra` gets `occluded`, `amodal_box` (as if nothing were in front) and `visible_box` (around the visible pixels).

    Args:
        label: Label with the mask of the visible part, and with boxes and `visibility` as if nothing were in front.
        placed: The object.
        share: Share of the object's pixels that is visible.
        written: Box that `box_xyxy` and `corners_xy` describe.
        obb: Kind of oriented box.
    """
    assert label.mask is not None and label.visibility is not None
    points = np.clip(row_corners(label.mask.to_array()), label.box_xyxy[:2], label.box_xyxy[2:])
    hull = convex_hull(np.unique(points, axis=0))
    boxes = {"amodal": label.box_xyxy, "visible": box_of_points(hull)}
    extra = {
        **label.extra,
        "occluded": True,
        **{f"{name}_box": [round(float(v), _DIGITS) for v in box] for name, box in boxes.items()},
    }
    label = replace(label, visibility=round(label.visibility * share, _DIGITS), extra=extra)
    if written == "amodal":
        return label
    direction = heading_in_image(placed) if obb == "heading" else None
    corners, _ = oriented_box(hull, bool(label.truncated), direction, placed.camera.size_wh)
    return replace(label, box_xyxy=boxes["visible"], corners_xy=corners)
