"""How many objects there are, from those that a detector finds and the share that it finds.

Each detection stands for 1/p objects, where p is the share of inserted objects found under the conditions of its look
(Horvitz and Thompson, Journal of the American Statistical Association 47, 1952). The conditions are those that are
known of a detection as well: time of day and ground pixel size, or height, not the true size. Counted are looks: an
object that three pictures show is three.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from infrablend.detection.detectability_record import CountFacts
from infrablend.detection.recall import NONE, Z95, Share
from infrablend.detection.sightings import Sighting, share_found
from infrablend.pipeline.flights.insert_trials import SearchedPicture, Trials, look_conditions

_LEAST_EFFECTIVE = 10.0
"""Fewest independent inserted objects under a condition whose share is used; otherwise that of all of them is."""

LookKey = tuple[str, str]
"""Time of day and range of ground pixel sizes of a look; the height instead of an unknown one, empty without either."""


class LookShares:
    """Share of objects found in one look, by what is known of the look."""

    def __init__(self, inserted: Sequence[Sighting], confidence: float) -> None:
        """Take the shares from inserted objects."""
        by_key: dict[LookKey, list[Sighting]] = {}
        for sighting in inserted:
            by_key.setdefault(look_key(sighting.conditions), []).append(sighting)
        self._whole = _share(inserted, confidence)
        self._shares = {key: _share(its, confidence) for key, its in by_key.items()}

    def known(self, key: LookKey) -> LookKey | None:
        """Return the key, or None where too few objects were inserted under its conditions to tell a share."""
        return key if self._shares.get(key, NONE).effective >= _LEAST_EFFECTIVE else None

    def __getitem__(self, key: LookKey | None) -> Share:
        """Return the share of a look; that of all looks where its own is not known."""
        known = None if key is None else self.known(key)
        return self._whole if known is None else self._shares[known]

    def all(self) -> list[Share]:
        """Return the shares of all looks and of those under each condition with enough inserted objects."""
        return [self._whole, *(s for s in self._shares.values() if s.effective >= _LEAST_EFFECTIVE)]


def look_key(conditions: Mapping[str, str]) -> LookKey:
    """Return the key of a look from its conditions."""
    return conditions["time"], conditions.get("ground pixel", conditions.get("height", ""))


def _share(inserted: Sequence[Sighting], confidence: float) -> Share:
    found = np.array([s.score >= confidence for s in inserted], np.bool_)
    return share_found(inserted, found)


def count_looks(trials: Trials, confidence: float, *, labelled: bool) -> CountFacts:
    """Return the corrected count of the objects that the searched pictures show.

    Args:
        trials: Finished trials.
        confidence: Least score of a detection.
        labelled: Whether labels say which detections are of real objects; otherwise all are counted.
    """
    shares = LookShares(trials.inserted, confidence)
    # Conditions that take the share of all looks have its error in common.
    counts: Counter[LookKey | None] = Counter()
    for picture in trials.searched.values():
        counts.update(shares.known(key) for key in _keys(picture, confidence, labelled=labelled))
    detections = sum(counts.values())
    facts: CountFacts = {
        "of": "labelled" if labelled else "all",
        "detections": detections,
        "corrected": None,
        "low": None,
        "high": None,
    }
    estimate = 0.0
    variance = 0.0
    for key, count in sorted(counts.items(), key=str):
        share = shares[key]
        if not share.value:
            return facts
        estimate += count / share.value
        variance += count * (1 - share.value) / share.value**2 + (count / share.value**2) ** 2 * share.variance
    if not detections:
        # Of a number that is found to be 0, the score interval of a Poisson count ends at the squared quantile.
        least = min(share.low or 0.0 for share in shares.all())
        return {**facts, "corrected": 0.0, "low": 0.0, "high": Z95**2 / least if least else None}
    half = Z95 * math.sqrt(variance)
    return {
        **facts,
        "corrected": estimate,
        "low": max(float(detections), estimate - half),
        "high": estimate + half,
    }


def _keys(picture: SearchedPicture, confidence: float, *, labelled: bool) -> list[LookKey]:
    counted = picture.found.scores >= confidence
    if labelled:
        counted &= ~picture.alarms
    boxes = picture.found.boxes_xyxy[counted]
    return [look_key(c) for c in look_conditions(picture.image, (boxes[:, :2] + boxes[:, 2:]) / 2)]
