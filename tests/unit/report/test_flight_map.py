"""The map of a flight counts how often ground was photographed, to scale."""

from __future__ import annotations

import numpy as np
import pytest

from infrablend.report.flight_map import photographed, round_length_m


def test_each_cell_is_counted_once_per_footprint() -> None:
    square = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    counts = photographed([square, square + [5.0, 0.0]], np.array([-5.0, -5.0]), 0.5, (40, 60))
    # OpenCV fills cells that an edge touches, too: less than a cell on each side.
    assert counts.max() == 2
    assert (counts > 0).sum() == pytest.approx(30 * 20, abs=2 * (30 + 20))
    assert (counts == 2).sum() == pytest.approx(10 * 20, abs=2 * (10 + 20))
    assert counts[20, 15] == 1
    assert counts[20, 25] == 2
    assert counts[5, 5] == 0


@pytest.mark.parametrize(("most", "length"), [(0.7, 0.5), (1.0, 1.0), (3.0, 2.0), (49.0, 20.0), (1200.0, 1000.0)])
def test_scale_bars_have_round_lengths(most: float, length: float) -> None:
    assert round_length_m(most) == pytest.approx(length)
