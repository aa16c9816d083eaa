"""Quantiles that are the same with numpy 1 and 2."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32] | NDArray[np.float64]


def quantile(values: Numbers, share: float) -> float:
    """Return a quantile of all values, computed in double precision.

    Of values in single precision, `np.quantile` of numpy 2 computes it in single precision, unless it is asked for a
    list of quantiles.
    """
    return float(np.quantile(values, [share])[0])


def percentile(values: Numbers, percent: float) -> float:
    """Return a percentile of all values; see `quantile`."""
    return float(np.percentile(values, [percent])[0])
