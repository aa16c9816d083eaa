"""Overlay and grey mapping."""

import numpy as np
import pytest

from infrablend.compositing.mapping import GreyMapping, percentile_mapping
from infrablend.compositing.overlay import Bloom, blend, blur_radius_px, compose, flat_layer, make_layer
from infrablend.config.recipe import PercentileMatching
from infrablend.core.render import RenderResult


def result(radiance, alpha, offset=(0, 0), frame=(20, 16)):
    r, a = np.asarray(radiance, np.float32), np.asarray(alpha, np.float32)
    return RenderResult(offset, frame, r, a, a[None].copy())


def test_alpha_over_by_hand():
    background = np.full((16, 20), 100, np.uint8)
    # Half covered by radiance 1 -> premultiplied 0.5: half of the bright end plus half of the background.
    layer = make_layer(result([[0.5, 1.0, 0.0]], [[0.5, 1.0, 0.0]], (4, 2)), GreyMapping(20, 220), 0.0)
    picture = compose(background, layer)
    assert picture[2, 4:7].tolist() == [160, 220, 100]
    assert (np.delete(picture.ravel(), [2 * 20 + 4, 2 * 20 + 5]) == 100).all()
    assert (background == 100).all()


def test_uncovered_pixels_keep_their_value_to_the_bit():
    rng = np.random.default_rng(0)
    background = rng.integers(0, 65536, (16, 20), dtype=np.uint16)
    alpha = np.zeros((5, 5), np.float32)
    alpha[2, 2] = 0.7
    picture = compose(background, make_layer(result(alpha * 0.3, alpha, (6, 6)), GreyMapping(0, 60000), 0.6))
    reach = blur_radius_px(0.6)
    changed = np.argwhere(picture != background)
    assert len(changed)
    assert (np.abs(changed - 8) <= reach).all()
    assert picture.dtype == np.uint16


def test_blur_keeps_a_covered_frame_edge():
    """An object that fills the frame's corner is not thinned there by the blur."""
    alpha = np.ones((6, 6), np.float32)
    layer = make_layer(result(alpha * 0.5, alpha, (0, 0)), GreyMapping(0, 200), 1.0)
    picture = compose(np.zeros((16, 20), np.uint8), layer)
    assert picture[0, 0] == 100
    assert picture[2, 2] == 100
    assert 0 < picture[6, 2] < 100


def test_blur_conserves_light_away_from_the_edge():
    alpha = np.zeros((7, 7), np.float32)
    alpha[3, 3] = 1
    layer = make_layer(result(alpha * 0.8, alpha, (5, 5)), GreyMapping(0, 100), 0.45)
    assert layer.alpha.sum() == pytest.approx(1, abs=1e-5)
    assert layer.grey.sum() == pytest.approx(80, abs=1e-3)


def test_black_hot_is_the_mirror_of_white_hot():
    rng = np.random.default_rng(1)
    background = rng.integers(30, 220, (64, 64), dtype=np.uint8)
    white = percentile_mapping(background, PercentileMatching(low_percentile=1, high_percentile=99))
    black = percentile_mapping(
        background, PercentileMatching(low_percentile=1, high_percentile=99, polarity="black-hot")
    )
    assert (white.dark, white.bright) == (black.bright, black.dark)
    assert white.dark < white.bright


def test_flat_background_still_shows_objects():
    for level in (0, 128, 255):
        m = percentile_mapping(np.full((10, 10), level, np.uint8), PercentileMatching(min_span=0.35))
        assert m.bright - m.dark >= 0.35 * 255 - 1e-9
        assert m.dark >= -1e-9
        assert m.bright <= 255 + 1e-9


def test_values_saturate_instead_of_wrapping():
    alpha = np.ones((1, 1), np.float32)
    picture = compose(np.zeros((16, 20), np.uint8), make_layer(result(alpha * 2, alpha), GreyMapping(0, 255), 0))
    assert picture[0, 0] == 255
    picture = compose(np.zeros((16, 20), np.uint8), make_layer(result(alpha * -1, alpha), GreyMapping(0, 255), 0))
    assert picture[0, 0] == 0


def test_nothing_rendered_nothing_changed():
    background = np.arange(320, dtype=np.uint16).reshape(16, 20)
    empty = np.zeros((0, 0), np.float32)
    nothing = RenderResult((0, 0), (20, 16), empty, empty.copy(), np.zeros((1, 0, 0), np.float32))
    layer = make_layer(nothing, GreyMapping(0, 255), 0.45)
    assert (compose(background, layer) == background).all()
    assert blend(background, layer).size == 0


