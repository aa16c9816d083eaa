"""Where real objects stand: inserted ones look for ground of the same level and clutter."""

import numpy as np
import pytest

from infrablend.assets.catalogue import load_model
from infrablend.config.recipe import RealGround
from infrablend.core.capture import Capture
from infrablend.core.dataset import Instance
from infrablend.errors import RecipeError
from infrablend.sampling.real_ground import draw_aim, ground_around
from infrablend.sampling.scene_sampler import sample_scene
from infrablend.sampling.site import FrameKey, Site
from tests.recipes import load_anywhere

WH = (640, 512)
CLUTTERED = "{level_grey: [-5, -1, 0, 1, 5], clutter_grey: [8, 9, 10, 11, 12]}"
EVEN = "{level_grey: [-5, -1, 0, 1, 5], clutter_grey: [0, 0, 1, 2, 3]}"


def lawn_and_car_park():
    """A picture with the same median everywhere: even on the left, with stripes of +-6 to +-14 levels on the right."""
    pixels = np.full(WH[::-1], 120.0)
    pixels[:, 320:] += np.linspace(6, 14, 320) * np.tile([1, 1, -1, -1], 80)
    pixels[:, :320] += np.linspace(0, 3, 320) * np.tile([1, 1, -1, -1], 80)
    return pixels.round().astype(np.uint8)


def places(ground, pixels, count=8, time_of_day="day", black_hot=False):
    """Return the horizontal places of people and the reasons for which draws were rejected."""
    overrides = ["placement.max_relief_grey=0"]
    recipe = load_anywhere(
        "hit-uav-person", overrides + [f"placement.ground={{{time_of_day}: {ground}}}"] * bool(ground)
    )
    models = {"person": load_model("person")}
    x, rejected = [], {}
    for k in range(count):
        key = FrameKey(f"f{k}", "train", 0, WH, Capture(pitch_deg=60.0, time_of_day=time_of_day))
        site = Site(pixels, altitude_m=60.0, black_hot=black_hot, time_of_day=time_of_day)
        scene = sample_scene(key, recipe, models, 1, site)
        x += [o.box_xyxy[[0, 2]].mean() for o in scene.objects]
        for reason, n in scene.spec.draws["rejected"].items():
            rejected[reason] = rejected.get(reason, 0) + n
    return np.array(x), rejected


@pytest.mark.parametrize("time_of_day", ["day", "night"])
def test_objects_stand_on_ground_as_cluttered_as_stated(time_of_day):
    x, rejected = places(CLUTTERED, lawn_and_car_park(), time_of_day=time_of_day)
    assert len(x) == 8
    # A few aim at levels that this picture has nowhere, and end up anywhere.
    assert (x > 310).sum() >= 6
    assert rejected["unlike_real_ground"]
    x, _ = places(EVEN, lawn_and_car_park(), time_of_day=time_of_day)
    assert (x < 330).sum() >= 6


def test_without_stated_ground_places_are_uniform():
    x, rejected = places(None, lawn_and_car_park())
    assert (x < 310).any() and (x > 330).any()
    assert "unlike_real_ground" not in rejected


@pytest.mark.parametrize("black_hot", [False, True])
def test_no_object_stands_on_ground_of_an_impossible_level(black_hot):
    pixels = np.full(WH[::-1], 160, np.uint8)
    pixels[:, 400:] = 40
    if black_hot:
        pixels = 255 - pixels
    # The clutter is nowhere to be found, so the places are those of the last attempts.
    ground = "{level_grey: [-55, -28, -12, 2, 38], clutter_grey: [60, 70, 80, 90, 100]}"
    x, _ = places(ground, pixels, black_hot=black_hot)
    assert len(x) == 8
    assert (x < 400).all()


def test_ground_is_measured_without_the_object_and_without_annotated_ones():
    pixels = np.full((60, 60), 100, np.uint8)
    pixels[20:30, 20:30] = 250
    pixels[20:30, 32:36] = 200
    site = Site(pixels)
    box, other = np.array([20.0, 20, 30, 30]), np.array([[32.0, 20, 36, 30]])
    assert ground_around(site, box, other).clutter == 0
    assert ground_around(site, box, np.zeros((0, 4))).clutter > 20
    assert ground_around(site, np.zeros(4), other) is None
    half = Site(pixels.astype(np.uint16) * 50, grey_unit=50.0, black_hot=True)
    assert ground_around(half, box, np.zeros((0, 4))).clutter == pytest.approx(
        ground_around(site, box, np.zeros((0, 4))).clutter
    )


def test_aims_have_the_distribution_of_the_real_objects():
    real = RealGround(level_grey=(-50.0, -10.0, 0.0, 10.0, 50.0), clutter_grey=(4.0, 6.0, 9.0, 16.0, 33.0))
    rng = np.random.default_rng(0)
    aims = [draw_aim(real, rng) for _ in range(400)]
    assert all(a.possible == (-50, 50) and a.level[0] < a.level[1] for a in aims)
    for clutter, share in ((5, 0.3), (9, 1 / 3), (40, 0.05)):
        accepted = np.mean([a.clutter[0] <= clutter <= a.clutter[1] for a in aims])
        assert 0.5 * share < accepted < 1.5 * share, clutter


def test_quantiles_in_the_wrong_order_are_refused():
    ground = "placement.ground={day: {level_grey: [5, 0, 1, 2, 3], clutter_grey: [1, 2, 3, 4]}}"
    with pytest.raises(RecipeError) as caught:
        load_anywhere("hit-uav-person", [ground])
    text = str(caught.value)
    assert "placement.ground.day.level_grey" in text and "rising order" in text
    assert "placement.ground.day.clutter_grey" in text and "five quantiles" in text


def test_annotated_objects_do_not_count_as_clutter():
    pixels = np.full(WH[::-1], 120, np.uint8)
    pixels[100:140, 100:140] = 220
    box = np.array([90.0, 110, 99, 130])
    labels = [Instance("Car", np.array([100.0, 100, 140, 140]))]
    site = Site(pixels, tuple(labels))
    assert ground_around(site, box, np.array([i.box_xyxy for i in labels])).clutter == 0
