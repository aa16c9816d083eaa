"""Selects part of a dataset: by class, number of pictures, number of objects, or flight conditions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from infrablend.annotation.classes import unknown_classes
from infrablend.core.dataset import Dataset, ImageRecord
from infrablend.core.rng import stream
from infrablend.errors import DatasetError, Problem
from infrablend.formats.base import sort_images
from infrablend.formats.pictures.images import load_background
from infrablend.pipeline.datasets.requests import MOST_COPIES, Selection, SelectionFacts


def select(dataset: Dataset, wanted: Selection) -> tuple[Dataset, SelectionFacts]:
    """Return the selected part of a dataset, and the facts of the selection with counts of left-out pictures by reason.

    The same dataset and selection give the same pictures. Pictures keep their order, their splits and all their labels.

    Raises:
        DatasetError: A class does not exist, no picture qualifies, or too few do. The error lists all problems.
    """
    problems = _problems(dataset, wanted)
    if problems:
        raise DatasetError(f"{dataset.root}: invalid selection", problems)
    named = wanted.with_class
    avoided = set(wanted.without)
    left_out: Counter[str] = Counter()
    pool: list[ImageRecord] = []
    for image in dataset.images:
        shown = {i.category for i in image.instances}
        if named is not None and named not in shown:
            left_out[f"without {named}"] += 1
        elif found := sorted(shown & avoided):
            left_out[f"with {found[0]}"] += 1
        else:
            pool.append(image)
    size = len(pool) if wanted.images is None else wanted.images
    most = len(pool) * (1 if wanted.like is None else MOST_COPIES)
    if not pool or size > most:
        expected = "at least one" if wanted.images is None else f"{wanted.images} (--images)"
        what = "; ".join(f"{n} {why}" for why, n in sorted(left_out.items())) or "none left out"
        raise DatasetError(
            f"{dataset.root}: too few pictures match the selection",
            [Problem("selection", "selection-short", f"{len(pool)} matching picture(s) ({what})", expected)],
        )
    if wanted.like is not None:
        like = [i for i in dataset.images if any(o.category == wanted.like for o in i.instances)]
        return _select_alike(dataset, pool, like, size, wanted, left_out)
    counts = np.array([sum(i.category == named for i in image.instances) for image in pool], np.int64)
    order = stream(wanted.seed, "select").permutation(len(pool))
    taken = order[:size] if wanted.objects is None else draw_with_sum(counts, order, size, wanted.objects)
    kept = [pool[k] for k in sorted(int(k) for k in taken)]
    if size < len(pool):
        left_out["not drawn"] += len(pool) - size
    facts: SelectionFacts = {**wanted.to_json(), "left_out": dict(sorted(left_out.items()))}
    if named is not None:
        facts["objects_taken"] = int(counts[taken].sum())
    return replace(dataset, images=tuple(kept)), facts


def _select_alike(
    dataset: Dataset,
    pool: Sequence[ImageRecord],
    like: Sequence[ImageRecord],
    size: int,
    wanted: Selection,
    left_out: Counter[str],
) -> tuple[Dataset, SelectionFacts]:
    copies = copies_to_match([conditions(i) for i in pool], [conditions(i) for i in like], size, wanted.seed)
    kept = []
    for image, n in zip(pool, copies, strict=True):
        if n > 0:
            kept.append(image)
        for k in range(1, n):
            name = PurePosixPath(image.name)
            again = name.with_name(f"{name.stem}_again{k}{name.suffix}").as_posix()
            kept.append(replace(image, id=f"{image.id}_again{k}", file_name=again))
    if never := sum(n == 0 for n in copies):
        left_out["not drawn"] += never
    facts: SelectionFacts = {
        **wanted.to_json(),
        "left_out": dict(sorted(left_out.items())),
        "pictures": sum(n > 0 for n in copies),
        "drawn_again": sum(n - 1 for n in copies if n > 1),
    }
    return replace(dataset, images=sort_images(kept)), facts


# Width of a step of grey level.
_LEVEL_STEP = 25.0
# Levels that weigh as much as 10 degrees of pitch or 20 m of height: an object looks less different on ground of
# another level than at another size.
_LEVEL_WEIGHT = 25.0


@dataclass(frozen=True, order=True)
class Conditions:
    """Conditions under which a picture was taken, rounded so that similar pictures compare equal.

    Attributes:
        time_of_day: `day` or `night`; empty if unknown.
        altitude_m: Height in steps of 10 m; -1 if unknown.
        pitch_deg: Camera pitch in steps of 10 degrees; -1 if unknown.
        level: Median grey level in steps of 25 of 255; -1 if the picture cannot be read.
    """

    time_of_day: str
    altitude_m: float
    pitch_deg: float
    level: float = -1

    def distance(self, other: Conditions) -> tuple[bool, float]:
        """Return how much two pictures differ: first the time of day, then 10 degrees, 20 m and 25 levels alike."""
        return (
            self.time_of_day != other.time_of_day,
            abs(self.altitude_m - other.altitude_m) / 20
            + abs(self.pitch_deg - other.pitch_deg) / 10
            + abs(self.level - other.level) / _LEVEL_WEIGHT,
        )


def conditions(image: ImageRecord) -> Conditions:
    """Return the conditions of a picture, with the grey level from its pixels.

    Where the sun shines the picture's processing has made the ground bright and the shade dark, and objects look
    different there: pictures of the same height, pitch and time of day are not yet alike.
    """
    height, pitch = (-1.0 if v is None else round(v, -1) for v in (image.capture.altitude_m, image.capture.pitch_deg))
    return Conditions(image.capture.time_of_day or "", height, pitch, _level(image))


def _level(image: ImageRecord) -> float:
    try:
        picture = load_background(image.path)
    except DatasetError:
        return -1  # what reads the selected pictures reports it
    median = float(np.median(picture.pixels)) * 255 / (2**picture.bit_depth - 1)
    return float(_LEVEL_STEP * round(median / _LEVEL_STEP))


def copies_to_match(pool: Sequence[Conditions], like: Sequence[Conditions], size: int, seed: int) -> list[int]:
    """Return the number of copies of each picture in the pool so that conditions are distributed as in `like`.

    The copies add up to `size`. If some conditions have too few pictures, even with `MOST_COPIES` copies of each, the
    nearest conditions supply the rest.
    """
    members: dict[Conditions, list[int]] = {}
    for k in stream(seed, "select").permutation(len(pool)).tolist():
        members.setdefault(pool[k], []).append(k)
    counts = Counter(like)
    shares = {f: size * n / len(like) for f, n in sorted(counts.items())}
    wanted = {f: int(s) for f, s in shares.items()}
    for f in sorted(shares, key=lambda f: (wanted[f] - shares[f], f))[: size - sum(wanted.values())]:
        wanted[f] += 1
    copies = [0] * len(pool)
    room = {f: MOST_COPIES * len(of) for f, of in members.items()}
    given: Counter[Conditions] = Counter()
    # All conditions first supply their own share; the nearest ones then fill the gaps.
    lacking: list[Conditions] = []
    for f, n in wanted.items():
        own = min(n, room.get(f, 0))
        given[f] += own
        lacking.extend([f] * (n - own))
    for f in lacking:
        free = [g for g in members if given[g] < room[g]]
        given[min(free, key=lambda g: (g.distance(f), g))] += 1
    for f, of in members.items():
        for n in range(given[f]):
            copies[of[n % len(of)]] += 1
    return copies


def draw_with_sum(counts: NDArray[np.int64], order: NDArray[np.int64], size: int, total: int) -> NDArray[np.int64]:
    """Return `size` of the indices in `order` whose counts add up to `total`, or come close to it.

    Starts with the first `size` indices and swaps one selected index for one unselected index, best swap first, as long
    as the sum comes closer to `total`. All other indices stay as they were drawn.
    """
    taken = order[:size].copy()
    left = order[size:].copy()
    missing = int(total - counts[taken].sum())
    while missing and len(taken) and len(left):
        after = np.abs(missing - (counts[left][None, :] - counts[taken][:, None]))
        a, b = np.unravel_index(int(np.argmin(after)), after.shape)
        if after[a, b] >= abs(missing):
            break
        missing -= int(counts[left[b]] - counts[taken[a]])
        taken[a], left[b] = left[b], taken[a]
    return taken


def _problems(dataset: Dataset, wanted: Selection) -> list[Problem]:
    known = ", ".join(c.name for c in dataset.categories) or "it has none"
    named = {
        "--with-class": [] if wanted.with_class is None else [wanted.with_class],
        "--without": wanted.without,
        "--like-class": [] if wanted.like is None else [wanted.like],
    }
    problems = []
    for option, names in named.items():
        if unknown := unknown_classes(dataset, names):
            expected = f"classes of the dataset ({known})"
            problems.append(Problem(option, "category-unknown", ", ".join(unknown), expected))

    def refuse(option: str, code: str, found: str, expected: str, todo: str = "") -> None:
        problems.append(Problem(option, code, found, expected, todo))

    if wanted.with_class is not None and wanted.with_class in wanted.without:
        refuse("--without", "selection-empty", f"{wanted.with_class}, also given as --with-class", "another class")
    for option, number in (("--images", wanted.images), ("--objects", wanted.objects)):
        if number is not None and number < 1:
            refuse(option, "selection-number", str(number), "a positive number")
    shown = {o.category for i in dataset.images for o in i.instances}
    if wanted.like is not None and wanted.objects is not None:
        refuse("--like-class", "selection-class", "given together with --objects", "only one of the two")
    elif wanted.like in {c.name for c in dataset.categories} - shown:
        refuse("--like-class", "selection-empty", f"no object of class {wanted.like}", "a class with objects")
    if wanted.objects is not None and wanted.with_class is None:
        found = f"{wanted.objects} objects, but no class"
        refuse("--objects", "selection-class", found, "objects of one class", "give --with-class")
    return problems
