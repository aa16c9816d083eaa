"""Physical grey levels: exact ground level, gain from anchors, clipped anchors as bounds."""

from dataclasses import replace

import numpy as np
import pytest

from infrablend.assets.catalogue import load_model
from infrablend.compositing.behind import Behind
from infrablend.compositing.gain import (
    Anchor,
    Backdrop,
    GainPrior,
    SharePrior,
    draw_gain,
    draw_share,
    find_anchors,
    ring_level,
)
from infrablend.compositing.local import Insert, LocalSettings, _land_anchors, local_mapping, match_locally
from infrablend.compositing.mapping import GreyMapping, measure_levels
from infrablend.config.loading import load_recipe
from infrablend.core.camera import CameraSpec
from infrablend.core.capture import Capture
from infrablend.core.dataset import Instance
from infrablend.core.scene import Weather
from infrablend.sampling.scene_sampler import sample_scene
from infrablend.sampling.site import FrameKey, Site
from infrablend.thermal.radiometry import band_radiance, band_radiance_slope

AIR_K = 283.15
WEATHER = Weather(AIR_K, AIR_K - 6, 0.0, AIR_K - 7, AIR_K + 2)
LEVELS = (16.0, 235.0)
INSERT = [Insert(np.array([300.0, 250.0, 340.0, 280.0]))]


def grey_of(kelvin, gain_k, ground=110.0):
    gain = gain_k / float(band_radiance_slope(AIR_K))
    return ground + gain * float(band_radiance(kelvin) - band_radiance(WEATHER.ground_k))


def scene(gain_k, people=0, cars=0, seed=0, ground=110.0):
    """A picture whose objects have exactly the temperatures that anchors assume."""
    rng = np.random.default_rng(seed)
    picture = rng.normal(ground, 2, (512, 640))
    labels = []
    for n in range(people):
        x, y = 40 + 60 * n, 60
        picture[y : y + 24, x : x + 12] = ground + 0.8 * (grey_of(AIR_K + 6, gain_k, ground) - ground)
        picture[y : y + 5, x : x + 12] = grey_of(301.15, gain_k, ground)
        labels.append(Instance("Person", np.array([x, y, x + 12, y + 24], np.float64)))
    for n in range(cars):
        x, y = 60 + 90 * n, 400
        picture[y : y + 24, x : x + 50] = grey_of(AIR_K - 8, gain_k, ground)
        labels.append(Instance("Car", np.array([x, y, x + 50, y + 24], np.float64)))
    return np.clip(picture, *LEVELS).round().astype(np.uint8), labels


def mapped(picture, inserts, labels, time="night", seed=0, levels=LEVELS, settings=None):
    backdrop = Backdrop(picture, labels, time, levels)
    return local_mapping(backdrop, inserts, WEATHER, settings or LocalSettings(), np.random.default_rng(seed))[:2]


def gains(picture, labels):
    drawn = [mapped(picture, INSERT, labels, seed=n) for n in range(40)]
    slope = float(band_radiance_slope(AIR_K))
    return np.array([(m.bright - m.dark) * slope for m, _ in drawn]), drawn


def test_the_grounds_temperature_gets_the_grounds_grey():
    """Exactly without anchors; with anchors, as far as the drawn gain explains them."""
    picture, labels = scene(6, people=2)
    for seen_labels, tolerance in (([], 1), (labels, 8)):
        for m, _ in gains(picture, seen_labels)[1]:
            seen = m.dark + (m.bright - m.dark) * float(band_radiance(WEATHER.ground_k))
            assert seen == pytest.approx(110, abs=tolerance)


def test_ground_warmer_than_drawn_is_an_offset_and_no_gain():
    """All objects 12 levels above what the drawn ground temperature predicts: 2 K at 6 levels per kelvin."""
    picture, labels = scene(6, people=8, cars=6)
    raised = picture.copy()
    for i in labels:
        x0, y0, x1, y1 = i.box_xyxy.astype(int)
        raised[y0:y1, x0:x1] += 12
    found = gains(raised, labels)
    offsets = [facts["gain"]["warm"]["offset_grey"] for _, facts in found[1]]
    assert np.mean(offsets) == pytest.approx(12, abs=5)
    assert found[0].mean() == pytest.approx(6, abs=1)
    assert np.mean([facts["gain"]["warm"]["offset_grey"] for _, facts in gains(picture, labels)[1]]) < 5


