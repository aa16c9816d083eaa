"""How likely a detector finds an object in the user's own pictures, measured with inserted ones.

The recipe's objects are inserted until the interval of the share that the detector finds is as narrow as asked for.
Where the pictures have labels of the class, the same figures of the real objects stand beside them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from infrablend.detection.detectability_record import AlarmFacts, CellFacts, MeasuredFacts, RecallFacts
from infrablend.detection.detections import FloatArray
from infrablend.detection.matching import SIZE_BINS
from infrablend.detection.recall import Share, difference, weighted_share, weights_of_sizes
from infrablend.detection.sightings import Sighting, share_found
from infrablend.pipeline.flights.corrected_counts import count_looks
from infrablend.pipeline.flights.detectability_request import DetectabilitySettings
from infrablend.pipeline.flights.insert_trials import Trials, stratum
from infrablend.report.figures import stratum_order

FACTS = "detectability.json"

# Figures are looked at after so many inserted objects, and again after so many more.
_FIRST = 40
_MORE = 20
# Least number of inserted objects in a cell, and of real ones, for it to be listed or compared.
_LEAST_IN_CELL = 10
LEAST_COMPARED = 40


@dataclass(frozen=True, eq=False)
class Comparison:
    """Inserted and real objects whose recall is compared.

    Attributes:
        inserted: Inserted objects.
        real: Real objects of the same kind; those that were searched.
        weights: Weights of the inserted objects; those of sizes that no real object has are 0.
        left_out: Number of real objects of sizes that no inserted one has.
    """

    inserted: Sequence[Sighting]
    real: Sequence[Sighting]
    weights: FloatArray
    left_out: int = 0

    @classmethod
    def of(cls, inserted: Sequence[Sighting], real: Sequence[Sighting], sizes: Sizes | None) -> Comparison:
        """Return the comparison with weights by the sizes of real objects; all equal without any."""
        if sizes is None or not len(sizes.px):
            return cls(inserted, real, np.ones(len(inserted)))
        px = np.array([s.size_px for s in inserted], np.float64)
        weights, left_out = weights_of_sizes(px, [stratum_of(s) for s in inserted], sizes.px, sizes.strata)
        if not weights.any():  # no inserted object has a size of the real ones
            weights = np.ones(len(inserted))
        return cls(inserted, real, weights, left_out)

    def predicted(self, confidence: float, score: Callable[[Sighting], float]) -> Share:
        """Return the share of inserted objects that are found."""
        found = np.array([score(s) >= confidence for s in self.inserted], np.bool_)
        return share_found(self.inserted, found, self.weights)

    def recall(self, confidence: float, score: Callable[[Sighting], float]) -> RecallFacts:
        """Return the shares of inserted and of real objects that are found."""
        said = self.predicted(confidence, score)
        facts: RecallFacts = {"predicted": said.value, "low": said.low, "high": said.high, "inserted": said.count}
        if self.real:
            found = np.array([score(s) >= confidence for s in self.real], np.bool_)
            actual = share_found(self.real, found)
            facts |= {
                "actual": actual.value,
                "actual_low": actual.low,
                "actual_high": actual.high,
                "real": actual.count,
            }
            apart = difference(said, actual)
            if apart is not None:
                facts["difference"] = list(apart)
        return facts


@dataclass(frozen=True, eq=False)
class Sizes:
    """Sizes of the labelled objects of a dataset.

    Attributes:
        px: (n,) longer sides of their boxes, px.
        strata: Their strata, see `insert_trials.stratum`.
    """

    px: FloatArray
    strata: Sequence[str]


def stratum_of(sighting: Sighting) -> str:
    """Return the stratum of an object, see `insert_trials.stratum`."""
    return stratum(sighting.conditions["time"], sighting.conditions["edge"])


def by_overlap(sighting: Sighting) -> float:
    """Return the score of the detection that overlaps the object."""
    return sighting.score


def by_place(sighting: Sighting) -> float:
    """Return the score of the detection at the place of the object, whatever its box."""
    return max(sighting.score, sighting.score_near)


def run_trials(
    trials: Trials,
    settings: DetectabilitySettings,
    seed: int,
    on_progress: Callable[[int, int], None] | None = None,
) -> None:
    """Insert and search until the interval is as narrow as asked for, or all rounds are done.

    Then search the pictures with labelled objects that no frame was made of: what the figures are compared with.
    """
    sizes = sizes_of(trials, settings)
    wanted = _FIRST
    share: Share | None = None
    for _ in trials.rounds(seed, settings.most_rounds):
        inserted = len(trials.inserted)
        if inserted >= wanted:
            share = Comparison.of(trials.inserted, (), sizes).predicted(settings.confidence, by_overlap)
            wanted = inserted + _MORE
            if share.half_width <= settings.until and share.count >= _FIRST:
                break
        if on_progress is not None:
            on_progress(inserted, max(inserted + 1, _needed(share, settings.until)))
    labelled = [i for i in trials.images() if any(trials.rules.is_class(o.category) for o in i.instances)]
    for image in labelled:
        trials.search(image)


def _needed(share: Share | None, until: float) -> int:
    """Return about how many inserted objects make half of the interval as narrow as `until`."""
    if share is None or not math.isfinite(share.half_width):
        return round(0.25 / (until / 2) ** 2)
    return round(share.count * (share.half_width / until) ** 2)


def sizes_of(trials: Trials, settings: DetectabilitySettings) -> Sizes | None:
    """Return the sizes to weight the inserted objects by; None to leave them as they are."""
    return Sizes(*trials.labelled_sizes()) if settings.sizes == "real" else None


def measured_facts(trials: Trials, settings: DetectabilitySettings) -> MeasuredFacts:
    """Return the figures of finished trials."""
    sizes = sizes_of(trials, settings)
    real = trials.real()
    whole = Comparison.of(trials.inserted, real, sizes)
    scores = [picture.found.scores[picture.alarms] for picture in trials.searched.values()]
    alarms = np.concatenate(scores) if scores else np.zeros(0)
    pictures = len(trials.searched)
    counts = {**trials.counts, "of_no_real_size": int((whole.weights == 0).sum())}
    return {
        "category": trials.rules.category,
        "confidence": settings.confidence,
        "least_overlap": settings.least_overlap,
        "recall": whole.recall(settings.confidence, by_overlap),
        "at_place": whole.recall(settings.confidence, by_place),
        "confidences": [
            AlarmFacts(
                **whole.recall(confidence, by_overlap),
                confidence=confidence,
                alarms_per_picture=float((alarms >= confidence).sum()) / max(pictures, 1),
            )
            for confidence in settings.confidences
        ],
        "cells": list(_cells(trials.inserted, real, settings, weighted=sizes is not None)),
        "tracks": _by_track(trials.inserted, settings.confidence),
        "counted": count_looks(trials, settings.confidence, labelled=len(real) > 0),
        "pictures": pictures,
        "weighted_by": "sizes of the labelled objects" if sizes is not None and len(sizes.px) else "nothing",
        "real_of_other_sizes": whole.left_out,
        "not_counted": {name: n for name, n in sorted(counts.items()) if n},
    }


def _cells(
    inserted: Sequence[Sighting], real: Sequence[Sighting], settings: DetectabilitySettings, *, weighted: bool
) -> Iterable[CellFacts]:
    """Yield the figures by size and by each condition, and by both time of day and size."""
    for by, value_of in _conditions(inserted).items():
        values = sorted(
            {v for s in (*inserted, *real) if (v := value_of(s)) is not None},
            key=lambda v: (v.rpartition(", ")[0], stratum_order(v.rpartition(", ")[2])),
        )
        for value in values:
            ours = [s for s in inserted if value_of(s) == value]
            theirs = [s for s in real if value_of(s) == value]
            sizes = None
            if weighted and theirs:
                px = np.array([s.size_px for s in theirs], np.float64)
                sizes = Sizes(px, [stratum_of(s) for s in theirs])
            facts = Comparison.of(ours, theirs, sizes).recall(settings.confidence, by_overlap)
            if facts["inserted"] < _LEAST_IN_CELL:
                continue
            yield CellFacts(**facts, by=by, value=value)


def _conditions(inserted: Sequence[Sighting]) -> dict[str, Callable[[Sighting], str | None]]:
    names = sorted({name for s in inserted for name in s.conditions})
    of: dict[str, Callable[[Sighting], str | None]] = {"size": size_bin}
    for name in names:
        of[name] = lambda s, name=name: s.conditions.get(name)  # type: ignore[misc]
    of["time, size"] = lambda s: f"{s.conditions['time']}, {size_bin(s)}"
    return of


def size_bin(sighting: Sighting) -> str:
    """Return the name of the range of sizes of an object, such as `8-16 px`."""
    name = next(n for n, (low, high) in SIZE_BINS.items() if n != "all" and low <= sighting.size_px < high)
    return f"{name} px"


def _by_track(inserted: Sequence[Sighting], confidence: float) -> RecallFacts | None:
    """Return the share of objects of sequences that are found at least once over all looks; None without tracks."""
    best: dict[str, float] = {}
    for s in inserted:
        if s.track:
            best[s.track] = max(best.get(s.track, 0.0), s.score)
    if not best:
        return None
    found = np.array([score >= confidence for score in best.values()], np.bool_)
    share = weighted_share(found, list(best))
    return {"predicted": share.value, "low": share.low, "high": share.high, "inserted": share.count}
