"""Experiments: generate, train, evaluate and compare by one file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from infrablend.core.tasks import OnProgress
from infrablend.pipeline.experiments.request import ExperimentRequest

if TYPE_CHECKING:
    from infrablend.pipeline.experiments.forecast import ExperimentPlan
    from infrablend.pipeline.experiments.run import ExperimentReport, OnStage


def list_experiments() -> dict[str, str]:
    """Return the names of the shipped experiments and the question each one answers."""
    from infrablend.config import experiment as experiments

    return {name: experiments.load_experiment(name).description for name in experiments.list_experiments()}


def experiment(
    request: ExperimentRequest, *, on_stage: OnStage | None = None, on_progress: OnProgress | None = None
) -> ExperimentReport:
    """Run an experiment: generate, train, evaluate, compare, and write the page, as far as the run gets.

    The same request continues an interrupted run, and experiments share equal stages. `on_stage` is called with a
    stage's id, what happened (`found`, `started`, `done`, `adopted`), its number, and the number of stages.
    """
    from infrablend.pipeline.experiments.prepare import prepare_experiment
    from infrablend.pipeline.experiments.run import run_experiment

    return run_experiment(prepare_experiment(request), on_stage=on_stage, on_progress=on_progress)


def plan_experiment(request: ExperimentRequest) -> ExperimentPlan:
    """Return stages, images, time and disk space of an experiment, without writing anything."""
    from infrablend.pipeline.experiments.forecast import plan_experiment as plan_stages
    from infrablend.pipeline.experiments.prepare import prepare_experiment

    return plan_stages(prepare_experiment(request))
