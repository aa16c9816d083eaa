"""Judging a detector on a split of a dataset: findings, tables, strata, intervals, plots, the page that shows them."""

from __future__ import annotations

import logging
import re
import time
import zipfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from infrablend import __version__
from infrablend.core.dataset import SPLITS, Dataset, ImageRecord, Split
from infrablend.core.files import replace_atomically, write_bytes, write_json, write_text
from infrablend.core.output import OutputFolder
from infrablend.errors import DatasetError, ModelError, Problem
from infrablend.evaluation.bootstrap import (
    LEVEL,
    MEASURES,
    draw_images,
    drawn_figures,
    interval,
    paired,
    several_groups,
)
from infrablend.evaluation.coco import MAX_DETECTIONS, coco_precisions
from infrablend.evaluation.confusion import IOU as CONFUSION_IOU
from infrablend.evaluation.confusion import confusion_matrix
from infrablend.evaluation.detections import (
    TASKS,
    Detections,
    Predictions,
    Task,
    read_predictions,
    write_predictions,
)
from infrablend.evaluation.matching import ClassMatches, match_all, size_bins
from infrablend.evaluation.precision import RECALLS, average_precisions, operating_point, precision_by_recall
from infrablend.evaluation.strata import image_strata
from infrablend.evaluation.truth import Truth, class_numbers, fingerprint, image_key, match_classes, truths
from infrablend.formats.base import shorten
from infrablend.formats.capture import facts_from_name
from infrablend.formats.groups import GROUPINGS, group_images
from infrablend.formats.pictures import read_size
from infrablend.report.evaluation import draw_plots, evaluation_page
from infrablend.training.weights import missing_packages

log = logging.getLogger(__name__)

Group = Literal["image", "sequence", "date", "gap"]
GROUPS: tuple[Group, ...] = ("image", *GROUPINGS)

PREDICTIONS, RECORD, PAGE, MATCHES, PLOTS = (
    "predictions.json",
    "evaluation.json",
    "evaluation.html",
    "matches.npz",
    "plots",
)
_OWN = frozenset({PREDICTIONS, RECORD, PAGE, MATCHES, PLOTS})
_SHOWN = 5
_LEAST_AP = 0.001


@dataclass(frozen=True, eq=False)
class EvaluationReport:
    """What a detector is worth on a split.

    Attributes:
        out: The folder.
        metrics: As in `evaluation.json`.
        problems: Warnings, and as errors the labels and pictures of the split that could not be read.
        seconds: Wall-clock time.
    """

    out: Path
    metrics: Mapping[str, Any]
    problems: tuple[Problem, ...] = ()
    seconds: float = 0.0

    @property
    def predictions(self) -> Path:
        """The file of findings."""
        return self.out / PREDICTIONS

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        return dict(self.metrics)


@dataclass(frozen=True, eq=False)
class Judged:
    """What is kept in `matches.npz`: enough to compare two evaluations without their dataset.

    Attributes:
        classes: Names.
        matches: By class; sizes all together.
        groups: Of each image: those of one group are drawn together.
    """

    classes: tuple[str, ...]
    matches: tuple[ClassMatches, ...]
    groups: tuple[str, ...]


