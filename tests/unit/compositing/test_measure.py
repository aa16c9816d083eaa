"""Defocus, motion tails, profile files, and the complete sensor chain."""

import io
import json
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image

from infrablend import api
from infrablend.compositing.mapping import GreyMapping
from infrablend.compositing.measure import edge_profiles, edge_sigma, flat_noise, true_grain
from infrablend.compositing.overlay import make_layer, motion_kernel
from infrablend.compositing.sensor import PIXEL_BOX_VARIANCE, SensorStrength, apply_sensor, fit_sensor, grain
from infrablend.config.loading import load_recipe
from infrablend.config.sensor_profile import PROFILES, Lens, SensorProfile, find_profile, read_profile
from infrablend.core.camera import CameraSpec
from infrablend.core.mesh import make_mesh
from infrablend.core.render import PlacedScene, RenderResult, place
from infrablend.core.scene import Appearance, ObjectSpec, SceneSpec, View
from infrablend.errors import RecipeError
from infrablend.formats.pictures.images import encode_image, load_background
from infrablend.pipeline.compose.frame import nearest_range_m

from .conftest import generate, overshoot, slanted_alpha

LEVELS = (16.0, 235.0)
GREY = GreyMapping(0.0, 255.0, (0.0, 255.0))


def rendered(shape=(20, 24), at=(100, 90), frame=(260, 240), level=0.7):
    """A soft-rimmed ellipse, off the pixel grid, as a renderer gives it."""
    h, w = shape
    y, x = np.mgrid[:h, :w]
    alpha = np.clip(6 - np.hypot((y - h / 2 + 0.3) * 1.2, x - w / 2 + 0.6), 0, 1).astype(np.float32)
    return RenderResult(at, frame, alpha * np.float32(level), alpha, alpha[None].copy())


def half_plane(size=256, low=60.0, high=140.0):
    """A slanted step that fills the frame, on a flat ground."""
    alpha = slanted_alpha(size)
    result = RenderResult((0, 0), (size, size), alpha * np.float32(high / 255), alpha, alpha[None].copy())
    noise = grain((size, size), 1.5, 1.05, 11)
    return np.clip(np.rint(low + noise), 0, 255).astype(np.uint8), result


def centroid(layer):
    y, x = np.mgrid[: layer.alpha.shape[0], : layer.alpha.shape[1]]
    a = layer.alpha.astype(np.float64)
    return (np.array([(a * x).sum(), (a * y).sum()]) / a.sum() + layer.offset_xy), a.sum()


def moments(kernel, motion):
    """Sum, mean, variance along and across, third moment along, of a kernel about its middle."""
    k, r = kernel.astype(np.float64), kernel.shape[0] // 2
    y, x = np.mgrid[-r : r + 1, -r : r + 1]
    turn = math.atan2(motion[1], motion[0])
    u, v = x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)
    return k.sum(), np.array([(k * x).sum(), (k * y).sum()]), (k * u * u).sum(), (k * v * v).sum(), (k * u**3).sum()


@pytest.mark.parametrize("length", [0.01, 0.5, 2.0, 5.0, 10.0])
@pytest.mark.parametrize("degrees", [0, 37, 90, 200, 315])
@pytest.mark.parametrize("sigma", [0.7, 0.85, 2.0])
def test_the_tail_is_one_sided_and_moves_nothing(length, degrees, sigma):
    motion = (length * math.cos(math.radians(degrees)), length * math.sin(math.radians(degrees)))
    kernel = motion_kernel(motion, sigma)
    total, mean, along, across, skew = moments(kernel, motion)
    assert total == pytest.approx(1, abs=1e-6)
    assert np.abs(mean).max() < 1e-4
    assert kernel.min() >= 0
    # Moments of a Gaussian plus those of an exponential; the cut end takes some percent of the higher ones.
    assert along == pytest.approx(sigma**2 + length**2, rel=0.08, abs=0.02)
    assert across == pytest.approx(sigma**2, rel=0.04, abs=0.02)
    assert skew == pytest.approx(2 * length**3, rel=0.25, abs=0.03)


