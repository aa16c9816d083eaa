"""Metric placement: the ground plane, the camera's height from annotated objects, places for objects."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from infrablend.assets.catalogue import load_model
from infrablend.config.loading import load_recipe
from infrablend.config.recipe import FlightHeight, StatedHeights
from infrablend.core.camera import CameraSpec, object_to_world
from infrablend.core.capture import Capture
from infrablend.core.dataset import Instance, boxes_of
from infrablend.core.ground_plane import at_height, ground_point, ground_z_m, pixel_ray
from infrablend.core.reference_sizes import REFERENCES
from infrablend.sampling.calibration import FACTOR_BOUNDS, FROM_TABLE, NOMINAL_FACTOR, calibrate, prior_of
from infrablend.sampling.metric import is_even, relief_of
from infrablend.sampling.placement import PlacementRequest, box_px, collides, volume_of
from infrablend.sampling.scene_sampler import RecipeSampler, rebuild_scene
from infrablend.sampling.site import FrameKey, Site
from tests.recipes import ANYWHERE, load_anywhere

WH = (640, 512)


def hit_uav_camera(pitch_deg, height_m, roll_deg=0.0):
    camera = CameraSpec(1.0, math.radians(pitch_deg), math.radians(roll_deg), 115.875, 36.0, WH)
    return at_height(camera, height_m)


def test_the_reference_case_of_the_geometry():
    """f 2060 px, height 100 m, pitch 50 degrees, centre pixel: 130.54 m away, 15.78 px per metre."""
    camera = hit_uav_camera(50, 100)
    assert camera.focal_px == pytest.approx(2060)
    assert camera.distance_m == pytest.approx(130.54, abs=0.005)
    assert camera.focal_px / camera.distance_m == pytest.approx(15.78, abs=0.005)
    assert ground_point(camera, 320, 256, ground_z_m(camera, 100)) == pytest.approx([0, 0, 0], abs=1e-9)
    # The horizon at 30 degrees lies at row 256 - 2060 tan 30 = -933.
    low = hit_uav_camera(30, 100)
    assert pixel_ray(low, 320, -934)[2] > 0 > pixel_ray(low, 320, -932)[2]


@pytest.mark.parametrize("pitch", [3, 10, 30, 60, 90])
@pytest.mark.parametrize("roll", [0, 7])
def test_pixel_to_ground_and_back(pitch, roll):
    camera = hit_uav_camera(pitch, 80, roll)
    z = ground_z_m(camera, 80)
    assert camera.position_m[2] - z == pytest.approx(80)
    for u, v in ((3.25, 500.5), (320, 256), (639, 300), (100, 400)):
        point = ground_point(camera, u, v, z)
        if pitch >= 10 or v > 400:
            assert point is not None
            assert point[2] == pytest.approx(z, abs=1e-9)
            assert camera.project(point[None])[0][0] == pytest.approx([u, v], abs=1e-6)


def test_a_camera_that_looks_up_has_ground_nowhere_in_the_frame():
    camera = hit_uav_camera(-10, 50)
    z = ground_z_m(camera, 50)
    assert camera.position_m[2] - z == pytest.approx(50)
    assert all(ground_point(camera, u, v, z) is None for u in (0, 320, 640) for v in (0, 256, 512))


def annotated(camera, height_m, name, count, rng):
    """Boxes of cuboids of the reference size on the ground, as an annotator would draw them."""
    length, width, tall = REFERENCES[name.casefold()].size_m
    corner = np.array([(i, j, k) for i in (-0.5, 0.5) for j in (-0.5, 0.5) for k in (0, 1)]) * (length, width, tall)
    labels = []
    while len(labels) < count:
        u, v = rng.uniform(60, 580), rng.uniform(60, 450)
        place = ground_point(camera, u, v, ground_z_m(camera, height_m))
        xy, _ = camera.project(object_to_world(corner, place, rng.uniform(0, 6.28)))
        box = np.concatenate([xy.min(axis=0), xy.max(axis=0)])
        if min(box[2] - box[0], box[3] - box[1]) > 7:
            labels.append(Instance(name, box))
    return labels


@pytest.mark.parametrize("pitch", [30, 60, 90])
@pytest.mark.parametrize("name", ["Car", "Person", "Bicycle"])
@pytest.mark.parametrize("factor", [1.0, 1.3])
def test_the_height_is_found_from_objects_of_known_size(pitch, name, factor):
    stated = 80.0
    labels = annotated(hit_uav_camera(pitch, factor * stated), factor * stated, name, 6, np.random.default_rng(1))
    found = calibrate(hit_uav_camera(pitch, stated), stated, labels)
    assert found.factor == pytest.approx(factor, rel=0.04 if name == "Car" else 0.09)
    assert found.anchors == {name.casefold(): 6}
    assert found.height_m == pytest.approx(found.factor * stated)


def flown(altitude_m, pitch_deg, time_of_day):
    return Capture(pitch_deg=pitch_deg, altitude_m=altitude_m, time_of_day=time_of_day)


def test_without_anchors_the_nominal_factor_holds_and_outliers_are_bounded():
    camera = hit_uav_camera(60, 100)
    assert calibrate(camera, 100, []).factor == pytest.approx(NOMINAL_FACTOR)
    huge = [Instance("Car", np.array([100.0, 100, 400, 400])) for _ in range(6)]
    tiny = [Instance("Car", np.array([100.0, 100, 107, 107])) for _ in range(6)]
    assert calibrate(camera, 100, huge).factor == FACTOR_BOUNDS[0]
    assert calibrate(camera, 100, tiny).factor == FACTOR_BOUNDS[1]
    # Cut by the frame, so its size is unusable.
    assert not calibrate(camera, 100, [Instance("Car", np.array([0.0, 100, 60, 140]))]).anchors


def test_heights_are_corrected_as_the_recipe_states_for_its_dataset():
    low = FlightHeight(factor=1.8, time_of_day="night", below_m=75, below_pitch_deg=70)
    heights = StatedHeights(factor=1.3, by_flight=(low, FlightHeight(factor=1.5, time_of_day="day")), box_looseness=1.2)
    flights = ((60, 60, "night"), (80, 60, "night"), (60, 80, "night"), (60, 90, "day"), (None, None, None))
    assert [prior_of(heights, flown(*flight)).factor for flight in flights] == [1.8, 1.3, 1.3, 1.5, 1.3]
    prior = prior_of(heights, flown(60, 60, "night"))
    assert calibrate(hit_uav_camera(60, 60), 60, [], prior).factor == pytest.approx(1.8)
    assert prior_of(StatedHeights(), flown(60, 60, "night")) == FROM_TABLE
    sure = StatedHeights(by_flight=(FlightHeight(factor=1.4, below_pitch_deg=35, spread=0.05),))
    assert [prior_of(sure, flown(80, pitch, "day")).sd for pitch in (30, 40, None)] == [0.05, 0.16, 0.16]


def test_loose_boxes_do_not_make_the_camera_lower():
    rng = np.random.default_rng(1)
    labels = annotated(hit_uav_camera(60, 100), 100, "Car", 6, rng)
    people = annotated(hit_uav_camera(60, 60), 60, "Person", 6, rng)
    loose = []
    for label in labels:
        centre, half = (label.box_xyxy[:2] + label.box_xyxy[2:]) / 2, (label.box_xyxy[2:] - label.box_xyxy[:2]) / 2
        loose.append(Instance(label.category, np.concatenate([centre - 1.2 * half, centre + 1.2 * half])))
    exact = calibrate(hit_uav_camera(60, 80), 80, labels)
    prior = prior_of(StatedHeights(references=("car",), box_looseness=1.2), flown(80, 60, "day"))
    found = calibrate(hit_uav_camera(60, 80), 80, [*loose, *people], prior)
    assert found.anchors == {"car": len(loose)} and not found.at_limit
    assert found.factor == pytest.approx(exact.factor, rel=0.02)
    assert calibrate(hit_uav_camera(60, 80), 80, loose).factor < 0.87 * found.factor


FLAT = np.full((512, 640), 120, np.uint8)


def sampler_of(recipe):
    return RecipeSampler(recipe, {o.model: load_model(o.model) for o in recipe.objects}, 0)


def key(number, pitch=60.0, time_of_day="night"):
    name = f"{int(time_of_day == 'night')}_80_{pitch:g}_0_{number:05d}"
    return FrameKey(name, "train", 0, WH, Capture(pitch_deg=pitch, time_of_day=time_of_day))


def draw(recipe, pixels=FLAT, labels=(), pitch=60.0, number=0, ignored=("DontCare",), altitude=80.0):
    site = Site(pixels, tuple(labels), frozenset(ignored), altitude)
    return sampler_of(recipe).sample(key(number, pitch), site).spec


def test_crowds_do_not_correct_the_height():
    camera = hit_uav_camera(60, 80)
    people = annotated(camera, 64.0, "Person", 6, np.random.default_rng(0))
    crowds = [replace(p, extra={"iscrowd": 1}) for p in people]
    assert calibrate(camera, 80.0, people).anchors == {"person": 6}
    assert calibrate(camera, 80.0, crowds) == calibrate(camera, 80.0, [])


def test_height_stated_by_the_recipe_is_not_corrected():
    recipe = load_anywhere("hit-uav-drone-physical", ["camera.altitude={fixed_m: 50}"])
    assert draw(recipe).view.camera_height_m == 50


def test_people_have_several_class_names():
    camera = hit_uav_camera(60, 100)
    for name in ("Person", "human", "Pedestrian"):
        labels = annotated(hit_uav_camera(60, 130), 130, "Person", 4, np.random.default_rng(2))
        labels = [Instance(name, i.box_xyxy) for i in labels]
        assert calibrate(camera, 100, labels).anchors == {"person": 4}


def test_standing_objects_are_on_the_ground_at_true_size():
    recipe = load_anywhere("hit-uav-person", ["placement.size_px=[1, 500]"])
    for number in range(8):
        spec = draw(recipe, number=number)
        assert spec.view.camera_height_m == pytest.approx(80 * NOMINAL_FACTOR)
        assert spec.camera.position_m[2] - spec.view.ground_z_m == pytest.approx(80 * NOMINAL_FACTOR)
        (person,) = spec.objects
        assert person.position_m[2] == spec.view.ground_z_m == 0
        mesh = load_model("person").build(person.params)
        world = object_to_world(mesh.vertices_m, person.position_m, person.yaw_rad)
        xy, _ = spec.camera.project(world)
        away = np.linalg.norm(np.array(person.position_m) - spec.camera.position_m)
        tall = mesh.size_m[2] * spec.camera.focal_px / away * math.cos(math.radians(60))
        deep = max(mesh.size_m[:2]) * spec.camera.focal_px / away
        assert tall * 0.8 < np.ptp(xy[:, 1]) < tall + deep


def test_flying_objects_keep_their_range_in_front_of_the_ground():
    recipe = load_anywhere("hit-uav-drone-physical")
    for number in range(8):
        spec = draw(recipe, number=number)
        (drone,) = spec.objects
        assert 15 <= np.linalg.norm(np.array(drone.position_m) - spec.camera.position_m) <= 60
    near = draw(load_anywhere("hit-uav-drone-physical", ["camera.altitude={fixed_m: 10}", "camera.calibrate=false"]))
    assert near.draws["rejected"].get("beyond_ground", 0) + near.draws["absent"].get("no_place", 0) > 0


@pytest.mark.parametrize("lens_mm", [84.69, 2000.0])
def test_flying_objects_have_the_sizes_that_the_recipe_asks_for_whatever_the_lens(lens_mm):
    recipe = load_anywhere(
        "drone-sky",
        [
            "objects.0.size_px=[8, 64]", "objects.0.count=3", "camera.pitch={fixed_deg: -20}",
            f"camera.focal_length_mm={lens_mm}", "placement.size_px=null", "objects.0.options={shape: fixed-wing}",
        ],
    )  # fmt: skip
    sampler = sampler_of(recipe)
    site = Site(FLAT, (), frozenset(), 2.0)
    sizes = []
    for number in range(40):
        scene = sampler.sample(key(number, -20.0), site)
        for placed in scene.objects[:3]:
            vertices = placed.mesh.vertices_m[np.unique(placed.mesh.triangles)]
            longest_m = float(np.ptp(vertices, axis=0).max()) * placed.spec.scale
            sizes.append(scene.spec.camera.focal_px * longest_m / placed.range_m)
    assert len(sizes) > 80 and 7.9 < min(sizes) < 10 and 50 < max(sizes) < 65
    assert np.median(sizes) == pytest.approx(np.sqrt(8 * 64), rel=0.3)


def test_objects_keep_clear_of_labels_and_ignore_regions():
    recipe = load_anywhere("hit-uav-person", ["objects.0.count=6", "camera.calibrate=false"])
    everywhere = [np.array([0.0, 0, 640, 250]), np.array([0.0, 250, 300, 512])]
    for category, reason in (("Car", "on_annotated"), ("DontCare", "on_ignored")):
        spec = draw(recipe, labels=[Instance(category, b) for b in everywhere])
        assert spec.draws["rejected"][reason] > 0
        for o in spec.objects:
            xy, _ = spec.camera.project(np.array([o.position_m]))
            assert xy[0, 0] > 290 and xy[0, 1] > 240
    sunk = draw(load_anywhere("hit-uav-person", ["objects.0.z_m=[-5, -1]"]))
    assert set(sunk.draws["rejected"]) == {"below_ground"}
    covered = draw(recipe, labels=[Instance("DontCare", np.array([0.0, 0, 640, 512]))])
    assert not covered.objects
    assert covered.draws["absent"] == {"no_place": 6}


def labelled_box(camera, o):
    """Return the box of an inserted object's labelled parts in the picture."""
    item = request(o)
    return box_px(camera, item.in_world((*o.position_m, o.yaw_rad)), item)


