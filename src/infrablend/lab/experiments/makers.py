"""Makes each kind of stage, with the functions that the command of the same name calls."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import cast

from infrablend.annotation.looseness import Looseness
from infrablend.core.dataset import SPLITS, Category, Dataset, ImageRecord, Split
from infrablend.core.tasks import paced
from infrablend.detection.detections import Task
from infrablend.detection.truth import class_key
from infrablend.errors import DatasetError, Problem, RenderError
from infrablend.formats.base import sort_images
from infrablend.formats.image_groups import frame_places
from infrablend.formats.read_write import Reading
from infrablend.lab.evaluation.evaluate import evaluate_detector
from infrablend.lab.evaluation.evaluation_comparison import compare_evaluations
from infrablend.lab.evaluation.evaluation_settings import EvaluationSettings
from infrablend.lab.experiments.definition import Convert, Detectability, Evaluation, Generate, Merge, Resplit, Training
from infrablend.lab.experiments.experiment_request import ExperimentRequest
from infrablend.lab.experiments.pasting import make_paste
from infrablend.lab.experiments.result_record import (
    CompareResult,
    DataResult,
    DetectabilityResult,
    EvaluateResult,
    TrainResult,
)
from infrablend.lab.experiments.stage import StageJob, data_result, read_dataset, spread_images
from infrablend.lab.training.train import train_dataset
from infrablend.lab.training.train_request import TrainRequest
from infrablend.lab.world.world_dataset import WorldRequest, make_world, write_sky_pictures
from infrablend.pipeline.datasets.convert import convert_dataset
from infrablend.pipeline.datasets.requests import ClassChanges, Selection, SplitRule
from infrablend.pipeline.datasets.select import select
from infrablend.pipeline.datasets.split import split_dataset
from infrablend.pipeline.flights.detectability import measure_detectability
from infrablend.pipeline.flights.detectability_request import DetectabilityRequest, DetectabilitySettings
from infrablend.pipeline.plans.run_request import Execution, RunRequest
from infrablend.pipeline.runs.generate import run_request


def _make_source(job: StageJob) -> DataResult:
    """Record the user's folder as it is, or write a part of it."""
    stage = job.stage
    path = stage.path or job.needs["of"].dataset
    dataset = read_dataset(path, options=stage.inputs.get("options"))
    limits = stage.inputs.get("limits") or {}
    whole = data_result(dataset, job.relative(path))
    if all(whole["images"].get(s, 0) <= n for s, n in limits.items()):
        result = whole
        if stage.path:  # the user's folder may move
            del result["dataset"]
            del result["there"]
    else:
        part = replace(dataset, images=tuple(spread_images(dataset, limits)))
        convert_dataset(part, "coco", job.out)
        result = data_result(part)
    result["whole"] = whole["images"]
    return result


def _make_world(job: StageJob) -> DataResult:
    inputs = job.stage.inputs
    out = job.out
    if inputs["layout"] == "sky":
        write_sky_pictures(out, inputs["images"], inputs["seed"], inputs["classes"])
    else:
        workers = Execution(job.request.workers).worker_count()
        make_world(out, WorldRequest(inputs["images"], inputs["seed"], inputs["layout"]), workers, job.on_progress)
    return data_result(read_dataset(out))


def _make_run(job: StageJob) -> DataResult:
    """Insert objects by a recipe; frames that failed are tried a second time."""
    spec: Generate = job.stage.spec
    source = job.needs["of"]
    request = job.request
    run = RunRequest(
        spec.recipe,
        source.dataset,
        job.out,
        seed=request.seed,
        settings={**spec.settings, "output.formats": ["coco"], "output.layout": "files"},
        reading=Reading(splits=spec.splits, options=source.reader_options),
        execution=_execution(request),
    )
    for _ in range(2):
        report = job.resume_or_restart(lambda existing: run_request(replace(run, existing=existing), job.on_progress))
        if not report.counts.get("failed_frames"):
            break
    else:
        problems = [p for p in report.problems if p.code.startswith("frame-")]
        raise RenderError(f"{job.stage.id}: frames failed twice; run the same command to try them again", problems)
    result = data_result(read_dataset(job.out / "coco"), "out/coco", report.counts)
    result["there"] = ["out/coco", "out/images"]
    counted = ("frames", "objects_inserted", "skipped_backgrounds")
    result["run"] = {k: report.counts[k] for k in counted if k in report.counts}
    return result


