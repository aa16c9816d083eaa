"""Tracks: objects keep their place in the world while the camera shifts, turns, zooms and freezes."""

from dataclasses import replace

import numpy as np
import pytest

from infrablend.assets.catalogue import load_model
from infrablend.config.recipe import Motion, PathPoint
from infrablend.core.camera import CameraSpec
from infrablend.core.ground_plane import at_height, ground_point, ground_z_m, pixel_ray
from infrablend.core.render import PlacedObject
from infrablend.core.scene import Appearance, ObjectSpec, SceneSpec, View
from infrablend.errors import RecipeError
from infrablend.imaging.camera_path import Moment
from infrablend.imaging.camera_shift import moved
from infrablend.sampling.tracks import Footage, camera_in, find_track, objects_in, velocity_px_s

SIZE = (320, 256)
HEIGHT = 40.0


def footage(*matrices, states=None, step_s=0.04):
    """Return a sequence whose frames lead to the first by these matrices."""
    states = states or ["first"] + ["followed"] * (len(matrices) - 1)
    moments = [Moment(0, s, np.asarray(m, float)) for s, m in zip(states, matrices, strict=True)]
    return Footage(moments, step_s * np.arange(len(moments)), SIZE)


def shifted(right, down, turn=0.0, zoom=1.0):
    """Return the matrix to the first frame of one whose camera is turned and zoomed about the middle, and shifted."""
    c, s = np.cos(turn) / zoom, np.sin(turn) / zoom
    middle = np.array([[1, 0, SIZE[0] / 2], [0, 1, SIZE[1] / 2], [0, 0, 1]])
    return (
        np.array([[1, 0, right], [0, 1, down], [0, 0, 1]])
        @ middle
        @ [[c, -s, 0], [s, c, 0], [0, 0, 1]]
        @ np.linalg.inv(middle)
    )


def scene(pitch_deg, model_name, at_px, range_m=60.0, height=HEIGHT):
    """Return an anchor's scene with one object whose origin is at a position of the picture."""
    camera = at_height(CameraSpec(1.0, np.radians(pitch_deg), 0.0, 50.0, 36.0, SIZE), height)
    z = ground_z_m(camera, height)
    model = load_model(model_name)
    params = model.sample(np.random.default_rng(1), {})
    place = (
        ground_point(camera, at_px[0], at_px[1], z)
        if model.stands
        else camera.position_m + range_m * pixel_ray(camera, at_px[0], at_px[1])
    )
    spec = ObjectSpec(model_name, model.category, params, {}, tuple(float(v) for v in place), 0.4)
    view = View(height, height, z, {}, 0.0)
    whole = SceneSpec("train/a_c0", "a", "train", 0, camera, (spec,), 283.0, Appearance(), 0, 0, view=view)
    return whole, PlacedObject(spec, model.build(params), camera), model


def track_of(whole, placed, model, seen, kind="still"):
    return find_track(
        1, placed, model, Motion(kind=kind), whole.view, 0, seen, np.random.default_rng(2), lambda x, y: True
    )


def shown(whole, placed, model, seen, n, kind="still", pitch_rad=None):
    track = track_of(whole, placed, model, seen, kind)
    camera, view = camera_in(whole, seen, 0, n, pitch_rad)
    return objects_in([track], [model], seen, n, camera, view)


def place_px(found):
    return found.camera.project(np.array([found.spec.position_m]))[0][0]