@pytest.mark.parametrize("share", [0.1, 0.4, 0.8])
def test_share_gain_and_offset_are_estimated_together(share):
    """Anchors over bright and dark ground; a wide prior leaves the share to them."""
    rng = np.random.default_rng(1)
    anchors = []
    for kind, kelvin in (("clothing", AIR_K + 6), ("car_roof", AIR_K - 8)) * 12:
        ring = float(rng.uniform(-50, 50))
        level = grey_of(kelvin, 8, ground=0.0) + share * ring + 6
        anchors.append(Anchor(kind, level - ring, kelvin, 3.0, ring))
    args = (AIR_K, float(band_radiance(WEATHER.ground_k)), 1.0)
    seeds = [np.random.default_rng(n) for n in range(30)]
    drawn = [draw_share(anchors, *args, SharePrior(0.5, 1.0), GainPrior(), rng)[0] for rng in seeds]
    assert np.mean(drawn) == pytest.approx(share, abs=0.12)
    rng = np.random.default_rng(0)
    fits = [draw_gain(anchors, *args, GainPrior(), True, rng, share) for _ in range(30)]
    unit = float(band_radiance_slope(AIR_K))
    assert np.mean([gain for gain, _, _ in fits]) * unit == pytest.approx(8, abs=1)
    assert np.mean([offset for _, offset, _ in fits]) == pytest.approx(6, abs=4)
    assert all(facts["doubts"] == [] for _, _, facts in fits)


@pytest.mark.parametrize("prior", [SharePrior(0.0), SharePrior(1.0), SharePrior(0.3, 0)])
def test_a_stated_share_is_exact_and_draws_nothing(prior):
    rng = np.random.default_rng(0)
    share, facts = draw_share([Anchor("clothing", 80, AIR_K + 6, 3.0, 40.0)], AIR_K, 0.1, 1.0, prior, GainPrior(), rng)
    assert share == prior.mean
    assert facts == {"drawn": share, "posterior": [share, 0.0], "anchors_used": 0}
    assert rng.random() == np.random.default_rng(0).random()


def test_rings_are_measured_against_the_pictures_ground():
    picture, labels = scene(6, people=1)
    picture[:200] += 30
    free = np.ones(picture.shape, bool)
    backdrop = Backdrop(picture, labels, "night", LEVELS)
    found, *_ = find_anchors(picture.astype(np.float32), free, backdrop, AIR_K, ground_grey=110.0)
    assert found.ring == pytest.approx(30, abs=1)
    assert found.above_ground(1.0) == found.grey
    assert found.above_ground(0.0) == pytest.approx(found.grey + found.ring)


@pytest.mark.parametrize("gain", [3.5, 6.0, 9.5])
def test_anchors_pull_the_gain_towards_the_truth(gain):
    picture, labels = scene(gain, people=8, cars=6)
    with_anchors, _ = gains(picture, labels)
    alone, _ = gains(picture, [])
    assert abs(with_anchors.mean() - gain) < 0.35 * gain
    if abs(gain - 6) > 1:
        assert abs(with_anchors.mean() - gain) < abs(alone.mean() - gain)
    assert with_anchors.std() < alone.std()


def test_without_anchors_the_prior_is_drawn_from():
    drawn, made = gains(*scene(6))
    assert drawn.mean() == pytest.approx(6, abs=0.8)
    assert 1.0 < drawn.std() < 2.4
    assert (drawn >= 2.5).all()
    assert (drawn <= 12).all()
    assert set(made[0][1]["anchors"].values()) == {0}
    assert all(facts["gain"]["warm"]["doubts"] == ["no_anchor"] for _, facts in made)


def test_clipped_face_is_a_lower_bound():
    """Ground at 150 and faces clipped at 235: at least 85 levels over 16 K. Clipping is never fitted through."""
    picture, labels = scene(9, people=5, ground=150.0)
    free = np.ones(picture.shape, bool)
    found = find_anchors(picture.astype(np.float32), free, Backdrop(picture, labels, "night", LEVELS), AIR_K)
    assert {a.kind for a in found} == {"clothing", "face_clipped"}
    least = 85 / float(band_radiance(301.15) - band_radiance(WEATHER.ground_k)) * float(band_radiance_slope(AIR_K))
    assert gains(picture, labels)[0].min() >= least - 0.05


