"""The stages of an experiment: what decides their result (the key), how each kind is made, where it is kept.

A stage lives in `WORK/<kind>/<key>/`: `out/` is what it made, `stage.json` its record, written last. The key is the
digest of everything that decides the result, those of the stages before it included: the same training in two
experiments is the same stage. A stage is done when its record says `complete`.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

from infrablend import __version__
from infrablend.assets.user_model import description_digest, is_description
from infrablend.config.experiment import Convert, Evaluation, Generate, Resplit, Scale, Training
from infrablend.config.loading import load_recipe
from infrablend.config.modes import recipe_from_json
from infrablend.config.recipe import Recipe
from infrablend.core.dataset import SPLITS, Dataset, ImageRecord, Split
from infrablend.core.files import link_or_copy, write_json
from infrablend.core.machine import describe_machine, installed_versions
from infrablend.core.output import OutputFolder
from infrablend.core.run_layout import RUN_FILE
from infrablend.errors import DatasetError, Interrupted, OutputError, Problem, RenderError
from infrablend.pipeline.content import json_digest
from infrablend.pipeline.convert import ClassChanges, convert_dataset
from infrablend.pipeline.plan import make_plan
from infrablend.pipeline.rerender import recipe_json
from infrablend.pipeline.select import Selection, select
from infrablend.training.presets import Preset

RECORD = "stage.json"
ADOPTABLE = ("train", "generate", "convert")
"""Kinds that can be taken over from elsewhere."""
# Raised where a kind comes to make something else of the same inputs: its old results are then not taken.
VERSIONS = {"source": 1, "world": 1, "generate": 1, "convert": 1, "split": 1, "train": 2, "evaluate": 2, "compare": 1}
_PACKAGES = ("bpy", "numpy", "opencv-python-headless", "Pillow", "pycocotools", "ultralytics", "torch")


@dataclass(frozen=True)
class Tools:
    """What stages are made with: the functions of `infrablend.api` of these names; tests bring their own."""

    read_dataset: Callable[..., Dataset]
    generate: Callable[..., Any]
    split: Callable[..., Any]
    make_world: Callable[..., Any]
    train: Callable[..., Any]
    evaluate: Callable[..., Any]
    compare_evaluations: Callable[..., Mapping[str, Any]]
    preset: Callable[[str, Mapping[str, Any]], Mapping[str, Any]]
    """The trainer's settings at a scale, with some set otherwise."""
    training_seconds: Callable[[str, Mapping[str, Any], int, bool], float]
    """About how long a training takes: scale, settings, images, whether on a GPU."""
    require_training: Callable[[str], None]
    """Raises where training cannot begin on the device."""
    require_settings: Callable[[str, Mapping[str, Any]], None]
    """Raises where the trainer does not know a setting: scale, settings."""


@dataclass(frozen=True)
class Setting:
    """What holds for all stages of a run.

    Attributes:
        work: Folder of the stages.
        scale: `smoke`, `small` or `paper`.
        seed: Of every random stream.
        device: Of the trainer; `auto` takes a GPU if there is one.
        training: Settings of every training over those of the scale's preset.
        renderer: `blender`, or `fake` (flat shapes).
        workers: Rendering processes; None for one per core.
        tools: See `Tools`.
        on_progress: Given to what takes it.
    """

    work: Path
    scale: Scale
    seed: int
    device: str
    tools: Tools
    training: Mapping[str, Any] = field(default_factory=dict)
    renderer: str = "blender"
    workers: int | None = None
    on_progress: Callable[..., None] | None = None


@dataclass(frozen=True)
class Stage:
    """One stage.

    Attributes:
        kind: A key of `KINDS`.
        name: In the experiment's file.
        inputs: What decides its result beside the stages before it, plain JSON.
        needs: Ids of the stages before it, by the part they play.
        spec: What the experiment's file says of it.
        images: About how many images it makes or learns from, by split; for plans.
        path: Of a source: the user's folder.
    """

    kind: str
    name: str
    inputs: Mapping[str, Any]
    needs: Mapping[str, str]
    spec: Any = None
    images: Mapping[str, int] = field(default_factory=dict)
    path: Path | None = None

    @property
    def id(self) -> str:
        """`train:aligned` and the like."""
        return f"{self.kind}:{self.name}"


