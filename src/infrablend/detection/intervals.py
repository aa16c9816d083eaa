"""Bootstrap intervals of figures: images, or whole sequences, are drawn repeatedly with replacement."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from infrablend.core.rng import stream
from infrablend.detection.detections import FloatArray

LEVEL = 0.95


def draw_images(groups: Sequence[str], draws: int, seed: int) -> NDArray[np.int32]:
    """Return the (draws, i) number of times each image is drawn.

    Each draw takes as many groups as there are, with all their images.
    """
    names, number = np.unique(np.array(groups, dtype=np.str_), return_inverse=True)
    rng = stream(seed, "bootstrap", draws, len(names))
    drawn = rng.integers(0, len(names), (draws, len(names)))
    counts = np.zeros((draws, len(names)), np.int32)
    np.add.at(counts, (np.arange(draws)[:, None], drawn), 1)
    return np.asarray(counts[:, number], np.int32)


def has_several_groups(images: NDArray[np.bool_], groups: Sequence[str]) -> bool:
    """Whether the images chosen by (i,) are of two groups at least: drawing from one gives the same again and again."""
    return len({groups[k] for k in np.flatnonzero(images).tolist()}) > 1


def interval(values: FloatArray) -> list[float] | None:
    """Return the ends of the middle 95 % of drawn values without NaN; None if no value is left."""
    known = values[~np.isnan(values)]
    if not len(known):
        return None
    low, high = np.quantile(known, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return [float(low), float(high)]
