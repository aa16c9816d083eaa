from __future__ import annotations

import numpy as np

from infrablend.core.quantiles import percentile, quantile


def test_quantiles_of_single_precision_are_computed_in_double_precision() -> None:
    values = np.linspace(0, 1, 327_680, dtype=np.float32)
    # In single precision, this position would be off by a thousandth of a step.
    position = 0.123 * (len(values) - 1)
    below, above = values[int(position)], values[int(position) + 1]
    expected = float(below) + float(above - below) * (position - int(position))
    assert quantile(values, 0.123) == expected
    assert abs(percentile(values, 12.3) - expected) < 1e-15


def test_quantiles_of_whole_numbers() -> None:
    assert quantile(np.array([1, 2, 4], np.uint8), 0.75) == 3.0
    assert percentile(np.array([1, 2, 4], np.uint8), 50) == 2.0