def evaluate_detector(
    weights: Path,
    dataset: Dataset,
    out: Path,
    *,
    split: str = "test",
    task: str | None = None,
    device: str = "auto",
    classes: Sequence[str] | None = None,
    image_size: int = 640,
    ignore_regions: bool = True,
    bootstrap: int = 1000,
    group: str = "image",
    seed: int = 0,
    against: Path | None = None,
    overwrite: bool = False,
    on_image: Callable[[int, int], None] | None = None,
) -> EvaluationReport:
    """Judge weights, or findings saved before, on a split; see `infrablend.api.evaluate`."""
    started = time.monotonic()
    if split not in SPLITS:
        raise DatasetError(f"split: found {split!r}, expected one of {', '.join(SPLITS)}")
    if group not in GROUPS:
        raise DatasetError(f"group: found {group!r}, expected one of {', '.join(GROUPS)}")
    if bootstrap < 0 or image_size < 0:
        raise DatasetError("bootstrap and image_size: expected numbers of at least 0")
    entries = _check_out(out, overwrite)
    theirs = None if against is None else _read_judged(against)
    problems: list[Problem] = []
    rejected = _rejected(dataset, split)
    images = _sized([i for i in dataset.images if i.split == split], problems)
    if not images:
        problems += shorten(rejected)
        where, n = f"{dataset.root.name}, split {split}", {s: sum(i.split == s for i in dataset.images) for s in SPLITS}
        there = ", ".join(f"{s} {k}" for s, k in n.items() if k) or "no images in any split"
        todo = "name another --split" if any(n.values()) else "check the dataset with `infrablend inspect`"
        problems.append(Problem(where, "split-empty", f"no images ({there})", "some", todo))
    source = _Source(weights, device, problems)
    chosen = _task(task, source, problems)
    judged = _classes(dataset, images, classes, source.classes, problems)
    if source.saved is not None:
        source.saved = _on_images(source.saved, images, weights, problems)
    else:
        problems += source.unreadable(images)
    grouping = _groups(images, group, problems)
    errors = [p for p in problems if p.severity == "error"]
    if errors:
        kind = ModelError if all(p.code == "weights" for p in errors) else DatasetError
        raise kind(f"{weights.name} cannot be evaluated on {dataset.root}", errors)

    names = tuple(judged)
    labels, counts = truths(images, dataset.categories, names, chosen, ignore_regions=ignore_regions)
    problems += _label_warnings(names, labels, counts)
    if rejected:
        counts["rejected"] = len(rejected)
        said = "; ".join(f"{p.where}: {p.found}" for p in rejected[:_SHOWN])
        more = f" and {len(rejected) - _SHOWN} more" if len(rejected) > _SHOWN else ""
        found = f"{len(rejected)} labels or pictures could not be read and are not judged: {said}{more}"
        problems += [Problem("labels", "labels-rejected", found, severity="warning"), *rejected]
    if not any((~t.ignore).any() for t in labels):
        raise DatasetError(
            f"{dataset.root.name}, split {split}: no object of {', '.join(names)}",
            [Problem(f"split {split}", "no-instances", "no object of the classes judged", "some", _masks_todo(chosen))],
        )
    key = fingerprint(images)
    if theirs is not None:
        same = _Compared(split, len(images), key, chosen, ignore_regions, group)
        _require_same(theirs[0], same, against or out)

    with _output(out).claimed():
        predictions = source.predict(images, image_size, on_image)
        _clear(out, entries)
        write_predictions(out / PREDICTIONS, predictions)
        class_of = class_numbers(judged, len(predictions.classes))
        _count_foreign(predictions, class_of, names, counts, problems)
        metrics, kept = _judge(labels, images, predictions, class_of, names, chosen, bootstrap, grouping, seed)
        problems += _hardly_anything(metrics["classes"], counts)
        facts = {
            "infrablend": __version__,
            "dataset": {
                "name": dataset.root.name,
                "format": dataset.format,
                "split": split,
                "images": len(images),
                "labels_sha256": key,
            },
            "detector": {**predictions.facts, "task": predictions.task, "classes": list(predictions.classes)},
            "task": chosen,
            "settings": {
                "ignore_regions": ignore_regions,
                "max_detections": MAX_DETECTIONS,
                "bootstrap": bootstrap,
                "group": group,
                "groups": len(set(grouping)),
                "seed": seed,
                "level": LEVEL,
            },
            "counts": counts,
            **metrics,
            "paired": None
            if theirs is None
            else _paired_facts([kept], [theirs[1]], theirs[0], bootstrap, seed, (against or out).name),
            "problems": [p.to_json() for p in problems],
        }
        _write_judged(out / MATCHES, kept)
        plots = draw_plots(facts)
        for name, data in plots.items():
            write_bytes(out / PLOTS / name, data)
        write_text(out / PAGE, evaluation_page(facts, plots))
        write_json(out / RECORD, facts)  # last: it says that all the rest is there
    return EvaluationReport(out, facts, tuple(problems), time.monotonic() - started)


# -- what goes in ----------------------------------------------------------------------------------------------