def test_cars_are_anchors_at_night_only():
    picture, labels = scene(6, cars=4)
    free = np.ones(picture.shape, bool)
    for time, number in (("night", 4), ("day", 0), (None, 0)):
        backdrop = Backdrop(picture, labels, time, LEVELS)
        assert len(find_anchors(picture.astype(np.float32), free, backdrop, AIR_K)) == number


def test_crowds_are_no_anchors():
    picture, labels = scene(6, people=4)
    crowds = [replace(i, extra={"iscrowd": 1}) for i in labels]
    (_, people), (_, none) = (mapped(picture, INSERT, of) for of in (labels, crowds))
    assert sum(people["anchors"].values()) == 4 and not sum(none["anchors"].values())


def test_black_hot_is_the_mirror_image():
    picture, labels = scene(6, people=4, cars=3)
    over = (LEVELS[0] + LEVELS[1] - picture).astype(np.uint8)
    a, _ = mapped(picture, INSERT, labels)
    b, _ = mapped(over, INSERT, labels, settings=LocalSettings(polarity="black-hot"))
    assert b.dark == pytest.approx(LEVELS[0] + LEVELS[1] - a.dark, abs=1e-3)
    assert b.bright == pytest.approx(LEVELS[0] + LEVELS[1] - a.bright, abs=1e-3)


def test_black_hot_objects_have_the_contrast_of_their_mirror_image():
    """The ring was that of the inverted picture: visible people counted as faint, and were left out."""
    recipe = load_recipe("hit-uav-person", ["objects.0.count=1", "placement.max_relief_grey=0"])
    models = {o.model: load_model(o.model) for o in recipe.objects}
    picture = np.random.default_rng(0).normal(60, 2, (512, 640)).round().astype(np.uint8)
    found = {}
    for polarity in ("white-hot", "black-hot"):
        pixels = picture if polarity == "white-hot" else (sum(LEVELS) - picture).astype(np.uint8)
        site = Site(pixels, altitude_m=60.0, black_hot=polarity == "black-hot", time_of_day="night")
        placed = sample_scene(
            FrameKey("a", "train", 0, (640, 512), Capture(pitch_deg=60.0, time_of_day="night")), recipe, models, 0, site
        )
        backdrop = Backdrop(pixels, (), "night", LEVELS)
        settings = LocalSettings(polarity=polarity)
        found[polarity] = match_locally(placed, backdrop, settings, np.random.default_rng(0))
    white, black = found["white-hot"], found["black-hot"]
    assert white.contrasts[0] > 20
    assert black.contrasts == pytest.approx(white.contrasts, abs=0.1)
    mirrored = sum(LEVELS) - np.array(white.facts["ring_grey"])
    assert black.facts["ring_grey"] == pytest.approx(mirrored, abs=0.1)
    assert black.facts["behind_grey"]["ground"] == pytest.approx(sum(LEVELS) - white.facts["behind_grey"]["ground"])


def test_surfaces_saturate_at_the_datasets_levels():
    mapping = GreyMapping(100.0, 500.0, LEVELS)
    alpha = np.array([[1.0, 0.5, 1.0]], np.float32)
    grey = mapping.apply(np.array([[1.0, 0.5, -1.0]], np.float32), alpha)
    assert grey.tolist() == [[235.0, 117.5, 16.0]]
    assert GreyMapping.from_json(mapping.to_json()) == mapping


def test_sixteen_bit_gains_scale_with_the_levels():
    picture, _ = scene(6)
    wide = (picture.astype(np.uint16) - 16) * 100 + 20_000
    levels = (20_000.0, 20_000.0 + 219 * 100)
    m, facts = mapped(wide, INSERT, [], None, 1, levels, LocalSettings(GainPrior(sd=0.01)))
    slope = float(band_radiance_slope(AIR_K))
    assert (m.bright - m.dark) * slope == pytest.approx(600, rel=0.03)
    assert facts["levels"] == list(levels)


def test_levels_are_measured():
    rng = np.random.default_rng(3)
    pictures = [np.clip(rng.normal(126, 60, (512, 640)), 16, 235).astype(np.uint8) for _ in range(3)]
    assert measure_levels(pictures) == LEVELS
    assert measure_levels([np.full((64, 64), 7, np.uint8)]) == (7, 8)


