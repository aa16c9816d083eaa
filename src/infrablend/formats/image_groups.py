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
from infrablend.formats.picture_facts import facts_from_name

Grouping = Literal["sequence", "date", "gap"]
GROUPINGS: tuple[Grouping, ...] = ("sequence", "date", "gap")

# Frames whose numbers differ by at most this much count as neighbours.
NEAR = 5
# Mark of a generated picture after the name of its background.
_CONFIGURATION = re.compile(r"(?<=.)(?:_c\d+(?:-\d+)?)+$", re.ASCII)
# Keys of Label Studio, before a name, and Roboflow, after it.
_UPLOAD = re.compile(r"[0-9a-f]{8}-(?!(?:[0-9a-f]{4}-){3})", re.ASCII)
_VERSION = re.compile(r"(?:_(?:jpe?g|png|bmp|tiff?|webp))?\.rf\.\w+$", re.ASCII | re.I)
# What programs append to the name of a copy: sizes, versions, crops, numbers of copies.
_APPENDED = re.compile(
    r"(?:[_.-](?:\d{2,5}x\d{2,5}|v\d{1,3}|(?:crop|tile|patch|aug|copy|rot|flip)[_-]?\d*)|\s?\(\d+\))+$", re.ASCII | re.I
)
# A number, a UUID, or a hash: a word of hexadecimal digits in which letters and decimal digits alternate.
_FIELD = re.compile(
    r"((?<![^\W_])(?:[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12}|(?=[0-9a-f]*(?:\d[a-f]+\d|[a-f]\d+[a-f]))[0-9a-f]{8,})"
    r"(?![^\W_])|\d+)",
    re.ASCII | re.I,
)


def background_stem(stem: str) -> str:
    """Return the stem of a picture's name without the mark of a generated picture: that of its background."""
    return _CONFIGURATION.sub("", stem)


def states_frame(image: ImageRecord) -> bool:
    """Return whether the frame number of an image is stated, so that nothing has to be guessed from its name."""
    capture = image.capture
    return facts_from_name(image.name) is not None or (capture.frame is not None and capture.sequence is not None)


def frame_places(images: Sequence[ImageRecord]) -> list[tuple[str, int] | None]:
    """Return the numbering and frame number of each image, or None if unknown.

    Frames of different numberings are never neighbours. Names in HIT-UAV's grammar contain a number that is unique in
    the whole dataset; otherwise each sequence, or else each clip that the names distinguish, has its own.
    """
    guessed = _guess_places([i.name for i in images])
    places: list[tuple[str, int] | None] = []
    for image, guess in zip(images, guessed, strict=True):
        facts = facts_from_name(image.name)
        sequence = image.capture.sequence
        if facts is not None:
            places.append(("", facts.frame))
        elif sequence is not None and image.capture.frame is not None:
            places.append((sequence, image.capture.frame))
        else:
            places.append(guess and (sequence if sequence is not None else guess[0], guess[1]))
    return places


def _guess_places(names: Iterable[str]) -> list[tuple[str, int] | None]:
    """Return the clip and frame number of each name.

    Among names that differ in numbers and hashes only, the last number that is not the same in all of them counts
    frames. The rest of the name is the clip, without what occurs with less than two frame numbers in the mean: such a
    time or hash names a picture, not a clip.
    """
    alike: dict[tuple[str, ...], list[list[str]]] = {}
    fields = []
    paths = [PurePosixPath(name) for name in names]
    uploads = [m[0] for p in paths if (m := _UPLOAD.match(p.name))]
    uploaded = len(uploads) == len(paths) and not all(u[:-1].isdecimal() for u in uploads)  # else dates
    for path in paths:
        stem = background_stem(_VERSION.sub("", path.stem[9:] if uploaded else path.stem))
        parts = _FIELD.split(bare if re.search(r"\d", bare := _APPENDED.sub("", stem)) else stem)
        parts[0] = f"{path.parent}/{parts[0]}"
        fields.append(parts)
        alike.setdefault(tuple(parts[::2]), []).append(parts)
    chosen = {texts: _frame_and_clip(those) for texts, those in alike.items()}
    places: list[tuple[str, int] | None] = []
    for parts in fields:
        frame, clip = chosen[tuple(parts[::2])]
        kept = "".join(p if k in clip else "*" if k == frame else "#" for k, p in enumerate(parts))
        places.append(None if frame is None else (kept, int(parts[frame])))
    return places


def _frame_and_clip(names: Sequence[Sequence[str]]) -> tuple[int | None, set[int]]:
    """Return which part of split names is the frame number, None without one, and which parts make up the clip."""
    values = [{n[k] for n in names} for k in range(len(names[0]))]
    numbers = [k for k in range(1, len(values), 2) if all(v.isdecimal() for v in values[k])]
    frame = max((k for k in numbers if len(values[k]) > 1), default=max(numbers, default=None))
    clip = {
        k for k in range(len(values)) if k != frame
        and (len(values[k]) == 1 or frame is None or len({(n[k], n[frame]) for n in names}) >= 2 * len(values[k]))
    }  # fmt: skip
    return frame, clip


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
    listed = tuple(images)
    for image, place in zip(listed, frame_places(listed), strict=True):
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
        lacks = "a frame number in their name"
        todo = "use --by sequence or --by date"
    elif by == "date":
        keys = {i.id: None if i.capture.captured is None else i.capture.captured[:10] for i in images}
        lacks = "a date of capture"
        todo = "use --by sequence or --by gap"
    else:
        keys = {i.id: i.capture.sequence for i in images}
        lacks = "a sequence"
        todo = "use --by gap, which needs numbers in the file names"
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
    places = zip(images, frame_places(images), strict=True)
    found: dict[str, str | None] = {i.id: None for i in images}
    ordered = sorted((place, image.id) for image, place in places if place is not None)
    name = ""
    before = None
    for (clip, number), id_ in ordered:
        if before is None or before[0] != clip or number - before[1] > gap:
            name = f"{clip} {number:06}".strip()
        found[id_] = name
        before = (clip, number)
    return found
