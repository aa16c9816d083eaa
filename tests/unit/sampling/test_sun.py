"""The sun over a scene: one per sequence, recorded, and absent by night."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from infrablend.assets.catalogue import load_model
from infrablend.core.capture import Capture
from infrablend.core.scene import SceneSpec
from infrablend.sampling.scene_sampler import sample_scene
from infrablend.sampling.site import FrameKey, Site
from tests.recipes import load_anywhere
from tests.samples import with_facts

KUNMING = "environment.place={latitude_deg: 25.0, longitude_deg: 102.7}"
PERSON = {"person": load_model("person")}
SITE = Site(np.full((512, 640), 120, np.uint8), altitude_m=60.0)
DAY = FrameKey(
    "f",
    "train",
    0,
    (640, 512),
    Capture(pitch_deg=60.0, time_of_day="day", sequence="20210116-day-60m-60deg", captured="2021-01-16"),
)


def sampled(key, *overrides, seed=3, recipe="hit-uav-person"):
    return sample_scene(key, load_anywhere(recipe, list(overrides)), PERSON, seed, SITE)


def sun(key, *overrides, seed=3):
    return sampled(key, *overrides, seed=seed).spec.weather.sun


def test_all_frames_of_a_sequence_have_one_sun():
    keys = [replace(DAY, background_id=f"f{k}", configuration=k % 2) for k in range(4)]
    assert len({sun(k) for k in keys}) == 1
    others = [
        with_facts(DAY, sequence="another"),
        with_facts(DAY, sequence=None),
        with_facts(DAY, sequence=None, captured=None),
    ]
    assert len({sun(k).azimuth_rad for k in [DAY, *others]}) == 4
    assert sun(DAY, seed=4) != sun(DAY)
    found = sun(DAY)
    assert found.source == "drawn" and 25 <= math.degrees(found.elevation_rad) <= 45
    assert found.direct_w_m2 > 700 > found.diffuse_w_m2


def test_time_and_place_of_capture_give_the_elevation():
    noon = with_facts(DAY, captured="2021-01-16T13:13:00+08:00")
    found = sun(noon, KUNMING)
    assert found.source == "computed" and math.degrees(found.elevation_rad) == pytest.approx(44, abs=0.5)
    assert sun(DAY, KUNMING) == sun(DAY)  # a date alone is not enough
    # By day the sun cannot be below the horizon: something is wrong, and the run says so.
    night = sun(with_facts(DAY, captured="2021-01-16T01:00:00+08:00"), KUNMING)
    assert night.source == "contradicted" and math.degrees(night.elevation_rad) >= 25


def test_clouds_hide_the_sun():
    clear, covered = (sun(DAY, f"environment.clear_share={share}") for share in (1, 0))
    assert covered.direct_w_m2 < clear.direct_w_m2 and covered.azimuth_rad == clear.azimuth_rad


def test_without_a_sun_nothing_is_warmed():
    for when in ("night", None):
        scene = sampled(with_facts(DAY, time_of_day=when))
        assert scene.spec.weather.sun is None
        assert all(p.sun_k == 0 for o in scene.spec.objects for p in o.parts.values())
        assert not any(o.sun_rise_k.any() for o in scene.objects)


def test_one_person_has_parts_in_sun_and_shade():
    for k in range(6):
        (person,) = sampled(replace(DAY, background_id=f"f{k}")).objects
        low, high = person.part_sun_range_k["jacket"]
        parts = person.spec.parts
        assert high - low > 4 or parts["jacket"].sun_k < 15
        assert parts["jacket"].sun_k == parts["sleeve"].sun_k != parts["trousers"].sun_k


def test_the_record_holds_the_sun():
    scene = sampled(DAY)
    back = SceneSpec.from_json(json.loads(json.dumps(scene.spec.to_json())))
    assert back == scene.spec and back.weather.sun == scene.spec.weather.sun
    old = scene.spec.to_json()
    del old["weather"]["sun"]
    for o in old["objects"]:
        for part in o["parts"].values():
            del part["sun_k"]
    assert SceneSpec.from_json(old).weather.sun is None


def test_a_temperature_that_the_recipe_states_includes_the_sun():
    (person,) = sampled(DAY, "objects.0.parts={jacket: {delta_t_k: [7, 7]}}").spec.objects
    air_k = sampled(DAY).spec.ambient_k
    assert person.parts["jacket"].sun_k == 0
    assert person.parts["jacket"].temperature_k == pytest.approx(air_k + 7)
