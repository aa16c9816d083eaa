"""Boxes, rectangles and convex polygons in the image plane, exact in float64.

Pixels are half-open: a box x0, y0, x1, y1 covers [x0, x1) x [y0, y1). x grows to the right and y downwards,
so a positive angle turns clockwise on screen. "Clockwise" below always means clockwise as seen on screen.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from infrablend.core.mesh import FloatArray

QUARTER_TURN_RAD = math.pi / 2
MANY_PX = 8
"""Smallest side of a picture that is more than a pixel beyond doubt."""

# Areas closer than this (relative) count as equal and the smaller angle wins, so that rounding does not decide.
_TIE = 1e-12
# Distance by which a corner may leave the frame through rounding; it is then moved back onto the edge.
_SLACK_PX = 1e-9


# -- axis-aligned boxes --------------------------------------------------------------------------------------


def box_of_points(points_xy: FloatArray) -> FloatArray:
    """Return the (4,) box x0, y0, x1, y1 around points (N, 2), N >= 1."""
    # By columns: numpy is many times slower along an axis when the other one is this short.
    x, y = np.ascontiguousarray(points_xy[:, 0]), np.ascontiguousarray(points_xy[:, 1])
    return np.array([x.min(), y.min(), x.max(), y.max()])


def clip_boxes(boxes_xyxy: FloatArray, size_wh: tuple[int, int]) -> FloatArray:
    """Return boxes (..., 4) clipped to the frame; one outside becomes empty, on the frame's edge."""
    w, h = size_wh
    return np.clip(boxes_xyxy, 0.0, np.array([w, h, w, h], np.float64))


def are_shares(boxes_xyxy: FloatArray) -> NDArray[np.bool_]:
    """Return which boxes are in shares of the picture instead of px, of (n, 4) boxes in px of pictures of many px.

    Shares of any order of corners, centres and sizes give boxes of up to a pixel beside the picture's first one.
    """
    boxes = boxes_xyxy.reshape(-1, 4)
    left_top = boxes[:, :2]
    size = boxes[:, 2:] - left_top
    small: NDArray[np.bool_] = np.all((np.abs(left_top) <= 1) & (size > 0) & (size <= 1), axis=1)
    # Whole pixels may be drawn, and a box in the corner may be what is left of an object outside of the picture.
    small &= (boxes != boxes.round()).any(1) | (boxes <= 1).all(1)
    beyond_doubt = small & (left_top > 0).any(1)
    return small if small.all() or beyond_doubt.any() else np.zeros_like(small)


def box_iou(a_xyxy: FloatArray, b_xyxy: FloatArray) -> FloatArray:
    """Return the (N, M) intersection over union of boxes (N, 4) and (M, 4); 0 where both are empty."""
    both = shared_areas(a_xyxy, b_xyxy)
    union = box_areas(a_xyxy)[:, None] + box_areas(b_xyxy)[None] - both
    return np.asarray(np.divide(both, union, out=np.zeros_like(both), where=union > 0))


def shared_areas(a_xyxy: FloatArray, b_xyxy: FloatArray) -> FloatArray:
    """Return the (N, M) areas that boxes (N, 4) and (M, 4) have in common."""
    low = np.maximum(a_xyxy[:, None, :2], b_xyxy[None, :, :2])
    high = np.minimum(a_xyxy[:, None, 2:], b_xyxy[None, :, 2:])
    return np.asarray(np.prod(np.maximum(high - low, 0.0), axis=-1))


def box_areas(boxes_xyxy: FloatArray) -> FloatArray:
    """Return the (N,) areas of boxes (N, 4); 0 for empty ones."""
    return np.asarray(np.prod(np.maximum(boxes_xyxy[:, 2:] - boxes_xyxy[:, :2], 0.0), axis=-1))


