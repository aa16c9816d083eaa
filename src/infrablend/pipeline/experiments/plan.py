"""The plan of an experiment: what a run with the same request would make, and about how long that takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from infrablend.pipeline.experiments import training_setup
from infrablend.pipeline.experiments.estimate import estimate_bytes, estimate_seconds, free_bytes, measured_rates
from infrablend.pipeline.experiments.graph import OTHER_SCALES
from infrablend.pipeline.experiments.prepare import PreparedExperiment
from infrablend.pipeline.experiments.stage import read_stage_record, stage_folder

LEARNING = ("train", "evaluate")
"""Kinds of stages that need the trainer."""
NO_WORK = ("done", "not needed", "adopted")
"""Statuses of stages that take no time."""


@dataclass(frozen=True)
class ExperimentPlan:
    """What a run would do.

    Attributes:
        facts: Stages with images, seconds and bytes, and their sums, as plain JSON.
    """

    facts: Mapping[str, Any]

    def to_json(self) -> dict[str, Any]:
        """Return the plan as plain JSON values."""
        return dict(self.facts)


def plan_experiment(prepared: PreparedExperiment) -> ExperimentPlan:
    """Return stages, images, time and disk space of a run, without writing anything.

    Raises:
        DatasetError: `only` or `adopt` names no stage, or something cannot be adopted.
        MissingDependencyError: The device that was asked for is not available.
        OutputError: The trainer does not know a setting.
    """
    graph, request = prepared.graph, prepared.request
    prepared.require_adoptable()
    finished = set(prepared.finished())
    adopted = set(request.adopt) - finished
    chosen = graph.select(request.only, finished | adopted) | adopted
    chosen |= {n for s in graph.stages if s.id in adopted for n in s.needs.values() if n.startswith("source:")}
    required = prepared.required(finished | adopted)
    todo = [s for s in graph.stages if s.id in (chosen & required) - finished - adopted]
    if request.device not in ("auto", "cpu") and any(s.kind in LEARNING for s in todo):
        training_setup.require_trainer(request.device)
    training_setup.require_training_settings(todo, request)
    rates = measured_rates(request.work)
    rows = []
    for s in graph.stages:
        if s.id not in chosen:
            continue
        key = graph.keys[s.id]
        if s.id in finished:
            status = "done"
        elif s.id in adopted:
            status = "adopted"
        elif s.id in required:
            status = (read_stage_record(stage_folder(request.work, s, key)) or {}).get("status", "to do")
        else:
            status = "not needed"
        work = status not in NO_WORK
        row: dict[str, Any] = {"stage": s.id, "key": key, "images": sum(s.images.values()), "status": status}
        row["needs"] = sorted(s.needs.values())
        if s.kind == "train":
            row["training"] = dict(s.inputs["preset"])
        row["about_s"] = round(estimate_seconds(s, rates, request), 1) if work else 0.0
        row["disk_bytes"] = estimate_bytes(s) if work else 0
        rows.append(row)
    facts = {
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
