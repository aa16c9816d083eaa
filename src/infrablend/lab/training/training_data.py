"""Data of a training: the labels and pictures to use, and the copy that Ultralytics reads."""

from __future__ import annotations

import logging
import shlex
import shutil
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from infrablend.annotation.classes import drop_classes
from infrablend.config.agc import Agc
from infrablend.core.dataset import Dataset, ImageRecord, Split
from infrablend.core.files import read_regular
from infrablend.core.format_table import writer_for_task
from infrablend.detection import tiles
from infrablend.detection.detections import TASKS
from infrablend.detection.scale import DATA, EIGHT_BIT, TILES
from infrablend.errors import DatasetError, OutputError, Problem
from infrablend.formats import writing
from infrablend.formats.pictures.images import size_problem
from infrablend.formats.pictures.listing import read_size
from infrablend.formats.pictures.temperature_scale import deep_mode, is_deep
from infrablend.lab.training.presets import Preset
from infrablend.lab.training.train_request import TrainRequest
from infrablend.lab.training.training_record import PreparedCounts
from infrablend.pipeline.datasets.eight_bit import eight_bit_copies

# Losses of the written format that would hide labels from the trainer.
_FATAL_LOSSES = ("box_outside", "without_mask_omitted", "class_unfit")
# Rejected labels and pictures that an error lists; it counts the others.
_REJECTED_SHOWN = 20
_FEW_PICTURES = 100
# Ultralytics advises up to 10 % of pictures without objects. With 40 % of them, a detector of inserted cars had AP50
# 0.48 of real ones (three trainings), and 0.54 without them (two).
_MOST_EMPTY = 0.1

log = logging.getLogger(__name__)


def select_training_data(dataset: Dataset, request: TrainRequest) -> tuple[Dataset, dict[str, int]]:
    """Return the dataset to train on and the labels left out by class; report all faults at once."""
    task = request.task
    classes = request.classes
    if task not in TASKS:
        raise OutputError(f"--task {task}: no such task; expected one of {', '.join(TASKS)}")
    known = [c.name for c in dataset.categories if not c.ignore]
    keep = [c for c in known if classes is None or c in classes]
    dropped = [c.name for c in dataset.categories if c.name not in keep]
    left_out = Counter(o.category for i in dataset.images for o in i.instances if o.category in dropped)
    wanted = drop_classes(dataset, dropped)
    problems = [
        *_class_problems(dataset, known, classes),
        *_split_problems(wanted, keep, request.chosen_preset()),
        *_shape_problems(wanted, keep, task),
    ]
    rejected = [p for p in dataset.problems if p.severity == "error"]
    wrong = [p for p in problems if p.severity == "error"]
    if rejected or wrong:
        message = f"{dataset.root}: cannot be trained on"
        if rejected:
            shown = f"; here are the first {_REJECTED_SHOWN}" if len(rejected) > _REJECTED_SHOWN else ""
            message += (
                f". {len(rejected)} labels or pictures could not be read and would be missing{shown}. "
                f"Correct them (infrablend check {dataset.root} lists all), or leave them out with "
                f"infrablend convert {dataset.root} clean --to coco and train on clean"
            )
        raise DatasetError(message, [*wrong, *rejected[:_REJECTED_SHOWN]])
    for p in problems:
        log.warning("%s", p)
    return _checked(wanted, request.agc), dict(sorted(left_out.items()))


def _class_problems(dataset: Dataset, known: Sequence[str], classes: Sequence[str] | None) -> list[Problem]:
    unknown = [c for c in classes or () if c not in known]
    if unknown:
        expected = f"classes of the dataset ({', '.join(known) or 'it has none'})"
        todo = _classes_line([c for c in known if c in (classes or ())])
        return [Problem("--classes", "category-unknown", ", ".join(unknown), expected, todo)]
    if not known or (classes is not None and not classes):
        return [Problem(str(dataset.root), "category-none", "no class", "at least one", "label something")]
    return []


