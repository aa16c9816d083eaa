"""`evaluate --tracks`: the sequences of a split, and what a tracker makes of the detections in them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from infrablend.core.dataset import ImageRecord
from infrablend.detection.truth import Case, Truth
from infrablend.errors import DatasetError, Problem
from infrablend.formats.sequence_writing import is_labelled
from infrablend.lab.evaluation.evaluation_record import TrackFacts
from infrablend.lab.evaluation.evaluation_settings import EvaluationSettings
from infrablend.lab.evaluation.track_scores import MATCH_IOU, Followed, only_tracked, track_figures
from infrablend.lab.evaluation.tracking import follow, tracker_settings

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
