"""Group the images of a dataset by flight, day or run of frames, divide groups over splits, and measure leakage.

Neighbouring frames of a video are nearly the same picture. If they are in different splits, a test measures memory,
not detection.
"""

from __future__ import annotations

import re
import shlex
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import PurePosixPath
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import SPLITS, Dataset, ImageRecord, Split
from infrablend.core.rng import stream
from infrablend.errors import DatasetError, Problem
from infrablend.formats.base import check_splits, sort_images
from infrablend.formats.picture_facts import facts_from_name
from infrablend.formats.values import to_time

Grouping = Literal["sequence", "date", "gap"]
GROUPINGS: tuple[Grouping, ...] = ("sequence", "date", "gap")

# Frames whose numbers differ by at most this much count as neighbours.
NEAR = 5
_DATE = len("2026-01-31")
# Number of orders in which groups are assigned; the best result is used.
_TRIES = 8
_OPTION = "--val-share"
# A share of val that is further off than by this factor is reported.
_FAR_OFF = 1.5
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
        k
        for k in range(len(values))
        if k != frame
        and (len(values[k]) == 1 or frame is None or len({(n[k], n[frame]) for n in names}) >= 2 * len(values[k]))
    }
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

    def to_json(self) -> dict[str, object]:
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
    _require_all(images, (keys[i.id] for i in images), by, lacks, todo)
    groups: dict[str, list[ImageRecord]] = {}
    for image in images:
        groups.setdefault(str(keys[image.id]), []).append(image)
    return {name: tuple(groups[name]) for name in sorted(groups)}


def time_blocks(images: Sequence[ImageRecord], shares: Sequence[float], gap: int) -> list[tuple[ImageRecord, ...]]:
    """Return one block of time per split with a share, with that split, in the order train, val, test.

    The order is that of the times of capture if all pictures have one, else that of sequences and frame numbers.

    Args:
        images: Pictures.
        shares: Shares of train, val and test among the pictures that are kept, with a sum of 1.
        gap: Pictures left out between two blocks, so that none is next to one of another split.

    Raises:
        DatasetError: Neither times nor numbers of all pictures are known, or the gaps leave a block without a picture.
    """
    ordered = _in_time(images)
    wanted = [k for k, share in enumerate(shares) if share > 0]
    kept = len(ordered) - gap * (len(wanted) - 1)
    if kept < len(wanted):
        found = f"{len(ordered)} picture(s), {gap} of which to leave out between each two of {len(wanted)} blocks"
        problem = Problem("--by time", "group-single", found, "a picture in each block", "use a smaller --gap")
        raise DatasetError("cannot cut the pictures into blocks of time", [problem])
    blocks = []
    start = 0
    for n, k in enumerate(wanted):
        end = round(kept * sum(shares[: k + 1])) + gap * n
        # No block is empty.
        end = min(max(end, start + 1), len(ordered) - (len(wanted) - n - 1) * (gap + 1))
        blocks.append(tuple(replace(i, split=SPLITS[k]) for i in ordered[start:end]))
        start = end + gap
    return blocks


def _in_time(images: Sequence[ImageRecord]) -> list[ImageRecord]:
    """Return pictures in the order of `time_blocks`; DatasetError if it is unknown."""
    times = [to_time(c) if (c := i.capture.captured) is not None and len(c) > _DATE else None for i in images]
    # With and without a time zone, times cannot be compared.
    known = len({None if t is None else t.tzinfo is None for t in times}) == 1 and None not in times
    keys: Sequence[Any] = times if known else frame_places(images)
    _require_all(images, keys, "time", "a time of capture or a frame number", "state captured in metadata.csv")
    return [i for _, i in sorted(zip(keys, images, strict=True), key=lambda pair: pair[0])]


def _require_all(images: Sequence[ImageRecord], keys: Iterable[object], by: str, lacks: str, todo: str) -> None:
    """Raise a DatasetError that counts the images without a key."""
    without = [i.name for i, key in zip(images, keys, strict=True) if key is None]
    if without:
        found = f"{len(without)} of {len(images)} images without {lacks}: {', '.join(without[:3])}"
        problem = Problem(f"--by {by}", "group-unknown", found, "one for every image", todo)
        raise DatasetError(f"cannot group by {by}", [problem])


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