def test_large_objects_cover_no_small_annotated_ones():
    """People of 1 % of a car's box vanished under it: what is shared counts against the smaller of both boxes."""
    rng = np.random.default_rng(5)
    people = [Instance("Person", np.array([x, y, x + 4, y + 4])) for x, y in rng.uniform(10, 500, (300, 2))]
    recipe = load_anywhere("hit-uav-car", ["objects.0.count=6", "placement.max_relief_grey=0"])
    drawn = [draw(recipe, labels=people, number=n) for n in range(8)]
    boxes = [labelled_box(s.camera, o) for s in drawn for o in s.objects]
    assert len(boxes) >= 8
    assert all(np.prod(b[2:] - b[:2]) > 50 * 16 for b in boxes)
    assert not any(collides(b, boxes_of(people)) for b in boxes)
    # With the rule off, cars do cover them.
    free = [
        draw(load_anywhere("hit-uav-car", ["placement.clear_of_labels=false"]), labels=people, number=n)
        for n in range(8)
    ]
    assert any(collides(labelled_box(s.camera, o), boxes_of(people)) for s in free for o in s.objects)


def test_the_search_for_places_is_bounded_in_a_picture_that_is_full():
    """Sixty objects without a place took 12,000 draws: 100 CPU seconds in a picture of 64 x 48 px."""
    recipe = load_anywhere("hit-uav-person", ["objects.0.count=60", "camera.calibrate=false"])
    full = draw(recipe, labels=[Instance("Car", np.array([0.0, 0, 640, 512]))])
    assert full.draws["absent"] == {"no_place": 60}
    assert full.draws["attempts"] == 200 + 100 + 50 + 25 + 12 + 55 * 10
    # Where places are rare but there, a miss does not keep later objects out.
    rare = draw(recipe, labels=[Instance("Car", np.array([0.0, 0, 560, 512]))])
    assert len(rare.objects) >= 10