def pixel_box(box_xyxy: NDArray[np.float64], shape_hw: tuple[int, ...]) -> tuple[int, int, int, int]:
    """Return the first and last column and row (exclusive) of a box grown to whole pixels and cut to the frame."""
    x0, y0, x1, y1 = box_xyxy
    h, w = shape_hw
    return (
        min(max(math.floor(x0), 0), w),
        min(max(math.floor(y0), 0), h),
        min(max(math.ceil(x1), 0), w),
        min(max(math.ceil(y1), 0), h),
    )


def boxes_mask(
    boxes_xyxy: Iterable[FloatArray], shape_hw: tuple[int, ...], window: tuple[int, int, int, int] | None = None
) -> NDArray[np.bool_]:
    """Mark the pixels that boxes, grown to whole pixels, cover.

    Args:
        boxes_xyxy: Boxes of 4 numbers each.
        shape_hw: Size of the frame.
        window: Left, top, right and bottom edge of the part of the frame to return; None for all of it.

    Returns:
        (h, w) mask of the window.
    """
    left, top, right, bottom = (0, 0, shape_hw[1], shape_hw[0]) if window is None else window
    mask = np.zeros((bottom - top, right - left), np.bool_)
    boxes = np.array([*boxes_xyxy], np.float64).reshape(-1, 4)
    low, high = np.floor(boxes[:, :2]), np.ceil(boxes[:, 2:])
    reaching = (low < (right, bottom)).all(axis=1) & (high > (left, top)).all(axis=1)
    for box in boxes[reaching]:
        x0, y0, x1, y1 = pixel_box(box, shape_hw)
        mask[max(y0 - top, 0) : max(y1 - top, 0), max(x0 - left, 0) : max(x1 - left, 0)] = True
    return mask


# -- polygons ------------------------------------------------------------------------------------------------


