"""Pairs of real and inserted objects of similar size, so that size cannot separate the two populations."""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence

from infrablend.core.rng import stream
from infrablend.realism.features import Measured

CALIPER_OCTAVES = 0.25


def pair_by_size(real: Sequence[Measured], inserted: Sequence[Measured], most: int) -> list[tuple[Measured, Measured]]:
    """Return (real, inserted) pairs whose box heights differ by at most a quarter of an octave.

    In random order, each inserted object is paired with the unused real one nearest in height, so both sides have the
    same distribution of sizes. Objects without a partner are left out, as are those with a flaw.

    Args:
        real: Real objects; each is used at most once.
        inserted: Inserted objects; each is used at most once.
        most: Largest number of pairs.
    """
    rest = sorted((math.log2(m.height_px), m.key, m) for m in real if not m.flaw)
    usable = sorted((m for m in inserted if not m.flaw), key=lambda m: m.key)
    order = stream(0, "pairs").permutation(len(usable))
    pairs: list[tuple[Measured, Measured]] = []
    for k in order:
        if len(pairs) == most:
            break
        m = usable[int(k)]
        size = math.log2(m.height_px)
        at = bisect.bisect_left(rest, (size, ""))
        near = [i for i in (at - 1, at) if 0 <= i < len(rest)]
        if not near:
            break
        best = min(near, key=lambda i: abs(rest[i][0] - size))
        if abs(rest[best][0] - size) <= CALIPER_OCTAVES:
            pairs.append((rest.pop(best)[2], m))
    return pairs
