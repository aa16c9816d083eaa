"""Enlarging the boxes of inserted objects."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from infrablend.annotation.looseness import is_loosened, loosen_inserted, loosen_rectangle
from infrablend.core.boxes import corners_of_box, smallest_rectangle_inside
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.masks import Mask

WH = (100, 80)


def test_boxes_grow_about_their_centre_and_the_exact_ones_are_kept():
    box = np.array([20.0, 30, 40, 40])
    mask = np.zeros((80, 100), bool)
    mask[30:40, 20:40] = True
    person = Instance("Person", box, corners_of_box(box), Mask.from_array(mask), inserted=True, extra={"scr": 3.0})
    image = ImageRecord("a", Path("a.png"), "train", WH, None, None, None, (person, Instance("Person", box)))
    (loose,), count = loosen_inserted([image], 1.5)
    enlarged, original = loose.instances
    assert count == 1 and original is image.instances[1]
    np.testing.assert_allclose(enlarged.box_xyxy, [15, 27.5, 45, 42.5])
    np.testing.assert_allclose(enlarged.corners_xy, corners_of_box(np.array([15, 27.5, 45, 42.5])))
    assert enlarged.mask == person.mask
    assert enlarged.extra["tight_bbox"] == [20, 30, 20, 10] and enlarged.extra["scr"] == 3.0
    np.testing.assert_array_equal(np.reshape(enlarged.extra["tight_obb"], (4, 2)), person.corners_xy)
    assert is_loosened(enlarged) and not is_loosened(person)


def test_classes_that_are_not_listed_keep_their_boxes():
    box = np.array([20.0, 30, 40, 40])
    both = (Instance("Person", box, inserted=True), Instance("Car", box, inserted=True))
    image = ImageRecord("a", Path("a.png"), "train", WH, None, None, None, both)
    (loose,), count = loosen_inserted([image], {"Car": 1.2, "Dog": 2.0})
    assert count == 1
    assert loose.instances[0] is both[0]
    np.testing.assert_allclose(loose.instances[1].box_xyxy, [18, 29, 42, 41])


coordinates = st.tuples(st.floats(0, WH[0]), st.floats(0, WH[1]))


@given(st.lists(coordinates, min_size=3, max_size=6), st.floats(1, 2))
def test_an_enlarged_rectangle_contains_the_exact_one_and_stays_in_the_frame(points, factor):
    tight = smallest_rectangle_inside(np.array(points), WH)
    loose = loosen_rectangle(tight, factor, WH)
    assert (loose >= 0).all() and (loose <= WH).all()
    for a, b, near, far in zip(tight, np.roll(tight, -1, axis=0), loose, np.roll(loose, -1, axis=0), strict=True):
        side = b - a
        normal = np.array([side[1], -side[0]])
        length = np.hypot(*side)
        assert abs(normal @ (far - near)) <= 1e-6 * max(length, 1.0)  # parallel
        assert normal @ (near - a) >= -1e-6 * max(length, 1.0)  # further out: corners are clockwise


@pytest.mark.parametrize("factor", [1.2, 2.0])
def test_a_rectangle_away_from_the_edge_grows_by_the_factor(factor):
    tight = np.array([[50.0, 20], [65, 35], [55, 45], [40, 30]])
    middle = tight.mean(axis=0)
    np.testing.assert_allclose(loosen_rectangle(tight, factor, WH), middle + factor * (tight - middle))