# -- dividing groups over splits -------------------------------------------------------------------------------


def with_val(dataset: Dataset, share: float, splits: Sequence[str] | None = None) -> Dataset:
    """Move a share of the training images of a dataset without a val split to val, by day of capture and sequence.

    No day and no sequence is in both; a sequence belongs to its first day, and without dates stands for itself. Where
    all images are of one day, sequences are divided, with a warning. The same data are always divided in the same way.

    Args:
        dataset: Dataset with all its splits.
        share: Wanted share of val among the images and among the objects of each class, in (0, 1).
        splits: Splits to return; None for all.

    Raises:
        DatasetError: The dataset has a val split, or its training images cannot be divided.
    """
    wanted = check_splits(splits)
    held = Counter(i.split for i in dataset.images)
    if held["val"]:
        found = f"{held['val']} picture(s) in val already"
        raise _refused(dataset, "val-there", found, "data without a val split", "leave --val-share out")
    training = [i for i in dataset.images if i.split == "train"]
    groups, problems = _by_day(dataset, training)
    names = [c.name for c in dataset.categories if not c.ignore]
    weights = group_weights(groups.values(), names)
    chosen = assign_groups(weights, (1 - share, share), 0)
    if len(set(chosen)) == 1:  # the groups are so large that none or all fits the share best
        smallest = int(np.argmin(weights[:, 0]))
        chosen = [int(k == smallest) for k in range(len(groups))]
    of_val = [name for name, split in zip(groups, chosen, strict=True) if split]
    moved = {i.id for name in of_val for i in groups[name]}
    images = [replace(i, split="val") if i.split == "train" and i.id in moved else i for i in dataset.images]
    reached = len(moved) / len(training)
    if not share / _FAR_OFF <= reached <= share * _FAR_OFF:
        found = f"{len(moved)} of {len(training)} picture(s), {100 * reached:.0f} %: whole days or sequences only"
        expected = f"about {100 * share:.0f} %"
        problems.append(Problem(_OPTION, "val-share-far", found, expected, _by_hand(dataset), "warning"))
    per_split = np.array([weights[np.array(chosen) == k].sum(axis=0) for k in (0, 1)])
    if lacking := [n for n, (train, val) in zip(names, per_split[:, 1:].T, strict=True) if train and not val]:
        found = f"no object of {', '.join(lacking)} in val"
        problems.append(Problem(_OPTION, "class-absent", found, "objects of every class", _by_hand(dataset), "warning"))
    return replace(
        dataset,
        images=sort_images(i for i in images if i.split in wanted),
        problems=(*dataset.problems, *problems),
        notes={**dataset.notes, "val": {"share": round(reached, 4), "groups": of_val}},
    )


def _by_day(dataset: Dataset, training: Sequence[ImageRecord]) -> tuple[dict[str, list[ImageRecord]], list[Problem]]:
    """Return the images of each day or sequence, at least two groups in the order of their names, and warnings."""
    unknown = [i.name for i in training if i.capture.sequence is None and i.capture.captured is None]
    if unknown or not training:
        found = f"{len(unknown)} of {len(training)} training pictures have neither a sequence nor a date of capture: "
        found += ", ".join(unknown[:3])
        found = found if training else "no picture in train"
        expected = "one of both for each, such as a column sequence in metadata.csv"
        raise _refused(dataset, "group-unknown", found, expected, _by_hand(dataset))
    first_day: dict[str | None, str] = {}
    for capture in (i.capture for i in training):
        if capture.sequence is not None and capture.captured is not None:
            day = capture.captured[:10]
            first_day[capture.sequence] = min(day, first_day.get(capture.sequence, day))
    by_day: dict[str, list[ImageRecord]] = {}
    by_sequence: dict[str, list[ImageRecord]] = {}
    for i in training:
        sequence = i.capture.sequence
        day = (i.capture.captured or "")[:10]
        by_day.setdefault(first_day.get(sequence, day or str(sequence)), []).append(i)
        by_sequence.setdefault(day if sequence is None else sequence, []).append(i)
    if len(by_day) > 1:
        return dict(sorted(by_day.items())), []
    (whole,) = by_day
    if len(by_sequence) == 1:
        found = f"all {len(training)} training pictures are of {next(iter(by_sequence))}"
        raise _refused(dataset, "group-single", found, "at least two days or sequences", _by_hand(dataset, "time"))
    found = f"all training pictures are of {whole}, so train and val show different sequences of one day"
    todo = "judge detectors on pictures of another day"
    problem = Problem(_OPTION, "val-same-day", found, "sequences of several days", todo, "warning")
    return dict(sorted(by_sequence.items())), [problem]


