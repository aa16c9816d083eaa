"""Functions that all readers and writers share: result of detection, options, splits, ids."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from importlib import import_module
from pathlib import Path
from typing import Literal

from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Instance, Split
from infrablend.core.spool import StoredImages
from infrablend.errors import DatasetError, Problem
from infrablend.formats.losses import Written

SPLIT_FOLDERS: Mapping[str, Split] = {
    "train": "train", "training": "train", "trainset": "train",
    "val": "val", "valid": "val", "validation": "val", "valset": "val", "eval": "val", "evaluation": "val",
    "minival": "val", "valminusminival": "val",
    "test": "test", "testing": "test", "testset": "test", "testdev": "test",
}  # fmt: skip
"""Split by the name of a folder, or by a word of a file's name, in lower case."""


@dataclass(frozen=True)
class Match:
    """Whether a folder looks like one format, and the reason."""

    format: str
    ok: bool
    reason: str


@dataclass(frozen=True)
class FormatModule:
    """What the module of a format offers by these names; all but `detect` and `read` may be missing.

    Attributes:
        detect: Decides whether a folder has the format.
        read: Reads a folder. Takes `splits` (None for all), `metadata` if `TAKES_TABLE` (a table of pitch and altitude;
            None for any `metadata.csv` or `.json` in the folder), and the options as text. A DatasetError says that
            nothing can be read.
        write: Writes images of known size below a folder. Takes images, categories with the ids to write, and what
            `format_table.Writer` names, such as `pictures`: False writes only labels.
        read_parts: As `read`, but yields parts of a dataset too large for memory; takes a folder for their pictures.
        native_writer: Returns the name of the writer for `native`, where that is not the name of the format.
        remarks: Returns known faults of a public dataset, for `inspect`.
        OPTIONS: Options of the reader, and what each does.
        TAKES_TABLE: Whether the reader takes a table of pitch and altitude.
        TAKES_VIDEO: Whether `detect` and `read` also take one video in place of a folder.
    """

    detect: Callable[[Path], Match]
    read: Callable[..., Dataset]
    write: Callable[..., Written] | None = None
    read_parts: Callable[..., Iterator[Dataset]] | None = None
    native_writer: Callable[[Dataset], str] | None = None
    remarks: Callable[[Dataset], Sequence[str]] | None = None
    OPTIONS: Mapping[str, str] = field(default_factory=dict)
    TAKES_TABLE: bool = True
    TAKES_VIDEO: bool = False

    @classmethod
    def load(cls, name: str) -> FormatModule:
        """Return what a module offers; `name` is its dotted path."""
        found = vars(import_module(name))
        return cls(**{f.name: found[f.name] for f in fields(cls) if f.name in found})


def option_error(root: Path, name: str, value: object, expected: str) -> DatasetError:
    """Return the error for an option of a reader that has a wrong value."""
    problem = Problem(f"option {name}", "option-value", f"{name}={value}", expected)
    return DatasetError(f"{root}: an option has a value that is not allowed", [problem])


def step_of(root: Path, every: str) -> int | None:
    """Return the step in frames that an option states; None for an empty one.

    Raises:
        DatasetError: It is not a positive whole number.
    """
    text = str(every).strip()
    if text and not (text.isascii() and text.isdigit() and 0 < int(text) < 10**9):
        raise option_error(root, "every", every, "a positive number of frames")
    return int(text) if text else None


def require_options(root: Path, **given: tuple[object, Sequence[str]]) -> None:
    """Check that options of a reader have allowed values, given as name=(value, choices).

    Raises:
        DatasetError: An option has another value; the message lists all such options.
    """
    problems = [
        Problem(f"option {name}", "option-value", f"{name}={value}", f"one of {', '.join(choices)}")
        for name, (value, choices) in given.items()
        if value not in choices
    ]
    if problems:
        raise DatasetError(f"{root}: an option has a value that is not allowed", problems)