@dataclass(frozen=True)
class Made:
    """A finished stage: its folder and its record."""

    folder: Path
    record: Mapping[str, Any]
    path: Path | None = None

    @property
    def result(self) -> Mapping[str, Any]:
        """What the kind has to say."""
        found: Mapping[str, Any] = self.record["result"]
        return found

    @property
    def dataset(self) -> Path:
        """Of a data stage: the folder to read."""
        return self.path if self.path is not None else self.folder / self.result["dataset"]


def keys_of(stages: Sequence[Stage]) -> dict[str, str]:
    """The key of each stage; each comes after what it needs."""
    keys: dict[str, str] = {}
    for s in stages:
        needs = {part: keys[i] for part, i in s.needs.items()}
        keys[s.id] = json_digest([s.kind, VERSIONS[s.kind], dict(s.inputs), needs])
    return keys


def folder_of(work: Path, stage: Stage, key: str) -> Path:
    """Where a stage is kept."""
    return work / stage.kind / key


def read_stage(folder: Path) -> dict[str, Any] | None:
    """The record, or None if there is none that can be read."""
    try:
        data = json.loads((folder / RECORD).read_text("utf-8"))
    except (OSError, ValueError):
        return None
    return data if isinstance(data, dict) else None


def finished(work: Path, stage: Stage, key: str) -> Made | None:
    """The stage if it is done."""
    folder = folder_of(work, stage, key)
    record = read_stage(folder)
    if record is None or record.get("status") != "complete" or not isinstance(record.get("result"), dict):
        return None
    made = Made(folder, record, stage.path if stage.kind == "source" and not record["result"].get("dataset") else None)
    there = made.result.get("there", [])
    return made if all((folder / p).exists() for p in there) else None


def make(stage: Stage, key: str, before: Mapping[str, Made], setting: Setting, adopt: Path | None = None) -> Made:
    """Make a stage, or go on with what an interrupted run left of it.

    Args:
        stage: Which.
        key: Its key.
        before: The stages that it needs, by id.
        setting: How.
        adopt: Take over what was made elsewhere, in this folder.

    Raises:
        DatasetError: What is to be taken over is something else.
        OutputError: Another process makes it, or the disk is full.
        Interrupted: What is done of it is kept.
        InfraBlendError: Whatever its kind raises.
    """
    folder = folder_of(setting.work, stage, key)
    with OutputFolder(folder, f"stage {stage.id}", RECORD).claimed():
        if (done := finished(setting.work, stage, key)) is not None:  # by the other command meanwhile
            return done
        left = read_stage(folder) or {}
        spent = float(left.get("seconds", 0.0))
        head = {
            "kind": stage.kind,
            "name": stage.name,
            "key": key,
            "inputs": dict(stage.inputs),
            "needs": {part: before[i].record["key"] for part, i in stage.needs.items() if i in before},
            "machine": describe_machine(),
            "packages": {"infrablend": __version__, **installed_versions(_PACKAGES)},
            "commit": commit(),
        }
        write_json(folder / RECORD, {**head, "status": "running", "seconds": spent})
        started = time.monotonic()
        parts = {part: before[i] for part, i in stage.needs.items() if i in before}

        def seconds() -> float:
            return round(spent + time.monotonic() - started, 3)

        try:
            if adopt is None:
                result = KINDS[stage.kind](stage, folder / "out", parts, setting)
            else:
                result = take_over(stage, folder / "out", parts, setting, adopt)
        except BaseException as error:
            stopped = isinstance(error, Interrupted | KeyboardInterrupt)
            status = "interrupted" if stopped else "failed"
            with contextlib.suppress(OutputError):  # the disk is full: what is there stays
                write_json(folder / RECORD, {**head, "status": status, "seconds": seconds()})
            raise
        write_json(folder / RECORD, {**head, "status": "complete", "seconds": seconds(), "result": result})
        record = read_stage(folder) or {}  # as any later run reads it
    return Made(folder, record, stage.path if stage.kind == "source" and not result.get("dataset") else None)


# The kinds.


def _source(stage: Stage, out: Path, before: Mapping[str, Made], setting: Setting) -> dict[str, Any]:
    """The user's folder as it is, or a part of it written anew."""
    path = stage.path or before["of"].dataset
    dataset = setting.tools.read_dataset(path, options=dict(stage.inputs.get("options", {})))
    limits = stage.inputs.get("limits") or {}
    facts = facts_of(dataset)
    if all(facts["images"].get(s, 0) <= n for s, n in limits.items()):
        stand_in = {} if stage.path else {"dataset": _relative(out, path), "there": [_relative(out, path)]}
        return {**facts, "whole": facts["images"], **stand_in}
    _fresh(out)
    part = replace(dataset, images=tuple(some_of(dataset, limits)))
    convert_dataset(part, "coco", out)
    return {**facts_of(part), "whole": facts["images"], "dataset": "out", "there": ["out"]}


