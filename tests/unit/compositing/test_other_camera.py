"""A finished picture as another camera shows it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from infrablend.compositing.other_camera import OtherCamera
from infrablend.config.recipe import Randomise

NEUTRAL = OtherCamera(0.0, 0.0, 1.0, 0.0, 7, 0.0, False, 8)


def picture(dtype=np.uint8):
    """Noise around 100 with a warm square of 40 px."""
    levels = np.random.default_rng(0).normal(100, 3, (64, 80))
    levels[20:40, 30:50] += 80
    return np.rint(levels * (1 if dtype == np.uint8 else 200)).astype(dtype)


def test_a_neutral_camera_changes_nothing_and_is_the_default():
    before = picture()
    assert (NEUTRAL.take(before) == before).all()
    drawn = OtherCamera.draw(Randomise(), 1.0, np.random.default_rng(1))
    assert replace(drawn, noise_seed=7, stripes_seed=0, vignette_power=2.0) == NEUTRAL
    assert OtherCamera.from_json(drawn.to_json()) == drawn


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_each_step_does_what_it_says(dtype):
    before, unit = picture(dtype), 1.0 if dtype == np.uint8 else 200.0
    camera = replace(NEUTRAL, grey_unit=unit)
    square, around = (slice(25, 35), slice(35, 45)), (slice(0, 12), slice(0, 80))

    def contrast(pixels):
        return (pixels[square].mean() - pixels[around].mean()) / unit

    assert contrast(replace(camera, gain=0.5).take(before)) == pytest.approx(contrast(before) / 2, abs=1)
    assert contrast(replace(camera, inverted=True).take(before)) == pytest.approx(-contrast(before), abs=0.01)
    noisy = replace(camera, noise_grey=12.0).take(before)
    assert noisy[around].std() / unit == pytest.approx(np.hypot(12, 3), rel=0.15)
    # A soft edge reaches further, light is kept; a halo darkens the ground just beside the square.
    column = before[30].astype(float) / unit
    blurred = replace(camera, blur_px=2.0).take(before)[30].astype(float) / unit
    assert blurred[28] > column[28] + 8 and blurred.sum() == pytest.approx(column.sum(), rel=0.02)
    bloomed = replace(camera, bloom=0.3).take(before)[30].astype(float) / unit
    assert bloomed[27] > column[27] + 2 and bloomed[40] < column[40]
    assert replace(camera, halo=1.0).take(before)[20:40, 28].mean() / unit < 95
    assert len(np.unique(replace(camera, bits=4).take(before))) <= 16
    corners = replace(camera, vignette_grey=-30.0, vignette_power=8.0).take(before).astype(float) / unit
    assert corners[0, 0] == pytest.approx(before[0, 0] / unit - 30, abs=1)
    assert corners[32, 28] == pytest.approx(before[32, 28] / unit, abs=1)
    stripes = replace(camera, stripes_grey=9.0)
    assert (stripes.take(before) == replace(stripes, noise_seed=99).take(before)).all()
    assert (stripes.take(before) != replace(stripes, stripes_seed=99).take(before)).any()
    striped = stripes.take(before)[:12].astype(float) / unit
    assert striped.mean(axis=0).std() == pytest.approx(9, rel=0.3) and striped.std(axis=0).mean() < 4
    assert all(replace(camera, gain=2.0).take(before).dtype == dtype for _ in range(2))


def test_draws_lie_in_their_ranges_and_repeat():
    rules = Randomise(blur_px=(0.5, 1.5), gain=(0.6, 1.6), noise_grey=(0, 6), invert=0.5, bits=(4, 8))
    drawn = [OtherCamera.draw(rules, 1.0, np.random.default_rng(k)) for k in range(60)]
    assert drawn == [OtherCamera.draw(rules, 1.0, np.random.default_rng(k)) for k in range(60)]
    assert all(0.5 <= c.blur_px <= 1.5 and 0.6 <= c.gain <= 1.6 and 4 <= c.bits <= 8 for c in drawn)
    assert {c.bits for c in drawn} == {4, 5, 6, 7, 8} and 15 < sum(c.inverted for c in drawn) < 45


def test_some_pictures_stay_as_they_are():
    rules = Randomise(share=0.5, gain=(0.5, 0.6))
    drawn = [OtherCamera.draw(rules, 1.0, np.random.default_rng(k)) for k in range(60)]
    kept = [c for c in drawn if c.gain == 1.0]
    assert 15 < len(kept) < 45 and all((c.take(picture()) == picture()).all() for c in kept)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_graphics_stay_clear_of_objects_and_repeat(dtype):
    before = np.full((256, 320), 100, dtype)
    before[-1, -1] = 255  # 16-bit graphics are between the levels of the picture
    objects = np.random.default_rng(1).uniform(0, 1, (12, 4)) * [300, 236, 12, 12]
    objects[:, 2:] += objects[:, :2] + 2
    near = np.zeros(before.shape, np.bool_)
    for x0, y0, x1, y1 in objects:
        near[max(int(y0) - 1, 0) : int(y1) + 2, max(int(x0) - 1, 0) : int(x1) + 2] = True
    changed = 0
    for seed in range(40):
        camera = replace(NEUTRAL, graphics_seed=seed).clear_of(objects)
        taken = camera.take(before)
        assert (taken == OtherCamera.from_json(json.loads(json.dumps(camera.to_json()))).take(before)).all()
        assert (taken[near] == 100).all()
        changed += bool((taken != before).any())
        # Graphics have the sharp edges and extreme levels of what is burnt in, and leave most of the scene.
        assert (taken != before).mean() < 0.35
    assert changed > 30


def test_graphics_leave_the_levels_of_16_bit_pictures_to_the_scene():
    before = np.random.default_rng(0).integers(7000, 8000, (256, 320), np.uint16)
    for seed in range(20):
        taken = replace(NEUTRAL, graphics_seed=seed).take(before)
        assert before.min() <= taken.min() and taken.max() <= before.max()