class _Source:
    """Where findings come from: weights, or a file of them."""

    def __init__(self, path: Path, device: str, problems: list[Problem]) -> None:
        self.saved: Predictions | None = None
        self._detector: Any = None
        self.classes: tuple[str, ...] | None = None
        self.task: Task | None = None
        try:
            path = _meant(path)
            if path.suffix == ".json":
                self.saved = read_predictions(path)
                self.classes, self.task = self.saved.classes, self.saved.task
            else:
                from infrablend.training.predict import load_detector

                self._detector = load_detector(path, device)
                self.classes, self.task = self._detector.classes, self._detector.task
        except (DatasetError, ModelError) as error:
            problems += error.problems

    def unreadable(self, images: Sequence[ImageRecord]) -> list[Problem]:
        """The pictures that weights could not be run on."""
        if self._detector is None:
            return []
        from infrablend.training.predict import check_pictures

        return check_pictures([i for i in images if i.size_wh is not None])  # others are told of already

    def predict(
        self, images: Sequence[ImageRecord], image_size: int, on_image: Callable[[int, int], None] | None
    ) -> Predictions:
        """The findings on the images."""
        if self.saved is not None:
            return self.saved
        from infrablend.training.predict import predict

        return predict(self._detector, images, image_size=image_size, on_image=on_image)


def _meant(path: Path) -> Path:
    """The file that a folder stands for: the findings of an evaluation, or the weights of a finished training.

    Raises:
        ModelError: The folder is neither.
    """
    if not path.is_dir():
        return path
    from infrablend.pipeline.train import RECORD as TRAINING
    from infrablend.training.trainer import WEIGHTS

    for file in (PREDICTIONS, WEIGHTS):
        if (path / file).is_file():
            return path / file
    found, expected = f"a folder without {PREDICTIONS} and {WEIGHTS}", f"weights (.pt), or {PREDICTIONS}"
    todo = f"give {WEIGHTS} of a finished `infrablend train`, or {PREDICTIONS} of an earlier evaluation"
    if (path / TRAINING).exists():
        found, expected = f"a training that is not finished: no {WEIGHTS} yet", "a finished one"
        todo = "finish it: the same `infrablend train` with --resume"
    raise ModelError(f"{path}: nothing to judge", [Problem(str(path), "weights", found, expected, todo)])


def _task(wanted: str | None, source: _Source, problems: list[Problem]) -> Task:
    task = source.task or "detect"
    if wanted is None:
        return task
    chosen = next((t for t in TASKS if t == wanted), None)
    if chosen is None:
        problems.append(Problem("task", "task", f"{wanted!r}", f"one of {', '.join(TASKS)}"))
    elif chosen not in (task, "detect") and source.task is not None:
        todo = "leave --task out, or take weights that were trained for it"
        problems.append(Problem("task", "task", f"{chosen}, but the detector finds {_FINDS[task]}", task, todo))
    return chosen or task


_FINDS: Mapping[Task, str] = {"detect": "boxes", "obb": "oriented boxes", "segment": "masks"}


_SPLIT_WORDS: Mapping[str, Split] = {
    "train": "train", "training": "train", "val": "val", "valid": "val", "validation": "val", "test": "test",
    "testing": "test",
}  # fmt: skip


def _rejected(dataset: Dataset, split: str) -> list[Problem]:
    """What the reader could not use of the split: its errors, but for those that surely are of another split.

    An error says the file alone. Its split is that of the folder it lies in, of the picture of its name, or, of JSON
    for many pictures, the one in its name, as in `instances_val2017.json`.
    """
    of_stem: dict[str, set[str]] = {}
    for image in dataset.images:
        of_stem.setdefault(PurePosixPath(image.name).stem, set()).add(image.split)

    def splits(p: Problem) -> set[str]:
        path = PurePosixPath(p.where.partition(": ")[0])
        folders: set[str] = {_SPLIT_WORDS[f.lower()] for f in path.parts[:-1] if f.lower() in _SPLIT_WORDS}
        words = re.split(r"[^a-z]+", path.stem.lower()) if path.suffix == ".json" else []
        return folders or of_stem.get(path.stem) or {_SPLIT_WORDS[w] for w in words if w in _SPLIT_WORDS} or {split}

    return [p for p in dataset.problems if p.severity == "error" and split in splits(p)]