def _split_problems(wanted: Dataset, keep: Sequence[str], preset: Preset) -> Iterator[Problem]:
    """Yield the splits and classes without pictures or objects; they are warnings where nothing depends on them."""
    splits = Counter(i.split for i in wanted.images)
    expected_of: dict[Split, str] = {
        "train": "pictures to train on",
        "val": "pictures, as the preset stops when val no longer improves" if preset.patience
        else "pictures to follow the training; nothing else depends on them",
    }  # fmt: skip
    for split, expected in expected_of.items():
        if not splits[split]:
            todo = "create splits with infrablend split"
            problem = Problem(f"split {split}", "split-empty", "no pictures", expected, todo)
            yield problem if split == "train" or preset.patience else replace(problem, severity="warning")
    if 0 < splits["train"] < _FEW_PICTURES and preset.name != "smoke":
        found = f"{splits['train']} pictures"
        expected = f"{_FEW_PICTURES} or more: a detector finds little after fewer"
        todo = "give more pictures, or take its figures as those of a test run"
        yield Problem("split train", "few-pictures", found, expected, todo, severity="warning")
    empty = sum(i.split == "train" and not i.instances for i in wanted.images)
    if _MOST_EMPTY < empty / max(splits["train"], 1) < 1:
        found = f"{empty} of {splits['train']} pictures without an object"
        expected = f"{_MOST_EMPTY:.0%} or less: they take the place of objects among the images shown"
        how = f" with infrablend convert --with-class {shlex.quote(keep[0])}" if len(keep) == 1 else ""
        todo = f"leave them out{how}, unless false alarms matter more"
        yield Problem("split train", "many-empty", found, expected, todo, severity="warning")
    objects = _objects_of(wanted.images, "train")
    for name in keep:
        if splits["train"] and not objects[name]:
            todo = _classes_line([c for c in keep if objects[c]])
            problem = Problem(f"class {name}", "class-empty", "no object in split train", "at least one", todo)
            bearable = preset.name == "smoke" and any(objects[c] for c in keep)
            yield replace(problem, severity="warning") if bearable else problem


def _shape_problems(wanted: Dataset, keep: Sequence[str], task: str) -> Iterator[Problem]:
    """Yield the classes with objects that lack the shape of the task: an oriented box or a mask."""
    lacks = {"obb": lambda o: o.corners_xy is None, "segment": lambda o: o.mask is None}.get(task)
    if lacks is None:
        return
    bare = Counter(o.category for i in wanted.images for o in i.instances if lacks(o))
    todo = "train --task detect"
    code = "obb-missing"
    what = "oriented box"
    if task == "segment":
        code = "mask-missing"
        what = "mask"
        objects = _objects_of(wanted.images, "train")
        with_masks = _classes_line([c for c in keep if objects[c] and not bare[c]])
        todo += f", or {with_masks}" if with_masks else ""
    for name, count in bare.items():
        yield Problem(f"class {name}", code, f"{count} objects without {what}", "one for each", todo)


def _objects_of(images: Iterable[ImageRecord], split: str) -> Counter[str]:
    return Counter(o.category for i in images if i.split == split for o in i.instances)


def _classes_line(names: Sequence[str]) -> str:
    """Return the option that trains on these classes alone, ready to paste; empty for no class."""
    listed = ",".join(name.replace(",", "\\,") for name in names)
    return f"add --classes {shlex.quote(listed)}" if names else ""