def _execution(request: ExperimentRequest) -> Execution:
    return Execution(request.workers, renderer=request.renderer, in_process=request.renderer == "flat")


def _make_part(job: StageJob) -> DataResult:
    """Write a part of a dataset with its classes renamed or dropped."""
    spec: Convert = job.stage.spec
    source = job.needs["of"]
    out = job.out
    dataset = read_dataset(source.dataset, splits=spec.splits, options=source.reader_options)
    images = [image for split in spec.splits for image in _chosen_images(job, dataset, split)]
    dataset = replace(dataset, images=_with_clips(images) if spec.clips else tuple(images))
    known = {c.name for c in dataset.categories}
    classes = ClassChanges({old: new for old, new in spec.rename.items() if old in known}, spec.drop, spec.only)
    report = convert_dataset(dataset, "coco", out, classes=classes, looseness=Looseness.of_labels(spec))
    return data_result(read_dataset(out), counts=report.counts)


def _with_clips(images: Sequence[ImageRecord]) -> tuple[ImageRecord, ...]:
    """Return the images, those without a sequence with the clip that their names tell, if they tell one."""
    return tuple(
        image
        if place is None or image.capture.sequence is not None
        else replace(image, capture=replace(image.capture, sequence=place[0].removeprefix("./")))
        for image, place in zip(images, frame_places(images), strict=True)
    )


def _chosen_images(job: StageJob, dataset: Dataset, split: str) -> Sequence[ImageRecord]:
    spec: Convert = job.stage.spec
    known = {c.name for c in dataset.categories}
    without = tuple(c for c in spec.without if c in known)
    part = replace(dataset, images=tuple(i for i in dataset.images if i.split == split))
    wanted = Selection(spec.with_class, without, like=spec.like, seed=job.request.seed)
    if spec.like is not None:
        wanted = replace(wanted, images=_matchable_images(part, spec.like, without))
    if (most := job.stage.inputs.get("images", {}).get(split)) is not None:
        wanted = replace(wanted, images=min(most, len(part.images) if wanted.images is None else wanted.images))
    shown = {None, *(o.category for i in part.images for o in i.instances)}
    if split != "train" and (wanted.images == 0 or spec.with_class not in shown):
        return ()  # a training can do without val
    if (match := job.needs.get("match")) is not None:
        n = match.data["images"].get(split, 0)
        objects = match.data["labels"].get(split, {}).get(spec.with_class or "", 0)
        wanted = replace(wanted, images=n, objects=objects)
        if not n:
            return ()
    return select(part, wanted)[0].images if part.images and wanted else part.images


def _matchable_images(part: Dataset, like: str, without: Sequence[str]) -> int:
    """Return how many images to draw so that the images with the class can match them in number."""
    classes = [{o.category for o in i.instances} for i in part.images]
    others = set(without) - {like}
    return min(sum(not c & set(without) for c in classes), sum(like in c and not c & others for c in classes))