def check_splits(splits: Iterable[str] | None) -> tuple[Split, ...]:
    """Return the requested splits in canonical order; None means all.

    Raises:
        DatasetError: A name is not a split, or the list is empty.
    """
    if splits is None:
        return SPLITS
    wanted = set(splits)
    unknown = sorted(wanted - set(SPLITS))
    if unknown or not wanted:
        raise DatasetError(f"splits: found {unknown or 'none'}, expected some of train, val, test")
    return tuple(s for s in SPLITS if s in wanted)


def is_ignored_name(name: str) -> bool:
    """Return whether a category's name means a region to ignore, such as HIT-UAV's DontCare or "don't care"."""
    return "".join(c for c in name if c.isalnum()).casefold() == "dontcare"


def ignored_by_class(categories: Iterable[Category]) -> set[str]:
    """Return the names of the categories to ignore whose name alone does not reveal it."""
    return {c.name for c in categories if c.ignore and not is_ignored_name(c.name)}


def count_crowds(instances: Iterable[Instance], ignored: Collection[str]) -> int:
    """Return the number of crowds in other categories than `ignored`, which a format marks as regions to ignore."""
    return sum(i.is_crowd and i.category not in ignored for i in instances)


def unmarked_regions(instances: Iterable[Instance], by_class: Collection[str]) -> int:
    """Return the number of regions to ignore that a format without a mark for them turns into objects.

    Args:
        instances: Labels to write.
        by_class: Categories to ignore whose name does not reveal it, see `ignored_by_class`.
    """
    return sum(i.category in by_class or (i.is_crowd and not is_ignored_name(i.category)) for i in instances)


def require_known(image: ImageRecord, known: Collection[str]) -> None:
    """Check that the objects of an image have known categories; ValueError if one has not."""
    unknown = [i.category for i in image.instances if i.category not in known]
    if unknown:
        raise ValueError(f"{image.id}: category {unknown[0]!r} is not in the list of categories")


def split_of_stem(stem: str) -> Split:
    """Return the split that the name of an annotation file states, see `stated_split`, else `train`."""
    return stated_split(stem) or "train"


def stated_split(name: str) -> Split | None:
    """Return the split that a word in a name states, such as `val2017` or `myTest`; None without one.

    Only whole words count: `latest` and `valley` state no split. Of several splits the first in `SPLITS` counts.
    """
    words = re.split(r"[\W\d_]+", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).casefold())
    stated = {SPLIT_FOLDERS[w] for w in words if w in SPLIT_FOLDERS}
    return next((s for s in SPLITS if s in stated), None)


def split_folders(base: Path) -> list[tuple[Split, Path]]:
    """Return the subfolders that are named after a split, in any case; none of a folder that does not exist."""
    folders = sorted(d for d in base.iterdir() if d.is_dir()) if base.is_dir() else []
    return [(SPLIT_FOLDERS[d.name.lower()], d) for d in folders if d.name.lower() in SPLIT_FOLDERS]


def shorten(problems: Sequence[Problem], each: int = 5) -> list[Problem]:
    """Return the first `each` problems of every code and one with the number of the others, to shorten messages.

    The last one is a warning if all of the others are.
    """
    seen: Counter[str] = Counter()
    kept: list[Problem] = []
    left: list[Problem] = []
    for p in problems:
        seen[p.code] += 1
        (kept if seen[p.code] <= each else left).append(p)
    if left:
        rest = Counter(p.code for p in left)
        found = ", ".join(f"{n} more {code}" for code, n in sorted(rest.items()))
        harmless = all(p.severity == "warning" for p in left)
        kept.append(Problem("elsewhere", "more", found, severity="warning" if harmless else "error"))
    return kept


def sort_images(images: Iterable[ImageRecord]) -> tuple[ImageRecord, ...]:
    """Return the images by (split order, id), the order of a `Dataset` and of every written file."""
    return tuple(sorted(images, key=lambda image: (SPLITS.index(image.split), image.id)))


def in_order(images: Iterable[ImageRecord]) -> Sequence[ImageRecord]:
    """Return the images in the order of `sort_images`; images that are stored sorted stay where they are."""
    return images if isinstance(images, StoredImages) else sort_images(images)


