"""Automatic gain control: 8-bit pictures from 16-bit ones, the same for originals and for pictures with inserts.

Each picture is mapped by itself, as a camera does, except with a fixed range of temperatures.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infrablend.config.agc import Agc, FixedAgc, LinearAgc, PlateauAgc
from infrablend.core.temperature import TemperatureScale

# Bins of the histogram for plateau equalisation; a bin is at least one count wide.
_BINS = 2048
_TOP = 255.0

Levels = NDArray[np.uint8]


def apply_agc(counts: NDArray[np.uint16], agc: Agc, scale: TemperatureScale | None = None) -> Levels:
    """Return the (h, w) 8-bit picture of a (h, w) 16-bit one; warm is bright where a scale says what is warm.

    Args:
        counts: The picture.
        agc: How to map it.
        scale: Scale of the counts; needed by a fixed range. A negative slope is turned over.

    Raises:
        ValueError: A fixed range without a scale.
    """
    if isinstance(agc, FixedAgc):
        if scale is None:
            raise ValueError("a fixed range of temperatures needs a temperature scale")
        celsius = scale.kelvin(counts) - 273.15
        return _rounded((celsius - agc.low_c) / (agc.high_c - agc.low_c) * _TOP)
    if scale is not None and scale.black_hot:
        counts = np.asarray(65_535 - counts, np.uint16)
    if isinstance(agc, LinearAgc):
        low, high = (float(v) for v in np.percentile(counts, [agc.low_percentile, agc.high_percentile]))
        return _rounded((counts.astype(np.float64) - low) / max(high - low, 1.0) * _TOP)
    return _plateau(counts, agc)


def _plateau(counts: NDArray[np.uint16], agc: PlateauAgc) -> Levels:
    """Return the picture after plateau equalisation."""
    outliers = [agc.outlier_percent, 100 - agc.outlier_percent]
    low, high = (float(v) for v in np.percentile(counts, outliers))
    width = max((high - low) / _BINS, 1.0)
    bins = max(int(np.ceil((high - low) / width)), 1)
    edges = low + width * np.arange(bins + 1)
    inner = counts[(counts >= low) & (counts <= high)]
    found, _ = np.histogram(inner, edges)
    kept = np.minimum(found, agc.plateau_percent / 100 * counts.size)
    share = agc.linear_percent / 100
    steps = (1 - share) * kept / max(float(kept.sum()), 1.0) + share / bins
    rise = np.minimum(_TOP * steps, agc.max_gain * width)
    curve = np.concatenate([[0.0], np.cumsum(rise)])
    unused = _TOP - curve[-1]
    if unused > 0:  # the largest gain does not fill the range: the median goes to the midpoint, as far as there is room
        median = float(np.interp(float(np.median(counts)), edges, curve))
        curve = curve + float(np.clip(agc.midpoint - median, 0.0, unused))
    return _rounded(np.interp(counts, edges, curve))


def _rounded(levels: NDArray[np.float64]) -> Levels:
    return np.asarray(np.clip(np.rint(levels), 0, _TOP), np.uint8)