def polygon_area(polygon_xy: FloatArray) -> float:
    """Return the signed area of a polygon (N, 2), px², positive if it runs clockwise; 0 below three points."""
    if len(polygon_xy) < 3:
        return 0.0
    x, y = (polygon_xy - polygon_xy[0]).T
    return float(0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def clockwise(corners_xy: FloatArray) -> FloatArray:
    """Return the corners (4, 2) of a convex outline in any order clockwise on screen, from the first one on."""
    x, y = (corners_xy - corners_xy.mean(axis=0)).T
    order = np.argsort(np.arctan2(y, x), kind="stable")
    return np.asarray(corners_xy[np.roll(order, -int(np.flatnonzero(order == 0)[0]))])


def _well_inside(points_xy: FloatArray, directions: int) -> NDArray[np.bool_]:
    """Mark points well inside the polygon of the extreme points in evenly spread directions.

    Such points cannot be corners of the hull (Akl and Toussaint 1978).
    """
    angle = np.arange(directions) * (2 * math.pi / directions)
    start = points_xy[np.argmax(np.stack([np.cos(angle), np.sin(angle)], axis=1) @ points_xy.T, axis=1)]
    edge = np.roll(start, -1, axis=0) - start
    used = (edge != 0).any(axis=1)
    start = start[used]
    edge = edge[used]
    if len(edge) < 3:
        return np.zeros(len(points_xy), np.bool_)
    normal = np.stack([-edge[:, 1], edge[:, 0]], axis=1)
    margin = 1e-9 * float(np.abs(edge).max()) * max(1.0, float(np.abs(start).max()))
    least = (normal * start).sum(axis=1) + margin
    return np.asarray((normal @ points_xy.T > least[:, None]).all(axis=0))


def convex_hull_indices(points_xy: FloatArray) -> NDArray[np.intp]:
    """Return the indices (H,) of the convex hull's corners among points (N, 2), clockwise from the leftmost one.

    Points inside edges are left out. One index for a single place, two for points on a line, none for N = 0.
    """
    n = len(points_xy)
    if n == 0:
        return np.zeros(0, np.intp)
    candidates = np.arange(n)
    for directions in (8, 64):
        if len(candidates) > 64:
            candidates = candidates[~_well_inside(points_xy[candidates], directions)]
    order = candidates[np.lexsort((points_xy[candidates, 1], points_xy[candidates, 0]))]
    # Of points at the same place only the first and the last matter below.
    step = (np.diff(points_xy[order], axis=0) != 0).any(axis=1)
    order = order[np.append(True, step) | np.append(step, True)]
    xs, ys = points_xy[order, 0].tolist(), points_xy[order, 1].tolist()

    def chain(sequence: range) -> list[int]:
        kept: list[int] = []
        for i in sequence:
            while len(kept) >= 2:
                a, b = kept[-2], kept[-1]
                if (xs[b] - xs[a]) * (ys[i] - ys[a]) - (ys[b] - ys[a]) * (xs[i] - xs[a]) > 0:
                    break
                kept.pop()
            if not kept or xs[i] != xs[kept[-1]] or ys[i] != ys[kept[-1]]:
                kept.append(i)
        return kept

    upper = chain(range(len(order)))
    lower = chain(range(len(order) - 1, -1, -1))
    ring = upper if len(upper) == 1 else upper[:-1] + lower[:-1]
    return np.asarray(order[ring])


def convex_hull(points_xy: FloatArray) -> FloatArray:
    """Return the (H, 2) corners of the convex hull of points (N, 2), clockwise; see `convex_hull_indices`."""
    return np.asarray(points_xy[convex_hull_indices(points_xy)])


def clip_convex(polygon_xy: FloatArray, clip_xy: FloatArray) -> FloatArray:
    """Return the (K, 2) intersection of convex polygons (N, 2) and (M, 2), both clockwise; K may be 0."""
    polygon = np.asarray(polygon_xy, np.float64)
    for a, b in zip(clip_xy, np.roll(clip_xy, -1, axis=0), strict=True):
        if not len(polygon):
            break
        ex, ey = b - a
        side = ex * (polygon[:, 1] - a[1]) - ey * (polygon[:, 0] - a[0])
        nxt = np.roll(polygon, -1, axis=0)
        nxt_side = np.roll(side, -1)
        crossing = side * nxt_side < 0
        share = np.divide(side, side - nxt_side, out=np.zeros_like(side), where=crossing)
        cut = polygon + share[:, None] * (nxt - polygon)
        # Each corner is followed by the point where the edge that leaves it crosses the line.
        both = np.stack([polygon, cut], axis=1).reshape(-1, 2)
        polygon = both[np.stack([side >= 0, crossing], axis=1).reshape(-1)]
    return polygon


def inside_convex(points_xy: FloatArray, polygon_xy: FloatArray) -> NDArray[np.bool_]:
    """Mark the (N,) points (N, 2) in the closed convex polygon (M, 2), clockwise."""
    edge = np.roll(polygon_xy, -1, axis=0) - polygon_xy
    x = points_xy[:, :1] - polygon_xy[:, 0]
    y = points_xy[:, 1:] - polygon_xy[:, 1]
    return np.asarray((edge[:, 0] * y - edge[:, 1] * x >= 0).all(axis=1))


# -- triangles -----------------------------------------------------------------------------------------------


def reach_of_triangles(triangles: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the smallest and largest values (T, C) over the corners of triangles (T, 3, C)."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def clip_triangles_near(xyz_m: FloatArray, near_m: float) -> tuple[FloatArray, NDArray[np.intp]]:
    """Cut triangles (T, 3, 3) in camera coordinates at depth `near_m` and keep what is farther.

    Returns:
        Triangles (T', 3, 3), and (T',) the index of the triangle each is a piece of.
    """
    ahead = xyz_m[:, :, 2] >= near_m
    count = ahead.sum(axis=1)
    whole = np.flatnonzero(count == 3)
    if len(whole) == len(xyz_m):
        return xyz_m, np.arange(len(xyz_m))

    def turned(which: NDArray[np.intp], lone: NDArray[np.bool_]) -> FloatArray:
        """Return the triangles, renumbered so that the corner alone on its side of the plane comes first."""
        first = np.argmax(lone[which], axis=1)
        return np.asarray(xyz_m[which[:, None], (first[:, None] + np.arange(3)) % 3])

    def crossing(a: FloatArray, b: FloatArray) -> FloatArray:
        share = (near_m - a[:, 2]) / (b[:, 2] - a[:, 2])
        point = a + share[:, None] * (b - a)
        point[:, 2] = near_m
        return point

    one = np.flatnonzero(count == 1)
    two = np.flatnonzero(count == 2)
    t1, t2 = turned(one, ahead), turned(two, ~ahead)
    tip = np.stack([t1[:, 0], crossing(t1[:, 0], t1[:, 1]), crossing(t1[:, 0], t1[:, 2])], axis=1)
    p, q = crossing(t2[:, 1], t2[:, 0]), crossing(t2[:, 2], t2[:, 0])
    half_a = np.stack([p, t2[:, 1], t2[:, 2]], axis=1)
    half_b = np.stack([p, t2[:, 2], q], axis=1)
    return np.concatenate([xyz_m[whole], tip, half_a, half_b]), np.concatenate([whole, one, two, two])


def clip_triangles_to_rect(triangles: FloatArray, rect_xyxy: FloatArray) -> FloatArray:
    """Return the corners (P, C) of triangles (T, 3, C) clipped to a rectangle, in no particular order.

    The first two of the C values are x and y; the others are interpolated linearly with them. The convex hull
    of the result is the convex hull of the clipped triangles; points repeat where triangles share them.
    """
    x0, y0, x1, y1 = (float(v) for v in rect_xyxy)
    low, high = reach_of_triangles(triangles[:, :, :2])
    touching = (low[:, 0] <= x1) & (high[:, 0] >= x0) & (low[:, 1] <= y1) & (high[:, 1] >= y0)
    within = (low[:, 0] >= x0) & (high[:, 0] <= x1) & (low[:, 1] >= y0) & (high[:, 1] <= y1)
    width = triangles.shape[2]
    found = [triangles[within].reshape(-1, width)]
    cut = triangles[touching & ~within]
    if len(cut):
        # Corners of a clipped triangle: ends of its clipped edges (Liang and Barsky) ...
        a = cut.reshape(-1, width)
        b = np.roll(cut, -1, axis=1).reshape(-1, width)
        step = b - a
        with np.errstate(divide="ignore", invalid="ignore"):
            enter_exit = (np.array([[x0, y0], [x1, y1]])[:, None] - a[:, :2]) / step[:, :2]
        still = step[:, :2] == 0
        out = still & ((a[:, :2] < [x0, y0]) | (a[:, :2] > [x1, y1]))
        enter = np.where(still, -np.inf, enter_exit.min(axis=0)).max(axis=1)
        leave = np.where(still, np.inf, enter_exit.max(axis=0)).min(axis=1)
        enter = np.maximum(enter, 0.0)
        leave = np.minimum(leave, 1.0)
        crosses = (enter <= leave) & ~out.any(axis=1)
        a = a[crosses]
        step = step[crosses]
        enter = enter[crosses, None]
        leave = leave[crosses, None]
        found += [a + enter * step, a + leave * step]
        # ... and corners of the rectangle that lie in the triangle.
        for corner in ((x0, y0), (x1, y0), (x1, y1), (x0, y1)):
            weight = _barycentric(cut[:, :, :2], np.array(corner))
            inside = (weight >= 0).all(axis=1)
            point = (weight[inside, :, None] * cut[inside]).sum(axis=1)
            point[:, :2] = corner
            found.append(point)
    points = np.concatenate(found)
    points[:, :2] = np.clip(points[:, :2], [x0, y0], [x1, y1])
    return np.asarray(points)


def _barycentric(triangles_xy: FloatArray, point_xy: FloatArray) -> FloatArray:
    """Return the (T, 3) barycentric weights of a point in triangles (T, 3, 2); NaN for triangles without area."""
    d = triangles_xy - point_xy
    nxt = np.roll(d, -1, axis=1)
    cross = d[:, :, 0] * nxt[:, :, 1] - d[:, :, 1] * nxt[:, :, 0]  # of the edge i -> i + 1: weight of corner i + 2
    total = cross.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        weight: FloatArray = np.where(total != 0, np.roll(cross, 2, axis=1) / total, np.nan)
    return weight


# -- oriented boxes ------------------------------------------------------------------------------------------


def corners_of_cxcywha(boxes: FloatArray) -> FloatArray:
    """Return the corners (..., 4, 2), clockwise, of boxes (..., 5): centre x, y, width, height, angle in radians.

    The width runs along (cos angle, sin angle), so a positive angle turns clockwise; at angle 0 the corners
    are top left, top right, bottom right, bottom left.
    """
    centre = boxes[..., :2]
    w = boxes[..., 2:3]
    h = boxes[..., 3:4]
    angle = boxes[..., 4]
    along = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * w / 2
    across = np.stack([-np.sin(angle), np.cos(angle)], axis=-1) * h / 2
    return np.stack(
        [centre - along - across, centre + along - across, centre + along + across, centre - along + across],
        axis=-2,
    )


def cxcywha_of_corners(corners_xy: FloatArray) -> FloatArray:
    """Return boxes (..., 5): centre x, y, width, height, angle in (-pi, pi], of corners (..., 4, 2), clockwise.

    The width runs from the first corner to the second. Corners that form no exact rectangle (rounded ones)
    give the rectangle with their mean sides.
    """
    c0, c1, c2, c3 = (corners_xy[..., i, :] for i in range(4))
    along = (c1 - c0 + c2 - c3) / 2
    across = (c3 - c0 + c2 - c1) / 2
    w, h = np.hypot(along[..., 0], along[..., 1]), np.hypot(across[..., 0], across[..., 1])
    # A box without width still has a direction if it has a height.
    angle = np.where(w > 0, np.arctan2(along[..., 1], along[..., 0]), np.arctan2(-across[..., 0], across[..., 1]))
    centre = corners_xy.mean(axis=-2)
    return np.concatenate([centre, np.stack([w, h, angle], axis=-1)], axis=-1)


def corners_of_box(box_xyxy: FloatArray) -> FloatArray:
    """Return the (4, 2) corners of one axis-aligned box, clockwise from the top left."""
    x0, y0, x1, y1 = box_xyxy
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], np.float64)