def test_people_do_not_overlap_trees():
    rng = np.random.default_rng(0)
    rough = FLAT.copy()
    rough[:, :320] = rng.integers(40, 220, (512, 320))
    recipe = load_anywhere("hit-uav-person", ["camera.calibrate=false"])
    drawn = [draw(recipe, rough, number=n) for n in range(12)]
    assert sum(s.draws["rejected"].get("uneven_ground", 0) for s in drawn) >= 4
    for s in drawn:
        xy, _ = s.camera.project(np.array([s.objects[0].position_m]))
        assert xy[0, 0] > 318
    assert is_even(relief_of(FLAT), np.array([10.0, 10, 20, 20]), 1.0)
    # A drone may be over anything.
    flying = [draw(load_anywhere("hit-uav-drone-physical"), rough, number=n) for n in range(4)]
    assert not any(s.draws["rejected"].get("uneven_ground") for s in flying)


def test_frame_without_ground_is_reported():
    spec = draw(load_anywhere("hit-uav-person"), pitch=-20.0)
    assert not spec.objects
    assert set(spec.draws["rejected"]) == {"no_ground"}
    assert spec.draws["absent"] == {"no_place": 1}


def test_the_same_frame_twice_and_through_json():
    recipe = load_anywhere("hit-uav-drone-physical", ["camera.roll_deg=[-5, 5]"])
    a, b = draw(recipe), draw(recipe)
    assert a == b
    assert type(a).from_json(a.to_json()) == a


