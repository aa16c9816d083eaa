"""Distance between two sets of crops: squared maximum mean discrepancy (MMD) with the kernel of KID."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from infrablend.core.rng import stream
from infrablend.realism.features import Measured

SUBSET = 100
SUBSETS = 100
_SIDE = 8


@dataclass(frozen=True)
class Distance:
    """Mean and standard deviation of the distance over subsets."""

    mean: float
    sd: float


def dct_features(crops: Sequence[Measured]) -> NDArray[np.float64]:
    """Return the (n, 64) lowest frequencies of the cosine transform of each 48 px crop."""
    return np.array(
        [cv2.dct(m.patch.astype(np.float64) / 255.0)[:_SIDE, :_SIDE].ravel() for m in crops], np.float64
    ).reshape(len(crops), _SIDE * _SIDE)


def mmd(a: NDArray[np.float64], b: NDArray[np.float64]) -> Distance:
    """Return the unbiased MMD^2 with the kernel (x.y / d + 1)^3 over subsets of 100 crops.

    The features are used without scaling.

    Raises:
        ValueError: One of the sets is smaller than a subset.
    """
    if min(len(a), len(b)) < SUBSET:
        raise ValueError(f"MMD needs {SUBSET} crops on each side, got {len(a)} and {len(b)}")
    rng = stream(0, "mmd")
    found = []
    for _ in range(SUBSETS):
        x = a[rng.choice(len(a), SUBSET, replace=False)]
        y = b[rng.choice(len(b), SUBSET, replace=False)]
        xx, yy, xy = (_kernel(p, q) for p, q in ((x, x), (y, y), (x, y)))
        n = SUBSET
        within = (xx.sum() - np.trace(xx) + yy.sum() - np.trace(yy)) / (n * (n - 1))
        found.append(within - 2 * xy.mean())
    return Distance(float(np.mean(found)), float(np.std(found)))


def standardised(features: NDArray[np.float64], like: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return features minus the mean of `like`, divided by its standard deviation."""
    deviation = like.std(axis=0)
    return np.asarray((features - like.mean(axis=0)) / np.where(deviation > 0, deviation, 1), np.float64)


def _kernel(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray((x @ y.T / x.shape[1] + 1) ** 3, np.float64)
