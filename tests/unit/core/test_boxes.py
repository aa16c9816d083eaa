"""Boxes and rectangles of shapes with known results."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from infrablend.core import boxes
from tests.polygons import polygon_iou


def tilted(cx: float, cy: float, w: float, h: float, angle_deg: float) -> np.ndarray:
    return boxes.corners_of_cxcywha(np.array([cx, cy, w, h, math.radians(angle_deg)]))


def test_box_of_points_is_their_extent() -> None:
    assert_array_equal(boxes.box_of_points(np.array([[1.5, 4], [3, 2.25], [2, 3]])), [1.5, 2.25, 3, 4])


def test_clip_boxes_moves_sides_to_the_frame() -> None:
    assert_array_equal(boxes.clip_boxes(np.array([[-3.0, 2, 700, 600]]), (640, 512)), [[0, 2, 640, 512]])
    assert_array_equal(boxes.clip_boxes(np.array([-9.0, 2, -3, 7]), (640, 512)), [0, 2, 0, 7])


def test_box_iou_of_known_pairs() -> None:
    a = np.array([[0.0, 0, 2, 2], [0, 0, 0, 0]])
    b = np.array([[1.0, 1, 3, 3], [0, 0, 2, 2], [5, 5, 6, 6]])
    assert_allclose(boxes.box_iou(a, b), [[1 / 7, 1, 0], [0, 0, 0]])


def test_polygon_area_is_positive_clockwise_on_screen() -> None:
    square = boxes.corners_of_box(np.array([100.0, 100, 103, 102]))
    assert boxes.polygon_area(square) == 6
    assert boxes.polygon_area(square[::-1]) == -6
    assert boxes.polygon_area(square[:2]) == 0


def test_hull_leaves_out_inner_and_collinear_points() -> None:
    points = np.array([[0, 0], [4, 0], [2, 0], [4, 3], [0, 3], [1, 1], [0, 1.5], [0, 0]], float)
    assert_array_equal(boxes.convex_hull(points), [[0, 0], [4, 0], [4, 3], [0, 3]])
    assert boxes.polygon_area(boxes.convex_hull(points)) == 12


@pytest.mark.parametrize(("points", "corners"), [([[2, 3]] * 4, 1), ([[0, 0], [1, 1], [3, 3]], 2)])
def test_hull_of_a_point_and_of_a_line(points: list[list[float]], corners: int) -> None:
    assert len(boxes.convex_hull(np.array(points, float))) == corners


def test_hull_of_many_points_keeps_every_extreme_one() -> None:
    rng = np.random.default_rng(3)
    circle = np.linspace(0, 2 * np.pi, 300, endpoint=False)
    rim = 100 + 50 * np.stack([np.cos(circle), np.sin(circle)], axis=1)
    inner = 100 + 20 * rng.uniform(-1, 1, (5000, 2))
    hull = boxes.convex_hull(np.concatenate([inner, rim]))
    assert {tuple(p) for p in hull} == {tuple(p) for p in rim}


def test_iou_of_a_square_and_itself_turned_by_45_degrees() -> None:
    # The overlap is a regular octagon of inradius 1: area 8 tan(22.5 deg).
    octagon = 8 * math.tan(math.pi / 8)
    a, b = tilted(10, 10, 2, 2, 0), tilted(10, 10, 2, 2, 45)
    assert polygon_iou(a, b) == pytest.approx(octagon / (8 - octagon), abs=1e-12)
    assert polygon_iou(a, a) == pytest.approx(1)
    assert polygon_iou(a, a + 5) == 0


def test_clipping_a_triangle_to_the_frame() -> None:
    triangle = np.array([[-10.0, 5], [10, -5], [10, 15]])
    clipped = boxes.clip_convex(triangle, boxes.corners_of_box(np.array([0.0, 0, 8, 9])))
    # On x = 0 it spans y 0..10, and the frame lies within from there on: all 8 x 9 are covered.
    assert boxes.polygon_area(clipped) == pytest.approx(72)


def test_near_plane_cuts_off_the_tip_or_the_base() -> None:
    tip_ahead = np.array([[0.0, 0, 2], [1, 0, 0], [0, 1, 0]])
    base_ahead = np.array([[0.0, 0, 0], [2, 0, 2], [0, 2, 2]])
    behind, ahead = np.array([[0.0, 0, -1], [1, 0, -1], [0, 1, -1]]), base_ahead + np.array([0, 0, 5])
    pieces, source = boxes.clip_triangles_near(np.stack([tip_ahead, base_ahead, behind, ahead]), 1.0)
    assert sorted(source.tolist()) == [0, 1, 1, 3]
    assert (pieces[:, :, 2] >= 1.0).all()
    area = 0.5 * np.abs(
        (pieces[:, 1, 0] - pieces[:, 0, 0]) * (pieces[:, 2, 1] - pieces[:, 0, 1])
        - (pieces[:, 1, 1] - pieces[:, 0, 1]) * (pieces[:, 2, 0] - pieces[:, 0, 0])
    )
    # Seen along z the tip keeps a quarter of 1/2, the base three quarters of 2.
    assert area[source == 0].sum() == pytest.approx(0.125)
    assert area[source == 1].sum() == pytest.approx(1.5)
    assert_array_equal(pieces[source == 3][0], ahead)


def test_triangle_around_the_whole_frame_leaves_the_frames_corners() -> None:
    triangle = np.array([[[-1000.0, -1000, 1], [3000, -1000, 2], [-1000, 3000, 3]]])
    points = boxes.clip_triangles_to_rect(triangle, np.array([0.0, 0, 640, 512]))
    assert {tuple(p) for p in points[:, :2]} == {(0, 0), (640, 0), (640, 512), (0, 512)}
    assert_allclose(points[:, 2], 1 + (points[:, 0] + 1000) / 4000 + (points[:, 1] + 1000) / 2000)


def test_clipped_triangles_have_the_hull_of_each_ones_clip() -> None:
    rng = np.random.default_rng(5)
    rect = np.array([10.0, 20, 50, 45])
    for _ in range(200):
        triangle = boxes.convex_hull(rng.uniform(-20, 90, (3, 2)))
        expected = boxes.clip_convex(triangle, boxes.corners_of_box(rect))
        points = boxes.clip_triangles_to_rect(triangle[None], rect)
        found = boxes.convex_hull(points) if len(points) else points
        assert boxes.polygon_area(found) == pytest.approx(boxes.polygon_area(expected), abs=1e-9)


def test_corners_run_clockwise_from_the_top_left() -> None:
    assert_allclose(tilted(5, 4, 6, 2, 0), [[2, 3], [8, 3], [8, 5], [2, 5]])
    # A quarter turn clockwise takes the top left corner to the top right.
    assert_allclose(tilted(5, 4, 6, 2, 90)[0], [6, 1], atol=1e-12)
    assert boxes.polygon_area(tilted(5, 4, 6, 2, 33)) == pytest.approx(12)


@pytest.mark.parametrize("angle_deg", [0, 10, 44.9, 45, 80, 89.999])
@pytest.mark.parametrize("size", [10.0, 20.0, 300.0])
def test_min_area_rectangle_recovers_a_tilted_one(angle_deg: float, size: float) -> None:
    truth = tilted(301.3, 217.7, size, 0.4 * size, angle_deg)
    rng = np.random.default_rng(1)
    weights = rng.dirichlet(np.ones(4), 500)
    found = boxes.min_area_rectangle(np.concatenate([weights @ truth, truth]))
    assert_allclose(found, truth, atol=1e-9)


def test_of_equally_small_rectangles_the_least_turned_is_taken() -> None:
    circle = np.arange(8) * (math.pi / 4) + 0.1
    octagon = 50 + 10 * np.stack([np.cos(circle), np.sin(circle)], axis=1)
    first = boxes.cxcywha_of_corners(boxes.min_area_rectangle(octagon))[4]
    assert first == pytest.approx(0.1 + math.pi / 8)
    moved = boxes.cxcywha_of_corners(boxes.min_area_rectangle(octagon[::-1] + 17.3))[4]
    assert moved == pytest.approx(first)


def test_rectangle_along_a_heading_starts_there() -> None:
    points = np.array([[0.0, 0], [4, 4], [3, 1]])
    corners = boxes.rectangle_along(points, np.array([-2.0, -2]))
    assert boxes.cxcywha_of_corners(corners)[4] == pytest.approx(-3 * math.pi / 4)
    assert boxes.cxcywha_of_corners(corners)[2] == pytest.approx(math.sqrt(32))
    with pytest.raises(ValueError, match="needs a length"):
        boxes.rectangle_along(points, np.zeros(2))


def test_inside_the_frame_the_smallest_rectangle_is_the_smallest() -> None:
    points = tilted(300, 200, 40, 10, 30)
    assert_array_equal(boxes.smallest_rectangle_inside(points, (640, 512)), boxes.min_area_rectangle(points))


def test_rectangle_at_the_frames_edge_turns_until_its_corner_touches() -> None:
    # A pointed bar at 45 degrees that just fits: a corner of its free rectangle sticks out on the left.
    along, across = np.array([1, 1]) / math.sqrt(2), np.array([-1, 1]) / math.sqrt(2)
    outline = np.array([[0, 0], [6, -5], [60, -5], [60, 5], [6, 5]], float)
    points = np.array([0.5, 100]) + outline[:, :1] * along + outline[:, 1:] * across
    free = boxes.min_area_rectangle(points)
    assert free.min() < -1
    held = boxes.smallest_rectangle_inside(points, (640, 512))
    assert held.min() == pytest.approx(0, abs=1e-8)
    assert held.min() >= 0
    width, height, angle = boxes.cxcywha_of_corners(held)[2:]
    box = boxes.box_of_points(points)
    assert boxes.polygon_area(free) < width * height < (box[2] - box[0]) * (box[3] - box[1])
    assert 0.01 < angle < math.pi / 2 - 0.01


def test_a_body_cut_by_the_frame_has_only_the_upright_rectangle() -> None:
    bar = boxes.clip_convex(tilted(5, 200, 60, 10, 30), boxes.corners_of_box(np.array([0.0, 0, 640, 512])))
    held = boxes.smallest_rectangle_inside(bar, (640, 512))
    assert_allclose(held, boxes.corners_of_box(boxes.box_of_points(bar)), atol=1e-9)


def test_points_outside_the_frame_are_refused() -> None:
    with pytest.raises(ValueError, match="must lie in the frame"):
        boxes.smallest_rectangle_inside(np.array([[0.0, 0], [641, 3]]), (640, 512))


def test_a_single_point_is_a_rectangle_without_area() -> None:
    assert_array_equal(boxes.min_area_rectangle(np.array([[3.0, 4]])), [[3, 4]] * 4)
    assert_array_equal(boxes.smallest_rectangle_inside(np.array([[0.0, 4]]), (9, 9)), [[0, 4]] * 4)


def test_counting_corners_from_a_heading() -> None:
    corners = boxes.corners_of_box(np.array([0.0, 0, 6, 2]))
    assert_array_equal(boxes.start_nearest(corners, np.array([-1.0, 0.1]))[0], [6, 2])
    assert_array_equal(boxes.start_nearest(corners, np.array([0.2, 1.0]))[0], [6, 0])
