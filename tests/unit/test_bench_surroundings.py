"""Levels and changes around objects, by distance."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

BOX = np.array([40.0, 40, 60, 55])


@pytest.fixture
def around(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "bench"))
    import surroundings

    return surroundings


def picture() -> np.ndarray:
    return np.full((100, 110), 100, np.float32)


def test_distances_count_rows_or_columns_from_the_nearest_box(around):
    away = around.distance_px((100, 110), [BOX, np.array([0.0, 0, 4.5, 4.5])])
    assert away[45, 50] == 0 and away[4, 4] == 0
    assert (away[39, 50], away[45, 63], away[57, 66]) == (1, 4, 7)


def test_changes_are_found_in_the_band_where_they_are(around):
    before, after = picture(), picture()
    after[45, 50] = 250  # inside
    after[38, 50] = 93  # 2 px above
    after[45, 70] = 104  # 11 px to the right
    found = around.largest_changes(before, after, [BOX])
    expected = np.zeros(len(around.BANDS_PX) + 1)
    expected[around.BANDS_PX.index(2)], expected[around.BANDS_PX.index(12)] = 7, 4  # the band from 10 to 12 px
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("contrast", [60, -50])
def test_levels_around_an_object_count_from_its_pixels_not_from_its_loose_box(around, contrast):
    shown = picture()
    shown[44:51, 44:56] += 5  # a rim of 2 px within the box and 1 px outside of it
    shown[40:55, 40:60] += 0
    shown[46:49, 46:54] = 100 + contrast
    found = around.levels_around(shown, np.array([43.0, 43, 57, 52]), [])
    assert found is not None
    measured, levels = found
    assert measured == pytest.approx(contrast, abs=8)
    np.testing.assert_allclose(levels[:2], 5)
    np.testing.assert_allclose(levels[3:], 0)


def test_faint_objects_and_uneven_ground_are_not_measured(around):
    faint = picture()
    faint[40:55, 40:60] += 20
    uneven = picture()
    uneven[:, 50:] += 40
    uneven[40:55, 40:60] = 250
    near_edge = picture()
    near_edge[0:20, 0:20] = 250
    assert around.levels_around(faint, BOX, []) is None
    assert around.levels_around(uneven, BOX, []) is None
    assert around.levels_around(near_edge, np.array([0.0, 0, 20, 20]), []) is None