def test_annotated_object_beside_the_insert_is_not_ground():
    picture = np.full((200, 200), 100, np.float32)
    free = np.ones(picture.shape, bool)
    picture[:, 110:] = 220
    free[:, 110:] = False
    assert ring_level(picture, np.array([90.0, 90, 110, 110]), free) == 100
    assert ring_level(picture, np.array([90.0, 90, 110, 110]), np.zeros_like(free)) in (100, 220)


def test_the_gain_of_warm_objects_comes_from_warm_anchors():
    """With anchors of 9 (people) and 4 levels per kelvin (cars), warm inserts use the first, cold ones the second."""
    picture, labels = scene(9, people=8)
    cold, cars = scene(4, cars=6)
    picture[390:430] = cold[390:430]
    means = {}
    for warm in (True, False):
        insert = [Insert(INSERT[0].box_xyxy, warm=warm)]
        drawn = [mapped(picture, insert, labels + cars, seed=n) for n in range(40)]
        means[warm] = np.mean([(m.bright - m.dark) * float(band_radiance_slope(AIR_K)) for m, _ in drawn])
        assert set(drawn[0][1]["gain"]) == {"warm" if warm else "cold"}
    assert means[True] > means[False] + 1
    assert means[False] < 6 < means[True]


def test_each_insert_is_set_against_its_own_ground():
    picture = np.full((512, 640), 80, np.uint8)
    picture[:, 320:] = 160
    inserts = [Insert(np.array([x, 200.0, x + 20, 240.0])) for x in (100.0, 500.0)]
    mapping, facts = mapped(picture, inserts, [])
    assert facts["ring_grey"] == [80, 160]
    assert GreyMapping.from_json(mapping.to_json()) == mapping
    ground = np.full((512, 640), band_radiance(WEATHER.ground_k), np.float32)
    grey = mapping.apply(ground, np.ones_like(ground))
    assert grey[220, 110] == pytest.approx(80, abs=0.1)
    assert grey[220, 510] == pytest.approx(160, abs=0.1)
    # A crop has its own offset.
    assert mapping.apply(ground[:5, :5], np.ones((5, 5), np.float32), (500, 200)) == pytest.approx(160, abs=0.1)


def test_near_objects_lose_less_to_the_air():
    picture = np.full((512, 640), 100, np.uint8)
    box = INSERT[0].box_xyxy
    (near, _), (on, _) = (mapped(picture, [i], [], None) for i in (Insert(box, 20.0, 150.0), Insert(box, 150.0, 150.0)))
    hot = float(band_radiance(AIR_K + 30))
    contrast = [m.dark + (m.bright - m.dark) * hot - 100 for m in (near, on)]
    assert 1.01 < contrast[0] / contrast[1] < 1.1


def test_the_local_share_decides_how_far_the_level_follows_the_place():
    """The same object on a bright and on a dark patch of one picture."""
    picture = np.full((512, 640), 110, np.uint8)
    picture[:, 320:] = 170
    picture[:, :160] = 90  # most of the ground is at 110 or 170, its median is 110
    at = [Insert(np.array([60.0, 250, 80, 280])), Insert(np.array([500.0, 250, 520, 280]))]
    radiance = float(band_radiance(WEATHER.ground_k + 5))
    levels = {}
    for share in (0.0, 0.25, 1.0):
        m, facts = mapped(picture, at, [], settings=LocalSettings(local_share=SharePrior(share, 0)))
        levels[share] = [p.dark + (p.bright - p.dark) * radiance for p in m.places]
        assert facts["ring_grey"] == [90, 170]
        assert levels[share][1] - levels[share][0] == pytest.approx(share * (170 - 90), abs=1e-6)
    assert levels[1.0][0] - 90 == pytest.approx(levels[0.0][0] - facts["behind_grey"]["ground"], abs=1e-6)