def _relative(out: Path, path: Path) -> str:
    return os.path.relpath(path, out.parent)


def some_of(dataset: Dataset, limits: Mapping[str, int]) -> Iterator[ImageRecord]:
    """At most so many images of each split: first one of each class, rarest first, then evenly spread."""
    for split in SPLITS:
        images = [i for i in dataset.images if i.split == split]
        n = limits.get(split, len(images))
        if len(images) <= n:
            yield from images
            continue
        counts = Counter(o.category for i in images for o in i.instances)
        chosen: set[int] = set()
        for name, _ in sorted(counts.items(), key=lambda pair: (pair[1], pair[0])):
            if len(chosen) < n and not any(o.category == name for k in chosen for o in images[k].instances):
                chosen.add(next(k for k, i in enumerate(images) if any(o.category == name for o in i.instances)))
        for k in range(n):
            if len(chosen) < n:
                wanted = k * len(images) // n
                chosen.add(min((j for j in range(len(images)) if j not in chosen), key=lambda j: (abs(j - wanted), j)))
        yield from (images[k] for k in sorted(chosen))


def _world(stage: Stage, out: Path, before: Mapping[str, Made], setting: Setting) -> dict[str, Any]:
    """A virtual world in a dataset's place."""
    _fresh(out)
    setting.tools.make_world(
        out, stage.inputs["images"], stage.inputs["seed"], layout=stage.inputs["layout"], workers=setting.workers,
        on_progress=setting.on_progress,
    )  # fmt: skip
    return {**facts_of(setting.tools.read_dataset(out)), "dataset": "out", "there": ["out"]}


def _generate(stage: Stage, out: Path, before: Mapping[str, Made], setting: Setting) -> dict[str, Any]:
    """A run of the generator."""
    spec: Generate = stage.spec
    if out.exists() and not (out / RUN_FILE).is_file():  # killed before its first record
        shutil.rmtree(out)
    report = None
    for _ in range(2):  # a frame that failed is tried again, once
        report = setting.tools.generate(
            spec.recipe,
            before["of"].dataset,
            out,
            splits=spec.splits,
            seed=setting.seed,
            workers=setting.workers,
            formats=["coco"],
            options=_options(before["of"]),
            settings=spec.settings,
            resume=out.exists(),
            on_progress=setting.on_progress,
            renderer=setting.renderer,
            in_process=setting.renderer == "fake",
        )
        if not report.counts.get("failed_frames"):
            break
    else:
        problems = [p for p in report.problems if p.code.startswith("frame-")] if report else []
        raise RenderError(f"{stage.id}: frames failed twice; the same command tries them again", problems)
    made = setting.tools.read_dataset(out / "coco")
    counts = {k: report.counts[k] for k in ("frames", "objects_inserted", "skipped_backgrounds") if k in report.counts}
    return {**facts_of(made), "run": counts, "dataset": "out/coco", "there": ["out/coco", "out/images"]}


def _convert(stage: Stage, out: Path, before: Mapping[str, Made], setting: Setting) -> dict[str, Any]:
    """A part, its classes renamed or dropped."""
    spec: Convert = stage.spec
    _fresh(out)
    dataset = setting.tools.read_dataset(before["of"].dataset, splits=spec.splits, options=_options(before["of"]))
    known = {c.name for c in dataset.categories}
    without = tuple(c for c in spec.without if c in known)
    images: list[ImageRecord] = []
    for split in spec.splits:
        part = replace(dataset, images=tuple(i for i in dataset.images if i.split == split))
        wanted = Selection(spec.with_class, without, like=spec.like, seed=setting.seed)
        if spec.like is not None:
            wanted = replace(wanted, images=_as_many(part, spec.like, without))
        if (most := spec.images.get(setting.scale, {}).get(split)) is not None:
            wanted = replace(wanted, images=min(most, len(part.images) if wanted.images is None else wanted.images))
        if split != "train" and (wanted.images == 0 or not _shows(part, spec.with_class)):
            continue  # training does without val
        if (match := before.get("match")) is not None:
            n = match.result["images"].get(split, 0)
            objects = match.result["labels"].get(split, {}).get(spec.with_class, 0)
            wanted = replace(wanted, images=n, objects=objects)
            if not n:
                continue
        images += select(part, wanted)[0].images if part.images and wanted else part.images
    dataset = replace(dataset, images=tuple(images))
    report = convert_dataset(
        dataset, "coco", out, classes=ClassChanges(spec.rename, spec.drop, spec.only), loosen=spec.loosen
    )
    loosened = {k: report.counts[k] for k in ("boxes_loosened", "loosened_by") if k in report.counts}
    return {**facts_of(setting.tools.read_dataset(out)), **loosened, "dataset": "out", "there": ["out"]}