CAMERAS = {
    "shift": shifted(23.4, -11.2),
    "turn": shifted(0, 0, turn=0.3),
    "zoom": shifted(0, 0, zoom=1.5),
    "all": shifted(-15, 8, turn=-0.2, zoom=0.8),
}


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize(("model", "pitch_deg"), [("drones", -5.0), ("deer", 60.0), ("deer", 90.0)])
def test_a_still_object_moves_with_the_background(name, model, pitch_deg):
    whole, placed, model = scene(pitch_deg, model, (150.0, 140.0))
    seen = footage(np.eye(3), CAMERAS[name])
    pitch = whole.camera.pitch_rad if model.stands else None
    (found,) = shown(whole, placed, model, seen, 1, pitch_rad=pitch)
    expected = moved(np.array([[150.0, 140.0]]), np.linalg.inv(CAMERAS[name]))[0]
    np.testing.assert_allclose(place_px(found), expected, atol=1e-6)
    assert found.spec.track == 1
    zoom = 1 / np.sqrt(np.linalg.det(CAMERAS[name][:2, :2]))
    size = np.ptp(found.xy, axis=0).max() / np.ptp(placed.xy, axis=0).max()
    assert size == pytest.approx(zoom, rel=0.2)  # a turned box has other sides
    assert np.linalg.norm(np.ptp(found.xy, axis=0)) == pytest.approx(
        zoom * np.linalg.norm(np.ptp(placed.xy, axis=0)), rel=0.3
    )


@pytest.mark.parametrize("pitch_deg", [45.0, 90.0])
def test_a_turned_picture_turns_what_stands_on_the_ground(pitch_deg):
    """Heading and place in a turned picture are those of the first one, turned with it."""
    whole, placed, model = scene(pitch_deg, "deer", (160.0, 128.0))
    seen = footage(np.eye(3), shifted(0, 0, turn=0.5))
    (found,) = shown(whole, placed, model, seen, 1, pitch_rad=whole.camera.pitch_rad)
    turned = moved(placed.xy, np.linalg.inv(shifted(0, 0, turn=0.5)))
    np.testing.assert_allclose(found.xy, turned, atol=0.05)


def test_a_drone_shows_another_side_as_the_camera_pans():
    whole, placed, model = scene(0.0, "drones", (160.0, 128.0))
    seen = footage(np.eye(3), shifted(100.0, 0))
    (found,) = shown(whole, placed, model, seen, 1)
    pan = 100.0 / whole.camera.focal_px
    assert found.spec.yaw_rad == pytest.approx(0.4 + pan, abs=1e-9)
    (tilted,) = shown(whole, placed, model, footage(np.eye(3), shifted(0, 30.0)), 1)
    assert tilted.camera.pitch_rad == pytest.approx(30.0 / whole.camera.focal_px)


def test_an_object_leaves_and_enters_the_picture():
    whole, placed, model = scene(60.0, "deer", (300.0, 128.0))
    seen = footage(np.eye(3), shifted(-200.0, 0), shifted(310.0, 0))
    counts = [len(shown(whole, placed, model, seen, n, pitch_rad=whole.camera.pitch_rad)) for n in range(3)]
    assert counts == [1, 0, 1] or counts == [1, 0, 0]
    away = footage(np.eye(3), shifted(400.0, 0))
    assert not shown(whole, placed, model, away, 1, pitch_rad=whole.camera.pitch_rad)


def test_a_followed_drone_stays_in_the_picture_however_the_camera_turns():
    rng = np.random.default_rng(0)
    turns = np.cumsum(rng.normal(0, 4, (200, 2)), axis=0) + np.linspace(0, 900, 200)[:, None]
    seen = footage(*(shifted(*t) for t in turns))
    whole, placed, model = scene(-5.0, "drones", (160.0, 128.0))
    track = track_of(whole, placed, model, seen, "followed")
    places = [moved(track.xy_px[n][None], seen.from_to(0, n))[0] for n in range(200)]
    apart = np.abs(np.array(places) - np.array(SIZE) / 2)
    assert apart.max() < 100
    # The operator's jerks stay in the picture: the drone does not follow them.
    steps = np.linalg.norm(np.diff(track.xy_px, axis=0), axis=1)
    assert np.median(np.abs(np.diff(steps))) < 0.5