def test_the_neighbourhood_reaches_as_far_as_stated():
    """A bright strip of 15 px around an object and an anchor of 30 px, within half of their length."""
    picture = np.full((512, 640), 90, np.uint8)
    box = np.array([300.0, 250, 330, 280])
    car = np.array([100.0, 250, 130, 280])
    for x0, y0, x1, y1 in (box.astype(int), car.astype(int)):
        picture[y0 - 15 : y1 + 15, x0 - 15 : x1 + 15] = 150
    picture[250:280, 100:130] = 60
    labels = [Instance("Car", car)]
    for reach, ring in ((0.5, 150), (1.5, 90)):
        prior = SharePrior(0.25, 0, reach)
        _, facts = mapped(picture, [Insert(box)], labels, settings=LocalSettings(local_share=prior))
        assert facts["ring_grey"] == [ring]
        backdrop = Backdrop(picture, labels, "night", LEVELS)
        (anchor,) = find_anchors(picture.astype(np.float32), backdrop.free(), backdrop, AIR_K, 6.0, 90.0, reach)
        assert anchor.ring == ring - 90


def camera(pitch_deg):
    return CameraSpec(100.0, np.radians(pitch_deg), 0.0, 84.69, 36.0, (320, 256))


# The horizon is at row 190: 62 px below the middle at a focal length of 752.8 px.
UP = camera(-np.degrees(np.arctan(62 / 752.8)))


def in_front_of_sky(picture, inserts, settings=None, seed=0, seen=UP, labels=(), time=None):
    backdrop = Backdrop(picture, labels, time, (0.0, 255.0))
    return local_mapping(backdrop, inserts, WEATHER, settings or LocalSettings(), np.random.default_rng(seed), seen)[:2]


def sky_picture(row=190, sky=97.0, land=230.0):
    rng = np.random.default_rng(0)
    levels = np.where(np.arange(256)[:, None] < row, sky, land) + rng.normal(0, 1, (256, 320))
    return np.clip(levels, 0, 255).round().astype(np.uint8)


def test_in_front_of_the_sky_the_reference_is_the_sky():
    """The gain follows from the step at the skyline, and a drone at air temperature is as bright as the land.

    One gain holds above and below the horizon.
    """
    picture = sky_picture()
    inserts = [Insert(np.array([100.0, 60, 116, 70]), range_m=40.0), Insert(np.array([100.0, 220, 116, 230]))]
    settings = LocalSettings(GainPrior(9.0, 5.4, 2.0, 30.0))
    air = []
    for seed in range(40):
        m, facts = in_front_of_sky(picture, inserts, settings, seed)
        assert facts["behind"] == ["sky", "ground"]
        assert facts["gain"]["warm"]["anchors_used"] == 1
        assert set(facts["gain"]) == {"warm"}
        place = m.places[0]
        air.append(place.dark + (place.bright - place.dark) * float(band_radiance(AIR_K)))
    assert np.mean(air) == pytest.approx(230, abs=25)
    blind, facts = in_front_of_sky(picture, inserts, settings, seen=None)
    assert facts["behind"] == ["ground", "ground"]
    place = blind.places[0]
    assert place.dark + (place.bright - place.dark) * float(band_radiance(WEATHER.ground_k)) == pytest.approx(97, abs=2)


def test_people_and_the_skyline_agree_on_one_gain():
    """Annotated people inform the gain in front of the sky, and the skyline that of objects on the ground."""
    # The land is 133 levels above a sky that is some 14 K colder.
    picture, settings = sky_picture(), LocalSettings(GainPrior(3.0, 3.0, 1.0, 30.0))
    insert = [Insert(np.array([100.0, 220, 116, 230]))]
    box = np.array([200.0, 200, 212, 224])
    picture[200:224, 200:212] = 245
    labels = [Instance("Person", box)]

    def posterior(labels, camera):
        return in_front_of_sky(picture, insert, settings, 0, camera, labels, "night")[1]["gain"]["warm"]

    alone, both = posterior([], UP), posterior(labels, UP)
    assert (alone["anchors_used"], both["anchors_used"]) == (1, 2)
    assert alone["posterior"][0] > 5 and alone["doubts"] == []
    assert both["posterior"][1] < alone["posterior"][1]
    assert posterior(labels, None)["anchors_used"] == 1


@pytest.mark.parametrize("reach", [1.5, 0.5])
def test_pixels_in_the_box_decide_between_sky_and_what_stands_above_the_horizon(reach):
    """A cloud that a mast joins to the trees makes the sky between them part of the skyline."""
    picture = sky_picture()
    picture[150:190, 100:260] = 200  # trees
    picture[60:66, 100:260] = 150  # cloud
    picture[60:150, 100:104] = 200  # mast
    inserts = [Insert(np.array([180.0, y, 196, y + 10]), range_m=40.0) for y in (100, 165)]
    settings = LocalSettings(local_share=SharePrior(reach=reach))
    _, facts = in_front_of_sky(picture, inserts, settings)
    assert facts["behind"] == ["sky", "skyline"]
    assert facts["ring_grey"] == [pytest.approx(97, abs=2), pytest.approx(200, abs=2)]


