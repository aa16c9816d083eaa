"""Assigns new splits to a dataset, keeping related images (a flight, a day, a run of frames) in the same split."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import get_args

from infrablend.core.dataset import SPLITS, Dataset, ImageRecord, Split
from infrablend.core.files import write_text
from infrablend.core.format_table import NATIVE, find_writer
from infrablend.core.output_checks import require_apart
from infrablend.core.workspace import SPLIT_FILE, replacing, workspace
from infrablend.errors import DatasetError, Problem
from infrablend.formats import writing
from infrablend.formats.base import shorten, sort_images
from infrablend.formats.image_groups import (
    NEAR,
    Leakage,
    assign_groups,
    group_images,
    group_weights,
    leakage,
    states_frame,
    time_blocks,
)
from infrablend.formats.pictures.listing import assign_ids, with_sizes
from infrablend.pipeline.datasets.origin import loosened_before, origin_of
from infrablend.pipeline.datasets.requests import SplitBy, SplitRule
from infrablend.report.card import dataset_card, write_card, written_layout

# A class is scarce in a split that has less than this part of its share of the class's objects.
_SCARCE = 0.2
# Between two blocks of time, this part of the pictures is left out, but not more than makes them no neighbours.
_GAPS_PER_FLIGHT = 20


@dataclass(frozen=True, eq=False)
class SplitReport:
    """Result of a new split and its quality.

    Attributes:
        out: Folder that was written.
        by: Grouping: images of one group stay in the same split.
        gap: Largest distance of frame numbers within a group, with `by="gap"`; pictures left out between two blocks,
            with `by="time"`.
        seed: Seed of the order in which groups were assigned.
        wanted: Requested shares of train, val and test.
        images: Number of images per split.
        objects: Number of objects written per class and split.
        groups: Split of each group.
        before: Neighbouring images in different splits, in the source's splits.
        after: Neighbouring images in different splits, in the new splits.
        format: Format that was written; `list` if only lists were written.
        losses: Counts of what the format cannot hold.
        files: Number of files written.
        problems: Warnings, e.g. about splits without images or without objects of a class.
    """

    out: Path
    by: SplitBy
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
        """Return the share of each split, from counts per split."""
        total = sum(counts.values())
        return {s: round(n / total, 4) if total else 0.0 for s, n in counts.items()}

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values, without the output folder."""
        return {
            "by": self.by,
            "gap": self.gap if self.by in ("gap", "time") else None,
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


def split_dataset(
    dataset: Dataset, out: Path, rule: SplitRule, *, to: str = NATIVE, lists: bool = False, overwrite: bool = False
) -> SplitReport:
    """Assign whole groups of images to train, val and test, and write the dataset with these splits.

    The number of images and of objects of each class come as close to the shares as whole groups allow: groups are
    assigned greedily, single groups are then moved while that helps, and the best of several orders is used. The same
    dataset and arguments give the same bytes.

    Args:
        dataset: Dataset as read; its own splits only serve to report the leakage before.
        out: Folder to write: new or empty, or with `overwrite` one that an earlier call wrote.
        rule: Grouping and shares.
        to: Format to write; `native` is the dataset's own.
        lists: Write only the record and the lists `train.txt`, `val.txt` and `test.txt`, with one path relative to the
            dataset per line.
        overwrite: Replace the folder that an earlier call wrote.

    Raises:
        DatasetError: The dataset lacks the facts that the grouping needs, its format has no writer, or the shares are
            invalid.
        OutputError: `out` is not empty, cannot be written, or another process is writing to it.
    """
    require_apart(dataset.root, out)
    if rule.by not in get_args(SplitBy):
        raise DatasetError(f"by: found {rule.by!r}, expected one of {', '.join(get_args(SplitBy))}")
    by = rule.by
    gap = min(NEAR, math.ceil(len(dataset.images) / _GAPS_PER_FLIGHT)) if by == "time" else NEAR
    gap = gap if rule.gap is None else rule.gap
    seed = rule.seed
    wanted = check_shares(rule.shares)
    if gap < 1:
        raise DatasetError(f"gap: found {gap}, expected a positive number of frames")
    native = writing.native_writer(dataset) if to == NATIVE else find_writer(to)
    if native is None and not lists:
        found = f"{dataset.format} without labels has no writer"
        problem = Problem(str(dataset.root), "format-unwritable", found, "a format to write", "give --to, or --list")
        raise DatasetError(f"{dataset.root}: cannot be written in its own format", [problem])
    names = [c.name for c in dataset.categories if not c.ignore]
    groups = _groups(dataset, by, gap, wanted)
    if unknown := sorted(set(rule.test) - (set(groups) if by != "time" else set())):
        expected = f"names of groups by {by}, such as {', '.join([*groups][:3])}"
        expected = "nothing: the last block of time is test" if by == "time" else expected
        wrong = [Problem("--test", "group-none", name, expected) for name in unknown]
        raise DatasetError(f"{dataset.root}: no such group", wrong)
    of_group: dict[str, Split] = dict.fromkeys(rule.test, "test")
    others = [name for name in groups if name not in of_group]
    rest = wanted[0] + wanted[1]
    shares = (wanted[0] / rest, wanted[1] / rest, 0.0) if of_group else wanted
    chosen = assign_groups(group_weights((groups[n] for n in others), names), shares, seed)
    of_group |= zip(others, (SPLITS[k] for k in chosen), strict=True)
    of_group = {name: group[0].split for name, group in groups.items()} if by == "time" else of_group
    images = [replace(i, split=of_group[name]) for name, group in groups.items() for i in group]
    report = SplitReport(
        out,
        by,
        gap,
        seed,
        wanted,
        {s: sum(i.split == s for i in images) for s in SPLITS},
        _objects_per_split(images, names),
        of_group,
        leakage(dataset.images),
        leakage(images),
        "list" if lists or native is None else native.name,
        problems=(*split_warnings(images, names, wanted, by, len(groups)), *_left_out(dataset, images)),
    )
    with workspace(out, "split dataset", SPLIT_FILE, replacing(overwrite)) as space:
        if lists:
            report = _write_lists(space.folder, report, images, dataset.root)
        else:
            report = _write_dataset(space.folder, report, images, dataset, to)
        content = report.to_json()  # without the source: the same bytes wherever the dataset is
        if loosened := loosened_before(dataset, replace(dataset, images=tuple(images))):
            labels = Counter(o.category for i in images for o in i.instances)
            content["counts"] = {**loosened, "labels": dict(sorted(labels.items()))}
        space.finish(content)
    return report


def _groups(
    dataset: Dataset, by: SplitBy, gap: int, wanted: tuple[float, float, float]
) -> dict[str, tuple[ImageRecord, ...]]:
    """Return the images that stay together by the name of their group; blocks of time are in their new splits."""
    if by == "time":
        blocks = time_blocks(dataset.images, wanted, gap)
        return {f"{block[0].split} {block[0].name} to {block[-1].name}": block for block in blocks}
    groups = group_images(dataset.images, by, gap)
    if by == "gap" and len(groups) == len(dataset.images) > 1 and not all(map(states_frame, dataset.images)):
        found = f"no two of {len(groups)} images have frame numbers at most {gap} apart, such as {next(iter(groups))}"
        todo = "use a larger --gap if these count frames, else --by sequence or --by date"
        problem = Problem("--by gap", "group-single", found, "numbers that count frames", todo)
        raise DatasetError("cannot group by gap: every group is one picture", [problem])
    return groups


def _left_out(dataset: Dataset, images: Sequence[ImageRecord]) -> list[Problem]:
    """Return a warning that counts the pictures of a dataset that are in none of the new splits."""
    if len(images) == len(dataset.images):
        return []
    objects = sum(len(i.instances) for i in dataset.images) - sum(len(i.instances) for i in images)
    found = f"{len(dataset.images) - len(images)} picture(s) with {objects} object(s) between the blocks are left out"
    expected = "no picture next to one of another split"
    return [Problem("split by time", "split-gap", found, expected, "use --gap to leave out fewer or more", "warning")]


def _objects_per_split(images: Sequence[ImageRecord], names: Iterable[str]) -> dict[str, dict[str, int]]:
    counts: dict[str, dict[str, int]] = {name: dict.fromkeys(SPLITS, 0) for name in names}
    for image in images:
        for instance in image.instances:
            if instance.category in counts:
                counts[instance.category][image.split] += 1
    return counts


def check_shares(shares: Sequence[float]) -> tuple[float, float, float]:
    """Return the three shares, scaled to a sum of 1.

    Raises:
        DatasetError: The shares are not three finite, non-negative numbers, at least two of them positive.
    """
    good = len(shares) == 3 and all(math.isfinite(s) and s >= 0 for s in shares)
    if not good or sum(s > 0 for s in shares) < 2:
        raise DatasetError(
            f"shares: found {list(shares)}, expected three numbers for train, val and test, two of them positive"
        )
    total = sum(shares)
    train, val, test = (s / total for s in shares)
    return train, val, test


def split_warnings(
    images: Sequence[ImageRecord], names: Sequence[str], wanted: Sequence[float], by: SplitBy, groups: int
) -> tuple[Problem, ...]:
    """Return warnings for splits without images, and for classes of which a split has no or hardly any objects."""
    problems = []
    smaller = "use other --shares" if by == "time" else "try another --seed"
    smaller += ", or --by gap, whose groups are smaller" if by != "gap" else ""
    total = Counter(o.category for i in images for o in i.instances)
    shares = dict(zip(SPLITS, wanted, strict=True))
    empty = [s for s in SPLITS if shares[s] > 0 and all(i.split != s for i in images)]
    if empty:
        names_of = f"{' and '.join(empty)} {'is' if len(empty) == 1 else 'are'} empty"
        holds = "one group holds all pictures" if groups == 1 else f"none of the {groups} groups was left"
        todo = "use a smaller --gap, or another --by" if by == "gap" else "use another --by, such as --by gap"
        todo += ", or --by time, which cuts it into blocks" if groups == 1 else ""
        problems.append(Problem(f"split by {by}", "split-empty", f"{names_of}: {holds}", "", todo, "warning"))
    for split, share in shares.items():
        if share == 0 or split in empty:
            continue
        here = [i for i in images if i.split == split]
        held = Counter(o.category for i in here for o in i.instances)
        if lacking := [n for n in names if total[n] and not held[n]]:
            found = f"no object of {', '.join(lacking)}"
            problems.append(Problem(split, "class-absent", found, "objects of every class", smaller, "warning"))
        if scarce := [n for n in names if held[n] and held[n] < _SCARCE * share * total[n]]:
            found = "only " + ", ".join(f"{held[n]} of {total[n]} objects of {n}" for n in scarce)
            expected = f"about {100 * share:.0f} % of the objects of every class"
            problems.append(Problem(split, "class-scarce", found, expected, smaller, "warning"))
    return tuple(problems)


def _write_lists(out: Path, report: SplitReport, images: Sequence[ImageRecord], root: Path) -> SplitReport:
    for split in SPLITS:
        here = [i.path for i in sort_images(images) if i.split == split]
        lines = [p.relative_to(root).as_posix() if p.is_relative_to(root) else str(p) for p in here]
        write_text(out / f"{split}.txt", "".join(f"{line}\n" for line in lines))
    return replace(report, files=len(SPLITS) + 1)


def _write_dataset(
    out: Path, report: SplitReport, images: Sequence[ImageRecord], source: Dataset, to: str
) -> SplitReport:
    unreadable: list[Problem] = []
    sized = with_sizes(images, lambda image: image.name, unreadable)
    if unreadable:
        raise DatasetError(f"{source.root}: the size of {len(unreadable)} picture(s) is unknown", shorten(unreadable))
    records = sort_images(_renamed(sized))
    written = writing.write(to, out, records, source.categories, source=source)
    done = f"The same pictures and labels in other splits, by {report.by}, seed {report.seed}; see `{SPLIT_FILE}`."
    card = dataset_card(
        origin_of(source, records, {}),
        records,
        source.categories,
        changes=[done, *(p.found for p in _left_out(source, images))],
        to=report.format,
        losses=written.losses,
        layout=written_layout(out, written.files, SPLIT_FILE),
    )
    write_card(out, card)
    kept = written.kept(records)
    return replace(
        report,
        objects={name: {s: kept[s, name] for s in of} for name, of in report.objects.items()},
        losses=written.losses,
        files=len(written.files) + 1,
        problems=(*report.problems, *written.problems),
    )


def _renamed(images: Sequence[ImageRecord]) -> list[ImageRecord]:
    """Give unique names to pictures that would have the same name within a split."""
    count = Counter((i.split, i.name) for i in images)
    if max(count.values(), default=0) < 2:
        return list(images)
    ids = assign_ids([i.id for i in images])
    return [replace(i, file_name=ids[i.id] + i.path.suffix) if count[i.split, i.name] > 1 else i for i in images]
