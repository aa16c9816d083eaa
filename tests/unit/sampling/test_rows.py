"""Rows of objects."""

from __future__ import annotations

import math

from infrablend.config.recipe import Group
from infrablend.sampling.rows import end_of_row, goes_on_behind


def test_a_row_goes_on_as_it_began() -> None:
    group = Group(share=1, apart_m=(2.5, 4), in_row=True, behind_m=(5.5, 8))
    mate, ahead, beside, crossing = (
        (0.0, 0.0, 0.0, 0.0),
        (6.0, 0.3, 0.0, 3.1),
        (0.2, 3.0, 0.0, 0.1),
        (6.0, 0.0, 0.0, 1.2),
    )
    assert goes_on_behind(mate, [mate], group) is None
    assert goes_on_behind(mate, [mate, crossing], group) is None
    assert goes_on_behind(mate, [mate, ahead], group) is True
    assert goes_on_behind(mate, [mate, ahead, beside], group) is False
    last = (11.0, 0.0, 0.0, 0.05)
    assert end_of_row(mate, [last, ahead, mate, beside], 0.0, 8.0) == last
    assert end_of_row(mate, [last, mate], 0.0, 8.0) == mate
    assert end_of_row(ahead, [last, ahead, mate], math.pi, 8.0) == mate
