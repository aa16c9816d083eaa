"""Rasteriser: samples triangles on a lattice of points, for silhouettes, depth and visibility.

A sample belongs to a triangle if it lies inside, left and upper edges included, right and lower ones not.
Triangles that share an edge therefore share no sample and leave no gap, and a shape is neither dilated nor eroded: its
sample count is an unbiased measure of its area. Everything works on spans (one triangle on one row of samples), without
a loop over triangles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.boxes import box_of_points, clip_triangles_near, reach_of_triangles
from infrablend.core.camera import CameraSpec
from infrablend.core.mesh import FloatArray, IntArray

BoolArray = NDArray[np.bool_]

NEAR_M = 0.05
# Samples along the longer side of an object's box for its share in the frame, and along a pixel's side of a silhouette.
_LONGEST = 256
_SUPERSAMPLE = 8


@dataclass(frozen=True)
class SampleGrid:
    """A lattice of samples: sample (row r, column c) is at `origin_xy` + (c + 0.5, r + 0.5) * `pitch_px`."""

    origin_xy: tuple[float, float]
    shape_hw: tuple[int, int]
    pitch_px: float

    @classmethod
    def over_pixels(cls, offset_xy: tuple[int, int], size_wh: tuple[int, int], supersample: int) -> SampleGrid:
        """Return a lattice with `supersample` squared samples in each pixel of a crop."""
        w, h = size_wh
        return cls((float(offset_xy[0]), float(offset_xy[1])), (h * supersample, w * supersample), 1 / supersample)

    @classmethod
    def over_box(cls, box_xyxy: FloatArray, longest: int) -> SampleGrid:
        """Return a lattice that spans a box with `longest` samples along its longer side."""
        x0, y0, x1, y1 = (float(v) for v in box_xyxy)
        pitch = max(x1 - x0, y1 - y0, 1e-9) / longest
        return cls((x0, y0), (max(1, math.ceil((y1 - y0) / pitch)), max(1, math.ceil((x1 - x0) / pitch))), pitch)

    def to_samples(self, xy: FloatArray) -> FloatArray:
        """Convert positions (..., 2) in pixels to positions in samples."""
        return np.asarray((xy - np.array(self.origin_xy)) / self.pitch_px)

    def columns_x(self) -> FloatArray:
        """Return the (columns,) x of the samples, pixels."""
        return np.asarray(self.origin_xy[0] + (np.arange(self.shape_hw[1]) + 0.5) * self.pitch_px, np.float64)

    def rows_y(self) -> FloatArray:
        """Return the (rows,) y of the samples, pixels."""
        return np.asarray(self.origin_xy[1] + (np.arange(self.shape_hw[0]) + 0.5) * self.pitch_px, np.float64)


@dataclass(frozen=True, eq=False)
class ProjectedTriangles:
    """Triangles in the image, cut at the near plane.

    Attributes:
        xy: (T, 3, 2) corners, pixels.
        inverse_depth: (T, 3) 1 / depth of the corners, 1/m; linear across the triangle in the image.
        source: (T,) index of the given triangle that each one is (a piece of).
        cut: Whether some triangle reached nearer than the near plane.
    """

    xy: FloatArray
    inverse_depth: FloatArray
    source: NDArray[np.intp]
    cut: bool

    def select(self, keep: NDArray[np.bool_]) -> ProjectedTriangles:
        """Return the triangles with `keep` (T,) True."""
        return ProjectedTriangles(self.xy[keep], self.inverse_depth[keep], self.source[keep], self.cut)


def project_triangles(camera: CameraSpec, vertices_world_m: FloatArray, triangles: IntArray) -> ProjectedTriangles:
    """Project triangles (T, 3), indices into world vertices (V, 3), cut at depth `NEAR_M`."""
    xyz = camera.to_camera(vertices_world_m)
    centre = np.array(camera.size_wh) / 2
    if float(xyz[:, 2].min()) >= NEAR_M:
        inverse = 1.0 / xyz[:, 2]
        xy = xyz[:, :2] * inverse[:, None] * camera.focal_px + centre
        return ProjectedTriangles(xy[triangles], inverse[triangles], np.arange(len(triangles)), False)
    corners = xyz[triangles]
    cut = bool((corners[:, :, 2] < NEAR_M).any())
    corners, source = clip_triangles_near(corners, NEAR_M)
    inverse = 1.0 / corners[:, :, 2]
    xy = corners[:, :, :2] * inverse[:, :, None] * camera.focal_px + centre
    return ProjectedTriangles(xy, inverse, source, cut)


@dataclass(frozen=True, eq=False)
class _Spans:
    """One triangle on one row of samples: columns `start` to `stop` (excluded) of row `row`."""

    triangle: NDArray[np.intp]
    row: NDArray[np.int64]
    start: NDArray[np.int64]
    stop: NDArray[np.int64]


def _spans(corners: FloatArray, shape_hw: tuple[int, int]) -> _Spans:
    """Spans of triangles (T, 3, 2) given in sample positions; empty ones left out."""
    rows, columns = shape_hw
    xa, xb, xc = (np.ascontiguousarray(corners[:, i, 0]) for i in range(3))
    ya, yb, yc = (np.ascontiguousarray(corners[:, i, 1]) for i in range(3))
    first = np.clip(np.ceil(np.minimum(np.minimum(ya, yb), yc) - 0.5), 0, rows).astype(np.int64)
    last = np.clip(np.ceil(np.maximum(np.maximum(ya, yb), yc) - 0.5), 0, rows).astype(np.int64)
    used = np.flatnonzero(
        (last > first)
        & (np.maximum(np.maximum(xa, xb), xc) > 0.5)
        & (np.minimum(np.minimum(xa, xb), xc) <= columns - 0.5)
    )
    count = (last - first)[used]
    first = first[used]
    xa = xa[used]
    xb = xb[used]
    xc = xc[used]
    ya = ya[used]
    yb = yb[used]
    yc = yc[used]
    # Corners by height. Every edge then runs downwards, so two triangles compute a shared edge with the same bits.
    for swap_bc in (False, True, False):
        if swap_bc:
            turn = yc < yb
            xb, xc, yb, yc = (np.where(turn, p, q) for p, q in ((xc, xb), (xb, xc), (yc, yb), (yb, yc)))
        else:
            turn = yb < ya
            xa, xb, ya, yb = (np.where(turn, p, q) for p, q in ((xb, xa), (xa, xb), (yb, ya), (ya, yb)))
    with np.errstate(divide="ignore", invalid="ignore"):
        long_slope = (xc - xa) / (yc - ya)
        top_slope = (xb - xa) / (yb - ya)
        low_slope = (xc - xb) / (yc - yb)
    triangle = np.repeat(np.arange(len(used)), count)
    row = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count) + first[triangle]
    at = row + 0.5
    x0, y0 = xa[triangle], ya[triangle]
    x1, y1 = xb[triangle], yb[triangle]
    on_long = x0 + (at - y0) * long_slope[triangle]
    below = at >= y1
    on_short = np.where(below, x1, x0) + (at - np.where(below, y1, y0)) * np.where(
        below, low_slope[triangle], top_slope[triangle]
    )
    start = np.clip(np.ceil(np.minimum(on_long, on_short) - 0.5), 0, columns).astype(np.int64)
    stop = np.clip(np.ceil(np.maximum(on_long, on_short) - 0.5), 0, columns).astype(np.int64)
    kept = stop > start
    return _Spans(used[triangle[kept]], row[kept], start[kept], stop[kept])


def covered_samples(triangles_xy: FloatArray, grid: SampleGrid) -> BoolArray:
    """Mark the (rows, columns) samples inside the union of triangles (T, 3, 2), pixels."""
    rows, columns = grid.shape_hw
    spans = _spans(grid.to_samples(triangles_xy), grid.shape_hw)
    width = columns + 1
    base = spans.row * width
    # +1 where a span starts, -1 where it stops; the running sum counts the spans over a sample. Each row's
    # sum is 0 at its extra last column, so one sum runs through all rows.
    change = np.bincount(base + spans.start, minlength=rows * width)
    change -= np.bincount(base + spans.stop, minlength=rows * width)
    return np.asarray(np.cumsum(change, dtype=np.int32).reshape(rows, width)[:, :columns] > 0)


def share_per_pixel(samples: BoolArray, supersample: int) -> NDArray[np.float32]:
    """Return the (h, w) float32 share of True samples in each block of `supersample` squared."""
    rows, columns = samples.shape
    size_wh = (columns // supersample, rows // supersample)
    return np.asarray(cv2.resize(samples.astype(np.float32), size_wh, interpolation=cv2.INTER_AREA))


def silhouette(triangles_xy: FloatArray, offset_xy: tuple[int, int], size_wh: tuple[int, int]) -> NDArray[np.float32]:
    """Return the (h, w) share of each pixel of a crop covered by the union of triangles (T, 3, 2) in the frame."""
    grid = SampleGrid.over_pixels(offset_xy, size_wh, _SUPERSAMPLE)
    return share_per_pixel(covered_samples(triangles_xy, grid), _SUPERSAMPLE)


@dataclass(frozen=True, eq=False)
class Fragments:
    """Samples inside triangles: one entry per triangle and sample, triangle by triangle and row by row.

    Attributes:
        index: Flat index of the sample.
        inverse_depth: 1 / depth of the triangle there.
        triangle: The triangle.
    """

    index: NDArray[np.int64]
    inverse_depth: FloatArray
    triangle: NDArray[np.intp]

    def take(self, numbers: NDArray[np.intp]) -> Fragments:
        """Return the fragments with these numbers, in their order."""
        return Fragments(self.index[numbers], self.inverse_depth[numbers], self.triangle[numbers])


def fragments_of(
    triangles_xy: FloatArray, inverse_depth: FloatArray, grid: SampleGrid, chosen: NDArray[np.intp]
) -> Fragments:
    """Return the fragments of chosen triangles, among (T, 3, 2) in pixels, with 1 / depth (T, 3) at the corners."""
    corners = grid.to_samples(triangles_xy[chosen])
    inverse_depth = inverse_depth[chosen]
    spans = _spans(corners, grid.shape_hw)
    # 1/z is linear in the image. Gradients of slivers are wild, so values are held within the corners' range.
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac = b - a, c - a
    za = inverse_depth[:, 0]
    zab = inverse_depth[:, 1] - za
    zac = inverse_depth[:, 2] - za
    twice_area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    safe = np.where(twice_area == 0, 1.0, twice_area)
    slope_x = np.where(twice_area == 0, 0.0, (zab * ac[:, 1] - zac * ab[:, 1]) / safe)
    slope_y = np.where(twice_area == 0, 0.0, (zac * ab[:, 0] - zab * ac[:, 0]) / safe)
    t = spans.triangle
    low, high = (reach[t, 0] for reach in reach_of_triangles(inverse_depth[:, :, None]))
    base = za[t] + slope_y[t] * (spans.row + 0.5 - a[t, 1]) - slope_x[t] * a[t, 0]
    z_start = np.clip(base + slope_x[t] * (spans.start + 0.5), low, high)
    z_last = np.clip(base + slope_x[t] * (spans.stop - 0.5), low, high)
    length = spans.stop - spans.start
    z_step = (z_last - z_start) / np.maximum(length - 1, 1)
    which = np.repeat(np.arange(len(t)), length)
    along = np.arange(len(which)) - np.repeat(np.cumsum(length) - length, length)
    index = (spans.row * grid.shape_hw[1] + spans.start)[which] + along
    return Fragments(index, z_start[which] + along * z_step[which], chosen[t[which]])


def nearest_fragments(fragments: Fragments, grid: SampleGrid) -> tuple[Fragments, FloatArray]:
    """Return the nearest fragment of each sample, and (rows * columns,) its 1 / depth, 0 where there is none.

    Of fragments at the same depth the first triangle's counts.
    """
    nearest = np.zeros(math.prod(grid.shape_hw))
    np.maximum.at(nearest, fragments.index, fragments.inverse_depth)
    best = np.flatnonzero(fragments.inverse_depth >= nearest[fragments.index])
    if len(best) > np.count_nonzero(nearest):
        at = fragments.index[best]
        first = np.empty(len(nearest), np.intp)
        first[at[::-1]] = best[::-1]  # of several values for one sample, the last one stays
        best = best[first[at] == best]
    return fragments.take(best), nearest


def nearest_inverse_depth(triangles_xy: FloatArray, inverse_depth: FloatArray, grid: SampleGrid) -> FloatArray:
    """Return the (rows, columns) largest 1 / depth of the triangles at each sample, 0 where there is none."""
    nearest = np.zeros(math.prod(grid.shape_hw))
    found = fragments_of(triangles_xy, inverse_depth, grid, np.arange(len(triangles_xy)))
    np.maximum.at(nearest, found.index, found.inverse_depth)
    return nearest.reshape(grid.shape_hw)


def visible(
    triangles_xy: FloatArray,
    inverse_depth: FloatArray,
    owner: NDArray[np.integer[Any]],
    owner_count: int,
    offset_xy: tuple[int, int],
    size_wh: tuple[int, int],
    supersample: int = 8,
) -> NDArray[np.float32]:
    """Return the (n, h, w) share of each pixel in which owner k's triangles are the nearest surface.

    Args:
        triangles_xy: (T, 3, 2) corners in pixels of the frame.
        inverse_depth: (T, 3) 1 / depth of the corners.
        owner: (T,) object or part of each triangle; a negative one or one >= n hides but is not returned. Of triangles
            at the same depth the one with the smallest owner counts.
        owner_count: n.
        offset_xy: Column and row of the crop's top left pixel.
        size_wh: Size of the crop.
        supersample: Samples along a pixel's side.
    """
    grid = SampleGrid.over_pixels(offset_xy, size_wh, supersample)
    order = np.argsort(owner, kind="stable")
    found, _ = nearest_fragments(fragments_of(triangles_xy, inverse_depth, grid, order), grid)
    nearest = np.full(grid.shape_hw, -1)
    nearest.flat[found.index] = owner[found.triangle]
    layers = [share_per_pixel(nearest == k, supersample) for k in range(owner_count)]
    return np.stack(layers) if layers else np.zeros((0, size_wh[1], size_wh[0]), np.float32)


def outline_points(samples: BoolArray, grid: SampleGrid) -> FloatArray:
    """Return the (P, 2) pixel positions of each row's first and last True sample; they have the same hull as all."""
    rows = np.flatnonzero(samples.any(axis=1))
    first = samples[rows].argmax(axis=1)
    last = samples.shape[1] - 1 - samples[rows, ::-1].argmax(axis=1)
    x, y = grid.columns_x(), grid.rows_y()[rows]
    return np.concatenate([np.stack([x[first], y], axis=1), np.stack([x[last], y], axis=1)])


