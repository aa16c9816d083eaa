"""Properties of the rectangles around any points."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose
from tests.polygons import polygon_iou

from infrablend.core import boxes

W, H = 64, 48
FRAME = (W, H)

share = st.floats(0, 1, allow_subnormal=False)
clouds = (
    st.integers(1, 40)
    .flatmap(lambda n: arrays(np.float64, (n, 2), elements=share))
    .map(lambda a: a * np.array(FRAME, float))
)


@st.composite
def cut_shapes(draw: st.DrawFn) -> np.ndarray:
    """Convex polygons that the frame's edge cuts, as truncated objects give them."""
    centre = np.array([draw(st.sampled_from([0, W / 2, W])), draw(st.sampled_from([0, H / 2, H]))], float)
    shift = np.array([draw(st.floats(-9, 9)), draw(st.floats(-9, 9))])
    size, aspect = draw(st.floats(2, 40)), draw(st.floats(0.05, 1))
    turn = draw(st.floats(0, math.pi))
    count = draw(st.integers(3, 24))
    around = np.arange(count) * (2 * math.pi / count) + draw(st.floats(0, 1))
    oval = np.stack([np.cos(around), aspect * np.sin(around)], axis=1) * size / 2
    rotation = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    return boxes.clip_convex(
        boxes.convex_hull(centre + shift + oval @ rotation), boxes.corners_of_box(np.array([0.0, 0, *FRAME]))
    )


def contains(corners: np.ndarray, points: np.ndarray, slack: float = 1e-7) -> bool:
    middle = corners.mean(axis=0)
    sides = np.roll(corners, -1, axis=0) - corners
    for corner, side in zip(corners, sides, strict=True):
        length = np.hypot(*side)
        if length < 1e-9:
            continue
        normal = np.array([-side[1], side[0]]) / length
        if ((points - corner) @ normal).min() < -slack or ((middle - corner) @ normal) < -slack:
            return False
    return True


def area(corners: np.ndarray) -> float:
    return float(np.hypot(*(corners[1] - corners[0])) * np.hypot(*(corners[2] - corners[1])))


def brute_force(points: np.ndarray, steps: int, in_frame: bool) -> float:
    """Least area of the tight rectangles at `steps` angles, of those in the frame if asked."""
    angle = np.arange(steps) * (math.pi / 2 / steps)
    u, v = np.stack([np.cos(angle), np.sin(angle)]), np.stack([-np.sin(angle), np.cos(angle)])
    a, b = points @ u, points @ v
    a0, a1, b0, b1 = a.min(axis=0), a.max(axis=0), b.min(axis=0), b.max(axis=0)
    areas = (a1 - a0) * (b1 - b0)
    if in_frame:
        ok = np.ones(steps, bool)
        for p in (a0, a1):
            for q in (b0, b1):
                corner = p * u + q * v
                ok &= (corner >= -1e-12).all(axis=0) & (corner[0] <= W + 1e-12) & (corner[1] <= H + 1e-12)
        areas = np.where(ok, areas, np.inf)
    return float(areas.min())


@given(clouds)
def test_hull_holds_all_points_and_is_made_of_them(points: np.ndarray) -> None:
    hull = boxes.convex_hull(points)
    assert {tuple(p) for p in hull} <= {tuple(p) for p in points}
    assert boxes.polygon_area(hull) >= 0
    if boxes.polygon_area(hull) > 1e-6:
        assert boxes.inside_convex(boxes.convex_hull(hull), hull + 0).all()
        assert contains(hull, points, 1e-6)


@given(clouds)
def test_min_area_rectangle_contains_and_is_not_beaten(points: np.ndarray) -> None:
    corners = boxes.min_area_rectangle(points)
    if area(corners) > 1e-6:
        assert contains(corners, points)
    assert area(corners) <= brute_force(points, 2000, in_frame=False) * (1 + 1e-9) + 1e-9
    x0, y0, x1, y1 = boxes.box_of_points(points)
    assert area(corners) <= (x1 - x0) * (y1 - y0) * (1 + 1e-9) + 1e-9


