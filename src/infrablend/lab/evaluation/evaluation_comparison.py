"""Stored evaluations: their matches, and the comparison of two evaluations on the same images."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infrablend.core.arguments import require_names, require_whole
from infrablend.core.files import open_regular, read_regular, replace_atomically
from infrablend.detection.detections import MATCHES, RECORD
from infrablend.detection.matching import ClassMatches, draw_images
from infrablend.detection.truth import match_classes
from infrablend.errors import ArgumentError, DatasetError, Problem
from infrablend.lab.evaluation.evaluation_record import Difference, EvaluatedDataset, EvaluationRecord, Paired, Rival
from infrablend.lab.evaluation.precision import paired


@dataclass(frozen=True, eq=False)
class StoredMatches:
    """The content of `matches.npz`: enough to compare two evaluations without their dataset.

    Attributes:
        classes: Names of the evaluated classes.
        matches: Matches of each class, objects of all sizes together.
        groups: Group of each image; those of one group are drawn together.
    """

    classes: tuple[str, ...]
    matches: tuple[ClassMatches, ...]
    groups: tuple[str, ...]


@dataclass(frozen=True)
class EvaluationComparison:
    """Difference of two evaluations on the same images.

    Attributes:
        against: Name and detector of the second evaluation.
        draws: Number of bootstrap draws.
        detectors: Number of detectors on each side.
        classes: Per class and metric (`map50`, `map50_95`): both values, their difference and its interval.
        left_out: Classes that only one side evaluated.
    """

    against: Rival
    draws: int
    detectors: Sequence[int]
    classes: Mapping[str, Mapping[str, Difference | None]]
    left_out: Sequence[str]

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return dict(vars(self))


def compare_evaluations(
    ours: Sequence[Path],
    theirs: Sequence[Path],
    *,
    classes: Sequence[str] | None = None,
    bootstrap: int = 1000,
    seed: int = 0,
) -> Paired:
    """Return the difference by class of two evaluations on the same images and labels; see `infrablend.api`.

    Raises:
        ArgumentError: A side has no evaluation, or another value is invalid.
        DatasetError: The evaluations do not fit together.
    """
    for side, folders in (("ours", ours), ("theirs", theirs)):
        if not folders:
            raise ArgumentError(f"{side}: found no folder, expected that of at least one evaluation")
    require_names("classes", classes)
    require_whole("bootstrap", bootstrap, 0)
    record, first = read_evaluation(ours[0])
    expected = recorded_conditions(record)
    read = {folder: read_evaluation(folder) for folder in [*ours[1:], *theirs]}
    for folder, (other, _) in read.items():
        require_same(other, expected, folder)
    if classes is not None:
        numbers = match_classes(first.classes, classes)
        unknown = [name for name, of in numbers.items() if not of]
        if unknown:
            raise DatasetError(f"classes: found {', '.join(unknown)}, expected some of {', '.join(first.classes)}")
        kept = [k for k in range(len(first.classes)) if any(k in of for of in numbers.values())]
        first = StoredMatches(
            tuple(first.classes[k] for k in kept), tuple(first.matches[k] for k in kept), first.groups
        )
    a = [first, *(read[f][1] for f in ours[1:])]
    b = [read[f][1] for f in theirs]
    return paired_facts(a, b, read[theirs[0]][0], theirs[0].name, bootstrap, seed)


def paired_facts(
    ours: Sequence[StoredMatches],
    theirs: Sequence[StoredMatches],
    record: EvaluationRecord,
    name: str,
    draws: int,
    seed: int,
) -> Paired:
    """Return the differences by class; `record` and `name` are those of the second side, groups those of the first."""
    sides = [*ours, *theirs]
    both = [n for n in ours[0].classes if all(n in j.classes for j in sides)]
    if not both:
        raise DatasetError(
            f"{name}: evaluates {', '.join(theirs[0].classes)}; expected some of {', '.join(ours[0].classes)}"
        )
    weights = draw_images(ours[0].groups, draws, seed)
    a, b = ([[j.matches[j.classes.index(n)] for n in both] for j in side] for side in (ours, theirs))
    return {
        "against": {"name": name, "detector": record["detector"]},
        "draws": draws,
        "detectors": [len(ours), len(theirs)],
        "classes": paired(a, b, both, weights, ours[0].groups, seed),
        "left_out": sorted({n for j in sides for n in j.classes} - set(both)),
    }


_SAME = {
    "split": "give both the same --split",
    "images": "evaluate both on the same split of the same dataset",
    "labels": "evaluate both on the same split and labels",
    "task": "give both the same --task",
    "ignored regions": "treat regions alike in both",
    "group": "give both the same --group",
}
"""What two evaluations must have in common to be compared, and advice."""


def conditions(dataset: EvaluatedDataset, task: str, *, ignore_regions: object, group: object) -> dict[str, object]:
    """Return what two evaluations must have in common to be compared, by name."""
    return {
        "split": dataset["split"],
        "images": dataset["images"],
        "labels": dataset["labels_sha256"],
        "task": task,
        "ignored regions": ignore_regions,
        "group": group,
    }


def recorded_conditions(record: EvaluationRecord) -> dict[str, object]:
    """Return the conditions of an earlier evaluation."""
    settings = record["settings"]
    return conditions(
        record["dataset"], record["task"], ignore_regions=settings["ignore_regions"], group=settings["group"]
    )


def require_same(record: EvaluationRecord, ours: Mapping[str, object], where: Path) -> None:
    """Raise DatasetError if the record of an evaluation, in the folder `where`, has other conditions than ours."""
    problems: list[Problem] = []
    for what, found in recorded_conditions(record).items():
        expected = ours[what]
        if found == expected or (what in ("images", "labels") and problems):  # other splits have other images
            continue
        if what == "labels":
            found = "different labels or images"
            expected = "the same"
        problems.append(Problem(str(where), f"other-{what}", f"{what}: {found}", str(expected), _SAME[what]))
    if problems:
        raise DatasetError(f"{where}: cannot be compared image by image", problems)


def write_matches(path: Path, stored: StoredMatches) -> None:
    """Write `matches.npz`."""
    arrays: dict[str, NDArray[Any]] = {
        "classes": np.array(stored.classes, dtype=np.str_),
        "groups": np.array(stored.groups, dtype=np.str_),
    }
    for k, m in enumerate(stored.matches):
        arrays |= {
            f"scores_{k}": m.scores,
            f"images_{k}": m.images,
            f"right_{k}": np.packbits(m.right[0], axis=1),
            f"neutral_{k}": np.packbits(m.neutral[0], axis=1),
            f"objects_{k}": m.objects[0],
        }
    with replace_atomically(path) as temporary:
        np.savez_compressed(temporary, allow_pickle=False, **arrays)


def read_evaluation(folder: Path) -> tuple[EvaluationRecord, StoredMatches]:
    """Return the record and the matches of an earlier evaluation.

    Raises:
        DatasetError: The folder holds no finished evaluation.
    """

    def refuse(why: str) -> DatasetError:
        todo = "give the folder that `infrablend evaluate` wrote"
        problem = Problem(str(folder), "evaluation", why, f"{RECORD} and {MATCHES}", todo)
        return DatasetError(f"{folder}: not a finished evaluation", [problem])

    try:
        record: EvaluationRecord = json.loads(read_regular(folder / RECORD))
        with open_regular(folder / MATCHES) as file, np.load(file, allow_pickle=False) as data:
            classes = tuple(str(n) for n in data["classes"])
            matches = tuple(_unpacked(data, k) for k in range(len(classes)))
            stored = StoredMatches(classes, matches, tuple(str(g) for g in data["groups"]))
        if record["detector"] is None or None in recorded_conditions(record).values():
            raise KeyError("settings")
    except FileNotFoundError as error:
        raise refuse(f"no {Path(str(error.filename)).name}") from error
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
        raise refuse(f"cannot be read ({type(error).__name__}: {error})"[:160]) from error
    return record, stored


def _unpacked(data: Any, k: int) -> ClassMatches:
    scores = data[f"scores_{k}"]
    right, neutral = (
        np.unpackbits(data[f"{name}_{k}"], axis=1, count=len(scores)).astype(np.bool_)[None]
        for name in ("right", "neutral")
    )
    return ClassMatches(scores, data[f"images_{k}"], right, neutral, data[f"objects_{k}"][None])
