"""Contrast of objects in finished pictures."""

import numpy as np
import pytest

from infrablend.compositing.contrast import OTHER_LEAST, measure_contrast, near_edge, real_least, visible_change

BOX = np.array([40.0, 30, 60, 50])


def picture(level=100.0, inside=180.0, clutter=4.0, seed=0):
    grey = level + np.random.default_rng(seed).normal(0, clutter, (100, 120))
    grey[30:50, 40:60] = inside
    return grey.astype(np.float32)


def test_contrast_is_that_of_the_box_against_its_ring():
    found = measure_contrast(picture(), BOX)
    assert found.high == found.low == found.middle == 180
    assert found.ring == pytest.approx(100, abs=0.5)
    assert found.clutter == pytest.approx(4, rel=0.1)
    assert found.signed == pytest.approx(80, abs=0.5)
    assert found.scr == pytest.approx(80 / 5, rel=0.1)
    dark = measure_contrast(picture(inside=60), BOX)
    assert dark.signed == pytest.approx(-40, abs=0.5)
    assert dark.change == -dark.signed


def test_other_objects_are_left_out_of_the_ring():
    grey = picture(clutter=0)
    grey[30:50, 61:75] = 250
    assert measure_contrast(grey, BOX).clutter > 20
    assert measure_contrast(grey, BOX, [np.array([61.0, 30, 75, 50])]).clutter == 0
    crowded = [np.array([0.0, 0, 120, 30]), np.array([0.0, 50, 120, 100]), np.array([0.0, 0, 40, 100])]
    assert measure_contrast(grey, BOX, [*crowded, np.array([60.0, 0, 120, 100])]) is None


def test_sixteen_bit_levels_are_scaled():
    a, b = measure_contrast(picture(), BOX), measure_contrast(picture() * 40, BOX, scale=40)
    assert b.to_json() == pytest.approx(a.to_json(), rel=1e-3)


def test_boxes_near_the_edge_are_named():
    assert near_edge(np.array([2.5, 10, 20, 20]), (100, 120))
    assert near_edge(np.array([10, 10, 20, 97.5]), (100, 120))
    assert not near_edge(np.array([3.0, 3, 117, 97]), (100, 120))


def test_new_grain_alone_is_no_visible_change():
    rng = np.random.default_rng(2)
    before = np.clip(np.rint(100 + rng.normal(0, 10, (60, 60))), 0, 255).astype(np.uint8)
    again = np.clip(np.rint(100 + rng.normal(0, 10, (60, 60))), 0, 255).astype(np.uint8)
    cover = np.ones((20, 20), np.float32)
    assert visible_change(before, again, cover, (20, 20)) < 10
    brighter = before.copy()
    brighter[20:40, 20:40] += 30
    assert visible_change(before, brighter, cover, (20, 20)) == pytest.approx(30, abs=0.5)
    assert visible_change(before, brighter, np.zeros((20, 20), np.float32), (20, 20)) == 0


def test_real_objects_set_the_limit_by_class_and_time_of_day():
    assert real_least("Person", "night").change > real_least("pedestrian", "day").change
    assert real_least("Person", None) == real_least("Person", "day")
    assert real_least("drone", "day") == real_least("deer", None) == OTHER_LEAST