def corners_in_frame(corners_xy: FloatArray, size_wh: tuple[int, int], slack_px: float = 0.0) -> bool:
    """Return whether no corner (N, 2) is farther than `slack_px` outside [0, w] x [0, h]."""
    high = np.asarray(size_wh, np.float64) + slack_px
    return bool((corners_xy >= -slack_px).all() and (corners_xy <= high).all())


def rectangle_along(points_xy: FloatArray, direction_xy: FloatArray) -> FloatArray:
    """Return the tight rectangle (4, 2), clockwise, around points (N, 2) with a side along a direction.

    The side from the first corner to the second points in that direction.

    Raises:
        ValueError: If the direction has no length.
    """
    length = math.hypot(float(direction_xy[0]), float(direction_xy[1]))
    if not length > 0:
        raise ValueError(f"a direction needs a length, got {direction_xy!r}")
    u = np.asarray(direction_xy, np.float64) / length
    v = np.array([-u[1], u[0]])
    a, b = points_xy @ u, points_xy @ v
    a0, a1 = a.min(), a.max()
    b0, b1 = b.min(), b.max()
    return np.stack([a0 * u + b0 * v, a1 * u + b0 * v, a1 * u + b1 * v, a0 * u + b1 * v])


def _rectangle_at(points_xy: FloatArray, angle_rad: float) -> FloatArray:
    return rectangle_along(points_xy, np.array([math.cos(angle_rad), math.sin(angle_rad)]))


