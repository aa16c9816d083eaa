"""The sequences of a run: their frames in order, and the tracks of the objects in them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from infrablend.core.frame_row import FrameRow
from infrablend.formats.labels.mot import ASSUMED_RATE
from infrablend.studio.run_labels import Box, Place, RunLabels


@dataclass(frozen=True)
class RunTrack:
    """An object through a sequence; objects of a class that have no ids share one track.

    Attributes:
        category: Class.
        id: Id in the sequence; empty for objects without one.
        inserted: Whether the run inserted it.
        boxes: Position of a frame in the sequence, from 0, and box in it, pixels; in the order of the positions.
    """

    category: str
    id: str
    inserted: bool
    boxes: tuple[tuple[int, Box], ...]


@dataclass(frozen=True)
class RunSequence:
    """A sequence of a run.

    Attributes:
        name: `<split>/<sequence>`.
        frames: Numbers of the rows of its frames, in order.
        times_s: Seconds of the frames since the first.
        tracks: Inserted tracks, then original ones.
    """

    name: str
    frames: tuple[int, ...]
    times_s: tuple[float, ...]
    tracks: tuple[RunTrack, ...]


def find_sequences(rows: Sequence[FrameRow], labels: RunLabels) -> list[RunSequence]:
    """Return the sequences of the frames of a run, by name; frames outside of sequences are left out."""
    groups: dict[str, list[tuple[Place, int]]] = defaultdict(list)
    for number, row in enumerate(rows):
        if (place := labels.place(row.image)) is not None:
            groups[place.sequence].append((place, number))
    found = []
    for name, group in sorted(groups.items()):
        group.sort(key=lambda one: (one[0].frame, one[1]))
        numbers = tuple(number for _, number in group)
        images = [rows[number].image for number in numbers]
        found.append(RunSequence(name, numbers, _seconds([place for place, _ in group]), _tracks(images, labels)))
    return found


def _seconds(places: Sequence[Place]) -> tuple[float, ...]:
    times = [place.time_s for place in places if place.time_s is not None]
    if len(times) < len(places) or any(b <= a for a, b in pairwise(times)):
        times = [place.frame / ASSUMED_RATE for place in places]
    return tuple(round(t - times[0], 6) for t in times)


def _tracks(images: Sequence[str], labels: RunLabels) -> tuple[RunTrack, ...]:
    boxes: dict[tuple[bool, str, str], list[tuple[int, Box]]] = defaultdict(list)
    for at, image in enumerate(images):
        for label in labels.of(image):
            if not label.ignore:
                boxes[not label.inserted, label.category, label.track].append((at, label.box_xyxy))
    ordered = sorted(boxes.items(), key=lambda one: (one[0][:2], len(one[0][2]), one[0][2]))
    return tuple(RunTrack(category, track, not original, tuple(b)) for (original, category, track), b in ordered)