def test_a_frozen_picture_is_that_of_the_frame_before():
    seen = footage(
        np.eye(3),
        shifted(5, 0),
        shifted(5, 0),
        shifted(5, 0),
        shifted(20, 0),
        states=["first", "followed", "frozen", "frozen", "followed"],
    )
    assert [seen.shown(n) for n in range(5)] == [0, 1, 1, 1, 4]


def test_the_velocity_is_that_in_the_picture():
    whole, placed, model = scene(-5.0, "drones", (160.0, 128.0))
    seen = footage(*(shifted(3.0 * k, -1.0 * k) for k in range(5)))
    track = track_of(whole, placed, model, seen)
    right, down = velocity_px_s([track], seen, 2)
    assert (right, down) == (pytest.approx(-3.0 / 0.04), pytest.approx(1.0 / 0.04))
    assert velocity_px_s([track], footage(np.eye(3)), 0) == (0.0, 0.0)


def test_levels_follow_gain_and_offset():
    seen = footage(np.eye(3), np.eye(3), np.eye(3))
    moments = [
        replace(m, gain=g, offset=o) for m, g, o in zip(seen.moments, (1.0, 2.0, 0.5), (0.0, -30.0, 80.0), strict=True)
    ]
    seen = replace(seen, moments=moments)
    gain, offset = seen.levels(1, 2)
    for level in (20.0, 100.0):
        assert gain * (2 * level - 30) + offset == pytest.approx(0.5 * level + 80)


def test_a_path_by_hand_goes_through_its_points():
    times = {"time_s": 0.0}, {"time_s": 0.08}
    for name, pitch, places in (
        ("deer", 60.0, ({"x_px": 100, "y_px": 150}, {"x_px": 200, "y_px": 120})),
        ("drones", -5.0, ({"x_px": 100, "y_px": 150, "range_m": 50}, {"x_px": 200, "y_px": 120, "range_m": 80})),
    ):
        whole, placed, model = scene(pitch, name, (150.0, 140.0))
        seen = footage(*(shifted(4.0 * k, 0) for k in range(4)))
        motion = Motion(path=tuple(PathPoint(**t, **p) for t, p in zip(times, places, strict=True)))
        track = find_track(1, placed, model, motion, whole.view, 0, seen, np.random.default_rng(2), lambda x, y: True)
        np.testing.assert_allclose(track.xy_px[[0, 2, 3]], [(100, 150), (200, 120), (200, 120)], atol=1e-6)
    np.testing.assert_allclose(track.range_m[[0, 2]], (50, 80))
    whole, placed, model = scene(10.0, "deer", (150.0, 200.0))
    sky = Motion(path=(PathPoint(time_s=0, x_px=100, y_px=2),))
    with pytest.raises(RecipeError, match=r"objects\.0\.motion\.path\.0"):
        find_track(1, placed, model, sky, whole.view, 0, seen, np.random.default_rng(2), lambda x, y: True)


def test_a_path_in_metres_begins_where_the_object_was_placed():
    whole, placed, model = scene(60.0, "deer", (150.0, 140.0))
    points = PathPoint(time_s=0, offset_m=(0, 0, 0)), PathPoint(time_s=0.08, offset_m=(3, 4, 0))
    motion = Motion(path=points)
    seen = footage(*([np.eye(3)] * 3))
    track = find_track(1, placed, model, motion, whole.view, 0, seen, np.random.default_rng(2), lambda x, y: True)
    np.testing.assert_allclose(track.path.place_m[-1] - placed.spec.position_m, (3, 4, 0), atol=1e-9)
    assert track.path.way_m[-1] == pytest.approx(5) and track.path.yaw_rad[1] == pytest.approx(np.arctan2(4, 3))


def test_a_point_of_a_path_has_one_place_and_times_rise():
    with pytest.raises(ValueError, match="x_px and y_px, or offset_m"):
        PathPoint(time_s=0, x_px=3)
    with pytest.raises(ValueError, match="each later"):
        Motion(path=(PathPoint(time_s=1, x_px=3, y_px=3),) * 2)