def _shows(part: Dataset, category: str | None) -> bool:
    return category is None or any(o.category == category for i in part.images for o in i.instances)


def _as_many(part: Dataset, like: str, without: Sequence[str]) -> int:
    """How many images to draw like those of a class: no more than can later be matched by images that show it."""
    shown = [{o.category for o in i.instances} for i in part.images]
    apart = set(without) - {like}
    return min(sum(not s & set(without) for s in shown), sum(like in s and not s & apart for s in shown))


def _resplit(stage: Stage, out: Path, before: Mapping[str, Made], setting: Setting) -> dict[str, Any]:
    """New splits."""
    spec: Resplit = stage.spec
    _fresh(out)
    report = setting.tools.split(
        before["of"].dataset, out, by=spec.by, gap=spec.gap, shares=spec.shares, seed=setting.seed, to="coco",
        options=_options(before["of"]),
    )  # fmt: skip
    facts = facts_of(setting.tools.read_dataset(out))
    empty = [s for s in SPLITS if not facts["images"].get(s)]
    if empty:
        found = f"no image in {', '.join(empty)}: {len(report.groups)} group(s) by {spec.by}"
        raise DatasetError(
            f"{stage.id}: cannot be used",
            [Problem(stage.id, "split-empty", found, "a group for each of train, val and test", "give more images")],
        )
    near = [one.to_json() for one in report.after]
    before_ = [one.to_json() for one in report.before]
    return {**facts, "leakage_before": before_, "leakage_after": near, "dataset": "out", "there": ["out"]}


def _train(stage: Stage, out: Path, before: Mapping[str, Made], setting: Setting) -> dict[str, Any]:
    """A detector."""
    spec: Training = stage.spec
    report = setting.tools.train(
        before["data"].dataset,
        out,
        preset=setting.scale,
        task=spec.task,
        weights=spec.weights,
        device=setting.device,
        seed=stage.inputs["seed"],
        settings={**setting.training, **spec.settings},
        classes=spec.classes,
        options=_options(before["data"]),
        resume=out.is_dir() and any(out.iterdir()),
        on_progress=setting.on_progress,
    )
    weights = os.path.relpath(report.weights, out.parent)
    return {"record": dict(report.record), "weights": weights, "there": [weights]}


def _evaluate(stage: Stage, out: Path, before: Mapping[str, Made], setting: Setting) -> dict[str, Any]:
    """A detector's figures."""
    spec: Evaluation = stage.spec
    _fresh(out)
    training, data = before["training"], before["data"]
    report = setting.tools.evaluate(
        training.folder / training.result["weights"],
        data.dataset,
        out,
        split=spec.split,
        task=before["training"].record["inputs"]["task"],
        device=setting.device,
        classes=_classes(spec, training.result["record"], data.result, stage.id),
        options=_options(data),
        bootstrap=stage.inputs["bootstrap"],
        group=spec.group,
        seed=setting.seed,
        on_progress=setting.on_progress,
    )
    return {"metrics": dict(report.metrics), "there": ["out/evaluation.json", "out/predictions.json"]}


def _classes(
    spec: Evaluation, trained: Mapping[str, Any], data: Mapping[str, Any], where: str
) -> tuple[str, ...] | None:
    """The classes to judge."""
    if spec.classes != "joint":
        return spec.classes
    known = {plain(c) for c in trained["classes"]}
    labels = data["labels"].get(spec.split, {})
    joint = tuple(c for c in data["classes"] if plain(c) in known and labels.get(c))
    if not joint:
        found = f"the detector has {', '.join(trained['classes'])}, the images have {', '.join(labels) or 'no labels'}"
        raise DatasetError(f"{where}: no joint class", [Problem(where, "class-none", found, "classes of both")])
    return joint


