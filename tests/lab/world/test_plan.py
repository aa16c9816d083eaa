"""The virtual world: plans, ground temperatures, labels and thermal images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from infrablend.core.rng import stream
from infrablend.errors import RecipeError
from infrablend.lab.world.fixtures import tree_prototype
from infrablend.lab.world.frame_files import (
    HIGH_GREY,
    LOW_GREY,
    TOWN,
    VisibleSamples,
    gain,
    label_object,
    noise,
    sample_world,
    silhouette_area_px,
    thermal_frame,
)
from infrablend.lab.world.ground import ground_kelvin
from infrablend.lab.world.ground_cover import Patch, Road
from infrablend.lab.world.people import Person, cycle, person
from infrablend.lab.world.scene_plan import WorldPlan
from infrablend.lab.world.setting import ground_points, world_camera
from infrablend.lab.world.thermal_surfaces import placed
from infrablend.lab.world.vehicles import vehicle
from infrablend.lab.world.world_frames import plan_frames, telemetry_of


def plan(
    kind: str = "street", time_of_day: str = "night", pitch: int = 60, altitude: int = 80, seed: int = 0
) -> WorldPlan:
    return sample_world(stream(seed, kind), pitch, altitude, time_of_day, kind)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", TOWN)
@pytest.mark.parametrize("time_of_day", ["day", "night"])
def test_every_place_has_objects_and_repeats(kind, time_of_day):
    first, second = plan(kind, time_of_day), plan(kind, time_of_day)
    assert first == second
    assert first != plan(kind, time_of_day, seed=1)
    assert first.people or first.vehicles or first.cycles
    assert (first.sun is None) == (time_of_day == "night")


def test_camera_projects_ground_points_back_to_their_pixels():
    # thermal.md 5.3: f 2060, h 100 m, p 50 deg: centre pixel at slant range 130.54 m, 15.78 px per metre.
    camera = world_camera(50, 100)
    assert camera.distance_m == pytest.approx(130.54, abs=0.01)
    assert camera.focal_px / camera.distance_m == pytest.approx(15.78, abs=0.01)
    pixels = np.array([[320.0, 256.0], [0.0, 0.0], [640.0, 512.0], [17.3, 400.1]])
    ground = ground_points(camera, pixels)
    assert ground[0] == pytest.approx([0, 0], abs=1e-9)
    back, _ = camera.project(np.column_stack([ground, np.zeros(4)]))
    assert back == pytest.approx(pixels, abs=1e-6)


@given(
    curvature=st.floats(-0.02, 0.02),
    heading=st.floats(-3, 3),
    along=st.floats(-30, 30),
    left=st.floats(-8, 8),
)
@settings(max_examples=100, deadline=None)
def test_road_coordinates_round_trip(curvature, heading, along, left):
    road = Road(3.0, -7.0, heading, curvature, 4.0, 2.0, 2, "asphalt", True)
    x, y, _ = road.at(along, left)
    s, t = road.along(np.asarray(x), np.asarray(y))
    assert float(s) == pytest.approx(along, abs=1e-6)
    assert float(t) == pytest.approx(left, abs=1e-6)


def test_solid_things_do_not_overlap():
    for seed in range(6):
        p = plan("parking", seed=seed, altitude=120, pitch=40)
        cars = [(v, placed(vehicle(v), v.x_m, v.y_m, v.heading_rad)) for v in p.vehicles]
        assert len(cars) > 3
        for v, _ in cars:
            c, s = np.cos(v.heading_rad), np.sin(v.heading_rad)
            for other, body in cars:
                if other is v:
                    continue
                d = body[:, :2] - (v.x_m, v.y_m)
                inside = (np.abs(d @ (c, s)) < 0.45 * v.length_m) & (np.abs(d @ (-s, c)) < 0.4 * v.width_m)
                assert not inside.any()


def test_night_temperatures_are_ordered_as_measured():
    p = plan("street")
    kelvin = {m.name: m.kelvin for m in p.materials}
    assert kelvin["grass"] < p.air_k < kelvin["asphalt"]
    for v in p.vehicles:
        assert v.paint_k < kelvin["asphalt"] - 3
    for q in p.people:
        assert min(q.top_k, q.skin_k) > kelvin["asphalt"] + 2


@pytest.mark.parametrize("kind", TOWN)
def test_ground_is_finite_and_repeats(kind):
    p = plan(kind, "day")
    a, b = ground_kelvin(p, 1), ground_kelvin(p, 1)
    assert a.shape == (512, 640) and a.dtype == np.float32
    assert np.array_equal(a, b)
    assert 250 < a.min() < a.max() < 350


def test_patch_is_where_the_camera_sees_it():
    p = plan("park")
    bare = replace(p, roads=(), patches=())
    # A 2 m square at the origin, 5 K warmer: at the picture's centre, of the size the camera gives it.
    square = replace(bare, patches=(Patch("rect", 0.0, 0.0, 0.0, 2.0, 2.0, None, 5.0),))
    change = ground_kelvin(square, 1) - ground_kelvin(bare, 1)
    rows, columns = np.nonzero(change > 2.5)
    scale = p.camera.focal_px / p.camera.distance_m
    assert np.ptp(columns) + 1 == pytest.approx(2 * scale, abs=2)
    assert np.ptp(rows) + 1 == pytest.approx(2 * scale * np.sin(p.camera.pitch_rad), abs=2)
    assert columns.mean() == pytest.approx(319.5, abs=1)
    assert change[0, 0] == 0


def test_bodies_have_plausible_sizes():
    p = plan("street", seed=3)
    for v in p.vehicles:
        size = np.ptp(vehicle(v).vertices_m, axis=0)
        assert size[0] == pytest.approx(v.length_m, abs=0.2)
        assert size[2] == pytest.approx(v.height_m, abs=0.35)
    for q in p.people:
        body = person(q)
        assert np.ptp(body.vertices_m[:, 2]) == pytest.approx(q.height_m, abs=0.16 if q.pose != "reach" else 0.6)
        # Bare head and hands are warmer than the clothes at night.
        assert body.kelvin.max() == pytest.approx(q.skin_k, abs=1e-3)
    for c in p.cycles:
        assert 1.2 < np.ptp(cycle(c).vertices_m[:, 0]) < 2.6
    crown = tree_prototype("crown", 0).vertices_m
    assert np.abs(crown[:, :2]).max() < 1.3 and crown[:, 2].max() == pytest.approx(1, abs=0.05)


def test_label_of_a_whole_a_cut_and_a_covered_body():
    camera = world_camera(60, 80)
    body = person(Person(0, 0, 0, 1.7, 1.0, "stand", 0.3, 0.1, 300, 295, 290, 290, 0))
    vertices = placed(body, 0.0, 0.0, 0.4)
    xy, _ = camera.project(vertices)
    area, framed = silhouette_area_px(xy, body.triangles, (640, 512))
    assert area == framed
    mask = np.zeros((1024, 1280), np.bool_)
    low, high = np.floor(xy.min(axis=0) * 2).astype(int), np.ceil(xy.max(axis=0) * 2).astype(int)
    mask[low[1] : high[1], low[0] : high[0]] = True
    whole = label_object("Person", camera, vertices, body.triangles, VisibleSamples(mask, (0, 0), 2), True)
    assert whole.box_xyxy == pytest.approx(np.concatenate([xy.min(axis=0), xy.max(axis=0)]))
    assert whole.visibility == 1 and not whole.truncated and not whole.dropped

    middle = (low[1] + high[1]) // 2
    covered = mask.copy()
    covered[middle:] = False
    # Half of the silhouette: fill only as much as the body itself has.
    covered[:, (low[0] + high[0]) // 2 :] = False
    half = label_object("Person", camera, vertices, body.triangles, VisibleSamples(covered, (0, 0), 2), True)
    assert half.box_xyxy is not None and half.box_xyxy[3] <= middle / 2
    none = label_object(
        "Person", camera, vertices, body.triangles, VisibleSamples(np.zeros_like(mask), (0, 0), 2), True
    )
    assert none.dropped == "hidden" and none.box_xyxy is None

    # Moved half out of the left edge: the box stays inside and the oriented box, too.
    shift = ground_points(camera, np.array([[2.0, 256.0]]))[0]
    moved = vertices + np.append(shift, 0.0)
    mask[:] = True
    cut = label_object("Car", camera, moved, body.triangles, VisibleSamples(mask, (0, 0), 2), False)
    assert cut.truncated and cut.box_xyxy is not None and cut.corners_xy is not None
    assert cut.box_xyxy[0] == 0 and cut.corners_xy.min() >= 0


def test_gain_holds_mean_and_limits_stretch():
    rng = np.random.default_rng(0)
    kelvin = (280 + 4 * rng.standard_normal((128, 160))).astype(np.float32)
    grey = gain(kelvin, 6.0, 33.0)
    assert np.clip(grey, LOW_GREY, HIGH_GREY).mean() == pytest.approx(126, abs=0.5)
    assert grey.std() == pytest.approx(33, rel=0.1)
    flat = gain(280 + kelvin / 1000, 6.0, 33.0)
    assert flat.std() < 0.1


def test_frame_has_hit_uavs_levels_and_noise():
    rng = stream(0, "frame")
    kelvin = np.full((512, 640), 280.0, np.float32)
    kelvin[200:260, 300:330] = 310
    kelvin[:, :100] = 250
    frame = thermal_frame(kelvin, 6.0, 33.0, 126.0, rng)
    assert frame.dtype == np.uint8 and frame.min() >= 16 and frame.max() <= 235
    n = noise(stream(1), (256, 256), 1.5)
    assert n.std() == pytest.approx(1.5, rel=1e-3)
    assert np.corrcoef(n[:, 1:].ravel(), n[:, :-1].ravel())[0, 1] == pytest.approx(0.79, abs=0.04)


def test_frames_cover_the_range_and_do_not_depend_on_their_number():
    few, many = plan_frames(8, 0), plan_frames(56, 0)
    assert [f.pitch_deg for f in few] == [f.pitch_deg for f in many[:8]]
    assert len({f.pitch_deg for f in few[:7]}) == 7 and len({f.altitude_m for f in few}) == 8
    assert {f.time_of_day for f in many} == {"day", "night"}
    by_split = {s: sum(f.split == s for f in many) for s in ("train", "val", "test")}
    assert by_split["train"] == pytest.approx(39, abs=1) and by_split["test"] == pytest.approx(11, abs=1)
    assert {(f.split, f.time_of_day) for f in plan_frames(5, 0, "dji")} == {("train", "night")}
    assert few[0].name.endswith("_0_00000.jpg")


def test_monets_sequences_cover_splits_and_lost_telemetry():
    frames = plan_frames(24, 0, "monet")
    assert plan_frames(8, 0, "monet") == frames[:8] and plan_frames(8, 1, "monet") != frames[:8]
    assert len({f.name for f in frames}) == 24 and frames[0].name == "runway_04/lwir/image00000.png"
    assert {f.split for f in frames[:4]} == {"train", "val", "test"}
    without = {f.sequence for f in frames} - {f.sequence for f in frames if f.telemetry}
    assert without == {"runway_01", "dirtroad_01"}
    assert [(f.sequence, f.index) for f in frames if not f.telemetry and f.sequence not in without] == [
        ("runway_04", 1)
    ]
    for f in frames:
        said = telemetry_of(f, 0)
        assert bool(said) == f.telemetry
        assert not said or (said["g_pitch"], said["alt"]) == (-f.pitch_deg, f.altitude_m)
        assert f.size_wh == (800, 600) and 10 <= f.pitch_deg <= 90
        assert len({g.time_of_day for g in frames if g.sequence == f.sequence}) == 1


@pytest.mark.parametrize("kind", ["runway", "dirtroad"])
@pytest.mark.parametrize("time_of_day", ["day", "night"])
def test_country_places_in_another_size(kind, time_of_day):
    p = sample_world(stream(0, kind), 55.5, 60.5, time_of_day, kind, (800, 600))
    assert p == sample_world(stream(0, kind), 55.5, 60.5, time_of_day, kind, (800, 600))
    assert p.camera.size_wh == (800, 600) and p.camera.focal_px == pytest.approx(2060 * 800 / 640)
    assert p.vehicles and p.people and not p.cycles
    assert ground_kelvin(p, 1).shape == (600, 800)
    assert kind not in TOWN  # the town's places are drawn as before


@pytest.mark.parametrize("count", [0, 100_001])
def test_a_number_of_frames_out_of_range_is_named(count):
    with pytest.raises(RecipeError) as error:
        plan_frames(count, 0)
    (problem,) = error.value.problems
    assert (problem.where, problem.found) == ("count", f"found {count}")