def _edge_angles(hull_xy: FloatArray) -> FloatArray:
    """Directions of a hull's edges modulo a quarter turn, in [0, pi/2), sorted, each once."""
    edge = np.roll(hull_xy, -1, axis=0) - hull_xy
    edge = edge[(edge != 0).any(axis=1)]
    angle = np.mod(np.arctan2(edge[:, 1], edge[:, 0]), QUARTER_TURN_RAD)
    angle[angle >= QUARTER_TURN_RAD] = 0.0
    return np.asarray(np.unique(angle))


def min_area_rectangle(points_xy: FloatArray) -> FloatArray:
    """Return the (4, 2) corners, clockwise, of the smallest rectangle around points (N, 2), N >= 1.

    A smallest rectangle has a side along an edge of the convex hull (Freeman and Shapira 1975); all of them
    are tried, in float64. Of equally small ones the one with the smallest angle in [0, pi/2) is taken.
    """
    hull = convex_hull(points_xy)
    angles = _edge_angles(hull)
    if not len(angles):
        return np.repeat(hull, 4, axis=0)
    areas = []
    for part in np.array_split(angles, math.ceil(len(angles) * len(hull) / 2**20)):
        u, v = np.stack([np.cos(part), np.sin(part)]), np.stack([-np.sin(part), np.cos(part)])
        areas.append(np.ptp(hull @ u, axis=0) * np.ptp(hull @ v, axis=0))
    area = np.concatenate(areas)
    scale = float(np.ptp(hull, axis=0).max()) ** 2
    best = angles[area <= area.min() * (1 + _TIE) + _TIE * scale]
    return _rectangle_at(hull, float(best[0]))