@settings(max_examples=150)
@given(cut_shapes())
def test_rectangle_in_the_frame_contains_stays_and_is_not_beaten(points: np.ndarray) -> None:
    if len(points) < 3 or boxes.polygon_area(points) < 1e-6:
        return
    corners = boxes.smallest_rectangle_inside(points, FRAME)
    assert corners.min() >= 0
    assert corners[:, 0].max() <= W
    assert corners[:, 1].max() <= H
    assert contains(corners, points)
    assert area(corners) <= brute_force(points, 20_000, in_frame=True) * (1 + 1e-9)
    assert area(corners) >= area(boxes.min_area_rectangle(points)) * (1 - 1e-9)
    right_angle = (corners[1] - corners[0]) @ (corners[2] - corners[1])
    assert abs(right_angle) < 1e-6


@given(clouds)
def test_any_points_in_the_frame_have_a_rectangle_in_it(points: np.ndarray) -> None:
    corners = boxes.smallest_rectangle_inside(points, FRAME)
    assert boxes.corners_in_frame(corners, FRAME)
    assert area(corners) <= brute_force(points, 2000, in_frame=True) * (1 + 1e-9) + 1e-9


@given(cut_shapes(), st.sampled_from(["mirror_x", "mirror_y", "turn"]))
def test_area_in_the_frame_survives_mirroring(points: np.ndarray, how: str) -> None:
    if len(points) < 3 or boxes.polygon_area(points) < 1e-6:
        return
    expected = area(boxes.smallest_rectangle_inside(points, FRAME))
    if how == "mirror_x":
        other, size = np.array([W, 0]) + points * [-1, 1], FRAME
    elif how == "mirror_y":
        other, size = np.array([0, H]) + points * [1, -1], FRAME
    else:
        other, size = points[:, ::-1].copy(), (H, W)
    assert math.isclose(area(boxes.smallest_rectangle_inside(other, size)), expected, rel_tol=1e-7)


@given(clouds, st.floats(0, 2 * math.pi), st.floats(-500, 500), st.floats(0.1, 10))
def test_min_area_turns_moves_and_grows_with_its_points(
    points: np.ndarray, turn: float, shift: float, scale: float
) -> None:
    rotation = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    moved = scale * points @ rotation + shift
    expected = scale**2 * area(boxes.min_area_rectangle(points))
    assert math.isclose(area(boxes.min_area_rectangle(moved)), expected, rel_tol=1e-6, abs_tol=1e-5)


@given(
    st.floats(-100, 700),
    st.floats(-100, 700),
    st.floats(0.01, 300),
    st.floats(0.01, 300),
    st.floats(-10, 10),
)
def test_cxcywha_and_corners_and_le90_are_one_box(cx: float, cy: float, w: float, h: float, angle: float) -> None:
    box = np.array([cx, cy, w, h, angle])
    corners = boxes.corners_of_cxcywha(box)
    back = boxes.cxcywha_of_corners(corners)
    assert_allclose(back[:4], box[:4], atol=1e-9)
    assert abs(math.remainder(back[4] - angle, 2 * math.pi)) < 1e-9
    assert_allclose(boxes.corners_of_cxcywha(back), corners, atol=1e-9)


@given(clouds, clouds)
def test_polygon_iou_is_symmetric_and_bounded(a: np.ndarray, b: np.ndarray) -> None:
    p, q = boxes.convex_hull(a), boxes.convex_hull(b)
    if boxes.polygon_area(p) < 1e-3 or boxes.polygon_area(q) < 1e-3:
        return
    iou = polygon_iou(p, q)
    assert -1e-9 <= iou <= 1 + 1e-9
    assert math.isclose(iou, polygon_iou(q, p), abs_tol=1e-6)


@given(clouds, st.floats(0, 2 * math.pi))
def test_rectangle_along_a_direction_contains(points: np.ndarray, turn: float) -> None:
    corners = boxes.rectangle_along(points, np.array([math.cos(turn), math.sin(turn)]))
    if area(corners) > 1e-6:
        assert contains(corners, points)