def _sized(images: Sequence[ImageRecord], problems: list[Problem]) -> list[ImageRecord]:
    """With sizes, from the pictures' headers where the labels do not say them."""
    done = []
    for image in images:
        size, problem = (image.size_wh, None) if image.size_wh else read_size(image.path, image_key(image))
        problems += [] if problem is None else [problem]
        done.append(replace(image, size_wh=size))
    return done


def _classes(
    dataset: Dataset,
    images: Sequence[ImageRecord],
    wanted: Sequence[str] | None,
    detector: Sequence[str] | None,
    problems: list[Problem],
) -> dict[str, tuple[int, ...]]:
    """Numbers of the detector's classes by name of the class judged."""
    own = [c.name for c in dataset.categories if not c.ignore]
    there = {i.category for image in images for i in image.instances}
    names = own
    if wanted is not None:
        found = match_classes(own, wanted)
        for name, of in found.items():
            if not of:
                problems.append(Problem("classes", "class-unknown", f"{name!r}", f"some of {', '.join(own)}"))
        names = [n for k, n in enumerate(own) if any(k in of for of in found.values())]
    if not names:
        problems.append(Problem(dataset.root.name, "no-classes", "no class to judge", "labelled classes"))
    if detector is None:
        return dict.fromkeys(names, ())
    mapping = match_classes(detector, names)
    lacking = [n for n, of in mapping.items() if not of and (n in there or wanted is not None)]
    if lacking:
        both = [n for n in names if mapping[n]]
        todo = f"judge the classes that both have with --classes {','.join(both)}" if both else "give other weights"
        found_text = f"the detector has no class {', '.join(lacking)} (it has {_few(detector)})"
        problems.append(Problem("classes", "class-absent", found_text, "every class that is judged", todo))
    for k, name in enumerate(detector):
        rivals = [n for n, of in mapping.items() if k in of]
        judged = [n for n in rivals if n in there] or rivals[:1]
        for n in [n for n in rivals if n not in judged]:  # it takes no findings from a class that has objects
            mapping[n] = ()
            found_text = f"{n}: no objects, and found as the detector's {name}, as {judged[0]} is: not judged"
            problems.append(Problem("labels", "class-left-out", found_text, severity="warning"))
        if len(judged) > 1:
            found_text = f"{' and '.join(judged)} are both found as the detector's {name}"
            pairs = " ".join(f"--rename {n}={judged[0]}" for n in judged[1:])
            todo = f"make them one class with `infrablend convert {pairs}`, or choose with --classes {judged[0]}"
            problems.append(Problem("classes", "class-shared", found_text, "a class of its own for each", todo))
    others = [n for k, n in enumerate(detector) if not any(k in of for of in mapping.values())]
    if others:
        found_text = f"{_few(others)}: findings of {'this class' if len(others) == 1 else 'these classes'} are left out"
        problems.append(Problem("detector", "class-left-out", found_text, severity="warning"))
    if wanted is not None and len(names) < len(own):
        left = ", ".join(n for n in own if n not in names)
        problems.append(Problem("labels", "class-left-out", f"{left}: not judged", severity="warning"))
    return {n: of for n, of in mapping.items() if of}


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")


def _on_images(saved: Predictions, images: Sequence[ImageRecord], file: Path, problems: list[Problem]) -> Predictions:
    """The findings on these images, named as ours; those of a file by other tools may lack the split."""
    of: dict[str, str] = {}
    for image in images:
        key = image_key(image)
        name = next((n for n in (key, image.name) if n in saved.images), None)
        if name is not None:
            of[key] = name
            if image.size_wh is not None and saved.sizes_wh[name] != image.size_wh:
                found = "{}x{} px".format(*saved.sizes_wh[name])
                problems.append(
                    Problem(f"{file.name}, {name}", "prediction-size", found, "{}x{} px".format(*image.size_wh))
                )
    lacking = [image_key(i) for i in images if image_key(i) not in of]
    if lacking:
        found = f"no entry for {len(lacking)} of {len(images)} images: {', '.join(lacking[:3])}"
        todo = "give the dataset and split that the file was made on"
        problems.append(Problem(file.name, "prediction-images", found, "an entry for every image", todo))
    rest = len(saved.images) - len(of)
    if rest and of:
        found = f"{rest} images that are not in the split: left out"
        problems.append(Problem(file.name, "prediction-images", found, severity="warning"))
    cut = sum(len(saved.images[n]) > MAX_DETECTIONS for n in of.values())
    if cut:
        found = f"more than {MAX_DETECTIONS} findings in {cut} images: the surest are judged"
        problems.append(Problem(file.name, "prediction-many", found, severity="warning"))
    first = np.arange(MAX_DETECTIONS)
    kept = {k: d if len(d := saved.images[n]) <= MAX_DETECTIONS else d.take(first) for k, n in of.items()}
    return replace(saved, images=kept, sizes_wh={k: saved.sizes_wh[n] for k, n in of.items()})