def hidden_points(points_xy: FloatArray, inverse_depth: FloatArray, occluders: ProjectedTriangles) -> BoolArray:
    """Mark the points (N, 2) at 1 / depth (N,) that a nearer triangle of the occluders covers."""
    hidden = np.zeros(len(points_xy), np.bool_)
    if not len(points_xy) or not len(occluders.xy):
        return hidden
    low, high = reach_of_triangles(occluders.xy)
    reach_low, reach_high = points_xy.min(axis=0), points_xy.max(axis=0)
    possible = (
        (low <= reach_high).all(axis=1)
        & (high >= reach_low).all(axis=1)
        & (occluders.inverse_depth.max(axis=1) > inverse_depth.min())
    )
    xy = occluders.xy[possible]
    inverse = occluders.inverse_depth[possible]
    low = low[possible]
    high = high[possible]
    # 4M pairs at a time.
    for part in np.array_split(np.arange(len(points_xy)), math.ceil(len(points_xy) * len(xy) / 2**22) or 1):
        x, y = points_xy[part, :1], points_xy[part, 1:]
        point, triangle = np.nonzero((x >= low[:, 0]) & (x <= high[:, 0]) & (y >= low[:, 1]) & (y <= high[:, 1]))
        d = xy[triangle] - points_xy[part[point], None]
        nxt = np.roll(d, -1, axis=1)
        cross = d[:, :, 0] * nxt[:, :, 1] - d[:, :, 1] * nxt[:, :, 0]
        total = cross.sum(axis=1)
        inside = ((cross >= 0).all(axis=1) | (cross <= 0).all(axis=1)) & (total != 0)
        point = point[inside]
        triangle = triangle[inside]
        cross = cross[inside]
        total = total[inside]
        weight = np.roll(cross, 2, axis=1) / total[:, None]
        z = (weight * inverse[triangle]).sum(axis=1)
        nearer = z > inverse_depth[part[point]] * (1 + 1e-9)
        hidden[part[point[nearer]]] = True
    return hidden


