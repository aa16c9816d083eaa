"""`evaluate --tracks`: the sequences of a split, what a tracker makes of the detections in them, and its scores.

HOTA, MOTA and IDF1 are computed by trackeval's metric classes, with bootstrap intervals over sequences.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import ImageRecord
from infrablend.detection.detections import Detections, FloatArray, Task
from infrablend.detection.matching import draw_images, has_several_groups, interval, overlaps
from infrablend.detection.tracking import follow, tracker_settings
from infrablend.detection.truth import Case, Truth
from infrablend.errors import DatasetError, Problem
from infrablend.formats.sequence_writing import is_labelled
from infrablend.lab.evaluation.evaluation_record import TrackFacts, TrackRow
from infrablend.lab.evaluation.evaluation_settings import EvaluationSettings

_SAID = {
    "pictures_without_sequence": "pictures without a sequence are left out of the tracks",
    "pictures_without_number": "pictures without a number in their sequence are left out of the tracks",
    "sequences_without_numbers": "sequences without any numbered picture are left out of the tracks",
    "pictures_of_same_number": "pictures are left out of the tracks: others have their sequence and number",
    "pictures_not_labelled": "pictures in sequences have no labels: the tracker sees them, but they do not count",
    "numbers_missing": "numbers are missing within sequences: the tracker takes the pictures beside them as neighbours "
    "(of videos, --read every=1 reads all)",
    "objects_without_track": "objects in sequences have no track: detections of them are neither right nor wrong",
    "objects_repeated": "objects have the track of another one in their picture: detections of them do not count",
}


@dataclass(frozen=True, eq=False)
class Sequences:
    """The sequences of a split that can be tracked.

    Attributes:
        pictures: By name, the indices of the images of each sequence, in order.
        labels: Labels for tracks, by the index of the image; of labelled images only.
        counts: What there is, and what is left out.
    """

    pictures: Mapping[str, Sequence[int]]
    labels: Mapping[int, Truth]
    counts: Mapping[str, int]


def find_sequences(case: Case, problems: list[Problem]) -> Sequences:
    """Return the sequences of the images, and append a warning for all that is left out of them to `problems`.

    Raises:
        DatasetError: No sequence has an object with a track.
    """
    numbered, counts = _numbered(case.images)
    pictures = {name: [of[number] for number in sorted(of)] for name, of in sorted(numbered.items())}
    counts["numbers_missing"] = sum(max(of) - min(of) + 1 - len(of) for of in numbered.values())
    labels = {}
    for k in (k for of in pictures.values() for k in of):
        if not is_labelled(case.images[k]):
            counts["pictures_not_labelled"] += 1
            continue
        labels[k], without, repeated = only_tracked(case.labels[k])
        counts["objects_without_track"] += without
        counts["objects_repeated"] += repeated
    problems += [
        Problem("tracks", key.replace("_", "-"), f"{counts[key]} {text}", severity="warning")
        for key, text in _SAID.items()
        if counts[key]
    ]
    there = {int(c) for truth in labels.values() for c in truth.classes[~truth.ignore]}
    if not there:
        found = "; ".join(f"{counts[key]} {text}" for key, text in _SAID.items() if counts[key])
        todo = "take a dataset of sequences with tracks (docs/reference/formats.md), or leave out --tracks"
        problem = Problem("tracks", "no-tracks", found, "objects with tracks in sequences of numbered pictures", todo)
        raise DatasetError("no labelled track to compare with", [problem])
    absent = [name for c, name in enumerate(case.classes) if c not in there]
    if absent:
        found = f"no labelled track of {', '.join(absent)}: no figures of tracks"
        problems.append(Problem("tracks", "class-without-tracks", found, severity="warning"))
    pictures = {name: of for name, of in pictures.items() if not labels.keys().isdisjoint(of)}
    counts |= {"sequences": len(pictures), "pictures": len(labels), "classes_without_tracks": len(absent)}
    return Sequences(pictures, labels, {k: n for k, n in sorted(counts.items()) if n})


def _numbered(images: Sequence[ImageRecord]) -> tuple[dict[str, dict[int, int]], Counter[str]]:
    """Return the index of each image by sequence and number, and the number of images without either."""
    numbered: dict[str, dict[int, int]] = {}
    counts: Counter[str] = Counter()
    for k, image in enumerate(images):
        name = image.capture.sequence
        number = image.capture.frame
        if name is None:
            counts["pictures_without_sequence"] += 1
        elif number is None:
            counts["pictures_without_number"] += 1
        elif number in numbered.setdefault(name, {}):
            counts["pictures_of_same_number"] += 1
        else:
            numbered[name][number] = k
    all_names = {i.capture.sequence for i in images} - {None}
    counts["sequences_without_numbers"] = len(all_names - numbered.keys())
    return numbered, counts


def track_facts(case: Case, sequences: Sequences, settings: EvaluationSettings, problems: list[Problem]) -> TrackFacts:
    """Run the tracker on the detections of each sequence, and return the figures as in `evaluation.json`."""
    used = tracker_settings(settings.tracker)
    followed = []
    for name, which in sequences.pictures.items():
        found = follow([case.images[k] for k in which], [case.found[k] for k in which], used)
        known = [(sequences.labels[k], of) for k, of in zip(which, found, strict=True) if k in sequences.labels]
        followed.append(Followed(name, *zip(*known, strict=True)))
    rows = track_figures(followed, case.classes, case.task, settings.bootstrap, settings.seed)
    if not any(len(ids) for s in followed for _, ids in s.found):
        problems.append(Problem("tracks", "tracks-none", "the tracker found no track", severity="warning"))
    return {"tracker": used, "iou": MATCH_IOU, "counts": dict(sequences.counts), "classes": rows}


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
