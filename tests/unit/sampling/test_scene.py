"""Scenes: reproducible, within the recipe's ranges, drawn again until the object is visible."""

import json
import math

import numpy as np
import pytest

from infrablend.annotation.labels import annotate
from infrablend.assets.catalogue import load_model
from infrablend.config.loading import load_recipe
from infrablend.core.capture import Capture
from infrablend.core.raster import inside_fraction
from infrablend.core.scene import SceneSpec
from infrablend.errors import ModelError
from infrablend.sampling.scene_sampler import rebuild_scene, require_parts, sample_scene
from infrablend.sampling.site import FrameKey
from tests.samples import with_facts

MODELS = {"drone": load_model("drone")}


def key(k=0, name="0_60_50_0_00001", pitch=50.0):
    return FrameKey(name, "train", k, (640, 512), Capture(pitch_deg=pitch))


def test_scene_depends_on_the_key():
    recipe = load_recipe("hit-uav-drone")
    a, b = (sample_scene(key(), recipe, MODELS, 0).spec for _ in range(2))
    assert a == b
    others = [
        sample_scene(key(1), recipe, MODELS, 0).spec,
        sample_scene(key(name="x"), recipe, MODELS, 0).spec,
        sample_scene(key(), recipe, MODELS, 1).spec,
    ]
    assert len({s.camera.distance_m for s in [a, *others]}) == 4


def test_scene_survives_json_and_builds_the_same_mesh():
    sampled = sample_scene(key(), load_recipe("hit-uav-drone"), MODELS, 3)
    back = SceneSpec.from_json(json.loads(json.dumps(sampled.spec.to_json())))
    assert back == sampled.spec
    for a, b in zip(rebuild_scene(back, MODELS).objects, sampled.objects, strict=True):
        assert a.mesh.vertices_m.tobytes() == b.mesh.vertices_m.tobytes()


def test_draws_stay_in_range_and_the_object_shows():
    recipe = load_recipe("hit-uav-drone")
    for n in range(40):
        s = sample_scene(key(name=f"f{n}", pitch=30 + n), recipe, MODELS, 0)
        c, o = s.spec.camera, s.spec.objects[0]
        assert 1 <= c.distance_m <= 10
        assert abs(math.degrees(c.roll_rad)) <= 10
        assert math.degrees(c.pitch_rad) == pytest.approx(30 + n)
        assert max(abs(o.position_m[0]), abs(o.position_m[1])) <= 3
        assert 0 <= o.yaw_rad < 2 * math.pi
        inside, depth = inside_fraction(c, s.objects[0].world_m, s.objects[0].mesh.triangles)
        assert inside >= 0.5
        assert depth >= 0.3


def test_keep_is_the_papers_literal_text():
    """Without redrawing, distance is uniform (a Kolmogorov-Smirnov distance far below the 0.1 % bar)."""
    recipe = load_recipe("hit-uav-drone", ["placement.on_miss=keep"])
    d = np.sort([sample_scene(key(name=f"f{n}"), recipe, MODELS, 0).spec.camera.distance_m for n in range(300)])
    ks = np.abs((d - 1) / 9 - (np.arange(300) + 0.5) / 300).max()
    assert ks < 1.95 / math.sqrt(300)
    s = sample_scene(key(), recipe, MODELS, 0).spec
    assert s.draws["attempts"] == 1


def test_redraw_position_keeps_the_first_distance():
    recipe = load_recipe("hit-uav-drone", ["placement.on_miss=redraw_position"])
    for n in range(20):
        s = sample_scene(key(name=f"f{n}"), recipe, MODELS, 0).spec
        assert s.camera.distance_m == s.draws["first_distance_m"]


def test_a_place_that_cannot_be_found_is_counted():
    recipe = load_recipe("hit-uav-drone", {"objects.0.x_m": [500, 501], "placement.attempts": 5})
    s = sample_scene(key(), recipe, MODELS, 0).spec
    assert s.objects == ()
    assert s.draws["absent"] == {"no_place": 1}
    assert s.draws["rejected"] == {"outside_frame": 5}
    several = sample_scene(
        key(),
        load_recipe("hit-uav-drone", {"objects.0.x_m": [500, 501], "placement.attempts": 5, "objects.0.count": 4}),
        MODELS,
        0,
    ).spec
    assert several.draws["rejected"] == {"outside_frame": 5 + 2 + 1 + 1}


def test_several_objects_and_empty_frames():
    recipe = load_recipe("hit-uav-drone", {"objects.0.count": {"values": [1, 2, 3]}, "empty_share": 0.25})
    numbers = [sample_scene(key(name=f"f{n}"), recipe, MODELS, 0).spec.draws["wanted"] for n in range(80)]
    assert set(numbers) == {0, 1, 2, 3}
    assert 8 <= numbers.count(0) <= 34