def nearest_m(spec):
    places = np.array([o.position_m[:2] for o in spec.objects])
    away = np.linalg.norm(places[:, None] - places[None], axis=2)
    np.fill_diagonal(away, np.inf)
    return away.min(axis=1)


def test_people_keep_company_as_often_and_as_close_as_the_recipe_says():
    alone = load_anywhere("hit-uav-person", ["objects.0.count=10"])
    settings = ["objects.0.count=10", "objects.0.group={share: 0.6, apart_m: [1, 2], max_overlap: 1}"]
    grouped = load_anywhere("hit-uav-person", settings)
    near = {
        name: np.concatenate([nearest_m(draw(r, number=n)) for n in range(12)])
        for name, r in (("alone", alone), ("grouped", grouped))
    }
    assert (near["alone"] < 2).mean() < 0.15
    # The nine after the first: 60 % beside another, whose neighbours they then are; some of these are alone else.
    assert 0.6 < (near["grouped"] <= 2 + 1e-9).mean() < 0.95
    assert load_anywhere("hit-uav-people").objects[0].group is not None


def test_cars_stand_in_rows():
    settings = ["objects.0.count=5", "objects.0.group={share: 1, apart_m: [2.5, 3], in_row: true, max_overlap: 0.6}"]
    spec = draw(load_anywhere("hit-uav-car", settings))
    assert len(spec.objects) == 5
    first = spec.objects[0]
    for o in spec.objects[1:]:
        # One or two steps of at most 4 degrees for each car between; heads may point either way.
        turn = math.remainder(o.yaw_rad - first.yaw_rad, math.pi)
        assert abs(math.degrees(turn)) <= 4 * 4
    assert (nearest_m(spec) <= 3 + 1e-9).all()
    assert (nearest_m(spec) >= 2.4).all()
    side = np.array([-math.sin(first.yaw_rad), math.cos(first.yaw_rad)])
    along = np.array([math.cos(first.yaw_rad), math.sin(first.yaw_rad)])
    away = np.array([np.subtract(o.position_m[:2], first.position_m[:2]) for o in spec.objects[1:]])
    assert (np.abs(away @ side) > 3 * np.abs(away @ along)).all()


