"""Boxes around the visible part of inserted objects."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from infrablend.annotation.looseness import Looseness, loosen_inserted, loosened_text, looseness_text, tighten_image
from infrablend.annotation.visible_fit import add_seen_box
from infrablend.core.boxes import box_of_points, corners_of_box
from infrablend.core.dataset import SEEN_BOX, SEEN_OBB, ImageRecord, Instance
from infrablend.core.rle_masks import Mask

WH = (100, 80)
GROUND = 120.0


def car(box: tuple[float, float, float, float] = (20.4, 30.2, 59.7, 50)) -> Instance:
    """An object whose mask fills a box."""
    mask = np.zeros((80, 100), bool)
    x0, y0, x1, y1 = (round(v) for v in box)
    mask[y0:y1, x0:x1] = True
    around = np.array(box, np.float64)
    return Instance("Car", around, corners_of_box(around), Mask.from_array(mask), inserted=True)


def picture(*parts: tuple[tuple[int, int, int, int], float]) -> NDArray[np.uint8]:
    """Ground with rectangles that differ from it."""
    levels = np.full((80, 100), GROUND)
    for (x0, y0, x1, y1), change in parts:
        levels[y0:y1, x0:x1] += change
    return levels.astype(np.uint8)


def seen(label: Instance) -> list[float]:
    x, y, w, h = label.extra[SEEN_BOX]
    return [x, y, x + w, y + h]


def test_a_part_with_the_level_of_the_ground_is_left_out() -> None:
    label = car()
    dark_roof = picture(((20, 30, 60, 40), -60), ((20, 40, 60, 50), 3))
    found = add_seen_box(label, dark_roof, picture(), 60, GROUND)
    # The blur spreads the roof by a pixel at most; the other sides are those of the shape, to the fraction of a pixel.
    assert_allclose(seen(found), [20.4, 30.2, 59.7, 40], atol=1)
    assert seen(found)[:3] == pytest.approx([20.4, 30.2, 59.7])
    assert_array_equal(found.box_xyxy, label.box_xyxy)
    assert_allclose(box_of_points(np.reshape(found.extra[SEEN_OBB], (4, 2))), seen(found))
    same_at_16_bit = add_seen_box(
        label, dark_roof.astype(np.uint16) * 100, picture().astype(np.uint16) * 100, 60, GROUND, 100.0
    )
    assert same_at_16_bit.extra == found.extra


def test_what_is_visible_all_over_keeps_its_box() -> None:
    label = car()
    # A hot nose must not hide that the rest is visible, too.
    found = add_seen_box(label, picture(((20, 30, 60, 50), -25), ((20, 30, 28, 50), 135)), picture(), 110, GROUND)
    assert found is label


def test_grain_and_small_spots_do_not_count() -> None:
    label = car()
    spot = picture(((20, 30, 60, 40), -60), ((40, 48, 42, 50), -60))
    assert seen(add_seen_box(label, spot, picture(), 60, GROUND))[3] == pytest.approx(40, abs=1)


def test_small_objects_keep_the_fractions_of_pixels() -> None:
    label = car((20.3, 30.3, 24.6, 33.4))
    assert add_seen_box(label, picture(((20, 30, 25, 33), -40)), picture(), 40, GROUND) is label


def test_an_object_without_a_visible_pixel_keeps_its_box() -> None:
    assert SEEN_BOX not in add_seen_box(car(), picture(), picture(), 20, GROUND).extra


def test_what_has_the_level_of_the_surroundings_on_other_ground_is_visible() -> None:
    """A part on a bright kerb that is as dark as the road around the object."""
    label, kerb = car(), picture(((0, 40, 100, 80), 50))
    finished = kerb.copy()
    finished[30:50, 20:60] = GROUND
    finished[30:40, 20:60] -= 60
    assert add_seen_box(label, finished, kerb, 60, GROUND) is label
    # Without a ring, the change alone decides.
    assert add_seen_box(label, finished, kerb, 60) is label


def test_pieces_of_a_partly_hidden_object_are_no_small_spots() -> None:
    whole = np.zeros((80, 100), bool)
    whole[20:40, 20:40] = True
    whole[48:52, 26:34] = True
    box = np.array([20.0, 20, 40, 52])
    label = Instance("Deer", box, corners_of_box(box), Mask.from_array(whole), inserted=True)
    levels = picture()
    levels[whole] -= 60
    assert add_seen_box(label, levels, picture(), 60, GROUND) is label


def test_a_side_behind_something_stays_where_it_is() -> None:
    """The box is that of the whole object; its left half is hidden, and the mask begins at 40 px."""
    label = car()
    mask = np.zeros((80, 100), bool)
    mask[30:50, 40:60] = True
    found = add_seen_box(
        replace(label, mask=Mask.from_array(mask)), picture(((43, 30, 56, 50), -60)), picture(), 60, GROUND
    )
    assert_allclose(seen(found), [20.4, 30.2, 56, 50], atol=1)
    assert seen(found)[0] == pytest.approx(20.4)


def test_oriented_boxes_are_cut_along_their_own_sides() -> None:
    turn = math.radians(30)
    axes = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    middle, half = np.array([50.0, 40]), np.array([24.0, 10])
    corners = middle + (np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]]) * half) @ axes
    y, x = np.mgrid[:80, :100] + 0.5
    own = (np.stack([x, y], axis=-1) - middle) @ axes.T
    inside = (np.abs(own) <= half).all(axis=-1)
    levels = np.full((80, 100), GROUND, np.uint8)
    levels[inside & (own[..., 0] < 6)] -= 60
    box = box_of_points(corners)
    label = Instance("Car", box, corners, Mask.from_array(inside), inserted=True)
    found = np.reshape(add_seen_box(label, levels, picture(), 60, GROUND).extra[SEEN_OBB], (4, 2))
    # 48 px long, of which 30 are visible.
    assert np.hypot(*(found[1] - found[0])) == pytest.approx(30, abs=1.5)
    assert np.hypot(*(found[3] - found[0])) == pytest.approx(20, abs=1e-6)
    assert_allclose(found[[0, 3]], corners[[0, 3]], atol=1e-9)


def test_boxes_are_fitted_before_they_are_enlarged_and_the_exact_ones_are_kept() -> None:
    label = add_seen_box(car(), picture(((20, 30, 60, 40), -60)), picture(), 60, GROUND)
    image = ImageRecord("a", Path("a.png"), "train", WH, (label, car((5, 5, 10, 10))))
    by = Looseness(1.2, fit="visible")
    (loose,), count = loosen_inserted([image], by)
    x0, y0, x1, y1 = seen(label)
    w, h = 0.1 * (x1 - x0), 0.1 * (y1 - y0)
    assert count == 2
    assert_allclose(loose.instances[0].box_xyxy, [x0 - w, y0 - h, x1 + w, y1 + h])
    assert_allclose(box_of_points(loose.instances[0].corners_xy), loose.instances[0].box_xyxy)
    exact, fitted = tighten_image(loose).instances[0], tighten_image(loose, fitted=True).instances[0]
    assert_allclose(exact.box_xyxy, label.box_xyxy)
    assert_allclose(fitted.box_xyxy, seen(label))
    assert_allclose(box_of_points(fitted.corners_xy), seen(label))
    assert by.to_counts() == {"boxes_fit": "visible", "loosened_by": 1.2}
    assert looseness_text(by.to_counts()) == "drawn around what is visible and enlarged by the factor 1.2"
    # Without enlarging, only boxes that can be fitted change; by default none do.
    assert loosen_inserted([image], Looseness(fit="visible"))[1] == 1
    assert looseness_text(Looseness(fit="visible").to_counts()) == "drawn around what is visible"
    assert loosen_inserted([image], Looseness())[1] == 0


def test_the_card_mentions_the_border_only_for_enlarged_boxes() -> None:
    assert loosened_text(3, Looseness(fit="visible")) == (
        "The boxes of 3 inserted objects were drawn around what is visible, to match hand-drawn boxes."
    )
    assert "the factor 1.2, up to the border" in loosened_text(3, Looseness(1.2, fit="visible"))