@pytest.mark.parametrize("motion", [(1.0, 0.0), (-2.3, 1.1), (3.0, 4.0), (0.0, -10.0)])
def test_a_blurred_layer_stays_where_it_was(motion):
    still, moved = (make_layer(rendered(), GREY, 0.85, m) for m in ((0.0, 0.0), motion))
    (a, mass_a), (b, mass_b) = centroid(still), centroid(moved)
    assert np.abs(a - b).max() < 0.02
    assert mass_b == pytest.approx(mass_a, rel=1e-4)
    # Light reaches farther out on the tail's side than ahead of it.
    y, x = np.nonzero(moved.alpha > 0.004)
    way = ((x + moved.offset_xy[0] - b[0]) * motion[0] + (y + moved.offset_xy[1] - b[1]) * motion[1]) / math.hypot(
        *motion
    )
    assert way.max() > -way.min() + math.hypot(*motion)


def test_no_motion_is_the_gaussian_to_the_bit_and_little_motion_near_it():
    result = rendered()
    plain, same = make_layer(result, GREY, 0.85), make_layer(result, GREY, 0.85, (0.0, 0.0))
    assert np.array_equal(plain.alpha, same.alpha)
    little = make_layer(result, GREY, 0.85, (1e-3, 0.0))
    assert little.offset_xy == plain.offset_xy
    assert np.abs(little.alpha - plain.alpha).max() < 2e-3


def test_a_tail_at_the_frames_edge_darkens_nothing_and_stays_in_the_frame():
    alpha = np.ones((30, 20), np.float32)
    result = RenderResult((0, 0), (80, 30), alpha * np.float32(0.5), alpha, alpha[None].copy())
    layer = make_layer(result, GREY, 0.85, (0.0, 6.0))
    assert layer.offset_xy == (0, 0)
    assert layer.alpha.shape[0] == 30
    # It covers the frame from top to bottom: along its own middle nothing shows through.
    assert layer.alpha[:, :10].min() > 0.999
    seen = layer.alpha > 0.01
    assert np.allclose(layer.grey[seen] / layer.alpha[seen], 127.5, atol=0.1)


def test_defocus_follows_the_lens():
    """The table of the design's section 4.2: native pixels at 1, 2, 5, 10, 20, 50 m."""
    table = {
        (25.0, 1.1, 17.0): (33, 17, 6.7, 3.3, 1.7, 0.7),
        (13.5, 1.0, 12.0): (15, 7.6, 3.0, 1.5, 0.8, 0.3),
        (13.0, 1.25, 17.0): (8.0, 4.0, 1.6, 0.8, 0.4, 0.2),
        (9.1, 1.0, 12.0): (6.9, 3.5, 1.4, 0.7, 0.3, 0.1),
    }
    for (focal, number, pixel), discs in table.items():
        lens = Lens(focal_length_mm=focal, f_number=number, pixel_um=pixel)
        for range_m, disc in zip((1, 2, 5, 10, 20, 50), discs, strict=True):
            assert lens.blur_disc_px(range_m) == pytest.approx(disc, rel=0.03, abs=0.06)
    lens = PROFILES["hit-uav"].lens
    assert lens is not None
    assert lens.blur_disc_px(5) == pytest.approx(9, rel=0.05)


def test_defocus_adds_to_the_blur_of_near_objects_only():
    ground = half_plane()[0]

    def sigma(range_m, strength=1.0):
        return fit_sensor(
            ground, "hit-uav", SensorStrength(defocus=strength), LEVELS, 1, range_m=range_m
        ).layer_sigma_px(0.45)

    sharp = sigma(None)
    assert sharp == pytest.approx(math.sqrt(0.9**2 - PIXEL_BOX_VARIANCE), abs=1e-3)
    assert sigma(5.0) == pytest.approx(math.hypot(sharp, 2.34), abs=0.01)
    assert sigma(5.0, 0.0) == sharp
    assert sigma(200.0) == pytest.approx(sharp, abs=0.01)
    # Without optics it adds to the recipe's softness.
    off = fit_sensor(ground, "hit-uav", SensorStrength(optics=0), LEVELS, 1, range_m=10.0)
    assert off.layer_sigma_px(0.45) == pytest.approx(math.hypot(0.45, 46.8 / 10 / 4), abs=0.01)


def without_geometry(scene: SceneSpec) -> PlacedScene:
    mesh = make_mesh([("body", np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32), False)])
    return place(scene, [mesh] * len(scene.objects))


