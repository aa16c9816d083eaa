"""Sampled silhouettes and depth, compared with exact areas."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from infrablend.assets.shapes import box
from infrablend.core import raster
from infrablend.core.boxes import (
    clip_convex,
    convex_hull,
    corners_of_box,
    corners_of_cxcywha,
    polygon_area,
)
from infrablend.core.camera import CameraSpec


def fan(polygon: np.ndarray) -> np.ndarray:
    """Triangles (T, 3, 2) of a convex polygon."""
    return np.stack([np.stack([polygon[0], polygon[i], polygon[i + 1]]) for i in range(1, len(polygon) - 1)])


def camera(distance_m: float = 10.0, pitch_deg: float = 0.0, roll_deg: float = 0.0) -> CameraSpec:
    return CameraSpec(distance_m, math.radians(pitch_deg), math.radians(roll_deg), 50.0, 36.0, (640, 512))


def cube(size_m: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    solid = box((size_m,) * 3, 0.0)
    return solid.vertices, solid.triangles


def exact_coverage(polygon: np.ndarray, w: int, h: int) -> np.ndarray:
    cells = [
        [polygon_area(clip_convex(polygon, corners_of_box(np.array([x, y, x + 1, y + 1], float)))) for x in range(w)]
        for y in range(h)
    ]
    return np.array(cells)


def test_a_rectangle_on_pixel_edges_is_covered_exactly() -> None:
    coverage = raster.silhouette(fan(corners_of_box(np.array([2.0, 1, 5, 3]))), (0, 0), (7, 5))
    expected = np.zeros((5, 7), np.float32)
    expected[1:3, 2:5] = 1
    assert_array_equal(coverage, expected)


@pytest.mark.parametrize("size", [10.0, 20.0])
def test_coverage_of_a_tilted_rectangle_has_no_bias(size: float) -> None:
    rng = np.random.default_rng(7)
    error, area_error = [], []
    for _ in range(12):
        box = np.array([15 + rng.uniform(), 14 + rng.uniform(), size, size / 2, rng.uniform(0, 3)])
        polygon = corners_of_cxcywha(box)
        coverage = raster.silhouette(fan(polygon), (0, 0), (30, 28))
        error.append(coverage - exact_coverage(polygon, 30, 28))
        area_error.append(coverage.sum() / (size * size / 2) - 1)
    # One sample of 64 per pixel that an edge crosses is the worst, and the mean error cancels.
    assert np.abs(error).max() < 0.09
    assert abs(np.mean(area_error)) < 0.002


def test_crop_and_whole_frame_agree() -> None:
    triangles = fan(corners_of_cxcywha(np.array([30.3, 20.8, 17, 9, 0.4])))
    whole = raster.silhouette(triangles, (0, 0), (64, 48))
    assert_array_equal(raster.silhouette(triangles, (25, 15), (10, 8)), whole[15:23, 25:35])


def test_triangles_sharing_edges_leave_no_gap_and_overlap_nowhere() -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(3, 29, (40, 2)).round(1)  # rounded: many samples lie exactly on edges
    center = np.array([16.0, 16.0])
    angle = np.arctan2(*(points - center).T)
    star = points[np.argsort(angle)]
    pieces = np.stack([np.broadcast_to(center, star.shape), star, np.roll(star, -1, axis=0)], axis=1)
    grid = raster.SampleGrid.over_pixels((0, 0), (32, 32), 10)
    counts = sum(raster.covered_samples(piece[None], grid).astype(int) for piece in pieces)
    assert counts.max() == 1
    assert_array_equal(counts > 0, raster.covered_samples(pieces, grid))
    square = fan(corners_of_box(np.array([0.0, 0, 32, 32])))
    assert raster.covered_samples(square, grid).all()


def test_order_of_corners_and_empty_triangles_do_not_matter() -> None:
    triangle = np.array([[[2.2, 3.1], [20.7, 5.5], [9.0, 18.3]]])
    grid = raster.SampleGrid.over_pixels((0, 0), (24, 24), 4)
    expected = raster.covered_samples(triangle, grid)
    assert expected.sum() / 16 == pytest.approx(abs(polygon_area(triangle[0])), rel=0.01)
    for order in ([1, 2, 0], [2, 1, 0], [0, 2, 1]):
        assert_array_equal(raster.covered_samples(triangle[:, order], grid), expected)
    flat = np.array([[[1.0, 1], [5, 5], [9, 9]], [[3, 3], [3, 3], [3, 3]], [[1, 4], [9, 4], [5, 4]]])
    assert not raster.covered_samples(flat, grid).any()
    assert not raster.covered_samples(np.zeros((0, 3, 2)), grid).any()


def test_projected_cube_has_the_cameras_pixels_and_depths() -> None:
    vertices, triangles = cube()
    projected = raster.project_triangles(camera(10), vertices, triangles)
    xy, depth = camera(10).project(vertices)
    assert_allclose(projected.xy, xy[triangles])
    assert_allclose(1 / projected.inverse_depth, depth[triangles])
    assert not projected.cut


def test_geometry_at_the_near_plane_is_cut_there() -> None:
    vertices, triangles = cube(4.0)
    projected = raster.project_triangles(camera(1.0), vertices, triangles)
    assert projected.cut
    assert np.isfinite(projected.xy).all()
    assert (1 / projected.inverse_depth).min() == pytest.approx(0.05)


def test_nearer_square_hides_the_farther_one() -> None:
    near, far = corners_of_box(np.array([4.0, 4, 12, 12])), corners_of_box(np.array([8.0, 8, 20, 20]))
    xy = np.concatenate([fan(far), fan(near)])
    inverse = np.repeat([0.1, 0.5], 2)[:, None] * np.ones(3)
    seen = raster.visible(xy, inverse, np.repeat([0, 1], 2), 2, (0, 0), (24, 24), 4)
    assert seen.shape == (2, 24, 24)
    assert seen[1].sum() == 64
    assert seen[0].sum() == 144 - 16
    assert (seen.sum(axis=0) <= 1).all()
    # Owners outside the list hide but are not returned.
    only = raster.visible(xy, inverse, np.repeat([0, -1], 2), 1, (0, 0), (24, 24), 4)
    assert_array_equal(only[0], seen[0])
    assert raster.visible(xy, inverse, np.repeat([-1, -1], 2), 0, (0, 0), (24, 24)).shape == (0, 24, 24)


def test_depth_between_the_corners_is_perspective_correct() -> None:
    # A ground plane: at depth 2 and 8 its corners, in the image's middle (harmonic mean) 3.2.
    corners = np.array([[[0.0, 0], [16, 0], [0, 16]], [[16, 0], [16, 16], [0, 16]]])
    inverse = 1 / np.array([[8.0, 8, 2], [8, 2, 2]])
    grid = raster.SampleGrid.over_pixels((0, 0), (16, 16), 1)
    depth = 1 / raster.nearest_inverse_depth(corners, inverse, grid)
    rows = np.arange(16) + 0.5
    assert_allclose(depth, np.tile((1 / (1 / 8 + rows / 16 * (1 / 2 - 1 / 8)))[:, None], (1, 16)), rtol=1e-12)
    assert (depth[7].mean() + depth[8].mean()) / 2 == pytest.approx(3.2, rel=0.01)


def test_two_planes_that_pierce_each_other_share_at_the_line_of_equal_depth() -> None:
    square = fan(corners_of_box(np.array([0.0, 0, 16, 16])))
    rising = 0.1 + square[:, :, 0] / 16
    level = np.full((2, 3), 0.1 + 5 / 16)
    seen = raster.visible(
        np.concatenate([square, square]), np.concatenate([rising, level]), np.array([0, 0, 1, 1]), 2, (0, 0), (16, 16)
    )
    assert_array_equal(seen[0], np.tile((np.arange(16) >= 5).astype(np.float32), (16, 1)))


def test_hull_of_outline_points_is_that_of_all_samples() -> None:
    grid = raster.SampleGrid.over_pixels((3, 2), (10, 8), 4)
    samples = np.zeros(grid.shape_hw, bool)
    samples[5:9, 7:12] = True
    samples[20, 3] = True
    points = raster.outline_points(samples, grid)
    assert_allclose(points.min(axis=0), [3 + 3.5 / 4, 2 + 5.5 / 4])
    assert_allclose(points.max(axis=0), [3 + 11.5 / 4, 2 + 20.5 / 4])
    assert raster.outline_points(np.zeros(grid.shape_hw, bool), grid).shape == (0, 2)


def test_only_points_behind_a_triangle_are_hidden() -> None:
    occluder = raster.ProjectedTriangles(
        np.array([[[0.0, 0], [10, 0], [0, 10]]]), np.array([[0.5, 0.5, 0.1]]), np.zeros(1, np.intp), False
    )
    points = np.array([[2.0, 2], [2, 2], [9, 9], [1, 8], [5, 0]])
    inverse = np.array([0.1, 0.45, 0.1, 0.2, 0.5])
    # At (2, 2) the triangle is at 0.42, at (1, 8) at 0.18; (5, 0) is on it and therefore not hidden.
    assert_array_equal(raster.hidden_points(points, inverse, occluder), [True, False, False, False, False])


@pytest.mark.parametrize(
    ("shift_px", "expected"), [(0.0, 1.0), (-320.0, 0.5), (320.0, 0.5), (-370.0, 0.0), (-300.0, 0.7), (330.0, 0.4)]
)
def test_share_of_a_square_inside_the_frame(shift_px: float, expected: float) -> None:
    # A square of 100 px at 10 m, facing the camera.
    view = camera(10)
    m_per_px = 10 / view.focal_px
    vertices = np.array([[x * m_per_px, 0, z * m_per_px] for x in (-50, 50) for z in (-50, 50)])
    vertices[:, 0] += shift_px * m_per_px
    share, depth = raster.inside_fraction(view, vertices, np.array([[0, 1, 2], [1, 3, 2]], np.int32))
    assert share == pytest.approx(expected, abs=0.005)
    if expected in (0.0, 1.0):
        assert share == expected
    assert depth == pytest.approx(10)


def test_share_of_a_cube_at_the_frames_corner_is_that_of_its_outline() -> None:
    view = camera(5, 40, 7)
    vertices, triangles = cube(0.6)
    vertices = vertices @ view.world_to_camera + view.position_m + view.world_to_camera.T @ [1.7, 1.4, 5.0]
    outline = convex_hull(view.project(vertices)[0])
    exact = polygon_area(clip_convex(outline, corners_of_box(np.array([0.0, 0, *view.size_wh])))) / polygon_area(
        outline
    )
    assert 0.1 < exact < 0.9
    assert raster.inside_fraction(view, vertices, triangles)[0] == pytest.approx(exact, abs=0.004)


def test_points_behind_the_camera_are_not_inside() -> None:
    vertices, triangles = cube()
    share, depth = raster.inside_fraction(camera(-5.0), vertices, triangles)
    assert share == 0
    assert depth < -4
    # Around the camera: the frame sees a part of what lies ahead.
    share, depth = raster.inside_fraction(camera(0.4), vertices, triangles)
    assert 0 < share < 1
    assert depth == pytest.approx(-0.1)


def test_triangle_without_samples_is_tested_at_its_centre() -> None:
    vertices = np.array([[-30.0, 0, 0], [0.5, 0, 0], [0.5, 0, 1e-7]])
    assert raster.inside_fraction(camera(10), vertices, np.array([[0, 1, 2]], np.int32))[0] == 0.0