def smallest_rectangle_inside(points_xy: FloatArray, size_wh: tuple[int, int]) -> FloatArray:
    """Return the (4, 2) corners, clockwise, of the smallest rectangle around points that stays inside the frame.

    For each angle the smallest rectangle around the points is the tight one, and if any at this angle stays
    in the frame, the tight one does. Between two neighbouring edge directions of the hull the same four
    points hold the four sides, so both sides' lengths are sinusoids of the angle, their product is
    log-concave, and its minimum over any interval lies at an end of it. The candidates are therefore the edge
    directions, and the angles at which a corner of the rectangle touches a side of the frame: by Thales'
    theorem a corner runs on a circle, and its position is p + q cos(2 angle) + r sin(2 angle), which is
    solved in closed form. The axis-aligned rectangle always stays inside, so there is always an answer. It is
    the only one where two of the points lie on one side of the frame, as they do if the frame cuts a body.

    Args:
        points_xy: (N, 2), N >= 1, inside the frame.
        size_wh: The frame.

    Returns:
        Corners within [0, w] x [0, h] to the last bit. Of equally small ones the smallest angle in [0, pi/2).

    Raises:
        ValueError: If a point lies more than 1e-6 px outside the frame.
    """
    if not corners_in_frame(points_xy, size_wh, 1e-6):
        raise ValueError(f"points must lie in the frame {size_wh}, got the box {box_of_points(points_xy).tolist()}")
    size = np.asarray(size_wh, np.float64)
    hull = convex_hull(np.clip(points_xy, 0.0, size))
    free = min_area_rectangle(hull)
    if corners_in_frame(free, size_wh, _SLACK_PX):
        return np.clip(free, 0.0, size)

    limits = np.unique(np.concatenate([[0.0], _edge_angles(hull), [QUARTER_TURN_RAD]]))
    low, high = limits[:-1], limits[1:]
    middle = (low + high) / 2
    along = hull @ np.stack([np.cos(middle), np.sin(middle)])
    across = hull @ np.stack([-np.sin(middle), np.cos(middle)])
    a0, a1 = hull[along.argmin(axis=0)], hull[along.argmax(axis=0)]
    b0, b1 = hull[across.argmin(axis=0)], hull[across.argmax(axis=0)]

    p, q, r = _room_of_corners(a0, a1, b0, b1, size)
    radius = np.hypot(q, r)
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = np.arccos(-p / radius)  # NaN where the corner never touches the side
    centre = np.arctan2(r, q)
    touching = np.stack([centre + spread, centre - spread])
    touching = np.mod(touching, 2 * math.pi) / 2  # 2t in [0, pi] is t in [0, pi/2]
    candidates = np.concatenate([low[None], high[None], touching.reshape(-1, len(low))])  # (10, intervals)
    belongs = (candidates >= low) & (candidates <= high)

    cos2 = np.cos(2 * candidates)
    sin2 = np.sin(2 * candidates)
    left = p[:, None] + q[:, None] * cos2 + r[:, None] * sin2  # (4, 10, intervals)
    belongs &= (left >= -_SLACK_PX).all(axis=0)
    c, s = np.cos(candidates), np.sin(candidates)
    width = (a1 - a0)[:, 0] * c + (a1 - a0)[:, 1] * s
    height = (b1 - b0)[:, 1] * c - (b1 - b0)[:, 0] * s
    area = np.where(belongs, width * height, np.inf)
    scale = float(np.ptp(hull, axis=0).max()) ** 2
    best = candidates[area <= area.min() * (1 + _TIE) + _TIE * scale].min()
    return np.clip(_rectangle_at(hull, float(best)), 0.0, size)


