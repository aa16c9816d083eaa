"""Shade by day: objects on dark ground are not in the sun; parked cars throw thermal shadows, moving things do not."""

import math
from dataclasses import replace

import numpy as np
import pytest

from infrablend.assets.catalogue import load_model
from infrablend.core.capture import Capture
from infrablend.core.dataset import Instance
from infrablend.core.scene import Sun
from infrablend.sampling.scene_sampler import RecipeSampler, rebuild_scene, sample_scene
from infrablend.sampling.shade import shadow_shift
from infrablend.sampling.site import FrameKey, Site
from tests.recipes import load_anywhere
from tests.samples import with_facts

DAY = FrameKey("f", "train", 0, (640, 512), Capture(pitch_deg=60.0, time_of_day="day", sequence="flight"))
EVEN = np.full((512, 640), 120, np.uint8)


def sampled(model, pixels=EVEN, *overrides, labels=(), key=DAY, **site):
    models = {model: load_model(model)}
    recipe = load_anywhere({"person": "hit-uav-person", "car": "hit-uav-car"}[model], list(overrides))
    where = Site(pixels, labels, altitude_m=60.0, **site)
    return sample_scene(key, recipe, models, 1, where), recipe, models, where


@pytest.mark.parametrize("black_hot", [False, True])
def test_people_on_shaded_ground_have_no_sunlit_side(black_hot):
    dark = EVEN.copy()
    dark[:, :300] = 30  # less than half of the picture
    pixels = 255 - dark if black_hot else dark
    found = {}
    for k in range(12):
        (person,) = sampled("person", pixels, key=replace(DAY, background_id=f"f{k}"), black_hot=black_hot)[0].objects
        x = person.box_xyxy[[0, 2]].mean()
        if abs(x - 300) > 30:
            found.setdefault(person.spec.shaded, set()).add(bool(x < 300))
        _, high = person.part_sun_range_k["jacket"]
        assert not person.spec.shaded or high < 5
    assert found == {True: {True}, False: {False}}


def test_a_shadow_points_away_from_the_sun():
    sun = Sun(math.radians(90), math.radians(45), 800.0, 90.0)
    assert shadow_shift(sun, 0.0) == pytest.approx((0, -1))
    assert shadow_shift(sun, math.radians(90)) == pytest.approx((-1, 0))
    assert np.hypot(*shadow_shift(replace(sun, elevation_rad=0.01), 0.0)) < 4


def test_parked_cars_throw_a_shadow_that_no_label_counts():
    scene, recipe, models, site = sampled("car", EVEN, "objects.0.options={state: day_sun}")
    (car,) = scene.objects
    state = car.spec.parts["ground_shadow"]
    assert not state.label and state.glow and state.sun_k == 0
    assert state.temperature_k < scene.spec.weather.air_k
    plain = models["car"].build({k: v for k, v in car.spec.params.items() if k != "shadow_xy"})
    assert np.array_equal(car.mesh.triangles[: len(plain.triangles)], plain.triangles)
    shadow = car.mesh.vertices_m[len(plain.vertices_m) :]
    sun = scene.spec.weather.sun
    away = np.array(shadow_shift(sun, car.spec.yaw_rad))
    reach = (shadow[:, :2] @ away).max() - (plain.vertices_m[:, :2] @ away).max()
    assert reach > 0.5 * np.hypot(*away) and (shadow[:, 2] < 0.02).all()
    (again,) = rebuild_scene(scene.spec, models).objects
    assert again.mesh.vertices_m.tobytes() == car.mesh.vertices_m.tobytes()
    # At another place and heading the shadow still points away from the sun.
    (moved,) = RecipeSampler(recipe, models, 1).move(scene, [0], site, 1).objects
    assert moved.spec.params["shadow_xy"] == pytest.approx(shadow_shift(sun, moved.spec.yaw_rad))
    assert moved.spec.parts == car.spec.parts


def test_moving_cars_people_and_cars_by_night_throw_none():
    driven = sampled("car", EVEN, "objects.0.options={state: day_driven}")[0]
    night = sampled("car", key=with_facts(DAY, time_of_day="night"))[0]
    person = sampled("person")[0]
    for scene in (driven, night, person):
        assert all("ground_shadow" not in o.mesh.part_names for o in scene.objects)


def test_a_shadow_never_covers_annotated_objects():
    labels = tuple(
        Instance("Bicycle", np.array([x, y, x + 4, y + 4], np.float64))
        for x in range(0, 640, 44)
        for y in range(0, 512, 44)
    )
    for k in range(6):
        key = replace(DAY, background_id=f"f{k}")
        scene = sampled("car", EVEN, "objects.0.options={state: day_sun}", labels=labels, key=key)[0]
        for car in scene.objects:
            xy = car.xy[np.unique(car.mesh.triangles)]
            low, high = xy.min(axis=0), xy.max(axis=0)
            shadow = "ground_shadow" in car.mesh.part_names
            hit = any((low < i.box_xyxy[2:]).all() and (high > i.box_xyxy[:2]).all() for i in labels)
            assert not (shadow and hit)