def _groups(images: Sequence[ImageRecord], by: str, problems: list[Problem]) -> tuple[str, ...]:
    """The group of each image. One background in several configurations, and itself, are one."""
    if by == "image":
        return _frames(images)
    kind = next(b for b in GROUPINGS if b == by)
    try:
        groups = group_images(images, kind)
    except DatasetError as error:
        todo = "take --group image, gap or date, whichever the dataset says"
        problems += [replace(p, where="--group", todo=todo) for p in error.problems]
        return ()
    of = {image_key(i): name for name, group in groups.items() for i in group}
    return tuple(of[image_key(i)] for i in images)


_CONFIGURATION = re.compile(r"(?<=.)(?:_c\d+)+$", re.ASCII)


def _frames(images: Sequence[ImageRecord]) -> tuple[str, ...]:
    """The frame that each image shows: its own key, or a name for all that were made of it, and for the original."""
    backgrounds, made = [], []
    for image in images:
        key = PurePosixPath(image_key(image))
        background = _CONFIGURATION.sub("", key.stem)
        backgrounds.append(str(key.with_name(background)))
        made.append(background != key.stem)
    sizes = Counter(backgrounds)
    names = {b: f"frame {b}" for b, m in zip(backgrounds, made, strict=True) if m and sizes[b] > 1}
    for image, background in zip(images, backgrounds, strict=True):
        facts = facts_from_name(image.name)
        if facts is not None and facts.configuration is not None:  # its number is the frame's in the whole dataset
            names[background] = f"frame {facts.frame}"
    return tuple(names.get(b, image_key(i)) for i, b in zip(images, backgrounds, strict=True))


def _masks_todo(task: Task) -> str:
    return "the labels have no masks: take --task detect" if task == "segment" else "name another --split"


def _label_warnings(names: Sequence[str], labels: Sequence[Truth], counts: Mapping[str, int]) -> list[Problem]:
    there = {int(c) for t in labels for c in t.classes[~t.ignore]}
    problems = []
    absent = [n for k, n in enumerate(names) if k not in there]
    if absent:
        found = f"no object of {', '.join(absent)} in the split: no figures for {'it' if len(absent) == 1 else 'them'}"
        problems.append(Problem("labels", "class-empty", found, severity="warning"))
    told = {
        "objects_without_mask": "objects without mask: neither found nor missed, their boxes are ignored",
        "objects_without_oriented_box": "objects without oriented box: their plain boxes are taken",
        "ignore_regions": "regions to ignore: what is found in them counts neither way",
        "crowds": "crowds (iscrowd): no objects; what is found of their class in them counts neither way",
        "crowds_left_out": "crowds (iscrowd) left out: no objects; what is found in them counts against the detector",
    }
    for key, text in told.items():
        if counts.get(key):
            problems.append(Problem("labels", key.replace("_", "-"), f"{counts[key]} {text}", severity="warning"))
    return problems


def _count_foreign(
    predictions: Predictions,
    class_of: NDArray[np.int64],
    names: Sequence[str],
    counts: dict[str, int],
    problems: list[Problem],
) -> None:
    counts["findings"] = sum(len(d) for d in predictions.images.values())
    foreign = sum(int((class_of[d.classes] < 0).sum()) for d in predictions.images.values())
    if foreign:
        counts["findings_of_other_classes"] = foreign
    if not counts["findings"]:
        found = f"not a single finding of {', '.join(names)}"
        problems.append(Problem("detector", "no-findings", found, "a trained detector", severity="warning"))