def _make_merge(job: StageJob) -> DataResult:
    spec: Merge = job.stage.spec
    parts = []
    for k, (part, asked) in enumerate(zip(spec.parts, job.stage.inputs["parts"], strict=True)):
        source = job.needs[f"part{k}"]
        dataset = read_dataset(source.dataset, options=source.reader_options)
        images = [i for i in dataset.images if i.split in part.splits]
        drawn = draw_images(replace(dataset, images=tuple(images)), asked["images"], job.stage.inputs["seed"])
        parts.append((part.of, drawn if part.into is None else move_images(drawn, part.into)))
    merged = merge_datasets(parts)
    if not merged.images:
        names = ", ".join(name for name, _ in parts)
        problem = Problem(job.stage.id, "split-empty", f"no image in the splits taken from {names}", "at least one")
        raise DatasetError(f"{job.stage.id}: cannot be used", [problem])
    convert_dataset(merged, "coco", job.out)
    return data_result(merged)


def draw_images(dataset: Dataset, limits: Mapping[str, int], seed: int) -> Dataset:
    """Return at most `limits` images per split, drawn at random; smaller draws are parts of larger ones."""
    images: list[ImageRecord] = []
    for split in dict.fromkeys(i.split for i in dataset.images):
        of_split = replace(dataset, images=tuple(i for i in dataset.images if i.split == split))
        n = limits.get(split, len(of_split.images))
        drawn = of_split if n >= len(of_split.images) else select(of_split, Selection(images=n, seed=seed))[0]
        images += drawn.images
    return replace(dataset, images=tuple(images))


def move_images(dataset: Dataset, split: Split) -> Dataset:
    """Return the dataset with all images in one split, each in a folder named after its own split."""
    moved = [replace(i, split=split, id=f"{i.split}/{i.id}", file_name=f"{i.split}/{i.name}") for i in dataset.images]
    return replace(dataset, images=tuple(moved))


def merge_datasets(parts: Sequence[tuple[str, Dataset]]) -> Dataset:
    """Return one dataset with the images of several, each in a folder named after its part.

    Classes of the same name are one class, with the id of the first that has it; an id that is taken is replaced by the
    next free one. Such a class is ignored only if it is ignored in all datasets that have it.
    A name that occurs again gets a number.
    """
    categories: dict[str, Category] = {}
    images = []
    names: list[str] = []
    for name, dataset in parts:
        folder = name if name not in names else f"{name}-{names.count(name) + 1}"
        names.append(name)
        for c in dataset.categories:
            if (known := categories.get(c.name)) is not None:
                categories[c.name] = replace(known, ignore=known.ignore and c.ignore)
                continue
            ids = {k.id for k in categories.values()}
            categories[c.name] = replace(c, id=c.id if c.id not in ids else max(ids) + 1)
        for image in dataset.images:
            images.append(replace(image, id=f"{folder}/{image.id}", file_name=f"{folder}/{image.name}"))
    first = parts[0][1]
    problems = tuple(p for _, dataset in parts for p in dataset.problems)
    return Dataset(first.root, first.format, tuple(categories.values()), sort_images(images), problems)


def _make_split(job: StageJob) -> DataResult:
    spec: Resplit = job.stage.spec
    source = job.needs["of"]
    out = job.out
    dataset = read_dataset(source.dataset, options=source.reader_options)
    rule = SplitRule(spec.by, spec.gap, spec.shares, job.request.seed, spec.test)
    report = split_dataset(dataset, out, rule, to="coco")
    result = data_result(read_dataset(out))
    wanted = [s for s, share in zip(SPLITS, spec.shares, strict=True) if share or (s == "test" and spec.test)]
    empty = [s for s in wanted if not result["images"].get(s)]
    if empty:
        found = f"no image in {', '.join(empty)}: {len(report.groups)} group(s) by {spec.by}"
        expected = f"a group for each of {', '.join(wanted)}"
        problem = Problem(job.stage.id, "split-empty", found, expected, "use a dataset with more groups")
        raise DatasetError(f"{job.stage.id}: cannot be used", [problem])
    result["leakage_before"] = [one.to_json() for one in report.before]
    result["leakage_after"] = [one.to_json() for one in report.after]
    return result