def test_numbers_of_objects_follow_time_of_day_height_and_angle():
    count = {
        "values": [1],
        "by_flight": [
            {"time_of_day": "day", "below_m": 85, "values": [4]},
            {"time_of_day": "day", "values": [3]},
            {"below_m": 50, "values": [2]},
            {"below_pitch_deg": 35, "values": [5]},
        ],
    }
    recipe = load_recipe("hit-uav-drone", {"objects.0.count": count})

    def number(**flight):
        return sample_scene(with_facts(key(), **flight), recipe, MODELS, 3).spec.draws["wanted"]

    assert number(time_of_day="day", altitude_m=84.0) == 4
    assert number(time_of_day="day", altitude_m=85.0) == 3
    assert number(time_of_day="day", altitude_m=None) == 3
    assert number(time_of_day="night", altitude_m=49.0) == 2
    assert number(time_of_day="night", altitude_m=None) == 1
    assert number(pitch_deg=30.0) == 5
    assert number(pitch_deg=35.0) == 1
    assert number() == 1


def test_size_limits_hold():
    recipe = load_recipe("hit-uav-drone", {"placement.size_px": [40, 90], "placement.min_inside": 1.0})
    for n in range(15):
        s = sample_scene(key(name=f"f{n}"), recipe, MODELS, 0)
        assert 40 <= np.ptp(s.objects[0].xy, axis=0).max() <= 90


def test_size_limits_are_about_the_labels_box():
    """An object that the frame cuts counts by its visible part."""
    settings = {
        "placement.size_px": [100, 130],
        "placement.min_inside": 0.05,
        "camera.distance_m": 3.0,
        "placement.attempts": 1000,
    }
    recipe = load_recipe("hit-uav-drone", settings)
    truncated = 0
    for n in range(12):
        s = sample_scene(key(name=f"f{n}"), recipe, MODELS, 0)
        labels, _ = annotate(s)
        for label in labels:
            assert 100 - 1e-6 <= np.ptp(label.box_xyxy.reshape(2, 2), axis=0).max() <= 130 + 1e-6
            truncated += bool(label.truncated)
    assert truncated >= 3


def test_fixed_and_random_pitch():
    fixed = load_recipe("hit-uav-drone-fixed-pitch")
    assert sample_scene(key(), fixed, MODELS, 0).spec.camera.pitch_rad == 0
    free = load_recipe("hit-uav-drone-random-pitch")
    pitches = [math.degrees(sample_scene(key(name=f"f{n}"), free, MODELS, 0).spec.camera.pitch_rad) for n in range(60)]
    assert min(pitches) < 20 < 70 < max(pitches)
    assert 0 <= min(pitches) <= max(pitches) <= 90


def test_part_overrides_reach_the_scene_and_unknown_parts_are_named():
    recipe = load_recipe("hit-uav-drone", {"objects.0.parts": {"motor": {"delta_t_k": 99}}})
    s = sample_scene(key(), recipe, MODELS, 0).spec
    assert s.objects[0].parts["motor"].temperature_k == pytest.approx(s.ambient_k + 99)
    with pytest.raises(ModelError, match="turbine"):
        require_parts(load_recipe("hit-uav-drone", {"objects.0.parts": {"turbine": {"delta_t_k": 9}}}), MODELS)


def of_first(settings, model="drone", state=None):
    models = {model: load_model(model)}
    options = {
        "objects.0.model": model,
        **({"objects.0.options": {"state": state, "sheltered": True}} if state else {}),
    }
    spec = sample_scene(key(), load_recipe("hit-uav-drone", {**options, **settings}), models, 0).spec
    return {name: part.temperature_k - spec.ambient_k for name, part in spec.objects[0].parts.items()}, spec.objects[0]


def test_all_parts_that_are_not_named_are_overridden_together():
    settings = {"objects.0.parts": {"*": {"delta_t_k": 5, "emissivity": 0.7}, "motor": {"delta_t_k": 99}}}
    found, drone = of_first(settings)
    assert found.pop("motor") == pytest.approx(99)
    assert list(found.values()) == pytest.approx([5] * len(found))
    drawn = of_first({})[1].parts["motor"].emissivity
    assert {p.emissivity for n, p in drone.parts.items() if n != "motor"} == {0.7}
    assert drone.parts["motor"].emissivity == drawn
    require_parts(load_recipe("hit-uav-drone", settings), MODELS)


def test_a_shift_warms_all_parts_of_an_object_alike():
    usual, plain = of_first({})
    warmer, shifted = of_first({"objects.0.delta_t_k": -12.5})
    assert warmer == pytest.approx({name: delta_k - 12.5 for name, delta_k in usual.items()})
    assert (plain.position_m, plain.params) == (shifted.position_m, shifted.params)
    stated, _ = of_first({"objects.0.delta_t_k": 10, "objects.0.parts": {"*": {"delta_t_k": 5}}})
    assert list(stated.values()) == pytest.approx([15] * len(stated))
    drawn, _ = of_first({"objects.0.delta_t_k": [0, 10]})
    (shift_k,) = {round(drawn[name] - usual[name], 6) for name in usual}
    assert 0 < shift_k < 10


def test_ground_beside_a_car_is_no_part_of_its_temperature():
    usual, _ = of_first({}, "car", "parked_cold")
    settings = {"objects.0.delta_t_k": 20, "objects.0.parts": {"*": {"delta_t_k": 5}}}
    found, _ = of_first(settings, "car", "parked_cold")
    ground = {name for name in found if name.startswith("ground_")}
    assert ground and {name: found[name] for name in ground} == {name: usual[name] for name in ground}
    assert [found[name] for name in set(found) - ground] == pytest.approx([25] * (len(found) - len(ground)))
