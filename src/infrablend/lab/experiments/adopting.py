"""Adopting results made outside the experiment: a training, a run or a dataset, checked as far as its record allows."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from infrablend import __version__
from infrablend.config.loading import read_recipe
from infrablend.core.dataset import SPLITS
from infrablend.core.file_names import leaves_folder
from infrablend.core.files import LINK_OUT, link_or_copy, load_json
from infrablend.core.run_folder import RUN_FILE, RunFolder
from infrablend.errors import DatasetError, Problem
from infrablend.lab.experiments.dataset_facts import data_result, read_dataset
from infrablend.lab.experiments.definition import Generate
from infrablend.lab.experiments.graph import deciding_fields
from infrablend.lab.experiments.result_record import DataResult, TrainResult
from infrablend.lab.experiments.stage import StageJob
from infrablend.lab.training.presets import Preset
from infrablend.lab.training.training_record import TrainingRecord
from infrablend.pipeline.plans.planning import make_plan
from infrablend.pipeline.runs.recorded import RecordedRun

ADOPTABLE = ("train", "generate", "convert")
"""Kinds of stages that can be adopted."""


def adopt_result(job: StageJob, folder: Path) -> DataResult | TrainResult:
    """Return the result of a stage from a folder that `train`, `generate` or `convert` has written.

    A training must have the settings, seed, classes, images and labels of the stage; a run its recipe, seed, version
    and backgrounds. How a dataset was converted cannot be checked; the record and the page say so.

    Raises:
        DatasetError: The folder contains something else; the error lists every difference.
    """
    training = _checked_training(job, folder) if job.stage.kind == "train" else None
    if job.stage.kind == "generate":
        _check_run(job, folder)
    shutil.copytree(folder, job.out, copy_function=lambda a, b: _adopt_file(folder, Path(a), Path(b)))
    if training is not None:
        weights = "out/weights.pt"
        training["adopted"] = True
        return {"record": training, "adopted": "checked", "weights": weights, "there": [weights]}
    checked = job.stage.kind == "generate"
    root = job.out / "coco" if checked else job.out
    result = data_result(read_dataset(root, splits=job.stage.spec.splits), job.relative(root))
    result["there"] = ["out"]
    result["adopted"] = "checked" if checked else "unchecked"
    return result


def _checked_training(job: StageJob, folder: Path) -> TrainingRecord:
    inputs = job.stage.inputs
    data = job.needs["data"].data
    path = folder / "train.json"
    try:
        found = load_json(path)
    except (OSError, ValueError) as error:
        expected = "a folder written by `infrablend train`"
        problem = Problem(str(path), "adopt-record", f"cannot be read ({error})", expected)
        raise DatasetError("nothing to adopt", [problem]) from error
    record: Any = found if isinstance(found, dict) else {}
    prepared = record.get("prepared") or {}
    asked = dict(inputs["preset"])
    settings = {k: v for k, v in (record.get("settings") or {}).items() if k in asked}
    classes = list(inputs["classes"] or data["classes"])
    labels = {k: n for k, n in data["labels"].get("train", {}).items() if k in classes and n}
    epochs, shown = Preset(**{"summary": "", **asked}).epochs_for(prepared.get("images") or 0)
    stops_early = bool(asked.get("patience"))
    pairs = {
        "weights": (Path(str(record.get("start_asked"))).name, inputs["weights"]),
        "epochs": (record.get("epochs"), epochs),
        "images shown": (record.get("passes"), record.get("passes") if stops_early else epochs * shown),
        "task": (record.get("task"), inputs["task"]),
        "seed": (record.get("seed"), inputs["seed"]),
        "settings": (settings, json.loads(json.dumps(asked))),
        "classes": (record.get("classes"), classes),
        "images": ((prepared.get("pictures") or {}).get("train"), data["images"].get("train")),
        "labels": ((prepared.get("objects") or {}).get("train"), labels),
    }
    if "weights_sha256" in record:  # earlier versions recorded the path alone
        pairs["SHA-256 of the weights"] = (record["weights_sha256"], inputs.get("weights_sha256"))
    _require_equal(job.stage.id, folder, pairs)
    return cast("TrainingRecord", record)


def _check_run(job: StageJob, folder: Path) -> None:
    record = RunFolder(folder).read_run()
    spec: Generate = job.stage.spec
    recipe = read_recipe(spec.recipe, spec.settings).recipe
    recorded = RecordedRun.from_record(record, folder / RUN_FILE).recipe
    source = job.needs["of"]
    seed = job.request.seed
    dataset = read_dataset(source.dataset, options=source.reader_options)
    keys = []
    for splits in (spec.splits, SPLITS):  # made from the splits that are needed, or from all
        part = replace(dataset, images=tuple(i for i in dataset.images if i.split in splits))
        keys.append(make_plan(recipe, part, seed).key["backgrounds"])
    backgrounds = (record.get("key") or {}).get("backgrounds")
    pairs = {
        "seed": (record.get("seed"), seed),
        "version": (record.get("infrablend"), __version__),
        "renderer": ((record.get("machine") or {}).get("renderer"), job.request.renderer),
        "recipe": (deciding_fields(recorded), deciding_fields(recipe)),
        "backgrounds": (backgrounds, backgrounds if backgrounds in keys else keys[0]),
        "labels": ((folder / "coco").is_dir(), True),
    }
    _require_equal(job.stage.id, folder, pairs)


def _adopt_file(folder: Path, source: Path, target: Path) -> Path:
    if leaves_folder(source, folder):
        raise DatasetError(f"{source}: {LINK_OUT}")
    return link_or_copy(source, target)


def _require_equal(stage_id: str, folder: Path, pairs: Mapping[str, tuple[Any, Any]]) -> None:
    problems = [
        Problem(f"{stage_id}, {what}", "adopt-other", json.dumps(found), json.dumps(expected))
        for what, (found, expected) in pairs.items()
        if found != expected
    ]
    if problems:
        raise DatasetError(f"{folder}: does not match {stage_id}", problems)
