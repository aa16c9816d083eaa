"""New splits that keep what belongs together together: whole flights, days or runs of frames in one split each."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.dataset import SPLITS, Dataset, ImageRecord, Split
from infrablend.core.files import write_json, write_text
from infrablend.core.format_table import NATIVE, find_writer
from infrablend.core.output import OutputFolder, require_apart
from infrablend.core.rng import stream
from infrablend.errors import DatasetError, Problem
from infrablend.formats import writing
from infrablend.formats.base import shorten, sort_images
from infrablend.formats.groups import GROUPINGS, NEAR, Grouping, Leakage, group_images, leakage
from infrablend.formats.pictures import assign_ids, with_sizes
from infrablend.report.card import dataset_card, write_card

SHARES = (0.7, 0.1, 0.2)
RECORD = "split.json"
# Orders in which the groups are dealt out; the best result is taken.
_TRIES = 8


@dataclass(frozen=True, eq=False)
class SplitReport:
    """What a new split is and how good.

    Attributes:
        out: Where it was written.
        by: What was kept together.
        gap: In frame numbers; for `by="gap"`.
        seed: Of the order in which groups were dealt out.
        wanted: Share of train, val and test that was asked for.
        images: Images by split.
        objects: Grouping class and split.
        groups: Split by group.
        before: Neighbours across the splits as they were.
        after: Neighbours across the new ones.
        format: What was written; `list` for lists alone.
        losses: What the format could not hold.
        files: Files written.
        problems: Warnings: splits without images or classes.
    """

    out: Path
    by: Grouping
    gap: int
    seed: int
    wanted: tuple[float, float, float]
    images: Mapping[str, int]
    objects: Mapping[str, Mapping[str, int]]
    groups: Mapping[str, str]
    before: tuple[Leakage, ...]
    after: tuple[Leakage, ...]
    format: str
    losses: Mapping[str, int] = field(default_factory=dict)
    files: int = 0
    problems: tuple[Problem, ...] = ()

    def shares(self, counts: Mapping[str, int]) -> dict[str, float]:
        """Share of each split in some counts by split."""
        total = sum(counts.values())
        return {s: round(n / total, 4) if total else 0.0 for s, n in counts.items()}

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values, without the place it was written to."""
        return {
            "by": self.by,
            "gap": self.gap if self.by == "gap" else None,
            "seed": self.seed,
            "wanted": dict(zip(SPLITS, self.wanted, strict=True)),
            "images": dict(self.images),
            "image_shares": self.shares(self.images),
            "objects": {name: dict(of) for name, of in self.objects.items()},
            "object_shares": {name: self.shares(of) for name, of in self.objects.items()},
            "leakage_before": [one.to_json() for one in self.before],
            "leakage_after": [one.to_json() for one in self.after],
            "format": self.format,
            "losses": dict(self.losses),
            "files": self.files,
            "problems": [p.to_json() for p in self.problems],
            "groups": dict(self.groups),
        }


@dataclass(frozen=True)
class SplitRule:
    """How to split a dataset.

    Attributes:
        by: What stays together: a `sequence`, a `date`, or (`gap`) runs of frame numbers.
        gap: For `by="gap"`: a run ends where the next frame number is more than this many away; None for 5.
        shares: Shares of train, val and test; they are scaled to a sum of 1. A share of 0 leaves that split empty.
        seed: Seed of the order in which groups are assigned.
    """

    by: Grouping
    gap: int | None = None
    shares: Sequence[float] = SHARES
    seed: int = 0


def split_dataset(
    dataset: Dataset, out: Path, rule: SplitRule, *, to: str = NATIVE, lists: bool = False
) -> SplitReport:
    """Deal whole groups of images out to train, val and test and write the dataset so.

    The counts of images and of every class come as close to the shares as whole groups allow (greedy, then moves of
    single groups as long as they help, the best of several orders). Same dataset, same arguments, same bytes.

    Args:
        dataset: As read; its own splits are only used for the leakage before.
        out: Folder to write, new or empty.
        rule: What stays together, and the share of each split.
        to: The format to write; `native` is the dataset's own.
        lists: Write `train.txt`, `val.txt`, `test.txt` (paths as in the dataset, one a line) and the record alone.

    Raises:
        DatasetError: The dataset does not say what is to be kept together, its format has no writer, or the shares are
            none.
        OutputError: `out` is not empty or cannot be written.
    """
    require_apart(dataset.root, out)
    if rule.by not in GROUPINGS:
        raise DatasetError(f"by: found {rule.by!r}, expected one of {', '.join(GROUPINGS)}")
    by, gap, seed = rule.by, NEAR if rule.gap is None else rule.gap, rule.seed
    wanted = check_shares(rule.shares)
    if gap < 1:
        raise DatasetError(f"gap: found {gap}, expected a number of frames above 0")
    OutputFolder(out, "split dataset", RECORD).require_empty()
    native = writing.native_writer(dataset) if to == NATIVE else find_writer(to)
    if native is None and not lists:
        found = f"{dataset.format} without labels has no writer"
        problem = Problem(str(dataset.root), "format-unwritable", found, "a format to write", "give --to, or --list")
        raise DatasetError(f"{dataset.root}: cannot be written in its own format", [problem])
    groups = group_images(dataset.images, by, gap)
    names = [c.name for c in dataset.categories if not c.ignore]
    counts = np.array([_weights(group, names) for group in groups.values()], np.float64)
    chosen = deal_out(counts, wanted, seed)
    of_group: dict[str, Split] = dict(zip(groups, (SPLITS[k] for k in chosen), strict=True))
    images = [replace(i, split=of_group[name]) for name, group in groups.items() for i in group]
    report = SplitReport(
        out,
        by,
        gap,
        seed,
        wanted,
        {s: sum(i.split == s for i in images) for s in SPLITS},
        {
            n: {s: sum(o.category == n for i in images if i.split == s for o in i.instances) for s in SPLITS}
            for n in names
        },
        of_group,
        leakage(dataset.images),
        leakage(images),
        "list" if lists or native is None else native.name,
        problems=_warnings(images, names, wanted, by),
    )
    report = _write_lists(report, images, dataset.root) if lists else _write_dataset(report, images, dataset, to)
    write_json(out / RECORD, report.to_json())
    return report