def _hardly_anything(table: Mapping[str, Mapping[str, Any]], counts: Mapping[str, int]) -> list[Problem]:
    """A warning if there are findings, but no class with an AP that its three decimals would show."""
    best = max(row["map50"] for row in table.values() if row["map50"] is not None)
    if not counts["findings"] or best >= _LEAST_AP:
        return []
    found = f"{counts['findings']} findings, hardly any of them on an object: mAP50 is below {_LEAST_AP} in every class"
    todo = "see that it is trained to the end, on pictures and classes such as these"
    return [Problem("detector", "no-hits", found, "a trained detector", todo, severity="warning")]


# -- the figures -----------------------------------------------------------------------------------------------


def _judge(
    labels: Sequence[Truth],
    images: Sequence[ImageRecord],
    predictions: Predictions,
    class_of: NDArray[np.int64],
    names: Sequence[str],
    task: Task,
    draws: int,
    groups: Sequence[str],
    seed: int,
) -> tuple[dict[str, Any], Judged]:
    found = (
        predictions.images if task == "obb" else {k: replace(d, corners_xy=None) for k, d in predictions.images.items()}
    )
    bins = size_bins()
    matches = match_all(labels, found, class_of, len(names), task, bins)
    coco = coco_precisions(labels, found, class_of, len(names), task)[0]
    ours = np.array([average_precisions(m)[0] for m in matches])
    if not np.allclose(coco, ours, rtol=0, atol=1e-6, equal_nan=True):
        raise AssertionError("pycocotools and our own matching disagree: a bug")
    weights = draw_images(groups, draws, seed)
    drawn = drawn_figures(matches, weights)
    confidence, points = operating_point(matches)
    table: dict[str, Any] = {}
    means = [p for p in points if p is not None]
    total = {
        "p": float(np.mean([p for p, _ in means])),
        "r": float(np.mean([r for _, r in means])),
        "map50": float(np.nanmean(coco[:, 0])),
        "map50_95": float(np.nanmean(coco)),
    }
    everything = np.sum([m.objects[0] for m in matches], axis=0)
    held = [m.objects[0] > 0 for m in matches]
    table["all"] = {
        "images": len(images),
        "instances": int(everything.sum()),
        **total,
        "ci": _intervals(drawn[:, 0], everything > 0, groups),
    }
    for k, name in enumerate(names):
        point, m = points[k], matches[k]
        table[name] = {
            "images": int(held[k].sum()),
            "instances": int(m.objects[0].sum()),
            "p": None if point is None else point[0],
            "r": None if point is None else point[1],
            "map50": _number(coco[k, 0]),
            "map50_95": _number(coco[k].mean()),
            "ci": _intervals(drawn[:, k + 1], held[k], groups),
        }
    strata: dict[str, Any] = {"size": {}}
    for a, name in enumerate(bins):
        if a:
            stratum = _stratum(
                [_at_size(m, a) for m in matches], names, np.ones(len(images), np.bool_), weights, groups
            )
            # Any image may hold any size, and so is looked at; told is in how many there are objects of this one.
            stratum["classes"]["all"]["images"] = int(np.any([m.objects[a] > 0 for m in matches], axis=0).sum())
            strata["size"][name] = stratum
    for kind, parts in image_strata(images).items():
        strata[kind] = {name: _stratum(matches, names, which, weights, groups) for name, which in parts.items()}
    matrix = confusion_matrix(labels, found, class_of, len(names), task, confidence)
    metrics = {
        "classes": table,
        "confidence": confidence,
        "strata": strata,
        "ultralytics": _by_ultralytics(labels, found, class_of, names, task),
        "confusion": {
            "classes": [*names, "background"],
            "found_by_labelled": matrix.tolist(),
            "confidence": confidence,
            "iou": CONFUSION_IOU,
        },
        "curves": {
            "recall": RECALLS.tolist(),
            "precision": {
                n: [round(float(v), 6) for v in precision_by_recall(m)]
                for n, m in zip(names, matches, strict=True)
                if m.objects[0].sum()
            },
        },
    }
    return metrics, Judged(tuple(names), tuple(_at_size(m, 0) for m in matches), tuple(groups))


def _by_ultralytics(
    labels: Sequence[Truth],
    found: Mapping[str, Detections],
    class_of: NDArray[np.int64],
    names: Sequence[str],
    task: Task,
) -> dict[str, Any] | None:
    if missing_packages():
        return None
    from infrablend.training.metrics import ultralytics_table

    return ultralytics_table(labels, found, class_of, names, task)