def _checked(dataset: Dataset, agc: Agc) -> Dataset:
    """Return train and val with the sizes in the pictures' headers.

    Raises:
        DatasetError: Pictures that cannot be read, have another size than annotated, or hold floats; pictures of 8 and
            of 16 bits; 16-bit pictures without the temperature scale that the AGC needs: all of them.
    """
    images = []
    problems = []
    deep = []
    for image in dataset.images:
        if image.split == "test":
            continue
        size_wh, problem = read_size(image.path, image.id)
        problems += [problem] if problem is not None else []
        if size_wh is None:
            continue
        if other := size_problem(image, image.id, size_wh):
            problems.append(other)
        mode = deep_mode(image)
        if mode.startswith("F"):
            todo = "write it with 16 bits and state the scale: the trainer cannot read floats"
            problems.append(Problem(image.id, "image-depth", f"mode {mode}", "8-bit or 16-bit pictures", todo))
        deep += [image] if mode.startswith("I") else []
        images.append(replace(image, size_wh=size_wh))
    if deep and len(deep) < len(images):
        todo = "put them in two folders; an AGC would show the same scene differently in the two"
        problems += [
            Problem(i.id, "image-depth", "16 bits per pixel", "8-bit pictures, as the others have", todo) for i in deep
        ]
    elif agc.needs_scale:
        expected = "a temperature scale, which a fixed AGC needs"
        todo = "state it: --read unit=centikelvin"
        lacking = [i for i in deep if i.capture.radiometry is None or i.capture.scale is None]
        problems += [Problem(i.id, "no-temperature-scale", "none", expected, todo) for i in lacking]
    if problems:
        raise DatasetError(f"{dataset.root}: cannot be trained on", problems)
    return replace(dataset, images=tuple(images))


def has_deep_pictures(dataset: Dataset) -> bool:
    """Return whether the pictures of data to train on have 16 bits; then all of them do."""
    return any(is_deep(i) for i in dataset.images[:1])


def most_tiles(preset: Preset, split: str) -> int:
    """Return the maximum number of tiles of a split; 0 for all."""
    return preset.tiles if split == "train" else min(preset.tiles or 256, 256)


def write_training_data(dataset: Dataset, out: Path, request: TrainRequest) -> PreparedCounts:
    """Write the data for the trainer to the folder `data` of a training, and return their counts."""
    preset = request.chosen_preset()
    images = [i for i in dataset.images if i.split in ("train", "val")]
    if has_deep_pictures(dataset):
        images = [*eight_bit_copies(images, out / EIGHT_BIT, request.agc)[0]]
    pictures = images
    tiled: dict[str, Mapping[str, int]] = {}
    if preset.tile:
        images = []
        for split in ("train", "val"):
            part = [i for i in pictures if i.split == split]
            planned = tiles.plan_tiles(part, preset.tile, seed=request.seed, most=most_tiles(preset, split))
            records, found = tiles.write_tiles(planned, out / TILES)
            images += records
            tiled[split] = {"tiles": len(records), **found}
    without_val = not any(i.split == "val" for i in images)
    if without_val:
        # Ultralytics requires a val split; with fixed passes nothing depends on it.
        images = [*images, *(replace(i, split="val") for i in images[:8])]
    categories = [replace(c, id=n) for n, c in enumerate(dataset.categories)]
    name = writer_for_task(request.task).name
    written = writing.write(name, out / DATA, images, categories)
    for working in (TILES, EIGHT_BIT):
        shutil.rmtree(out / working, ignore_errors=True)
    fatal = {k: n for k, n in written.losses.items() if k.rpartition(".")[2] in _FATAL_LOSSES}
    if fatal:
        problems = [Problem(name, k, f"{n} labels would be lost", "none",
                            "infrablend check lists them") for k, n in fatal.items()]  # fmt: skip
        raise DatasetError(f"{dataset.root}: the trainer would not see some labels", problems)
    counts: PreparedCounts = {
        "pictures": dict(Counter(i.split for i in pictures)),
        "objects": {s: dict(sorted(_objects_of(pictures, s).items())) for s in ("train", "val")},
        "images": sum(i.split == "train" for i in images),
        "labels": _written_labels(out / DATA, "train"),
        "images_val": sum(i.split == "val" for i in images),
        "labels_val": _written_labels(out / DATA, "val"),
        "losses": dict(written.losses),
    }
    if tiled:
        sides = sorted(max(i.size_wh) for i in pictures if i.split == "train" and i.size_wh is not None)
        counts["picture_px"] = sides[len(sides) // 2]
        counts["tiles"] = tiled["train"]
        counts["tiles_val"] = tiled["val"]
    if without_val:
        counts["val"] = "the first pictures of train: there is no val split, and nothing depends on it"
    return counts


def _written_labels(data: Path, split: str) -> int:
    return sum(len(read_regular(p).splitlines()) for p in (data / "labels" / split).rglob("*.txt"))
