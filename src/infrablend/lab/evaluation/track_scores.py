"""HOTA, MOTA and IDF1 of tracks by trackeval's metric classes, with bootstrap intervals over sequences."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from infrablend.detection.detections import Detections, FloatArray, Task
from infrablend.detection.intervals import draw_images, has_several_groups, interval
from infrablend.detection.matching import overlaps
from infrablend.detection.truth import Truth
from infrablend.lab.evaluation.evaluation_record import TrackRow

MEASURES = ("hota", "deta", "assa", "mota", "idf1", "switches")
MATCH_IOU = 0.5
"""Least overlap of a match for MOTA and IDF1, and with regions to ignore; HOTA, DetA, AssA: mean over 0.05 to 0.95."""


@dataclass(frozen=True, eq=False)
class Followed:
    """What a tracker made of one sequence.

    Attributes:
        name: Name of the sequence.
        labels: Labels of its pictures, in order, from `only_tracked`.
        found: What is tracked in each picture, and the ids of the tracks.
    """

    name: str
    labels: Sequence[Truth]
    found: Sequence[tuple[Detections, NDArray[np.int64]]]


class SequenceData(TypedDict):
    """The tracks of one class in one sequence, by trackeval's names: ids and overlaps of each picture, and numbers."""

    gt_ids: list[NDArray[np.int64]]
    tracker_ids: list[NDArray[np.int64]]
    similarity_scores: list[FloatArray]
    num_gt_dets: int
    num_tracker_dets: int
    num_gt_ids: int
    num_tracker_ids: int
    num_timesteps: int


def only_tracked(truth: Truth) -> tuple[Truth, int, int]:
    """Return labels in which objects without a track are to be ignored, with the number of them.

    Of objects of one class and track in one picture, all but the first are to be ignored, too; the last number counts
    them.
    """
    objects = np.flatnonzero(~truth.ignore)
    named = [k for k in objects if truth.track_ids[k] is not None]
    first = {(truth.classes[k], truth.track_ids[k]): k for k in reversed(named)}
    ignore = np.ones_like(truth.ignore)
    ignore[list(first.values())] = False
    return replace(truth, ignore=ignore), len(objects) - len(named), len(named) - len(first)


def track_figures(
    sequences: Sequence[Followed], classes: Sequence[str], task: Task, draws: int, seed: int
) -> dict[str, TrackRow]:
    """Return the figures by class; `all` has their mean over the classes with labelled tracks, and all switches.

    Args:
        sequences: Labels and tracks of each sequence.
        classes: Names of the classes.
        task: What is compared.
        draws: Number of bootstrap draws of sequences; 0 for no intervals.
        seed: Seed of the draws.

    Returns:
        By class the numbers of `sequences` with such objects, labelled `tracks`, `objects` in pictures, and `found`
        tracks; the measures, None without labelled tracks; and their intervals `ci`, None if all objects are in one
        sequence. Draws without objects of a class are left out of its interval and of that of `all`.
    """
    names = [s.name for s in sequences]
    weights = np.concatenate([np.ones((1, len(names)), np.int32), draw_images(names, draws, seed)])
    counts = []
    values = []
    for c in range(len(classes)):
        data = [_sequence_data(s, c, task) for s in sequences]
        counts.append(np.array([[d["num_gt_dets"], d["num_gt_ids"], d["num_tracker_ids"]] for d in data], np.int64))
        values.append(_measure(data, weights))
        values[-1][weights @ counts[-1][:, 0] == 0] = np.nan
    there = [k for k, of in enumerate(counts) if of[:, 0].any()]
    mean = np.mean([values[k] for k in there], axis=0)
    mean[:, -1] *= len(there)
    return {
        name: _row(of, figures, names)
        for name, of, figures in zip(("all", *classes), [np.sum(counts, axis=0), *counts], [mean, *values], strict=True)
    }


def _row(counts: NDArray[np.int64], figures: FloatArray, names: Sequence[str]) -> TrackRow:
    objects, tracks, found = counts.sum(axis=0).tolist()
    held = counts[:, 0] > 0
    several = len(figures) > 1 and has_several_groups(held, names)
    hota, deta, assa, mota, idf1, switches = (float(v) if objects else None for v in figures[0])
    return {
        "sequences": int(held.sum()),
        "tracks": tracks,
        "objects": objects,
        "found": found,
        "hota": hota,
        "deta": deta,
        "assa": assa,
        "mota": mota,
        "idf1": idf1,
        "switches": None if switches is None else round(switches),
        "ci": {m: interval(figures[1:, k]) for k, m in enumerate(MEASURES)} if several else None,
    }


def _sequence_data(sequence: Followed, c: int, task: Task) -> SequenceData:
    """Return the tracks of one class as trackeval's metrics expect them, without detections in regions to ignore."""
    labelled: dict[Hashable, int] = {}
    tracked: dict[Hashable, int] = {}
    gt_ids = []
    tracker_ids = []
    similarity = []
    for truth, (found, ids) in zip(sequence.labels, sequence.found, strict=True):
        its = np.flatnonzero(found.classes == c)
        of = found.take(its)
        overlap = overlaps(of, truth, task)
        objects = np.flatnonzero((truth.classes == c) & ~truth.ignore)
        near = overlap >= MATCH_IOU
        kept = near[:, objects].any(axis=1) | ~(near & truth.regions_of(of.classes)).any(axis=1)
        gt_ids.append(_numbers([truth.track_ids[k] for k in objects], labelled))
        tracker_ids.append(_numbers(ids[its][kept].tolist(), tracked))
        similarity.append(overlap[kept][:, objects].T)
    return {
        "gt_ids": gt_ids,
        "tracker_ids": tracker_ids,
        "similarity_scores": similarity,
        "num_gt_dets": sum(map(len, gt_ids)),
        "num_tracker_dets": sum(map(len, tracker_ids)),
        "num_gt_ids": len(labelled),
        "num_tracker_ids": len(tracked),
        "num_timesteps": len(gt_ids),
    }


def _numbers(ids: Sequence[Hashable], known: dict[Hashable, int]) -> NDArray[np.int64]:
    return np.array([known.setdefault(i, len(known)) for i in ids], np.int64)


def _measure(data: Sequence[SequenceData], weights: NDArray[np.int32]) -> FloatArray:
    """Return the (b, 6) measures for (b, s) numbers of times that each sequence counts."""
    from trackeval.metrics import CLEAR, HOTA, Identity

    hota = HOTA()
    clear = CLEAR({"PRINT_CONFIG": False})
    identity = Identity({"PRINT_CONFIG": False})
    # Fields of HOTA are arrays over overlaps, to which the draws are a second axis: counts are multiplied, means stay.
    parts = {
        k: {
            field: value[:, None] * (weights[:, k] if field in hota.integer_array_fields else 1.0)
            for field, value in hota.eval_sequence(d).items()
            if np.ndim(value)
        }
        for k, d in enumerate(data)
    }
    figures = [hota.combine_sequences(parts)[f].mean(axis=0) for f in ("HOTA", "DetA", "AssA")]
    for metric, summed, wanted in (
        (clear, clear.summed_fields, ("MOTA", "IDSW")),
        (identity, identity.integer_fields, ("IDF1",)),
    ):
        of = [metric.eval_sequence(d) for d in data]
        totals = weights @ np.array([[r[f] for f in summed] for r in of], np.float64)
        combined = [metric.combine_sequences({"drawn": dict(zip(summed, row, strict=True))}) for row in totals]
        figures += [np.array([r[f] for r in combined], np.float64) for f in wanted]
    *shares, switches, idf1 = figures
    return np.column_stack([*shares, idf1, switches])
