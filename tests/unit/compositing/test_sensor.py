"""The sensor chain: slanted edges, grain, no change outside the insert, same bytes."""

import math
from typing import get_args

import cv2
import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.assets.catalogue import load_model
from infrablend.compositing.mapping import GreyMapping
from infrablend.compositing.measure import (
    edge_sigma,
    flat_noise,
    grain_of,
    sharpened_sigma,
    unsharpened_sigma,
)
from infrablend.compositing.overlay import Layer, compose, make_layer
from infrablend.compositing.sensor import (
    PIXEL_BOX_VARIANCE,
    Sensor,
    SensorStrength,
    apply_sensor,
    enhance,
    fit_sensor,
    grain,
    unsharpen,
)
from infrablend.config.loading import list_recipes, load_recipe
from infrablend.config.recipe import Sensor as SensorFields
from infrablend.config.sensor_profile import PROFILES
from infrablend.core.render import RenderResult
from infrablend.rendering.flat import FlatRenderer
from infrablend.sampling.scene_sampler import rebuild_scene

from .conftest import generate, slanted_alpha

LEVELS = (16.0, 235.0)
OFF = SensorStrength(0, 0, 0, 0, clip=False)


def slanted(sigma_px, low=60.0, high=140.0, size=256):
    """A blurred half-plane of alpha: an edge as the chain's optics give it."""
    alpha = cv2.GaussianBlur(slanted_alpha(size), (0, 0), math.sqrt(sigma_px**2 - PIXEL_BOX_VARIANCE))
    return np.full((size, size), round(low), np.uint8), Layer((0, 0), alpha * np.float32(high), alpha)


def through(gain, noise=1.5, codec=None, sigma=0.9, levels=LEVELS, high=140.0):
    ground, layer = slanted(sigma, high=high)
    return apply_sensor(ground, layer, Sensor("hit-uav", None, gain, 1.6, noise, 1.05, 7, levels, codec))


def blob(shape=(40, 40), at=(70, 61), grey=200.0):
    y, x = np.mgrid[: shape[0], : shape[1]] - np.array(shape).reshape(2, 1, 1) / 2
    alpha = np.clip(12.5 - np.hypot(y, x), 0, 1).astype(np.float32)
    return Layer(at, alpha * np.float32(grey), alpha)


