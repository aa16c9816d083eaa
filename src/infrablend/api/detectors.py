"""Detectors: train and evaluate them, compare evaluations; experiments, which do all of it by one file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from infrablend.api.datasets import read_dataset
from infrablend.core.output import require_apart
from infrablend.core.tasks import OnProgress, paced
from infrablend.core.workspace import Existing
from infrablend.formats.reading import READ_ALL, Reading
from infrablend.pipeline.detectors.evaluation_settings import DEFAULT_SETTINGS, EvaluationSettings
from infrablend.pipeline.detectors.train import TrainReport, train_dataset
from infrablend.pipeline.detectors.training_plan import TrainPlan, plan_training
from infrablend.pipeline.experiments.request import ExperimentRequest
from infrablend.training.request import DEFAULT_TRAINING, TrainRequest

if TYPE_CHECKING:
    from infrablend.evaluation.comparison import EvaluationComparison
    from infrablend.pipeline.detectors.evaluate import EvaluationReport
    from infrablend.pipeline.experiments.forecast import ExperimentPlan
    from infrablend.pipeline.experiments.run import ExperimentReport, OnStage


def train(
    dataset: str | Path, out: str | Path, request: TrainRequest = DEFAULT_TRAINING, *, reading: Reading = READ_ALL,
    existing: Existing = "refuse", on_progress: OnProgress | None = None,
) -> TrainReport:  # fmt: skip
    """Train a detector with Ultralytics; write `weights.pt` and `train.json`. Needs `infrablend[train]`.

    `dataset` has any readable format; a run of `generate` is one. `existing` decides what happens to an earlier
    training in `out`: `refuse`, `resume` or `overwrite`.
    """
    require_apart(Path(dataset), Path(out))
    found = read_dataset(dataset, reading)
    return train_dataset(found, Path(out), request, existing=existing, on_progress=on_progress)


def plan_train(
    dataset: str | Path, request: TrainRequest = DEFAULT_TRAINING, *, reading: Reading = READ_ALL,
    out: str | Path | None = None, existing: Existing = "refuse",
) -> TrainPlan:  # fmt: skip
    """Return images, epochs, time and disk space of `train`; whatever `train` would refuse is refused here too.

    >>> plan_train("hit-uav", TrainRequest(preset="smoke", device="cpu", classes=["Car"])).images
    2
    """
    folder = None if out is None else Path(out)
    return plan_training(read_dataset(dataset, reading), request, out=folder, existing=existing)


def evaluate(
    weights: str | Path, dataset: str | Path, out: str | Path, settings: EvaluationSettings = DEFAULT_SETTINGS, *,
    device: str = "auto", reading: Reading = READ_ALL, against: str | Path | None = None, overwrite: bool = False,
    on_progress: OnProgress | None = None,
) -> EvaluationReport:  # fmt: skip
    """Evaluate a detector on a split: tables, strata, intervals and plots; docs/how_to/evaluate.md explains them.

    `weights` are Ultralytics weights (.pt) or the folder of a finished `train`, which need `infrablend[train]`; or
    `predictions.json` or the folder of an earlier evaluation, which need neither torch nor Ultralytics. `against` is
    the folder of another evaluation on the same images and labels. For tracks, all frames of videos are read unless
    the reading states a step.
    """
    from infrablend.formats.detection import with_every_frame
    from infrablend.pipeline.detectors.evaluate import evaluate_detector
    from infrablend.storage.mirror import local_folder

    require_apart(Path(dataset), Path(out))
    if settings.tracks:
        reading = with_every_frame(reading, local_folder(dataset))
    return evaluate_detector(
        Path(weights), read_dataset(dataset, reading), Path(out), settings, device=device,
        against=None if against is None else Path(against), overwrite=overwrite, on_image=paced(on_progress),
    )  # fmt: skip


def compare_evaluations(
    ours: str | Path | Sequence[str | Path], theirs: str | Path | Sequence[str | Path], *,
    classes: Sequence[str] | None = None, bootstrap: int = 1000, seed: int = 0,
) -> EvaluationComparison:  # fmt: skip
    """Return the difference of mAP50 and mAP50-95 of two evaluations on the same images, by class, with its interval.

    Either side may be several folders, of detectors that differ only in their training seed: their means are compared,
    and the interval includes the variation between seeds. By default all classes are compared that both evaluated.
    """
    from infrablend.evaluation import comparison

    first, second = ([Path(s)] if isinstance(s, str | Path) else [Path(p) for p in s] for s in (ours, theirs))
    facts = comparison.compare_evaluations(first, second, classes=classes, bootstrap=bootstrap, seed=seed)
    return comparison.EvaluationComparison(**facts)


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
