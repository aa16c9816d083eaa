"""Groups of images by pitch, altitude and time of day."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import ImageRecord

PITCH_EDGES_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0)
ALTITUDE_EDGES_M = (0.0, 20.0, 40.0, 60.0, 80.0, 100.0, 120.0, 150.0)
# At most this many different values get a bin each.
_SINGLE_VALUES = 10


def image_strata(images: Sequence[ImageRecord]) -> dict[str, dict[str, NDArray[np.bool_]]]:
    """Return (i,) masks of the images in each bin of pitch, altitude and time; `unknown` has those without a value."""
    return {
        "pitch": _binned([i.capture.pitch_deg for i in images], PITCH_EDGES_DEG),
        "altitude": _binned([i.capture.altitude_m for i in images], ALTITUDE_EDGES_M),
        "time": _time_of_day_bins([i.capture.time_of_day for i in images]),
    }


def _binned(values: Sequence[float | None], edges: Sequence[float]) -> dict[str, NDArray[np.bool_]]:
    """Bin by value if there are few different values (HIT-UAV has steps of 10), else by ranges."""
    known = sorted({v for v in values if v is not None})
    if len(known) <= _SINGLE_VALUES:
        names: Mapping[float, str] = {v: f"{v:g}" for v in known}
        ordered = [f"{v:g}" for v in known]
    else:
        place = np.searchsorted(np.array(edges), np.array(known), side="right")
        labels = [f"<{edges[0]:g}", *(f"{a:g}-{b:g}" for a, b in itertools.pairwise(edges))]
        labels.append(f">={edges[-1]:g}")
        names = {v: labels[int(k)] for v, k in zip(known, place, strict=True)}
        ordered = labels
    return _bins([None if v is None else names[v] for v in values], ordered)


def _time_of_day_bins(values: Sequence[str | None]) -> dict[str, NDArray[np.bool_]]:
    return _bins(values, ("day", "night"))


def _bins(values: Sequence[str | None], ordered: Sequence[str]) -> dict[str, NDArray[np.bool_]]:
    bins = ["unknown" if v is None else v for v in values]
    return {name: np.array([v == name for v in bins], np.bool_) for name in (*ordered, "unknown") if name in set(bins)}
