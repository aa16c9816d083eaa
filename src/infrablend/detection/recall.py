"""Recall with its interval: the share of objects that are found, weighted, for pictures that depend on each other.

Objects of one picture are found or missed together more often than by chance. The variance of a share therefore comes
from the sums over clusters of pictures (linearised, as for ratio estimators in sample surveys: Cochran, Sampling
Techniques, 1977, chapter 6), and says how many independent objects would have the same. Wilson's interval (Journal of
the American Statistical Association 22, 1927) of that many lies within 0 and 1, and holds for shares near either.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infrablend.detection.detections import FloatArray

# Mean number of real objects in a bin of sizes, and of inserted ones, at least: with fewer, a few of them would weigh
# as much as all others.
_LEAST_REAL = 20
_LEAST_INSERTED = 15
Z95 = 1.959964
"""Quantile of the normal distribution for intervals of 95 %."""


@dataclass(frozen=True)
class Share:
    """A share and its interval of 95 %.

    Attributes:
        value: The share; None without objects.
        low: Lower end.
        high: Upper end.
        count: Number of objects.
        effective: Number of independent objects with the same variance.
    """

    value: float | None
    low: float | None
    high: float | None
    count: int
    effective: float = 0.0

    @property
    def half_width(self) -> float:
        """Half of the interval's width; infinite without objects."""
        return math.inf if self.low is None or self.high is None else (self.high - self.low) / 2

    @property
    def variance(self) -> float:
        """Variance of the share, from the width of its interval."""
        return (self.half_width / Z95) ** 2


NONE = Share(None, None, None, 0)


def weighted_share(
    found: NDArray[np.bool_],
    clusters: Sequence[str],
    weights: FloatArray | None = None,
    tracks: Sequence[str] | None = None,
) -> Share:
    """Return the share of (n,) objects that are found.

    Args:
        found: (n,) whether each object is found.
        clusters: n names of the groups of pictures that the objects are in.
        weights: (n,) weights of the objects; all equal by default.
        tracks: n names of objects that several pictures show; looks at the same one depend on each other, too.
    """
    weight = np.ones(len(found)) if weights is None else weights
    total = float(weight.sum())
    if not total > 0:
        return NONE
    value = float((weight * found).sum() / total)
    residuals = weight * (found - value)
    groups, variance = _of_clusters(residuals, clusters, weight)
    if tracks is not None:
        # Both dependences (Cameron, Gelbach and Miller, Journal of Business & Economic Statistics 29, 2011), of which
        # neither makes an interval narrower.
        fewer, of_tracks = _of_clusters(residuals, tracks, weight)
        groups = min(groups, fewer)
        variance = max(variance, of_tracks, variance + of_tracks - float((residuals**2).sum()))
    variance /= total**2
    independent = total**2 / float((weight**2).sum())
    # A share of 0 or 1, or a single cluster, has no variance to tell from: then each cluster counts as one object.
    effective = min(groups, independent)
    if groups > 1 and variance > 0:
        effective = min(value * (1 - value) / variance, independent)
    low, high = wilson(value, effective)
    return Share(value, low, high, int((weight > 0).sum()), effective)


def _of_clusters(residuals: FloatArray, clusters: Sequence[str], weight: FloatArray) -> tuple[int, float]:
    """Return the number of clusters with weight, and the variance of the sum of the residuals over them."""
    _, numbers = np.unique(np.asarray(clusters), return_inverse=True)
    groups = int(np.count_nonzero(np.bincount(numbers, weight)))
    return groups, groups / max(groups - 1, 1) * float((np.bincount(numbers, residuals) ** 2).sum())


def wilson(share: float, count: float) -> tuple[float, float]:
    """Return Wilson's interval of 95 % of a share among `count` independent objects.

    >>> [round(end, 3) for end in wilson(0.8, 100)]
    [0.711, 0.867]
    """
    scale = 1 + Z95**2 / count
    middle = (share + Z95**2 / (2 * count)) / scale
    half = Z95 / scale * math.sqrt(share * (1 - share) / count + Z95**2 / (4 * count**2))
    # The ends of a share of 0 or 1 are that share, but for rounding.
    return max(0.0, min(middle - half, share)), min(1.0, max(middle + half, share))


def difference(one: Share, other: Share) -> tuple[float, float, float] | None:
    """Return `one - other` and the ends of its interval, from the errors of both; None where one is unknown.

    The interval combines those of both shares (Newcombe, Statistics in Medicine 17, 1998), so it may be lopsided.
    """
    if one.value is None or other.value is None or one.low is None or other.low is None:
        return None
    assert one.high is not None and other.high is not None
    value = one.value - other.value
    low = value - math.hypot(one.value - one.low, other.high - other.value)
    high = value + math.hypot(one.high - one.value, other.value - other.low)
    return value, low, high


def weights_of_sizes(
    sizes_px: FloatArray, strata: Sequence[str], real_px: FloatArray, real_strata: Sequence[str], bins: int = 8
) -> tuple[FloatArray, int]:
    """Return weights that give inserted objects the sizes of real ones, in each stratum, and the real ones left out.

    In each stratum the real sizes are divided at their quantiles, so that a bin has as many real objects as another;
    the inserted objects of a bin share the weight of its real ones. Those beyond the sizes of all real ones have none.

    Args:
        sizes_px: (n,) sizes of the inserted objects.
        strata: n strata, such as times of day.
        real_px: (m,) sizes of the real objects.
        real_strata: m strata of the real objects.
        bins: Most bins of a stratum.

    Returns:
        (n,) weights, which add up to the real objects that are represented, and the number of the others: of sizes or
        strata that no inserted object has.
    """
    weights = np.zeros(len(sizes_px))
    left_out = 0
    stratum, real_stratum = np.asarray(strata), np.asarray(real_strata)
    for name in sorted(set(real_strata)):
        real = real_px[real_stratum == name]
        inserted = np.flatnonzero((stratum == name) & (sizes_px >= real.min()) & (sizes_px <= real.max()))
        count = max(1, min(bins, len(real) // _LEAST_REAL, len(inserted) // _LEAST_INSERTED))
        edges = np.quantile(real, np.linspace(0, 1, count + 1)[1:-1])
        of_inserted = np.searchsorted(edges, sizes_px[inserted], side="right")
        of_real = np.bincount(np.searchsorted(edges, real, side="right"), minlength=len(edges) + 1)
        for k, reals in enumerate(of_real):
            its = inserted[of_inserted == k]
            if len(its):
                weights[its] = reals / len(its)
            else:
                left_out += int(reals)
    return weights, left_out
