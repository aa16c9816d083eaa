"""Forecasts what an experiment would make, and its approximate time and disk space.

Times come from finished stages in the work folder, or else from constants.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from infrablend.config.loading import read_recipe
from infrablend.core.files import free_bytes, read_object
from infrablend.core.machine import describe_machine
from infrablend.core.operating_system import usable_processors
from infrablend.core.workspace import partial_of
from infrablend.detection.predict import pick_device
from infrablend.detection.recall import Z95
from infrablend.detection.ultralytics_environment import require_ultralytics
from infrablend.errors import InfraBlendError
from infrablend.lab.experiments.definition import Detectability, Generate
from infrablend.lab.experiments.experiment_request import ExperimentRequest
from infrablend.lab.experiments.graph import OTHER_SCALES, preset_of
from infrablend.lab.experiments.prepare import PreparedExperiment
from infrablend.lab.experiments.result_record import PlanFacts, PlannedStage
from infrablend.lab.experiments.stage import RECORD, Stage, stage_folder
from infrablend.lab.training.presets import cpu_threads, estimate_seconds
from infrablend.lab.training.start_weights import AUTO, SCRATCH, network_of
from infrablend.lab.training.training_backends import BACKENDS
from infrablend.lab.training.training_record import TrainingRecord
from infrablend.pipeline.flights.detectability_request import DEFAULT_DETECTABILITY
from infrablend.pipeline.plans.scenes import about_scenes

LEARNING = ("train", "evaluate", "detectability")
"""Kinds of stages that need the trainer."""
NO_WORK = ("done", "not needed", "adopted")
"""Statuses of stages that take no time."""

# Seconds on one core, as in docs/explanation/performance.md.
FRAME_S = 0.06
OBJECT_S = 0.06
WORLD_S = 2.0
COPY_S = 0.002
PASTE_S = 0.02
PREDICT_S = {"cpu": 0.15, "gpu": 0.01}
COMPARE_S = 20.0
START_S = 5.0
IMAGE_BYTES = 120_000
WEIGHTS_BYTES = 60_000_000
LABELS_BYTES = 2_000  # labels and predictions of an image; the pictures themselves are hard links

Rates = Mapping[tuple[str, str], float]
"""Measured seconds per image, by kind of stage and network."""


def measured_rates(work: Path, device: str = "cpu") -> Rates:
    """Return seconds per image of the stages in a work folder that this machine made; per image shown for trainings.

    Trainings count that ran on the kind of device, and with the number of threads, that the next one will have.
    """
    trained_on = "gpu" if _runs_on_gpu(device) else cpu_threads()
    here = {k: describe_machine()[k] for k in ("processor", "cores")}
    sums: dict[tuple[str, str], tuple[float, int]] = {}
    for path in sorted(work.glob(f"*/*/{RECORD}")):
        record = read_object(path) or {}
        with contextlib.suppress(KeyError, TypeError, ValueError, AttributeError):  # a record that is not ours
            if {k: record["machine"].get(k) for k in here} != here:
                continue
            seconds, images = _seconds_and_images(record)
            if images and (record["kind"] != "train" or _trained_on(record["result"]["record"]) == trained_on):
                key = (str(record["kind"]), _network(record["inputs"]))
                before_s, before = sums.get(key, (0.0, 0))
                sums[key] = (before_s + max(seconds - START_S, 0.0), before + images)
    return {k: seconds / images for k, (seconds, images) in sums.items()}


def _seconds_and_images(record: Any) -> tuple[float, int]:
    result = record["result"]
    seconds = float(record["seconds"])
    match record["kind"]:
        case "train":
            return float(result["record"]["seconds"]), int(result["record"]["passes"])
        case "evaluate":
            return seconds, int(result["metrics"]["classes"]["all"]["images"])
        case "world":
            return seconds, sum(result["images"].values())
    return seconds, 0  # no basis for estimates


def _trained_on(record: TrainingRecord) -> str | int:
    return int(record["threads"]) if record["device"] == "cpu" else "gpu"


def _network(inputs: Mapping[str, Any]) -> str:
    """Return what determines the training time per image, network and size; empty for other stages."""
    preset = inputs.get("preset")
    if not preset:
        return ""
    start = inputs["weights"]  # which bring their own network
    model = preset["model"] if start in (AUTO, SCRATCH) else inputs.get("weights_sha256", start)
    return f"{model} {preset['image_size']}"


def stage_seconds(stage: Stage, rates: Rates, request: ExperimentRequest) -> float:
    """Return about how many seconds a stage takes."""
    images = sum(stage.images.values())
    known = rates.get((stage.kind, _network(stage.inputs)))
    if stage.kind == "train":
        if known is not None and (passes := stage.inputs["preset"].get("passes")):
            return START_S + float(passes) * known
        preset = preset_of(request, stage.spec)
        shown = stage.images.get("train", 0)
        if preset.tile:  # with about five objects in a picture, for which HIT-UAV needs 1.4 tiles
            shown += math.ceil(0.08 * (5 * shown))
        shown = min(shown, preset.tiles) if preset.tiles else shown
        return estimate_seconds(preset, shown, gpu=_runs_on_gpu(request.device), threads=cpu_threads())
    if known is not None:
        return START_S + images * known
    match stage.kind:
        case "world":
            return START_S + images * WORLD_S
        case "generate":
            return START_S + images * (FRAME_S + OBJECT_S * _mean_objects(stage.spec)) / len(usable_processors())
        case "evaluate":
            return START_S + images * PREDICT_S["gpu" if _runs_on_gpu(request.device) else "cpu"]
        case "detectability":
            return START_S + _searched_seconds(stage, request)
        case "paste":
            return START_S + images * PASTE_S
        case "compare":
            return COMPARE_S * (0.1 if request.scale == "smoke" else 1.0)
    return images * COPY_S


def _searched_seconds(stage: Stage, request: ExperimentRequest) -> float:
    """Return about how long frames with enough objects take, if half of them are found, and pictures as they are."""
    objects = _mean_objects(stage.spec)
    images = sum(stage.images.values())
    recipe = read_recipe(stage.spec.recipe, stage.spec.settings).recipe
    most = images * about_scenes(recipe, images) * DEFAULT_DETECTABILITY.most_rounds
    frames = min(0.25 * (Z95 / float(stage.inputs["until"])) ** 2 / max(objects, 0.1), most)
    predict_s = PREDICT_S["gpu" if _runs_on_gpu(request.device) else "cpu"]
    return frames * ((FRAME_S + OBJECT_S * objects) / len(usable_processors()) + predict_s) + images * predict_s


def _runs_on_gpu(device: str) -> bool:
    try:
        return device != "cpu" and pick_device(device) != "cpu"
    except InfraBlendError:  # reported where a training is required, not where its time is estimated
        return False


def require_trainer(device: str) -> None:
    """Check that Ultralytics and the device are available, before anything is made.

    Raises:
        MissingDependencyError: One of them is not.
    """
    require_ultralytics()
    pick_device(device)


def require_training_settings(stages: Iterable[Stage], request: ExperimentRequest) -> None:
    """Check settings and start weights of all trainings now rather than hours later.

    Without Ultralytics, only our own settings are checked.

    Raises:
        OutputError: The trainer does not know a setting.
        FetchError: There are no such weights.
        ModelError: Weights are damaged, or for another task.
    """
    for stage in stages:
        if stage.kind == "train":
            backend = BACKENDS["ultralytics"]
            preset = preset_of(request, stage.spec)
            backend.require_settings(preset, stage.spec.task)
            backend.require_start(stage.spec.weights, preset, stage.spec.task)


def _add_training(row: PlannedStage, stage: Stage, request: ExperimentRequest) -> None:
    spec = stage.spec
    row["training"] = dict(stage.inputs["preset"])
    row["weights"] = stage.inputs["weights"]
    row["network"] = network_of(spec.weights, preset_of(request, spec), spec.task)


def _mean_objects(spec: Generate | Detectability) -> float:
    total = 0.0
    for o in read_recipe(spec.recipe, spec.settings).recipe.objects:
        if isinstance(o.count, int):
            total += o.count
        else:
            weights = o.count.weights or (1.0,) * len(o.count.values)
            total += sum(v * w for v, w in zip(o.count.values, weights, strict=True)) / sum(weights)
    return total


def estimate_bytes(stage: Stage) -> int:
    """Return about how much disk space a stage takes."""
    images = sum(stage.images.values())
    if stage.kind in ("generate", "world", "paste"):
        return images * IMAGE_BYTES
    if stage.kind == "train":
        return images * IMAGE_BYTES + WEIGHTS_BYTES
    return images * LABELS_BYTES


@dataclass(frozen=True)
class ExperimentPlan:
    """What a run would do.

    Attributes:
        facts: Stages with images, seconds and bytes, and their sums, as plain JSON.
    """

    facts: PlanFacts

    def to_json(self) -> dict[str, object]:
        """Return the plan as plain JSON values."""
        return dict(self.facts)


def plan_experiment(prepared: PreparedExperiment) -> ExperimentPlan:
    """Return stages, images, time and disk space of a run, without writing anything.

    Raises:
        DatasetError: `only` or `adopt` names no stage, or something cannot be adopted.
        MissingDependencyError: The device that was asked for is not available.
        OutputError: The trainer does not know a setting.
    """
    graph = prepared.graph
    request = prepared.request
    prepared.require_adoptable()
    finished = set(prepared.finished())
    adopted = set(request.adopt) - finished
    chosen = graph.select(request.only, finished | adopted) | adopted
    chosen |= {n for s in graph.stages if s.id in adopted for n in s.needs.values() if n.startswith("source:")}
    required = prepared.required(finished | adopted)
    todo = [s for s in graph.stages if s.id in (chosen & required) - finished - adopted]
    if request.device not in ("auto", "cpu") and any(s.kind in LEARNING for s in todo):
        require_trainer(request.device)
    require_training_settings(todo, request)
    # The kind of device is asked of torch, which takes seconds to import.
    rates = measured_rates(request.work, request.device if any(s.kind in LEARNING for s in todo) else "cpu")
    rows: list[PlannedStage] = []
    for s in graph.stages:
        if s.id not in chosen:
            continue
        status = "done" if s.id in finished else "adopted" if s.id in adopted else "not needed"
        if status == "not needed" and s.id in required:
            begun = partial_of(stage_folder(request.work, s, graph.keys[s.id])).is_dir()
            status = "interrupted" if begun else "to do"
        work = status not in NO_WORK
        row: PlannedStage = {
            "stage": s.id,
            "key": graph.keys[s.id],
            "images": sum(s.images.values()),
            "status": status,
            "needs": sorted(s.needs.values()),
            "about_s": round(stage_seconds(s, rates, request), 1) if work else 0.0,
            "disk_bytes": estimate_bytes(s) if work else 0,
        }
        if s.kind == "train":
            _add_training(row, s, request)
        rows.append(row)
    facts: PlanFacts = {
        "experiment": prepared.experiment.name,
        "scale": request.scale,
        "device": request.device,
        "seed": request.seed,
        "stages": rows,
        "to_do": sum(r["status"] not in NO_WORK for r in rows),
        "about_s": round(sum(r["about_s"] for r in rows)),
        "disk_bytes": sum(r["disk_bytes"] for r in rows),
        "disk_free_bytes": free_bytes(request.work),
        "left_out": {n: why for n, why in graph.left_out.items() if why != OTHER_SCALES},
        "stand_ins": list(graph.stand_ins),
    }
    return ExperimentPlan(facts)