def background(seed=0, noise=1.7, size=(160, 200)):
    rng = np.random.default_rng(seed)
    ramp = np.linspace(80, 120, size[1])[None, :] + grain(size, noise, 1.05, int(rng.integers(2**31)))
    return np.clip(np.rint(ramp), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("sigma", [0.6, 0.8, 1.0, 1.3])
def test_edges_are_measured_without_bias(sigma):
    """The middle reading of one edge is right within 0.06 px; the sharpest fifth, used for scenes, up to 0.15 less."""
    ground, layer = slanted(sigma)
    picture = compose(ground, layer)
    assert edge_sigma(picture, percentile=50)[0] == pytest.approx(sigma, abs=0.06)
    assert sigma - 0.15 <= edge_sigma(picture)[0] <= sigma + 0.02


def test_sharpening_can_be_undone():
    for sigma in (0.7, 0.9, 1.3):
        seen = sharpened_sigma(sigma, 0.6, 1.6)
        assert seen < sigma
        assert unsharpened_sigma(seen, 0.6, 1.6) == pytest.approx(sigma, abs=1e-3)
    assert 0.55 <= sharpened_sigma(0.9, 0.6, 1.6) <= 0.60
    assert unsharpened_sigma(0.7, 0.0, 1.6) == 0.7


def test_sharpening_of_a_picture_can_be_undone():
    picture = background().astype(np.float64)
    assert np.abs(enhance(unsharpen(picture, 0.6, 1.6), 0.6, 1.6) - picture).max() < 0.01


def test_a_textured_background_does_not_shine_through_an_insert():
    ground = np.random.default_rng(2).integers(60, 160, (120, 120)).astype(np.uint8)
    alpha = np.ones((60, 60), np.float32)
    picture = apply_sensor(ground, Layer((30, 30), alpha * 110, alpha), Sensor("hit-uav", None, 0.6))
    assert np.ptp(picture[44:76, 44:76].astype(int)) <= 2


def test_an_insert_gets_the_sharpness_of_its_background():
    """Soft pictures get soft inserts: after blur and sharpening, an insert is as sharp as its background."""
    found = []
    for sigma in (0.6, 0.75):
        ground, layer = slanted(sigma)
        picture = compose(ground, layer)
        fit = fit_sensor(picture, "hit-uav", SensorStrength(noise=0, codec=0), LEVELS, 1)
        found.append(fit.blur_sigma_px)
        ground, layer = slanted(math.sqrt(fit.blur_sigma_px**2 + PIXEL_BOX_VARIANCE))
        again = apply_sensor(ground, layer, fit)
        assert edge_sigma(again)[0] == pytest.approx(edge_sigma(picture)[0], abs=0.1)
    assert found[0] < found[1] - 0.07


def test_a_scene_softer_than_its_camera_does_not_blur_the_insert_beyond_the_profile():
    fit = fit_sensor(compose(*slanted(2.0)), "hit-uav", SensorStrength(), LEVELS, 1)
    assert fit.edge_sigma_px > 1.5
    assert fit.blur_sigma_px < 1.1


def test_a_background_without_edges_gets_the_profiles_blur():
    fit = fit_sensor(background(), "hit-uav", SensorStrength(), LEVELS, 1)
    assert fit.edge_sigma_px is None
    assert math.hypot(fit.blur_sigma_px, math.sqrt(PIXEL_BOX_VARIANCE)) == pytest.approx(0.9, abs=1e-3)


def test_grain_has_the_measured_strength_and_correlation():
    n = grain((400, 400), 1.7, 1.05, 3)
    assert n.std() == pytest.approx(1.7, rel=0.03)
    for a, b in ((n[:, 1:], n[:, :-1]), (n[1:], n[:-1])):
        assert 0.77 <= (a * b).mean() / n.var() <= 0.82
    assert grain_of(math.exp(-1 / (4 * 1.05**2))) == pytest.approx(1.05)


def test_grain_is_recovered_without_clipped_areas():
    picture = background(noise=2.0, size=(320, 320))
    picture[:64, :64] = 235
    noise, correlation, blocks = flat_noise(picture, LEVELS)
    assert noise == pytest.approx(2.0, rel=0.15)
    assert 0.72 <= correlation <= 0.82
    assert blocks == 5
    assert flat_noise(np.full((64, 64), 235, np.uint8), LEVELS) == (None, None, 0)
    fit = fit_sensor(np.full((64, 64), 235, np.uint8), "hit-uav", SensorStrength(), LEVELS, 1)
    assert fit.noise_grey == PROFILES["hit-uav"].noise_grey


def test_an_inserts_grain_is_that_of_its_background():
    """Deviation inside an insert of one level against the flat background's: within 30 %, codec included."""
    ground = background(noise=1.7, size=(320, 320))
    alpha = np.ones((96, 96), np.float32)
    fit = fit_sensor(ground, "hit-uav", SensorStrength(), LEVELS, 5)
    picture = apply_sensor(ground, Layer((100, 100), alpha * 150, alpha), fit)
    inside = [flat_noise(picture[y : y + 32, x : x + 32], LEVELS)[0] for y in (108, 140) for x in (108, 140)]
    assert 0.7 <= np.median(inside) / flat_noise(ground, LEVELS)[0] <= 1.3


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_strength_0_is_the_plain_overlay(dtype):
    ground = background().astype(dtype) * (1 if dtype == np.uint8 else 100)
    fit = fit_sensor(ground, "hit-uav", OFF, LEVELS, 1)
    assert fit.blur_sigma_px is None
    layer = blob(grey=200.0 if dtype == np.uint8 else 20000.0)
    assert np.array_equal(apply_sensor(ground, layer, fit), compose(ground, layer))


@pytest.mark.parametrize("at", [(70, 61), (0, 0), (160, 120)])
def test_pixels_out_of_reach_keep_their_bits(at):
    ground = background()
    ground[::7, ::5] = 250  # beyond the limits: not the insert's business
    layer = blob(at=at)
    picture = apply_sensor(ground, layer, fit_sensor(ground, "hit-uav", SensorStrength(), LEVELS, 1))
    x, y = at
    reach = 5 + 7  # the halo's, and the rest of an 8 px block
    away = np.ones(ground.shape, bool)
    away[max(y - reach, 0) : y + 40 + reach, max(x - reach, 0) : x + 40 + reach] = False
    assert np.array_equal(picture[away], ground[away])
    assert not np.array_equal(picture, ground)
    # Untouched are whole blocks of the codec's grid, nothing smaller.
    blocks = (picture != ground).reshape(20, 8, 25, 8).any(axis=(1, 3))
    assert blocks.sum() <= ((40 + 2 * reach) // 8 + 1) ** 2


@pytest.mark.parametrize(("ground", "shown"), [(60, 160), (140, 40), (100, 200)])
def test_on_even_ground_an_insert_changes_little_beside_it(ground, shown):
    """A square that differs by 100 levels: real objects of that contrast change the ground 8 px away by 2 levels."""
    worst = np.zeros(4)
    for at in range(8):
        background = np.full((96, 96), ground, np.uint8)
        square = np.ones((17, 23), np.float32)
        result = RenderResult((36 + at, 36), (96, 96), square * (shown / 255), square, square[None])
        sensor = fit_sensor(background, "hit-uav", SensorStrength(), LEVELS, at, range_m=80.0)
        picture = apply_sensor(background, make_layer(result, GreyMapping(0, 255), sensor.layer_sigma_px(0.45)), sensor)
        away = np.ones_like(background)
        away[36:53, 36 + at : 59 + at] = 0
        away_px, change = cv2.distanceTransform(away, cv2.DIST_C, 3), cv2.absdiff(picture, background)
        worst = np.maximum(worst, [change[away_px > px].max() for px in (2, 4, 8, 12)])
    assert (worst <= [20, 12, 5, 0]).all(), worst


def test_levels_stay_within_the_limits_before_the_codec_and_ring_after_it():
    hot = through(0.6, high=400.0)
    assert hot.max() == 235
    assert through(0.6, high=-300.0).min() == 16
    assert through(0.6, high=400.0, levels=None).max() == 255
    assert 235 < through(0.6, high=400.0, codec=68).max() < 255


def test_the_same_seed_gives_the_same_bytes_and_another_one_other_grain():
    ground, layer = background(), blob()
    pictures = [
        apply_sensor(ground, layer, fit_sensor(ground, "hit-uav", SensorStrength(), LEVELS, seed)) for seed in (1, 1, 2)
    ]
    assert np.array_equal(pictures[0], pictures[1])
    assert not np.array_equal(pictures[0], pictures[2])


def test_black_hot_is_white_hot_turned_over():
    """Same blur, grain and, but for rounding, the same picture (without the codec, whose rounding is its own)."""
    ground = background(size=(320, 320))
    ground[200:260, 50:120] += 80
    turned = (251 - ground).astype(np.uint8)
    steps = SensorStrength(noise=0, codec=0)
    layer = blob()
    other = Layer(layer.offset_xy, np.float32(251) * layer.alpha - layer.grey, layer.alpha)
    fit, fit_turned = (fit_sensor(g, "hit-uav", steps, LEVELS, 1) for g in (ground, turned))
    assert fit.edges > 0
    assert fit_turned.blur_sigma_px == pytest.approx(fit.blur_sigma_px, abs=0.02)
    assert flat_noise(turned, LEVELS)[0] == pytest.approx(flat_noise(ground, LEVELS)[0])
    a, b = apply_sensor(ground, layer, fit).astype(int), apply_sensor(turned, other, fit).astype(int)
    assert np.abs(a + b - 251).max() <= 1


def test_16_bit_goes_through_all_but_the_codec():
    ground = background(size=(320, 320)).astype(np.uint16) * 100
    fit = fit_sensor(ground, "hit-uav", SensorStrength(), (1600.0, 23500.0), 1)
    assert fit.codec_quality is None
    assert 100 <= fit.noise_grey <= 250
    picture = apply_sensor(ground, blob(grey=40000.0), fit)
    assert picture.dtype == np.uint16
    assert picture.max() == 23500


def test_a_record_keeps_the_whole_chain():
    fit = fit_sensor(background(), "monet", SensorStrength(codec=2), LEVELS, 9)
    assert fit.codec_quality == 50
    assert Sensor.from_json(fit.to_json()) == fit
    assert Sensor.from_json(Sensor("hit-uav").to_json()) == Sensor("hit-uav")


def test_the_recipe_names_the_profiles_there_are():
    names, _ = get_args(SensorFields.model_fields["profile"].annotation)
    assert set(get_args(names)) == {*PROFILES}


def test_nothing_to_lay_over():
    ground = background()
    empty = Layer((0, 0), np.zeros((0, 0), np.float32), np.zeros((0, 0), np.float32))
    assert np.array_equal(apply_sensor(ground, empty, Sensor("hit-uav")), ground)


@pytest.fixture
def pictures(tmp_path):
    """Two backgrounds with grain and an edge, in a plain folder."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    for n in range(2):
        grey = background(n, size=(240, 320))
        grey[150:, 200:] += 70
        Image.fromarray(cv2.GaussianBlur(grey, (0, 0), 0.7)).save(folder / f"{n}.png")
    return folder


def made(pictures, out, **settings):
    return [(r, np.array(Image.open(out / "images" / r.image))) for r in generate(pictures, out, **settings)]


def test_the_papers_recipes_do_without_and_give_the_plain_overlay(pictures, tmp_path):
    for name in list_recipes():
        recipe = load_recipe(name)
        assert (recipe.sensor.profile == "off") == (recipe.placement.mode == "paper"), name
    models = {"drone": load_model("drone")}
    for record, picture in made(pictures, tmp_path / "off"):
        assert "sensor" not in record.facts
        assert record.scene is not None
        assert record.mapping is not None
        below = np.array(Image.open(pictures / f"{record.background['id'].split('/')[-1]}.png"))
        result = FlatRenderer().render(rebuild_scene(record.scene, models))
        layer = make_layer(result, GreyMapping.from_json(record.mapping), 0.45)
        assert np.array_equal(picture, compose(below, layer))


def test_a_run_with_the_sensor_has_the_same_labels_and_can_be_made_again(pictures, tmp_path):
    off = made(pictures, tmp_path / "off")
    on = made(pictures, tmp_path / "on", sensor_profile="hit-uav")
    assert len(on) == 4
    for (a, before), (b, after) in zip(off, on, strict=True):
        assert all(x.equals(y) for x, y in zip(a.inserted, b.inserted, strict=True))
        assert not np.array_equal(before, after)
        facts = b.facts["sensor"]
        assert facts["edges"] > 20
        assert 0.3 < facts["blur_sigma_px"] < 1.3
        assert facts["flat_blocks"] == 5
    assert on[0][0].facts["sensor"]["noise_seed"] != on[1][0].facts["sensor"]["noise_seed"]
    for record, picture in on:
        again = api.rerender(tmp_path / "on", record.frame_id, tmp_path / "again.png", overwrite=True)
        assert np.array_equal(np.array(Image.open(again)), picture)


def test_a_run_with_all_strengths_0_is_one_without_the_sensor(pictures, tmp_path):
    none = {f"sensor_{k}": 0 for k in ("optics", "halo", "noise", "codec")}
    off = made(pictures, tmp_path / "off")
    zero = made(pictures, tmp_path / "zero", sensor_profile="hit-uav", sensor_clip=False, **none)
    for (_, a), (_, b) in zip(off, zero, strict=True):
        assert np.array_equal(a, b)


def test_saturated_objects_have_hard_edges_if_they_are_cut_off_last():
    """Levels far above the range are blurred and then cut off, as in a camera; cut off first, the edge stays soft."""
    y, x = np.mgrid[:64, :64] - 31.5
    alpha = (np.hypot(x, y) < 12).astype(np.float32)
    result = RenderResult((0, 0), (64, 64), alpha, alpha, alpha[None])
    background, widths = np.full((64, 64), 60, np.uint8), []
    for headroom in (0.0, 2.0):
        beyond = headroom * 255
        mapping = GreyMapping(60.0, 700.0, (0 - beyond, 255 + beyond))
        layer = make_layer(result, mapping, 1.0)
        picture = apply_sensor(background, layer, Sensor("none", 1.0, limits=(0.0, 255.0))).astype(float)
        line = (picture[32, 32:] - 60) / (picture[32, 32] - 60)
        widths.append(np.interp(-0.1, -line, np.arange(32)) - np.interp(-0.9, -line, np.arange(32)))
        assert picture[32, 32] == 255
    assert widths[1] < 0.75 * widths[0]
