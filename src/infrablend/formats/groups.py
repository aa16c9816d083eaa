"""Group the images of a dataset by flight, day or run of frames, and measure leakage between splits.

Neighbouring frames of a video are nearly the same picture. If they are in different splits, a test measures memory,
not detection.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import PurePosixPath
from typing import Any, Literal

from infrablend.core.dataset import SPLITS, ImageRecord, Split
from infrablend.errors import DatasetError, Problem
from infrablend.formats.capture import facts_from_name

Grouping = Literal["sequence", "date", "gap"]
GROUPINGS: tuple[Grouping, ...] = ("sequence", "date", "gap")

# Frames whose numbers differ by at most this much count as neighbours.
NEAR = 5
# Mark of a generated picture after the name of its background.
_CONFIGURATION = re.compile(r"(?<=.)(?:_c\d+(?:-\d+)?)+$", re.ASCII)
_LAST_NUMBER = re.compile(r"^(.*?)(\d{1,12})(\D*)$", re.ASCII)


def background_stem(stem: str) -> str:
    """Return the stem of a picture's name without the mark of a generated picture: that of its background."""
    return _CONFIGURATION.sub("", stem)


def frame_place(image: ImageRecord) -> tuple[str, int] | None:
    """Return the numbering and frame number of an image, or None if unknown.

    Frames of different numberings are never neighbours. Names in HIT-UAV's grammar contain a number that is unique in
    the whole dataset; otherwise each sequence, or else each folder with the name up to the last number, has its own.
    """
    facts = facts_from_name(image.name)
    if facts is not None:
        return "", facts.frame
    name = PurePosixPath(image.name)
    match = _LAST_NUMBER.match(background_stem(name.stem))
    if image.capture.frame is not None and image.capture.sequence is not None:
        return image.capture.sequence, image.capture.frame
    if match is None:
        return None
    clip = image.capture.sequence if image.capture.sequence is not None else f"{name.parent}/{match[1]}*{match[3]}"
    return clip, int(match[2])


@dataclass(frozen=True)
class Leakage:
    """Number of images of one split that have neighbours in another split.

    Attributes:
        split: Split whose images are counted.
        other: Split of the neighbours.
        images: Number of images of `split` with a known frame number.
        near: Number of those with an image of `other` at most `distance` frames away.
        distance: Distance in frame numbers.
    """

    split: Split
    other: Split
    images: int
    near: int
    distance: int = NEAR

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return asdict(self)


def leakage(images: Iterable[ImageRecord], distance: int = NEAR) -> tuple[Leakage, ...]:
    """Count neighbours across splits: test and val against train, test against val; without numbers, no entry."""
    frames: dict[Split, dict[str, list[int]]] = {s: {} for s in SPLITS}
    for image in images:
        place = frame_place(image)
        if place is not None:
            frames[image.split].setdefault(place[0], []).append(place[1])
    found: list[Leakage] = []
    pairs: tuple[tuple[Split, Split], ...] = (("test", "train"), ("val", "train"), ("test", "val"))
    for split, other in pairs:
        known = {clip: sorted(numbers) for clip, numbers in frames[other].items()}
        own = [(clip, n) for clip, numbers in sorted(frames[split].items()) for n in numbers]
        if own and known:
            near = sum(_has_near(known.get(clip, ()), n, distance) for clip, n in own)
            found.append(Leakage(split, other, len(own), near, distance))
    return tuple(found)


def _has_near(numbers: Sequence[int], number: int, distance: int) -> bool:
    k = bisect_left(numbers, number - distance)
    return k < len(numbers) and numbers[k] <= number + distance


def group_images(images: Sequence[ImageRecord], by: Grouping, gap: int = NEAR) -> dict[str, tuple[ImageRecord, ...]]:
    """Return the images of each group by the group's name, sorted by name.

    A group is one sequence, one day of capture, or one run of frame numbers, which ends where the next number is more
    than `gap` away.

    Raises:
        DatasetError: Some images lack what they are to be grouped by; the problem counts them.
    """
    keys: Mapping[str, str | None]
    if by == "gap":
        keys = _runs(images, gap)
        lacks, todo = "a frame number in their name", "use --by sequence or --by date"
    elif by == "date":
        keys = {i.id: None if i.capture.captured is None else i.capture.captured[:10] for i in images}
        lacks, todo = "a date of capture", "use --by sequence or --by gap"
    else:
        keys = {i.id: i.capture.sequence for i in images}
        lacks, todo = "a sequence", "use --by gap, which needs numbers in the file names"
    without = [i.name for i in images if keys[i.id] is None]
    if without:
        found = f"{len(without)} of {len(images)} images without {lacks}: {', '.join(without[:3])}"
        problem = Problem(f"--by {by}", "group-unknown", found, "one for every image", todo)
        raise DatasetError(f"cannot group by {by}", [problem])
    groups: dict[str, list[ImageRecord]] = {}
    for image in images:
        groups.setdefault(str(keys[image.id]), []).append(image)
    return {name: tuple(groups[name]) for name in sorted(groups)}


def _runs(images: Sequence[ImageRecord], gap: int) -> dict[str, str | None]:
    places = {i.id: frame_place(i) for i in images}
    found: dict[str, str | None] = {i.id: None for i in images}
    ordered = sorted((place, id_) for id_, place in places.items() if place is not None)
    name, before = "", None
    for (clip, number), id_ in ordered:
        if before is None or before[0] != clip or number - before[1] > gap:
            name = f"{clip} {number:06}".strip()
        found[id_] = name
        before = (clip, number)
    return found
