"""Evaluate a detector on a split of a dataset: detections, metrics, plots, and the report that shows them."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np

from infrablend import __version__
from infrablend.core.dataset import SPLITS, Dataset, ImageRecord
from infrablend.core.files import write_bytes, write_json, write_text
from infrablend.core.workspace import replacing, workspace
from infrablend.detection.detection_source import DetectionSource, choose_task
from infrablend.detection.detections import MATCHES, MAX_DETECTIONS, PREDICTIONS, RECORD, FloatArray, write_predictions
from infrablend.detection.matching import LEVEL
from infrablend.detection.tracking import require_trackers
from infrablend.detection.truth import (
    Case,
    Truth,
    class_numbers,
    compared,
    evaluated_classes,
    fingerprint,
    image_key,
    truths,
)
from infrablend.detection.ultralytics_environment import missing_packages
from infrablend.errors import DatasetError, ModelError, Problem
from infrablend.formats.base import SPLIT_FOLDERS, shorten
from infrablend.formats.image_groups import GROUPINGS, background_stem, group_images
from infrablend.formats.picture_facts import facts_from_name
from infrablend.formats.pictures.images import load_background
from infrablend.formats.pictures.listing import with_sizes
from infrablend.lab.evaluation.evaluated_tracks import find_sequences, track_facts
from infrablend.lab.evaluation.evaluation_comparison import (
    StoredMatches,
    conditions,
    paired_facts,
    read_evaluation,
    require_same,
    write_matches,
)
from infrablend.lab.evaluation.evaluation_figures import figures, list_found
from infrablend.lab.evaluation.evaluation_record import ClassRows, EvaluatedDataset, EvaluationRecord
from infrablend.lab.evaluation.evaluation_settings import DEFAULT_SETTINGS, EvaluationSettings
from infrablend.lab.evaluation.small_targets import BODY_BINS, NO_BODY_PX, body_sizes
from infrablend.lab.evaluation.stress import stress_facts
from infrablend.lab.pages.evaluation_page import draw_plots, evaluation_page
from infrablend.lab.pages.stress_page import STRESS_PAGE, stress_page

PAGE = "evaluation.html"
PLOTS = "plots"
STRESS = "stress.json"
_SHOWN = 5
_LEAST_AP = 0.001


@dataclass(frozen=True, eq=False)
class EvaluationReport:
    """The result of an evaluation.

    Attributes:
        out: Folder of the evaluation.
        metrics: Content of `evaluation.json`.
        problems: Warnings, and, as errors, the labels and pictures of the split that could not be read.
        seconds: Wall-clock time.
    """

    out: Path
    metrics: EvaluationRecord
    problems: tuple[Problem, ...] = ()
    seconds: float = 0.0

    @property
    def predictions(self) -> Path:
        """Path of the detections."""
        return self.out / PREDICTIONS

    def to_json(self) -> dict[str, object]:
        """Return plain JSON values."""
        return dict(self.metrics)


def evaluate_detector(
    weights: Path,
    dataset: Dataset,
    out: Path,
    settings: EvaluationSettings = DEFAULT_SETTINGS,
    *,
    device: str = "auto",
    against: Path | None = None,
    overwrite: bool = False,
    on_image: Callable[[int, int], None] | None = None,
) -> EvaluationReport:
    """Evaluate weights or saved detections on a split; see `infrablend.api.evaluate`."""
    started = time.monotonic()
    if settings.tracks:
        require_trackers("trackeval")
    rival = None if against is None else (against, *read_evaluation(against))
    problems: list[Problem] = []
    with workspace(out, "evaluation", RECORD, replacing(overwrite)) as space:
        split = settings.split or _default_split(dataset, problems)
        of_split = [i for i in dataset.images if i.split == split]
        source = DetectionSource(weights, device, problems, of_split, dataset.categories)
        case, numbers, groups, counts = _prepare(dataset, split, source, settings, problems)
        sequences = find_sequences(case, problems) if settings.tracks else None
        evaluated: EvaluatedDataset = {
            "name": dataset.root.name,
            "format": dataset.format,
            "split": split,
            "images": len(case.images),
            "labels_sha256": fingerprint(case.images),
        }
        if rival is not None:
            ours = conditions(evaluated, case.task, ignore_regions=settings.ignore_regions, group=settings.group)
            require_same(rival[1], ours, rival[0])
        predictions = source.on(case.images, settings.image_size, on_image, problems)
        write_predictions(space.folder / PREDICTIONS, predictions)
        class_of = class_numbers(numbers, len(predictions.classes))
        case = replace(case, found=compared(predictions.images, case.labels, class_of, case.task))
        counts["detections"] = sum(len(d) for d in predictions.images.values())
        foreign = counts["detections"] - sum(len(d) for d in case.found)
        counts |= {"detections_of_other_classes": foreign} if foreign else {}
        tracks = None if sequences is None else track_facts(case, sequences, settings, problems)
        bodies = measure_bodies(case, counts, problems) if settings.by_body else None
        metrics, matches = figures(case, groups, settings.bootstrap, settings.seed, bodies)
        stored = StoredMatches(case.classes, matches, groups)
        problems += _detection_warnings(metrics["classes"], counts["detections"])
        facts: EvaluationRecord = {
            "classes": metrics["classes"],
            "confidence": metrics["confidence"],
            "strata": metrics["strata"],
            "targets": metrics["targets"],
            "false_alarms": metrics["false_alarms"],
            "confusion": metrics["confusion"],
            "curves": metrics["curves"],
            "infrablend": __version__,
            "dataset": evaluated,
            "task": case.task,
            "settings": {
                "ignore_regions": settings.ignore_regions,
                "max_detections": MAX_DETECTIONS,
                "bootstrap": settings.bootstrap,
                "group": settings.group,
                "groups": len(set(groups)),
                "seed": settings.seed,
                "level": LEVEL,
            },
            "detector": {**predictions.facts, "task": predictions.task, "classes": list(predictions.classes)},
            "counts": counts,
            "ultralytics": _by_ultralytics(case),
            "paired": None
            if rival is None
            else paired_facts([stored], [rival[2]], rival[1], rival[0].name, settings.bootstrap, settings.seed),
            "problems": [p.to_json() for p in problems],
        }
        if settings.list_first:
            facts["first_detections"] = list_found(case, settings.list_first, settings.list_iou)
        if tracks is not None:
            facts["tracks"] = tracks
        if settings.stress:
            facts["stress"] = stress_facts(case, source, class_of, settings, metrics["confidence"], on_image)
            write_json(space.folder / STRESS, facts["stress"])
            write_text(space.folder / STRESS_PAGE, stress_page(facts))
        write_matches(space.folder / MATCHES, stored)
        plots = draw_plots(facts)
        for name, data in plots.items():
            write_bytes(space.folder / PLOTS / name, data)
        write_text(space.folder / PAGE, evaluation_page(facts, plots))
        space.finish(facts)
    return EvaluationReport(out, facts, tuple(problems), time.monotonic() - started)


# -- inputs ----------------------------------------------------------------------------------------------------


def _prepare(
    dataset: Dataset, split: str, source: DetectionSource, settings: EvaluationSettings, problems: list[Problem]
) -> tuple[Case, Mapping[str, tuple[int, ...]], tuple[str, ...], dict[str, int]]:
    """Return the labels without detections, the detector's classes of each class, groups of images, and counts.

    Raises:
        ModelError, DatasetError: They cannot be evaluated; the message lists all problems.
    """
    rejected = rejected_in(dataset, split)
    listed = [i for i in dataset.images if i.split == split]
    images = with_sizes(listed, image_key, problems)
    if not listed:
        problems += shorten(rejected)
        problems.append(_empty_split(dataset, split))
    task = choose_task(settings.task, source, problems)
    numbers = evaluated_classes(dataset, images, settings.classes, source.classes, problems)
    source.check(images, problems)
    if settings.stress and source.is_fixed:
        found = "saved detections or an ONNX file"
        problems.append(Problem(source.name, "stress-saved", found, "weights (.pt), to detect again"))
    groups = image_groups(images, settings.group, problems)
    errors = [p for p in problems if p.severity == "error"]
    if errors:
        kind = ModelError if all(p.code == "weights" for p in errors) else DatasetError
        raise kind(f"{source.name} cannot be evaluated on {dataset.root}", errors)
    names = tuple(numbers)
    labels, counts = truths(images, dataset.categories, names, task, ignore_regions=settings.ignore_regions)
    problems += _label_warnings(names, labels, counts)
    if rejected:
        counts["rejected"] = len(rejected)
        shown = "; ".join(f"{p.where}: {p.found}" for p in rejected[:_SHOWN])
        more = f" and {len(rejected) - _SHOWN} more" if len(rejected) > _SHOWN else ""
        found = f"{len(rejected)} labels or images could not be read and are excluded: {shown}{more}"
        problems += [Problem("labels", "labels-rejected", found, severity="warning"), *rejected]
    if not any((~t.ignore).any() for t in labels):
        todo = "the labels have no masks: use --task detect" if task == "segment" else "name another --split"
        raise DatasetError(
            f"{dataset.root.name}, split {split}: no object of {', '.join(names)}",
            [Problem(f"split {split}", "no-instances", "no object of the evaluated classes", "some", todo)],
        )
    return Case(images, labels, (), names, task), numbers, groups, counts


def _default_split(dataset: Dataset, problems: list[Problem]) -> str:
    """Return the split test; in a dataset without one val, or the only one with images, with a warning."""
    filled = [s for s in SPLITS if any(i.split == s for i in dataset.images)]
    there = ["val"] if filled == ["train", "val"] else filled
    broken = set(rejected_in(dataset, "test")).difference(*(rejected_in(dataset, s) for s in there))
    if len(there) != 1 or there == ["test"] or broken:  # what could not be read of a split is no reason for another one
        return "test"
    found = f"no split test: evaluated on {there[0]}, the only {'other ' if len(filled) > 1 else ''}split"
    todo = "name it with --split; figures on pictures that the detector was trained on, or chosen by, are too good"
    problems.append(Problem(dataset.root.name, "split-only", found, "pictures of split test", todo, "warning"))
    return there[0]


def _empty_split(dataset: Dataset, split: str) -> Problem:
    counts = {s: sum(i.split == s for i in dataset.images) for s in SPLITS}
    elsewhere = ", ".join(f"{s} {k}" for s, k in counts.items() if k) or "no images in any split"
    todo = "name another --split" if any(counts.values()) else "check the dataset with `infrablend inspect`"
    return Problem(f"{dataset.root.name}, split {split}", "split-empty", f"no images ({elsewhere})", "some", todo)


def _label_warnings(names: Sequence[str], labels: Sequence[Truth], counts: Mapping[str, int]) -> list[Problem]:
    there = {int(c) for t in labels for c in t.classes[~t.ignore]}
    problems = []
    absent = [n for k, n in enumerate(names) if k not in there]
    if absent:
        found = f"no object of {', '.join(absent)} in the split: no figures for {'it' if len(absent) == 1 else 'them'}"
        problems.append(Problem("labels", "class-empty", found, severity="warning"))
    messages = {
        "objects_without_mask": "objects without a mask count neither as found nor as missed; their boxes are ignored",
        "objects_without_oriented_box": "objects without an oriented box: their axis-aligned boxes are used",
        "ignore_regions": "ignore regions: unmatched detections inside them are not counted",
        "crowds": "crowds (iscrowd) are not objects; unmatched detections of their class inside them are not counted",
        "crowds_left_out": "crowds (iscrowd) are left out; detections inside them count as false positives",
    }
    for key, text in messages.items():
        if counts.get(key):
            problems.append(Problem("labels", key.replace("_", "-"), f"{counts[key]} {text}", severity="warning"))
    return problems


def rejected_in(dataset: Dataset, split: str) -> list[Problem]:
    """Return the errors of the reader in a split, without those that surely belong to another one.

    An error names a file only. Its split is that of its folder, that of the picture with its name, or, for JSON of
    many pictures, the one in the file name, as in `instances_val2017.json`. Sizes are compared later.
    """
    of_stem: dict[str, set[str]] = {}
    for image in dataset.images:
        of_stem.setdefault(PurePosixPath(image.name).stem, set()).add(image.split)

    def splits(p: Problem) -> set[str]:
        path = PurePosixPath(p.where.partition(": ")[0])
        folders: set[str] = {SPLIT_FOLDERS[f.lower()] for f in path.parts[:-1] if f.lower() in SPLIT_FOLDERS}
        words = re.split(r"[^a-z]+", path.stem.lower()) if path.suffix == ".json" else []
        return folders or of_stem.get(path.stem) or {SPLIT_FOLDERS[w] for w in words if w in SPLIT_FOLDERS} or {split}

    errors = (p for p in dataset.problems if p.severity == "error" and p.code != "image-size")
    return [p for p in errors if split in splits(p)]


def image_groups(images: Sequence[ImageRecord], by: str, problems: list[Problem]) -> tuple[str, ...]:
    """Return the group of each image. Configurations of one background and the background itself share one."""
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


def _frames(images: Sequence[ImageRecord]) -> tuple[str, ...]:
    """Return the frame that each image shows: its own key, or one name for an original and all images made of it."""
    backgrounds = []
    made = []
    for image in images:
        key = PurePosixPath(image_key(image))
        background = background_stem(key.stem)
        backgrounds.append(str(key.with_name(background)))
        made.append(background != key.stem)
    sizes = Counter(backgrounds)
    names = {b: f"frame {b}" for b, m in zip(backgrounds, made, strict=True) if m and sizes[b] > 1}
    for image, background in zip(images, backgrounds, strict=True):
        facts = facts_from_name(image.name)
        if facts is not None and facts.configuration is not None:  # its number is the frame's in the whole dataset
            names[background] = f"frame {facts.frame}"
    return tuple(names.get(b, image_key(i)) for i, b in zip(images, backgrounds, strict=True))


# -- figures ---------------------------------------------------------------------------------------------------


def measure_bodies(case: Case, counts: dict[str, int], problems: list[Problem]) -> list[FloatArray]:
    """Return the sizes of the bodies of the labels on each image, px; append those without one to `problems`."""
    found = []
    unread = []
    for image, truth in zip(case.images, case.labels, strict=True):
        sizes = np.full(len(truth.ignore), NO_BODY_PX)
        if not truth.ignore.all():
            try:
                sizes = body_sizes(load_background(image.path, truth.size_wh).pixels, truth)
            except DatasetError as error:
                unread.append(f"{image.name}: {error.problems[0].found}")
        found.append(sizes)
    of = np.concatenate([sizes[~t.ignore] for sizes, t in zip(found, case.labels, strict=True)])
    left = {
        "bodies_below_2_px": int(((of != NO_BODY_PX) & (of < BODY_BINS["2-4"][0])).sum()),
        "bodies_not_measured": int((of == NO_BODY_PX).sum()),
    }
    counts |= left
    if any(left.values()):
        text = "{} objects with a body below 2 px and {} without a measurable one are in no bin of the body"
        problems.append(Problem("labels", "bodies", text.format(*left.values()), severity="warning"))
    if unread:
        text = f"pictures that cannot be read, so that the bodies in them are not measured: {len(unread)}; {unread[0]}"
        problems.append(Problem("labels", "bodies-unread", text, severity="warning"))
    return found


def _detection_warnings(table: ClassRows, detections: int) -> list[Problem]:
    """Return a warning if there are no detections, or if the AP of every class rounds to 0.000."""
    code = "no-detections"
    found = f"no detection of {', '.join(c for c in table if c != 'all')}"
    todo = ""
    if detections:
        if max(row["map50"] for row in table.values() if row["map50"] is not None) >= _LEAST_AP:
            return []
        code = "no-hits"
        found = f"{detections} detections, hardly any on an object: mAP50 is below {_LEAST_AP} in every class"
        todo = "check that the training is finished, and that its images and classes resemble these"
    return [Problem("detector", code, found, "a trained detector", todo, severity="warning")]


def _by_ultralytics(case: Case) -> ClassRows | None:
    if missing_packages():
        return None
    from infrablend.lab.evaluation.ultralytics_scores import ultralytics_table

    return ultralytics_table(case)
