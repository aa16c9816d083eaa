"""Physical grey levels: exact ground level, gain from anchors, clipped anchors as bounds."""

import numpy as np
import pytest

from infrablend.compositing.gain import Backdrop, GainPrior, find_anchors, ring_level
from infrablend.compositing.local import Insert, LocalSettings, local_mapping
from infrablend.compositing.mapping import GreyMapping, measure_levels
from infrablend.core.dataset import Instance
from infrablend.core.scene import Weather
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
    return local_mapping(backdrop, inserts, WEATHER, settings or LocalSettings(), np.random.default_rng(seed))


def gains(picture, labels):
    drawn = [mapped(picture, INSERT, labels, seed=n) for n in range(40)]
    slope = float(band_radiance_slope(AIR_K))
    return np.array([(m.bright - m.dark) * slope for m, _ in drawn]), drawn


def test_the_grounds_temperature_gets_the_grounds_grey():
    picture, labels = scene(6, people=2)
    for _, (m, _) in enumerate(gains(picture, labels)[1]):
        seen = m.dark + (m.bright - m.dark) * float(band_radiance(WEATHER.ground_k))
        assert seen == pytest.approx(110, abs=1)


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
    assert made[0][1]["anchors"] == {"clothing": 0, "car_roof": 0, "face_clipped": 0, "clothing_clipped": 0}


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


def test_black_hot_is_the_mirror_image():
    picture, labels = scene(6, people=4, cars=3)
    over = (LEVELS[0] + LEVELS[1] - picture).astype(np.uint8)
    a, _ = mapped(picture, INSERT, labels)
    b, _ = mapped(over, INSERT, labels, settings=LocalSettings(polarity="black-hot"))
    assert b.dark == pytest.approx(LEVELS[0] + LEVELS[1] - a.dark, abs=1e-3)
    assert b.bright == pytest.approx(LEVELS[0] + LEVELS[1] - a.bright, abs=1e-3)


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
    assert facts["ground_grey"] == [80, 160]
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