def _compare(stage: Stage, out: Path, before: Mapping[str, Made], setting: Setting) -> dict[str, Any]:
    """Two detectors on the same images."""
    a, b = ([made.folder / "out" for part, made in before.items() if part.startswith(side)] for side in "ab")
    found = setting.tools.compare_evaluations(
        a,
        b,
        bootstrap=stage.inputs["bootstrap"],
        seed=setting.seed,
    )
    return {"classes": found["classes"], "left_out": found["left_out"]}


KINDS: Mapping[str, Callable[[Stage, Path, Mapping[str, Made], Setting], dict[str, Any]]] = {
    "source": _source,
    "world": _world,
    "generate": _generate,
    "convert": _convert,
    "split": _resplit,
    "train": _train,
    "evaluate": _evaluate,
    "compare": _compare,
}


# What was made elsewhere.


def take_over(stage: Stage, out: Path, before: Mapping[str, Made], setting: Setting, folder: Path) -> dict[str, Any]:
    """The result of a stage from a folder that `train`, `generate` or `convert` wrote by itself.

    A training must have the settings, seed, classes, images and labels of this stage; a run its recipe, seed, version
    and backgrounds. How other data were made cannot be told: the record, and the page, say so.

    Raises:
        DatasetError: It is something else; all that differs.
    """
    found = _adopted_training(stage, before, folder) if stage.kind == "train" else None
    if stage.kind == "generate":
        _require_run(stage, before, setting, folder)
    _fresh(out)
    shutil.copytree(folder, out, copy_function=lambda a, b: link_or_copy(Path(a), Path(b)))
    if found is not None:
        weights = "out/weights.pt"
        return {"record": {**found, "adopted": True}, "adopted": "checked", "weights": weights, "there": [weights]}
    root = out / "coco" if stage.kind == "generate" else out
    facts = facts_of(setting.tools.read_dataset(root, splits=stage.spec.splits))
    checked = stage.kind == "generate"
    return {
        **facts,
        "adopted": "checked" if checked else "unchecked",
        "dataset": _relative(out, root),
        "there": ["out"],
    }


def _adopted_training(stage: Stage, before: Mapping[str, Made], folder: Path) -> dict[str, Any]:
    """Its record, if it is the training that the stage asks for."""
    record = _read_record(folder / "train.json", "a folder that `infrablend train` wrote")
    data, prepared = before["data"].result, record.get("prepared") or {}
    asked = dict(stage.inputs["preset"])
    settings = {k: v for k, v in (record.get("settings") or {}).items() if k in asked}
    classes = list(stage.inputs["classes"] or data["classes"])
    labels = {k: n for k, n in data["labels"].get("train", {}).items() if k in classes and n}
    epochs, shown = _length(asked, prepared.get("images") or 0)
    early = bool(asked.get("patience"))
    pairs = {
        "status": (record.get("status"), "complete"),
        "weights": (record.get("start_asked"), stage.inputs["weights"]),
        "epochs": (record.get("epochs"), epochs),
        "images shown": (record.get("passes"), record.get("passes") if early else epochs * shown),
        "task": (record.get("task"), stage.inputs["task"]),
        "seed": (record.get("seed"), stage.inputs["seed"]),
        "settings": (settings, json.loads(json.dumps(asked))),
        "classes": (record.get("classes"), classes),
        "images": ((prepared.get("pictures") or {}).get("train"), data["images"].get("train")),
        "labels": ((prepared.get("objects") or {}).get("train"), labels),
    }
    _require_alike(stage.id, folder, pairs)
    return record


def _length(preset: Mapping[str, Any], images: int) -> tuple[int, int]:
    """Epochs of a training, and images shown in each."""
    return Preset(**{"summary": "", **preset}).epochs_for(images)


def _require_run(stage: Stage, before: Mapping[str, Made], setting: Setting, folder: Path) -> None:
    record = _read_record(folder / RUN_FILE, "a folder that `infrablend generate` wrote")
    spec: Generate = stage.spec
    recipe = load_recipe(spec.recipe, spec.settings)
    theirs = recipe_from_json(recipe_json(record))
    dataset = setting.tools.read_dataset(before["of"].dataset, options=_options(before["of"]))
    keys = []
    for splits in (spec.splits, SPLITS):  # with the splits that are needed, or with all
        part = replace(dataset, images=tuple(i for i in dataset.images if i.split in splits))
        keys.append(make_plan(recipe, part, setting.seed).key["backgrounds"])
    theirs_key = (record.get("key") or {}).get("backgrounds")
    pairs = {
        "status": (record.get("status"), "complete"),
        "seed": (record.get("seed"), setting.seed),
        "version": (record.get("infrablend"), __version__),
        "renderer": ((record.get("machine") or {}).get("renderer"), setting.renderer),
        "recipe": (_said(theirs), _said(recipe)),
        "backgrounds": (theirs_key, theirs_key if theirs_key in keys else keys[0]),
        "labels": ((folder / "coco").is_dir(), True),
    }
    _require_alike(stage.id, folder, pairs)