def request(o):
    model = load_model(o.model)
    return PlacementRequest(None, model, o.params, model.build(o.params), o.scale)


def volumes(spec):
    return [volume_of(request(o), (*o.position_m, o.yaw_rad)) for o in spec.objects]


def test_no_car_stands_inside_another():
    """Boxes in the picture do not show it: neighbours in a row may hide each other by half."""
    group = "objects.0.group={share: 1, apart_m: [2.2, 2.6], in_row: true, max_overlap: 1}"
    recipe = load_anywhere("hit-uav-car", ["objects.0.count=12", "placement.max_relief_grey=0", group])
    specs = [draw(recipe, pitch=30.0, number=n) for n in range(6)]
    assert sum(s.draws["rejected"].get("in_another", 0) for s in specs) > 0
    assert sum(len(s.objects) for s in specs) > 30
    for spec in specs:
        assert not any(a.intersects(b) for a, b in itertools.combinations(volumes(spec), 2))


def test_a_moved_car_keeps_out_of_those_that_stay():
    group = "objects.0.group={share: 1, apart_m: [2.2, 2.6], in_row: true, max_overlap: 1}"
    recipe = load_anywhere("hit-uav-car", ["objects.0.count=8", "placement.max_relief_grey=0", group])
    sampler, rejected = sampler_of(recipe), 0
    # Ground for few cars, all else is covered: moved cars must stand close to the others.
    ignored = [Instance("DontCare", np.array(b, np.float64)) for b in ([0, 0, 640, 150], [0, 350, 640, 512])]
    site = Site(FLAT, tuple(ignored), frozenset({"DontCare"}), 80.0)
    for n in range(4):
        scene = sampler.sample(key(n), site)
        moved = sampler.move(scene, range(0, len(scene.objects), 2), site, 1).spec
        rejected += moved.draws["rejected"].get("in_another", 0)
        assert not any(a.intersects(b) for a, b in itertools.combinations(volumes(moved), 2))
    assert rejected