def check_shares(shares: Sequence[float]) -> tuple[float, float, float]:
    """Three shares with a sum of 1.

    Raises:
        DatasetError: They are not three finite numbers of at least 0, with at least two above 0.
    """
    good = len(shares) == 3 and all(math.isfinite(s) and s >= 0 for s in shares)
    if not good or sum(s > 0 for s in shares) < 2:
        raise DatasetError(f"shares: found {list(shares)}, expected three numbers for train, val and test, two above 0")
    total = sum(shares)
    train, val, test = (s / total for s in shares)
    return train, val, test


def _weights(group: Sequence[ImageRecord], names: Sequence[str]) -> list[int]:
    """Return the counts of a group that are balanced over the splits: images, then objects of each class."""
    counts = Counter(o.category for i in group for o in i.instances)
    return [len(group), *(counts[n] for n in names)]


def deal_out(counts: NDArray[np.float64], shares: Sequence[float], seed: int) -> list[int]:
    """Return the split of each of n groups that divides every column of (n, k) counts as wanted.

    Columns count alike, whatever their sums; those that are all 0 do not count.
    """
    totals = counts.sum(axis=0)
    parts = counts[:, totals > 0] / totals[totals > 0]
    target = np.array(shares, np.float64)
    allowed = [k for k, share in enumerate(shares) if share > 0]
    best: tuple[float, list[int]] | None = None
    for attempt in range(_TRIES):
        # Large groups first, small ones fill up; beyond the first attempt the order is shaken a little.
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
    """How much worse the split becomes by a part: what lies below its share is free to be filled."""
    before = held[split] - target[split]
    return float(((before + part) ** 2 - before**2).sum())


def _improve(
    chosen: NDArray[np.int_],
    held: NDArray[np.float64],
    parts: NDArray[np.float64],
    target: NDArray[np.float64],
    allowed: Sequence[int],
) -> None:
    """Move single groups as long as that helps; in place."""
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


def _warnings(
    images: Sequence[ImageRecord], names: Sequence[str], wanted: Sequence[float], by: Grouping
) -> tuple[Problem, ...]:
    """Return warnings for splits without images and for classes missing from a split."""
    problems = []
    for split, share in zip(SPLITS, wanted, strict=True):
        if share == 0:
            continue
        here = [i for i in images if i.split == split]
        if not here:
            found = "no group is left for it"
            todo = "take a smaller --gap, if there is one" if by == "gap" else "take --by gap"
            problems.append(Problem(split, "split-empty", found, "more and smaller groups", todo, "warning"))
            continue
        lacking = [
            n
            for n in names
            if any(o.category == n for i in images for o in i.instances)
            and not any(o.category == n for i in here for o in i.instances)
        ]
        if lacking:
            found = f"no object of {', '.join(lacking)}"
            problems.append(
                Problem(split, "class-absent", found, "some of every class", "take another seed", "warning")
            )
    return tuple(problems)


def _write_lists(report: SplitReport, images: Sequence[ImageRecord], root: Path) -> SplitReport:
    for split in SPLITS:
        here = [i.path for i in sort_images(images) if i.split == split]
        lines = [p.relative_to(root).as_posix() if p.is_relative_to(root) else str(p) for p in here]
        write_text(report.out / f"{split}.txt", "".join(f"{line}\n" for line in lines))
    return replace(report, files=len(SPLITS) + 1)


def _write_dataset(report: SplitReport, images: Sequence[ImageRecord], source: Dataset, to: str) -> SplitReport:
    unreadable: list[Problem] = []
    sized = with_sizes(images, lambda image: image.name, unreadable)
    if unreadable:
        raise DatasetError(f"{source.root}: the size of {len(unreadable)} picture(s) is unknown", shorten(unreadable))
    records = sort_images(_renamed(sized))
    written = writing.write(to, report.out, records, source.categories, source=source)
    done = f"The same pictures and labels in other splits, by {report.by}, seed {report.seed}; see `{RECORD}`."
    card = dataset_card(source, records, source.categories, changes=[done], to=report.format, losses=written.losses)
    kept = write_card(report.out, card)
    return replace(
        report,
        losses=written.losses,
        files=len(written.files) + 1,
        problems=(*report.problems, *written.problems, *kept),
    )


def _renamed(images: Sequence[ImageRecord]) -> list[ImageRecord]:
    """Pictures of like name that come together in one split get names of their own."""
    count = Counter((i.split, i.name) for i in images)
    if max(count.values(), default=0) < 2:
        return list(images)
    ids = assign_ids([i.id for i in images])
    return [replace(i, file_name=ids[i.id] + i.path.suffix) if count[i.split, i.name] > 1 else i for i in images]