def test_the_range_is_that_of_the_nearest_object_and_of_the_real_camera_only():
    camera = CameraSpec(50.0, math.pi / 2, 0.0, 115.9, 36.0, (640, 512))
    objects = tuple(ObjectSpec("drone", "drone", {}, {}, (0.0, 0.0, z), 0.0) for z in (10.0, 30.0))
    scene = SceneSpec("train/a_c0", "a", "train", 0, camera, objects, 280.0, Appearance(), 0, 1)
    assert nearest_range_m(without_geometry(scene)) is None
    metric = replace(scene, view=View(50.0, 50.0, 0.0, {}, 0.1))
    assert nearest_range_m(without_geometry(metric)) == pytest.approx(20.0)
    assert nearest_range_m(without_geometry(replace(metric, objects=()))) is None


def test_disc_blur_is_close_to_its_gaussian():
    """An edge through the disc and the Gaussian, each with the other optics: within 1 % of the step at 15 m."""
    result = half_plane(128)[1]
    disc_px = PROFILES["hit-uav"].lens.blur_disc_px(15.0)
    fine = 8
    r = math.ceil(disc_px)
    y, x = (np.mgrid[: (2 * r + 1) * fine, : (2 * r + 1) * fine] + 0.5) / fine - r - 0.5
    disc = cv2.resize((np.hypot(x, y) < disc_px / 2).astype(np.float32), (2 * r + 1,) * 2, interpolation=cv2.INTER_AREA)
    through_disc = cv2.GaussianBlur(cv2.filter2D(result.alpha, -1, disc / disc.sum()), (0, 0), 0.85)
    through_gauss = cv2.GaussianBlur(result.alpha, (0, 0), math.hypot(0.85, disc_px / 4))
    assert np.abs(through_disc - through_gauss)[20:-20, 20:-20].max() < 0.012


# The figures of the design's section 8, through all of it: render, layer, fit, apply, save as the source is saved.


def through_all(tmp_path, *, halo=1.0, codec=1.0, motion=(0.0, 0.0)):
    ground, result = half_plane()
    path = tmp_path / "ground.jpg"
    Image.fromarray(ground).save(path, quality=95)
    background = load_background(path)
    strength = SensorStrength(halo=halo, codec=codec)
    fit = fit_sensor(background.pixels, "hit-uav", strength, LEVELS, 5)
    layer = make_layer(result, GREY, fit.layer_sigma_px(0.45), motion)
    data = encode_image(apply_sensor(background.pixels, layer, fit), background)
    return np.array(Image.open(io.BytesIO(data))), Image.open(io.BytesIO(data)).quantization[0]