@pytest.mark.parametrize(
    ("x", "y", "z", "yaw_deg", "inside"),
    [
        (0.0, 0.0, 0.0, 0.0, True),
        (1.7, 0.0, 0.0, 0.0, True),
        (2.2, 0.0, 0.0, 0.0, False),
        # Boxes along x and y would meet, the turned cars do not.
        (3.0, 2.6, 0.0, 45.0, False),
        (0.0, 0.0, 2.5, 0.0, False),
    ],
)
def test_volumes_are_turned_with_their_objects(x, y, z, yaw_deg, inside):
    spec = draw(load_anywhere("hit-uav-car", ["objects.0.count=1"]))
    car = request(replace(spec.objects[0], scale=1.0))
    a = volume_of(car, (10.0, 5.0, 0.0, math.pi / 2 + math.radians(yaw_deg)))
    b = volume_of(car, (10.0 + x, 5.0 + y, z, math.pi / 2 + math.radians(yaw_deg)))
    assert a.intersects(b) is inside and b.intersects(a) is inside


def lined(yaw_deg, pitch=90.0):
    """A picture from above with kerbs along a direction on the ground."""
    v, u = np.mgrid[0 : WH[1], 0 : WH[0]]
    turn = math.radians(yaw_deg)
    # Seen from straight above, up in the picture is +Y.
    side = -v * math.cos(turn) - u * math.sin(turn)
    return np.where(side % 90 < 6, 150, 120).astype(np.uint8)


def off_deg(spec, yaw_deg, period_deg):
    turns = (math.degrees(o.yaw_rad) - yaw_deg for o in spec.objects)
    return np.array([abs((t + period_deg / 2) % period_deg - period_deg / 2) for t in turns])


@pytest.mark.parametrize("yaw", [0, 30])
def test_aligned_cars_stand_along_the_lines_of_the_picture(yaw):
    settings = ["objects.0.count=6", "placement.max_relief_grey=0", "objects.0.align={share: 1, spread_deg: 3}"]
    drawn = [draw(load_anywhere("hit-uav-car", settings), lined(yaw), pitch=90.0, number=n) for n in range(8)]
    off = np.concatenate([off_deg(s, yaw, 90) for s in drawn])
    assert len(off) > 30 and off.max() < 14 and 1.5 < math.sqrt((off**2).mean()) < 4.5
    # One picture has one of the two directions, the other pictures have either; both ends may be in front.
    across = [off_deg(s, yaw, 180).mean() > 45 for s in drawn]
    assert all(off_deg(s, yaw + 90 * a, 180).max() < 14 for s, a in zip(drawn, across, strict=True))
    assert 0 < sum(across) < len(drawn)
    assert any(np.ptp(np.cos([o.yaw_rad for o in s.objects])) > 1 or across[n] for n, s in enumerate(drawn))


def test_some_cars_do_not_follow_the_lines():
    settings = ["objects.0.count=6", "placement.max_relief_grey=0", "objects.0.align={share: 0.5, spread_deg: 1}"]
    drawn = [draw(load_anywhere("hit-uav-car", settings), lined(0), pitch=90.0, number=n) for n in range(12)]
    off = np.concatenate([off_deg(s, 0, 90) for s in drawn])
    assert 0.4 < (off < 4).mean() < 0.75


def test_cars_of_a_picture_without_lines_share_a_direction():
    settings = ["objects.0.count=5", "objects.0.align={share: 1, spread_deg: 2}"]
    drawn = [draw(load_anywhere("hit-uav-car", settings), number=n) for n in range(6)]
    for s in drawn:
        assert off_deg(s, math.degrees(s.objects[0].yaw_rad), 180).max() < 14
    firsts = np.array([math.degrees(s.objects[0].yaw_rad) % 90 for s in drawn])
    assert np.ptp(firsts) > 10


def test_neighbours_are_aligned_as_well():
    """Objects beside another one took any heading, whatever `align` said."""
    settings = ["objects.0.count=6", "objects.0.align={share: 1, spread_deg: 2}", "placement.max_relief_grey=0"]
    for in_row in ("true", "false"):
        group = f"objects.0.group={{share: 1, apart_m: [3, 6], in_row: {in_row}, max_overlap: 0.6}}"
        drawn = [
            draw(load_anywhere("hit-uav-car", [*settings, group]), lined(30), pitch=90.0, number=n) for n in range(6)
        ]
        off = np.concatenate([off_deg(s, 30, 90) for s in drawn])
        # Headings in a row differ by up to 4 degrees from one neighbour to the next.
        assert len(off) > 20 and np.median(off) < 5 and off.max() < 25


