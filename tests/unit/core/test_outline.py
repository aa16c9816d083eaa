"""Size of what a picture shows of an object."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from infrablend.core.outline import find_body
from infrablend.core.rng import stream


def show(bar_hw: tuple[int, int], change: float) -> np.ndarray:
    """A bar at row 40 and column 40 before ground of some grain."""
    picture = 100 + stream(0, "grain").normal(0, 1, (96, 96))
    picture[40 : 40 + bar_hw[0], 40 : 40 + bar_hw[1]] = 100 + change
    return picture


def body_size_px(picture, box, boxes):
    body = find_body(picture, box, boxes)
    return None if body is None else body.size_px


def box_around(bar_hw: tuple[int, int], margin: float) -> np.ndarray:
    return np.array([40 - margin, 40 - margin, 40 + bar_hw[1] + margin, 40 + bar_hw[0] + margin])


@pytest.mark.parametrize("change", [60, -60])
@pytest.mark.parametrize("margin", [0, 3.4, 8])
@pytest.mark.parametrize(("bar_hw", "size"), [((1, 1), 1), ((2, 2), 2), ((2, 6), 6), ((20, 9), 20)])
def test_the_longer_side_is_measured_in_exact_and_loose_boxes_alike(bar_hw, size, margin, change):
    picture, box = show(bar_hw, change), box_around(bar_hw, margin)
    for shown in (np.rint(picture).astype(np.uint8), np.rint(300 * picture).astype(np.uint16), np.float32(picture)):
        assert body_size_px(shown, box, [box]) == pytest.approx(size)


def test_the_area_above_half_of_the_peak_is_measured_along_the_object():
    """A line of 20 px at 45 degrees, blurred across; and a blob, whose width at half its peak is 2.355 sigma."""
    picture = np.zeros((96, 96), np.float32)
    cv2.line(picture, (40, 40), (54, 54), 100.0, 3)
    box = np.array([36.0, 36, 59, 59])
    assert body_size_px(picture + 50, box, [box]) == pytest.approx(14 * 2**0.5 + 3, abs=1.5)
    rows, columns = np.mgrid[:96, :96]
    blob = 50 + 100 * np.exp(-((rows - 47.5) ** 2 + (columns - 47.5) ** 2) / (2 * 3.0**2))
    box = np.array([33.0, 33, 62, 62])
    assert body_size_px(np.float32(blob), box, [box]) == pytest.approx(2.355 * 3, abs=1)


def test_a_bar_fills_its_rectangle_and_a_cross_does_not():
    picture, box = show((3, 12), -40), box_around((3, 12), 3)
    body = find_body(picture, box, [box])
    assert (body.size_px, body.width_px, body.fill) == pytest.approx((12, 3, 1)) and -45 < body.peak < -37
    picture[36:47, 45:47] = 60
    box = np.array([36.0, 33, 56, 50])
    cross = find_body(picture, box, [box])
    # The smallest rectangle around a cross may be turned.
    area = 3 * 12 + 11 * 2 - 3 * 2
    assert cross.fill == pytest.approx(area / (cross.size_px * cross.width_px)) and cross.fill < 0.6


def test_what_does_not_stand_out_or_runs_on_has_no_size():
    flat, box = np.full((96, 96), 100, np.uint8), box_around((4, 4), 2)
    assert body_size_px(flat, box, [box]) is None
    flat[41, 41] = 101  # a step of rounding
    assert body_size_px(flat, box, [box]) is None
    assert body_size_px(show((1, 1), 0), box, [box]) is None  # grain alone
    ground = show((4, 4), 60)
    ground[40:44] = 160  # a warm road from edge to edge
    assert body_size_px(ground, box, [box]) is None
    picture = show((4, 4), 60)
    picture[40:44, 44:70] = 160  # runs on, but belongs to another label
    assert body_size_px(picture, box, [box]) is None
    assert body_size_px(picture, box, [box, np.array([44.0, 38, 72, 46])]) == pytest.approx(6)
    assert body_size_px(picture, np.array([-20.0, -20, -10, -10]), []) is None
    corner = np.array([94.0, 94, 96, 96])
    assert body_size_px(picture, corner, [corner]) is None