def _at_size(m: ClassMatches, size: int) -> ClassMatches:
    part = slice(size, size + 1)
    return ClassMatches(m.scores, m.images, m.right[part], m.neutral[part], m.objects[part])


def _of_images(m: ClassMatches, which: NDArray[np.bool_]) -> ClassMatches:
    """Without the objects of other images, and the findings, which would be counted 0 times, a thousand times over."""
    keep = which[m.images]
    return ClassMatches(m.scores[keep], m.images[keep], m.right[..., keep], m.neutral[..., keep], m.objects * which)


def _stratum(
    matches: Sequence[ClassMatches],
    names: Sequence[str],
    which: NDArray[np.bool_],
    weights: NDArray[Any],
    groups: Sequence[str],
) -> dict[str, Any]:
    """Figures of some images: all others count for nothing."""
    matches = [_of_images(m, which) for m in matches]
    figures = drawn_figures(matches, which[None].astype(np.int32))[0]
    drawn = drawn_figures(matches, weights * which[None].astype(np.int32))
    objects = [m.objects[0] for m in matches]
    objects = [np.sum(objects, axis=0), *objects]
    rows = {}
    for k, (name, of) in enumerate(zip(("all", *names), objects, strict=True)):
        rows[name] = {
            "images": int((of > 0).sum()) if k else int(which.sum()),
            "instances": int(of.sum()),
            "map50": _number(figures[k, 0]),
            "map50_95": _number(figures[k, 1]),
            "ci": _intervals(drawn[:, k], of > 0, groups),
        }
    return {"images": int(which.sum()), "classes": rows}


