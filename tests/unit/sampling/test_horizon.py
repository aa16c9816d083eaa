"""The camera's pitch from the horizon in the picture, and inserts that are moved to other places."""

import math

import numpy as np
import pytest

from infrablend.assets.catalogue import load_model
from infrablend.compositing.behind import elevations
from infrablend.config.loading import load_recipe
from infrablend.core.capture import Capture
from infrablend.sampling.scene_sampler import RecipeSampler, sample_scene
from infrablend.sampling.site import FrameKey, Site

WH = (320, 256)
ALONE = {f"objects.{n}.count": 0 for n in (1, 2, 3)}  # no birds and aircraft


def sky(row=190, noise=1.5):
    rng = np.random.default_rng(0)
    levels = np.where(np.arange(WH[1])[:, None] < row, 97, 220) + rng.normal(0, noise, WH[::-1])
    return np.clip(levels, 0, 255).round().astype(np.uint8)


def draw(pixels, settings=(), name="a", pitch_deg=None, **site):
    recipe = load_recipe("drone-sky-halmstad", {"objects.0.count": 1, **ALONE, **dict(settings)})
    models = {o.model: load_model(o.model) for o in recipe.objects}
    place = Site(pixels, max_noise_grey=recipe.placement.max_noise_grey, **site)
    key = FrameKey(name, "train", 0, WH, Capture(pitch_deg=pitch_deg))
    return sample_scene(key, recipe, models, 1, place), recipe, models, place


def test_the_pitch_puts_the_horizon_where_the_picture_has_it():
    scene, *_ = draw(sky(190))
    elevation = elevations(scene.spec.camera)
    row = int(np.argmin(np.abs(elevation[:, 160])))
    assert row == pytest.approx(190, abs=4)
    assert scene.spec.camera.pitch_rad < 0


def test_black_hot_pictures_have_a_horizon_too():
    white, *_ = draw(sky(190))
    black, *_ = draw(255 - sky(190), black_hot=True)
    assert black.spec.camera.pitch_rad == pytest.approx(white.spec.camera.pitch_rad, abs=math.radians(0.5))


def test_sky_alone_has_its_horizon_below_the_picture():
    for n in range(8):
        scene, *_ = draw(sky(400), name=f"s{n}")
        # The lower corners are at most half of the width times the sine of the roll lower than the middle of the edge.
        roll = abs(scene.spec.camera.roll_rad)
        assert elevations(scene.spec.camera).min() >= -math.tan(math.radians(12)) * math.sin(roll) - 1e-6
        assert -16 <= math.degrees(scene.spec.camera.pitch_rad) <= -8


def test_without_any_horizon_nothing_is_inserted_and_the_reason_is_counted():
    scene, *_ = draw(sky(400), {"camera.pitch": {"from_horizon": True}})
    assert not scene.objects
    assert scene.spec.draws["absent"] == {"no_horizon": 1}
    assert scene.spec.draws["wanted"] == 1


def test_nothing_is_inserted_into_pure_noise():
    scene, *_ = draw(sky(400, noise=40))
    assert not scene.objects
    assert scene.spec.draws["absent"] == {"noise": 1}


def test_moved_objects_keep_shape_and_temperature():
    scene, recipe, models, site = draw(sky(), {"objects.0.count": 3})
    assert len(scene.objects) == 3
    moved = RecipeSampler(recipe, models, 1).move(scene, [1], site, 1)
    assert moved.objects[0].spec == scene.objects[0].spec
    assert moved.objects[2].spec == scene.objects[2].spec
    old, new = scene.objects[1].spec, moved.objects[1].spec
    assert (new.params, new.parts, new.scale) == (old.params, old.parts, old.scale)
    assert new.position_m != old.position_m
    assert moved.spec.draws["moved"] == 1
    again = RecipeSampler(recipe, models, 1).move(scene, [1], site, 1)
    assert again.spec == moved.spec
    assert RecipeSampler(recipe, models, 1).move(scene, [1], site, 2).objects[1].spec.position_m != new.position_m


def test_a_known_pitch_comes_before_the_horizon_and_the_record_says_so():
    found, *_ = draw(sky(190))
    known, *_ = draw(sky(190), pitch_deg=-12.5)
    assert math.degrees(known.spec.camera.pitch_rad) == pytest.approx(-12.5)
    stated, *_ = draw(sky(400))
    nothing, *_ = draw(sky(400), {"camera.pitch": {"from_horizon": True}})
    assert [s.spec.draws["pitch_from"] for s in (found, known, stated, nothing)] == [
        "horizon",
        "metadata",
        "recipe",
        "nothing",
    ]
