"""Divides groups of images over splits, so that no group is in two of them."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.rng import stream
from infrablend.errors import DatasetError, Problem
from infrablend.formats.base import check_splits, sort_images

# Number of orders in which groups are assigned; the best result is used.
_TRIES = 8
_OPTION = "--val-share"
# A share of val that is further off than by this factor is reported.
_FAR_OFF = 1.5


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
        raise _refused(dataset, "group-single", found, "at least two days or sequences", _by_hand(dataset))
    found = f"all training pictures are of {whole}, so train and val show different sequences of one day"
    todo = "judge detectors on pictures of another day"
    problem = Problem(_OPTION, "val-same-day", found, "sequences of several days", todo, "warning")
    return dict(sorted(by_sequence.items())), [problem]


def _by_hand(dataset: Dataset) -> str:
    command = f"infrablend split {shlex.quote(str(dataset.root))} OUT --by gap"
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