def _number(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def _intervals(
    drawn: NDArray[np.float64], held: NDArray[np.bool_], groups: Sequence[str]
) -> dict[str, list[float] | None] | None:
    """Intervals of (draws, 2) mAP50 and mAP50-95; None without draws, or with objects in images of one group alone."""
    if not len(drawn) or not several_groups(held, groups):
        return None
    return {name: interval(drawn[:, k]) for k, name in enumerate(MEASURES)}


# -- two evaluations -------------------------------------------------------------------------------------------


def compare_evaluations(
    ours: Sequence[Path],
    theirs: Sequence[Path],
    *,
    classes: Sequence[str] | None = None,
    bootstrap: int = 1000,
    seed: int = 0,
) -> dict[str, Any]:
    """Two evaluations on the same images and labels, by class: the difference, its interval; see `api.compare`."""
    record, judged = _read_judged(ours[0])
    read = {folder: _read_judged(folder) for folder in [*ours[1:], *theirs]}
    for folder, (other, _) in read.items():
        _require_same(other, _Compared.of(record), folder)
    if classes is not None:
        numbers = match_classes(judged.classes, classes)
        unknown = [name for name, of in numbers.items() if not of]
        if unknown:
            raise DatasetError(f"classes: found {', '.join(unknown)}, expected some of {', '.join(judged.classes)}")
        kept = [k for k in range(len(judged.classes)) if any(k in of for of in numbers.values())]
        judged = Judged(tuple(judged.classes[k] for k in kept), tuple(judged.matches[k] for k in kept), judged.groups)
    a = [judged, *(read[f][1] for f in ours[1:])]
    b = [read[f][1] for f in theirs]
    return _paired_facts(a, b, read[theirs[0]][0], bootstrap, seed, theirs[0].name)


def _paired_facts(
    ours: Sequence[Judged], theirs: Sequence[Judged], record: Mapping[str, Any], draws: int, seed: int, name: str
) -> dict[str, Any]:
    sides = [*ours, *theirs]
    both = [n for n in ours[0].classes if all(n in j.classes for j in sides)]
    if not both:
        raise DatasetError(
            f"{name}: judged {', '.join(theirs[0].classes)}; expected some of {', '.join(ours[0].classes)}"
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


@dataclass(frozen=True)
class _Compared:
    """What two evaluations must have in common."""

    split: str
    images: int
    labels: str
    task: str
    ignore_regions: bool
    group: str

    @classmethod
    def of(cls, record: Mapping[str, Any]) -> _Compared:
        """From `evaluation.json`."""
        data, settings = record["dataset"], record["settings"]
        return cls(
            data["split"], data["images"], data["labels_sha256"],
            record["task"], settings["ignore_regions"], settings["group"],
        )  # fmt: skip


def _require_same(record: Mapping[str, Any], ours: _Compared, where: Path) -> None:
    theirs = _Compared.of(record)
    problems = []

    def differ(what: str, found: object, expected: object, todo: str) -> None:
        problems.append(Problem(str(where), f"other-{what}", f"{what}: {found}", str(expected), todo))

    if theirs.split != ours.split:
        differ("split", theirs.split, ours.split, "give both the same --split")
    elif theirs.images != ours.images:
        differ("images", theirs.images, ours.images, "evaluate both on the same split of the same dataset")
    elif theirs.labels != ours.labels:
        differ("labels", "others, or of other images", "the same", "evaluate both on the same split and labels")
    if theirs.task != ours.task:
        differ("task", theirs.task, ours.task, "give both the same --task")
    if theirs.ignore_regions != ours.ignore_regions:
        differ("ignored regions", theirs.ignore_regions, ours.ignore_regions, "treat regions alike in both")
    if theirs.group != ours.group:
        differ("group", theirs.group, ours.group, "give both the same --group")
    if problems:
        raise DatasetError(f"{where}: not to be compared image by image", problems)


def _write_judged(path: Path, judged: Judged) -> None:
    arrays: dict[str, NDArray[Any]] = {
        "classes": np.array(judged.classes, dtype=np.str_),
        "groups": np.array(judged.groups, dtype=np.str_),
    }
    for k, m in enumerate(judged.matches):
        arrays |= {
            f"scores_{k}": m.scores,
            f"images_{k}": m.images,
            f"right_{k}": np.packbits(m.right[0], axis=1),
            f"neutral_{k}": np.packbits(m.neutral[0], axis=1),
            f"objects_{k}": m.objects[0],
        }
    with replace_atomically(path) as temporary:
        np.savez_compressed(temporary, allow_pickle=False, **arrays)


def _read_judged(folder: Path) -> tuple[dict[str, Any], Judged]:
    """Record and matches of an earlier evaluation."""
    import json

    def refuse(why: str) -> DatasetError:
        todo = "give the folder that `infrablend evaluate` wrote"
        problem = Problem(str(folder), "evaluation", why, f"{RECORD} and {MATCHES}", todo)
        return DatasetError(f"{folder}: no finished evaluation", [problem])

    try:
        record = json.loads((folder / RECORD).read_bytes())
        with (folder / MATCHES).open("rb") as file, np.load(file, allow_pickle=False) as data:
            classes = tuple(str(n) for n in data["classes"])
            matches = tuple(_unpacked(data, k) for k in range(len(classes)))
            judged = Judged(classes, matches, tuple(str(g) for g in data["groups"]))
        if None in astuple(_Compared.of(record)) or record["detector"] is None:
            raise KeyError("settings")
    except FileNotFoundError as error:
        raise refuse(f"no {Path(str(error.filename)).name}") from error
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
        raise refuse(f"cannot be read ({type(error).__name__}: {error})"[:160]) from error
    return record, judged


def _unpacked(data: Any, k: int) -> ClassMatches:
    scores = data[f"scores_{k}"]
    right, neutral = (
        np.unpackbits(data[f"{name}_{k}"], axis=1, count=len(scores)).astype(np.bool_)[None]
        for name in ("right", "neutral")
    )
    return ClassMatches(scores, data[f"images_{k}"], right, neutral, data[f"objects_{k}"][None])


# -- the folder ------------------------------------------------------------------------------------------------


def _output(out: Path) -> OutputFolder:
    return OutputFolder(out, "evaluation", RECORD, can_overwrite=True)


def _check_out(out: Path, overwrite: bool) -> list[str]:
    """Return what the folder already contains; refuse what may not be replaced."""
    folder = _output(out)
    entries = folder.entries()
    folder.require_only(_OWN, entries)
    return folder.require_empty(existing="overwrite" if overwrite else "refuse")


def _clear(out: Path, entries: Sequence[str]) -> None:
    """Delete an earlier evaluation; its detections stay until the new ones replace them."""
    _output(out).remove(name for name in (RECORD, PAGE, MATCHES, PLOTS) if name in entries)