def _room_of_corners(a0: FloatArray, a1: FloatArray, b0: FloatArray, b1: FloatArray, size_wh: FloatArray) -> FloatArray:
    """Return the distances of a rectangle's corners to the frame's sides while it turns by t; negative is outside.

    The corner between the sides held by A (normal u) and B (normal v) is at (A.u) u + (B.v) v, which is
    x = (Ax + Bx)/2 + (Ax - Bx)/2 cos 2t + (Ay - By)/2 sin 2t and
    y = (Ay + By)/2 - (Ay - By)/2 cos 2t + (Ax - Bx)/2 sin 2t. For t in [0, pi/2] the leftmost corner is
    (a0, b1), the rightmost (a1, b0), the topmost (a0, b0) and the lowest (a1, b1).

    Args:
        a0: (intervals, 2) points that hold the first side.
        a1: Those of the side opposite to it.
        b0: Those of the second side.
        b1: Those of the side opposite to it.
        size_wh: (2,) size of the frame.

    Returns:
        (3, 4, intervals): terms p, q and r of p + q cos 2t + r sin 2t for each of the four corners.
    """

    def x_terms(a: FloatArray, b: FloatArray) -> FloatArray:
        return np.stack([a[:, 0] + b[:, 0], a[:, 0] - b[:, 0], a[:, 1] - b[:, 1]]) / 2

    def y_terms(a: FloatArray, b: FloatArray) -> FloatArray:
        return np.stack([a[:, 1] + b[:, 1], b[:, 1] - a[:, 1], a[:, 0] - b[:, 0]]) / 2

    w, h = size_wh
    shift_w, shift_h = np.array([[w], [0.0], [0.0]]), np.array([[h], [0.0], [0.0]])
    return np.stack([x_terms(a0, b1), y_terms(a0, b0), shift_w - x_terms(a1, b0), shift_h - y_terms(a1, b1)], axis=1)


def start_nearest(corners_xy: FloatArray, direction_xy: FloatArray) -> FloatArray:
    """Return the rectangle (4, 2) renumbered so that its first side is closest to a direction."""
    sides = np.roll(corners_xy, -1, axis=0) - corners_xy
    length = np.hypot(sides[:, 0], sides[:, 1])
    along = np.divide(sides @ np.asarray(direction_xy), length, out=np.zeros(4), where=length > 0)
    return np.roll(corners_xy, -int(np.argmax(along)), axis=0)