def test_a_dead_pixel_hides_no_edges():
    """Levels above 255 over the darkest pixel were clipped before the search for edges."""
    stripes = np.where(np.arange(320) // 40 % 2, 22000, 20000).astype(np.uint16)
    picture = np.tile(stripes, (256, 1))
    dead = picture.copy()
    dead[100, 100] = 0
    (_, heights), (_, others) = (edge_profiles(p, scale=9.1) for p in (picture, dead))
    assert len(heights) > 1000 and len(others) > 0.9 * len(heights)
    assert np.median(others) == pytest.approx(np.median(heights), rel=0.01)


def test_a_slanted_step_through_the_whole_chain(tmp_path):
    picture, table = through_all(tmp_path)
    sigma, edges = edge_sigma(picture, percentile=50)
    assert edges > 100
    assert 0.55 <= sigma <= 0.75
    for side in overshoot(picture):
        assert 0.03 <= side <= 0.08
    assert list(table[:8]) == [2, 1, 1, 2, 2, 4, 5, 6]
    # What was unsharpened once is sharpened never: the chain's blur is the profile's own there.
    soft, _ = through_all(tmp_path, halo=0.0)
    assert max(overshoot(soft)) < 0.02


def test_the_chains_own_sigma_without_the_halo():
    ground, result = half_plane()
    profile = PROFILES["hit-uav"]
    layer = make_layer(result, GREY, math.sqrt(profile.psf_sigma_px**2 - PIXEL_BOX_VARIANCE))
    fit = fit_sensor(ground, "hit-uav", SensorStrength(optics=0, halo=0), LEVELS, 5)
    picture = apply_sensor(ground, layer, fit)
    assert 0.88 <= edge_sigma(picture, percentile=50)[0] <= 1.0


def test_the_grain_through_the_whole_chain():
    """On a ground whose grain reads 1.7 levels and 0.79 at lag 1, as HIT-UAV's does."""
    ground = np.clip(np.rint(90 + grain((320, 320), 1.9, 1.22, 4)), 0, 255).astype(np.uint8)
    noise, correlation, _ = flat_noise(ground, LEVELS)
    assert noise == pytest.approx(1.7, abs=0.1)
    assert correlation == pytest.approx(0.79, abs=0.02)
    alpha = np.ones((200, 200), np.float32)
    result = RenderResult((60, 60), (320, 320), alpha * np.float32(0.6), alpha, alpha[None].copy())
    fit = fit_sensor(ground, "hit-uav", SensorStrength(codec=0), LEVELS, 5)
    picture = apply_sensor(ground, make_layer(result, GREY, fit.layer_sigma_px(0.45)), fit).astype(np.float64)
    inside = picture[80:240, 80:240] - picture[80:240, 80:240].mean()
    assert 0.77 <= (inside[:, 1:] * inside[:, :-1]).mean() / inside.var() <= 0.82
    assert inside.std() == pytest.approx(noise, rel=0.15)
    assert flat_noise(picture[80:240, 80:240].astype(np.uint8), LEVELS)[0] == pytest.approx(noise, rel=0.15)


def test_true_grain_inverts_the_measurement():
    for sigma, size in ((1.7, 1.05), (1.2, 1.15), (2.5, 0.8)):
        read = []
        for seed in range(6):
            picture = np.clip(np.rint(90 + grain((320, 32), sigma, size, seed)), 0, 255).astype(np.uint8)
            # One block at a time: no choice of the flattest.
            read += [true_grain(*flat_noise(picture[y : y + 32], LEVELS)[:2], 1.0) for y in range(0, 320, 32)]
        assert np.mean(read, axis=0) == pytest.approx((sigma, size), rel=0.04)


@pytest.mark.parametrize("level", [-0.5, 1.6])
def test_levels_before_the_codec(level):
    ground = half_plane()[0]
    fit = fit_sensor(ground, "hit-uav", SensorStrength(codec=0), LEVELS, 5, range_m=12.0, motion_px=(2.0, 1.0))
    alpha = np.ones((60, 60), np.float32)
    result = RenderResult((80, 80), (256, 256), alpha * np.float32(level), alpha, alpha[None].copy())
    layer = make_layer(result, GreyMapping(0.0, 255.0, (-1e9, 1e9)), fit.layer_sigma_px(0.45), (2.0, 1.0))
    picture = apply_sensor(ground, layer, fit)
    assert picture.min() >= 16
    assert picture.max() <= 235


@pytest.mark.parametrize("at", [(100, 90), (0, 0), (236, 220)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_every_step_on_and_pixels_out_of_reach_keep_their_bits(at, dtype, tmp_path):
    """With defocus and a long tail: pixels beyond the layer and the halo equal the background, also in the PNG."""
    rng = np.random.default_rng(3)
    scale = 1 if dtype == np.uint8 else 100
    ground = (rng.integers(20, 250, (240, 260)) * scale).astype(dtype)
    levels = (LEVELS[0] * scale, LEVELS[1] * scale)
    fit = fit_sensor(ground, "hit-uav", SensorStrength(2, 2, 2, 2, True, 2), levels, 1, range_m=9.0)
    layer = make_layer(
        rendered(at=at), GreyMapping(0.0, 255.0 * scale, (0.0, 255.0 * scale)), fit.layer_sigma_px(0.45), (3.5, -2.0)
    )
    path = tmp_path / "ground.png"
    Image.fromarray(ground).save(path)
    background = load_background(path)
    assert background.pixels.dtype == dtype
    (tmp_path / "out.png").write_bytes(encode_image(apply_sensor(background.pixels, layer, fit), background, "png"))
    picture = load_background(tmp_path / "out.png").pixels
    (x, y), (h, w), reach = layer.offset_xy, layer.alpha.shape, 5 + 7
    away = np.ones(ground.shape, bool)
    away[max(y - reach, 0) : y + h + reach, max(x - reach, 0) : x + w + reach] = False
    assert 0.3 < away.mean() < 0.97
    assert np.array_equal(picture[away], ground[away])
    assert not np.array_equal(picture, ground)


def test_a_run_draws_and_records_the_motion(tmp_path):
    folder = tmp_path / "pictures"
    folder.mkdir()
    for n in range(2):
        grey = np.clip(np.rint(90 + grain((240, 320), 1.7, 1.05, n)), 0, 255).astype(np.uint8)
        Image.fromarray(grey).save(folder / f"{n}.png")

    still = generate(folder, tmp_path / "still", sensor_profile="hit-uav")
    moving = generate(folder, tmp_path / "moving", sensor_profile="hit-uav", sensor_motion_px=[2, 6])
    off = generate(folder, tmp_path / "off")
    with pytest.raises(RecipeError, match=r"sensor\.motion_px: .* only with a camera in sensor\.profile"):
        generate(folder, tmp_path / "none", sensor_motion_px=[2, 6])
    drawn = [r.scene.motion_px for r in moving]
    assert all(2 <= math.hypot(*m) <= 6 for m in drawn)
    assert len(set(drawn)) == len(drawn) == 4
    assert all(r.scene.motion_px == (0.0, 0.0) for r in (*still, *off))
    for a, b in zip(still, moving, strict=True):
        # The scene says where the object is on average: nothing else changes.
        assert all(x.equals(y) for x, y in zip(a.inserted, b.inserted, strict=True))
        assert a.scene.objects == b.scene.objects
        assert a.image_sha256 != b.image_sha256
        assert b.facts["sensor"]["speed_px_s"] == pytest.approx(100 * math.hypot(*b.scene.motion_px), abs=0.01)
        again = api.rerender(tmp_path / "moving", b.frame_id, tmp_path / "again.png", overwrite=True)
        of_run = Image.open(tmp_path / "moving" / "images" / b.image)
        assert np.array_equal(np.array(Image.open(again)), np.array(of_run))
        plain = b.scene.to_json()
        assert SceneSpec.from_json(json.loads(json.dumps(plain))) == b.scene
        del plain["motion_px"]
        assert SceneSpec.from_json(plain).motion_px == (0.0, 0.0)


def test_a_recipe_may_name_a_profile_file(tmp_path):
    mine = PROFILES["monet"].model_copy(update={"name": "mine", "levels": (10.0, 200.0), "codec_quality": None})
    (tmp_path / "mine.json").write_text(mine.model_dump_json())
    (tmp_path / "r.yaml").write_text("name: r\nobjects: [{model: drone}]\nsensor: {profile: mine.json}\n")
    recipe = load_recipe(tmp_path / "r.yaml")
    assert recipe.sensor.profile == mine
    assert type(recipe).model_validate_json(recipe.model_dump_json()) == recipe
    fit = fit_sensor(half_plane()[0], recipe.sensor.profile, SensorStrength(), LEVELS, 1)
    assert (fit.profile, fit.limits, fit.codec_quality) == ("mine", (10.0, 200.0), None)
    deep = fit_sensor(half_plane()[0].astype(np.uint16) * 50, mine, SensorStrength(), (800.0, 11750.0), 1)
    assert deep.limits == (800.0, 11750.0)


def test_wrong_profiles_are_reported(tmp_path):
    with pytest.raises(RecipeError, match=r"expected one of off, hit-uav, monet, generic-640x512, or the path of"):
        load_recipe("hit-uav-drone", ["sensor.profile=hit_uav"])
    with pytest.raises(RecipeError, match=r"none\.json: cannot be read.*one of the names hit-uav, monet"):
        load_recipe("hit-uav-drone", [f"sensor.profile={tmp_path / 'none.json'}"])
    with pytest.raises(RecipeError, match=r"'x': no such profile; expected one of hit-uav, monet"):
        find_profile("x")
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("{name: a, psf_sigma_px: 99, edge_bounds_px: [2, 1], noise_grey: 1, noise_grain_px: 1, lense: 3}")
    with pytest.raises(RecipeError) as caught:
        read_profile(wrong)
    assert {p.where for p in caught.value.problems} == {"psf_sigma_px", "edge_bounds_px", "lense"}
    (tmp_path / "list.json").write_text("[1, 2]")
    with pytest.raises(RecipeError, match="list"):
        read_profile(tmp_path / "list.json")


def test_profiles_survive_json():
    for p in PROFILES.values():
        assert SensorProfile.model_validate_json(p.model_dump_json()) == p