def _by_hand(dataset: Dataset, by: str = "gap") -> str:
    command = f"infrablend split {shlex.quote(str(dataset.root))} OUT --by {by}"
    return f"leave --val-share out, or divide the data before ({command}) and give the result as data"


def _refused(dataset: Dataset, code: str, found: str, expected: str, todo: str) -> DatasetError:
    return DatasetError(f"{dataset.root}: no val split can be made", [Problem(_OPTION, code, found, expected, todo)])


def group_weights(groups: Iterable[Sequence[ImageRecord]], names: Sequence[str]) -> NDArray[np.float64]:
    """Return what to balance over the splits, (n, 1 + classes): each group's images, then its objects of each class."""
    rows = []
    for group in groups:
        counts = Counter(o.category for i in group for o in i.instances)
        rows.append([len(group), *(counts[n] for n in names)])
    return np.array(rows, np.float64)


def assign_groups(counts: NDArray[np.float64], shares: Sequence[float], seed: int) -> list[int]:
    """Return the index of the split of each of n groups so that every column of the (n, k) counts follows the shares.

    All columns weigh the same, whatever their sums; columns of zeros are ignored.
    """
    totals = counts.sum(axis=0)
    parts = counts[:, totals > 0] / totals[totals > 0]
    target = np.array(shares, np.float64)
    allowed = [k for k, share in enumerate(shares) if share > 0]
    best: tuple[float, list[int]] | None = None
    for attempt in range(_TRIES):
        # Large groups go first and small ones fill the gaps; later attempts vary the order slightly.
        shake = stream(seed, "split", attempt).uniform(0.5, 1.5, len(parts)) if attempt else np.ones(len(parts))
        order = np.argsort(-parts.sum(axis=1) * shake, kind="stable")
        chosen = np.full(len(parts), -1)
        held = np.zeros((len(target), parts.shape[1]))
        for g in order:
            chosen[g] = min((_cost_of(held, parts[g], s, target), s) for s in allowed)[1]
            held[chosen[g]] += parts[g]
        _improve(chosen, held, parts, target, allowed)
        cost = float(((held - target[:, None]) ** 2).sum())
        if best is None or cost < best[0] - 1e-12:
            best = cost, [int(s) for s in chosen]
    return best[1] if best is not None else []


def _cost_of(held: NDArray[np.float64], part: NDArray[np.float64], split: int, target: NDArray[np.float64]) -> float:
    before = held[split] - target[split]
    return float(((before + part) ** 2 - before**2).sum())


def _improve(
    chosen: NDArray[np.int_],
    held: NDArray[np.float64],
    parts: NDArray[np.float64],
    target: NDArray[np.float64],
    allowed: Sequence[int],
) -> None:
    """Move single groups to other splits, in place, until no move helps."""
    for _ in range(100):
        moved = False
        for g in range(len(parts)):
            here = int(chosen[g])
            held[here] -= parts[g]
            costs = ((round(_cost_of(held, parts[g], s, target), 12), s != here, s) for s in allowed)
            there = min(costs)[2]
            held[there] += parts[g]
            moved |= there != here
            chosen[g] = there
        if not moved:
            return
