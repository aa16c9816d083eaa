"""Labels of scenes that can be computed by hand."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from infrablend.annotation.labels import annotate
from infrablend.assets.shapes import box, ellipsoid
from infrablend.core import boxes
from infrablend.core.camera import CameraSpec, object_to_world
from infrablend.core.dataset import Instance
from infrablend.core.mesh import Mesh, make_mesh
from infrablend.core.raster import SampleGrid, covered_samples, project_triangles
from infrablend.core.render import RenderResult, place
from infrablend.core.scene import Appearance, ObjectSpec, PartState, SceneSpec
from infrablend.errors import ModelError

WH = (640, 512)
FOCAL_PX = 50 / 36 * 640


def camera(distance_m: float = 10.0, pitch_deg: float = 0.0, roll_deg: float = 0.0) -> CameraSpec:
    return CameraSpec(distance_m, math.radians(pitch_deg), math.radians(roll_deg), 50.0, 36.0, WH)


def brick(size_m: tuple[float, float, float], middle_m: tuple[float, float, float] = (0, 0, 0)) -> tuple:
    """Vertices and triangles of a box."""
    solid = box(size_m, 0.0)
    return solid.vertices + np.array(middle_m), solid.triangles


def brick_mesh(size_m: tuple[float, float, float], part: str = "body") -> Mesh:
    return make_mesh([(part, *brick(size_m), False)])


def thing(
    position_m: tuple[float, float, float] = (0, 0, 0),
    yaw_deg: float = 0.0,
    category: str = "drone",
    scale: float = 1.0,
    **labels: bool,
) -> ObjectSpec:
    parts = {name: PartState(300.0, 0.9, label) for name, label in ({"body": True} | labels).items()}
    return ObjectSpec("test", category, {}, parts, position_m, math.radians(yaw_deg), scale)


def scene(view: CameraSpec, *things: ObjectSpec) -> SceneSpec:
    return SceneSpec("test/a_c0", "a", "test", 0, view, things, 290.0, Appearance(), 0, 0)


def at_px(shift_px: tuple[float, float], view: CameraSpec) -> tuple[float, float, float]:
    """Position of a thing in the plane through the origin, seen by a level camera, shifted right and down."""
    m_per_px = view.distance_m / view.focal_px
    return (shift_px[0] * m_per_px, 0.0, -shift_px[1] * m_per_px)


def plate(width_px: float, height_px: float, view: CameraSpec) -> Mesh:
    """A square facing a level camera, in the plane through the origin."""
    m = view.distance_m / view.focal_px
    x, z = width_px * m / 2, height_px * m / 2
    vertices = np.array([[-x, 0, -z], [x, 0, -z], [x, 0, z], [-x, 0, z]])
    return make_mesh([("body", vertices, np.array([[0, 1, 2], [0, 2, 3]], np.int32), False)])


def rendered(coverage: np.ndarray, offset_xy: tuple[int, int]) -> RenderResult:
    alpha = np.clip(coverage.sum(axis=0), 0, 1).astype(np.float32)
    return RenderResult(offset_xy, WH, alpha.copy(), alpha, coverage.astype(np.float32))


def silhouette_box(view: CameraSpec, spec: ObjectSpec, mesh: Mesh) -> np.ndarray:
    """Box of the silhouette sampled 16 times per pixel, as the acceptance test measures it."""
    world = object_to_world(mesh.vertices_m, spec.position_m, spec.yaw_rad, spec.scale)
    grid = SampleGrid.over_pixels((280, 216), (80, 80), 16)
    samples = covered_samples(project_triangles(view, world, mesh.triangles).xy, grid)
    rows, columns = np.flatnonzero(samples.any(axis=1)), np.flatnonzero(samples.any(axis=0))
    return np.array([280, 216, 280, 216]) + np.array([columns[0], rows[0], columns[-1] + 1, rows[-1] + 1]) / 16


@pytest.mark.parametrize("size_px", [10.0, 20.0, 200.0])
def test_sphere_has_the_box_of_its_outline(size_px: float) -> None:
    radius = 0.25
    # The outline of a sphere at distance d is a circle of radius f r / sqrt(d^2 - r^2).
    distance = math.sqrt((2 * FOCAL_PX * radius / size_px) ** 2 + radius**2)
    ball = ellipsoid((radius,) * 3, 48, 48)
    (found,), report = annotate(
        place(scene(camera(distance, 35, 4), thing()), [make_mesh([("body", ball.vertices, ball.triangles, True)])])
    )
    expected = np.array([[320, 256, 320, 256]]) + size_px / 2 * np.array([[-1, -1, 1, 1]])
    assert boxes.box_iou(found.box_xyxy[None], expected)[0, 0] > 0.985
    assert found.mask is not None
    assert found.mask.area_px == pytest.approx(math.pi * size_px**2 / 4, rel=0.04)
    assert (found.visibility, found.truncated, found.inserted) == (1.0, False, True)
    assert report.kept == (0,)
    assert report.drops == ()


def test_cube_that_faces_the_camera_has_its_front_faces_box_to_the_last_digit() -> None:
    (found,), _ = annotate(place(scene(camera(10), thing()), [brick_mesh((1, 1, 1))]))
    half = FOCAL_PX * 0.5 / 9.5
    expected = [320 - half, 256 - half, 320 + half, 256 + half]
    assert_allclose(found.box_xyxy, expected, atol=1e-9)
    assert_allclose(found.corners_xy, boxes.corners_of_box(np.array(expected)), atol=1e-9)


@pytest.mark.parametrize("roll_deg", [-10.0, 3.0, 10.0])
def test_roll_turns_the_oriented_box_against_the_camera(roll_deg: float) -> None:
    view = camera(10, roll_deg=roll_deg)
    (found,), _ = annotate(place(scene(view, thing()), [plate(60, 20, view)]))
    assert found.corners_xy is not None
    cx, cy, w, h, angle = boxes.cxcywha_of_corners(found.corners_xy)
    if w < h:
        w, h, angle = h, w, angle + math.pi / 2
    assert_allclose([cx, cy, w, h], [320, 256, 60, 20], atol=1e-9)
    assert math.remainder(math.degrees(angle) + roll_deg, 180) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("size_px", [10.0, 20.0])
def test_boxes_agree_with_a_finely_sampled_silhouette(size_px: float) -> None:
    rng = np.random.default_rng(int(size_px))
    cross = make_mesh(
        [("body", *brick((1, 0.08, 0.06)), False), ("body", *brick((0.08, 0.8, 0.1), (0.1, 0, 0)), False)]
    )
    for _ in range(8):
        view = camera(1.1 * FOCAL_PX / size_px, float(rng.uniform(0, 90)), float(rng.uniform(-10, 10)))
        spec = thing((0.1, 0.2, 0.1), float(rng.uniform(0, 360)))
        (found,), _ = annotate(place(scene(view, spec), [cross]))
        assert boxes.box_iou(found.box_xyxy[None], silhouette_box(view, spec, cross)[None])[0, 0] > 0.97


@pytest.mark.parametrize(
    ("shift_px", "visible"),
    [
        ((-310, 0), 0.75),
        ((310, 0), 0.75),
        ((0, -256), 0.5),
        ((0, 256), 0.5),
        ((-320, -256), 0.25),
        ((325, 251), 0.375 * 0.625),
        ((-335, 256), 0.125 * 0.5),
    ],
)
@pytest.mark.parametrize("obb", ["min_area", "heading"])
def test_a_plate_cut_by_the_frame(shift_px: tuple[float, float], visible: float, obb: str) -> None:
    view = camera(10)
    spec = thing(at_px(shift_px, view))
    (found,), report = annotate(place(scene(view, spec), [plate(40, 40, view)]), obb=obb)  # type: ignore[arg-type]
    full = np.array([300, 236, 340, 276]) + np.array([*shift_px, *shift_px])
    assert_allclose(found.box_xyxy, boxes.clip_boxes(full, WH), atol=1e-9)
    assert found.truncated
    assert found.visibility == pytest.approx(visible, abs=0.01)
    assert found.corners_xy is not None
    assert boxes.corners_in_frame(found.corners_xy, WH)
    assert abs(boxes.polygon_area(found.corners_xy)) == pytest.approx(1600 * visible, rel=1e-6)
    assert report.obb_held_inside == ((0,) if obb == "heading" else ())


def test_oriented_box_of_a_whole_object_in_the_corner_stays_inside() -> None:
    # A hexagon touching the left edge with one corner; its least rectangle would leave the frame.
    view = camera(10)
    outline = np.array([[-30, 0], [-25, -7], [20, -40], [26, -30], [-22, 6]], float)
    m = view.distance_m / view.focal_px
    vertices = np.stack([outline[:, 0] * m, np.zeros(5), -outline[:, 1] * m], axis=1)
    mesh = make_mesh([("body", vertices, np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4]], np.int32), False)])
    (found,), report = annotate(place(scene(view, thing(at_px((-289.9, 0), view))), [mesh]))
    assert not found.truncated
    assert found.visibility == 1.0
    assert report.obb_held_inside == (0,)
    assert found.corners_xy is not None
    assert boxes.corners_in_frame(found.corners_xy, WH)
    width, height = boxes.cxcywha_of_corners(found.corners_xy)[2:4]
    assert width * height < np.prod(found.box_xyxy[2:] - found.box_xyxy[:2]) - 1


def test_outside_and_behind_are_dropped_by_name() -> None:
    view = camera(10)
    mesh = plate(40, 40, view)
    things = [thing(at_px((-345, 0), view)), thing(at_px((0, 400), view)), thing((0, -20, 0)), thing()]
    found, report = annotate(place(scene(view, *things), [mesh] * 4))
    assert len(found) == 1
    assert report.kept == (3,)
    assert [(d.index, d.reason) for d in report.drops] == [(k, "outside_frame") for k in range(3)]


def test_a_nearer_plate_takes_its_share() -> None:
    view = camera(10)
    mesh = plate(40, 40, view)
    # Half as far, the same mesh is 80 px; its right edge is put on the middle of the far one.
    shift = -40 * view.distance_m / view.focal_px / 2
    far, near = thing(category="deer"), thing((shift, -5.0, 0.0))
    (a, b), report = annotate(place(scene(view, far, near), [mesh, mesh]))
    assert a.category == "deer"
    assert a.visibility == pytest.approx(0.5, abs=0.01)
    assert (b.visibility, b.truncated) == (1.0, False)
    # Two hidden corners: depth samples, at most 1/8 px apart, find the edge.
    assert_allclose(a.box_xyxy, [320, 236, 340, 276], atol=0.13)
    assert_allclose(a.box_xyxy[[2]], 340, atol=1e-9)
    assert_allclose(b.box_xyxy, [240, 216, 320, 296], atol=1e-9)
    assert report.boxes_from_samples == (0,)
    assert a.mask is not None
    assert b.mask is not None
    assert a.mask.area_px == 20 * 40
    assert not (a.mask.to_array() & b.mask.to_array()).any()


def test_a_hole_in_the_middle_leaves_the_box_exact() -> None:
    view = camera(10)
    small = plate(10, 10, view)
    (a, _), report = annotate(place(scene(view, thing(), thing((0, -5, 0))), [plate(40, 40, view), small]))
    assert_allclose(a.box_xyxy, [300, 236, 340, 276], atol=1e-9)
    assert a.visibility == pytest.approx(1 - 400 / 1600, abs=0.01)
    assert report.boxes_from_samples == ()


def test_completely_hidden_object_gets_no_label() -> None:
    view = camera(10)
    found, report = annotate(place(scene(view, thing(), thing((0, -5, 0))), [plate(20, 20, view), plate(40, 40, view)]))
    assert len(found) == 1
    assert [(d.index, d.reason) for d in report.drops] == [(0, "hidden")]


def test_farther_objects_hide_nothing() -> None:
    view = camera(10)
    (a, _), _ = annotate(place(scene(view, thing(), thing((0, 5, 0))), [plate(40, 40, view), brick_mesh((3, 1, 3))]))
    assert a.visibility == 1.0


@pytest.mark.parametrize("first", [0, 1])
def test_neighbours_count_only_where_they_reach_into_the_box(first: int) -> None:
    """Plates beside, above and far from another one, nearer than it, change nothing; one over its corner does."""
    view = camera()
    plates = [plate(40, 40, view)] * 5

    def labelled(*shifts_px: tuple[float, float]) -> Instance:
        others = [thing((x, -0.5, z)) for x, _, z in (at_px(shift, view) for shift in shifts_px)]
        things = [*others[:first], thing(), *others[first:]]
        found, _ = annotate(place(scene(view, *things), plates[: len(things)]))
        return found[min(first, len(others))]

    alone, beside = labelled(), labelled((45, 0), (0, -45), (200, 100))
    assert_array_equal(beside.box_xyxy, alone.box_xyxy)
    assert_array_equal(beside.corners_xy, alone.corners_xy)
    assert (beside.mask, beside.visibility) == (alone.mask, 1.0)
    assert labelled((45, 0), (30, 30)).visibility < 0.97


def test_a_bar_through_the_near_plane_is_cut_not_mirrored() -> None:
    # From 8 m ahead to 2 m behind the camera, below it to the right: it leaves the frame downwards.
    view = camera(4)
    mesh = brick_mesh((0.2, 10.0, 0.2))
    (found,), _ = annotate(place(scene(view, thing((0.3, -1.0, -0.5))), [mesh]))
    near_edge = [320 + FOCAL_PX * 0.2 / 8, 256 + FOCAL_PX * 0.4 / 8]
    assert_allclose(found.box_xyxy[:2], near_edge, atol=1e-9)
    assert found.box_xyxy[3] == 512
    # Its upper right edge, 0.4 to the right and 0.4 below the axis, crosses the frame's lower side at 45 degrees.
    assert found.box_xyxy[2] == pytest.approx(320 + 256, abs=1e-6)
    assert found.truncated
    assert found.visibility is not None
    assert 0 < found.visibility < 0.2


def test_parts_without_label_count_nowhere_but_hide() -> None:
    body, disc = brick((0.4, 0.4, 0.1)), brick((2, 2, 0.01), (0, 0, 0.2))
    small = brick((0.2, 0.2, 0.01), (0, 0, 0.2))
    view = camera(10, 90)
    alone = make_mesh([("body", *body, False)])
    with_small = make_mesh([("body", *body, False), ("disc", *small, False)])
    with_disc = make_mesh([("body", *body, False), ("disc", *disc, False)])
    (a,), _ = annotate(place(scene(view, thing()), [alone]))
    (b,), _ = annotate(place(scene(view, thing(disc=False)), [with_small]))
    (c,), _ = annotate(place(scene(view, thing(disc=True)), [with_disc]))
    assert_array_equal(a.box_xyxy, b.box_xyxy)
    assert b.visibility == 1.0
    assert a.mask is not None
    assert b.mask is not None
    assert b.mask.area_px < a.mask.area_px
    assert c.box_xyxy[2] - c.box_xyxy[0] == pytest.approx(2 * FOCAL_PX / (10 - 0.205))
    found, report = annotate(place(scene(view, thing(disc=False)), [with_disc]))
    assert found == ()
    assert report.drops[0].reason == "hidden"
    nothing, report = annotate(place(scene(view, thing(body=False)), [alone]))
    assert nothing == ()
    assert report.drops[0].reason == "no_labelled_part"


def test_heading_seen_from_above() -> None:
    # From straight above, +X is right and +Y up: a heading of 30 degrees points up by 30, angle -30 on screen.
    view = camera(10, 90)
    (found,), report = annotate(place(scene(view, thing(yaw_deg=30)), [brick_mesh((1.0, 0.3, 0.001))]), obb="heading")
    assert found.corners_xy is not None
    _, _, w, h, angle = boxes.cxcywha_of_corners(found.corners_xy)
    assert math.degrees(angle) == pytest.approx(-30)
    assert (w, h) == pytest.approx((FOCAL_PX / 9.9995, 0.3 * FOCAL_PX / 9.9995))
    assert report.heading_end_on == ()


def test_heading_along_the_line_of_sight_falls_back() -> None:
    (found,), report = annotate(place(scene(camera(10), thing(yaw_deg=90)), [brick_mesh((1, 0.3, 0.2))]), obb="heading")
    assert report.heading_end_on == (0,)
    assert found.corners_xy is not None


def test_mask_is_coverage_of_at_least_a_half() -> None:
    view = camera(10)
    coverage = np.zeros((1, 4, 5), np.float32)
    coverage[0, 1, 1:4] = [0.49, 0.5, 1.0]
    (found,), report = annotate(place(scene(view, thing()), [plate(4, 2, view)]), rendered(coverage, (318, 255)))
    assert found.mask is not None
    rows, columns = np.nonzero(found.mask.to_array())
    assert (rows.tolist(), columns.tolist()) == ([256, 256], [320, 321])
    assert report.mask_fallbacks == ()


def test_an_empty_mask_becomes_the_pixel_of_largest_coverage() -> None:
    view = camera(10)
    coverage = np.zeros((1, 3, 3), np.float32)
    coverage[0, 1] = [0.1, 0.4, 0.3]
    (found,), report = annotate(place(scene(view, thing()), [plate(0.9, 0.5, view)]), rendered(coverage, (319, 255)))
    assert found.mask is not None
    assert np.argwhere(found.mask.to_array()).tolist() == [[256, 320]]
    assert report.mask_fallbacks == (0,)


def test_invisible_object_gets_no_label() -> None:
    view = camera(10)
    found, report = annotate(
        place(scene(view, thing()), [plate(4, 2, view)]), rendered(np.zeros((1, 3, 3)), (319, 255))
    )
    assert found == ()
    assert report.drops[0].reason == "no_visible_pixel"
    json.dumps(report.to_json())


def test_disagreeing_inputs_are_refused() -> None:
    view = camera(10)
    mesh = plate(4, 2, view)
    one = scene(view, thing())
    with pytest.raises(ValueError, match="1 objects need 1 meshes"):
        annotate(place(one, []))
    with pytest.raises(ValueError, match="need 1 coverages, got 2"):
        annotate(place(one, [mesh]), rendered(np.zeros((2, 3, 3)), (0, 0)))
    with pytest.raises(ValueError, match="leaves"):
        annotate(place(one, [mesh]), rendered(np.zeros((1, 3, 3)), (638, 0)))
    with pytest.raises(ModelError, match="the mesh has parts \\['wing'\\]"):
        annotate(place(one, [brick_mesh((1, 1, 1), "wing")]))


def test_no_objects_no_labels() -> None:
    found, report = annotate(place(scene(camera()), []), rendered(np.zeros((0, 1, 1)), (0, 0)))
    assert found == ()
    assert report.kept == ()


def test_masks_of_one_frame_share_no_pixel():
    """A pixel that two objects cover evenly belongs to the first of them, whichever is nearer."""
    view = camera()
    things = (thing(at_px((-5, 0), view)), thing(at_px((5, 0), view)))
    coverage = np.zeros((2, 20, 30), np.float32)
    coverage[0, 5:15, 5:15], coverage[1, 5:15, 15:25] = 1, 1
    coverage[:, 5:15, 14] = 0.5
    mesh = brick_mesh((0.1, 0.1, 0.1))
    labels, _ = annotate(place(scene(view, *things), [mesh, mesh]), rendered(coverage, (305, 246)))
    first, second = (i.mask.to_array() for i in labels)
    assert not (first & second).any()
    assert (int(first.sum()), int(second.sum())) == (100, 100)
    assert first[251:261, 319].all()


def test_a_mask_of_one_pixel_takes_one_that_is_left():
    view = camera()
    things = (thing(at_px((0, 0), view)), thing(at_px((1, 0), view)))
    mesh = brick_mesh((0.1, 0.1, 0.1))
    for shares, columns in (([[0.6, 0], [0.4, 0.3]], (1, 2)), ([[0.6, 0], [0.4, 0]], (1, 1))):
        coverage = np.zeros((2, 5, 5), np.float32)
        coverage[:, 2, 1:3] = shares
        labels, report = annotate(place(scene(view, *things), [mesh, mesh]), rendered(coverage, (318, 254)))
        found = [np.argwhere(i.mask.to_array())[0][1] - 318 for i in labels]
        assert tuple(found) == columns
        assert report.mask_fallbacks == (1,)
