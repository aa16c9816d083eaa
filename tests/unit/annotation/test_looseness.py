"""Enlarging the boxes of inserted objects."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from infrablend.annotation.looseness import (
    Looseness,
    is_loosened,
    loosen_inserted,
    loosen_rectangle,
    looseness_text,
    margin_by_size,
    tighten_image,
)
from infrablend.config.loading import load_recipe
from infrablend.core.boxes import corners_of_box, smallest_rectangle_inside
from infrablend.core.dataset import ImageRecord, Instance
from infrablend.core.rle_masks import Mask

WH = (100, 80)


def test_boxes_grow_about_their_centre_and_the_exact_ones_are_kept():
    box = np.array([20.0, 30, 40, 40])
    mask = np.zeros((80, 100), bool)
    mask[30:40, 20:40] = True
    person = Instance("Person", box, corners_of_box(box), Mask.from_array(mask), inserted=True, extra={"scr": 3.0})
    image = ImageRecord("a", Path("a.png"), "train", WH, (person, Instance("Person", box)))
    (loose,), count = loosen_inserted([image], Looseness(1.5))
    enlarged, original = loose.instances
    assert count == 1 and original is image.instances[1]
    np.testing.assert_allclose(enlarged.box_xyxy, [15, 27.5, 45, 42.5])
    np.testing.assert_allclose(enlarged.corners_xy, corners_of_box(np.array([15, 27.5, 45, 42.5])))
    assert enlarged.mask == person.mask
    assert enlarged.extra["tight_bbox"] == [20, 30, 20, 10] and enlarged.extra["scr"] == 3.0
    np.testing.assert_array_equal(np.reshape(enlarged.extra["tight_obb"], (4, 2)), person.corners_xy)
    assert is_loosened(enlarged) and not is_loosened(person)
    exact, unchanged = tighten_image(loose).instances
    assert not is_loosened(exact) and unchanged is original and exact.extra == person.extra
    np.testing.assert_array_equal(exact.box_xyxy, person.box_xyxy)
    np.testing.assert_array_equal(exact.corners_xy, person.corners_xy)


def test_classes_that_are_not_listed_keep_their_boxes():
    box = np.array([20.0, 30, 40, 40])
    both = (Instance("Person", box, inserted=True), Instance("Car", box, inserted=True))
    image = ImageRecord("a", Path("a.png"), "train", WH, both)
    (loose,), count = loosen_inserted([image], Looseness({"Car": 1.2, "Dog": 2.0}))
    assert count == 1
    assert loose.instances[0] is both[0]
    np.testing.assert_allclose(loose.instances[1].box_xyxy, [18, 29, 42, 41])


def test_a_margin_in_px_moves_each_side_after_the_factor():
    box = np.array([20.0, 30, 40, 40])
    turned = np.array([[50.0, 20], [65, 35], [55, 45], [40, 30]])
    both = (Instance("Person", box, turned, inserted=True), Instance("Car", box, inserted=True))
    image = ImageRecord("a", Path("a.png"), "train", WH, both)
    (loose,), count = loosen_inserted([image], Looseness(1.5, {"Person": 3.5}))
    person, car = loose.instances
    assert count == 2
    np.testing.assert_allclose(person.box_xyxy, [15 - 3.5, 27.5 - 3.5, 45 + 3.5, 42.5 + 3.5])
    np.testing.assert_allclose(car.box_xyxy, [15, 27.5, 45, 42.5])
    assert person.extra["tight_bbox"] == [20, 30, 20, 10]
    sides = np.hypot(*(np.roll(turned, -1, axis=0) - turned).T)
    enlarged = person.corners_xy
    assert enlarged is not None
    np.testing.assert_allclose(np.hypot(*(np.roll(enlarged, -1, axis=0) - enlarged).T), 1.5 * sides + 7)
    np.testing.assert_allclose(enlarged.mean(axis=0), turned.mean(axis=0))
    assert Looseness(1.5, {"Person": 3.5}).to_counts() == {"loosened_by": 1.5, "loosened_by_px": {"Person": 3.5}}
    assert not Looseness() and not Looseness({"Car": 1.0}, {"Car": 0.0})


def test_margins_end_at_the_border_and_widen_what_has_no_extent():
    corner = Instance("Person", np.array([0.0, 0, 4, 4]), corners_of_box(np.array([0.0, 0, 4, 4])), inserted=True)
    flat = Instance("Person", np.array([20.0, 30, 28, 30]), corners_of_box(np.array([20.0, 30, 28, 30])), inserted=True)
    image = ImageRecord("a", Path("a.png"), "train", WH, (corner, flat))
    (loose,), _ = loosen_inserted([image], Looseness(loosen_px=3.0))
    for one, expected in zip(loose.instances, ([0, 0, 7, 7], [17, 27, 31, 33]), strict=True):
        np.testing.assert_allclose(one.box_xyxy, expected)
        low, high = one.corners_xy.min(axis=0), one.corners_xy.max(axis=0)
        np.testing.assert_allclose([*low, *high], expected)


coordinates = st.tuples(st.floats(0, WH[0]), st.floats(0, WH[1]))


@given(st.lists(coordinates, min_size=3, max_size=6), st.floats(1, 2), st.floats(0, 32))
def test_an_enlarged_rectangle_contains_the_exact_one_and_stays_in_the_frame(points, factor, px):
    tight = smallest_rectangle_inside(np.array(points), WH)
    loose = loosen_rectangle(tight, factor, WH, px)
    assert (loose >= 0).all() and (loose <= WH).all()
    for a, b, near, far in zip(tight, np.roll(tight, -1, axis=0), loose, np.roll(loose, -1, axis=0), strict=True):
        side = b - a
        normal = np.array([side[1], -side[0]])
        length = np.hypot(*side)
        assert abs(normal @ (far - near)) <= 1e-6 * max(length, 1.0)  # parallel
        assert normal @ (near - a) >= -1e-6 * max(length, 1.0)  # further out: corners are clockwise


@given(st.lists(coordinates, min_size=3, max_size=6), st.floats(1, 2), st.floats(0, 32), st.integers(1, 3))
def test_the_numbering_of_the_corners_does_not_matter(points, factor, px, first):
    tight = smallest_rectangle_inside(np.array(points), WH)
    loose = loosen_rectangle(np.roll(tight, first, axis=0), factor, WH, px)
    np.testing.assert_allclose(loose, np.roll(loosen_rectangle(tight, factor, WH, px), first, axis=0), atol=1e-5)


def test_near_a_border_the_sides_share_what_room_there_is():
    # The left corner is 2 px from the border; its two sides are alike, so each moves by half of what fits.
    tight = np.array([[2.0, 40], [22, 20], [42, 40], [22, 60]])
    loose = loosen_rectangle(tight, 1.0, WH, px=4.0)
    np.testing.assert_allclose(loose[0], [0, 40], atol=1e-9)
    np.testing.assert_allclose(loose[1], [21 + 4 * np.sqrt(0.5), 19 - 4 * np.sqrt(0.5)], atol=1e-9)
    np.testing.assert_allclose(loose[2], [42 + 4 * np.sqrt(2), 40], atol=1e-9)


@pytest.mark.parametrize(("longer_px", "margin_px"), [(3, 2), (8, 2), (9.5, 2.5), (11, 3), (32, 3), (50, 4), (200, 16)])
def test_the_margin_that_people_leave_grows_with_the_object(longer_px, margin_px):
    assert margin_by_size(longer_px) == pytest.approx(margin_px, rel=0.01)


def test_margins_by_size_follow_the_box_that_is_enlarged():
    small, large = (Instance("drone", np.array([20.0, 20, 20 + w, 26]), inserted=True) for w in (6, 11))
    image = ImageRecord("a", Path("a.png"), "train", WH, (small, large))
    by = Looseness(loosen_px={"drone": "by_size"})
    (loose,), count = loosen_inserted([image], by)
    assert count == 2
    assert [i.box_xyxy.tolist() for i in loose.instances] == [[18, 18, 28, 28], [17, 17, 34, 29]]
    assert looseness_text(by.to_counts()) == "enlarged by a margin by size (drone)"
    assert looseness_text(Looseness(loosen_px="by_size").to_counts()) == "enlarged by a margin by size"
    mixed = Looseness(loosen_px={"drone": "by_size", "bird": 4.5, "kite": 0.0})
    assert looseness_text(mixed.to_counts()) == "enlarged by bird 4.5 px on each side and a margin by size (drone)"


@pytest.mark.parametrize("fit", ["shape", "visible"])
def test_oriented_boxes_may_stay_exact(fit):
    box = np.array([20.0, 30, 40, 40])
    person = Instance("Person", box, corners_of_box(box), inserted=True)
    image = ImageRecord("a", Path("a.png"), "train", WH, (person,))
    (loose,), _ = loosen_inserted([image], Looseness(1.5, loosen_obb=False, fit=fit))
    np.testing.assert_allclose(loose.instances[0].box_xyxy, [15, 27.5, 45, 42.5])
    np.testing.assert_array_equal(loose.instances[0].corners_xy, person.corners_xy)
    np.testing.assert_array_equal(tighten_image(loose).instances[0].box_xyxy, box)


def test_exact_is_a_factor_of_one():
    assert load_recipe("hit-uav-people", ["labels.loosen=exact"]).labels.loosen == 1.0
    assert load_recipe("hit-uav-people").labels.loosen == "auto" and load_recipe("hit-uav-drone").labels.loosen == 1.0


@pytest.mark.parametrize("factor", [1.2, 2.0])
def test_a_rectangle_away_from_the_edge_grows_by_the_factor(factor):
    tight = np.array([[50.0, 20], [65, 35], [55, 45], [40, 30]])
    middle = tight.mean(axis=0)
    np.testing.assert_allclose(loosen_rectangle(tight, factor, WH), middle + factor * (tight - middle))