def _read_record(path: Path, expected: str) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        problem = Problem(str(path), "adopt-record", f"cannot be read ({error})", expected)
        raise DatasetError("nothing to take over", [problem]) from error
    return found if isinstance(found, dict) else {}


def _require_alike(where: str, folder: Path, pairs: Mapping[str, tuple[Any, Any]]) -> None:
    """Raise if (found, expected) of anything differ."""
    problems = [
        Problem(f"{where}, {what}", "adopt-other", json.dumps(found), json.dumps(expected))
        for what, (found, expected) in pairs.items()
        if found != expected
    ]
    if problems:
        raise DatasetError(f"{folder}: is not what {where} asks for", problems)


def _options(made: Made) -> dict[str, str] | None:
    """Reader's options: those of a source that is read as it lies; what was written by us needs none."""
    if made.path is None:
        return None
    return dict(made.record["inputs"].get("options", {})) or None


def _fresh(out: Path) -> None:
    """Remove what an interrupted stage left: `out` is this stage's alone."""
    if out.exists():
        shutil.rmtree(out)


def plain(name: str) -> str:
    """A class name without case and blanks: `Other Vehicle` is `OtherVehicle`."""
    return "".join(c for c in name.casefold() if c.isalnum())


def facts_of(dataset: Dataset) -> dict[str, Any]:
    """Images and labels by split, classes, kinds of labels. Ignore regions are no class."""
    ignored = {c.name for c in dataset.categories if c.ignore}
    objects = [o for i in dataset.images for o in i.instances if o.category not in ignored]
    labels: dict[Split, dict[str, int]] = {}
    for split in SPLITS:
        found = Counter(o.category for i in dataset.images if i.split == split for o in i.instances)
        labels[split] = {n: k for n, k in sorted(found.items()) if n not in ignored}
    kinds = {
        "AABB": bool(objects),
        "OBB": any(o.corners_xy is not None for o in objects),
        "Masks": any(o.mask is not None for o in objects),
    }
    return {
        "images": {s: n for s in SPLITS if (n := sum(i.split == s for i in dataset.images))},
        "labels": labels,
        "classes": [c.name for c in dataset.categories if not c.ignore],
        "label_kinds": [k for k, there in kinds.items() if there],
        "format": dataset.format,
    }


def recipe_inputs(spec: Generate) -> dict[str, Any]:
    """What a recipe says, own models by content. A field that a later version adds leaves what was made of use."""
    recipe = load_recipe(spec.recipe, spec.settings)
    own = {o.model: description_digest(Path(o.model)) for o in recipe.objects if is_description(o.model)}
    return {
        "recipe": _said(recipe),
        "models": sorted(own.values()),
        "splits": list(spec.splits),
        "version": __version__,
    }


def _said(recipe: Recipe) -> dict[str, Any]:
    """What of a recipe decides frames and labels."""
    left_out: Any = {"description": True, "name": True, "output": {"formats"}}
    found: dict[str, Any] = json.loads(recipe.model_dump_json(exclude=left_out, exclude_defaults=True))
    return {k: v for k, v in found.items() if v != {}}


# What figures depend on beside the inputs; for the page.


def checkout() -> Path | None:
    """The repository that this code runs from, or None."""
    root = Path(__file__).resolve().parents[3]
    return root if (root / ".git").exists() and (root / "pyproject.toml").is_file() else None


@cache
def commit() -> str | None:
    """Commit of that repository, `+` behind it if tracked sources were changed since; None outside of one."""
    root = checkout()
    if root is None:
        return None
    try:
        head = subprocess.run(["git", "rev-parse", "HEAD"], cwd=root, capture_output=True, text=True, check=True)
        changed = subprocess.run(["git", "diff", "--quiet", "HEAD", "--", "src"], cwd=root, check=False)
    except (OSError, subprocess.CalledProcessError):
        return None
    return head.stdout.strip() + ("+" if changed.returncode else "")