def test_flat_paste_is_one_level_for_each_object_with_a_hard_edge():
    alpha = np.array([[0.4, 1.0, 1.0, 0.6, 0.0, 0.3]], np.float32)
    shown = np.array([[0.1, 0.2, 0.4, 0.9, 0.0, 0.5]], np.float32)
    coverage = np.stack([np.where(np.arange(6) < 5, alpha, 0), np.where(np.arange(6) == 5, alpha, 0)]).astype(
        np.float32
    )
    r = RenderResult((4, 2), (20, 16), shown * alpha, alpha, coverage)
    picture = compose(np.full((16, 20), 7, np.uint8), flat_layer(r, GreyMapping(0, 200)))
    # Median of 40, 80 and 180 for the first; the second covers no pixel by half and gets the one it has.
    assert picture[2, 4:10].tolist() == [7, 80, 80, 80, 7, 100]
    assert (picture != 7).sum() == 4


@pytest.mark.parametrize(("dark", "bright", "added"), [(0.0, 200.0, 8), (220.0, 20.0, -8)])
@pytest.mark.parametrize("softness_px", [0.0, 0.6])
def test_warmed_ground_adds_the_same_light_to_dark_and_bright_ground(dark, bright, added, softness_px):
    background = np.full((16, 20), 40, np.uint8)
    background[:, 10:] = 150
    alpha = np.full((10, 14), 0.4, np.float32)  # ground at 0.5 that is warmed to 0.6, as seen through 40 % of the sheet
    light = RenderResult((3, 3), (20, 16), alpha * np.float32(0.6), alpha, np.zeros((1, 10, 14), np.float32), 0.5)
    layer = make_layer(light, GreyMapping(dark, bright), softness_px)
    assert (layer.alpha == 0).all()
    change = compose(background, layer).astype(int) - background
    assert (change[6:10, 6:14] == added).all()
    covering = RenderResult((3, 3), (20, 16), light.radiance, alpha, light.coverage)
    change = compose(background, make_layer(covering, GreyMapping(dark, bright), 0.0)).astype(int) - background
    assert change[8, 6] != change[8, 14]


def test_an_object_on_warmed_ground_hides_it():
    coverage = np.zeros((1, 4, 4), np.float32)
    coverage[0, 1:3, 1:3] = 1
    solid = coverage[0]
    alpha = solid + 0.5 * (1 - solid)
    light = RenderResult((2, 2), (20, 16), 0.9 * solid + 0.3 * 0.5 * (1 - solid), alpha, coverage, 0.2)
    picture = compose(np.full((16, 20), 60, np.uint8), make_layer(light, GreyMapping(0, 200), 0.0))
    expected = np.full((4, 4), 70)
    expected[1:3, 1:3] = 180
    np.testing.assert_array_equal(picture[2:6, 2:6], expected)


@pytest.mark.parametrize("odd", [0, 65535])
def test_one_odd_pixel_of_a_16_bit_picture_does_not_spread_its_levels(odd):
    picture = np.random.default_rng(0).uniform(28500, 30500, (512, 640)).astype(np.uint16)
    spoilt = picture.copy()
    spoilt[100, 100] = odd
    one, other = (
        percentile_mapping(p, PercentileMatching(low_percentile=40, high_percentile=60)) for p in (picture, spoilt)
    )
    assert (other.dark, other.bright) == (pytest.approx(one.dark, abs=5), pytest.approx(one.bright, abs=5))


def test_bloom_spreads_light_around_an_object_and_keeps_its_sum():
    alpha = np.zeros((41, 41), np.float32)
    alpha[18:23, 18:23] = 1
    sharp, glowing = (
        make_layer(result(alpha, alpha, frame=(41, 41)), GreyMapping(0, 1000), 0.6, bloom=bloom)
        for bloom in (Bloom(), Bloom(0.2, 3.0))
    )
    assert glowing.grey.sum() == pytest.approx(sharp.grey.sum(), rel=1e-3)
    middle = glowing.grey[20]
    # Four pixels beside the object, where the blur does not reach, is a glow that decreases outwards.
    assert sharp.grey[20, 27] < 1 < middle[27] and middle[24] > middle[26] > middle[28] > 0
    assert glowing.grey[20, 20] < sharp.grey[20, 20]