def _make_training(job: StageJob) -> TrainResult:
    spec: Training = job.stage.spec
    data = job.needs["data"]
    request = TrainRequest(
        preset=job.request.scale,
        settings={**spec.settings, **job.request.training},
        task=spec.task,
        weights=spec.weights,
        device=job.request.device,
        seed=job.stage.inputs["seed"],
        classes=spec.classes,
    )
    dataset = read_dataset(data.dataset, options=data.reader_options)
    report = job.resume_or_restart(
        lambda existing: train_dataset(dataset, job.out, request, existing=existing, on_progress=job.on_progress)
    )
    weights = job.relative(report.weights)
    return {"record": report.record, "weights": weights, "there": [weights]}


def _make_evaluation(job: StageJob) -> EvaluateResult:
    spec: Evaluation = job.stage.spec
    training = job.needs["training"]
    data = job.needs["data"]
    report = evaluate_detector(
        training.folder / training.trained["weights"],
        read_dataset(data.dataset, options=data.reader_options),
        job.out,
        EvaluationSettings(
            split=spec.split,
            task=cast("Task", training.record["inputs"]["task"]),
            classes=_evaluated_classes(spec, training.trained["record"]["classes"], data.data, job.stage.id),
            bootstrap=job.stage.inputs["bootstrap"],
            group=spec.group,
            seed=job.request.seed,
            list_first=spec.list_first or 0,
            list_iou=spec.list_iou,
            by_body=spec.by_body,
            tracks=spec.tracks,
        ),
        device=job.request.device,
        on_image=paced(job.on_progress),
    )
    return {"metrics": report.metrics, "there": ["out/evaluation.json", "out/predictions.json"]}


def _evaluated_classes(
    spec: Evaluation, trained: Sequence[str], data: DataResult, stage_id: str
) -> tuple[str, ...] | None:
    """Return the classes to evaluate: those listed, or those that both detector and images have."""
    if spec.classes != "joint":
        return spec.classes
    known = {class_key(c) for c in trained}
    labels = data["labels"].get(spec.split, {})
    joint = tuple(c for c in data["classes"] if class_key(c) in known and labels.get(c))
    if not joint:
        found = f"the detector has {', '.join(trained)}, the images have {', '.join(labels) or 'no labels'}"
        problem = Problem(stage_id, "class-none", found, "at least one class that both have")
        raise DatasetError(f"{stage_id}: no joint class", [problem])
    return joint


def _make_detectability(job: StageJob) -> DetectabilityResult:
    spec: Detectability = job.stage.spec
    training = job.needs["training"]
    data = job.needs["data"]
    request = DetectabilityRequest(
        spec.recipe,
        training.folder / training.trained["weights"],
        data.dataset,
        DetectabilitySettings(until=job.stage.inputs["until"], category=spec.category, group=spec.group),
        recipe_settings=spec.settings,
        reading=Reading(splits=(spec.split,), options=data.reader_options),
        execution=_execution(job.request),
        device=job.request.device,
        seed=job.request.seed,
    )
    report = measure_detectability(request, job.out, on_progress=job.on_progress)
    return {"facts": report.facts, "there": ["out/detectability.json", "out/detectability.html"]}


def _make_comparison(job: StageJob) -> CompareResult:
    a, b = ([made.folder / "out" for role, made in job.needs.items() if role.startswith(side)] for side in "ab")
    found = compare_evaluations(a, b, bootstrap=job.stage.inputs["bootstrap"], seed=job.request.seed)
    return {"classes": found["classes"], "left_out": found["left_out"]}


MAKERS: Mapping[str, Callable[[StageJob], Mapping[str, object]]] = {
    "source": _make_source,
    "world": _make_world,
    "generate": _make_run,
    "convert": _make_part,
    "split": _make_split,
    "merge": _make_merge,
    "paste": make_paste,
    "train": _make_training,
    "evaluate": _make_evaluation,
    "detectability": _make_detectability,
    "compare": _make_comparison,
}
"""The maker of each kind of stage: it writes the stage's output and returns the result to record."""