def test_cars_stand_along_the_view_by_day_only():
    align = "objects.0.align={share: 1, along: view, turn_deg: 20, spread_deg: 2, time_of_day: day}"
    plain = load_anywhere("hit-uav-car", ["objects.0.count=6", "placement.max_relief_grey=0"])
    aligned = load_anywhere("hit-uav-car", ["objects.0.count=6", "placement.max_relief_grey=0", align])
    day, sampler = Site(FLAT, (), frozenset(), 80.0, time_of_day="day"), sampler_of(aligned)
    by_day = [sampler.sample(key(n, time_of_day="day"), day).spec for n in range(24)]
    # One direction per picture, about that of +Y, in which the camera looks; either end may be in front.
    for s in by_day:
        assert off_deg(s, math.degrees(s.objects[0].yaw_rad), 180).max() < 14
    turns = np.array([(math.degrees(s.objects[0].yaw_rad) % 180) - 90 for s in by_day])
    assert 10 < turns.std() < 32 and abs(turns.mean()) < 15 and (np.abs(turns) < 62).all()
    noses = [math.sin(o.yaw_rad) > 0 for s in by_day for o in s.objects]
    assert 0.3 < np.mean(noses) < 0.7
    night = Site(FLAT, (), frozenset(), 80.0, time_of_day="night")
    drawn, unaligned = (sampler_of(recipe).sample(key(1), night).spec for recipe in (aligned, plain))
    assert drawn.objects == unaligned.objects


def test_flying_objects_have_headings_of_their_own():
    plain = load_anywhere("hit-uav-drone-physical", ["objects.0.count=2"])
    aligned = load_anywhere("hit-uav-drone-physical", ["objects.0.count=2", "objects.0.align={share: 1}"])
    assert draw(plain, lined(0)).objects == draw(aligned, lined(0)).objects


def test_a_moved_car_stands_along_the_others():
    settings = ["objects.0.count=4", "placement.max_relief_grey=0", "objects.0.align={share: 1, spread_deg: 2}"]
    sampler, site = sampler_of(load_anywhere("hit-uav-car", settings)), Site(lined(20), (), frozenset(), 80.0)
    for n in range(4):
        scene = sampler.sample(key(n, 90.0), site)
        moved = sampler.move(scene, range(4), site, 1).spec
        first = math.degrees(scene.spec.objects[0].yaw_rad)
        assert moved.objects and off_deg(moved, first, 180).max() < 12
        assert [o.position_m for o in moved.objects] != [o.position_m for o in scene.spec.objects]


def test_draws_without_companions_are_unchanged():
    """A recipe that names no group gets the scenes it always got."""
    plain = load_anywhere("hit-uav-person", ["objects.0.count=3"])
    never = load_anywhere("hit-uav-person", ["objects.0.count=3", "objects.0.group={share: 0}"])
    assert [o.position_m for o in draw(plain).objects] != []
    assert len(draw(never).objects) == 3


@pytest.mark.parametrize("name", ["hit-uav-person", "hit-uav-drone-physical", "hit-uav-drone"])
def test_nothing_is_placed_where_the_camera_saw_nothing(name, monkeypatch):
    ground = np.random.default_rng(0).integers(115, 125, (512, 640)).astype(np.uint8)
    black = np.zeros(ground.shape, np.bool_)
    black[:, :320] = True
    recipe = load_recipe(name, ["objects.0.count=3", *[ANYWHERE] * (name == "hit-uav-person")])
    drawn = [draw(recipe, np.where(black, 0, ground).astype(np.uint8), number=n) for n in range(6)]
    assert sum(s.draws["rejected"].get("on_margin", 0) for s in drawn) >= 3
    models = {o.model: load_model(o.model) for o in recipe.objects}
    boxes = [o.box_xyxy for s in drawn for o in rebuild_scene(s, models).objects]
    assert boxes and all(box[0] > 310 for box in boxes)  # labelled parts beyond 320; discs of propellers are not
    free = draw(recipe, ground)
    monkeypatch.setattr("infrablend.sampling.site.find_margin", lambda *_: None)
    assert draw(recipe, ground) == free  # the search draws nothing and rejects nothing