def inside_fraction(
    camera: CameraSpec,
    vertices_world_m: FloatArray,
    triangles: IntArray,
) -> tuple[float, float]:
    """Return the share of an object's projected area inside the frame, and the smallest depth of its vertices.

    Args:
        camera: The camera.
        vertices_world_m: (V, 3) in the world.
        triangles: (T, 3) indices; what is nearer than `NEAR_M` is cut away before projecting.

    Returns:
        The share in [0, 1], exactly 1 if the object is wholly inside and ahead, 0 if wholly outside or
        behind; and the depth in metres, negative behind the camera. An object cut by the near plane has the
        share of what is left of it.
    """
    xyz = camera.to_camera(vertices_world_m)
    depth = xyz[:, 2]
    min_depth = float(depth.min())
    w, h = camera.size_wh
    if float(depth.max()) < NEAR_M:
        return 0.0, min_depth
    centre = np.array([w, h]) / 2
    if min_depth >= NEAR_M:
        xy = xyz[:, :2] * (camera.focal_px / depth)[:, None] + centre
        x0, y0, x1, y1 = box_of_points(xy)
        if x0 >= 0 and y0 >= 0 and x1 <= w and y1 <= h:
            return 1.0, min_depth
        if x1 <= 0 or y1 <= 0 or x0 >= w or y0 >= h:
            return 0.0, min_depth
        corners = xy[triangles]
    else:
        clipped, _ = clip_triangles_near(xyz[triangles], NEAR_M)
        if not len(clipped):
            return 0.0, min_depth
        corners = clipped[:, :, :2] * (camera.focal_px / clipped[:, :, 2:]) + centre
    box = box_of_points(corners.reshape(-1, 2))
    if (box[2:] <= 0).any() or (box[:2] >= (w, h)).any():
        return 0.0, min_depth
    grid = SampleGrid.over_box(box, _LONGEST)
    covered = covered_samples(corners, grid)
    total = int(covered.sum())
    if not total:  # thinner than the samples' pitch everywhere: the box's centre decides
        middle = (box[:2] + box[2:]) / 2
        return float(((middle >= 0) & (middle <= (w, h))).all()), min_depth
    x, y = grid.columns_x(), grid.rows_y()
    inside = covered[(y >= 0) & (y <= h)][:, (x >= 0) & (x <= w)]
    return int(inside.sum()) / total, min_depth