def split_parts(ordered: Sequence[ImageRecord]) -> dict[Split, Sequence[ImageRecord]]:
    """Return the images of each split that has some; `ordered` is sorted."""
    counts = Counter(i.split for i in ordered)
    parts: dict[Split, Sequence[ImageRecord]] = {}
    start = 0
    for split in SPLITS:
        if counts[split]:
            parts[split] = ordered[start : start + counts[split]]
            start += counts[split]
    return parts


def require_size(image: ImageRecord) -> tuple[int, int]:
    """Return `image.size_wh`, which writers need; ValueError if it is unknown."""
    if image.size_wh is None:
        raise ValueError(f"{image.id}: size_wh must be known to write labels")
    return image.size_wh


@dataclass(frozen=True)
class Numbered:
    """Images with their ids and those of their objects; yields the chosen ones, as often as asked."""

    images: Sequence[ImageRecord]
    image_ids: Sequence[int | str]
    object_ids: Sequence[Sequence[int | str]]
    chosen: Sequence[int]

    def __iter__(self) -> Iterator[tuple[ImageRecord, int | str, Sequence[int | str]]]:
        """Yield each image with its id and the ids of its objects."""
        return ((self.images[n], self.image_ids[n], self.object_ids[n]) for n in self.chosen)

    def part(self, chosen: Sequence[int]) -> Numbered:
        """Return some of the images by their index."""
        return replace(self, chosen=chosen)

    def by_split(self) -> dict[Split, Numbered]:
        """Return the images of each split that has some."""
        parts = {}
        start = 0
        for split, images in split_parts(self.images).items():
            parts[split] = self.part(range(start, start + len(images)))
            start += len(images)
        return parts


def number_ids(images: Sequence[ImageRecord], ids: Literal["source", "new"], first: int) -> Numbered:
    """Return image ids and annotation ids for sorted images, counted from `first` over all splits, or the source's.

    With the source's ids, inserted objects get the numbers after the largest.

    Raises:
        ValueError: `ids="source"`, and the source's ids are missing or not unique in a split.
    """
    every = range(len(images))
    if ids == "source":
        image_ids = [i.source_id for i in images]
        known = [[o.source_id for o in i.instances if not (o.inserted and o.source_id is None)] for i in images]
        for rows in ([[i] for i in image_ids], known):
            for split in SPLITS:
                values = [v for i, row in zip(images, rows, strict=True) if i.split == split for v in row]
                if None in values or len(set(values)) != len(values):
                    raise ValueError('ids="source" needs a unique source_id of each; use ids="new"')
        free = itertools.count(max([first - 1, *(v for row in known for v in row if type(v) is int)]) + 1)
        object_ids = [[next(free) if o.source_id is None else o.source_id for o in i.instances] for i in images]
        return Numbered(images, image_ids, object_ids, every)  # type: ignore[arg-type]
    new_ids = []
    start = first
    for image in images:
        new_ids.append(range(start, start + len(image.instances)))
        start += len(image.instances)
    return Numbered(images, range(first, first + len(images)), new_ids, every)


def names_of(records: Iterable[ImageRecord]) -> list[str]:
    """Return the names of the categories of some records, sorted."""
    return sorted({i.category for r in records for i in r.instances})


def named_categories(names: Iterable[str]) -> tuple[Category, ...]:
    """Return categories with these names, numbered from 0; a name may mean a region to ignore."""
    return tuple(Category(n, name, "", is_ignored_name(name)) for n, name in enumerate(names))


def numbered_from_one(categories: Iterable[Category]) -> list[Category]:
    """Return the categories in the order of their ids, numbered from 1."""
    return [replace(c, id=n) for n, c in enumerate(sorted(categories, key=lambda c: c.id), 1)]


def category_ids(categories: Iterable[Category]) -> dict[str, int]:
    """Return the native id per category name; ValueError if a name or an id occurs twice."""
    ids: dict[str, int] = {}
    for c in categories:
        if c.name in ids or c.id in ids.values():
            raise ValueError(f"category {c.id} {c.name!r} occurs twice")
        ids[c.name] = c.id
    return ids