@pytest.mark.parametrize("headroom", [0.0, 2.0])
def test_headroom_widens_the_levels_before_the_optics(headroom):
    picture, labels = scene(6, people=3)
    settings = LocalSettings(headroom=headroom)
    m, facts = mapped(picture, INSERT, labels, settings=settings)
    assert m.limits == (16 - 219 * headroom, 235 + 219 * headroom)
    assert facts["levels"] == [16, 235]


def test_trees_above_the_horizon_are_neither_sky_nor_ground():
    picture = sky_picture()
    picture[120:190, 140:260] = 200
    insert = [Insert(np.array([190.0, 140, 206, 150]), range_m=40.0)]
    m, facts = in_front_of_sky(picture, insert)
    assert facts["behind"] == ["skyline"]
    assert m.dark + (m.bright - m.dark) * float(band_radiance(AIR_K)) == pytest.approx(200, abs=2)


@pytest.mark.parametrize(("level", "doubt"), [(-140, "gain_negative"), (90, "gain_at_bound")])
def test_gains_beyond_the_bounds_are_doubted(level, doubt):
    """Clothes and roofs at levels that only a negative or a very high gain explains."""
    reference = float(band_radiance(WEATHER.ground_k))
    anchors = [Anchor("clothing", level, AIR_K + 6, 1.0), Anchor("car_roof", -2.5 * level, AIR_K - 8, 1.0)] * 3
    rng = np.random.default_rng(0)
    _, _, facts = draw_gain(anchors, AIR_K, reference, 1.0, GainPrior(), True, rng)
    assert doubt in facts["doubts"]


def test_doubts_are_named_and_the_prior_replaces_such_gains():
    """People that are darker than the ground although they should be warmer."""
    picture, labels = scene(6, people=6)
    inverted = (220 - picture.astype(int)).clip(16, 235).astype(np.uint8)
    _, facts = mapped(inverted, INSERT, labels)
    doubts = facts["gain"]["warm"]["doubts"]
    assert "anchors_off" in doubts
    trusted = LocalSettings(on_untrusted="prior")
    _, instead = mapped(inverted, INSERT, labels, settings=trusted)
    assert instead["gain"]["warm"]["doubts"] == doubts
    assert instead["gain"]["warm"]["from_prior"] is True
    assert instead["gain"]["warm"]["posterior"][0] == pytest.approx(6.0)
    unsure = LocalSettings(on_untrusted="prior", local_share=SharePrior(0.3, 0.1))
    _, instead = mapped(inverted, INSERT, labels, settings=unsure)
    assert instead["local_share"]["posterior"] == [0.3, 0.1] and instead["local_share"]["anchors_used"] == 0
    _, good = mapped(picture, INSERT, labels, settings=trusted)
    assert good["gain"]["warm"]["doubts"] == []


@pytest.mark.parametrize(
    ("ground", "step", "rise"),
    [
        (150.0, 40.0, 90.0),  # a soft skyline: the step beside it is only a part of the rise
        (150.0, 120.0, 120.0),  # local enhancement took contrast from the large areas
        (None, 40.0, 40.0),  # no ground in sight but what rises above the horizon
    ],
)
def test_the_rise_from_sky_to_land_is_the_larger_of_two_readings(ground, step, rise):
    nothing = np.zeros((512, 640), np.bool_)
    behind = Behind(ground, 60.0, 1.2, None, nothing, nothing, step_grey=step)
    (land,) = _land_anchors(behind, Backdrop(np.zeros((512, 640), np.uint8), [], "day", LEVELS), WEATHER)
    assert (land.kind, land.grey) == ("land", rise)
    clipped = Behind(ground, 130.0, 1.2, None, nothing, nothing, step_grey=120.0)
    (land,) = _land_anchors(clipped, Backdrop(np.zeros((512, 640), np.uint8), [], "day", LEVELS), WEATHER)
    assert land.kind == "land_clipped"
